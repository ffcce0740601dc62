"""What the film on wet ground mirrors, on the GPU: twin of `rainsim.film` and `rainsim.ripmap`.

The level mirrored picture and the field of mirrored light need nothing of the picture itself: they
are drawn beside it on a stream of their own, and laid on it once it is graded. Every block of the
field is filled in, film or not. Whether `auto` draws the mirrored picture is found out with the
first frames: the device adds up the film's share of the light, the host looks when the frame is
finished, and if it is worth a picture the frame is drawn again with it.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel, pinned
from rainsim.cuda.numbers import Numbers
from rainsim.cuda.raster import Rasterizer
from rainsim.cuda.shading import BLOCK, blocks
from rainsim.film import (
    ABOVE,
    COARSE,
    FIELD_STEP,
    HALF,
    MOST_ASIDE,
    MOST_UP,
    ONE,
    ZERO,
    field_at,
    in_level_picture,
    level_camera,
    mirrored_light,
    usual_share,
    usual_shares,
)
from rainsim.light import pixel_ray
from rainsim.lobe import LOBE
from rainsim.raster import prepare
from rainsim.render import pose
from rainsim.ripmap import LEVELS
from rainsim.scene.cameras import mirrored_camera

COARSEST = 1 << (LEVELS - 1)
SUMMERS = 128  # threads that add up a row


@cuda_kernel
def halve_widths(picture, size, horizon, atlas_out):
    """Fill the upper half of a ripmap: all widths of the rows; see `rainsim.ripmap.ripmap`.

    size : ndarray of shape (2,), float32
        Columns and rows of the picture that are drawn; what lies beyond is as at their border.
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
    if level == LEVELS:
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
def mirrored_field(
    ground_from_camera, eye, lens, step, ground, origin, spacing, lobe, atlas, level_depth,
    level_size, level_lens, forward, environment, field_out,
):  # fmt: skip
    """Fill in the light that film mirrors to each block of pixels; see `rainsim.film`.

    level_size : ndarray of shape (2,), float32
        Columns and rows of the level picture; zero: there is none.
    """
    i, j = cuda.grid(2)
    if j >= field_out.shape[0] or i >= field_out.shape[1]:
        return
    m = ground_from_camera
    b = ((np.float32(j) + HALF) * np.float32(step) - lens[3]) / lens[1]
    a = ((np.float32(i) + HALF) * np.float32(step) - lens[2]) / lens[0]
    depth = level_depth[: int(level_size[1]), : int(level_size[0])]
    red, green, blue = mirrored_light(
        m[0, 0] * a + m[0, 1] * b + m[0, 2], m[1, 0] * a + m[1, 1] * b + m[1, 2],
        m[2, 0] * a + m[2, 1] * b + m[2, 2], eye, ground, origin, spacing, lobe, atlas, depth,
        level_lens, forward, environment,
    )  # fmt: skip
    field_out[j, i, 0], field_out[j, i, 1], field_out[j, i, 2] = red, green, blue


@cuda_kernel
def lay_film(bare, cover, field, step, picture_out):
    """Add to a picture without film what its film mirrors; see `rainsim.film`."""
    column, row = cuda.grid(2)
    height, width = cover.shape
    if row >= height or column >= width:
        return
    share = cover[row, column]
    red, green, blue = bare[row, column, 0], bare[row, column, 1], bare[row, column, 2]
    if share > ZERO:
        r, g, b = field_at(field, ONE / np.float32(step), row, column)
        red, green, blue = red + share * r, green + share * g, blue + share * b
    picture_out[row, column, 0] = red
    picture_out[row, column, 1] = green
    picture_out[row, column, 2] = blue


@cuda_kernel
def film_share(cover, ground_from_camera, lens, table, total_out):
    """Add up what film mirrors; see `rainsim.film`. A block of SUMMERS threads takes a row."""
    sums = cuda.shared.array(SUMMERS, np.float64)
    tid, j = cuda.threadIdx.x, cuda.blockIdx.x
    m, row = ground_from_camera, j * COARSE
    total = 0.0
    for column in range(tid * COARSE, cover.shape[1], SUMMERS * COARSE):
        share = cover[row, column]
        if share > ZERO:
            x, y, z = pixel_ray(m, lens, row, column)
            total += share * usual_share(table, x, y, z)
    sums[tid] = total
    cuda.syncthreads()
    if tid == 0:
        for k in range(1, SUMMERS):
            total += sums[k]
        total_out[j] = total


class Film:
    """What wet ground mirrors in the pictures of a renderer.

    Parameters
    ----------
    renderer : rainsim.cuda.frame.Renderer
        Its `wet_ground` has chosen, or chooses, whether the mirrored picture is drawn.

    Attributes
    ----------
    rasterizers : list of Rasterizer
        The one of what stands on the ground, once it is drawn.
    bare : device array of shape (height, width, 3), float32
        The picture without film.
    cover : device array of shape (height, width), float32
        Share of a full film; without rows where it is not told apart.
    """

    def __init__(self, renderer):
        self.renderer, self.wet_ground = renderer, renderer.wet_ground
        self.apart, self.rasterizers = self.wet_ground.apart, []
        self.stream, self._forked, self._done = cuda.stream(), cuda.event(), cuda.event()
        self._room = None
        if not self.apart:
            return
        self._ground, self._lobe = cuda.to_device(self.wet_ground.ground), cuda.to_device(LOBE)
        self._table = cuda.to_device(usual_shares())
        # What stands for a level picture that shows nothing.
        self._size = cuda.to_device(np.zeros(2, np.float32))
        self._lens = cuda.to_device(np.ones(4, np.float32))
        self._now = Numbers(self.stream, {
            "turn": ((3, 3), np.float32), "eye": ((3,), np.float32), "forward": ((2,), np.float32),
        })  # fmt: skip
        self._allocate(1, 1)
        if self.wet_ground.drawn:
            self._prepare()

    def room_for(self, height, width):
        """Allocate what a picture of this size needs; return the cover's array."""
        f4, self._shape = np.float32, (height, width)
        self.bare = self.field = None
        self.cover = cuda.device_array((height if self.apart else 1, width), f4)
        if not self.apart:
            return self.cover[:0]
        self.bare = cuda.device_array((height, width, 3), f4)
        rows = -(-height // COARSE)
        self._total, self._told = cuda.device_array(rows, np.float64), pinned(rows, np.float64)
        return self.cover

    def _allocate(self, width, height):
        """Allocate the level picture of at most this size, and its ripmap."""
        f4 = np.float32
        self._picture = cuda.device_array((height, width, 3), f4)
        self._depth, self._clearance = (cuda.device_array((height, width), f4) for _ in range(2))
        high, wide = (-(-side // COARSEST) * 2 * COARSEST for side in (height, width))
        self._atlas = cuda.device_array((high, wide, 3), f4)

    def _prepare(self):
        """Take what stands on the ground to the device."""
        r = self.renderer
        splats = in_level_picture(prepare(r.scene.splats), r.terrain, r.frame)
        self.rasterizers = [Rasterizer(splats, self.stream, first_room=len(splats))]

    def update(self, camera, view):
        """Take over the camera of the next picture: in the capture's frame and in the ground's."""
        self._step = max(1, round(camera.fx / FIELD_STEP))
        if self.apart and (self.field is None or self._field_step != self._step):
            self._field_step = self._step
            shape = (-(-n // self._step) for n in self._shape)
            self.field = cuda.device_array((*shape, 3), np.float32)
        if not self.rasterizers:
            return
        frame, level = self.renderer.frame, level_camera(view)
        _, mirrored = mirrored_camera(frame.camera_in_capture(level), frame, 0.0)
        self._horizon = round(level.cy)
        room = math.ceil(2 * MOST_ASIDE * level.fx), math.ceil((ABOVE + MOST_UP) * level.fx)
        if room != self._room:
            self._room = room
            self._allocate(*room)
        rasterizer = self.rasterizers[0]
        rasterizer.update(mirrored, self.renderer.near, room=room)
        self._size, self._lens = rasterizer.size, rasterizer.lens
        turn, eye = pose(frame.camera_in_ground(mirrored))
        self._now.update(turn=turn, eye=eye, forward=level.forward[:2])

    @property
    def queue(self):
        """What a recorded queue depends on."""
        if not self.apart:
            return ()
        return self._step, self._room, *(rasterizer.queue for rasterizer in self.rasterizers)

    def lacks(self):
        """Return whether the frame that the device has drawn shows that a picture is to be drawn.

        `auto` decides; it is said once, and kept.
        """
        if not self.apart or self.rasterizers:
            return False
        ground = self.wet_ground
        if ground.config.film == "auto" and not ground.drawn:
            share = float(self._told.sum() / (len(self._told) * -(-self._shape[1] // COARSE)))
            if share > 0:
                ground.choose(share, self.renderer.notes)
        return ground.drawn

    def grow(self):
        """Draw the mirrored picture from now on if the finished frame lacked it; return that."""
        lacking = self.lacks()
        if lacking:
            self._prepare()
        return lacking

    def draw(self):
        """Queue the level picture and the field, beside what the renderer's stream does next."""
        if not self.apart:
            return
        r, stream = self.renderer, self.stream
        self._forked.record(r.stream)
        self._forked.wait(stream)
        self._now.send()
        for rasterizer in self.rasterizers:
            rasterizer.launch()
            self._grade(rasterizer)
        self._fill()
        self._done.record(stream)

    def _grade(self, rasterizer):
        """Queue the grading of the level picture, and its ripmap."""
        self.renderer.grade(
            rasterizer, self._depth.shape, self._now["turn"], self._now["eye"], self._picture,
            self._depth, self._clearance, self.cover[:0], self.stream,
        )  # fmt: skip
        high, wide, _ = self._atlas.shape
        grid = blocks(high // 2, wide), BLOCK, self.stream
        halve_widths[grid](self._picture, self._size, self._horizon, self._atlas)
        halve_heights[grid](self._atlas)

    def _fill(self):
        """Queue the field."""
        r, n = self.renderer, self.renderer.numbers
        mirrored_field[blocks(*self.field.shape[:2]), BLOCK, self.stream](
            n["turn"], n["eye"], n["lens"], self._step, self._ground, *r.place, self._lobe,
            self._atlas, self._depth, self._size, self._lens, self._now["forward"], r.blurred,
            self.field,
        )  # fmt: skip

    def lay(self, picture):
        """Queue the film that is laid over the graded picture."""
        r, n = self.renderer, self.renderer.numbers
        self._done.wait(r.stream)
        if not self.rasterizers and self.wet_ground.config.film == "auto":
            film_share[len(self._total), SUMMERS, r.stream](
                self.cover, n["turn"], n["lens"], self._table, self._total
            )
            self._total.copy_to_host(self._told, stream=r.stream)
        lay_film[blocks(*self._shape), BLOCK, r.stream](
            self.bare, self.cover, self.field, self._step, picture
        )
