"""One march in the mirrored picture: for one pixel, and for many rays at a time."""

import numpy as np
import pytest

from rainsim.jit import serial_kernel
from rainsim.numerics.mipmap import coarsened
from rainsim.reflection import water_record
from rainsim.reflection.facets import normal_of
from rainsim.reflection.mirror_pass import mirror_light
from rainsim.reflection.mirrored_rays import ENVIRONMENT, MIRROR, reflected_upwards
from rainsim.reflection.planar_mirror import (
    MirrorPicture,
    image_of,
    mirrored_light,
    vanishing_point,
)
from rainsim.reflection.water_record import RECORD, read_record
from rainsim.scene.view import View

HEIGHT, WIDTH, FOCAL = 90, 120, 100.0
EYE = np.array([0.1, -2.0, 1.5], np.float32)
LEVEL = np.float32(0.02)


@serial_kernel
def one_by_one(record, view, mirror, light_out):
    for n in range(len(record)):
        light_out[n, 0], light_out[n, 1], light_out[n, 2] = mirrored_light(
            view, mirror, read_record(record, n)
        )


def mirrored_view():
    """The camera mirrored at LEVEL: it looks along y and 20 degrees down, mirrored up."""
    pitch = np.radians(20)
    ahead = np.array([0, np.cos(pitch), -np.sin(pitch)])
    right = np.array([1.0, 0, 0])
    turn = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    lens = np.float32([FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2])
    flipped = (turn * [[1], [1], [-1]]).astype(np.float32)
    eye = np.array([EYE[0], EYE[1], 2 * LEVEL - EYE[2]], np.float32)
    return turn, View(flipped, eye, *lens)


def listed_water(turn, view, rng, n=3000):
    """Records all over the picture's lower part, some still, some with ripples."""
    u, v = rng.uniform(0, WIDTH, n), rng.uniform(0.45 * HEIGHT, HEIGHT, n)
    ray = np.stack([(u - view.cx) / FOCAL, (v - view.cy) / FOCAL, np.ones(n)], -1) @ turn.T
    ray = ray[ray[:, 2] < -0.02]
    t = (LEVEL - EYE[2]) / ray[:, 2]
    n = len(ray)
    record = np.zeros((n, RECORD), np.float32)
    record[:, water_record.POINT] = EYE + t[:, None] * ray
    unit = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    record[:, water_record.VIEW_X : water_record.VIEW_Z + 1] = unit
    record[:, water_record.VIEW_DEPTH] = t
    record[:, water_record.SLOPE_X : water_record.SLOPE_Y + 1] = rng.normal(0, 0.04, (n, 2))
    rough = rng.uniform(0, 0.05, n) ** 2 * (rng.uniform(size=n) < 0.6)
    record[:, water_record.VARIANCE_X] = rough
    record[:, water_record.VARIANCE_Y] = 1.5 * rough
    record[:, water_record.COVARIANCE] = 0.3 * rough
    return record


@pytest.mark.parametrize("kind", ["posts", "noise", "sky"])
def test_rays_by_the_chunk_find_what_single_rays_find(rng, kind):
    turn, view = mirrored_view()
    record = listed_water(turn, view, rng)
    picture = rng.uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32)
    depth = np.full((HEIGHT, WIDTH), 1e4, np.float32)
    if kind == "posts":
        for column, far in zip(range(10, 110, 12), (3, 5, 9, 30) * 3, strict=False):
            depth[:, column : column + 3] = far
    elif kind == "noise":
        depth = rng.uniform(2.5, 12, (HEIGHT, WIDTH)).astype(np.float32)
    mirror = MirrorPicture(picture, coarsened(picture), depth)
    n = len(record)
    found, wanted = (np.full((n, 3), np.nan, np.float32) for _ in range(2))
    source = np.full(n, 99, np.uint8)
    one_by_one(record, view, mirror, wanted)
    mirror_light(np.arange(n), record, view, mirror, found, source)
    assert np.isfinite(found).all() and wanted.std() > 0.1
    # A ray that passes within rounding of a surface may end on either side of it.
    apart = np.abs(found - wanted).max(axis=1) > 1e-4
    assert apart.mean() < 2e-3
    assert set(np.unique(source)) <= {ENVIRONMENT, MIRROR}
    assert (source == ENVIRONMENT).all() == (kind == "sky")


def test_no_sky_shows_through_a_wall_behind_bars(rng):
    """A ray that goes behind a bar meets the wall there: the sky past the wall is no answer."""
    turn, view = mirrored_view()
    record = listed_water(turn, view, rng)
    record[:, water_record.SLOPE_X : water_record.SLOPE_Y + 1] *= 2
    record[:, water_record.VARIANCE_X : water_record.COVARIANCE + 1] = 0
    top, far, near = 0.75 * HEIGHT, 6.0, 3.0  # the wall's row, then depths [m]
    picture, depth = np.ones((HEIGHT, WIDTH, 3), np.float32), np.full((HEIGHT, WIDTH), 1e4)
    wall, bars = np.arange(HEIGHT) < top, np.arange(WIDTH) % 8 < 4
    picture[wall], depth[wall] = 0, far
    picture[:, bars], depth[:, bars] = 0, near
    mirror = MirrorPicture(picture, coarsened(picture), depth.astype(np.float32))
    n = len(record)
    found, source = np.full((n, 3), np.nan, np.float32), np.full(n, 99, np.uint8)
    mirror_light(np.arange(n), record, view, mirror, found, source)
    dark = np.zeros(n, bool)
    for k in range(n):
        water = read_record(record, k)
        _, v, z = image_of(view, water.x, water.y, water.z)
        normal = normal_of(water.slope_x, water.slope_y)
        ray = reflected_upwards(water.view_x, water.view_y, water.view_z, *normal)
        end = vanishing_point(view, *ray)
        at_wall = v + (1 - z / far) * (end[1] - v)
        dark[k] = z < near and at_wall < top - 1
    assert dark.mean() > 0.1 and (found[~dark] > 0.5).mean() > 0.2
    assert np.isfinite(found).all() and (found[dark, 0] > 0.5).mean() < 0.012
