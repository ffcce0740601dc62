"""What the passes of a frame compute on the CPU; `rainsim.render.frame` names them in order."""

import numpy as np

from rainsim.particles import drop_radiance, paper
from rainsim.reflection import water_pass
from rainsim.reflection.water_pass import WetPicture
from rainsim.render import layers
from rainsim.render.frame import is_same
from rainsim.render.rain_pass import draw_falling, draw_landing
from rainsim.shading.composite import RainCover, RainLight, compose
from rainsim.shading.glare import Glare


class Passes:
    """The passes of a frame on the CPU, with what they keep from one frame to the next.

    work : dict of str to callable. By the names of the passes, see `Frame.make`.
        What is no pass of the CPU has no entry: the light on wet ground is found
        with the film, tall things when a ray is first marched.
    """

    def __init__(self):
        self._mirrors, self._mirrored = {}, None  # by level, window and step; what they show
        self._blocks, self._glare = (None, None), Glare()
        self.work = {
            "splat": _splat, "grade and wet": _grade, "film": _add_film,
            "water surface": _draw_surface, "light of drops": _light_drops,
            "find water": _find_water, "mirror": self.mirror, "reflection": self.reflect,
            "water": _lay, "streaks": draw_falling, "splashes": draw_landing,
            "light of the rain": _light_rain, "glare": self._add_glare, "compose": _compose,
            **layers.WORK,
        }  # fmt: skip

    def forget_reflections(self):
        """Forget the mirrored pictures and the depth that is marched."""
        self._mirrors, self._blocks = {}, (None, None)

    def mirror(self, seen, tops, camera, view, scene, methods, mirror_step):
        """Return the mirrored pictures that the water asks for, by their places."""
        shows = camera, scene.changes
        if not is_same(shows, self._mirrored):
            self._mirrors, self._mirrored = {}, shows
        if not len(seen):
            return {}
        places = water_pass.shared_out(seen, methods.reflections, tops, view)[0]
        kept = self._mirrors
        self._mirrors = {
            (*place, mirror_step): kept.get((*place, mirror_step))
            or scene.mirrored(camera, *place, mirror_step)
            for place, _ in places
        }
        return {place: self._mirrors[*place, mirror_step] for place, _ in places}

    def reflect(
        self, seen, mirrors, ripples, tops, picture, depth, clearance, view, scene, methods
    ):
        """Fill in the slopes and the mirrored light of the water."""
        if not len(seen):
            return seen
        water_pass.tilt(seen, *ripples, tops)
        wet = WetPicture(picture, depth, clearance, view, None)
        around = scene.sky.environment, scene.sky.gloss
        water_pass.light_up(
            seen, methods.reflections, wet, tops, mirrors.get, around,
            lambda: self._depth_blocks(wet),
        )  # fmt: skip
        return seen

    def _depth_blocks(self, wet):
        if self._blocks[0] is not wet.depth:
            self._blocks = wet.depth, water_pass.depth_blocks(wet)
        return self._blocks[1]

    def _add_glare(self, shown, ground_camera, brightness, render):
        if render.glare == "off":
            return shown
        return self._glare.added(shown, ground_camera.fx, brightness)


def _splat(camera, capture):
    return capture.layers(camera)


def _grade(layers, view, scene, film_apart):
    """Return picture, depth, clearance and cover without what wet ground mirrors."""
    cover = np.empty(layers.alpha.shape if film_apart else (0, 0), np.float32)
    wet = scene.wetted(layers, view, cover)
    return wet.picture, wet.depth, wet.clearance, cover


def _add_film(below, depth, clearance, cover, view, ground_camera, scene, ground):
    wet, sky = WetPicture(below, depth, clearance, view, below), scene.sky
    return ground.film.add_to(wet, cover, ground_camera, scene.level_mirrored, sky.gloss).picture


def _draw_surface(water, rings, ground):
    return water_pass.draw_surface(ground.water, water, rings)


def _light_drops(picture, depth, view, scene, everywhere):
    return drop_radiance.falling_light(
        scene.sky.gloss, everywhere, view.ground_from_camera, view.lens, picture, depth
    )


def _find_water(depth, view, surface, tops, scene, methods):
    off_ground = scene.shading.off_ground
    return water_pass.find_water(methods, depth, view, surface, tops, off_ground)


def _lay(seen, picture, below, depth, view, sun, methods):
    """Return the picture with the water on it."""
    shown = picture.copy()
    water_pass.lay(seen, methods, WetPicture(picture, depth, None, view, below), sun, shown)
    return shown


def _light_rain(drop_light, air, shown, render):
    """Return the `RainLight` of drops, splashes and air."""
    if render.streaks == "paper":
        drops = drop_radiance.even(paper.line_radiance(shown))
        return RainLight(drops, drops, air)
    return RainLight(*drop_light, air)


def _compose(dazzling, depth, rain_alpha, splash_alpha, fog, rain_light, view, brightness):
    image = np.empty((*depth.shape, 3), np.uint8)
    cover = RainCover(rain_alpha, splash_alpha, fog)
    compose(dazzling, depth, cover, rain_light, view, np.float32(brightness), image)
    return image
