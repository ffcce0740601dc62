"""A field of rings and a crown against an independent path tracer, Mitsuba 3 (extra `truth`).

Both stand over a bed that glows evenly, under a sky that brightens to the zenith. Mitsuba traces
meshes of water: the surface whose slopes the tile holds, and the crown that the splash formulas
describe, as a sheet of water of 0.24 mm with a round rim, its faces uneven by 0.1 mm (even ones
add two thirds of the light). Ours are the pixels' slopes, and a share of light that the splash
replaces by a radiance.
"""

import math

import numpy as np
import pytest
from scipy import ndimage

from rainsim.drops import Impacts, RainField, RainSpectrum, flat_surfaces, impacts
from rainsim.particles import crown, drop_radiance
from rainsim.particles.splash import Impact, relative_size
from rainsim.particles.splash_pass import draw_splashes
from rainsim.rain.size_distribution import terminal_speed
from rainsim.reflection import screen_space, water_record, water_shading
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.reflection.water_shading import Ripples, surface_at
from rainsim.reflection.wet_tops import DRY_TOPS
from rainsim.scene.cameras import look_at
from rainsim.scene.view import view_of
from rainsim.shading import environment
from rainsim.shading.composite import splash_light
from rainsim.shading.fresnel import fresnel
from rainsim.water.ripples import RippleTile, tile_impacts

mitsuba = pytest.importorskip("mitsuba")
pytestmark = pytest.mark.slow

INDEX, BED = 1.333, 0.12  # and the glow of the bed


def sky(rows=64):
    """Radiance by direction: 1 at the zenith, 0.5 at the horizon, the bed below it."""
    up = environment.directions(rows, 2 * rows)[..., 2]
    light = np.where(up > 0, 0.5 + 0.5 * up, BED)
    return np.repeat(light[..., None], 3, axis=2).astype(np.float32)


def mesh(name, points, faces, normals=None):
    """A mesh of water."""
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict({"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0})
    made = mitsuba.Mesh(
        name, len(points), len(faces), has_vertex_normals=normals is not None, props=properties
    )
    values = mitsuba.traverse(made)
    values["vertex_positions"] = points.astype(np.float32).ravel()
    if normals is not None:
        values["vertex_normals"] = normals.astype(np.float32).ravel()
    values["faces"] = faces.astype(np.uint32).ravel()
    values.update()
    return made


def traced(camera, samples, bounces, seed=1, **meshes):
    """The luminance that Mitsuba finds, (height, width), over a bed at z = -0.2 m."""
    t = mitsuba.ScalarTransform4f
    eye, ahead = camera.position, camera.forward
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    scene = mitsuba.load_dict({
        "type": "scene", "integrator": {"type": "path", "max_depth": bounces, "rr_depth": 50},
        "sky": {"type": "envmap", "bitmap": mitsuba.Bitmap(turned(sky())),
                "to_world": t().rotate([1, 0, 0], 90)},
        "bed": {"type": "rectangle", "to_world": t().translate([0, 0, -0.2]) @ t().scale([9, 9, 1]),
                "bsdf": black, "emitter": {"type": "area", "radiance": {
                    "type": "rgb", "value": BED * INDEX**2}}},
        "sensor": {
            "type": "perspective", "fov_axis": "x",
            "fov": math.degrees(2 * math.atan(camera.width / 2 / camera.fx)),
            "to_world": t().look_at(
                origin=eye.tolist(), target=(eye + ahead).tolist(), up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height,
                     "rfilter": {"type": "box"}},
        },
        **meshes,
    })  # fmt: skip
    return np.array(mitsuba.render(scene, spp=samples, seed=seed))[..., 1].astype(float)


def turned(picture):
    """Our map of directions as Mitsuba's, whose columns begin a quarter further on."""
    return np.ascontiguousarray(np.roll(picture, 3 * picture.shape[1] // 4, axis=1))


def plain(camera):
    """Depth of the level z = 0 in a camera's picture, which shows nothing else."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    ray = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1)
    down = ray @ camera.camera_from_world[:3, :3][:, 2]
    return (-camera.position[2] / down).astype(np.float32)


def grid_faces(rows, columns):
    """Two triangles for each square of a grid of points."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    low = np.stack([a, a + 1, a + columns + 1], 1)
    return np.concatenate([low, np.stack([a, a + columns + 1, a + columns], 1)])


# ---- rings


def rained_on(rate=50.0, depth=0.006):
    """A tile after three seconds of rain."""
    field, ground = RainField(RainSpectrum(rate), seed=4), flat_surfaces(2, 2, 0.1)
    tile = RippleTile(1.0, 256, depth, rate=rate, chord=0.5)
    for n in range(72):
        found = impacts(field, ground, n / 24, (n + 1) / 24)
        tile.advance(1 / 24, *tile_impacts(found, ground.area, tile.size, (n + 1) / 24))
    return tile


def surface_of(tile, x, y):
    """Elevation and normals of both layers of a tile at places."""
    n, height, slope = tile.cells, np.zeros_like(x), np.zeros((*x.shape, 2))
    waves, slopes = tile.elevation, tile.slopes().astype(float)
    for turn in (0.0, 1.0):
        c, s = math.cos(turn), math.sin(turn)
        at = np.stack([c * y - s * x, c * x + s * y]) * n / tile.size - 0.5
        height += ndimage.map_coordinates(waves, at, order=3, mode="grid-wrap")
        p, q = (ndimage.map_coordinates(a, at, order=3, mode="grid-wrap") for a in slopes)
        slope += np.stack([c * p - s * q, s * p + c * q], axis=-1)
    normal = np.concatenate([-slope, np.ones((*x.shape, 1))], axis=-1)
    return height, normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def drawn_rings(tile, camera):
    """The luminance of all pixels by our shading, sky and bed known."""
    view, depth = view_of(camera), plain(camera)
    shape = depth.shape
    record = np.zeros((depth.size, water_record.RECORD), np.float32)
    for k, t in enumerate(depth.ravel()):
        pixel = surface_at(view, *divmod(k, shape[1]), t)
        water_record.write_level(pixel._replace(ripple_share=np.float32(1)), record[k])
    ripples = Ripples(ripple_moments(tile.slopes()), np.float32(tile.size))
    water_shading.tilt_water(ripples, DRY_TOPS, record)
    light = np.full((len(record), 3), np.nan, np.float32)
    source = np.zeros(len(record), np.uint8)
    screen_space.environment_light(np.arange(len(record)), record, sky(), light, source)
    slope = record[:, water_record.SLOPE_X : water_record.SLOPE_Y + 1].astype(float)
    normal = np.column_stack([-slope, np.ones(len(slope))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    seen = record[:, water_record.VIEW_X : water_record.VIEW_Z + 1].astype(float)
    share = np.vectorize(fresnel)(np.maximum(-(seen * normal).sum(axis=1), 0.02))
    return ((1 - share) * BED + share * light[:, 1]).reshape(shape)


@pytest.mark.parametrize(("eye", "fov", "size", "contrast"), [
    ((-0.6, 0.0, 0.45), 40, (144, 108), 0.15), ((-1.0, 0.0, 0.3), 24, (144, 60), 0.18),
])  # fmt: skip
def test_a_field_of_rings_is_that_of_a_path_tracer(eye, fov, size, contrast):
    mitsuba.set_variant("scalar_rgb")
    tile = rained_on()
    camera = look_at(eye, (0.1, 0.0, 0.0), (0, 0, 1), fov, *size)
    side = np.linspace(-1.5, 1.5, 1501)
    x, y = np.meshgrid(side, side)
    height, normal = surface_of(tile, x, y)
    points = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    water = mesh("water", points, grid_faces(1501, 1501), normal.reshape(-1, 3))
    one, two = (traced(camera, 256, 8, seed, water=water).ravel() for seed in (1, 2))
    ours, truth = drawn_rings(tile, camera).ravel(), (one + two) / 2
    # What both runs share is no noise.
    signal = np.cov(one, two)[0, 1]
    shared = np.cov(ours, truth)[0, 1]
    print(
        f"rings: mean {ours.mean() / truth.mean():.4f}, contrast {ours.std() / signal**0.5:.3f}, "
        f"correlation {shared / (ours.std() * signal**0.5):.3f}, deviation {signal**0.5:.4f}"
    )
    assert ours.mean() == pytest.approx(truth.mean(), rel=0.02)
    assert ours.std() == pytest.approx(signal**0.5, rel=contrast)
    assert shared / (ours.std() * signal**0.5) > 0.9


# ---- a crown

DROP, WATER, AGE, OPEN, UNEVEN = 4e-3, 2e-3, 6e-3, 1e-4, 1e-4  # m, m, s, s, m


def crown_mesh(impact, rim):
    """The crown of an impact as a body of water: a sheet under a round rim, seamless around."""
    shape = crown.crown_shape(impact, relative_size(impact.depth / impact.diameter), 1e-4)
    passed = AGE / shape.life
    ring = crown._Ring(0.0, 0.0, 0.0, shape.growth * math.sqrt(AGE),
                       shape.height * 4 * passed * (1 - passed), 1.0)  # fmt: skip
    with np.errstate(over="ignore"):
        word = crown.subkey(impact.key, (1 << 20) + 1)
        phase_1, phase_2, wave = crown.uniform_triple(word)
    around, sheet, fingers = 240, 0.35 * rim, crown.fingers_of(shape, wave)
    rows = []
    turn = 2 * math.pi * np.arange(around) / around
    for angle in turn:
        out, high, cosine, sine = crown._rim_point(angle, ring, fingers, phase_1, phase_2)
        foot = np.array([ring.foot, 1e-4])
        top = np.array([out, high])
        along = (top - foot) / np.linalg.norm(top - foot)
        aside = np.array([along[1], -along[0]])
        ball = [top + rim * (math.cos(a) * aside + math.sin(a) * along)
                for a in np.linspace(-0.9, math.pi + 0.9, 16)]  # fmt: skip
        inside, outside = foot - sheet * aside, foot + sheet * aside
        wall = [outside + (ball[0] - outside) * f for f in np.linspace(0, 1, 8)[:-1]]
        back = [ball[-1] + (inside - ball[-1]) * f for f in np.linspace(0, 1, 8)[1:]]
        profile = np.array([*wall, *ball, *back, (inside + outside) / 2 - [0, 5e-5]])
        k = np.arange(len(profile))
        shift = np.sin(37 * angle + 1.3 * k) + np.sin(23 * angle - 0.9 * k + 2)
        profile[1:-1] += UNEVEN * shift[1:-1, None] * aside
        rows.append(np.column_stack([profile[:, 0] * cosine, profile[:, 0] * sine, profile[:, 1]]))
    points = np.array(rows)
    n, m = points.shape[:2]
    index = np.arange(n * m).reshape(n, m)
    a, b = index, np.roll(index, -1, axis=0)
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    faces = np.concatenate([
        np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)
    ])  # fmt: skip
    return points.reshape(-1, 3), faces


def drawn_crown(camera, speed):
    """Share of light that a crown of a drop of DROP on WATER replaces AGE after its fall."""
    fallen = Impacts(
        np.zeros((1, 3)), np.array([[0, 0, -speed]]), np.array([DROP]), np.array([-AGE]),
        np.zeros(1, np.uint8), np.zeros(1, np.int32), np.zeros(1, np.int32),
        np.array([99], np.uint64),
    )  # fmt: skip
    ground, depth = flat_surfaces(2, 2, 0.1, (-1.0, -1.0)), plain(camera)
    alpha = np.full(depth.shape, np.nan, np.float32)
    draw_splashes(
        RainField(RainSpectrum(1e-6)), ground, camera, 0.0, OPEN,
        np.full(ground.shape, WATER, np.float32), 0.0, depth, alpha, more=fallen,
    )  # fmt: skip
    return alpha


@pytest.mark.parametrize("pitch", [8, 26, 50, 75])
def test_a_crown_adds_as_much_light_as_in_a_path_tracer(pitch):
    mitsuba.set_variant("scalar_rgb")
    speed = float(terminal_speed(DROP))
    impact = Impact(np.uint64(99), 0.0, 0.0, 0.0, 0.0, 0.0, speed, DROP, WATER, AGE)
    down = math.radians(pitch)
    eye = (-0.55 * math.cos(down), 0.0, 0.55 * math.sin(down) + 4e-3)
    camera = look_at(eye, (0.0, 0.0, 4e-3), (0, 0, 1), 8, 120, 90)
    alpha = drawn_crown(camera, speed)
    shown = ndimage.binary_dilation(alpha > 0.005, iterations=2)
    x, y = np.meshgrid([-5.0, 5.0], [-5.0, 5.0])
    flat = mesh("water", np.stack([x, y, 0 * x], -1).reshape(-1, 3), grid_faces(2, 2))
    body = mesh("crown", *crown_mesh(impact, 0.5 * crown._RIM * DROP))
    truth = traced(camera, 500, 30, water=flat, crown=body)
    row = np.arange(len(truth))[:, None] + 0 * truth
    fit = np.polynomial.polynomial.polyfit(row[~shown], truth[~shown], 4)
    bare = np.polynomial.polynomial.polyval(row, fit)
    view, gloss = view_of(camera), sky()
    mean = drop_radiance.mean_radiance(gloss)
    drops, sheets = drop_radiance.falling_light(
        gloss, mean, view.ground_from_camera, view.lens, np.full((90, 120, 3), BED, np.float32),
        plain(camera),
    )  # fmt: skip
    added = (alpha * (splash_light(drops[4, 6, 1], sheets[4, 6, 1]) - bare)).sum()
    wanted = (truth - bare)[shown].sum()
    print(f"crown at {pitch} degrees: {added:.1f} drawn, {wanted:.1f} traced")
    assert wanted > 10
    assert 0.5 < added / wanted < 1.6
