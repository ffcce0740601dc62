"""Shade in the picture of the ground: found by its one ratio, and never made of paint."""

import numpy as np
import pytest

import factories
import made_ground
from made_ground import LAWN, PAVING, SAND, SUN_OVER_SKY
from rainsim.constants import SH_0
from rainsim.daylight import relight
from rainsim.daylight.kept_light import under_clouds
from rainsim.numerics.srgb import display, linear
from rainsim.scene.types import GroundFrame, Scene
from rainsim.surface import kept_surface
from rainsim.surface.fuse import CaptureSurface
from rainsim.surface.ground_picture import ground_picture
from rainsim.surface.ground_shade import ground_shade, hidden_at, lifted

OFF = np.random.default_rng(5).normal(0, 0.12, (8, 3)).clip(-0.25, 0.25)


def picture_of(exposure=(0.0,), **what):
    return ground_picture(made_ground.views(lambda at: made_ground.light_of(at, **what), exposure))


def cells(picture):
    """Return the middles of the cells that are seen, on the ground, (n, 3)."""
    row, column = np.nonzero(picture.seen)
    place = picture.low + picture.cell * (np.stack([column, row], -1) + 0.5)
    return np.column_stack([place, 0 * row])


def lifted_light(found, place, log):
    """Return the light (n, 3) of small splats at places once it is lifted."""
    light = lifted(found, place, log, np.full(len(place), 0.01))
    return np.exp(log) + light[:, 3:] * (light[:, :3] - np.exp(log))


@pytest.fixture(scope="module")
def shadow():
    """A picture with two bars of shade over two paints, and the shade that is found."""
    picture = picture_of()
    return picture, ground_shade(picture)


def test_shade_is_found_with_its_ratio(shadow):
    _, found = shadow
    assert found.confidence > 0.9
    np.testing.assert_allclose(np.log1p(found.ratio), np.log1p(SUN_OVER_SKY), atol=0.2)


def test_one_paint_is_as_light_on_both_sides(shadow):
    picture, found = shadow
    place = cells(picture)
    log = picture.log[picture.seen]
    after = np.log(lifted_light(found, place, log))
    hidden, lawn = made_ground.shaded(place), place[:, 1] > 0.1
    for paint in (lawn, place[:, 1] < -0.1):
        sides = [paint & (hidden > 0.98), paint & (hidden < 0.02)]
        before = log[sides[0]].mean(axis=0) - log[sides[1]].mean(axis=0)
        assert (before < -0.6).all()
        mean = [after[side].mean(axis=0) for side in sides]
        np.testing.assert_allclose(*mean, atol=0.12)
    # No line along the edge: where the sun is half hidden the ground is as light as beside it.
    truth = np.log(made_ground.light_of(place, shade=lambda at: 0 * at[..., 0]))
    edge = (hidden > 0.05) & (hidden < 0.95) & (np.abs(place[:, 1]) > 0.2)
    assert np.abs((after - truth)[edge].mean(axis=0)).max() < 0.15


def test_exposures_change_nothing(shadow):
    found = ground_shade(picture_of(OFF))
    np.testing.assert_allclose(np.log1p(found.ratio), np.log1p(shadow[1].ratio), atol=0.1)
    assert abs(found.area - shadow[1].area) < 0.05


@pytest.mark.parametrize("paints", [(PAVING, LAWN), (SAND, PAVING * 0.4), (LAWN, SAND, PAVING)])
def test_paints_without_sun_are_left(paints):
    assert ground_shade(picture_of(paints=paints, shade=None)) is None
    assert ground_shade(picture_of(OFF, paints=paints, shade=None)) is None


def test_a_border_of_paints_that_looks_like_shade_is_left(shadow):
    """Paving as much darker and bluer as the shade is: one paint alone never tells."""
    darker = PAVING / (1 + SUN_OVER_SKY)
    assert ground_shade(picture_of(paints=(PAVING, darker), shade=None)) is None
    assert shadow[1] is not None


def test_a_dark_paint_within_the_sun_keeps_its_colour(shadow):
    def light(place):
        spot = np.hypot(place[..., 0] - 0.6, place[..., 1] + 1.5) < 0.3
        return made_ground.light_of(place) * np.where(spot[..., None], [0.25, 0.2, 0.15], 1)

    picture = ground_picture(made_ground.views(light))
    place = cells(picture)
    found = ground_shade(picture)
    inside = np.hypot(place[:, 0] - 0.6, place[:, 1] + 1.5) < 0.2
    log = picture.log[picture.seen]
    gain = np.log(lifted_light(found, place, log)) - log
    assert np.abs(gain[inside]).max() < 0.1
    assert np.percentile(gain, 95) > 1.0


def test_splats_of_the_shaded_ground_alone_are_lifted(shadow):
    _, found = shadow
    dark, lit = (-1.0, 0.5), (2.2, 0.5)
    place = np.array([(*dark, 0), (*dark, -0.1), (*dark, 0.6), (*lit, 0), (9, 9, 0), (*dark, 0)])
    light = made_ground.light_of(place)
    scale = np.array([0.02, 0.02, 0.02, 0.02, 0.02, 2.0])[:, None]  # the last is haze
    splats = factories.splats(place, scale=scale, color=display(light))
    scene = Scene("made", splats, (), GroundFrame(np.eye(3), 1.0, np.zeros(3)), None, "0" * 64, ())
    result = relight._by_ground(scene, found)
    assert result.gain is None and "shade on" in result.note

    def gain(share):
        splats = under_clouds(scene.splats, result.ground, share)
        return linear(splats.sh[:, 0] * np.float32(SH_0) + np.float32(0.5)) / light

    np.testing.assert_allclose(gain(1.0)[2:], 1, atol=0.02)
    np.testing.assert_allclose(gain(1.0)[:2], [1 + SUN_OVER_SKY] * 2, rtol=0.2)
    np.testing.assert_allclose(gain(0.5)[:2], [1 + SUN_OVER_SKY / 2] * 2, rtol=0.2)
    assert under_clouds(scene.splats, result.ground, 0.0) is scene.splats


def test_what_stands_is_not_of_the_ground(shadow):
    _, found = shadow
    place = np.array([(-1.0, 0.5, 0.0), (-1.0, 0.5, 0.5), (9.0, 9.0, 0.0)])
    hidden, ground = hidden_at(found, place, np.log(made_ground.light_of(place)))[:2]
    np.testing.assert_allclose(ground, [1, 0, 0], atol=0.01)
    assert hidden[0] > 0.9


def test_it_is_kept_for_the_next_run(shadow, tmp_path, monkeypatch):
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path))
    surface = CaptureSurface(*np.zeros((6, 2, 3), np.float32))
    sky, maps = np.zeros(100, bool), np.zeros((2, 10), np.float32)
    found = kept_surface.Found(
        surface, sky, sky, maps[0, :3], maps, maps > 0, maps[0, :3], 3.0, shadow[1]
    )  # fmt: skip
    splats = factories.splats(np.zeros((100, 3)))
    scene = Scene("made", splats, (), GroundFrame(np.eye(3), 1.0, np.zeros(3)), None, "0" * 64, ())
    for find in (lambda *_: found, None):  # to call it again would be an error
        monkeypatch.setattr(kept_surface, "_last", [None, None])
        monkeypatch.setattr(kept_surface, "find_surface", find)
        again = kept_surface.kept_surface(scene).shade
    for mine, kept in zip(shadow[1], again, strict=True):
        np.testing.assert_array_equal(kept, mine)
