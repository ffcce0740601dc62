"""Twin of `rainsim.render.passes`: what the passes of a frame queue on the device."""

from __future__ import annotations

from functools import partial

from rainsim.cuda.driver import Event
from rainsim.cuda.jit import cuda
from rainsim.cuda.particles.drop_radiance import DropLight
from rainsim.cuda.reflection import ray_water, screen_space, water_shading, wet_tops
from rainsim.cuda.reflection.planar_mirror import Mirrors
from rainsim.cuda.reflection.water_surface import WaterSurface
from rainsim.cuda.render.actor_splats import MovingActors
from rainsim.cuda.render.lanes import Lanes, Launch
from rainsim.cuda.render.rain_pass import RainPass
from rainsim.cuda.shading.composite import compose
from rainsim.cuda.shading.glare import Glare
from rainsim.cuda.shading.wet_ground_mirror import WetGroundLight
from rainsim.cuda.shading.wet_pass import grade_layers, pixel_grid
from rainsim.reflection.water_pass import optics_of
from rainsim.reflection.water_shading import Background, Ripples
from rainsim.reflection.water_surface import WaterMap
from rainsim.render.frame import PASSES, WET
from rainsim.shading.composite import RainCover, RainLight


class Passes:
    """The passes of the frames of a device, with their tables there.

    frame : DeviceFrame
    mirrors : Mirrors
    ground_light : WetGroundLight
    drop_light : DropLight
    surface : WaterSurface
    glare : Glare or None. None: lamps have no halos.
    actors : MovingActors or None. None in scenes without actors.
    rain : RainPass
    lanes : Lanes. What is queued beside what.
    launches : dict of str to Launch. By the names of the passes. What is no pass
        of the device has no entry: the reflection is found where the water is
        shaded.
    """

    def __init__(self, frame):
        self._frame, conductor = frame, frame.conductor
        ground = conductor.ground
        self.surface = WaterSurface(
            ground.terrain.bed, ground.water.relief, ground.terrain.mirrors, frame["water"],
            ground.water.block_reach, frame.stream,
        )  # fmt: skip
        self.mirrors = Mirrors(frame, conductor.config.render.reflections)
        self.ground_light, self.drop_light = WetGroundLight(frame), DropLight(frame)
        self.glare = None if conductor.config.render.glare == "off" else Glare(frame)
        aside, beside = cuda.stream(), cuda.stream()
        self._counted = Event(), Event()
        capture = conductor.wet_scene.capture
        self.actors = None if capture.actors is None else MovingActors(frame)
        self.rain = RainPass(frame, self.actors, self.surface)
        launches = {
            "splat": Launch(lambda stream: frame.rasterizer.launch()),
            "grade and wet": Launch(self._grade),
            "water surface": Launch(self.surface.launch),
            "find tall": Launch(self._find_tall, aside),
            "light of drops": Launch(self.drop_light.launch, aside),
            "list drops": Launch(self.rain.send, beside),
            "streaks": Launch(self.rain.draw_streaks, beside),
            "list splashes": Launch(self._list_splashes, aside),
            "splashes": Launch(self.rain.draw_splashes, beside),
            "find water": Launch(self._find_water),
            "mirror": Launch(self._mirror),
            "water": Launch(self._lay_water), "compose": Launch(self._compose),
        }  # fmt: skip
        if (light := self.ground_light).level is not None:
            launches["splat level"] = Launch(light.splat, light.stream)
            launches["light on wet ground"] = Launch(light.draw, light.stream)
            launches["film"] = Launch(light.add)
        if self.glare is not None:
            launches["glare"] = Launch(self.glare.add)
        self.launches, self.lanes = launches, Lanes(PASSES, launches)

    def each(self, part, stream):
        """Return what a part queues, by pass, one after the other on a stream: functions."""
        return {
            each.name: partial(self.launches[each.name].queue, stream)
            for each in self.lanes.of(part)
        }

    def room_for(self, height, width):
        """Make room for pictures of a size [px]."""
        self.mirrors.forget_size()
        self.rain.room_for(height, width)
        if self.glare is not None:
            self.glare.room_for(height, width)

    # ---- what a finished frame had too little room for

    def dry_rasterizers(self):
        """Return what may lack room in pictures that need no water: rasterizers, and `Lamps`."""
        light = self.ground_light
        return [self._frame.rasterizer, *light.rasterizers, *light.lamps]

    def wait_for_counts(self):
        """Wait until it is known how much room the frame's water and rain need."""
        for counted in self._counted:
            counted.synchronize()

    @property
    def lacks(self):
        """Whether the frame's water and rain had too little room."""
        return self.mirrors.lacks or self.rain.lacks

    def grow(self):
        """Make room where the finished frame's water and rain lacked it."""
        self.mirrors.grow()
        self.rain.grow()

    def dependencies(self, part):
        """Return the values that the recorded queues of a part, WET or not, depend on, a tuple."""
        if part == WET:
            return *self.mirrors.queue, *self.rain.dependencies()
        return *self._frame.rasterizer.queue, *self.ground_light.queue

    # ---- what is queued

    def _grade(self, stream):
        frame = self._frame
        grade_layers(
            frame, frame.rasterizer, frame.size, frame.uniforms["turn"], frame.uniforms["eye"],
            frame["below"], frame["depth"], frame["clearance"], frame["cover"], stream,
            mirrored=False,
        )  # fmt: skip

    def _find_tall(self, stream):
        frame, joiners = self._frame, screen_space.JOINERS
        screen_space.keep_tall[pixel_grid(frame.size, stream)](
            frame["depth"], frame["clearance"], frame["tall"], frame["bounds"]
        )
        screen_space.join_bounds[-(-len(frame["bounds"]) // joiners), joiners, stream](
            *frame.size, frame["bounds"]
        )

    def _list_splashes(self, stream):
        self.rain.list_splashes(stream)
        self._counted[0].record_outside(stream)

    def _mirror(self, stream):
        self.mirrors.launch(stream)
        self._counted[1].record_outside(stream)

    def _find_water(self, stream):
        frame = self._frame
        grid, found = pixel_grid(frame.size, stream), (frame["hit"], frame["coverage"])
        ray_water.meet_water[grid](
            frame["depth"], frame.view, self._water_map, self.surface.highest,
            frame.uniforms["cover"], *found,
        )  # fmt: skip
        if len(frame.tops.form):
            wet_tops.meet_tops[grid](
                frame["depth"], frame.view, frame.tops, frame.uniforms["off_ground"],
                *found,
            )  # fmt: skip

    @property
    def _water_map(self):
        drawn, place = self.surface, self._frame.place
        return WaterMap(drawn.surface, drawn.over, self._frame["rings"], *place, drawn.shores)

    def _lay_water(self, stream):
        frame, mirrors = self._frame, self.mirrors.arrays
        (height, width), (wide, high) = frame.size, screen_space.PATCH
        patches = (-(-width // wide), -(-height // high)), screen_space.PATCH, stream
        found, settings = (frame["hit"], frame["coverage"]), frame.uniforms["settings"]
        screen_space.find_hits[patches](
            *found, frame["tall"], frame["bounds"], frame.view, settings, mirrors.range,
            frame["distance"],
        )  # fmt: skip
        water_shading.shade_water[pixel_grid(frame.size, stream)](
            *found, frame["distance"],
            Background(frame["picture"], frame["below"], frame["depth"]), frame["tall"],
            frame.view, self._water_map, frame.tops, Ripples(frame["moments"], frame.tile),
            frame["environment"], frame["gloss"], settings, mirrors,
            optics_of(frame.conductor.methods, frame.uniforms["sun"]), frame["shown"],
        )  # fmt: skip

    def _compose(self, stream):
        frame, light = self._frame, self.drop_light
        compose[pixel_grid(frame.size, stream)](
            frame["dazzling"], frame["depth"], RainCover(*self.rain.alphas, frame.uniforms["fog"]),
            RainLight(light.drops, light.sheets, frame.uniforms["air"]), frame.view,
            frame.uniforms["brightness"], frame["image"],
        )  # fmt: skip
