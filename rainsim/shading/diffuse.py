"""Captured gloss removed from wet surfaces, which get the gloss of the rainy day instead.

A capture keeps the gloss of its own day in the harmonics: a table top mirrors the sky of that day.
What water darkens is the diffuse part, and what it mirrors is drawn again. So level
surfaces that are wet show the colour of their darker views, the same from all sides.
"""

import dataclasses

import numpy as np

from rainsim.constants import SH_0
from rainsim.numerics.blocks import in_blocks
from rainsim.shading.bodies import EDGE, STEP, TOP

ON_TOP = 0.05  # m below the highest surface of its cell within which a splat lies open to the rain
RINGS = (0.03, 8), (0.06, 16)  # m around a cell, and places on them that heights are compared at
SAME = 0.01  # m, by which level places differ at most
FEWEST, ENOUGH = 0.12, 0.22  # share of places as high: none is level, and all
GREEN = 0.15  # excess of green over the largest channel, of leaves
STEPS = 16  # of wetness between which colours are made again


def level_share(scene, terrain, reach, lawn, bodies):
    """Return each splat's share in smooth surfaces that are open to the rain, float32, 0 to 1.

    That are level surfaces and smooth bodies.

    reach : float32 array (ny, nx). Share of the rain that reaches the ground.
    lawn : float32 array (ny, nx). Share of grass, which has no gloss to lose.
    bodies : uint8 array (ny, nx, 3). See `bodies.body_map`.
    """
    cells, share = level_cells(terrain, reach, lawn), np.empty(len(scene.splats), np.float32)

    def work(part):
        some = scene.splats.take(part), scene.ground_frame, terrain
        share[part] = np.maximum(share_of_level(*some, cells), share_of_bodies(*some, bodies))

    in_blocks(work, len(share))
    return share


def share_of_bodies(splats, frame, terrain, bodies):
    """Return how far each splat belongs to a smooth body, (n,) float32, 0 to 1; leaves do not."""
    if not bodies.size:
        return np.zeros(len(splats), np.float32)
    place = frame.to_ground(splats.position.astype(np.float64))
    row, column, inside = terrain.grid.cells(place[:, 0], place[:, 1])
    low, high = (bodies[row, column, k].astype(np.float32) for k in range(2))
    high %= TOP
    z = (place[:, 2] - terrain.bed[row, column]) / STEP
    found = inside & (high > 0) & (z > low - float(EDGE)) & (z < high + float(EDGE))
    r, g, b = np.clip(splats.sh[found, 0] * SH_0 + 0.5, 0, 1).T
    green = 2 * g - r - b > GREEN * np.maximum(np.maximum(r, g), b)
    share = np.zeros(len(splats), np.float32)
    share[found] = ~green
    return share


def level_cells(terrain, reach, lawn):
    """Return how far each cell's highest surface is level and open to the rain, (ny, nx), 0 to 1.

    The parameters are those of `level_share`.
    """
    level = levelness(terrain.top, terrain.grid.spacing)
    stands = terrain.top - terrain.bed > ON_TOP
    return level * np.where(stands, 1.0, reach * (1 - lawn))


def share_of_level(splats, frame, terrain, cells):
    """Return each splat's share in level surfaces that are open to the rain, 0 to 1."""
    place = frame.to_ground(splats.position.astype(np.float64))
    row, column, inside = terrain.grid.cells(place[:, 0], place[:, 1])
    away = np.abs(place[:, 2] - terrain.top[row, column])
    found = cells[row, column] * np.clip(2 - away / ON_TOP, 0, 1)
    return np.where(inside, found, 0).astype(np.float32)


def levelness(height, spacing):
    """Return how level a height map (ny, nx) [m] is in each cell, 0 to 1, up to edges of steps.

    Level is what has enough places around it that are as high: a corner of a table has a quarter.
    """
    height = np.asarray(height, np.float32)
    padded = {}
    count = np.zeros(height.shape, np.float32)
    for distance, places in RINGS:
        angle = 2 * np.pi * np.arange(places) / places
        for x, y in zip(np.cos(angle), np.sin(angle), strict=True):
            column, row = round(distance * x / spacing), round(distance * y / spacing)
            reach = max(abs(column), abs(row))
            if reach not in padded:
                padded[reach] = np.pad(height, reach, mode="edge")
            ny, nx = height.shape
            there = padded[reach][reach + row :, reach + column :][:ny, :nx]
            count += np.abs(there - height) < SAME
    share = count / sum(places for _, places in RINGS)
    return np.clip((share - FEWEST) / (ENOUGH - FEWEST), 0, 1)


def without_gloss(splats, diffuse, share):
    """Return splats of which a share has the colour `diffuse` from all sides.

    diffuse : array (n, 3). Display-referred.
    share : float32 array (n,). 0: as captured, 1: diffuse.
    """
    if not share.any():
        return splats
    sh = splats.sh.copy()

    def work(part):
        which = np.flatnonzero(share[part])
        if len(which):
            which += part.start
            mixed = sh[which] * (1 - share[which])[:, None, None]
            plain = (diffuse[which].astype(np.float32) - 0.5) / np.float32(SH_0)
            mixed[:, 0] += share[which, None] * plain
            sh[which] = mixed

    in_blocks(work, len(share))
    return dataclasses.replace(splats, sh=sh)


def step_of(wet):
    """Return a wetness (0 to 1) in STEPS, so that colours change seldom while things dry."""
    return round(float(wet) * STEPS) / STEPS
