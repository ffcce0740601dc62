"""The twins of shading, water surface and water light in the simulator, against the CPU's."""

import functools
import inspect
from types import SimpleNamespace

import numpy as np
import pytest

import naive
from rainsim import ssr
from rainsim.cuda import simulated
from rainsim.cuda.jit import cuda
from rainsim.cuda.particles import drop_radiance as cuda_drops
from rainsim.cuda.reflection import planar_mirror as cuda_mirror
from rainsim.cuda.reflection import ray_water as cuda_ray_water
from rainsim.cuda.reflection import screen_space as cuda_screen
from rainsim.cuda.reflection import water_shading as cuda_water
from rainsim.cuda.reflection import water_surface as cuda_surface
from rainsim.cuda.shading import composite as cuda_composite
from rainsim.cuda.shading import glare as cuda_glare
from rainsim.cuda.shading import wet_ground_mirror as cuda_film
from rainsim.cuda.shading import wet_pass as shading
from rainsim.numerics import mipmap  # fmt: skip
from rainsim.particles import drop_radiance
from rainsim.reflection import (
    mirror_pass,
    ray_water,
    screen_space,
    slope_moments,
    water_shading,
    water_surface,
)
from rainsim.reflection.planar_mirror import MirrorPicture
from rainsim.reflection.puddle_rings import puddle_rings
from rainsim.reflection.water_record import RECORD
from rainsim.reflection.water_shading import Background, Optics, Ripples
from rainsim.reflection.water_surface import WaterMap
from rainsim.reflection.wet_tops import DRY_TOPS
from rainsim.scene.view import View
from rainsim.shading import composite, glare, sky, wet_ground_mirror, wet_pass
from rainsim.shading.composite import RainCover, RainLight
from rainsim.shading.fresnel import EXACT, SCHLICK
from rainsim.shading.grading import Look
from rainsim.shading.surface_point import GroundMaps
from rainsim.shading.wet_pass import DryPicture
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import SkyMaps
from rainsim.water.ripples import block_reach, ring_reach

assert simulated()
decibel = functools.partial(naive.decibel, peak=1.0)
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
HEIGHT, WIDTH, CELLS = 20, 30, 28
SPACING, ORIGIN = np.float32(0.1), np.array([-1.4, -1.4], np.float32)
F4 = np.float32


@pytest.fixture(scope="module")
def view():
    """A camera over a pool: turn, eye, lens and what a dry picture has."""
    rng = np.random.default_rng(4)
    down = np.radians(35)
    right, ahead = np.array([1.0, 0, 0]), np.array([0, np.cos(down), -np.sin(down)])
    turn = np.stack([right, np.cross(ahead, right), ahead], axis=1).astype(F4)
    eye, lens = np.array([0.05, -1.6, 1.2], F4), np.array([26, 27, 15.2, 9.7], F4)
    v, h = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    ray = np.stack([(h - lens[2]) / lens[0], (v - lens[3]) / lens[1], np.ones_like(h)], -1)
    z = (ray @ turn.T)[..., 2]
    depth = np.where(z < -0.05, -eye[2] / np.minimum(z, -0.05), 60.0).astype(F4)
    depth[4:12, 10:14] = 1.4  # a post
    normal = np.zeros((HEIGHT, WIDTH, 3), F4)
    normal[...] = np.array([0, 0, 1], F4) @ turn
    alpha = rng.uniform(0.05, 1, (HEIGHT, WIDTH)).astype(F4)
    return SimpleNamespace(
        turn=turn, eye=eye, lens=lens, depth=depth, normal=normal, alpha=alpha,
        color=rng.uniform(0, 1.2, (HEIGHT, WIDTH, 3)).astype(F4),
        bed=rng.normal(0, 0.004, (CELLS, CELLS)).astype(F4),
        grass=rng.uniform(0, 1, (CELLS, CELLS)).astype(F4),
        exposure=rng.uniform(0.2, 1, (CELLS, CELLS)).astype(F4),
    )  # fmt: skip


def launch(kernel, *arguments):
    kernel[shading.blocks(HEIGHT, WIDTH), shading.BLOCK](*arguments)


def test_halos_of_lamps(view, poisoned):
    """Lamps of several colours, and sizes of lens one after the other."""
    picture = (0.3 * view.color).astype(F4)
    picture[3, 4], picture[3, 29], picture[17, 11:13] = (90, 9, 0), (4, 70, 30), (8, 8, 50)
    shown, brightness = cuda.to_device(picture), F4(0.7)
    twin = cuda_glare.Glare()
    for focal in (26.0, 60.0):
        found = twin.added(shown, brightness, focal)
        wanted = glare.Glare().added(picture, focal, 0.7)
        assert np.abs(wanted - picture).max() > 0.01
        np.testing.assert_allclose(found.copy_to_host(), wanted, rtol=1e-5, atol=1e-6)
        found.copy_to_device(poisoned((HEIGHT, WIDTH, 3)))


def test_grade_and_wet(view, poisoned):
    day, around = sky.overcast(), sky.overcast(0.7)
    look = Look(*F4([0.8, 0.9, 0.8, 1, 0.85, 0.6, 1.3, EXACT]))
    wetness = np.random.default_rng(2).uniform(0, 1, (CELLS, CELLS, 4)).astype(F4)
    bodies = np.full((CELLS, CELLS, 3), 255, np.uint8)
    bodies[..., 0], bodies[..., 1] = 0, 100  # all that stands is a smooth body
    dry = DryPicture(
        view.color, view.alpha, view.depth, view.depth * F4(1.01), view.normal, F4(0.9), F4(0.2)
    )
    skies = SkyMaps(around, sky.overcast(0.8), day)

    def given(damp):
        """Return the arguments of both kernels."""
        ground = GroundMaps(view.bed, wetness * F4(damp), ORIGIN, SPACING, bodies)
        rain = OffGroundWetness(*F4([damp, 0.2, -0.4, 0.8, 0.3]))
        return dry, View(view.turn, view.eye, *view.lens), ground, rain, skies, look

    shapes = (HEIGHT, WIDTH, 3), *3 * ((HEIGHT, WIDTH),)
    none = np.empty((0, 0), F4)
    whole, part = F4([WIDTH, HEIGHT]), F4([WIDTH - 3, HEIGHT - 5])
    drawn = np.zeros((HEIGHT, WIDTH), bool)
    drawn[:-5, :-3] = True
    for damp, size, apart in ((0.9, whole, True), (0.7, part, False)):
        wanted, found = ([poisoned(shape) for shape in shapes] for _ in range(2))
        wet_pass.grade_and_wet(*given(damp), *wanted[:3], wanted[3] if apart else none)
        launch(shading.grade_and_wet, size, *given(damp), *found[:3],
               found[3] if apart else found[3][:0])  # fmt: skip
        where = drawn | apart
        np.testing.assert_array_equal(np.isfinite(found[2]), where)
        assert decibel(found[0][where], wanted[0][where]) > 100
        np.testing.assert_allclose(found[1][where], wanted[1][where], rtol=1e-6)
        np.testing.assert_allclose(found[2][where], wanted[2][where], atol=1e-5)
        np.testing.assert_allclose(found[3], wanted[3], atol=1e-5)
        assert np.isnan(found[3]).all() != apart
    glossing = [poisoned(shape) for shape in shapes[:3]]
    wet_pass.grade_and_wet(*given(0.9), *glossing, none)
    wet_pass.grade_and_wet(*given(0.9), *wanted[:3], wanted[3])
    assert wanted[3].max() > 0.3 and decibel(glossing[0], wanted[0]) < 50


def test_compose(view, poisoned, rng):
    alphas = [rng.uniform(0, 0.5, (HEIGHT, WIDTH)).astype(F4) for _ in range(2)]
    fog = np.linspace(0, 0.6, 99).astype(F4)
    fog[0], fog[1] = 20, 0.02
    drops, around = rng.uniform(0, 1, (2, 4, 6, 3)).astype(F4)
    air = F4([0.8] * 3)
    light = view.color * 2, view.depth, RainCover(*alphas, fog), RainLight(drops, around, air)
    wanted, found = (poisoned((HEIGHT, WIDTH, 3), np.uint8) for _ in range(2))
    shown = *light, View(view.turn, view.eye, *view.lens), F4(1.1)
    composite.compose(*shown, wanted)
    launch(cuda_composite.compose, *shown, found)
    difference = np.abs(found.astype(int) - wanted)
    assert difference.max() <= 1 and (difference > 0).mean() < 0.01
    assert wanted.std() > 10


@pytest.fixture(scope="module")
def pond(view):
    """Depth of water, and the surface that the CPU makes of it."""
    rng = np.random.default_rng(9)
    y, x = np.mgrid[:CELLS, :CELLS]
    depth = np.clip(0.03 - 0.004 * np.hypot(x - 14, y - 15), 0, None).astype(F4)
    depth[2:4, 2:5] = 0.02
    relief = rng.normal(0, 5e-4, (CELLS, CELLS)).astype(F4)
    mirrors = rng.uniform(size=(CELLS, CELLS)) < 0.9
    depth[22:26, 1:7], mirrors[22:26, 1:7] = 0.08, False  # over the tips of a lawn
    terrain = SimpleNamespace(bed=view.bed)
    return depth, relief, mirrors, water_surface.water_surface(terrain, depth, relief, mirrors)


def test_water_surface(view, pond):
    depth, relief, mirrors, (surface, over, highest) = pond
    reach = block_reach(8 * SPACING, *ring_reach(5e-3))
    twin = cuda_surface.WaterSurface(view.bed, relief, mirrors, reach)
    twin.draw(depth)
    shores = puddle_rings(depth, mirrors, reach)
    np.testing.assert_allclose(twin.shores.copy_to_host(), shores, rtol=1e-5)
    assert shores.min() < 0.8 * shores.max()
    np.testing.assert_allclose(twin.over.copy_to_host(), over, atol=2e-7)
    found = twin.surface.copy_to_host()
    near = over > 0
    # Far from water the nearest block decides, and of two as near either may.
    assert (np.abs(found - surface)[near] < 2e-7).mean() > 0.995
    assert (np.abs(found - surface) < 1e-6).mean() > 0.95
    assert twin.highest.copy_to_host()[0] == pytest.approx(highest, abs=1e-6)
    twin.draw(np.zeros_like(depth))
    assert twin.highest.copy_to_host()[0] == cuda_surface.NO_HEIGHT
    assert (twin.over.copy_to_host() == 0).all()


@pytest.mark.parametrize("reflection, law", [("march", EXACT), ("mirror", SCHLICK)])
def test_water_light(view, pond, poisoned, rng, reflection, law):
    *_, (surface, over, highest) = pond
    camera = View(view.turn, view.eye, *view.lens)
    water_map = WaterMap(surface, over, view.exposure, ORIGIN, SPACING)
    highest, cover = F4(surface[over > 0].max()), np.array([0.0005, 0.002], F4)
    rows = np.arange(HEIGHT, dtype=np.int64)
    hit, hit2, coverage, coverage2 = (poisoned((HEIGHT, WIDTH)) for _ in range(4))
    count = np.zeros(HEIGHT, np.int64)
    ray_water.meet_water(view.depth, camera, water_map, highest, rows, cover, hit, coverage, count)
    noisy = view.depth.copy()  # pixels a little too near make no holes
    noisy[::3, ::3] = np.where(coverage > 0.9, hit - F4(0.02), noisy)[::3, ::3]
    launch(
        cuda_ray_water.meet_water, noisy, camera, water_map, np.array([highest]), cover, hit2,
        coverage2,
    )  # fmt: skip
    np.testing.assert_allclose(coverage2, coverage, atol=1e-4)
    assert 50 < count.sum() < HEIGHT * WIDTH

    slopes = rng.normal(0, 0.05, (2, 32, 32)).astype(F4)
    ripples = Ripples(slope_moments.ripple_moments(slopes), F4(1.0))
    picture, clearance = view.color, np.where(view.depth == F4(1.4), 1.0, 0).astype(F4)
    clearance[view.depth > 50] = 1e4
    tall, tall2 = poisoned((HEIGHT, WIDTH)), poisoned((HEIGHT, WIDTH))
    screen_space.keep_tall(view.depth, clearance, tall)
    bounds, bounds2 = (poisoned(ssr.bounds_of(HEIGHT, WIDTH)) for _ in range(2))
    ssr.block_bounds(tall, bounds)
    launch(cuda_screen.keep_tall, view.depth, clearance, tall2, bounds2)
    many = -(-len(bounds2) // cuda_screen.JOINERS), cuda_screen.JOINERS
    cuda_screen.join_bounds[many](HEIGHT, WIDTH, bounds2)
    np.testing.assert_array_equal(tall, tall2)
    np.testing.assert_array_equal(bounds, bounds2)
    around, sun = sky.overcast(), np.array([0.1, 0.7, 0.7, 9, 8, 7], F4)
    settings = ssr.MarchSettings(*F4([0.15, 1.0, 12.0]))
    n = int(count.sum())
    pixel, record = np.empty(n, np.int32), np.empty((n, RECORD), F4)
    light, source = poisoned((n, 3)), poisoned(n, np.uint8)
    water_shading.list_water(
        hit, coverage, np.cumsum(count) - count, rows, camera, water_map, DRY_TOPS, pixel, record
    )
    water_shading.tilt_water(ripples, DRY_TOPS, record)
    mirror = rng.uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(F4)
    mirror_depth = rng.uniform(2, 5, (HEIGHT, WIDTH)).astype(F4)
    window = F4([*view.lens, WIDTH, HEIGHT])
    coarse, coarse2 = mipmap.coarsened(mirror), poisoned(mipmap.coarse_shape(HEIGHT, WIDTH))
    cuda_mirror.coarsen[(1, 1), cuda_mirror.THREADS](window[4:], mirror, coarse2)
    for level in range(1, 5):  # the picture has no more
        top = mipmap.top_of(HEIGHT, level)
        part = slice(top, top + (HEIGHT >> level)), slice(0, WIDTH >> level)
        np.testing.assert_allclose(coarse2[part], coarse[part], rtol=1e-6)
    everything, level = np.arange(n), F4(0.02)
    flipped = view.turn * F4([[1], [1], [-1]])
    if reflection == "mirror":
        below_eye = np.array([*view.eye[:2], 2 * level - view.eye[2]], F4)
        mirror_view = camera._replace(ground_from_camera=flipped, eye=below_eye)
        mirror_pass.mirror_light(
            everything, record, mirror_view, MirrorPicture(mirror, coarse, mirror_depth), light,
            source,
        )  # fmt: skip
        served = np.array([[0, 9, -9], [level, -10, 10]], F4)
    else:
        screen_space.march_light(
            everything, record, picture, ssr.DepthBlocks(tall, bounds), camera, around,
            settings, light, source,
        )  # fmt: skip
        served = np.array([[0, 10, -10], [0, 9, -9]], F4)
    below = rng.uniform(0, 1, picture.shape).astype(F4)
    background = Background(picture, below, view.depth)
    optics = Optics(law, F4(4e-3), sun)
    wanted, found = picture.copy(), poisoned(picture.shape)
    water_shading.lay_water(pixel, record, light, background, camera, optics, wanted)
    distance = poisoned((HEIGHT, WIDTH))
    launch(cuda_screen.find_hits, hit, coverage, tall, bounds, camera, settings, served, distance)
    assert (np.isfinite(distance) == ((coverage > 0) & (reflection == "march"))).all()
    pictures = (np.stack([0 * m, m]) for m in (mirror, coarse2, mirror_depth))
    mirrors = cuda_mirror.MirrorArrays(served, window, flipped, *pictures)
    launch(
        cuda_water.shade_water, hit, coverage, distance, background, tall, camera, water_map,
        DRY_TOPS, ripples, around, around, settings, mirrors, optics, found,
    )  # fmt: skip
    assert decibel(found, wanted) > 70
    assert decibel(wanted, picture) < 30


def test_signatures_are_those_of_the_cpu():
    """What the twins leave out is what a list of pixels needs; they add a size and bounds."""
    pairs = [
        (wet_pass.grade_and_wet, shading.grade_and_wet, {"size"}),  # of a mirror's window
        # The device fills in every block, and its level picture's arrays are larger than that.
        (
            wet_ground_mirror.mirrored_field,
            cuda_film.mirrored_field,
            {"wanted", "level_size"},
        ),
        (wet_ground_mirror.add_reflection, cuda_film.add_reflection, set()),
        (composite.compose, cuda_composite.compose, set()),
        (screen_space.keep_tall, cuda_screen.keep_tall, {"bounds_out"}),
        (ray_water.meet_water, cuda_ray_water.meet_water, {"row_order", "count_out"}),
    ]
    for theirs, ours, without in pairs:
        theirs, ours = (list(inspect.signature(f).parameters) for f in (theirs, ours.fn))
        assert [n for n in ours if n not in without] == [n for n in theirs if n not in without]


def test_light_of_drops_is_the_cpus(monkeypatch):
    monkeypatch.setattr(cuda_drops, "_SUMMERS", 6)  # each adds up several of a cell's 16 pixels
    rng = np.random.default_rng(8)
    around = rng.uniform(0, 2, (32, 64, 3)).astype(np.float32)
    mean = drop_radiance.mean_radiance(around)
    turn = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.float32)
    lens = np.array([90, 100, 60, 40], np.float32)
    picture = rng.uniform(0, 2, (80, 120, 3)).astype(np.float32)
    depth = rng.uniform(1, 20, (80, 120)).astype(np.float32)
    depth[:10] = np.inf
    wanted = np.stack(drop_radiance.falling_light(around, mean, turn, lens, picture, depth))
    assert wanted.std() > 0.01 and np.abs(wanted[0] - wanted[1]).max() > 0.01
    seen = cuda.to_device(picture), cuda.to_device(depth)
    view = View(turn, np.zeros(3, F4), *lens)
    found = cuda_drops.DropLight().find(*seen, around, mean, view)
    found = tuple(field.copy_to_host() for field in found)
    np.testing.assert_allclose(found, wanted, rtol=1e-5)
