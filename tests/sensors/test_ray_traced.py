"""Rays through splats: closed forms, brute force, the picture's own rules."""

import numpy as np
import pytest

import factories
from rainsim.raster import prepare, rasterize
from rainsim.scene.types import Camera
from rainsim.sensors.ray_traced import Tracer


def splats(position, scale, opacity, color, rotation=(1, 0, 0, 0)):
    return factories.splats(position, rotation, scale, opacity, color=color)


def cloud(rng, n=3000, size=0.02, bands=4):
    rotation = rng.normal(size=(n, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    position = rng.uniform(-1, 1, (n, 3)) + np.array([0, 0, 4])
    scale, opacity = size * rng.uniform(0.3, 1, (n, 3)), rng.uniform(0.2, 0.9, n)
    sh = rng.normal(0, 0.4, (n, bands * bands, 3))
    return factories.splats(position, rotation, scale, opacity, sh)


def test_one_splat_is_its_gaussian():
    """A ball of 0.1 at distance 3: alpha = opacity exp(-d^2 / (2 s^2)) at a ray d beside it."""
    tracer = Tracer(splats([[0, 0, 3.0]], [[0.1] * 3], [0.8], [[0.9, 0.4, 0.2]]))
    beside = np.array([0.0, 0.05, 0.1, 0.2, 0.24])
    origin = np.stack([beside, 0 * beside, 0 * beside], axis=1)
    direction = np.tile([0.0, 0, 1], (5, 1))
    found = tracer.trace(origin, direction, before=0.5)
    expected = 0.8 * np.exp(-0.5 * (beside / 0.1) ** 2)
    np.testing.assert_allclose(found.alpha, expected, rtol=1e-5)
    np.testing.assert_allclose(found.color, expected[:, None] * (0.9, 0.4, 0.2), rtol=1e-4)
    np.testing.assert_allclose(found.distance[:4], 3.5, rtol=1e-5)
    np.testing.assert_array_equal(tracer.trace(origin, -direction).alpha, 0)
    # Farther away it ends at 1/255, and a pixel's low-pass widens it.
    far = np.array([[0.33, 0, 0]])
    assert tracer.trace(far, direction[:1]).alpha == 0
    wide = tracer.trace(far, direction[:1], pixel=0.1)
    variance = 0.1**2 + 0.3 * (3 * 0.1) ** 2
    np.testing.assert_allclose(wide.alpha, 0.8 * np.exp(-0.5 * 0.33**2 / variance), rtol=1e-4)


def test_an_oblique_ellipsoid_shows_its_shadow():
    """Along x a splat of scales (a, b, c) is the ellipse (b, c): the plane tells the distance."""
    tracer = Tracer(splats([[2.0, 0, 0]], [[1e-3, 0.2, 0.4]], [0.5], [[1, 1, 1]]))
    direction = np.array([[1.0, 0.2, -0.1]])
    direction /= np.linalg.norm(direction)
    found = tracer.trace(np.zeros((1, 3)), direction)
    y, z = 2 * 0.2, -2 * 0.1  # where the ray meets its plane
    expected = 0.5 * np.exp(-0.5 * ((y / 0.2) ** 2 + (z / 0.4) ** 2))
    np.testing.assert_allclose(found.alpha, expected, rtol=1e-3)
    np.testing.assert_allclose(found.plane_distance, 2 / direction[0, 0], rtol=1e-4)
    np.testing.assert_allclose(found.normal, [[-1, 0, 0]], atol=1e-5)


def test_two_splats_blend_in_order_from_either_side():
    two = splats([[0, 0, 1.0], [0, 0, 2]], [[0.1] * 3] * 2, [0.6, 0.7], [[1, 0, 0], [0, 1, 0]])
    tracer = Tracer(two)
    there = tracer.trace([[0, 0, 0]], [[0, 0, 1]])
    back = tracer.trace([[0, 0, 3]], [[0, 0, -1]])
    np.testing.assert_allclose(there.color, [[0.6, 0.4 * 0.7, 0]], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(back.color, [[0.3 * 0.6, 0.7, 0]], rtol=1e-4, atol=1e-6)
    below = tracer.trace([[0, 0, 0]], [[0, 0, 1]], plane=(0, 0, 1, 1.5))
    np.testing.assert_allclose(below.color, [[0, 0.7, 0]], rtol=1e-4, atol=1e-6)


def brute(cloud, origin, direction):
    """Blend all splats in the order of their centres, in float64."""
    w, x, y, z = cloud.rotation.T.astype(float)
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]).transpose(2, 0, 1)  # fmt: skip
    inverse = np.einsum("nij,nj,nkj->nik", turn, cloud.scale.astype(float) ** -2, turn)
    offset = cloud.position - origin
    along = np.einsum("nij,j->ni", inverse, direction)
    t = np.einsum("ni,ni->n", along, offset) / np.einsum("ni,i->n", along, direction)
    q = offset - t[:, None] * direction
    alpha = cloud.opacity * np.exp(-0.5 * np.einsum("ni,nij,nj->n", q, inverse, q))
    alpha = np.where(alpha < 1 / 255, 0, np.minimum(alpha, 0.999))
    centre = offset @ direction
    alpha[centre < 0] = 0
    order = np.argsort(centre)
    clear = np.cumprod(1 - alpha[order])
    weight = alpha[order] * np.append(1, clear[:-1])
    color = np.maximum(0.28209479177387814 * cloud.sh[order, 0] + 0.5, 0)
    return weight @ color, 1 - clear[-1]


def test_the_hierarchy_finds_what_brute_force_finds(rng):
    some = cloud(rng, bands=1, size=0.08)
    origin = rng.uniform(-1, 1, (40, 3))
    direction = rng.normal(size=(40, 3)) + np.array([0, 0, 3])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    found = Tracer(some).trace(origin, direction, segment=0.2)
    for k in range(40):
        color, alpha = brute(some, origin[k], direction[k])
        np.testing.assert_allclose(found.color[k], color, atol=3e-3)
        assert found.alpha[k] == pytest.approx(alpha, abs=2e-3)
    assert found.hits.mean() > 5 and found.alpha.std() > 0.05


def test_segments_and_threads_do_not_matter(rng, threads):
    some = cloud(rng)
    direction = rng.normal(size=(300, 3)) + np.array([0, 0, 5])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    tracer = Tracer(some)
    threads(1)
    one = tracer.trace(np.zeros((300, 3)), direction, segment=0.1)
    threads(2)
    two = tracer.trace(np.zeros((300, 3)), direction, segment=50.0)
    np.testing.assert_array_equal(one.color, two.color)
    np.testing.assert_array_equal(one.distance, two.distance)


def test_rays_from_a_camera_make_the_picture(rng):
    """Small splats, where one projection for all pixels of a splat is as good as one for each."""
    some = cloud(rng, n=20_000, size=0.01)
    camera = Camera(96, 96, 400.0, 400.0, 48.0, 48.0, np.eye(4))
    picture = rasterize(prepare(some), camera, 0.05)
    v, u = np.mgrid[0:96, 0:96] + 0.5
    ray = np.stack([(u - 48) / 400, (v - 48) / 400, np.ones_like(u)], axis=-1).reshape(-1, 3)
    direction = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    found = Tracer(some).trace(np.zeros_like(direction), direction, pixel=direction[:, 2] / 400)
    error = found.color.reshape(96, 96, 3) - picture.color
    assert -10 * np.log10(np.mean(error**2)) > 46
    assert picture.color.std() > 0.1
    both = np.isfinite(picture.depth) & (picture.alpha > 0.5)
    depth = (found.distance * direction[:, 2]).reshape(96, 96)
    assert np.median(np.abs(depth - picture.depth)[both]) < 1e-3


def test_no_splats_and_no_rays():
    nothing = splats(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    assert Tracer(nothing).trace([[0, 0, 0]], [[0, 0, 1]]).alpha == 0
    one = Tracer(splats([[0, 0, 1.0]], [[0.1] * 3], [0.6], [[1, 0, 0]]))
    assert len(one.trace(np.zeros((0, 3)), np.zeros((0, 3))).alpha) == 0
