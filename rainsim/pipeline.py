"""The whole program on one page: from a capture to rainy frames.

Each stage can be run alone: `extract_terrain`, `simulate`, `render`; `render_rain` chains them.
"""

import bisect
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from rainsim.actors.footprint import with_footprints
from rainsim.backend import free_device_memory, on_backend
from rainsim.errors import ParameterError
from rainsim.io import cache
from rainsim.io.allocator import trim
from rainsim.jit import get_num_threads, may_run_beside, set_threads
from rainsim.render.first_view import view_of_water
from rainsim.render.labels import without_flow
from rainsim.render.leaving import leaving_notes
from rainsim.render.memory import require_memory
from rainsim.render.report import FrameReport
from rainsim.render.shutter import PathMotion
from rainsim.render.sunken import sunken_notes
from rainsim.simulation import simulate
from rainsim.terrain.kept_terrain import kept_terrain
from rainsim.terrain.path_ground import PathGround, follows_path, path_ground
from rainsim.terrain.pond import without_images
from rainsim.terrain.poured import with_water
from rainsim.terrain.types import Terrain

__all__ = [
    "FrameReport",
    "FrameSequence",
    "Terrain",
    "extract_terrain",
    "frames_of",
    "ground_of",
    "render",
    "render_rain",
    "simulate",
    "view_of_water",
]

READ_AHEAD = 4  # frames: what the camera needs so much later is read beside the drawing


def render_rain(
    scene, cameras, config, backend="cpu", progress=None, layers=(), terrain=None, optics=None
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
    optics : Optics, optional
        Lens, glass and shutter of the cameras, by default a pinhole that stands still over the
        exposure.

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

    Examples
    --------
    >>> config = rainsim.Config.from_preset("moderate")
    >>> config = config.replace(frames=2, spacing=0.04, extent=1.0)
    >>> for picture, report in rainsim.render_rain(scene, scene.cameras[:1], config):
    ...     print(report.index, picture.shape)
    0 (48, 64, 3)
    1 (48, 64, 3)
    """
    on_backend(backend)  # an error before anything is computed
    config.check()
    if terrain is None:
        terrain = ground_of(scene, config, cameras, backend, progress=progress)
    sequence = FrameSequence(scene, terrain, cameras, config, backend, layers, optics=optics)
    yield from sequence.frames(config.indices, progress)


class FrameSequence:
    """The frames of a scene in the rain, any of them, with the same bytes as in one go.

    A frame follows from the water at its time, which is simulated from the start on: from the last
    frame that was asked for, or for an earlier frame from the beginning again.

    states : callable, optional. states(number) returns the `SimState` of a
        number; without it the water is simulated here. Which one a frame shows is
        `Config.moment`.
    exr : ExrFormat, optional. How the layers of a frame are written as one file;
        the layers must be those that it needs.
    optics : Optics, optional. As `render_rain` takes it.
    """

    def __init__(
        self, scene, terrain, cameras, config, backend="cpu", layers=(), states=None, exr=None,
        optics=None,
    ):  # fmt: skip
        self.scene, self.cameras, self.config = scene, cameras, config
        self._ground = self._leg = None
        if isinstance(terrain, PathGround):
            self._ground, terrain = terrain, terrain.overview
        self.terrain = terrain = with_footprints(terrain, scene)
        self.backend, self.layers, self.states, self.exr = backend, layers, states, exr
        self._renderer = SequenceRenderer(
            scene, terrain, cameras, config, layers, backend, optics, exr
        )
        self._water, self._state, self._steps, self._begun = None, None, 0, None

    @property
    def next(self):
        """The first frame that needs no simulation from the beginning, int."""
        last = self._steps - 1  # the state that is at hand
        return bisect.bisect_left(self.config.moments, last) if self.config.moments else last + 1

    def frames(self, indices, tell=None):
        """Yield (picture, FrameReport) of the frames `indices`, in rising order."""
        if len(indices) == 0:
            return
        if tell is not None and self._water is None:
            tell("light", 0, 1)
        is_first = self._water is None and self._ground is None and self.states is None
        if is_first and get_num_threads() > 1 and may_run_beside():
            self._begun = _begun(self.terrain, self.config, self.backend)
        for picture, report in self._renderer.render(self._states_of(list(indices), tell)):
            yield picture, report if self.exr is None else replace(report, exr=self.exr)

    def keep_setup(self):
        """Compute with all threads the kept results that other processes of the run will read."""
        if self.backend == "cpu" and cache.folder() is not None:
            self._renderer.make()

    def _states_of(self, indices, tell):
        moment = self.config.moment
        if self.states is not None:
            yield from (_shown_at(self.states(moment(index)), index) for index in indices)
            return
        total = moment(indices[0]) + 1
        for index in indices:
            leg = None if self._ground is None else self._ground.leg(index)
            if self._water is None or index < self.next or leg != self._leg:
                if tell is not None and index == indices[0]:
                    tell("simulate", 0, total)
                self._begin(leg, moment(index) / self.config.fps)
            while self._steps <= moment(index):
                self._state, self._steps = next(self._water), self._steps + 1
                if tell is not None and self._steps <= total:
                    tell("simulate", self._steps, total)
            yield _shown_at(self._state, index)

    def _begin(self, leg, time):
        """Begin the water again: that of the one map, or of a leg that is drawn from a time on."""
        self._water = self._state = None  # their memory is free for what follows
        if leg is None:
            _, simulate_on_backend = on_backend(self.backend)
            begun, self._begun, self._steps = self._begun, None, 0
            self._water = begun or simulate_on_backend(self.terrain, self.config)
            return
        made = self._ground.terrain
        terrain = self._renderer.take_ground(lambda: made(self.scene, leg), time)
        trim()
        self._leg, self._steps = leg, leg.start(self.config)
        self._water = simulate(terrain, self.config, first=self._steps)


def _begun(terrain, config, backend):
    """Return an iterator of states; the first, which takes one core, is found beside the light.

    On a device only what the host does for it is.
    """
    beside = ThreadPoolExecutor(1, initializer=set_threads, initargs=(1,)).submit
    if backend == "cuda":
        from rainsim.cuda.simulation import simulate as simulate_on_device
        from rainsim.cuda.simulation import start_of

        return simulate_on_device(terrain, config, beside(start_of, terrain, config).result)
    states = simulate(terrain, config)
    first = beside(next, states)

    def all_states():
        yield first.result()
        yield from states

    return all_states()


def _shown_at(state, index):
    """Return a state as the one that the frame `index` shows."""
    return state if state.index == index else state.shown_by(index)


def ground_of(
    scene, config, cameras, backend="cpu", mask=None, progress=None, say=None, water=None
):  # fmt: skip
    """Return the ground of frames: one `Terrain`, or a `PathGround` where it follows the path.

    cameras : sequence of Camera. As `FrameSequence` takes them.
    Raises ParameterError, BackendError if the path is asked for together with
        what needs one map.
    """
    if not follows_path(scene, config, cameras, backend, mask if water is None else water):
        return extract_terrain(scene, config, mask, progress, say, water)
    tell = progress or (lambda stage, done, total: None)
    tell("terrain", 0, 1)
    ground, notes = path_ground(scene, config, cameras)
    tell("terrain", 1, 1)
    if say is not None:
        say(notes)
    return ground


def extract_terrain(scene, config, mask=None, progress=None, say=None, water=None):
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
        Called with notes on the map that is going to be made, its size and its cells, and on the
        water.
    water : rainsim.terrain.poured.WaterMask, optional
        On the ground at the start.

    Raises
    ------
    ParameterError
        If the settings ask for ground along a path, which is no single map, or the water does not
        fit the map.

    Examples
    --------
    >>> terrain = rainsim.extract_terrain(scene, config)
    >>> terrain.bed.shape == terrain.grid.shape
    True
    """
    if config.terrain.ground_map == "path":
        raise ParameterError(
            "ground_map is path, which is for the frames of `rainsim run`; here one map of the "
            "whole is made; give whole or auto"
        )
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
    wet = with_water(terrain, water)
    if say is not None and wet is not terrain:
        say(wet.notes[-1:])
    return with_footprints(wet, scene)


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


def render(scene, terrain, states, cameras, config, names=(), backend="cpu", optics=None):
    """Yield (picture, FrameReport) for each state and its camera.

    cameras : sequence of Camera. One per frame of the whole sequence (the state's
        index picks), or one for all.
    backend : {"cpu", "cuda"}. What draws. Pictures of "cuda" are overwritten by
        the next one.
    Yields picture : uint8 array (height, width, 3)
        report : FrameReport
    """
    drawn = SequenceRenderer(scene, terrain, cameras, config, names, backend, optics)
    yield from drawn.render(states)


class SequenceRenderer:
    """Draws states with their cameras; takes the arguments of `render` but the states, and `exr`.

    That is the `ExrFormat` of files whose light `optics` spreads and bends as the picture.
    """

    def __init__(
        self, scene, terrain, cameras, config, names=(), backend="cpu", optics=None, exr=None
    ):  # fmt: skip
        if not cameras:
            raise ParameterError("no camera was given; a frame needs one")
        last = max(config.indices, default=0)
        if 1 < len(cameras) <= last:
            raise ParameterError(
                f"there are {len(cameras)} cameras and the last frame has the number {last}; give "
                "one camera for each frame from 0 on, or one for all"
            )
        self._taking = None
        if optics is not None:
            self._taking = optics.taking(cameras, scene, config, names, backend, exr)
            cameras = self._taking.drawn
        self._scene, self._terrain, self._cameras = scene, terrain, cameras
        self._config, self._names, self._backend = config, names, backend
        self._path = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]
        self._along = PathMotion(self._path, config.fps)
        self._renderer, self._notes = None, ()

    def render(self, states):
        """Yield (picture, FrameReport) for each state."""
        path, along = self._path, self._along
        config, cuts = self._config, deque()  # whether each frame that is drawn ends in a cut

        def shots():
            for state in states:
                index = 0 if len(path) == 1 else state.index
                exposure = config.at(state.time).render.exposure
                if self._scene.pages is not None and len(self._cameras) > 1:
                    ahead = min(state.index + READ_AHEAD, len(self._cameras) - 1)
                    self._renderer.conductor.read_ahead(self._cameras[ahead])
                cuts.append(along.cuts[index])
                yield self._cameras[index], state, along.end(index, exposure)

        if self._renderer is None:
            self._renderer = self.make()
            self._notes = (
                *sunken_notes(path, self._terrain, config),
                *leaving_notes(self._renderer.conductor.wet_scene, self._cameras),
            )
        if self._taking is None:
            film = self._renderer.film(shots(), self._names)
        else:
            film = self._taking.film(self._renderer, shots())
        for picture, report in film:
            notes, self._notes = self._notes, ()
            if cuts.popleft():
                report = without_flow(report)
            if notes:
                report = replace(report, notes=(*notes, *report.notes))
            yield picture, report

    def take_ground(self, make, time):
        """Draw another map of the ground from now on, see `Conductor.take_ground`."""
        return self._renderer.conductor.take_ground(make, time)

    def make(self):
        """Return the backend's renderer for these frames."""
        scene, terrain, first = self._scene, self._terrain, self._cameras[0]
        device_free = free_device_memory(self._backend)
        require_memory(scene, first, terrain.bed.size, len(self._names), device_free)
        scene = without_images(scene, terrain)
        return on_backend(self._backend)[0](scene, terrain, self._config, first)
