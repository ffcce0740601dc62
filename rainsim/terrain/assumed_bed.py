"""The bed of ground that the capture does not know to the centimetre: a plane with a roughness.

Where few pictures overlap, splats of the ground are sheets before the cameras, some decimetres off.
The hollows among them are noise, and no water stands in them. What is known is that there is
ground, about how high, and of which colour. Its unevenness is assumed to be that of average roads.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from rainsim.terrain import bed as bedding
from rainsim.terrain.types import INFERRED, UNKNOWN

WINDOW = 0.45  # of the cameras' height about the level, within which splats may be the ground's
WITHOUT_CAMERAS = 1.6  # m, taken for the cameras' height where there are none
POOR = 0.06  # of the cameras' height: root mean square from which on the ground is not known
CELL = 1.0  # m, in which the splats below the level are gathered
LEAST_COVER = 0.05  # of a cell by such splats, for it to count
LAYER = 2.0  # times the scatter of the splats: half the thickness of the layer that they fill
SPREADS, LEAST_ALPHA = (0.25, 0.5, 1.0, 2.0, 4.0), 0.1  # m about splats that show the ground
THICK = 0.06  # m about the places of things, that they fill
STANDS = 0.5  # m over the layer of the ground, up to which what begins there stands on it
# Power spectral density of the height of a road along a line, G (n / N0)^-2 [m3] at n waves per
# metre: ISO 8608:2016, class C ("average"), geometric mean of its range.
DENSITY, N0 = 256e-6, 0.1  # m3, 1/m
WAVES = 4.0, 2.0, 1.0, 0.5, 0.25  # m, the octaves that are drawn; longer ones are slopes
OCTAVE = 2**0.5 - 2**-0.5  # integral of n^-2 over an octave about n, times n
# Variance of the random coefficients over that of an octave: splines spread a part of it to longer
# waves. The density is then met within 10 % from 0.2 to 1.4 waves per metre.
COEFFICIENTS = 14.0


def scatter_of(above, position, cover, height):
    """Return how far the splats of the ground scatter about its level [m]; 0 if it is known.

    Nothing lies below the ground, so what is found there is scatter, and as much lies above it.
    The root mean square of the heights below it is taken by places, and their median counts.

    Parameters
    ----------
    above : ndarray of shape (n,) [m]
        Heights of splats over the level of the ground.
    position : ndarray of shape (n, 2 or 3) [m]
    cover : ndarray of shape (n,) [m2]
    height : float [m]
        Of the cameras.
    """
    below = (above < 0) & (above > -WINDOW * height) & (cover > 0)
    if not below.any():
        return 0.0
    column, row = np.floor(position[below, :2] / CELL).astype(np.int64).T
    _, cell = np.unique(column * (np.ptp(row) + 1) + row, return_inverse=True)
    total = np.bincount(cell, cover[below])
    square = np.bincount(cell, cover[below] * above[below] ** 2)
    counted = total > LEAST_COVER * CELL**2
    if not counted.any():
        return 0.0
    found = float(np.median(np.sqrt(square[counted] / total[counted])))
    return found if found > POOR * height else 0.0


def bed_of(seen, grid):
    """Return bed [m], source, noise [m], colour and excess green of ground that is poorly known.

    Sheets before the cameras hardly cover the ground that they show, seen from above: so each cell
    has the colour of what is near, within the least of SPREADS that shows enough.

    Parameters
    ----------
    seen : rainsim.terrain.extract.Seen
        The splats about the bed, from above.
    grid : Grid
    """
    color, known = np.zeros((*grid.shape, 3), np.float32), np.zeros(grid.shape, bool)
    for spread in SPREADS:
        width = spread / grid.spacing
        alpha = bedding.blur(seen.alpha, width)
        new = (alpha > LEAST_ALPHA) & ~known
        for c in range(3):
            channel = bedding.blur(np.ascontiguousarray(seen.color[..., c]), width)
            color[new, c] = np.clip(channel[new] / alpha[new], 0, 1)
        known |= new
    green = 2 * color[..., 1] - color[..., 0] - color[..., 2]
    source = np.where(known, INFERRED, UNKNOWN).astype(np.uint8)
    return roughness(grid), source, np.zeros(grid.shape, np.float32), color, green


def cover(places, grid, bed, layer, ceiling):
    """Return top and underside [m] of what stands on or hangs over poorly known ground.

    Parameters
    ----------
    places : ndarray of shape (n, 3) [m]
        Of surfaces on which cameras agree: splats before few cameras look like things.
    grid : Grid
    bed : ndarray of shape (ny, nx) [m]
    layer : float [m]
        Half the thickness of the splats about the bed.
    ceiling : float [m]
        What is higher was hardly seen.
    """
    row, column, inside = grid.cells(places[:, 0], places[:, 1])
    inside &= (places[:, 2] > layer) & (places[:, 2] < ceiling)
    row, column, height = row[inside], column[inside], places[inside, 2].astype(np.float32)
    top, low = np.full(grid.shape, -np.inf, np.float32), np.full(grid.shape, np.inf, np.float32)
    np.maximum.at(top, (row, column), height)
    np.minimum.at(low, (row, column), height)
    size = 2 * max(1, round(THICK / grid.spacing)) + 1
    top, low = ndimage.maximum_filter(top, size), ndimage.minimum_filter(low, size)
    there = np.isfinite(top)
    low = np.where(low < layer + STANDS, bed, low)
    return np.where(there, top, bed), np.where(there, np.minimum(low, top), bed)


def roughness(grid, seed=0):
    """Return the heights [m] of an average road over a grid, ndarray of shape (ny, nx), float32.

    They depend on the place alone, not on the grid: octaves of cubic splines whose coefficients are
    random numbers on lattices through the origin. Under a straightedge of 3 m gaps are some 8 mm.
    """
    x, y = grid.centres()
    height = np.zeros(grid.shape, np.float32)
    for octave, wave in enumerate(WAVES):
        variance = DENSITY * N0**2 * wave * OCTAVE
        columns, across = _spline(2 * x / wave)
        rows, down = _spline(2 * y / wave)
        random = _normal(rows[:, None], columns[None, :], 97 * seed + octave)
        height += np.sqrt(np.float32(COEFFICIENTS * variance)) * (down @ random @ across.T)
    return height


def _spline(place):
    """Return the lattice points that bear on places (n,), and their weights (n, points)."""
    first = np.floor(place).astype(np.int64)
    t = place - first
    lattice = np.arange(first.min() - 1, first.max() + 3)
    weights = np.zeros((len(place), len(lattice)), np.float32)
    row, column = np.arange(len(place)), first - lattice[0]
    parts = (1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3
    for k, part in enumerate(parts):
        weights[row, column - 1 + k] = part / 6
    return lattice, weights


def _normal(row, column, seed):
    """Return a random number of mean 0 and variance 1 for each lattice point, float32."""
    with np.errstate(over="ignore"):
        h = row.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        h = (h ^ (h >> np.uint64(29))) + column.astype(np.uint64) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(32))) * np.uint64(0x94D049BB133111EB + 2 * seed)
        h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    # The sum of four uniform numbers of 16 bits is nearly normal.
    parts = sum(((h >> np.uint64(16 * k)) & np.uint64(0xFFFF)).astype(np.float32) for k in range(4))
    return (parts / np.float32(65536) - np.float32(2)) * np.float32(3**0.5)
