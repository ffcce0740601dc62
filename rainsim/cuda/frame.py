"""Whole rainy frames on the GPU: twin of `rainsim.render`.

All that a frame is made of lies in one queue: splatting, grading and wetting, the water surface,
reflections, refraction, streaks, splashes, composition to 8 bit and the copy of the picture to the
host. It is recorded once and replayed; the host only brings what has changed and waits at the end.
What had too little room is then known: room is made and the frame is drawn again.
"""

from __future__ import annotations

import time as clock

import numpy as np

from rainsim import sky, waterview
from rainsim.cuda import optics, shading
from rainsim.cuda.apart import TakesApart
from rainsim.cuda.graph import Graph
from rainsim.cuda.jit import cuda, pinned
from rainsim.cuda.mirror import Mirrors
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.raster import DeviceSplats, Rasterizer
from rainsim.cuda.splash import ROOM, Splashes
from rainsim.cuda.streaks import Streaks
from rainsim.cuda.timing import part_times
from rainsim.cuda.watersurface import WaterSurface
from rainsim.errors import BackendError, ParameterError
from rainsim.moments import ripple_moments
from rainsim.paperwater import LEAST_WATER
from rainsim.render import FrameReport, _lens, _pose
from rainsim.render import Renderer as HostRenderer
from rainsim.splash import LONGEST_LIFE, WET_FILM
from rainsim.ssr import bounds_of
from rainsim.streaks import FOG_STEPS, NO_FOG, fog_table, streak_reach

STAGES = {  # names of the functions that queue them: those of the CPU where there is one
    "Numbers.send": "numbers", "Rasterizer.launch": "splat", "Renderer._grade": "grade and wet",
    "Streaks.launch": "streaks", "WaterSurface.launch": "water surface",
    "Renderer._meet_water": "find water", "Renderer._mirror": "mirror",
    "Renderer._lay_water": "water", "Splashes.launch": "splashes", "Renderer._compose": "compose",
    "Renderer._hand_over": "copy",
}  # fmt: skip
NO_MIRRORS_IN_FILMS = (
    "film: backend cuda mirrors what lies around the first camera in wet ground, as film "
    '"environment" does; backend cpu mirrors what stands on it'
)
MOST_TRIES = 8  # of a frame for which there was too little room


class Renderer(TakesApart, HostRenderer):
    """Draws frames of one scene, terrain and configuration on the GPU.

    Takes the states that the CPU's simulation yields, or those of `rainsim.cuda.simulate`, whose
    water never leaves the device.
    """

    def __init__(self, scene, terrain, config, first_camera):
        _require_known(config.render)
        self.stream = cuda.stream()
        super().__init__(scene, terrain, config, first_camera)
        if config.render.film == "auto":
            self.notes.append(NO_MIRRORS_IN_FILMS)
        send = self._send
        self._bed, self._exposed = send(terrain.bed), send(self.rings)
        self._ground, self._ground_sent = send(self.ground), self.ground
        self._place = send(self._origin), self._spacing
        self._around, self._gloss = send(self.environment), send(self.gloss)
        self._sky = send(self.day)
        self._directions = cuda.to_device(sky.directions(*self.environment.shape[:2]))
        self._drop = cuda.device_array(3, np.float32)
        self._sums = cuda.device_array((shading.SUMMERS, shading.SUMS), np.float64)
        self._air = sky.horizon_radiance(self.day).astype(np.float32)
        self._water = cuda.device_array(terrain.grid.shape, np.float32)
        self._surface = WaterSurface(
            terrain.bed, self.water.relief, terrain.mirrors, self._water, self.stream
        )
        self.mirrors = Mirrors(self, config.render.reflections)
        self._moments = None
        self._size = self._graphs = self._queue = None
        self._fog_of = None, None

    def _rasterizer_of(self, prepared):
        return Rasterizer(DeviceSplats(prepared), self.stream)

    @staticmethod
    def _send(array):
        return cuda.to_device(np.ascontiguousarray(array, dtype=np.float32))

    def draw(self, camera, state, camera_end=None, names=()):
        """Return the picture (height, width, 3) uint8 that `camera` (capture frame) takes.

        The picture is overwritten by the next call. `camera_end`, `names`: see `rainsim.render`.
        """
        begin = clock.perf_counter()
        self.update(camera, state, camera_end)
        self.run(getattr(state, "simulation", None))
        stages = {"frame": (clock.perf_counter() - begin) * 1e3}
        notes, self.notes = (*state.notes, *self.notes), []  # the renderer's are told once
        apart = self._take_apart(names, camera, state) if names else ()
        report = FrameReport(state.index, state.time, stages, state.ledger, notes, *apart)
        return self.image, report

    def run(self, simulation=None):
        """Draw what `update` has brought, again if there was too little room; wait for it.

        What does not need the water is drawn beside the `simulation` of its step.
        """
        for _ in range(MOST_TRIES):
            if self._graphs is None:
                self._record(simulation)
            dry, wet = self._graphs
            dry.launch()
            if simulation is not None:
                simulation.before(self.stream)
            wet.launch()
            if simulation is not None:
                simulation.after(self.stream)
            self.stream.synchronize()
            lacking = simulation is not None and simulation.lacked()
            lacking |= self.mirrors.grow() | self._splashes_lacked()
            if self.rasterizer.overflows():
                self.rasterizer.make_room()
                lacking = True
            if not lacking:
                break
            self._check_queue()
        if self.rasterizer.is_tight():
            self.rasterizer.make_room()
        self.mirrors.make_ahead()

    def _splashes_lacked(self):
        """Make room for splashes where the finished frame had too little; return whether it had."""
        if self.streaks is None:
            return False
        lines, *impacts = (int(found[0]) for found in self._found)
        for found, room in zip(impacts, self.splashes.rooms[1:], strict=True):
            if found > room:
                raise BackendError(
                    f"{found} drops that may splash were found for one frame, {room} were expected "
                    "at most; take backend cpu"
                )
        if lines <= len(self.splashes.lines):
            return False
        self._new_splashes(2 * lines)
        return True

    def _new_splashes(self, room):
        args = self._drops_of
        self.splashes = Splashes(self.streaks, args[0], self.surfaces, self._surface.depth, room)
        self.splashes.update(*args)
        self._graphs = None

    def _record(self, simulation):
        if simulation is not None:
            simulation.before(self.stream)
        self.launch()  # compiles, and allocates what only then is known
        self.stream.synchronize()
        halves = self.stages()
        self._graphs = [Graph(self.stream, _chain(half)) for half in halves]

    def _check_queue(self):
        """Record anew if what the queues depend on has changed."""
        queue = self.rasterizer.queue, self.mirrors.queue, id(self._moments)
        if queue != self._queue:
            self._queue, self._graphs = queue, None

    def update(self, camera, state, camera_end=None):
        """Take over what the next frame shows."""
        self._set_time(state.time)
        if self.ground is not self._ground_sent:
            self._ground.copy_to_device(np.ascontiguousarray(self.ground, np.float32))
            self._ground_sent = self.ground
        self.view = self.frame.camera_in_ground(camera)
        if self._size != (camera.height, camera.width):
            self._size = camera.height, camera.width
            self._room_for(camera, state)
        self.rasterizer.update(camera, self.near)
        self.mirrors.update(camera, self.near, self.frame)
        self._bring(state)
        turn, eye = _pose(self.view)
        fog = NO_FOG
        field = self.weather.field(state.time - LONGEST_LIFE, state.time + self.now.render.exposure)
        if self.streaks is not None:
            fog = self._update_drops(field, state, camera_end)
        self.numbers.update(
            turn=turn, eye=eye, lens=_lens(camera), look=self.look, others=self.others,
            brightness=self.now.render.brightness, fog=fog, sun=self._sun, air=self._air,
            forward=self.view.forward,
        )  # fmt: skip
        self._check_queue()

    def _update_drops(self, field, state, camera_end):
        """Say which drops are in the air; return the fog of those that are not drawn."""
        render = self.now.render
        reach = streak_reach(field, self.view, render.exposure, render.streak_far)
        self.streaks.update(
            field, self.view, state.time, render.exposure, reach, camera_end, *self._focus
        )
        self._drops_of = field, self.view, state.time, render.exposure, WET_FILM * self.wetness
        if self.splashes is None or self.splashes._depth is not self._surface.depth:
            self._new_splashes(ROOM)
        self.splashes.update(*self._drops_of)
        key = field, self.view.fx, self.view.fy, render.exposure, render.streak_far
        if key != self._fog_of[0]:
            self._fog_of = key, fog_table(field, reach)
        return self._fog_of[1]

    def _bring(self, state):
        """Bring the water and its ripples to the device, unless they are there."""
        moments = getattr(state, "moments", None)
        if moments is None:
            self._water.copy_to_device(np.ascontiguousarray(state.depth, np.float32))
            moments = ripple_moments(state.slopes)
            if self._moments is None:
                self._moments = cuda.to_device(moments)
            self._moments.copy_to_device(moments)
        elif self._moments is not moments:
            self._moments, self._surface.depth = moments, state.depth
        self._tile = np.float32(state.tile_size)

    def _room_for(self, camera, state):
        """Allocate what a picture of this size needs."""
        height, width = self._size
        f4 = np.float32
        self._graphs = None
        self.mirrors.room_for(height, width)
        self._picture, self._shown = (cuda.device_array((height, width, 3), f4) for _ in range(2))
        self._depth, self._clearance, self._tall, self._hit, self._distance = (
            cuda.device_array((height, width), f4) for _ in range(5)
        )
        self._coverage, self._none = (cuda.device_array((height, width), f4) for _ in range(2))
        self._bounds = cuda.device_array(bounds_of(height, width), f4)
        self._none.copy_to_device(np.zeros((height, width), f4))
        self._image = cuda.device_array((height, width, 3), np.uint8)
        self.image = pinned((height, width, 3), np.uint8)
        self.numbers = Numbers(self.stream, {
            "turn": ((3, 3), f4), "eye": ((3,), f4), "lens": ((4,), f4), "look": ((5,), f4),
            "others": ((5,), f4), "brightness": ((1,), f4), "fog": ((FOG_STEPS + 3,), f4),
            "sun": ((6,), f4), "air": ((3,), f4), "settings": ((3,), f4), "cover": ((2,), f4),
            "forward": ((3,), np.float64),
        })  # fmt: skip
        render = self.config.render
        hard = render.coverage == "hard"
        stride = max(1.0, self.water.stride * width)
        self.numbers.update(
            settings=(self.water.thickness, stride, waterview.REFLECTION_LENGTH),
            cover=(LEAST_WATER,) * 2 if hard else render.water_coverage,
        )  # fmt: skip
        self.streaks = self.splashes = None
        self._found = [pinned(1, np.int32) for _ in range(7)]  # see Splashes.counts
        field = self.weather.field(state.time - LONGEST_LIFE, state.time + render.exposure)
        if field is not None:
            self.streaks = Streaks(field, self.surfaces, width, height, self._depth, self.stream)

    # ---- the queue

    def launch(self):
        """Queue the frame; nothing here waits, allocates or reads results."""
        for half in self.stages():
            _chain(half)()

    def stages(self):
        """Return the frame's parts in their order: those that need no water, and the others.

        Each is a function that puts its part on the stream.
        """
        dry = [self.numbers.send, self.rasterizer.launch, self._grade]
        wet = [self._surface.launch, self._meet_water, self._mirror, self._lay_water]
        if self.streaks is not None:
            dry.append(self.streaks.launch)
            wet.append(self.splashes.launch)
        return dry, [*wet, self._compose, self._hand_over]

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
            self.rasterizer, self._size, n["turn"], n["eye"], self._picture, self._depth,
            self._clearance,
        )  # fmt: skip

    def grade(self, rasterizer, shape, turn, eye, picture, depth, clearance):
        """Queue the grading and wetting of what a rasterizer has drawn, a picture of `shape`."""
        layers, n = rasterizer.layers, self.numbers
        shading.grade_and_wet[shading.blocks(*shape), shading.BLOCK, self.stream](
            rasterizer.size, layers.color.reshape(*shape, 3), layers.alpha.reshape(shape),
            layers.depth.reshape(shape), layers.plane_depth.reshape(shape),
            layers.normal.reshape(*shape, 3), np.float32(self.frame.meters_per_unit),
            turn, eye, rasterizer.lens, self._bed, self._ground, *self._place, self._gloss,
            self._sky, n["look"], n["others"], picture, depth, clearance,
        )  # fmt: skip

    def _meet_water(self):
        n, render = self.numbers, self.config.render
        grid = shading.blocks(*self._size), shading.BLOCK, self.stream
        surface = self._surface
        optics.keep_tall[grid](self._depth, self._clearance, self._tall, self._bounds)
        optics.meet_water[grid](
            self._depth, n["turn"], n["eye"], n["lens"], surface.surface, surface.over,
            *self._place, surface.highest, n["cover"], render.coverage == "hard",
            self._hit, self._coverage,
        )  # fmt: skip

    def _mirror(self):
        self.mirrors.launch(self._hit, self._coverage)

    def _lay_water(self):
        n = self.numbers
        grid = shading.blocks(*self._size), shading.BLOCK, self.stream
        optics.find_hits[grid](
            self._hit, self._coverage, self._tall, self._bounds, n["turn"], n["eye"], n["lens"],
            n["settings"], self.mirrors.range, self._distance,
        )  # fmt: skip
        optics.shade_water[grid](
            self._hit, self._coverage, self._distance, self._picture, self._depth, self._tall,
            n["turn"], n["eye"], n["lens"], self._surface.over, self._exposed,
            *self._place, self._moments, self._tile, self._around, n["settings"],
            self.mirrors.range, self.mirrors.window, self.mirrors.picture, self.mirrors.coarse,
            self.mirrors.depth,
            *self.water.laws(), n["sun"], self._shown,
        )  # fmt: skip

    def _compose(self):
        n = self.numbers
        grid = shading.blocks(*self._size), shading.BLOCK, self.stream
        shading.sum_environment[shading.SUMMERS, shading.SUM_THREADS, self.stream](
            self._directions, self._around, n["forward"], self._sums
        )
        shading.drop_radiance[1, 32, self.stream](self._sums, self._drop)
        rain = splash = self._none
        if self.streaks is not None:
            rain, splash = self.streaks.alpha, self.splashes.alpha
        shading.compose[grid](
            self._shown, self._depth, rain, splash, self._drop, n["air"], n["fog"], n["lens"],
            n["brightness"], self._image,
        )  # fmt: skip

    def _hand_over(self):
        self._image.copy_to_host(self.image, stream=self.stream)
        if self.streaks is not None:
            for there, here in zip(self.splashes.counts, self._found, strict=True):
                there.copy_to_host(here, stream=self.stream)


def _chain(parts):
    """Return a function that calls all of `parts`."""

    def queue():
        for part in parts:
            part()

    return queue


def _require_known(render):
    """Raise ParameterError for looks that only the CPU draws."""
    for name, wanted in (
        ("reflections", ("auto", "mirror", "ssr")), ("water_geometry", ("height-field",)),
        ("streaks", ("shutter",)), ("splashes", ("crowns",)), ("film", ("auto", "environment")),
    ):  # fmt: skip
        value = getattr(render, name)
        if value not in wanted:
            raise ParameterError(
                f"{name} is {value!r}; backend cuda draws {' or '.join(wanted)}; take backend cpu"
            )
