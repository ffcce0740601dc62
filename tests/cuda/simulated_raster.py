"""The splatting twin in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import functools
import inspect

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import naive
from rainsim import raster
from rainsim.actors.actor import Actor
from rainsim.actors.motion import Track
from rainsim.cuda import raster as twin
from rainsim.cuda import simulated
from rainsim.cuda.splatting import prepared as on_device
from rainsim.cuda.splatting.prepared import ROW, DeviceSplats
from rainsim.render.actor_splats import ActorSplats
from rainsim.scene.types import Camera, Splats
from rainsim.splatting.detail import Detail
from rainsim.splatting.merged import Merger

assert simulated()
decibel = functools.partial(naive.decibel, peak=1.0)
# Plain numpy numbers warn where a GPU's do not; kernels divide by zero and choose afterwards.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


def camera(width=24, height=17, focal=22.0, **kwargs):
    return Camera(
        width, height, focal, focal * 1.05, width / 2 + 1.5, height / 2 - 0.7, np.eye(4), **kwargs
    )


def cloud(n=60, bands=16, seed=3):
    rng = np.random.default_rng(seed)
    rotation = rng.normal(size=(n, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    return Splats(
        rng.uniform((-3, -2, -1), (3, 2, 9), (n, 3)).astype(np.float32),
        rotation.astype(np.float32), np.exp(rng.normal(-1.5, 0.8, (n, 3))).astype(np.float32),
        rng.uniform(0, 1, n).astype(np.float32),
        rng.normal(0, 0.25, (n, bands, 3)).astype(np.float32),
    )  # fmt: skip


def assert_alike(layers, wanted, least=80):
    assert wanted.alpha.max() > 0.9
    assert decibel(layers.color, wanted.color) > least
    assert decibel(layers.alpha, wanted.alpha) > least
    assert decibel(layers.normal, wanted.normal) > 60
    np.testing.assert_array_equal(np.isinf(layers.depth), np.isinf(wanted.depth))
    seen = np.isfinite(wanted.depth)
    np.testing.assert_allclose(layers.depth[seen], wanted.depth[seen], rtol=1e-3)
    np.testing.assert_allclose(layers.plane_depth[seen], wanted.plane_depth[seen], rtol=2e-2)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"plane": (0.0, 1.0, 0.2, 0.3)},
        {"depth": "median"},
        {"compensate": True},
        {"background": (0.2, 0.9, 0.4)},
    ],
)
def test_the_twin_draws_what_the_cpu_draws(options):
    prepared = raster.prepare(cloud())
    wanted = raster.rasterize(prepared, camera(), 0.2, **options)
    assert_alike(twin.rasterize(prepared, camera(), 0.2, **options), wanted)
    plain = raster.rasterize(prepared, camera(), 0.2)
    if "background" in options:
        assert decibel(plain.color, wanted.color) < 40
    elif options:
        assert decibel(plain.depth[8:], wanted.depth[8:]) < 80


@pytest.mark.parametrize("options", [{}, {"leading": True}, {"plane": (0.0, 1.0, 0.2, 0.3)}])
def test_levels_of_detail_are_those_of_the_cpu(options):
    splats, last = cloud(500), np.zeros(500, bool)
    splats.scale[:] *= 0.1
    last[450:] = True
    prepared = Detail(raster.prepare(splats, last), (0.5, 1.0, 2.0)).drawn
    drawer = twin.Rasterizer(prepared)
    assert len(prepared.box) > 3
    for detail in (0.0, 30.0):
        wanted = raster.rasterize(prepared, camera(), 0.2, detail=detail, **options)
        found = drawer.draw(camera(), 0.2, detail=detail, **options)
        assert_alike(found, wanted, least=60)
    plain = raster.rasterize(prepared, camera(), 0.2, **options)
    assert decibel(plain.color, wanted.color) < 40  # of the two, the coarser one


def test_hits_are_those_of_the_cpu(monkeypatch):
    prepared = raster.prepare(cloud(150))
    wanted = raster.rasterize(prepared, camera(), 0.2, hit=True)
    found = twin.rasterize(prepared, camera(), 0.2, hit=True)
    np.testing.assert_array_equal(found.hit, wanted.hit)
    assert_alike(found, wanted)
    assert len(np.unique(found.hit)) > 20
    empty = twin.rasterize(raster.prepare(cloud(2)), camera(), 0.2, hit=True).hit
    assert (empty == -1).mean() > 0.5
    for module in (on_device, twin):  # as if a float32 told fewer numbers apart
        monkeypatch.setattr(module, "MOST_NUMBERS", 10)
    drawer = twin.Rasterizer(prepared)
    assert len(drawer.splats.divisors()) == 3
    np.testing.assert_array_equal(drawer.draw(camera(), 0.2, hit=True).hit, wanted.hit)


def test_actors_before_a_static_set_are_those_of_the_cpu():
    """Only their chunks are sent, and none of a moment before is left."""
    still, moving = cloud(60), cloud(300, seed=4)
    for splats in (still, moving):
        splats.scale[:] *= 0.3
    still = raster.prepare(still)
    merger = Merger(still, len(moving))
    drawer = twin.Rasterizer(DeviceSplats(still, 2))
    alone = raster.rasterize(still, camera(), 0.2)
    static = drawer.splats.geometry.copy_to_host()[2 * ROW :]
    for count in (300, 80, 0):
        actors = raster.prepare(moving.take(np.arange(300) < count)) if count else None
        merged = merger.merged(actors, len(still))
        drawer.put_actors(merged)
        wanted = raster.rasterize(merged, camera(), 0.2, hit=True)
        found = drawer.draw(camera(), 0.2, hit=True)
        assert_alike(found, wanted)
        np.testing.assert_array_equal(found.hit, wanted.hit)
        assert (found.hit >= len(still)).any() == (count > 0)
        assert (decibel(wanted.color, alone.color) > 80) == (count == 0)
    np.testing.assert_array_equal(drawer.splats.geometry.copy_to_host()[2 * ROW :], static)


@pytest.mark.parametrize("bands", [1, 4, 9])
def test_actors_are_posed_on_the_device_as_on_the_cpu(bands):
    """Two that turn, the harmonics of one as well; one is away at times, then none is there."""
    still = raster.prepare(cloud(20, bands=bands))
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.5, -1.0, 0.8]]).as_quat(scalar_first=True)
    actors = [
        Actor(str(k), "car", cloud(count, seed=k + 4, bands=bands), np.zeros((2, 3)), Track(
            np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.3, 0.1, -0.2]]), turns,
            np.array([k == 0, True])), turning=k == 0)
        for k, count in enumerate((70, 290))
    ]  # fmt: skip
    drawer, wanted = twin.Rasterizer(DeviceSplats(still, 3)), raster.Rasterizer(still)
    moving = ActorSplats(actors, still)
    for time in (1.0, 0.4, None):
        moving.set_time(time)
        for each in (drawer, wanted):
            each.pose_actors(moving)
        found, theirs = (each.draw(camera(), 0.2, hit=True) for each in (drawer, wanted))
        assert_alike(found, theirs)
        assert (found.hit == theirs.hit).mean() > 0.99
        assert moving.numbers(theirs.hit).max() == (0 if time is None else 2 if time == 1 else 1)
    moving.set_time(1.0)
    drawer.pose_actors(moving)
    parts = [raster.prepare(actor.splats) for actor in actors]
    wanted = [
        [actor.track.pose(1.0).places(np.stack(np.meshgrid(*box.reshape(2, 3).T), -1).reshape(8, 3))
         for box in part.box]
        for actor, part in zip(actors, parts, strict=True)
    ]  # fmt: skip
    corners = np.concatenate(wanted)
    wanted = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    np.testing.assert_allclose(drawer.splats.box.copy_to_host()[:3], wanted, atol=1e-5)
    assert (drawer.splats.span.copy_to_host()[:3, 0] == 0).all()


def test_the_training_codes_stop():
    splats = cloud(150)
    splats.opacity[:] = 0.98
    prepared = raster.prepare(splats)
    wanted = raster.rasterize(prepared, camera(), 0.2, drop_last=True)
    assert_alike(twin.rasterize(prepared, camera(), 0.2, drop_last=True), wanted)
    assert np.abs(raster.rasterize(prepared, camera(), 0.2).alpha - wanted.alpha).max() > 1e-4


@pytest.mark.parametrize("bands", [1, 4, 9])
def test_orthographic_and_all_degrees(bands):
    prepared = raster.prepare(cloud(bands=bands))
    cam = camera(focal=4.0, orthographic=True)
    assert_alike(twin.rasterize(prepared, cam, 0.2), raster.rasterize(prepared, cam, 0.2))


def test_room_is_made_for_the_entries_of_a_picture():
    prepared = raster.prepare(cloud())
    rasterizer = twin.Rasterizer(prepared)
    first = rasterizer.draw(camera(), 0.2)
    small = twin.Rasterizer(prepared)
    small._room = 8
    again = small.draw(camera(), 0.2)
    assert small.entries == rasterizer.entries > 60
    for name in ("color", "alpha", "depth", "plane_depth", "normal"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    wide = twin.Rasterizer(prepared, workspace=small.workspace)  # of whose lists more are there
    np.testing.assert_array_equal(wide.draw(camera(), 0.2).color, first.color)


def test_equal_depths_keep_the_order_of_the_cpu():
    splats = cloud(40, 1)
    position = splats.position.copy()
    position[:, 2] = np.where(np.arange(40) % 2, 3.0, 3.0 + 1e-6 * np.arange(40))
    flat = Splats(position, splats.rotation, splats.scale, splats.opacity, splats.sh)
    prepared = raster.prepare(flat)
    assert_alike(twin.rasterize(prepared, camera(), 0.2), raster.rasterize(prepared, camera(), 0.2))


def test_tiles_are_empty_again_when_nothing_is_there():
    prepared = raster.prepare(cloud())
    rasterizer = twin.Rasterizer(prepared)
    assert rasterizer.draw(camera(), 0.2).alpha.max() > 0.9
    nothing = rasterizer.draw(camera(), 0.2, plane=(0, 0, 0, 1))
    assert nothing.alpha.max() == 0 and np.isinf(nothing.depth).all()


def test_splats_that_are_not_numbers_are_not_drawn():
    splats = cloud()
    position = splats.position.copy()
    position[::7, 1] = np.nan
    broken = Splats(position, splats.rotation, splats.scale, splats.opacity, splats.sh)
    prepared = raster.prepare(broken)
    layers = twin.rasterize(prepared, camera(), 0.2)
    assert np.isfinite(layers.color).all()
    assert_alike(layers, raster.rasterize(prepared, camera(), 0.2))


def test_signatures_are_those_of_the_cpu():
    for name in ("draw",):
        ours, theirs = getattr(twin.Rasterizer, name), getattr(raster.Rasterizer, name)
        ours, theirs = (dict(inspect.signature(each).parameters) for each in (ours, theirs))
        assert ours.pop("on_device").default is False and ours == theirs
    assert inspect.signature(twin.rasterize) == inspect.signature(raster.rasterize)


def test_a_lower_degree_than_the_scene_has():
    prepared = raster.prepare(cloud())
    layers = twin.rasterize(prepared, camera(), 0.2, degree=1)
    assert_alike(layers, raster.rasterize(prepared, camera(), 0.2, degree=1))
    assert decibel(layers.color, twin.rasterize(prepared, camera(), 0.2).color) < 40
