"""The paper's rain: one exponential of radii, opaque lines of spheres, one Gaussian a splash."""

import numpy as np
import pytest
from scipy import stats

from rainsim.config.settings import Config, mm_per_hour
from rainsim.drops import RainField, Weather, flat_surfaces, impacts
from rainsim.errors import ParameterError
from rainsim.particles import paper
from rainsim.rain.size_distribution import PAPER_RADIUS, SMALLEST, RainSpectrum, drop_volume
from rainsim.scene.types import Camera
from scenes import looking


def view(size=400, height=1.5):
    """A level camera that looks along x."""
    return looking((0, 0, height), (1, 0, height), size, size, size)


def blank(camera):
    return np.full((camera.height, camera.width), np.nan, np.float32), np.full(
        (camera.height, camera.width), np.inf, np.float32
    )


GROUND = flat_surfaces(16, 16, 0.1, (-1.0, -8.0))


@pytest.mark.parametrize("rate", [2.0, 50.0])
def test_radii_are_one_exponential_at_every_rate_and_the_gauge_reads_it(rate):
    spectrum = RainSpectrum(rate, "paper")
    assert spectrum.speed.min() == spectrum.speed.max()
    duration = 2e4 / (spectrum.density @ spectrum.speed) / 16
    found = impacts(RainField(spectrum, seed=3), flat_surfaces(4, 4, 0.1), 0.0, duration)
    span = np.exp(-np.array([SMALLEST, 6e-3]) / (2 * PAPER_RADIUS))
    chance = (span[0] - np.exp(-found.diameter / (2 * PAPER_RADIUS))) / (span[0] - span[1])
    assert stats.kstest(chance, "uniform").pvalue > 0.01
    read = found.volume.sum() / 16 / duration + spectrum.fine_rate
    error = np.sqrt((found.volume**2).sum()) / found.volume.sum()
    assert read == pytest.approx(mm_per_hour(rate), rel=3 * error) and error < 0.02


def test_a_configuration_asks_for_it_by_name():
    config = Config.from_toml(
        'drop_radii = "paper"\nstreaks = "paper"\nsplashes = "paper"\n'
    ).check()
    assert Weather(config).field(0.0, 0.1).spectrum.radii == "paper"
    for name in ("drop_radii", "streaks", "splashes"):
        with pytest.raises(ParameterError, match=name):
            Config().replace(**{name: "papers"}).check()


def test_lines_are_opaque_and_twelve_millimetres_wide_whatever_the_rate():
    camera = view()
    for rate in (2.0, 50.0):
        field = RainField(RainSpectrum(rate, "paper"), seed=2)
        alpha, depth = blank(camera)
        paper.draw_lines(field, GROUND, camera, 3.0, 6.0, depth, alpha)
        assert alpha.max() > 0.99  # a drop of any size hides what is behind it
        assert 0 < (alpha > 0.5).mean() < 0.5
    far = np.full_like(depth, 0.2)
    paper.draw_lines(field, GROUND, camera, 3.0, 6.0, far, alpha)
    assert alpha.max() == 0


def test_a_line_is_as_long_as_it_should_be():
    """In thin rain each separate blob is 12 mm wide and 162 mm long, or cut by the frame."""
    from scipy import ndimage

    camera = view(800)
    field = RainField(RainSpectrum(3.0, "paper"), seed=2)
    alpha, depth = blank(camera)
    paper.draw_lines(field, GROUND, camera, 3.0, 5.0, depth, alpha)
    blobs, count = ndimage.label(alpha > 0.5)
    ratios = []
    for rows, columns in ndimage.find_objects(blobs):
        if rows.start > 0 and rows.stop < 800:
            ratios.append((rows.stop - rows.start) / (columns.stop - columns.start))
    expected = (paper.LINE_LENGTH + paper.SPHERE_RADIUS) / (2 * paper.SPHERE_RADIUS)
    assert count >= len(ratios) >= 3
    assert np.median(ratios) == pytest.approx(expected, rel=0.3)


def test_nothing_falls_under_cover():
    camera = view()
    field = RainField(RainSpectrum(50, "paper"), seed=2)
    alpha, depth = blank(camera)
    roof = flat_surfaces(16, 16, 0.1, (-8.0, -8.0), height=5.0)
    paper.draw_lines(field, roof, camera, 3.0, 6.0, depth, alpha)
    assert alpha.max() == 0


def test_the_covariance_of_a_splash_has_the_squared_volume_for_its_determinant():
    longest, other = paper.gaussian_axes(2e-3)
    assert (longest * other * other) ** 2 == pytest.approx(drop_volume(2e-3) ** 2)
    assert longest > other


def test_splashes_are_there_for_the_frame_of_their_drop_and_lie_along_the_wind():
    camera = view(800)
    down = np.eye(4)
    down[:3, :3] = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    down[2, 3] = 0.5
    close = Camera(800, 800, 800, 800, 400, 400, down)
    field = RainField(RainSpectrum(100, "paper"), (4.0, 0.0), seed=2)
    alpha, depth = blank(close)
    paper.draw_gaussians(field, GROUND, close, 1.0, 1.01, depth, alpha)
    found = impacts(field, GROUND, 1.0, 1.01)
    inside = (np.abs(found.position[:, :2]) < 0.24).all(axis=1)
    longest, other = paper.gaussian_axes(found.diameter[inside])
    whole = (2 * np.pi * longest * other * (800 / 0.5) ** 2).sum()
    shown = alpha.sum(dtype=np.float64)
    assert inside.sum() > 10
    assert shown == pytest.approx(whole, rel=0.2)  # some lie across the edge
    paper.draw_gaussians(field, GROUND, camera, 1.0, 1.0, *blank(camera)[::-1])
    along = np.abs(np.diff(alpha, axis=1)).sum()
    across = np.abs(np.diff(alpha, axis=0)).sum()
    assert across > 1.1 * along  # edges along the wind are longer


def test_lines_are_grey_two_hundred_and_darker_on_a_dark_picture():
    bright = paper.line_radiance(np.full((4, 4, 3), 0.5, np.float32))
    dark = paper.line_radiance(np.full((4, 4, 3), 0.02, np.float32))
    assert bright == pytest.approx(np.full(3, paper.GREY**2.2)) and dark.max() < 0.3 * bright.min()
