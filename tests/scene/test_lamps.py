"""Lamps: their radiance, the halo around them, dusk, and their image in a wet road."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from benchmarks.traced import trace_reflections
from rainsim.actors.actor_files import read_actors
from rainsim.config.settings import Config
from rainsim.constants import SH_0
from rainsim.errors import InputError, ParameterError
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, display, linear
from rainsim.pipeline import extract_terrain, simulate
from rainsim.render.renderer import Renderer
from rainsim.scene.folder import import_scene
from rainsim.scene.lamps import LUMINANCE, WHITE, Lamp, with_lamps
from rainsim.scene.splat_sets import joined
from rainsim.shading.color import linear_from_display
from rainsim.shading.composite import tone_curve
from rainsim.shading.glare import DAZZLES, Glare, scattered
from scenes import lamp_scene, moving_scene, one_splat

FOCAL = 200.0


def light_of(splats):
    """Linear colours of splats, seen from anywhere."""
    assert (splats.sh[:, 1:] == 0).all()
    return linear(0.5 + SH_0 * splats.sh[:, 0].astype(float))


# --- radiance -------------------------------------------------------------------------------------


def test_display_and_light_are_each_others_inverse_and_the_kernels():
    light = np.geomspace(1e-4, 25, 60)
    np.testing.assert_allclose(linear(display(light)), light, rtol=1e-12)
    kernel = [linear_from_display(np.float32(c)) for c in display(light)]
    np.testing.assert_allclose(kernel, light, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("kind", ["tail", "brake", "sign"])
def test_a_clipped_lamp_gets_the_flux_of_its_class(kind):
    splats = one_splat(color=(1.0, 0.86, 0.62), scale=0.1)
    lit, counts = with_lamps(splats, [Lamp(kind, np.array([0, 0, 2.0]), 0.2)])
    before, after = linear(np.array([1.0, 0.86, 0.62])), light_of(lit)[0]
    area = (lit.scale[0, 0] / splats.scale[0, 0]) ** 2
    flux = (after @ LUMINANCE_WEIGHTS) * area
    assert counts == [1] and flux == pytest.approx(LUMINANCE[kind] / WHITE, rel=1e-3)
    np.testing.assert_allclose(after / after.max(), before, rtol=1e-3)  # its own colour
    if kind == "brake":  # brighter and no larger: where it falls to white is where it was
        rim = np.sqrt(2 * np.log(after.max())) * lit.scale[0, 0]
        assert lit.scale[0, 0] < splats.scale[0, 0] and rim < 2.2 * splats.scale[0, 0]


def test_dark_and_far_splats_are_no_lamps():
    splats = joined([one_splat(color=(0.5, 0.5, 0.5)), one_splat((0, 0, 3.0), color=(1, 1, 1))])
    lit, counts = with_lamps(splats, [Lamp("head", np.array([0, 0, 2.0]), 0.5)])
    assert counts == [0]
    np.testing.assert_array_equal(lit.sh, splats.sh)
    np.testing.assert_array_equal(lit.scale, splats.scale)


def test_lamps_in_files(tmp_path):
    from made_actors import described

    scene = moving_scene()
    actor = scene.actors[0]
    place = actor.splats.position[actor.splats.sh[:, 0].max(axis=1).argmax()].tolist()
    lamp = {"class": "tail", "at": place, "radius": 0.05}
    path = described(tmp_path, scene, lamps=[lamp])
    found = read_actors(path)
    changed = (found.actors[0].splats.sh[:, 0] != actor.splats.sh[:, 0]).any(axis=1)
    assert 0 < changed.sum() < 200 and f"1 lamps of {changed.sum()} splats" in found.notes[-1]
    assert light_of(found.actors[0].splats).max() > 1.5 > light_of(actor.splats).max()
    text = path.read_text().replace('"nodes"', '"lamps": [%s], "nodes"')
    ground = scene.splats.position[0].tolist()
    path.write_text(text % f'{{"class": "sign", "at": {ground}, "radius": 0.2}}')
    static = import_scene(path)
    assert "1 lamps of 0 splats shine; 1 have no splat" in static.notes[-1]  # the paving is grey
    for wrong in (3, [3], [lamp | {"class": "moon"}], [lamp | {"radius": 0}], [{"class": "tail"}],
                  [lamp | {"at": [0, 0]}], [lamp | {"class": []}]):  # fmt: skip
        with pytest.raises(InputError, match="lamps has"):
            read_actors(described(tmp_path, scene, lamps=wrong))


# --- glare ----------------------------------------------------------------------------------------


def test_the_point_spread_is_one_over_a_hemisphere_with_the_sharp_image():
    def ring(angle):
        return scattered(angle) * 2 * np.pi * np.sin(np.radians(angle)) * np.pi / 180

    pieces = [integrate.quad(ring, a, b)[0] for a, b in ((0, 0.1), (0.1, 1), (1, 10), (10, 90))]
    assert 0.384 + sum(pieces) == pytest.approx(1.0, abs=0.02)
    assert (np.diff(scattered(np.geomspace(0.01, 90, 50))) < 0).all()


@pytest.mark.parametrize("brightness", [1.0, 4.0])
def test_the_halo_of_a_lamp_is_the_published_function(brightness):
    picture = np.full((90, 140, 3), 0.1, np.float32)
    picture[45, 70] = 500.0, 50.0, 0.1
    shown = Glare().added(picture, FOCAL, brightness)
    for row, column in ((45, 71), (45, 75), (60, 70), (20, 100), (89, 139)):
        angle = np.arctan(np.hypot(row - 45, column - 70) / FOCAL)
        expected = scattered(np.degrees(angle)) * np.cos(angle) ** 3 / FOCAL**2
        for c, radiance in ((0, 500.0), (1, 50.0)):
            halo = shown[row, column, c] - 0.1
            excess = radiance - DAZZLES / brightness
            assert halo == pytest.approx(expected * excess, rel=2e-3, abs=2e-6)
    np.testing.assert_array_equal(shown[..., 2], picture[..., 2])  # no blue in it
    assert picture[45, 71, 0] == np.float32(0.1)  # the picture itself is left alone


def test_without_lamps_there_is_no_halo():
    picture = np.full((20, 30, 3), 0.9 * DAZZLES, np.float32)
    assert Glare().added(picture, FOCAL, 1.0) is picture
    assert Glare().added(picture, FOCAL, 2.0) is not picture


# --- dusk and the wet road ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dusk():
    """The scenes at dusk, their ground, still water, a camera and the settings."""
    config = Config.from_preset("dusk").replace(
        rate=0.0, past=6e-3, frames=1, width=48, extent=1.0, spacing=0.025, film="mirror"
    )
    scenes = lamp_scene()
    terrain = extract_terrain(scenes[1], config)
    state = next(simulate(terrain, config))
    state = replace(state, slopes=np.zeros_like(state.slopes))
    return scenes, terrain, state, scenes[1].cameras[0].resized(96, 72), config


def test_lamps_shine_at_dusk_and_the_meter_follows_the_land(dusk):
    scenes, terrain, state, camera, config = dusk
    renderers = [Renderer(scene, terrain, config, camera) for scene in scenes]
    clipped, shining = renderers
    pictures = [r.draw(camera, state)[0].astype(int) for r in renderers]
    assert shining.conductor.brightness == pytest.approx(clipped.conductor.brightness, rel=0.15)
    assert (pictures[1] - pictures[0]).max() > 40
    assert clipped.conductor.wet_scene.shading.look.exposure == pytest.approx(0.7 * 0.04, rel=1e-5)


def test_the_image_of_a_lamp_in_the_water_is_that_of_traced_rays(dusk):
    """As it is shown: with the meter's factor and the tone curve."""
    scenes, terrain, state, camera, config = dusk
    light = {}
    for name, scene in (("mirror", scenes[1]), ("traced", scenes[1]), ("clipped", scenes[0])):
        renderer = Renderer(scene, terrain, config.replace(reflections="mirror"), camera)
        if name != "mirror":
            trace_reflections(renderer)
        _, report = renderer.draw(camera, state, None, ("reflection", "coverage"))
        radiance = report.aovs["reflection"] * np.float32(renderer.conductor.brightness)
        light[name] = np.vectorize(tone_curve)(radiance.astype(np.float32))
        water = report.aovs["coverage"] > 0.5

    def likeness(name):
        return -10 * np.log10(np.mean((light[name] - light["traced"])[water] ** 2))

    assert water.sum() > 100 and light["traced"][water].max() > 0.9
    assert likeness("mirror") > 27.5
    assert likeness("clipped") < likeness("mirror") - 3


@pytest.mark.parametrize("value", [0.0, -1.0, 1.5, float("nan")])
def test_daylight_that_no_day_has(value):
    with pytest.raises(ParameterError, match="daylight"):
        Config().replace(daylight=value).check()
