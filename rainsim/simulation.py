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
from rainsim.drops import GROUND, OBSTACLE, Surfaces, Weather, flat_surfaces, impacts
from rainsim.errors import InputError, counted
from rainsim.grid import WaterSolver
from rainsim.io.arrays import TEXT, Field, read_arrays, write_arrays
from rainsim.io.files import json_number, parsed_json
from rainsim.ledger import SUPPLY, WHEREABOUTS
from rainsim.rain.dripping import DRIP_COLUMNS
from rainsim.rain.exposure import computed_exposure, rain_exposure
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.rain.throws import AT, COLUMNS, NO_THROWS, column
from rainsim.shading.wetness import evaporation_rate
from rainsim.terrain.poured import with_standing
from rainsim.terrain.table import DRAIN
from rainsim.terrain.types import NO_TOPS
from rainsim.water.begin import Begin, low_ground
from rainsim.water.keyframes import level_changes, past_rain_growth
from rainsim.water.on_objects import Objects
from rainsim.water.puddles import WET, doubt, probability, puddles_of, wet_share
from rainsim.water.ripples import RippleTile, mean_chord, tile_impacts
from rainsim.water.streams import run_in, run_off, with_streams
from rainsim.water.top_water import TopWater
from rainsim.water.tyres import NO_TRACKS
from rainsim.water.window_tyres import tyres_of

RIPPLE_DEPTHS = (2e-3, 0.1)  # m: films thinner carry no rings, deeper water is deep to them
RIPPLE_WARM_UP = 5.0  # s of rain before the first frame: then rings come and go in balance
DRIP_WARM_UP = 1.0  # s of it for the edges of objects: the longest fall from them
WARM_UP_STEP = 1 / 15  # s
WINDOW_DEPTH, WINDOW_CHORD = 5e-3, 0.5  # m of the puddles that rings of all windows run on; usual
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
    throws : ndarray of shape (t, 22), float64
        What tyres have thrown that may be in the air, see `tyres.COLUMNS`.
    throw_id : ndarray of shape (t,), uint64
    tracks : ndarray of shape (ny, nx) or (0, 0), uint8
        How full the film is where tyres have passed, of 255; see `Tyres.tracks`. Of a window
        over all that lies around it.
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
    throws: np.ndarray = field(default_factory=NO_THROWS.copy)
    throw_id: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint64))
    tracks: np.ndarray = field(default_factory=NO_TRACKS.copy)

    def shown_by(self, index):
        """Return this state as the one that the frame `index` shows."""
        return replace(self, index=index)


def surfaces_of(terrain):
    """Return the `Surfaces` that drops can hit on a terrain."""
    grid, heights = terrain.grid, (terrain.bed, terrain.top, terrain.underside)
    return Surfaces(grid.spacing, grid.origin, *heights)


def steady_water(terrain, config, number, beyond=None):
    """Return the `Begin` at a state: the rain until then at rest, and the streams of steady rain.

    Parameters
    ----------
    terrain : Terrain
    config : Config
    number : int
    beyond : Terrain, optional
        What lies about the map, in wider cells: its water comes in by streams.
    """
    time = number / config.fps
    now, fallen = config.at(time), Weather(config).fallen(time)

    def still(ground):
        exposure = computed_exposure(ground, usual_wind(config), config.rain.roughness)
        return exposure, initial_water(ground, now, exposure, fallen), now.rain.rate * exposure

    exposure, (depth, notes), rain = still(terrain)
    inflow = ()
    if beyond is not None and now.rain.rate > 0:
        _, (standing, _), coarse = still(beyond)
        inflow = run_in(run_off(beyond, standing, coarse), beyond.grid, terrain.grid)
    return Begin(number, *with_streams(terrain, depth, rain, inflow), notes, exposure)


def widened(state, window, begun):
    """Return the state of a window over all that lies around it, where the water stands still.

    Tracks of tyres are those of all that lies around it already.

    Parameters
    ----------
    state : SimState
    window : tuple of slice
        Rows and columns of the window.
    begun : ndarray of shape (ny, nx), float32 [m]
        Depth at the start, in the window and around it.
    """
    depth = begun.copy()
    depth[window] = state.depth
    velocity = np.zeros((2, *depth.shape), np.float32)
    velocity[(slice(None), *window)] = state.velocity
    return replace(state, depth=depth, velocity=velocity)


def initial_water(terrain, config, exposure, fallen=0.0):
    """Return the depth [m] (ny, nx) at the start, and notes: a given level or past rain at rest.

    `fallen` [m] is the rain that has come since the past rain.
    """
    if config.water.level is not None:
        level = low_ground(terrain) + config.water.level
        depth = np.maximum(level - terrain.bed.astype(np.float64), terrain.water)
        note = f"still water at {config.water.level:g} m above the low ground"
        return with_standing(terrain, depth), (note,)
    puddles = puddles_of(terrain)
    stands = config.rain.past * config.rain.puddles + fallen
    puddles.rain(np.multiply(exposure, stands, dtype=np.float64))
    if config.rain.drying > 0:
        puddles.evaporate(evaporation_rate(config) * config.rain.drying)
    sure, warning = probability(terrain, puddles.depth), doubt(terrain, config.rain.past)
    likely = "" if sure is None else f" (probability of water where it is shown {sure:.0%})"
    count = counted(puddles.count(), "puddle") + likely
    return with_standing(terrain, puddles.depth), (
        f"{config.rain.past * 1e3:g} mm of past rain stand at rest in {count}; "
        f"{wet_share(puddles.depth, terrain.sealed):.0%} of the paving under {WET * 1e3:g} mm or "
        f"more; {puddles.graph.dropped} of {puddles.graph.count} hollows left out as noise",
        *([warning] if warning else []),
    )


def puddle_depth(depth):
    """Return the depth [m] for rings: the median of the depths that can carry them."""
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


def simulate(terrain, config, progress=None, dtype=np.float32, begin=None):
    """Yield the `SimState` at the time of each frame, from the first on, without end.

    Parameters
    ----------
    terrain : Terrain
    config : Config
    progress : callable, optional
        progress(stage, done, total) is called before the slow first state.
    dtype : dtype
        Of the water; float64 closes the ledger to rounding.
    begin : Begin, optional
        Of the first state, where the terrain is one of several windows of the ground. The rings on
        the water are then those of every other window.

    Examples
    --------
    >>> states = rainsim.simulate(terrain, config)
    >>> state = next(states)
    >>> isinstance(state, rainsim.SimState), bool(state.depth.max() > 0)
    (True, True)
    >>> bool(abs(state.ledger["residual"]) < 1e-6)
    True
    """
    first = begin.number if begin else 0
    begun = first / config.fps
    start, weather = config.at(begun), Weather(config)
    wind = usual_wind(config), config.rain.roughness
    moving = MovingSurfaces(terrain, *wind)
    surfaces, exposure = moving.still, begin.exposure if begin else rain_exposure(terrain, *wind)
    whole = _area(terrain, exposure)
    puddle_growth = past_rain_growth(terrain, config, exposure, begun)
    level_change = level_changes(terrain, config)
    solver = water_solver(terrain, start, dtype)
    tyres = tyres_of(terrain, config, begin)
    if begin:  # cars have come before the water's account opens
        begin = begin._replace(depth=tyres.come(begin.depth, weather, first))
    depth, notes = _filled(solver, terrain, start, exposure, begin)
    ripples = ripple_tile(config, weather, None if begin else (depth, terrain.grid.spacing))
    objects = Objects(surfaces, start, *tops_of(terrain, config, start), keep=begin is None)
    warm_up(ripples, objects, weather, begun)
    objects.open_account()
    in_window, begin, depth = begin is not None, None, None  # the maps of the start are let go
    index, hits, report = first, None, tyres.start(solver, weather, begun)
    while True:
        time = index / config.fps
        if index > first:
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
            tyres.roll(solver, before, time, weather)
            if rain and in_window:
                rings_on(ripples, rain, before, time)
            elif rain:  # rings of both
                rings = objects.with_drips(landed, before, time)
                area = whole if opened is exposure else _area(terrain, opened)
                ripples.advance(time - before, *tile_impacts(rings, area, ripples.size, time))
            if level_change is not None:  # what keyframes move
                objects.let_in(solver, *level_change(before, time))
            if puddle_growth is not None:
                solver.deposit(*puddle_growth(before, time))
            report = solver.advance(time - before, rain=fine)
        deep, met = np.array(solver.depth, np.float32), _met(hits)
        ledger = tyres.book(objects.ledger(report, solver), time)
        hits = landed = fine = opened = None  # tens of MB that nobody needs while a frame is drawn
        yield SimState(
            index, time, deep, _velocity(solver), ripples.slopes(), ripples.size, *met, ledger,
            notes if index == first else (), *objects.falling(),
            top_water=objects.top_water(), **tyres.state(deep, time),
        )  # fmt: skip
        index += 1


def _velocity(solver):
    """Return the velocity at cell centres as a state has it."""
    return np.stack(solver.velocity).astype(np.float32, copy=False)


def _filled(solver, terrain, start, exposure, begin):
    """Give a solver the water of the start; return its depth [m] (ny, nx), and notes."""
    if begin is not None:
        solver.set_state(begin.depth, *begin.velocity)
        return begin.depth, begin.notes
    depth, notes = initial_water(terrain, start, exposure)
    solver.set_state(depth)
    return depth, (*notes, solver.choice)


def ripple_tile(config, weather, water=None):
    """Return the `RippleTile` of a run.

    Parameters
    ----------
    config : Config
    weather : Weather
    water : tuple, optional
        Depth (ny, nx) [m] at the start and cell size [m] of the only map; windows, which must agree
        on their rings, have those of usual puddles.
    """
    depth, chord = WINDOW_DEPTH, WINDOW_CHORD
    if water is not None:
        depth, chord = puddle_depth(water[0]), mean_chord(*water, RIPPLE_DEPTHS[0])
    film, rate = config.water.surface_film, weather.mean_rate
    return RippleTile(depth=depth, film=film, chord=chord, rate=rate, dtype=np.float32)


def _area(terrain, share):
    return float(share.sum()) * terrain.grid.cell_area


def _met(hits):
    """Return the positions, diameters and kinds of `Impacts`, or of none, as a state has them."""
    if hits is None:
        return np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.uint8)
    position, diameter = (np.asarray(a, np.float32) for a in (hits.position, hits.diameter))
    return position, diameter, np.asarray(hits.kind, np.uint8)


def tops_of(terrain, config, start):
    """Return the `TopWater` of a terrain and how much of it has dried at the start [m]."""
    dried = evaporation_rate(start) * start.rain.drying
    return TopWater(tops_drawn(terrain, config)), dried


def tops_drawn(terrain, config):
    """Return the terrain, without its tops if the settings leave them out."""
    return terrain if config.render.tops == "auto" else replace(terrain, tops=NO_TOPS)


def usual_wind(config):
    """Return the mean wind of the keyframes, (speed [m/s], direction [rad]), for shelter."""
    winds = [config.at(time).rain.wind_velocity for time in config.key_times()]
    x, y = np.mean(winds, axis=0)
    return math.hypot(x, y), math.atan2(y, x)


def warm_up(ripples, objects, weather, time=0.0):
    """Let the rain before a time [s] spread rings on the tile and wet the edges of objects.

    Parameters
    ----------
    ripples : RippleTile
    objects : Objects
    weather : Weather
    time : float [s]
    """
    for begin, end in _steps(RIPPLE_WARM_UP, time):
        rain = weather.field(begin, end)
        if rain is None:
            return
        rings_on(ripples, rain, begin, end)
    for begin, end in _steps(DRIP_WARM_UP, time):
        # Edges hold many drops: what matters is how much falls, not which drops do.
        rate = mm_per_hour(weather.rate(0.5 * (begin + end)))
        objects.take_even_rain(rate * (end - begin))
        objects.advance(begin, end, weather)


def rings_on(ripples, rain, begin, end):
    """Let the drops that fall on a level square the size of the tile make rings there."""
    square = flat_surfaces(ripples.size, ripples.size, ripples.size / 8)
    landed = impacts(rain, square, begin, end)
    ripples.advance(end - begin, *tile_impacts(landed, square.area, ripples.size, end))


def _steps(duration, time):
    """Return even steps of a warm-up up to a time, as (begin, end) [s]."""
    count = round(duration / WARM_UP_STEP)
    return [
        (time + (n - count) * WARM_UP_STEP, time + (n + 1 - count) * WARM_UP_STEP)
        for n in range(count)
    ]


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
    "throws": Field("float64", ("throws", len(COLUMNS)), -LONGEST, LONGEST),
    "throw_id": Field("uint64", ("throws",), 0, 2**64 - 1),
    "tracks": Field("uint8", ("tracks ny", "tracks nx"), 0, 255),
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
        (found["tracks"].shape not in ((0, 0), found["depth"].shape),
         "its tracks are those of another height map"),
        (not _are_thrown(found["throws"]), "its tyres do not roll"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"{path} is no {STATE} of rainsim ({text}); {STATE_REMEDY}")
    return SimState(
        index=int(found["index"]), time=float(found["time"]), tile_size=float(found["tile_size"]),
        ledger=facts["ledger"], notes=tuple(facts["notes"]),
        **{n: found[n] for n in _FIELDS},
    )  # fmt: skip


def _are_volumes(ledger):
    """Whether a value read from JSON is an account of volumes."""
    names = (*SUPPLY, *WHEREABOUTS)
    return isinstance(ledger, dict) and all(json_number(ledger.get(n)) is not None for n in names)


def _are_texts(notes):
    return isinstance(notes, list) and all(isinstance(note, str) for note in notes)


def _are_thrown(table):
    """Whether the rows of a table of throws have a duration, a way and no negative volumes."""
    lasts = column(table, "end") > column(table, "begin")
    rolls = (table[:, AT["x"] : AT["y"] + 1] != table[:, AT["x_end"] : AT["y_end"] + 1]).any(axis=1)
    sizes = table[:, [AT["width"], AT["radius"], *range(AT["section"], len(COLUMNS))]]
    return bool((lasts & rolls & (sizes >= 0).all(axis=1)).all())


def _fall(drips):
    """Whether the rows of drips have a size and fall for a while."""
    diameter, begin, end = drips[:, 4], drips[:, 5], drips[:, 6]
    fits = (diameter > 0) & (diameter <= LARGEST_DROP)
    return bool((fits & (end >= begin) & (end - begin <= LONGEST_FALL)).all())
