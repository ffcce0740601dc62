"""The surface of a capture: where its cameras agree, what is sky, how high its ground lies."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

import factories
import sunny_yard
from rainsim.daylight.lit_surface import Surface, carried
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.raster import Rasterizer
from rainsim.scene.splat_sets import joined
from rainsim.shading import backdrop
from rainsim.splatting.prepared import GEOMETRY, LANES, prepare, turn
from rainsim.surface import captured_sky, fuse, kept_surface, sweep, views, walls
from rainsim.terrain.types import Grid
from scenes import looking


def floating(scene, place, count=60, spread=0.05, opacity=0.9, color=(0.9, 0.9, 0.9)):
    """Return splats in the air about a place of the ground frame [m]."""
    rng = np.random.default_rng(3)
    position = np.asarray(place) + spread * rng.standard_normal((count, 3))
    like = scene.splats.take(slice(0, count))
    sh = np.zeros_like(like.sh)
    sh[:, 0] = (np.asarray(color) - 0.5) / sunny_yard.SH_0
    return replace(
        like, position=scene.ground_frame.to_capture(position).astype(np.float32), sh=sh,
        opacity=np.full(count, opacity, np.float32),
        scale=np.full((count, 3), 0.06, np.float32),
    )  # fmt: skip


@pytest.fixture(scope="module")
def yard():
    return sunny_yard.yard(step=0.05)[0]


@pytest.fixture(scope="module")
def found(yard):
    return kept_surface.find_surface(yard)


def off_the_faces(points):
    """Return the distance [m] of points to the ground and to the boxes of the yard."""
    away = np.abs(points[:, 2])
    for low, high in sunny_yard.BOXES:
        out = np.maximum(np.maximum(low - points, points - high), 0)
        inside = np.minimum(points - low, high - points).min(axis=1)
        face = np.where(inside > 0, inside, np.linalg.norm(out, axis=1))
        away = np.minimum(away, face)
    return away


def test_the_surface_lies_on_what_was_captured(found):
    away = off_the_faces(found.surface.position.astype(float))
    assert len(found.surface.position) > 3000
    assert np.median(away) < 0.01 and np.percentile(away, 95) < 0.05
    ground = (found.surface.position[:, 2] < 0.01) & (found.surface.flat > 0.9)
    assert ground.sum() > 1000 and np.median(found.surface.normal[ground, 2]) > 0.99


def test_wide_pixels_have_wider_voxels(found, yard, monkeypatch):
    monkeypatch.setattr(fuse, "COARSE", 0.0)
    steps = []
    wide = kept_surface.find_surface(yard, lambda: steps.append(1)).surface
    assert len(steps) == kept_surface.STEPS
    assert np.median(wide.size) == pytest.approx(2 * fuse.VOXEL)
    assert np.median(found.surface.size) == pytest.approx(fuse.VOXEL)
    assert len(wide.position) < 0.5 * len(found.surface.position)
    assert np.median(off_the_faces(wide.position.astype(float))) < 0.015


def test_what_cameras_look_through_is_no_surface(yard):
    haze = floating(yard, (0.9, -0.3, 0.9), spread=0.15, opacity=0.3)
    hazy = kept_surface.find_surface(replace(yard, splats=joined([yard.splats, haze])))
    near = np.linalg.norm(hazy.surface.position - [0.9, -0.3, 0.9], axis=1) < 0.25
    assert near.sum() < 20  # of some hundred
    # What stands there is seen by all cameras, and stays.
    box = np.abs(hazy.surface.position - [-0.2, 0.15, 0.75]).max(axis=1) < 0.3
    assert box.sum() > 30
    solid = np.linalg.norm(hazy.solid[:, :3] - [0.9, -0.3, 0.9], axis=1) < 0.25
    assert not solid.any()


def test_a_yard_without_sky_has_none(found, yard):
    assert not found.sky.any() and found.sky.shape == (len(yard.splats),)


def test_the_least_depth_around_is_known_before_the_sky_is_left_out(yard):
    for view in views.depth_views(yard, yard.cameras[:3], Rasterizer(prepare(yard.splats))):
        np.testing.assert_array_equal(view.least, ndimage.minimum_filter(view.depth, 3))


def view_of(light, up=0.0):
    """Return the `DepthView` of a level camera at the origin that looks along x, `up` [rad]."""
    height, width = light.shape[:2]
    c, s = np.cos(up), np.sin(up)
    forward, right, down = [c, 0, s], [0, -1, 0], [s, 0, -c]
    matrix = np.zeros((3, 4), np.float32)
    matrix[:, :3] = right, down, forward
    lens = np.array([width, width, width / 2, height / 2], np.float32)
    depth = np.full((height, width), 5.0, np.float32)
    return views.DepthView(
        matrix, np.zeros(3, np.float32), lens, depth, depth.copy(), light, np.ones_like(depth)
    )


def blue_over_wall(height=60, width=80):
    """Return a picture whose upper half is a blue sky and whose lower half a plain grey wall."""
    light = np.empty((height, width, 3), np.float32)
    light[: height // 2] = (0.25, 0.4, 0.7)
    light[height // 2 :] = (0.2, 0.2, 0.19)
    return light


def test_the_sky_is_found_by_its_colour_and_a_wall_is_not_sky():
    pictures = [view_of(blue_over_wall(), 0.45 + 0.02 * k) for k in range(4)]
    colors = captured_sky.SkyColors(pictures)
    assert colors.color is not None
    shown = [part > 0 for part in colors.parts(pictures)[0]]
    assert shown[0][2:28].mean() > 0.95 and shown[0][32:].mean() == 0
    seen = captured_sky.seen_sky(pictures, shown)
    assert 0 <= seen.min() and seen[22:].max() == 1
    assert not seen[2:5, :2].any()  # low and straight ahead is the wall


def test_one_sky_is_found_in_pictures_of_different_exposure():
    exposure = np.float32([-0.45, 0, 0, 0.3, -0.45])
    pictures = [
        view_of(blue_over_wall() * np.exp(e), 0.45 + 0.02 * k) for k, e in enumerate(exposure)
    ]
    colors = captured_sky.SkyColors(pictures)
    np.testing.assert_allclose(colors.exposure, exposure, atol=0.05)
    for part in colors.parts(pictures)[0]:
        assert (part[3:26] == 1).all() and (part[34:] == -1).all()


def test_regions_of_a_picture_are_judged_whole():
    light = blue_over_wall()
    light[8:14, 20:40] = 0.9  # a cloud
    light[6:12, 2:16] = light[16:22, 22:36] = 0.9  # two more, and the roofs that hide them below
    light[10:14, 2:13] = light[20:24, 22:33] = 0.15
    light[14:32, 5:9] = light[24:32, 26:30] = 0.15
    light[15:32, 55:70] = 0.9  # a gable, on the wall
    light[40:46, 20:26] = np.float32(0.8) * light[0, 0]  # a pane, which mirrors the sky
    light[40:46, 40:46] = light[0, 0]  # a gap
    others = [view_of(blue_over_wall(), 0.43 + 0.02 * k) for k in range(4)]
    pictures = [view_of(light, 0.45), *others]
    part = captured_sky.SkyColors(pictures).parts(pictures)[0][0]
    assert (part[9:13, 22:38] == 1).all() and (part[19:31, 59:66] == -1).all()
    assert (part[7:9, 3:15] == 1).all() and (part[17:19, 23:35] == 1).all()
    assert (part[41:45, 21:25] == 0).all() and (part[42:44, 42:44] == 1).all()


def test_the_sky_goes_on_where_it_darkens_smoothly_and_ends_at_an_edge():
    others = [view_of(blue_over_wall(), 0.43 + 0.02 * k) for k in range(4)]
    shade = {"sky": np.linspace(0, -0.8, 30), "front": np.full(30, -0.8)}
    for name, darker in shade.items():
        light = blue_over_wall()
        light[:30, 50:] *= np.exp(darker, dtype=np.float32)[:, None]
        light[30:] = (0.2, 0.15, 0.1)
        pictures = [view_of(light, 0.45), *others]
        part = captured_sky.SkyColors(pictures).parts(pictures)[0][0]
        assert (part[3:25, 3:45] == 1).all()
        assert (part[3:25, 70:77] == (1 if name == "sky" else -1)).all()


def test_a_pale_wall_that_goes_on_below_the_horizon_is_no_sky():
    for foot in (46, 54):  # rows: the horizon's, and one of a wall near by
        light = np.full((60, 80, 3), (0.25, 0.4, 0.7), np.float32)
        light[foot:] = (0.1, 0.08, 0.05)
        colors = captured_sky.SkyColors([view_of(light, 0.2 + 0.002 * k) for k in range(4)])
        assert (colors.color is None) == (foot == 54)


def test_a_ceiling_that_differs_from_place_to_place_is_no_sky():
    lamp = np.linspace(-0.8, 0.8, 80, dtype=np.float32)[:, None]  # light falls off to a side
    pictures = [
        view_of(blue_over_wall() * np.exp(turn * lamp), 0.45) for turn in (-1.0, -0.4, 0.4, 1.0)
    ]
    assert captured_sky.SkyColors(pictures).color is None
    plain = [view_of(np.full((60, 80, 3), 0.01, np.float32), 0.4)]
    assert captured_sky.SkyColors(plain).color is None  # a night


def test_one_grey_everywhere_is_no_sky():
    grey = np.full((60, 80, 3), 0.25, np.float32)
    assert captured_sky.SkyColors([view_of(grey, 0.02 * k) for k in range(4)]).color is None
    # The same grey over darker land is the sky of a dull day.
    over_land = grey.copy()
    over_land[30:] = (0.1, 0.09, 0.05)
    assert (
        captured_sky.SkyColors([view_of(over_land, 0.02 * k) for k in range(4)]).color is not None
    )


def test_a_grey_front_below_a_brighter_sky_is_no_sky():
    front = np.full((60, 80, 3), (0.3, 0.32, 0.36), np.float32)
    front[50:] = (0.1, 0.09, 0.05)
    assert captured_sky.SkyColors([view_of(front, 0.3)] * 4).color is not None
    front[:8, :50] = 0.9
    pictures = [view_of(front, 0.3)] * 4
    parts = captured_sky.SkyColors(pictures).parts(pictures)[0]
    assert (parts[0][12:] < 1).all()


def test_a_front_that_a_camera_shows_bluer_than_its_sky_is_no_sky():
    for land in ((0.1, 0.12, 0.19), (0.1, 0.09, 0.05)):  # balanced for lamps, and for daylight
        front = np.full((60, 80, 3), (0.17, 0.22, 0.41), np.float32)
        front[45:] = land
        front[:16, :50] = (0.87, 0.89, 0.99)
        pictures = [view_of(front, 0.2)] * 4
        colors = captured_sky.SkyColors(pictures)
        shown, balance = colors.parts(pictures)[0][0], colors.balance
        assert balance @ LUMINANCE_WEIGHTS == pytest.approx(1)
        if land[2] > land[0]:
            np.testing.assert_allclose(balance / balance[0], np.array(land) / land[0], rtol=1e-5)
            assert (shown[20:44, 5:75] < 1).all() and (shown[2:13, 5:45] == 1).all()
        else:  # a blue sky with a cloud
            assert np.ptp(balance) == 0
            assert (shown[20:40, 5:75] == 1).all()


@pytest.mark.parametrize("sky", [False, True])
def test_what_cameras_apart_see_at_one_place_is_no_sky(sky, monkeypatch):
    monkeypatch.setattr(captured_sky, "RIVAL", 1)  # that a sky is brighter does not count here
    light = np.full((60, 80, 3), (0.3, 0.32, 0.36), np.float32)
    light[50:] = (0.1, 0.09, 0.05)
    light[: 16 * sky] = 0.9
    rng = np.random.default_rng(0)
    for away in (50.0, 4.0):  # of a front that is ahead, whatever the camera's place
        pictures = []
        for y in (-1.5, -0.5, 0.5, 1.5):
            view = view_of(light, 0.3)
            eye = np.float32([0, y, 0])
            depth = np.full((60, 80), away, np.float32)
            depth[50:] = rng.uniform(1, 4)  # the ground is hardly known, and the sky is not
            depth[: 16 * sky] = rng.uniform(10, 60)
            matrix = np.column_stack([view.matrix[:, :3], -view.matrix[:, :3] @ eye])
            pictures.append(view._replace(matrix=matrix, eye=eye, depth=depth, least=depth))
        colors = captured_sky.SkyColors(pictures)
        if not sky:
            assert (colors.color is None) == (away == 4.0)
    if sky:  # of the other parts of the map the next is tried
        shown = colors.parts(pictures)[0][0]
        assert (shown[2:13, 5:75] == 1).all() and (shown[20:] < 1).all()
    else:  # views that are not of the capture's cameras do not count
        rings = [view_of(light, 0.3)] * 40
        colors = [captured_sky.SkyColors(pictures + rings, own).color for own in (4, 0)]
        assert colors[0] is None and colors[1] is not None


def test_a_white_wall_that_goes_on_below_the_horizon_is_no_sky():
    light = np.full((60, 80, 3), 0.3, np.float32)  # a grey sky
    light[30:] = 0.05
    light[:30, 15:65] = 0.8
    cloud = [view_of(light, 0.1)] * 4
    assert (captured_sky.SkyColors(cloud).parts(cloud)[0][0][5:25, 25:55] == 1).all()
    light[30:52, 15:65] = 0.8
    wall = [view_of(light, 0.1)] * 4
    part = captured_sky.SkyColors(wall).parts(wall)[0][0]
    assert (part[5:50, 25:55] < 1).all()


def test_splats_of_a_wall_whose_places_scatter_face_as_the_wall_does():
    rng = np.random.default_rng(0)
    count = 6000
    place = np.column_stack([
        2 + 0.1 * rng.standard_normal(count), rng.uniform(-2, 2, count), rng.uniform(0, 4, count)
    ]).astype(np.float32)  # fmt: skip
    loose = rng.standard_normal((count, 3)).astype(np.float32)  # as the few splats about one lie
    loose[:, 0] = -np.abs(loose[:, 0])
    loose /= np.linalg.norm(loose, axis=1, keepdims=True)
    scene = sunny_yard.yard(step=0.4)[0]
    splats = scene.splats.take(np.zeros(count, int))
    splats = replace(splats, position=scene.ground_frame.to_capture(place).astype(np.float32))
    scene = replace(scene, splats=splats)
    for light, leaf in (((0.3, 0.3, 0.3), False), ((0.05, 0.2, 0.03), True)):
        surface = fuse.CaptureSurface(
            place, loose, np.zeros(count, "f4"), np.tile(np.float32(light), (count, 1)),
            np.full(count, 0.04, np.float32), np.full(count, 4, np.uint8),
        )  # fmt: skip
        seen = SimpleNamespace(surface=surface, middle=np.zeros(3, np.float32))
        normal, share = kept_surface.splat_normals(scene, seen, np.zeros(count, bool))
        normal = normal @ scene.ground_frame.rotation.T
        inner = (np.abs(place[:, 1]) < 1.5) & (np.abs(place[:, 2] - 2) < 1.5)
        if leaf:
            assert share.max() == 0  # each keeps its own
        else:
            assert share[inner].min() > 0.95 and normal[inner, 0].max() < -0.95
            assert np.abs(normal[inner, 2]).max() < 0.05


def test_haze_before_a_wall_is_moved_to_the_wall():
    rng = np.random.default_rng(0)
    count = 6000
    place = np.column_stack([
        2 - 0.1 * np.abs(rng.standard_normal(count)),
        rng.uniform(-2, 2, count), rng.uniform(0, 2.5, count),
    ]).astype(np.float32)  # fmt: skip
    towards = np.tile([-1.0, 0, 0], (count, 1))
    size, plain = np.full(count, 0.04, np.float32), np.ones(count, np.float32)
    seen = np.full(count, 6, np.uint8)
    moved, upright = walls.to_walls(place, towards, size, plain, seen, [])
    wall = upright.any(axis=1)
    assert wall.mean() > 0.9 and np.abs(upright[wall, 0]).min() > 0.999
    assert np.ptp(moved[wall, 0]) < 0.02 and 1.8 < moved[wall, 0].mean() < 2.0
    ground = place.copy()
    ground[:, 2] = 0
    ground[:, 0] = rng.uniform(-2, 2, count)
    moved, upright = walls.to_walls(ground, towards, size, plain, seen, [])
    assert not upright.any() and np.array_equal(moved, ground)


def ground_seen(bump, textured):
    """Return pictures of a ground with a bump [m] and its height; specks, or none."""
    rng = np.random.default_rng(1)
    cells = 12 * rng.standard_normal((200, 200)) * textured

    def texture(x, y):
        return cells[(np.floor(y / 0.03) % 200).astype(int), (np.floor(x / 0.03) % 200).astype(int)]

    def height(x, y):
        return bump * np.exp(-(x**2 + y**2) / (2 * 0.25**2))

    pictures = []
    for turn_ in np.arange(10) * 2 * np.pi / 10:
        eye = np.array([1.3 * np.cos(turn_), 1.3 * np.sin(turn_), 1.2])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        turning = np.stack([right, np.cross(forward, right), forward])
        width, tall, focal = 240, 180, 260.0
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(tall) + 0.5)
        ray = np.stack([(u - width / 2) / focal, (v - tall / 2) / focal, 1 + 0 * u], -1) @ turning
        z = np.zeros(u.shape)
        for _ in range(6):
            far = (z - eye[2]) / ray[..., 2]
            z = height(eye[0] + far * ray[..., 0], eye[1] + far * ray[..., 1])
        shown = texture(eye[0] + far * ray[..., 0], eye[1] + far * ray[..., 1])
        matrix = np.column_stack([turning, -turning @ eye]).astype(np.float32)
        lens = np.array([focal, focal, width / 2, tall / 2], np.float32)
        pictures.append(sweep.TexturePicture(
            matrix, eye.astype(np.float32), lens, far.astype(np.float32), shown.astype("f4")
        ))  # fmt: skip
    return pictures, height


@pytest.mark.parametrize("textured", [True, False])
def test_heights_come_from_specks_and_from_nothing_else(textured):
    pictures, height = ground_seen(0.015, textured)
    ground = object.__new__(sweep.GroundSweep)
    ground._pictures, ground._guess, ground.thin = pictures, np.zeros((0, 3)), False
    grid = Grid((48, 48), (-0.48, -0.48), 0.02)
    x, y = np.meshgrid(*grid.centres())
    start = np.full(grid.shape, 0.004, np.float32)
    found, smoothed = ground.heights(grid, start, np.ones(grid.shape, bool))
    assert np.isfinite(found).all()
    if textured:
        assert np.median(np.abs(found - height(x, y))) < 1.5e-3
        assert found[24, 24] - found[4, 4] > 0.008 and smoothed.mean() > 0.5
    else:
        assert np.abs(found - start).max() < 2e-3  # nothing to go by: as guessed


def test_a_map_is_swept_where_six_pictures_may_show_it_and_elsewhere_nothing_is_found(yard):
    near, far = Grid((40, 40), (-0.4, -0.4), 0.02), Grid((40, 40), (60.0, -0.4), 0.02)
    assert sweep.can_tell(yard, near, 0.0) and not sweep.can_tell(yard, far, 0.0)
    assert sweep.can_tell(replace(yard, cameras=yard.cameras[:6]), near, 0.0)
    assert not sweep.can_tell(replace(yard, cameras=yard.cameras[:5]), near, 0.0)
    surface = SimpleNamespace(normal=np.zeros((0, 3)), flat=np.zeros(0), position=np.zeros((0, 3)))
    start = np.full(far.shape, 0.004, np.float32)
    height, _ = sweep.GroundSweep(yard, surface).heights(far, start, np.ones(far.shape, bool))
    np.testing.assert_array_equal(height, start)


def test_offsets_that_are_tried_add_up(poisoned):
    pictures, _ = ground_seen(0.0, True)
    place = np.zeros((1, 1, 3), np.float32)
    offsets = np.array([-0.02, 0.0, 0.02], np.float32)
    one = np.ones((1, 1), bool)
    variance, weight, count = sweep.variances(place, sweep.UP, one, offsets, pictures)
    assert (
        weight[0, 0] > 1
        and count[0, 0] == len(pictures)
        and variance[1, 0, 0] < 0.5 * variance[[0, 2], 0, 0].min()
    )
    sums, count = poisoned((3, 3, 1, 1)), np.zeros((1, 1), np.uint16)
    sweep.try_offsets(place, sweep.UP, ~one, offsets, pictures[0], sums, count)
    assert np.isnan(sums).all() and count[0, 0] == 0  # what is not wanted is not touched


@pytest.mark.parametrize("before", ["nothing", "a thing", "no ground"])
def test_a_picture_counts_where_it_shows_ground_all_around(before):
    pictures, _ = ground_seen(0.0, True)
    place, one = np.zeros((1, 1, 3), np.float32), np.ones((1, 1), bool)
    rows, columns = pictures[0].depth.shape
    for picture in pictures:  # beside the middle, where the place is seen
        side = picture.depth[:, columns // 2 + 5 :]
        side[:] = {"nothing": side, "a thing": 0.5, "no ground": side}[before]
        if before == "no ground":
            picture.depth[:, : columns // 2 + 2] = np.inf
            picture.depth[: rows // 2 - 2] = np.inf
    offsets = np.array([-0.02, 0.0, 0.02], np.float32)
    count = sweep.variances(place, sweep.UP, one, offsets, pictures)[2]
    assert count[0, 0] == (len(pictures) if before == "nothing" else 0)


@pytest.mark.parametrize("count", [5, 10])
def test_few_cameras_leave_the_ground_as_the_splats_have_it(count):
    pictures, height = ground_seen(0.015, True)
    ground = object.__new__(sweep.GroundSweep)
    ground._pictures, ground._guess, ground.thin = pictures[:count], np.zeros((0, 3)), False
    grid = Grid((48, 48), (-0.48, -0.48), 0.02)
    start = height(*np.meshgrid(*grid.centres())).astype(np.float32) + np.float32(0.004)
    change = ground.heights(grid, start, np.ones(grid.shape, bool))[0] - start
    assert np.abs(change).max() < 1e-6 if count == 5 else np.median(change) < -0.003


def test_dark_splats_take_the_values_of_dark_places():
    x = np.arange(-0.4, 0.4, 0.04, dtype=np.float32)
    place = np.stack([*np.meshgrid(x, x), np.zeros((20, 20), "f4")], -1).reshape(-1, 3)
    dark = place[:, 0] < 0
    light = np.where(dark, 0.05, 0.4).astype("f4")[:, None] * np.ones(3, "f4")
    one = np.ones(len(place), np.float32)
    near = np.zeros((len(place), 1), np.int32)
    surface = Surface(place, 0 * place, one, light, near, one)
    values = np.where(dark, 4.0, 0.5).astype("f4")[:, None]
    at = np.array([[0.01, 0, 0.02], [0.01, 0, 0.02], [5, 5, 5]], np.float32)
    own = np.array([0.05, 0.4, 0.4], "f4")[:, None] * np.ones(3, "f4")
    found, known = carried(surface, 0.04, values, at, own)
    assert found[0, 0] > 3 and found[1, 0] < 0.7 and known.tolist() == [True, True, False]


def test_normals_are_turned_and_others_are_kept(yard):
    splats = yard.splats.take(slice(0, 300))
    prepared = prepare(splats)
    before = prepared.geometry.reshape(-1, GEOMETRY, LANES)[:, 9:12].copy()
    share = np.zeros(300, np.float32)
    share[::2] = 1
    turn(prepared, np.tile(np.float32([0.6, 0.8, 0]), (300, 1)), share)
    after = prepared.geometry.reshape(-1, GEOMETRY, LANES)[:, 9:12]
    rows = after.transpose(0, 2, 1).reshape(-1, 3)[:300]
    old = before.transpose(0, 2, 1).reshape(-1, 3)[:300]
    turned = share[prepared.order] == 1
    assert np.abs(rows[turned] @ [0.6, 0.8, 0]).min() > 0.9999
    np.testing.assert_allclose(rows[~turned], old[~turned], atol=1e-6)


def test_haze_far_from_every_place_faces_the_cameras_upright(yard):
    rng = np.random.default_rng(4)
    place = np.column_stack([rng.uniform(-1, 1, (400, 2)), np.zeros(400)]).astype(np.float32)
    up = np.tile(np.float32([0, 0, 1]), (400, 1))
    size = np.full(400, 0.04, np.float32)
    surface = fuse.CaptureSurface(place, up, 0 * size + 1, 0 * place, size, np.zeros(400, "u1"))
    at = np.float32([[0, 0, 0.02], [0, 0, 0.6], [0, 4, 2], [3, 4, 0]])
    frame = yard.ground_frame
    splats = yard.splats.take(np.arange(4))
    scene = replace(yard, splats=replace(splats, position=frame.to_capture(at).astype("f4")))
    seen = SimpleNamespace(surface=surface, middle=np.float32([0, 0, 1.5]))
    sky = np.zeros(4, bool)
    normal, share = kept_surface.splat_normals(scene, seen, sky)
    normal = normal @ frame.rotation.T
    np.testing.assert_allclose(share[1:], [1, 1, 1], atol=0.01)
    assert share[0] > 0.8
    np.testing.assert_allclose(normal[0], (0, 0, 1), atol=1e-3)
    np.testing.assert_allclose(normal[2:], [(0, -1, 0), (-0.6, -0.8, 0)], atol=1e-3)
    one = surface._replace(**{name: value[:1] for name, value in surface._asdict().items()})
    alone = SimpleNamespace(surface=one, middle=seen.middle)
    assert np.isfinite(kept_surface.splat_normals(scene, alone, sky)[0]).all()
    sky[2] = True  # that of a sky that stays is not wetted
    normal, share = kept_surface.splat_normals(scene, seen, sky)
    np.testing.assert_allclose((normal @ frame.rotation.T)[2], (0, 0, -1), atol=1e-6)
    assert share[2] == 1


def test_a_far_white_house_stays_and_what_the_sky_hides_goes(yard):
    def grid(x, y, z, scale, color, opacity=0.97):
        place = np.stack(np.meshgrid(x, y, z), -1).reshape(-1, 3)
        return factories.splats(place, scale=scale, opacity=opacity, color=color)

    ground = grid(np.arange(2, 60, 4), np.arange(-40, 41, 4), [-0.5], 2, (0.3, 0.25, 0.2))
    house = grid([66], np.arange(-12, 13, 2), np.arange(0, 15, 2), 1, (0.95, 0.95, 0.94))
    dome = grid([70], np.arange(-35, 36, 5), np.arange(0, 46, 5), 3, (0.6, 0.75, 0.95))
    needle = grid([74], [-20, 12], [25], 1, (0.7, 0.1, 0.6))
    cloud = grid([71], [20.0], [30.0], 1, (0.95, 0.95, 0.96), 0.01)  # no camera makes it out
    parts = ground, house, dome, needle, cloud
    cameras = tuple(looking((0, 0.4 * k, 1.6), (40, 0, 9), 96, 72) for k in range(10))
    frame = replace(yard.ground_frame, rotation=np.eye(3), meters_per_unit=1.0,
                    translation=np.zeros(3))  # fmt: skip
    scene = replace(yard, splats=joined(parts), cameras=cameras, ground_frame=frame)
    found = kept_surface.find_surface(scene)
    own = np.split(backdrop.sky_of(scene, found), np.cumsum([len(p) for p in parts])[:-1])
    assert not own[0].any() and not own[1].any() and own[3].all() and own[4].all()
    seen = np.abs(dome.position[:, 1]) < 25
    assert own[2][seen & (dome.position[:, 2] > 20) & (dome.position[:, 2] < 35)].all()
    blind = np.split(backdrop.sky_of(scene), np.cumsum([len(p) for p in parts])[:-1])
    assert blind[1].mean() > 0.9 and not blind[3].any()  # by distance alone


def test_what_the_sky_hides_goes_unless_cameras_see_it(yard):
    speck = [0, 0, 0.1, 1.5]  # px: on land, on sky, beside the sky; and if there were no sky
    slate = [15, 1, 0, 18]
    light = np.float64([speck, speck, [1.0, 0, 0.5, 1.5], [0, 1.4, 0, 1.5], slate, slate])
    lit, veiled = np.int16([[0, 1, 1, 0, 4, 1], [1, 1, 1, 0, 2, 2]])
    scene = replace(yard, splats=factories.splats([[0, 9, 3]] * 6, scale=0.01, color=(0.1, 0, 0)))
    colors = SimpleNamespace(at=lambda way: 0 * way, off=lambda color, way: 3 + 0 * way[:, 0])
    lens = [SimpleNamespace(lens=(100,))]

    def told(alone):
        where = np.float32([[0, 9, 3]] * 6), alone, np.zeros(3, "f4")
        return kept_surface._sky_splats(scene, lens, colors, *where, light, lit, veiled)

    found, aloft = told(np.ones(6, bool))
    assert found.tolist() == [True, False, False, False, False, True]
    assert aloft.tolist() == [True, True, False, True, False, False]
    # The colour of the sky where no surface is: the sky is seen among leaves that hide most of it.
    colors.off = lambda color, way: 0.1 + 0 * way[:, 0]
    assert told(np.arange(6) > 3)[1].tolist() == [True, True, False, True, True, True]


def test_few_splats_have_no_surface(yard):
    assert kept_surface.kept_surface(replace(yard, splats=yard.splats.take(slice(0, 20)))) is None


def test_it_is_kept_for_the_next_run(yard, found, tmp_path, monkeypatch):
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path))
    monkeypatch.setattr(kept_surface, "_last", [None, None])
    monkeypatch.setattr(kept_surface, "find_surface", lambda scene, step: found)
    kept_surface.kept_surface(yard)
    monkeypatch.setattr(kept_surface, "_last", [None, None])
    monkeypatch.setattr(kept_surface, "find_surface", None)  # to call it would be an error
    again = kept_surface.kept_surface(yard)
    for name, values in found.surface._asdict().items():
        np.testing.assert_array_equal(getattr(again.surface, name), values)
    np.testing.assert_array_equal(again.solid, found.solid)
    assert again.half == found.half
    sky = np.zeros(len(yard.splats), bool)
    normals = kept_surface.kept_normals(yard, found, sky)
    monkeypatch.setattr(kept_surface, "splat_normals", None)
    for values, kept in zip(normals, kept_surface.kept_normals(yard, found, sky), strict=True):
        np.testing.assert_array_equal(kept, values)


def test_cameras_are_made_up_where_there_are_none(yard):
    bare = replace(yard, cameras=())
    position = yard.ground_frame.to_ground(yard.splats.position)
    middle, half = views.window_of(position, ())
    made = views.cameras_of(bare, middle, half)
    assert len(made) == len(views.RINGS) * views.ON_RING
    assert len(views.cameras_of(yard, middle, half)) == len(yard.cameras) == views.FEWEST_CAMERAS
    few = replace(yard, cameras=yard.cameras[:4])
    assert len(views.cameras_of(few, middle, half)) == 4 + len(made)
    # Splats of a sky far away, somewhat less than half of all, change little of what is looked at.
    sky = 30 + np.zeros((int(0.8 * len(position)), 3))
    wide = views.window_of(np.concatenate([position, sky]), ())[1]
    assert half <= wide < 2.5 * half


def test_views_are_counted(poisoned):
    light = np.full((40, 40, 3), 0.3, np.float32)
    view = view_of(light)
    place = np.array([[5, 0, 0], [3, 0, 0], [8, 0, 0], [-5, 0, 0]], np.float32)
    found = fuse.counted(place, np.full(4, 0.04, np.float32), [view, view])
    assert found.tolist() == [[2, 0, 0], [0, 2, 0], [0, 0, 2], [0, 0, 0]]
    assert SimpleNamespace(**view._asdict()).plain.min() == 1
