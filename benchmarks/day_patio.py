"""The fixed case: a patio before a house, with a table, between hedges, on a sunny afternoon.

Its geometry, cameras, sun and seeds never change, so that figures of different versions compare.
"""

from __future__ import annotations

import numpy as np

from benchmarks import day_garden
from benchmarks.day_case import Case, Rain, Sun, aimed
from benchmarks.day_ground import add_paving, paved
from benchmarks.day_shapes import Shapes

LOW, HIGH = (-3.0, -2.6), (4.0, 2.6)  # m: the paving; the wall of the house stands at x = 4
GARDEN_LOW, GARDEN_HIGH = (-7.0, -6.5), (4.0, 6.5)
HEDGE, WALL = 1.9, 3.0  # m high
DIPS = ((-0.9, 0.55, 0.016, 0.38), (1.25, -0.55, 0.013, 0.42), (2.7, 1.2, 0.010, 0.35),
        (-1.9, -1.3, 0.012, 0.33), (0.6, -1.7, 0.010, 0.3))  # fmt: skip
TABLE, TABLE_RADIUS, TABLE_HEIGHT = (0.35, 0.45), 0.6, 0.74
WINDOW = (0.8, 0.85, 2.05)  # m: half width, sill, head
DARK_WOOD, POST_WOOD = (0.25, 0.16, 0.09), (0.2, 0.13, 0.08)


def build():
    """Return the `Shapes` and the `Paving` of the patio."""
    shapes = Shapes()
    paving = paved(LOW, HIGH, DIPS, closed=("east",))
    rng = add_paving(shapes, paving)
    day_garden.add_lawn(shapes, rng, GARDEN_LOW, (LOW[0], GARDEN_HIGH[1]), 0.035)
    day_garden.add_lawn(shapes, rng, (LOW[0], GARDEN_LOW[1]), (GARDEN_HIGH[0], LOW[1]), 0.03)
    day_garden.add_lawn(shapes, rng, (LOW[0], HIGH[1]), GARDEN_HIGH, 0.03)
    shapes.rectangle("kerb", (*LOW, -0.05), (0, HIGH[1] - LOW[1], 0), (0, 0, 0.05), 0.25, 0.02)
    _add_house(shapes)
    _add_table(shapes)
    shapes.box("box", (1.7, -1.75, 0.0), (2.5, -1.3, 0.42), (0.35, 0.10, 0.06), 0.012)
    shapes.tube("post", (-1.1, -1.5), 0.035, -0.01, 2.1, (0.06, 0.065, 0.07), 0.012)
    shapes.ball("globe", (-1.1, -1.5, 2.2), 0.13, 0.75, 1500, 0.0125)
    (west, south), (east, north) = GARDEN_LOW, GARDEN_HIGH
    rng = np.random.default_rng(3)
    for low, high, count in (
        ((west - 0.6, south - 0.6), (west, north + 0.6), 26000),
        ((west, south - 0.6), (east + 0.5, south), 20000),
        ((west, north), (east + 0.5, north + 0.6), 20000),
    ):
        day_garden.add_hedge(shapes, rng, low, high, HEDGE, count)
    return shapes, paving


def _add_house(shapes):
    """Add the wall with a window: frame and a pane that mirrors."""
    x, (half, sill, head) = HIGH[0], WINDOW
    south, north = GARDEN_LOW[1], GARDEN_HIGH[1]
    for y0, y1, z0, z1 in (
        (south, -half, -0.05, WALL), (half, north, -0.05, WALL),
        (-half, half, -0.05, sill), (-half, half, head, WALL),
    ):  # fmt: skip
        up, along = (0, 0, z1 - z0), (0, y1 - y0, 0)
        shapes.rectangle("wall", (x, y0, z0), up, along, day_garden.render_albedo, 0.03)
    day_garden.paint_wall(shapes, x, (south, -0.05), (north, WALL))
    deep, wide, high = 0.08, (0, 2 * half, 0), (0, 0, head - sill)
    shapes.rectangle("glass", (x + deep, -half, sill), high, wide, (0.02, 0.022, 0.025), 0.02)
    inward = (deep, 0, 0)
    for corner, u, v in (
        ((x, -half, sill), wide, inward), ((x, -half, head), inward, wide),
        ((x, -half, sill), inward, high), ((x, half, sill), high, inward),
    ):  # fmt: skip
        shapes.rectangle("frame", corner, u, v, 0.7, 0.02)
    shapes.box("frame", (x + 0.03, -0.03, sill), (x + 0.075, 0.03, head), 0.7, 0.015)


def _add_table(shapes):
    """Add a round table on a post."""
    r, top = TABLE_RADIUS, TABLE_HEIGHT
    low, high = (tuple(c + side * r for c in TABLE) for side in (-1, 1))
    day_garden.paint_top(shapes, "tabletop", low, high)
    shapes.disk("tabletop", TABLE, r, top, 1, day_garden.plank_albedo, 0.011)
    shapes.disk("table", TABLE, r, top - 0.03, -1, DARK_WOOD, 0.03)
    shapes.tube("table", TABLE, r, top - 0.03, top, DARK_WOOD, 0.01)
    shapes.tube("table", TABLE, 0.05, 0.0, top - 0.03, POST_WOOD, 0.012)
    shapes.tube("table", TABLE, 0.22, -0.01, 0.03, POST_WOOD, 0.012)
    shapes.disk("table", TABLE, 0.22, 0.03, 1, POST_WOOD, 0.012)


def cameras(count=14):
    """Return the cameras: to the house, away from it, across, and others in a ring."""
    rng = np.random.default_rng(11)
    found = []
    for k in range(count):
        turn = 2 * np.pi * (k + 0.5) / count
        height = 1.5 + 0.12 * rng.standard_normal()
        eye = (min(0.35 + 3.1 * np.cos(turn), 3.2), 2.9 * np.sin(turn), height)
        found.append((eye, np.array([0.35, 0.1, 0.35]) + 0.25 * rng.standard_normal(3)))
    found[:3] = (
        ((-2.6, -0.9, 1.45), (1.0, 0.1, 0.45)),
        ((2.9, 1.9, 1.5), (-0.4, -0.5, 0.4)),
        ((-0.4, -2.9, 1.5), (0.7, 0.6, 0.35)),
    )
    return aimed(found)


SOAKED = ("paving", "bed", "tabletop", "table", "box")
PATIO = Case(
    "patio", build, cameras, Sun((-0.62, -0.42), 40.0, 3.5),
    rains=(
        Rain("rain", SOAKED, 0.03, gloss=True),
        Rain("smooth", SOAKED, 0.03, views=(0, 1), slopes=0.5),
        Rain("rough", SOAKED, 0.03, views=(0, 1), slopes=1.5),
        Rain("dark leaves", SOAKED, 0.03, views=(1,), skin=0.7),
        Rain("wind", (*SOAKED, "wall"), 0.03, (6.0, 0.0), views=(0,)),
    ),
)  # fmt: skip
