"""Smooth bodies: where they stand, how they get wet, and what the water on them mirrors."""

from types import SimpleNamespace

import numpy as np
import pytest

from factories import look, off_ground
from rainsim.actors.footprint import Shadow
from rainsim.shading import bodies, environment, walls, wetting
from rainsim.shading.fresnel import fresnel
from rainsim.shading.surface_point import NO_LAYER, GroundMaps, SurfacePoint
from rainsim.shading.wetting import SkyMaps
from rainsim.terrain.types import NO_TOPS, Grid

F4 = np.float32
CELLS, SPACING = 200, 0.02
LOOK = look()
SOAKED = off_ground(supply=100, porosity=0.2)
AHEAD = F4([1, 0, 0])
BOX = slice(60, 120), slice(60, 120)  # cells of a box 0.8 m high


def terrain_of(height, underside=None, tops=NO_TOPS):
    """Return what `body_map` needs of a terrain at z = 0."""
    bed = np.zeros((CELLS, CELLS), F4)
    return SimpleNamespace(
        grid=Grid(bed.shape, (0.0, 0.0), SPACING), bed=bed, top=height.astype(F4), tops=tops,
        layer=NO_LAYER,
        underside=(np.zeros_like(bed) if underside is None else underside.astype(F4)),
    )  # fmt: skip


def standing(height):
    """Return the height map of a box of a height [m] on the ground."""
    field = np.zeros((CELLS, CELLS))
    field[BOX] = height
    return field


def share(found, x, y, z, upness=0.0):
    """Return the `body_share` at a place [m]."""
    return bodies.body_share(found, F4(x / SPACING - 0.5), F4(y / SPACING - 0.5), F4(z), F4(upness))


def test_a_box_is_a_body_up_to_its_height_and_beside_its_cells():
    found = bodies.body_map(terrain_of(standing(0.8)))
    assert share(found, 1.8, 1.8, 0.4) == share(found, 1.16, 1.8, 0.4) == 1
    assert share(found, 1.8, 1.8, 0.8) == 1 and share(found, 1.8, 1.8, 1.0) == 0
    assert share(found, 1.0, 1.8, 0.4) == 0


def test_patches_of_steps_on_poorly_known_ground_are_no_bodies(monkeypatch):
    poor = terrain_of(standing(0.8))
    poor.layer = poor.bed + 0.5
    assert bodies.body_map(poor).size
    monkeypatch.setattr(bodies, "LARGEST", 1.0)  # m2; the box has 1.44
    assert bodies.body_map(poor).size == 0 < bodies.body_map(terrain_of(standing(0.8))).size


@pytest.mark.parametrize("height", [0.1, 3.0])
def test_kerbs_and_walls_are_no_bodies(height):
    assert bodies.body_map(terrain_of(standing(height))).size == 0


def test_leaves_and_tables_are_no_bodies(rng):
    rough = standing(0.8) * rng.uniform(0.8, 1.2, (CELLS, CELLS))
    assert bodies.body_map(terrain_of(rough)).size == 0
    assert bodies.body_map(terrain_of(standing(0.8), standing(0.75))).size == 0


def test_what_has_no_level_upper_side_is_no_body():
    """Haze that hangs over the ground, as a cone; a car's bonnet slopes by less."""
    y, x = np.mgrid[:CELLS, :CELLS] * SPACING - 2.0
    away = np.hypot(x, y)
    for slope, is_body in ((3.0, False), (0.4, True)):
        cone = np.where(away < 0.4, 0.3 + slope * (0.4 - away), 0.0)
        assert bool(bodies.body_map(terrain_of(cone)).size) == is_body


def test_the_level_part_of_a_top_shows_its_own_water():
    index = np.where(standing(1.0) > 0, 0, -1)
    tops = type("Tops", (), {"index": index, "__len__": lambda self: 1})()
    found = bodies.body_map(terrain_of(standing(0.8), tops=tops))
    assert share(found, 1.8, 1.8, 0.8, upness=1.0) == 0
    assert share(found, 1.8, 1.8, 0.8, upness=0.1) == 1


def test_sides_of_a_body_get_wet_in_calm_rain_and_its_underside_does_not():
    rain = SOAKED._replace(supply=F4(6))

    def damp(nz, body):
        point = SurfacePoint(*F4([3, 0, 1]), *F4([-np.sqrt(1 - nz * nz), 0, nz]), F4(3))
        return walls.damp_off_ground(rain, point, F4(1), F4(body))

    assert damp(0, 1) > 0.9 and damp(0, 0) < 0.02
    assert damp(-0.9, 1) == damp(-0.9, 0) == 0


def pixel(normal, sky, body=True, color=(0.5, 0.5, 0.5), look=LOOK):
    """Return the light of a wet thing 0.7 m over the ground, 3 m away along x."""
    maps = np.zeros((8, 8, 3), np.uint8)
    maps[...] = (0, 60, 255) if body else 0
    ground = GroundMaps(np.zeros((8, 8), F4), np.zeros((8, 8, 4), F4), F4([0, -2]), F4(1), maps)
    point = SurfacePoint(*F4([3, 0, 0.7]), *F4(normal), F4(3))
    return np.array(wetting.wet_pixel(
        tuple(F4(color)), F4(1), AHEAD, point, tuple(F4(normal)), ground, SOAKED,
        SkyMaps(sky, sky, sky), look, False,
    )[:3])  # fmt: skip


def test_between_sides_and_undersides_wetness_has_no_edge():
    upness = np.linspace(-1, 0.3, 131)
    for body, height, supply in ((1.0, 1.5, 15), (0.0, 0.02, 150)):
        damp = np.array([
            walls.damp_off_ground(
                SOAKED._replace(supply=F4(supply)),
                SurfacePoint(F4(0), F4(0), F4(1), F4(np.sqrt(1 - z * z)), F4(0), F4(z), F4(50)),
                F4(height), F4(body),
            )
            for z in upness
        ])  # fmt: skip
        assert np.abs(np.diff(damp)).max() < 0.05
        assert damp[0] == 0 and damp[upness > -0.15].min() > 0.9


def test_a_coat_mirrors_by_fresnel_what_its_normal_shows():
    """White above 45 degrees; facets that mirror the zenith, and what lies behind the viewer."""
    bright = environment.directions()[..., 2] > np.sqrt(0.5)
    light = np.repeat(bright[..., None], 3, axis=-1).astype(F4)
    dark = 0 * light
    up, back = F4([-1, 0, 1]) / F4(np.sqrt(2)), F4([-1, 0, 0])
    added = pixel(up, light) - pixel(up, dark)
    np.testing.assert_allclose(added, fresnel(F4(np.sqrt(0.5))), rtol=1e-3)
    np.testing.assert_allclose(pixel(back, light), pixel(back, dark))
    np.testing.assert_allclose(pixel(up, light, body=False), pixel(up, dark, body=False), atol=0.01)


@pytest.mark.parametrize("slant", [0, 30, 60, 75, 84, 88])
def test_white_things_in_white_surroundings_are_not_brighter_than_white(slant):
    white = np.ones((32, 64, 3), F4)
    turn = np.radians(slant)
    light = pixel((-np.cos(turn), 0, np.sin(turn)), white, color=(1, 1, 1))
    assert 0.8 < light.max() <= 1 + 1e-4


def test_an_actor_that_moves_takes_its_place_on_the_map_along():
    """An actor 1 m long and 0.8 m high that goes along x."""
    terrain = terrain_of(standing(0.0))

    def shadow(grid, time):
        if time < 0:
            return None
        rows, columns = slice(80, 110), slice(20 + int(time * 10), 70 + int(time * 10))
        top = np.full((30, 50), 0.8, F4)
        return Shadow((rows, columns), top, top * 0)

    still = bodies.body_map(terrain)
    terrain.footprints = (SimpleNamespace(shadow=shadow),)
    untouched, nowhere = bodies.stamped(still, terrain, -1.0)
    assert untouched is still and not nowhere
    (before, _), (after, (part,)) = (bodies.stamped(still, terrain, time) for time in (0.0, 10.0))
    same = np.zeros_like(after)
    same[part] = after[part]
    np.testing.assert_array_equal(same, after)
    assert after[part].any()
    assert share(before, 0.9, 1.9, 0.4) == share(after, 2.9, 1.9, 0.4) == 1
    assert share(after, 0.9, 1.9, 0.4) == share(before, 2.9, 1.9, 0.4) == 0
