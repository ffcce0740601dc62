"""Splatting against closed forms and against float64 blending in plain loops."""

import dataclasses
import functools
import tracemalloc

import numpy as np
import pytest

import factories
import naive
from rainsim import raster
from rainsim.constants import SH_0
from rainsim.errors import ParameterError
from rainsim.jit import set_threads
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import Camera, Splats
from rainsim.splatting.tiles import DIGITS, MANY, RECORD_MASK, sort_keys

decibel = functools.partial(naive.decibel, peak=1.0)


def camera(width=64, height=48, focal=60.0, **kwargs):
    return Camera(
        width, height, focal, focal * 1.05, width / 2 + 1.5, height / 2 - 0.7, np.eye(4), **kwargs
    )


def one_splat(position=(0, 0, 4.0), scale=(0.3, 0.2, 0.1), opacity=0.8, color=0.7):
    return factories.splats([position], scale=scale, opacity=opacity, color=color)


def cloud(rng, n=400, bands=16):
    rotation = rng.normal(size=(n, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    position = rng.uniform((-3, -2, -1), (3, 2, 9), (n, 3))
    scale, opacity = np.exp(rng.normal(-2.5, 0.8, (n, 3))), rng.uniform(0, 1, n)
    return factories.splats(position, rotation, scale, opacity, rng.normal(0, 0.25, (n, bands, 3)))


def draw(splats, cam, near=0.2):
    return raster.rasterize(raster.prepare(splats), cam, near)


def test_one_splat_has_its_closed_form():
    cam = Camera(33, 33, 50.0, 50.0, 16.5, 16.5, np.eye(4))
    splats = one_splat(scale=(0.3, 0.3, 0.3), opacity=0.8, color=0.7)
    layers = draw(splats, cam)
    variance = (50 / 4 * 0.3) ** 2 + 0.3
    x, y = np.meshgrid(np.arange(33) - 16, np.arange(33) - 16)
    alpha = 0.8 * np.exp(-(x * x + y * y) / 2 / variance)
    alpha[alpha < 1 / 255] = 0
    np.testing.assert_allclose(layers.alpha, alpha, atol=3e-6)
    np.testing.assert_allclose(layers.color[..., 1], 0.7 * alpha, atol=3e-6)
    assert layers.depth[16, 16] == pytest.approx(4.0, abs=1e-5)
    assert np.isinf(layers.depth[0, 0]) and layers.alpha[0, 0] == 0


@pytest.mark.parametrize("bands", [1, 4, 9, 16])
@pytest.mark.parametrize("orthographic", [False, True])
def test_agrees_with_float64_blending(rng, bands, orthographic):
    splats = cloud(rng, bands=bands)
    cam = camera(orthographic=orthographic, focal=9.0 if orthographic else 60.0)
    layers = draw(splats, cam)
    color, alpha, depth = naive.splat_image(splats, cam, 0.2)
    assert alpha.max() > 0.9
    assert decibel(layers.color, color) > 90
    assert decibel(layers.alpha, alpha) > 90
    solid = alpha > 0.5
    assert np.percentile(np.abs(layers.depth[solid] / depth[solid] - 1), 99) < 1e-4


@pytest.mark.parametrize("orthographic", [False, True])
def test_depths_normals_and_hits_agree_with_float64(rng, orthographic):
    splats = cloud(rng, 600, 1)
    cam = camera(orthographic=orthographic, focal=9.0 if orthographic else 60.0)
    exact = naive.splat_layers(splats, cam, 0.2)
    prepared = raster.prepare(splats)
    layers = raster.rasterize(prepared, cam, 0.2, hit=True)
    halves = raster.rasterize(prepared, cam, 0.2, depth="median", hit=True)
    solid = exact["alpha"] > 0.5
    assert solid.mean() > 0.3
    for got, name in (
        (layers.depth, "depth"), (layers.plane_depth, "plane_depth"), (halves.depth, "median"),
    ):  # fmt: skip
        # What adds 1/255 to a pixel may fall on either side in float32: two pixels are let off.
        assert np.sort(np.abs(got[solid] / exact[name][solid] - 1))[-3] < 1e-4, name
        assert np.abs(got[solid] / exact["depth"][solid] - 1).max() > 0.01 or name == "depth"
    across = np.linalg.norm(np.cross(layers.normal, exact["normal"]), axis=-1)[solid]
    assert np.degrees(np.arcsin(np.sort(across)[-3])) < 0.1
    assert (np.einsum("ijk,ijk->ij", layers.normal, exact["normal"])[solid] > 0).all()
    for hit in (layers.hit, halves.hit):
        assert (hit != exact["hit"]).sum() <= 2
    assert len(np.unique(layers.hit)) > 50 and layers.hit.dtype == np.int32
    assert raster.rasterize(prepared, cam, 0.2).hit is None


def test_background_is_blended_with_what_is_left_of_the_light(rng):
    prepared, cam = raster.prepare(cloud(rng, 100, 1)), camera()
    black = raster.rasterize(prepared, cam, 0.2)
    over = raster.rasterize(prepared, cam, 0.2, background=(0.2, 0.5, 0.9))
    clear = 1 - black.alpha
    assert clear.max() == 1 and clear.min() < 0.1
    np.testing.assert_allclose(over.color - black.color, clear[..., None] * (0.2, 0.5, 0.9),
                               atol=1e-6)  # fmt: skip
    np.testing.assert_array_equal(over.alpha, black.alpha)


def test_the_last_splat_is_dropped_as_the_training_codes_do(rng):
    """One opaque splat behind another would leave 1e-6 of the light; a faint one behind counts."""
    cam = Camera(33, 33, 50.0, 50.0, 16.5, 16.5, np.eye(4))
    parts = [one_splat((0, 0, z), (9, 9, 0.01), o, c)
             for z, o, c in ((3, 0.99, 0.2), (4, 0.995, 1.0), (5, 0.5, 1.0))]  # fmt: skip
    stack = joined(parts)
    prepared = raster.prepare(stack)
    plain = raster.rasterize(prepared, cam, 0.2)
    dropped = raster.rasterize(prepared, cam, 0.2, drop_last=True, background=(1, 0, 0), hit=True)
    at = (16, 16)
    assert plain.alpha[at] == pytest.approx(1 - 0.01 * 0.005 * 0.5, abs=1e-6)
    assert plain.color[at][1] == pytest.approx(0.99 * 0.2 + 0.01 * 0.995, abs=5e-5)
    assert dropped.alpha[at] == pytest.approx(0.99, abs=1e-5)
    assert dropped.color[at] == pytest.approx([0.99 * 0.2 + 0.01, 0.99 * 0.2, 0.99 * 0.2], abs=1e-5)
    assert dropped.hit[at] == 0
    splats = cloud(rng, 3000, 1)
    splats = dataclasses.replace(splats, opacity=np.sqrt(splats.opacity))
    exact = naive.splat_layers(splats, camera(), 0.2, drop_last=True)
    got = raster.rasterize(raster.prepare(splats), camera(), 0.2, drop_last=True)
    assert decibel(got.color, exact["color"]) > 90 and decibel(got.alpha, exact["alpha"]) > 90
    assert decibel(draw(splats, camera()).color, exact["color"]) < 75


def test_splats_a_millionth_of_their_depth_apart_keep_their_order():
    """Float32 alone gives depths near 8 in steps of 1e-6: the order would be that of the scene."""
    cam = dataclasses.replace(camera(), camera_from_world=np.eye(4))
    cam.camera_from_world[2, 3] = 7.3
    parts = [one_splat((0, 0, 0.7 + 1e-7 * k), (9, 9, 0.01), 0.9, c)
             for k, c in ((2, 0.2), (1, 0.5), (0, 1.0))]  # fmt: skip
    stack = joined(parts)
    assert len(np.unique(stack.position[:, 2])) == 3
    assert draw(stack, cam).color[24, 32, 0] == pytest.approx(
        0.9 + 0.09 * 0.5 + 9e-3 * 0.2, abs=1e-3
    )


@pytest.mark.parametrize("size", [(1, 1), (15, 17), (16, 16), (70, 33)])
def test_any_picture_size(rng, size):
    splats = cloud(rng, 60, 4)
    cam = camera(*size)
    color, _, _ = naive.splat_image(splats, cam, 0.2)
    assert decibel(draw(splats, cam).color, color) > 85


def test_rotated_and_rescaled_scene_with_the_inverse_camera(rng):
    """SH degree 0, for colour would have to be rotated too; the geometry must not care."""
    splats = cloud(rng, 300, 1)
    q = rng.normal(size=4)
    turn = naive.quaternion_matrix(q)
    q = q / np.linalg.norm(q)
    size, shift = 3.7, np.array([5.0, -2.0, 11.0])
    w, x, y, z = splats.rotation.T.astype(float)
    a, b, c, d = q
    turned = np.stack([
        a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w,
    ], axis=1)  # fmt: skip
    other = Splats(
        (splats.position @ turn.T * size + shift).astype(np.float32), turned.astype(np.float32),
        splats.scale * np.float32(size), splats.opacity, splats.sh,
    )  # fmt: skip
    cam = camera()
    matrix = np.eye(4)
    matrix[:3, :3] = turn.T
    matrix[:3, 3] = -turn.T @ shift
    moved = dataclasses.replace(cam, camera_from_world=matrix)
    one, two = draw(splats, cam, 0.2), draw(other, moved, 0.2 * size)
    assert decibel(one.color, two.color) > 80
    solid = one.alpha > 0.5
    np.testing.assert_allclose(two.depth[solid], one.depth[solid] * size, rtol=1e-4)


def test_same_bytes_on_one_and_two_threads(rng):
    prepared = raster.prepare(cloud(rng, 3000, 16))
    try:
        set_threads(1)
        one = raster.rasterize(prepared, camera(), 0.2, hit=True)
        set_threads(2)
        two = raster.rasterize(prepared, camera(), 0.2, hit=True)
    finally:
        set_threads(2)
    for field in dataclasses.fields(one):
        assert getattr(one, field.name).tobytes() == getattr(two, field.name).tobytes(), field.name
    assert one.alpha.max() > 0.9 and len(np.unique(one.hit)) > 50


def test_every_pixel_is_written_and_working_memory_is_reused(rng):
    drawer = raster.Rasterizer(raster.prepare(cloud(rng, 500, 4)))
    first = drawer.draw(camera(), 0.2)
    drawer.draw(camera(20, 20), 0.2)
    again = drawer.draw(camera(), 0.2)
    assert np.isfinite(first.color).all() and np.isfinite(first.alpha).all()
    assert not np.isnan(first.depth).any() and not np.isnan(first.plane_depth).any()
    assert first.color.tobytes() == again.color.tobytes()
    assert first.alpha.max() > 0.5


@pytest.mark.parametrize(
    "change",
    [
        {"position": (0, 0, -4.0)},
        {"position": (np.nan, 0, 4.0)},
        {"opacity": 0.0},
        {"opacity": np.nan},
        {"scale": (np.nan, 1, 1)},
        {"scale": (np.inf, 1, 1)},
        {"color": np.nan},
        {"color": np.inf},
        {"position": (0, 0, 0.05)},
    ],
)
def test_what_cannot_be_seen_leaves_the_picture_black(change):
    layers = draw(one_splat(**change), camera())
    assert not layers.color.any() and not layers.alpha.any() and np.isinf(layers.depth).all()


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (np.nan, 0, 0, 0), (np.inf, 0, 0, 1)])
def test_a_splat_without_a_direction_is_not_drawn(quaternion):
    bad = dataclasses.replace(one_splat(), rotation=np.array([quaternion], np.float32))
    assert not draw(bad, camera()).alpha.any()


def test_broken_splats_leave_the_others_alone(rng):
    """One splat of each kind among good ones in one chunk: the picture is that of the good ones."""
    splats = cloud(rng, 200, 16)
    clean = draw(splats, camera())
    spoilt = splats.take(np.concatenate([np.arange(200), np.arange(7)]))
    spoilt.position[200] = np.nan
    spoilt.rotation[201] = 0
    spoilt.scale[202] = np.inf
    spoilt.opacity[203] = np.nan
    spoilt.sh[204, 0, 0] = np.nan
    spoilt.sh[205, 2, 1] = np.inf
    spoilt.sh[206, 14, 2] = -np.inf
    drawn = draw(spoilt, camera())
    assert decibel(drawn.color, clean.color) > 110 and np.isfinite(drawn.color).all()
    np.testing.assert_allclose(drawn.alpha, clean.alpha, atol=1e-6)
    kept = raster.select(raster.prepare(spoilt), np.ones(207, bool))
    assert decibel(raster.rasterize(kept, camera(), 0.2).color, clean.color) > 90


def test_quaternions_of_any_length_mean_the_same(rng):
    splats = cloud(rng, 200, 1)
    length = rng.uniform(0.01, 50, (200, 1)).astype(np.float32)
    longer = dataclasses.replace(splats, rotation=splats.rotation * length)
    assert decibel(draw(longer, camera()).color, draw(splats, camera()).color) > 110


def test_splats_across_the_near_plane_agree_with_float64(rng):
    splats = cloud(rng, 600, 1)
    splats.position[:] = rng.uniform((-0.4, -0.3, 0.1), (0.4, 0.3, 0.6), (600, 3))
    splats.scale[:] *= 0.3
    color, alpha, _ = naive.splat_image(splats, camera(), 0.2)
    behind = splats.position[:, 2] < 0.2
    assert 50 < behind.sum() < 300 and alpha.max() > 0.9
    assert decibel(draw(splats, camera()).color, color) > 85
    assert decibel(draw(splats, camera(), 0.01).color, color) < 40


def test_opacity_one_is_capped_and_what_is_behind_shows_a_thousandth():
    cam = Camera(33, 33, 50.0, 50.0, 16.5, 16.5, np.eye(4))
    parts = [one_splat((0, 0, z), (9, 9, 0.01), 1.0, c) for z, c in ((3, 0.1), (5, 0.9))]
    stack = joined(parts)
    layers = draw(stack, cam)
    assert layers.color[16, 16, 0] == pytest.approx(0.999 * 0.1 + 0.001 * 0.999 * 0.9, abs=1e-6)
    assert layers.alpha[16, 16] == pytest.approx(1 - 1e-6, abs=2e-7)


def test_splat_that_fills_the_picture():
    layers = draw(one_splat(scale=(1e4, 1e4, 1e-3), opacity=1.0, color=0.6), camera())
    np.testing.assert_allclose(layers.color, 0.6 * 0.999, atol=1e-4)
    np.testing.assert_allclose(layers.depth, 4.0, rtol=1e-4)


def test_empty_scene_and_a_million_at_one_point():
    empty = one_splat().take(np.zeros(0, int))
    assert not draw(empty, camera()).alpha.any()
    many = one_splat(opacity=0.02).take(np.zeros(1_000_000, int))
    layers = draw(many, camera())
    assert layers.alpha[24, 32] > 0.9998 and np.isfinite(layers.color).all()


def test_points_with_zero_scale_are_pixels():
    layers = draw(one_splat(scale=(0, 0, 0), opacity=1.0), camera())
    assert 0 < (layers.alpha > 0).sum() < 30


def test_compensation_keeps_the_light_of_what_the_low_pass_widens():
    """Mip-Splatting: alpha times the root of the areas' ratio; big splats hardly change."""
    cam = Camera(33, 33, 50.0, 50.0, 16.5, 16.5, np.eye(4))
    for size, near_one in ((0.01, False), (2.0, True)):
        splats = one_splat(scale=(size, size, size), opacity=0.9)
        prepared = raster.prepare(splats)
        plain = raster.rasterize(prepared, cam, 0.2).alpha[16, 16]
        weaker = raster.rasterize(prepared, cam, 0.2, compensate=True).alpha[16, 16]
        area = (50 / 4 * size) ** 2
        assert weaker / plain == pytest.approx(area / (area + 0.3), rel=1e-4)
        assert (weaker / plain > 0.99) == near_one


def test_cutting_at_a_plane_leaves_what_is_above(rng):
    splats = cloud(rng, 300, 1)
    prepared = raster.prepare(splats)
    plane = np.array([0.2, -0.9, 0.1, 0.3])
    cut = raster.rasterize(prepared, camera(), 0.2, plane=plane)
    kept = splats.take(splats.position @ plane[:3].astype(np.float32) >= plane[3])
    assert 20 < len(kept) < 280
    assert decibel(cut.color, draw(kept, camera()).color) > 100


def test_lower_degrees_of_harmonics_are_those_of_a_truncated_scene(rng):
    splats = cloud(rng, 200, 16)
    prepared = raster.prepare(splats)
    for degree in (0, 1, 2):
        fewer = dataclasses.replace(
            splats, sh=np.ascontiguousarray(splats.sh[:, : (degree + 1) ** 2])
        )
        one = raster.rasterize(prepared, camera(), 0.2, degree=degree).color
        assert decibel(one, draw(fewer, camera()).color) > 110
        assert decibel(one, draw(splats, camera()).color) < 60


def test_the_light_of_a_splat_is_what_it_adds_to_each_part_of_the_picture(rng):
    """One splat white, all others black: what is drawn is its light."""
    splats, view = cloud(rng, 60, 1), camera()
    part = np.zeros((view.height, view.width), np.int8)
    part[:20], part[20:30, 7:] = -1, 1
    light = raster.Rasterizer(raster.prepare(splats)).weigh(view, 0.01, part)
    assert light.shape == (60, 4)
    light, whole = light[:, :3], light[:, 3]
    drawn = np.zeros((60, 3))
    for k in range(60):
        sh = np.full_like(splats.sh, -0.5 / SH_0)
        sh[k] *= -1
        alone = dataclasses.replace(splats, sh=sh)
        picture = raster.rasterize(raster.prepare(alone), view).color[..., 0]
        drawn[k] = [picture[part == which].sum() for which in (-1, 1, 0)]
    assert np.abs(light - drawn).max() < 1e-3 * drawn.max()
    assert (drawn.max(axis=0) > 1).all()
    alone = raster.Rasterizer(raster.prepare(splats.take(np.array([7])))).weigh(view, 0.01, part)
    assert whole[7] == pytest.approx(alone[0, 1], rel=1e-5) and (whole >= 0.999 * light[:, 1]).all()
    some = raster.Rasterizer(raster.prepare(splats)).weigh(view, 0.01, part, 2)[:, :3]
    assert abs(some.sum() / light.sum() - 1) < 0.02


def test_selecting_prepared_splats_is_preparing_selected_ones(rng):
    splats = cloud(rng, 1000, 4)
    prepared = raster.prepare(splats)
    np.testing.assert_array_equal(prepared.position, splats.position[prepared.order])
    keep = prepared.position[:, 2] > 3
    some = raster.select(prepared, keep)
    assert len(some) == keep.sum()
    np.testing.assert_array_equal(some.position, prepared.position[keep])
    expected = draw(splats.take(splats.position[:, 2] > 3), camera())
    assert decibel(raster.rasterize(some, camera(), 0.2).color, expected.color) > 110


@pytest.mark.parametrize("seed", range(6))
def test_leaving_out_chunks_changes_nothing(seed):
    """Chunks far out, near the eye, and across the picture's edges; cameras within the cloud."""
    rng = np.random.default_rng(seed)
    splats = cloud(rng, 4000, 1)
    turn = naive.quaternion_matrix(rng.normal(size=4))
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    matrix[:3, 3] = -turn @ rng.uniform((-3, -2, -1), (3, 2, 9))
    cam = dataclasses.replace(camera(48, 32, 40.0), camera_from_world=matrix)
    color, _, _ = naive.splat_image(splats, cam, 0.2)
    assert decibel(draw(splats, cam).color, color) > 85


def test_thin_slanted_splats_reach_every_pixel_they_should(rng):
    """The block test is conservative: needles at all angles, one at a time."""
    cam = camera(64, 64, 60.0)
    for angle in np.linspace(0, np.pi, 13):
        needle = one_splat((0.05, -0.03, 4.0), (2.0, 0.01, 0.01), 0.95)
        q = np.array([[np.cos(angle / 2), 0, 0, np.sin(angle / 2)]], np.float32)
        needle = dataclasses.replace(needle, rotation=q)
        color, _, _ = naive.splat_image(needle, cam, 0.2)
        assert decibel(draw(needle, cam).color, color) > 95


def test_unknown_depth_mode_is_told():
    with pytest.raises(ParameterError, match="expected, median"):
        raster.rasterize(raster.prepare(one_splat()), camera(), depth="nearest")


def nbytes(*arrays):
    return sum(a.nbytes for a in arrays)


def test_memory_on_top_of_the_splats_own_arrays(rng):
    """SH 3, all splats in sight: what is prepared and what a picture works with."""
    splats = cloud(rng, 40_000)
    splats.position[:, 2] += 6
    own = nbytes(*(getattr(splats, name) for name in splats.__slots__))
    tracemalloc.start()
    try:
        drawer = raster.Rasterizer(raster.prepare(splats))
        held, peak = (n / own for n in tracemalloc.get_traced_memory())
        drawer.draw(camera(), 0.2)
    finally:
        tracemalloc.stop()
    p = drawer.prepared
    prepared = nbytes(p.geometry, p.sh, p.fine, p.step, p.box, p.order) / own
    assert 0.7 < prepared < 0.8 and held < 0.8 and peak < 1.3
    working = nbytes(drawer._record, drawer._box, drawer._lane, drawer._entry) / own
    assert 0.2 < working and prepared + working < 1.3


def test_harmonics_come_back_within_half_a_step(rng):
    splats = cloud(rng, 700)
    prepared = raster.prepare(splats)
    assert prepared.degree == 3 and prepared.fine.dtype == np.int16
    back = prepared.harmonics().transpose(0, 2, 1).reshape(-1, 16, 3)[:700]
    wanted = splats.sh[prepared.order]
    np.testing.assert_array_equal(back[:, :4], wanted[:, :4])
    error = np.abs(back[:, 4:] - wanted[:, 4:])
    assert 0 < error.max() <= 0.51 * prepared.step.max() and prepared.step.max() < 5e-5
    splats.sh[5, 9, 1] = np.inf
    spoilt = raster.prepare(splats).harmonics()
    assert np.isfinite(spoilt).all() and abs(spoilt).max() < 2
    for bands, degree in ((1, 0), (4, 1), (9, 2)):
        fewer = dataclasses.replace(splats, sh=np.ascontiguousarray(wanted[:, :bands]))
        assert raster.prepare(fewer).degree == degree


def test_many_splats_in_one_place_are_sorted_as_soon_as_any(rng):
    n = MANY + 100
    depth = np.concatenate([[1e-3, 50.0], 2.0 + 1e-6 * rng.random(n - 2)])  # one range of 16 bits
    bits = depth.view(np.uint64) << np.uint64(1) & ~RECORD_MASK
    key = bits | np.arange(n, dtype=np.uint64)
    key[5], key[n // 2] = key[7] & ~RECORD_MASK | np.uint64(5), key[7]  # ties
    expected = np.sort(key)
    sort_keys(key, np.empty_like(key), np.empty(DIGITS, np.int64), n)
    np.testing.assert_array_equal(key, expected)
