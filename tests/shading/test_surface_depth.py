"""The label of depth lies on walls seen at a slant, where the depth that is drawn does not."""

import numpy as np
import pytest

import factories
from rainsim.config.settings import Config
from rainsim.pipeline import extract_terrain, simulate
from rainsim.render.labels import SEEN
from rainsim.render.renderer import Renderer
from rainsim.scene.types import GroundFrame, Scene
from rainsim.scene.view import pixel_rays
from scenes import looking

NAMES = "depth", "drawn_depth", "range", "position", "height"


def beside_a_wall(seed=2):
    """Level ground, and along it a wall of big discs at y = 1 m, both exact; a camera along it."""
    rng, spacing = np.random.default_rng(seed), 0.15
    x, far = (v.ravel() for v in np.meshgrid(np.arange(0, 12, spacing), np.arange(-1, 1, spacing)))
    ground = np.column_stack([x, far, np.zeros(len(x))])
    x, up = (v.ravel() for v in np.meshgrid(np.arange(0, 12, spacing), np.arange(0, 3, spacing)))
    wall = np.column_stack([x, np.ones(len(x)), up])
    wall[:, ::2] += rng.uniform(-0.03, 0.03, (len(wall), 2))
    wide, thin = np.full((len(ground), 3), 0.15), np.full((len(wall), 3), 0.15)
    wide[:, 2], thin[:, 1] = 1e-3, 1e-3
    splats = factories.splats(
        np.concatenate([ground, wall]), scale=np.concatenate([wide, thin]), opacity=0.7
    )
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3), 1.0, ("made for a test",))
    camera = looking((1.0, -0.2, 1.5), (9.0, 0.9, 1.0), 96, 64, focal=80)
    return Scene("lane", splats, (camera,), frame, None, "0" * 64, ())


@pytest.fixture(scope="module")
def drawn():
    """Scene, camera and layers of one picture."""
    scene = beside_a_wall()
    config = Config.from_preset("moderate").replace(frames=1, extent=1.0, spacing=0.1)
    terrain, camera = extract_terrain(scene, config), scene.cameras[0]
    renderer = Renderer(scene, terrain, config, camera)
    state = next(iter(simulate(terrain, config)))
    again = scene.ground_frame.camera_in_ground(camera)
    _, report = renderer.draw(camera, state, again, (*NAMES, "flow", "flow_mask"))
    return camera, report.aovs


def exact(camera):
    """Depths along the view axis at which pixels show the wall, and the ground; infinite beside."""
    ray, eye = pixel_rays(camera) @ camera.camera_from_world[:3, :3], camera.position
    with np.errstate(divide="ignore"):
        wall, ground = (1 - eye[1]) / ray[..., 1], -eye[2] / ray[..., 2]
    place = eye + wall[..., None] * ray
    on_wall = (wall > 0) & (place[..., 2] > 0.3) & (place[..., 2] < 2.6)
    place = eye + ground[..., None] * ray
    on_ground = (ground > 0) & (np.abs(place[..., 1]) < 0.7)
    ahead = (np.abs(wall - 4.5) < 2.5) & on_wall, (ground < 7) & on_ground & ~on_wall
    return [np.where(seen, d, np.inf) for d, seen in zip((wall, ground), ahead, strict=True)]


def test_the_label_is_on_the_wall_and_what_is_drawn_before_it(drawn):
    camera, found = drawn
    wall, ground = exact(camera)
    on = np.isfinite(wall)
    label, seen = (found[name][on] / wall[on] - 1 for name in ("depth", "drawn_depth"))
    assert on.sum() > 500
    assert np.median(np.abs(label)) < 2e-3 and np.percentile(np.abs(label), 90) < 0.01
    assert np.median(np.abs(seen)) > 3 * np.median(np.abs(label)) and np.median(seen) < 0
    on = np.isfinite(ground)
    assert on.sum() > 300
    np.testing.assert_allclose(found["depth"][on], found["drawn_depth"][on], rtol=1e-6)
    assert np.median(np.abs(found["depth"][on] / ground[on] - 1)) < 5e-3


def test_range_place_and_flow_follow_the_label(drawn):
    camera, found = drawn
    known = np.isfinite(found["depth"])
    assert known.any() and (known == np.isfinite(found["drawn_depth"])).all()
    ray = pixel_rays(camera)
    far = found["depth"] * np.linalg.norm(ray, axis=-1)
    np.testing.assert_allclose(found["range"][known], far[known], rtol=1e-6)
    place = camera.position + found["depth"][..., None] * (ray @ camera.camera_from_world[:3, :3])
    np.testing.assert_allclose(found["position"][known], place[known], atol=1e-4)
    # A camera that stands still sees each surface again where it is.
    assert (found["flow_mask"] == SEEN).all() and np.abs(found["flow"]).max() < 1e-9
    on = known & (np.abs(found["height"]) < 0.2)
    np.testing.assert_allclose(found["position"][on][:, 2], found["height"][on], atol=0.05)
