"""AOVs of frames that were drawn on the GPU.

The device keeps no AOVs: the buffers of the finished frame are fetched, and the CPU's passes
compute the layers from them. Mirrored pictures and the dry picture are splatted again. So an AOV
costs what it costs on the CPU, less the splatting.
"""

from __future__ import annotations

from rainsim.cuda.raster import Rasterizer
from rainsim.render.layers import buffers_of
from rainsim.render.passes import Passes
from rainsim.shading.composite import RainLight


class AovReader:
    """Computes the AOVs of the frame that a device has finished.

    frame : DeviceFrame
    """

    def __init__(self, frame):
        self._frame, self._passes = frame, Passes()
        self._rasterizer = None  # no recorded queue depends on its pictures

    def make(self, names, state):
        """Make the named AOVs of the finished frame, and the light that recomposes it.

        They stand in the conductor's `Frame` afterwards.

        names : sequence of str. Of `aov.AOVS`.
        state : SimState or DeviceState
        """
        frame, conductor = self._frame, self._frame.conductor
        inputs, scene = conductor.frame, conductor.wet_scene
        capture = scene.capture
        for name in ("picture", "below", "depth", "clearance", "dazzling"):
            inputs.put(name, frame[name].copy_to_host())
        cover, light = frame.passes.rain.cover(), frame.passes.drop_light
        inputs.put("rain_alpha", cover.rain_alpha)
        inputs.put("fog", cover.fog)
        inputs.put("splash_alpha", cover.splash_alpha)
        drops, sheets = light.drops.copy_to_host(), light.sheets.copy_to_host()
        inputs.put("rain_light", RainLight(drops, sheets, inputs["air"]))
        inputs.put("water", frame.passes.surface.depth.copy_to_host())
        inputs.put("ripples", (frame.ripple_slopes(), state.tile_size))
        inputs.put("drips", (state.drips, state.drip_id))
        if capture.paged is not None:  # which draws for the host with a rasterizer of its own
            inputs.make(buffers_of(names), self._passes.work)
            return
        if self._rasterizer is None:
            own = frame.rasterizer
            self._rasterizer = Rasterizer(own.splats, own.stream, first_room=own.room.entries)
        capture.rasterizer = self._rasterizer
        try:
            inputs.make(buffers_of(names), self._passes.work)
        finally:
            capture.rasterizer = frame.rasterizer
