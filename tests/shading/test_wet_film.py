"""What the film on wet ground mirrors, against closed forms and rays drawn at random."""

import math

import numpy as np
import pytest

from benchmarks.film import film_accuracy, film_line
from rainsim.config.settings import Config
from rainsim.numerics.ripmap import ripmap
from rainsim.pipeline import extract_terrain, simulate
from rainsim.render.renderer import Renderer
from rainsim.scene.view import View
from rainsim.shading import microfacet, wet_ground_mirror
from rainsim.shading.fresnel import EXACT, SCHLICK, schlick
from rainsim.shading.wet_ground_mirror import GroundSlopes, LevelPicture
from rainsim.terrain.table import HARD, class_table
from scenes import tiny_scene

F4 = np.float32
EYE = np.array([0, 0, 1.5], F4)
# A level camera that looks along y; rows of the ground frame's axes in columns.
TURN = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], F4)
WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
LENS = np.array([FOCAL, FOCAL, WIDTH / 2, 6], F4)
VIEW = View(TURN, EYE, *LENS)
FORWARD = np.array([0, 1], F4)
CELLS, SPACING = 20, F4(2.0)
ORIGIN = np.array([-20, -5], F4)


def dielectric(cosine):
    """Return Fresnel's reflectance of water, float64."""
    t = np.sqrt(1 - (1 - cosine**2) / 1.333**2)
    s, p = (cosine - 1.333 * t) / (cosine + 1.333 * t), (1.333 * cosine - t) / (1.333 * cosine + t)
    return (s**2 + p**2) / 2


def smith(tangent, slope):
    """Return Smith's Lambda of a Gaussian surface, exact."""
    a = tangent / slope
    erfc = np.vectorize(math.erfc)(a / math.sqrt(2))
    return np.exp(-a * a / 2) / (a * math.sqrt(2 * math.pi)) - erfc / 2


def facets(view, slope, count, rng):
    """Return mirrored rays (n, 3) and weights (n,) whose sum is the reflectance.

    Facets are drawn by their slopes and weighted by how large they are seen.
    """
    sx, sy = rng.normal(0, slope, (2, count))
    normal = np.stack([-sx, -sy, np.ones(count)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    cosine = np.maximum(-normal @ view, 0)
    seen = cosine / normal[:, 2]
    ray = view + 2 * cosine[:, None] * normal
    rise = ray[:, 2] / np.hypot(ray[:, 0], ray[:, 1])
    up = rise > 1e-3
    out = 1 + smith(-view[2] / np.hypot(view[0], view[1]), slope)
    hidden = smith(np.where(up, rise, 1), slope)
    weight = seen / seen.sum() * dielectric(cosine) * np.where(up, out / (out + hidden), 0)
    return ray, weight


def level_ground(slope=0.2):
    ground = np.zeros((CELLS, CELLS, 4), F4)
    ground[..., 3] = slope
    return ground


def field_of(atlas, depth, environment, poisoned, ground=None, law=EXACT):
    wanted = np.ones((HEIGHT, WIDTH), bool)
    field = poisoned((HEIGHT, WIDTH, 3))
    slopes = level_ground() if ground is None else ground
    wet_ground_mirror.mirrored_field(
        VIEW, 1, wanted, GroundSlopes(slopes, ORIGIN, SPACING, law), microfacet.LOBE,
        LevelPicture(atlas, depth, LENS, FORWARD), environment, field,
    )  # fmt: skip
    assert np.isfinite(field).all()
    return field


def test_lobe_has_the_moments_of_the_visible_facets():
    mean, width = microfacet.LOBE[..., 0].astype(float), microfacet.LOBE[..., 1].astype(float)
    np.testing.assert_allclose(mean[-1] @ microfacet.PARTS, 0, atol=2e-3)
    np.testing.assert_allclose(
        (mean[-1] ** 2 + width[-1] ** 2 / 12) @ microfacet.PARTS, 1, rtol=2e-3
    )
    # At a grazing angle the density is x exp(-x^2 / 2): mean sqrt(pi / 2).
    np.testing.assert_allclose(mean[0] @ microfacet.PARTS, math.sqrt(math.pi / 2), rtol=2e-3)
    assert (np.diff(mean, axis=1) > 0).all()


@pytest.mark.parametrize("slope", [0.1, 0.2, 0.3])
def test_reflectance_is_that_of_facets_drawn_at_random(slope, rng, poisoned):
    tangent = np.array([0.02, 0.1, 0.3, 1, 3], F4)
    share = poisoned(tangent.shape)
    microfacet.ground_reflectance(microfacet.LOBE, tangent, F4(slope), share)
    for t, found in zip(tangent, share, strict=True):
        view = np.array([1, 0, -t]) / math.hypot(1, t)
        wanted = facets(view, slope, 60_000, rng)[1].sum()
        assert found == pytest.approx(wanted, rel=0.07, abs=2e-3)
    assert (share < 1).all() and (np.diff(share[1:]) < 0).all()


@pytest.mark.parametrize("degrees", [10, 28, 38, 60])
def test_what_is_mirrored_stands_as_high_as_facets_drawn_at_random_mirror(degrees, rng):
    """Facets that lean across the plane of view mirror lower: seen at 60 degrees by 9."""
    slope, tangent = 0.2, math.tan(math.radians(degrees))
    ray, weight = facets(np.array([1, 0, -tangent]) / math.hypot(1, tangent), slope, 60_000, rng)
    wanted = np.degrees(np.arcsin(ray[:, 2])) @ weight / weight.sum()
    parts = np.array([
        microfacet.lobe_part(microfacet.LOBE, k, F4(tangent), F4(0), F4(slope), EXACT)
        for k in range(microfacet.SAMPLES)
    ])  # fmt: skip
    found = np.degrees(np.arctan(parts[:, 0])) @ parts[:, 1] / parts[:, 1].sum()
    assert found == pytest.approx(wanted, abs=2)


def test_the_film_mirrors_by_the_law_that_is_named(poisoned):
    """A smooth film seen from above: between the angles where Schlick's law is right, it is low."""
    atlas, depth, *_ = wet_ground_mirror.NO_LEVEL_PICTURE
    white, ground = np.ones((8, 16, 3), F4), level_ground(0.01)
    exact, approximate = (
        field_of(atlas, depth, white, poisoned, ground, law)[..., 0] for law in (EXACT, SCHLICK)
    )
    row = 40
    sine = (row + 0.5 - LENS[3]) / np.hypot(FOCAL, row + 0.5 - LENS[3])
    assert approximate[row, 32] == pytest.approx(schlick(F4(sine)), rel=0.02)
    assert approximate[row, 32] < 0.97 * exact[row, 32]


ONE_DEGREE = math.radians(1)  # at which road tables are seen
WET_ASPHALT = 0.03  # sr^-1, luminance coefficient of what is not mirrored


def facet_coefficient(beta, tangent, slope):
    """Return the luminance coefficient [sr^-1] of the facets in closed form, float64.

    The lamp stands at an angle of `tangent` from the zenith, `beta` [rad] off the plane of view.
    """
    eye = np.array([math.cos(ONE_DEGREE), 0, math.sin(ONE_DEGREE)])
    gamma = np.arctan(tangent)
    light = np.stack([-np.sin(gamma) * np.cos(beta), np.sin(gamma) * np.sin(beta),
                      np.cos(gamma)], -1)  # fmt: skip
    half = light + eye
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    square = (half[..., 0] ** 2 + half[..., 1] ** 2) / half[..., 2] ** 2
    density = np.exp(-square / (2 * slope**2)) / (2 * math.pi * slope**2)
    seen = 1 + smith(eye[2] / eye[0], slope) + smith(1 / np.maximum(tangent, 1e-2), slope)
    mirrored = dielectric(half @ eye) * density / (
        4 * eye[2] * light[..., 2] * half[..., 2] ** 4 * seen
    )  # fmt: skip
    return WET_ASPHALT + mirrored


def lobe_coefficient(beta, tangent, slope):
    """Return the luminance coefficient that the parts of the program's lobe make."""
    dip = F4(math.tan(ONE_DEGREE))
    parts = [
        microfacet.lobe_part(microfacet.LOBE, k, dip, F4(0), F4(slope), EXACT)
        for k in range(microfacet.SAMPLES)
    ]
    rise, weight, facet, width = np.array(parts, np.float64).T
    elevation, middle = np.arctan2(1, tangent), np.arctan(rise)
    density = np.interp(elevation, middle, weight / width, right=0)
    spread = np.interp(elevation, middle, 2 * slope * facet * np.hypot(1, rise))
    ahead = np.cos(beta) > 1e-9
    aside = np.tan(np.where(ahead, beta, 0))
    across = ahead * np.exp(-0.5 * (aside / spread) ** 2) / (math.sqrt(2 * math.pi) * spread)
    return WET_ASPHALT + density * across * (1 + aside**2) / (np.cos(elevation) * np.sin(elevation))


def road_table(coefficient, slope):
    """Return the specular factor S1 and the mean luminance coefficient Q0 of a road."""
    x, y = np.meshgrid(np.linspace(-4, 12, 160), np.linspace(-3, 3, 61))  # mounting heights
    tangent, beta = np.hypot(x, y), np.arctan2(y, x)
    angle = (1 + tangent**2) ** -1.5
    special = coefficient(0.0, np.array(2.0), slope) * math.cos(math.atan(2)) ** 3
    special /= coefficient(0.0, np.array(1e-2), slope)
    return float(special), float((coefficient(beta, tangent, slope) * angle).sum() / angle.sum())


def test_paving_reflects_as_wet_roads_do():
    """Specular factor S1 and mean luminance coefficient Q0 of the standard tables W2 to W4.

    CIE 47-1979, classes after van Bommel 2015 (Road Lighting, table 12.3): W2 has S1 of 4.5 to 7.2
    and Q0 0.150, W3 7.2 to 9.8 and 0.196, W4 9.8 to 12 and 0.247, seen at one degree.
    """
    for slope in (0.2, 0.25, 0.3):
        exact = road_table(facet_coefficient, slope)
        found = road_table(lobe_coefficient, slope)
        assert found[0] == pytest.approx(exact[0], rel=0.06)
        # The density is interpolated between the parts, and cut off beyond the last.
        assert found[1] == pytest.approx(exact[1], rel=0.15)
    special, mean = road_table(lobe_coefficient, float(class_table().column("film_slope")[HARD]))
    assert 9.8 < special < 12 and mean == pytest.approx(0.247, rel=0.1)  # W4


def test_levels_of_the_ripmap_are_means_of_blocks(rng):
    picture = rng.uniform(0, 1, (64, 128, 3)).astype(F4)
    atlas = ripmap(picture, 0)
    height, width = 64, 128
    for down, across in ((0, 0), (2, 0), (0, 3), (3, 1)):
        high, wide = height >> down, width >> across
        top, left = 2 * (height - high), 2 * (width - wide)
        means = picture.reshape(high, 1 << down, wide, 1 << across, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(
            atlas[top : top + high, left : left + wide], means, rtol=1e-4, atol=1e-6
        )
    # Rows above the horizon show what is at the horizon.
    np.testing.assert_array_equal(ripmap(picture, 5)[:5, :128], np.tile(picture[5], (5, 1, 1)))


@pytest.mark.parametrize("pictured", [True, False])
def test_white_surroundings_give_the_reflectance_and_no_more(pictured, poisoned):
    white = np.ones((16, 32, 3), F4)
    atlas, depth = wet_ground_mirror.NO_LEVEL_PICTURE[:2]
    if pictured:
        atlas = ripmap(np.ones((HEIGHT, WIDTH, 3), F4), 6)
        depth = np.full((HEIGHT, WIDTH), 9, F4)
    field = field_of(atlas, depth, white, poisoned)
    assert (field <= 1).all() and (field >= 0).all()
    dip = (np.arange(HEIGHT) + 0.5 - 6) / FOCAL
    below = dip > 0.01
    share = poisoned(below.sum())
    microfacet.ground_reflectance(microfacet.LOBE, dip[below].astype(F4), F4(0.2), share)
    np.testing.assert_allclose(field[below, WIDTH // 2, 0], share, rtol=2e-3)


def panel_light(origin, ray, distance, left, right, low, high):
    """Return whether rays meet a glowing panel across the view; a dark wall stands around it."""
    along = (distance - origin[1]) / np.where(ray[:, 1] > 0, ray[:, 1], np.nan)
    x, z = origin[0] + along * ray[:, 0], along * ray[:, 2]
    return (x > left) & (x < right) & (z > low) & (z < high)


@pytest.mark.parametrize(("slope", "least"), [(0.2, 0.98), (0.06, 0.95)])
def test_a_window_makes_the_streak_that_rays_drawn_at_random_make(slope, least, rng, poisoned):
    """A lit window in a dark wall: the field against 2000 facets a block."""
    distance, panel = 12.0, (-0.6, 0.6, 1.0, 2.5)
    v, u = np.indices((HEIGHT, WIDTH)) + 0.5
    # The mirrored camera sees the wall's point at height z where z + eye height is below it.
    x, z = (u - LENS[2]) / FOCAL * distance, (v - LENS[3]) / FOCAL * distance - EYE[2]
    lit = (x > panel[0]) & (x < panel[1]) & (z > panel[2]) & (z < panel[3])
    picture = np.repeat(lit[..., None], 3, axis=-1).astype(F4)
    depth = np.where(z > 0, distance, np.inf).astype(F4)  # below the wall's foot lies ground
    dark = np.zeros((16, 32, 3), F4)
    atlas = ripmap(picture, 6)
    field = field_of(atlas, depth, dark, poisoned, level_ground(slope))[..., 0]
    wanted = np.zeros_like(field)
    ground = (v - LENS[3]) / FOCAL > EYE[2] / distance  # before the wall
    ground &= (u % 4 < 1) & (abs(u - LENS[2]) < 16)
    for j, i in zip(*np.nonzero(ground), strict=True):
        ray = np.array([(u[j, i] - LENS[2]) / FOCAL, 1, -(v[j, i] - LENS[3]) / FOCAL])
        spot = EYE + ray * EYE[2] / -ray[2]
        mirrored, weight = facets(ray / np.linalg.norm(ray), slope, 2000, rng)
        wanted[j, i] = (weight * panel_light(spot, mirrored, distance, *panel)).sum()
    assert wanted.max() > 0.03
    assert math.sqrt(((field - wanted)[ground] ** 2).mean()) < 0.06 * wanted.max()
    assert np.corrcoef(field[ground], wanted[ground])[0, 1] > least


def test_slope_of_the_ground_moves_what_it_mirrors(poisoned):
    """Ground that rises away from the eye mirrors what stands twice its slope higher."""
    picture = np.zeros((HEIGHT, WIDTH, 3), F4)
    picture[30:] = 1.0  # bright above an elevation of atan(24 / 60)
    depth = np.full((HEIGHT, WIDTH), np.inf, F4)
    dark = np.zeros((16, 32, 3), F4)
    rising = level_ground(0.06)
    rising[..., 2] = 0.05
    atlas = ripmap(picture, 6)
    level = field_of(atlas, depth, dark, poisoned, level_ground(0.06))[14:30, WIDTH // 2, 0]
    found = field_of(atlas, depth, dark, poisoned, rising)[14:30, WIDTH // 2, 0]
    assert found.sum() > 1.2 * level.sum() > 0


def test_ground_that_leans_aside_mirrors_what_stands_on_that_side(poisoned):
    """Ground that rises to the left throws mirrored rays, and so what it mirrors, to the right."""
    picture = np.zeros((HEIGHT, WIDTH, 3), F4)
    picture[:, WIDTH // 2 + 4 :] = 1.0
    atlas, depth = ripmap(picture, 6), np.full((HEIGHT, WIDTH), np.inf, F4)
    leaning = level_ground(0.06)
    leaning[..., 1] = -0.1
    dark = np.zeros((16, 32, 3), F4)
    level = field_of(atlas, depth, dark, poisoned, level_ground(0.06))[20, WIDTH // 2, 0]
    assert field_of(atlas, depth, dark, poisoned, leaning)[20, WIDTH // 2, 0] > 1.5 * level


def test_film_is_added_where_it_is(rng, poisoned):
    bare = rng.uniform(0, 1, (9, 13, 3)).astype(F4)
    cover = np.zeros((9, 13), F4)
    cover[4:, 6:] = 0.5
    wanted = np.zeros((3, 5), bool)
    wet_ground_mirror.wet_blocks(cover, 3, wanted)
    assert wanted[1:, 1:].all() and not wanted[:, 0].any() and not wanted[0, 0]
    field = np.full((3, 5, 3), 0.4, F4)
    picture = poisoned(bare.shape)
    wet_ground_mirror.add_reflection(bare, cover, field, 3, picture)
    np.testing.assert_allclose(picture - bare, 0.4 * cover[..., None] + 0 * bare, atol=1e-6)


def test_share_of_light_that_film_mirrors(poisoned):
    """Of full film on the lower half, seen from tangents of 0 to 0.7."""
    cover = np.zeros((HEIGHT, WIDTH), F4)
    cover[HEIGHT // 2 :] = 0.5
    u, v = np.meshgrid(
        np.arange(0, WIDTH, wet_ground_mirror.COARSE),
        np.arange(24, HEIGHT, wet_ground_mirror.COARSE),
    )
    a, b = (u + 0.5 - LENS[2]) / FOCAL, (v + 0.5 - LENS[3]) / FOCAL
    share = poisoned(u.size)
    microfacet.ground_reflectance(
        microfacet.LOBE,
        (b / np.hypot(a, 1)).astype(F4).ravel(),
        wet_ground_mirror.USUAL_SLOPE,
        share,
    )
    assert wet_ground_mirror.mean_share(VIEW, cover) == pytest.approx(share.mean() / 4, rel=5e-3)
    assert wet_ground_mirror.mean_share(VIEW, 0 * cover) == 0


def test_film_is_that_of_lobes_traced_through_the_splats():
    """On the yard: the mirrored picture is near the traced rays, the surroundings are not."""
    scene = tiny_scene()
    camera = scene.cameras[0].resized(48, 36)
    config = Config().replace(
        rate=0.0, past=2e-3, frames=1, width=48, extent=1.0, spacing=0.05, film="mirror"
    )
    terrain = extract_terrain(scene, config)
    state = next(simulate(terrain, config))
    renderer = Renderer(scene, terrain, config, camera)
    renderer.draw(camera, state)
    found = film_accuracy(renderer, camera, pixels=60, rays=24)
    assert found["mirror"]["psnr"] > 30
    assert found["mirror"]["psnr"] > found["environment"]["psnr"] + 3
    assert "dB" in film_line(found)
