"""A capture's splats as clouds cover the captured sun."""

from __future__ import annotations

import dataclasses

import numpy as np

from rainsim.constants import SH_0
from rainsim.daylight.lit_surface import BLACK
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.srgb import display, linear

MOST_OF_HARMONICS = np.float32(4)  # factor on harmonics: those of dark splats are noise


def covered_share(render):
    """Return the share of the captured sun that clouds take, 0 to 1.

    More than their share of the sky: clouds that spread grow thicker, too, and before rain the sun
    rarely finds a gap. Chosen.
    """
    return 1 - (1 - render.cloudiness) ** 2


def under_clouds(splats, gain, share):
    """Return the splats with a share of the sun divided out; the given ones where there is none.

    Light adds up, so the gain on linear light is the mean of 1 and `gain`, (n, 3), see `Relight`. A
    splat's harmonics are display-referred: all are scaled by what the gain does to its colour of
    degree 0. A share of 0 is as captured, 1 wholly overcast.
    """
    if gain is None or share == 0:
        return splats
    sh = np.empty_like(splats.sh)

    def work(part):
        factor = 1 + np.float32(share) * (gain[part].astype(np.float32) - 1)
        base = splats.sh[part, 0] * np.float32(SH_0) + np.float32(0.5)
        # What is brightened and black gets some light: a splat may be dark to hide a bright one.
        light = np.where(factor > 1, np.maximum(linear(base), BLACK), linear(base)) * factor
        # Nearly black: as the linear part of the display's curve has it.
        scale = np.where(base > 1e-3, display(light) / np.maximum(base, 1e-3), factor)
        sh[part] = splats.sh[part] * np.minimum(scale, MOST_OF_HARMONICS)[:, None, :]
        lit = (factor > 1) & (base < display(BLACK))
        sh[part, 0] = (np.where(lit, display(light), base * scale) - np.float32(0.5)) / SH_0

    in_blocks(work, len(splats))
    return dataclasses.replace(splats, sh=sh)
