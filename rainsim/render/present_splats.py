"""The splats of a capture in the light and the wetness of the present time."""

import numpy as np

from rainsim.daylight.kept_light import covered_share, under_clouds
from rainsim.shading.diffuse import level_share, step_of, without_gloss
from rainsim.shading.wetness import paving_dampness


class PresentSplats:
    """Colours of a scene's splats: the captured ones without their sun and without their gloss.

    gain : array (n, 3) or None. See `daylight.relight.Relight`.
    diffuse : array (n, 3) or None. See `visibility.Views`.
    reach, lawn, bodies : array (ny, nx, ...). See `diffuse.level_share`.
    """

    def __init__(self, scene, gain, diffuse, terrain, reach, lawn, bodies):
        self._captured, self._gain = scene.splats, gain
        self._level, self._diffuse = None, diffuse
        if diffuse is not None:
            self._level = level_share(scene, terrain, reach, lawn, bodies)

    def state(self, now):
        """Return the two numbers of 0 to 1 on which the colours depend at the settings of one time.

        The share of the captured sun that clouds take, and how wet level surfaces are.
        """
        wet = self._level is not None and now.render.wetting != "none"
        clouds = 0.0 if self._gain is None else covered_share(now.render)
        return clouds, step_of(paving_dampness(now)) if wet else 0.0

    def at(self, state):
        """Return the `Splats` of a state; the captured ones where nothing changes them."""
        clouds, wet = state
        splats = self._captured
        if wet > 0:
            splats = without_gloss(splats, self._diffuse, self._level * np.float32(wet))
        return under_clouds(splats, self._gain, clouds)
