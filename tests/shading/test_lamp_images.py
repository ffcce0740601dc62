"""The images of lamps in wet ground: against the sum over facets, and what hides a lamp."""

import numpy as np
import pytest
from numpy import float32 as F4

from rainsim.scene.view import view_of
from rainsim.shading.fresnel import SCHLICK
from rainsim.shading.ground_slopes import GroundSlopes
from rainsim.shading.lamp_images import LampView, add_lamps, scaled, without_lamps
from rainsim.shading.lamp_search import BRIGHT, lamps_in
from rainsim.shading.wet_ground_mirror import level_camera
from scenes import looking

HEIGHT, SLOPE = 1.5, 0.2  # m over the ground, rms slope of the film
PIXELS = 24, 18


FALL = 0.35  # rad, of the view that goes along x
CAMERA = looking((0, 0, HEIGHT), (np.cos(FALL), 0, HEIGHT - np.sin(FALL)), *PIXELS, 20.0)
GROUND = GroundSlopes(
    np.broadcast_to(np.array([0, 0, 0, SLOPE], np.float32), (8, 8, 4)).copy(),
    np.array([-20, -20], np.float32), F4(5.0),
)  # fmt: skip


def level_depth(surface=np.inf):
    level = level_camera(CAMERA)
    lens = np.array([level.fx, level.fy, level.cx, level.cy], np.float32)
    depth = np.full((level.height, level.width), surface, np.float32)
    return depth, lens, level.forward[:2].astype(np.float32)


def field_of(lamp, depth=None, ground=GROUND):
    """The light of one lamp in every pixel's block, of shape (rows, columns, 3)."""
    seen, lens, forward = level_depth()
    depth = seen if depth is None else depth
    wanted = np.ones(PIXELS[::-1], bool)
    found = np.zeros((*PIXELS[::-1], 3), np.float32)
    shown = LampView(np.array([lamp], np.float32), depth, lens, forward)
    add_lamps(view_of(CAMERA), 1, wanted, ground, shown, found)
    return found


def brute_force(place, radiance, radius, row, column):
    """Radiance to a pixel by the sum over facets that mirror a ball lamp of a radius, float64."""
    local = np.array([(column + 0.5 - CAMERA.cx) / CAMERA.fx,
                      (row + 0.5 - CAMERA.cy) / CAMERA.fy, 1.0])  # fmt: skip
    ray = local @ CAMERA.camera_from_world[:3, :3]
    ray /= np.linalg.norm(ray)
    spot = np.array([0, 0, HEIGHT]) - ray * HEIGHT / ray[2]
    step = 0.0025
    sx, sy = np.meshgrid(*[np.arange(-1.2, 1.2, step) + step / 2] * 2)
    density = np.exp(-(sx**2 + sy**2) / (2 * SLOPE**2)) / (2 * np.pi * SLOPE**2)
    normal = np.stack([-sx, -sy, np.ones_like(sx)], -1)
    long = np.linalg.norm(normal, axis=-1)
    cosine = np.maximum(-(normal @ ray) / long, 0)
    out = ray + 2 * (cosine / long)[..., None] * normal
    to = place - spot
    toward = out @ to
    met = (toward > 0) & (np.sum((toward[..., None] * out - to) ** 2, -1) < radius**2)
    rise = out[..., 2] / np.hypot(out[..., 0], out[..., 1])
    leave = 1 + smith(-ray[2] / np.hypot(*ray[:2]) / SLOPE)
    arrive = np.where(rise > 0, smith(np.maximum(rise, 1e-3) / SLOPE), np.inf)
    t = np.sqrt(1 - (1 - cosine**2) / 1.333**2)
    a, b = (cosine - 1.333 * t) / (cosine + 1.333 * t), (1.333 * cosine - t) / (1.333 * cosine + t)
    weight = density * cosine * long * (a * a + b * b) / 2 / (leave + arrive) / -ray[2]
    return radiance * np.sum(weight[met]) * step**2


def smith(a):
    from scipy.special import erfc

    return np.exp(-a * a / 2) / (a * np.sqrt(2 * np.pi)) - erfc(a / np.sqrt(2)) / 2


@pytest.mark.parametrize("place", [(9.0, 0.6, 0.7), (14.0, -2.0, 5.0)])
def test_the_image_is_the_sum_over_the_facets_that_mirror_the_lamp(place):
    radius = 0.12
    flux = 10.0 * np.pi * radius**2
    lamp = (*place, flux, 0.5 * flux, 0.0, radius**2 / 4, radius**2 / 4)
    found = field_of(lamp)
    for row, column in ((9, 12), (12, 10), (8, 13), (14, 12)):
        wanted = brute_force(np.array(place), 10.0, radius, row, column)
        assert wanted > 1e-5
        assert found[row, column, 0] == pytest.approx(wanted, rel=0.1)
        assert found[row, column, 1] == pytest.approx(0.5 * wanted, rel=0.1)
    assert found[..., 2].max() == 0 and np.isfinite(found).all()


def test_lamps_are_mirrored_by_the_law_that_is_named():
    lamp = (9.0, 0.6, 0.7, 1.0, 1.0, 1.0, 0.01, 0.01)
    share = field_of(lamp, ground=GROUND._replace(law=SCHLICK))[9, 12] / field_of(lamp)[9, 12]
    assert (np.abs(share - 1) > 0.02).all() and (np.abs(share - 1) < 0.25).all()


def test_what_stands_between_hides_a_lamp():
    lamp = (12.0, 0.0, 0.7, 1.0, 1.0, 1.0, 0.01, 0.01)
    free = field_of(lamp)
    assert free[8:, 12].max() > 1e-3
    depth, *_ = level_depth(surface=8.0)  # a wall from 8 m on, before the lamp
    before, beyond = field_of(lamp, depth), field_of(lamp, np.full_like(depth, 30.0))
    assert before[8:, 12].max() < 0.02 * free[8:, 12].max()
    np.testing.assert_array_equal(beyond, free)  # what stands behind it hides nothing


def test_lamps_are_found_with_their_place_and_flux():
    level = scaled(level_camera(CAMERA), 200.0)
    depth = np.full((level.height, level.width), np.inf, np.float32)
    picture = np.full((*depth.shape, 3), 0.5, np.float32)
    place = np.array([10.0, 0.8, 2.0])
    rows, columns = np.indices(depth.shape) + 0.5
    across = -place[1] / place[0] * level.fx + level.cx
    up = (place[2] + HEIGHT) / place[0] * level.fy + level.cy
    ball = np.hypot(columns - across, rows - up) < 4.0
    picture[ball], depth[ball] = (12.0, 6.0, 3.0), place[0]
    lamps, share = lamps_in(picture, depth, level)
    area = ball.sum() * (place[0] / level.fx) ** 2 / np.sqrt(1 + 0.08**2 + 0.35**2)
    total = lamps[:, 3:6].sum(axis=0)
    kept = 1 - BRIGHT / 12.0
    np.testing.assert_allclose(total, np.array([12.0, 6.0, 3.0]) * kept * area, rtol=0.02)
    middle = (lamps[:, :3] * lamps[:, 3:4]).sum(axis=0) / total[0]
    np.testing.assert_allclose(middle, place, atol=0.06)
    assert 0 < share < 0.3 and without_lamps(picture).max() == pytest.approx(BRIGHT)
    hue = without_lamps(picture)[ball][0]
    np.testing.assert_allclose(hue / hue[0], (1.0, 0.5, 0.25), rtol=1e-6)


def test_what_is_no_brighter_than_white_is_no_lamp():
    level = level_camera(CAMERA)
    picture = np.full((level.height, level.width, 3), 1.2, np.float32)
    lamps, share = lamps_in(picture, np.full(picture.shape[:2], 9.0, np.float32), level)
    assert lamps.shape == (0, 8) and share == 0
    np.testing.assert_array_equal(without_lamps(picture), picture)
