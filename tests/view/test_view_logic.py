"""What the page shows when: the schedule, the clock, what a change costs; no picture is drawn."""

import math
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rainsim.commands.view import _address_for, _serve
from rainsim.config.declare import BASES, LIGHT, WATER
from rainsim.config.preset_files import from_human
from rainsim.config.preset_writer import preset_text_of
from rainsim.config.settings import Config, preset_names
from rainsim.config.tables import HUMAN_KEYS, OPTION_KEYS, PARTS, SETTINGS, SLIDERS, si_value
from rainsim.errors import InputError, ParameterError
from rainsim.scene.camera_path import (
    camera_path_data,
    path_cameras,
    path_keyframes,
    path_moments,
)
from rainsim.view import schedule
from rainsim.view.clock import PlayClock
from rainsim.view.keyframes import (
    Keyframe,
    moments_of,
    path_config,
    placed,
    smooth_path,
    timeline_of,
    times_of,
    view_at,
    with_timeline,
    without,
)
from rainsim.view.page_keyframes import FRUSTUM, behind
from rainsim.view.schedule import EXACT, SHARP, SMALL, STILL_AFTER, Schedule
from rainsim.view.session import Viewpoint, out_of_date
from rainsim.view.threads import ThreadChoice
from rainsim.view.water_states import SharedWater

LATER = STILL_AFTER + 0.01


def looking(*keys, **settings):
    """A schedule with clients that have a camera, at time 0."""
    plan = Schedule(**settings)
    for key in keys:
        plan.add(key, 0.0)
        plan.move(key, f"view of {key}", 1.5, 0.0)
    return plan


def draw(plan, now, seconds=0.01):
    """Take the next job and finish it."""
    job, _ = plan.next(now)
    plan.done(job, seconds, now + seconds)
    return job


# --- schedule -------------------------------------------------------------------------------------


def test_a_moving_camera_gets_small_pictures_and_a_still_one_the_full_one():
    plan = looking("a")
    plan._pace = plan._simple_pace = 1.0  # a machine that is slow beyond all measure
    job = draw(plan, 0.0)
    assert (job.width, job.height, job.step) == (324, 216, SMALL)
    job, wait = plan.next(0.05)
    assert job is None and 0 < wait <= STILL_AFTER
    job = draw(plan, LATER)
    assert (job.width, job.height, job.step) == (648, 432, EXACT)
    assert plan.next(9.0) == (None, None)  # nothing to do until something changes
    assert plan.move("a", "another view", 1.5, 10.0) and not plan.move("a", "another view", 1.5, 11)
    assert draw(plan, 10.0).step == SMALL


def test_small_pictures_are_as_large_as_the_machine_is_fast_between_floor_and_full():
    plan = looking("a", least=200, full=1000, simplifies=False)
    widths = []
    for pace in (1e-6, 8e-8, 1e-9):  # s a pixel
        for n in range(40):
            plan.move("a", (pace, n), 1.5, n)
            job, _ = plan.next(n)
            plan.done(job, pace * (job.width * job.height + schedule.FIXED_PIXELS), n)
        widths.append(plan.moving_width())
    assert widths[0] == 200 < widths[1] < 1000 == widths[2]
    assert Schedule(adapts=False, full=1000).moving_width() == 1000


def test_slow_machines_simplify_what_moves_and_nothing_that_stands_still():
    plan = looking("a")
    plan.done(plan.next(0.0)[0], 0.09, 0.0)  # 90 ms for the least picture
    for n in range(30):
        plan.move("a", n, 1.5, n)
        job, _ = plan.next(n)
        plan.done(job, 0.04 if job.simple else 0.09, n)
    assert plan.is_slow and job.simple and 324 <= job.width <= 648
    job, _ = plan.next(40.0)
    assert job.step == EXACT and not job.simple
    plan.simplifies = False
    assert not plan.is_slow and plan.moving_width() == 324


def test_a_full_picture_is_given_up_when_the_camera_moves_and_a_small_one_is_not():
    plan = looking("a")
    small, _ = plan.next(0.0)
    plan.move("a", "v2", 1.5, 0.01)
    assert plan.may_go_on(small) and not plan.is_current(small)
    plan.done(small, 0.01, 0.02)
    draw(plan, 0.02)  # the small one of the new camera
    full, _ = plan.next(0.02 + LATER)
    assert full.step == EXACT and plan.may_go_on(full)
    plan.move("a", "v3", 1.5, 0.3)
    assert not plan.may_go_on(full)
    plan.remove("a")
    assert not plan.may_go_on(small) and plan.next(9.0) == (None, None)


def test_clients_take_turns_and_moving_ones_go_first():
    plan = looking("a", "b", "c")
    assert {draw(plan, 0.1 * n).client for n in range(3)} == {"a", "b", "c"}
    assert draw(plan, 1.0).step == EXACT
    plan.move("c", "v2", 1.5, 1.1)
    job = draw(plan, 1.1)
    assert (job.client, job.step) == ("c", SMALL)
    assert draw(plan, 1.2).step == EXACT  # of a client that stands still meanwhile
    served = []
    for n in range(6):  # two that move all the time
        for key in "ab":
            plan.move(key, (n, key), 1.5, 2.0 + n)
        served.append(draw(plan, 2.0 + n).client)
    assert abs(served.count("a") - served.count("b")) <= 1


def test_parts_out_of_date_are_refined_in_two_steps():
    plan = looking("a", stale=True)
    plan._pace = 1.0
    steps = [draw(plan, 0.0).step, draw(plan, LATER).step, draw(plan, 2 * LATER).step]
    assert steps == [SMALL, SHARP, EXACT]
    plan.change(1.0)
    plan.stale = False
    assert [draw(plan, 1.0).step, draw(plan, 1.0 + LATER).step] == [SMALL, EXACT]


def test_nothing_is_refined_while_time_plays():
    plan = looking("a", plays=True)
    draw(plan, 0.0)
    assert plan.next(9.0) == (None, None)


def test_a_change_for_one_client_leaves_the_others_alone():
    plan = looking("a", "b")
    for n in range(4):
        draw(plan, n)
    plan.change(9.0, "b")
    assert draw(plan, 9.0).client == "b"
    assert draw(plan, 9.0 + LATER).client == "b"
    assert plan.next(20.0) == (None, None)


def drawn_with(choice, seconds, count):
    """Draw pictures that take seconds[threads]; return the numbers of threads that were used."""
    used = []
    for _ in range(count):
        used.append(choice.next())
        choice.took(used[-1], seconds[used[-1]])
    return used


def test_pictures_in_motion_are_drawn_with_the_number_of_threads_that_is_faster():
    choice = ThreadChoice(4)
    assert choice.faster == 4 and choice.next() == 4
    used = drawn_with(choice, {4: 0.08, 3: 0.05}, 46)
    assert sorted(used[:6]) == [3, 3, 3, 4, 4, 4]  # both are tried
    assert used[6:].count(4) == 1 and choice.faster == 3  # and the slower one again, rarely
    used = drawn_with(choice, {4: 0.03, 3: 0.05}, 120)  # the browser has gone
    assert choice.faster == 4 and used[-20:].count(4) >= 19
    assert drawn_with(ThreadChoice(1), {1: 0.1}, 60) == [1] * 60
    assert set(drawn_with(ThreadChoice(2), {1: 0.1, 2: 0.1}, 60)) == {1, 2}


# --- time -----------------------------------------------------------------------------------------


def test_time_plays_at_its_speed_loops_and_stands_still():
    clock = PlayClock(frames=3, fps=10.0)
    assert clock.wait(0.0) is None and not clock.tick(5.0)
    clock.play(0.0)
    assert clock.wait(0.0) == pytest.approx(0.1)
    assert [clock.tick(t) for t in (0.05, 0.1, 0.15, 0.2, 0.31)] == [False, True, False, True, True]
    assert clock.index == 0  # after the last frame the first
    clock.speed = 0.25
    clock.play(1.0)
    assert not clock.tick(1.3) and clock.tick(1.4) and clock.time == pytest.approx(0.1)
    clock.loops = False
    for t in (2, 3, 4):
        clock.tick(t)
    assert clock.index == 2 and not clock.plays
    assert clock.go_to(99) is False and clock.go_to(-1) and clock.index == 0


def test_a_late_machine_slows_time_and_leaves_no_frame_out():
    clock = PlayClock(frames=100, fps=100.0)
    clock.play(0.0)
    for n in range(1, 6):
        assert clock.tick(float(n)) and clock.index == n


# --- what a change costs --------------------------------------------------------------------------


def test_every_setting_has_its_cost():
    for one in SETTINGS.values():
        assert set(one.touches) <= set(BASES)
    for slider in SLIDERS:
        assert HUMAN_KEYS[slider.key][0] in SETTINGS


def test_a_change_makes_no_more_out_of_date_than_it_must():
    base = Config.from_preset("moderate")
    assert out_of_date(base, base) == set()
    assert out_of_date(base, base.replace(brightness=2.0, reflections="ssr")) == set()
    assert out_of_date(base, base.replace(seed=7)) == {WATER}
    assert out_of_date(base, base.replace(cloudiness=0.1)) == {LIGHT}
    assert out_of_date(base, base.replace(rate=0.0)) == {WATER, LIGHT}
    assert out_of_date(base, base.replace(spacing=0.1)) == set(BASES)


# --- the table of controls ------------------------------------------------------------------------


def test_sliders_stay_within_the_rules():
    for slider in SLIDERS:
        attribute = HUMAN_KEYS[slider.key][0]
        for number in (slider.low, slider.high):
            table = {slider.key: number}
            if attribute in PARTS:
                table = {key: 0.0 for key, _ in PARTS[attribute]} | table
            config = Config().replace(**from_human(table, "a slider"))
            config.check()
            assert si_value(slider.key, number) in np.ravel(config.value(attribute))
        assert slider.low < slider.high and 0 < slider.step <= slider.high - slider.low


def test_options_of_the_command_line_are_those_of_the_table():
    from rainsim.cli import cli

    names = {p.name for p in cli.commands["run"].params}
    assert set(OPTION_KEYS) <= names
    assert {key for keys in OPTION_KEYS.values() for key in keys} <= set(HUMAN_KEYS)


@pytest.mark.parametrize("name", preset_names())
def test_settings_are_written_as_a_preset_that_reads_back_exactly(name, tmp_path):
    sky = tmp_path / 'a\x7f"b\\ä.hdr'
    sky.touch()
    config = Config.from_preset(name).replace(
        rate=17.3e-3 / 3600, wind=(3.1, math.radians(41)), surroundings=(1.5, -2.25, 1 / 3), seed=5
    )
    config = config.replace(sun=(math.radians(77), math.radians(33.3)), sky=str(sky))
    assert Config.from_toml(preset_text_of(config, "about")) == config


def test_without_viser_the_command_says_what_to_install(monkeypatch):
    import importlib.util

    from click.testing import CliRunner

    from rainsim.cli import cli

    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "viser" else real(name)
    )
    done = CliRunner().invoke(cli, ["view"], prog_name="rainsim")
    assert done.exit_code == 1
    assert done.stderr == 'Error: the page needs viser; pip install "rainsim[view]"\n'


# --- paths ----------------------------------------------------------------------------------------


def pose(turn=(0.6, 0.0, 0.8, 0.0), place=(1.0, 2.0, 3.0)):
    matrix = np.eye(4)
    matrix[:3, :3] = Viewpoint(place, turn, 1.0).rotation
    matrix[:3, 3] = place
    return matrix


def test_a_camera_path_is_read_as_it_was_written():
    data = camera_path_data([(pose(), 0.9), (pose(place=(0, 0, 1)), 1.1)], 640, 400, 24.0)
    first, second = path_cameras(data, "a.json")
    assert (first.width, first.height, first.cx, first.cy) == (640, 400, 320.0, 200.0)
    assert first.fx == first.fy == pytest.approx(200 / math.tan(0.45))
    np.testing.assert_allclose(first.position, (1, 2, 3), atol=1e-12)
    np.testing.assert_allclose(first.forward, pose()[:3, 2], atol=1e-12)  # OpenCV axes again
    np.testing.assert_allclose(second.position, (0, 0, 1), atol=1e-12)
    assert data["camera_path"][1]["render_time"] == pytest.approx(1 / 24)
    flat = np.reshape(data["camera_path"][0]["camera_to_world"], (4, 4))
    np.testing.assert_allclose(flat[:3, 1], -pose()[:3, 1])  # OpenGL: y up, z back


def test_keyframes_are_read_as_they_were_written():
    marks = [(pose(), 0.9, 0.0, None), (pose(place=(0, 0, 1)), 1.1, 3.5, 0.75)]
    data = camera_path_data([(pose(), 0.9)], 640, 400, 24.0, marks)
    (first, _, none), (second, seconds, time) = path_keyframes(data, "a.json")
    assert none is None and time == 0.75
    np.testing.assert_allclose(first.position, (1, 2, 3), atol=1e-12)
    np.testing.assert_allclose(first.forward, pose()[:3, 2], atol=1e-12)
    np.testing.assert_allclose(second.position, (0, 0, 1), atol=1e-12)
    assert second.fy == pytest.approx(200 / math.tan(0.55)) and seconds == 3.5
    data["keyframes"][1] |= {"override_transition_enabled": False, "override_transition_sec": None}
    assert path_keyframes(data, "a.json")[1][1] == data["default_transition_sec"] == 2.0
    data["keyframes"][1]["matrix"][3] = None
    with pytest.raises(InputError, match=r"a.json keyframe 1.*matrix.*16"):
        path_keyframes(data, "a.json")
    for broken in (None, [], {}, {"keyframes": []}, {"keyframes": [3]}, {"keyframes": 3}):
        with pytest.raises(InputError, match=r"a.json"):
            path_keyframes(broken, "a.json")


def nerfstudio_path(times=None, fps=30, closed=False):
    """A camera path in the layout of nerfstudio's viewer, two keyframes and some frames."""
    matrix = pose() @ np.diag([1.0, -1.0, -1.0, 1.0])
    flat = {"fov": 50.0, "aspect": 1.6}
    keyframe = {"matrix": matrix.ravel().tolist(), **flat}
    keyframe |= {"override_transition_enabled": False, "override_transition_sec": None}
    frames = [{"camera_to_world": matrix.ravel().tolist(), **flat} for _ in range(5)]
    keyframes, own = [dict(keyframe), dict(keyframe)], {}
    keyframes[1] |= {"override_transition_enabled": True, "override_transition_sec": 1.25}
    if times is not None:  # of captures that move only
        own = {"default_time": times[0]}
        for one, time, is_own in zip(keyframes, (times[0], times[-1]), (False, True), strict=True):
            one |= {"render_time": time, "override_time_enabled": is_own}
        for one, time in zip(frames, times, strict=True):
            one["render_time"] = time
    return {
        "default_fov": 50.0, **own, "default_transition_sec": 2.0, "keyframes": keyframes,
        "camera_type": "perspective", "render_height": 400, "render_width": 640, "fps": fps,
        "seconds": 5 / fps, "is_cycle": closed, "smoothness_value": 0.0, "camera_path": frames,
        "crop": {
            "crop_center": [0, 0, 0], "crop_scale": [1, 1, 1], "crop_rot": [0, 0, 0],
            "crop_bg_color": {"r": 38, "g": 42, "b": 55},
        },
    }  # fmt: skip


def test_a_path_in_nerfstudio_s_layout_is_read_with_its_times():
    data = nerfstudio_path()
    assert len(path_cameras(data, "n.json")) == 5 and path_moments(data, "n.json") == ()
    assert [time for _, _, time in path_keyframes(data, "n.json")] == [None, None]
    data = nerfstudio_path([0.1, 0.1, 0.15, 0.2, 0.2])
    assert path_moments(data, "n.json") == (3, 3, 4, 6, 6)
    (_, _, first), (camera, seconds, last) = path_keyframes(data, "n.json")
    assert (first, seconds, last) == (0.1, 1.25, 0.2)
    np.testing.assert_allclose(camera.forward, pose()[:3, 2], atol=1e-12)
    closed = path_keyframes(nerfstudio_path(closed=True), "n.json")
    assert len(closed) == 3 and closed[2][0] is closed[0][0] and closed[2][1] == 2.0
    even = nerfstudio_path([n / 30 for n in range(5)])  # time goes on: the run's own frames
    assert path_moments(even, "n.json") == ()


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.2, 0.1, 0.1, 0.1, 0.1], r"camera_path 1: render_time is 0.1; it must be 0.2 or more"),
        ([0.0, None, 0.1, 0.1, 0.1], r"camera_path 1: render_time is missing"),
        ([0.0, -1.0, 0.1, 0.1, 0.1], r"camera_path 1: render_time is -1.0; it must be a time"),
        ([0.0, "a", 0.1, 0.1, 0.1], r"camera_path 1: render_time is .a.; it must be a time"),
        ([0.0, float("nan"), 0.1, 0.1, 0.1], r"camera_path 1: render_time is nan"),
    ],
)
def test_times_that_no_rain_has_are_refused(times, message):
    data = nerfstudio_path([0.0, 0.1, 0.1, 0.1, 0.1])
    for frame, time in zip(data["camera_path"], times, strict=True):
        frame["render_time"] = time
    with pytest.raises(InputError, match=message):
        path_moments(data, "n.json")
    with pytest.raises(InputError, match="fps is missing"):
        path_moments({**nerfstudio_path([0.0] * 5), "fps": None}, "n.json")


def test_keyframes_that_show_their_own_times_stop_the_rain():
    low, view = Config.from_preset("drizzle"), Viewpoint((0.0, 0.0, 1.0), (1.0, 0, 0, 0), 1.0)
    far = Viewpoint((1.0, 0.0, 1.0), (1.0, 0, 0, 0), 1.0)
    still = [Keyframe(view, low, 2.0, 0.5), Keyframe(far, low, 1.0, 0.5)]
    assert moments_of(still, 24.0) == (12,) * 25
    config = path_config(still, low)
    assert config.moments == (12,) * 25 and config.frames == 25 and config.moment(3) == 12
    assert Config.from_dict(config.as_dict()) == config
    slow = [Keyframe(view, low, 2.0, 0.0), Keyframe(far, low, 1.0, 0.5)]
    assert moments_of(slow, 24.0) == tuple(np.rint(np.arange(25) / 2).astype(int).tolist())
    going = [Keyframe(view, low, 2.0), Keyframe(far, low, 1.0)]
    assert moments_of(going, 24.0) == () == path_config(going, low).moments
    poses = [(pose(), 0.9)] * 25
    data = camera_path_data(poses, 640, 400, 24.0, (), moments_of(slow, 24.0))
    assert path_moments(data, "a.json") == moments_of(slow, 24.0)
    with pytest.raises(ParameterError, match="others have none"):
        moments_of([still[0], going[1]], 24.0)
    with pytest.raises(ParameterError, match="runs forwards"):
        moments_of([slow[1], slow[0]], 24.0)
    bright = low.replace(brightness=2.0)
    with pytest.raises(ParameterError, match=r"brightness change .* stands still"):
        path_config([still[0], Keyframe(far, bright, 1.0, 0.5)], low)
    changed = path_config([slow[0], Keyframe(far, bright, 1.0, 0.5)], low)
    assert changed.at(0.5).render.brightness == 2.0  # in times of the rain
    with pytest.raises(ParameterError, match="moments of frames are 25 for 24"):
        config.replace(frames=24).check()
    for wrong in (11, -1, 12.0, True):
        with pytest.raises(ParameterError, match="moment of a frame is"):
            replace(config, moments=(*config.moments[:-1], wrong)).check()


def test_a_path_goes_through_its_keyframes_without_a_jump():
    config = Config.from_preset("drizzle")
    frames = [
        Keyframe(Viewpoint((float(n), n % 2, 1.0), t, 0.8 + 0.1 * n), config, 1.0)
        for n, t in enumerate([(1.0, 0, 0, 0), (0.6, 0, 0.8, 0), (0.0, 0, 1.0, 0)])
    ]
    views = smooth_path(frames, 10.0)
    assert len(views) == 21
    for n, frame in zip((0, 10, 20), frames, strict=True):
        np.testing.assert_allclose(views[n].position, frame.view.position, atol=1e-9)
        np.testing.assert_allclose(views[n].rotation, frame.view.rotation, atol=1e-9)
        assert views[n].fov == pytest.approx(frame.view.fov)
    steps = np.linalg.norm(np.diff([v.position for v in views], axis=0), axis=1)
    assert steps[0] < 0.3 * steps.max() and np.abs(np.diff(steps)).max() < 0.35 * steps.max()
    assert smooth_path(frames[:1], 10.0) == [frames[0].view]
    with pytest.raises(ParameterError, match="there is no keyframe"):
        smooth_path([], 10.0)
    with pytest.raises(ParameterError, match="time between keyframes"):
        smooth_path([frames[0], Keyframe(frames[1].view, config, 0.0)], 10.0)


def test_the_frustum_of_a_keyframe_is_not_seen_from_its_place():
    view = Viewpoint((1.0, 2.0, 3.0), (0.6, 0.0, 0.8, 0.0), 1.1)
    place, ahead = behind(view, 1.5), view.rotation[:, 2]
    length = FRUSTUM / math.cbrt(math.tan(0.55) ** 2 * 1.5 / 3)
    rim = (place + length * ahead - view.position) @ ahead
    assert -0.05 * length < rim < 0
    np.testing.assert_allclose(np.cross(place - view.position, ahead), 0, atol=1e-12)


def test_a_timeline_is_the_list_and_the_list_a_timeline(root):
    """Without a path the camera stands still; with one it goes as before."""
    text = (root / "examples/timeline.toml").read_text()
    given = Config.from_toml(text)
    view = Viewpoint((0.0, -2.0, 1.0), (1.0, 0.0, 0.0, 0.0), 0.9)
    alone = with_timeline([], given, view)
    np.testing.assert_allclose(times_of(alone), [0, 1, 3, 5, 6.5, 8])
    assert {keyframe.view for keyframe in alone} == {view}
    again = path_config(alone, given.replace(fps=24.0))
    for time in np.linspace(0, 8, 33):
        for name in ("rate", "past", "wind", "cloudiness", "brightness"):
            one, other = (config.at(time).value(name) for config in (given, again))
            np.testing.assert_allclose(one, other, atol=1e-12)
    path = [Keyframe(view, given), Keyframe(replace(view, position=(1.0, 0.0, 1.0)), given, 4.0)]
    both = with_timeline(path, given, None)
    np.testing.assert_allclose(times_of(both), [0, 1, 3, 4, 5, 6.5, 8])
    np.testing.assert_allclose(both[2].view.position, view_at(path, 3.0).position)
    assert both[3].view == path[1].view


def test_keyframes_keep_their_times_when_one_goes_or_moves():
    view, config = Viewpoint((0.0, -2.0, 1.0), (1.0, 0.0, 0.0, 0.0), 0.9), Config()
    three = [Keyframe(replace(view, fov=0.5 + n), config, 1.0 + n) for n in range(3)]  # 0, 2, 5 s
    assert times_of(without(three, 1)).tolist() == [0, 5]
    assert times_of(without(three, 0)).tolist() == [0, 3]
    moved = placed(three, [0.0, 6.0, 5.0])
    assert [k.view.fov for k in moved] == [0.5, 2.5, 1.5] and times_of(moved).tolist() == [0, 5, 6]
    with pytest.raises(ParameterError, match="two keyframes are at 5 s"):
        placed(three, [0.0, 5.0, 5.0])


def test_settings_of_keyframes_become_a_timeline():
    low, view = Config.from_preset("drizzle"), Viewpoint((0.0, 0.0, 1.0), (1.0, 0, 0, 0), 1.0)
    high = low.replace(rate=1e-5, cloudiness=1.0, seed=3)
    keyframes = [Keyframe(view, low), Keyframe(view, high, 2.0)]
    assert timeline_of([Keyframe(view, low), Keyframe(view, low, 1.0)]) == ()
    config = path_config(keyframes, high)
    assert config.frames == 49 and config.rain.seed == 3  # what cannot change is the present one
    assert config.at(0.0).rain.rate == low.rain.rate
    assert config.at(2.0).rain.rate == 1e-5
    assert low.rain.rate < config.at(1.0).rain.rate < 1e-5
    assert Config.from_toml(preset_text_of(config)) == config
    with pytest.raises(ParameterError, match="level is set at some keyframes only"):
        timeline_of([Keyframe(view, low), Keyframe(view, low.replace(level=0.1), 1.0)])


# --- water ----------------------------------------------------------------------------------------


class State:
    def __init__(self, index):
        self.index, self.time = index, index / 10
        self.depth = np.full((3, 4), index, np.float64)


def test_water_is_simulated_once_and_kept_within_its_bytes():
    begun = []

    def simulate(terrain, config):
        begun.append(terrain)
        for index in range(1000):
            yield State(index)

    water = SharedWater(simulate, most=5 * 96)
    water.restart("terrain", None)
    assert water.state(3).index == 3 and water.state(1).index == 1 and begun == ["terrain"]
    assert water.indices == [0, 1, 2, 3]
    for index in range(20):
        assert water.state(index).index == index
    assert len(water.indices) <= 5 and 0 in water.indices and begun == ["terrain"]
    times, depths = water.depths_at(1, 2)
    assert (depths == np.array(water.indices)).all() and (times == depths / 10).all()
    assert water.state(2).index == 2 and len(begun) == 2  # forgotten: simulated again
    water.restart("another", None)
    assert water.state(0).index == 0 and begun[-1] == "another"


def test_a_search_for_a_state_can_be_given_up_between_steps():
    water = SharedWater(lambda terrain, config: map(State, range(100)))
    steps = []

    def check():
        steps.append(1)
        if len(steps) > 3:
            raise InterruptedError

    water._states = None
    with pytest.raises(InterruptedError):
        water.state(10, check)
    assert water.indices == [0, 1, 2]


def test_the_constants_keep_what_the_page_promises():
    assert schedule.LEAST_WIDTH >= 324 and 2 * schedule.TARGET < 0.15


@pytest.mark.parametrize("moment", ["page", "address"])
def test_ctrl_c_before_the_loop_leaves_no_thread(moment, monkeypatch, tmp_path):
    """The thread that draws is no daemon: left running, it would keep the process alive."""
    ended, closed = threading.Event(), []

    class OnePage:
        address = "http://127.0.0.1:1"

        def __init__(self, *_):
            if moment == "page":
                raise KeyboardInterrupt

        def close(self):
            closed.append(True)

    class Hand:
        def __init__(self, *_, **__):
            pass

        def run(self):
            ended.wait(20)

        def end(self):
            ended.set()

    def say(text):
        if text != "ended":
            raise KeyboardInterrupt

    for name, members in (
        ("page", {"Page": OnePage}), ("painter", {"Painter": Hand}),
        ("home", {"Home": lambda *_: None}),
    ):  # fmt: skip
        monkeypatch.setitem(sys.modules, f"rainsim.view.{name}", SimpleNamespace(**members))
    session = SimpleNamespace(config=SimpleNamespace(width=648))
    _serve(SimpleNamespace(say=say), session, None, tmp_path, None, None, 0, None)
    assert ended.is_set() and closed == [True] * (moment == "address")
    assert not any(thread.name == "painter" for thread in threading.enumerate())


@pytest.mark.parametrize(
    ("width", "has_graphics", "end"),
    [(648, False, "/?fixedDpr=0.5"), (648, True, ""), (1297, False, "")],
)
def test_the_address_asks_for_fewer_pixels_where_a_processor_draws_the_page(
    width, has_graphics, end
):
    address = "http://127.0.0.1:8080"
    assert _address_for(address, width, has_graphics) == address + end
