"""The captured gloss of wet level surfaces: the diffuse colour of splats, where it is taken."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import factories
from rainsim.constants import SH_0
from rainsim.raster import Rasterizer, prepare
from rainsim.scene.types import Scene
from rainsim.shading import visibility
from rainsim.shading.bodies import body_map
from rainsim.shading.diffuse import STEPS, level_share, levelness, step_of, without_gloss
from rainsim.terrain.surface import terrain_from_heights
from rainsim.terrain.types import Grid
from scenes import ground_frame, tiny_scene


def splats_at(position, sh):
    return factories.splats(position, opacity=0.99, sh=sh)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_seen_color_is_that_of_the_picture(degree, rng):
    scene = tiny_scene()
    camera = scene.cameras[0]
    middle = camera.position + 2.0 * camera.forward
    sh = rng.normal(0, 0.15, (1, (degree + 1) ** 2, 3))
    splats = splats_at([middle], sh)
    drawn = Rasterizer(prepare(splats)).draw(camera, 0.01)
    row, column = int(camera.cy), int(camera.cx)
    wanted = drawn.color[row, column] / drawn.alpha[row, column]
    x, y, z = camera.forward.astype(np.float32)
    found = [visibility.color_seen(splats.sh[0], c, x, y, z) for c in range(3)]
    np.testing.assert_allclose(found, wanted, atol=2e-3)


def test_the_diffuse_color_is_that_of_the_darker_views():
    scene = dataclasses.replace(tiny_scene(), source=Path("tiny.ply"))
    sheen = np.zeros((len(scene.splats), 4, 3), np.float32)
    sheen[:, 0] = scene.splats.sh[:, 0]
    plain = dataclasses.replace(scene, splats=dataclasses.replace(scene.splats, sh=sheen))
    views = visibility.views_of_splats(plain)
    color = 0.5 + SH_0 * sheen[:, 0]
    np.testing.assert_allclose(views.diffuse, np.clip(color, 0, None), atol=2e-3)
    sheen = sheen.copy()
    sheen[:, 1:] = 0.3
    glossy = dataclasses.replace(scene, splats=dataclasses.replace(scene.splats, sh=sheen))
    views = visibility.views_of_splats(glossy)
    seen = views.seen == 3
    assert seen.sum() > 100
    looks = np.stack([colors(glossy.splats, camera) for camera in scene.cameras])[:, seen]
    found = views.diffuse[seen].astype(float)
    light = looks.sum(axis=-1)
    assert (found.sum(axis=-1) < light.mean(axis=0) + 1e-2).all()
    assert (found.sum(axis=-1) > light.min(axis=0) - 1e-2).all()
    spread = light.max(axis=0) - light.min(axis=0) > 0.2
    assert spread.any()
    assert (found.sum(axis=-1) < light.mean(axis=0) - 0.02)[spread].mean() > 0.9


def colors(splats, camera):
    """Return each splat's colour as a camera sees it, (n, 3)."""
    away = splats.position - camera.position
    away /= np.linalg.norm(away, axis=1)[:, None]
    x, y, z = away.T[:, :, None]
    sh = splats.sh
    value = 0.5 + SH_0 * sh[:, 0] + 0.4886025 * (z * sh[:, 2] - y * sh[:, 1] - x * sh[:, 3])
    return np.maximum(value, 0)


def test_a_table_is_level_up_to_its_edge_and_a_slope_is_not():
    height = np.zeros((60, 60))
    height[20:40, 20:40] = 0.7
    height += np.random.default_rng(3).normal(0, 0.002, height.shape)
    level = levelness(height, 0.02)
    assert np.percentile(level[20:40, 20:40], 1) > 0.5 and level[:15].min() > 0.9
    slope = np.indices((60, 60))[0] * 0.02 * 1.2
    assert levelness(slope, 0.02)[5:-5, 5:-5].max() < 0.6
    rough = np.random.default_rng(4).normal(0, 0.1, (60, 60))
    assert levelness(rough, 0.02).mean() < 0.1


def share_of(scene, terrain, reach, lawn):
    return level_share(scene, terrain, reach, lawn, body_map(terrain))


def test_open_level_splats_count_and_others_do_not():
    height = np.zeros((80, 80), np.float32)
    height[30:50, 30:50] = 0.7
    terrain = terrain_from_heights(height * 0, Grid((80, 80), (-0.8, -0.8), 0.02))
    terrain = dataclasses.replace(terrain, top=height, underside=height)
    place = np.array([[0, 0, 0.7], [0.5, 0.5, 0.0], [0, 0, 0.4], [0.5, 0.5, 0.6], [9, 9, 0]])
    frame = ground_frame()
    splats = splats_at(frame.to_capture(place), np.zeros((5, 1, 3)))
    scene = Scene("table", splats, (), frame)
    full, none = np.ones((80, 80), np.float32), np.zeros((80, 80), np.float32)
    found = share_of(scene, terrain, full, none)
    np.testing.assert_allclose(found, [1, 1, 0, 0, 0], atol=0.05)
    found = share_of(scene, terrain, none, none)  # no rain reaches the ground: a roof
    np.testing.assert_allclose(found, [1, 0, 0, 0, 0], atol=0.05)
    found = share_of(scene, terrain, full, full)  # grass
    np.testing.assert_allclose(found, [1, 0, 0, 0, 0], atol=0.05)
    box = dataclasses.replace(terrain, underside=terrain.bed)
    np.testing.assert_allclose(share_of(scene, box, full, none), [1, 1, 1, 0, 0], atol=0.05)
    leaves = dataclasses.replace(scene, splats=splats_at(splats.position, [[[0.0, 0.5, 0]]] * 5))
    np.testing.assert_allclose(share_of(leaves, box, full, none), [1, 1, 0, 0, 0], atol=0.05)


def test_without_gloss_a_splat_looks_the_same_from_all_sides(rng):
    sh = rng.normal(0, 0.3, (6, 16, 3))
    splats = splats_at(np.zeros((6, 3)), sh)
    diffuse = rng.uniform(0, 1, (6, 3))
    share = np.array([0, 0, 0.5, 0.5, 1, 1], np.float32)
    found = without_gloss(splats, diffuse, share)
    np.testing.assert_array_equal(found.sh[:2], splats.sh[:2])
    np.testing.assert_array_equal(found.sh[4:, 1:], 0)
    np.testing.assert_allclose(0.5 + SH_0 * found.sh[4:, 0], diffuse[4:], atol=1e-6)
    np.testing.assert_allclose(found.sh[2:4, 1:], 0.5 * splats.sh[2:4, 1:])
    assert without_gloss(splats, diffuse, share * 0) is splats


def test_wetness_comes_in_steps():
    steps = {step_of(wet) for wet in np.linspace(0, 1, 1000)}
    assert len(steps) == STEPS + 1 and {0.0, 1.0} <= steps
