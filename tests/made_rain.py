"""Rain on a terrain of 2 x 2 m over time, all hard and level unless said otherwise."""

import numpy as np

from rainsim import simulation, terrain
from rainsim.config.settings import Config, mm_per_hour

NY = NX = 40
SPACING = 0.05


def ground(bed=None, top=None, underside=None, grass=None):
    """A terrain of 2 x 2 m, all hard and level unless said otherwise."""
    zero = np.zeros((NY, NX), np.float32)
    bed = zero if bed is None else np.asarray(bed, np.float32)
    return terrain.Terrain(
        terrain.Grid((NY, NX), (-1.0, -1.0), SPACING), bed,
        bed if top is None else np.asarray(top, np.float32),
        bed if underside is None else np.asarray(underside, np.float32),
        np.full((NY, NX), terrain.MEASURED, np.uint8),
        np.zeros((NY, NX), np.uint8) if grass is None else np.asarray(grass, np.uint8),
        zero, np.full((NY, NX, 3), 0.5, np.float32),
    )  # fmt: skip


def centres():
    c = -1.0 + (np.arange(NX) + 0.5) * SPACING
    return np.meshgrid(c, c)


def states(terrain_, config, count, dtype=np.float32):
    run = simulation.simulate(terrain_, config, dtype=dtype)
    return [next(run) for _ in range(count)]


def config(**changes):
    base = {"rate": mm_per_hour(20.0), "past": 0.0, "wind": (0.0, 0.0), "fps": 20.0, "frames": 4}
    return Config().replace(**{**base, **changes})
