"""Light on wavy water against an independent path tracer, Mitsuba 3 (an extra of the tests).

A sheet of water with a wave lies over a glowing floor beside a glowing wall. Mitsuba traces the
dielectric; our shading gets depth, colour and height of the dry scene. Light that leaves water is
weakened by 1/n^2, by which the floor glows more in Mitsuba: a floor that scatters daylight gets
that much more of it. The water is clear there, so ours is compared without its absorption.
"""

import numpy as np
import pytest
from scipy import ndimage
from test_optics import EYE, FOCAL, HEIGHT, ORIGIN, SHAPE, SPACING, TURN, VIEW, WIDTH, rays

from rainsim import ssr
from rainsim.reflection import ray_water, screen_space, water_record, water_shading
from rainsim.reflection.mirrored_rays import SCREEN
from rainsim.reflection.water_shading import Background, Optics
from rainsim.reflection.water_surface import WaterMap
from rainsim.reflection.wet_tops import DRY_TOPS
from rainsim.shading.fresnel import EXACT, fresnel

mitsuba = pytest.importorskip("mitsuba")
pytestmark = pytest.mark.slow

DEEP, WAVE, AMPLITUDE = 0.02, 0.5, 0.001  # m
INDEX, SAMPLES = 1.333, 32
WALL, TALL = 1.0, 3.0  # m: x of a wall beside the water, and its height
GLOW = np.array([0.9, 0.6, 0.3])
NUMBER = 2 * np.pi / WAVE


def floor_light(x, y):
    red, green = 0.5 + 0.3 * np.sin(2 * x), 0.4 + 0.2 * np.cos(x + y)
    return np.stack([red, green, 0.3 + 0.2 * np.sin(y)], axis=-1)


def traced():
    """Mean and standard error of Mitsuba's picture."""
    mitsuba.set_variant("scalar_rgb")
    n = 801
    u = np.linspace(-4, 4, n)
    x, y = np.meshgrid(u, u)
    slope = -AMPLITUDE * NUMBER * np.sin(NUMBER * x)
    normal = np.stack([-slope, 0 * x, np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    points = np.stack([x, y, DEEP + AMPLITUDE * np.cos(NUMBER * x)], axis=-1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)])
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict({"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0})
    mesh = mitsuba.Mesh("water", n * n, len(faces), has_vertex_normals=True, props=properties)
    values = mitsuba.traverse(mesh)
    values["vertex_positions"] = points.astype(np.float32).ravel()
    values["vertex_normals"] = normal.astype(np.float32).ravel()
    values["faces"] = faces.astype(np.uint32).ravel()
    values.update()
    t = mitsuba.ScalarTransform4f
    size = 1024
    c = (np.arange(size) + 0.5) / size * 8 - 4
    gx, gy = np.meshgrid(c, c)
    picture = (floor_light(gx, gy) * INDEX**2).astype(np.float32)
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    target = EYE + TURN[:, 2]
    scene = mitsuba.load_dict({
        "type": "scene", "integrator": {"type": "path", "max_depth": 4, "hide_emitters": False},
        "water": mesh,
        "floor": {
            "type": "rectangle", "to_world": t().scale([4, 4, 1]), "bsdf": black,
            "emitter": {"type": "area", "radiance": {
                "type": "bitmap", "bitmap": mitsuba.Bitmap(picture), "raw": True}},
        },
        "wall": {
            "type": "rectangle", "bsdf": black,
            "to_world": t().translate([WALL, 0, TALL / 2]) @ t().rotate([0, 1, 0], -90)
            @ t().scale([TALL / 2, 4, 1]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": GLOW.tolist()}},
        },
        "sensor": {
            "type": "perspective", "fov_axis": "x",
            "fov": float(np.degrees(2 * np.arctan(WIDTH / 2 / FOCAL))),
            "to_world": t().look_at(origin=EYE.tolist(), target=target.tolist(), up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT,
                     "rfilter": {"type": "box"}},
        },
    })  # fmt: skip
    runs = np.array([np.array(mitsuba.render(scene, spp=SAMPLES, seed=k))[..., :3]
                     for k in range(6)])  # fmt: skip
    return runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(len(runs))


def ours():
    """Our picture from the dry scene's depth and colour, and where it is all water."""
    ray = rays()
    with np.errstate(divide="ignore"):
        floor = np.where(ray[..., 2] < 0, -EYE[2] / ray[..., 2], np.inf)
        wall = (WALL - EYE[0]) / ray[..., 0]
    depth = np.where((wall > 0) & (wall < floor), wall, floor)
    point = EYE + np.where(np.isfinite(depth), depth, 0)[..., None] * ray
    on_wall = (wall > 0) & (wall < floor) & (point[..., 2] < TALL)
    picture = np.where(on_wall[..., None], GLOW, floor_light(point[..., 0], point[..., 1]))
    depth, picture = depth.astype(np.float32), picture.astype(np.float32)
    clearance = np.where(on_wall, point[..., 2], 0).astype(np.float32)
    x = ORIGIN[0] + (np.arange(SHAPE[1]) + 0.5) * SPACING
    surface = DEEP + AMPLITUDE * np.cos(NUMBER * x) + np.zeros((SHAPE[0], 1))
    surface = surface.astype(np.float32)
    coverage = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    hit, count = np.full_like(coverage, np.nan), np.zeros(HEIGHT, np.int64)
    rows, spacing = np.arange(HEIGHT), np.float32(SPACING)
    water_map = WaterMap(surface, surface, np.ones(SHAPE, np.float32), ORIGIN, spacing)
    cover = np.array([1e-4, 2e-4], np.float32)
    ray_water.meet_water(depth, VIEW, water_map, surface.max(), rows, cover, hit, coverage, count)
    n = count.sum()
    pixel, record = np.zeros(n, np.int32), np.zeros((n, water_record.RECORD), np.float32)
    water_shading.list_water(
        hit, coverage, np.cumsum(count) - count, rows, VIEW, water_map, DRY_TOPS, pixel, record
    )
    slope = -AMPLITUDE * NUMBER * np.sin(NUMBER * record[:, water_record.X])
    record[:, water_record.SLOPE_X] = slope
    light, source = np.zeros((len(pixel), 3), np.float32), np.zeros(len(pixel), np.uint8)
    tall = np.empty_like(depth)
    screen_space.keep_tall(depth, clearance, tall)
    bounds = np.empty(ssr.bounds_of(*depth.shape), np.float32)
    ssr.block_bounds(tall, bounds)
    screen_space.march_light(
        np.arange(n), record, picture, ssr.DepthBlocks(tall, bounds), VIEW,
        np.zeros((16, 32, 3), np.float32), ssr.MarchSettings(*np.float32([0.15, 1, 12])), light,
        source,
    )  # fmt: skip
    out = picture.copy()
    optics = Optics(EXACT, np.float32(4e-3), np.zeros(6, np.float32))
    background = Background(picture, picture, depth)
    water_shading.lay_water(pixel, record, light, background, VIEW, optics, out)
    # Take back what our puddle water absorbs on the way down along the bent ray and straight up.
    normal = np.stack([-slope, 0 * slope, np.ones(n)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    view = record[:, water_record.VIEW_X : water_record.VIEW_Z + 1]
    cosine = -np.einsum("ij,ij->i", view, normal)
    share = np.vectorize(fresnel)(cosine)[:, None] * light
    down = np.array([water_shading.refracted(*r, *u, c)[2]
                     for r, u, c in zip(view, normal, cosine, strict=True)])  # fmt: skip
    path = record[:, water_record.WATER_DEPTH] * (1 - 1 / down)
    absorb = np.array([water_shading.ABSORB_R, water_shading.ABSORB_G, water_shading.ABSORB_B])
    flat = out.reshape(-1, 3)
    flat[pixel] = (flat[pixel] - share) * np.exp(absorb * path[:, None]) + share
    return out, pixel, source, coverage


def test_reflection_and_refraction_agree_with_a_path_tracer():
    truth, sigma = traced()
    out, pixel, source, coverage = ours()
    both = np.zeros(coverage.shape, bool)  # where the march, too, has met the wall
    both.ravel()[pixel[source == SCREEN]] = True
    both &= coverage > 0.999
    both[:, :10] = both[:, -10:] = False  # where reflections fade to the surroundings
    both = ndimage.binary_erosion(both, np.ones((7, 7)))  # and pixels that show two things
    assert both.sum() > 1000
    off, allowed = np.abs(out - truth)[both], (3 * sigma + 0.02 * truth)[both]
    assert (off <= allowed).mean() > 0.995
    assert np.median(off / truth[both]) < 0.005
    mirrored = np.abs(truth - floor_light(0, 0))[both]  # the picture is not one plain colour
    assert mirrored.std() > 0.05
