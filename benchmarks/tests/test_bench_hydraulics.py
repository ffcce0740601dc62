"""`benchmarks hydraulics`: exact flows satisfy their equations; errors fall with the grid."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import cases, chart, flood_cases, held_cases, hydraulic_cases, hydraulics, water
from rainsim.jit import set_threads

G, SUITE = hydraulic_cases.GRAVITY, hydraulics.SUITE


@pytest.fixture(autouse=True)
def one_thread():
    """Maps of four rows: a second thread only waits."""
    threads = set_threads(None)
    set_threads(1)
    yield
    set_threads(threads)


def slope_of(f, x, step):
    """Return the derivative of f at x, to sixth order."""
    far = ((3, 1 / 60), (2, -3 / 20), (1, 3 / 4))
    return sum(weight * (f(x + n * step) - f(x - n * step)) for n, weight in far) / step


def test_the_bump_keeps_its_head_and_its_jump_keeps_the_thrust():
    flow = hydraulic_cases.BUMP_FLOW
    place, fast, tranquil = hydraulic_cases.jump_place()
    assert 11.6 < place < 11.7 and fast < hydraulic_cases.critical_depth(flow) < tranquil
    thrust = [hydraulic_cases.thrust(depth, flow) for depth in (fast, tranquil)]
    assert thrust[0] == pytest.approx(thrust[1], rel=1e-10)
    x = np.linspace(0.05, 34.95, 700)
    depth = hydraulic_cases.bump_depth(x)
    total = hydraulic_cases.head(depth, flow) + hydraulic_cases.bump_bed(x)
    for side in (x < place, x > place):
        assert np.ptp(total[side]) < 1e-10
    assert total[0] > total[-1]  # a jump costs energy
    behind = (x > 13) & (x < hydraulic_cases.BUMP_LENGTH)
    assert depth[behind] == pytest.approx(hydraulic_cases.BUMP_STAGE, abs=1e-10)
    assert depth[-1] < hydraulic_cases.critical_depth(flow)  # fast at the open edge


@pytest.mark.parametrize(("first", "gain", "brought"), [(2.0, 0, 0), (0, 0.004, 0), (0, 0.004, 1)])
def test_macdonalds_channel_is_steady(first, gain, brought):
    x = np.concatenate([np.linspace(10, 480, 50), np.linspace(520, 990, 50)])
    bed = hydraulic_cases.channel_slope(x, first + gain * x, gain, brought)
    h, _ = hydraulic_cases.channel_depth(x)
    q = first + gain * x

    def thrust(at):
        return hydraulic_cases.thrust(hydraulic_cases.channel_depth(at)[0], first + gain * at)

    friction = hydraulic_cases.CHANNEL_MANNING**2 * q**2 / h ** (10 / 3)
    joins = brought * gain * q / h  # momentum that the rain brings along
    assert np.abs(slope_of(thrust, x, 2.0) + G * h * (bed + friction) - joins).max() < 1e-10
    assert np.abs(slope_of(thrust, x, 2.0)).max() > 1e-3


def test_the_channels_bed_is_the_integral_of_its_slope_and_has_one_critical_place():
    case = hydraulic_cases.macdonald(200)
    x, flow = case.x[0], hydraulic_cases.CHANNEL_FLOW
    inside = (x > 10) & (x < 990)
    slope = hydraulic_cases.channel_slope(x, flow, 0.0, 0.0)
    found = np.gradient(case.bed[0], case.spacing)
    assert found[inside] == pytest.approx(slope[inside], rel=2e-3)
    froude = flow / np.sqrt(G * np.where(inside, case.exact[0], 1.0) ** 3)
    assert np.array_equal(froude[inside] > 1, x[inside] > 500)


def test_the_flows_between_a_discharge_and_a_level_are_steady():
    x = np.linspace(10, 990, 99)
    flow, h = hydraulic_cases.CHANNEL_FLOW, held_cases.tranquil_channel_depth(x)[0]

    def thrust(at):
        return hydraulic_cases.thrust(held_cases.tranquil_channel_depth(at)[0], flow)

    friction = held_cases.TRANQUIL_MANNING**2 * flow**2 / h ** (10 / 3)
    lost = G * h * (held_cases.tranquil_channel_slope(x) + friction)
    assert np.abs(slope_of(thrust, x, 2.0) + lost).max() < 1e-9
    assert (flow / np.sqrt(G * h**3) < 1).all()  # tranquil
    x = np.linspace(0.05, 24.95, 250)
    h = held_cases.tranquil_bump_depth(x)
    total = hydraulic_cases.head(h, held_cases.TRANQUIL_FLOW) + np.maximum(
        0.2 - 0.05 * (x - 10) ** 2, 0
    )
    assert np.ptp(total) < 1e-10 and h[-1] == pytest.approx(held_cases.TRANQUIL_STAGE)


@pytest.mark.parametrize(
    ("name", "cells", "bound"),
    [("bump, jump", 50, 0.01), ("bump, tranquil", 50, 0.002), ("macdonald, tranquil", 50, 0.004)],
)
def test_a_discharge_and_a_level_hold_the_exact_flow(name, cells, bound):
    record = hydraulics.measure(name, cells, "accurate")
    # From rest what comes in stands 0.14 m too high in MacDonald's first cell.
    assert record["error"] < bound and abs(record["residual"]) < 1e-9


def test_the_inlet_brings_the_flow():
    for case, flow in (
        (hydraulic_cases.bump(70), hydraulic_cases.BUMP_FLOW),
        (hydraulic_cases.macdonald(50), hydraulic_cases.CHANNEL_FLOW),
    ):
        supply = case.extra["supply"]
        assert supply[0].sum() * case.spacing == pytest.approx(flow, rel=1e-12)
        assert (supply >= 0).all() and not supply[:, case.x[0] > 0].any()


def test_the_kinematic_wave_of_a_plane_moves_at_its_own_speed():
    length, alpha, rate, until, m = 20.0, 5.0, 50 / 3.6e6, 300.0, 5 / 3
    t = np.array([350.0, 400.0, 500.0])
    q = cases.kinematic_flow(t, length, alpha, rate, until)
    depth = (q / alpha) ** (1 / m)
    # The depth at the foot was at q / rate when the rain ended, and came with m alpha h^(m-1).
    start = length - m * alpha * depth ** (m - 1) * (t - until)
    assert rate * start == pytest.approx(q, rel=1e-10)
    early = cases.kinematic_flow(np.array([50.0, 299.0]), length, alpha, rate, until)
    assert early == pytest.approx([alpha * (50 * rate) ** m, rate * length], rel=1e-12)


def test_the_catchments_theory_keeps_the_volume():
    rain = hydraulic_cases.SHOWER * 1.62e6
    t = np.linspace(0, 40 * hydraulic_cases.SHOWER_TIME, 40001)
    flow = hydraulic_cases.catchment_flow(t)
    assert np.abs(flow[t < 5400][-1] / rain - 1) < 1e-3  # 4.86 m3/s
    assert np.trapezoid(flow, t) == pytest.approx(rain * 5400, rel=4e-3)
    case = hydraulic_cases.catchment(81)
    assert case.bed.size * case.spacing**2 == 1.62e6
    assert (case.manning[:, 40] == 0.15).all() and (case.manning[:, [39, 41]] == 0.015).all()


@pytest.mark.parametrize("name", ["stoker", "bump", "macdonald", "plane 10 %"])
@pytest.mark.parametrize("method", ["accurate", "lean 64"])
def test_errors_fall_with_the_grid(name, method):
    _, _, sizes = hydraulics.SUITE[name]
    records = [hydraulics.measure(name, cells, method) for cells in sizes]
    assert hydraulics.orders(records)[name, method] > 0.5
    assert abs(records[-1]["residual"]) < 1e-9
    # What does nothing is far off.
    case = hydraulics.SUITE[name][0](sizes[-1])
    if case.exact is not None:
        assert cases.error_of(case, case.depth) > 3 * records[-1]["error"]


def test_rain_joins_at_the_speed_of_the_water():
    straight, carried = (
        hydraulics.measure(name, 60, "accurate")["error"]
        for name in ("macdonald rain", "macdonald rain, carried")
    )
    assert carried < 0.002 and straight > 0.05


def test_an_open_edge_holds_what_stands_there_and_passes_what_flows():
    case = hydraulic_cases.sill(place=-2)
    solver, *_ = water.solve(case, "accurate")
    inflow = float(case.extra["supply"].sum()) * case.spacing**2
    assert solver.discharge("east") == pytest.approx(inflow, rel=5e-3)
    solver.set_state(1.0 - case.bed)  # a lake with a level surface
    assert solver.advance(1.0).max_speed == 0 and solver.discharge("east") == 0
    assert hydraulics.at_sill("accurate")["leaves"] == pytest.approx(1, abs=1e-3)


def test_cells_without_an_exact_depth_do_not_count():
    case = cases.stoker(16)
    wrong = case.exact.copy()
    wrong[:, 0] += 1.0
    unknown = case.exact.copy()
    unknown[:, 0] = np.nan
    assert cases.error_of(case, wrong) > 1
    assert cases.error_of(replace(case, exact=unknown), wrong) == 0


def test_the_floods_have_their_published_numbers():
    river = {name: SUITE[name][0](40).extra["conditions"]()[0] for name in ("EA 2, hollows",
             "EA 4, plain")}  # fmt: skip
    assert river["EA 4, plain"].given.mean(0, 18000) * 18000 == pytest.approx(285_000)
    assert river["EA 2, hollows"].given.mean(0, 5100) * 5100 == pytest.approx(97_200)
    case = flood_cases.hollows(80)
    rows, columns = case.extra["gauges"]
    for j, i in zip(rows, columns, strict=True):  # a hollow's gauge is its lowest cell
        around = case.bed[j - 6 : j + 7, i - 6 : i + 7]
        assert case.bed[j, i] < around.min() + 0.05 and around.max() > case.bed[j, i] + 0.4
    assert case.bed[-6, 4] > case.bed[-6, -6] > case.bed[4, -6]  # the north-west is high
    case = flood_cases.flume(716)
    built = (case.bed > 2) & (case.x > 8)
    assert built.sum() * case.spacing**2 == pytest.approx(0.8 * 0.4, rel=0.02)  # m2
    assert not built[case.extra["gauges"]].any()
    gate = case.bed[:, round(7.1 / case.spacing)] < 2
    assert gate.sum() * case.spacing == pytest.approx(1.0, abs=0.11)
    case = flood_cases.street(60)
    assert (case.bed > 2).sum() * case.spacing**2 == pytest.approx(8 * 16 * 12)


@pytest.mark.parametrize("method", ["accurate", "lean"])
def test_a_flood_between_buildings_nears_the_refined_run(method):
    coarse, fine = (hydraulics.measure("street", cells, method, fine=120) for cells in (30, 60))
    assert fine["error"] < min(0.12, coarse["error"])
    assert fine["flood"]["late"] < 0.04 and fine["flood"]["reached"] >= 4
    assert abs(fine["residual"]) < 1e-7


def test_test_4_of_the_agency_is_within_the_span_of_the_packages():
    assert hydraulics.in_span(50, "accurate") == len(flood_cases.PUBLISHED_SPAN)
    assert flood_cases.in_published_span(np.zeros((10, 50)), 20.0) < 2


def test_an_order_is_found_from_its_errors():
    records = [{"case": "c", "scheme": "s", "cells": n, "error": 3 * n**-1.5} for n in (20, 80, 40)]
    assert hydraulics.orders(records) == {("c", "s"): pytest.approx(1.5)}
    assert hydraulics.orders(records[:1]) == {}


@pytest.mark.slow
def test_a_quick_run_has_every_case(tmp_path):
    result = hydraulics.run(quick=True)
    assert {record["case"] for record in result["records"]} == set(hydraulics.SUITE)
    text = hydraulics.table(result)
    for part in (
        "| bump | 70 |",
        "| order |",
        "| catchment |",
        "| sill at an open edge, and EA 4 |",
        "| street | 30 |",
    ):
        assert part in text
    assert water.line(result["records"][0]).startswith("stoker")
    assert result["sill"]["lean"]["leaves"] > 0.999
    chart.require_matplotlib()
    hydraulics.draw(result, tmp_path / "c.png")
    for name in ("c.png", "c-orders.png"):
        assert (tmp_path / name).stat().st_size > 10_000
