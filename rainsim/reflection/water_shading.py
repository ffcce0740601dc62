"""Light on water: a pixel's tilt by ripples, the refracted bed, the reflection, the sun's glint.

`water_at` makes a pixel of water of where its ray meets the surface, `tilted` adds the ripples;
`shade_water_pixel` is the composition: what shows through the water, what it mirrors and the sun's
glint, mixed with the dry picture by the water's coverage. The CPU's loops over the list of the
water (`water_record`) and the CUDA thread of a pixel call the same three functions.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim import jit
from rainsim.constants import HALF, ONE, TWO, ZERO
from rainsim.jit import prange
from rainsim.numerics.approximations import exp_minus
from rainsim.numerics.interpolation import bilinear, bilinear_color, map_place, smoothstep
from rainsim.reflection import water_record, wet_tops
from rainsim.reflection.facets import normal_of, pixel_reflectance, view_cosine
from rainsim.reflection.slope_moments import pixel_slopes, tile_height
from rainsim.reflection.water_surface import BLOCK, WaterMap
from rainsim.scene.view import View, in_camera, pixel_ray
from rainsim.shading.fresnel import REFRACTIVE_INDEX, reflectance
from rainsim.water.ripples import LAYERS

# Absorption of puddle water [1/m], red, green, blue. Clean water takes .35, .07, .02 (Pope and Fry
# 1997); puddles hold fine soil, which takes blue most. No measurement of it is used here: a guess.
ABSORB_R, ABSORB_G, ABSORB_B = np.float32(5), np.float32(5.5), np.float32(7)
LEAST_FALL = np.float32(0.1)  # of a refracted ray over its length: bounds its way to the bed
RIPPLE_LOW, RIPPLE_HIGH = np.float32(0.0008), np.float32(0.004)  # m of water: none, full rings
SHELTERED_SHARE = np.float32(0.07)  # of the rings, under cover: they run in from the open
CELLS = np.float32(BLOCK)  # of a block, along a side
NEAREST = np.float32(0.05)  # m
RISES, LEAST_RISE = 3, np.float32(0.1)  # steps to where a ray meets ripples; its sine, at least
TURN_COSINE, TURN_SINE = np.float32(math.cos(1)), np.float32(math.sin(1))  # of the second layer
REFRACT_TOLERANCE = np.float32(0.04)  # m: what lies nearer than the bed by more is foreground


class Ripples(NamedTuple):
    """Moments of the ripples' slopes at one time."""

    moments: np.ndarray  # (n, n + n // 2, 6) float32, of slopes on a periodic tile: slope_moments
    tile_size: np.float32  # m


class Background(NamedTuple):
    """A wet picture without the water on it."""

    picture: np.ndarray  # (height, width, 3) float32, linear light
    below: np.ndarray  # (height, width, 3) float32, what shows through water: no film mirrors on it
    depth: np.ndarray  # (height, width) float32 [m], along the view axis; infinite for sky


class Optics(NamedTuple):
    """The laws of light on water, and the sun."""

    law: int  # of reflectance, see shading.fresnel.LAWS
    glint_variance: np.float32  # of slopes finer than a pixel's own, along either axis
    sun: np.ndarray  # (6,) float32: direction to it, irradiance of red, green, blue; 0 for none
    # Factor on what shows through: the wet bed's colour holds what the surface reflects from below
    # on the mean over all directions, and 1 - F takes it away for the direction of view.
    bed_gain: np.float32 = ONE


@jit.inlined_function
def water_at(view, water_map, tops, row, column, t, coverage):
    """Return the `WaterPixel` whose ray meets the surface at view depth t [m], without ripples.

    Rings do not run in a thin film of water, few run in where a roof keeps the rain off, and shores
    that are near take them.
    """
    water = surface_at(view, row, column, abs(t))
    top, on_top, _, _, _ = wet_tops.top_below(tops, water.x, water.y, water.z)
    u, v = map_place(water.x, water.y, water_map.origin, water_map.spacing)
    water_depth = bilinear(water_map.depth, u, v)
    share = smoothstep(RIPPLE_LOW, RIPPLE_HIGH, water_depth)
    share *= SHELTERED_SHARE + (ONE - SHELTERED_SHARE) * bilinear(water_map.rings, u, v)
    share *= bilinear(water_map.shores, (u + HALF) / CELLS - HALF, (v + HALF) / CELLS - HALF)
    if top >= 0:
        water_depth, share = (
            on_top,
            wet_tops.BOARD_RINGS * smoothstep(wet_tops.RING_LOW, wet_tops.RING_HIGH, on_top),
        )
    return water_record.WaterPixel(
        water.x, water.y, water.z, water.view_x, water.view_y, water.view_z, abs(t), water_depth,
        coverage, share, ZERO, ZERO, ZERO, ZERO, ZERO, water.width,
    )  # fmt: skip


@jit.inlined_function
def surface_at(view, row, column, t):
    """Return the numbers of a `WaterPixel` that the camera decides; the others are zero."""
    x, y, z = pixel_ray(view, row, column)
    eye = view.eye
    length = math.sqrt(x * x + y * y + z * z)
    inv = ONE / length
    return water_record.WaterPixel(
        eye[0] + t * x, eye[1] + t * y, eye[2] + t * z, x * inv, y * inv, z * inv, t, ZERO, ZERO,
        ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, t * length / view.fx,
    )  # fmt: skip


@jit.inlined_function
def tilted(water, ripples, tops):
    """Return a `WaterPixel` with the ripples' slopes over its footprint on the surface.

    On tops with the slopes of the top, and those of the film between puddles.
    """
    share = water.ripple_share
    a, b, aa, bb, ab = ZERO, ZERO, ZERO, ZERO, ZERO
    if share > ZERO:
        x, y = risen(water, ripples)
        a, b, aa, bb, ab = layered_slopes(water, ripples, x, y)
    square = share * share
    a, b, aa, bb, ab = share * a, share * b, square * aa, square * bb, square * ab
    top, _, smooth, gx, gy = wet_tops.top_below(tops, water.x, water.y, water.z)
    if top >= 0:
        film = (ONE - smooth) * wet_tops.FILM_SLOPE * wet_tops.FILM_SLOPE
        a, b, aa, bb = a + gx, b + gy, aa + film, bb + film
    return water_record.with_slopes(water, a, b, aa, bb, ab)


@jit.inlined_function
def risen(water, ripples):
    """Return where a pixel's ray meets the ripples, x and y, and not the level of the water.

    In a low view crests stand before troughs, and their far sides are hidden: without that heavy
    rain has bright bands along all crests, up to a quarter too much light and the wrong waves.
    The place is found by steps that shorten where slopes are below a ray's own.
    """
    x, y = water.x, water.y
    rise = max(-water.view_z, LEAST_RISE)
    for _ in range(RISES):
        h, c, s = ZERO, ONE, ZERO
        for _ in range(LAYERS):
            h += tile_height(ripples.moments, ripples.tile_size, c * x + s * y, c * y - s * x,
                             water.width)  # fmt: skip
            c, s = TURN_COSINE, TURN_SINE
        back = water.ripple_share * h / rise
        x, y = water.x - back * water.view_x, water.y - back * water.view_y
    return x, y


@jit.inlined_function
def layered_slopes(water, ripples, x, y):
    """Return the slopes of both layers of the tile at (x, y), as `pixel_slopes` returns one's.

    One layer lies as the tile does, the other turned by a radian: a sheet of water that is wider
    than the tile then nowhere looks as it does a tile further on.
    """
    a, b, aa, bb, ab = ZERO, ZERO, ZERO, ZERO, ZERO
    c, s = ONE, ZERO
    for _ in range(LAYERS):
        p, q, pp, qq, pq = pixel_slopes(
            ripples.moments, ripples.tile_size, c * x + s * y, c * y - s * x,
            c * water.view_x + s * water.view_y, c * water.view_y - s * water.view_x, water.view_z,
            water.width,
        )  # fmt: skip
        a, b = a + c * p - s * q, b + s * p + c * q
        cc, ss, cs = c * c, s * s, c * s
        aa += cc * pp - TWO * cs * pq + ss * qq
        bb += ss * pp + TWO * cs * pq + cc * qq
        ab += cs * (pp - qq) + (cc - ss) * pq
        c, s = TURN_COSINE, TURN_SINE
    return a, b, aa, bb, ab


@jit.inlined_function
def shade_water_pixel(water, row, column, light, background, view, optics):
    """Return the linear light of a pixel that shows water.

    dry * (1 - coverage) + coverage * ((1 - F) refracted + F mirrored + glint), F the reflectance.

    water : WaterPixel
    row, column : int
    light : tuple of three float32. Radiance that comes to the surface from where
        the pixel mirrors.
    """
    r, g, b, share, glint = water_terms(water, row, column, background, view, optics)
    sun, picture = optics.sun, background.picture
    through, covers, dry = ONE - share, water.coverage, ONE - water.coverage
    return (
        dry * picture[row, column, 0] + covers * (through * r + share * light[0] + glint * sun[3]),
        dry * picture[row, column, 1] + covers * (through * g + share * light[1] + glint * sun[4]),
        dry * picture[row, column, 2] + covers * (through * b + share * light[2] + glint * sun[5]),
    )  # fmt: skip


@jit.inlined_function
def water_terms(water, row, column, background, view, optics):
    """Return the light that shows through a pixel of water (r, g, b), its reflectance and glint.

    The light through the water is that before it is weakened by 1 - reflectance; the glint is per
    irradiance of the sun. Parameters are those of `shade_water_pixel`.
    """
    ux, uy, uz = normal_of(water.slope_x, water.slope_y)
    cosine = view_cosine(water, ux, uy, uz)
    share = pixel_reflectance(optics.law, water)
    u, v, travel = refracted_to(water, ux, uy, uz, cosine, background.depth, view, row, column)
    r, g, b = bilinear_color(background.below, u, v)
    glint = ZERO
    sun = optics.sun
    if sun[3] + sun[4] + sun[5] > ZERO:
        glint = sun_glint(water, sun[0], sun[1], sun[2], optics.law, optics.glint_variance)
    gain = optics.bed_gain
    return (
        gain * r * exp_minus(ABSORB_R * travel), gain * g * exp_minus(ABSORB_G * travel),
        gain * b * exp_minus(ABSORB_B * travel), share, glint,
    )  # fmt: skip


@jit.inlined_function
def refracted_to(water, ux, uy, uz, cosine, depth, view, row, column):
    """Return the image point that the view ray, bent at the normal u, ends at on the bed.

    And the length of the light's way through the water [m]: down along the bent ray, and up again
    straight to the sky.
    """
    qx, qy, qz = refracted(water.view_x, water.view_y, water.view_z, ux, uy, uz, cosine)
    path = water.water_depth / max(-qz, LEAST_FALL)
    _, _, ahead = in_camera(view, water.view_x, water.view_y, water.view_z)
    t = water.view_depth / ahead
    u, v = bed_seen_at(
        depth, view, t * water.view_x + path * qx, t * water.view_y + path * qy,
        t * water.view_z + path * qz, np.float32(column) + HALF, np.float32(row) + HALF,
    )  # fmt: skip
    return u, v, path + water.water_depth


@jit.device_function
def refracted(vx, vy, vz, ux, uy, uz, cosine):
    """Return the direction v bent into water at the normal u (Snell); v.u = -cosine."""
    eta = ONE / REFRACTIVE_INDEX
    bend = eta * cosine - math.sqrt(ONE - eta * eta * (ONE - cosine * cosine))
    return eta * vx + bend * ux, eta * vy + bend * uy, eta * vz + bend * uz


@jit.inlined_function
def bed_seen_at(depth, view, x, y, z, u0, v0):
    """Return where the bed point at ground-frame offset (x, y, z) from the eye shows.

    The pixel itself, at (u0, v0), if foreground hides it. Towards the picture's edge, beyond which
    nothing is drawn, rays bend by half of the way there at most: no row is shown twice.
    """
    ex, ey, ez = in_camera(view, x, y, z)
    if ez < NEAREST:
        return u0, v0
    height, width = depth.shape
    u = u0 + towards_edge(view.fx * ex / ez + view.cx - u0, u0, np.float32(width))
    v = v0 + towards_edge(view.fy * ey / ez + view.cy - v0, v0, np.float32(height))
    if ez - depth[int(v), int(u)] > REFRACT_TOLERANCE:
        return u0, v0
    return u, v


@jit.inlined_function
def towards_edge(shift, at, size):
    """Return a shift [px] from a place in a picture, at most half of the way to its edge."""
    return min(max(shift, -HALF * at), HALF * (size - at))


@jit.device_function
def sun_glint(water, lx, ly, lz, law, glint_variance):
    """Return the radiance of the glint of a sun in direction l, over its irradiance.

    Cox and Munk 1954: F p(slope) / (4 cos(view) n_z^4), with a Gaussian slope density p about the
    pixel's mean slope.
    """
    xx, yy = glint_variance + water.variance_x, glint_variance + water.variance_y
    xy = water.covariance
    vx, vy, vz = water.view_x, water.view_y, water.view_z
    hx, hy, hz = lx - vx, ly - vy, lz - vz
    inv = ONE / max(math.sqrt(hx * hx + hy * hy + hz * hz), np.float32(1e-6))
    hx, hy, hz = hx * inv, hy * inv, hz * inv
    if hz < np.float32(0.05) or lz <= ZERO:
        return ZERO
    ex, ey = -hx / hz - water.slope_x, -hy / hz - water.slope_y
    determinant = max(xx * yy - xy * xy, np.float32(1e-14))
    away = (yy * ex * ex - TWO * xy * ex * ey + xx * ey * ey) / determinant
    density = math.exp(-HALF * away) / (np.float32(2 * np.pi) * math.sqrt(determinant))
    f = reflectance(law, -(vx * hx + vy * hy + vz * hz))
    n4 = hz * hz * hz * hz
    return f * density / (np.float32(4) * max(-vz, np.float32(0.05)) * n4)


@jit.cpu_kernel
def list_water(
    hit, coverage, first, row_order, view: View, water_map: WaterMap, tops: wet_tops.TopMaps,
    pixel_out, record_out,
):  # fmt: skip
    """Write the record of each pixel that water covers, row by row; its slopes are zero.

    hit, coverage : float32 array (height, width) [m], [1]. As
        `ray_water.meet_water` writes them.
    first : int64 array (height,). Place of each row's first record.
    row_order : int64 array (height,). Order in which rows are taken, see
        `jit.interleaved`.
    tops : TopMaps
    pixel_out : int32 array (n,). Number of each record's pixel, row * width +
        column.
    record_out : float32 array (n, RECORD)
    """
    height, width = coverage.shape
    for k in prange(height):
        row = row_order[k]
        n = first[row]
        for column in range(width):
            if coverage[row, column] > ZERO:
                water = water_at(
                    view, water_map, tops, row, column, hit[row, column], coverage[row, column]
                )
                water_record.write_level(water, record_out[n])
                pixel_out[n] = row * width + column
                n += 1


@jit.cpu_kernel
def tilt_water(ripples: Ripples, tops: wet_tops.TopMaps, record_out):
    """Tilt the listed water by the ripples: modifies the slopes of `record_out` (n, RECORD)."""
    for n in prange(len(record_out)):
        water_record.write_slopes(
            tilted(water_record.read_record(record_out, n), ripples, tops), record_out[n]
        )


@jit.cpu_kernel
def lay_water(
    pixel, record, light, background: Background, view: View, optics: Optics, picture_out
):
    """Write the water into the picture: reflection, refraction and the sun's glint.

    pixel : int32 array (n,)
    record : float32 array (n, RECORD)
    light : float32 array (n, 3). Radiance that each record mirrors, before it is
        multiplied by the reflectance.
    picture_out : float32 array (height, width, 3). Only the listed pixels are
        written.
    """
    width = background.depth.shape[1]
    for n in prange(len(pixel)):
        row, column = pixel[n] // width, pixel[n] % width
        r, g, b = shade_water_pixel(
            water_record.read_record(record, n), row, column,
            (light[n, 0], light[n, 1], light[n, 2]), background, view, optics,
        )  # fmt: skip
        picture_out[row, column, 0] = r
        picture_out[row, column, 1] = g
        picture_out[row, column, 2] = b


@jit.cpu_kernel
def separate_water(
    pixel, record, background: Background, view: View, optics: Optics, through_out, share_out,
    glint_out,
):  # fmt: skip
    """Write the terms that `lay_water` adds up, apart; for arbitrary output variables.

    through_out : float32 array (n, 3). Radiance from below the water, before it
        is multiplied by 1 - reflectance.
    share_out : float32 array (n,). Reflectance.
    glint_out : float32 array (n, 3). The sun's glint as it is added.
    """
    width = background.depth.shape[1]
    for n in prange(len(pixel)):
        row, column = pixel[n] // width, pixel[n] % width
        r, g, b, share, glint = water_terms(
            water_record.read_record(record, n), row, column, background, view, optics
        )
        through_out[n, 0], through_out[n, 1], through_out[n, 2] = r, g, b
        share_out[n] = share
        for c in range(3):
            glint_out[n, c] = glint * optics.sun[3 + c]
