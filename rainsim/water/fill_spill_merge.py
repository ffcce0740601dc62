"""Where rain stands after it has run off: fill, spill and merge of the bed's depressions.

The rain of minutes or hours before the first frame is not stepped. Each cell's rain runs down the
steepest of its four neighbours to a pit, a permeable cell or an open edge. A depression that
receives more than it holds spills over its lowest rim into the next one; two that have filled to
the same rim become one. The result is the state of rest of the water, to float64 rounding of its
volume. Neighbours are four because the flow solver passes water through faces only.

References
----------
Barnes, Callaghan and Wickert 2021, "Computing water flow through complex landscapes, part 3:
Fill-Spill-Merge", Earth Surf. Dynam. 9. The tree of depressions is theirs. We differ: the tree
comes from one sweep over the cells in ascending order, and spilling follows a union-find structure
in which a full depression passes what it gets to where it spills, so each fills up once.
"""

import numpy as np

from rainsim.errors import ParameterError, require_not_negative, require_positive
from rainsim.jit import device_function, serial_kernel
from rainsim.water.inputs import require_bed

# Where a path down ends, besides a leaf of the tree (its number, from 1 on).
OUT = -1
SOAKED = -2
UNSEEN = -3

DRAINED = 0  # the node of all cells from which water leaves before it can stand

PLAIN, EDGE, PERMEABLE = 0, 1, 2  # kinds of cells
PARENT, SIBLING, TARGET = 0, 1, 2  # rows of the links of a tree
RIM, PIT, VOLUME, AREA = range(4)  # rows of its levels
CELLS, HEIGHTS = 0, 1  # rows of the sums over the cells of a node


def standing_water(
    bed, rainfall, spacing, permeable=None, minimum_depth=0.0, minimum_area=0.0, open_edges=True
):
    """Find where `rainfall` stands once it has stopped flowing.

    Parameters
    ----------
    bed : array_like of shape (ny, nx) [m]
        Ground height.
    rainfall : float or array_like of shape (ny, nx) [m]
        Depth that has fallen on each cell.
    spacing : float [m]
        Side of a cell.
    permeable : array_like of shape (ny, nx), bool, optional
        Cells that take up whatever falls on them or reaches them.
    minimum_depth : float [m]
        Depressions that are less deep when full hold nothing; water passes over them. One that has
        merged counts with its merged depth.
    minimum_area : float [m2]
        The same for depressions whose water, when full, covers less.
    open_edges : bool
        Whether water leaves over the map's edge.

    Returns
    -------
    depth : ndarray of shape (ny, nx), float64 [m]
    outflow_volume : float [m3]
        Water that left over the edge.
    infiltrated_volume : float [m3]
        Water that permeable cells took up.

    Examples
    --------
    >>> bed = np.ones((5, 5))
    >>> bed[2, 2] = 0.99
    >>> depth, outflow, soaked = rainsim.standing_water(bed, 0.002, 0.1, open_edges=False)
    >>> round(float(depth.sum()) * 0.1**2, 9) == round(0.002 * 0.5**2, 9)
    True
    """
    graph = SpillGraph(bed, spacing, permeable, minimum_depth, minimum_area, open_edges)
    return graph.pour(rainfall)


class SpillGraph:
    """Which depression spills into which; kept, so that water can be poured again and again.

    Parameters are those of `standing_water`.

    shape : tuple of int
    spacing : float [m]
    dropped : int. Depressions (merged ones too) that hold nothing, for they are
        too shallow or too small.
    count : int. All depressions.
    """

    def __init__(
        self, bed, spacing, permeable=None, minimum_depth=0.0, minimum_area=0.0, open_edges=True
    ):
        bed = np.ascontiguousarray(require_bed(bed, least=1))
        self.shape = bed.shape
        self.spacing = require_positive("spacing", spacing, "m")
        minimum_depth = require_not_negative("minimum_depth", minimum_depth, "m")
        cells = require_not_negative("minimum_area", minimum_area, "m2") / self.spacing**2
        kind = _cell_kinds(bed.shape, permeable, open_edges)
        # Sums of heights over cells must not cost digits.
        bed = bed - bed.mean()  # a map of millions of cells is held once
        self._bed = bed.reshape(-1)
        self._tree = _Tree(bed, kind)
        small = self._tree.too_small(minimum_depth, cells)
        self._capacity = self._tree.levels[VOLUME].copy()
        self._capacity[1:][small] = 0.0
        self.dropped, self.count = int(np.count_nonzero(small)), int(small.size)

    def pour(self, rainfall):
        """Return depth [m] (ny, nx), outflow and infiltrated volume [m3] of `rainfall` [m].

        Water that stands already is poured again with what is new: it stays where it is as long as
        nothing is added or taken.
        """
        rainfall = _require_rainfall(rainfall, self.shape)
        tree, area = self._tree, self.spacing**2
        depth, left = np.empty(self._bed.size), np.empty(2)
        fill(
            self._bed, rainfall.reshape(-1), tree.order, tree.node, tree.ending, tree.links,
            tree.levels[RIM], self._capacity, depth, left,
        )  # fmt: skip
        return depth.reshape(self.shape), float(left[0]) * area, float(left[1]) * area


class _Tree:
    """The tree of depressions; nodes are numbered so that parents come after children.

    order : int64 array (n,). Cells in ascending order of height, ties by number.
    node, ending : int32 array (n,). Each cell's smallest depression (DRAINED if
        none), and the leaf, OUT or SOAKED where its rain runs to.
    links : int32 array (3, count). PARENT: what two full siblings become
        (DRAINED: nothing). SIBLING: the depression that shares the rim (DRAINED:
        the overflow never comes back). TARGET: the leaf, OUT or SOAKED where the
        overflow runs to.
    levels : float64 array (4, count) [m]. RIM: level of the rim. PIT: lowest
        point. VOLUME: depth up to the rim summed over the cells. Infinite rim and
        volume: nothing can spill. AREA: number of its cells.
    """

    def __init__(self, bed, kind):
        flat, size = bed.reshape(-1), bed.size
        self.order = np.argsort(flat, kind="stable")  # the same order on every machine
        self.node, self.ending = np.empty(size, np.int32), np.empty(size, np.int32)
        # Pits do not touch, so they are at most half the cells; merges are one less, and those
        # at drained saddles no more.
        room = 2 * size + 2
        links, levels = np.empty((3, room), np.int32), np.empty((4, room))
        count = build(
            flat, self.order, kind.reshape(-1), bed.shape[1], self.node, self.ending, links, levels
        )
        self.links, self.levels = links[:, :count].copy(), levels[:, :count].copy()

    def too_small(self, minimum_depth, minimum_cells):
        """Mask of the depressions that are too shallow or too small when full, without DRAINED."""
        full_depth = self.levels[RIM, 1:] - self.levels[PIT, 1:]
        return (full_depth < minimum_depth) | (self.levels[AREA, 1:] < minimum_cells)


@device_function
def find(up, node):
    """Follow `up` to the end, halving the path on the way (modified in place)."""
    while up[node] != node:
        up[node] = up[up[node]]
        node = up[node]
    return node


@device_function
def neighbour(c, side, nx, size):
    """Cell on side 0 to 3 (west, east, south, north) of cell c, or -1 off the map."""
    if side == 0:
        return c - 1 if c % nx > 0 else -1
    if side == 1:
        return c + 1 if c % nx < nx - 1 else -1
    if side == 2:
        return c - nx if c >= nx else -1
    return c + nx if c + nx < size else -1


@device_function
def lower(bed, a, b):
    """Whether cell a comes before cell b in ascending order."""
    return bed[a] < bed[b] or (bed[a] == bed[b] and a < b)


@device_function
def look_around(bed, node, c, nx, up, tops_out, doors_out):
    """List the nodes around cell c and the lowest neighbour (door) in each, lowest door first."""
    around = 0
    for side in range(4):
        door = neighbour(c, side, nx, bed.size)
        if door < 0 or node[door] == UNSEEN:
            continue
        top = find(up, node[door])
        a = 0
        while a < around and tops_out[a] != top:
            a += 1
        if a == around:
            around += 1
        elif lower(bed, doors_out[a], door):
            continue
        while a > 0 and lower(bed, door, doors_out[a - 1]):
            tops_out[a], doors_out[a] = tops_out[a - 1], doors_out[a - 1]
            a -= 1
        tops_out[a], doors_out[a] = top, door
    return around


@device_function
def close(top, other, both, target, level, sums, up_out, links_out, levels_out):
    """Give node `top` its rim at `level`, shared with `other`; full, the two become `both`."""
    up_out[top] = both
    links_out[PARENT, top], links_out[SIBLING, top], links_out[TARGET, top] = both, other, target
    levels_out[RIM, top], levels_out[AREA, top] = level, sums[CELLS, top]
    # Rounding of the difference must not make it negative.
    levels_out[VOLUME, top] = max(sums[CELLS, top] * level - sums[HEIGHTS, top], 0.0)


@device_function
def join(a, b, both, a_target, b_target, level, sums_out, up_out, links_out, levels_out):
    """Merge the nodes a and b at `level` into the new node `both`."""
    up_out[both] = both
    for k in range(2):  # array arithmetic takes seconds to compile
        sums_out[k, both] = sums_out[k, a] + sums_out[k, b]
    levels_out[PIT, both] = min(levels_out[PIT, a], levels_out[PIT, b])
    close(a, b, both, a_target, level, sums_out, up_out, links_out, levels_out)
    close(b, a, both, b_target, level, sums_out, up_out, links_out, levels_out)


@serial_kernel
def build(bed, order, kind, nx, node_out, ending_out, links_out, levels_out):
    """Build the tree of depressions in one sweep up; see `_Tree` for the arrays.

    At a saddle water goes to the lowest door that is not its own. So the two nodes with the lowest
    doors are siblings, what they become is the next one's sibling, and so on; nodes whose door is
    higher than a drained one spill without return.

    Returns int. Number of nodes, with DRAINED.
    """
    up = np.empty(links_out.shape[1], np.int32)  # to the node that now contains a node
    sums = np.zeros((2, up.size))
    # One type for nodes: `close` and `join` are compiled once.
    tops, doors = np.empty(4, np.int64), np.empty(4, np.int64)
    node_out[:] = UNSEEN
    up[DRAINED] = DRAINED
    links_out[:, DRAINED] = DRAINED
    levels_out[:, DRAINED] = -np.inf
    count = 1
    for c in order:
        around = look_around(bed, node_out, c, nx, up, tops, doors)
        if kind[c] != PLAIN:
            node_out[c], ending_out[c] = DRAINED, OUT if kind[c] == EDGE else SOAKED
            for a in range(around):
                if tops[a] != DRAINED:
                    close(tops[a], DRAINED, DRAINED, ending_out[c], bed[c],
                          sums, up, links_out, levels_out)  # fmt: skip
            continue
        if around == 0:
            top = count
            count += 1
            up[top], levels_out[PIT, top], ending_out[c] = top, bed[c], top
        else:
            top, first = tops[0], ending_out[doors[0]]
            ending_out[c] = first
            drain = 0  # place of the drained door, if there is one
            while drain < around and tops[drain] != DRAINED:
                drain += 1
            for a in range(drain + 1, around):
                close(tops[a], DRAINED, DRAINED, first, bed[c], sums, up, links_out, levels_out)
            for a in range(1, drain):
                join(top, tops[a], count, ending_out[doors[a]], first, bed[c],
                     sums, up, links_out, levels_out)  # fmt: skip
                top = count
                count += 1
            if drain < around and top != DRAINED:
                close(top, DRAINED, DRAINED, ending_out[doors[drain]], bed[c],
                      sums, up, links_out, levels_out)  # fmt: skip
                top = DRAINED
        node_out[c] = top
        sums[CELLS, top] += 1.0
        sums[HEIGHTS, top] += bed[c]
    # With no way out one depression is left; it never spills.
    for top in range(1, count):
        if up[top] == top:
            close(top, DRAINED, DRAINED, np.int32(OUT), np.inf, sums, up, links_out, levels_out)
    return count


@serial_kernel
def fill(bed, rainfall, order, node, ending, links, rim, capacity, depth_out, left_out):
    """Pour the rain into the tree and spread each depression's water over its cells.

    capacity : float64 array (count,) [m]. Depth that each node holds, summed over
        its cells.
    left_out : float64 array (2,) [m]. Depth that left over the edge and into
        permeable cells, summed.
    """
    count = rim.size
    rain = np.zeros(count)
    left_out[:] = 0.0
    # Whether a node's water has one level: leaves, and what has merged.
    whole = np.zeros(count, np.bool_)
    for c in range(bed.size):
        if ending[c] > 0:
            rain[ending[c]] += rainfall[c]
            whole[ending[c]] = True
        else:
            left_out[-1 - ending[c]] += rainfall[c]

    water, full = np.zeros(count), np.zeros(count, np.bool_)
    # From a full depression to where its overflow ends up by now; past the nodes, to a way out.
    passes = np.arange(count + 2).astype(np.int32)
    for leaf in range(1, count):
        volume = rain[leaf]
        if volume > 0.0:
            volume, at = pour(leaf, volume, links, capacity, passes, water, full, whole)
            if at >= count:
                left_out[at - count] += volume
    spread(bed, order, node, links, rim, water, full, whole, depth_out)


@device_function
def pour(leaf, volume, links, capacity, passes_out, water_out, full_out, whole_out):
    """Pour `volume` into a leaf; return the volume left at the last node reached, and that node.

    Each turn fills a node for good, so all pours together take as many turns as there are nodes.
    """
    count = capacity.size
    at = find(passes_out, leaf)
    while at < count and volume > capacity[at] - water_out[at]:
        volume -= capacity[at] - water_out[at]
        water_out[at], full_out[at] = capacity[at], True
        other, target = links[SIBLING, at], links[TARGET, at]
        if other != DRAINED and full_out[other]:
            both = links[PARENT, at]  # `other` already passes everything on to `at`
            whole_out[both] = True
            water_out[both] = water_out[at] + water_out[other]
            passes_out[at] = both
        else:
            passes_out[at] = target if target > 0 else count - 1 - target
        at = find(passes_out, at)
    if at < count:
        water_out[at] += volume
    return volume, at


@device_function
def spread(bed, order, node, links, rim, water, full, whole, depth_out):
    """Turn the water of each node of the tree into a level, and the levels into depths.

    water : float64 array (count,) [m]. Depth that lies in each node, summed over
        its cells.
    full : bool array (count,). Whether the node holds its capacity: its level is
        the rim.
    whole : bool array (count,). Whether its water has one level: leaves, and
        parents once both children are full.
    """
    count = rim.size
    pool = np.empty(count, np.int32)  # the depression whose level a node shares, or DRAINED
    pool[DRAINED] = DRAINED
    for n in range(count - 1, 0, -1):
        above = pool[links[PARENT, n]]
        pool[n] = above if above != DRAINED else (n if whole[n] else DRAINED)
    cells, heights = np.zeros(count), np.zeros(count)
    level = np.full(count, -np.inf)
    for n in range(1, count):
        if full[n] and water[n] > 0.0:
            level[n] = rim[n]
    # The level lies under the first cell, going up, that the water does not reach.
    for c in order:
        n = pool[node[c]]
        if n == DRAINED or level[n] > -np.inf or water[n] <= 0.0:
            continue
        if cells[n] * bed[c] - heights[n] >= water[n]:
            level[n] = (water[n] + heights[n]) / cells[n]
        else:
            cells[n] += 1.0
            heights[n] += bed[c]
    for n in range(1, count):
        if pool[n] == n and level[n] == -np.inf and water[n] > 0.0:
            level[n] = (water[n] + heights[n]) / cells[n]
    for c in range(bed.size):
        n = pool[node[c]]
        depth_out[c] = max(level[n] - bed[c], 0.0) if n != DRAINED else 0.0


def _cell_kinds(shape, permeable, open_edges):
    kind = np.full(shape, PLAIN, np.uint8)
    if open_edges:
        kind[[0, -1]] = EDGE
        kind[:, [0, -1]] = EDGE
    if permeable is not None:
        permeable = np.asarray(permeable)
        if permeable.shape != shape or permeable.dtype != bool:
            raise ParameterError(
                f"permeable has shape {permeable.shape} and type {permeable.dtype}; it must be a "
                f"mask (bool) of the bed's shape {shape}"
            )
        kind[permeable] = PERMEABLE
    return kind


def _require_rainfall(rainfall, shape):
    rainfall = np.asarray(rainfall, np.float64)
    if rainfall.shape not in ((), shape):
        raise ParameterError(
            f"rainfall has shape {rainfall.shape}; it must be a number or of the bed's shape "
            f"{shape}"
        )
    bad = ~(np.isfinite(rainfall) & (rainfall >= 0))
    if bad.any():
        raise ParameterError(
            f"rainfall is {rainfall[bad].flat[0]} m; it must be finite and not negative everywhere"
        )
    rainfall = np.ascontiguousarray(np.broadcast_to(rainfall, shape))
    rainfall.flags.writeable = False  # a number's as a map's already is: `fill` is compiled once
    return rainfall
