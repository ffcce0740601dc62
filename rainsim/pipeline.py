"""The whole program on one page: from a capture to rainy frames.

Each stage can be run alone: `extract_terrain`, `simulate`, `render`; `render_rain` chains them.
"""

from __future__ import annotations

from dataclasses import replace

from rainsim.backend import on_backend
from rainsim.errors import ParameterError
from rainsim.render.first_view import view_of_water
from rainsim.render.memory import require_memory
from rainsim.render.report import FrameReport
from rainsim.render.shutter import shutter_end
from rainsim.render.sunken import sunken_notes
from rainsim.simulation import SimState, read_state, simulate, write_state
from rainsim.terrain.kept import kept_terrain
from rainsim.terrain.pond import without_images
from rainsim.terrain.types import Terrain

__all__ = [
    "FrameReport",
    "SimState",
    "Terrain",
    "extract_terrain",
    "frames_of",
    "read_state",
    "render",
    "render_rain",
    "simulate",
    "view_of_water",
    "write_state",
]


def render_rain(
    scene, cameras, config, backend="cpu", progress=None, layers=(), terrain=None, skip=()
):  # fmt: skip
    """Yield the rainy frames of a scene: the whole program.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera
        One per frame, or one for all, in the capture frame.
    config : Config
    backend : {"cpu", "cuda"}
        What draws the frames, see `rainsim.cuda`. Pictures of "cuda" are overwritten by the next.
    progress : callable, optional
        Called as progress(stage, done, total) as stages go on.
    layers : sequence of str
        Layers that the reports are to hold, see `rainsim.render.aov`.
    terrain : Terrain, optional
        Of the scene, where it has been extracted already.
    skip : container of int
        Frames that need not be drawn; looked at when the first frame is asked for.

    Yields
    ------
    picture : ndarray of shape (height, width, 3), uint8
        For display (sRGB).
    report : FrameReport

    Raises
    ------
    ParameterError
        If the configuration breaks a rule or the cameras do not match the frames.
    BackendError
        If the backend cannot run here.
    """
    _, simulate_on_backend = on_backend(backend)  # an error before anything is computed
    config.check()
    tell = progress or (lambda stage, done, total: None)
    if terrain is None:
        terrain = extract_terrain(scene, config, progress=tell)
    states = frames_of(simulate_on_backend(terrain, config), config, tell, skip)
    yield from render(scene, terrain, states, cameras, config, layers, backend)


def extract_terrain(scene, config, mask=None, progress=None, say=None):
    """Return the `Terrain` of a scene as the configuration asks for it.

    Kept for the next run unless RAINSIM_CACHE is "off", see `rainsim.io.cache`.

    Parameters
    ----------
    scene : Scene
    config : Config
    mask : ndarray of shape (ny, nx), int, optional
        Class of each cell as the user has it, -1 where the splats decide; see `terrain.read_mask`.
    progress : callable, optional
        Called as progress("terrain", done, total) before, after each step and after the last.
    say : callable, optional
        Called with notes on the map that is going to be made: its size and its cells.
    """
    tell, all_of_it = progress or (lambda stage, done, total: None), 1

    def steps(notes, done, total):
        nonlocal all_of_it
        all_of_it = total
        if done == 0 and say is not None:
            say(notes)
        if done < total:
            tell("terrain", done, total)

    tell("terrain", 0, 1)
    terrain = kept_terrain(scene, config.terrain, mask, steps)
    tell("terrain", all_of_it, all_of_it)
    return terrain


def frames_of(states, config, tell=None, skip=()):
    """Yield the states of the frames of the frame range but those to `skip`.

    Frames before the first are only simulated.
    """
    wanted = {index for index in config.indices if index not in skip}
    if not wanted:
        return
    first, last = min(wanted), max(wanted)
    for state in states:
        if state.index in wanted:
            yield state
        elif tell is not None and state.index < first:
            tell("simulate", state.index + 1, first)
        if state.index >= last:
            return


def render(scene, terrain, states, cameras, config, names=(), backend="cpu"):
    """Yield (picture, FrameReport) for each state and its camera.

    Parameters
    ----------
    scene : Scene
    terrain : Terrain
    states : iterable of SimState
        In the order of their frames.
    cameras : sequence of Camera
        One per frame of the whole sequence (the state's index picks), or one for all.
    config : Config
    names : sequence of str
        Layers that the reports are to hold, see `rainsim.render.aov`.
    backend : {"cpu", "cuda"}
        What draws. Pictures of "cuda" are overwritten by the next one.

    Yields
    ------
    picture : ndarray of shape (height, width, 3), uint8
    report : FrameReport
    """
    if not cameras:
        raise ParameterError("no camera was given; a frame needs one")
    if backend == "cpu":
        require_memory(scene, cameras[0], terrain.bed.size, len(names))
    scene = without_images(scene, terrain)
    renderer = on_backend(backend)[0](scene, terrain, config, cameras[0])
    path = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]

    def shots():
        for state in states:
            camera = cameras[0] if len(cameras) == 1 else cameras[state.index]
            exposure = config.at(state.time).render.exposure
            yield camera, state, shutter_end(path, state.index, exposure, config.fps)

    notes = sunken_notes(path, terrain, config)
    for picture, report in renderer.film(shots(), names):
        yield picture, replace(report, notes=(*notes, *report.notes))
        notes = ()
