"""Crowns: as wide and as lasting as cited, right in area, drawn, and gone when they should be."""

import numpy as np
import pytest

from rainsim.drops import RainField, RainSpectrum, Surfaces, flat_surfaces, impacts
from rainsim.particles.crown import (
    LONGEST_CROWN,
    LONGEST_JET,
    crown_shape,
    fingers_of,
    raise_crown,
    raise_jet,
)
from rainsim.particles.splash import WET_FILM, Impact
from rainsim.particles.splash_pass import draw_splashes, seen_splashes
from rainsim.rain.size_distribution import terminal_speed
from rainsim.scene.types import Camera
from splash_lines import Lines, fallen, splash_droplets

NEIGHBOURS = [(j, i) for j in (-1, 0, 1) for i in (-1, 0, 1)]


def crown(diameter, age, film=1e-3, exposure=1e-5, pixel=1e-4):
    speed = float(terminal_speed(diameter))
    impact = Impact(np.uint64(5), 0.0, 0.0, 0.0, 0.0, 0.0, speed, diameter, film, age)
    count, rows = np.zeros(1, np.int64), np.full((4096, 7), np.nan)
    shape = crown_shape(impact, 1.0, pixel)
    with np.errstate(over="ignore"):
        if age < shape.life:
            raise_crown(impact, shape, pixel, exposure, count, rows)
    if shape.jet and age < LONGEST_JET:
        raise_jet(impact, pixel, exposure, count, rows)
    return Lines.of(rows[: count[0]])


@pytest.mark.parametrize("diameter", [1.5e-3, 2.5e-3, 4e-3])
def test_the_foot_grows_with_the_square_root_of_time(diameter):
    feet = []
    for age in (1e-3, 4e-3):
        lines = crown(diameter, age)
        low = lines.position[:, 2] == 0  # where sheets stand
        feet.append(np.hypot(*lines.position[low, :2].T).mean())
    assert feet[1] / feet[0] == pytest.approx(2, rel=0.01)
    speed = terminal_speed(diameter)
    inviscid = diameter * (2 * diameter / 3e-3) ** 0.25 * (speed * 1e-3 / diameter) ** 0.5
    assert 0.5 < feet[0] / inviscid < 1  # h / D within the clipped range for these drops


def test_a_crown_rises_sinks_and_is_gone():
    heights = [crown(3e-3, age).position[:, 2].max(initial=0) for age in (1e-3, 8e-3, 16e-3)]
    assert heights[0] < heights[1] > heights[2]
    assert 2e-3 < heights[1] < 15e-3
    assert len(crown(3e-3, LONGEST_CROWN)) == 0 and len(crown(3e-3, -0.01)) == 0


def test_detail_follows_the_pixel_and_the_area_hardly_does():
    fine, coarse = crown(3e-3, 5e-3, pixel=2e-4), crown(3e-3, 5e-3, pixel=5e-3)
    assert len(fine) > 3 * len(coarse) > 5
    assert (fine.diameter**2).sum() == pytest.approx((coarse.diameter**2).sum(), rel=0.15)


def test_an_exposure_shows_the_share_of_time_that_a_crown_lives():
    short = crown(2e-3, 0.0, exposure=0.03, pixel=1.0)
    long = crown(2e-3, 0.0, exposure=0.06, pixel=1.0)
    assert (short.diameter**2).sum() == pytest.approx(2 * (long.diameter**2).sum(), rel=1e-6)


def test_the_rim_has_as_many_fingers_as_rayleighs_wavelengths_fit_on_it():
    """A rim of .17 D under the wavelength 9.02 a, when its fastest wave has grown by e."""
    found = {}
    for diameter in (2e-3, 4e-3):
        speed = float(terminal_speed(diameter))
        impact = Impact(np.uint64(5), 0.0, 0.0, 0.0, 0.0, 0.0, speed, diameter, 1e-3, 0.0)
        shape, a = crown_shape(impact, 1.0, 1e-4), 0.085 * diameter
        circumference = 2 * np.pi * shape.growth * np.sqrt(np.sqrt(1000 * a**3 / 0.0728) / 0.343)
        assert shape.fingers == pytest.approx(circumference / (9.02 * a), rel=0.01)
        assert fingers_of(shape, 0.0) < round(shape.fingers) < fingers_of(shape, 0.999)
        found[diameter] = fingers_of(shape, 0.5)
    assert 6 <= found[2e-3] < found[4e-3] <= 20


def test_a_jet_rises_from_deep_water_only():
    deep, shallow = crown(3e-3, 0.045, film=0.02), crown(3e-3, 0.045, film=1e-3)
    assert len(deep) == 1 and len(shallow) == 0


def test_droplets_of_an_exposure_are_those_of_its_moments():
    impact = fallen([3e-3], first=5)
    still = splash_droplets(impact, 1e-3, 0.01)
    moving = splash_droplets(impact, 1e-3, 0.01, 0.01)
    end = splash_droplets(impact, 1e-3, 0.02)
    np.testing.assert_allclose(moving.position, still.position)
    np.testing.assert_allclose(moving.position + moving.velocity * 0.01, end.position, atol=1e-12)
    born = splash_droplets(impact, 1e-3, -0.005, 0.01)  # half of the exposure
    assert len(born) == len(still)
    np.testing.assert_allclose(born.diameter, still.diameter * np.sqrt(0.5))


def camera(size=160):
    rotation = np.array([[1.0, 0, 0], [0, -0.5, -np.sqrt(0.75)], [0, np.sqrt(0.75), -0.5]])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ np.array([2.0, 0.4, 1.0])
    return Camera(size, size, size, size, size / 2, size / 2, matrix)


def drawn(surfaces, time=1.0, film=WET_FILM, rate=50, exposure=1 / 60):
    view = camera()
    alpha = np.full((view.height, view.width), np.nan, np.float32)
    depth = np.full_like(alpha, 50)
    water = np.zeros(surfaces.shape, np.float32)
    field = RainField(RainSpectrum(rate), seed=1)
    draw_splashes(field, surfaces, view, time, exposure, water, film, depth, alpha)
    return alpha


def test_splashes_are_seen_on_the_ground_and_on_a_table():
    ground = flat_surfaces(4, 4, 0.05)
    alpha = drawn(ground)
    assert alpha.max() > 0.1 and 0.002 < (alpha > 0.03).mean() < 0.5
    level = np.zeros((80, 80), np.float32)
    table = Surfaces(0.05, (0, 0), level, level + 0.5, level + 0.45)
    assert drawn(table).max() > 0.1 and (drawn(table) != alpha).any()
    assert drawn(ground, rate=0).max() == 0


def test_splashes_live_for_some_frames_and_threads_do_not_matter(threads):
    ground = flat_surfaces(4, 4, 0.05)
    threads(1)
    first, soon, late = (drawn(ground, 1.0 + dt, exposure=1e-3) for dt in (0, 0.002, 0.2))
    threads(2)
    assert first.tobytes() == drawn(ground, 1.0, exposure=1e-3).tobytes()
    alike, other = (np.corrcoef(first.ravel(), a.ravel())[0, 1] for a in (soon, late))
    assert alike > 0.4 > 0.2 > other


def test_drips_splash_beside_the_rain_and_are_known_by_their_ids():
    ground, view = flat_surfaces(4, 4, 0.05), camera()
    drip = fallen([4.5e-3], first=5)
    drip.position[:, :2] = 2.0, 2.0
    dry = RainField(RainSpectrum(0), seed=1)
    water = np.zeros(ground.shape, np.float32)
    alpha = np.full((view.height, view.width), np.nan, np.float32)
    depth = np.full_like(alpha, 50)
    where = (dry, ground, view, drip.time[0] + 2e-3, 2e-3, water, WET_FILM, depth)
    draw_splashes(*where, alpha, more=drip)
    assert alpha.max() > 0.1
    draw_splashes(*where, alpha)
    assert alpha.max() == 0
    position, ids = seen_splashes(*where, more=drip)
    assert list(ids) == list(drip.id)
    np.testing.assert_array_equal(position, drip.position)
    assert len(seen_splashes(*where)[1]) == 0


def test_splashes_that_are_listed_are_those_that_are_drawn():
    """More of them than a list has room for at first, each once, each where the picture has one."""
    field, ground, view = RainField(RainSpectrum(80.0), seed=1), flat_surfaces(4, 4, 0.05), camera()
    alpha = np.full((view.height, view.width), np.nan, np.float32)
    depth = np.full_like(alpha, 50)
    where = (field, ground, view, 1.0, 1 / 60, np.zeros(ground.shape, np.float32), WET_FILM, depth)
    draw_splashes(*where, alpha)
    position, ids = seen_splashes(*where)
    assert len(ids) == len(np.unique(ids)) > 512
    fell = np.isin(ids, impacts(field, ground, 1.0 - 0.12, 1.0 + 1 / 60).id)
    assert fell.all()
    x, y, z = view.camera_from_world[:3, :3] @ position.T + view.camera_from_world[:3, 3:]
    column, row = (view.fx * x / z + view.cx).astype(int), (view.fy * y / z + view.cy).astype(int)
    inside = (column > 0) & (row > 0) & (column < 159) & (row < 159)
    near = np.max([alpha[(row + j)[inside], (column + i)[inside]] for j, i in NEIGHBOURS], axis=0)
    assert inside.sum() > 200 and (near > 0).mean() > 0.9
    depth[:, :80] = np.inf  # nothing was captured there
    assert np.isin(ids[inside & (column >= 80)], seen_splashes(*where)[1]).all()
    assert not np.isin(ids[inside & (column < 80)], seen_splashes(*where)[1]).any()
