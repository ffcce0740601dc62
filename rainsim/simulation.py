"""Rain on terrain over time: standing water at the start, then rain, flow and ripples.

`simulate` yields the state at each frame's time. A state holds all that a picture needs besides
the capture, the terrain and the seed: the drops in the air follow from the seed alone. Ground and
objects take the rain evenly, as its rate and their shelter say: a cell gets tens of drops a second,
and which ones is not seen in its depth. The drops that ring are listed on the ripples' tile.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from rainsim.config.settings import mm_per_hour
from rainsim.drops import Surfaces, Weather, flat_surfaces, impacts
from rainsim.errors import counted
from rainsim.grid import WaterSolver
from rainsim.io.states import SimState
from rainsim.rain.exposure import rain_exposure
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.shading.wetness import evaporation_rate
from rainsim.terrain.poured import with_standing
from rainsim.terrain.table import DRAIN
from rainsim.terrain.types import NO_TOPS
from rainsim.water.keyframed import moved_water
from rainsim.water.on_objects import Objects
from rainsim.water.puddles import WET, doubt, low_ground, probability, puddles_of, wet_share
from rainsim.water.ripples import RippleTile, mean_chord, tile_impacts
from rainsim.water.streams import with_streams
from rainsim.water.top_water import TopWater

RIPPLE_DEPTHS = (2e-3, 0.1)  # m: films thinner carry no rings, deeper water is deep to them
RIPPLE_WARM_UP = 5.0  # s of rain before the first frame: then rings come and go in balance
DRIP_WARM_UP = 1.0  # s of it for the edges of objects: the longest fall from them
WARM_UP_STEP = 1 / 15  # s
DRAIN_INTAKE = 0.1  # m/s that a grating takes at most: 8 l/s through an opening of 0.08 m2


def surfaces_of(terrain):
    """Return the `Surfaces` that drops can hit on a terrain."""
    grid, heights = terrain.grid, (terrain.bed, terrain.top, terrain.underside)
    return Surfaces(grid.spacing, grid.origin, *heights)


def steady_water(terrain, config, exposure, time):
    """Return depth [m], velocity [m/s] and notes: rain until a time [s] at rest, and its streams.

    `exposure` is the share of the rain that reaches the ground.
    """
    now, fallen = config.at(time), Weather(config).fallen(time)
    depth, notes = initial_water(terrain, now, exposure, fallen)
    return *with_streams(terrain, depth, now.rain.rate * exposure), notes


def initial_water(terrain, config, exposure, fallen=0.0):
    """Return the depth [m] at the start, and notes: a given level or past rain at rest."""
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


def simulate(terrain, config, dtype=np.float32, first=None):
    """Yield the `SimState` at the time of each frame, from the first on, without end.

    Parameters
    ----------
    terrain : Terrain
    config : Config
    dtype : dtype
        Of the water; float64 closes the ledger to rounding.
    first : int, optional
        Number of the first state, where the terrain is that of a leg of a drive: water then begins
        with the streams of steady rain, see `steady_water`.

    Examples
    --------
    >>> states = rainsim.simulate(terrain, config)
    >>> state = next(states)
    >>> isinstance(state, rainsim.SimState), bool(state.depth.max() > 0)
    (True, True)
    >>> bool(abs(state.ledger["residual"]) < 1e-6)
    True
    """
    index = first or 0
    begun = index / config.fps
    start, weather = config.at(begun), Weather(config)
    wind = usual_wind(config), config.rain.roughness
    moving = MovingSurfaces(terrain, *wind)
    surfaces, exposure = moving.still, rain_exposure(terrain, *wind)
    area = float(exposure.sum()) * terrain.grid.cell_area
    by_keyframes = moved_water(terrain, config, exposure, begun)
    solver = water_solver(terrain, start, dtype)
    if first is None:
        (depth, notes), velocity = initial_water(terrain, start, exposure), ()
    else:
        depth, velocity, notes = steady_water(terrain, config, exposure, begun)
    solver.set_state(depth, *velocity)
    notes = (*notes, solver.choice) if first is None else notes
    ripples = ripple_tile(config, weather, depth, terrain.grid.spacing)
    objects = Objects(surfaces, start, *tops_of(terrain, config, start))
    warm_up(ripples, objects, weather, begun)
    objects.open_account()
    depth = velocity = None  # the maps of the start are let go
    report, number = None, index
    while True:
        time = index / config.fps
        if index > number:
            before = (index - 1) / config.fps
            rate, drips, rings = rain_on(objects, weather, ripples.size, area, before, time)
            solver.deposit(*drips)
            if rings is not None:
                ripples.advance(time - before, *rings)
                solver.sources.shelter(moving.thinned(exposure, 0.5 * (before + time)))
            by_keyframes(solver, objects, before, time)
            report = solver.advance(time - before, rain=rate)
        deep = np.array(solver.depth, np.float32)
        flow = np.stack(solver.velocity).astype(np.float32, copy=False)
        ledger = objects.ledger(report, solver).as_dict()
        yield SimState(
            index, time, deep, flow, ripples.slopes(), ripples.size, ledger,
            notes if index == number else (), *objects.falling(),
            top_water=objects.top_water(),
        )  # fmt: skip
        index += 1


def ripple_tile(config, weather, depth, spacing):
    """Return the `RippleTile` of a run over water of a depth (ny, nx) [m]."""
    film, rate = config.water.surface_film, weather.mean_rate
    chord = mean_chord(depth, spacing, RIPPLE_DEPTHS[0])
    deep = puddle_depth(depth)
    return RippleTile(depth=deep, film=film, chord=chord, rate=rate, dtype=np.float32)


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
    """Let the rain before a time [s] spread rings on the tile and wet the edges of objects."""
    for begin, end in _steps(RIPPLE_WARM_UP, time):
        rain = weather.field(begin, end)
        if rain is None:
            return
        ripples.advance(end - begin, *rings_of(ripples.size, rain, begin, end))
    for begin, end in _steps(DRIP_WARM_UP, time):
        # Edges hold many drops: what matters is how much falls, not which drops do.
        rate = mm_per_hour(weather.rate(0.5 * (begin + end)))
        objects.take_even_rain(rate * (end - begin))
        objects.advance(begin, end, weather)


def rain_on(objects, weather, size, area, before, time):
    """Let it rain on objects in an interval [s], and water fall from them.

    Returns rate : float [m/s]. Of the rain.
        drips : tuple of ndarray. What comes to the ground, see `Objects.advance`.
        rings : tuple of ndarray or None. Without rain there are none; see
            `rings_of`.
    """
    rate = mm_per_hour(weather.rate(0.5 * (before + time)))
    objects.take_even_rain(rate * (time - before))
    drips, rain = objects.advance(before, time, weather), weather.field(before, time)
    if rain is None:
        return rate, drips, None
    return rate, drips, rings_of(size, rain, before, time, objects.landed(), area)


def rings_of(size, rain, begin, end, drips=None, area=0.0):
    """Return what rings on a tile in an interval [s], as `ripples.tile_impacts` does.

    That is the rain on a level square of the tile's size [m], and its part of the `drips` that came
    to an `area` [m2].
    """
    square = _square(size)
    drops = tile_impacts(impacts(rain, square, begin, end), square.area, size, end)
    if drips is None or area <= 0:
        return drops
    more = tile_impacts(drips, area, size, end)
    return tuple(np.concatenate(both) for both in zip(drops, more, strict=True))


@lru_cache(2)
def _square(size):
    return flat_surfaces(size, size, size / 8)


def _steps(duration, time):
    """Return even steps of a warm-up up to a time, as (begin, end) [s]."""
    count = round(duration / WARM_UP_STEP)
    return [
        (time + (n - count) * WARM_UP_STEP, time + (n + 1 - count) * WARM_UP_STEP)
        for n in range(count)
    ]
