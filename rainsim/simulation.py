"""Rain on terrain over time: standing water at the start, then drops, flow and ripples.

`simulate` yields the state at each frame's time. A state holds all that a picture needs besides
the capture, the terrain and the seed: the drops in the air follow from the seed alone.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace

import numpy as np

from rainsim.config.settings import mm_per_hour
from rainsim.drops import GROUND, OBSTACLE, Surfaces, Weather, flat_surfaces, impacts, joined
from rainsim.errors import InputError
from rainsim.grid import WaterSolver
from rainsim.io.arrays import TEXT, Field, read_arrays, write_arrays
from rainsim.io.files import json_number, parsed_json
from rainsim.ledger import SUPPLY, WHEREABOUTS, Ledger
from rainsim.rain.dripping import DRIP_COLUMNS, Drips, drip_impacts
from rainsim.rain.exposure import rain_exposure
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.shading.wetness import evaporation_rate
from rainsim.terrain.table import DRAIN
from rainsim.terrain.types import NO_TOPS
from rainsim.water.keyframes import level_changes, past_rain_growth
from rainsim.water.puddles import WET, doubt, puddles_of, wet_share
from rainsim.water.ripples import RippleTile, mean_chord, tile_impacts
from rainsim.water.top_water import TopWater

RIPPLE_DEPTHS = (2e-3, 0.1)  # m: films thinner carry no rings, deeper water is deep to them
RIPPLE_WARM_UP = 5.0  # s of rain before the first frame: then rings come and go in balance
DRIP_WARM_UP = 1.0  # s of it for the edges of objects: the longest fall from them
WARM_UP_STEP = 1 / 15  # s
SMALLEST_ROOM = 1e-30  # m3, keeps tops without water from a division by zero
DRAIN_INTAKE = 0.1  # m/s that a grating takes at most: 8 l/s through an opening of 0.08 m2


@dataclass(frozen=True)
class SimState:
    """Water at one frame's time.

    Attributes
    ----------
    index : int
        Of the frame.
    time : float [s]
    depth : ndarray of shape (ny, nx), float32 [m]
    velocity : ndarray of shape (2, ny, nx), float32 [m/s]
        u, v at cell centres.
    slopes : ndarray of shape (2, n, n), float32
        Ripple slopes d eta/dx and d eta/dy on a periodic tile of `tile_size`.
    tile_size : float [m]
    impact_position : ndarray of shape (k, 3), float32 [m]
        Where drops hit between the frame before and this one.
    impact_diameter : ndarray of shape (k,), float32 [m]
    impact_kind : ndarray of shape (k,), uint8
        `drops.GROUND` (or the water on it) or `drops.OBSTACLE`.
    ledger : dict
        Volumes in m3, see `rainsim.ledger`.
    notes : tuple of str
    drips : ndarray of shape (m, 9), float64
        Drops from edges that are in the air or have just landed, see `dripping.DRIP_COLUMNS`.
    drip_id : ndarray of shape (m,), uint64
    top_water : ndarray of shape (n,), float64 [m3]
        On each of the terrain's tops, see `water.top_water`.
    """

    index: int
    time: float
    depth: np.ndarray
    velocity: np.ndarray
    slopes: np.ndarray
    tile_size: float
    impact_position: np.ndarray
    impact_diameter: np.ndarray
    impact_kind: np.ndarray
    ledger: dict
    notes: tuple = ()
    drips: np.ndarray = field(default_factory=lambda: np.zeros((0, len(DRIP_COLUMNS))))
    drip_id: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint64))
    top_water: np.ndarray = field(default_factory=lambda: np.zeros(0))


def surfaces_of(terrain):
    """Return the `Surfaces` that drops can hit on a terrain."""
    return Surfaces(
        spacing=terrain.grid.spacing, origin=terrain.grid.origin, ground=terrain.bed,
        top=terrain.top, underside=terrain.underside,
    )  # fmt: skip


def low_ground(terrain):
    """Return the height of the low ground [m], over which water levels are given."""
    return float(np.percentile(terrain.bed.astype(np.float64), 5))


def initial_water(terrain, config, exposure):
    """Return the depth [m] (ny, nx) at the start, and notes: a given level or past rain at rest."""
    bed = terrain.bed.astype(np.float64)
    if config.water.level is not None:
        level = low_ground(terrain) + config.water.level
        depth = np.maximum(level - bed, terrain.water)
        return depth, (f"still water at {config.water.level:g} m above the low ground",)
    puddles = puddles_of(terrain)
    puddles.rain(config.rain.past * exposure.astype(np.float64))
    if config.rain.drying > 0:
        puddles.evaporate(evaporation_rate(config) * config.rain.drying)
    wet = wet_share(puddles.depth, terrain.sealed)
    warning = doubt(terrain, config.rain.past)
    return puddles.depth, (
        f"{config.rain.past * 1e3:g} mm of past rain stand at rest in {puddles.count()} puddles; "
        f"{wet:.0%} of the paving under {WET * 1e3:g} mm or more; {puddles.graph.dropped} of "
        f"{puddles.graph.count} hollows left out as noise",
        *([warning] if warning else []),
    )


def puddle_depth(depth):
    """Return the depth [m] that rings run on: the median of what is deep enough to carry them."""
    deep = depth[depth > RIPPLE_DEPTHS[0]]
    return float(np.clip(np.median(deep) if deep.size else 0.0, *RIPPLE_DEPTHS))


def water_solver(terrain, config, dtype=np.float32):
    """Return the `WaterSolver` of a terrain, friction and infiltration by class."""
    still = config.water.level is not None
    # A flood stands because the land around is flooded too; rain runs off an open map.
    return WaterSolver(
        terrain.bed, terrain.grid.spacing, scheme=config.water.scheme,
        boundary="wall" if still else "open",
        manning=terrain.by_class("manning"),
        storage=terrain.by_class("storage"),
        infiltration=None if still else terrain.by_class("infiltration"),
        courant=config.water.courant,
        drains=None if still else drains_of(terrain), dtype=dtype,
    )  # fmt: skip


def drains_of(terrain):
    """Return the cells of the drains as (row, column, rate [m3/s]), as `WaterSolver` takes them."""
    rows, columns = np.nonzero(terrain.ground_class == DRAIN)
    rate = DRAIN_INTAKE * terrain.grid.cell_area
    return [(int(row), int(column), rate) for row, column in zip(rows, columns, strict=True)]


def simulate(terrain, config, progress=None, dtype=np.float32):
    """Yield the `SimState` at the time of each frame, from frame 0 on, without end.

    Parameters
    ----------
    terrain : Terrain
    config : Config
    progress : callable, optional
        progress(stage, done, total) is called before the slow first state.
    dtype : dtype
        Of the water; float64 closes the ledger to rounding.

    Examples
    --------
    >>> states = rainsim.simulate(terrain, config)
    >>> state = next(states)
    >>> isinstance(state, rainsim.SimState), bool(state.depth.max() > 0)
    (True, True)
    >>> bool(abs(state.ledger["residual"]) < 1e-6)
    True
    """
    start, weather = config.at(0.0), Weather(config)
    from_where = usual_wind(config), config.rain.roughness
    moving = MovingSurfaces(terrain, *from_where)
    surfaces, exposure = moving.still, rain_exposure(terrain, *from_where)
    open_area = float(exposure.sum()) * terrain.grid.cell_area
    puddle_growth = past_rain_growth(terrain, config, exposure)
    level_change = level_changes(terrain, config)
    depth, notes = initial_water(terrain, start, exposure)
    solver = water_solver(terrain, start, dtype)
    solver.set_state(depth)
    ripples = RippleTile(
        depth=puddle_depth(depth),
        film=config.water.surface_film,
        chord=mean_chord(depth, terrain.grid.spacing, RIPPLE_DEPTHS[0]),
        rate=weather.mean_rate,
        dtype=np.float32,
    )
    objects = Objects(surfaces, start, TopWater(tops_drawn(terrain, config)))
    warm_up(ripples, objects, weather)
    objects.open_account()
    index, hits, report = 0, None, None
    while True:
        time = index / config.fps
        if index > 0:
            before = (index - 1) / config.fps
            hits, fine = None, 0.0
            rain = weather.field(before, time)
            if rain is not None:  # drops on ground and objects; the finest as a rate
                middle = 0.5 * (before + time)
                opened = moving.thinned(exposure, middle)
                fine = rain.spectrum.fine_rate * opened
                hits = impacts(rain, moving.at(middle), before, time)
                landed = hits.take(hits.kind == GROUND)
                solver.deposit(landed.row, landed.column, landed.volume)
                objects.take_rain(hits, rain.spectrum.fine_rate * (time - before))
            solver.deposit(*objects.advance(before, time, weather))  # drips from objects
            if rain is not None:  # rings of both
                rings = objects.with_drips(landed, before, time)
                area = open_area
                if opened is not exposure:
                    area = float(opened.sum()) * terrain.grid.cell_area
                ripples.advance(time - before, *tile_impacts(rings, area, ripples.size, time))
            if level_change is not None:  # what keyframes move
                objects.let_in(solver, *level_change(before, time))
            if puddle_growth is not None:
                solver.deposit(*puddle_growth(before, time))
            report = solver.advance(time - before, rain=fine)
        u, v = solver.velocity
        yield SimState(
            index, time, np.array(solver.depth, np.float32),
            np.stack([u, v]).astype(np.float32), ripples.slopes(), ripples.size,
            _of_hits(hits, "position", (0, 3)), _of_hits(hits, "diameter", (0,)),
            _of_hits(hits, "kind", (0,), np.uint8), objects.ledger(report, solver),
            notes if index == 0 else (), *objects.falling(),
            top_water=objects.top_water(),
        )  # fmt: skip
        index += 1


def _of_hits(hits, name, shape, dtype=np.float32):
    return np.zeros(shape, dtype) if hits is None else np.asarray(getattr(hits, name), dtype)


class Objects:
    """The water on what stands above the ground, with its account; drips from it if asked for.

    Attributes
    ----------
    drips : Drips or None
    initial, inflow : float [m3]
        What was on the objects when the account was opened, and what has risen from outside.
    tops : TopWater
    """

    def __init__(self, surfaces, start, tops):
        rain, wet = start.rain, start.rain.past > 0 or start.water.level is not None
        self.drips = Drips(surfaces, rain.seed, wet) if rain.drips else None
        self._surfaces, self._roughness = surfaces, rain.roughness
        self.initial = self._came = self._returned = self._kept = self.inflow = 0.0
        self.tops = tops
        self._on_tops = tops.after(rain.past, evaporation_rate(start) * rain.drying)
        if self.drips is not None:
            self._fill_tops()

    def _fill_tops(self):
        """Give each drip point the room that the tops above it have, and the water of past rain."""
        points, count, tops = self.drips.point, len(self.drips.room), len(self._on_tops)
        room, top = self.tops.room()
        over = (points >= 0) & (top >= 0)
        pairs, which = np.unique(points[over] * tops + top[over], return_inverse=True)
        self._point, self._top = np.divmod(pairs, max(tops, 1))
        self._room = np.bincount(which, room[over], len(pairs))
        self._room_of = np.bincount(self._point, self._room, count)
        share = self._on_tops / np.maximum(self.tops.capacity, SMALLEST_ROOM)
        self._held_of = np.bincount(self._point, self._room * share[self._top], count)
        self.drips.hold(self._room_of, self._held_of)

    def top_water(self):
        """Return the water on each top now [m3], (n,)."""
        if self.drips is None or not len(self._on_tops):
            return self._on_tops.copy()
        return self._on_each(np.maximum(self._room_of - self.drips.room, 0.0))

    def top_water_after(self, rain):
        """Return the water on each top [m3] (n,) after `rain` [m] that falls evenly."""
        if self.drips is None or not len(self._on_tops):
            return self._on_tops.copy()
        points = self.drips.point
        cells = np.bincount(points[points >= 0], minlength=len(self._room_of))
        came = cells * self._surfaces.spacing**2 * rain
        return self._on_each(np.minimum(self._held_of + came, self._room_of))

    def _on_each(self, held):
        """Return the water on each top [m3] of what is `held` behind each drip point [m3]."""
        share = held / np.maximum(self._room_of, SMALLEST_ROOM)
        parts = len(self._on_tops)
        mine = np.bincount(self._top, self._room * share[self._point], parts)
        return (
            mine
            / np.maximum(np.bincount(self._top, self._room, parts), SMALLEST_ROOM)
            * (self.tops.capacity)
        )

    def open_account(self):
        """Count what is on the objects and in the air now as there from the start."""
        self._came = self._returned = self._kept = 0.0
        if self.drips is not None:
            self.initial = self.drips.held + self.drips.airborne

    def take_rain(self, hits, fine_depth):
        """Give the objects what fell on them, and a depth [m] of finer rain."""
        if self.drips is not None:
            self._came += self.drips.take_rain(hits, fine_depth)
        else:
            fallen = float(hits.volume[hits.kind != GROUND].sum())
            self._came += fallen
            self._kept += fallen

    def take_even_rain(self, depth):
        """Give the objects a depth [m] of rain that falls evenly."""
        if self.drips is not None:
            self._came += self.drips.take_even_rain(depth)

    def let_in(self, solver, rows, columns, volumes):
        """Give the ground water that rises from outside, and take what falls."""
        more, less = volumes > 0, volumes < 0
        solver.deposit(rows[more], columns[more], volumes[more])
        solver.withdraw(rows[less], columns[less], -volumes[less])
        self.inflow += float(volumes[more].sum())

    def advance(self, start, stop, weather):
        """Return the rows, columns and volumes [m3] of what comes down from them."""
        if self.drips is None:
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        wind = weather.wind(0.5 * (start + stop)), self._roughness
        rows, columns, volumes = self.drips.advance(start, stop, *wind)
        self._returned += float(volumes.sum())
        return rows, columns, volumes

    def with_drips(self, hits, start, stop):
        """Return `hits` and the drips that came to the ground from `start` to `stop` [s]."""
        if self.drips is None:
            return hits
        drips = drip_impacts(*self.drips.falling(), self._surfaces, start, stop)
        return joined(hits, drips.take(drips.kind == GROUND))

    def falling(self):
        """Return the drips in the air and their ids, as `SimState` holds them."""
        return () if self.drips is None else self.drips.falling()

    def ledger(self, report, solver):
        """Return the solver's ledger with the objects' water in it, as a dict."""
        held, airborne = self._kept, 0.0
        if self.drips is not None:
            held, airborne = held + self.drips.held, self.drips.airborne
        ledger = solver.ledger if report is None else report.ledger
        return self.with_objects(ledger, self._came, self._returned, held, airborne, self.inflow)

    def with_objects(self, ledger, came, returned, held, airborne, inflow):
        """Return a solver's ledger as a dict, with the objects' water [m3] in it.

        `came` to the objects, `returned` to the ground, is `held` on them, is `airborne` as drips
        now, or came as `inflow` from outside the map.
        """
        ledger = ledger.as_dict()
        ledger["initial"] += self.initial
        # The solver books water from objects and from outside as rain.
        ledger["rain"] += came - returned - inflow
        ledger["inflow"] += inflow
        ledger["obstacles"] += held
        ledger["airborne"] += airborne
        return Ledger.from_dict(ledger).as_dict()


def tops_drawn(terrain, config):
    """Return the terrain, without its tops if the settings leave them out."""
    return terrain if config.render.tops == "auto" else replace(terrain, tops=NO_TOPS)


def usual_wind(config):
    """Return the mean wind of the keyframes, (speed [m/s], direction [rad]): what shelters."""
    winds = [config.at(time).rain.wind_velocity for time in config.key_times()]
    x, y = np.mean(winds, axis=0)
    return math.hypot(x, y), math.atan2(y, x)


def warm_up(ripples, objects, weather):
    """Let the rain before the first frame spread rings on the tile and wet the edges of objects.

    Parameters
    ----------
    ripples : RippleTile
    objects : Objects
    weather : Weather
    """
    square = flat_surfaces(ripples.size, ripples.size, ripples.size / 8)
    for begin, end in _steps(RIPPLE_WARM_UP):
        rain = weather.field(begin, end)
        if rain is None:
            return
        landed = impacts(rain, square, begin, end)
        ripples.advance(end - begin, *tile_impacts(landed, square.area, ripples.size, end))
    for begin, end in _steps(DRIP_WARM_UP):
        # Edges hold many drops: what matters is how much falls, not which drops do.
        rate = mm_per_hour(weather.rate(0.5 * (begin + end)))
        objects.take_even_rain(rate * (end - begin))
        objects.advance(begin, end, weather)


def _steps(duration):
    """Return even steps up to time 0 of a warm-up, as (begin, end) [s]."""
    count = round(duration / WARM_UP_STEP)
    return [((n - count) * WARM_UP_STEP, (n + 1 - count) * WARM_UP_STEP) for n in range(count)]


# --- states on disk -------------------------------------------------------------------------------

STATE_VERSION = 1
STATE, STATE_REMEDY = "water state", "`rainsim simulate` writes it; simulate again"
FARTHEST, LONGEST = 1e7, 1e9  # m, s: places and times in a file
LONGEST_FALL, LARGEST_DROP = 500.0, 0.05  # s, m: of drips
_FIELDS = {
    "depth": Field("float32", ("ny", "nx"), 0, 1e5),
    "velocity": Field("float32", (2, "ny", "nx"), -1e4, 1e4),
    "slopes": Field("float32", (2, "tile cells", "tile cells"), -1e4, 1e4),
    "impact_position": Field("float32", ("impacts", 3), -FARTHEST, FARTHEST),
    "impact_diameter": Field("float32", ("impacts",), 0, LARGEST_DROP),
    "impact_kind": Field("uint8", ("impacts",), 0, max(GROUND, OBSTACLE)),
    "drips": Field("float64", ("drips", len(DRIP_COLUMNS)), -LONGEST, LONGEST),
    "drip_id": Field("uint64", ("drips",), 0, 2**64 - 1),
    "top_water": Field("float64", ("tops",), 0, 1e9),
}
_OTHERS = {
    "index": Field("int64", (), 0, 99_999),
    "time": Field("float64", (), 0, LONGEST),
    "tile_size": Field("float64", (), 0.01, 100),
    "ledger": Field(TEXT),
    "notes": Field(TEXT),
}


def write_state(path, state):
    """Write the `SimState` `state` to `path` as an uncompressed .npz."""
    others = {
        "index": np.int64(state.index), "time": np.float64(state.time),
        "tile_size": np.float64(state.tile_size), "ledger": json.dumps(state.ledger),
        "notes": json.dumps(state.notes),
    }  # fmt: skip
    write_arrays(path, STATE_VERSION, {n: getattr(state, n) for n in _FIELDS} | others)


def read_state(path, terrain=None):
    """Return the `SimState` that `write_state` wrote, all of it checked.

    Parameters
    ----------
    path : path-like
    terrain : Terrain, optional
        If given the state must be one of water on it.

    Examples
    --------
    >>> rainsim.write_state("00000.npz", state)
    >>> bool((rainsim.read_state("00000.npz", terrain).depth == state.depth).all())
    True
    """
    found = read_arrays(path, STATE, _FIELDS | _OTHERS, STATE_VERSION, STATE_REMEDY)
    facts = {"ledger": parsed_json(found["ledger"]), "notes": parsed_json(found["notes"])}
    tops = 0 if terrain is None else len(terrain.tops)
    for wrong, text in (
        (not _are_volumes(facts["ledger"]), "its ledger is not that of rainsim"),
        (not _are_texts(facts["notes"]), "its notes are not a list of texts"),
        (found["slopes"].shape[1] < 2, "its tile of ripples has no cells"),
        (not _fall(found["drips"]), "its drips do not fall"),
        (terrain is not None and found["depth"].shape != terrain.grid.shape,
         "it is not of this height map, whose shape is another"),
        (terrain is not None and len(found["top_water"]) not in (0, tops),
         "it is not of this height map, which has other tops"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"{path} is no {STATE} of rainsim ({text}); {STATE_REMEDY}")
    return SimState(
        index=int(found["index"]), time=float(found["time"]), tile_size=float(found["tile_size"]),
        ledger=facts["ledger"], notes=tuple(facts["notes"]), **{n: found[n] for n in _FIELDS},
    )  # fmt: skip


def _are_volumes(ledger):
    """Whether what was read from JSON is an account of volumes."""
    names = (*SUPPLY, *WHEREABOUTS)
    return isinstance(ledger, dict) and all(json_number(ledger.get(n)) is not None for n in names)


def _are_texts(notes):
    return isinstance(notes, list) and all(isinstance(note, str) for note in notes)


def _fall(drips):
    """Whether the rows of drips have a size and fall for a while."""
    diameter, begin, end = drips[:, 4], drips[:, 5], drips[:, 6]
    fits = (diameter > 0) & (diameter <= LARGEST_DROP)
    return bool((fits & (end >= begin) & (end - begin <= LONGEST_FALL)).all())
