"""Streaks: summed alpha, length, place, occlusion and fog are those of the counted drops."""

import numpy as np
import pytest

from rainsim.drops import RainField, RainSpectrum, Surfaces, flat_surfaces
from rainsim.errors import ParameterError
from rainsim.particles.fog import NO_FOG, fog_extinction, fog_optical_depth, fog_table
from rainsim.particles.line_raster import FAINTEST, NEAR
from rainsim.particles.streaks import draw_streaks, streak_reach
from rainsim.scene.types import Camera
from rainsim.shading.composite import fog_thickness

FOCAL = 500.0  # px
DRY = RainField(RainSpectrum(0.0))


def looking(direction, eye=(0.0, 0.0, 0.0), width=96, height=80, focal=FOCAL):
    """A camera at `eye` that looks along x ("ahead"), straight up or straight down."""
    rows = {
        "ahead": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
        "up": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "down": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    }[direction]
    rotation = np.array(rows, dtype=np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ np.array(eye, dtype=np.float64)
    return Camera(width, height, focal, focal, width / 2, height / 2, matrix)


def sky(camera):
    return np.full((camera.height, camera.width), np.inf, np.float32)


def one_drop(position, velocity, diameter, camera, exposure, depth=None, end=None, times=1):
    """Draw a single drop, once or a few times over each other."""
    alpha = np.full((camera.height, camera.width), np.nan, np.float32)
    depth = sky(camera) if depth is None else depth
    lines = np.array([[*position, *velocity, diameter]] * times, np.float64)
    draw_streaks(DRY, None, camera, 0.0, exposure, depth, NEAR, alpha, end, more=lines)
    return alpha


def rain_alpha(field, camera, far=8.0, time=3.0, exposure=1 / 60, surfaces=None, depth=None):
    alpha = np.full((camera.height, camera.width), np.nan, np.float32)
    depth = sky(camera) if depth is None else depth
    draw_streaks(field, surfaces, camera, time, exposure, depth, far, alpha)
    return alpha


# ---- one drop


@pytest.mark.parametrize("exposure", [0.1e-3, 0.5e-3, 1e-3, 4e-3, 1 / 60, 33e-3])
@pytest.mark.parametrize("diameter, depth", [(0.6e-3, 5.0), (2e-3, 5.0), (3e-3, 2.0), (4e-3, 1.1)])
@pytest.mark.parametrize("wind", [0.0, 9.0])
def test_summed_alpha_does_not_depend_on_the_exposure(exposure, diameter, depth, wind):
    """Thin and wide drops, falling and blown sideways, streaks from still to 100 px."""
    camera = looking("ahead", width=400, height=400)
    velocity = np.array([0.0, wind, -6.0])
    middle = np.array([depth, 0.0131, 0.0077]) - velocity * exposure / 2
    alpha = one_drop(middle, velocity, diameter, camera, exposure)
    assert alpha.sum() == pytest.approx(np.pi / 4 * (FOCAL * diameter / depth) ** 2, rel=0.02)
    assert alpha.min() >= 0 and alpha.max() < 1


def test_strength_is_a_factor_on_what_a_drop_covers():
    camera = looking("ahead", width=100, height=100)
    alpha = np.empty((2, 100, 100), np.float32)
    drop = np.array([[5.0, 0.0131, 0.05, 0, 0, -6.0, 0.6e-3]])
    for strength, out in zip((1, 3), alpha, strict=True):
        draw_streaks(
            DRY, None, camera, 0.0, 1 / 60, sky(camera), NEAR, out, strength=strength, more=drop
        )
    assert alpha[0].sum() > 0
    assert alpha[1].sum() == pytest.approx(3 * alpha[0].sum(), rel=1e-3)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_summed_alpha_is_the_mean_over_the_path_when_the_depth_changes(direction):
    camera = looking(direction)
    start, stop = (1.2, 1.0) if direction == "up" else (1.0, 1.2)
    z = start if direction == "up" else -start
    alpha = one_drop((0.01, 0.004, z), (0, 0, -10.0), 0.8e-3, camera, 0.02)
    mean = 1 / (start * stop)  # of 1/z^2 between the two depths
    assert alpha.sum() == pytest.approx(np.pi / 4 * (FOCAL * 0.8e-3) ** 2 * mean, rel=0.01)


@pytest.mark.parametrize("exposure", [1e-6, 1 / 200])
@pytest.mark.parametrize("diameter", [1e-3, 14e-3])
def test_a_drop_is_where_the_camera_projects_it(exposure, diameter):
    """The centroid, for a point-like drop and for a disc, is within a twentieth of a pixel."""
    camera = looking("ahead")
    velocity = np.array([0, 2.0, -5.0])
    middle = np.array([3.0, 0.0613, -0.0411])
    alpha = one_drop(middle - velocity * exposure / 2, velocity, diameter, camera, exposure)
    v, u = (np.indices(alpha.shape) + 0.5) * alpha / alpha.sum()
    assert u.sum() == pytest.approx(48 - FOCAL * 0.0613 / 3, abs=0.05)
    assert v.sum() == pytest.approx(40 + FOCAL * 0.0411 / 3, abs=0.05)


def test_a_wide_still_drop_is_a_disc():
    alpha = one_drop((2.0, 0, 0), (0, 0, 0), 40e-3, looking("ahead"), 1e-3)  # 10 px wide
    assert alpha[40, 48] > 0.99 and alpha[40, 48 + 4] > 0.9 and alpha[40, 48 + 6] == 0
    np.testing.assert_allclose(alpha, alpha[::-1, ::-1], atol=1e-6)
    np.testing.assert_allclose(alpha[8:72, 16:80], alpha[8:72, 16:80].T, atol=1e-6)


@pytest.mark.parametrize("wind", [0.0, 3.0])
def test_the_ends_of_a_wide_streak_are_round(wind):
    """A pixel's alpha is the share of time for which the moving disc covers it."""
    camera, exposure = looking("ahead", width=120, height=160), 10e-3
    velocity, radius = np.array([0.0, wind, -9.0]), 4.0  # px
    middle = np.array([1.0, 0.0, 0.0]) - velocity * exposure / 2
    focal = camera.fx
    alpha = one_drop(middle, velocity, 2 * radius / focal, camera, exposure)
    step = np.array([-velocity[1], -velocity[2]]) * focal * exposure
    v, u = np.indices(alpha.shape) + 0.5
    covered = np.zeros(alpha.shape)
    for part in (np.arange(400) + 0.5) / 400 - 0.5:
        at = np.array([60.0, 80.0]) + part * step
        covered += np.hypot(u - at[0], v - at[1]) < radius
    covered /= 400
    assert np.hypot(*step) > 3 * 2 * radius  # it is drawn as strips
    assert abs(alpha - covered).max() < 0.2 * covered.max()
    end = np.array([60.0, 80.0]) + step / 2
    near = np.hypot(u - end[0], v - end[1]) < 1.0
    np.testing.assert_allclose(alpha[near], covered.max() / 2, rtol=0.3)


def test_drops_behind_things_are_hidden_and_partly_hidden_ones_cut():
    camera = looking("ahead")
    depth = sky(camera)
    depth[:, :48] = 2.0
    drop = (3.0, 0, 0.05), (0, 0, -6.0), 1e-3  # on the border of the two halves
    open_air, cut = one_drop(*drop, camera, 1 / 60), one_drop(*drop, camera, 1 / 60, depth)
    assert cut[:, :48].max() == 0 < open_air[:, :48].max()
    assert np.array_equal(cut[:, 48:], open_air[:, 48:])
    depth[:, :48] = 3.5
    assert np.array_equal(one_drop(*drop, camera, 1 / 60, depth), open_air)


def test_transmittances_of_drops_over_each_other_multiply():
    drop = (3.0, 0, 0.05), (0, 0, -6.0), 3e-3, looking("ahead"), 1 / 60
    single, double = one_drop(*drop), one_drop(*drop, times=2)
    assert single.max() > 5e-3
    np.testing.assert_allclose(double, 1 - (1 - single) ** 2, atol=2e-6)


# ---- the field


def naive_alpha_sum(field, camera, far, time):
    """Oracle: sum of (pi/4)(f D / z)^2 over all drops whose centre is in the picture."""
    drops = field.drops_in_box(time, (0, -far, -far), (far, far, far))
    z = drops.position[:, 0]
    with np.errstate(divide="ignore"):
        u, v = (c - FOCAL * drops.position[:, a] / z for a, c in ((1, camera.cx), (2, camera.cy)))
    seen = (z >= NEAR) & (z < far)
    seen &= (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    oblique = np.linalg.norm(drops.position[seen], axis=1) / z[seen]
    return (np.pi / 4 * (FOCAL * drops.diameter[seen] / z[seen]) ** 2 * oblique).sum()


def test_the_picture_holds_the_drops_that_the_field_lists():
    field = RainField(RainSpectrum(50), (0.5, 1.0), seed=4)
    camera = looking("ahead", width=500, height=400)
    alpha = rain_alpha(field, camera, far=4.0, exposure=1e-5)
    listed = naive_alpha_sum(field, camera, 4.0, 3.0)
    assert alpha.sum(dtype=np.float64) == pytest.approx(listed, rel=0.02)


def oblique(camera):
    """One over the cosine of each pixel's angle off the axis."""
    v, u = np.indices((camera.height, camera.width)) + 0.5
    return np.sqrt(1 + ((u - camera.cx) ** 2 + (v - camera.cy) ** 2) / camera.fx**2)


def test_corners_of_a_wide_picture_see_the_longer_way_through_the_rain():
    """Extinction along the true distance: 1.66 times the depth in the corners of this camera."""
    field, camera = RainField(RainSpectrum(50), (1, 2), seed=3), looking("ahead", focal=47.0)
    pictures = [rain_alpha(field, camera, far=2.0, time=t) for t in np.arange(120) * 0.5]
    optical = -np.log1p(-np.mean(pictures, axis=0, dtype=np.float64))
    way = oblique(camera)
    expected = field.spectrum.extinction.sum() * (2.0 - NEAR)
    for part in (way > 1.35, way < 1.1):
        assert optical[part].mean() == pytest.approx(expected * way[part].mean(), rel=0.08)


def drawn_and_fog(field, camera, far, depth, count, exposure=1 / 60):
    """Return the mean optical depth of `count` pictures and the fog behind, and its error."""
    drawn = [
        -np.log1p(-rain_alpha(field, camera, far, t, exposure, depth=depth)).mean(dtype=np.float64)
        for t in np.arange(count) * 0.7
    ]
    fog = fog_optical_depth(field, float(depth.max()), far) * oblique(camera).mean()
    return np.mean(drawn) + fog, np.std(drawn) / np.sqrt(count)


@pytest.mark.parametrize(("near_split", "far_split"), [(3.0, 9.0), (5.0, 20.0)])
def test_drawn_and_fog_together_do_not_depend_on_the_split(near_split, far_split):
    field, camera = RainField(RainSpectrum(50), seed=3), looking("ahead", focal=150.0)
    depth = np.full((80, 96), far_split, np.float32)
    splits = near_split, far_split
    (sooner, _), (later, error) = (drawn_and_fog(field, camera, far, depth, 12) for far in splits)
    assert abs(sooner - later) < max(0.01 * later, 2 * error)
    fine, whole = fog_extinction(field)
    assert whole == pytest.approx(fine + field.spectrum.extinction.sum()) and fine > 0


def test_no_drops_under_a_roof_and_drops_beside_it():
    """The camera looks ahead from under a wide roof; beyond the roof's edge it rains."""
    ground = np.full((80, 80), -1.5, np.float32)
    top, underside = ground.copy(), ground.copy()
    top[:, :60], underside[:, :60] = 1.0, 0.9  # x from -1 to 2
    surfaces = Surfaces(0.05, (-1.0, -2.0), ground, top, underside)
    field, camera = RainField(RainSpectrum(50), seed=1), looking("ahead")
    assert rain_alpha(field, camera, far=2.0, surfaces=surfaces).max() == 0
    beyond = rain_alpha(field, camera, far=2.9, surfaces=surfaces)
    assert beyond.max() > 0
    depth = np.full((80, 96), 2.0, np.float32)
    assert rain_alpha(field, camera, far=2.9, surfaces=surfaces, depth=depth).max() == 0
    assert rain_alpha(field, camera, far=2.0).max() > 0


def test_streaks_end_on_the_ground():
    camera = looking("ahead")
    field = RainField(RainSpectrum(100), seed=1)
    level = flat_surfaces(6, 6, 0.1, (-1, -3), height=-0.06)
    alpha = rain_alpha(field, camera, far=2.0, exposure=1 / 15, surfaces=level)
    horizon_of_nearest = 40 + FOCAL * 0.06 / 2.0  # the ground at 2 m; nearer ground is lower
    assert alpha[: int(horizon_of_nearest) - 2].mean() > 0
    buried = flat_surfaces(6, 6, 0.1, (-1, -3), height=0.3)
    assert rain_alpha(field, camera, far=2.0, surfaces=buried).max() == 0


def test_threads_and_history_do_not_matter(threads):
    camera = looking("ahead")
    level = flat_surfaces(6, 6, 0.1, (-1, -3), height=-1.0)
    pictures = []
    for count in (1, 2):
        threads(count)
        field = RainField(RainSpectrum(50), (1, 2), seed=9)
        if count == 2:
            rain_alpha(field, camera, time=0.0, surfaces=level)
        pictures.append(rain_alpha(field, camera, time=2.0, surfaces=level).tobytes())
    assert pictures[0] == pictures[1]
    assert np.frombuffer(pictures[0], np.float32).min() >= 0  # and poison is gone


def test_no_rain_draws_nothing_over_the_poison():
    alpha = rain_alpha(RainField(RainSpectrum(0)), looking("ahead"))
    assert alpha.max() == 0 == alpha.min()


def test_bad_input_is_refused():
    field, camera = RainField(RainSpectrum(1)), looking("ahead")
    with pytest.raises(ParameterError, match="exposure"):
        rain_alpha(field, camera, exposure=0.0)
    with pytest.raises(ParameterError, match="far"):
        rain_alpha(field, camera, far=-1.0)
    with pytest.raises(ParameterError, match="shape"):
        rain_alpha(field, camera, depth=np.zeros((3, 3), np.float32))


# ---- what is left to the fog


@pytest.mark.parametrize("exposure", [1 / 250, 1 / 60])
def test_drops_too_faint_to_see_are_fog_and_nothing_is_lost(exposure):
    """Drawn + fog with each class's own reach is what it is with one split for all."""
    field, camera = RainField(RainSpectrum(50), seed=3), looking("ahead", focal=300.0)
    depth = np.full((80, 96), 9.0, np.float32)
    reach = streak_reach(field, camera, exposure, 9.0)
    assert reach.min() < 3 < reach.max() <= 9 and (np.diff(reach) >= 0).all()
    (one, error), (own, other_error) = (
        drawn_and_fog(field, camera, far, depth, 24, exposure) for far in (9.0, reach)
    )
    assert abs(one - own) < max(0.01 * one, 2 * error, 2 * other_error)


def test_beyond_its_reach_a_drop_hardly_changes_a_pixel():
    field, camera = RainField(RainSpectrum(50)), looking("ahead", height=400)
    reach = streak_reach(field, camera, 1 / 60, 100.0)
    for size_class in (0, 20, 40):
        diameter, speed = field.spectrum.edges[size_class + 1], field.spectrum.speed[size_class]
        alpha = one_drop((reach[size_class], 0, 0), (0, 0, -speed), diameter, camera, 1 / 60)
        assert 0.2 * FAINTEST < alpha.max() < 1.1 * FAINTEST


def test_the_fog_table_holds_the_optical_depth():
    field, camera = RainField(RainSpectrum(50)), looking("ahead")
    reach = streak_reach(field, camera, 1 / 60, 8.0)
    table = fog_table(field, reach)
    for depth in (0.5, 2.2, 5.0, 30.0):
        read = fog_thickness(table, np.float32(depth))
        assert read == pytest.approx(fog_optical_depth(field, depth, reach), rel=2e-3, abs=2e-6)
    assert fog_thickness(NO_FOG, np.float32(50.0)) == 0
