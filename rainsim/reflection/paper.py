"""Water on the paper's terms (RainyGS): each of its choices, as a baseline to compare with.

Spheres for the water's surface, coverage of all or nothing, refraction by shifting the image, the
sun's highlight (n.h)^p, and a march with a point test for reflections. Its reflectance, Schlick's,
is one of the laws in `shading.fresnel`. No loop that draws the default knows of these.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, device_function, lean_function, prange, serial_kernel
from rainsim.numerics.approximations import exp_minus
from rainsim.numerics.interpolation import bilinear, bilinear_color
from rainsim.reflection import water_shading
from rainsim.reflection.facets import normal_of, view_cosine
from rainsim.reflection.mirrored_rays import ENVIRONMENT, SCREEN, reflected_upwards
from rainsim.reflection.ray_water import HIDE_HIGH, LEAST_DIP, meet_surface
from rainsim.reflection.screen_space import surface_in_camera
from rainsim.reflection.water_record import COVERAGE, read_record
from rainsim.reflection.water_surface import WaterMap
from rainsim.scene.view import View, camera_component, in_camera, pixel_ray, project
from rainsim.shading.environment import sample_environment
from rainsim.shading.fresnel import REFRACTIVE_INDEX, reflectance
from rainsim.ssr import NEAR, MarchSettings

RADIUS = np.float32(0.006)  # m of the spheres; the paper's unit is unknown, metres are taken
EPSILON = 0.03  # m, thickness of the paper's point test
LEAST_WATER = np.float32(1e-6)  # m of water that a cell must hold
SHIFT_PER_DEPTH = ONE - ONE / REFRACTIVE_INDEX  # of the image shift, see `shifted`
PHONG_EXPONENT = np.float32(64)  # the paper gives none


class PaperLaws(NamedTuple):
    """Which of the paper's laws of light replace the default's."""

    image_shift: bool  # refraction by shifting the image; the water is clear
    phong: bool  # (n.h)^p for the sun's glint


@serial_kernel
def meet_spheres(depth, view, water_map, hit_out, coverage_out, count_out):
    """Draw the water as spheres at the height map's cells; arguments as in `ray_water.meet_water`.

    Between cells wider than the spheres there are holes.
    """
    height, width = depth.shape
    ny, nx = water_map.surface.shape
    eye, origin, spacing = view.eye, water_map.origin, water_map.spacing
    hit_out[:] = np.float32(np.inf)
    coverage_out[:] = ZERO
    for j in range(1, ny - 1):
        for i in range(1, nx - 1):
            if not water_map.depth[j, i] > LEAST_WATER:
                continue
            u, v, cz = project(
                view, origin[0] + (np.float32(i) + HALF) * spacing - eye[0],
                origin[1] + (np.float32(j) + HALF) * spacing - eye[1],
                water_map.surface[j, i] - eye[2],
            )  # fmt: skip
            if cz < NEAR + RADIUS:
                continue
            reach = view.fx * RADIUS / cz
            for row in range(max(int(v - reach), 0), min(int(v + reach) + 1, height)):
                for column in range(max(int(u - reach), 0), min(int(u + reach) + 1, width)):
                    du, dv = np.float32(column) + HALF - u, np.float32(row) + HALF - v
                    inside = reach * reach - du * du - dv * dv
                    if inside < ZERO:
                        continue
                    t = cz - math.sqrt(inside) * cz / view.fx
                    if t < hit_out[row, column] and t < depth[row, column]:
                        hit_out[row, column] = t
                        coverage_out[row, column] = ONE
    for row in range(height):
        count = 0
        for column in range(width):
            if coverage_out[row, column] > ZERO:
                count += 1
        count_out[row] = count


@cpu_kernel
def meet_hard(depth, view: View, water_map: WaterMap, highest, hit_out, coverage_out, count_out):
    """Cover all of a pixel or nothing; arguments as in `ray_water.meet_water`.

    A pixel is water if there is any where its ray meets the surface, nearer than the scene.
    """
    height, width = depth.shape
    ny, nx = water_map.surface.shape
    for row in prange(height):
        count = 0
        for column in range(width):
            coverage_out[row, column] = ZERO
            x, y, z = pixel_ray(view, row, column)
            behind = depth[row, column]
            if z > LEAST_DIP or view.eye[2] + behind * z > highest + HIDE_HIGH:
                continue
            t, u, v = meet_surface(view, water_map, x, y, z, highest)
            inside = u > ONE and v > ONE and u <= np.float32(nx - 2) and v <= np.float32(ny - 2)
            if not (t > ZERO and t < behind and inside):
                continue
            if bilinear(water_map.depth, u, v) > LEAST_WATER:
                hit_out[row, column], coverage_out[row, column] = t, ONE
                count += 1
        count_out[row] = count


@cpu_kernel
def paper_light(
    which, record, picture, depth, view: View, environment, settings: MarchSettings, light_out,
    source_out,
):  # fmt: skip
    """Find the mirrored light as the paper (RainyGS, supplement, "Screen-space reflection") does.

    The ray of each pixel's own rippled normal is marched pixel by pixel; a point test with the
    settings' thickness is the hit; the environment is the fallback. `depth` is what
    `screen_space.keep_tall` keeps; other arguments as in `screen_space.march_light`.
    """
    for k in prange(len(which)):
        n = which[k]
        water = read_record(record, n)
        ux, uy, uz = normal_of(water.slope_x, water.slope_y)
        rx, ry, rz = reflected_upwards(water.view_x, water.view_y, water.view_z, ux, uy, uz)
        row, column = march_points(
            depth, view, surface_in_camera(view, water), in_camera(view, rx, ry, rz), settings
        )
        if row >= 0:
            light_out[n, 0], light_out[n, 1] = picture[row, column, 0], picture[row, column, 1]
            light_out[n, 2] = picture[row, column, 2]
            source_out[n] = SCREEN
        else:
            c0, c1, c2 = sample_environment(environment, rx, ry, rz)
            light_out[n, 0], light_out[n, 1], light_out[n, 2] = c0, c1, c2
            source_out[n] = ENVIRONMENT


@lean_function
def march_points(depth, view, start, direction, settings):
    """Find a ray's hit as the paper (RainyGS) does: the first pixel with D <= Z < D + epsilon.

    Arguments as in `rainsim.ssr.march`; steps of one pixel.

    Returns row, column : int. Negative if nothing was met within the picture.
    """
    height, width = depth.shape
    x, y, z = start
    dx, dy, dz = direction
    length = settings.farthest
    if dz < ZERO:
        length = min(length, (z - NEAR) / -dz)
    if length <= ZERO:
        return -1, -1
    iz0, iz1 = ONE / z, ONE / (z + dz * length)
    u0, v0 = view.fx * x * iz0 + view.cx, view.fy * y * iz0 + view.cy
    du = view.fx * (x + dx * length) * iz1 + view.cx - u0
    dv = view.fy * (y + dy * length) * iz1 + view.cy - v0
    steps = int(max(abs(du), abs(dv)))
    for k in range(1, steps + 1):
        t = np.float32(k) / np.float32(steps)
        u, v = u0 + du * t, v0 + dv * t
        if not (u >= ZERO and v >= ZERO and u < np.float32(width) and v < np.float32(height)):
            break
        now = ONE / (iz0 + (iz1 - iz0) * t)
        surface = depth[int(v), int(u)]
        if surface <= now and now < surface + settings.thickness:
            return int(v), int(u)
    return -1, -1


@lean_function
def paper_terms(water, row, column, background, view, optics, laws):
    """Return the terms of `water_shading.water_terms`, by the paper's laws."""
    ux, uy, uz = normal_of(water.slope_x, water.slope_y)
    cosine = view_cosine(water, ux, uy, uz)
    share = reflectance(optics.law, cosine)
    u, v, travel = shifted(water, ux, uy, uz, view, row, column)
    if not laws.image_shift:
        u, v, travel = water_shading.refracted_to(
            water, ux, uy, uz, cosine, background.depth, view, row, column
        )
    r, g, b = bilinear_color(background.below, u, v)
    glint, sun = ZERO, optics.sun
    if sun[3] + sun[4] + sun[5] > ZERO:
        if laws.phong:
            glint = share * phong_highlight(water, ux, uy, uz, sun[0], sun[1], sun[2])
        else:
            glint = water_shading.sun_glint(
                water, sun[0], sun[1], sun[2], optics.law, optics.glint_variance
            )
    return (
        r * exp_minus(water_shading.ABSORB_R * travel),
        g * exp_minus(water_shading.ABSORB_G * travel),
        b * exp_minus(water_shading.ABSORB_B * travel), share, glint,
    )  # fmt: skip


@device_function
def shifted(water, ux, uy, uz, view, row, column):
    """Return the image point that the paper (RainyGS) shows through water, and no way through it.

    I_src(u + k n_u, v + k n_v), n the normal on the screen, k "proportional to the water depth".
    The paper gives no factor: with (1 - 1/n) it is Snell's law for steep views.
    """
    k = SHIFT_PER_DEPTH * water.water_depth / water.view_depth
    u = np.float32(column) + HALF - view.fx * k * camera_component(view, 0, ux, uy, uz)
    v = np.float32(row) + HALF - view.fy * k * camera_component(view, 1, ux, uy, uz)
    return u, v, ZERO


@device_function
def phong_highlight(water, ux, uy, uz, lx, ly, lz):
    """Return the paper's highlight (n.h)^p (Blinn and Phong) of a sun in direction l."""
    hx, hy, hz = lx - water.view_x, ly - water.view_y, lz - water.view_z
    inv = ONE / max(math.sqrt(hx * hx + hy * hy + hz * hz), np.float32(1e-6))
    return max((ux * hx + uy * hy + uz * hz) * inv, ZERO) ** PHONG_EXPONENT


@cpu_kernel
def separate_paper_water(
    pixel, record, background: water_shading.Background, view: View, optics: water_shading.Optics,
    laws: PaperLaws, through_out, share_out, glint_out,
):  # fmt: skip
    """Write the arrays of `water_shading.separate_water`, by the paper's laws."""
    width = background.depth.shape[1]
    for n in prange(len(pixel)):
        row, column = pixel[n] // width, pixel[n] % width
        r, g, b, share, glint = paper_terms(
            read_record(record, n), row, column, background, view, optics, laws
        )
        through_out[n, 0], through_out[n, 1], through_out[n, 2] = r, g, b
        share_out[n] = share
        for c in range(3):
            glint_out[n, c] = glint * optics.sun[3 + c]


def lay_paper_water(pixel, record, light, background, view, optics, laws, picture_out):
    """Write the water into the picture as `water_shading.lay_water` does, by the paper's laws."""
    n = len(pixel)
    through, glint = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    share = np.empty(n, np.float32)
    separate_paper_water(pixel, record, background, view, optics, laws, through, share, glint)
    covers = record[:, COVERAGE, None]
    dry = background.picture.reshape(-1, 3)[pixel]
    water = (1 - share[:, None]) * through + share[:, None] * light + glint
    picture_out.reshape(-1, 3)[pixel] = (1 - covers) * dry + covers * water
