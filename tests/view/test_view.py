"""The session behind the page, on the tiny scene and without a browser."""

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rainsim.commands.given import cameras_of
from rainsim.commands.given import settings as settings_of
from rainsim.config.declare import BASES
from rainsim.config.settings import Config, mm_per_hour
from rainsim.errors import ParameterError
from rainsim.io.images import read_image
from rainsim.pipeline import FrameSequence, render_rain
from rainsim.render.shutter import PathMotion
from rainsim.scene.cameras import look_at, resize_to
from rainsim.scene.folder import override_ground_frame
from rainsim.scene.library import load_scene
from rainsim.surface.offered_views import offered_cameras
from rainsim.terrain.classify import read_mask
from rainsim.terrain.poured import painted_water, read_water_mask
from rainsim.terrain.table import GRASS
from rainsim.view import probe
from rainsim.view.home import Home
from rainsim.view.keyframes import Keyframe
from rainsim.view.modes import MODES, PUDDLES, RAIN, colored, mode_picture
from rainsim.view.painter import Painter
from rainsim.view.schedule import EXACT, SMALL
from rainsim.view.session import OutOfDateError, Session
from scenes import DIP_CENTRE, tiny_scene

SIZE = 64, 48


def settings(scene, **changes):
    base = {
        "rate": mm_per_hour(20.0), "past": 4e-3, "frames": 3, "width": SIZE[0], "extent": 1.0,
        "spacing": 0.04,
    }  # fmt: skip
    if scene.cameras:
        base["surroundings"] = tuple(float(v) for v in scene.cameras[0].position)
    return Config().replace(**{**base, **changes})


@pytest.fixture(scope="module")
def scene():
    return tiny_scene()


@pytest.fixture(scope="module")
def made(scene):
    """A session with all parts, and the view of the scene's first camera."""
    session = Session(scene, settings(scene))
    session.make()
    return session, session.viewpoint_of(scene.cameras[0])


@pytest.fixture
def session(made):
    """The session with the settings that it was made with."""
    session = made[0]
    session.set_config(settings(session.scene))
    session.make()
    return session


@pytest.fixture(scope="module")
def view(made):
    return made[1]


def other(view, by=0.2):
    return replace(view, position=(view.position[0] + by, *view.position[1:]))


# --- session --------------------------------------------------------------------------------------


def test_a_page_sees_what_the_capture_s_camera_sees(scene, made, view):
    camera = resize_to(scene.cameras[0], SIZE[0])
    seen = made[0].camera_of(view, *SIZE)
    np.testing.assert_allclose(seen.camera_from_world, camera.camera_from_world, atol=1e-9)
    assert seen.fx == pytest.approx(camera.fx) and (seen.cx, seen.cy) == (camera.cx, camera.cy)


CHANGES = {
    "picture": {"brightness": 1.7, "exposure": 0.02},
    "passes": {"seed": 5, "reflections": "ssr"},
    "metering": {"metering": "off", "ripples": 0.2},
    "light": {"cloudiness": 0.2, "sun": (0.4, 0.7)},
    "rain": {"rate": mm_per_hour(60.0), "wind": (6.0, 1.0)},
    "puddles": {"past": 9e-3, "drying": 600.0},
    "flood": {"level": 0.02},
}


def same_as_new(scene, session, view, configs):
    """Draw with settings one after the other; compare the last picture with a new session's."""
    before = session.draw(view, *SIZE, 1)[0]
    for config in configs:
        session.set_config(config)
        session.draw(view, *SIZE, 1)  # the first try, from parts that are out of date
        session.make()
    changed = session.draw(view, *SIZE, 1)[0]
    fresh = Session(scene, configs[-1])
    fresh.make()
    np.testing.assert_array_equal(changed, fresh.draw(view, *SIZE, 1)[0])
    assert (changed != before).any()


def test_changed_settings_draw_what_a_new_session_draws(scene, session, view):
    names, changes = ("light", "passes", "picture"), {}
    configs = [settings(scene, **(changes := changes | CHANGES[name])) for name in names]
    same_as_new(scene, session, view, configs)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_each_changed_setting_draws_what_a_new_session_draws(scene, session, view, name):
    same_as_new(scene, session, view, [settings(scene, **CHANGES[name])])


def test_a_picture_that_does_not_fit_into_memory_is_refused(session, view, monkeypatch):
    monkeypatch.setattr("rainsim.render.memory.free_memory", lambda: int(1e9))
    assert session.draw(view, *SIZE, 1)[0].shape == (SIZE[1], SIZE[0], 3)
    with pytest.raises(ParameterError, match="a picture of 16384 x 9000 pixels takes some 32"):
        session.draw(view, 16384, 9000, 1)


def test_a_first_try_shows_the_change_at_once(scene, session, view):
    before = session.draw(view, *SIZE, 0)[0]
    session.set_config(settings(scene, brightness=0.5))
    assert not session.stale
    assert session.draw(view, *SIZE, 0)[0].mean() < 0.8 * before.mean()
    session.set_config(settings(scene, rate=0.0, past=0.0, cloudiness=0.0))
    assert session.stale
    assert (session.draw(view, *SIZE, 0)[0] != before).mean() > 0.3


def test_a_picture_that_is_given_up_leaves_no_trace(session, view):
    whole = session.draw(view, *SIZE, 0)[0]
    moved = other(view)
    for most in range(6):
        marks = []

        def check(marks=marks, most=most):
            marks.append(1)
            if len(marks) > most:
                raise OutOfDateError

        with pytest.raises(OutOfDateError):
            session.draw(moved, *SIZE, 0, check=check)
    np.testing.assert_array_equal(session.draw(view, *SIZE, 0)[0], whole)


def test_simple_reflections_leave_the_finished_picture_alone(session, view):
    whole = session.draw(view, *SIZE, 0)[0].copy()
    simple = session.draw(view, *SIZE, 0, simple=True)[0].copy()
    assert 0 < np.abs(simple.astype(int) - whole).mean() < 8
    np.testing.assert_array_equal(session.draw(view, *SIZE, 0)[0], whole)


def test_another_scale_makes_all_parts_again(scene, made, view):
    session = Session(scene, settings(scene))
    session.make()
    twice = override_ground_frame(scene, meters_per_unit=2 * scene.ground_frame.meters_per_unit)
    session.set_scene(twice)
    assert session.stale == set(BASES)
    session.make()
    assert session.renderer.conductor.wet_scene.frame is twice.ground_frame


# --- modes ----------------------------------------------------------------------------------------


def test_every_mode_is_a_picture_of_its_own(session, view):
    shot, seen = (view, *SIZE, 1), set()
    rain = session.draw(*shot)[0].copy()
    for name in MODES:
        picture, depth = mode_picture(session, name, 8.0, shot)
        assert picture.shape == rain.shape and picture.dtype == np.uint8
        assert depth.shape == rain.shape[:2] and np.median(depth) == pytest.approx(1.6, abs=0.6)
        assert (picture == rain).all() == (name == RAIN), name
        seen.add(picture.tobytes())
    assert len(seen) >= len(MODES) - 1  # without a sun there is no highlight


def test_puddles_grow_with_the_rain_and_classes_have_their_colours(session, view):
    shot = view, *SIZE, 0
    clean = mode_picture(session, "clean capture", 0, shot)[0].astype(int)
    few, many = (mode_picture(session, PUDDLES, mm, shot)[0].astype(int) for mm in (0.2, 8.0))
    assert (many != clean).sum() > (few != clean).sum() > 0
    assert tuple(colored(np.array([0.0, 1.0, np.nan]))[2]) == (68, 1, 84)


# --- points ---------------------------------------------------------------------------------------


def test_a_click_reads_the_ground_and_its_water(session, view):
    frame, terrain = session.scene.ground_frame, session.terrain
    camera = frame.camera_in_ground(session.camera_of(view, *SIZE))
    row, column, _ = terrain.grid.cells(*DIP_CENTRE)
    x, y, z = camera.camera_from_world[:3, :3] @ (
        *DIP_CENTRE, terrain.bed[row, column]
    ) + camera.camera_from_world[:3, 3]  # fmt: skip
    place = (camera.fx * x / z + camera.cx) / SIZE[0], (camera.fy * y / z + camera.cy) / SIZE[1]
    point = probe.point_at(session, view, place, SIZE)
    np.testing.assert_allclose(point[:2], DIP_CENTRE, atol=0.03)
    reading = probe.read_point(session, point, 1)
    assert reading.ground == pytest.approx(-0.010, abs=0.006) and reading.depth > 1e-3
    assert "paving, measured" in reading.lines()[2] and reading.lines()[3].startswith("water ")
    np.testing.assert_allclose(frame.to_ground(reading.capture_point), point, atol=1e-9)
    beside = probe.read_point(session, (50.0, 0.0, 0.0), 1)
    assert beside.cell is None and beside.lines()[-1] == "beside the map"


def test_nothing_solid_is_one_clear_error(session, view):
    up = look_at((0.0, 0.0, 1.0), (0.3, 0.0, 3.0), (0, 0, 1), 60.0, *SIZE)
    above = session.viewpoint_of(session.scene.ground_frame.camera_in_capture(up))
    with pytest.raises(ParameterError, match="nothing solid"):
        probe.point_at(session, above, (0.5, 0.5), SIZE)


def test_scale_and_up_follow_from_points(scene):
    frame = scene.ground_frame
    scale = probe.meters_per_unit_of(scene, (0, 0, 0), (0.5, 0, 0), 1.5)
    assert scale == pytest.approx(3 * frame.meters_per_unit)
    up = probe.up_of(scene, [(0, 0, 0), (0, 1, 0), (1, 0, 0)])
    np.testing.assert_allclose(up, frame.up, atol=1e-12)
    with pytest.raises(ParameterError, match="on a line"):
        probe.up_of(scene, [(0, 0, 0), (1, 0, 0), (2, 0, 1e-6)])


def test_three_points_or_a_pole_level_the_ground_anew(scene):
    frame = scene.ground_frame
    tilt = Rotation.from_euler("x", 12, degrees=True).as_matrix()
    wrong = replace(frame, rotation=tilt @ frame.rotation, translation=tilt @ frame.translation)
    leaning = replace(scene, ground_frame=wrong)
    corners = [(-0.8, -0.8, 0.0), (0.8, -0.8, 0.0), (-0.8, 0.8, 0.0)]
    points = [wrong.to_ground(frame.to_capture(np.array(p))) for p in corners]
    up = probe.up_of(leaning, points, (0.0, -1.0, 1.0))
    np.testing.assert_allclose(up, frame.up, atol=1e-9)
    mended, is_found = probe.with_up(leaning, up, points[0])
    lean = np.degrees(np.arccos(min(mended.ground_frame.up @ frame.up, 1.0)))
    assert is_found and lean < 0.5 and 11 < np.degrees(np.arccos(wrong.up @ frame.up)) < 13
    below = probe.up_of(leaning, points, (0.0, -1.0, -1.0))  # what is seen is the upper side
    np.testing.assert_allclose(below, -frame.up, atol=1e-9)
    across, is_found = probe.with_up(scene, frame.rotation[0], (0.1, 0.2, 0.3))
    assert not is_found and across.ground_frame.meters_per_unit == frame.meters_per_unit
    np.testing.assert_allclose(across.ground_frame.up, frame.rotation[0], atol=1e-12)
    point = across.ground_frame.to_ground(frame.to_capture(np.array((0.1, 0.2, 0.3))))
    assert point[2] == pytest.approx(0.0, abs=1e-12)


def test_a_painted_class_changes_the_puddles_and_is_saved_as_a_mask(scene, tmp_path):
    session = Session(scene, settings(scene, rate=0.0))
    session.make()
    point = (*DIP_CENTRE, 0.0)
    before = probe.read_point(session, point, 0)
    mask = probe.painted(session.mask, session.terrain, point, 0.4, GRASS)
    assert (mask == GRASS).sum() * 0.04**2 == pytest.approx(np.pi * 0.4**2, rel=0.1)
    session.set_scene(scene, mask)
    session.make()
    after = probe.read_point(session, point, 0)
    assert before.depth > 1e-3 > after.depth and after.kind.startswith("grass")
    taken = Home(tmp_path / "out", "tiny").save_ground(session)
    options = dict(zip(taken.command[2::2], taken.command[3::2], strict=True))
    np.testing.assert_array_equal(read_mask(options["--class-mask"]), mask)
    assert (probe.painted(mask, session.terrain, point, 9.0, -1) == -1).all()
    twice = override_ground_frame(scene, meters_per_unit=2 * scene.ground_frame.meters_per_unit)
    session.set_scene(twice, mask)
    saved = Home(tmp_path / "out", "tiny").save_scene(session)
    again = load_scene(saved.command[1])
    assert again.ground_frame.meters_per_unit == twice.ground_frame.meters_per_unit
    np.testing.assert_array_equal(Session(again, settings(again)).scene.painted.cells, mask)


def test_water_that_is_put_on_the_ground_stands_there_and_is_saved_as_a_mask(scene, tmp_path):
    session = Session(scene, settings(scene, rate=0.0, past=0.0))
    session.make()
    point = (0.5, 0.5, 0.0)
    assert probe.read_point(session, point, 0).depth == 0
    grid = session.terrain.grid
    mask = painted_water(None, grid, point, 0.3, 0.02, True)
    session.set_water_mask(mask)
    session.make()
    assert probe.read_point(session, point, 0).depth > 5e-3
    taken = Home(tmp_path / "out", "tiny").save_ground(session)
    options = dict(zip(taken.command[2::2], taken.command[3::2], strict=True))
    again = read_water_mask(options["--water-mask"], options["--water-mask-use"])
    np.testing.assert_allclose(again.depth, mask.depth, atol=1e-7)
    saved = Home(tmp_path / "out", "tiny").save_scene(session)
    assert saved.command[2] == "--water-mask" and again.stays
    twice = override_ground_frame(scene, meters_per_unit=2 * scene.ground_frame.meters_per_unit)
    session.set_scene(twice)
    assert session.water_mask is None  # it lies elsewhere now


# --- what is taken home ---------------------------------------------------------------------------


def looked_around(scene, cameras=()):
    """A session in which other settings and other places were looked at, and its view."""
    first = (scene.cameras or cameras)[0]
    place = {"surroundings": tuple(float(v) for v in first.position)}
    session = Session(scene, settings(scene, **place), cameras=cameras)
    session.make()
    view = session.viewpoint_of(first)
    session.draw(view, *SIZE, 0)
    changes = {"rate": mm_per_hour(40.0), "wind": (3.0, 0.7), "sun": (0.3, 0.8)}
    session.set_config(settings(scene, **changes, **place))
    session.draw(other(view), 40, 30, 2)
    return session, other(view, 0.1)


@pytest.mark.parametrize("cameras", [True, False])
def test_a_shot_is_drawn_from_its_files_to_the_byte(scene, tmp_path, cameras):
    if not cameras:
        offered = offered_cameras(replace(scene, cameras=()))
        scene = replace(scene, cameras=())
    session, view = looked_around(scene, () if cameras else offered)
    home = Home(tmp_path / "out", "a scene")
    taken = home.save_shot(session, view, 1, 72, 44)
    assert taken.line.startswith("rainsim run --scene 'a scene' --ground-frame ")
    assert (taken.folder / "command.txt").read_text() == taken.line + "\n"
    words = dict(zip(taken.command[1::2], taken.command[2::2], strict=True))
    given = {"path": words["--path"], "frames": int(words["--frames"]), "frame_range": (1, 2)}
    assert words["--frame-range"] == "1:2"
    given |= {"width": int(words["--width"]), "height": int(words["--height"])}
    config = settings_of(words["--preset"], given)
    cameras, config = cameras_of(scene, config, given)
    ((picture, _),) = render_rain(scene, cameras, config)
    np.testing.assert_array_equal(picture, read_image(taken.folder / "picture.png"))
    bare = home.save_view(session, view, 1, 72, 44)  # the command alone
    assert bare.line == taken.line.replace("shot-001", "view-001")
    names = {path.name for path in taken.folder.iterdir()}
    assert {path.name for path in bare.folder.iterdir()} == names - {"picture.png"}
    for name in ("camera_path.json", "preset.toml"):
        assert (bare.folder / name).read_bytes() == (taken.folder / name).read_bytes()
    assert home.save_ground(session).folder.name == "ground-001"
    assert home.save_ground(session).folder.name == "ground-002"  # nothing is replaced


def path_frame(session, cameras, index):
    """One frame of a path as `rainsim run --path` draws it, with the session's parts."""
    config, frame = session.config, session.scene.ground_frame
    path, moment = [frame.camera_in_ground(camera) for camera in cameras], config.moment(index)
    end = PathMotion(path, config.fps).end(index, config.at(moment / config.fps).render.exposure)
    session._follow()
    return session.renderer.draw(replace(cameras[index]), session.water.state(moment), end)[0]


def test_a_path_on_which_the_rain_stands_still_is_drawn_by_its_file(scene, session, view, tmp_path):
    low = settings(scene, fps=10.0)
    session.set_config(low)
    session.make()
    keyframes = [Keyframe(view, low, 2.0, 0.1), Keyframe(other(view, 0.02), low, 0.2, 0.1)]
    taken = Home(tmp_path / "out", "tiny").save_path(session, keyframes, *SIZE)
    given = {"path": taken.folder / "camera_path.json", "frames": 3}
    cameras, config = cameras_of(scene, Config.from_preset(taken.folder / "preset.toml"), given)
    assert config.moments == (1, 1, 1)
    frames = list(render_rain(scene, cameras, config))
    assert [report.index for _, report in frames] == [0, 1, 2]
    assert {report.time for _, report in frames} == {0.1}
    session.set_config(config)
    session.make()
    for index, (picture, _) in enumerate(frames):
        np.testing.assert_array_equal(picture, path_frame(session, cameras, index))
    goes_on = list(render_rain(scene, cameras, replace(config, moments=())))
    np.testing.assert_array_equal(goes_on[1][0], frames[1][0])  # its own moment
    assert (goes_on[2][0] != frames[2][0]).any()
    sequence = FrameSequence(scene, session.terrain, cameras, config)
    assert sequence.next == 0
    ((picture, _),) = sequence.frames([2])
    np.testing.assert_array_equal(picture, frames[2][0])
    assert sequence.next == 0  # the state at hand is that of the first frame too
    ((picture, _),) = sequence.frames([0])
    np.testing.assert_array_equal(picture, frames[0][0])


# --- the thread that draws ------------------------------------------------------------------------


class Pages:
    """What a painter shows, in place of a browser."""

    def __init__(self, session, **changes):
        self.shown, self.errors, self.left, self.time = [], [], [], 0.0
        self.painter = Painter(
            session, lambda key, shown: self.shown.append((key, shown)),
            fail=self.errors.append, now=lambda: self.time,
            badly_seen=lambda key, share: self.left.append((key, share)),
        )  # fmt: skip
        self.painter.set_sizes(full=SIZE[0], least=32)
        self.painter.schedule._pace = 1.0  # slow: small pictures are the least ones

    def run(self, most=50):
        """Let the painter do all that is due, with time going on."""
        for _ in range(most):
            if not self.painter.step():
                self.time += 0.06
                if self.painter.schedule.next(self.time) == (None, None):
                    return

    def take(self):
        found, self.shown = self.shown, []
        return found


def opened(session, view):
    """A page that has been shown a view."""
    pages = Pages(session)
    pages.painter.add(1)
    pages.painter.look(1, view, 4 / 3)
    pages.run()
    return pages


def test_a_page_gets_a_small_picture_and_then_the_full_one_with_depth(session, view):
    pages = opened(session, view)
    first, last = (shown for _, shown in pages.take())
    assert first.picture.shape == (24, 32, 3) and first.depth is None and first.job.step == SMALL
    assert last.picture.shape == (48, 64, 3) and last.depth.shape == (48, 64)
    assert last.job.step == EXACT
    np.testing.assert_array_equal(last.picture, session.draw(view, *SIZE, 0)[0])


def test_two_pages_have_their_cameras_and_share_the_water(session, view):
    pages = Pages(session)
    for key, own in ((1, view), (2, other(view))):
        pages.painter.add(key)
        pages.painter.look(key, own, 4 / 3)
    pages.run()
    last = dict(pages.take())
    assert (last[1].picture != last[2].picture).any()
    states = session.water.indices
    pages.painter.set_mode(2, "depth")
    pages.run()
    shown = pages.take()
    assert {key for key, _ in shown} == {2} and session.water.indices == states
    pages.painter.remove(2)  # a lost connection
    pages.painter.turn(lambda clock, now: clock.go_to(2))
    pages.run()
    assert {key for key, _ in pages.take()} == {1}


def test_a_slider_s_first_try_is_followed_by_the_exact_picture(scene, session, view):
    pages = opened(session, view)
    before = pages.take()[-1][1].picture
    pages.painter.set_config(lambda config: config.replace(rate=mm_per_hour(90.0)))
    pages.run()
    shown = [shown for _, shown in pages.take()]
    assert [s.job.step for s in shown][-1] == EXACT and len(shown) == 3 and not session.stale
    assert (shown[-1].picture != before).any()
    pages.painter.set_config(lambda config: config)  # no change
    pages.run()
    assert not pages.take()
    with pytest.raises(ParameterError, match="rain is -1"):
        pages.painter.set_config(lambda config: config.replace(rate=-mm_per_hour(1)))
    assert pages.painter.config.rain.rate == mm_per_hour(90.0)


def test_settings_that_cannot_be_drawn_are_reported_once_and_drawing_goes_on(scene, view):
    session = Session(scene, settings(scene, rate=0.0))
    session.make()
    pages = opened(session, view)
    pages.take()
    pages.painter.set_config(lambda config: config.replace(extent=500.0, spacing=0.005))
    pages.run()
    assert len(pages.errors) == 1 and "larger --spacing" in str(pages.errors[0])
    pages.painter.set_config(lambda config: config.replace(extent=1.0, spacing=0.04))
    pages.run()
    assert pages.take()[-1][1].job.step == EXACT and len(pages.errors) == 1


def test_without_ground_the_capture_is_drawn_until_up_is_mended(scene, view):
    upright = Rotation.from_euler("x", 90, degrees=True).as_matrix() @ scene.ground_frame.rotation
    beside = replace(scene.ground_frame, rotation=upright, translation=np.array([0.0, 0.0, 9.0]))
    session = Session(replace(scene, ground_frame=beside), settings(scene, rate=0.0))
    pages = Pages(session)
    pages.painter.add(1)
    lost = session.viewpoint_of(scene.cameras[0])
    pages.painter.look(1, lost, 4 / 3)
    pages.run()
    shown = [s for _, s in pages.take()]
    assert len(pages.errors) == 1 and session.no_ground is pages.errors[0]
    assert shown[-1].picture.shape == (48, 64, 3) and np.isfinite(shown[-1].depth).mean() > 0.5
    assert shown[-1].picture.std() > 5
    point = probe.point_at(session, lost, (0.5, 0.7), SIZE)
    assert probe.read_point(session, point, 0).lines()[-1] == "beside the map"
    pages.painter.ask(lambda own: own.set_scene(scene))
    pages.painter.redraw()
    pages.painter.look(1, view, 4 / 3)
    pages.run()
    last = pages.take()[-1][1]
    assert session.no_ground is None and len(pages.errors) == 1 and last.job.step == EXACT
    np.testing.assert_array_equal(last.picture, session.draw(view, *SIZE, 0)[0])


def test_time_plays_for_all_pages(session, view):
    pages = opened(session, view)
    pages.take()
    pages.painter.turn(lambda clock, now: clock.play(now))
    for _ in range(12):
        pages.painter.step()
        pages.time += 0.021
    pictures = [shown for _, shown in pages.take()]
    assert 4 <= len(pictures) <= 8
    assert {s.job.step for s in pictures} == {SMALL}
    assert (pictures[-2].picture != pictures[-1].picture).any()


def test_the_thread_answers_draws_and_ends(session, view):
    done = threading.Event()
    painter = Painter(
        session, lambda key, shown: shown.job.step == EXACT and done.set(), now=time.perf_counter
    )
    thread = threading.Thread(target=painter.run)
    thread.start()
    try:
        painter.add(1)
        painter.look(1, view, 4 / 3)
        assert painter.ask(lambda own: own is session).result(30)
        with pytest.raises(ParameterError, match="wrong"):
            painter.ask(_fail).result(30)
        assert done.wait(60)
    finally:
        painter.end()
        thread.join(60)
    assert not thread.is_alive()


def test_an_eye_below_the_ground_or_far_from_it_is_told(session, view):
    session.make()
    assert session.out_of_place(view) == ""
    assert "m below the ground" in session.out_of_place(replace(view, position=(0.0, 0.0, -0.5)))
    assert "far from the ground" in session.out_of_place(replace(view, position=(1e4, 0.0, 1.5)))


def test_a_finished_picture_tells_how_much_of_it_is_badly_seen(session, view):
    pages = opened(session, view)
    assert pages.left == []  # a generated scene: nothing is known
    session.scene, before = replace(session.scene, source=Path("somewhere")), session.scene
    wet = session.renderer.conductor.wet_scene
    scene = wet.scene
    wet.scene, session._leaving = replace(scene, source=Path("somewhere")), None
    try:
        from_below = look_at((0.2, 0.1, -0.8), (0.0, 0.0, 0.2), (0, 0, 1), 50, 64, 48)
        under = session.viewpoint_of(before.ground_frame.camera_in_capture(from_below))
        shares = []
        for seen in (other(view, 0.01), under):
            pages.painter.look(1, seen, 4 / 3)
            pages.run()
            shares.append(pages.left[-1])
        assert shares[0] == (1, pytest.approx(0, abs=0.1))
        assert shares[1][1] > 0.5 > 5 * shares[0][1]
    finally:
        session.scene, wet.scene, session._leaving = before, scene, None


def _fail(session):
    raise ParameterError("wrong")
