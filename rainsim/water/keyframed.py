"""Water that keyframes move: past rain that grows, a level that rises and falls."""

import numpy as np

from rainsim.water.puddles import puddles_of


def past_rain_growth(terrain, config, exposure, begin=0.0):
    """Return how past rain that keyframes let grow fills the puddles, or None if it is steady.

    The function that is returned takes two times [s] and returns the rows, columns and volumes [m3]
    of the water that has come to rest between them. Time passes quickly there: the water does not
    flow but is put where it would stand (fill, spill and merge), and the ledger does not hold what
    runs off or seeps away meanwhile.

    exposure : float32 array (ny, nx). See `rain.exposure.rain_exposure`.
    begin : float [s]. Time of the first state.
    """
    past = [config.at(time).rain.past for time in config.key_times()]
    if np.ptp(past) == 0 or config.at(0.0).water.level is not None:
        return None
    puddles = puddles_of(terrain)
    puddles.rain(config.rain.puddles * config.at(begin).rain.past * exposure.astype(np.float64))

    def between(before, time):
        more = config.at(time).rain.past - config.at(before).rain.past
        stood = puddles.depth
        if more > 0:
            puddles.rain(config.rain.puddles * more * exposure.astype(np.float64))
        grown = np.maximum(puddles.depth - stood, 0.0)
        rows, columns = np.nonzero(grown)
        return (
            rows.astype(np.int32), columns.astype(np.int32),
            grown[rows, columns] * terrain.grid.cell_area,
        )  # fmt: skip

    return between


def level_changes(terrain, config):
    """Return how water follows a level that keyframes move, or None if it is steady.

    The function that is returned takes two times [s] and returns the rows, columns and volumes [m3]
    that a level surface gains between them, negative where it falls. Water in hollows stays there
    as puddles when the level falls below their rims.
    """
    times = config.key_times()
    levels = [config.at(time).water.level for time in times]
    if levels[0] is None or np.ptp(levels) == 0:
        return None
    bed = terrain.bed.astype(np.float64)
    low, hollows = np.percentile(bed, 5), 0.0
    if np.diff(levels).min() < 0:
        full = puddles_of(terrain)
        full.rain(np.ptp(bed) + 1.0)  # more than they hold
        hollows = full.depth

    def stands(time):
        level = config.at(time).water.level
        highest = max([level, *(h for t, h in zip(times, levels, strict=True) if t <= time)])
        left = np.minimum(hollows, low + highest - bed)
        return np.maximum(np.maximum(low + level - bed, left), 0.0)

    def between(before, time):
        gained = (stands(time) - stands(before)) * terrain.grid.cell_area
        rows, columns = np.nonzero(gained)
        return rows.astype(np.int32), columns.astype(np.int32), gained[rows, columns]

    return between


def moved_water(terrain, config, exposure, begin=0.0):
    """Return how keyframes move water, see `past_rain_growth` and `level_changes`.

    The function that is returned takes a solver, the `Objects` that book what comes from outside,
    and two times [s].
    """
    growth = past_rain_growth(terrain, config, exposure, begin)
    change = level_changes(terrain, config)

    def move(solver, objects, before, time):
        if growth is not None:
            solver.deposit(*growth(before, time))
        if change is not None:
            objects.let_in(solver, *change(before, time))

    return move
