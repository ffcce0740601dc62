"""Levels of detail: what merging keeps, which level a picture takes, and what it leaves alone."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import made_captures
from rainsim import raster
from rainsim.config.settings import Config
from rainsim.errors import ParameterError
from rainsim.jit import set_threads
from rainsim.pipeline import extract_terrain, simulate
from rainsim.reflection.mirror_choice import merged_cells
from rainsim.render.renderer import Renderer
from rainsim.scene.cameras import cropped
from rainsim.scene.types import Camera, Splats
from rainsim.splatting.detail import Detail
from rainsim.splatting.prepared import GEOMETRY, LANES, NOBODY, OPACITY, by_splat
from scenes import moving_scene, tiny_scene

SIDES = (0.15, 0.3, 0.6)
LAYERS = ("color", "alpha", "depth", "plane_depth", "normal")


def leaves(count=4000, far=4.0):
    return made_captures.leaves(count, 0.008, far, 9)


def with_levels(prepared, sides):
    return Detail(prepared, sides).drawn


def camera(scale=1, back=0.0):
    """Return a camera that looks along z from `back` behind the origin, 24 x 24 px times scale."""
    pose = np.eye(4)
    pose[2, 3] = back
    return Camera(24 * scale, 24 * scale, 36.0 * scale, 36.0 * scale, 12.0 * scale, 12.0 * scale,
                  pose)  # fmt: skip


def level_of(prepared, side):
    """Return geometry and harmonics of the splats of the level drawn at a size, as rows."""
    chunks = np.flatnonzero((prepared.span[:, 0] <= side) & (side < prepared.span[:, 1]))
    rows = by_splat(prepared.geometry[chunks].reshape(-1, GEOMETRY, LANES))
    values = by_splat(prepared.harmonics()[chunks])
    there = rows[:, OPACITY] > -np.inf
    member = prepared.order.reshape(-1, LANES)[chunks].ravel()
    return rows[there], values[there], member[there], there


def moments(rows, values, is_merged):
    """Return weight, mean place, mean square and mean colour of fine splats."""
    few = rows[:, 3] < 1
    rows, values, is_merged = rows[few].astype(float), values[few], is_merged[few]
    xx, xy, xz, yy, yz, zz = rows[:, 3:9].T
    minors = xx * yy - xy**2 + yy * zz - yz**2 + xx * zz - xz**2
    opacity = np.exp2(rows[:, OPACITY])
    thin = -np.log1p(-opacity.clip(0, 0.5))
    depth = np.where(opacity < 0.5, thin, 2 * np.log(2) * opacity)
    depth = np.where(is_merged, depth, opacity)
    weight = depth * np.sqrt(minors)
    square = rows[:, [3, 6, 8]] + rows[:, :3] ** 2
    mean = [(weight[:, None] * a).sum(0) / weight.sum() for a in (rows[:, :3], square, values)]
    return np.concatenate([[weight.sum()], *mean])


def test_merging_keeps_light_place_covariance_and_colour():
    plain = raster.prepare(leaves())
    prepared = with_levels(plain, SIDES)
    base, colors, *_ = level_of(prepared, 0.0)
    wanted = moments(base, colors, np.zeros(len(base), bool))
    number = [len(base)]
    known = {tuple(row) for row in base[:, :3]}
    for side in SIDES:
        rows, values, _, _ = level_of(prepared, side)
        is_merged = np.array([tuple(row) not in known for row in rows[:, :3]])
        np.testing.assert_allclose(moments(rows, values, is_merged), wanted, rtol=3e-3, atol=2e-4)
        np.testing.assert_array_equal(rows[rows[:, 3] > 1], base[base[:, 3] > 1])
        np.testing.assert_allclose(np.linalg.norm(rows[:, 9:12], axis=1), 1, rtol=1e-3)
        assert np.isfinite(rows).all()
        number.append(len(rows))
    assert number[1] < 0.8 * number[0] and number[3] < 0.1 * number[0]  # they were merged
    fainter = base.copy()
    fainter[:, OPACITY] -= 0.1
    assert moments(fainter, colors, np.zeros(len(base), bool))[0] < 0.95 * wanted[0]


def test_a_cell_holds_one_splat_for_each_way_that_its_splats_face():
    rng = np.random.default_rng(1)
    position = rng.uniform(0.01, 0.99, (200, 3)).astype(np.float32) * np.float32(0.2) + 3
    position[:100, 1] = 3.1  # a floor; the others are a wall
    position[100:, 0] = 3.1
    rotation = np.tile(np.float32([1, 0, 0, 0]), (200, 1))
    scale = np.full((200, 3), 0.01, np.float32)
    scale[:100, 1] = scale[100:, 0] = 1e-4
    splats = Splats(position, rotation, scale, np.full(200, 0.5, np.float32),
                    np.zeros((200, 1, 3), np.float32))  # fmt: skip
    rows, _, member, _ = level_of(with_levels(raster.prepare(splats), (0.2,)), 0.2)
    assert len(rows) == 2
    floor, wall = rows[np.argmax(rows[:, 10] ** 2)], rows[np.argmax(rows[:, 9] ** 2)]
    assert floor[6] < 1e-6 < 1e-3 < min(floor[3], floor[8])  # flat, and as wide as the cell
    assert wall[3] < 1e-6 < 1e-3 < min(wall[6], wall[8])
    assert (member[0] < 100) != (member[1] < 100)
    scale[:] = 0.01  # balls face nowhere: now all are one
    assert len(level_of(with_levels(raster.prepare(splats), (0.2,)), 0.2)[0]) == 1


@pytest.mark.parametrize("opacity", [0.95, 0.02])
def test_a_wall_of_merged_splats_has_no_gaps_and_a_veil_stays_one(opacity):
    step = 0.025
    across = np.arange(-1, 1, step, dtype=np.float32)
    place = np.stack([*np.meshgrid(across, across), np.full((len(across),) * 2, 3)], -1)
    position = place.reshape(-1, 3).astype(np.float32)
    scale = np.tile(np.float32([0.6 * step, 0.6 * step, 1e-3]), (len(position), 1))
    rotation = np.tile(np.float32([1, 0, 0, 0]), (len(position), 1))
    color = np.ones((len(position), 1, 3), np.float32)
    share = np.full(len(position), opacity, np.float32)
    splats = Splats(position, rotation, scale, share, color)
    drawer = raster.Rasterizer(with_levels(raster.prepare(splats), SIDES))
    fine = drawer.draw(camera(16), 0.1, detail=0.0).alpha.reshape(24, 16, 24, 16)
    truth, found = fine.mean(axis=(1, 3)), drawer.draw(camera(), 0.1, detail=4.0).alpha
    alone = drawer.draw(camera(), 0.1, detail=0.0).alpha
    truth, found, alone = (alpha[4:-4, 4:-4] for alpha in (truth, found, alone))
    assert abs(found.mean() - truth.mean()) < 0.1 * abs(alone.mean() - truth.mean()) + 0.02
    assert found.min() > 0.7 * truth.min()


def test_a_ring_of_walls_that_lies_flat_faces_up():
    around = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    out = np.stack([np.cos(around), np.sin(around), 0 * around], -1)
    position = (np.float32([3.3, 3.3, 3.3]) + 0.2 * out).astype(np.float32)
    half = around / 2  # the thin axis, x, turned about z
    rotation = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], -1).astype(np.float32)
    scale = np.tile(np.float32([1e-4, 0.02, 0.005]), (90, 1))
    splats = Splats(position, rotation, scale, np.full(90, 0.5, np.float32),
                    np.zeros((90, 1, 3), np.float32))  # fmt: skip
    plain = raster.prepare(splats)
    rows = level_of(with_levels(plain, (0.6,)), 0.6)[0]
    assert len(rows) == 2 and (np.abs(rows[:, 11]) > 0.99).all()
    own = level_of(with_levels(plain, (0.6,)), 0.0)[0]
    assert (np.abs(own[:, 11]) < 0.01).all()


def test_each_group_is_drawn_once_from_wherever_it_is_seen():
    splats = leaves(9000)
    prepared = with_levels(raster.prepare(splats), SIDES)
    assert len(prepared.span) > 36  # levels were added
    sizes = np.geomspace(1e-3, 10, 200)
    groups = np.unique(prepared.reach, axis=0, return_inverse=True)[1].ravel()
    base = np.bincount(groups[prepared.span[:, 0] == 0], minlength=groups.max() + 1)
    assert base.sum() == 36 and (base > 0).all()
    drawn = set()
    for side in sizes:
        here = (prepared.span[:, 0] <= side) & (side < prepared.span[:, 1])
        levels = [set(prepared.span[here & (groups == g), 0].tolist()) for g in range(len(base))]
        assert all(len(level) == 1 for level in levels)
        drawn |= set().union(*levels)
    assert drawn == {0.0, *np.float32(SIDES).tolist()}


def test_pictures_that_resolve_all_and_merge_0_are_those_of_all_splats():
    plain = raster.prepare(leaves())
    prepared = with_levels(plain, SIDES)
    drawers = raster.Rasterizer(plain), raster.Rasterizer(prepared)
    for options in ({"detail": 0.0}, {"detail": 0.2}):
        wanted, found = (d.draw(camera(8), 0.1, hit=True, **options) for d in drawers)
        for name in (*LAYERS, "hit"):
            np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
    far = [d.draw(camera(), 0.1, detail=4.0).color for d in drawers]
    assert np.abs(far[0] - far[1]).max() > 0.02


def test_a_far_picture_is_nearer_to_the_mean_of_a_large_one():
    drawer = raster.Rasterizer(with_levels(raster.prepare(leaves(20000)), SIDES))

    def drawn(scale, detail):
        picture = drawer.draw(camera(scale), 0.1, detail=detail).color
        return picture.reshape(24, scale, 24, scale, 3).mean(axis=(1, 3))

    truth = drawn(16, 0.0)
    error, all_drawn = (np.sqrt(np.mean((drawn(1, d) - truth) ** 2)) for d in (2.0, 0.0))
    assert error < 0.8 * all_drawn and truth.std() > 0.05


def test_the_choice_follows_the_camera_and_nothing_else():
    drawer = raster.Rasterizer(with_levels(raster.prepare(leaves()), SIDES))
    whole = drawer.draw(camera(4), 0.1, detail=8.0)
    drawer.draw(camera(4, back=6.0), 0.1, detail=8.0)  # another picture in between
    before = set_threads(1)
    try:
        again = drawer.draw(camera(4), 0.1, detail=8.0)
    finally:
        set_threads(before)
    for name in LAYERS:
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    part = drawer.draw(cropped(camera(4), (32, 16, 80, 64)), 0.1, detail=8.0)
    np.testing.assert_allclose(part.color, whole.color[16:64, 32:80], atol=1e-5)
    finer = drawer.draw(camera(4), 0.1, detail=1.0)
    assert np.abs(finer.color - whole.color).max() > 0.02


def test_a_slow_dolly_does_not_pop():
    drawer = raster.Rasterizer(with_levels(raster.prepare(leaves(far=9.0)), SIDES))

    def mean_change(detail):
        frames = [drawer.draw(camera(3, back=0.02 * k), 0.1, detail=detail).color
                  for k in range(25)]  # fmt: skip
        return np.mean([np.abs(a - b).mean() for a, b in pairwise(frames)])

    merged, full = mean_change(6.0), mean_change(0.0)
    assert merged < 1.05 * full and merged > 0.3 * full


def test_splats_behind_and_across_the_camera():
    splats = leaves(3000)
    splats.position[:, 2] -= 3.5  # the camera stands amid the leaves
    plain = raster.prepare(splats)
    drawer = raster.Rasterizer(with_levels(plain, SIDES))
    wanted = raster.rasterize(plain, camera(4), 0.05)
    near = drawer.draw(camera(4), 0.05, detail=2.0)
    np.testing.assert_array_equal(near.color, wanted.color)  # the nearest centre decides
    turned = replace(camera(4), camera_from_world=np.diag([-1.0, 1.0, -1.0, 1.0]))
    assert np.isfinite(drawer.draw(turned, 0.05, detail=50.0).color).all()
    behind = camera(4, back=-50.0)  # all of it lies behind
    assert drawer.draw(behind, 0.05, detail=4.0).alpha.max() == 0


def test_what_is_no_splat_does_no_harm():
    splats = leaves(2000)
    clean = {name: getattr(splats, name).copy() for name in Splats.__slots__}
    splats.position[10:20] = np.nan
    splats.position[20:25] = 1e30
    splats.scale[30:35] = np.inf
    splats.scale[35:40] = 1e12
    splats.opacity[40:50] = 0
    splats.opacity[50:55] = np.nan
    splats.rotation[60:65] = 0
    splats.sh[70:75] = np.nan
    gone = np.r_[10:25, 30:55, 60:65, 70:75]
    spoilt = with_levels(raster.prepare(splats), SIDES)
    rest = Splats(**{name: np.delete(a, gone, axis=0) for name, a in clean.items()})

    def spoilt_at(side):
        rows, values, _, _ = level_of(spoilt, side)
        assert np.isfinite(values).all()
        return (~np.isfinite(rows).all(axis=1)).sum()

    assert [spoilt_at(side) for side in SIDES] == [spoilt_at(0.0)] * 3  # none was merged
    assert spoilt_at(0.0) > 15
    picture = raster.Rasterizer(spoilt).draw(camera(2), 0.1, detail=4.0).color
    wanted = raster.Rasterizer(with_levels(raster.prepare(rest), SIDES)).draw(
        camera(2), 0.1, detail=4.0
    )
    assert np.isfinite(picture).all() and np.sqrt(np.mean((picture - wanted.color) ** 2)) < 0.03


@pytest.mark.parametrize("count", [0, 1, 2])
def test_nothing_and_next_to_nothing(count):
    splats = leaves(3).take(np.arange(3) >= 3 - count)
    plain = raster.prepare(splats)
    prepared = with_levels(plain, SIDES)
    assert (prepared.order != NOBODY).sum() >= count
    found = raster.Rasterizer(prepared).draw(camera(2), 0.1, detail=4.0)
    np.testing.assert_array_equal(found.color, raster.rasterize(plain, camera(2), 0.1).color)


def test_splats_that_come_last_have_no_levels_and_can_be_left_out():
    splats = leaves()
    last = np.zeros(4000, bool)
    last[2000:] = True
    plain = raster.prepare(splats, last)
    prepared = with_levels(plain, SIDES)
    assert prepared.leading > plain.leading
    assert len(prepared.box) - prepared.leading == len(plain.box) - plain.leading
    drawers = raster.Rasterizer(plain), raster.Rasterizer(prepared)
    for detail in (0.0, 4.0):
        all_, first = (drawers[1].draw(camera(2), 0.1, leading=leading, detail=detail).alpha
                       for leading in (False, True))  # fmt: skip
        assert np.abs(all_ - first).max() > 0.1
    wanted, found = (d.draw(camera(2), 0.1, leading=True).color for d in drawers)
    np.testing.assert_array_equal(found, wanted)


# ---- in frames


def renderer_of(scene, **changes):
    config = Config.from_preset("moderate").replace(
        frames=1, width=64, extent=1.0, spacing=0.05, **changes
    )
    terrain = extract_terrain(scene, config)
    state = next(iter(simulate(terrain, config)))
    return Renderer(scene, terrain, config, scene.cameras[0]), state


@pytest.fixture(scope="module")
def frames():
    """Return pictures of the tiny scene, and their clean layers, by `merge`."""
    scene, found = tiny_scene(), {}
    for merge in (0.0, 4.0, 12.0):
        renderer, state = renderer_of(scene, merge=merge)
        picture, report = renderer.draw(scene.cameras[0], state, None, ("clean",))
        found[merge] = np.array(picture, float), report.aovs["clean"], renderer
    return found


def test_frames_merge_as_set(frames):
    every, merged = (frames[k][2].conductor.wet_scene.capture for k in (0.0, 12.0))
    assert every.drawn is every.prepared
    assert len(merged.drawn.box) > len(merged.prepared.box)

    def rms(k, a):
        return np.sqrt(np.mean((frames[0.0][k] - frames[a][k]) ** 2))

    assert rms(0, 12.0) > rms(0, 4.0) and rms(0, 12.0) > 1
    assert rms(1, 12.0) > 0  # the layer of the capture is merged as its frame is


def test_colours_that_change_are_merged_again():
    splats = leaves()
    detail = Detail(raster.prepare(splats), SIDES)
    other = replace(splats, sh=splats.sh[::-1].copy())
    before, geometry = detail.drawn.sh.copy(), detail.drawn.geometry
    detail.recolor(other)
    wanted = with_levels(raster.prepare(other), SIDES)
    for name in ("geometry", "sh", "fine", "step", "box", "order", "span", "reach"):
        np.testing.assert_array_equal(getattr(detail.drawn, name), getattr(wanted, name))
    assert detail.drawn.geometry is geometry and np.abs(detail.drawn.sh - before).max() > 0.1
    for name in ("geometry", "sh", "fine", "step", "box", "order"):
        whole = getattr(raster.prepare(other), name)
        np.testing.assert_array_equal(getattr(detail.prepared, name), whole)


def test_scenes_with_actors_draw_every_splat():
    renderer, _ = renderer_of(moving_scene())
    capture = renderer.conductor.wet_scene.capture
    assert capture.merge == 0 and capture.drawn.span is None


def test_the_setting_is_checked():
    with pytest.raises(ParameterError, match="merge is -1"):
        Config().replace(merge=-1.0).check()


def test_mirrored_pictures_of_half_the_size_merge_in_wider_cells(frames, monkeypatch):
    scene = frames[4.0][2].conductor.wet_scene
    camera, asked = tiny_scene().cameras[0].resized(64, 48), []
    plain = scene.capture.rasterizer.draw

    def draw(*given, **named):
        asked.append((named["detail"], given[0].width))
        return plain(*given, **named)

    monkeypatch.setattr(scene.capture.rasterizer, "draw", draw)
    whole, half = (scene.mirrored(camera, 0.0, (0, 0, 64, 48), step)[1] for step in (1, 2))
    assert asked == [(4.0, 64), (8.0, 32)]
    assert whole.picture.shape == (48, 64, 3) and half.picture.shape == (24, 32, 3)
    assert merged_cells(0.0, 2) == 0  # all splats as they are
