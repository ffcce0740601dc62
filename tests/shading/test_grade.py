"""The wet picture, drawn in chunks of vectors, against the same formulas pixel by pixel."""

import numpy as np
import pytest

import factories
from rainsim.constants import FAR_AWAY
from rainsim.numerics import pixel_batches
from rainsim.numerics.interpolation import map_place
from rainsim.scene.view import View, pixel_ray
from rainsim.shading import sky, surface_point, wet_pass, wetting
from rainsim.shading.dampness import find_dampness
from rainsim.shading.grading import OPAQUE, covered_share, undiluted
from rainsim.shading.smooth_normals import smooth_normal, turn_of
from rainsim.shading.surface_point import GroundMaps, SurfacePoint
from rainsim.shading.wetting import SkyMaps

F4 = np.float32
HEIGHT, WIDTH, CELLS = 3, wet_pass.CHUNK + 37, 40
ORIGIN, SPACING, UNIT = F4([-2, -2]), F4(0.1), F4(0.5)
LENS = F4([200, 210, WIDTH / 2, HEIGHT / 2])
EYE = F4([0, 0, 1])
TURN = np.array([[1, 0, 0], [0, -0.3, 0.954], [0, -0.954, -0.3]], F4)  # looks down a little
VIEW = View(TURN, EYE, *LENS)


def dull(open_sky):
    return factories.look(exposure=0.8, compression=0.9, sky_replaced=0.8, open_sky=open_sky,
                          albedo=0.85, tops_end=0.6, wetness=1.3)  # fmt: skip


@pytest.fixture
def dry():
    """Everything at random: ground, walls, half covered pixels, sky, places off the map."""
    rng = np.random.default_rng(4)
    normal = rng.normal(size=(HEIGHT, WIDTH, 3))
    normal[:, ::2] = TURN.T @ (0, 0, 1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    depth = rng.uniform(1, 9, (HEIGHT, WIDTH))
    depth[:, ::2] = rng.uniform(3, 8, (HEIGHT, 1))
    depth[rng.uniform(size=depth.shape) < 0.1] = 90
    alpha = np.minimum(rng.uniform(0, 3, depth.shape), 1)
    return {
        "color": rng.uniform(-0.1, 1.3, (HEIGHT, WIDTH, 3)).astype(F4),
        "alpha": alpha.astype(F4),
        "depth": np.where(alpha < 0.02, np.inf, depth).astype(F4),
        "plane_depth": np.where(alpha < 0.02, np.inf, depth * 1.02).astype(F4),
        "normal": normal.astype(F4),
        "bed": rng.normal(0, 0.2, (CELLS, CELLS)).astype(F4),
        "wetness": rng.uniform(0, 1, (CELLS, CELLS, 4)).astype(F4),
    }


@pytest.fixture
def poor():
    """Whether the bed is poorly known."""
    return False


@pytest.fixture
def scene(dry, poor):
    """What the picture is graded with but its look: ground, wetness off it, skies."""
    rng = np.random.default_rng(5)
    bodies = rng.integers(0, (20, 256, 256), (CELLS, CELLS, 3)).astype(np.uint8)
    ground = GroundMaps(dry.pop("bed"), dry.pop("wetness"), ORIGIN, SPACING, bodies)
    if poor:  # thick in the middle, none at a rim
        layer = np.clip(rng.normal(0.3, 0.3, (CELLS, CELLS)), 0, 0.9).astype(F4)
        ground = ground._replace(layer=layer, thickest_layer=layer.max())
    rain = factories.off_ground(supply=0.9, slant_x=0.2, slant_y=-0.4, film_left=0.8, porosity=0.3)
    return ground, rain, SkyMaps(sky.overcast(0.6), sky.overcast(0.7), sky.overcast())


def pixel_by_pixel(dry, ground, rain, skies, look, apart):
    """Return what `grade_and_wet` writes, by `wet_pixel`."""
    picture = np.zeros((HEIGHT, WIDTH, 3))
    depth, clearance, cover = (np.zeros((HEIGHT, WIDTH)) for _ in range(3))
    for row, column in np.ndindex(HEIGHT, WIDTH):
        at = row, column
        ray, normal = F4(pixel_ray(VIEW, row, column)), TURN @ dry.normal[at]
        length, alpha = F4(np.linalg.norm(ray)), dry.alpha[at]
        with np.errstate(invalid="ignore"):  # infinite depths
            d, e = surface_point.depth_of_surface(
                dry.depth[at] * UNIT, dry.plane_depth[at] * UNIT, normal[2]
            )
            point = SurfacePoint(*(EYE + e * ray), *normal, e * length)
            if ground.layer.size and surface_point.is_surface(alpha, ray[2]):
                *_, d, _, point = surface_point.seen_surface(
                    turn_of(TURN), VIEW, row, column, tuple(dry.normal[at]), dry.depth[at] * UNIT,
                    dry.plane_depth[at] * UNIT, dry, (HEIGHT, WIDTH), ground,
                )  # fmt: skip
        around = normal
        if dry.around > 0 and surface_point.is_surface(alpha, ray[2]):
            around = TURN @ F4(smooth_normal(
                dry.depth, dry.normal, row, column, HEIGHT, WIDTH, VIEW.fx, dry.around / UNIT
            ))  # fmt: skip
        *picture[at], clearance[at], cover[at] = wetting.wet_pixel(
            dry.color[at], alpha, ray / length, point, around, ground, rain, skies,
            look, apart,
        )  # fmt: skip
        depth[at] = d if surface_point.is_surface(alpha, ray[2]) else np.inf
    return picture, depth, clearance, cover


@pytest.mark.parametrize(
    ("open_sky", "apart", "poor"), [(0, False, False), (1, True, False), (1, True, True)]
)
def test_chunks_give_what_single_pixels_give(dry, scene, poisoned, open_sky, apart, poor):
    look = dull(open_sky)
    dry = wet_pass.DryPicture(**dry, meters_per_unit=UNIT, around=F4(0.4 if apart else 0))
    shape = HEIGHT, WIDTH
    found = [poisoned(s) for s in ((*shape, 3), shape, shape, shape if apart else (0, 0))]
    wet_pass.grade_and_wet(dry, VIEW, *scene, look, *found)
    wanted = pixel_by_pixel(dry, *scene, look, apart)
    for one, other in list(zip(found, wanted, strict=True))[: 4 if apart else 3]:
        if poor:  # rays that graze the bed meet it somewhere else by the last digits
            assert np.mean(np.isclose(one, other, rtol=2e-4, atol=2e-5)) > 0.95
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-2 if poor else 2e-5)
    on_map = wanted[2] < FAR_AWAY
    assert 0.1 < on_map.mean() < (1 if poor else 0.9) and np.isinf(wanted[1]).any()
    assert not apart or 0.05 < (wanted[3] > 0).mean() < 0.8


def test_the_layers_show_how_wet_the_place_is_that_is_wetted_and_what_it_covers(
    dry, scene, poisoned
):
    """Not the place that is drawn: along walls that one may lie beside the map."""
    dry["plane_depth"] = (dry["depth"] * np.where(np.arange(WIDTH) % 3, 1.02, 0.9)).astype(F4)
    dry = wet_pass.DryPicture(**dry, meters_per_unit=UNIT, around=F4(0.4))
    look = dull(open_sky=1)
    ground, rain, _ = scene
    *_, depth, _, _ = pixel_by_pixel(dry, *scene, look, True)
    found, matte = (poisoned((HEIGHT, WIDTH)) for _ in range(2))
    find_dampness(depth.astype(F4), dry, look, VIEW, ground, rain, found, matte)
    wanted, beside, whole = np.zeros((HEIGHT, WIDTH)), 0, matte.copy()
    for at in zip(*np.nonzero(np.isfinite(depth)), strict=True):
        ray, normal = F4(pixel_ray(VIEW, *at)), TURN @ dry.normal[at]
        d, e = surface_point.depth_of_surface(
            dry.depth[at] * UNIT, dry.plane_depth[at] * UNIT, normal[2]
        )
        length = F4(np.linalg.norm(ray))
        point = SurfacePoint(*(EYE + e * ray), *normal, e * length)
        clearance, above = surface_point.heights_of(point, True, ground)
        drawn = map_place(*(EYE + d * ray)[:2], ORIGIN, SPACING)
        beside += clearance < FAR_AWAY and not -0.5 < max(drawn, key=abs) < CELLS - 0.5
        if surface_point.ground_share(clearance, normal[2], F4(-1)) < 1:
            alpha, around = dry.alpha[at], TURN @ F4(smooth_normal(
                dry.depth, dry.normal, *at, HEIGHT, WIDTH, VIEW.fx, dry.around / UNIT
            ))  # fmt: skip
            rgb = undiluted(*dry.color[at], alpha)
            lean = wetting.wetted_normal(*rgb, above, point, tuple(around), F4(0))
            point = SurfacePoint(*(EYE + e * ray), *lean, e * length)
        level = surface_point.ground_share(above, point.nz, F4(-1))
        leaf = wetting.leaf_share(*undiluted(*dry.color[at], dry.alpha[at]))
        whole[at] = covered_share(dry.alpha[at], (1 - level) * leaf, ray[2])
        wet = wetting.wet_state(point, clearance, above, level, leaf, F4(1), ground, rain)
        wanted[at] = wet.dampness
    np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=2e-4)
    np.testing.assert_allclose(matte, whole, atol=1e-5)
    assert beside > 0 and (wanted > 0.05).mean() > 0.3 and np.ptp(wanted) > 0.5


def test_nowhere_is_some_place_in_memory(poisoned):
    n, field = pixel_batches.CHUNK, np.ones((7, 11), F4)
    s, place, corner = (
        poisoned((3 * n,)),
        np.empty(n, np.uint32),
        poisoned((pixel_batches.CORNERS,)),
    )
    s[n // 2 : n], s[n + n // 3 : 2 * n] = np.inf, -np.inf
    pixel_batches.nearest(field, n, s, 0, n, 2 * n, place)
    assert (s[2 * n :] == 1).all() and place.max() < field.size
    pixel_batches.interpolate(field, n, s, 0, n, place, corner)
    assert place.max() < field.size - 11


def test_what_hides_nearly_all_of_the_sky_hides_all_and_edges_stay_as_they_are():
    alphas, whole = F4([0, 0.1, 0.5, 0.65, OPAQUE, 1]), [0, 0.1, 0.5, 0.75, 1, 1]
    for leaf, sine, wanted in ((0, 0.5, whole), (1, 0.5, alphas), (1, 0, whole)):  # crown, hedge
        found = [covered_share(alpha, F4(leaf), F4(sine)) for alpha in alphas]
        np.testing.assert_allclose(found, wanted, rtol=1e-6)


@pytest.mark.parametrize("z", [0.3, -0.3])
def test_what_lies_behind_shows_where_nothing_was_captured_also_below_the_horizon(scene, z):
    ground, rain, skies = scene
    look = factories.look(sky_replaced=100, albedo=0)
    ray = F4([0.0, np.sqrt(1 - z * z), z])
    nowhere = SurfacePoint(*F4([0, 99, 99]), *F4([0, -1, 0]), F4(99))

    def seen(alpha):
        color = tuple(F4([0.2, 0.2, 0.2]) * F4(alpha))
        return wetting.wet_pixel(
            color,
            F4(alpha),
            ray,
            nowhere,
            F4([0, -1, 0]),
            ground,
            rain,
            skies,
            look,
            False,
        )[:3]

    behind = wetting.sample_environment(skies.behind, *ray)
    assert min(behind) > 0.05
    np.testing.assert_allclose(seen(0.0), behind, rtol=1e-5)
    np.testing.assert_allclose(
        seen(0.85),
        wetting.graded(*undiluted(*F4([0.17, 0.17, 0.17]), F4(1)), look),
        rtol=1e-5,
    )  # a half open pixel: nothing behind it


# --- poorly known ground --------------------------------------------------------------------------

LAYER, NOTHING = F4(0.4), (F4(0), FAR_AWAY)  # m; that stands there


def poor_ground(layer=0.4, bed=0.1):
    """Maps of a level bed whose splats fill a thick layer."""
    maps = np.full((CELLS, CELLS), F4(bed)), np.ones((CELLS, CELLS, 4), F4)
    thickness = np.full((CELLS, CELLS), F4(layer))
    return GroundMaps(*maps, ORIGIN, SPACING, layer=thickness, thickest_layer=F4(layer))


@pytest.mark.parametrize("height", [-1.5, -0.2, 0.0, 0.3])
def test_a_sheet_before_or_behind_poor_ground_is_seen_on_the_bed(height):
    ground, ray = poor_ground(), F4([0.2, 1.0, -0.4])
    depth = F4((0.1 + height - 1.6) / ray[2])
    point = SurfacePoint(*(F4([0, -1, 1.6]) + depth * ray), *F4([0, -1, 0]), depth)
    found, drawn = surface_point.on_bed(point, depth, depth, *ray, LAYER, NOTHING, ground)
    np.testing.assert_allclose(found[:3], F4([0, -1, 1.6]) + 3.75 * ray, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose((found.nx, found.ny, found.nz, drawn), (0, 0, 1, 3.75), atol=1e-5)


def test_a_ray_to_poor_ground_ends_at_a_wall_that_stands_before_it():
    ground, ray, eye = poor_ground(0.6), F4([0.2, 1.0, -0.4]), F4([0, -2.5, 1.6])
    depth = F4((0.1 + 0.5 - 1.6) / ray[2])
    point = SurfacePoint(*(eye + depth * ray), *F4([0, -1, 0]), depth)

    def seen(wall):
        row = int((wall - ORIGIN[1]) / SPACING)
        layer = ground.layer.copy()
        layer[row : row + 4] *= -1
        return surface_point.on_bed(
            point, depth, depth, *ray, F4(0.6), NOTHING, ground._replace(layer=layer)
        )[0]

    met = seen(point.y + 0.5)
    assert 0.4 < met.y - point.y < 0.8 and met.z > 0.2 and (met.ny, met.nz) == (-1, 0)
    behind = surface_point.on_bed(point, depth, depth, *ray, F4(0.6), NOTHING, ground)[0]
    assert behind.z == pytest.approx(0.1, abs=1e-5) and behind.nz == 1
    assert seen(behind.y + 0.3) == behind


def what_stands(over, odd=1.0, down=33):
    """Tell what stands in a picture of something 4 m off that shows `over` times that over it.

    What is over it comes down to row `down`; the place is in row 40, a layer of ground ends in 35.
    Of one pixel, that which is asked for, the depth is `odd` times as large.
    """
    depth = np.full((60, 20), 4 / UNIT, F4)
    depth[:down] *= F4(over)
    depth[40, 10] *= F4(odd)
    level = F4([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # looks along y
    blank = np.ones((60, 20), F4)
    dry = wet_pass.DryPicture(blank, blank, depth, depth, blank, UNIT, F4(0))
    view = View(level, F4([0, 0, 0.72]), *F4([100, 100, 10, 30]))  # shows it 0.2 m over the bed
    ray = F4([0.005, 1, -0.105])
    return surface_point.what_stands(
        turn_of(level), view, 40, 10, ray, dry, depth.shape, poor_ground()
    )


def test_what_goes_on_over_the_layer_stands_and_a_sheet_that_ends_there_does_not():
    share, way, layer = what_stands(1.0)
    assert share > 0.8 and way == pytest.approx(4) and layer == LAYER
    for over in (3.0, np.inf, 0.5):  # the last hangs before the ground
        assert what_stands(over)[0] == 0
    assert what_stands(0.5, down=38)[0] > 0.8  # the foot of a wall, that seems to lie behind it
    for odd in (0.4, 2.5):  # the depth of one pixel decides nothing
        assert what_stands(1.0, odd)[0] == pytest.approx(share, abs=0.25)


def test_what_stands_is_no_ground_and_lies_where_it_goes_on_over_the_layer():
    ground, ray, eye = poor_ground(), F4([0.2, 1.0, -0.4]), F4([0, -1, 1.6])

    def seen(height, share):
        depth = F4((0.1 + height - 1.6) / ray[2])
        point = SurfacePoint(*(eye + depth * ray), *F4([0, -1, 0]), depth)
        return surface_point.on_bed(point, depth, depth, *ray, LAYER, (F4(share), F4(3)), ground)

    for height in (-0.3, 0.2):
        assert seen(height, 0)[0].ground == 1 and seen(height, 1)[0].ground == 0
        assert seen(height, 0.5)[0].ground == pytest.approx(0.5)
    stands, drawn = seen(-0.3, 1)
    assert drawn == 3 and stands.ny == -1 and seen(-0.3, 0)[1] == pytest.approx(3.75)
    above, drawn = seen(0.2, 1)  # neither does it jump there to what lies behind it over the bed
    assert drawn == 3 and above[:3] == pytest.approx(stands[:3])


def test_what_stands_higher_than_the_layer_stays_and_between_nothing_jumps():
    ground, ray = poor_ground(), F4([0.2, 1.0, -0.4])

    def moved(height):
        depth = F4((0.1 + height - 1.6) / ray[2])
        point = SurfacePoint(*(F4([0, -1, 1.6]) + depth * ray), *F4([0, -1, 0]), depth)
        return surface_point.on_bed(point, depth, depth, *ray, LAYER, NOTHING, ground)[1] - depth

    heights = np.arange(0.3, 1.0, 0.01)
    ways = np.array([moved(height) for height in heights])
    assert not ways[heights > 0.81].any() and ways[0] > 0.7
    assert np.abs(np.diff(ways)).max() < 0.1
    # A camera below the bed, as mirrored ones are, and one that looks up, see no ground.
    point = SurfacePoint(*F4([0, 0, 0.2]), *F4([0, -1, 0]), F4(1))
    seen, _ = surface_point.on_bed(point, F4(1), F4(1), *F4([0, 1, 0.3]), LAYER, NOTHING, ground)
    assert seen == point._replace(ground=1)
    nowhere = point._replace(x=F4(np.nan), y=F4(np.nan))
    assert np.isfinite(
        surface_point.layer_at(ground, *map_place(nowhere.x, nowhere.y, ORIGIN, SPACING))
    )


def test_ground_is_told_without_a_step_of_height_or_normal():
    heights, upness = np.linspace(-0.5, 0.6, 221), np.linspace(-1, 1, 201)
    share = np.array([
        [surface_point.ground_share(F4(h), F4(u), F4(-1)) for u in upness] for h in heights
    ])  # fmt: skip
    assert share[heights < 0.04][:, upness > 0.31].min() == 1 and share[heights > 0.41].max() == 0
    assert share[:, upness < 0.09].max() == 0  # the foot of a wall
    assert (
        np.abs(np.diff(share, axis=0)).max() < 0.2 and np.abs(np.diff(share, axis=1)).max() < 0.08
    )
    assert share[heights.searchsorted(0.15), -1] == 1
