"""Properties of settings, timelines and camera paths, checked on values that hypothesis makes.

The default lane takes some examples of each, the slow one thousands; both are the same every time.
"""

import json
import math
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from rainsim.config import timeline
from rainsim.config.preset_files import HUMAN_KEYS, preset_names
from rainsim.config.settings import Config
from rainsim.config.tables import SLIDERS
from rainsim.errors import ParameterError, RainsimError
from rainsim.render.shutter import FASTEST, FASTEST_TURN, PathMotion
from rainsim.scene.camera_rule import MOST_FOV
from rainsim.scene.cameras import (
    look_at,
    mirrored_camera,
    orbit,
    resize_to,
)
from refusals import one_clear_line
from scenes import ground_frame

QUICK, MANY = 60, 5_000
ATTRIBUTES = [a for a, _ in HUMAN_KEYS.values()]
ATTRIBUTES += ["terrain", "rain", "frame_range", "threads", "keyframes", "no such setting"]

# Preset keys with values that every rule allows; the two of the sun go together.
NUMBERS = {s.key: (s.low, s.high) for s in SLIDERS if not s.key.startswith("sun_")}
NUMBERS |= {"surface_film": (0, 1), "terrain_spacing_m": (0.005, 0.5)}
GOOD = st.fixed_dictionaries({}, optional={
    **{key: st.floats(*ends, allow_subnormal=False) for key, ends in NUMBERS.items()},
    "seed": st.integers(0, 2**31), "frames": st.integers(1, 1000), "drips": st.booleans(),
    "width": st.integers(64, 4000),
})  # fmt: skip
# What TOML, JSON or a caller may put in place of a value.
ANY = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=12)
    | st.sampled_from([10**400, -(10**400), 1e308, 5e-324, "auto", "", "\x1b[31m", b"a"]),
    lambda inner: st.lists(inner, max_size=4) | st.tuples(inner, inner)
    | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)  # fmt: skip
TIMES = st.lists(st.floats(-10, 1000), min_size=2, max_size=6, unique=True).map(sorted)


def toml(table):
    """The text of a table of plain values."""
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())


# --- settings -------------------------------------------------------------------------------------


def settings_round_trip(table, name, keys):
    assume(table.get("wind_direction_degrees") is None or "wind_speed_m_per_s" in table)
    config = Config.from_toml(toml(table) + "".join(
        f"[[keyframe]]\ntime_s = {n}\ncloudiness = {share!r}\n" for n, share in enumerate(keys)
    ))  # fmt: skip
    for key, value in table.items():
        attribute, unit = HUMAN_KEYS[key]
        group = next(g for g in (config, config.rain, config.water, config.render, config.terrain)
                      if hasattr(g, attribute))  # fmt: skip
        found = getattr(group, attribute)
        if attribute != "wind":
            assert found == (value if unit is None else value * unit)
    stored = json.loads(json.dumps(config.replace(fps=1.0).as_dict()))
    assert Config.from_dict(stored) == config.replace(fps=1.0)
    preset = Config.from_preset(name)
    with tempfile.TemporaryDirectory() as folder:
        (path := Path(folder) / "a.toml").write_text(toml(table))
        assert Config.from_preset(path) == Config.from_toml(toml(table))
    assert Config.from_dict(preset.as_dict()) == preset
    assert preset.replace() == preset


def bad_values_are_one_clear_error(attribute, value, key, keyframes):
    for use in (
        lambda: Config().replace(**{attribute: value}).check(),
        lambda: Config.from_dict({attribute: value}),
        lambda: Config.from_dict({"rain": {attribute: value}, "keyframes": keyframes}),
        lambda: Config.from_dict(value),
        lambda: Config.from_toml(f"{key} = {json.dumps(value, default=repr)}\n"),
        lambda: Config.from_toml(f"[[keyframe]]\n{key} = {json.dumps(value, default=repr)}\n"),
        lambda: timeline.read_keyframes(keyframes, lambda table, where: table, "a.toml"),
        lambda: timeline.from_json(keyframes),
    ):
        try:
            use()
        except RainsimError as error:
            one_clear_line(error)
            assert str(error).isprintable()


def a_range_is_what_it_says(first, end, frames):
    try:
        config = Config().replace(frame_range=(first, end), frames=frames).check()
    except ParameterError as error:
        one_clear_line(error)
        assert not 0 <= first < end <= frames
    else:
        assert list(config.indices) == list(range(first, end))


# --- timelines ------------------------------------------------------------------------------------


def keyframes_of(times, rows):
    return tuple((time, tuple(sorted(row.items()))) for time, row in zip(times, rows, strict=False))


ROWS = st.lists(
    st.fixed_dictionaries({"rate": st.floats(0, 2e-4), "wind": st.tuples(
        st.floats(0, 40), st.floats(-10, 10))}, optional={"cloudiness": st.floats(0, 1)}),
    min_size=6, max_size=6,
)  # fmt: skip


def interpolation_stays_within_its_ends(times, rows, asked):
    frames = timeline.check_keyframes(keyframes_of(times, rows))
    assume(all(b - a > 1e-6 for a, b in pairwise(times)))
    config = Config().replace(keyframes=frames)
    alone = [config.at(time) for time in asked]
    assert [config.at(time) for time in reversed(asked)] == alone[::-1]
    for time, now in zip(asked, alone, strict=True):
        after = next((n for n, at in enumerate(times) if at > time), len(times))
        ends = [rows[max(after - 1, 0)], rows[min(after, len(times) - 1)]]
        rates = sorted(end["rate"] for end in ends)
        slack = 1e-12 * rates[1]
        assert rates[0] - slack <= now.rain.rate <= rates[1] + slack
        assert now.rain.wind[0] <= max(end["wind"][0] for end in ends) * (1 + 1e-12)
        clouds = [config.render.cloudiness, *(r["cloudiness"] for r in rows if "cloudiness" in r)]
        assert min(clouds) - 1e-12 <= now.render.cloudiness <= max(clouds) + 1e-12
        assert now.keyframes == ()
    for time, row in zip(times, rows, strict=False):  # the keyframes themselves
        assert config.at(time).rain.rate == row["rate"]
    for before, row in ((times[0] - 5, rows[0]), (times[-1] + 5, rows[len(times) - 1])):
        assert config.at(before).rain.rate == row["rate"]


def times_must_rise(times, rows, place):
    place %= len(times) - 1
    for wrong in (
        [*times[: place + 1], times[place], *times[place + 1 :]],  # equal
        [*times[:place], times[place + 1], times[place], *times[place + 2 :]],  # swapped
    ):
        with pytest.raises(ParameterError, match="times must rise"):
            timeline.check_keyframes(keyframes_of(wrong, rows * 2))


# --- cameras --------------------------------------------------------------------------------------

POINT = st.tuples(*[st.floats(-20, 20)] * 3)
FOV, SIDE = st.floats(5, 150), st.integers(16, 4000)


def is_rotation(matrix, sign=1):
    return np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-9) and np.isclose(
        np.linalg.det(matrix), sign
    )


def camera_at(eye, target, fov=60.0, width=640, height=480):
    try:
        return look_at(eye, target, (0, 0, 1), fov, width, height)
    except ParameterError as error:  # straight up or down, or nowhere
        one_clear_line(error)
        assume(False)


def shutters_keep_ends_and_rotations(eyes, target, share, fps):
    path = [camera_at(eye, target) for eye in eyes]
    along = PathMotion(path, fps)
    for index, here in enumerate(path):
        last = index + 1 == len(path)
        there = path[index - 1] if last else path[index + 1]
        whole, part, shut = (along.end(index, exposure / fps) for exposure in (1.0, share, 0.0))
        speed = np.linalg.norm(there.position - here.position) * fps
        if whole is None:
            turned = here.camera_from_world[:3, :3] @ there.camera_from_world[:3, :3].T
            angle = math.acos(np.clip((np.trace(turned) - 1) / 2, -1, 1))
            still = speed == 0 and angle < 1e-6
            assert still or speed > FASTEST * 0.999 or angle * fps > FASTEST_TURN * 0.999
            continue
        assert speed <= FASTEST * 1.001
        assert np.allclose(shut.camera_from_world, here.camera_from_world, atol=1e-9)
        if not last:  # the last goes on as it came
            assert np.allclose(whole.camera_from_world, there.camera_from_world, atol=1e-7)
        for camera in (whole, part, shut):
            assert is_rotation(camera.camera_from_world[:3, :3])
        straight = here.position + share * (whole.position - here.position)
        assert np.allclose(part.position, straight, atol=1e-9)


def orbits_are_circles(eyes, count, width):
    frame = ground_frame()
    cameras = [frame.camera_in_capture(camera_at(eye, (0.1, 0.2, 0.0))) for eye in eyes]
    try:
        path = orbit(frame, cameras, (0.0, 0.0, 0.0), count, width)
    except ParameterError as error:
        one_clear_line(error)
        return
    assert len(path) == count and len({camera.name for camera in path}) == count
    grounded = [frame.camera_in_ground(camera) for camera in path]
    places = np.array([camera.position for camera in grounded])
    axis = frame.to_ground(np.zeros(3))
    radii = np.hypot(*(places - axis)[:, :2].T)
    assert np.allclose(radii, radii[0]) and np.allclose(places[:, 2], places[0, 2])
    for camera in grounded:
        assert is_rotation(camera.camera_from_world[:3, :3])
        assert camera.width == width
        seen = camera.camera_from_world[:3] @ np.append(axis, 1.0)
        assert np.allclose(seen[:2], 0, atol=1e-6 * (1 + np.abs(seen[2])))


def sizes_keep_the_view(eye, target, fov, width, height):
    camera = camera_at(eye, target, fov)
    half = camera.width / camera.fx / 2 * max(1, height / width)  # of the longer side
    if math.degrees(2 * math.atan(half)) > MOST_FOV:
        with pytest.raises(ParameterError, match="angle"):
            resize_to(camera, width, height)
        return
    resized = resize_to(camera, width, height)
    assert (resized.width, resized.height) == (width, height)
    assert math.isclose(resized.width / resized.fx, camera.width / camera.fx, rel_tol=1e-9)
    assert np.array_equal(resized.camera_from_world, camera.camera_from_world)
    frame = ground_frame()
    _, mirrored = mirrored_camera(camera, frame, 0.3)
    _, twice = mirrored_camera(mirrored, frame, 0.3)
    assert is_rotation(mirrored.camera_from_world[:3, :3], -1)
    assert np.allclose(twice.camera_from_world, camera.camera_from_world, atol=1e-9)


EYES = st.lists(POINT, min_size=2, max_size=5)
PROPERTIES = {
    settings_round_trip: {"table": GOOD, "name": st.sampled_from(preset_names()),
                          "keys": st.lists(st.floats(0, 1), max_size=3)},
    bad_values_are_one_clear_error: {
        "attribute": st.sampled_from(ATTRIBUTES), "value": ANY,
        "key": st.sampled_from([*HUMAN_KEYS, "time_s", "keyframe"]),
        "keyframes": st.lists(ANY | st.dictionaries(
            st.sampled_from([*HUMAN_KEYS, "time_s", "rate"]), ANY, max_size=3), max_size=3) | ANY},
    a_range_is_what_it_says: dict.fromkeys(("first", "end", "frames"), st.integers(-2, 30))
    | {"frames": st.integers(1, 30)},
    interpolation_stays_within_its_ends: {
        "times": TIMES, "rows": ROWS, "asked": st.lists(st.floats(-20, 1100), max_size=8)},
    times_must_rise: {"times": TIMES, "rows": ROWS, "place": st.integers(0, 10)},
    shutters_keep_ends_and_rotations: {"eyes": EYES, "target": POINT, "share": st.floats(0, 1),
                                       "fps": st.floats(0.1, 120)},
    orbits_are_circles: {"eyes": EYES, "count": st.integers(1, 12), "width": SIDE},
    sizes_keep_the_view: {"eye": POINT, "target": POINT, "fov": FOV, "width": SIDE,
                          "height": SIDE},
}  # fmt: skip


def examine(check, count):
    """Check a property on `count` examples, the same ones every time."""
    run = given(**PROPERTIES[check])(check)
    quiet = [HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large]
    settings(
        max_examples=count, derandomize=True, deadline=None, database=None,
        suppress_health_check=quiet,
    )(run)()  # fmt: skip


@pytest.mark.parametrize("check", PROPERTIES, ids=lambda check: check.__name__)
def test_some_examples(check):
    examine(check, QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("check", PROPERTIES, ids=lambda check: check.__name__)
def test_thousands_of_examples(check):
    examine(check, MANY)
