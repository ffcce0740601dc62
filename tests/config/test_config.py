"""Settings: units, presets, and values that break a rule."""

import math
import re

import pytest

from rainsim.config.settings import HUMAN_KEYS, MM_PER_HOUR, Config, preset_names, preset_text
from rainsim.errors import InputError, ParameterError, RainsimError


@pytest.mark.parametrize(("name", "rate"), [("drizzle", 2.5), ("moderate", 10), ("downpour", 50)])
def test_presets_rain_as_much_as_they_say(name, rate):
    config = Config.from_preset(name).check()
    assert config.rain.rate == pytest.approx(rate / 3.6e6, rel=1e-12)
    assert config.water.level is None
    assert config.rain.past > 0


def test_flood_has_a_level_and_presets_get_wetter():
    assert Config.from_preset("flood").check().water.level > 0
    past = [Config.from_preset(n).rain.past for n in ("drizzle", "moderate", "downpour")]
    assert past == sorted(past) and past[0] < past[-1]


def test_human_units_become_si(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        "rain_mm_per_hour = 36\npast_rain_mm = 4\nwind_speed_m_per_s = 2\n"
        "wind_direction_degrees = 90\nexposure_ms = 4\nsun_azimuth_degrees = 180\n"
        "captured_sun_azimuth_degrees = 90\ncaptured_sun_elevation_degrees = 30\n"
        "sun_elevation_degrees = 45\nwater_level_m = 0.1\nframes = 7\nterrain_spacing_m = 0.05\n"
    )
    config = Config.from_preset(file).check()
    assert config.rain.rate == pytest.approx(1e-5)
    assert config.rain.past == pytest.approx(4e-3)
    assert config.rain.wind == pytest.approx((2, math.pi / 2))
    assert config.rain.wind_velocity == pytest.approx((0, 2), abs=1e-12)
    assert config.render.exposure == pytest.approx(4e-3)
    assert config.render.sun == pytest.approx((math.pi, math.pi / 4))
    assert config.render.captured_sun == pytest.approx((math.pi / 2, math.pi / 6))
    assert config.water.level == 0.1
    assert config.frames == 7
    assert config.terrain.spacing == 0.05


def test_a_relative_sky_lies_beside_the_preset_file(tmp_path):
    (tmp_path / "dull.hdr").write_bytes(b"")
    file = tmp_path / "mine.toml"
    file.write_text('sky = "dull.hdr"\n')
    assert Config.from_preset(file).render.sky == str(tmp_path / "dull.hdr")


BAD = [
    ({"rate": -1 * MM_PER_HOUR}, r"rain is -1\.0 mm/h; it must not be negative"),
    ({"rate": math.nan}, "rain is nan; it must be a finite number"),
    ({"rate": math.inf}, "rain is inf; it must be a finite number"),
    ({"rate": 5000 * MM_PER_HOUR}, r"rain is 5000\.0 mm/h; it must be at most 1000"),
    ({"past": -1e-3}, r"past rain is -1\.0 mm"),
    ({"past": math.nan}, "past rain is nan"),
    ({"wind": (-1.0, 0.0)}, "wind speed is -1.0 m/s"),
    ({"wind": 3.0}, "wind is 3.0; it must be a speed and a direction"),
    ({"frames": 0}, "frames is 0; it must be a whole number from 1"),
    ({"frames": 2.5}, "frames is 2.5"),
    ({"frames": True}, "frames is True"),
    ({"fps": 0.0}, "fps is 0.0 frames/s; it must be positive"),
    ({"fps": math.nan}, "fps is nan"),
    ({"fps": 1e-300}, "fps is 1e-300 frames/s; it must lie from 0.1 to 9999 frames/s"),
    ({"fps": 0.001, "exposure": 0.1}, r"fps is 0\.001 frames/s; it must lie from 0\.1"),
    ({"level": 1e300}, r"level is 1e\+300 m; it must lie from -1000 to 1000 m"),
    ({"brightness": 1e300}, r"brightness is 1e\+300; it must lie from 0\.001 to 1000"),
    ({"drying": 1e300}, r"drying is 2\.77777778e\+296 h; it must lie from 0 to 10000 h"),
    ({"wind": (1.0, 1e9)}, r"wind is 1000000000\.0; it must lie from"),
    ({"surroundings": (0.0, 0.0, 1e300)}, r"surroundings is 1e\+300 units; it must lie"),
    ({"width": 0}, "width is 0 px"),
    ({"height": 10**6}, "height is 1000000 px"),
    ({"threads": 0}, "threads is 0"),
    ({"seed": -1}, "seed is -1"),
    ({"exposure": 0.0}, "exposure is 0.0 ms; it must be positive"),
    ({"exposure": 0.05}, r"exposure is 50 ms; it must be at most one frame, 41\.67 ms at 24"),
    ({"fps": 100.0}, r"exposure is 16\.67 ms; it must be at most one frame, 10 ms at 100"),
    ({"frame_range": (3, 3)}, r"frame range is 3:3; it must satisfy 0 <= A < B <= 24"),
    ({"frame_range": (0, 25)}, r"frame range is 0:25"),
    ({"cloudiness": 1.5}, "cloudiness is 1.5; it must lie from 0"),
    ({"brightness": 0.0}, "brightness is 0.0; it must be positive"),
    ({"sun": (0.0, 2.0)}, "sun elevation is 114.59"),
    ({"sky": "sunny"}, "sky is 'sunny'; it must be overcast or capture or the path"),
    ({"scheme": "magic"}, "water scheme is 'magic'; it must be one of auto, accurate, lean, paper"),
    ({"level": math.nan}, "water level is nan"),
    ({"courant": 2.0}, "courant is 2.0"),
    ({"spacing": 0.0}, "terrain spacing is 0.0 m; it must be positive"),
    ({"spacing": 3.0}, "terrain spacing is 3.0 m; it must be at most 0.5 m"),
    ({"extent": 0.01}, "terrain extent is 0.01 m"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=lambda v: str(v)[:40])
def test_a_bad_value_is_named_with_its_rule(changes, message):
    with pytest.raises(ParameterError, match=message) as caught:
        Config().replace(**changes).check()
    assert "\n" not in str(caught.value)


def test_a_missing_sky_file_is_an_input_error():
    with pytest.raises(InputError, match=r"there is no sky file nowhere\.hdr"):
        Config().replace(sky="nowhere.hdr").check()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rain_mm_hour = 3", "key 'rain_mm_hour'; the nearest is 'rain_mm_per_hour'"),
        ("xyzzy = 3", "key 'xyzzy'; known are rain_mm_per_hour"),
        ('rain_mm_per_hour = "a"', "rain_mm_per_hour is 'a'; it must be a finite number"),
        ("rain_mm_per_hour = true", "rain_mm_per_hour is True"),
        ("rain_mm_per_hour = nan", "rain_mm_per_hour is nan; it must be a finite number"),
        (f"rain_mm_per_hour = 1{'0' * 400}", "it must be a finite number"),
        ("rain_mm_per_hour = ", "is not valid TOML"),
        ("sun_azimuth_degrees = 3", "sun_azimuth_degrees but no sun_elevation_degrees"),
        ("[rain]\nrate = 3", "has the key 'rain'"),
        ("frames = 0", "mine.toml: frames is 0"),
        ("sky = 3", "sky is 3"),
    ],
)
def test_a_bad_preset_file_is_named_with_its_key(tmp_path, text, message):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(ParameterError, match=re.escape(message)) as caught:
        Config.from_preset(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed = " + "9" * 5000, "a line of 5007 characters"),
        ("seed = " + "[" * 990, "TOML"),
        ("seed = " + "9" * 900, r"seed is 9{50,60}\.\.\."),
        ("wind_direction_degrees = inf", "must be a finite number"),
        ("[[keyframe]]\ntime_s = 0\nwind_direction_degrees = inf", "must be a finite number"),
        (f"[[keyframe]]\ntime_s = 1{'0' * 400}\nrain_mm_per_hour = 1", "time_s is 1000"),
        ("a" + ".b" * 600 + " = 1", "a line of 1205 characters"),
        ("a" * 900 + " = 1", r"the key 'a{50,60}\.\.\.;"),
        ("#" + "a" * 2**20, "at most 1048576"),
    ],
)
def test_preset_files_made_to_break_the_reader(tmp_path, text, message):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(RainsimError, match=message) as caught:
        Config.from_preset(path)
    assert len(str(caught.value)) < 700 and "\n" not in str(caught.value)


def test_texts_made_to_break_the_reader():
    for value, message in (("9" * 5000, "thousands of digits"), ("[" * 10_000, "without end")):
        with pytest.raises(ParameterError, match=message):
            Config.from_toml(f"seed = {value}")


def test_a_preset_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfframes = 7\n")
    assert Config.from_preset(tmp_path / "a.toml").frames == 7


def test_unknown_presets_and_attributes_name_the_nearest():
    with pytest.raises(ParameterError, match="no preset 'drizle'; the nearest is 'drizzle'"):
        Config.from_preset("drizle")
    with pytest.raises(ParameterError, match="rats is not a setting; the nearest is 'rate'"):
        Config().replace(rats=1)
    with pytest.raises(InputError, match=r"none\.toml does not exist"):
        Config.from_preset("none.toml")
    with pytest.raises(ParameterError, match=r"no preset '\.\./flood'"):
        Config.from_preset("../flood")


def test_every_key_of_the_presets_is_known_and_explained():
    for name in preset_names():
        text = preset_text(name)
        assert text.startswith("# ")
        keys = re.findall(r"^(\w+) =", text, flags=re.MULTILINE)
        assert set(keys) <= set(HUMAN_KEYS) and "rain_mm_per_hour" in keys
