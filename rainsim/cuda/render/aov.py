"""AOVs of frames that were drawn on the GPU.

The device keeps no AOVs: the buffers of the finished frame are fetched, and the CPU's functions
compute the terms of the water from them. Mirrored pictures and the dry picture are splatted again.
So an AOV costs what it costs on the CPU, less the splatting.
"""

from __future__ import annotations

from types import SimpleNamespace

from rainsim.cuda.raster import Rasterizer
from rainsim.reflection.water_pass import WetPicture
from rainsim.render import aov
from rainsim.render.report import Timer
from rainsim.scene.view import view_of
from rainsim.shading.composite import RainLight


class AovReader:
    """Computes the AOVs of the frame that a device has finished.

    Parameters
    ----------
    frame : DeviceFrame
    """

    def __init__(self, frame):
        self.frame = frame
        self._rasterizer = None  # no recorded queue depends on its pictures

    def read(self, names, state):
        """Return the named AOVs of the finished frame, and the light that recomposes it.

        Parameters
        ----------
        names : sequence of str
            Of `aov.AOVS`.
        state : SimState or DeviceState
        """
        frame, host = self.frame, self.frame.host
        wet = WetPicture(
            frame.picture.copy_to_host(), frame.depth.copy_to_host(),
            frame.clearance.copy_to_host(), view_of(host.view), frame.below.copy_to_host(),
        )  # fmt: skip
        state = SimpleNamespace(
            index=state.index, time=state.time, depth=frame.surface.depth.copy_to_host(),
            slopes=frame.ripple_slopes(), tile_size=state.tile_size, drips=state.drips,
            drip_id=state.drip_id, top_water=state.top_water,
        )  # fmt: skip
        drops, sheets = frame.drop_light.drops, frame.drop_light.sheets
        light = RainLight(drops.copy_to_host(), sheets.copy_to_host(), host.air_light)
        scene = host.wet_scene
        if self._rasterizer is None:
            own = frame.rasterizer
            self._rasterizer = Rasterizer(own.splats, own.stream, first_room=own.entries)
        scene.rasterizer = self._rasterizer
        try:
            if not set(aov.OF_THE_WATER).isdisjoint(names):
                host.water.look(wet)
                light_of = host.mirrored, scene.traced, scene.environment, host.sunlight
                host.water.draw(state, host.shower, *light_of, Timer())
            return host.aovs(names, state, wet, frame.rain.cover(), light)
        finally:
            scene.rasterizer = frame.rasterizer
