"""A frame of a small wet scene, with the layers that a test asks for."""

from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.render.renderer import Renderer
from scenes import tiny_scene


def wet_shot(names):
    """Return picture, report, renderer, camera and state of the tiny scene in a sunny downpour."""
    scene = tiny_scene()
    camera = scene.cameras[0].resized(160, 120)
    config = Config.from_preset("downpour").replace(
        past=6e-3, sun=(0.0, 0.7), cloudiness=0.5, extent=1.0, spacing=0.025, streak_far=4.0
    )
    ground = pipeline.extract_terrain(scene, config)
    state = next(s for s in pipeline.simulate(ground, config) if s.index == 2)
    renderer = Renderer(scene, ground, config, camera)
    return *renderer.draw(camera, state, None, names), renderer, camera, state
