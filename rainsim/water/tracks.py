"""How full the film of a road is where tyres have rolled."""

import math

import numpy as np

from rainsim.jit import serial_kernel
from rainsim.rain.tyres import REMEMBERED, TICK

NO_TRACKS = np.zeros((0, 0), np.uint8)
FULL = 255
USUAL_FILM = 2e-4  # m, that rain has to fill before a track is gone; an assumption
KEPT = 0.1  # share of the film that stays in the road's texture under a tyre; an assumption
DEEP = 1.5e-3  # m: water that stands so deep closes behind a tyre at once


def tracks_of(rolls, terrain, depth, time, rain):
    """Return how full the film is where tyres have rolled, uint8 (ny, nx) of FULL.

    Where none has it is FULL; of shape (0, 0) where none has at all. The water has a `depth`
    (ny, nx) [m] at a time [s]; `rain` [m/s] fills the tracks, which last `REMEMBERED` at most.
    """
    lasts = min(REMEMBERED, USUAL_FILM / max(rain, 1e-12))
    age = time - rolls.tick * TICK
    rolls, age = rolls.take(age < lasts), age[age < lasts]
    if not len(age):
        return NO_TRACKS
    grid = terrain.grid
    half = 0.5 * np.maximum(rolls.width, grid.spacing)
    fresh = 1 - age / lasts
    ways = np.column_stack([
        (rolls.begin[:, :2] - grid.origin) / grid.spacing, rolls.way / grid.spacing,
        half / grid.spacing, fresh, np.full(len(age), TICK / lasts),
    ])  # fmt: skip
    worn = np.zeros(grid.shape, np.float32)
    wear(ways, worn)
    worn *= depth < DEEP
    tracks = np.rint(FULL * (1 - (1 - KEPT) * worn)).astype(np.uint8)
    return tracks


@serial_kernel
def wear(ways, worn_out):
    """Raise how fresh tracks are to that of each way, their edges softened over a cell.

    ways : float64 array (n, 7). Place, way (both x, y) and half the width, in
        cells; freshness at the begin, from 0 to 1; by how much it is more at the
        end. What is fresher than 1 is still to come.
    """
    ny, nx = worn_out.shape
    for n in range(len(ways)):
        x, y, way_x, way_y, half, fresh, more = ways[n]
        length, reach = math.hypot(way_x, way_y), half + 1
        left, right = math.floor(x + min(way_x, 0) - reach), math.ceil(x + max(way_x, 0) + reach)
        low, high = math.floor(y + min(way_y, 0) - reach), math.ceil(y + max(way_y, 0) + reach)
        for j in range(max(low, 0), min(high, ny)):
            for i in range(max(left, 0), min(right, nx)):
                off_x, off_y = i + 0.5 - x, j + 0.5 - y
                along = (off_x * way_x + off_y * way_y) / (length * length)
                aside = abs(off_y * way_x - off_x * way_y) / length
                now = fresh + along * more
                if 0 <= along < 1 and aside < reach and now <= 1:
                    cover = min(max(half + 0.5 - aside, 0.0), 1.0)
                    worn_out[j, i] = max(worn_out[j, i], np.float32(cover * now))
