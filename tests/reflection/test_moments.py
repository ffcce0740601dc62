"""Slopes of ripples over pixels, and pictures looked up blurred, against brute force."""

import math

import numba
import numpy as np
import pytest
from scipy import ndimage

from rainsim.numerics.interpolation import bilinear_color
from rainsim.numerics.mipmap import COARSEST, blurred_color, coarsened, top_of
from rainsim.reflection import mirror_pass, water_record
from rainsim.reflection.planar_mirror import MirrorPicture
from rainsim.reflection.slope_moments import (
    heights_of,
    pixel_slopes,
    place_of,
    ripple_moments,
    root_of,
    tile_height,
)
from rainsim.reflection.water_shading import Ripples, layered_slopes, risen
from rainsim.scene.view import View

N, SIZE = 64, np.float32(0.5)
CELL = float(SIZE) / N


@pytest.fixture(scope="module")
def slopes():
    """Waves of 4 cells and longer on a periodic tile, slopes of some 0.05."""
    rng = np.random.default_rng(7)
    white = rng.normal(size=(N, N))
    eta = ndimage.gaussian_filter(white, 1.3, mode="wrap")
    dy, dx = (np.roll(eta, -1, k) - np.roll(eta, 1, k) for k in (0, 1))
    both = np.stack([dx, dy])
    return (0.05 * both / both.std()).astype(np.float32)


def test_every_level_holds_the_means_of_blocks(slopes):
    moments = ripple_moments(slopes)
    x, y = slopes.astype(float)
    for level in range(int(math.log2(N)) + 1):
        top, left = place_of(N, level)
        k, cells = 1 << level, N >> level
        found = moments[top : top + cells, left : left + cells]
        for c, field in enumerate((x, y, x * x, y * y, x * y)):
            mean = field.reshape(cells, k, cells, k).mean(axis=(1, 3))
            np.testing.assert_allclose(found[..., c], mean, atol=3e-8)


def rings(cells=N):
    """Height of a periodic surface over the tile's size, and its exact slopes."""
    y, x = np.mgrid[:cells, :cells] / cells
    turn = 2 * np.pi
    height = 3e-3 * np.cos(turn * 3 * x) + 2e-3 * np.sin(turn * (2 * x - 4 * y))
    wave = 2e-3 * turn * np.cos(turn * (2 * x - 4 * y))
    slopes = np.stack([-3e-3 * turn * 3 * np.sin(turn * 3 * x) + 2 * wave, -4 * wave])
    return height, slopes.astype(np.float32)


def test_heights_are_those_whose_slopes_were_given():
    height, slopes = rings()
    np.testing.assert_allclose(heights_of(slopes), height, atol=1e-6)
    moments = ripple_moments(slopes)
    np.testing.assert_allclose(moments[:N, :N, 5], height, atol=1e-6)
    place = np.float32(0.3) * SIZE, np.float32(0.7) * SIZE
    found = tile_height(moments, SIZE, *place, np.float32(1e-4))
    wanted = 3e-3 * np.cos(2 * np.pi * 0.9) + 2e-3 * np.sin(2 * np.pi * (0.6 - 2.8))
    half = 0.5 / N * float(np.abs(slopes).max())  # cells are read at their middles
    assert found / SIZE == pytest.approx(wanted, abs=half + 1e-4)
    assert abs(tile_height(moments, SIZE, *place, SIZE)) < 2e-4 * SIZE  # a wide pixel sees no wave


@pytest.mark.parametrize("dip", [60, 15])
def test_a_ray_meets_the_ripples_and_not_the_level_of_the_water(dip):
    _, slopes = rings()
    slopes *= np.float32(0.7)
    ripples = Ripples(ripple_moments(slopes), SIZE)
    view = np.float32([math.cos(math.radians(dip)), 0, -math.sin(math.radians(dip))])
    blank = [np.float32(0)] * len(water_record.WaterPixel._fields)
    off, before = [], []
    for x, y in np.random.default_rng(0).uniform(-1, 1, (200, 2)).astype(np.float32):
        pixel = water_record.WaterPixel(*blank)._replace(
            x=x, y=y, view_x=view[0], view_z=view[2], width=np.float32(1e-4),
            ripple_share=np.float32(1),
        )  # fmt: skip
        a, b = risen(pixel, ripples)
        assert b == y
        ray = (a - x) / view[0] * view[2]  # its height over the level of the water
        off.append(ray - surface_height(ripples, a, b))
        before.append(surface_height(ripples, x, y))
    assert np.std(off) < 0.35 * np.std(before) and np.std(before) > 1e-3 * SIZE


def surface_height(ripples, x, y):
    """Height of both layers of the tile."""
    c, s = math.cos(1), math.sin(1)
    places = (x, y), (c * x + s * y, c * y - s * x)
    width = np.float32(1e-4)
    return sum(tile_height(ripples.moments, SIZE, *np.float32(p), width) for p in places)


def layered(slopes, x, y, view, width):
    """What `layered_slopes` gives at places (x, y), an array (n, 5)."""
    ripples = Ripples(ripple_moments(slopes), SIZE)
    blank = [np.float32(0)] * len(water_record.WaterPixel._fields)
    pixel = water_record.WaterPixel(*blank)._replace(
        **dict(zip(("view_x", "view_y", "view_z"), map(np.float32, view), strict=True)),
        width=np.float32(width),
    )
    places = (pixel._replace(x=np.float32(a), y=np.float32(b)) for a, b in zip(x, y, strict=True))
    return np.array([layered_slopes(place, ripples, place.x, place.y) for place in places])


def test_two_layers_of_the_tile_do_not_repeat(slopes):
    """Each point has the sum of both slopes, the second's turned back by a radian."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-2, 2, (2, 400))
    here = layered(slopes, x, y, (0.6, 0.0, -0.8), 0.01 * CELL)
    turn = np.array([[math.cos(1), -math.sin(1)], [math.sin(1), math.cos(1)]])
    wanted = np.zeros((2, 400))
    for matrix in (np.eye(2), turn):
        u, v = matrix.T @ np.stack([x, y]) / CELL - 0.5
        pair = [ndimage.map_coordinates(s, [v, u], order=1, mode="grid-wrap") for s in slopes]
        wanted += matrix @ np.stack(pair)
    np.testing.assert_allclose(here[:, :2].T, wanted, atol=2e-4)
    assert here[:, :2].var() == pytest.approx(2 * slopes.var(), rel=0.25)
    for step in ((float(SIZE), 0.0), (0.0, float(SIZE)), (2 * float(SIZE), float(SIZE))):
        there = layered(slopes, x + step[0], y + step[1], (0.6, 0.0, -0.8), 0.01 * CELL)
        shared = np.corrcoef(here[:, :2].ravel(), there[:, :2].ravel())[0, 1]
        assert 0.3 < shared < 0.7  # the first layer's half


def test_two_layers_turn_their_covariance(slopes):
    """From far away a pixel sees the covariance of a tile plus that of the tile turned."""
    moments = ripple_moments(slopes)
    level = int(math.log2(N))
    a, b, aa, bb, ab = moments[place_of(N, level)][:5].astype(float)
    tile = np.array([[aa - a * a, ab - a * b], [ab - a * b, bb - b * b]])
    turn = np.array([[math.cos(1), -math.sin(1)], [math.sin(1), math.cos(1)]])
    both = tile + turn @ tile @ turn.T
    found = layered(slopes, [0.1], [0.2], (0.0, 0.0, -1.0), 4 * float(SIZE))[0]
    np.testing.assert_allclose(
        found[2:], [both[0, 0], both[1, 1], both[0, 1]], rtol=0.02, atol=2e-5
    )


def footprint(slopes, x, y, view, width):
    """Slopes (2, k) at points spread over what a pixel shows."""
    ahead = np.array(view[:2]) / np.hypot(*view[:2])
    a, b = np.meshgrid(*2 * [(np.arange(16) + 0.5) / 16 - 0.5])
    u = x + width * (a * ahead[0] / -view[2] - b * ahead[1])
    v = y + width * (a * ahead[1] / -view[2] + b * ahead[0])
    at = np.stack([v.ravel(), u.ravel()]) / CELL - 0.5
    return np.stack([ndimage.map_coordinates(s, at, order=3, mode="grid-wrap") for s in slopes])


@pytest.mark.parametrize("dip", [80, 30, 12])
@pytest.mark.parametrize("cells", [0.4, 2.0, 5.0])
def test_a_pixel_takes_mean_and_covariance_over_its_footprint(slopes, dip, cells):
    moments = ripple_moments(slopes)
    rng = np.random.default_rng(1)
    away, width = math.radians(40), cells * CELL
    dip = math.radians(dip)
    view = math.cos(dip) * math.cos(away), math.cos(dip) * math.sin(away), -math.sin(dip)
    found, wanted = [], []
    for x, y in rng.uniform(-1, 1, (60, 2)):
        arguments = (np.float32(v) for v in (x, y, *view, width))
        found.append(pixel_slopes(moments, SIZE, *arguments))
        here = footprint(slopes.astype(float), x, y, view, width)
        (aa, ab), (_, bb) = np.cov(here, bias=True)
        wanted.append((*here.mean(axis=1), aa, bb, ab))
    found, wanted = np.array(found), np.array(wanted)
    error, held = (found - wanted)[:, :2].std(), wanted[:, :2].std()
    assert error < 0.35 * held + 0.004  # a share of the energy: cells are not the footprint
    spread = wanted[:, 2:4].mean()
    assert found[:, 2:4].mean() == pytest.approx(spread, rel=0.5, abs=1e-5)
    # Nothing of the slopes is lost: what the mean does not hold, the covariance does.
    if cells > 1:
        total = np.mean(found[:, :2] ** 2 + found[:, 2:4])
        assert total == pytest.approx(np.mean(wanted[:, :2] ** 2 + wanted[:, 2:4]), rel=0.15)
        assert np.corrcoef(found[:, 2] - found[:, 3], wanted[:, 2] - wanted[:, 3])[0, 1] > 0.5


def test_flat_water_stays_flat():
    moments = ripple_moments(np.zeros((2, N, N)))
    assert pixel_slopes(moments, SIZE, *np.float32([0.1, 0.2, 0.6, 0, -0.8, 0.01])) == (0,) * 5


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="looks at machine code")
@pytest.mark.parametrize(("floor", "is_double"), [(np.floor, False), (math.floor, True)])
def test_slopes_are_found_in_single_precision(floor, is_double):
    """`math.floor` shows that the test sees what it looks for."""

    def slopes(moments, x):
        a = x - floor(x)
        return a * pixel_slopes(moments, np.float32(0.5), a, a, a, a, -a, a)[0]

    types = numba.float32[:, :, ::1], numba.float32
    kernel = numba.njit(types, error_model="numpy", no_cpython_wrapper=True)(slopes)
    (code,) = kernel.inspect_llvm().values()
    assert ("fpext float" in code) == is_double


def test_root_of_a_covariance():
    a, b, c = root_of(*np.float32([4e-3, 3e-3, -2e-3]))
    np.testing.assert_allclose([a * a, b * b + c * c, a * b], [4e-3, 3e-3, -2e-3], rtol=1e-5)


def test_coarse_pictures_hold_means():
    rng = np.random.default_rng(3)
    picture = rng.uniform(0, 1, (77, 130, 3)).astype(np.float32)
    coarse = coarsened(picture)
    for level in range(1, COARSEST + 1):
        k, rows, columns = 1 << level, 77 >> level, 130 >> level
        blocks = picture[: rows * k, : columns * k].reshape(rows, k, columns, k, 3)
        found = coarse[top_of(77, level) :][:rows, :columns]
        np.testing.assert_allclose(found, blocks.mean(axis=(1, 3), dtype=float), atol=1e-6)


@pytest.mark.parametrize("blur", [0.0, 1.0, 2.3, 4.0, 9.0])
def test_blurred_colours_are_those_of_a_blurred_picture(blur):
    rng = np.random.default_rng(5)
    picture = rng.uniform(0, 1, (160, 192, 3)).astype(np.float32)
    coarse = coarsened(picture)
    soft = ndimage.gaussian_filter(picture, (blur, blur, 0), mode="nearest")
    points = rng.uniform(40, 110, (300, 2)).astype(np.float32)
    found = np.array([blurred_color(picture, coarse, *p, np.float32(blur)) for p in points])
    wanted = np.array([bilinear_color(soft, *p) for p in points])
    if blur == 0:
        np.testing.assert_array_equal(found, wanted)
        return
    sharp = np.array([bilinear_color(picture, *p) for p in points])
    assert np.mean((found - wanted) ** 2) < 0.4 * np.mean((sharp - wanted) ** 2)
    assert 0.4 < found.std() / wanted.std() < 2.2


def test_rough_water_takes_the_contrast_of_stripes_as_a_normal_spread_does():
    """A mirror of stripes far away: what is left is exp(-2 (pi deviation / width)^2)."""
    focal, columns, rows = 400.0, 512, 256
    eye = np.array([0, 0, 1], np.float32)
    # Level, along y, and mirrored at the height 0.
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0]], np.float32)
    view = View(turn, -eye, *np.float32([focal, focal, 256, 128]))
    # Rays 20 degrees down: a slope along x moves what they mirror sideways by 2 sin(20) of it.
    dip, deviation = math.radians(20), 0.05
    n = 200
    aside = np.linspace(-0.2, 0.2, n)
    ray = np.stack([aside, np.ones(n), np.full(n, -math.tan(dip))], 1)
    record = np.zeros((n, water_record.RECORD), np.float32)
    t = 1 / math.tan(dip)
    record[:, water_record.POINT] = eye + t * ray
    unit = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    record[:, water_record.VIEW_X : water_record.VIEW_Z + 1] = unit
    record[:, water_record.VIEW_DEPTH] = t
    record[:, water_record.VARIANCE_X] = deviation**2
    depth = np.full((rows, columns), 1e4, np.float32)
    pixels = focal * 2 * deviation * math.tan(dip)
    light, source = np.full((n, 3), np.nan, np.float32), np.zeros(n, np.uint8)
    for width in (3.0 * pixels, 6.0 * pixels):
        stripes = 0.5 + 0.5 * np.cos(2 * np.pi * (np.arange(columns) + 0.5) / width)
        picture = np.empty((rows, columns, 3), np.float32)
        picture[...] = stripes[:, None]
        mirror = MirrorPicture(picture, coarsened(picture), depth)
        mirror_pass.mirror_light(np.arange(n), record, view, mirror, light, source)
        left = math.exp(-2 * (math.pi * pixels / width) ** 2)
        contrast = np.ptp(light[:, 0])
        assert contrast == pytest.approx(left, abs=0.12)
        assert contrast > 0.05
