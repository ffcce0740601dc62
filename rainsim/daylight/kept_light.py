"""The relit light of a capture: from an earlier run or found and kept."""

from __future__ import annotations

import math

import numpy as np

from rainsim.daylight.relight import Relight, find_relight
from rainsim.io import cache

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
    sun = config.render.sun if isinstance(config.render.sun, tuple) else None
    white = math.exp(round(math.log(white) / ROUNDING) * ROUNDING)
    if not cache.folder():
        return find_relight(scene, found, sun, white)
    name = cache.name_of(KIND, scene.splats, scene.ground_frame, scene.cameras, sun, white)
    entry = cache.read(KIND, name)
    if entry:
        facts, arrays = entry
        direction = None if facts["sun"] is None else np.array(facts["sun"])
        return Relight(
            arrays.get("gain"),
            facts["note"],
            direction,
            facts["ratio"],
            facts["confidence"],
            facts["ground_only"],
        )
    relight = find_relight(scene, found, sun, white)
    facts = {
        "note": relight.note, "confidence": relight.confidence, "ratio": relight.ratio,
        "ground_only": relight.ground_only,
        "sun": None if relight.sun is None else [float(x) for x in relight.sun],
    }  # fmt: skip
    cache.write(KIND, name, facts, {} if relight.gain is None else {"gain": relight.gain})
    return relight
