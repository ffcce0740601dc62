"""The whole program on one page: from a capture to rainy frames.

Each stage can be run alone: `extract_terrain`, `simulate`, `render`; `render_rain` chains them.
"""

from __future__ import annotations

from rainsim import render as rendering
from rainsim import terrain
from rainsim.backends import on_backend
from rainsim.render import FrameReport, render
from rainsim.simulation import SimState, read_state, simulate, write_state
from rainsim.terrain import Terrain

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
    "write_state",
]


def render_rain(scene, cameras, config, backend="cpu", progress=None, layers=()):
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
        progress(stage, done, total) is told what is being done.
    layers : sequence of str
        Layers that the reports are to hold, see `rainsim.layers`.

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
    tell("terrain", 0, 1)
    ground = extract_terrain(scene, config)
    tell("terrain", 1, 1)
    states = frames_of(simulate_on_backend(ground, config), config, tell)
    yield from rendering.render(scene, ground, states, cameras, config, layers, backend)


def extract_terrain(scene, config, mask=None):
    """Return the `Terrain` of a scene as the configuration asks for it.

    `mask` (ny, nx) gives the ground's classes where it is not -1, see `terrain.read_mask`.
    """
    return terrain.extract_terrain(scene, config.terrain, mask)


def frames_of(states, config, tell=None):
    """Yield the states of the frames that are asked for; the ones before are only simulated."""
    first, end = config.frame_range or (0, config.frames)
    for state in states:
        if state.index >= end:
            return
        if state.index >= first:
            yield state
        elif tell is not None:
            tell("simulate", state.index + 1, first)
        if state.index + 1 >= end:
            return
