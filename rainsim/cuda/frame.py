"""Whole rainy frames on the GPU: twin of `rainsim.render`.

All that a frame is made of lies in one queue: splatting, grading and wetting, the water surface,
reflections, refraction, streaks, splashes, composition to 8 bit and the copy of the picture to the
host. It is recorded once and replayed; the host only brings what has changed and waits at the end.
What had too little room is then known: room is made and the frame is drawn again. Streaks and
splashes are drawn beside the water, and the water's surface is found beside the splatting. In a
film the host makes ready the next frame while the device draws.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim import droplight, sky, waterview
from rainsim.cuda import optics, shading
from rainsim.cuda.apart import TakesApart
from rainsim.cuda.drips import DripList
from rainsim.cuda.film import Film
from rainsim.cuda.jit import cuda, pinned
from rainsim.cuda.mirror import Mirrors
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.raster import DeviceSplats, Rasterizer
from rainsim.cuda.recent import RecentImpacts
from rainsim.cuda.sequence import InTurn, chain, simulation_of
from rainsim.cuda.splash import Splashes
from rainsim.cuda.streaks import Streaks
from rainsim.cuda.timing import part_times
from rainsim.cuda.watersurface import WaterSurface
from rainsim.errors import ParameterError
from rainsim.moments import ripple_moments
from rainsim.paperwater import LEAST_WATER
from rainsim.render import Renderer as HostRenderer
from rainsim.render import lens_of, pose
from rainsim.splash import LONGEST_LIFE, WET_FILM
from rainsim.ssr import bounds_of
from rainsim.streaks import FOG_STEPS, NO_FOG, fog_table, streak_reach

STAGES = {  # names of the functions that queue them: those of the CPU where there is one
    "Numbers.send": "numbers", "Rasterizer.launch": "splat", "Renderer._grade": "grade and wet",
    "Renderer._film": "film", "Streaks.launch": "streaks",
    "WaterSurface.launch": "water surface", "Renderer._keep_tall": "find tall",
    "Renderer._meet_water": "find water", "Renderer._mirror": "mirror",
    "Renderer._lay_water": "water", "Splashes.launch": "splashes", "Renderer._compose": "compose",
    "Renderer._hand_over": "counts", "Renderer._copy_picture": "copy",
}  # fmt: skip


class Renderer(InTurn, TakesApart, HostRenderer):
    """Draws frames of one scene, terrain and configuration on the GPU.

    Takes the states that the CPU's simulation yields, or those of `rainsim.cuda.simulate`, whose
    water never leaves the device.
    """

    def __init__(self, scene, terrain, config, first_camera):
        _require_known(config.render)
        self.stream, *self._beside = (cuda.stream() for _ in range(3))
        self._forked, self._joined, self._found_tall = (cuda.event() for _ in range(3))
        self._begin_turns()
        super().__init__(scene, terrain, config, first_camera)
        send = self._send
        self._bed, self._exposed = send(terrain.bed), send(self.rings)
        self._ground, self._ground_sent = send(self.ground), self.ground
        self.place = send(self._origin), self._spacing
        self._around, self.blurred = send(self.environment), send(self.gloss)
        self._sky, self._sky_sent = send(self.behind), self.behind
        self._air = sky.horizon_radiance(self.day).astype(np.float32)
        self._water = cuda.device_array(terrain.grid.shape, np.float32)
        self._surface = WaterSurface(
            terrain.bed, self.water.relief, terrain.mirrors, self._water, self.stream
        )
        self.water.layered = False  # layers show what was drawn: one picture for each mirror
        self.mirrors = Mirrors(self, config.render.reflections)
        self.film_light = Film(self)
        self._moments = None
        self._size = None
        self._fog_of = None, None
        self._own_impacts = self._own_drips = None

    def _rasterizer_of(self, prepared):
        return Rasterizer(DeviceSplats(prepared), self.stream)

    @staticmethod
    def _send(array):
        return cuda.to_device(np.ascontiguousarray(array, dtype=np.float32))

    def draw(self, camera, state, camera_end=None, names=()):
        """Return the picture (height, width, 3) uint8 that `camera` (capture frame) takes.

        The picture is overwritten by the next call. `camera_end`, `names`: see `rainsim.render`.
        """
        self.update(camera, state, camera_end)
        self.run()
        return self._report(names)

    def _splashes_lacked(self):
        """Make room for splashes where the finished frame had too little; return whether it had."""
        if self.streaks is None:
            return False
        if self._own_impacts is not None:
            self._own_impacts.check()
        lines = int(self._lines[0])
        if lines <= len(self.splashes.lines):
            return False
        self.splashes.make_room(2 * lines)
        return True

    def update(self, camera, state, camera_end=None):
        """Take over what the next frame shows; the device may still be drawing the one before."""
        self._next, self._to_bring = (camera, state, camera_end), []
        self._looks += self._set_time(state.time)
        self._seen = camera, self._looks
        if self.ground is not self._ground_sent:
            self._to_bring.append(self._bring_ground)
        if self.behind is not self._sky_sent:
            self._to_bring.append(self._bring_sky)
        self.view = self.frame.camera_in_ground(camera)
        if self._size != (camera.height, camera.width):
            self._size = camera.height, camera.width
            self._room_for(camera, state)
        self.rasterizer.update(camera, self.near)
        self.mirrors.update(camera, self.near, self.frame)
        self.film_light.update(camera, self.view)
        self._bring(state)
        turn, eye = pose(self.view)
        fog = NO_FOG
        field = self.weather.field(state.time - LONGEST_LIFE, state.time + self.now.render.exposure)
        if self.streaks is not None:
            fog = self._update_drops(field, state, camera_end)
        self.numbers.update(
            turn=turn, eye=eye, lens=lens_of(camera), look=self.look, others=self.others,
            brightness=self.now.render.brightness, fog=fog, sun=self._sun, air=self._air,
            drop=self._drop_field(turn, lens_of(camera), camera), around=self.everywhere,
        )  # fmt: skip

    def _bring_ground(self):
        self._ground.copy_to_device(np.ascontiguousarray(self.ground, np.float32))
        self._ground_sent = self.ground

    def _bring_sky(self):
        self._sky.copy_to_device(self.behind)
        self._sky_sent = self.behind

    def _update_drops(self, field, state, camera_end):
        """Say which drops are in the air; return the fog of those that are not drawn."""
        render = self.now.render
        reach = streak_reach(field, self.view, render.exposure, render.streak_far)
        self.streaks.update(
            field, self.view, state.time, render.exposure, reach, camera_end, *self._focus
        )
        simulation = simulation_of(state)
        if simulation is None and self._own_impacts is None:
            # These states' times may lie within an interval: two more are to come.
            self._own_impacts = RecentImpacts(
                self.weather, self.surfaces, self.config.fps, 2, self.stream
            )
        if self._own_impacts is not None:
            self._own_impacts.update(math.floor(state.time * self.config.fps + 1e-6))
        if self.splashes is None:
            recent = self._own_impacts if simulation is None else simulation.impacts
            self.splashes = Splashes(self.streaks, recent, self._surface.depth)
        self.splashes.update(field, WET_FILM * self.wetness)
        key = field, self.view.fx, self.view.fy, render.exposure, render.streak_far
        if key != self._fog_of[0]:
            self._fog_of = key, fog_table(field, reach)
        return self._fog_of[1]

    def _bring(self, state):
        """Bring the water and its ripples to the device, unless they are there."""
        self._tile = np.float32(state.tile_size)
        if simulation_of(state) is not None:
            return
        moments = ripple_moments(state.slopes)
        if self._moments is None:
            self._moments = cuda.to_device(moments)
        room = 0 if self._own_drips is None else self._own_drips.room
        if self.streaks is not None and len(state.drip_id) > room:
            self._own_drips = DripList(2 * len(state.drip_id))

        def bring():
            self._water.copy_to_device(np.ascontiguousarray(state.depth, np.float32))
            self._moments.copy_to_device(moments)
            if self._own_drips is not None:
                self._own_drips.fill(state.drips, state.drip_id)
                self.streaks.drips = self._own_drips

        self._to_bring.append(bring)

    def _room_for(self, camera, state):
        """Allocate what a picture of this size needs."""
        height, width = self._size
        f4 = np.float32
        self.mirrors.room_for(height, width)
        self._cover = self.film_light.room_for(height, width)
        self._picture, self._shown = (cuda.device_array((height, width, 3), f4) for _ in range(2))
        self._depth, self._clearance, self._tall, self._hit, self._distance = (
            cuda.device_array((height, width), f4) for _ in range(5)
        )
        self._coverage, self._none = (cuda.device_array((height, width), f4) for _ in range(2))
        self._bounds = cuda.device_array(bounds_of(height, width), f4)
        self._none.copy_to_device(np.zeros((height, width), f4))
        self._below = self.film_light.bare if self.film_light.apart else self._picture
        self._image = cuda.device_array((height, width, 3), np.uint8)
        self._images = [pinned((height, width, 3), np.uint8) for _ in range(2)]
        self.numbers = Numbers(self.stream, {
            "turn": ((3, 3), f4), "eye": ((3,), f4), "lens": ((4,), f4), "look": ((6,), f4),
            "others": ((5,), f4), "brightness": ((1,), f4), "fog": ((FOG_STEPS + 3,), f4),
            "sun": ((6,), f4), "air": ((3,), f4), "settings": ((3,), f4), "cover": ((2,), f4),
            "drop": ((*droplight.GRID, 3), f4), "around": ((3,), f4),
        })  # fmt: skip
        render = self.config.render
        hard = render.coverage == "hard"
        stride = max(1.0, self.water.stride * width)
        self.numbers.update(
            settings=(self.water.thickness, stride, waterview.REFLECTION_LENGTH),
            cover=(LEAST_WATER,) * 2 if hard else render.water_coverage,
        )  # fmt: skip
        self.streaks = self.splashes = None
        self._lines = pinned(1, np.int32)
        field = self.weather.field(state.time - LONGEST_LIFE, state.time + render.exposure)
        if field is not None:
            self.streaks = Streaks(field, self.surfaces, width, height, self._depth, self.stream)

    # ---- the queue

    def stages(self):
        """Return the frame's parts in their order: those that need no water, and the others.

        Each is a function that puts its part on the stream.
        """
        dry, wet, last = self._parts()
        dry = [part for part in dry if part not in (self.film_light.draw, self._lay_film)]
        if self.film_light.apart:
            dry.append(self._film)
        rain = []
        if self.streaks is not None:
            rain = [self.streaks.launch, self.splashes.launch]
            if self._own_impacts is not None:
                rain.insert(0, self._own_impacts.launch)
        return dry, [*rain, self._surface.launch, *wet, *last, self._copy_picture]

    def _parts(self):
        """Return the frame's parts but rain: without water, with it, and what needs both."""
        film = self.film_light
        return (
            [self.numbers.send, film.draw, self.rasterizer.launch, self._grade, self._lay_film],
            [self._keep_tall, self._meet_water, self._mirror, self._lay_water],
            [self._compose, self._hand_over],
        )

    def _queue_wet(self):
        """Queue what needs the water; streaks and what splashes beside it."""
        _, (tall, meet, *wet), last = self._parts()
        beside, aside = self._beside
        self._forked.record(self.stream)
        self._forked.wait(beside)
        self._forked.wait(aside)
        tall(aside)
        self._found_tall.record(aside)
        if self.streaks is not None:
            self.streaks.launch(beside)
            self.streaks.sent.wait(aside)
            if self._own_impacts is not None:
                self._own_impacts.launch(aside)
            self.splashes.gather(aside)
            self._joined.record(aside)
            self._joined.wait(beside)
            self.splashes.draw(beside)
        self._joined.record(beside)
        meet()
        self._found_tall.wait(self.stream)
        chain(wet)()
        self._joined.wait(self.stream)
        chain(last)()

    def stage_times(self):
        """Return the milliseconds of each stage of the frame drawn last, by events; draws it again.

        The stages follow one another here; what lies beside another stage in use is not told.
        """
        dry, wet = self.stages()
        named = {STAGES.get(part.__qualname__, part.__qualname__): part for part in [*dry, *wet]}
        return part_times(self.stream, named)

    def _grade(self):
        n = self.numbers
        self.grade(
            self.rasterizer, self._size, n["turn"], n["eye"], self._below, self._depth,
            self._clearance, self._cover, self.stream,
        )  # fmt: skip

    def grade(self, rasterizer, shape, turn, eye, picture, depth, clearance, film, stream):
        """Queue the grading and wetting of what a rasterizer has drawn, a picture of `shape`."""
        layers, n = rasterizer.layers, self.numbers
        shading.grade_and_wet[shading.blocks(*shape), shading.BLOCK, stream](
            rasterizer.size, layers.color.reshape(*shape, 3), layers.alpha.reshape(shape),
            layers.depth.reshape(shape), layers.plane_depth.reshape(shape),
            layers.normal.reshape(*shape, 3), np.float32(self.frame.meters_per_unit),
            turn, eye, rasterizer.lens, self._bed, self._ground, *self.place, self.blurred,
            self._sky, n["look"], n["others"], picture, depth, clearance, film,
        )  # fmt: skip

    def _film(self):
        """Queue all of the film, after what it lies beside in use."""
        self.film_light.draw()
        self._lay_film()

    def _lay_film(self):
        if self.film_light.apart:
            self.film_light.lay(self._picture)

    def _keep_tall(self, stream=None):
        stream, joiners = self.stream if stream is None else stream, optics.JOINERS
        optics.keep_tall[shading.blocks(*self._size), shading.BLOCK, stream](
            self._depth, self._clearance, self._tall, self._bounds
        )
        optics.join_bounds[-(-len(self._bounds) // joiners), joiners, stream](
            *self._size, self._bounds
        )

    def _meet_water(self):
        n, render = self.numbers, self.config.render
        grid = shading.blocks(*self._size), shading.BLOCK, self.stream
        surface = self._surface
        optics.meet_water[grid](
            self._depth, n["turn"], n["eye"], n["lens"], surface.surface, surface.over,
            *self.place, surface.highest, n["cover"], render.coverage == "hard",
            self._hit, self._coverage,
        )  # fmt: skip

    def _mirror(self):
        self.mirrors.launch(self._hit, self._coverage)

    def _lay_water(self):
        n = self.numbers
        grid = shading.blocks(*self._size), shading.BLOCK, self.stream
        (height, width), (wide, high) = self._size, optics.PATCH
        patches = (-(-width // wide), -(-height // high)), optics.PATCH, self.stream
        optics.find_hits[patches](
            self._hit, self._coverage, self._tall, self._bounds, n["turn"], n["eye"], n["lens"],
            n["settings"], self.mirrors.range, self._distance,
        )  # fmt: skip
        optics.shade_water[grid](
            self._hit, self._coverage, self._distance, self._picture, self._below, self._depth,
            self._tall, n["turn"], n["eye"], n["lens"], self._surface.over, self._exposed,
            *self.place, self._moments, self._tile, self._around, n["settings"],
            self.mirrors.range, self.mirrors.window, self.mirrors.picture, self.mirrors.coarse,
            self.mirrors.depth,
            *self.water.laws(), n["sun"], self._shown,
        )  # fmt: skip

    def _compose(self):
        n = self.numbers
        grid = shading.blocks(*self._size), shading.BLOCK, self.stream
        rain = splash = self._none
        if self.streaks is not None:
            rain, splash = self.streaks.alpha, self.splashes.alpha
        shading.compose[grid](
            self._shown, self._depth, rain, splash, n["drop"], n["around"], n["air"], n["fog"],
            n["lens"], n["brightness"], self._image,
        )  # fmt: skip

    def _copy_picture(self, stream=None):
        stream = self.stream if stream is None else stream
        self._image.copy_to_host(self.image, stream=stream)

    def _hand_over(self):
        if self.streaks is not None:
            self.splashes.count.copy_to_host(self._lines, stream=self.stream)


def _require_known(render):
    """Raise ParameterError for looks that only the CPU draws."""
    for name, wanted in (
        ("reflections", ("auto", "mirror", "ssr")), ("water_geometry", ("height-field",)),
        ("streaks", ("shutter",)), ("splashes", ("crowns",)),
    ):  # fmt: skip
        value = getattr(render, name)
        if value not in wanted:
            raise ParameterError(
                f"{name} is {value!r}; backend cuda draws {' or '.join(wanted)}; take backend cpu"
            )
