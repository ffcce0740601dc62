"""The skies of a scene: that of the day, its seen parts, and the surroundings that mirror it."""

from rainsim.io import images
from rainsim.shading import environment, sky
from rainsim.shading.skyline import with_skyline
from rainsim.shading.wetting import SkyMaps


class SceneSky:
    """The sky behind a scene and the light around it.

    skylines : tuple or None. See `skyline.skylines`.
    plain : bool. Whether the day's sky has no land of its own, as a panorama has.
    day : float32 array (rows, columns, 3). The sky of the day, see `day_sky`.
    behind, behind_mirrored : float32 array (rows, columns, 3). What is seen of
        the day behind the scene and behind the mirrored scene.
    environment, gloss, coat : float32 array (rows, columns, 3). The wet capture
        around the first camera with the sky of the day; the same, see `glossy`.
    """

    def __init__(self, backdrop, skylines, plain, day):
        self.day, self.backdrop, self._skylines, self._plain = day, backdrop, skylines, plain
        self.behind = self.behind_mirrored = self.environment = None
        self.gloss, self.coat = environment.glossy(day)  # until the surroundings are drawn

    def take_day(self, day, look):
        """Draw another sky of the day from now on."""
        self.day = day
        self.take_look(look)
        self.gloss, self.coat = environment.glossy(day)

    def take_look(self, look):
        """Make the skies behind the scene and behind the mirrored scene, by the present look."""
        self.behind = self.behind_mirrored = self.backdrop.behind(self.day, look, self._plain)
        if self._skylines:
            whole, mirrored = self._skylines
            self.behind_mirrored = with_skyline(self.behind, mirrored, look.exposure)
            self.behind = with_skyline(self.behind, whole, 0.0)

    def take_surroundings(self, drawn):
        """Mirror the wet capture around the first camera, a map."""
        self.environment = drawn
        self.gloss, self.coat = environment.glossy(drawn)

    def maps(self, mirrored=False):
        """Return the `SkyMaps` of pictures, or of mirrored pictures."""
        return SkyMaps(self.gloss, self.coat, self.behind_mirrored if mirrored else self.behind)


def day_sky(config, zenith):
    """Return the environment map of the sky that a render configuration names.

    `zenith` is the radiance of its zenith if it is overcast; a panorama gets as bright as that.
    """
    level = zenith / sky.ZENITH_RADIANCE
    if config.sky in sky.PLAIN:
        return sky.clouded(sky.overcast(level))
    return sky.from_panorama(images.read_hdr(config.sky), level)
