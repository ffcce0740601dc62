"""The paved ground of a made-up garden: its bed with dips, how far rain fills them, its colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.morphology import reconstruction
from skimage.segmentation import watershed

from benchmarks.day_shapes import Picture, grid_faces

CELL = 0.0125  # m between vertices
SLAB, JOINT = 0.5, 0.008  # m: width of a slab, half width of the joint beside it
FILM_ONLY = 1.5e-3  # m: dips that are nowhere deeper hold a film, no puddle
SPOT_SPACING = 0.0135  # m


@dataclass(frozen=True)
class Paving:
    """Paved ground at vertices, maps of shape (ny, nx), row = y, column = x, in metres."""

    x: np.ndarray
    y: np.ndarray
    bed: np.ndarray
    level: np.ndarray  # of the water, where depth is positive
    depth: np.ndarray  # of puddles; 0 without
    albedo: np.ndarray  # (ny, nx, 3)

    @property
    def slopes(self):
        """Slopes of the bed along x and y."""
        along_y, along_x = np.gradient(self.bed, CELL)
        return along_x, along_y

    @property
    def points(self):
        """The vertices, shape (ny, nx, 3) [m]."""
        return np.stack([*np.meshgrid(self.x, self.y), self.bed], axis=-1)

    def depth_at(self, x, y):
        """Return the depth [m] of puddles at places [m], 0 beside the paving."""
        at = [(y - self.y[0]) / CELL, (x - self.x[0]) / CELL]
        return ndimage.map_coordinates(self.depth, at, order=1, cval=0)


def smooth_noise(shape, width, seed):
    """Return noise of unit deviation, smoothed by `width` cells."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    noise = ndimage.gaussian_filter(noise, width, mode="reflect")
    return noise / noise.std()


def paved(low, high, dips, closed=(), rain=None, seed=0):
    """Return the `Paving` of slabs over a rectangle from `low` to `high` [m].

    `dips` are rows of x, y, depth and width [m]. No water leaves over the sides `closed` ("west",
    "east", "south", "north"). `rain` [m] has fallen on the whole paving and run into the dips;
    None: they are full.
    """
    nx, ny = (round((b - a) / CELL) + 1 for a, b in zip(low, high, strict=True))
    x, y = np.linspace(low[0], high[0], nx), np.linspace(low[1], high[1], ny)
    gx, gy = np.meshgrid(x, y)
    i, j = np.floor(gx / SLAB).astype(int), np.floor(gy / SLAB).astype(int)
    rng = np.random.default_rng(5 + 10 * seed)
    tilt = rng.normal(0, 0.0012, (40, 40, 3))[j + 20, i + 20]
    across, along = gx / SLAB - i - 0.5, gy / SLAB - j - 0.5
    bed = 0.006 * smooth_noise((ny, nx), 0.45 / CELL, 1 + 10 * seed)
    for cx, cy, deep, wide in dips:
        bed -= deep * np.exp(-0.5 * ((gx - cx) ** 2 + 1.5 * (gy - cy) ** 2) / wide**2)
    bed += 0.00025 * smooth_noise((ny, nx), 0.04 / CELL, 2 + 10 * seed)
    slabs = tilt[..., 0] + 2 * tilt[..., 1] * across + 2 * tilt[..., 2] * along
    bed += ndimage.gaussian_filter(slabs, 1.0)
    bed -= np.median(bed)
    joint = np.minimum(0.5 - abs(across), 0.5 - abs(along)) * SLAB < JOINT
    bed -= 0.0012 * ndimage.gaussian_filter(joint.astype(float), 0.7)
    tone = 0.33 + 0.035 * rng.normal(size=(40, 40))[j + 20, i + 20]
    tone += 0.02 * smooth_noise(bed.shape, 0.03 / CELL, 3 + 10 * seed)
    tone += 0.015 * smooth_noise(bed.shape, 0.25 / CELL, 4 + 10 * seed)
    tone = np.where(joint, 0.16, np.clip(tone, 0.18, 0.5))
    tone = ndimage.gaussian_filter(tone, 0.6)
    level = spill_level(bed, closed)
    if rain is not None:
        level = filled_level(bed, level, rain)
    depth = np.where(level > bed + 1e-6, level - bed, 0)
    lake, count = ndimage.label(depth > 0)
    deepest = ndimage.maximum(depth, lake, np.arange(count + 1))
    deepest[0] = 0
    depth = np.where(deepest[lake] > FILM_ONLY, depth, 0)
    return Paving(x, y, bed, level, depth, tone[..., None] * np.array([1.04, 1.0, 0.93]))


def spill_level(bed, closed=()):
    """Return the level [m] of full dips: the lowest height over which their water can leave."""
    seed = np.full_like(bed, bed.max())
    edges = {"south": np.s_[0], "north": np.s_[-1], "west": np.s_[:, 0], "east": np.s_[:, -1]}
    for side, edge in edges.items():
        if side not in closed:
            seed[edge] = bed[edge]
    return reconstruction(seed, bed, method="erosion")


def filled_level(bed, full, rain):
    """Return the level [m] of dips into which `rain` [m] has run from all that drains to them.

    All ground drains to some dip, none of it straight over an edge. What a dip cannot hold leaves
    for good: the dips do not feed each other.
    """
    lake = ndimage.label(full > bed + 1e-6)[0]
    catchment = watershed(full + 1e-9 * bed, lake)
    level = bed.copy()
    for k, where in enumerate(ndimage.find_objects(lake), 1):
        inside = lake[where] == k
        heights = np.sort(bed[where][inside])
        volume = rain * (catchment == k).sum()  # in cells
        # Volume below each height of the dip: heights are filled one after the other.
        below = np.arange(1, len(heights) + 1) * heights - np.cumsum(heights)
        cells = np.searchsorted(below, volume, side="right")
        reached = (volume + heights[:cells].sum()) / cells
        spill = full[where][inside][0]
        level[where] = np.where(inside, np.minimum(reached, spill), level[where])
    return level


def add_paving(shapes, paving, seed=2):
    """Add a paving to the shapes: the open ground, and the bed under the puddles apart from it."""
    along_x, along_y = paving.slopes
    normals = np.stack([-along_x, -along_y, np.ones_like(along_x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points, albedo = paving.points.reshape(-1, 3), paving.albedo.reshape(-1, 3)
    wet = paving.depth > 0
    under = wet[:-1, :-1] & wet[1:, 1:] & wet[:-1, 1:] & wet[1:, :-1]
    for part, keep in (("paving", ~under), ("bed", under)):
        faces = grid_faces(*paving.bed.shape, keep)
        shapes.add_mesh(part, points, faces, albedo, normals.reshape(-1, 3))
    half = CELL / 2
    bounds = (paving.x[0] - half, paving.x[-1] + half, paving.y[0] - half, paving.y[-1] + half)
    shapes.pictures["paving"] = shapes.pictures["bed"] = Picture(paving.albedo, bounds)
    x, y = np.meshgrid(
        np.arange(paving.x[0] + SPOT_SPACING / 2, paving.x[-1], SPOT_SPACING),
        np.arange(paving.y[0] + SPOT_SPACING / 2, paving.y[-1], SPOT_SPACING),
    )
    rng = np.random.default_rng(seed)
    x = x + rng.uniform(-0.2, 0.2, x.shape) * SPOT_SPACING
    y = y + rng.uniform(-0.2, 0.2, y.shape) * SPOT_SPACING
    at = [(y - paving.y[0]) / CELL, (x - paving.x[0]) / CELL]
    slope_x, slope_y, z = (
        ndimage.map_coordinates(values, at, order=1, mode="nearest").ravel()
        for values in (along_x, along_y, paving.bed)
    )
    normal = np.stack([-slope_x, -slope_y, np.ones(x.size)], axis=-1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    position = np.stack([x.ravel(), y.ravel(), z], axis=-1)
    shapes.add_spots("paving", position, normal, [1.0, 0, 0], SPOT_SPACING)
    return rng
