"""Lamps that a capture clipped at white: their splats get the radiance that a table gives a class.

A photograph shows a lamp at most as white. On wet roads and in drops a lamp shows by how much
brighter it is than the road, so a description of the scene names its lamps, and their splats are
made as bright as such lamps are.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim.constants import SH_0
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, display, linear

WHITE = 4000.0  # cd/m2 that stand for display white: the zenith of an overcast day of 10,000 lx
# Luminance by class [cd/m2]: intensities towards other drivers that ECE regulations allow (head
# lamps some 1000 cd beside the dipped beam, tail lamps up to 17 cd, brake lamps 60 to 260 cd,
# indicators 200 cd) over lit areas of 100, 25, 50 and 100 cm2; street lamps and signs by order of
# magnitude. The areas are assumptions, and so is which intensity a camera sees.
LUMINANCE = {
    "head": 100_000.0, "tail": 7_000.0, "brake": 30_000.0, "indicator": 20_000.0,
    "street": 60_000.0, "sign": 8_000.0,
}  # fmt: skip
BRIGHT = 0.7  # of white, display-referred: the largest channel of what belongs to a lit lamp
MOST = 4.0  # display value, the brightest that a splat can have (`shading.color.BRIGHTEST`)
DULLEST = 1e-3  # linear luminance that a colour counts with at least


class Lamp(NamedTuple):
    """A ball in which bright splats are a lamp's.

    centre : float64 array (3,). In the frame and unit of the splats.
    """

    kind: str
    centre: np.ndarray
    radius: float


def with_lamps(splats, lamps):
    """Return splats whose lamps shine, and how many splats each lamp has.

    Returns splats : Splats
        counts : list of int

    A bright splat keeps its colour and gets the class's luminance L = g times its own. A Gaussian
    of g times white looks larger than it is, since its faint rim is white too, so its deviations
    shrink by k = sqrt(max(1, ln g)) and its radiance grows by k^2: its flux is that of L over the
    lamp's own area.
    """
    sh, scale, counts = splats.sh.copy(), splats.scale.copy(), []
    shown = 0.5 + SH_0 * splats.sh[:, 0].astype(np.float64)
    for lamp in lamps:
        near = np.linalg.norm(splats.position - lamp.centre, axis=1) <= lamp.radius
        mine = np.flatnonzero(near & (shown.max(axis=1) >= BRIGHT))
        counts.append(len(mine))
        color = linear(np.maximum(shown[mine], 0.0))
        own = np.maximum(color @ LUMINANCE_WEIGHTS, DULLEST)
        gain = np.maximum(LUMINANCE[lamp.kind] / WHITE / own, 1.0)
        narrower = np.sqrt(np.maximum(1.0, np.log(gain)))
        bright = np.minimum(display(color * (gain * narrower**2)[:, None]), MOST)
        sh[mine] = 0.0  # the same from all sides
        sh[mine, 0] = (bright - 0.5) / SH_0
        scale[mine] = splats.scale[mine] / narrower[:, None]
    return replace(splats, sh=sh, scale=np.ascontiguousarray(scale, np.float32)), counts
