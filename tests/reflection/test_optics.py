"""Water in the picture: a tank with a known floor, mirrors, contact, and what must not change."""

import itertools
import math

import numpy as np
import pytest

from rainsim import ssr
from rainsim.numerics.mipmap import coarsened
from rainsim.reflection import mirror_pass, paper, ray_water, screen_space, water_shading
from rainsim.reflection.planar_mirror import MirrorPicture
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.reflection.water_record import RECORD, WaterPixel
from rainsim.reflection.water_shading import Background, Optics, Ripples
from rainsim.reflection.water_surface import WaterMap
from rainsim.reflection.wet_tops import DRY_TOPS
from rainsim.scene.view import View
from rainsim.shading.fresnel import EXACT, SCHLICK, fresnel

WIDTH, HEIGHT, FOCAL = 120, 90, 100.0
LENS = np.array([FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2], np.float32)
# Camera 1.5 m above the ground, looking along +x and 30 degrees down.
PITCH = math.radians(30)
FORWARD = np.array([math.cos(PITCH), 0, -math.sin(PITCH)])
RIGHT = np.array([0, -1.0, 0])
DOWN = np.cross(FORWARD, RIGHT)
TURN = np.ascontiguousarray(np.stack([RIGHT, DOWN, FORWARD], axis=1), dtype=np.float32)
EYE = np.array([-2.0, 0, 1.5], np.float32)
VIEW = View(TURN, EYE, *LENS)
SPACING = 0.05
SHAPE = (160, 160)
ORIGIN = np.array([-4.0, -4.0], np.float32)


def mirrored_view(view, level):
    """The view of the camera mirrored at a level."""
    turn, eye = view.ground_from_camera * np.float32([[1], [1], [-1]]), view.eye.copy()
    eye[2] = 2 * np.float32(level) - eye[2]
    return view._replace(ground_from_camera=turn, eye=eye)


def ripples(slopes):
    return Ripples(ripple_moments(slopes), np.float32(1.0))


def rays():
    v, h = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    camera = np.stack([(h - LENS[2]) / FOCAL, (v - LENS[3]) / FOCAL, np.ones_like(h)], axis=-1)
    return camera @ TURN.T.astype(float)


def floor_picture(z=0.0):
    """Depth of a floor at height z, and a picture that holds each floor point's x and y."""
    ray = rays()
    with np.errstate(divide="ignore"):
        t = np.where(ray[..., 2] < 0, (z - EYE[2]) / ray[..., 2], np.inf)
    point = EYE + t[..., None] * np.where(np.isfinite(t[..., None]), ray, 0)
    picture = np.zeros((HEIGHT, WIDTH, 3))
    picture[..., 0], picture[..., 1] = point[..., 0], point[..., 1]
    picture[~np.isfinite(picture)] = 0
    return t.astype(np.float32), picture.astype(np.float32)


def water(depth_of_water, picture=None, depth=None, clearance=None, slopes=0.0, environment=None,
          sun=None, mirror=None, mirror_depth=None, level=0.0, cover=(0.4e-3, 2.2e-3), hard=False,
          schlick=False, shift=False, phong=False):  # fmt: skip
    """The picture with water on it, and the water's coverage."""
    floor_depth, floor = floor_picture()
    picture = floor if picture is None else picture
    depth = floor_depth if depth is None else depth
    clearance = np.zeros((HEIGHT, WIDTH), np.float32) if clearance is None else clearance
    deep = np.broadcast_to(np.float32(depth_of_water), SHAPE).copy()
    if environment is None:
        environment = np.zeros((16, 32, 3), np.float32)
    coverage = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    hit, count = np.full_like(coverage, np.nan), np.full(HEIGHT, -1, np.int64)
    rows, spacing = np.arange(HEIGHT), np.float32(SPACING)
    water_map = WaterMap(deep, deep, np.ones(SHAPE, np.float32), ORIGIN, spacing)
    found = hit, coverage, count
    if hard:
        paper.meet_hard(depth, VIEW, water_map, deep.max(), *found)
    else:
        cover = np.array(cover, np.float32)
        ray_water.meet_water(depth, VIEW, water_map, deep.max(), rows, cover, *found)
    assert np.isfinite(coverage).all() and (count == (coverage > 0).sum(axis=1)).all()
    n = count.sum()
    pixel, record = np.full(n, -1, np.int32), np.full((n, RECORD), np.nan, np.float32)
    water_shading.list_water(
        hit, coverage, np.cumsum(count) - count, rows, VIEW, water_map, DRY_TOPS, pixel, record
    )
    # Of the tile whose layers, one turned by a radian, together slope so.
    turn = np.array([[math.cos(1), -math.sin(1)], [math.sin(1), math.cos(1)]])
    slopes = np.linalg.solve(np.eye(2) + turn, np.broadcast_to(slopes, 2))[:, None, None]
    water_shading.tilt_water(ripples(np.tile(slopes, (1, 32, 32))), DRY_TOPS, record)
    assert np.isfinite(record).all()
    light, source = np.full((n, 3), np.nan, np.float32), np.full(n, 99, np.uint8)
    if mirror is not None:
        mirror_pass.mirror_light(
            np.arange(n), record, mirrored_view(VIEW, level),
            MirrorPicture(mirror, coarsened(mirror), mirror_depth), light, source,
        )  # fmt: skip
    else:
        tall = np.full_like(depth, np.nan)
        screen_space.keep_tall(depth, clearance, tall)
        bounds = np.full(ssr.bounds_of(*depth.shape), np.nan, np.float32)
        ssr.block_bounds(tall, bounds)
        screen_space.march_light(
            np.arange(n), record, picture, ssr.DepthBlocks(tall, bounds), VIEW, environment,
            ssr.MarchSettings(*np.float32([0.15, 1, 12])), light, source,
        )  # fmt: skip
    assert np.isfinite(light).all() and (source != 99).all()
    sun = np.zeros(6, np.float32) if sun is None else sun
    out = picture.copy()
    out.reshape(-1, 3)[pixel] = np.nan
    optics = Optics(SCHLICK if schlick else EXACT, np.float32(4e-3), sun)
    given = pixel, record, light, Background(picture, picture, depth), VIEW, optics
    if shift or phong:
        paper.lay_paper_water(*given, paper.PaperLaws(shift, phong), out)
    else:
        water_shading.lay_water(*given, out)
    assert np.isfinite(out).all()
    return out, coverage


def test_dry_ground_is_left_alone():
    _, picture = floor_picture()
    out, coverage = water(0.0)
    assert not coverage.any()
    np.testing.assert_array_equal(out, picture)


def test_a_tanks_apparent_shift_is_snells():
    """Through 4 cm of water each pixel shows the floor point that refraction says."""
    deep = 0.04
    out, coverage = water(deep)
    ray = rays()
    unit = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    t = (deep - EYE[2]) / ray[..., 2]
    surface = EYE + t[..., None] * ray
    cosine = -unit[..., 2]
    sine_in = np.sqrt(1 - cosine**2) / 1.333
    shift = deep * sine_in / np.sqrt(1 - sine_in**2)
    flat = unit[..., :2] / np.linalg.norm(unit[..., :2], axis=-1, keepdims=True)
    floor = surface[..., :2] + shift[..., None] * flat
    mirror = np.vectorize(fresnel)(cosine)
    path = deep / np.sqrt(1 - sine_in**2)
    for channel, absorb in ((0, 5.0), (1, 5.5)):
        expected = floor[..., channel] * (1 - mirror) * np.exp(-absorb * (path + deep))
        inside = coverage > 0.999
        inside[:, :5] = inside[:, -5:] = False
        inside[:8] = inside[-5:] = False  # where the shifted point leaves the picture
        assert inside.sum() > 2000
        # Half a pixel on the floor, in metres, for each pixel's own footprint.
        footprint = t * np.linalg.norm(ray, axis=-1) / FOCAL / np.maximum(cosine, 0.05)
        assert (np.abs(out[..., channel] - expected) < 0.5 * footprint)[inside].all()
    dry = floor_picture()[1]
    assert np.abs(out - dry).max() > 0.02


def test_mirrors_the_sky_by_fresnel_where_the_floor_is_black():
    environment = np.full((16, 32, 3), 2.0, np.float32)
    out, coverage = water(0.02, picture=np.zeros((HEIGHT, WIDTH, 3), np.float32),
                          environment=environment)  # fmt: skip
    unit = rays() / np.linalg.norm(rays(), axis=-1, keepdims=True)
    expected = 2.0 * np.vectorize(fresnel)(np.clip(-unit[..., 2], 0.02, 1))
    inside = coverage > 0.999
    np.testing.assert_allclose(out[..., 1][inside], expected[inside], rtol=1e-4)


def test_a_white_furnace_stays_white_or_darker():
    """Light of 1 from everywhere, bed and sky: water gives back at most 1, clear water nearly 1."""
    white = np.ones((16, 32, 3), np.float32)
    bed = np.ones((HEIGHT, WIDTH, 3), np.float32)
    for slopes in (0.0, 0.05, (0.2, -0.1)):
        for schlick in (False, True):
            out, coverage = water(0.003, bed, environment=white, slopes=slopes, schlick=schlick)
            assert out.max() <= 1 + 1e-5
            assert out[coverage > 0.99].min() > 0.9  # 3 mm of water absorb little
    clear, _ = water(0.003, bed, environment=white, shift=True)
    np.testing.assert_allclose(clear, 1, atol=1e-5)
    deep, coverage = water(0.5, bed, environment=white)
    assert deep[coverage > 0.99].mean() < 0.5


def test_water_absorbs_by_beer_and_lambert():
    bed = np.ones((HEIGHT, WIDTH, 3), np.float32)
    cosine = -(rays() / np.linalg.norm(rays(), axis=-1, keepdims=True))[..., 2]
    through = 1 - np.vectorize(fresnel)(np.clip(cosine, 0.02, 1))
    for deep in (0.01, 0.05, 0.2):
        out, coverage = water(deep, bed)
        path = deep * (1 + 1 / np.sqrt(1 - (1 - cosine**2) / 1.333**2))
        inside = coverage > 0.999
        assert inside.sum() > 2000
        for channel, absorb in enumerate((5.0, 5.5, 7.0)):
            expected = through * np.exp(-absorb * path)
            np.testing.assert_allclose(out[..., channel][inside], expected[inside], rtol=1e-4)


def test_mirrors_a_wall_that_the_picture_shows():
    """A bright wall at x = 2: the water shows it where the mirrored ray ends in the picture."""
    depth, picture = floor_picture()
    ray = rays()
    t_wall = (2.0 - EYE[0]) / ray[..., 0]
    top = EYE[2] + t_wall * ray[..., 2]
    wall = (t_wall < depth) & (top > 0) & (t_wall > 0)
    depth = np.where(wall, t_wall, depth).astype(np.float32)
    picture = np.where(wall[..., None], 1.0, 0.0) * np.ones(3)
    clearance = np.where(wall, top, 0).astype(np.float32)
    out, coverage = water(0.005, picture.astype(np.float32), depth, clearance)
    unit = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    mirror = np.vectorize(fresnel)(np.clip(-unit[..., 2], 0.02, 1))
    t = (0.005 - EYE[2]) / ray[..., 2]
    point = EYE + t[..., None] * ray
    height = 0.005 - ray[..., 2] / ray[..., 0] * (2.0 - point[..., 0])  # on the wall
    # The wall's highest visible row is at the top of the picture.
    inside = (coverage > 0.999) & ~wall & (height < top[12].min()) & (height > 0.1)
    inside[:, :20] = inside[:, -20:] = False  # where the mirror fades to the surroundings
    assert inside.sum() > 300
    np.testing.assert_allclose(out[..., 0][inside], mirror[inside], rtol=0.05)


def test_mirrored_pass_is_shown_as_it_is_on_flat_water_and_bent_on_ripples():
    """A mirrored picture of stripes: flat water shows each pixel its own, a slope moves it."""
    stripes = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    stripes[::2] = 1.0
    far = np.full((HEIGHT, WIDTH), 20.0, np.float32)
    black = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    out, coverage = water(0.005, black, mirror=stripes, mirror_depth=far, level=0.005)
    unit = rays() / np.linalg.norm(rays(), axis=-1, keepdims=True)
    share = np.vectorize(fresnel)(np.clip(-unit[..., 2], 0.02, 1))
    inside = coverage > 0.999
    assert inside.sum() > 2000
    np.testing.assert_allclose((out / share[..., None])[inside], stripes[inside], atol=2e-3)
    # A surface that rises away from the camera by a slope s turns the mirror ray by 2 s.
    ramp = np.tile(np.arange(HEIGHT, dtype=np.float32)[:, None, None], (1, WIDTH, 3))
    slope = 0.01
    bent, coverage = water(0.02, black, mirror=ramp, mirror_depth=np.full_like(far, 1e4),
                           level=0.02, slopes=(slope, 0.0))  # fmt: skip
    row, column = 60, WIDTH // 2
    angle = math.atan((row + 0.5 - HEIGHT / 2) / FOCAL)
    # The sky is far: its mirror image moves by the angle that the mirror turns the ray.
    expected = HEIGHT / 2 - 0.5 + FOCAL * math.tan(angle + 2 * slope)
    shares = bent[row, column, 0] / fresnel(math.sin(PITCH + angle + slope))
    assert abs(abs(shares - row) - abs(expected - row)) < 0.15
    assert abs(shares - row) > 1


def test_what_stands_above_the_water_is_not_painted_over():
    depth, picture = floor_picture()
    nearer = (depth * 0.7).astype(np.float32)  # an object well above the water
    out, coverage = water(0.02, depth=nearer, clearance=np.full_like(depth, 0.4))
    assert not coverage.any()
    np.testing.assert_array_equal(out, picture)


@pytest.mark.parametrize("side, over, hides", [(1, 0.02, False), (3, 0.02, True), (1, 0.1, True)])
def test_noise_of_the_depth_makes_no_holes_in_water(side, over, hides):
    depth, _ = floor_picture()
    _, before = water(0.02)
    row, column = (int(n) for n in np.argwhere(before > 0.999).mean(axis=0))
    nearer = depth.copy()
    part = np.s_[row - side // 2 : row + side // 2 + 1, column - side // 2 : column + side // 2 + 1]
    nearer[part] = ((0.02 + over - EYE[2]) / rays()[part][..., 2]).astype(np.float32)
    _, coverage = water(0.02, depth=nearer)
    assert before[part].min() > 0.999 and (coverage[row, column] < 0.01) == hides
    coverage[part] = before[part]
    np.testing.assert_array_equal(coverage, before)


def test_coverage_grows_with_depth_and_softly():
    middle = (HEIGHT // 2, WIDTH // 2)
    values = [water(d)[1][middle] for d in (0.0003, 0.0008, 0.0013, 0.0018, 0.003)]
    assert values[0] == 0 and values[-1] == 1
    assert all(a < b for a, b in itertools.pairwise(values))


def test_ripples_bend_the_mirror():
    environment = np.zeros((64, 128, 3), np.float32)
    environment[:32] = np.linspace(2, 0, 32)[:, None, None]
    black = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    flat, coverage = water(0.02, black, environment=environment)
    bent, _ = water(0.02, black, environment=environment, slopes=0.1)
    assert np.abs(bent - flat)[coverage > 0.99].mean() > 0.001


def tilting_water(view, variance):
    """A pixel of level water whose slopes vary, seen along `view`."""
    level = WaterPixel(*np.zeros(RECORD))._replace(view_x=view[0], view_y=view[1], view_z=view[2])
    return level._replace(variance_x=1.3 * variance, variance_y=variance, covariance=2e-3)


def test_sun_glint_integrates_to_the_reflected_sun():
    """The slope density integrates to one: a rough level mirror loses no sunlight."""
    n = 400
    tilt = np.linspace(-0.35, 0.35, n)
    total = 0.0
    variance = 4e-3
    for gx in tilt[::8]:
        for gy in tilt[::8]:
            h = np.array([-gx, -gy, 1.0])
            h /= np.linalg.norm(h)
            sun = np.array([0.3, 0.1, 0.9])
            sun /= np.linalg.norm(sun)
            view = sun - 2 * (sun @ h) * h  # from the eye to the water: v with half vector h
            value = water_shading.sun_glint(tilting_water(view, variance), *sun, EXACT, 0.0)
            f = fresnel(sun @ h)
            # radiance * cos(view) * 4 h_z^4 / F is the density of slopes.
            total += value / f * 4 * h[2] ** 4 * max(-view[2], 0.05) * (tilt[8] - tilt[0]) ** 2
    assert total == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("above", [0.3, 0.02, 1e-3, 0.0, -0.02, -0.5])
def test_a_camera_at_or_under_the_water_sees_none_and_nothing_breaks(above):
    level = np.float32(0.5)
    eye = EYE.copy()
    eye[2] = level + np.float32(above)
    ray = rays()
    with np.errstate(divide="ignore"):
        t = np.where(ray[..., 2] < 0, -eye[2] / ray[..., 2], np.inf)
    depth = np.where(t > 0, t, np.inf).astype(np.float32)
    deep = np.full(SHAPE, level, np.float32)
    coverage = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    hit, count = np.full_like(coverage, np.nan), np.full(HEIGHT, -1, np.int64)
    rows, spacing = np.arange(HEIGHT), np.float32(SPACING)
    view = View(TURN, eye, *LENS)
    water_map = WaterMap(deep, deep, np.ones(SHAPE, np.float32), ORIGIN, spacing)
    cover = np.array([0.4e-3, 2.2e-3], np.float32)
    ray_water.meet_water(depth, view, water_map, level, rows, cover, hit, coverage, count)
    n = count.sum()
    assert np.isfinite(coverage).all() and n == (coverage > 0).sum()
    assert (n > 0) == (above > 0)
    nothing = np.full_like(depth, np.inf), view, water_map, level, rows, cover
    ray_water.meet_water(*nothing, np.empty_like(hit), np.empty_like(hit), empty := count + 1)
    assert not empty.any()  # no water hangs where nothing was captured
    pixel, record = np.full(n, -1, np.int32), np.full((n, RECORD), np.nan, np.float32)
    water_shading.list_water(
        hit, coverage, np.cumsum(count) - count, rows, view, water_map, DRY_TOPS, pixel, record
    )
    water_shading.tilt_water(ripples(np.full((2, 32, 32), 0.03)), DRY_TOPS, record)
    light, source = np.full((n, 3), np.nan, np.float32), np.full(n, 99, np.uint8)
    mirror = np.full((HEIGHT, WIDTH, 3), 0.25, np.float32)
    mirror_pass.mirror_light(
        np.arange(n), record, mirrored_view(view, level),
        MirrorPicture(mirror, coarsened(mirror), np.full((HEIGHT, WIDTH), 3.0, np.float32)),
        light, source,
    )  # fmt: skip
    np.testing.assert_allclose(light, 0.25, rtol=1e-5)


def test_puddles_shorter_than_a_pixel_cover_their_share_of_it():
    spacing, up, turn = np.float32(0.05), 1.5, np.float32([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    place = (np.arange(1400) + 0.5) * spacing
    deep = np.tile(np.where(place % 0.9 < 0.3, 0.005, 0).astype("f4"), (80, 1))
    level = np.zeros_like(deep)
    water_map = WaterMap(level, deep, level + 1, np.float32([0, -2]), spacing)

    def covers(finer):  # rows below a level camera's horizon that show the ground from 5 m on
        height, eye = 30 * finer, np.float32([0, 0, up])
        view = View(turn, eye, *np.float32([100, 100 * finer, 2, -2.2 * finer]))
        row = np.arange(height)
        depth = 100 * finer * up / (row + 0.5 + 2.2 * finer)
        depth = np.tile(depth.astype("f4")[:, None], (1, 4))
        hit, covered = np.full((2, height, 4), np.nan, np.float32)
        given = depth, view, water_map, np.float32(0), row, np.float32([4e-4, 2.2e-3])
        ray_water.meet_water(*given, hit, covered, np.empty(height, np.int64))
        return covered

    coarse, fine = covers(1), covers(32).reshape(30, 32, 4).mean(axis=1)
    assert 0.2 < fine[:16].mean() < 0.5 and fine[16:].std() > 0.2
    np.testing.assert_allclose(coarse[:16], fine[:16], atol=0.15)  # of half a metre and more
    assert np.abs(coarse[:16] - fine[:16]).mean() < 0.07
