"""The rainy picture without water: what was captured, graded and wetted, once per camera.

A row is done in chunks of CHUNK pixels, each in a few passes over numbers that stay in cache, so
that all but the looking-up runs in vectors; pixel by pixel, with a branch for each case, takes
three times as long. The formulas are those of `shade`.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.chunks import CHUNK, CORNERS, interpolate
from rainsim.jit import cpu_kernel, inlined_function, prange
from rainsim.shade import (
    FAR_AWAY,
    FLAT,
    GLOSS_LIFT,
    HALF,
    LEAST_ALPHA,
    LEAST_SKY,
    ON_GROUND,
    ONE,
    WALL_SHARE,
    ZERO,
    film_cover,
    film_off_ground,
    is_edge,
    on_ground,
    rainy,
    undiluted,
)
from rainsim.sky import azimuth_in_map, color_in_map, elevation_in_map
from rainsim.walls import damp_off_ground

# Rows of a chunk's numbers. The pixel: colour, alpha, distances along the view axis [m] to the mean
# and to the plane, normal (camera frame).
(RED, GREEN, BLUE, ALPHA, DEPTH, PLANE, NORMAL_X, NORMAL_Y, NORMAL_Z) = (
    CHUNK * k for k in range(9)
)
# Where it is: unit view direction, place [m] and normal (ground frame), cosine between that and
# the way back, distances [m] to the place and, for the sky, to what is drawn.
(VIEW_X, VIEW_Y, VIEW_Z, X, Y, Z, LEAN_X, LEAN_Y, UPNESS, COSINE, AWAY, FAR) = (
    CHUNK * k for k in range(9, 21)
)
# Its wetness, as `shade.wet_state` has it.
(CLEARANCE, HEIGHT, LAWN, DAMP, FILM, PORES) = (CHUNK * k for k in range(21, 27))
# Shares of gloss and of sky, and where maps (at first the ground's) show those.
(GLOSS, THROUGH, ACROSS, DOWN, LIFTED) = (CHUNK * k for k in range(27, 32))
NUMBERS = 32 * CHUNK

NOWHERE = np.float32(np.inf)


@cpu_kernel
def grade_and_wet(
    color, alpha, depth, plane_depth, normal, meters_per_unit, ground_from_camera, eye, lens,
    bed, ground, origin, spacing, environment, day_sky, look, others,
    picture_out, depth_out, clearance_out, film_out,
):  # fmt: skip
    """Grade the dry picture, wet it, and measure it against the ground.

    Parameters
    ----------
    color, alpha, depth, plane_depth, normal
        As `raster.Layers` has them, depth in capture units, normals in the camera frame.
    ground_from_camera : ndarray of shape (3, 3), float32
    eye : ndarray of shape (3,), float32 [m]
    bed : ndarray of shape (ny, nx), float32 [m]
    ground : ndarray of shape (ny, nx, 5), float32
        As `wetness.ground_maps` gives it.
    environment, day_sky : ndarray of shape (rows, columns, 3), float32
        What lies around, for gloss; the sky behind everything.
    look : ndarray of shape (6,), float32
        Exposure, desaturation, compression, share of the captured sky that is replaced, distance
        [m] beyond which what is bright may be sky, and 1 if the splats of the captured sky are left
        out (see `backdrop`), so that `day_sky` shows wherever something is open.
    others : ndarray of shape (5,), float32
        As `wetness.others` gives it.
    picture_out : ndarray of shape (height, width, 3), float32
    depth_out : ndarray of shape (height, width), float32 [m]
        Infinite for sky.
    clearance_out : ndarray of shape (height, width), float32 [m]
        Height above the bed; 1e4 outside the map and for the sky.
    film_out : ndarray of shape (height, width) or (0, 0), float32
        Share of a full film on the ground; what that mirrors is then left out of the picture, see
        `film`. If empty, the ground glosses with the environment as all else does.
    """
    height, width = alpha.shape
    film_apart = film_out.shape[0] > 0
    colors, normals = color.reshape(height, 3 * width), normal.reshape(height, 3 * width)
    pictures = picture_out.reshape(height, 3 * width)
    for row in prange(height):
        s, corner = np.empty(NUMBERS, np.float32), np.empty(CORNERS, np.float32)
        glossy, open_ = np.empty(CHUNK, np.uint32), np.empty(CHUNK, np.uint32)
        b = (np.float32(row) + HALF - lens[3]) / lens[1]
        for left in range(0, width, CHUNK):
            n = min(CHUNK, width - left)
            end = left + n
            take(
                colors[row, 3 * left : 3 * end], alpha[row, left:end], depth[row, left:end],
                plane_depth[row, left:end], normals[row, 3 * left : 3 * end], meters_per_unit,
                look[5], n, s,
            )  # fmt: skip
            place(ground_from_camera, eye, lens, b, left, n, s)
            wet(bed, ground, origin, spacing, others, n, s, glossy, corner)
            shade(look, film_apart, n, s)
            add_surroundings(environment, day_sky, n, s, glossy, open_)
            give(
                n, s, pictures[row, 3 * left : 3 * end], depth_out[row, left:end],
                clearance_out[row, left:end],
            )  # fmt: skip
            if film_apart:
                tell_film(ground, origin, spacing, n, s, film_out[row, left:end])


@inlined_function
def take(color, alpha, depth, plane_depth, normal, meters_per_unit, open_sky, n, s):
    """Take over n pixels of the dry picture, colours as linear light and depths in metres."""
    for i in range(n):
        s[ALPHA + i] = alpha[i]
    for i in range(n):
        s[RED + i], s[GREEN + i], s[BLUE + i] = color[3 * i], color[3 * i + 1], color[3 * i + 2]
    for i in range(n):
        cover = s[ALPHA + i]
        r, g, b = undiluted(
            s[RED + i], s[GREEN + i], s[BLUE + i], cover if is_edge(cover, open_sky) else ONE
        )
        s[RED + i], s[GREEN + i], s[BLUE + i] = r, g, b
    for i in range(n):
        s[DEPTH + i] = depth[i] * meters_per_unit
    for i in range(n):
        s[PLANE + i] = plane_depth[i] * meters_per_unit
    for i in range(n):
        s[NORMAL_X + i] = normal[3 * i]
        s[NORMAL_Y + i] = normal[3 * i + 1]
        s[NORMAL_Z + i] = normal[3 * i + 2]


@inlined_function
def give(n, s, picture_out, depth_out, clearance_out):
    """Write n pixels of the wet picture."""
    for i in range(n):
        picture_out[3 * i] = s[RED + i]
        picture_out[3 * i + 1] = s[GREEN + i]
        picture_out[3 * i + 2] = s[BLUE + i]
    for i in range(n):
        depth_out[i] = s[DEPTH + i] if s[ALPHA + i] >= LEAST_ALPHA else NOWHERE
    for i in range(n):
        clearance_out[i] = s[CLEARANCE + i]


@inlined_function
def place(m, eye, lens, b, left, n, s):
    """Find where in the ground frame `m` each pixel of a row at height b is."""
    m00, m01, m02 = m[0, 0], m[0, 1], m[0, 2]
    m10, m11, m12 = m[1, 0], m[1, 1], m[1, 2]
    m20, m21, m22 = m[2, 0], m[2, 1], m[2, 2]
    e0, e1, e2, f, c = eye[0], eye[1], eye[2], lens[0], lens[2]
    for i in range(n):
        a = (np.float32(left + i) + HALF - c) / f
        x, y, z = m00 * a + m01 * b + m02, m10 * a + m11 * b + m12, m20 * a + m21 * b + m22
        length = math.sqrt(x * x + y * y + z * z)
        inv = ONE / length
        s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i] = x * inv, y * inv, z * inv
        n0, n1, n2 = s[NORMAL_X + i], s[NORMAL_Y + i], s[NORMAL_Z + i]
        upness = m20 * n0 + m21 * n1 + m22 * n2
        s[LEAN_X + i] = m00 * n0 + m01 * n1 + m02 * n2
        s[LEAN_Y + i] = m10 * n0 + m11 * n1 + m12 * n2
        s[UPNESS + i] = upness
        s[COSINE + i] = -(n0 * a + n1 * b + n2) * inv
        # Plane depth is far better on flat ground, and can be wild on thin things.
        e = s[PLANE + i]
        d = e if upness > FLAT else s[DEPTH + i]
        s[DEPTH + i], s[FAR + i] = d, d * length
        # Along a wall seen at a slant the splats' own depths scatter.
        e = e if abs(e - d) < WALL_SHARE * d else d
        e = e if s[ALPHA + i] >= LEAST_ALPHA else ZERO
        s[X + i], s[Y + i], s[Z + i] = e0 + e * x, e1 + e * y, e2 + e * z
        s[AWAY + i] = e * length


@inlined_function
def wet(bed, ground, origin, spacing, others, n, s, cell, corner):
    """Find how wet each pixel's surface is; see `shade.wet_state`."""
    rows, columns = bed.shape
    right, bottom = np.float32(columns - 1), np.float32(rows - 1)
    o0, o1 = origin[0], origin[1]
    for i in range(n):
        u, v = (s[X + i] - o0) / spacing - HALF, (s[Y + i] - o1) / spacing - HALF
        inside = (u > ZERO) & (v > ZERO) & (u < right) & (v < bottom)
        s[HEIGHT + i] = ONE if inside else ZERO
        s[ACROSS + i], s[DOWN + i] = u, v
    interpolate(bed, n, s, ACROSS, DOWN, cell, corner)
    off = 0  # pixels that show no ground
    for i in range(n):
        z, over = s[Z + i], s[Z + i] - s[ACROSS + i]
        solid, inside = s[ALPHA + i] >= LEAST_ALPHA, s[HEIGHT + i] > ZERO
        clear, height = over if inside else FAR_AWAY, over if inside else z
        clear, height = clear if solid else FAR_AWAY, height if solid else FAR_AWAY
        s[CLEARANCE + i], s[HEIGHT + i] = clear, height
        off += np.int64((clear >= ON_GROUND) | (s[UPNESS + i] <= FLAT))
    if off > 0:
        for i in range(n):
            damp = damp_off_ground(
                others, s[LEAN_X + i], s[LEAN_Y + i], s[UPNESS + i], s[X + i], s[Y + i], s[Z + i],
                s[HEIGHT + i], s[AWAY + i],
            )  # fmt: skip
            s[DAMP + i] = damp if s[ALPHA + i] >= LEAST_ALPHA else ZERO
            s[FILM + i] = film_off_ground(others, s[DAMP + i], s[HEIGHT + i])
            s[LAWN + i], s[PORES + i] = ZERO, others[4]
    for i in range(n):
        if s[CLEARANCE + i] < ON_GROUND and s[UPNESS + i] > FLAT:
            u, v = (s[X + i] - origin[0]) / spacing - HALF, (s[Y + i] - origin[1]) / spacing - HALF
            s[LAWN + i], s[DAMP + i], s[FILM + i], s[PORES + i] = on_ground(ground, u, v)


@inlined_function
def shade(look, film_apart, n, s):
    """Grade and wet the colours."""
    l0, l1, l2, l3, l4, l5 = look[0], look[1], look[2], look[3], look[4], look[5]
    for i in range(n):
        r, g, b, gloss, through = rainy(
            s[RED + i], s[GREEN + i], s[BLUE + i], s[ALPHA + i], s[FAR + i], s[VIEW_Z + i],
            s[COSINE + i], s[UPNESS + i], s[HEIGHT + i], s[LAWN + i], s[DAMP + i], s[FILM + i],
            s[PORES + i], l0, l1, l2, l3, l4, l5,
        )  # fmt: skip
        s[RED + i], s[GREEN + i], s[BLUE + i], s[THROUGH + i] = r, g, b, through
        floor = s[UPNESS + i] > FLAT and s[HEIGHT + i] < ON_GROUND
        s[GLOSS + i] = ZERO if film_apart and floor else gloss


@inlined_function
def tell_film(ground, origin, spacing, n, s, film_out):
    """Write the share of a full film on the ground."""
    for i in range(n):
        film_out[i] = ZERO
        if s[UPNESS + i] > FLAT and s[HEIGHT + i] < ON_GROUND:
            film_out[i] = film_cover(
                ground, origin, spacing, s[X + i], s[Y + i], s[CLEARANCE + i], s[UPNESS + i],
                s[LAWN + i], s[FILM + i],
            )  # fmt: skip


@inlined_function
def add_surroundings(environment, day_sky, n, s, glossy, open_):
    """Add what glosses, and the sky that stands in for the captured one."""
    gloss, through = listed(s, GLOSS, n, ZERO, glossy), listed(s, THROUGH, n, LEAST_SKY, open_)
    if gloss + through == 0:
        return
    for i in range(n):
        x, y, z = s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i]
        s[ACROSS + i], s[DOWN + i] = azimuth_in_map(x, y), elevation_in_map(x, y, z)
        s[LIFTED + i] = elevation_in_map(x, y, abs(z) + GLOSS_LIFT)
    for k in range(gloss):
        add_light(environment, s, GLOSS, LIFTED, glossy[k])
    for k in range(through):
        add_light(day_sky, s, THROUGH, DOWN, open_[k])


@inlined_function
def listed(s, row, n, least, which_out):
    """List the pixels that have more than `least` in a row of numbers; return how many there are.

    Without a branch: such pixels are scattered, which no processor foresees.
    """
    count = np.uint32(0)
    for i in range(n):
        which_out[count] = np.uint32(i)
        count = np.uint32(count + np.uint32(s[row + i] > least))
    return count


@inlined_function
def add_light(environment, s, share, down, i):
    """Add a share of what a map holds in the place of pixel i."""
    w = s[np.uint32(share + i)]
    r, g, b = color_in_map(environment, s[np.uint32(ACROSS + i)], s[np.uint32(down + i)])
    s[np.uint32(RED + i)] += w * r
    s[np.uint32(GREEN + i)] += w * g
    s[np.uint32(BLUE + i)] += w * b
