"""Whole rainy frames on the GPU: twin of `rainsim.render.renderer`.

The passes are those of the CPU, in the same order, and run by the same `Frame`; what they compute
stands in `rainsim.cuda.render.passes`. The finished picture is copied to the host while the next
frame is drawn.
"""

from typing import NamedTuple

import numpy as np

from rainsim.cuda.driver import Download, one_fault
from rainsim.cuda.jit import cuda
from rainsim.cuda.raster import Rasterizer, Workspace
from rainsim.cuda.render.aov import read_aovs
from rainsim.cuda.render.passes import Passes
from rainsim.cuda.splatting.prepared import DeviceSplats
from rainsim.errors import ParameterError
from rainsim.rain.moving_surfaces import FRAMES_AHEAD
from rainsim.render.conductor import Conductor
from rainsim.render.renderer import report_of
from rainsim.render.report import FrameReport, Timer
from rainsim.splatting.prepared import LANES


class Drawn(NamedTuple):
    """A frame that is on its way to the host."""

    picture: np.ndarray  # there, once it is copied
    report: FrameReport
    copied: object  # the event of its copy

    def finished(self):
        """Return picture and report; waits for the copy."""
        self.copied.synchronize()
        return self.picture, self.report


class Renderer:
    """Draws frames of one scene, terrain and configuration on the GPU.

    Takes the states that the CPU's simulation yields, or those of `rainsim.cuda.simulation`, whose
    water stays on the device.

    conductor : Conductor. Scene, light, weather and ground; its capture's
        rasterizer draws on the device, its `frame` holds device arrays.
    takes_any_height : bool. No: memory is allocated again.
    """

    takes_any_height = False

    @one_fault()
    def __init__(self, scene, terrain, config, first_camera):
        _require_known(config.render)
        self._room = sum(-(-len(actor.splats) // LANES) for actor in scene.actors)
        self._workspace, self._download = Workspace(), Download()
        self.conductor = Conductor(scene, terrain, config, first_camera, self._rasterizer_of)
        self.passes = Passes(self.conductor)

    def _rasterizer_of(self, prepared):
        if prepared.written is None:
            prepared = DeviceSplats(prepared, self._room)
        return Rasterizer(prepared, workspace=self._workspace)

    @one_fault()
    def draw(self, camera, state, camera_end=None, names=(), timer=None):
        """Return the picture (height, width, 3) uint8 that a camera takes, and its report.

        The picture is overwritten by the next call but one. Parameters are those of the CPU's
        renderer; with a `timer` the host waits for the device after each pass.
        """
        return self._begin(camera, state, camera_end, names, timer).finished()

    def film(self, shots, names=()):
        """Yield the result of `draw` for each (camera, state, camera_end), one after the other.

        A picture is copied to the host while the next one is drawn.
        """
        before = None
        for shot in shots:
            with one_fault():
                drawn = self._begin(*shot, names)
                done = None if before is None else before.finished()
            if done is not None:
                yield done
            before = drawn
        if before is not None:
            yield before.finished()

    def _begin(self, camera, state, camera_end, names=(), timer=None):
        """Queue a frame and the copy of its picture; return it as `Drawn`."""
        conductor, own = self.conductor, timer or Timer()
        depth, moments = self.passes.tables.water_of(state)
        conductor.roll(state.time, _host_depth(state) if conductor.cars else None)
        conductor.take(camera, state, camera_end)
        self.passes.tables.update()
        put, frame = conductor.frame.put, conductor.frame
        put("water", depth, mark=state)
        put("ripples", (moments, np.float32(state.tile_size)), mark=state)
        put("drips", _drips_of(state), mark=state)

        def mark(name):
            if timer is not None:
                cuda.synchronize()
            own.mark(name)

        frame.make(("image",), self.passes.work, mark)
        picture, copied = self._download.begin(frame["image"])
        made = read_aovs(names, state, frame) if names else None
        report = report_of(conductor, state, own.stages, names, made)
        if conductor.ground.terrain.footprints:
            fps = conductor.config.fps
            number = round(state.time * fps)
            times = [(number + n) / fps for n in range(1 + FRAMES_AHEAD)]
            conductor.look_ahead(times[1:], times[:1])
        return Drawn(picture, report, copied)


def _host_depth(state):
    """Return the depth of a state's water [m] on the host."""
    return state.depth.copy_to_host() if hasattr(state, "moments") else state.depth


def _drips_of(state):
    """Return the drips of a state: a `DripList` of the device, or the table and ids of the host."""
    if hasattr(state, "drip_list"):
        return state.drip_list
    return state.drips, state.drip_id


def _require_known(render):
    """Raise ParameterError for looks that only the CPU draws."""
    for name, wanted in (
        ("reflections", ("auto", "mirror", "ssr")), ("water_geometry", ("height-field",)),
        ("refraction", ("snell",)), ("highlight", ("cox-munk",)), ("coverage", ("soft",)),
        ("streaks", ("shutter",)), ("splashes", ("crowns",)),
    ):  # fmt: skip
        value = getattr(render, name)
        if value not in wanted:
            raise ParameterError(
                f"{name} is {value!r}; backend cuda draws {' or '.join(wanted)}; take backend cpu"
            )
