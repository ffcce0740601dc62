"""Twin of `rainsim.shading.lamp_images`: the images of lamps in wet ground on a CUDA device.

The host finds the lamps of a frame, by the CPU's functions in the level picture, before the frame's
queue starts: a few sources of a picture of some hundred pixels. On the device a thread takes a
block of pixels through all of them.
"""

from __future__ import annotations

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.driver import send
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.raster import Rasterizer
from rainsim.cuda.shading.wet_pass import BLOCK, blocks
from rainsim.scene.cameras import mirrored_camera
from rainsim.scene.view import view_from
from rainsim.shading.ground_slopes import block_ray
from rainsim.shading.lamp_images import BRIGHT, LampView, lamp_light, lamps_seen, may_shine
from rainsim.shading.wet_ground_mirror import level_camera

ROOM = 256  # lamps that there is room for at first
MOST = np.float32(BRIGHT)


@cuda_kernel
def dim_lamps(many, picture_out):
    """Make the colours of a picture no brighter than BRIGHT if it shows lamps, as on the CPU.

    many : device array of shape (1,), int32
        Lamps.
    """
    column, row = cuda.grid(2)
    if many[0] == 0 or row >= picture_out.shape[0] or column >= picture_out.shape[1]:
        return
    brightest = ZERO
    for c in range(3):
        brightest = max(brightest, picture_out[row, column, c])
    if brightest > MOST:
        for c in range(3):
            picture_out[row, column, c] *= MOST / brightest


@cuda_kernel
def add_lamps(many, camera, step, ground, seen, level_size, field_out):
    """Add the light of lamps that wet ground mirrors to each block; see the CPU's kernel.

    many : device array of shape (1,), int32
        Lamps; the array of lamps may be longer.
    level_size : device array of shape (2,), float32
        Columns and rows of the level picture, whose arrays may be larger.
    """
    i, j = cuda.grid(2)
    if many[0] == 0 or j >= field_out.shape[0] or i >= field_out.shape[1]:
        return
    view = view_from(camera)
    x, y, z = block_ray(view, step, j, i)
    depth = seen.depth[: int(level_size[1]), : int(level_size[0])]
    shown = LampView(seen.lamps[: many[0]], depth, seen.lens, seen.forward)
    red, green, blue = lamp_light(x, y, z, view.eye, ground, shown)
    field_out[j, i, 0] += red
    field_out[j, i, 1] += green
    field_out[j, i, 2] += blue


class Lamps:
    """The lamps that the wet ground of one frame after another mirrors.

    Parameters
    ----------
    frame : DeviceFrame
    splats : DeviceSplats
        Of the level picture.
    stream : numba.cuda.stream

    Attributes
    ----------
    version : int
        Of the list of lamps, see `cuda.graph.new_version`.
    """

    def __init__(self, frame, splats, stream):
        self._frame, self._stream = frame, stream
        self._rasterizer = Rasterizer(splats, stream, first_room=splats.count)
        self._many = cuda.to_device(np.zeros(1, np.int32))
        self._shown = None  # camera and look that the lamps are of
        self._make_room(ROOM)

    def _make_room(self, room):
        self._lamps, self.version = cuda.to_device(np.zeros((room, 8), np.float32)), new_version()

    def update(self, camera, ground_camera):
        """List the search for the lamps of the next frame, unless they are those of the last.

        Parameters
        ----------
        camera, ground_camera : Camera
            In the capture frame and in the ground frame.
        """
        shown = camera, self._frame.conductor.wet_scene.changes
        if self._shown is None or shown[0] is not self._shown[0] or shown[1] != self._shown[1]:
            self._frame.pending.append(lambda: self._find(shown, ground_camera))

    def _find(self, shown, ground_camera):
        """Find the lamps and send them; the device must draw nothing meanwhile."""
        _, lamps = lamps_seen(level_camera(ground_camera), self._seen)
        if len(lamps) > len(self._lamps):
            self._make_room(2 * len(lamps))
        send(self._many, np.array([len(lamps)], np.int32))
        if len(lamps):
            send(self._lamps[: len(lamps)], lamps)
        self._shown = shown

    def _seen(self, level):
        """Return the `WetPicture` of standing things, see `WetScene.level_mirrored`."""
        scene = self._frame.conductor.wet_scene
        if scene.capture.paged is not None:
            return scene.level_mirrored(level)
        _, camera = mirrored_camera(scene.frame.camera_in_capture(level), scene.frame, 0.0)
        layers = self._rasterizer.draw(camera, scene.capture.near)
        return scene.wetted(layers, scene.view_of(camera), mirrored=True)

    def dim(self, picture, stream):
        """Queue the dimming of the level picture where it shows lamps."""
        dim_lamps[blocks(*picture.shape[:2]), BLOCK, stream](self._many, picture)

    def add(self, step, ground, level, level_size, field, stream):
        """Queue the sum of the field of mirrored light and the lamps' light."""
        seen = LampView(self._lamps, level.depth, level.lens, level.forward)
        add_lamps[blocks(*field.shape[:2]), BLOCK, stream](
            self._many, self._frame.view, step, ground, seen, level_size, field
        )


def shines(scene):
    """Return whether a scene or one of its actors has splats as bright as lamps."""
    return any(may_shine(part.splats) for part in (scene, *scene.actors))
