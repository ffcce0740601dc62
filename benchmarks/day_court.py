"""The second case: a court under a tree, before a wall that faces away from a high sun.

Dappled shade, the shadow of the wall over half the paving, a bench, wet gloss on lawn and leaves,
and no more rain than fills the dips in part. No constant of the program is chosen on it.
"""

from __future__ import annotations

import numpy as np

from benchmarks import day_garden
from benchmarks.day_case import Case, Rain, Sun, aimed
from benchmarks.day_ground import add_paving, paved
from benchmarks.day_shapes import Shapes

LOW, HIGH = (-3.2, -2.4), (3.0, 2.4)  # m: the paving; the wall stands at x = 3
GARDEN_LOW, GARDEN_HIGH = (-6.0, -5.5), (3.0, 5.5)
HEDGE, WALL = 1.6, 2.8  # m high
DIPS = ((-1.2, 0.2, 0.014, 0.40), (1.6, -0.9, 0.012, 0.36), (0.5, 1.3, 0.011, 0.34),
        (-2.2, -1.5, 0.010, 0.30))  # fmt: skip
TREE, TRUNK, CROWN, CROWN_HALF = (0.9, 2.9), 2.6, (0.8, 2.6, 4.0), (1.9, 1.9, 1.4)
LEAVES, CLIPPED = 9000, 15000  # leaves of the tree, of one hedge
BENCH = (-0.2, -1.75), (1.2, -1.33)  # m: corners of its seat
SEAT = 0.45  # m


def build():
    """Return the `Shapes` and the `Paving` of the court."""
    shapes = Shapes()
    paving = paved(LOW, HIGH, DIPS, closed=("east",), rain=0.003, seed=1)
    rng = add_paving(shapes, paving)
    day_garden.add_lawn(shapes, rng, GARDEN_LOW, (LOW[0], GARDEN_HIGH[1]), 0.035)
    day_garden.add_lawn(shapes, rng, (LOW[0], GARDEN_LOW[1]), (GARDEN_HIGH[0], LOW[1]), 0.03)
    day_garden.add_lawn(shapes, rng, (LOW[0], HIGH[1]), GARDEN_HIGH, 0.03)
    day_garden.paint_lawn(shapes, GARDEN_LOW, GARDEN_HIGH)
    south, north = GARDEN_LOW[1], GARDEN_HIGH[1]
    up, along = (0, 0, WALL + 0.05), (0, north - south, 0)
    shapes.rectangle("wall", (HIGH[0], south, -0.05), up, along, day_garden.render_albedo, 0.03)
    # The wall is thick: its back and top keep the sun from shining through.
    back = (HIGH[0] + 0.3, south, -0.05)
    shapes.rectangle("wall", back, along, up, (0.6, 0.55, 0.45), 0.1)
    shapes.rectangle("wall", (HIGH[0], south, WALL), (0.3, 0, 0), along, (0.55, 0.5, 0.42), 0.03)
    _add_bench(shapes)
    shapes.box("box", (2.2, 0.9, 0.0), (2.7, 1.8, 0.5), (0.10, 0.13, 0.30), 0.012)
    (west, _), east = GARDEN_LOW, GARDEN_HIGH[0]
    rng = np.random.default_rng(13)
    for low, high in (
        ((west - 0.6, south - 0.6), (west, north + 0.6)),
        ((west, south - 0.6), (east + 0.3, south)),
        ((west, north), (east + 0.3, north + 0.6)),
    ):
        day_garden.add_hedge(shapes, rng, low, high, HEDGE, CLIPPED)
    day_garden.add_tree(shapes, rng, TREE, TRUNK, CROWN, CROWN_HALF, LEAVES)
    return shapes, paving


def _add_bench(shapes):
    """Add a bench: a seat of planks on two blocks."""
    (x0, y0), (x1, y1) = BENCH
    day_garden.paint_top(shapes, "tabletop", *BENCH)
    corner, u, v = (x0, y0, SEAT), (x1 - x0, 0, 0), (0, y1 - y0, 0)
    shapes.rectangle("tabletop", corner, u, v, day_garden.plank_albedo, 0.011)
    dark = (0.25, 0.16, 0.09)
    low, wide, deep, thin = SEAT - 0.04, (x1 - x0, 0, 0), (0, y1 - y0, 0), (0, 0, 0.04)
    for corner, u, v in (
        ((x0, y0, low), wide, thin), ((x1, y1, low), (x0 - x1, 0, 0), thin),
        ((x0, y1, low), (0, y0 - y1, 0), thin), ((x1, y0, low), deep, thin),
        ((x0, y0, low), deep, wide),
    ):  # fmt: skip
        shapes.rectangle("table", corner, u, v, dark, 0.012)
    for x in (x0 + 0.12, x1 - 0.32):
        shapes.box(
            "table", (x, y0 + 0.05, -0.01), (x + 0.2, y1 - 0.05, SEAT - 0.04), dark,
            0.012,
        )  # fmt: skip


def cameras(count=14):
    """Return the cameras: to the wall, away from it, along it, and others in a ring."""
    rng = np.random.default_rng(21)
    found = []
    for k in range(count):
        turn = 2 * np.pi * (k + 0.5) / count
        eye = (min(-0.2 + 2.9 * np.cos(turn), 2.4), 2.6 * np.sin(turn), rng.normal(1.5, 0.1))
        found.append((eye, rng.normal((-0.1, 0.0, 0.4), 0.25)))
    found[:3] = (
        ((-3.0, -1.2, 1.5), (1.2, 0.2, 0.5)),
        ((2.3, -1.9, 1.5), (-1.4, 0.5, 0.5)),
        ((-1.6, -2.9, 1.45), (0.5, 0.9, 0.6)),
    )
    return aimed(found)


COATED = ("paving", "bed", "tabletop", "table", "box", "lawn", "leaf")
COURT = Case(
    "court", build, cameras, Sun((0.80, 0.35), 52.0, 2.8),
    rains=(
        Rain("rain", COATED, 0.003, gloss=True),
    ),
)  # fmt: skip
