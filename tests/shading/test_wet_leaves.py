"""Wet leaves: each is a small mirror of what its own normal shows, as far as it stands open."""

import numpy as np
import pytest

from factories import look, off_ground, wetness
from rainsim.numerics.srgb import linear
from rainsim.shading import environment, wetting
from rainsim.shading.color import luminance
from rainsim.shading.fresnel import SCHLICK, fresnel, schlick
from rainsim.shading.surface_point import GroundMaps, SurfacePoint
from rainsim.shading.wetting import SkyMaps

F4 = np.float32
LOOK = look()
SOAKED = off_ground(supply=100)
DRY = SOAKED._replace(supply=F4(0))
GREEN, BROWN = F4([0.30, 0.42, 0.22]), F4([0.40, 0.33, 0.26])  # display-referred
LEVEL = GroundMaps(np.zeros((4, 4), F4), np.zeros((4, 4, 4), F4), F4([50, 50]), F4(1))
AHEAD = F4([1, 0, 0])
TO_ZENITH, ONWARDS = F4([-1, 0, 1]) / F4(np.sqrt(2)), F4([-1, 0, 0])  # normals


@pytest.fixture
def skies():
    """White above 45 degrees, black below."""
    bright = environment.directions()[..., 2] > np.sqrt(0.5)
    light = np.repeat(bright[..., None], 3, axis=-1).astype(F4)
    return SkyMaps(light, light, light)


def gloss_of(color, normal, rain, skies, look=LOOK):
    """Return what water adds to a thing 1 m above the ground seen along x, in green light."""

    def drawn(maps):
        point = SurfacePoint(F4(3), F4(0), F4(1), *normal, F4(3))
        return wetting.wet_pixel(
            color, F4(1), AHEAD, point, normal, LEVEL, rain, maps, look, False
        )[1]  # fmt: skip

    return drawn(skies) - drawn(SkyMaps(0 * skies.gloss, 0 * skies.coat, skies.behind))


def test_a_leaf_that_is_turned_to_the_zenith_mirrors_it(skies):
    open_leaf = gloss_of(1.2 * GREEN, TO_ZENITH, SOAKED, skies)
    assert open_leaf == pytest.approx(fresnel(F4(np.sqrt(0.5))), rel=0.02)
    law = look(law=SCHLICK)
    by_law = gloss_of(1.2 * GREEN, TO_ZENITH, SOAKED, skies, law)
    assert by_law == pytest.approx(schlick(F4(np.sqrt(0.5))), rel=0.02) != open_leaf
    # One that faces the viewer mirrors what lies behind the viewer.
    assert gloss_of(1.2 * GREEN, ONWARDS, SOAKED, skies) == 0


def test_leaves_are_wet_by_half_however_they_lie_and_wood_by_its_slope():
    def damp(normal, leaf, rain=SOAKED):
        point = SurfacePoint(F4(3), F4(0), F4(1), *F4(normal), F4(3))
        wet = wetting.wet_state(point, F4(1), F4(1), F4(0), F4(leaf), F4(1), LEVEL, rain)
        return wet.dampness

    up, side, down = (0, 0, 1), (-1, 0, 0), (0, 0, -1)
    assert [damp(n, 1) for n in (up, side, down)] == pytest.approx([0.5] * 3)
    assert damp(up, 0) == 1 and damp(side, 0) < 0.01 and damp(up, 1, DRY) == 0


def test_dry_leaves_and_wet_wood_do_not_gloss_as_wet_leaves_do(skies):
    assert gloss_of(GREEN, TO_ZENITH, DRY, skies) == 0
    wood = gloss_of(BROWN, TO_ZENITH, SOAKED, skies)
    assert 0 <= wood < 0.2 * gloss_of(GREEN, TO_ZENITH, SOAKED, skies)


def test_dark_leaves_deep_in_a_hedge_mirror_little(skies):
    dark, light = (gloss_of(tone * GREEN, TO_ZENITH, SOAKED, skies) for tone in (0.4, 0.8))
    assert 0 < dark < 0.35 * light
    # Twice the albedo for the same colour is twice the light that is known to reach the leaf.
    brighter = gloss_of(0.4 * GREEN, TO_ZENITH, SOAKED, skies, LOOK._replace(albedo=F4(2)))
    assert brighter == pytest.approx(2 * dark, rel=1e-4)


def test_a_leaf_on_edge_is_no_mirror_at_grazing_angles(skies):
    def reflected(cosine):
        normal = F4([-cosine, 0, np.sqrt(1 - cosine**2)])
        white = SkyMaps(np.ones_like(skies.gloss), np.ones_like(skies.gloss), skies.behind)
        return gloss_of(1.2 * GREEN, normal, SOAKED, white)

    assert reflected(0.3) == pytest.approx(reflected(0.5), rel=1e-4)
    assert reflected(0.1) < reflected(0.3)  # blended normals at outlines
    assert reflected(0.9) < 0.5 * reflected(0.5)


def test_lawns_and_leaves_hardly_darken_where_paving_does():
    wet = wetness(porosity=0.12)
    tones = {"stone": F4([0.25, 0.25, 0.24]), "leaf": F4([0.1, 0.2, 0.05])}

    def kept(color, wet):
        found = wetting.wetted(*color, F4(0), wet, LOOK)
        return float(luminance(*map(F4, found)) / luminance(*color))

    assert kept(tones["stone"], wet) < 0.6
    assert 0.85 < kept(tones["leaf"], wet) < 0.92
    assert 0.92 < kept(tones["leaf"], wet._replace(lawn=F4(1), porosity=F4(0.45))) < 0.97
    dry = wet._replace(dampness=F4(0))
    assert kept(tones["leaf"], dry) == pytest.approx(1, abs=1e-6)


def test_a_factor_on_the_wetness_darkens_and_glosses_by_as_much(skies):
    dark = SkyMaps(0 * skies.gloss, 0 * skies.coat, 0 * skies.behind)

    def drawn(factor, color=BROWN, maps=dark):
        point = SurfacePoint(F4(3), F4(0), F4(1), *TO_ZENITH, F4(3))
        look = LOOK._replace(wetness=F4(factor))
        return wetting.wet_pixel(
            color, F4(1), AHEAD, point, TO_ZENITH, LEVEL, SOAKED, maps, look, False
        )[1]  # fmt: skip

    captured = luminance(*linear(np.array([BROWN[1]] * 3)))
    none, half, one, two = (drawn(f) for f in (0, 0.5, 1, 2))
    assert none == pytest.approx(captured, rel=1e-5)
    assert none - half == pytest.approx((none - one) / 2, rel=0.05)
    assert 0.1 * captured * 0.99 <= two < one < half
    gloss = [gloss_of(GREEN, TO_ZENITH, SOAKED, skies, LOOK._replace(wetness=F4(f)))
             for f in (0, 1, 2)]  # fmt: skip
    assert gloss[0] == 0 and gloss[2] == pytest.approx(2 * gloss[1], rel=1e-4) and gloss[1] > 0
    white = SkyMaps(0 * skies.gloss + 1, 0 * skies.coat + 1, skies.behind)
    smooth = SOAKED._replace(porosity=F4(0))  # a coat of water is no more than a mirror
    assert gloss_of(BROWN, TO_ZENITH, smooth, white, LOOK._replace(wetness=F4(2))) <= 1
