"""Twin of `shading.wet_ground_mirror` and `numerics.ripmap`: reflections in wet ground.

Every block of the field of mirrored light is computed, wet or not.
"""

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.cuda.driver import send
from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel
from rainsim.cuda.shading.lamp_images import add_lamps, shines
from rainsim.cuda.shading.wet_pass import BLOCK, DeviceView, blocks
from rainsim.numerics.ripmap import LEVELS
from rainsim.reflection.water_pass import WetPicture
from rainsim.scene.view import View
from rainsim.shading import wet_ground_mirror
from rainsim.shading.lamp_images import LampView, lamps_seen, without_lamps
from rainsim.shading.microfacet import LOBE

COARSEST = 1 << (LEVELS - 1)
_NOWHERE = View(np.eye(3, dtype=np.float32), np.zeros(3, np.float32), *np.float32([1, 1, 0, 0]))


@cuda_kernel
def halve_widths(picture, size, horizon, atlas_out):
    """Fill the upper half of a ripmap: all widths of the rows; see `ripmap`.

    size : ndarray of shape (2,), float32
        Columns and rows of the picture that are drawn; beyond them the border's values go on.
    """
    column, row = cuda.grid(2)
    height, width = atlas_out.shape[0] // 2, atlas_out.shape[1] // 2
    if row >= height or column >= 2 * width:
        return
    level, start = level_of(column, width)
    if level == LEVELS:
        return
    columns, rows = int(size[0]), int(size[1])
    j, i = min(max(row, horizon), rows - 1), (column - start) << level
    r, g, b = ZERO, ZERO, ZERO
    for k in range(i, i + (1 << level)):
        at = min(k, columns - 1)
        r, g, b = r + picture[j, at, 0], g + picture[j, at, 1], b + picture[j, at, 2]
    share = ONE / np.float32(1 << level)
    atlas_out[row, column, 0] = r * share
    atlas_out[row, column, 1] = g * share
    atlas_out[row, column, 2] = b * share


@cuda_kernel
def halve_heights(atlas):
    """Fill the lower half of a ripmap from its upper one."""
    column, row = cuda.grid(2)
    height = atlas.shape[0] // 2
    row += height
    if row >= 2 * height or column >= atlas.shape[1]:
        return
    level, start = level_of(row, height)
    if level == LEVELS or level_of(column, atlas.shape[1] // 2)[0] == LEVELS:
        return
    j = (row - start) << level
    r, g, b = ZERO, ZERO, ZERO
    for k in range(j, j + (1 << level)):
        r, g, b = r + atlas[k, column, 0], g + atlas[k, column, 1], b + atlas[k, column, 2]
    share = ONE / np.float32(1 << level)
    atlas[row, column, 0] = r * share
    atlas[row, column, 1] = g * share
    atlas[row, column, 2] = b * share


@cuda_device
def level_of(place, side):
    """Return the level of a ripmap's column or row and where that begins; LEVELS: none."""
    level, start = 0, 0
    while level < LEVELS and place >= start + (side >> level):
        start += side >> level
        level += 1
    return level, start


@cuda_kernel
def mirrored_field(view, step, ground, lobe, level, level_size, environment, field_out):
    """Write the light that wet ground mirrors to each block of pixels; see the CPU's kernel.

    level_size : device array of shape (2,), float32
        Columns and rows of the level picture, whose arrays may be larger; zero: there is none.
    """
    i, j = cuda.grid(2)
    if j >= field_out.shape[0] or i >= field_out.shape[1]:
        return
    x, y, z = wet_ground_mirror.block_ray(view, step, j, i)
    depth = level.depth[: int(level_size[1]), : int(level_size[0])]
    drawn = wet_ground_mirror.LevelPicture(level.atlas, depth, level.lens, level.forward)
    red, green, blue = wet_ground_mirror.mirrored_light(
        x, y, z, view.eye, ground, lobe, drawn, environment
    )
    field_out[j, i, 0], field_out[j, i, 1], field_out[j, i, 2] = red, green, blue


@cuda_kernel
def add_reflection(bare, cover, field, step, picture_out):
    """Add the light that wet ground mirrors to a picture without it; see the CPU's kernel."""
    column, row = cuda.grid(2)
    height, width = cover.shape
    if row >= height or column >= width:
        return
    share = cover[row, column]
    red, green, blue = bare[row, column, 0], bare[row, column, 1], bare[row, column, 2]
    if share > ZERO:
        r, g, b = wet_ground_mirror.field_at(field, ONE / np.float32(step), row, column)
        red, green, blue = red + share * r, green + share * g, blue + share * b
    picture_out[row, column, 0] = red
    picture_out[row, column, 1] = green
    picture_out[row, column, 2] = blue


class LevelView:
    """The level picture of the frames of a device: what stands on the ground, mirrored.

    tables : DeviceTables
    camera : DeviceView. Of the picture, whose arrays may be larger.
    lamps : float32 device array (n, NUMBERS) or None. Those of the last picture.
    """

    def __init__(self, tables):
        self._tables, self.camera, self.lamps = tables, DeviceView(), None
        self._forward = cuda.device_array(2, np.float32)
        self._fine_camera, self._shines = DeviceView(), shines(tables.conductor.wet_scene.scene)
        self._room = None
        self._allocate(1, 1)
        self.camera.take(_NOWHERE, (0, 0))

    def _allocate(self, width, height):
        """Allocate the picture of at most this size, and its ripmap."""
        self._room, f4 = (width, height), np.float32
        self._pictures = _pictures(height, width)
        high, wide = (-(-side // COARSEST) * 2 * COARSEST for side in (height, width))
        self._atlas = cuda.device_array((high, wide, 3), f4)

    def draw(self, scene, camera):
        """Queue the picture for a camera of the ground frame, and its ripmap.

        Waits where there may be lamps.
        """
        level = wet_ground_mirror.level_camera(camera)
        room = (
            math.ceil(2 * wet_ground_mirror.MOST_ASIDE * level.fx),
            math.ceil((wet_ground_mirror.ABOVE + wet_ground_mirror.MOST_UP) * level.fx),
        )
        if room != self._room:
            self._allocate(*room)
        send(self._forward, level.forward[:2])
        if self._shines:
            self._find_lamps(scene, level)
        else:
            self._grade(scene, level, self.camera, self._pictures)
        high, wide, _ = self._atlas.shape
        grid = blocks(high // 2, wide), BLOCK
        halve_widths[grid](self._pictures[0], self.camera.size, round(level.cy), self._atlas)
        halve_heights[grid](self._atlas)

    def _grade(self, scene, level, camera, pictures):
        """Queue the graded picture of a level camera of the ground frame."""
        drawn, layers = scene.capture.level_layers(level, on_device=True)
        camera.take(scene.view_of(drawn), layers.alpha.shape)
        self._tables.grade(layers, camera, *pictures, mirrored=True)

    def _find_lamps(self, scene, level):
        """Draw the picture and leave the lamps out of it, which the host finds."""

        def seen_by(camera):
            view, pictures = self.camera, self._pictures
            if camera is not level:  # finer, to see how large they are
                view, pictures = self._fine_camera, _pictures(camera.height, camera.width)
            self._grade(scene, camera, view, pictures)
            picture, depth = (
                array.copy_to_host()[: camera.height, : camera.width] for array in pictures[:2]
            )
            return WetPicture(picture, depth, None, scene.view_of(camera), picture)

        seen, lamps = lamps_seen(level, seen_by)
        self.lamps = cuda.to_device(lamps) if len(lamps) else None
        if len(lamps):
            part = slice(0, level.height), slice(0, level.width)
            send(self._pictures[0], without_lamps(seen.picture), part)

    @property
    def arrays(self):
        """The picture as kernels take it, a `LevelPicture`."""
        place = self._pictures[1], self.camera.lens, self._forward
        return wet_ground_mirror.LevelPicture(self._atlas, *place)


def _pictures(height, width):
    """Return arrays for a graded picture, its depth and its clearance."""
    shapes = (height, width, 3), (height, width), (height, width)
    return [cuda.device_array(shape, np.float32) for shape in shapes]


class WetGroundLight:
    """The light that wet ground mirrors in the frames of a device.

    tables : DeviceTables. The film of its conductor's ground says whether the
        level picture is drawn.
    """

    def __init__(self, tables):
        self._tables = tables
        slopes, corner, *place = tables.conductor.ground.film.ground
        self._ground = wet_ground_mirror.GroundSlopes(
            cuda.to_device(slopes), cuda.to_device(corner), *place
        )
        self._lobe, self._field = cuda.to_device(LOBE), None
        self._level = LevelView(tables)
        self._shown = None, None  # camera and look of the last picture

    def draw(self, scene, camera):
        """Queue the field of light for a camera of the ground frame; return it and its step [px].

        scene : WetScene
        """
        tables, level = self._tables, self._level
        film = tables.conductor.ground.film
        if film.drawn:
            shown, (before, look) = film.shared_camera or camera, self._shown
            if shown is not before or scene.changes != look:
                level.draw(scene, shown)
            self._shown = shown, scene.changes
        step = max(1, round(camera.fx / wet_ground_mirror.FIELD_STEP))
        shape = -(-camera.height // step), -(-camera.width // step), 3
        if self._field is None or self._field.shape != shape:
            self._field = cuda.device_array(shape, np.float32)
        grid = blocks(*shape[:2]), BLOCK
        seen = level.arrays
        mirrored_field[grid](
            tables.view, step, self._ground, self._lobe, seen, level.camera.size, tables["gloss"],
            self._field,
        )  # fmt: skip
        if level.lamps is not None:
            lamps = LampView(level.lamps, seen.depth, seen.lens, seen.forward)
            add_lamps[grid](tables.view, step, self._ground, lamps, level.camera.size, self._field)
        return self._field, step
