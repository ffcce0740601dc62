"""A frame on the device: its buffers by name, its numbers, and what the host sends.

`rainsim.cuda.render.passes` queues the kernels that fill the buffers, `FrameQueue` decides when.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from rainsim.cuda.driver import Staging, copy_to_host, send
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import cuda
from rainsim.cuda.lod.paged import ChunkPicture
from rainsim.cuda.moving_map import MovingMap
from rainsim.cuda.raster import Rasterizer
from rainsim.cuda.render.passes import Passes
from rainsim.particles.fog import FOG_STEPS
from rainsim.reflection.ray_water import COVERING_DEPTHS
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.reflection.water_pass import March
from rainsim.scene.view import view_of_arrays
from rainsim.shading.grading import Look
from rainsim.shading.wetness import OffGroundWetness
from rainsim.ssr import bounds_of


class DeviceFrame:
    """Buffers of one frame after another; `frame["depth"]` is a device array.

    conductor : Conductor. Its capture's rasterizer draws on the device.
    stream : numba.cuda.stream. That the frame's main queue lies on.
    rasterizer : rainsim.cuda.raster.Rasterizer. Of the capture; of one in chunks
        not `PagedScene.drawer`, which draws for the host.
    chunks : ChunkPicture or None. What `rasterizer` draws of a capture in chunks.
    place : tuple. Corner (2,) and spacing [m] of the map.
    uniforms : FrameUniforms. Numbers that change from frame to frame.
    passes : Passes
    pending : list of callable. Copies to the device that the next frame needs
        before its queue starts.
    look : tuple. Numbers of what changes the look of the next frame of a camera.
    size : tuple of int or None. Height and width [px].
    tile : float32 [m]. Side of the tile of ripples.
    """

    def __init__(self, conductor, stream):
        self.conductor, self.stream = conductor, stream
        scene, ground = conductor.wet_scene, conductor.ground
        self.rasterizer, self.chunks = scene.capture.rasterizer, None
        if (paged := scene.capture.paged) is not None:
            drawer = paged.drawer
            self.rasterizer = Rasterizer(
                drawer.splats, drawer.stream, first_room=drawer.room.entries
            )
            self.chunks = ChunkPicture(paged.whole, drawer.splats, lambda: [self.rasterizer])
        grid = ground.terrain.grid
        self.place = to_device(np.array(grid.origin, np.float32)), np.float32(grid.spacing)
        layer = ground.terrain.layer
        bodies = scene.ground.bodies.now.size or ground.terrain.footprints
        shape = (*grid.shape, 3) if bodies else (1, 1, 3)
        self._buffers = {
            "bed": to_device(ground.terrain.bed), "ground_map": to_device(scene.ground.map),
            "layer": to_device(layer if layer.size else np.zeros((1, 1), np.float32)),
            "rings": to_device(ground.rings), "bodies": cuda.device_array(shape, np.uint8),
            "environment": to_device(scene.sky.environment), "gloss": to_device(scene.sky.gloss),
            "coat": to_device(scene.sky.coat), "behind": to_device(scene.sky.behind),
            "behind_mirrored": to_device(scene.sky.behind_mirrored),
            "water": cuda.device_array(grid.shape, np.float32), "moments": None,
        }  # fmt: skip
        tops = ground.water.tops
        self._tops = tops._replace(
            number=cuda.to_device(tops.number), form=to_device(tops.form),
            depths=to_device(tops.depths), holds=to_device(tops.holds),
            origin=to_device(tops.origin),
        )  # fmt: skip
        self.size = self.uniforms = self.tile = self._version = self.look = None
        self.passes = Passes(self)
        self.pending, self._staging = [], Staging(stream)
        self._maps = {
            name: MovingMap(self._buffers[name], self._staging, still)
            for name, still in (
                ("rings", ground.rings), ("ground_map", scene.ground.tracked.untouched),
                ("bodies", None),
            )
        }  # fmt: skip
        self._sent = {name: value for name, value, _ in self._kept() if name != "actors"}
        name, value, send = next(each for each in self._kept() if each[0] == "bodies")
        self._send(name, value, send)
        self.rasterizer.recolors = False

    def __getitem__(self, name):
        return self._buffers[name]

    @property
    def ahead(self):
        """The stream that pictures are splatted on."""
        return self.rasterizer.stream

    # ---- what a frame shows

    def update(self, camera, state, camera_end=None):
        """Take over camera, state and look of the next frame.

        The device may still be drawing the frame before: only `pending` writes to its buffers.
        """
        conductor, passes = self.conductor, self.passes
        conductor.roll(state.time, host_depth(state) if conductor.cars else None)
        conductor.take(camera, state, camera_end)
        self.pending = [
            partial(self._send, name, value, send)
            for name, value, send in self._kept() if value is not self._sent.get(name)
        ]  # fmt: skip
        if passes.actors is not None:
            passes.actors.update(state)
        if self.size != (camera.height, camera.width):
            self.size = camera.height, camera.width
            self._allocate()
        scene, inputs = conductor.wet_scene, conductor.frame
        capture = scene.capture
        if self.chunks is not None:
            self.chunks.choose(self.pending, camera, capture.near)
            self.rasterizer.splats.aim_at(self.chunks.boxes())
        self.rasterizer.update(camera, capture.near, detail=capture.merge)
        passes.mirrors.update(camera, capture, inputs["mirror_step"])
        passes.ground_light.update(camera, conductor.ground_camera)
        if passes.glare is not None:
            passes.glare.update(conductor.ground_camera.fx)
        self.look = conductor.wet_scene.changes
        self._take_state(state)
        fog = passes.rain.update(state, camera_end)
        view = conductor.view
        self.uniforms.update(
            turn=view.ground_from_camera, eye=view.eye, lens=view.lens, look=scene.shading.look,
            off_ground=scene.shading.off_ground, brightness=conductor.brightness, fog=fog,
            sun=inputs["sun"], air=inputs["air"], around=inputs["everywhere"],
        )  # fmt: skip

    def _kept(self):
        """Return what is sent again when another stands in its place: name, value, how."""
        scene = self.conductor.wet_scene
        copies = {
            "behind": scene.sky.behind,
            "behind_mirrored": scene.sky.behind_mirrored,
        }
        kept = [(name, array, partial(self._copy, name)) for name, array in copies.items()]
        inputs, still = self.conductor.frame, self.conductor.ground.rings
        rings = inputs["rings"] if "rings" in inputs else still
        windows = self.conductor.sheltered
        kept.append(("rings", rings, partial(self._send_rings, windows, still)))
        kept.append(("ground_map", scene.ground.tracked, self._send_ground))
        if scene.capture.actors is not None and scene.capture.paged is None:
            kept.append(("actors", scene.capture.actors.placed, self._send_actors))
        bodies = scene.ground.bodies
        kept.append(("bodies", bodies.now, partial(self._send_bodies, bodies.moved, bodies.still)))
        if scene.capture.paged is None:
            kept.append(("colors", scene.capture.drawn, self._send_colors))
        return kept

    def send_chunks(self):
        """Send what the pictures of a capture in chunks lack; the device must be idle meanwhile."""
        passes = self.passes
        for chunks in (self.chunks, passes.mirrors.chunks, passes.ground_light.chunks):
            if chunks is not None:
                chunks.send()

    def _send(self, name, value, send):
        send(value)
        self._sent[name] = value

    def _copy(self, name, array):
        self._staging.send(self._buffers[name], np.asarray(array, np.float32))

    def _send_ground(self, tracked):
        """Send the rows of a `TrackedMap` that differ from those that are there."""
        rows, columns = tracked.rows, slice(0, tracked.map.shape[1])
        windows = [(rows, columns)] if rows.start < rows.stop else []
        self._maps["ground_map"].send(tracked.map, windows, tracked.untouched)

    def _send_rings(self, windows, still, rings):
        self._maps["rings"].send(rings, windows, still)

    def _send_bodies(self, windows, still, bodies):
        shape = self._buffers["bodies"].shape
        bodies = bodies if bodies.size else np.zeros(shape, np.uint8)
        self._maps["bodies"].send(bodies, windows, still)

    def _send_colors(self, drawn):
        self.rasterizer.splats.send_colors(drawn)
        if (level := self.passes.ground_light.level) is not None:
            level.send_colors()

    def _send_actors(self, _placed):
        self.rasterizer.send_actors(self.stream)
        if (level := self.passes.ground_light.level) is not None:
            level.send_actors()

    def _take_state(self, state):
        """List the copies of the water and its ripples to the device, unless they are there."""
        self.tile = np.float32(state.tile_size)
        if len(self._tops.form):
            self.uniforms.update(tops=self.conductor.frame["tops"].water)
        if simulation_of(state) is not None:
            return
        moments = ripple_moments(state.slopes)
        if self._buffers["moments"] is None:
            self._buffers["moments"] = cuda.to_device(moments)

        def send_water():
            self._copy("water", state.depth)
            send(self._buffers["moments"], moments, self.stream)
            self.passes.rain.send_drips(state)

        self.pending.append(send_water)

    def leave_water(self):
        """Let go of the water of the frames so far; the next shows that of another simulation."""
        self._buffers["moments"], self.passes.surface.depth = None, self._buffers["water"]
        self.passes.rain.leave_water()

    def take_water(self, state):
        """Take over the water that a simulation on the device has for a frame."""
        self._buffers["moments"], self.passes.surface.depth = state.moments, state.depth
        self.passes.rain.take_water(state)

    def _allocate(self):
        """Allocate the buffers of a picture of the present size."""
        height, width = self.size
        f4, apart = np.float32, self.passes.ground_light.level is not None
        cover = cuda.device_array((height if apart else 1, width), f4)
        self._buffers["cover"] = cover if apart else cover[:0]
        own = {"below": apart, "dazzling": self.passes.glare is not None}
        for name in ("picture", "shown", *(name for name, is_own in own.items() if is_own)):
            self._buffers[name] = cuda.device_array((height, width, 3), f4)
        for name, same in (("below", "picture"), ("dazzling", "shown")):
            if not own[name]:
                self._buffers[name] = self._buffers[same]
        for name in ("depth", "clearance", "tall", "hit", "distance", "coverage", "no_rain"):
            self._buffers[name] = cuda.device_array((height, width), f4)
        self._buffers["bounds"] = cuda.device_array(bounds_of(height, width), f4)
        self._buffers["no_rain"].copy_to_device(np.zeros((height, width), f4))
        self._buffers["image"] = cuda.device_array((height, width, 3), np.uint8)
        self.uniforms = FrameUniforms(self.stream, {
            "turn": ((3, 3), f4), "eye": ((3,), f4), "lens": ((4,), f4),
            "look": ((len(Look._fields),), f4),
            "off_ground": ((len(OffGroundWetness._fields),), f4),
            "brightness": ((1,), f4), "fog": ((FOG_STEPS + 3,), f4),
            "sun": ((6,), f4), "air": ((3,), f4), "settings": ((3,), f4), "cover": ((2,), f4),
            "around": ((3,), f4), "size": ((2,), f4),
            "tops": ((max(len(self._tops.form), 1), 2), f4),
        })  # fmt: skip
        self.uniforms.update(
            settings=March().settings(width), cover=COVERING_DEPTHS, size=(width, height)
        )
        self.passes.room_for(height, width)
        self._version = new_version()

    def dependencies(self, part):
        """Return the values that the recorded queues of a part depend on, see `Passes`, a tuple.

        When they change these are recorded again.
        """
        return self._version, *self.passes.dependencies(part)

    # ---- as kernels take it

    @property
    def view(self):
        """The `View` of the camera as kernels take it."""
        return view_of_arrays(*(self.uniforms[name] for name in ("turn", "eye", "lens")))

    @property
    def tops(self):
        """The tops as kernels take them, `TopMaps`."""
        return self._tops._replace(water=self.uniforms["tops"])

    # ---- what comes back

    def copy_image(self, image_out, stream=None):
        """Queue the copy of the 8-bit picture to the host."""
        copy_to_host(self._buffers["image"], image_out, self.stream if stream is None else stream)

    def ripple_slopes(self):
        """Return the slopes of the tile of ripples, on the host, see `slope_moments`."""
        moments = self._buffers["moments"].copy_to_host()  # first columns: the slopes themselves
        return np.moveaxis(moments[:, : len(moments), :2], -1, 0)


def to_device(array):
    """Return a float32 copy of an array on the device."""
    return cuda.to_device(np.ascontiguousarray(array, dtype=np.float32))


def host_depth(state):
    """Return the depth of a state's water on the host, ndarray (ny, nx) [m]; may wait for it."""
    simulation = simulation_of(state)
    return state.depth if simulation is None else simulation.host_depth(state.step)


def simulation_of(state):
    """Return the simulation whose water is on the device, or None."""
    return getattr(state, "simulation", None)
