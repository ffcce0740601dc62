"""The relit light of a capture: from an earlier run or found and kept, and the splats in it."""

import dataclasses
import math

import numpy as np

from rainsim.constants import SH_0
from rainsim.daylight.relight import Relight, find_relight
from rainsim.io import cache
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.srgb import display, linear

KIND = "daylight"
ROUNDING = 0.1  # of the logarithm of an albedo
NO_RELIGHT = Relight(None, "")


def kept_relight(scene, config, found, white):
    """Return the `Relight` of a scene, from an earlier run if there was one.

    Nothing is looked for where the setting `relight` is "off", where no cloud ever covers the sky,
    and in generated scenes, which are lit by a dull sky. `found` is what the scene's cameras show,
    if anything; `white` the albedo that a captured linear colour of 1 stands for. It is rounded in
    steps of ROUNDING, so that another height map of the scene seldom asks for another search.
    """
    clouds = max(config.at(time).render.cloudiness for time in config.key_times())
    if config.render.relight == "off" or clouds == 0 or scene.source is None:
        return NO_RELIGHT
    given = config.render.captured_sun
    sun, shone = (given, True) if given is not None else (sun_by_clock(scene), False)
    white = math.exp(round(math.log(white) / ROUNDING) * ROUNDING)

    def searched():
        both = vars(find_relight(scene, found, sun, white, shone))
        arrays = {name: v for name, v in both.items() if isinstance(v, np.ndarray)}
        return {name: v for name, v in both.items() if name not in arrays}, arrays

    place = scene.splats, scene.ground_frame, scene.cameras
    facts, arrays = cache.kept(KIND, searched, *place, sun, white, shone)
    return Relight(**facts, **arrays)


def sun_by_clock(scene):
    """Return azimuth and elevation [rad] of the sun by the photographs' place and time, or None."""
    if scene.captured_sun is None:
        return None
    x, y, z = scene.ground_frame.rotation @ scene.captured_sun
    return math.atan2(y, x), math.asin(max(-1.0, min(1.0, float(z))))


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
    degree 0. A share of 0 is as captured, 1 wholly overcast. Instead of a gain (n, 4) is the
    `ground` of a `Relight`.
    """
    if gain is None or share == 0:
        return splats
    if gain.shape[1] == 4:
        return _lifted_ground(splats, gain, share)
    sh = np.empty_like(splats.sh)

    def work(part):
        factor = 1 + np.float32(share) * (gain[part].astype(np.float32) - 1)
        base = splats.sh[part, 0] * np.float32(SH_0) + np.float32(0.5)
        light = linear(base) * factor
        # Nearly black: as the linear part of the display's curve has it.
        scale = np.where(base > 1e-3, display(light) / np.maximum(base, 1e-3), factor)
        sh[part] = splats.sh[part] * scale[:, None, :]
        sh[part, 0] += (scale - 1) * np.float32(0.5 / SH_0)

    in_blocks(work, len(splats))
    return dataclasses.replace(splats, sh=sh)


def _lifted_ground(splats, ground, share):
    """Return the splats with shaded ground as bright as the ground in the sun, see `Relight`.

    Its light is that of the sky, without gloss: the harmonics of splats that were dark are noise.
    """
    which = np.flatnonzero(ground[:, 3])
    own = np.float32(share) * ground[which, 3:].astype(np.float32)
    sh, part = splats.sh.copy(), splats.sh[which]
    light = linear(part[:, 0] * np.float32(SH_0) + np.float32(0.5))
    light += own * (ground[which, :3].astype(np.float32) - light)
    part *= 1 - own[:, None]
    part[:, 0] = (display(light) - np.float32(0.5)) / np.float32(SH_0)
    sh[which] = part
    return dataclasses.replace(splats, sh=sh)
