"""Layers of frames that were drawn on the GPU.

The device holds no layers of its own: what it has drawn is fetched, and what was never drawn apart,
the terms of the water, the CPU's functions find again in that. Mirrored pictures and the dry one
are splatted once more for it. So a layer costs what it costs on the CPU, less the splatting.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from rainsim import layers
from rainsim.cuda.raster import Rasterizer
from rainsim.render import Timer, lens_of, pose
from rainsim.splash import LONGEST_LIFE
from rainsim.streaks import NO_FOG
from rainsim.waterview import View


class TakesApart:
    """The part of `rainsim.cuda.frame.Renderer` that tells layers."""

    _aside = None  # a rasterizer whose pictures no recorded queue knows

    def _take_apart(self, names, camera, state):
        """Return the layers of the frame just drawn, and what `layers.recompose` needs besides.

        Parameters
        ----------
        names : sequence of str
            Of `layers.LAYERS`.
        camera : Camera
            In the capture frame, as the frame was drawn.
        state : SimState or DeviceState
        """
        shown, when = self.streaks is not None, state.time
        render = self.now.render
        self.field = self.weather.field(when - LONGEST_LIFE, when + render.exposure)
        self._camera = camera
        picture = self._picture.copy_to_host()
        self.wet = View(
            picture, self._depth.copy_to_host(), self._clearance.copy_to_host(),
            *pose(self.view), lens_of(camera), self._below.copy_to_host(),
        )  # fmt: skip
        nothing = np.zeros_like(self.wet.depth)
        rain = self.streaks.alpha.copy_to_host() if shown else nothing
        splash = self.splashes.alpha.copy_to_host() if shown else nothing
        moments = self._moments.copy_to_host()  # the first are the tile's own slopes
        slopes = np.moveaxis(moments[:, : len(moments), :2], -1, 0)
        state = SimpleNamespace(
            index=state.index, time=when, depth=self._surface.depth.copy_to_host(),
            slopes=slopes, tile_size=state.tile_size, drips=state.drips, drip_id=state.drip_id,
        )  # fmt: skip
        own = self.rasterizer
        if self._aside is None:
            self._aside = Rasterizer(own.splats, own.stream, first_room=own.entries)
        self.rasterizer = self._aside
        try:
            if not set(layers.TERMS).isdisjoint(names):
                self.water.look(self.wet)
                self.water.draw(
                    state, self._mirrored, self._traced, self.environment, self._sun, Timer()
                )
            fog = self._fog_of[1] if shown else NO_FOG
            found = layers.collect(names, self._shot(names, state, rain, splash, fog))
        finally:
            self.rasterizer = own
        light = {"drop": self.numbers.host["drop"].tolist(), "air": self._air.tolist()}
        light["around"] = self.everywhere.tolist()
        return found, light | {"brightness": float(render.brightness)}
