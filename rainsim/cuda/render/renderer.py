"""Whole rainy frames on the GPU: twin of `rainsim.render.renderer`.

A frame is one queue on the device, recorded once and replayed: splatting, grading and wetting, the
water surface, reflections, refraction, streaks, splashes, composition to 8 bit and the copy of the
picture to the host. The host sends what has changed and waits at the end; then it is known which
list had too little room, room is made, and the frame is drawn again. Streaks and splashes are drawn
beside the water, the water's surface is found beside the splatting, and in a video the host
prepares the next frame while the device draws.
"""

from __future__ import annotations

import time as clock

from rainsim.cuda.driver import Event, one_fault
from rainsim.cuda.jit import cuda
from rainsim.cuda.raster import Rasterizer
from rainsim.cuda.render.aov import AovReader
from rainsim.cuda.render.device_frame import DeviceFrame
from rainsim.cuda.render.frame_queue import FrameQueue
from rainsim.cuda.splatting.prepared import DeviceSplats
from rainsim.cuda.timing import part_times
from rainsim.errors import ParameterError
from rainsim.render.conductor import Conductor
from rainsim.render.frame import DRY, SPLAT, SURFACE, WET
from rainsim.render.renderer import report_of
from rainsim.splatting.prepared import LANES


class Renderer:
    """Draws frames of one scene, terrain and configuration on the GPU.

    Takes the states that the CPU's simulation yields, or those of `rainsim.cuda.simulation`, whose
    water stays on the device.

    conductor : Conductor. Scene, light, weather and ground; its capture's
        rasterizer draws on the device.
    frame : DeviceFrame
    queue : FrameQueue
    takes_any_height : bool. No: memory is allocated again and queues are recorded
        again.
    """

    takes_any_height = False

    @one_fault()
    def __init__(self, scene, terrain, config, first_camera):
        _require_known(config.render)
        self.stream, self._ahead = cuda.stream(), cuda.stream()
        self._room = sum(-(-len(actor.splats) // LANES) for actor in scene.actors)
        self.conductor = Conductor(scene, terrain, config, first_camera, self._rasterizer_of)
        self.frame = DeviceFrame(self.conductor, self.stream)
        self.queue = FrameQueue(self.frame)
        self._aovs = AovReader(self.frame)

    def _rasterizer_of(self, prepared):
        if prepared.written is None:
            prepared = DeviceSplats(prepared, self._room)
        return Rasterizer(prepared, self._ahead)

    @one_fault()
    def draw(self, camera, state, camera_end=None, names=()):
        """Return the picture (height, width, 3) uint8 that a camera takes, and its report.

        The picture is overwritten by the next call. Parameters are those of the CPU's renderer.
        """
        self.queue.draw((camera, state, camera_end))
        return self._report(names)

    def film(self, shots, names=()):
        """Yield the result of `draw` for each (camera, state, camera_end), one after the other.

        While one is drawn, the next is asked for and prepared, and begun on the device.
        """
        if not names:
            with one_fault():
                yield from self.queue.draw_each(shots, self._report)
            return
        for shot in shots:
            yield self.draw(*shot, names)

    @one_fault()
    def stage_times(self):
        """Return the milliseconds of each stage of the frame drawn last, by events; draws it again.

        The stages follow one another here; in use some lie beside others, and take less.
        """
        frame, passes, stream = self.frame, self.frame.passes, self.stream

        before, after = Event(), Event()

        def splat():
            before.record(stream)
            before.wait(frame.ahead)
            passes.lanes.queue(SPLAT, frame.ahead)
            after.record(frame.ahead)
            after.wait(stream)

        parts = {"numbers": frame.uniforms.send, "splat": splat}
        for part in (DRY, SURFACE, WET):
            parts.update(passes.each(part, stream))
        parts["copy"] = lambda: frame.copy_image(self.queue.pictures.last.values)
        return part_times(stream, parts)

    def _report(self, names=()):
        """Return the picture and the report of the frame that was finished last."""
        done = self.queue.done
        stages = {"frame": (clock.perf_counter() - done.begin) * 1e3}
        if names:
            self._aovs.make(names, done.state)
        return done.picture.values, report_of(self.conductor, done.state, stages, names)


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
