"""Cars on a wet road over time: tyres take water from it, throw it, and it comes down again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim.actors.motion import Motion
from rainsim.actors.wheels import MOST_WHEELS, REMEDY
from rainsim.errors import ParameterError
from rainsim.io.states import AT, NO_THROWS, NO_TRACKS, THROW_COLUMNS
from rainsim.numerics.random import mix, subkey
from rainsim.rain.throws import (
    REMEMBERED,
    SLOWEST,
    column,
    flown,
    mist_left,
    mist_share,
    parcels_of,
    thrown_rates,
)
from rainsim.rain.wind import wind_at
from rainsim.terrain.table import class_table
from rainsim.water.landings import Landings
from rainsim.water.tracks import REACH, blur_weights, lay_tracks

LEFT = 1e-4  # m of water that stays in the road's texture under a tyre; an assumption
LONGEST_STEP = 1 / 24  # s: within it a tyre rolls straight at one speed
FASTEST = 100.0  # m/s, 360 km/h: what is faster is a track that jumps or a wrong scale
OFF_THE_ROAD = 0.3  # m: a wheel farther from the ground of the map stands on something else
BEFORE = 1.5  # s before the first frame that cars have driven already
PATCH = 0.12  # m: radius of the patch on which a parcel comes down
STANDS = 0.05  # m over the bed: what is higher stops drops
WIND_AT = 1.0  # m: height of the wind that carries drops and mist
SHOULDER = 1.0  # cells: deviation with which the edges of tracks are softened


class _Car(NamedTuple):
    """An actor with tyres."""

    motion: Motion
    covered: np.ndarray  # (n,), whether the car's floor is behind the tyre
    section: float  # m2


class _Way(NamedTuple):
    """The way of a tyre in a step."""

    begin: np.ndarray  # (3,) [m]
    end: np.ndarray
    middle: np.ndarray  # (3,) [m], of the car at the end
    rows: np.ndarray  # of the cells of the road that it passes
    columns: np.ndarray


class Tyres:
    """The tyres of the cars on a terrain and the water that they have thrown.

    Parameters
    ----------
    terrain : Terrain
    seed : int
    roughness : float [m]
        See `rain.wind.wind_shares`.

    Attributes
    ----------
    lifted, returned, kept, gone : float [m3]
        Water that the tyres took from the road; the part of it that came down on the ground, on
        things that stand there, and beside the map.

    Raises
    ------
    ParameterError
        If a car's box is none of a road vehicle, or its track faster than `FASTEST`.
    """

    def __init__(self, terrain, seed=0, roughness=0.0):
        self._terrain, self._roughness = terrain, roughness
        self._key = mix(np.array([seed % 2**64], np.uint64) ^ np.uint64(0x7912E5))
        motions = [footprint.motion for footprint in terrain.footprints]
        self._cars = [_car(motion) for motion in motions if len(motion.wheels)]
        for car in self._cars:
            _require_possible(car.motion)
        self.lifted = self.returned = self.kept = self.gone = self._mist = 0.0
        self._throws, self._ids = NO_THROWS, np.zeros(0, np.uint64)
        self._own = np.zeros(0)  # share of each throw that the account has
        self._landings, self._rolled = Landings(), None
        self._passed = np.zeros(terrain.grid.shape, bool) if self._cars else None
        self._box = None  # first row, first column, last row, last column of all that was passed
        spacing = terrain.grid.spacing
        step = max(1, round(PATCH / 3 / spacing))  # cells between those that take a share
        reach = step * math.ceil(PATCH / (step * spacing))
        j, i = np.mgrid[-reach : reach + 1 : step, -reach : reach + 1 : step]
        near = np.hypot(j, i) * spacing <= max(PATCH, 0.5 * spacing)
        self._patch = np.stack([j[near], i[near]])
        self._stands = terrain.top - terrain.bed > STANDS

    def start(self, solver, weather, time=0.0):
        """Let cars drive for a while before a time [s], so that the first frame has their spray.

        Returns
        -------
        WaterReport or None
            Of the water without what they threw; None without cars.
        """
        if not self._cars:
            return None
        for k in range(math.ceil(BEFORE / LONGEST_STEP), 0, -1):
            stop = time - (k - 1) * LONGEST_STEP
            self._step(solver, time - k * LONGEST_STEP, stop, weather)
        return solver.advance(0.0)

    def roll(self, solver, start, stop, weather):
        """Let cars roll from `start` to `stop` [s], and the water they have thrown come down.

        Parameters
        ----------
        solver : WaterSolver
        start, stop : float [s]
        weather : Weather
        """
        if not self._cars:
            return
        count = max(1, math.ceil((stop - start) / LONGEST_STEP - 1e-6))
        times = np.linspace(start, stop, count + 1)
        for k in range(count):
            self._step(solver, float(times[k]), float(times[k + 1]), weather)

    def throws(self):
        """Return the table of throws that may still be in the air, and its ids."""
        return self._throws.copy(), self._ids.copy()

    def come(self, depth, weather, number):
        """Return the depth of a window's water when cars have come to it, see `WindowTyres`."""
        return depth

    def state(self, depth, time):
        """Return throws, their ids and tracks over water of a depth, as `SimState` takes them."""
        throws, ids = self.throws()
        return {"throws": throws, "throw_id": ids, "tracks": self.tracks(depth)}

    def tracks(self, depth):
        """Return how full the film is where tyres have passed, uint8 (ny, nx) of 255.

        Parameters
        ----------
        depth : ndarray of shape (ny, nx) [m]
            Of the water.

        Returns
        -------
        ndarray
            255 where none has passed; of shape (0, 0) where none has passed at all.
        """
        if self._box is None:
            return NO_TRACKS
        part = self.passed()
        tracks = np.full(self._passed.shape, 255, np.uint8)
        lay_tracks(
            depth[part], self._passed[part], self._terrain.ground_class[part],
            class_table().column("storage"), np.float32(LEFT), blur_weights(SHOULDER),
            tracks[part],
        )  # fmt: skip
        return tracks

    def passed(self):
        """Return rows and columns, two slices, of what `tracks` looks at; None if it is nothing."""
        if self._box is None:
            return None
        return self._passed_part(math.ceil(REACH * SHOULDER) + 1)  # the blur reaches no farther

    def _passed_part(self, margin=0):
        """Return rows and columns, two slices, about all that tyres have passed."""
        low, high = self._box[:2], self._box[2:]
        return tuple(slice(max(a - margin, 0), b + 1 + margin)
                     for a, b in zip(low, high, strict=True))  # fmt: skip

    def book(self, ledger, time):
        """Return a `Ledger` with the water that tyres have thrown in it.

        The solver books what is lifted as drained and what comes down as rain.
        """
        if not self._cars:
            return ledger
        hanging = float((mist_left(self._throws, time) * self._own).sum())
        return replace(
            ledger, drained=ledger.drained - self.lifted, rain=ledger.rain - self.returned,
            airborne=ledger.airborne + (self._landings.own + hanging),
            obstacles=ledger.obstacles + self.kept,
            outflow=ledger.outflow + (self.gone + self._mist - hanging),
        )  # fmt: skip

    def _step(self, solver, start, stop, weather):
        """Throw the water that tyres meet in a step, and land water that has flown long enough."""
        wind = weather.wind(0.5 * (start + stop)) * float(wind_at(WIND_AT, self._roughness))
        rows, ids, own = [], [], []
        tick = round(stop / (LONGEST_STEP / 64))
        for number, car, k, way in self._ways(start, stop):
            row, share = self._throw(solver, car, k, way, start, stop, wind)
            if row is not None:
                row[AT["car"]] = number
                rows.append(row)
                ids.append((number * MOST_WHEELS + k, tick))
                own.append(share)
        if rows:
            table, (wheel, moment) = np.array(rows), np.array(ids, np.int64).T
            ids = subkey(subkey(self._key, wheel), moment)
            own = np.array(own)
            self._mist += float((column(table, "mist") * own).sum())
            self._throws = np.concatenate([self._throws, table])
            self._ids = np.concatenate([self._ids, ids])
            self._own = np.concatenate([self._own, own])
            self._landings.add(self._landings_of(table, ids, own))
        recent = column(self._throws, "end") > stop - REMEMBERED
        self._throws, self._ids = self._throws[recent], self._ids[recent]
        self._own = self._own[recent]
        self._land(solver, stop)

    def _ways(self, start, stop):
        """Return the ways of all tyres that throw water in a step from `start` to `stop` [s].

        Number of the car, the car, number of its tyre and the `_Way`. Those of the last step are
        kept: on a device they are asked for twice.
        """
        if self._rolled is None or self._rolled[0] != (start, stop):
            self._rolled = (start, stop), list(self._found_ways(start, stop))
        return self._rolled[1]

    def _found_ways(self, start, stop):
        for number, car in enumerate(self._cars):
            poses = car.motion.coming(start), car.motion.coming(stop)
            if poses[0] is None or poses[1] is None:
                continue
            ways = [pose.places(car.motion.wheels[:, :3]) for pose in poses]
            middle = poses[1].places(car.motion.box[:1])[0]
            for k, (begin, end) in enumerate(zip(*ways, strict=True)):
                if math.hypot(*(end - begin)[:2]) / (stop - start) < SLOWEST:
                    continue
                rows, columns = self._cells_under(begin, end, car.motion.wheels[k, 3])
                if len(rows):
                    yield number, car, k, _Way(begin, end, middle, rows, columns)

    def _cells_under(self, begin, end, width):
        """Return rows and columns of the cells of the road that a tyre of a width [m] passes."""
        rows, columns = _swept(self._terrain.grid, begin, end, float(width))
        if len(rows):
            off = np.abs(self._terrain.bed[rows, columns] - 0.5 * (begin + end)[2])
            rows, columns = (a[off < OFF_THE_ROAD] for a in (rows, columns))
        return rows, columns

    def _throw(self, solver, car, k, way, start, stop, wind):
        """Take the water in the path of one tyre.

        Returns
        -------
        row : ndarray or None
            Of the table of throws.
        share : float
            Of it that the account has.
        """
        begin, end, middle, rows, columns = way
        width, radius = car.motion.wheels[k, 3:]
        step = np.hypot(*(end - begin)[:2])
        speed = step / (stop - start)
        grid = self._terrain.grid
        self._passed[rows, columns] = True
        box = rows.min(), columns.min(), rows.max(), columns.max()
        self._box = box if self._box is None else (
            *np.minimum(self._box[:2], box[:2]), *np.maximum(self._box[2:], box[2:]))  # fmt: skip
        lifted, own = self._taken(solver, rows, columns, stop)
        if lifted <= 0:
            return None, 0.0
        self.lifted += own
        depth = lifted / (len(rows) * grid.cell_area)
        rates = thrown_rates(depth, width, speed)
        volumes = lifted * rates / rates.sum()
        mist = volumes * mist_share(speed, car.section)
        out = 0.5 * (begin + end)[:2] - middle[:2]
        ahead = (end - begin)[:2] / step
        out -= (out @ ahead) * ahead
        length = np.hypot(*out)
        out = out / length if length > 0 else np.array([-ahead[1], ahead[0]])
        row = np.zeros(len(THROW_COLUMNS))
        row[: AT["bow"]] = (
            start, stop, *begin, *end[:2], *out, width, radius, car.covered[k], 0, *wind,
            car.section, depth,
        )  # fmt: skip
        row[AT["bow"] : AT["mist"]] = volumes - mist
        row[AT["mist"]] = mist.sum()
        return row, own / lifted

    def _taken(self, solver, rows, columns, time):
        """Take the water of cells down to LEFT; return its volume and the account's part [m3]."""
        lifted = solver.lift(rows, columns, LEFT)
        return lifted, lifted

    def _landings_of(self, table, ids, own):
        """Return when and where the drops of a table of throws come down, see `Landings`."""
        parcels = parcels_of(table, ids)
        place, _ = flown(parcels, parcels.age)
        cell = np.floor((place[:, :2] - self._terrain.grid.origin) / self._terrain.grid.spacing)
        volume = parcels.volume
        lands = parcels.begin + parcels.age
        return np.column_stack([lands, cell[:, ::-1], volume, volume * own[parcels.row]])

    def _land(self, solver, time):
        """Bring down the thrown water that lands up to a time [s]: parcels, each on a patch."""
        down, (ny, nx) = self._landings.due(time), self._terrain.grid.shape
        row, column = (down[:, 1:3].astype(np.int64)[..., None] + self._patch).swapaxes(0, 1)
        inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
        row, column = row[inside], column[inside]
        each = down[:, 3:] / self._patch.shape[1]
        volume, own = (np.broadcast_to(a[:, None], inside.shape)[inside] for a in each.T)
        self.gone += float((each[:, 1] * (~inside).sum(axis=1)).sum())
        held = self._stands[row, column]
        self.kept += float(own[held].sum())
        self._put_down(solver, row[~held], column[~held], volume[~held], own[~held])

    def _put_down(self, solver, row, column, volume, own):
        """Put landed water [m3] on cells of the ground; `own` of it is in the account [m3]."""
        self.returned += float(own.sum())
        solver.deposit(row, column, volume)


def _car(motion):
    """Return the `_Car` of an actor's motion."""
    wheels, size = motion.wheels, motion.box[1]
    covered = wheels[:, 0] > wheels[:, 0].min() + 0.5 * wheels[:, 4]
    return _Car(motion, covered, float(size[1] * size[2]))


def _swept(grid, begin, end, width):
    """Return rows and columns of the cells whose middles a tyre passes over on a straight way."""
    half, spacing, first, middles = 0.5 * max(width, grid.spacing), grid.spacing, [], []
    for a, b, least, count in zip(begin, end, grid.origin, grid.shape[::-1], strict=False):
        low = max(math.floor((min(a, b) - half - least) / spacing), 0)
        high = min(math.ceil((max(a, b) + half - least) / spacing), count)
        first.append(low)
        middles.append(least + (np.arange(low, high) + 0.5) * spacing - a)
    (x, y), way = middles, (end - begin)[:2]
    y, length = y[:, None], np.hypot(*way)
    along, aside = (x * way[0] + y * way[1]) / length, (y * way[0] - x * way[1]) / length
    rows, columns = np.nonzero((along >= 0) & (along < length) & (np.abs(aside) < half))
    return rows + first[1], columns + first[0]


def _require_possible(motion):
    """Raise ParameterError if an actor with tyres is faster than any car while it is there."""
    speed = motion.speeds()
    if len(speed) and speed.max() > FASTEST:
        k, actor = int(speed.argmax()), motion.actor
        raise ParameterError(
            f"actor {actor.id} moves at {speed[k]:.4g} m/s from {actor.track.time[k]:g} s on; what "
            f"has tyres must move at {FASTEST:g} m/s at most; {REMEDY}, or hide it there"
        )
