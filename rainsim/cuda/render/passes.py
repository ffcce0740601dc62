"""What the passes of a frame compute on a GPU; `rainsim.render.frame` names them in order.

Each takes device arrays and queues the work on the device; some wait for a count.
"""

import numpy as np

from rainsim.cuda.jit import cuda
from rainsim.cuda.particles.drop_radiance import DropLight
from rainsim.cuda.reflection import ray_water, screen_space, water_shading, wet_tops
from rainsim.cuda.reflection.planar_mirror import Mirrors
from rainsim.cuda.reflection.water_surface import WaterSurface
from rainsim.cuda.render.device_tables import DeviceTables
from rainsim.cuda.render.rain_pass import RainPass
from rainsim.cuda.shading.composite import compose
from rainsim.cuda.shading.glare import Glare
from rainsim.cuda.shading.wet_ground_mirror import WetGroundLight, add_reflection
from rainsim.cuda.shading.wet_pass import pixel_grid
from rainsim.reflection.water_pass import optics_of
from rainsim.reflection.water_shading import Background, Ripples
from rainsim.reflection.water_surface import WaterMap
from rainsim.shading.composite import RainCover, RainLight
from rainsim.ssr import bounds_of


class Passes:
    """The passes of a frame on a GPU, with what they keep from one frame to the next.

    work : dict of str to callable. By the names of the passes, see `Frame.make`.
        What is no pass of the device has no entry: the level picture is splatted
        with the light on wet ground, drops are listed as they are drawn.
    """

    def __init__(self, conductor):
        self.tables, ground, self._arrays = DeviceTables(conductor), conductor.ground, {}
        self._surface = WaterSurface(
            ground.terrain.bed, ground.water.relief, ground.terrain.mirrors,
            ground.water.block_reach,
        )  # fmt: skip
        self._mirrors, self._drop_light = Mirrors(self.tables), DropLight()
        self._glare, self._rain = Glare(), RainPass(conductor)
        self._film = WetGroundLight(self.tables) if ground.film.apart else None
        self.work = {
            "splat": _splat, "light on wet ground": self._light_ground,
            "grade and wet": self._grade, "film": self._add_film,
            "water surface": self._draw_surface, "find tall": self._find_tall,
            "light of drops": self._light_drops, "list drops": self._rain.see,
            "streaks": self._rain.fall, "splashes": self._rain.land,
            "find water": self._find_water, "mirror": self._mirror, "reflection": self._march,
            "water": self._lay, "light of the rain": self._light_rain, "glare": self._add_glare,
            "compose": self._compose,
        }  # fmt: skip

    def _array(self, name, *shape, kind=np.float32):
        """Return a device array that stays until another shape is asked for."""
        if name not in self._arrays or self._arrays[name].shape != shape:
            self._arrays[name] = None  # freed before more is asked for
            self._arrays[name] = cuda.device_array(shape, kind)
        return self._arrays[name]

    def _grade(self, layers, film_apart):
        size = layers.alpha.shape
        below = self._array("below", *size, 3)
        depth, clearance = (self._array(name, *size) for name in ("depth", "clearance"))
        cover = self._array("cover", *size) if film_apart else None
        self.tables.grade(layers, self.tables.camera, below, depth, clearance, cover)
        return below, depth, clearance, cover

    def _light_ground(self, scene, ground_camera):
        return None if self._film is None else self._film.draw(scene, ground_camera)

    def _add_film(self, below, depth, cover, field_on_ground):
        if field_on_ground is None:
            return below
        picture = self._array("picture", *below.shape)
        add_reflection[pixel_grid(depth.shape)](below, cover, *field_on_ground, picture)
        return picture

    def _draw_surface(self, water):
        self._surface.draw(water)
        return self._surface

    def _find_tall(self, depth, clearance):
        size, joiners = depth.shape, screen_space.JOINERS
        tall, bounds = self._array("tall", *size), self._array("bounds", *bounds_of(*size))
        screen_space.keep_tall[pixel_grid(size)](depth, clearance, tall, bounds)
        screen_space.join_bounds[-(-len(bounds) // joiners), joiners](*size, bounds)
        return tall, bounds

    def _light_drops(self, picture, depth, view, scene, everywhere):
        return self._drop_light.find(picture, depth, scene.sky.gloss, everywhere, view)

    def _find_water(self, depth, surface, scene):
        tables, grid = self.tables, pixel_grid(depth.shape)
        seen = tuple(self._array(name, *depth.shape) for name in ("hit", "coverage"))
        ray_water.meet_water[grid](
            depth, tables.view, self._water_map(surface), surface.highest, tables["cover"], *seen
        )
        if len(tables.tops.form):
            wet_tops.meet_tops[grid](
                depth, tables.view, tables.tops, scene.shading.off_ground, *seen
            )
        return seen

    def _water_map(self, surface):
        tables = self.tables
        return WaterMap(
            surface.surface, surface.over, tables["rings"], *tables.place, surface.shores
        )

    def _mirror(self, seen, camera, scene, methods, mirror_step):
        return self._mirrors.draw(seen, camera, scene, methods.reflections, mirror_step)

    def _march(self, seen, mirrors, ripples, depth, tall):
        (height, width), (wide, high) = depth.shape, screen_space.PATCH
        distance, tables = self._array("distance", height, width), self.tables
        screen_space.find_hits[(-(-width // wide), -(-height // high)), screen_space.PATCH](
            *seen, *tall, tables.view, tables.march, mirrors.range, distance
        )
        return distance, mirrors, tall[0], Ripples(*ripples)

    def _lay(self, seen, reflected, picture, below, depth, methods):
        tables, (distance, mirrors, tall, ripples) = self.tables, reflected
        shown = self._array("shown", *picture.shape)
        water_shading.shade_water[pixel_grid(depth.shape)](
            *seen, distance, Background(picture, below, depth), tall, tables.view,
            self._water_map(self._surface), tables.tops, ripples, tables["environment"],
            tables["gloss"], tables.march, mirrors, optics_of(methods, tables["sun"]), shown,
        )  # fmt: skip
        return shown

    def _light_rain(self, drop_light):
        return RainLight(*drop_light, self.tables["air"])

    def _add_glare(self, shown, ground_camera, brightness, render):
        if render.glare == "off":
            return shown
        return self._glare.added(shown, np.float32(brightness), ground_camera.fx)

    def _compose(self, dazzling, depth, rain_alpha, splash_alpha, fog, rain_light, brightness):
        image = self._array("image", *dazzling.shape, kind=np.uint8)
        compose[pixel_grid(depth.shape)](
            dazzling, depth, RainCover(rain_alpha, splash_alpha, fog), rain_light,
            self.tables.view, np.float32(brightness), image,
        )  # fmt: skip
        return image


def _splat(camera, capture):
    return capture.layers(camera, on_device=True)
