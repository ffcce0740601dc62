"""What a capture tells of the sky: badly placed splats, the skyline, albedo and exposure."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import factories
from rainsim.config.settings import Config
from rainsim.constants import SH_0
from rainsim.pipeline import extract_terrain
from rainsim.raster import prepare
from rainsim.render import drawn_capture
from rainsim.render.wet_scene import WetScene
from rainsim.scene.cameras import resize_to
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Scene
from rainsim.shading import calibration, sky, skyline, visibility
from rainsim.shading.color import GAMMA
from rainsim.shading.environment import COLUMNS, ROWS, directions
from rainsim.splatting.prepared import recolored
from rainsim.terrain.surface import terrain_from_heights
from rainsim.terrain.types import INFERRED, Grid
from scenes import ground_frame, looking, tiny_scene


def patch(centre, count, spread, size, color, rng):
    """Return arrays of opaque round splats about a point."""
    position = np.asarray(centre) + rng.uniform(-1, 1, (count, 3)) * spread
    sh = np.full((count, 1, 3), 0, np.float32)
    sh[:, 0] = (np.asarray(color) - 0.5) / SH_0
    return position, np.full((count, 3), size), sh


def splats_of(*patches):
    position, scale, sh = (np.concatenate(a) for a in zip(*patches, strict=True))
    return factories.splats(position, scale=scale, opacity=0.99, sh=sh)


@pytest.fixture
def yard(rng):
    """A wall that all cameras see, a blob above that one sees, a crown that none look up to."""
    wall = patch((0, 5, 1.5), 400, (2, 0.1, 1.5), 0.2, (0.4, 0.3, 0.2), rng)
    blob = patch((3.5, 5, 3.2), 40, 0.2, 0.2, (0.95, 0.95, 0.97), rng)
    low = patch((0, -30, 0.2), 30, 0.1, 0.1, (0.2, 0.2, 0.2), rng)
    splats = splats_of(wall, blob, low)
    square = 160, 160, 160
    cameras = [looking((0.02 * k, 0, 1.5), (0, 5, 1.5), *square) for k in range(30)]
    cameras.append(looking((0, 0, 1.5), (3.5, 5, 3.0), *square))
    frame = dataclasses.replace(
        ground_frame(), rotation=np.eye(3), meters_per_unit=1.0, translation=np.zeros(3)
    )
    which = np.repeat((0, 1, 2), (400, 40, 30))
    return Scene("yard", splats, tuple(cameras), frame, source=Path("yard.ply")), which


def test_a_high_splat_that_few_cameras_saw_is_badly_placed(yard):
    scene, which = yard
    found = visibility.badly_placed(scene, visibility.views_of_splats(scene))
    assert found[which == 1].mean() > 0.95
    assert not found[which == 0].any()
    assert not found[which == 2].any()  # low, though no camera looks there


def test_what_hides_a_splat_keeps_it_from_being_seen(yard):
    scene, which = yard
    seen, asked, *_ = visibility.views_of_splats(scene)
    assert asked == 31
    assert seen[which == 0].max() >= 30 and (seen[which == 2] == 0).all()
    behind = scene.splats.position.copy()
    behind[which == 0, 1] += 6  # behind the others? no: nothing is left before it
    moved = dataclasses.replace(scene, splats=dataclasses.replace(scene.splats, position=behind))
    assert visibility.views_of_splats(moved)[0][which == 0].max() >= 30
    hidden = scene.splats.position.copy()
    hidden[:50, 1] = 9.0
    hidden[:50, 0] *= 0.2
    moved = dataclasses.replace(scene, splats=dataclasses.replace(scene.splats, position=hidden))
    assert visibility.views_of_splats(moved)[0][:50].max() <= 2


@pytest.mark.parametrize("change", ["built-in", "no cameras", "no splats"])
def test_nothing_is_badly_placed_where_nothing_is_known(yard, change):
    scene, _ = yard
    scene = {
        "built-in": lambda: dataclasses.replace(scene, source=None),
        "no cameras": lambda: dataclasses.replace(scene, cameras=()),
        "no splats": lambda: dataclasses.replace(scene, splats=scene.splats.take([])),
    }[change]()
    assert visibility.views_of_splats(scene) is None
    found = visibility.badly_placed(scene, None)
    assert found.shape == (len(scene.splats),) and not found.any()


def test_places_and_depths_that_are_no_numbers_are_not_seen():
    position = np.array([[0, 0, 2], [np.nan, 0, 2], [0, 0, np.inf], [0, -np.inf, 2]], np.float32)
    view, lens = np.eye(3, 4, dtype=np.float32), np.array([8, 8, 4, 4], np.float32)
    seen, total = np.zeros(4, np.uint8), np.zeros((4, 7), np.float32)
    sh, eye = np.zeros((4, 1, 3), np.float32), np.zeros(3, np.float32)

    def look(depth):
        depth = np.full((8, 8), depth, np.float32)
        visibility.count_view(position, sh, view, eye, lens, depth, seen, total)
        return seen.tolist()

    assert look(2.0) == [1, 0, 0, 0] and look(np.nan) == [1, 0, 0, 0]
    assert look(np.inf) == [2, 0, 0, 0]
    assert (total[0, :4] > 0).all() and not total[1:].any()
    np.testing.assert_allclose(total[0, 4:], (0, 0, -2), rtol=1e-6)  # towards the camera, twice


def dome(covered):
    """Return a map of alpha: 1 where `covered(elevation, azimuth)` [degrees]."""
    d = directions()
    elevation, azimuth = (
        np.degrees(np.arcsin(d[..., 2])),
        np.degrees(np.arctan2(d[..., 1], d[..., 0])),
    )
    return np.where(covered(elevation, azimuth), 1.0, 0.0).astype(np.float32)


def test_the_sky_is_what_is_connected_with_the_zenith():
    alpha = dome(lambda e, a: e < 20)
    pane = (abs(np.degrees(np.arcsin(directions()[..., 2])) - 10) < 4) & (
        abs(directions()[..., 1]) < 0.2
    )
    alpha[pane] = 0.2
    found = skyline.open_sky(alpha)
    assert found[: int(ROWS * 68 / 180)].all()
    assert not found[pane].any()
    notch = dome(lambda e, a: (e < 20) & ~((abs(a) < 20) & (e > 5)))
    assert skyline.open_sky(notch)[int(ROWS * 80 / 180), COLUMNS // 2]  # a gap between two houses


def test_gaps_in_a_crown_show_the_sky_and_half_open_ones_do_not():
    crown = dome(lambda e, a: e < 90)
    gap, dark = (slice(30, 34), slice(100, 104)), (slice(30, 34), slice(150, 154))
    crown[gap], crown[dark] = 0.0, 0.3
    found = skyline.open_sky(crown)
    assert found[gap].all() and not found[dark].any()
    assert found.sum() == 16


def test_the_skyline_spreads_over_what_a_place_sees_through_and_over_nothing_solid(monkeypatch):
    row = np.arange(ROWS)[:, None]
    border = ROWS // 2 - 10
    solid, thin = np.where(row < border, 0.0, 1.0), np.where(row < border, 0.0, 1.0)
    thin = np.where((row >= border + 1) & (row < border + 3), 0.3, thin)
    share = {}
    for name, maps in (("solid", (solid, solid)), ("thin", (solid, thin)), ("bare", (solid,))):
        seen = iter([np.dstack([np.zeros((ROWS, COLUMNS, 3)), np.tile(m, (1, COLUMNS))])
                     for m in maps])  # fmt: skip
        monkeypatch.setattr(skyline, "probe", lambda draw, place, seen=seen: next(seen))
        share[name] = skyline.seen_from(None, np.zeros((len(maps), 3))).open[:, 5]
    assert share["solid"][border - 4] > 0.99 and share["solid"][border + 1] < 0.2
    assert share["thin"][border + 1] > share["solid"][border + 1] + 0.2
    assert share["thin"][border + 5] < 0.01
    # From a single place, as without cameras, no outline glows: the sky goes on behind it.
    assert share["bare"][border] > 0.9 and share["bare"][border + 5] < 0.01


def test_where_cameras_saw_no_sky_a_half_open_doorway_shows_none():
    seen = np.ones((45, 180), bool)
    seen[:20, :60] = False  # a front, up to 40 degrees, for 120 degrees
    everywhere = skyline.Skyline(np.ones((ROWS, COLUMNS), np.float32), None)
    found = skyline.opened(everywhere, seen).open
    azimuth = np.degrees(np.arctan2(directions()[..., 1], directions()[..., 0]))
    elevation = np.degrees(np.arcsin(directions()[..., 2]))
    inside = (azimuth > 10) & (azimuth < 110) & (elevation < 30)  # below the horizon as well
    assert (found[inside] < 0.01).all()
    # Its outline moves from camera to camera: the sky goes on a little behind it.
    assert (found[(azimuth > 0) & (azimuth < 120) & (elevation > 38)] > 0.5).all()
    assert (found[azimuth < -10] > 0.99).all()


def test_behind_mirrored_pictures_much_of_what_cameras_saw_must_be_sky(yard):
    scene, _ = yard
    prepared = prepare(scene.splats, np.arange(len(scene.splats)) == 0)
    seen = np.full((45, 180), 0.1, np.float32)
    seen[23:] = 0.5
    whole, mirrored = skyline.skylines(scene, prepared, scene.cameras[0], 0.1, seen)
    high, low = directions()[..., 2] > 0.8, np.abs(directions()[..., 2] - 0.35) < 0.25
    assert whole.open[high | low].min() > 0.99
    assert mirrored.open[high].min() > 0.99 and mirrored.open[low].max() < 0.01


def test_under_an_open_sky_the_day_is_drawn_and_below_it_the_land():
    alpha = dome(lambda e, a: e < 0)
    seen = np.concatenate([np.full((ROWS, COLUMNS, 3), 0.5, np.float32) * alpha[..., None],
                           alpha[..., None]], axis=-1)  # fmt: skip
    land = skyline.spread_colors(seen)
    np.testing.assert_allclose(land, 0.5**GAMMA, rtol=1e-3)
    open_ = skyline.open_sky(alpha).astype(np.float32)
    day = np.full((2 * ROWS, 2 * COLUMNS, 3), 3.0, np.float32)
    behind = skyline.with_skyline(day, skyline.Skyline(open_, land), 0.7)
    np.testing.assert_allclose(behind[: ROWS - 4], 3.0)
    np.testing.assert_allclose(behind[ROWS + 4 :], 0.7 * 0.5**GAMMA, rtol=1e-3)
    dark = skyline.with_skyline(day, skyline.Skyline(open_, land), 0.0)
    assert (dark[ROWS + 4 :] == 0).all() and (dark[0] == 3).all()


@pytest.mark.parametrize("high", [1.5, 20.0])
def test_distant_ground_goes_over_into_the_horizons_sky(high):
    plain = sky.overcast()
    made = sky.with_haze(plain, high)
    sine, rows = directions()[:, 0, 2], made[:, 0, 1]
    assert (np.diff(rows[sine < 0.03]) <= 1e-6).all()  # ever darker from the horizon down
    beside = rows[(sine < 0) & (sine > -0.02)]
    assert beside.min() > 0.6 * rows[sine > 0].min()  # the plain map: .5
    np.testing.assert_array_equal(made[sine > sky.AIR], plain[sine > sky.AIR])
    down = np.exp(-high / sky.HAZE)
    ground, air = plain[-1, 0, 1], rows[(sine > 0) & (sine < 0.03)].mean()
    assert made[-1, 0, 1] == pytest.approx(air + down * (ground - air), rel=0.02)


def test_a_kept_skyline_is_that_of_the_colors_drawn(yard, tmp_path, monkeypatch):
    """Another weather's colours of the same capture must not answer for a run's own."""
    scene, _ = yard
    captured = prepare(scene.splats)
    dark = dataclasses.replace(scene.splats, sh=scene.splats.sh - np.float32(0.5))
    wet = recolored(captured, dark)
    fresh = skyline.skylines(scene, wet, scene.cameras[0], 0.1)[0]
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path))
    first = skyline.skylines(scene, captured, scene.cameras[0], 0.1)[0]
    found = skyline.skylines(scene, wet, scene.cameras[0], 0.1)[0]
    again = skyline.skylines(scene, wet, scene.cameras[0], 0.1)[0]
    assert np.abs(found.land - first.land).max() > 0.01
    np.testing.assert_array_equal(found.land, fresh.land)
    np.testing.assert_array_equal(again.land, fresh.land)
    assert len(list(tmp_path.iterdir())) == 2


def scene_of(splats, cameras=()):
    return Scene("test", splats, cameras, ground_frame(), None, "")


def test_albedo_follows_the_ground_and_what_is_given():
    height = np.zeros((40, 40), np.float32)
    terrain = terrain_from_heights(height, Grid((40, 40), (-1.0, -1.0), 0.05))
    grey = splats_of(patch((0, 0, 0), 4, 0.1, 0.1, (0.2, 0.2, 0.2), np.random.default_rng(0)))
    none = scene_of(grey)
    dim = dataclasses.replace(terrain, color=np.full((40, 40, 3), 0.3, np.float32))
    bright = dataclasses.replace(terrain, color=np.full((40, 40, 3), 0.7, np.float32))
    low, note = calibration.albedo_of_white(bright, none)
    high, _ = calibration.albedo_of_white(dim, none)
    assert low < calibration.USUAL < high and "paving" in note
    given, note = calibration.albedo_of_white(bright, none, 0.3)
    assert given == pytest.approx(0.3 / 0.7**2.2, rel=1e-3) and "as given" in note
    white = splats_of(patch((0, 0, 0), 99, 0.1, 0.1, (1, 1, 1), np.random.default_rng(0)))
    assert calibration.albedo_of_white(dim, scene_of(white))[0] == pytest.approx(
        calibration.WHITEST
    )
    # An overcast sky over ground of that albedo: L = a E / pi, zenith 9/7 of E / pi.
    ground, albedo = 0.7 * 0.3**2.2, high * 0.3**2.2
    assert calibration.zenith_radiance(high, 0.7) == pytest.approx(9 / 7 * ground / albedo)


def test_albedo_of_poor_ground_is_that_near_the_cameras():
    terrain = terrain_from_heights(
        np.zeros((40, 40), np.float32), Grid((40, 40), (-1.0, -1.0), 0.05)
    )
    color = np.full((40, 40, 3), 0.2, np.float32)  # of walls, laid on the ground behind them
    color[10:30, 10:30] = 0.7
    terrain = dataclasses.replace(terrain, color=color)
    grey = splats_of(patch((0, 0, 0), 4, 0.1, 0.1, (0.2, 0.2, 0.2), np.random.default_rng(0)))
    eye, far, lost = (
        ground_frame().camera_in_capture(looking(place, (20, 0, 0), 8, 8))
        for place in ((0, 0, 0.2), (9, 0, 0.2), (0.9, 0.9, 9))
    )
    poor = dataclasses.replace(terrain, layer=np.full((40, 40), 0.3, np.float32),
                               source=np.full((40, 40), INFERRED, np.uint8))  # fmt: skip
    known, _ = calibration.albedo_of_white(terrain, scene_of(grey, (eye,)))
    near, _ = calibration.albedo_of_white(poor, scene_of(grey, (eye, eye, lost)))
    away, _ = calibration.albedo_of_white(poor, scene_of(grey, (far,)))
    assert near < 0.5 * known and away == known


def test_albedo_is_that_of_relit_colors_however_much_of_the_ground_lay_in_the_shade():
    along = (np.arange(40) + 0.5) * 0.05 - 1.0
    places = np.stack([*np.meshgrid(along, along), np.zeros((40, 40))], axis=-1).reshape(-1, 3)
    frame = ground_frame()
    grey = splats_of(patch((0, 0, 0), 1600, 0.1, 0.02, (0.3, 0.3, 0.3), np.random.default_rng(0)))
    splats = dataclasses.replace(grey, position=frame.to_capture(places))
    terrain = terrain_from_heights(
        np.zeros((40, 40), np.float32), Grid((40, 40), (-1.0, -1.0), 0.05)
    )
    found = []
    for shaded in (10, 30):  # rows in the shade, a third as bright
        dark = np.arange(40)[:, None] < shaded
        light = np.where(dark, 0.2, 0.6) * np.ones((40, 40))
        color = np.repeat(light[..., None] ** (1 / GAMMA), 3, axis=2).astype(np.float32)
        seen = dataclasses.replace(terrain, color=color)
        gain = np.repeat(np.where(light < 0.4, 3.0, 1.0).reshape(-1, 1), 3, axis=1)
        captured, _ = calibration.albedo_of_white(seen, scene_of(splats))
        relit, _ = calibration.albedo_of_white(seen, scene_of(splats), None, gain)
        found.append((captured, relit))
    (mostly_lit, lit), (mostly_dark, dark) = found
    assert dark == pytest.approx(lit, rel=1e-3) and mostly_dark > 1.3 * mostly_lit
    given, _ = calibration.albedo_of_white(seen, scene_of(splats), 0.3, gain)
    assert given == pytest.approx(0.3 / 0.6, rel=1e-3)


def test_the_meter_keeps_a_clear_day_and_greys_a_dull_one():
    assert calibration.metered(0.3, 0.3, 0.0, 1.0, 0.0) == pytest.approx(1)
    assert calibration.metered(0.3, 0.08, 0.0, 1.0, 1.0) == pytest.approx(2)
    between = calibration.metered(0.3, 0.1, 0.0, 1.0, 0.5)
    low, high = (calibration.metered(0.3, 0.1, 0.0, 1.0, cloudiness) for cloudiness in (1.0, 0.0))
    assert low < between < high
    assert calibration.metered(0.0, 0.1, 0.0, 1.0, 1.0) == 1.0
    assert calibration.metered(0.1, np.nan, 0.0, 1.0, 1.0) == 1.0


def test_the_meter_is_biased_as_far_as_it_is_wet():
    wet = Config()
    assert calibration.exposure_bias(wet) == pytest.approx(-0.3)
    assert calibration.exposure_bias(wet.replace(rate=0.0, past=0.0)) == 0
    drying = wet.replace(rate=0.0, past=1e-3, drying=8 * 3600.0)
    assert -0.3 < calibration.exposure_bias(drying) < -0.01
    assert calibration.exposure_bias(wet.replace(exposure_bias=0.5)) == pytest.approx(0.5)
    assert calibration.exposure_bias(wet.replace(metering="off")) == 0
    assert calibration.exposure_bias(Config.from_preset("paper")) == 0


def test_the_meter_keeps_clouds_in_a_sky_that_fills_the_picture():
    no_sky, some, much = (calibration.metered(0.3, 0.04, s, 1.0, 1.0) for s in (0.0, 0.1, 0.5))
    assert no_sky == pytest.approx(4) and much == pytest.approx(calibration.MOST_ZENITH)
    assert much < some < no_sky
    assert calibration.metered(0.3, 0.16, 0.5, 1.0, 1.0) == pytest.approx(1)  # never darker for it


@pytest.fixture(scope="module")
def speckled():
    """White specks of 2 millimetres, close together, over the dark ground of `tiny_scene`."""
    scene = tiny_scene(1024, 768)
    frame, rng = scene.ground_frame, np.random.default_rng(3)
    at = np.column_stack([rng.uniform(-1, 1, (20_000, 2)), np.full(20_000, 0.004)])
    specks = splats_of(patch((0, 0, 0), 20_000, 0.0, 2e-3 / frame.meters_per_unit, [0.95] * 3, rng))
    specks = dataclasses.replace(specks, position=frame.to_capture(at).astype(np.float32))
    dark = dataclasses.replace(scene.splats, sh=scene.splats.sh - np.float32(0.25 / SH_0))
    scene = dataclasses.replace(scene, splats=joined([dark, specks]))
    config = Config().replace(rate=0.0, past=0.0, extent=1.0, spacing=0.05)
    return scene, config, extract_terrain(scene, config)


def test_the_meter_sees_fine_splats_no_brighter_than_the_picture_shows_them(speckled, monkeypatch):
    scene, config, terrain = speckled
    wet = WetScene(scene, terrain, config, scene.cameras[0])
    small = [resize_to(camera, calibration.VIEW_WIDTH) for camera in scene.cameras]
    captured, rainy, _ = wet.land_light(scene.cameras, True)
    metered, metered_rainy, _ = wet.land_light(small, True)
    wet.capture.merge = 0.0
    unmerged = wet.land_light(small, True)[0]
    monkeypatch.setattr(drawn_capture, "ALL", 1.0)  # those finer than a pixel are drawn too wide
    wide, wide_rainy, _ = wet.land_light(small, True)
    assert unmerged - captured < 0.5 * (wide - captured)
    assert wide > 1.6 * captured
    assert metered - captured < 0.5 * (wide - captured)
    assert metered_rainy - rainy < 0.5 * (wide_rainy - rainy)


def test_the_meter_leaves_out_the_gloss_that_the_wet_ground_mirror_adds(speckled):
    scene, config, terrain = speckled
    rainy = config.replace(past=2.0, cloudiness=1.0)
    wet = WetScene(scene, terrain, rainy, scene.cameras[0])
    views = [resize_to(c, 128) for c in scene.cameras]
    assert wet.land_light(views, False)[1] > 1.05 * wet.land_light(views, True)[1]
