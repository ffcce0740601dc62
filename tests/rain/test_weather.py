"""Timelines: what keyframes say, and rain and wind that change without a drop popping."""

import numpy as np
import pytest

from rainsim.config.settings import Config, mm_per_hour
from rainsim.drops import GUST_SHARES, Weather, flat_surfaces, impacts
from rainsim.errors import ParameterError
from rainsim.rain.size_distribution import terminal_speed
from rainsim.rain.wind import SCENE_HEIGHT, wind_shares


def timeline(*frames, **base):
    text = "".join(f"{k} = {v}\n" for k, v in base.items())
    for frame in frames:
        text += "[[keyframe]]\n" + "".join(f"{k} = {v}\n" for k, v in frame.items())
    return Config.from_toml(text).check()


CHANGE = timeline(
    {"time_s": 0.0, "rain_mm_per_hour": 5.0, "wind_speed_m_per_s": 1.0},
    {"time_s": 2.0, "rain_mm_per_hour": 50.0, "wind_speed_m_per_s": 4.0},
    {"time_s": 3.0, "rain_mm_per_hour": 0.0},
    gusts=0.3,
)


def test_settings_go_evenly_from_keyframe_to_keyframe():
    assert CHANGE.at(1.0).rain.rate == pytest.approx(mm_per_hour(27.5))
    assert CHANGE.at(1.0).rain.wind[0] == pytest.approx(2.5)
    assert CHANGE.at(-1.0).rain.rate == pytest.approx(mm_per_hour(5.0))
    assert CHANGE.at(9.0).rain.rate == 0 and CHANGE.at(9.0).rain.wind[0] == pytest.approx(4.0)
    assert CHANGE.at(1.0).keyframes == ()


def test_a_preset_is_a_timeline_of_one_keyframe():
    config = Config.from_preset("downpour")
    assert config.key_times() == [0.0] and config.at(5.0) == config
    one = timeline({"time_s": 0.0, "rain_mm_per_hour": 50.0, "past_rain_mm": 8.0})
    assert one.at(3.0).rain.rate == config.rain.rate and one.at(3.0).rain.past == config.rain.past


def test_an_option_that_is_given_holds_for_all_times():
    steady = CHANGE.replace(rate=mm_per_hour(7.0))
    assert {steady.at(t).rain.rate for t in (0.0, 1.0, 5.0)} == {mm_per_hour(7.0)}
    assert steady.at(1.0).rain.wind[0] == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ({"rain_mm_per_hour": 1.0}, "keyframe 2 has no time_s"),
        ({"time_s": -1.0}, "times must rise"),
        ({"time_s": 1.0, "water_level_m": 0.1}, "level is set by a later keyframe only"),
        ({"time_s": 1.0, "rain_mm_per_hour": -3.0}, "at 1 s: rain is -3.0 mm/h"),
        ({"time_s": 1.0, "rains_mm_per_hour": 3.0}, "rain_mm_per_hour"),
    ],
)
def test_bad_keyframes_are_told(frame, message):
    with pytest.raises(ParameterError, match=message):
        timeline({"time_s": 0.0}, frame)


def test_a_water_level_may_rise_and_fall_with_time():
    moving = [(0.0, 0.02), (2.0, 0.06), (4.0, 0.01)]
    moving = timeline(*({"time_s": t, "water_level_m": level} for t, level in moving))
    levels = [moving.at(time).water.level for time in (1.0, 2.0, 3.0)]
    assert levels == pytest.approx([0.04, 0.06, 0.035])


def test_drift_is_the_integral_of_the_wind():
    weather = Weather(CHANGE)
    time = np.linspace(-1, 5, 3001)
    wind = np.array([weather.wind(t) for t in time])
    drift = np.array([weather.drift(t) for t in time])
    summed = np.cumsum((wind[1:] + wind[:-1]) / 2 * np.diff(time)[:, None], axis=0)
    np.testing.assert_allclose(drift[1:] - drift[0], summed, atol=1e-5)
    assert np.ptp(wind[:, 0]) > 1 and weather.drift(0.0) == pytest.approx(0.0)
    assert sum(share**2 / 2 for share in GUST_SHARES) == pytest.approx(0.5, abs=0.01)


def test_drops_neither_jump_nor_appear_nor_vanish_in_the_air():
    """Frame by frame, each drop well inside a box is near where its velocity took it."""
    weather, step = Weather(CHANGE), 1 / 24
    low, high = np.array([-1.0, -1.0, 0.5]), np.array([1.0, 1.0, 2.0])
    reach = np.array([0.6, 0.6, 0.6])
    checked = 0
    for start in (0.5, 1.9, 2.4, 2.8):
        now, then = (
            weather.field(start, start + step),
            weather.field(start + step, start + 2 * step),
        )
        before = now.drops_in_box(start, low, high)
        after = then.drops_in_box(start + step, low - reach, high + reach)
        assert np.isin(before.id, after.id).all()  # none has vanished
        moved = after.position[np.searchsorted(after.id, before.id)] - before.position
        np.testing.assert_allclose(moved, before.velocity * step, atol=1e-9)
        inside = (after.position > low + 0.4).all(axis=1) & (after.position < high - 0.6).all(
            axis=1
        )
        assert np.isin(after.id[inside], before.id).all()  # none has appeared
        checked += len(before)
    assert checked > 1000


def test_the_gauge_reads_the_rate_of_each_moment():
    """Some 8,000 drops each: 3 % is two standard errors of their volume."""
    config = timeline(
        {"time_s": 0.0, "rain_mm_per_hour": 10.0}, {"time_s": 8.0, "rain_mm_per_hour": 90.0}
    )
    weather = Weather(config)
    ground = flat_surfaces(4, 4, 0.1)
    read, wanted, counts = [], [], []
    for start in (1.0, 4.0, 7.0):
        field = weather.field(start, start + 0.2)
        found = impacts(field, ground, start, start + 0.2)
        read.append(found.volume.sum() / 16 / 0.2 + field.spectrum.fine_rate)
        wanted.append(mm_per_hour(weather.rate(start + 0.1)))
        flux = field.spectrum.density @ field.spectrum.speed * 16 * 0.2
        counts.append(abs(len(found) - flux) / np.sqrt(flux))
    np.testing.assert_allclose(read, wanted, rtol=0.06)
    assert max(counts) < 4 and wanted[2] > 3 * wanted[0]


def test_after_the_rain_nothing_falls_and_dry_weather_has_no_field():
    weather = Weather(CHANGE)
    assert len(impacts(weather.field(3.2, 3.3), flat_surfaces(4, 4, 0.1), 3.2, 3.3)) == 0
    assert Weather(Config().replace(rate=0.0)).field(0.0, 1.0) is None


def test_steady_weather_is_one_field():
    weather = Weather(Config.from_preset("downpour"))
    assert weather.field(0.0, 0.1) is weather.field(5.0, 5.1)


# ---- wind that grows with height


def fall_through(diameter, roughness, step=1e-4):
    """Oracle: integrate a drop's horizontal speed and way from 60 m down, in a wind of 1 m/s."""
    fall = float(terminal_speed(diameter))
    z, speed, way, passed = 60.0, 1.0, 0.0, None
    ways = []
    while z > 0:
        wind = np.log1p(z / roughness) / np.log1p(10 / roughness)
        speed += (wind - speed) * 9.81 / fall * step
        way += speed * step
        z -= fall * step
        if z < SCENE_HEIGHT:
            passed = way if passed is None else passed
            ways.append((SCENE_HEIGHT - z, way - passed))
    return np.array(ways)


@pytest.mark.parametrize("diameter", [0.7e-3, 2e-3, 4e-3])
def test_drops_drift_as_their_own_path_through_the_wind_profile_says(diameter):
    fall = float(terminal_speed(diameter))
    share = wind_shares(np.array([fall]), 0.03)[0]
    fallen, way = fall_through(diameter, 0.03).T
    assert way[-1] == pytest.approx(share * SCENE_HEIGHT / fall, rel=0.01)
    # and bends away from the straight path by centimetres for each m/s of wind
    bend = np.abs(way - share * fallen / fall).max()
    assert 1e-4 < bend < 0.15 * SCENE_HEIGHT / fall


def test_wind_shares_grow_with_size_and_fall_with_roughness_and_may_be_left_out():
    speed = terminal_speed(np.array([0.5e-3, 1e-3, 3e-3, 6e-3]))
    smooth, rough = wind_shares(speed, 0.005), wind_shares(speed, 0.5)
    assert (np.diff(smooth) > 0).all() and (rough < smooth).all() and rough.min() > 0.3
    assert (wind_shares(speed, 0.0) == 1).all()
