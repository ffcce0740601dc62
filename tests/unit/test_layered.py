"""Mirrored pictures of two layers: a post before a far wall of stripes, known in closed form."""

import math

import numpy as np
import pytest

from rainsim import layered, mirrorlight, optics, reflect, waterview
from rainsim.config import RenderConfig
from rainsim.pyramid import coarsened
from rainsim.raster import Layers

ROWS, COLUMNS, FOCAL = 192, 256, 200.0
TURN = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)  # level, along y
EYE = np.array([0, 0, 1], np.float32)
LENS = np.array([FOCAL, FOCAL, COLUMNS / 2, 60], np.float32)
POST, WALL = 4.0, 40.0  # m, depth of a post 20 cm wide and of a wall
HALF_POST = 0.1


def wall_at(x):
    return 0.5 + 0.4 * np.sin(x / 3)


def layers(shape, color, alpha, depth):
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 2] = -1
    full = [np.ascontiguousarray(np.broadcast_to(a, shape), np.float32) for a in (alpha, depth)]
    rgb = np.ascontiguousarray(np.broadcast_to(color, (*shape, 3)), np.float32)
    return Layers(rgb, full[0], full[1], full[1], normal)


def mirrored():
    """What the mirrored camera sees: one picture with its depth, and two layers."""
    shape = ROWS, COLUMNS
    fine = (np.arange(4 * COLUMNS) / 4 + 0.125 - LENS[2]) / FOCAL
    cover = (abs(fine) * POST < HALF_POST).reshape(-1, 4).mean(axis=1)
    far = np.broadcast_to(wall_at(WALL * fine).reshape(-1, 4).mean(axis=1), shape)
    far = np.ascontiguousarray(np.repeat(far[..., None], 3, 2), np.float32)
    single = ((1 - cover[:, None]) * far).astype(np.float32)
    depth = np.ascontiguousarray(
        np.broadcast_to(cover * POST + (1 - cover) * WALL, shape), np.float32
    )
    near = layers(shape, 0, cover, np.where(cover > 0, POST, np.inf))
    view = waterview.View(
        far, np.full(shape, WALL, np.float32), None, TURN, EYE, LENS, far
    )  # fmt: skip

    def grade(color, alpha, distance, plane, normal, direction):
        np.testing.assert_allclose(normal, np.broadcast_to([0, -1, 0], normal.shape), atol=1e-6)
        np.testing.assert_allclose(distance * direction[:, 1], POST, rtol=1e-5)
        return color

    open_sky = np.float32(1)  # shares are mixed in linear light
    there = layers(shape, far, 0.0, WALL)
    two = layered.layered(near, there, view, np.float32(1), open_sky, grade)
    return (single, coarsened(single), depth), two


def water(slope, n=120):
    """Records along a row, 1.8 m away, whose slope along x is given."""
    record = np.zeros((n, optics.RECORD), np.float32)
    ray = np.stack([np.linspace(-0.12, 0.12, n), np.ones(n), np.full(n, -1 / 1.8)], axis=1)
    record[:, :3] = EYE + 1.8 * ray
    record[:, 3:6] = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    record[:, 6] = 1.8
    record[:, 10] = slope
    return record


def truth(record):
    """What each bent ray meets: the post's plane, then the wall."""
    n = np.stack([-record[:, 10], -record[:, 11], np.ones(len(record))], axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    v = record[:, 3:6].astype(float)
    r = v - 2 * (v * n).sum(axis=1, keepdims=True) * n
    x = {d: record[:, 0] + (d - record[:, 1]) / r[:, 1] * r[:, 0] for d in (POST, WALL)}
    return np.where(abs(x[POST]) < HALF_POST, 0.0, wall_at(x[WALL])), abs(x[POST]) - HALF_POST


def look(kernel, pictures, record):
    light = np.full((len(record), 3), np.nan, np.float32)
    source = np.full(len(record), 99, np.uint8)
    kernel(
        np.arange(len(record)), record, TURN, EYE, LENS, np.float32(0), *pictures, 8,
        np.float32(0.1), light, source,
    )  # fmt: skip
    assert np.isfinite(light).all() and (source == reflect.MIRROR).all()
    return light[:, 1]


@pytest.mark.parametrize("slope", [0.06, -0.04, 0.02])
def test_bent_rays_find_the_post_and_what_it_hides(slope):
    one, two = mirrored()
    record = water(slope)
    wanted, from_edge = truth(record)
    inside = abs(from_edge) > 0.04  # of a pixel, some
    found = look(layered.layered_light, two, record)
    np.testing.assert_allclose(found[inside], wanted[inside], atol=0.03)
    assert {0.0} < set(np.round(wanted, 1))  # some rays meet the post, some do not
    single = look(mirrorlight.mirror_light, one, record)
    error = [np.sqrt(np.mean((a - wanted)[inside] ** 2)) for a in (found, single)]
    assert error[0] < 0.25 * error[1]


def test_level_water_mirrors_the_picture_itself():
    one, two = mirrored()
    record = water(0.0)
    found, single = (
        look(layered.layered_light, two, record), look(mirrorlight.mirror_light, one, record)
    )  # fmt: skip
    np.testing.assert_allclose(found, single, atol=0.01)  # between pixels a product is no sum
    assert np.median(abs(found - single)) < 1e-6


def test_depths_are_spread_to_where_nothing_is_near():
    alpha, depth = np.zeros((40, 64), np.float32), np.full((40, 64), np.inf, np.float32)
    alpha[8:12, 4:8], depth[8:12, 4:8] = 0.5, 3.0
    alpha[8:12, 40:44], depth[8:12, 40:44] = 1.0, 7.0
    alpha[8, 5], depth[8, 5] = 1.0, 4.5
    found = layered.spread_depth(alpha, depth)
    assert found.shape == (10, 16)
    assert found[2, 1] == pytest.approx((15 * 0.5 * 3 + 4.5) / 8.5)
    assert found[2, 10] == 7
    assert found[3, 0] == found[2, 1] and found[3, 11] == 7  # beside them
    assert 3 < found[9, 6] < 7 and np.isfinite(found).all()
    assert (layered.spread_depth(0 * alpha, depth) > 1e3).all()


def choose(one, two, name="auto"):
    view = waterview.WaterView.__new__(waterview.WaterView)
    view.config = RenderConfig(reflections=name)
    view.view = waterview.View(None, np.empty((ROWS, COLUMNS)), None, TURN, EYE, LENS, None)
    view.record = water(0.03)
    view.pixel = np.arange(len(view.record), dtype=np.int32)
    view.light, view.source = np.empty((len(view.record), 3), np.float32), np.empty(120, np.uint8)
    view._groups, view._mirrors, view.layered, view._worth = {}, {}, None, None
    view.mirror_share, view.mirror_steps, view.mirror_thickness = 1.0, 8, 0.1
    drawn = []

    def draw_mirrored(level, window, share, split=None):
        drawn.append(split)
        return LENS, one if split is None else two

    for _ in range(2):
        view.light_up(name, draw_mirrored, None, None, SimpleTimer())
    return view, drawn


class SimpleTimer:
    def mark(self, name):
        pass


def test_auto_takes_two_layers_where_they_show():
    one, two = mirrored()
    view, drawn = choose(one, two)
    assert view._worth and drawn == [None, pytest.approx(5.0, abs=0.01)]  # each was drawn once
    assert "two layers" in view.choice()
    found = look(layered.layered_light, two, view.record)
    np.testing.assert_allclose(view.light[:, 1], found, rtol=1e-6)
    alike = [np.full_like(a, 0.5) if a.ndim == 3 and a.shape[2] == 3 else a for a in (*one, *two)]
    alike[6] = np.zeros_like(two[3])
    alike[6][..., 3] = np.where(two[3][..., 3] < 1, 1 - 1e-6, 1)  # a post of glass
    view, drawn = choose(tuple(alike[:3]), (*alike[3:6], alike[6], coarsened(alike[6]), two[5]))
    assert not view._worth and "two layers" not in view.choice()
    full = two[3].copy()
    full[..., 3] = np.minimum(full[..., 3], 0.999)
    view, drawn = choose(one, (*two[:3], full, coarsened(full), two[5]))
    assert not view._worth  # what is near covers all of it
    view, drawn = choose(one, two, "mirror")
    assert drawn == [None] and math.isfinite(view.light.sum())
