"""Streams of a steady rain: discharge and depth against the formulas, and what has none."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rainsim.grid import WaterSolver
from rainsim.terrain.table import DRAIN, HARD, class_table
from rainsim.terrain.types import MEASURED, Grid, Terrain
from rainsim.water.puddles import puddles_of
from rainsim.water.streams import BLOCK, run_off, with_streams

SPACING, SLOPE, RAIN = 0.02, 0.02, 4e-4  # m, of the road, m/s
LONG, WIDE, KERB, CAMBER = 12.8, 2.56, 0.1, 0.05  # m, m, m, slope to the kerb


def terrain_of(bed, classes=None):
    bed = np.ascontiguousarray(bed, np.float32)
    grid = Grid(bed.shape, (0.0, 0.0), SPACING)
    zero = np.zeros(bed.shape, np.float32)
    classes = np.full(bed.shape, HARD, np.uint8) if classes is None else classes
    source = np.full(bed.shape, MEASURED, np.uint8)
    return Terrain(grid, bed, bed, bed, source, classes, zero, np.zeros((*bed.shape, 3), "f4"))


def gutter(pit=False):
    """A road that falls to the east and to a kerb in the south, over which nothing runs.

    `pit`: with a hole in the gutter at its middle.
    """
    x = (np.arange(round(LONG / SPACING)) + 0.5) * SPACING
    y = (np.arange(round(WIDE / SPACING)) + 0.5) * SPACING
    bed = SLOPE * (LONG - x) + CAMBER * np.maximum(y - BLOCK, 0)[:, None]
    bed[y < BLOCK] += KERB
    if pit:
        here = np.hypot(x - LONG / 2, y[:, None] - 0.3) < 0.25
        bed = bed - 0.2 * here
    return terrain_of(bed)


def through(depth, velocity, at, film):
    """Discharge to the east [m3/s] through the section at x [m] of what flows."""
    column = int(at / SPACING)
    section = np.s_[:, column - 8 : column + 8]  # of two blocks
    free = np.maximum(depth[section] - film, 0)
    return float((free * velocity[0][section]).sum(axis=0).mean()) * SPACING


def drained(at):
    """What falls [m3/s] on the road up to the section at x [m]; its rim is taken to drain away."""
    return RAIN * (at - BLOCK) * (WIDE - 2 * BLOCK)


def film_of(terrain):
    return float(class_table().column("storage")[HARD])


# --- discharge and depth --------------------------------------------------------------------------


def test_a_gutter_carries_what_falls_on_all_that_drains_there():
    road = gutter()
    still, rain = np.zeros(road.bed.shape), np.full(road.bed.shape, RAIN)
    flow = run_off(road, still, rain)
    for at in (4.0, 8.0, 12.0):
        column = round(at / BLOCK)
        assert flow.east[:, column].sum() == pytest.approx(drained(at), rel=1e-6)
    depth, velocity = with_streams(road, still, rain)
    for at in (6.0, 10.0):
        assert through(depth, velocity, at, film_of(road)) == pytest.approx(drained(at), rel=0.15)


def test_depth_is_that_of_the_flow_law():
    x = (np.arange(640) + 0.5) * SPACING
    plane = terrain_of(np.broadcast_to(SLOPE * (LONG - x), (192, 640)))
    rain = np.full(plane.bed.shape, RAIN)
    depth, velocity = with_streams(plane, np.zeros(plane.bed.shape), rain)
    manning = float(class_table().column("manning")[HARD])
    for at in (5.0, 9.0, 12.0):
        here = 96, int(at / SPACING)
        free = (RAIN * at * manning / math.sqrt(SLOPE)) ** 0.6
        assert depth[here] - film_of(plane) == pytest.approx(free, rel=0.04)
        assert velocity[0][here] * free == pytest.approx(RAIN * at, rel=0.06)
        assert abs(velocity[1][here]) < 1e-3
    # Film where a stream would be thinner than what counts as one.
    assert not with_streams(plane, np.zeros(plane.bed.shape), 1e-3 * rain)[0].any()


@pytest.mark.parametrize("dtype, least", [
    pytest.param(np.float64, 1e-9, marks=pytest.mark.slow), (np.float32, 1e-5),
])  # fmt: skip
def test_the_solver_keeps_the_stream_that_it_begins_with(dtype, least):
    road = gutter()
    still, rain = np.zeros(road.bed.shape), np.full(road.bed.shape, RAIN)
    depth, velocity = with_streams(road, still, rain)

    def after(seconds, *state):
        solver = WaterSolver(
            road.bed, SPACING, manning=road.by_class("manning"), boundary="open",
            storage=road.by_class("storage"), dtype=dtype,
        )  # fmt: skip
        solver.set_state(*state)
        begun = solver.ledger
        solver.advance(seconds, rain=RAIN)
        assert begun.initial == pytest.approx(state[0].sum() * SPACING**2, rel=1e-3 * least)
        assert abs(solver.ledger.residual) < least
        return through(solver.depth, solver.velocity, 8.0, film_of(road))

    assert after(1.0, depth, *velocity) == pytest.approx(drained(8.0), rel=0.15)
    assert after(1.0, still) < 0.3 * drained(8.0)


# --- where there is none --------------------------------------------------------------------------


def test_a_gutter_without_rain_begins_dry():
    road = gutter()
    depth, velocity = with_streams(road, np.zeros(road.bed.shape), np.zeros(road.bed.shape))
    assert not depth.any() and not velocity.any()


def test_what_stands_at_rest_stays_and_a_hole_that_is_not_full_keeps_what_comes():
    road = gutter(pit=True)
    rain = np.full(road.bed.shape, RAIN)
    found = {}
    for name, fallen in (("low", 1e-3), ("full", 1.0)):
        puddles = puddles_of(road)
        puddles.rain(fallen)
        depth, _ = with_streams(road, puddles.depth, rain)
        assert (depth >= puddles.depth).all() and puddles.depth.max() > 0
        flow = run_off(road, puddles.depth, rain)
        found[name] = flow.east[:, round(8.0 / BLOCK)].sum()
    assert found["full"] == pytest.approx(drained(8.0), rel=1e-6)
    assert found["low"] < 0.6 * drained(8.0)


def test_drains_and_lawns_take_the_stream():
    road = gutter()
    still, rain = np.zeros(road.bed.shape), np.full(road.bed.shape, RAIN)
    classes = road.ground_class.copy()
    classes[round(BLOCK / SPACING) : 40, 300:316] = DRAIN
    taken = replace(road, ground_class=classes)
    section = round(6.8 / BLOCK)
    before, after = (run_off(map_, still, rain).east[:, section].sum() for map_ in (road, taken))
    assert 0 < after < 0.5 * before
