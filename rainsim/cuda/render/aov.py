"""AOVs of frames that were drawn on the GPU.

The device keeps no AOVs: the buffers of the finished frame are fetched, and the CPU's passes
compute the layers from them. Mirrored pictures and the dry picture are splatted again. So an AOV
costs what it costs on the CPU, less the splatting.
"""

import numpy as np

from rainsim.render.frame import INPUTS, PASSES, Frame
from rainsim.render.layers import LAYER_PASSES, buffers_of
from rainsim.render.passes import Passes
from rainsim.shading.composite import RainLight

FETCHED = (
    "picture", "below", "depth", "clearance", "dazzling", "rain_alpha", "splash_alpha", "fog",
    "water",
)  # fmt: skip


def read_aovs(names, state, drawn):
    """Return a `Frame` of the host with the AOVs of a finished one, and what recomposes it."""
    frame = Frame((*PASSES, *LAYER_PASSES))
    for name in INPUTS:
        if name not in FETCHED:
            frame.put(name, drawn[name])
    for name in FETCHED:
        frame.put(name, drawn[name].copy_to_host())
    light = drawn["rain_light"]
    fields = light.drops.copy_to_host(), light.around.copy_to_host()
    frame.put("rain_light", RainLight(*fields, drawn["air"]))
    moments, size = drawn["ripples"]
    moments = moments.copy_to_host()  # first columns: the slopes themselves
    frame.put("ripples", (np.moveaxis(moments[:, : len(moments), :2], -1, 0), size))
    frame.put("drips", (state.drips, state.drip_id))
    frame.make(buffers_of(names), Passes().work)
    return frame
