"""The view that is drawn where no camera is asked for: the one that shows most water."""

from dataclasses import replace

import numpy as np
import pytest

from rainsim.commands.given import cameras_of
from rainsim.config.settings import Config
from rainsim.demo_scenes import FIRST_VIEWS
from rainsim.render.first_view import mirrored_share, places_of_water, view_of_water
from rainsim.scene.cameras import look_at
from rainsim.scene.types import GroundFrame, Scene
from rainsim.terrain.types import MEASURED, UNKNOWN, Grid, Terrain

SPACING = 0.05
DIP = (2.0, 2.0)  # m, middle of the only puddle
FRAME = GroundFrame(np.eye(3), 0.5, np.array([0.0, 0.0, 0.3]))


def yard(wall=None):
    """4 x 4 m of paving with a dip of 15 mm, and a `wall` over columns of the map."""
    side = round(4 / SPACING)
    y, x = (np.mgrid[:side, :side] + 0.5) * SPACING
    r = np.hypot(x - DIP[0], y - DIP[1]) / 0.6
    bed = np.where(r < 1, -0.015 * (1 - r**2), 0).astype(np.float32)
    top = bed.copy()
    if wall is not None:
        top[:, wall] = 2.0
    return Terrain(
        Grid(bed.shape, (0.0, 0.0), SPACING), bed, top, bed.copy(),
        np.full(bed.shape, MEASURED, np.uint8), np.zeros(bed.shape, np.uint8),
        np.zeros(bed.shape, np.float32), np.full((*bed.shape, 3), 0.5, np.float32),
    )  # fmt: skip


def camera(name, eye, target=(*DIP, 0.0)):
    return FRAME.camera_in_capture(look_at(eye, target, (0.01, 0, 1), 50, 60, 40, name))


def scene(*cameras):
    return Scene("yard", None, cameras, FRAME)


AWAY = camera("away", (2, 1, 1), (2, -3, 0))
STEEP = camera("steep", (2.0, 1.7, 2.5))
LOW = camera("low", (2, -0.5, 0.7))
EAST = camera("east", (4.2, 2, 1.1))


def test_a_low_view_of_the_puddle_is_chosen():
    for order in ((AWAY, STEEP, LOW), (LOW, STEEP, AWAY), (STEEP, AWAY, LOW)):
        assert view_of_water(scene(*order), yard()) is LOW
    assert view_of_water(scene(AWAY, STEEP), yard()) is STEEP


def test_what_stands_before_the_puddle_counts():
    columns = slice(62, 64)  # between the dip and the eastern camera
    assert view_of_water(scene(EAST, STEEP), yard()) is EAST
    assert view_of_water(scene(EAST, STEEP), yard(columns)) is STEEP
    under = yard(columns)
    under.underside[:, columns] = 1.5  # a bridge, which one looks through below
    assert view_of_water(scene(EAST, STEEP), under) is EAST


def test_without_water_in_view_the_first_camera_is_drawn():
    level = replace(yard(), bed=np.zeros_like(yard().bed))
    assert view_of_water(scene(STEEP, LOW), level) is STEEP
    assert view_of_water(scene(AWAY, AWAY), yard()) is AWAY
    unseen = replace(yard(), source=np.full(yard().bed.shape, UNKNOWN, np.uint8))
    assert view_of_water(scene(AWAY, LOW), unseen) is AWAY


def test_the_share_is_that_of_the_picture():
    """Of a puddle that fills the picture of a camera straight above it, water mirrors 2 %."""
    ground = yard()
    depth = np.full(ground.bed.shape, 0.01)
    places, area = places_of_water(ground, depth)
    assert area * len(places) == pytest.approx(16)
    above = look_at((2, 2, 1.5), (2, 2, 0), (1, 0, 0), 60, 60, 60, "above")
    assert mirrored_share(above, places, area, ground) == pytest.approx(0.0204, rel=0.15)
    aside = look_at((2, 0.5, 0.4), (2, 3, 0), (0, 0, 1), 20, 60, 30, "aside")
    assert 0.06 < mirrored_share(aside, places, area, ground) < 0.5


def test_the_built_in_bicycle_is_seen_from_low_unless_a_camera_is_named():
    given, config = {"camera": None}, Config().replace(width=96)
    built_in = replace(scene(STEEP, LOW), name="bicycle")
    (first,), _ = cameras_of(built_in, config, given)
    np.testing.assert_allclose(first.position, FIRST_VIEWS["bicycle"][0])
    assert (first.width, first.height) == (96, 64)
    (named,), _ = cameras_of(built_in, config, {"camera": "low"})
    assert named.name == "low"
    for other in (replace(built_in, source="mine"), replace(built_in, name="yard")):
        (first,), _ = cameras_of(other, config, given)
        assert first.name == "steep"
