"""The parts of the made-up gardens: lawn, hedge, tree, rendered wall, planks."""

from __future__ import annotations

import numpy as np

from benchmarks.day_shapes import Picture, grid_faces, leaf_cards

LAWN, LEAF = np.array([0.075, 0.14, 0.035]), np.array([0.06, 0.125, 0.03])
CORE, BARK = (0.02, 0.03, 0.012), (0.09, 0.07, 0.05)
RENDER, WOOD = np.array([0.62, 0.55, 0.44]), np.array([0.30, 0.19, 0.105])
LAWN_STEP = 0.04  # m between vertices
LEAF_HALF = 0.055  # m
SHELL = 0.14  # m: leaves farther inside a hedge are left out, its dark core begins at 0.12


def lawn_height(x, y):
    """Return the height [m] of the lawn."""
    return -0.012 + 0.006 * np.sin(3.1 * x + 1) * np.sin(2.7 * y)


def lawn_albedo(x, y):
    """Return the mottled albedo of the lawn, shape (..., 3)."""
    fine = np.sin(9.1 * x + 3 * np.sin(2.3 * y)) * np.sin(8.3 * y + 2 * np.sin(1.9 * x))
    return (1 + 0.22 * fine + 0.15 * np.sin(1.3 * x + 0.7 * y))[..., None] * LAWN


def add_lawn(shapes, rng, low, high, spacing):
    """Add lawn over the rectangle from `low` to `high` [m], its splats `spacing` apart."""
    x, y = (np.linspace(a, b, round((b - a) / LAWN_STEP) + 1)
            for a, b in zip(low, high, strict=True))  # fmt: skip
    gx, gy = np.meshgrid(x, y)
    points = np.stack([gx, gy, lawn_height(gx, gy)], axis=-1).reshape(-1, 3)
    faces = grid_faces(len(y), len(x))
    shapes.add_mesh("lawn", points, faces, lawn_albedo(gx, gy).reshape(-1, 3))
    gx, gy = np.meshgrid(*(np.arange(a + spacing / 2, b, spacing)
                           for a, b in zip(low, high, strict=True)))  # fmt: skip
    gx = gx + rng.uniform(-0.2, 0.2, gx.shape) * spacing
    gy = gy + rng.uniform(-0.2, 0.2, gy.shape) * spacing
    points = np.stack([gx, gy, lawn_height(gx, gy) + 0.001], axis=-1).reshape(-1, 3)
    shapes.add_spots("lawn", points, [0, 0, 1.0], [1.0, 0, 0], spacing)


def paint_lawn(shapes, low, high):
    """Add the lawn's albedo from `low` to `high` [m] as a picture that can get a coat of water."""
    x, y = (np.arange(a + LAWN_STEP / 2, b, LAWN_STEP) for a, b in zip(low, high, strict=True))
    albedo = lawn_albedo(*np.meshgrid(x, y))
    bounds = (low[0], x[-1] + LAWN_STEP / 2, low[1], y[-1] + LAWN_STEP / 2)
    shapes.pictures["lawn"] = Picture(albedo, bounds)


def add_hedge(shapes, rng, low, high, height, count):
    """Add a hedge over a rectangle [m]: `count` leaves, those inside left out, about a core."""
    core = "core", (low[0] + 0.12, low[1] + 0.12, -0.05), (high[0] - 0.12, high[1] - 0.12)
    shapes.box(*core[:2], (*core[2], height - 0.12), CORE, 0.08)
    cards = leaf_cards(rng, count, (*low, 0), (*high, height), LEAF_HALF)
    x, y, z = cards.center.T
    inside = (x > low[0] + SHELL) & (x < high[0] - SHELL) & (y > low[1] + SHELL)
    inside &= (y < high[1] - SHELL) & (z < height - SHELL)
    cards = cards.take(~inside)
    add_leaves(shapes, rng, cards)


def add_leaves(shapes, rng, cards):
    """Add leaves of various greens."""
    tone = rng.uniform(0.7, 1.35, len(cards.center))[:, None]
    shapes.leaves("leaf", cards, tone * LEAF)


def add_tree(shapes, rng, place, trunk, crown, half_axes, count):
    """Add a tree at (x, y): a trunk of that height, `count` leaves in an ellipsoid about `crown`.

    The leaves stand in some hundred clusters, so that the sun falls through the gaps in patches.
    """
    shapes.tube("trunk", place, 0.11, -0.05, trunk, BARK, 0.012)
    clusters = rng.standard_normal((130, 3))
    clusters *= (rng.random(130) ** (1 / 3) / np.linalg.norm(clusters, axis=1))[:, None]
    cards = leaf_cards(rng, count, (-1, -1, -1), (1, 1, 1), 1.3 * LEAF_HALF)
    offset = 0.16 * rng.standard_normal((count, 3)) + clusters[rng.integers(0, 130, count)]
    move = np.asarray(crown) + np.asarray(half_axes) * offset - cards.center
    cards.corners[:] += move[:, None]
    cards.center[:] += move
    add_leaves(shapes, rng, cards)


def render_albedo(points):
    """Return the albedo of a rendered wall that faces -x: mottled, dirty at its foot."""
    y, z = points[:, 1], points[:, 2]
    tone = 1 + 0.05 * np.sin(5 * y + np.sin(3 * z)) * np.sin(4 * z)
    return (tone - 0.10 * np.exp(-np.maximum(z, 0) / 0.15))[:, None] * RENDER


def paint_wall(shapes, x, low, high):
    """Add a wall's albedo as a picture over y and z, so that it can get wet; it stands at `x`."""
    y, z = (np.arange(a + 0.01, b, 0.02) for a, b in zip(low, high, strict=True))
    gy, gz = np.meshgrid(y, z)
    points = np.stack([np.full_like(gy, x), gy, gz], axis=-1).reshape(-1, 3)
    bounds = (low[0], y[-1] + 0.01, low[1], z[-1] + 0.01)
    albedo = render_albedo(points).reshape(*gy.shape, 3)
    shapes.pictures["wall"] = Picture(albedo, bounds, axes=(1, 2))


def plank_albedo(points):
    """Return the albedo (n, 3) of a tabletop of planks at points (n, 2 or more) [m]."""
    x = points[:, 0] * 0.9 + 0.3 * points[:, 1]
    return (1 + 0.25 * np.sin(60 * x + 2 * np.sin(5 * points[:, 1])))[:, None] * WOOD


def paint_top(shapes, part, low, high, pixels=600):
    """Add a `Picture` of planks as the albedo of a tabletop, so that it can get a coat of water.

    `part` names the tabletop's mesh, `low` and `high` are its corners (x, y) [m]; the picture has
    `pixels` rows and columns.
    """
    x, y = (a + (np.arange(pixels) + 0.5) / pixels * (b - a)
            for a, b in zip(low, high, strict=True))  # fmt: skip
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    albedo = plank_albedo(points).reshape(pixels, pixels, 3)
    shapes.pictures[part] = Picture(albedo, (low[0], high[0], low[1], high[1]))
