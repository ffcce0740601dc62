"""The splatting twin on a real GPU: `pytest -m gpu`."""

import functools
import json
import runpy

import numpy as np
import pytest

import naive
from rainsim import raster
from rainsim.scene.types import Camera, Splats

pytestmark = pytest.mark.gpu
decibel = functools.partial(naive.decibel, peak=1.0)
LAYERS = ("color", "alpha", "depth", "plane_depth", "normal")


@pytest.fixture(scope="module")
def twin():
    from rainsim.cuda import raster as module

    return module


@pytest.fixture(scope="module")
def cloud():
    rng = np.random.default_rng(5)
    n = 60_000
    rotation = rng.normal(size=(n, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    return raster.prepare(Splats(
        rng.uniform((-3, -2, -1), (3, 2, 9), (n, 3)).astype(np.float32),
        rotation.astype(np.float32), np.exp(rng.normal(-3.5, 0.8, (n, 3))).astype(np.float32),
        rng.uniform(0, 1, n).astype(np.float32), rng.normal(0, 0.25, (n, 16, 3)).astype(np.float32),
    ))  # fmt: skip


def camera(width=419, height=307, focal=400.0, **kwargs):
    return Camera(
        width, height, focal, focal * 1.05, width / 2 + 1.5, height / 2 - 0.7, np.eye(4), **kwargs
    )


def assert_alike(layers, wanted):
    assert wanted.alpha.max() > 0.9
    assert decibel(layers.color, wanted.color) >= 80
    assert decibel(layers.alpha, wanted.alpha) >= 80
    assert (np.isinf(layers.depth) != np.isinf(wanted.depth)).mean() < 1e-4
    seen = np.isfinite(wanted.depth) & np.isfinite(layers.depth)
    error = np.abs(layers.depth[seen] / wanted.depth[seen] - 1)
    assert np.percentile(error, 99.9) < 1e-3


@pytest.mark.parametrize(
    "options",
    [{}, {"plane": (0.0, 1.0, 0.2, 0.3)}, {"compensate": True}, {"drop_last": True}],
)
def test_agrees_with_the_cpu(twin, cloud, options):
    wanted = raster.rasterize(cloud, camera(), 0.2, **options)
    layers = twin.rasterize(cloud, camera(), 0.2, **options)
    assert_alike(layers, wanted)
    assert decibel(layers.normal, wanted.normal) > 50


def test_orthographic_and_median(twin, cloud):
    flat = camera(focal=50.0, orthographic=True)
    assert_alike(twin.rasterize(cloud, flat, 0.2), raster.rasterize(cloud, flat, 0.2))
    layers = twin.rasterize(cloud, camera(), 0.2, depth="median")
    wanted = raster.rasterize(cloud, camera(), 0.2, depth="median")
    assert decibel(layers.color, wanted.color) >= 80
    seen = np.isfinite(wanted.depth) & np.isfinite(layers.depth)
    assert (np.abs(layers.depth[seen] / wanted.depth[seen] - 1) < 1e-4).mean() > 0.995


def test_warps_agree_with_the_plain_way(twin, cloud):
    quick = twin.Rasterizer(cloud).draw(camera(), 0.2)
    plain = twin.Rasterizer(cloud, plain=True).draw(camera(), 0.2)
    assert decibel(quick.color, plain.color) >= 85


def test_the_same_bytes_twice_and_where_room_lacked(twin, cloud):
    rasterizer, tight = twin.Rasterizer(cloud), twin.Rasterizer(cloud)
    first = rasterizer.draw(camera(), 0.2)
    second = rasterizer.draw(camera(), 0.2)
    tight._room = 1000
    third = tight.draw(camera(), 0.2)
    assert tight.entries == rasterizer.entries > 100_000
    on_device = rasterizer.draw(camera(), 0.2, on_device=True).to_host()
    for name in LAYERS:
        for other in (second, third, on_device):
            np.testing.assert_array_equal(getattr(first, name), getattr(other, name))
    other = rasterizer.draw(camera(focal=500.0), 0.2)
    assert (other.color != first.color).mean() > 0.5


def garden(data):
    """Return the splats of the garden in a folder."""
    parts = runpy.run_path(str(data / "unpack.py"))["load_garden"]()
    position, scale, quaternion, opacity, dc, rest = parts
    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return Splats(
        position, quaternion.astype(np.float32), np.exp(scale), 1 / (1 + np.exp(-opacity)),
        np.concatenate([dc[:, None], rest], axis=1),
    )  # fmt: skip


def garden_camera(data, name, width, height):
    views = json.loads((data / "garden_cameras.json").read_text())
    view = next(v for v in views if v["img_name"] == name)
    turn, eye = np.array(view["rotation"]), np.array(view["position"])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.T, -turn.T @ eye
    return Camera(
        width, height, view["fx"] * width / view["width"], view["fy"] * height / view["height"],
        width / 2, height / 2, matrix,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["DSC07956", "DSC07996"])
def test_the_garden_as_gsplat_and_the_cpu_draw_it(twin, shared, name):
    data = shared("data/garden.npz").parent
    prepared = raster.prepare(garden(data))
    reference = np.load(shared("reference/garden_gsplat.npz"))
    cam = garden_camera(data, name, 648, 420)
    # With the stop that gsplat has.
    layers = twin.rasterize(prepared, cam, 0.01, drop_last=True)
    wanted = raster.rasterize(prepared, cam, 0.01, drop_last=True)
    against_gsplat = decibel(layers.color, reference[f"{name}_rgb"] / 32768)
    against_cpu = decibel(layers.color, wanted.color)
    print(
        f"{name}: against gsplat {against_gsplat:.1f} dB"
        f" (CPU {decibel(wanted.color, reference[f'{name}_rgb'] / 32768):.1f} dB),"
        f" against the CPU {against_cpu:.1f} dB"
    )
    assert against_gsplat >= 70
    assert against_cpu >= 80
    plain = twin.rasterize(prepared, cam, 0.01)
    assert decibel(plain.color, raster.rasterize(prepared, cam, 0.01).color) >= 80


def test_hits_of_more_splats_than_a_float32_tells_apart(twin, rng):
    """19 million splats, most of them behind the camera; and few, by digits of few numbers."""
    n = 19_000_000
    place = rng.uniform((-3, -2, -9), (3, 2, 3), (n, 3)).astype(np.float32)
    many = raster.prepare(Splats(
        place, np.tile(np.float32([1, 0, 0, 0]), (n, 1)), np.full((n, 3), 0.004, np.float32),
        np.full(n, 0.9, np.float32), np.zeros((n, 1, 3), np.float32),
    ))  # fmt: skip
    drawer = twin.Rasterizer(many)
    assert len(drawer.splats.divisors()) == 2
    found = drawer.draw(camera(), 0.2, hit=True).hit
    wanted = raster.rasterize(many, camera(), 0.2, hit=True).hit
    assert (found == wanted).mean() > 0.999
    places = np.nonzero(np.isin(many.order, found[found >= 0]))[0]
    assert len(places) > 1000 and places.max() >= 1 << 24  # told apart beyond one digit
