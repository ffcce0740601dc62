"""Rain on terrain over time."""

import dataclasses
import math

import numpy as np
import pytest

from made_rain import NX, NY, SPACING, centres, config, ground, states
from rainsim import simulation
from rainsim.config.settings import mm_per_hour
from rainsim.drops import Weather
from rainsim.rain.exposure import rain_exposure


def bowl():
    x, y = centres()
    return np.maximum(-0.02 * (1 - (x * x + y * y) / 0.36), -0.02).clip(max=0)


def test_past_rain_stands_in_the_dip_and_stays():
    first, *_, last = states(ground(bowl()), config(rate=0.0, past=2e-3), 3)
    x, y = centres()
    assert first.depth[(np.hypot(x, y) < 0.1)].mean() > 5e-3
    assert first.depth[(np.hypot(x, y) > 0.8)].max() < 1e-4
    np.testing.assert_allclose(last.depth, first.depth, atol=1e-5)
    assert not last.slopes.any()


def test_a_factor_on_the_puddles_changes_what_stands_and_nothing_else():
    open_ = np.ones((NY, NX), np.float32)
    volume = [
        simulation.initial_water(ground(bowl()), config(past=1e-3, puddles=f), open_)[0].sum()
        for f in (0.0, 0.5, 1.0, 2.0)
    ]
    assert volume[0] == 0 < volume[1]
    assert volume[3] > 1.2 * volume[2] > 1.4 * volume[1]


@pytest.mark.parametrize("asked", ["auto", "accurate", "lean", "paper"])
def test_the_scheme_is_taken_by_name_and_said(asked):
    (first,) = states(ground(bowl()), config(past=2e-3, scheme=asked), 1)
    (said,) = (note for note in first.notes if note.startswith("water: scheme"))
    assert ("accurate" if asked == "auto" else asked) in said
    assert ("auto: smooth" if asked == "auto" else "asked for by name") in said


def test_rain_arrives_by_the_ledger_and_moves_the_water():
    first, *_, last = states(ground(bowl()), config(past=2e-3), 5)
    assert abs(last.ledger["residual"]) < 1e-9
    fallen = mm_per_hour(20.0) * last.time * (NX * SPACING) ** 2
    assert last.ledger["rain"] == pytest.approx(fallen, rel=1e-6)
    assert last.ledger["rain"] > 0 and not np.array_equal(last.depth, first.depth)
    assert np.abs(last.slopes).max() > 1e-3


def test_level_ground_gets_a_flood_at_the_level_asked_for():
    state = states(ground(bowl()), config(level=0.05, rate=0.0), 2)[-1]
    low = np.percentile(bowl(), 5)
    np.testing.assert_allclose(state.depth + bowl(), low + 0.05, atol=1e-5)
    assert state.ledger["outflow"] == 0


def test_a_level_of_keyframes_rises_and_is_booked_as_inflow():
    frames = ((0.0, (("level", 0.02),)), (0.2, (("level", 0.06),)))
    rising = dataclasses.replace(config(rate=0.0), keyframes=frames).check()
    run = states(ground(bowl()), rising, 7)
    low = np.percentile(bowl(), 5)
    for state, level in ((run[0], 0.02), (run[2], 0.04), (run[-1], 0.06)):
        np.testing.assert_allclose(state.depth + bowl(), low + level, atol=2e-5)
    ledger = run[-1].ledger
    assert ledger["inflow"] == pytest.approx(0.04 * (NX * SPACING) ** 2, rel=0.02)
    assert abs(ledger["residual"]) < 1e-7  # of float32
    assert ledger["rain"] == pytest.approx(0, abs=1e-9)


def test_a_level_that_falls_is_drained_and_leaves_what_hollows_hold():
    bed = np.zeros((NY, NX), np.float32)
    bed[:, : NX // 2] = np.linspace(0.03, 0.0, NX // 2)  # falls to the east
    bed[NY // 4 : NY // 2, NX // 8 : NX // 4] -= 0.02  # a pit in the slope
    frames = ((0.0, (("level", 0.06),)), (0.4, (("level", 0.0),)))
    falling = dataclasses.replace(config(rate=0.0), keyframes=frames).check()
    run = states(ground(bed), falling, 14)
    assert run[0].depth.mean() > 0.04
    assert (np.diff([state.depth.sum() for state in run]) <= 1e-4).all()
    ledger, area = run[-1].ledger, SPACING**2
    gone = (run[0].depth.astype(float).sum() - run[-1].depth.astype(float).sum()) * area
    assert ledger["drained"] == pytest.approx(gone, rel=1e-5) and abs(ledger["residual"]) < 1e-7
    pit = run[-1].depth[NY // 4 : NY // 2, NX // 8 : NX // 4]
    assert pit.mean() > 0.005 and run[-1].depth[:, NX // 2 :].max() < 2e-3


def test_rings_are_in_balance_from_the_first_frame_on():
    """So that a film does not begin with water that roughens as it goes."""
    run = states(ground(bowl()), config(past=6e-3, rate=mm_per_hour(50.0), fps=5.0), 16)
    rough = np.array([np.std(s.slopes) for s in run])
    assert 0.7 < rough[:3].mean() / rough[-6:].mean() < 1.3


def test_a_surface_film_calms_the_rings():
    rough, calm = (
        states(ground(bowl()), config(past=2e-3, surface_film=f, rate=mm_per_hour(60)), 2)[-1]
        for f in (0.0, 1.0)
    )
    assert 0 < np.std(calm.slopes) < 0.9 * np.std(rough.slopes)


def test_grass_swallows_the_past_rain():
    lawn = np.ones((NY, NX))
    state = states(ground(bowl(), grass=lawn), config(rate=0.0, past=5e-3), 1)[0]
    assert not state.depth.any()


def test_a_roof_keeps_the_ground_dry_and_is_booked():
    x, y = centres()
    under = (np.abs(x) < 0.5) & (np.abs(y) < 0.5)
    roof = ground(top=np.where(under, 2.0, 0.0), underside=np.where(under, 1.9, 0.0))
    still = rain_exposure(roof, (0.0, 0.0))
    windy = rain_exposure(roof, (4.0, 0.0))
    middle = (np.abs(x) < 0.3) & (np.abs(y) < 0.3)
    far = np.hypot(x, y) > 0.85
    assert still[middle].max() < 0.01 and still[far].min() > 0.95
    # Wind along x blows the rain under the roof's west side and dries the east.
    west, east = (x < -0.3) & (np.abs(y) < 0.3), (x > 0.6) & (np.abs(y) < 0.3)
    assert windy[west].mean() > 0.3 and windy[east].mean() < still[east].mean() - 0.3
    state = states(roof, config(rate=mm_per_hour(50.0)), 4)[-1]
    assert state.ledger["obstacles"] > 0
    assert abs(state.ledger["residual"]) < 1e-9
    assert state.depth[middle].max() < 1e-9 < state.depth[far].max()


def test_a_frame_is_the_same_alone_and_in_sequence_and_seeds_differ():
    one = states(ground(bowl()), config(), 3)
    two = states(ground(bowl()), config(), 3)
    other = states(ground(bowl()), config(seed=7), 3)
    for a, b in zip(one, two, strict=True):
        assert a.depth.tobytes() == b.depth.tobytes() and a.slopes.tobytes() == b.slopes.tobytes()
    assert one[-1].slopes.tobytes() != other[-1].slopes.tobytes()


def test_rings_run_on_the_puddles_own_depth():
    assert simulation.puddle_depth(np.zeros((3, 3))) == simulation.RIPPLE_DEPTHS[0]
    assert simulation.puddle_depth(np.array([0, 1e-4, 0.006, 0.008, 0.01])) == pytest.approx(0.008)
    assert simulation.puddle_depth(np.full(4, 5.0)) == simulation.RIPPLE_DEPTHS[1]


def first_field(config):
    return Weather(config).field(0.0, config.frame_interval)


def test_wind_velocity_is_that_of_the_settings():
    field = first_field(config(wind=(3.0, math.radians(90)), roughness=0.0))
    np.testing.assert_allclose(field.velocity[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(field.velocity[:, 1], 3.0)
    rough = first_field(config(wind=(3.0, math.radians(90))))
    assert (np.diff(rough.velocity[:, 1]) > 0).all()  # big drops bring the wind of higher up
    assert 0.65 * 3 < rough.velocity[0, 1] < rough.velocity[-1, 1] < 3
    assert first_field(config(rate=0.0)) is None
