"""The streams of a steady rain: where water runs on the ground, how deep and how fast.

A gutter takes minutes to fill, and a leg of a drive is looked at for seconds. Its water therefore
begins with the streams of a steady rain, the kinematic wave at rest in time: through each
place runs what falls on all the ground that drains there, at the depth h at which friction balances
the slope S of the ground (Manning; Chow 1959, Open-channel hydraulics, chapter 5):

    q = h^(5/3) S^(1/2) / n        for a discharge q [m2/s] and a roughness n [s/m^(1/3)]

Where water runs is found on blocks of cells. Hollows that are not full keep what comes; over level
ground water finds the way to the lowest rim.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.jit import cpu_kernel, prange, serial_kernel
from rainsim.terrain.table import DRAIN

BLOCK = 0.16  # m: a gutter's stream is about as wide
RISE = 1e-6  # m from block to block that level ground is taken to rise against the flow
FULL = 2e-4  # m: a pool that could rise by less runs over
KEEPS = 0.25  # of a block that must be such a pool, or soak water up, for it to keep what comes
LEAST_SLOPE, LEAST_MANNING = 1e-3, 1e-3
THINNEST, STREAM = 0.5e-3, 1.5e-3  # m of depth between which streams begin; thinner is film
ACROSS = 6  # blocks to either side of one, over which its stream may spread
SIDEWAYS = 0.1  # of the fall along a stream, that the ground beside its bottom falls at most
HIGHEST = 0.5  # m of a stream
BISECTIONS = 20  # of HIGHEST: to a micrometre
LEVEL, ROOT, EAST, NORTH, SHARE, TOTAL = range(6)  # rows of a table of streams


class Runoff(NamedTuple):
    """Runoff of the ground under a steady rain, on blocks of cells.

    level : float64 array (rows, columns) [m]. Of ground and standing water,
        hollows that water passes over filled.
    east : float64 array (rows, columns + 1) [m3/s]. What runs through the faces
        between columns, positive to the east.
    north : float64 array (rows + 1, columns) [m3/s]
    """

    level: np.ndarray
    east: np.ndarray
    north: np.ndarray

    @property
    def discharge(self):
        """The discharge through the middle of each block to the east and north [m3/s]."""
        return (0.5 * (self.east[:, :-1] + self.east[:, 1:]),
                0.5 * (self.north[:-1] + self.north[1:]))  # fmt: skip

    def slope(self, side):
        """Return the slope of `level` down which each block's water runs, blocks `side` [m]."""
        padded = np.pad(self.level, 1, mode="edge")
        middle = padded[1:-1, 1:-1]
        x = middle - np.minimum(padded[1:-1, :-2], padded[1:-1, 2:])
        y = middle - np.minimum(padded[:-2, 1:-1], padded[2:, 1:-1])
        return np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)) / side


def block_cells(spacing):
    """Return how many cells of a size [m] a block has along a side."""
    return max(1, round(BLOCK / spacing))


def run_off(terrain, standing, rain):
    """Return the `Runoff` over `standing` water [m] of a `rain` [m/s] that reaches the ground."""
    grid = terrain.grid
    k = block_cells(grid.spacing)
    surface = block_means(terrain.bed + standing, k)
    net = np.maximum(rain - terrain.by_class("infiltration"), 0.0)
    source = block_means(net, k, "constant") * (k * grid.spacing) ** 2
    keeps = (terrain.soaks | ~runs_over(terrain.bed, standing)).astype(np.float32)
    sink = block_means(keeps, k) > KEEPS
    sink |= block_means((terrain.ground_class == DRAIN).astype(np.float32), k) > 0
    sink[[0, -1]] = sink[:, [0, -1]] = True
    level = np.empty(surface.shape)
    flood(surface, sink, level)
    order = np.argsort(level, axis=None, kind="stable")[::-1]
    rows, columns = level.shape
    east, north = np.zeros((rows, columns + 1)), np.zeros((rows + 1, columns))
    route(level, source, sink, order, east, north)
    return Runoff(level, east, north)


def with_streams(terrain, standing, rain):
    """Return the water at rest with the streams of a steady rain.

    Returns depth : float64 array (ny, nx) [m]. At least `standing`.
        velocity : float32 array (2, ny, nx) [m/s]. Of the streams and of the
            water at rest that they run through.
    """
    depth = np.array(standing, np.float64)
    velocity = np.zeros((2, *depth.shape), np.float32)
    if not np.any(rain > 0):
        return depth, velocity
    flow = run_off(terrain, standing, rain)
    k = block_cells(terrain.grid.spacing)
    side = k * terrain.grid.spacing
    x, y = (part / side for part in flow.discharge)
    slope = np.maximum(flow.slope(side), LEAST_SLOPE)
    manning = terrain.by_class("manning").astype(np.float32)
    root = np.sqrt(slope) / np.maximum(block_means(manning, k), LEAST_MANNING)
    depth_alone = (np.hypot(x, y) / root) ** 0.6
    share = np.clip((depth_alone - THINNEST) / (STREAM - THINNEST), 0.0, 1.0)
    film = terrain.by_class("storage").astype(np.float32)
    table = np.zeros((6, *share.shape))
    ground = terrain.bed + film
    table[LEVEL] = block_means(ground, k) + depth_alone
    table[ROOT], table[SHARE] = root, share
    size = np.maximum(np.hypot(x, y), 1e-12)
    table[EAST], table[NORTH], table[TOTAL] = x / size, y / size, size * side
    bottom = share * is_bottom(flow.level, x, y)
    fill_sections(ground, k, terrain.grid.spacing, x, y, root, bottom, table)
    lay(terrain.bed, film, k, table, x, y, depth, velocity)
    return depth, velocity


def is_bottom(level, x, y):
    """Return the mask of blocks beside whose stream no ground is much lower: bottoms of gutters."""
    padded = np.pad(level, 1, mode="edge")
    falls = [level - np.minimum(padded[1:-1, :-2], padded[1:-1, 2:]),
             level - np.minimum(padded[:-2, 1:-1], padded[2:, 1:-1])]  # fmt: skip
    upright = np.abs(x) >= np.abs(y)  # the section across the stream is a column of blocks
    along, across = np.where(upright, falls, falls[::-1])
    return across <= SIDEWAYS * np.maximum(along, 0.0)


def block_means(values, k, beyond="edge"):
    """Return the means of blocks of k x k cells, float64; `beyond` is how a rim is continued."""
    ny, nx = values.shape
    padded = np.pad(values, ((0, -ny % k), (0, -nx % k)), mode=beyond)
    shape = padded.shape[0] // k, k, padded.shape[1] // k, k
    return padded.reshape(shape).mean(axis=(1, 3), dtype=np.float64)


def runs_over(bed, standing):
    """Return the mask of the cells that are no part of a pool that could still rise."""
    pool, count = ndimage.label(standing > 0)
    room = np.full((2, count + 1), np.inf)
    rims(bed, np.asarray(standing, np.float64), pool, room)
    full = room[0] <= room[1] + FULL
    full[0] = True
    return full[pool]


@serial_kernel
def rims(bed, depth, pool, room_out):
    """Find the lowest rim of each pool and its level.

    pool : int32 array (ny, nx). Number of each cell's pool, 0 of dry ones.
    room_out : float64 array (2, pools + 1) [m]. Lowest rim, -inf at the map's
        edge, and highest level. Infinite before.
    """
    ny, nx = bed.shape
    room_out[1] = -np.inf
    for j in range(ny):
        for i in range(nx):
            n = pool[j, i]
            if n == 0:
                continue
            room_out[1, n] = max(room_out[1, n], bed[j, i] + depth[j, i])
            for side in range(4):
                b, a = j + (side == 0) - (side == 1), i + (side == 2) - (side == 3)
                if b < 0 or a < 0 or b >= ny or a >= nx:
                    room_out[0, n] = -np.inf
                elif pool[b, a] == 0:
                    room_out[0, n] = min(room_out[0, n], np.float64(bed[b, a]))


@serial_kernel
def flood(surface, sink, level_out):
    """Fill the hollows of a surface up to their rims (Planchon and Darboux 2002, Catena 46).

    sink : bool array (rows, columns). Where water ends; nothing is filled there.
    level_out : float64 array (rows, columns) [m]. Rises by RISE at least from
        block to block, away from where water ends.
    """
    rows, columns = surface.shape
    for j in range(rows):
        for i in range(columns):
            level_out[j, i] = surface[j, i] if sink[j, i] else np.inf
    changed = True
    while changed:
        changed = False
        for back in range(2):
            for m in range(rows * columns):
                c = rows * columns - 1 - m if back else m
                j, i = c // columns, c % columns
                if sink[j, i] or level_out[j, i] == surface[j, i]:
                    continue
                low = np.inf
                for side in range(4):
                    b, a = j + (side == 0) - (side == 1), i + (side == 2) - (side == 3)
                    if 0 <= b < rows and 0 <= a < columns:
                        low = min(low, level_out[b, a])
                level = max(surface[j, i], low + RISE)
                if level < level_out[j, i]:
                    level_out[j, i] = level
                    changed = True


@serial_kernel
def route(level, source, sink, order, east_out, north_out):
    """Let the water of each block run on to its lower neighbours, in proportion to the fall.

    source : float64 array (rows, columns) [m3/s]. Of each block; what comes from
        its neighbours is added.
    """
    rows, columns = level.shape
    for c in order:
        j, i = c // columns, c % columns
        if sink[j, i] or source[j, i] <= 0.0:
            continue
        fall = 0.0
        for side in range(4):
            b, a = j + (side == 0) - (side == 1), i + (side == 2) - (side == 3)
            if 0 <= b < rows and 0 <= a < columns:
                fall += max(level[j, i] - level[b, a], 0.0)
        if fall <= 0.0:
            continue
        for side in range(4):
            b, a = j + (side == 0) - (side == 1), i + (side == 2) - (side == 3)
            if 0 <= b < rows and 0 <= a < columns and level[b, a] < level[j, i]:
                part = source[j, i] * (level[j, i] - level[b, a]) / fall
                source[b, a] += part
                if side == 0:
                    north_out[j + 1, i] += part
                elif side == 1:
                    north_out[j, i] -= part
                elif side == 2:
                    east_out[j, i + 1] += part
                else:
                    east_out[j, i] -= part


@serial_kernel
def fill_sections(bed, k, spacing, x, y, root, share, table_out):
    """Find the level of each gutter's stream, in the section of the ground across it.

    It is the level at which friction balances the slope for all that runs through the section
    below it. Of streams that reach the same block the larger one counts.

    root : float64 array (rows, columns) [m^(1/3)/s]. Square root of the slope
        over Manning's n.
    share : float64 array (rows, columns). Of the depth that is laid; 0: the block
        is no bottom of a stream.
    table_out : float64 array (6, rows, columns). LEVEL [m], ROOT, direction EAST
        and NORTH, SHARE, and the discharge TOTAL of the section [m3/s]; before,
        those of each block by itself.
    """
    ny, nx = bed.shape
    rows, columns = share.shape
    length = (2 * ACROSS + 1) * k
    profile = np.empty(length)
    for j in range(rows):
        for i in range(columns):
            if share[j, i] <= 0.0:
                continue
            upright = abs(x[j, i]) >= abs(y[j, i])  # the section is a column of blocks
            at, last = (j, ny) if upright else (i, nx)
            begin = (at - ACROSS) * k
            first, end = max(-begin, 0), min(last - begin, length)
            other = i * k if upright else j * k
            beyond = min(other + k, nx if upright else ny)
            lowest = ACROSS * k
            for n in range(first, end):
                total = 0.0
                for m in range(other, beyond):
                    total += bed[begin + n, m] if upright else bed[m, begin + n]
                profile[n] = total / (beyond - other)
                if ACROSS * k <= n < (ACROSS + 1) * k and profile[n] < profile[lowest]:
                    lowest = n
            low, high = profile[lowest], profile[lowest] + HIGHEST
            through, south, north = 0.0, lowest, lowest
            for _ in range(BISECTIONS):
                level = 0.5 * (low + high)
                south = north = lowest
                while south > first and profile[south - 1] < level:
                    south -= 1
                while north < end - 1 and profile[north + 1] < level:
                    north += 1
                carries, through = 0.0, 0.0
                for n in range(south, north + 1):
                    deep = level - profile[n]
                    carries += deep * np.cbrt(deep * deep)
                for b in range(at - ACROSS + south // k, at - ACROSS + north // k + 1):
                    through += abs(x[b, i]) if upright else abs(y[j, b])
                if carries * spacing * root[j, i] < through * k * spacing:
                    low = level
                else:
                    high = level
            size = math.sqrt(x[j, i] ** 2 + y[j, i] ** 2)
            through *= k * spacing
            for b in range(at - ACROSS + south // k, at - ACROSS + north // k + 1):
                d, c = (b, i) if upright else (j, b)
                if through >= table_out[TOTAL, d, c]:
                    table_out[LEVEL, d, c], table_out[ROOT, d, c] = high, root[j, i]
                    table_out[EAST, d, c] = x[j, i] / size
                    table_out[NORTH, d, c] = y[j, i] / size
                    table_out[SHARE, d, c], table_out[TOTAL, d, c] = share[j, i], through


@cpu_kernel
def lay(bed, film, k, table, x, y, depth_out, velocity_out):
    """Lay the streams over the water at rest.

    x, y : float64 array (rows, columns) [m2/s]. Discharge to the east and north,
        of what runs through water at rest.
    velocity_out : float32 array (2, ny, nx) [m/s]. 0 before.
    """
    ny, nx = bed.shape
    rows, columns = x.shape
    for j in prange(ny):
        v = (j + 0.5) / k - 0.5
        m = math.floor(v)
        for i in range(nx):
            u = (i + 0.5) / k - 0.5
            n = math.floor(u)
            weight, part, level, root = 0.0, 0.0, 0.0, 0.0
            east, north, to_east, to_north = 0.0, 0.0, 0.0, 0.0
            for b in range(m, m + 2):
                for a in range(n, n + 2):
                    d, c = min(max(b, 0), rows - 1), min(max(a, 0), columns - 1)
                    w = (1.0 - abs(v - b)) * (1.0 - abs(u - a))
                    to_east += w * x[d, c]
                    to_north += w * y[d, c]
                    if table[SHARE, d, c] > 0.0:
                        weight += w
                        part += w * table[SHARE, d, c]
                        level += w * table[LEVEL, d, c]
                        root += w * table[ROOT, d, c]
                        east += w * table[EAST, d, c]
                        north += w * table[NORTH, d, c]
            if weight <= 0.0:
                continue
            free = part / weight * max(level / weight - bed[j, i] - film[j, i], 0.0)
            rest = depth_out[j, i] - film[j, i]
            if rest >= free and rest > 0.0:
                velocity_out[0, j, i] = to_east / max(rest, THINNEST)
                velocity_out[1, j, i] = to_north / max(rest, THINNEST)
            elif free > 0.0:
                depth_out[j, i] = max(depth_out[j, i], free + film[j, i])
                size = max(math.sqrt(east * east + north * north), 1e-6)
                speed = np.cbrt(free * free) * root / weight
                velocity_out[0, j, i] = speed * east / size
                velocity_out[1, j, i] = speed * north / size
