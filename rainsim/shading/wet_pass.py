"""The rainy picture without water: captured light, graded and wetted; pictures and rays.

`grade_row` is the twin of `wetting.wet_pixel`: the same formulas in the same order, but for a row
in chunks of CHUNK pixels and each chunk in passes over numbers that stay in cache. So all but the
look-ups in maps runs in vectors, which takes a third of the time of one pixel after the other. Only
the loops and the packing stand here; `tests/shading/test_grade.py` fails when the two differ.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, prange, serial_kernel
from rainsim.numerics.interpolation import is_on_map, map_place
from rainsim.numerics.pixel_batches import CHUNK, CORNERS, interpolate
from rainsim.scene.view import View
from rainsim.shading.environment import azimuth_in_map, color_in_map, elevation_in_map
from rainsim.shading.grading import Look, covered_share, surface_color
from rainsim.shading.smooth_normals import (
    AROUND,
    EACH,
    NO_AROUND,
    SAMPLES,
    STEPS,
    likeness,
    sample,
    sharpness,
    step_of,
    turn_of,
    turned,
)
from rainsim.shading.surface_point import (
    NOT_POOR,
    GroundMaps,
    SurfacePoint,
    ground_share,
    heights_over,
    is_surface,
    seen_surface,
)
from rainsim.shading.wetness import OffGroundWetness, Wetness, store_wetness, stored_wetness
from rainsim.shading.wetting import (
    LEAST_SKY,
    SkyMaps,
    glossed,
    leaf_share,
    lit_share,
    mirror_cover,
    rainy_color,
    wet_state,
    wetted_normal,
)

# Rows of a chunk's numbers. The dry pixel: colour, alpha, distances along the view axis [m] to the
# mean and to the plane of its splats, normal (camera frame).
(RED, GREEN, BLUE, ALPHA, DEPTH, PLANE, NORMAL_X, NORMAL_Y, NORMAL_Z) = (
    CHUNK * k for k in range(9)
)
# The surface: unit view direction, position [m] and normal (ground frame), cosine between normal
# and the way back, distance [m] of that position.
(VIEW_X, VIEW_Y, VIEW_Z, X, Y, Z, LEAN_X, LEAN_Y, UPNESS, COSINE, AWAY) = (
    CHUNK * k for k in range(9, 20)
)
# Heights as `heights_of` returns them, shares of gloss, of sky and of what is smooth of the gloss,
# and places in maps: first the ground's column and row, then the environment's.
(CLEARANCE, HEIGHT, GLOSS, THROUGH, SMOOTH, ACROSS, DOWN) = (CHUNK * k for k in range(20, 27))
LEVEL = 27 * CHUNK  # how surely it is the ground, see `ground_share`
POOR = 28 * CHUNK  # how surely poor ground shows, see `SurfacePoint`
WETNESS = 29 * CHUNK  # as `store_wetness` writes it, a row for each field
NUMBERS = WETNESS + len(Wetness._fields) * CHUNK

NO_DEPTH = np.float32(np.inf)
NO_COVER = np.empty((0, 0), np.float32)  # as `cover_out`: ground glosses as all else does


class DryPicture(NamedTuple):
    """A splatted picture of the capture; read-only. See `raster.Layers`."""

    color: np.ndarray  # (height, width, 3) float32, display-referred, over black
    alpha: np.ndarray  # (height, width) float32
    depth: np.ndarray  # (height, width) float32 [units], along the view axis
    plane_depth: np.ndarray  # (height, width) float32 [units]
    normal: np.ndarray  # (height, width, 3) float32, unit, camera frame
    meters_per_unit: np.float32
    around: np.float32  # m, of the neighbourhood whose normals count; 0: each pixel's own


def dry_picture(layers, meters_per_unit, mirrored=False, layer=ZERO):
    """Return the `DryPicture` of `raster.Layers` with depths in capture units.

    In mirrored ones each pixel keeps its own normal. The splats of poor ground fill a `layer` [m];
    they lie as badly elsewhere, so that a wider neighbourhood counts.
    """
    return DryPicture(
        layers.color, layers.alpha, layers.depth, layers.plane_depth, layers.normal,
        np.float32(meters_per_unit), NO_AROUND if mirrored else max(AROUND, np.float32(layer)),
    )  # fmt: skip


@cpu_kernel
def grade_and_wet(
    dry: DryPicture, view: View, ground: GroundMaps, rain: OffGroundWetness, sky: SkyMaps,
    look: Look, picture_out, depth_out, clearance_out, cover_out,
):  # fmt: skip
    """Grade the dry picture, wet it, and measure it against the ground.

    dry : DryPicture
    ground : GroundMaps
    rain : OffGroundWetness
    sky : SkyMaps
    picture_out : float32 array (height, width, 3). Radiance.
    depth_out : float32 array (height, width) [m]. Infinite for the sky.
    clearance_out : float32 array (height, width) [m]. Height above the bed;
        FAR_AWAY off the map and for the sky.
    cover_out : array (height, width) or (0, 0), float32. Share of a full water
        film on the ground, whose reflection is then left out of the picture: the
        wet-ground mirror adds it. If empty, the ground glosses as all else does.
    """
    height, width = depth_out.shape
    mirror_apart = cover_out.shape[0] > 0
    colors = dry.color.reshape(height, 3 * width)
    normals = dry.normal.reshape(height, 3 * width)
    pictures = picture_out.reshape(height, 3 * width)
    for row in prange(height):
        grade_row(
            np.int64(row), dry, colors[row], normals, view, ground, rain, sky, look,
            mirror_apart, pictures[row], depth_out[row], clearance_out[row],
            cover_out,
        )  # fmt: skip


@device_function
def grade_row(
    row, dry, color, normals, view, ground, rain, sky, look, mirror_apart,
    picture_out, depth_out, clearance_out, cover_out,
):  # fmt: skip
    """Grade, wet and measure one row of pixels; see `grade_and_wet`."""
    alpha, depth, plane_depth, width = (
        dry.alpha[row], dry.depth[row], dry.plane_depth[row], len(depth_out)
    )  # fmt: skip
    s, corner = np.empty(NUMBERS, np.float32), np.empty(CORNERS, np.float32)
    glossy, open_ = np.empty(CHUNK, np.uint32), np.empty(CHUNK, np.uint32)
    for left in range(0, width, CHUNK):
        n = min(CHUNK, width - left)
        end = left + n
        read_colors(color[3 * left : 3 * end], alpha[left:end], look, n, s)
        read_surface(
            depth[left:end], plane_depth[left:end],
            normals[row, 3 * left : 3 * end], dry.meters_per_unit, n, s,
        )  # fmt: skip
        locate(view, row, left, n, dry, ground, s)
        find_heights(ground, n, s, glossy, corner)
        if dry.around > ZERO:
            take_normals_around(dry, normals, view, row, left, n, ground.thickest_layer, s, glossy)
        find_levels(n, s)
        find_wetness(ground, rain, look, n, s)
        color_pixels(look, mirror_apart, n, s)
        add_surroundings(sky, n, s, glossy, open_)
        write_pixels(
            n, s, picture_out[3 * left : 3 * end], depth_out[left:end],
            clearance_out[left:end],
        )  # fmt: skip
        if mirror_apart:
            write_cover(ground, look, n, s, cover_out[row, left:end])


@inlined_function
def read_colors(color, alpha, look, n, s):
    """Read alpha of n pixels, and their colour as linear light of the covered part."""
    for i in range(n):
        s[ALPHA + i] = alpha[i]
    for i in range(n):
        s[RED + i], s[GREEN + i], s[BLUE + i] = color[3 * i], color[3 * i + 1], color[3 * i + 2]
    for i in range(n):
        cover = s[ALPHA + i]
        r, g, b = surface_color(s[RED + i], s[GREEN + i], s[BLUE + i], cover, look)
        s[RED + i], s[GREEN + i], s[BLUE + i] = r, g, b


@inlined_function
def read_surface(depth, plane_depth, normal, meters_per_unit, n, s):
    """Read depths, in metres, and normals of n pixels."""
    for i in range(n):
        s[DEPTH + i] = depth[i] * meters_per_unit
    for i in range(n):
        s[PLANE + i] = plane_depth[i] * meters_per_unit
    for i in range(n):
        s[NORMAL_X + i] = normal[3 * i]
        s[NORMAL_Y + i] = normal[3 * i + 1]
        s[NORMAL_Z + i] = normal[3 * i + 2]


@inlined_function
def locate(view, row, left, n, dry, ground, s):
    """Find where in the ground frame each pixel of a row is."""
    turn = turn_of(view.ground_from_camera)
    if ground.layer.shape[0] > 1:
        for i in range(n):
            locate_pixel(turn, view, row, left, i, dry, ground, True, s)
    else:  # in vectors
        for i in range(n):
            locate_pixel(turn, view, row, left, i, dry, ground, False, s)


@inlined_function
def locate_pixel(turn, view, row, left, i, dry, ground, poor, s):
    """Find where in the ground frame pixel i of a chunk is."""
    x, y, z, depth, cosine, point = seen_surface(
        turn, view, row, left + i, (s[NORMAL_X + i], s[NORMAL_Y + i], s[NORMAL_Z + i]),
        s[DEPTH + i], s[PLANE + i], dry, dry.depth.shape, ground, poor,
    )  # fmt: skip
    s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i] = x, y, z
    s[LEAN_X + i], s[LEAN_Y + i], s[UPNESS + i] = point.nx, point.ny, point.nz
    s[COSINE + i], s[DEPTH + i] = cosine, depth
    s[X + i], s[Y + i], s[Z + i], s[AWAY + i] = point.x, point.y, point.z, point.distance
    s[POOR + i] = point.ground


@inlined_function
def find_heights(ground, n, s, cell, corner):
    """Find the height over the ground of each pixel's surface: `heights_of` in vectors."""
    bed, origin, spacing = ground.bed, ground.origin, ground.spacing
    corner_of_map = origin[0], origin[1]
    everywhere = ground.thickest_layer > ZERO
    for i in range(n):
        u, v = map_place(s[X + i], s[Y + i], corner_of_map, spacing)
        s[HEIGHT + i] = ONE if everywhere | is_on_map(u, v, bed) else ZERO
        s[ACROSS + i], s[DOWN + i] = u, v
    interpolate(bed, n, s, ACROSS, DOWN, cell, corner)
    for i in range(n):
        solid, inside = is_surface(s[ALPHA + i], s[VIEW_Z + i]), s[HEIGHT + i] > ZERO
        clear, height = heights_over(s[ACROSS + i], s[Z + i], inside, solid)
        s[CLEARANCE + i], s[HEIGHT + i] = clear, height


@inlined_function
def take_normals_around(dry, normals, view, row, left, n, layer, s, step):
    """Replace the normals of pixels that show no ground by those of their neighbourhoods.

    In vectors what `smooth_normal` and `wetted_normal` do. `step` has room for a number a pixel.
    """
    turn, focal = turn_of(view.ground_from_camera), view.fx
    radius = dry.around / dry.meters_per_unit
    found = 0
    for i in range(n):
        level = ground_share(s[CLEARANCE + i], s[UPNESS + i], NOT_POOR)
        here = dry.depth[row, left + i]
        shown = is_surface(s[ALPHA + i], s[VIEW_Z + i]) & (level < ONE)
        which = step_of(focal, radius, here)
        s[GLOSS + i], s[THROUGH + i] = here, sharpness(focal, which, here)
        step[i] = np.uint32(1 << which) if shown else np.uint32(0)
    for i in range(n):
        found |= np.int64(step[i])
    for k in range(STEPS):
        if found >> k & 1:
            add_around(dry.depth, normals, row, left, n, k, s)
            for i in range(n):
                if step[i] == np.uint32(1 << k):
                    around = turned(
                        turn, EACH * s[SMOOTH + i], EACH * s[ACROSS + i], EACH * s[DOWN + i]
                    )
                    a, b, c = wetted_normal(
                        s[RED + i], s[GREEN + i], s[BLUE + i], s[HEIGHT + i],
                        surface_point(s, i), around, layer,
                    )  # fmt: skip
                    s[LEAN_X + i], s[LEAN_Y + i], s[UPNESS + i] = a, b, c
                    s[COSINE + i] = -(a * s[VIEW_X + i] + b * s[VIEW_Y + i] + c * s[VIEW_Z + i])


@inlined_function
def add_around(depths, normals, row, left, n, step, s):
    """Sum the surface normals of like depth in a window around each of n pixels.

    The rows SMOOTH, ACROSS and DOWN of `s` are scratch memory for x, y and z of the sums.
    """
    rows, columns = depths.shape
    for i in range(n):
        s[SMOOTH + i], s[ACROSS + i], s[DOWN + i] = ZERO, ZERO, ZERO
    for k in range(SAMPLES):
        across, down = sample(k, step)
        v = min(max(row + down, 0), rows - 1)
        # Beyond the picture's sides the pixels at its edge count.
        first = min(max(left + across, 0), columns)
        before = min(max(-left - across, 0), n)
        inside = max(min(columns - first, n - before), 0)
        add_normals(depths[v, first:], normals[v, 3 * first :], before, inside, s)
        for i in range(before):
            add_normals(depths[v], normals[v], i, 1, s)
        for i in range(before + inside, n):
            add_normals(depths[v, columns - 1 :], normals[v, 3 * columns - 3 :], i, 1, s)


# Not inlined, as `pixel_batches.interpolate`.
@serial_kernel
def add_normals(depth, normal, first, n, s):
    """Add n normals of a row to the sums of the pixels from `first` on, weighted by like depth."""
    for i in range(np.uint64(n)):
        k = np.uint64(first) + i
        weight = likeness(depth[i], s[np.uint64(GLOSS) + k], s[np.uint64(THROUGH) + k])
        s[np.uint64(SMOOTH) + k] += weight * normal[np.uint64(3) * i]
        s[np.uint64(ACROSS) + k] += weight * normal[np.uint64(3) * i + np.uint64(1)]
        s[np.uint64(DOWN) + k] += weight * normal[np.uint64(3) * i + np.uint64(2)]


@inlined_function
def find_levels(n, s):
    """Find how surely each pixel shows the ground."""
    for i in range(n):
        s[LEVEL + i] = ground_share(s[HEIGHT + i], s[UPNESS + i], s[POOR + i])


@inlined_function
def find_wetness(ground, rain, look, n, s):
    """Find how wet each pixel's surface is."""
    for i in range(n):
        s[GLOSS + i] = leaf_share(s[RED + i], s[GREEN + i], s[BLUE + i])
        s[THROUGH + i] = lit_share(s[RED + i], s[GREEN + i], s[BLUE + i], look)
    for i in range(n):
        wet = wet_state(
            surface_point(s, i), s[CLEARANCE + i], s[HEIGHT + i], s[LEVEL + i], s[GLOSS + i],
            s[THROUGH + i], ground, rain,
        )  # fmt: skip
        store_wetness(wet, s, WETNESS + i, CHUNK)


@inlined_function
def surface_point(s, i):
    """Return the `SurfacePoint` of pixel i of a chunk."""
    return SurfacePoint(
        s[X + i], s[Y + i], s[Z + i], s[LEAN_X + i], s[LEAN_Y + i], s[UPNESS + i], s[AWAY + i],
        s[POOR + i],
    )  # fmt: skip


@inlined_function
def color_pixels(look, mirror_apart, n, s):
    """Grade and wet the colours of n pixels."""
    for i in range(n):
        r, g, b, gloss, through, smooth = rainy_color(
            s[RED + i], s[GREEN + i], s[BLUE + i], s[ALPHA + i], s[VIEW_Z + i], s[COSINE + i],
            s[UPNESS + i], s[HEIGHT + i], s[LEVEL + i], stored_wetness(s, WETNESS + i, CHUNK), look,
        )  # fmt: skip
        s[RED + i], s[GREEN + i], s[BLUE + i], s[THROUGH + i] = r, g, b, through
        s[SMOOTH + i] = smooth
        s[GLOSS + i] = gloss * (ONE - s[LEVEL + i]) if mirror_apart else gloss


@inlined_function
def add_surroundings(sky, n, s, glossy, open_):
    """Add the mirrored surroundings, and the sky that is seen behind the scene."""
    gloss = list_above(s, GLOSS, n, ZERO, glossy)
    through = list_above(s, THROUGH, n, LEAST_SKY, open_)
    if gloss > 0:
        for i in range(n):
            x, y, z = glossed(
                s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i], s[COSINE + i], s[LEAN_X + i],
                s[LEAN_Y + i], s[UPNESS + i], s[SMOOTH + i],
            )  # fmt: skip
            s[ACROSS + i], s[DOWN + i] = azimuth_in_map(x, y), elevation_in_map(x, y, z)
        for k in range(gloss):
            if s[np.uint32(SMOOTH + glossy[k])] > ONE:
                add_radiance(sky.coat, s, GLOSS, glossy[k])
            else:
                add_radiance(sky.gloss, s, GLOSS, glossy[k])
    if through > 0:
        for i in range(n):
            x, y, z = s[VIEW_X + i], s[VIEW_Y + i], s[VIEW_Z + i]
            s[ACROSS + i], s[DOWN + i] = azimuth_in_map(x, y), elevation_in_map(x, y, z)
        for k in range(through):
            add_radiance(sky.behind, s, THROUGH, open_[k])


@inlined_function
def list_above(s, row, n, least, which_out):
    """List the pixels that have more than `least` in a row of numbers; return how many there are.

    Without a branch: such pixels are scattered, which no processor predicts.
    """
    count = np.uint32(0)
    for i in range(n):
        which_out[count] = np.uint32(i)
        count = np.uint32(count + np.uint32(s[row + i] > least))
    return count


@inlined_function
def add_radiance(environment, s, share, i):
    """Add a share of the radiance of an environment map to pixel i."""
    w = s[np.uint32(share + i)]
    r, g, b = color_in_map(environment, s[np.uint32(ACROSS + i)], s[np.uint32(DOWN + i)])
    s[np.uint32(RED + i)] += w * r
    s[np.uint32(GREEN + i)] += w * g
    s[np.uint32(BLUE + i)] += w * b


@inlined_function
def write_pixels(n, s, picture_out, depth_out, clearance_out):
    """Write n pixels of the wet picture."""
    for i in range(n):
        picture_out[3 * i] = s[RED + i]
        picture_out[3 * i + 1] = s[GREEN + i]
        picture_out[3 * i + 2] = s[BLUE + i]
    for i in range(n):
        depth_out[i] = s[DEPTH + i] if is_surface(s[ALPHA + i], s[VIEW_Z + i]) else NO_DEPTH
    for i in range(n):
        clearance_out[i] = s[CLEARANCE + i]


@inlined_function
def write_cover(ground, look, n, s, cover_out):
    """Write the share of a full water film on level ground."""
    for i in range(n):
        cover_out[i] = ZERO
        if s[LEVEL + i] > ZERO:
            cover_out[i] = covered_share(s[ALPHA + i], ZERO, ZERO) * mirror_cover(
                surface_point(s, i), s[CLEARANCE + i], s[LEVEL + i],
                stored_wetness(s, WETNESS + i, CHUNK), ground, look,
            )  # fmt: skip
