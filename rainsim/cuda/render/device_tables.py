"""What the passes of a device read: the maps and numbers of a frame, sent from the host."""

from functools import partial

import numpy as np

from rainsim.cuda.driver import send
from rainsim.cuda.jit import cuda
from rainsim.cuda.moving_map import MovingMap
from rainsim.cuda.shading.wet_pass import DeviceView, grade_and_wet, pixel_grid
from rainsim.reflection.ray_water import COVERING_DEPTHS
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.reflection.water_pass import march_settings
from rainsim.shading.smooth_normals import AROUND, NO_AROUND
from rainsim.shading.surface_point import GroundMaps
from rainsim.shading.wet_pass import DryPicture
from rainsim.shading.wetting import SkyMaps


class DeviceTables:
    """Maps and numbers on a device; `tables["rings"]` is a device array."""

    def __init__(self, conductor):
        self.conductor, self.camera = conductor, DeviceView()
        scene, ground = conductor.wet_scene, conductor.ground
        grid, layer = ground.terrain.grid, ground.terrain.layer
        self.place = to_device(np.array(grid.origin, np.float32)), np.float32(grid.spacing)
        bodies = scene.ground.bodies.now.size or ground.terrain.footprints
        shape = (*grid.shape, 3) if bodies else (1, 1, 3)
        self._arrays = {
            "bed": to_device(ground.terrain.bed), "ground_map": to_device(scene.ground.map),
            "layer": to_device(layer if layer.size else np.zeros((1, 1))),
            "rings": to_device(ground.rings), "bodies": cuda.to_device(np.zeros(shape, np.uint8)),
            "environment": to_device(scene.sky.environment), "gloss": to_device(scene.sky.gloss),
            "coat": to_device(scene.sky.coat), "behind": to_device(scene.sky.behind),
            "behind_mirrored": to_device(scene.sky.behind_mirrored),
            "cover": to_device(COVERING_DEPTHS),
        }  # fmt: skip
        tops = ground.water.tops
        self._tops = tops._replace(
            number=cuda.to_device(tops.number), form=to_device(tops.form),
            depths=to_device(tops.depths), holds=to_device(tops.holds),
            origin=to_device(tops.origin),
        )  # fmt: skip
        self._arrays |= {name: cuda.device_array(size, np.float32) for name, size in (
            ("sun", 6), ("air", 3), ("tops", (max(len(tops.form), 1), 2))
        )}  # fmt: skip
        self.tops = self._tops._replace(water=self._arrays["tops"])
        self._maps = {
            name: MovingMap(self._arrays[name], still)
            for name, still in (
                ("rings", ground.rings), ("ground_map", scene.ground.tracked.untouched),
                ("bodies", None),
            )
        }  # fmt: skip
        self._sent = {name: value for name, value, _ in self._kept() if name != "bodies"}
        self._water = self._moments = None  # of states of the host
        self._no_cover = cuda.device_array((1, 1), np.float32)[:0]

    def __getitem__(self, name):
        return self._arrays[name]

    @property
    def view(self):
        """The `View` of the frame's camera as kernels take it."""
        return self.camera.view

    # ---- what the host sends

    def update(self):
        """Send what the conductor has taken over for the next frame."""
        conductor, inputs = self.conductor, self.conductor.frame
        camera = conductor.camera
        for name, value, give in self._kept():
            if value is not self._sent.get(name):
                give(value)
                self._sent[name] = value
        self.camera.take(conductor.view, (camera.height, camera.width))
        self.march = march_settings(camera.width)
        if len(self.tops.form):
            send(self.tops.water, inputs["tops"].water)
        for name in ("sun", "air"):
            send(self._arrays[name], inputs[name])

    def _kept(self):
        """Return what is sent again when another stands in its place: name, value, how."""
        conductor, scene = self.conductor, self.conductor.wet_scene
        inputs, still = conductor.frame, conductor.ground.rings
        rings = inputs["rings"] if "rings" in inputs else still
        bodies, tracked = scene.ground.bodies, scene.ground.tracked
        return [
            *(
                (name, getattr(scene.sky, name), partial(send, self._arrays[name]))
                for name in ("behind", "behind_mirrored")
            ),
            ("rings", rings, partial(self._send, "rings", conductor.sheltered, still)),
            ("ground_map", tracked, self._send_ground),
            ("bodies", bodies.now, partial(self._send, "bodies", bodies.moved, bodies.still)),
        ]

    def _send(self, name, windows, still, values):
        values = values if values.size else np.zeros(self._arrays[name].shape, np.uint8)
        self._maps[name].send(values, windows, still)

    def _send_ground(self, tracked):
        """Send the rows of a `TrackedMap` that differ from those that are there."""
        rows, columns = tracked.rows, slice(0, tracked.map.shape[1])
        windows = [(rows, columns)] if rows.start < rows.stop else []
        self._maps["ground_map"].send(tracked.map, windows, tracked.untouched)

    def water_of(self, state):
        """Return depth and slopes' moments of a state of either backend, on the device.

        Those of a state of the host are overwritten by the next call.
        """
        if hasattr(state, "moments"):
            return state.depth, state.moments
        moments = ripple_moments(state.slopes)
        if self._water is None:
            self._water = cuda.device_array(state.depth.shape, np.float32)
            self._moments = cuda.device_array(moments.shape, np.float32)
        send(self._water, state.depth)
        send(self._moments, moments)
        return self._water, self._moments

    # ---- what several passes do

    def grade(self, layers, camera, picture_out, depth_out, clearance_out, cover_out=None,
              mirrored=False):  # fmt: skip
        """Queue the grading and wetting of the layers of a picture.

        picture_out, depth_out, clearance_out, cover_out : device array. See
            `grade_and_wet`; without the last the film's mirror is not apart.
        """
        scene, shape = self.conductor.wet_scene, layers.alpha.shape
        layer = scene.ground.thickest_layer
        dry = DryPicture(
            layers.color, layers.alpha, layers.depth, layers.plane_depth, layers.normal,
            np.float32(scene.frame.meters_per_unit), NO_AROUND if mirrored else max(AROUND, layer),
        )  # fmt: skip
        ground = GroundMaps(
            self["bed"], self["ground_map"], *self.place, self["bodies"], self["layer"], layer
        )
        behind = self["behind_mirrored" if mirrored else "behind"]
        cover = self._no_cover if cover_out is None else cover_out
        grade_and_wet[pixel_grid(shape)](
            camera.size, dry, camera.view, ground, scene.shading.off_ground,
            SkyMaps(self["gloss"], self["coat"], behind), scene.shading.look, picture_out,
            depth_out, clearance_out, cover,
        )  # fmt: skip


def to_device(array):
    """Return a float32 copy of an array on the device."""
    return cuda.to_device(np.ascontiguousarray(array, dtype=np.float32))
