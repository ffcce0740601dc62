"""Marks in a picture of optical depths: drops on short paths, antialiased, of a given summed alpha.

A picture is a flat int32 array of whole units of optical depth, so that neither the order of the
marks nor the number of threads matters. It is stored column by column, as its depth is: most rain
falls down the picture, and neighbours in memory are what makes that fast. Everything here is in the
camera frame, in float32.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, TWO, ZERO
from rainsim.jit import device_function, inlined_function, lean_function

DEPTH_TILE = 16  # px; side of the tiles whose least and greatest depths are known
NEAR = 0.5  # m; drops nearer to the camera are out of any focus and are not drawn
# Places in a lens: focal lengths and principal point [px], half of the largest drop times the focal
# length [px m], the aperture times the focal length [px m], one over the depth in focus [1/m], the
# factor on what each drop covers.
FX, FY, CX, CY, LARGEST_RADIUS, APERTURE, PER_FOCUS, STRENGTH = range(8)
FAINTEST = 3e-3  # share of light: half of it falls to each of two pixels, and at a contrast of 0.4
# on a linear mid-grey of 0.2 that is a fifth of a level of an 8-bit picture, on near black more
_WIDE = np.float32(1.5)  # px; wider drops are drawn as discs
_STILL = np.float32(3.0)  # px; a shorter path of a drop nearly as wide as a pixel is a disc too
_WIDE_STILL = np.float32(0.9)  # px
_LONG = np.float32(3.0)  # widths; a longer wide path is drawn in strips
_STRIPS = np.float32(1.0)  # per px
_PIECES = np.float32(10.0)  # a path is cut where the depth has changed by a tenth
_MOST_PIECES = np.float32(63.0)

_SCALE = np.float32(2**23)  # units of the picture per unit of optical depth
_PER_UNIT = np.float32(2**-23)
_CEILING = np.int32(2**30)  # optical depth 128: black, and two of them still fit an int32
_OPAQUE = np.float32(0.9997)  # the most that one drop replaces in one pixel
_FAINT = np.float32(0.05)  # below it three terms give -log(1 - alpha) to 3e-5
_FAINT_UNITS = np.int64(_FAINT * _SCALE)
_NEAREST = np.float32(0.5 * NEAR)  # a path that comes nearer ends there
_SIXTH, _QUARTER = np.float32(1 / 6), np.float32(0.25)
_HALF_SCALE, _THIRD_SCALE = np.float32(2**22), np.float32(2**23 / 3)
_QUARTER_PI = np.float32(math.pi / 4)
_FARTHEST = np.float32(1e6)  # px
_SHORTEST = np.float32(0.05)  # px; length given to a path that hardly moves


class SceneDepth(NamedTuple):
    """The scene's depth, as marks are tested against it.

    width, height : int [px]
    columns : float32 array (width * height,) [m]. Depth along the view axis,
        column by column.
    tiles : ndarray of shape (2, ceil(height / DEPTH_TILE), ceil(width /
        DEPTH_TILE)), float32 [m]. The greatest and the least depth of each tile.
    """

    width: int
    height: int
    columns: np.ndarray
    tiles: np.ndarray


class Path(NamedTuple):
    """A straight path in the camera frame [m], float32: where it begins and ends."""

    x: float
    y: float
    z: float
    x_end: float
    y_end: float
    z_end: float


class _Segment(NamedTuple):
    """A piece of a path in the picture: ends along two image axes [px] and in depth [m]."""

    s0: float
    t0: float
    z0: float
    s1: float
    t1: float
    z1: float


class _Axes(NamedTuple):
    """Two image axes, s and t: pixels along each, and the step in memory from one to the next."""

    s_count: int
    t_count: int
    s_stride: int
    t_stride: int


@lean_function
def draw_path(path, share, diameter, lens, scene, clear, picture):
    """Draw the first `share` of a drop's straight path.

    share : float32. Of the path, and of the time: a drop that ends on its way
        covers the picture for less.
    diameter : float32 [m]
    lens : float32 array (8,). See `FX`.
    scene : SceneDepth
    clear : bool. Nothing stands before the path: no depth is read then.
    picture : int32 array (width * height,) or int64. Optical depths, column by
        column; added to.

    A drop covers (pi/4) fx fy (D / z)^2 over the cosine of its angle off the axis: it subtends
    (D / distance)^2, but a pixel there subtends less. A drop out of focus is spread over its circle
    of confusion.

    A path towards or away from the camera is cut into pieces of equal time, each with its share of
    that area, whose mean over a piece is that of 1 / (z0 z1); never so finely that pieces lie on
    each other in the picture.
    """
    fx, fy, cx, cy = lens[FX], lens[FY], lens[CX], lens[CY]
    x, y, z = path.x, path.y, path.z
    dx, dy, dz = (path.x_end - x) * share, (path.y_end - y) * share, (path.z_end - z) * share
    z_end = max(z + dz, _NEAREST)
    # Quotients cost more than all else here: each depth is divided by once.
    z0, per_z0, per_z_end = z, ONE / z, ONE / z_end
    u0, v0 = fx * x * per_z0 + cx, fy * y * per_z0 + cy
    u1, v1 = fx * (x + dx) * per_z_end + cx, fy * (y + dy) * per_z_end + cy
    per_nearest = max(per_z0, per_z_end)
    pieces = 1
    if _PIECES * abs(dz) * per_nearest >= ONE:
        long_enough = max(abs(u1 - u0), abs(v1 - v0)) / (TWO + fx * diameter * per_nearest)
        pieces += int(min(_PIECES * abs(dz) * per_nearest, min(long_enough, _MOST_PIECES)))
    step = ONE / np.float32(pieces)
    per_middle = ONE / (z0 + HALF * dz)
    x_middle, y_middle = (x + HALF * dx) * per_middle, (y + HALF * dy) * per_middle
    oblique = np.sqrt(ONE + x_middle * x_middle + y_middle * y_middle)
    area = _QUARTER_PI * fx * fy * diameter * diameter * oblique * share * step
    area *= lens[STRENGTH]
    for piece in range(1, pieces + 1):
        passed = np.float32(piece) * step
        z1 = z + dz * passed
        per_z1 = ONE / z1
        u1 = fx * (x + dx * passed) * per_z1 + cx
        v1 = fy * (y + dy * passed) * per_z1 + cy
        if pieces > 1:
            per_middle = TWO / (z0 + z1)
        wide = fx * diameter * per_middle
        if lens[APERTURE] > ZERO:
            blur = lens[APERTURE] * (per_middle - lens[PER_FOCUS])
            wide = np.sqrt(wide * wide + blur * blur)
        _draw_segment(
            _Segment(u0, v0, z0, u1, v1, z1), wide, area * per_z0 * per_z1, scene, clear, picture
        )
        z0, per_z0, u0, v0 = z1, per_z1, u1, v1


@lean_function
def _draw_segment(segment, wide, alpha, scene, clear, picture):
    """Spread `alpha` over the picture of a straight piece, `wide` pixels across.

    Wide and long pieces are drawn as strips, wide short ones as a disc, all others as thin lines.
    """
    across, along = abs(segment.s1 - segment.s0), abs(segment.t1 - segment.t0)
    longer = max(across, along)
    if wide > _WIDE and longer > _LONG * wide:
        _draw_strips(segment, wide, alpha, scene, clear, picture)
    elif wide > _WIDE or (wide > _WIDE_STILL and longer < _STILL):
        _draw_disc(segment, HALF * wide, alpha, scene, clear, picture)
    else:
        _draw_thin(segment, along >= across, alpha, scene, clear, picture)


@lean_function
def _draw_strips(segment, wide, alpha, scene, clear, picture):
    """Spread `alpha` over a wide path that is much longer than wide, as thin paths side by side.

    Each has the share of time that the drop's disc covers it. A place at a strip's end is covered
    for less, by up to the disc's chord there: copies of the strip, shifted by parts of that chord,
    add up to the ramp.
    """
    u0, v0, z0, u1, v1, z1 = segment
    du, dv = u1 - u0, v1 - v0
    scale = wide / np.sqrt(du * du + dv * dv)
    du, dv = du * scale, dv * scale
    strips = int(wide * _STRIPS) + 1
    step = ONE / np.float32(strips)
    total = ZERO
    for strip in range(strips):
        aside = (np.float32(strip) + HALF) * step - HALF
        total += np.sqrt(_QUARTER - aside * aside)
    for strip in range(strips):
        aside = (np.float32(strip) + HALF) * step - HALF
        chord = TWO * np.sqrt(_QUARTER - aside * aside)
        copies = int(chord * wide * HALF) + 1
        part = alpha * HALF * chord / (total * np.float32(copies))
        for copy in range(copies):
            ahead = ((np.float32(copy) + HALF) / np.float32(copies) - HALF) * chord
            right, down = ahead * du - aside * dv, ahead * dv + aside * du
            beside = _Segment(u0 + right, v0 + down, z0, u1 + right, v1 + down, z1)
            _draw_thin(beside, abs(dv) >= abs(du), part, scene, clear, picture)


@lean_function
def _draw_thin(segment, steep, alpha, scene, clear, picture):
    """Spread `alpha` evenly over a path that is no wider than a pixel.

    Every point of the path is shared linearly between the pixel centres around it, along both
    axes, so that the streak's centroid is where it belongs and slides smoothly. A `steep` path is
    longer down the picture than across it; from here on s is the image axis of its length.
    """
    u0, v0, z0, u1, v1, z1 = segment
    if steep:
        axes = _Axes(scene.height, scene.width, 1, scene.height)
        _draw_along(_Segment(v0, u0, z0, v1, u1, z1), axes, alpha, scene.columns, clear, picture)
    else:
        axes = _Axes(scene.width, scene.height, scene.height, 1)
        _draw_along(segment, axes, alpha, scene.columns, clear, picture)


@lean_function
def _draw_along(segment, axes, alpha, depth, clear, picture):
    """Draw a thin path, see `_draw_thin`, whose longer image axis is s."""
    s0, t0, z0, s1, t1, z1 = segment
    s_stride, t_stride, t_count = axes.s_stride, axes.t_stride, axes.t_count
    if s1 < s0:
        s0, s1, t0, t1, z0, z1 = s1, s0, t1, t0, z1, z0
    lacking = max(_SHORTEST - (s1 - s0), ZERO) * HALF
    s0, s1 = s0 - lacking - HALF, s1 + lacking - HALF  # from here on in pixel centres
    per_length = ONE / (s1 - s0)
    inner = alpha * per_length
    lean, recede = (t1 - t0) * per_length, (z1 - z0) * per_length
    # Clipped before the conversion: a path may reach far outside the picture.
    start = int(max(np.floor(s0), ZERO))
    stop = int(min(np.floor(s1) + ONE, np.float32(axes.s_count - 1))) + 1
    highest = np.float32(t_count)
    bold = inner >= _FAINT
    # Most pixels need no test: those between the ends of a path that is clear and in the picture.
    first = start + 2 if np.float32(start) < s0 + ONE else start
    last = stop - 2 if np.float32(stop - 1) > s1 - ONE else stop
    across = t0 + lean * (np.float32(first) - s0) + HALF
    across_last = t0 + lean * (np.float32(last - 1) - s0) + HALF
    lowest = min(across, across_last)
    if not clear or bold or last <= first or lowest < ONE or max(across, across_last) >= highest:
        first = last = start
    for s in range(first + lane(), last, lanes()):
        across = t0 + lean * (np.float32(s) - s0) + HALF  # from before the picture
        t = int(across)
        right = across - np.float32(t)
        at = s * s_stride + t * t_stride
        add(picture, at - t_stride, inner * (ONE - right), False)
        add(picture, at, inner * right, False)
    before = first - start
    for n in range(lane(), before + stop - last, lanes()):
        s = start + n if n < before else last + n - before
        centre = np.float32(s)
        amount, passed = inner, centre - s0
        if centre < s0 + ONE or centre > s1 - ONE:
            amount *= _hat_integral(s1 - centre) - _hat_integral(s0 - centre)
            passed = min(max(passed, ZERO), s1 - s0)
        across = t0 + lean * passed + HALF  # from the centre of the pixel before the picture
        if across < ZERO or across >= highest + ONE:
            continue
        t = int(across) - 1
        right = across - np.float32(t + 1)
        z = z0 + recede * passed
        at = s * s_stride + t * t_stride
        if t >= 0 and (clear or z < depth[at]):
            add(picture, at, amount * (ONE - right), bold)
        at += t_stride
        if t + 1 < t_count and (clear or z < depth[at]):
            add(picture, at, amount * right, bold)


@device_function
def _hat_integral(x):
    """Integral up to x of the hat 1 - |x| on [-1, 1]."""
    x = min(max(x, -ONE), ONE)
    return HALF + x - HALF * x * abs(x)


@lean_function
def _draw_disc(segment, radius, alpha, scene, clear, picture):
    """Spread `alpha` over a moving disc by the share of time that it covers each pixel."""
    u0, v0, z0, u1, v1, z1 = segment
    width, height, depth = scene.width, scene.height, scene.columns
    du, dv = u1 - u0, v1 - v0
    length = np.sqrt(du * du + dv * dv)
    if length > ZERO:
        du, dv = du / length, dv / length
    reach = radius + ONE
    top, bottom = int(np.floor(min(v0, v1) - reach)), int(np.floor(max(v0, v1) + reach))
    left, right = int(np.floor(min(u0, u1) - reach)), int(np.floor(max(u0, u1) + reach))
    # A slanted path fills little of the box around it: only a stretch of each row is looked at.
    slope, half = ZERO, _FARTHEST
    if abs(dv) * length > ONE:
        slope, half = du / dv, reach / abs(dv)
    total = ZERO
    for row in range(top + lane(), bottom + 1, lanes()):
        first, last = _stretch(row, u0, v0, slope, half, left, right)
        for column in range(first, last + 1):
            total += _cover(row, column, u0, v0, du, dv, length, radius)
    scale = alpha / max(over_lanes(total), _SHORTEST)
    for row in range(max(top, 0) + lane(), min(bottom, height - 1) + 1, lanes()):
        first, last = _stretch(row, u0, v0, slope, half, left, right)
        for column in range(max(first, 0), min(last, width - 1) + 1):
            amount = scale * _cover(row, column, u0, v0, du, dv, length, radius)
            if amount > ZERO:
                u, v = np.float32(column) + HALF - u0, np.float32(row) + HALF - v0
                part = min(max((u * du + v * dv) / max(length, _SHORTEST), ZERO), ONE)
                at = column * height + row
                if clear or z0 + (z1 - z0) * part < depth[at]:
                    add(picture, at, amount, amount >= _FAINT)


@device_function
def _stretch(row, u0, v0, slope, half, left, right):
    """Return the first and last column that a path of half width `half` may touch in a row."""
    middle = u0 + (np.float32(row) + HALF - v0) * slope
    first = max(middle - half - HALF, np.float32(left))
    last = min(middle + half + HALF, np.float32(right))
    return int(np.floor(first)), int(np.floor(last))


@device_function
def _cover(row, column, u0, v0, du, dv, length, radius):
    """Share of time for which the moving disc covers a pixel, from four points in it."""
    u, v = np.float32(column) + HALF - u0, np.float32(row) + HALF - v0
    if abs(u * dv - v * du) > radius + ONE:
        return ZERO
    covered = ZERO
    for corner in range(4):
        a = u + (_QUARTER if corner & 1 else -_QUARTER)
        b = v + (_QUARTER if corner & 2 else -_QUARTER)
        along, aside = a * du + b * dv, a * dv - b * du
        if length <= _SHORTEST:  # still: inside or not
            covered += _QUARTER if a * a + b * b < radius * radius else ZERO
            continue
        half_chord = radius * radius - aside * aside
        if half_chord > ZERO:
            half_chord = np.sqrt(half_chord)
            inside = min(length, along + half_chord) - max(ZERO, along - half_chord)
            covered += _QUARTER * max(inside, ZERO) / length
    return covered


@inlined_function
def add(picture, at, alpha, bold):
    """Add one drop's alpha to a pixel's optical depth; see `added`."""
    here = np.uint64(at)  # unsigned: numba then need not ask whether it counts from the end
    picture[here] = added(picture[here], alpha, bold)


@device_function
def lane():
    """Return the thread's number among those that draw a mark together; the CPU draws with one."""
    return 0


@device_function
def lanes():
    """Return how many threads draw a mark together."""
    return 1


@device_function
def over_lanes(part):
    """Return the sum of a number over the threads that share a mark."""
    return part


@device_function
def added(units, alpha, bold):
    """Return a pixel's optical depth with one drop's alpha added, `bold` from _FAINT up."""
    if bold:
        optical = -np.log(ONE - min(alpha, _OPAQUE)) * _SCALE
        return np.int32(min(units + np.int32(optical + HALF), _CEILING))
    # Too little to reach the ceiling, however many there are.
    optical = alpha * (_SCALE + alpha * (_HALF_SCALE + alpha * _THIRD_SCALE))
    return units + np.int32(optical + HALF)


@device_function
def alpha_of(total):
    """Return the alpha of a pixel's summed optical depth."""
    optical = np.float32(min(total, np.int64(_CEILING))) * _PER_UNIT
    return -np.expm1(-optical) if optical >= _FAINT else faint_alpha(optical)


@device_function
def faint_alpha(optical):
    """Return the alpha of a small optical depth."""
    return optical * (ONE - optical * (HALF - optical * _SIXTH))


@lean_function
def read_depth(band, depth, columns_out, tile_depth_out):
    """Copy a band of rows, column by column, and find each tile's greatest and least depth."""
    height, width = depth.shape
    # Unsigned whole numbers: numba then need not ask whether an index counts from the end.
    first, end = np.uint64(band * DEPTH_TILE), np.uint64(min((band + 1) * DEPTH_TILE, height))
    for tile in range(tile_depth_out.shape[2]):
        left, right = np.uint64(tile * DEPTH_TILE), np.uint64(min((tile + 1) * DEPTH_TILE, width))
        most = least = depth[first, left]
        for row in range(first, end):
            for column in range(left, right):
                most, least = max(most, depth[row, column]), min(least, depth[row, column])
        tile_depth_out[0, band, tile], tile_depth_out[1, band, tile] = most, least
        for column in range(left, right):
            at = column * np.uint64(height)
            for row in range(first, end):
                columns_out[at + row] = depth[row, column]


@device_function
def resolve_band(band, picture, alpha_out):
    """Turn the workers' summed optical depths of a band into alpha."""
    height, width = alpha_out.shape
    first, end = np.uint64(band * DEPTH_TILE), np.uint64(min((band + 1) * DEPTH_TILE, height))
    rows, workers = end - first, picture.shape[0]
    total = np.empty(DEPTH_TILE, np.int64)
    for column in range(np.uint64(width)):
        at, most = column * np.uint64(height) + first, np.int64(0)
        for row in range(rows):
            total[row] = picture[0, at + row]
            for worker in range(1, workers):
                total[row] += picture[worker, at + row]
            most = max(most, total[row])
        if most < _FAINT_UNITS:
            for row in range(rows):
                optical = np.float32(total[row]) * _PER_UNIT
                alpha_out[first + row, column] = faint_alpha(optical)
        else:
            for row in range(rows):
                alpha_out[first + row, column] = alpha_of(total[row])
