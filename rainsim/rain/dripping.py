"""Water that leaves objects above the ground: drips from edges, run-off down walls.

Rain on the top of an object goes to the nearest edge along the object, where water collects until
there is enough for a drop. Under an overhang the drop falls, from rest; at a wall that stands on
the ground the water runs down and off at the wall's foot. Every surface keeps a film of water.
"""

import numpy as np
from scipy import sparse

from rainsim.constants import GRAVITY
from rainsim.io.states import DRIP_COLUMNS, NO_DRIPS, NO_IDS
from rainsim.jit import device_function
from rainsim.numerics.random import mix, subkey, uniform
from rainsim.rain.heightfield import GROUND, OBSTACLE
from rainsim.rain.impacts import Impacts
from rainsim.rain.size_distribution import drop_volume, terminal_speed
from rainsim.rain.wind import wind_at

STEP = 0.05  # m: where the top falls by more to the next cell there is an edge
LOWEST = 0.05  # m: lower things are ground
FILM = 2e-4  # m that a surface holds back, as `splash.WET_FILM`; a guess
SMALLEST, LARGEST = 4.0e-3, 5.2e-3  # m, of drops that part from an edge
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))  # rows and columns from a cell
GATHERING = 0.1  # m: drops leave at one point of an edge of this length
CLIMB = 200.0  # m of detour along the object that a metre of climb is worth
KEPT = 0.45  # s that landed drops are remembered for their splashes
_MOST_AT_ONCE = 64  # drops from one point in one step; more is a jet
END = DRIP_COLUMNS.index("end")


class Drips:
    """The water on the objects of a map and the drops that leave them.

    wet : bool. Whether it has rained before: films are full and each edge holds
        part of a drop.
    held : float. Water on the objects [m3]: films, puddles, hanging drops, and
        water that can reach no edge.
    airborne : float. Water in falling drips [m3].
    landed : Impacts. The drops that came down in the last step.
    point : int32 array (ny, nx). The drip point that a cell's water goes to; -1
        for ground, -2 where it finds no edge.
    """

    def __init__(self, surfaces, seed=0, wet=True):
        self._surfaces = surfaces
        self.point, edge, foot = _catchments(surfaces)
        spacing = surfaces.spacing
        count = len(edge)
        key = mix(np.array([seed % 2**64], np.uint64) ^ np.uint64(0xD21B))
        self._key = subkey(np.broadcast_to(key, count), np.arange(count, dtype=np.uint64))
        chance = uniform(mix(self._key))
        self._diameter = SMALLEST + (LARGEST - SMALLEST) * chance
        self._volume = drop_volume(self._diameter)
        self._row, self._column = foot.T if count else np.zeros((2, 0), np.int64)
        # half of the way into the lower cell: drops fall clear of the edge
        middle = 0.25 * edge + 0.75 * foot if count else np.zeros((0, 2))
        x = surfaces.origin[0] + (middle[:, 1] + 0.5) * spacing
        y = surfaces.origin[1] + (middle[:, 0] + 0.5) * spacing
        rows, columns = edge.T if count else np.zeros((2, 0), np.int64)
        lands = surfaces.top[self._row, self._column].astype(np.float64)
        under = surfaces.underside[rows, columns].astype(np.float64)
        self._falls = under - lands > STEP
        start = np.where(self._falls, under, lands)
        self._places = np.stack([x, y, start, lands, self._diameter], axis=1)
        self._height, self._fall_time = start - lands, fall_time(start - lands, self._diameter)
        self._next = self.point[self._row, self._column]  # drips on a lower object go on
        self._cells = np.bincount(self.point[self.point >= 0], minlength=count)
        self._stuck = np.count_nonzero(self.point == -2)  # cells
        self._room = self._cells * spacing**2 * FILM * (0.0 if wet else 1.0)
        part = uniform(mix(self._key ^ np.uint64(7)))
        self._store = self._volume * part * (1.0 if wet else 0.0)
        self._store[~self._falls] = 0.0
        self._drops = np.zeros(count, np.int64)
        self._lost = 0.0  # lies where no edge can be reached
        self._film = 0.0
        self._table, self._ids, self._site = NO_DRIPS, NO_IDS, np.zeros(0, np.int64)
        self.airborne, self.landed = 0.0, None
        self._until = -np.inf  # s, the end of the last step

    @property
    def held(self):
        """Water on the objects [m3]."""
        return float(self._store.sum()) + self._film + self._lost

    def hold(self, room, held):
        """Let the objects hold `room` [m3] more behind each point, of which `held` is there."""
        self._room += room - held
        self._film += float(held.sum())

    @property
    def room(self):
        """Water [m3] that the surfaces above each dripping point still hold back, shape (points,).

        It fills their film and puddles; only what comes after drips from the point.
        """
        return self._room

    def take_even_rain(self, depth):
        """Give the objects a depth [m] of even rain; return the water that came [m3]."""
        each = depth * self._surfaces.spacing**2
        came, lost = self._cells * each, self._stuck * each
        self._lost += lost
        self._receive(came)
        return float(came.sum()) + lost

    def advance(self, start, stop, wind=(0.0, 0.0), roughness=0.0):
        """Let drops part, fall and land from `start` to `stop` [s].

        roughness : float [m]. Of the land, see `wind.wind_shares`.
        Returns row, column : int64 array (m,)
            volume : float64 array (m,) [m3]. What came to the ground.
        """
        kept = np.flatnonzero(self._table[:, END] >= min(self._until, stop - KEPT))
        old, new = (self._table, self._ids, self._site), self._part(start, stop, wind, roughness)
        # Each step makes new arrays: states hold those of the steps before.
        self._table, self._ids, self._site = (
            np.concatenate([a.take(kept, axis=0), b]) for a, b in zip(old, new, strict=True)
        )
        end = self._table[:, END].copy()  # side by side they are read faster
        hit = np.flatnonzero((end >= self._until) & (end < stop))
        landed = drip_impacts(self._table[hit], self._ids[hit], self._surfaces, self._until, stop)
        self.airborne = float(self._volume[self._site[end >= stop]].sum())
        self._until, self.landed = stop, landed
        walls = np.flatnonzero(~self._falls & (self._store > 0))
        site = np.concatenate([self._site[hit], walls])
        volume = np.concatenate([self._volume[self._site[hit]], self._store[walls]])
        self._store[walls] = 0.0
        again = self._next[site]
        below, down = again >= 0, again == -1
        self._receive(np.bincount(again[below], volume[below], minlength=len(self._store)))
        self._lost += float(volume[again == -2].sum())
        row, column = self._row[site], self._column[site]
        # Drops land where the wind has taken them, unless that is on an object.
        free = self.point[landed.row, landed.column] == -1
        np.copyto(row[: len(hit)], landed.row, where=free)
        np.copyto(column[: len(hit)], landed.column, where=free)
        return row[down], column[down], volume[down]

    def falling(self):
        """Return drips in the air and just landed, see `io.states.DRIP_COLUMNS`, and their ids."""
        return self._table, self._ids

    def _receive(self, came):
        """Fill the films first, then the edges."""
        taken = np.minimum(came, self._room)
        self._room -= taken
        self._film += float(taken.sum())
        self._store += came - taken

    def _part(self, start, stop, wind, roughness):
        """Return the drops that part from their edges in an interval, evenly over it.

        Returns table, ids, site : array (n, 9), (n,), (n,). See `falling`; the points.
        """
        full = np.flatnonzero(self._falls & (self._store >= self._volume))
        count = self._store[full] / self._volume[full]
        count = np.minimum(count, _MOST_AT_ONCE).astype(np.int64)
        self._store[full] -= count * self._volume[full]
        site, several = np.repeat([full, count], count, axis=1)
        within = np.arange(len(site)) - np.repeat(np.cumsum(count) - count, count)
        ids = subkey(self._key[site], self._drops[site] + within + 16)
        self._drops[full] += count
        begin = start + (stop - start) * ((within + uniform(ids)) / several)
        blows = np.multiply.outer(wind_at(0.5 * self._height[site], roughness), wind)
        end = begin + self._fall_time[site]
        return np.column_stack([self._places[site], begin, end, blows]), ids, site


@device_function
def fall_time(height, diameter):
    """Return how long [s] a drop takes to fall `height` [m] from rest.

    Quadratic drag, whose terminal speed v is the drop's: z = v^2 / g ln cosh(g t / v).
    """
    speed = terminal_speed(diameter)
    return speed / GRAVITY * np.arccosh(np.exp(GRAVITY * height / speed**2))


@device_function
def fallen(time, diameter):
    """Return how far [m] a drop has fallen and how fast [m/s] it is, `time` [s] after it parted."""
    speed = terminal_speed(diameter)
    t = GRAVITY * np.maximum(time, 0.0) / speed
    return speed**2 / GRAVITY * np.log(np.cosh(t)), speed * np.tanh(t)


@device_function
def drift(time, diameter):
    """Return how far [m] a wind of 1 m/s has moved a drop, `time` [s] after it parted from rest.

    Drag turns its velocity to the wind's at the rate g / v tanh(g t / v) while it falls faster than
    the wind blows: the way is v / g (s - gd s) with s = g t / v and gd Gudermann's function.
    """
    speed = terminal_speed(diameter)
    s = GRAVITY * np.maximum(time, 0.0) / speed
    return speed / GRAVITY * (s - 2 * np.arctan(np.tanh(s / 2)))


@device_function
def drip_line(x, y, top, diameter, begin, end, wind_x, wind_y, time, exposure):
    """Return a drip as an exposure sees it: place, way over the exposure and diameter, 7 numbers.

    One that lands while the shutter is open is there for a share of the exposure. Numbers or
    arrays; the drip must be in the air for some of it.
    """
    first, last = np.maximum(begin, time), np.minimum(end, time + exposure)
    high, _ = fallen(first - begin, diameter)
    low, _ = fallen(last - begin, diameter)
    way = drift(first - begin, diameter)
    more = (drift(last - begin, diameter) - way) / exposure
    return (
        x + way * wind_x, y + way * wind_y, top - high, more * wind_x, more * wind_y,
        (high - low) / exposure, diameter * np.sqrt((last - first) / exposure),
    )  # fmt: skip


@device_function
def drip_end(x, y, diameter, begin, end, wind_x, wind_y):
    """Return where a drip comes down (x, y) [m] and how fast [m/s]; numbers or arrays."""
    way = drift(end - begin, diameter)
    return x + way * wind_x, y + way * wind_y, fallen(end - begin, diameter)[1]


def drips_seen(table, time, exposure):
    """Return drips as `streaks.draw_lines` takes them, (n, 7); see `drip_line`."""
    seen = np.minimum(table[:, 6], time + exposure) > np.maximum(table[:, 5], time)
    x, y, top, _, *rest = table[seen].T
    return np.column_stack(drip_line(x, y, top, *rest, time, exposure))


def drip_impacts(table, ids, surfaces, before, after):
    """Return as `Impacts` the drips that landed from `before` to `after` [s]."""
    hit = (table[:, 6] >= before) & (table[:, 6] < after)
    table, ids = table[hit], ids[hit]
    velocity = np.zeros((len(table), 3))
    x, y, _, bottom, *rest = table.T
    x, y, velocity[:, 2] = drip_end(x, y, *rest)
    velocity[:, 2] *= -1
    place = np.column_stack([x, y, bottom])
    cell = np.floor((place[:, :2] - surfaces.origin) / surfaces.spacing).astype(np.int32)
    cell = np.clip(cell, 0, np.array(surfaces.shape[::-1]) - 1)
    column, row = np.ascontiguousarray(cell.T)
    on_ground = surfaces.top[row, column] <= surfaces.ground[row, column]
    return Impacts(
        place, velocity, np.ascontiguousarray(table[:, 4]),
        np.ascontiguousarray(table[:, 6]), np.where(on_ground, GROUND, OBSTACLE).astype(np.uint8),
        row, column, ids,
    )  # fmt: skip


# ---- where water goes on an object


def solid_cells(surfaces):
    """Return the mask of the cells that have an object above the ground, (ny, nx)."""
    return np.subtract(surfaces.top, surfaces.ground, dtype=np.float64) > LOWEST


def _catchments(surfaces):
    """Return each cell's drip point, and the edge cell and the lower cell of each point.

    Water takes the shortest way to an edge along the object, around what it would have to climb.
    """
    top = surfaces.top.astype(np.float64)
    ny, nx = top.shape
    solid = solid_cells(surfaces)
    point = np.full((ny, nx), -1, np.int32)
    if not solid.any():
        return point, np.zeros((0, 2), np.int64), np.zeros((0, 2), np.int64)
    drop = np.zeros((ny, nx))  # to the lowest neighbour
    lowest = np.zeros((ny, nx), np.uint8)  # its number in NEIGHBOURS
    framed = np.pad(top, 1, mode="edge")
    for n, (dj, di) in enumerate(NEIGHBOURS):
        fall = top - framed[1 + dj : 1 + dj + ny, 1 + di : 1 + di + nx]
        deeper = fall > drop
        np.copyto(drop, fall, where=deeper)
        lowest[deeper] = n
    edge = solid & (drop > STEP)
    del framed, fall, deeper, drop  # float64 maps of millions of cells
    # One point gathers the edge cells of a small square: the lowest of them.
    side = max(round(GATHERING / surfaces.spacing), 1)
    edge_row, edge_column = np.nonzero(edge)
    order = np.argsort(top[edge_row, edge_column], kind="stable")
    edge_row, edge_column = edge_row[order], edge_column[order]
    square = (edge_row // side) * (nx // side + 1) + edge_column // side
    _, first, which = np.unique(square, return_index=True, return_inverse=True)
    chosen = np.stack([edge_row[first], edge_column[first]], axis=1)
    point[solid] = -2
    if len(chosen):
        source = _nearest_edge(top, solid, edge_row * nx + edge_column, surfaces.spacing)
        number = np.full(ny * nx, -2, np.int32)
        number[edge_row * nx + edge_column] = which
        reached = source >= 0
        point.ravel()[reached] = number[source[reached]]
    foot = chosen + np.array(NEIGHBOURS)[lowest[chosen[:, 0], chosen[:, 1]]]
    return point, chosen, foot


def _nearest_edge(top, solid, edges, spacing):
    """Return for each cell the edge cell that its water reaches first, flat; -1 for none."""
    cells = np.flatnonzero(solid)  # the graph has only these: open ground would take 100 bytes each
    index = np.zeros(top.shape, np.int32)
    index.reshape(-1)[cells] = np.arange(len(cells))
    starts, ends, costs = [], [], []
    for a, b in (
        (np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[:-1], np.s_[1:]), (np.s_[1:], np.s_[:-1]),
    ):  # fmt: skip
        rise = top[a] - top[b]  # of water that flows from b to a
        joined = solid[a] & solid[b] & (np.abs(rise) <= STEP)
        starts.append(index[a][joined])
        ends.append(index[b][joined])
        costs.append(spacing + CLIMB * np.maximum(rise[joined], 0.0))
    graph = sparse.csr_array(
        (np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))), (len(cells),) * 2
    )
    edges = index.reshape(-1)[edges]
    _, _, nearest = sparse.csgraph.dijkstra(
        graph, indices=edges, min_only=True, return_predecessors=True
    )
    source = np.full(top.size, -1, np.int32)
    reached = nearest >= 0  # else -9999
    source[cells[reached]] = cells[nearest[reached]]
    return source
