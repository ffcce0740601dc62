"""A frame on the device: its buffers and the kernel launches that fill them.

A frame has parts: what needs no water (splatting, grading and wetting, the wet-ground mirror), the
water's surface, what needs the water (mirrors, reflection and refraction), rain, and composition to
8 bit. `DeviceFrame` queues each; `FrameQueue` decides when.
"""

from __future__ import annotations

import numpy as np

from rainsim.cuda.driver import Event, copy_to_host
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.graph import chain, new_version
from rainsim.cuda.jit import cuda
from rainsim.cuda.particles.drop_radiance import DropLight
from rainsim.cuda.reflection import ray_water, screen_space, water_shading, wet_tops
from rainsim.cuda.reflection.planar_mirror import Mirrors
from rainsim.cuda.reflection.water_surface import WaterSurface
from rainsim.cuda.render.actor_splats import MovingActors
from rainsim.cuda.render.rain_pass import RainPass
from rainsim.cuda.shading import wet_pass
from rainsim.cuda.shading.composite import compose
from rainsim.cuda.shading.wet_ground_mirror import WetGroundLight
from rainsim.particles.fog import FOG_STEPS
from rainsim.reflection import water_pass
from rainsim.reflection.mirror_choice import mirror_step
from rainsim.reflection.ray_water import COVERING_DEPTHS
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.reflection.water_shading import Background, Ripples
from rainsim.reflection.water_surface import WaterMap
from rainsim.reflection.wet_tops import top_numbers
from rainsim.scene.view import CameraArrays, view_of
from rainsim.shading.composite import RainCover, RainLight
from rainsim.shading.grading import Look
from rainsim.shading.smooth_normals import AROUND, NO_AROUND
from rainsim.shading.wet_pass import DryPicture
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import GroundMaps, SkyMaps
from rainsim.ssr import bounds_of
from rainsim.water.top_water import sheet_depth


class DeviceFrame:
    """Buffers and launches of one frame after another.

    Parameters
    ----------
    host : rainsim.render.renderer.Renderer
        Its scene, water and light; its rasterizer draws on the device.
    stream : numba.cuda.stream
        That the frame's main queue lies on.

    Attributes
    ----------
    rasterizer : rainsim.cuda.raster.Rasterizer
        Of the capture.
    uniforms : FrameUniforms
        Numbers that change from frame to frame.
    mirrors : Mirrors
    ground_light : WetGroundLight
    drop_light : DropLight
    rain : RainPass
    surface : WaterSurface
    actors : MovingActors or None
        None in scenes without actors.
    pending : list of callable
        Copies to the device that the next frame needs before its queue starts.
    size : tuple of int or None
        Height and width [px].
    """

    def __init__(self, host, stream):
        self.host, self.stream = host, stream
        self.wet_scene, self.terrain = host.wet_scene, host.terrain
        self.rasterizer, self.wet_ground = self.wet_scene.rasterizer, host.wet_ground
        self.ahead = self.rasterizer.stream
        self._beside = [cuda.stream() for _ in range(2)]
        self._forked, self._joined, self._found_tall = (Event() for _ in range(3))
        grid, scene = self.terrain.grid, self.wet_scene
        self.place = to_device(np.array(grid.origin, np.float32)), np.float32(grid.spacing)
        self._bed, self._rings = to_device(self.terrain.bed), to_device(host.rings)
        self._ground, self._ground_sent = to_device(scene.ground), scene.ground
        bodies = scene.bodies.now.size or self.terrain.footprints
        self._bodies = cuda.device_array((*grid.shape, 3) if bodies else (1, 1, 3), np.uint8)
        self._send_bodies()
        tops = host.water.tops
        self._tops = tops._replace(
            number=cuda.to_device(tops.number), form=to_device(tops.form),
            depths=to_device(tops.depths), holds=to_device(tops.holds),
            origin=to_device(tops.origin),
        )  # fmt: skip
        self._around, self.gloss = to_device(scene.environment), to_device(scene.gloss)
        self._coat = to_device(scene.coat)
        self._behind, self._behind_sent = to_device(scene.behind), scene.behind
        self._behind_mirrored = to_device(scene.behind_mirrored)
        self._colors_sent, self.rasterizer.recolors = scene.drawn, False
        self._water = cuda.device_array(grid.shape, np.float32)
        self.surface = WaterSurface(
            self.terrain.bed, host.water.relief, self.terrain.mirrors, self._water,
            host.water.block_reach, stream,
        )  # fmt: skip
        self.mirrors = Mirrors(self, host.config.render.reflections)
        self.ground_light = WetGroundLight(self)
        self.drop_light = DropLight(self)
        self.size = self.uniforms = self._moments = self._version = None
        self.pending, self.rain = [], RainPass(self)
        self.actors = None if scene.actors is None else MovingActors(self)

    # ---- what a frame shows

    def update(self, camera, state, camera_end=None):
        """Take over camera, state and look of the next frame; return whether the look has changed.

        The device may still be drawing the frame before: only `pending` writes to its buffers.
        """
        host, scene, self.pending = self.host, self.wet_scene, []
        changed = host.set_time(state.time)
        if self.actors is not None:
            changed |= self.actors.update(state)
        if scene.ground is not self._ground_sent:
            self.pending.append(self._send_ground)
        if scene.bodies.now is not self._bodies_sent:
            self.pending.append(self._send_bodies)
        if scene.behind is not self._behind_sent:
            self.pending.append(self._send_sky)
        if scene.drawn is not self._colors_sent:
            self.pending.append(self._send_colors)
        host.take_camera(camera)
        host.view_end = camera_end
        render = host.now.render
        field = host.rain.field(state.time, render.exposure)
        if self.size != (camera.height, camera.width):
            self.size = camera.height, camera.width
            self._allocate(field)
        self.rasterizer.update(camera, scene.near, detail=scene.merge)
        view = view_of(host.view)
        step = mirror_step(render.mirror_size, host.shower, view.lens)
        self.mirrors.update(camera, scene, step)
        self.ground_light.update(camera, host.view)
        self._take_state(state)
        fog = self.rain.update(field, state, camera_end, simulation_of(state))
        self.uniforms.update(
            turn=view.ground_from_camera, eye=view.eye, lens=view.lens, look=scene.look,
            off_ground=scene.off_ground, brightness=host.brightness, fog=fog, sun=host.sunlight,
            air=host.air_light, around=host.everywhere,
        )  # fmt: skip
        return changed

    def send_rings(self, rings):
        """Send the amplitudes of rings (ny, nx); the device must draw nothing meanwhile."""
        self._rings.copy_to_device(np.ascontiguousarray(rings, np.float32))

    def _send_ground(self):
        self._ground.copy_to_device(np.ascontiguousarray(self.wet_scene.ground, np.float32))
        self._ground_sent = self.wet_scene.ground

    def _send_bodies(self):
        bodies = self.wet_scene.bodies.now
        self._bodies.copy_to_device(
            bodies if bodies.size else np.zeros(self._bodies.shape, np.uint8)
        )
        self._bodies_sent = bodies

    def _send_sky(self):
        self._behind.copy_to_device(self.wet_scene.behind)
        self._behind_mirrored.copy_to_device(self.wet_scene.behind_mirrored)
        self._behind_sent = self.wet_scene.behind

    def _send_colors(self):
        self.rasterizer.splats.send_colors(self.wet_scene.drawn)
        self.ground_light.send_colors()
        self._colors_sent = self.wet_scene.drawn

    def _take_state(self, state):
        """List the copies of the water and its ripples to the device, unless they are there."""
        self._tile = np.float32(state.tile_size)
        tops = self.host.water.top_water
        if len(tops.tops):
            sheet = sheet_depth(self.host.now.rain.rate)
            self.uniforms.update(tops=top_numbers(tops, state.top_water, sheet))
        if simulation_of(state) is not None:
            return
        moments = ripple_moments(state.slopes)
        if self._moments is None:
            self._moments = cuda.to_device(moments)

        def send():
            self._water.copy_to_device(np.ascontiguousarray(state.depth, np.float32))
            self._moments.copy_to_device(moments)
            self.rain.send_drips(state)

        self.pending.append(send)

    def leave_water(self):
        """Let go of the water of the frames so far; the next shows that of another simulation."""
        self._moments, self.surface.depth = None, self._water
        self.rain.leave_water()

    def take_water(self, state):
        """Take over the water that a simulation on the device has for a frame."""
        self._moments, self.surface.depth = state.moments, state.depth
        self.rain.take_water(state)

    def _allocate(self, field):
        """Allocate the buffers of a picture of the present size; `field` is None without rain."""
        height, width = self.size
        f4, host = np.float32, self.host
        self.mirrors.room_for(height, width)
        self._cover = self.ground_light.room_for(height, width)
        self.picture, self._shown = (cuda.device_array((height, width, 3), f4) for _ in range(2))
        self.depth, self.clearance, self._tall, self._hit, self._distance = (
            cuda.device_array((height, width), f4) for _ in range(5)
        )
        self._coverage, self._none = (cuda.device_array((height, width), f4) for _ in range(2))
        self._bounds = cuda.device_array(bounds_of(height, width), f4)
        self._none.copy_to_device(np.zeros((height, width), f4))
        self.below = self.ground_light.bare if self.ground_light.apart else self.picture
        self._image = cuda.device_array((height, width, 3), np.uint8)
        self.uniforms = FrameUniforms(self.stream, {
            "turn": ((3, 3), f4), "eye": ((3,), f4), "lens": ((4,), f4),
            "look": ((len(Look._fields),), f4),
            "off_ground": ((len(OffGroundWetness._fields),), f4),
            "brightness": ((1,), f4), "fog": ((FOG_STEPS + 3,), f4),
            "sun": ((6,), f4), "air": ((3,), f4), "settings": ((3,), f4), "cover": ((2,), f4),
            "around": ((3,), f4), "size": ((2,), f4),
            "tops": ((max(len(self._tops.form), 1), 2), f4),
        })  # fmt: skip
        stride = max(1.0, host.water.stride * width)
        self.uniforms.update(
            settings=(host.water.thickness, stride, water_pass.REFLECTION_LENGTH),
            cover=COVERING_DEPTHS, size=(width, height),
        )  # fmt: skip
        self.rain.room_for(field, height, width, self.depth, self._none)
        self._version = new_version()

    # ---- what a finished frame had too little room for

    def dry_rasterizers(self):
        """Return the rasterizers of the pictures that need no water."""
        return [self.rasterizer, *self.ground_light.rasterizers]

    def dry_is_amiss(self):
        """Return whether the finished frame's rasterizers had too little room or far too much."""
        return any([  # a list: each of them counts its picture
            splats.count_picture() or splats.overflows() or splats.is_tight()
            for splats in self.dry_rasterizers()
        ])  # fmt: skip

    def grow(self):
        """Make room where the finished frame's water and rain lacked it; return whether any did."""
        return any([self.mirrors.grow(), self.rain.grow()])  # both

    def grow_dry(self):
        """Make room in the dry rasterizers that lacked it; return whether any did."""
        full = [splats for splats in self.dry_rasterizers() if splats.overflows()]
        return bool([splats.make_room() for splats in full])

    def dependencies(self):
        """Return the values a recorded queue depends on: when they change, it is recorded again."""
        return (
            self._version, self.rasterizer.queue, self.ground_light.queue, self.mirrors.queue,
            *self.rain.dependencies(),
        )  # fmt: skip

    # ---- parts

    def splat(self):
        """Queue the splatting of the picture and of the level picture, on the stream `ahead`."""
        self.ground_light.splat(self.ahead)
        self.rasterizer.launch()
        self.ground_light.join(self.ahead)

    def graded_parts(self):
        """Return the parts that need splatted pictures and no water, each a function."""
        return [self.uniforms.send, self.ground_light.draw, self._grade, self._add_ground_light]

    def wet_parts(self):
        """Return the parts that need the water, each a function that queues it."""
        return [self._keep_tall, self.drop_light.launch, self._meet_water, self._mirror,
                self._lay_water]  # fmt: skip

    def last_parts(self):
        """Return the parts that need water and rain, each a function that queues it."""
        return [self._compose, self.rain.count_lines]

    def stages(self):
        """Return the parts that need no water, and all others, for timing one after the other."""
        dry = [self.uniforms.send, self._splat, self._grade]
        if self.ground_light.apart:
            dry.append(self._ground_light)
        wet = [*self.rain.parts(), self.surface.launch, *self.wet_parts(), *self.last_parts()]
        return dry, wet

    def queue_wet(self):
        """Queue the launches that need the water; streaks and splashes on streams beside it."""
        tall, light, meet, *wet = self.wet_parts()
        beside, aside = self._beside
        self._forked.record(self.stream)
        self._forked.wait(beside)
        self._forked.wait(aside)
        tall(aside)
        self._found_tall.record(aside)
        light(aside)
        self.rain.queue(beside, aside, self._joined)
        self._joined.record(beside)
        meet()
        self._found_tall.wait(self.stream)
        chain(wet)()
        self._joined.wait(self.stream)
        chain(self.last_parts())()

    def grade(
        self, rasterizer, shape, turn, eye, picture, depth, clearance, cover, stream, mirrored=True
    ):
        """Queue the grading and wetting of a rasterizer's layers, a picture of `shape`."""
        layers, n = rasterizer.layers, self.uniforms
        behind = self._behind_mirrored if mirrored else self._behind
        dry = DryPicture(
            layers.color.reshape(*shape, 3), layers.alpha.reshape(shape),
            layers.depth.reshape(shape), layers.plane_depth.reshape(shape),
            layers.normal.reshape(*shape, 3), np.float32(self.wet_scene.frame.meters_per_unit),
            NO_AROUND if mirrored else AROUND,
        )  # fmt: skip
        ground = GroundMaps(self._bed, self._ground, *self.place, self._bodies)
        wet_pass.grade_and_wet[wet_pass.blocks(*shape), wet_pass.BLOCK, stream](
            rasterizer.size, dry, CameraArrays(turn, eye, rasterizer.lens), ground,
            n["off_ground"], SkyMaps(self.gloss, self._coat, behind), n["look"], picture, depth,
            clearance, cover,
        )  # fmt: skip

    def _grid(self, stream=None):
        """Return the launch configuration of a thread for each pixel."""
        stream = self.stream if stream is None else stream
        return wet_pass.blocks(*self.size), wet_pass.BLOCK, stream

    def _grade(self):
        n = self.uniforms
        self.grade(
            self.rasterizer, self.size, n["turn"], n["eye"], self.below, self.depth,
            self.clearance, self._cover, self.stream, mirrored=False,
        )  # fmt: skip

    def _splat(self):
        """Queue the splatting in line with the frame's stream."""
        self._forked.record(self.stream)
        self._forked.wait(self.ahead)
        self.splat()
        self._joined.record(self.ahead)
        self._joined.wait(self.stream)

    def _ground_light(self):
        """Queue the wet-ground mirror, which in use lies beside other parts."""
        self.ground_light.draw()
        self._add_ground_light()

    def _add_ground_light(self):
        if self.ground_light.apart:
            self.ground_light.add(self.picture)

    def _keep_tall(self, stream=None):
        joiners = screen_space.JOINERS
        screen_space.keep_tall[self._grid(stream)](
            self.depth, self.clearance, self._tall, self._bounds
        )
        stream = self.stream if stream is None else stream
        screen_space.join_bounds[-(-len(self._bounds) // joiners), joiners, stream](
            *self.size, self._bounds
        )

    def _meet_water(self):
        ray_water.meet_water[self._grid()](
            self.depth, self.camera_arrays, self._water_map, self.surface.highest,
            self.uniforms["cover"], self._hit, self._coverage,
        )  # fmt: skip
        if len(self._tops.form):
            wet_tops.meet_tops[self._grid()](
                self.depth, self.camera_arrays, self.tops, self.uniforms["off_ground"], self._hit,
                self._coverage,
            )  # fmt: skip

    @property
    def camera_arrays(self):
        """The camera as kernels take it."""
        n = self.uniforms
        return CameraArrays(n["turn"], n["eye"], n["lens"])

    @property
    def _water_map(self):
        drawn = self.surface
        return WaterMap(drawn.surface, drawn.over, self._rings, *self.place, drawn.shores)

    @property
    def tops(self):
        """The tops as kernels take them, `TopMaps`."""
        return self._tops._replace(water=self.uniforms["tops"])

    def _mirror(self):
        self.mirrors.launch(self._hit, self._coverage)

    def _lay_water(self):
        n, mirrors = self.uniforms, self.mirrors
        (height, width), (wide, high) = self.size, screen_space.PATCH
        patches = (-(-width // wide), -(-height // high)), screen_space.PATCH, self.stream
        screen_space.find_hits[patches](
            self._hit, self._coverage, self._tall, self._bounds, self.camera_arrays,
            n["settings"], mirrors.range, self._distance,
        )  # fmt: skip
        water_shading.shade_water[self._grid()](
            self._hit, self._coverage, self._distance,
            Background(self.picture, self.below, self.depth), self._tall, self.camera_arrays,
            self._water_map, self.tops, Ripples(self._moments, self._tile), self._around,
            self.gloss, n["settings"], mirrors.arrays, self.host.water.optics(n["sun"]),
            self._shown,
        )  # fmt: skip

    def _compose(self):
        n = self.uniforms
        compose[self._grid()](
            self._shown, self.depth, RainCover(*self.rain.alphas, n["fog"]),
            RainLight(self.drop_light.drops, self.drop_light.sheets, n["air"]), self.camera_arrays,
            n["brightness"], self._image,
        )  # fmt: skip

    # ---- what comes back

    def copy_image(self, image_out, stream=None):
        """Queue the copy of the 8-bit picture to the host."""
        copy_to_host(self._image, image_out, self.stream if stream is None else stream)

    def ripple_slopes(self):
        """Return the slopes of the tile of ripples, on the host, see `slope_moments`."""
        moments = self._moments.copy_to_host()  # the first columns are the slopes themselves
        return np.moveaxis(moments[:, : len(moments), :2], -1, 0)


def to_device(array):
    """Return a float32 copy of an array on the device."""
    return cuda.to_device(np.ascontiguousarray(array, dtype=np.float32))


def simulation_of(state):
    """Return the simulation whose water is on the device, or None."""
    return getattr(state, "simulation", None)
