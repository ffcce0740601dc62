"""Wet tops in a picture: where tables and benches show, and how their water mirrors.

A pixel shows a top if what it shows lies at the top's height. All of a wet top mirrors: the puddles
as water does on the ground, the film between them as a rough mirror, whose facets tilt by
FILM_SLOPE about the surface. So both are one list with the ground's water, and share its
reflections.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.constants import HALF, ONE, TWO, ZERO
from rainsim.jit import cpu_kernel, inlined_function, prange
from rainsim.numerics.interpolation import bilinear, map_place, smoothstep
from rainsim.reflection.ray_water import LEAST_COVERAGE, LEAST_DIP
from rainsim.reflection.water_record import X, Y, Z
from rainsim.scene.view import View, column_slope, pixel_ray, row_slope
from rainsim.shading.wetness import OffGroundWetness

# m from its surface up to which what a picture shows is a top; its depth is blended at the edges
NEAR_TOP, OFF_TOP = np.float32(0.03), np.float32(0.06)
# m below and above it that are the capture's error; lower there is the top's side
WARP_LOW, WARP_HIGH = np.float32(-0.006), np.float32(0.012)
SAME_HEIGHT = np.float32(0.03)  # m, of water on a top from the top's surface
FILM_SLOPE = np.float32(0.1)  # rms slope of a water film on boards and paint, along one axis
THIN, FULL = np.float32(0.15e-3), np.float32(0.8e-3)  # m of water: still a film, a smooth puddle
# m of water on smooth ground: no rings, full ones; thinner than on the ground, whose stones break
# the surface.
RING_LOW, RING_HIGH = np.float32(0.3e-3), np.float32(2e-3)
# Amplitude of rings on a board over that on a puddle of 6 mm and a mean chord of half a metre. The
# shores of a puddle of 3 to 5 cm of radius take most waves: by the balance of drops, damping and
# that way it has .33 to .45 of the rms slope, .5 to 3 mm deep, at 10 and 50 mm/h.
BOARD_RINGS = np.float32(0.4)
FILM_SHARE = np.float32(0.95)  # of a full film on what takes up some water
QUARTER, LEAST_WAY = np.float32(0.25), np.float32(0.05)
# A film rounds off where it ends, at gaps and edges, within some millimetres (water's capillary
# length is 2.7 mm). Drawn is the Gaussian mean of this width in cells of the patch, from the first
# level up, whole at the second.
ROUNDED, ENDS, WHOLE = 0.8, 0.4, 1.0
MARGIN = 0.3  # m around the middle of a top, beyond its width, that it surely ends in
FORM = 10  # numbers of a top
(CORNER_X, CORNER_Y, FIRST_ROW, ROWS, COLUMNS, CENTRE_X, CENTRE_Y, CONSTANT, BY_X, BY_Y) = range(
    FORM
)


class TopMaps(NamedTuple):
    """The tops as kernels take them; read-only. See `terrain.types.Tops`."""

    number: np.ndarray  # (ny, nx) int16, of the top over each cell, -1 for none; (0, 0) without any
    form: np.ndarray  # (n, FORM) float32, see CORNER_X to BY_Y
    water: np.ndarray  # (n, 2) float32: which of `depths` show, and depth [m] of what flows off
    depths: np.ndarray  # (k, rows, columns) float32 [m], of puddles: `TopWater.drawn`
    holds: np.ndarray  # (rows, columns) float32, share that holds water
    origin: np.ndarray  # (2,) float32 [m], corner of the map
    spacing: np.float32  # m, of the map's cells
    fine: np.float32  # m, of the patches' cells
    low: np.float32  # m, under and over the heights of all tops
    high: np.float32


def top_maps(terrain, water):
    """Return the `TopMaps` of a terrain and its `TopWater`, dry.

    water : TopWater
    """
    tops, (low, high) = terrain.tops, height_range(terrain.tops)
    form = np.zeros((len(tops), FORM), np.float32)
    if len(tops):
        form[:, CORNER_X : CORNER_Y + 1] = tops.corner
        form[:, FIRST_ROW : COLUMNS + 1] = tops.patch
        form[:, CENTRE_X : CENTRE_Y + 1] = tops.centre
        form[:, CONSTANT : BY_Y + 1] = tops.surface
    return TopMaps(
        np.ascontiguousarray(tops.index), form, np.zeros((len(tops), 2), np.float32), water.drawn,
        drawn_film(tops.holds), np.array(terrain.grid.origin, np.float32),
        *(np.float32(n) for n in (terrain.grid.spacing, tops.spacing, low, high)),
    )  # fmt: skip


def drawn_film(holds):
    """Return the share of a water film that is drawn where it may stand, (rows, columns) float32.

    holds : bool array (rows, columns). Of `terrain.types.Tops`: a mask whose
        edges would show its cells.
    """
    mean = ndimage.gaussian_filter(holds.astype(np.float32), ROUNDED)
    part = np.clip((mean - np.float32(ENDS)) / np.float32(WHOLE - ENDS), 0, 1)
    return part * part * (3 - 2 * part)


DRY_TOPS = TopMaps(  # of a scene without any
    np.zeros((0, 0), np.int16), np.zeros((0, FORM), np.float32), np.zeros((0, 2), np.float32),
    np.zeros((1, 1, 1), np.float32), np.zeros((1, 1), np.float32), np.zeros(2, np.float32), ONE,
    ONE, ZERO, ZERO,
)  # fmt: skip


def height_range(tops):
    """Return a height [m] under all tops and one over them."""
    if not len(tops):
        return 0.0, 0.0
    reach = np.sqrt(tops.area) + MARGIN
    spread = np.abs(tops.surface[:, 1:]).sum(axis=1) * reach + OFF_TOP
    return (tops.surface[:, 0] - spread).min(), (tops.surface[:, 0] + spread).max()


def top_numbers(water, volume, sheet):
    """Return `TopMaps.water` of the volume [m3] on each top (n,) and the flowing sheet's depth [m].

    water : TopWater
    volume : array (n,) [m3]. None known: of another length.
    sheet : float [m]
    """
    count = len(water.tops)
    volume = volume if len(volume) == count else np.zeros(count)
    return np.column_stack([water.stage(volume), np.full(count, sheet, np.float32)])


@inlined_function
def top_over(tops, x, y):
    """Return the number of the top at (x, y) [m], -1 for none."""
    rows, columns = tops.number.shape
    u, v = (x - tops.origin[0]) / tops.spacing, (y - tops.origin[1]) / tops.spacing
    if not (u >= ZERO and v >= ZERO and u < np.float32(columns) and v < np.float32(rows)):
        return -1
    return int(tops.number[int(v), int(u)])


@inlined_function
def share_over(tops, k, x, y):
    """Return the share of top k at (x, y) [m], between the map's cells: its edge has no steps."""
    rows, columns = tops.number.shape
    u, v = map_place(x, y, tops.origin, tops.spacing)
    u = min(max(u, ZERO), np.float32(columns - 1))
    v = min(max(v, ZERO), np.float32(rows - 1))
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    p = ONE if tops.number[j, i] == k else ZERO
    q = ONE if tops.number[j, i + 1] == k else ZERO
    r = ONE if tops.number[j + 1, i] == k else ZERO
    s = ONE if tops.number[j + 1, i + 1] == k else ZERO
    return (p + (q - p) * a) * (ONE - b) + (r + (s - r) * a) * b


@inlined_function
def is_level(tops, k):
    """Tell whether water stands on top k."""
    return tops.form[k, ROWS] > ZERO


@inlined_function
def top_surface(tops, k, x, y):
    """Return height [m] and slopes of top k at (x, y) [m]; a level one counts as quite level."""
    f = tops.form[k]
    height = f[CONSTANT] + f[BY_X] * (x - f[CENTRE_X]) + f[BY_Y] * (y - f[CENTRE_Y])
    sloping = ZERO if f[ROWS] > ZERO else ONE
    return height, sloping * f[BY_X], sloping * f[BY_Y]


@inlined_function
def on_patch(tops, k, x, y):
    """Return the share of a level top that holds water at (x, y) [m], and the water's depth [m]."""
    f = tops.form[k]
    u = (x - f[CORNER_X]) / tops.fine - HALF
    v = (y - f[CORNER_Y]) / tops.fine - HALF
    if not (u > ZERO and v > ZERO and u < f[COLUMNS] - ONE and v < f[ROWS] - ONE):
        return ZERO, ZERO
    v += f[FIRST_ROW]
    last = tops.depths.shape[0] - 1
    stage, sheet = tops.water[k, 0], tops.water[k, 1]
    low = min(max(int(stage), 0), last)
    high = min(low + 1, last)
    depth = bilinear(tops.depths[low], u, v)
    depth += (stage - np.float32(low)) * (bilinear(tops.depths[high], u, v) - depth)
    return bilinear(tops.holds, u, v), depth + sheet


@inlined_function
def film_on(rain):
    """Return the share of a full water film on open tops, see `walls.damp_off_ground`."""
    full = min(rain.supply, TWO)
    return FILM_SHARE * rain.film_left * full * (ONE - QUARTER * full)


@inlined_function
def wet_top(view, tops, rain, depth, row, column):
    """Return where a pixel's ray meets a wet top, and the share of the pixel that is wet.

    tops : TopMaps
    rain : OffGroundWetness
    depth : float32 [m]. Of what the pixel shows, along the view axis.
    row, column : int
    Returns hit : float32 [m]. Along the view axis; negative on a top that slopes,
        into which no planar mirror looks.
        coverage : float32. 0 if the pixel shows no wet top.
    """
    x, y, z = pixel_ray(view, row, column)
    eye = view.eye
    shown = eye[2] + depth * z
    if not (z <= LEAST_DIP and depth > LEAST_WAY and shown > tops.low and shown < tops.high):
        return ZERO, ZERO
    k = top_over(tops, eye[0] + depth * x, eye[1] + depth * y)
    if k < 0:
        return ZERO, ZERO
    height, gx, gy = top_surface(tops, k, eye[0] + depth * x, eye[1] + depth * y)
    above = shown - height
    fall = z - gx * x - gy * y  # of the ray towards the surface
    if not (abs(above) < TWO * OFF_TOP and fall <= LEAST_DIP):
        return ZERO, ZERO
    hit = depth - above / fall
    covers = film_on(rain)
    if is_level(tops, k):
        # A capture's tops are warped by some millimetres, which a slanted view shows as a shift.
        # The patch was seen from above: it is looked up where the pixel's own depth puts it.
        warp = min(max(above, WARP_LOW), WARP_HIGH)
        place = depth - (above - warp) / fall
        holds, water = on_patch(tops, k, eye[0] + place * x, eye[1] + place * y)
        if not share_over(tops, k, eye[0] + hit * x, eye[1] + hit * y) > ZERO:
            return ZERO, ZERO  # a flat view: the ray meets the plane beside the top
        covers = max(covers, smoothstep(THIN, FULL, water)) * holds
    else:
        covers *= share_over(tops, k, eye[0] + hit * x, eye[1] + hit * y)
        above *= HALF  # the fit of a sloping top is worse
    covers *= ONE - smoothstep(NEAR_TOP, OFF_TOP, abs(above))
    if not (covers > LEAST_COVERAGE and hit > LEAST_WAY):
        return ZERO, ZERO
    return (hit if is_level(tops, k) else -hit), covers


@inlined_function
def is_at(tops, k, x, y, z):
    """Tell whether (x, y, z) [m] lies on top k; k is -1 for none."""
    if k < 0:
        return False
    height, _, _ = top_surface(tops, k, x, y)
    return abs(z - height) <= SAME_HEIGHT


@inlined_function
def top_with(tops, x, y, z):
    """Return the number of the top that (x, y, z) [m] lies on, -1 for none.

    It lies over the point, or over one of the four cells that `share_over` weighs there: at its
    edge a top covers a part of the cell beside its own.
    """
    k = top_over(tops, x, y)
    if is_at(tops, k, x, y, z):
        return k
    rows, columns = tops.number.shape
    u, v = map_place(x, y, tops.origin, tops.spacing)
    if not (u > -ONE and v > -ONE and u < np.float32(columns) and v < np.float32(rows)):
        return -1
    for cell in range(4):
        i = int(u + ONE) - 1 + cell % 2
        j = int(v + ONE) - 1 + cell // 2
        if i >= 0 and j >= 0 and i < columns and j < rows:
            k = int(tops.number[j, i])
            if is_at(tops, k, x, y, z):
                return k
    return -1


@inlined_function
def top_below(tops, x, y, z):
    """Return which top water at (x, y, z) [m] lies on, -1: none; the puddle's depth and the share
    of it that is smooth; and the slopes of the top.
    """
    k = -1
    if z > tops.low and z < tops.high:
        k = top_with(tops, x, y, z)
    if k < 0:
        return -1, ZERO, ZERO, ZERO, ZERO
    _, gx, gy = top_surface(tops, k, x, y)
    water = ZERO
    if is_level(tops, k):
        _, water = on_patch(tops, k, x, y)
    return k, water, smoothstep(THIN, FULL, water), gx, gy


@cpu_kernel
def list_tops(tops: TopMaps, record, top_out):
    """Write which top each record's water lies on, -1 for none; `top_out` is (n,) int16."""
    for n in prange(len(record)):
        top_out[n] = top_below(tops, record[n, X], record[n, Y], record[n, Z])[0]


@cpu_kernel
def meet_tops(
    depth, view: View, tops: TopMaps, rain: OffGroundWetness, row_order, hit_out, coverage_out,
    count_out,
):  # fmt: skip
    """Add the wet tops to the hits that `ray_water.meet_water` found, whose water hides them.

    depth : float32 array (height, width) [m]
    tops : TopMaps
    rain : OffGroundWetness
    row_order : int64 array (height,)
    hit_out, coverage_out, count_out : ndarray. As `meet_water` wrote them; see
        `wet_top` for the hit.
    """
    height, width = depth.shape
    m, up, low, high = view.ground_from_camera, view.eye[2], tops.low, tops.high
    m20, m21, m22 = m[2, 0], m[2, 1], m[2, 2]
    for k in prange(height):
        row = row_order[k]
        count = 0
        b = row_slope(view, row)
        for column in range(width):
            a = column_slope(view, column)
            shown = up + depth[row, column] * (m20 * a + m21 * b + m22)
            if not (shown > low and shown < high) or coverage_out[row, column] > ZERO:
                continue  # most pixels: the call takes longer
            hit, covers = wet_top(view, tops, rain, depth[row, column], row, column)
            if covers > ZERO:
                hit_out[row, column], coverage_out[row, column] = hit, covers
                count += 1
        count_out[row] += count
