"""The captured sun: found where it stood, divided out, and left alone where there was none."""

from dataclasses import replace

import numpy as np
import pytest

import scenes
import sunny_yard
from rainsim.config.settings import Config
from rainsim.daylight import kept_light, relight, sky_light, visibility
from rainsim.daylight.kept_light import covered_share, under_clouds
from rainsim.daylight.light import Light
from rainsim.daylight.lit_surface import Surface
from rainsim.daylight.shade import NO_EDGES, edge_shade, factor_in_shade
from rainsim.daylight.sun import _pairs
from rainsim.numerics.srgb import display, linear
from rainsim.render.wet_scene import WetScene
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Splats
from rainsim.surface.kept_surface import kept_surface

SURFACE = {}  # of the last scene: several tests look for the sun of one


def relit(scene, sun=None, shone=True):
    """Return the `Relight` of a scene, whose sun may be given by its angles in degrees."""
    if SURFACE.get("scene") is not scene:
        SURFACE.update(scene=scene, found=kept_surface(scene))
    angles = None if sun is None else tuple(np.radians(sun))
    return relight.find_relight(scene, SURFACE["found"], angles, shone=shone)


def light_of(splats):
    return linear(splats.sh[:, 0] * sunny_yard.SH_0 + 0.5)


def in_sight(place):
    """Tell which places (n, 3) the yard's cameras see: none behind its wall, none far out."""
    return (place[:, 0] < 2.1) & (np.hypot(place[:, 0], place[:, 1]) < 2.6)


@pytest.fixture(scope="module")
def sunny():
    """The sunny yard, its sun's share and openness, and what is found of it."""
    scene, share, sky = sunny_yard.yard()
    return scene, share, sky, relit(scene)


@pytest.fixture(scope="module")
def dull():
    """The same yard on a dull day."""
    return sunny_yard.yard(sun=np.zeros(3))


def angle(found, azimuth, elevation):
    towards = sunny_yard.direction_of(azimuth, elevation)
    return np.degrees(np.arccos(np.clip(found @ towards, -1, 1)))


def test_the_sun_is_found_where_it_stood(sunny):
    assert sunny[3].confidence > 0.8
    assert angle(sunny[3].sun, 200, 38) < 3


def test_the_suns_share_is_found(sunny):
    found = sunny[3]
    # On open level ground: the ratio of sun to sky there, for each channel.
    measured = np.array(found.ratio) * found.sun[2]
    truth = sunny_yard.SUN_OVER_SKY * np.sin(np.radians(38))
    assert np.abs(measured / (1 + measured) - truth / (1 + truth)).max() < 0.07


def test_shade_and_light_become_those_of_a_dull_day(sunny, dull):
    scene, share, sky, found = sunny
    place = scene.ground_frame.to_ground(scene.splats.position)
    ground = (np.abs(place[:, 2]) < 0.01) & (sky > 0.6) & in_sight(place)
    lit, shade = ground & (share[:, 1] > 0.3), ground & (share[:, 1] == 0)
    assert shade.sum() > 100
    truth = light_of(dull[0].splats)
    before = light_of(scene.splats) / truth
    after = light_of(under_clouds(scene.splats, found.gain, 1.0)) / truth
    assert (before[shade].mean(axis=0) < 0.4 * before[lit].mean(axis=0)).all()
    np.testing.assert_allclose(after[shade].mean(axis=0), after[lit].mean(axis=0), rtol=0.2)
    level = light_of(under_clouds(scene.splats, found.gain, 1.0))[lit].mean(axis=0)
    np.testing.assert_allclose(level, light_of(scene.splats)[lit].mean(axis=0), rtol=0.2)


def test_walls_that_faced_the_sun_lose_most(sunny):
    scene, share, sky, found = sunny
    place = scene.ground_frame.to_ground(scene.splats.position)
    gain = found.gain.astype(float)[:, 1]
    wall = (np.abs(place[:, 0] - 2.2) < 0.01) & (place[:, 2] > 1)  # the sun shone onto it
    ground = (np.abs(place[:, 2]) < 0.01) & (sky > 0.9) & (share[:, 1] > 0.3)
    assert 0.35 < gain[wall].mean() / gain[ground].mean() < 0.75


def test_a_dull_capture_is_left_alone(dull):
    found = relit(dull[0])
    assert found.gain is None and found.confidence < 0.5
    assert "no sure sign of sunshine" in found.note and "stays as captured" in found.note


def test_shade_that_is_not_bluer_is_paint():
    found = relit(sunny_yard.yard(sun=np.full(3, 4.4))[0])
    assert found.gain is None and found.confidence < 0.5
    assert angle(found.sun, 200, 38) < 3  # its edges lie as those of a shadow


def test_few_cameras_are_said():
    said = "too few cameras to see what throws shadows: 4 of the 8 it takes"
    assert said in relight._unsure(0.0, 4)
    assert all("too few" not in relight._unsure(0.0, count) for count in (0, 8))


def test_a_given_sun_is_taken_wherever_it_stands(sunny):
    wrong = relit(sunny[0], [20.0, 30.0])
    assert wrong.gain is not None and "given" in wrong.note
    assert wrong.ratio == relight.USUAL_RATIO
    np.testing.assert_allclose(wrong.sun, sunny_yard.direction_of(20, 30), atol=1e-12)


def test_a_sun_by_the_clock_counts_where_shadows_show_that_it_shone(sunny, dull):
    wrong = relit(sunny[0], [20.0, 30.0], shone=False)
    assert wrong.gain is None and "if it did shine, --captured-sun=20,30" in wrong.note
    assert relit(dull[0], [200.0, 38.0], shone=False).gain is None
    assert relit(dull[0], [200.0, 38.0]).gain is not None  # a person's word counts
    right = relit(sunny[0], [203.0, 38.0], shone=False)
    assert right.gain is not None and angle(right.sun, 200, 38) < 1.0


def test_the_captured_sun_is_one_setting_and_the_new_days_another(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setenv("RAINSIM_CACHE", "off")

    def find_relight(*given):
        asked.append(given[2::2])
        return kept_light.NO_RELIGHT

    monkeypatch.setattr(kept_light, "find_relight", find_relight)
    scene = replace(scenes.tiny_scene(), source=tmp_path)
    config = Config().replace(cloudiness=1.0, sun=(1.0, 0.5))
    clock = replace(scene, captured_sun=(0.0, 0.6, 0.8))
    for one, settings in ((scene, config), (clock, config),
                          (clock, config.replace(captured_sun=(0.2, 0.4)))):  # fmt: skip
        kept_light.kept_relight(one, settings, None, 0.6)
    up = scene.ground_frame.rotation @ clock.captured_sun
    assert asked[0] == (None, False)
    assert asked[1][0][1] == pytest.approx(np.arcsin(up[2])) and asked[1][1] is False
    assert asked[2] == ((0.2, 0.4), True)


def test_a_given_sun_some_degrees_off_leaves_no_crescent(sunny, dull):
    scene, _, sky, found = sunny
    given = relit(scene, [204.0, 38.0])
    assert "by the shadows" in given.note and angle(given.sun, 200, 38) < 1.0
    np.testing.assert_allclose(given.ratio, sunny_yard.SUN_OVER_SKY, rtol=0.15)
    place = scene.ground_frame.to_ground(scene.splats.position)
    ground = (np.abs(place[:, 2]) < 0.01) & (sky > 0.6) & in_sight(place)
    truth = light_of(dull[0].splats)[ground]
    errors = [
        np.log(light_of(under_clouds(scene.splats, gain, 1.0))[ground] / truth).std()
        for gain in (found.gain, given.gain, np.ones_like(found.gain))
    ]
    assert errors[1] < errors[0] + 0.05 and errors[0] < 0.8 * errors[2]


@pytest.mark.slow
def test_the_sun_is_found_without_cameras(sunny):
    found = relit(replace(sunny[0], cameras=()))
    assert found.gain is not None and angle(found.sun, 200, 38) < 3


def broken(splats, name):
    """Return splats that tell nothing of a sun."""
    if name == "empty":
        return splats.take(slice(0, 0))
    if name == "few":
        return splats.take(slice(0, 60))
    if name == "nan":
        names = ("position", "rotation", "scale", "opacity", "sh")
        return Splats(*(np.full_like(getattr(splats, name), np.nan) for name in names))
    return replace(splats, scale=np.full_like(splats.scale, 0.05))  # round


def indoors():
    """A room of even light, closed above."""
    scene, _, _ = sunny_yard.yard(sun=np.zeros(3), step=0.06)
    frame, splats = scene.ground_frame, scene.splats
    place = frame.to_ground(splats.position)
    ground = splats.take(np.abs(place[:, 2]) < 0.01)
    above = replace(ground, position=frame.to_capture(
        frame.to_ground(ground.position) + np.array([0, 0, 2.4])).astype(np.float32))  # fmt: skip
    return replace(scene, splats=joined([splats, above]))


@pytest.mark.parametrize(
    "name", ["empty", "few", "nan", "round", pytest.param("indoors", marks=pytest.mark.slow)]
)
def test_captures_that_tell_nothing_stay_as_they_are(name):
    if name == "indoors":
        scene = indoors()
    else:
        scene, _, _ = sunny_yard.yard(step=0.12)
        scene = replace(scene, splats=broken(scene.splats, name))
    found = relit(scene)
    assert found.gain is None
    assert found.note.endswith("the light stays as captured")


@pytest.mark.slow
def test_some_bad_splats_do_no_harm():
    scene, _, _ = sunny_yard.yard(step=0.05)
    position = scene.splats.position.copy()
    position[::50] = np.nan
    broken = replace(scene, splats=replace(scene.splats, position=position))
    found = relit(broken)
    assert angle(found.sun, 200, 38) < 3
    assert (found.gain[::50] == 1).all() and np.isfinite(found.gain.astype(float)).all()
    assert (found.gain != 1).any()


def test_a_sun_below_the_horizon_is_none(sunny):
    below = relit(sunny[0], [200.0, -10.0])
    assert below.gain is None


# --- the gain on splats ---------------------------------------------------------------------------


def test_no_share_is_the_capture_itself(sunny):
    splats = sunny[0].splats
    assert under_clouds(splats, sunny[3].gain, 0.0) is splats
    assert under_clouds(splats, None, 1.0) is splats


def test_light_is_mixed_linearly(rng):
    splats = scenes.one_splat()
    many = Splats(*(np.repeat(getattr(splats, n), 50, axis=0) for n in (
        "position", "rotation", "scale", "opacity", "sh")))  # fmt: skip
    many.sh[:, 0] = (rng.uniform(0.02, 1, (50, 3)) - 0.5) / sunny_yard.SH_0
    gain = rng.uniform(0.3, 4, (50, 3)).astype(np.float16)
    before = light_of(many)
    for share in (0.25, 1.0):
        after = light_of(under_clouds(many, gain, share))
        expected = before * (1 + share * (gain.astype(float) - 1))
        np.testing.assert_allclose(after, expected, rtol=2e-4, atol=1e-6)


def test_harmonics_keep_their_contrast(rng):
    splats = scenes.one_splat(color=(0.5, 0.4, 0.3))
    sh = np.concatenate([splats.sh, rng.normal(0, 0.1, (1, 3, 3))], axis=1).astype(np.float32)
    gain = np.array([[2.0, 1.0, 0.5]], np.float16)
    found = under_clouds(replace(splats, sh=sh), gain, 1.0).sh
    scale = display(linear(np.array([0.5, 0.4, 0.3])) * gain[0].astype(float)) / [0.5, 0.4, 0.3]
    np.testing.assert_allclose(found[0, 1:], sh[0, 1:] * scale, rtol=1e-4)


def test_black_splats_stay_finite():
    black = scenes.one_splat(color=(0.0, -0.2, 1e-6))
    found = under_clouds(black, np.full((1, 3), 3, np.float16), 1.0)
    assert np.isfinite(found.sh).all()


def test_the_covered_share_goes_from_none_to_all():
    shares = [covered_share(Config().replace(cloudiness=c).render) for c in (0.0, 0.5, 0.9, 1.0)]
    assert shares[0] == 0 and shares[-1] == 1 and shares == sorted(shares)
    assert shares[2] > 0.95


# --- what a scene's set-up does of it -------------------------------------------------------------


def test_it_is_kept_for_the_next_run(sunny, tmp_path, monkeypatch):
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path))
    scene = replace(sunny[0], source=tmp_path)
    config = Config().replace(cloudiness=1.0)
    monkeypatch.setattr(kept_light, "find_relight", lambda *_: sunny[3])
    first = kept_light.kept_relight(scene, config, None, 0.6)
    monkeypatch.setattr(kept_light, "find_relight", None)  # to call it would be an error
    again = kept_light.kept_relight(scene, config, None, 0.6)
    assert again.note == first.note and again.confidence == first.confidence
    np.testing.assert_array_equal(again.gain, first.gain)
    np.testing.assert_allclose(again.sun, first.sun)


@pytest.mark.parametrize("changes", [{"relight": "off"}, {"cloudiness": 0.0}, {"source": None}])
def test_nothing_is_looked_for_where_nothing_is_wanted(tmp_path, monkeypatch, changes):
    monkeypatch.setattr(kept_light, "find_relight", None)
    changes = dict(changes)
    scene = replace(scenes.tiny_scene(), source=changes.pop("source", tmp_path))
    found = kept_light.kept_relight(scene, Config().replace(**changes), None, 0.6)
    assert found.gain is None and found.note == ""


@pytest.mark.parametrize("of_ground", [False, True])
def test_a_timeline_brings_the_sun_back(tmp_path, monkeypatch, of_ground):
    from rainsim.pipeline import extract_terrain

    monkeypatch.setattr(kept_light, "find_relight", lifted_relight if of_ground else fake_relight)
    scene = replace(scenes.tiny_scene(), source=tmp_path)
    camera = scene.cameras[0]
    config = replace(
        Config().replace(rate=0.0, past=0.0, extent=1.0, spacing=0.05, cloudiness=1.0),
        keyframes=((0.0, (("cloudiness", 1.0),)), (1.0, (("cloudiness", 0.0),))),
    )
    terrain = extract_terrain(scene, config)
    wet = WetScene(scene, terrain, config, camera)
    assert "fake" in wet.notes
    layers = wet.capture.layers(camera)
    covered, clean = layers.color, wet.capture.captured_color(camera, layers)
    wet.set_time(config.at(1.0))
    sunny = wet.capture.layers(camera).color
    off = WetScene(scene, terrain, config.replace(relight="off"), camera)
    np.testing.assert_array_equal(sunny, off.capture.layers(camera).color)
    np.testing.assert_array_equal(clean, sunny)  # the layer `clean` is the capture at any time
    assert covered.mean() > 1.2 * sunny.mean()


def fake_relight(scene, found, sun, white, shone):
    gain = np.full((len(scene.splats), 3), 2, np.float16)
    return relight.Relight(gain, "fake", np.array([0.0, 0.0, 1.0]), (1.0, 1.0, 1.0), 1.0)


def lifted_relight(scene, found, sun, white, shone):
    light = np.minimum(2 * light_of(scene.splats), 1)
    ground = np.column_stack([light, np.ones(len(light))]).astype(np.float16)
    return relight.Relight(None, "fake", None, (1.0, 1.0, 1.0), 1.0, ground)


# --- visibility -----------------------------------------------------------------------------------


def disc_over_ground():
    """A level disc 1 m above level ground, as solids."""
    line = np.arange(-2, 2, 0.05)
    x, y = (part.ravel() for part in np.meshgrid(line, line))
    place = np.concatenate([
        np.stack([x, y, 0 * x], -1), np.stack([x, y, 0 * x + 1], -1)[np.hypot(x, y) < 0.5],
    ]).astype(np.float32)  # fmt: skip
    normal, flat = np.tile(np.float32([0, 0, 1]), (len(place), 1)), np.ones(len(place), np.float32)
    none = np.zeros((len(place), 1), np.int32)
    surface = Surface(place, normal, flat, 0 * normal, none, np.float32(0.05**2) * flat)
    return place, visibility.solids_of(surface)


@pytest.mark.parametrize("merged", [False, True])
@pytest.mark.parametrize("slant", [0.0, 0.7])
def test_shadows_lie_where_they_should(poisoned, merged, slant):
    place, solids = disc_over_ground()
    if merged:
        fewer = visibility.coarsened(solids, 0.2)
        assert len(fewer.reach) < 0.5 * len(solids.reach)
        solids = fewer
    direction = np.array([slant, 0, 1]) / np.hypot(slant, 1)
    window = visibility.Window(np.zeros(3, np.float32), 512, np.float32(6 / 512))
    axes = visibility.axes_of(direction)
    heights = poisoned((1, 512, 512))
    visibility.draw_heights(solids, axes, window, heights)
    assert np.isfinite(heights).all()
    ground = place[place[:, 2] == 0]
    normal = np.tile(np.float32([0, 0, 1]), (len(ground), 1))
    seen = poisoned((len(ground), 1))
    flat = np.ones(len(ground), np.float32)
    visibility.find_seen(heights, axes, window, ground, normal, flat, np.float32(0.02), seen)
    away = np.hypot(ground[:, 0] + slant, ground[:, 1])
    assert (seen[away < 0.4] == 0).all() and (seen[away > 0.65] == 1).all()


def test_nothing_hides_nothing(poisoned):
    place, solids = disc_over_ground()
    empty = type(solids)(*(a[:0] for a in solids))
    window = visibility.Window(np.zeros(3, np.float32), 64, np.float32(0.1))
    heights, seen = poisoned((1, 64, 64)), poisoned((len(place), 1))
    axes = visibility.axes_of([0.0, 0.0, 1.0])
    visibility.draw_heights(empty, axes, window, heights)
    assert (heights == visibility.NOTHING).all()
    normal = np.tile(np.float32([0, 0, 1]), (len(place), 1))
    flat = np.ones(len(place), np.float32)
    visibility.find_seen(heights, axes, window, place, normal, flat, np.float32(0.02), seen)
    assert (seen == 1).all()


def test_skies_have_their_published_shape():
    directions = sky_light.hemisphere(4000)
    weight = 2 / len(directions) * directions[:, 2]  # over pi: cosine times solid angle
    assert weight.sum() == pytest.approx(1, rel=1e-3)
    assert (weight * sky_light.overcast(directions)).sum() == pytest.approx(7 / 9, rel=1e-3)


@pytest.mark.parametrize(
    ("elevation", "away", "beside", "towards"),
    [
        (20, (0.68, 0.70, 0.64), (0.78, 0.74, 0.65), (1.71, 1.30, 0.92)),
        (40, (0.59, 0.62, 0.59), (0.69, 0.68, 0.63), (1.19, 1.03, 0.83)),
        (70, (0.56, 0.58, 0.56), (0.63, 0.63, 0.60), (0.77, 0.74, 0.67)),
    ],
)
def test_walls_receive_of_the_clear_sky_what_they_do_of_the_fitted_one(
    elevation, away, beside, towards
):
    """Of Hosek and Wilkie's, over level ground, by where a wall faces; turbidity 3."""
    directions, sun = sky_light.hemisphere(4000), sunny_yard.direction_of(0, elevation)
    clear = sky_light.clear(directions, sun)
    clear /= (clear * directions[:, 2:]).sum(axis=0)
    for normal, light in (((-1, 0, 0), away), ((0, 1, 0), beside), ((1, 0, 0), towards)):
        cosine = np.maximum(directions @ np.array(normal), 0)
        np.testing.assert_allclose(cosine @ clear, light, atol=0.06)


# --- shade as it was measured ---------------------------------------------------------------------


def surface_at(position, normal=(0, 0, 1)):
    n = len(position)
    one = np.ones(n, np.float32)
    normals = np.tile(np.float32(normal), (n, 1))
    none = np.zeros((n, 1), np.int32)
    return Surface(np.float32(position), normals, one, normals, none, one)


def test_shade_takes_over_what_its_edges_show(rng):
    place = rng.uniform(-0.5, 0.5, (400, 3)).astype(np.float32) * np.float32([1, 1, 0])
    up = np.tile(np.float32([0, 0, 1]), (400, 1))
    change = np.array([0.3, 0.1, -0.2]) + 0.2 * rng.standard_normal((400, 3))
    edges = edge_shade(place, up, change)
    surface = surface_at([(0, 0, 0), (0.2, 0.1, 0), (0, 0, 0), (30, 0, 0)])
    factor = factor_in_shade(surface, np.float32([0, 0.5, 1, 0]), edges)
    np.testing.assert_allclose(np.log(factor[0]), [0.3, 0.1, -0.2], atol=0.08)
    np.testing.assert_allclose(np.log(factor[1]), [0.15, 0.05, -0.1], atol=0.04)
    assert (factor[2:] == 1).all()  # in the sun, and far from any edge
    wall = factor_in_shade(surface_at([(0, 0, 0)], (1, 0, 0)), np.zeros(1), edges)
    assert (wall == 1).all()


def test_without_edges_shade_is_as_the_model_has_it():
    factor = factor_in_shade(surface_at([(0, 0, 0)]), np.zeros(1), NO_EDGES)
    assert (factor == 1).all()


def test_deep_shade_under_a_blue_sky_keeps_its_hue_where_the_gain_is_bounded():
    """Grey ground is grey after it, in the sun and in shade that asks for more than the bound."""
    ratio = np.array([9.0, 5.0, 2.0])
    measured, up = relight.SunRatio(ratio, 999, 1.0), np.array([0, 0, 1.0])
    surface = surface_at([(0, 0, 0)] * 3)
    clear = np.repeat(np.float32([[1], [0.6], [0.25]]), 3, axis=1)
    lit, none = np.float32([1, 0, 0]), np.zeros((3, 3), np.float32)
    light = Light(clear, np.ones(3, np.float32), None, none)
    gain = relight.gains(surface, light, lit, up, measured, none).astype(float)
    shown = (clear + lit[:, None] * ratio) * gain
    np.testing.assert_allclose(shown / shown[:, :1], np.tile([1, 0.6, 0.3], (3, 1)), rtol=5e-3)
    np.testing.assert_allclose(gain[0], 1, rtol=2e-3)
    np.testing.assert_allclose(gain[1], (1 + ratio) / 0.6, rtol=2e-3)  # below the bound
    np.testing.assert_allclose(gain[2], (1 + ratio) * relight.MOST_GAIN, rtol=5e-3)
    assert relight.MOST_GAIN < 1 / 0.25


def test_the_clear_sky_is_bluest_away_from_the_sun():
    directions, sun = sky_light.hemisphere(4000), sunny_yard.direction_of(0, 40)
    color = sky_light.clear(directions, sun)
    color /= (color * directions[:, 2:]).sum(axis=0)
    blue, high = color[:, 2] / color[:, 0], directions[:, 2] > 0.5
    near, away = directions @ sun > 0.95, directions @ sun < 0.2
    assert blue[high & away].mean() > 1.4 * blue[near].mean()


def test_places_above_one_another_are_no_pair():
    """The underside of a bench and the top of its seat face up alike and are 4 cm apart."""
    x, y = (a.ravel() * 0.1 for a in np.meshgrid(np.arange(10.0), np.arange(10.0)))
    level = np.stack([x, y, 0 * x], -1).astype(np.float32)
    above = level + np.float32([0, 0, 0.06])
    normal = np.tile(np.float32([0, 0, 1]), (200, 1))
    light = np.repeat(np.float32([[0.1] * 3, [0.2] * 3]), 100, axis=0)
    pair = _pairs(np.concatenate([level, above]), normal, light)
    assert len(pair) > 300 and (pair[:, 0] // 100 == pair[:, 1] // 100).mean() > 0.95
    slanted = level + level[:, :1] * np.float32([0, 0, 0.3])  # a slope is one plane
    normal = np.tile(np.float32([-0.287, 0, 0.958]), (100, 1))
    assert len(_pairs(slanted, normal, light[:100])) > 300
