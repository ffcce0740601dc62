"""Leaving the capture: what is badly seen of pictures from where no camera of the capture stood."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rainsim.raster import Rasterizer, prepare
from rainsim.render.leaving import MUCH, leaving_notes, leaving_of
from rainsim.scene.cameras import look_at
from scenes import tiny_scene

INSIDE, BELOW = (-0.9, -1.3, 1.1), (0.2, 0.1, -0.8)  # m: between the cameras; under the ground


@pytest.fixture(scope="module")
def scene():
    return replace(tiny_scene(), source=Path("somewhere"))


class Drawn:
    """A wet scene and its capture in one, as far as `leaving` asks."""

    def __init__(self, scene):
        self.scene, self.capture = scene, self
        self._rasterizer = Rasterizer(prepare(scene.splats))

    def layers(self, camera, **options):
        return self._rasterizer.draw(camera, 0.02, **options)


def seen_from(scene, eye):
    camera = look_at(eye, (0.0, 0.0, 0.2), (0, 0, 1), 50, 64, 48)
    return scene.ground_frame.camera_in_capture(camera)


def test_what_the_cameras_saw_is_well_seen_and_undersides_are_not(scene):
    leaving = leaving_of(Drawn(scene))
    own = [leaving.share(camera) for camera in scene.cameras]
    assert max(own) < 0.1
    assert leaving.share(seen_from(scene, INSIDE)) < 0.1
    assert leaving.share(seen_from(scene, BELOW)) > 0.6
    away = look_at((0, 0, 1), (0, 0, 5), (0, 1, 0), 50, 64, 48)  # nothing is there
    assert leaving.share(scene.ground_frame.camera_in_capture(away)) == 0


def test_what_one_camera_saw_is_badly_seen(scene):
    lone = replace(scene, cameras=scene.cameras[:1])
    assert leaving_of(Drawn(lone)).share(lone.cameras[0]) > 0.6  # all but the void


def test_a_path_is_told_where_it_leaves_and_own_cameras_are_not_looked_at(scene):
    heights = np.linspace(1.1, -1.0, 60)
    path = [seen_from(scene, (-0.9, -1.3, z)) for z in heights]
    (note,) = leaving_notes(Drawn(scene), path)
    first = int(note.split("from frame ")[1].split()[0])
    leaving = leaving_of(Drawn(scene))
    shares = [leaving.share(camera) for camera in path]
    crossing = next(k for k, share in enumerate(shares) if share > MUCH)
    assert abs(first - crossing) <= 2 and first % 2 == 0  # every second one is looked at
    assert f"{max(shares[::2]):.0%}" in note
    assert leaving_notes(Drawn(scene), path[:10]) == ()
    assert "of the picture" in leaving_notes(Drawn(scene), [seen_from(scene, BELOW)])[0]
    assert leaving_notes(Drawn(scene), scene.cameras) == ()


def test_nothing_is_said_of_captures_without_cameras(scene):
    bare = Drawn(replace(scene, cameras=()))
    assert leaving_of(bare) is None and leaving_notes(bare, [seen_from(scene, BELOW)]) == ()
    assert leaving_notes(Drawn(tiny_scene()), [seen_from(scene, BELOW)]) == ()  # a built-in one
