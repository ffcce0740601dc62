"""All files of a scene in the rain for other renderers, frame by frame."""

from contextlib import ExitStack

from rainsim.drops import Weather
from rainsim.io.files import replacing
from rainsim.particles.splash import LONGEST_LIFE, WET_FILM
from rainsim.pipeline import frames_of, simulate
from rainsim.scene.origin import capture_from_ground
from rainsim.shading.wetness import paving_dampness
from rainsim.simulation import surfaces_of
from rainsim.world import usd_files
from rainsim.world.falling import falling_at
from rainsim.world.meshes import ground_mesh, water_mesh, write_glb

CAMERA, GROUND, WATER = "camera.usda", "ground.usdc", "water.usdc"
RAIN, CAPTURE, GLB = "rain.usdc", "capture.usdc", "ground.glb"
BLOCK = 16  # frames that are held in memory; some 100 MB in a downpour at 1920 px


def write_parts(folder, scene, terrain, cameras, config, parts, first, tell):
    """Write parts of a scene in the rain; return the files' names and notes on what they lack."""
    moves = not {"camera", "water", "rain"}.isdisjoint(parts)
    clock = usd_files.Clock(first, config.frames if moves else 0, config.fps)
    cameras = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]
    layers, notes = {}, []
    if "camera" in parts:
        layers[CAMERA] = usd_files.camera_layer(cameras, clock, config.render.exposure)
    if "ground" in parts:
        ground = ground_mesh(terrain)
        layers[GROUND] = usd_files.ground_layer(ground, clock)
        write_glb(folder / GLB, ground)
    if "capture" in parts:
        layers[CAPTURE] = usd_files.capture_layer(scene, clock)
        notes += _left_out(scene)
    for name, layer in layers.items():
        layer.write(folder / name)
    growing = [name for name, part in ((WATER, "water"), (RAIN, "rain")) if part in parts]
    if growing:
        with ExitStack() as files:
            paths = {name: files.enter_context(replacing(folder / name)) for name in growing}
            _fill(paths, terrain, cameras, config, clock, tell)
    names = [*layers, *growing]
    large = capture_from_ground(scene) if any(scene.origin) else None
    usd_files.write_world(folder / usd_files.WORLD, names, clock, large)
    return [usd_files.WORLD, *names, *([GLB] if "ground" in parts else [])], notes


def _left_out(scene):
    notes = []
    if scene.pages is not None:
        notes.append("of this big capture a coarse level of the whole is written")
    if scene.actors:
        notes.append(f"the {len(scene.actors)} actors are not written; the capture is what stands")
    return notes


def _fill(paths, terrain, cameras, config, clock, tell):
    """Write each frame's water and rain to the files whose names are in `paths`, in blocks."""
    water = usd_files.WaterLayer(clock, paths[WATER]) if WATER in paths else None
    rain = usd_files.RainLayer(clock, paths[RAIN]) if RAIN in paths else None
    layers = [layer for layer in (water, rain) if layer is not None]
    weather, surfaces = Weather(config), surfaces_of(terrain)
    for done, state in enumerate(frames_of(simulate(terrain, config), config, tell), start=1):
        code = clock.code(state.index)
        if water is not None:
            water.add(code, water_mesh(terrain, state.depth, state.velocity))
        if rain is not None:
            now = config.at(state.time)
            field = weather.field(state.time - LONGEST_LIFE, state.time + now.render.exposure)
            camera = cameras[0 if len(cameras) == 1 else state.index]
            film = WET_FILM * paving_dampness(now)
            rain.add(code, falling_at(state, field, surfaces, camera, now.render, film))
        for layer in layers if done % BLOCK == 0 or done == config.frames else ():
            layer.save()
        tell("frames", done, config.frames)
