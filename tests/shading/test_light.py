"""Optical formulas against their definitions."""

import itertools

import numpy as np
import pytest

from factories import look, off_ground, wetness
from rainsim.numerics.approximations import (
    angle,
    exp_minus,
)
from rainsim.particles import drop_radiance, fog
from rainsim.scene.view import View
from rainsim.shading import environment as maps
from rainsim.shading import sky, surface_point, walls, wetting
from rainsim.shading.color import (
    display_from_linear,
    linear_from_display,
)
from rainsim.shading.composite import RainCover, RainLight, compose, tone_curve
from rainsim.shading.fresnel import (
    fresnel,
    schlick,
)
from rainsim.shading.grading import graded
from rainsim.shading.surface_point import SurfacePoint

AS_CAPTURED = look(albedo=0.85)
DULL = AS_CAPTURED._replace(exposure=0.7, compression=1.2)
SLANTING = off_ground(slant_x=0.5)  # rain to +x; one film of supply


def test_fresnel_and_schlick_against_float64():
    """Exact to 1e-3 everywhere (in fact 1e-6); Schlick's errors are the known ones."""
    cosine = np.linspace(0, 1, 2001)
    n = 1.333
    t = np.sqrt(1 - (1 - cosine**2) / n**2)
    exact = 0.5 * (
        ((cosine - n * t) / (cosine + n * t)) ** 2 + ((n * cosine - t) / (n * cosine + t)) ** 2
    )
    ours = np.array([fresnel(np.float32(c)) for c in cosine])
    assert np.abs(ours - exact).max() < 1e-5
    rough = np.array([schlick(np.float32(c)) for c in cosine])
    for degrees, off in ((45, -0.19), (60, -0.15), (80, 0.14)):
        at = np.argmin(np.abs(cosine - np.cos(np.radians(degrees))))
        assert rough[at] / exact[at] - 1 == pytest.approx(off, abs=0.02)


def test_polynomials_are_the_functions_they_stand_for():
    c = np.linspace(0, 4, 4001).astype(np.float32)
    exact = np.where(c <= 0.04045, c / 12.92, ((c.astype(float) + 0.055) / 1.055) ** 2.4)
    got = np.array([linear_from_display(v) for v in c])
    np.testing.assert_allclose(got, exact, rtol=5e-6, atol=1e-7)
    c = np.linspace(0, 1, 4001).astype(np.float32)
    exact = np.where(c <= 0.0031308, c * 12.92, 1.055 * c.astype(float) ** (1 / 2.4) - 0.055)
    got = np.array([display_from_linear(v) for v in c])
    np.testing.assert_allclose(got, exact, atol=2e-6)
    x = np.linspace(0, 25, 501).astype(np.float32)
    got = np.array([exp_minus(v) for v in x])
    np.testing.assert_allclose(got, np.exp(-x.astype(float)), rtol=1e-5, atol=3e-9)
    turn = np.linspace(-np.pi + 1e-3, np.pi, 721)
    got = [angle(np.float32(np.sin(a)), np.float32(np.cos(a))) for a in turn]
    np.testing.assert_allclose(got, turn, atol=1e-5)


def test_the_tone_curve_is_linear_up_to_half_of_white_and_never_cut_off():
    low = np.linspace(0, 0.5, 9, dtype=np.float32)
    np.testing.assert_allclose(
        [tone_curve(v) for v in low], [display_from_linear(v) for v in low], atol=2e-5
    )
    high = [tone_curve(np.float32(v)) for v in (0.5, 1.0, 2.0, 4.0, 20.0)]
    assert all(a < b for a, b in itertools.pairwise(high)) and high[-1] <= 1
    wanted = display_from_linear(np.float32(0.5 + 0.5 * (1 - np.exp(-2 * 0.5))))
    assert high[1] == pytest.approx(wanted, abs=1e-5)
    assert tone_curve(np.float32(-0.1)) == pytest.approx(0, abs=2e-5)


def test_wet_ratio_is_the_published_curve():
    for albedo, ratio in ((0.05, 0.50), (0.1, 0.515), (0.2, 0.54), (0.3, 0.57), (0.5, 0.64)):
        assert wetting.wet_ratio(np.float32(albedo)) == pytest.approx(ratio, abs=0.01)


def test_wetting_darkens_and_dry_stays():
    def wetted(r, g, b, damp=1.0, porosity=0.0, smooth=0.0):
        wet = wetness(dampness=damp, porosity=porosity)
        return wetting.wetted(r, g, b, smooth, wet, AS_CAPTURED)

    wet, dry = wetted(0.3, 0.3, 0.3), wetted(0.3, 0.3, 0.3, damp=0.0)
    np.testing.assert_allclose(dry, 0.3, rtol=1e-6)
    assert 0.5 < wet[0] / 0.3 < 0.65
    soaked = wetted(0.3, 0.3, 0.3, porosity=0.45)
    assert 0.4 < soaked[0] / wet[0] < 0.95  # filled pores darken more than a film
    assert wet < wetted(0.3, 0.3, 0.3, smooth=1.0) < dry
    leaf = wetted(0.1, 0.3, 0.05)
    assert sum(leaf) / 0.45 > wet[0] / 0.3  # leaves shed water


def test_wet_colors_are_richer_as_far_as_their_channels_darken():
    wet = wetness()
    red, green, blue = wetting.wetted(0.5, 0.25, 0.1, 0.0, wet, AS_CAPTURED)
    for found, dry in ((red, 0.5), (green, 0.25), (blue, 0.1)):
        assert found / dry == pytest.approx(wetting.wet_ratio(0.85 * dry), rel=1e-5)
    assert 1.1 * 5 < red / blue < 1.3 * 5
    grey = wetting.wetted(0.3, 0.3, 0.3, 0.0, wet, AS_CAPTURED)
    assert grey[0] == grey[1] == grey[2]


def test_level_things_gloss_by_their_water_alone_where_tops_are_drawn():
    wet = wetness(porosity=0.2)

    def gloss(height, tops_end):
        look = AS_CAPTURED._replace(tops_end=tops_end)
        level = surface_point.ground_share(
            np.float32(height), np.float32(1), surface_point.NOT_POOR
        )
        return wetting.rainy_color(
            0.2, 0.15, 0.1, 1.0, -0.3, 0.3, 1.0, height, level, wet, look
        )[3]  # fmt: skip

    assert gloss(0.7, 0.0) > 0.005 and gloss(0.7, 1.6) == 0
    for height in (0.1, 2.0):  # the ground, and roofs that are too high for tops
        assert gloss(height, 1.6) == gloss(height, 0.0) > 0.005


def test_what_lies_in_deep_shadow_mirrors_no_sky():
    def film(albedo):
        color = np.full(3, albedo / AS_CAPTURED.albedo)
        return wetting.lit_share(*color, AS_CAPTURED)

    assert film(0.001) < 0.01 < film(0.005) < 0.5 < film(0.015) < film(0.03) == 1


def test_filled_pores_follow_the_similarity_of_deep_layers():
    for albedo in (0.05, 0.1, 0.3, 0.5, 0.8):
        s = np.linspace(0, 1, 200_001)
        curve = (1 - s) * (1 - 0.139 * s) / (1 + 1.17 * s)
        dry = np.interp(-albedo, -curve, s)
        wanted = np.interp(min(dry * 1.55, 1.0), s, curve) / albedo
        assert wetting.filled_ratio(np.float32(albedo)) == pytest.approx(wanted, abs=2e-3)
    assert wetting.filled_ratio(np.float32(0.3)) < wetting.wet_ratio(np.float32(0.3))


def test_walls_catch_what_slants_towards_them():
    def damp(nx, ny, nz, supply=1.0, height=1.5):
        rain = SLANTING._replace(supply=supply)
        points = np.random.default_rng(1).uniform(0, 40, (400, 3))
        points = [SurfacePoint(*point, nx, ny, nz, 2.0) for point in points]
        return np.mean([walls.damp_off_ground(rain, point, height, 0.0) for point in points])

    assert damp(0.0, 0.0, 1.0, 2.5) == 1.0
    side, lee = damp(0.0, 1.0, 0.0, 8.0), damp(1.0, 0.0, 0.0, 8.0)
    assert damp(-1.0, 0.0, 0.0) > 0.2 > damp(0.0, 1.0, 0.0)
    assert side < 0.01 and lee < 0.01  # no drop meets them; their foot gets what splashes back
    assert damp(0.0, 1.0, 0.0, 80.0, 0.1) > 0.5
    assert damp(-1.0, 0.0, 0.0, 30.0) == 1.0 and damp(0.0, 0.0, -1.0) < 0.03  # soffits stay dry
    assert damp(-1.0, 0.0, 0.0, 0.0) == 0.0
    # Normals of a captured wall are noise: it is wet where it seems to lean over a little.
    assert damp(-0.98, 0.0, -0.19, 30.0) == 1.0 > 0.5 > damp(-0.77, 0.0, -0.64, 30.0)
    # What splashes back from the ground wets the foot of a wall, and nothing below a table.
    foot = damp(1.0, 0.0, 0.0, 30.0, 0.02)
    assert foot > 0.5 > 2 * damp(1.0, 0.0, 0.0, 30.0) and damp(1.0, 0.0, 0.0, 0.0, 0.02) == 0.0
    assert damp(0.0, 0.0, -1.0, 1.0, 0.02) < 0.03


def test_a_wall_is_wet_evenly_but_for_soft_paths_longer_than_wide():
    at = np.arange(0, 1.6, 0.02)

    def damp(x, y, z, nx, ny, nz, supply=1.0):
        point = SurfacePoint(x, y, z, nx, ny, nz, 2.0)
        return walls.damp_off_ground(SLANTING._replace(supply=supply), point, 9.0, 0.0)

    def wall(nx, ny, nz, supply=1.0):
        return np.array([[damp(y, y, z, nx, ny, nz, supply) for y in at] for z in at])

    half = wall(-1.0, 0.0, 0.0, 1.5)
    assert 0.4 < half.mean() < 0.8 and 0.02 < half.std() < 0.12
    across = np.abs(np.diff(half, axis=1))
    assert across.mean() > 4 * np.abs(np.diff(half, axis=0)).mean()
    assert across.max() < 0.15  # within 2 cm
    assert wall(-1.0, 0.0, 0.0, 30.0).std() == 0 == wall(-1.0, 0.0, 0.0, 0.0).std()
    # A normal that turns, on a car or by noise, changes it by little.
    turn = np.radians(np.arange(0, 180, 1.0))
    for tilt in (0.0, 0.3, 0.55):
        level = np.sqrt(1 - tilt**2)
        around = [
            damp(0.3, 0.7, 1, level * c, level * s, tilt)
            for c, s in zip(np.cos(turn), np.sin(turn), strict=True)
        ]
        assert np.abs(np.diff(around)).max() < 0.08
    steep = [damp(0.3, 0.7, 1.0, -np.sqrt(1 - z * z), 0.0, z) for z in np.arange(-0.95, 0.95, 0.01)]
    assert np.abs(np.diff(steep)).max() < 0.04
    # After long rain, too: what hardly faces the drops has no edge to what they miss.
    for nx in (-1, 1):
        long = [
            damp(0.3, 0.7, 1.0, nx * np.sqrt(1 - z * z), 0.0, z, 50.0)
            for z in np.arange(-0.95, 0.95, 0.01)
        ]
        assert np.abs(np.diff(long)).max() < 0.1


def test_noise_of_a_walls_normals_wets_no_patch_in_calm_air():
    calm = SLANTING._replace(slant_x=np.float32(0), slant_y=np.float32(0), supply=100.0)

    def damp(nz):
        point = SurfacePoint(0.3, 0.7, 2.0, np.sqrt(1 - nz * nz), 0.0, nz, 2.0)
        return walls.damp_off_ground(calm, point, 2.0, 0.0)

    assert damp(0.0) == damp(0.2) == damp(-0.2) < 0.01 and damp(0.8) > 0.99
    lean = [damp(nz) for nz in np.arange(0, 1, 0.05)]
    assert np.diff(lean).max() < 0.15  # no edge where it gets wet


def test_grading_is_the_identity_when_asked_for():
    np.testing.assert_allclose(graded(0.2, 0.5, 0.9, AS_CAPTURED), (0.2, 0.5, 0.9), rtol=1e-6)
    r, _g, b = graded(0.2, 0.5, 0.9, DULL)
    assert b < 0.7 * 0.9 and r / b == pytest.approx(0.2 / 0.9, rel=1e-6)


def test_lamps_are_not_dimmed_by_the_day():
    """What exceeds white by far shines by itself; grading goes on smoothly up to there."""
    lamp = np.array(graded(20.0, 12.0, 4.0, DULL))
    assert (lamp > 0.85 * np.array([20, 12, 4])).all() and lamp[0] < 20
    below, above = (graded(*(1.5 * k,) * 3, DULL)[0] for k in (0.999, 1.001))
    assert abs(above - below) < 5e-3 and below < 0.7


def test_overcast_sky_has_moon_and_spencers_irradiance():
    environment = sky.overcast()
    zenith = np.full(3, sky.ZENITH_RADIANCE)
    np.testing.assert_allclose(maps.irradiance(environment), 7 / 9 * zenith, rtol=0.01)
    np.testing.assert_allclose(environment[0].mean(0), zenith, rtol=0.01)
    assert environment[70, 0, 1] < environment[40, 0, 1]


def test_clouds_keep_the_irradiance_and_the_haze():
    plain = sky.overcast()
    made = sky.clouded(plain)
    assert maps.irradiance(made)[1] == pytest.approx(maps.irradiance(plain)[1], rel=1e-5)
    elevation = maps.directions(*made.shape[:2])[..., 2]
    high, low = (elevation > 0.4) & (elevation < 0.45), (elevation > 0.0) & (elevation < 0.02)
    assert 0.08 < made[high, 1].std() / made[high, 1].mean() < 0.4
    assert made[low, 1].std() / made[low, 1].mean() < 0.25
    np.testing.assert_array_equal(made, sky.clouded(plain))
    # No side of the sky is brighter than another: wet ground would mirror it at any hour.
    sides = made[(elevation > 0.2) & (elevation < 0.75), 1].reshape(-1, 4, 128).mean(axis=(0, 2))
    assert np.ptp(sides) < 0.06 * sides.mean()
    seam = np.abs(made[:, 0] - made[:, -1]).max()
    assert seam <= 2 * np.abs(np.diff(made, axis=1)).max()


def test_a_captured_sky_is_kept_where_it_was_seen_and_filled_elsewhere():
    direction = maps.directions()
    captured = np.where(direction[..., :1] > 0, (0.2, 0.4, 0.8), (0.0, 0.0, 0.0)).astype(np.float32)
    known = (direction[..., 0] > 0) & (direction[..., 2] > 0)
    made, share = sky.completed(captured, known)
    assert share == pytest.approx(0.5, abs=0.01)
    np.testing.assert_array_equal(made[known], captured[known])
    behind = made[(direction[..., 0] < -0.5) & (direction[..., 2] > 0.3)]
    assert (behind[:, 2] > 2 * behind[:, 0]).all()  # as blue as what was seen
    nothing, share = sky.completed(captured, np.zeros_like(known))
    assert share == 0
    np.testing.assert_array_equal(nothing, sky.overcast())


def test_the_sun_is_found_in_a_sky_that_has_one():
    environment = sky.overcast()
    assert sky.brightest(environment) is None
    azimuth, elevation = np.radians(130), np.radians(35)
    there = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)]
    near = maps.directions() @ np.array([*there, np.sin(elevation)]) > np.cos(np.radians(3))
    environment[near] = 400.0
    found = sky.brightest(environment)
    np.testing.assert_allclose(np.degrees(found), (130, 35), atol=1.0)


def test_environment_lookup_finds_what_was_put_there():
    rows, columns = maps.ROWS, maps.COLUMNS
    direction = maps.directions()
    picture = np.zeros((rows, columns, 3), np.float32)
    picture[..., 0] = direction[..., 0]
    picture[..., 1] = direction[..., 1]
    picture[..., 2] = direction[..., 2]
    rng = np.random.default_rng(3)
    for _ in range(50):
        d = rng.normal(size=3)
        d = (d / np.linalg.norm(d)).astype(np.float32)
        got = maps.sample_environment(picture, *d)
        np.testing.assert_allclose(got, d, atol=0.02)
    # The seam behind (azimuth +-180 degrees) is no edge.
    a = maps.sample_environment(picture, np.float32(-1), np.float32(1e-4), np.float32(0))[0]
    b = maps.sample_environment(picture, np.float32(-1), np.float32(-1e-4), np.float32(0))[0]
    assert a == pytest.approx(b, abs=1e-3)


def test_panorama_is_scaled_to_the_skys_irradiance():
    rng = np.random.default_rng(1)
    for shape in ((256, 512, 3), (300, 700, 3), (32, 64, 3)):
        panorama = rng.uniform(3, 40, shape).astype(np.float32)
        environment = sky.from_panorama(panorama)
        rows = max(shape[0], maps.ROWS)
        assert environment.shape == (rows, 2 * rows, 3)
        wanted = maps.irradiance(sky.overcast())[1]
        assert maps.irradiance(environment)[1] == pytest.approx(wanted, rel=1e-3)


LOOKS_ALONG_X = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.float32)
LENS = np.array([100, 100, 60, 40], np.float32)
FAR = np.full((80, 120), np.inf, np.float32)


def seen(around, turn=LOOKS_ALONG_X):
    """The picture (80, 120, 3) of what lies infinitely far around."""
    v, u = np.mgrid[:80, :120] + 0.5
    ray = np.stack([(u - 60) / 100, (v - 40) / 100, np.ones_like(u)], -1) @ turn.T
    ray = (ray / np.linalg.norm(ray, axis=-1, keepdims=True)).astype(np.float32)
    shown = [maps.sample_environment(around, *d) for d in ray.reshape(-1, 3)]
    return np.array(shown, np.float32).reshape(80, 120, 3)


def drop_light(around, picture, depth, turn=LOOKS_ALONG_X):
    """What `falling_light` returns of a picture (80, 120, 3) and the surroundings beside it."""
    mean = drop_radiance.mean_radiance(around)
    return drop_radiance.falling_light(around, mean, turn, LENS, picture, depth)


def bent(into, normal, ratio):
    """Directions that Snell's law gives to rays at a face."""
    cosine = -(into * normal).sum(1, keepdims=True)
    slip = np.sqrt(1 - ratio**2 * (1 - cosine**2))
    return ratio * into + (ratio * cosine - slip) * normal


def through_drop(u, v, rng, count=4000):
    """Directions in which rays of a camera at a pixel leave a drop, and how much is thrown back."""
    ahead = LOOKS_ALONG_X.astype(float) @ [(u - 60) / 100, (v - 40) / 100, 1]
    ahead /= np.linalg.norm(ahead)
    side = np.cross(ahead, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    r, angle = np.sqrt(rng.random((count, 1))), rng.random((count, 1)) * 2 * np.pi
    out = r * (np.cos(angle) * side + np.sin(angle) * np.cross(ahead, side))
    first = out - np.sqrt(1 - r**2) * ahead  # where the ray of sight enters the sphere
    within = bent(np.broadcast_to(ahead, out.shape), first, 1 / 1.333)
    second = first - 2 * (first * within).sum(1, keepdims=True) * within
    loss = 1 - np.array([fresnel(c) for c in np.sqrt(1 - r[:, 0] ** 2)])[:, None]
    return bent(within, -second, 1.333).astype(np.float32), loss**2


PLACES = {(4, 6): (60, 40), (0, 0): (0, 0), (8, 3): (30, 80)}


def test_drop_is_a_lens_that_shows_what_lies_far_around_behind_it():
    """Rays through a sphere of water, bent by Snell's law at each face in three dimensions."""
    direction = maps.directions()
    around = (1 + 0.5 * direction[..., :1] + 2 * direction[..., 2:] ** 2) * np.array([1, 0.6, 0.3])
    around = around.astype(np.float32)
    mean = drop_radiance.mean_radiance(around)
    np.testing.assert_allclose(mean, (1 + 2 / 3) * np.array([1, 0.6, 0.3]), rtol=2e-3)
    field, _ = drop_light(around, seen(around), FAR)
    rng = np.random.default_rng(3)
    for place, pixel in PLACES.items():
        leaves, through = through_drop(*pixel, rng)
        shown = np.array([maps.sample_environment(around, *d) for d in leaves])
        wanted = (through * shown + (1 - through) * mean).mean(axis=0)
        np.testing.assert_allclose(field[place], wanted, rtol=0.02)
    assert field[4, 6, 0] != pytest.approx(field[0, 6, 0], rel=0.01)


def test_drop_shows_of_a_wall_what_its_rays_meet():
    """The wall is 3 m away and bright in its middle; a drop counts as halfway to it."""
    around = np.full((32, 64, 3), 0.2, np.float32)
    v, u = np.mgrid[:80, :120] + 0.5
    glow = 0.2 + np.exp(-((u - 60) ** 2 + (v - 40) ** 2) / 18**2)
    picture = np.repeat(glow[..., None], 3, axis=2).astype(np.float32)
    rng = np.random.default_rng(4)
    flat = {depth: np.full((80, 120), depth, np.float32) for depth in (3, 1e4)}
    field = {depth: drop_light(around, picture, wall)[0][..., 0] for depth, wall in flat.items()}
    for place, (left, top) in PLACES.items():
        leaves, through = through_drop(left, top, rng)
        x, y, z = -leaves[:, 1], -leaves[:, 2], leaves[:, 0]  # of the camera frame
        ends = z > 0
        a = (left - 60) / 100 / 2 + x / np.where(ends, z, 1) / 2
        b = (top - 40) / 100 / 2 + y / np.where(ends, z, 1) / 2
        square = (100 * a) ** 2 + (100 * b) ** 2
        shown = 0.2 + np.where(ends, np.exp(-square / 18**2), 0)[:, None]
        wanted = (through * shown + (1 - through) * 0.2).mean()
        np.testing.assert_allclose(field[3][place], wanted, rtol=0.03)
    assert field[3][4, 6] > 1.3 * field[1e4][4, 6]  # what is far is seen past the wall's middle


def test_sheets_of_splashes_show_the_less_of_the_sky_the_more_they_are_seen_from_above():
    around = sky.overcast()
    around[around.shape[0] // 2 :] = 0.1
    mean = drop_radiance.mean_radiance(around)
    shares, angles = [], np.array([0.0, 0.6, 1.5])
    for down in angles:
        c, s = np.cos(down), np.sin(down)
        turn = np.array([[0, -s, c], [-1, 0, 0], [0, -c, -s]], np.float32)
        drops, sheets = drop_light(around, seen(around, turn), FAR, turn)
        assert drops.shape == sheets.shape == (*drop_radiance.GRID, 3)
        shares.append((sheets[4, 6, 1] - drops[4, 6, 1]) / (mean[1] - drops[4, 6, 1]))
    wanted = drop_radiance.SEEN_LEVEL - drop_radiance.SEEN_ABOVE * np.sin(angles)
    np.testing.assert_allclose(shares, wanted, rtol=1e-3)


def test_drops_before_the_ground_are_darker_than_before_the_sky(poisoned):
    around = sky.overcast()
    field, _ = drop_light(around, seen(around), FAR)
    assert (np.diff(field[:, 6, 1]) < 0).all() and field[0, 6, 1] > 1.5 * field[-1, 6, 1]
    assert field[-1, 6, 1] > 1.5 * around[-1, 0, 1]  # some sky is in them
    half, none = np.full((80, 120), 0.5, np.float32), np.zeros((80, 120), np.float32)
    shown = poisoned((80, 120, 3), np.uint8)
    compose(
        np.zeros((80, 120, 3), np.float32), none + 5, RainCover(half, none, fog.NO_FOG),
        RainLight(field, field, around[0, 0]), View(LOOKS_ALONG_X, np.zeros(3, np.float32), *LENS),
        np.float32(1), shown,
    )  # fmt: skip
    wanted = [[display_from_linear(0.5 * c) * 255 for c in field[j, i]]
              for j, i in ((0, 0), (-1, 0), (0, -1), (-1, -1))]  # fmt: skip
    np.testing.assert_allclose(shown[[0, -1, 0, -1], [0, 0, -1, -1]], wanted, atol=2)
    assert (np.diff(shown[:, 60, 1].astype(int)) <= 0).all()
