"""Twin of `rainsim.shading.lamp_images` and `lamp_search`: lamps in wet ground on a CUDA device.

A thread looks for the bright pixels of a square of the level picture, a block makes lamps of all of
them, in the order of the squares. Where lamps have much of the light a finer picture is drawn, in
the queues of all frames from the first that needs it: the device decides which of both counts, so
that no frame waits for the host. A thread takes a block of pixels of the frame through all lamps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel, pinned
from rainsim.cuda.raster import Rasterizer
from rainsim.cuda.shading.wet_pass import BLOCK, blocks
from rainsim.cuda.small_copies import copy_small
from rainsim.scene.view import view_from
from rainsim.shading.ground_slopes import block_ray
from rainsim.shading.lamp_images import FINE_RESOLUTION, WORTH_FINE, LampView, lamp_light, scaled
from rainsim.shading.lamp_search import (
    BRIGHT,
    NUMBERS,
    TILE,
    bright_pixels,
    first_part,
    may_shine,
    room_for,
    write_lamp,
)

MOST = np.float32(BRIGHT)
THREADS = 8 if SIMULATED else 64  # that look for bright pixels, a square each
GATHERERS = 4 if SIMULATED else 256  # of the one block that makes lamps of them
NOTHING = np.uint64(0)


class Bright(NamedTuple):
    """What is bright in each square of a level picture, as device arrays."""

    pixels: object  # (n,) uint64, see `lamp_search.bright_pixels`
    light: object  # (n, 2) float64, above BRIGHT and of all pixels


@cuda_kernel
def mark_bright(picture, depth, size, horizon, is_fine, share, pixels_out, light_out):
    """Find the bright pixels of a level picture, a thread for each of its squares.

    picture, depth : device array. The arrays may be larger than the picture.
    size : float32 device array (2,). Columns and rows that are drawn.
    horizon : int. First row that counts.
    is_fine : bool. Whether it is the finer picture, which counts for nothing
        where `share` is small.
    share : float64 device array (1,). Of the light of the coarse picture that is
        lamps'.
    pixels_out, light_out : device array. See `Bright`.
    """
    n = cuda.grid(1)
    width, height = int(size[0]), int(size[1])
    across = (width + TILE - 1) // TILE
    if n >= across * ((height + TILE - 1) // TILE) or (is_fine and share[0] <= WORTH_FINE):
        return
    found, excess, total = bright_pixels(
        picture, depth, n // across * TILE, n % across * TILE, horizon, height, width
    )
    pixels_out[n] = found
    light_out[n, 0], light_out[n, 1] = excess, total


@cuda_kernel
def gather_lamps(
    picture, depth, size, lens, eye, forward, is_fine, bright, share_out, many_out, lamps_out
):  # fmt: skip
    """Make lamps of bright pixels, in the order of the squares; one block of GATHERERS.

    picture, depth, size, is_fine. As `mark_bright` takes them.
    lens, eye, forward : device array. As `lamp_search.find_lamps` takes them.
    share_out : float64 device array (1,). Written by the coarse picture.
    many_out : int32 device array (1,)
    lamps_out : float32 device array (room, NUMBERS)
    """
    counts = cuda.shared.array(GATHERERS, np.int32)
    light = cuda.shared.array((GATHERERS, 2), np.float64)
    if is_fine and share_out[0] <= WORTH_FINE:
        return
    tid = cuda.threadIdx.x
    across = (int(size[0]) + TILE - 1) // TILE
    squares = across * ((int(size[1]) + TILE - 1) // TILE)
    each = (squares + GATHERERS - 1) // GATHERERS
    first, end = min(tid * each, squares), min((tid + 1) * each, squares)
    count, excess, total = 0, 0.0, 0.0
    for n in range(first, end):
        left = bright.pixels[n]
        while left != NOTHING:
            left &= ~first_part(left)
            count += 1
        excess += bright.light[n, 0]
        total += bright.light[n, 1]
    counts[tid], light[tid, 0], light[tid, 1] = count, excess, total
    cuda.syncthreads()
    step = 1
    while step < GATHERERS:  # sums of those before, always in one order
        before, other, more = 0, 0.0, 0.0
        if tid >= step:
            before, other, more = counts[tid - step], light[tid - step, 0], light[tid - step, 1]
        cuda.syncthreads()
        counts[tid] += before
        light[tid, 0] += other
        light[tid, 1] += more
        cuda.syncthreads()
        step *= 2
    if tid == GATHERERS - 1:
        many_out[0] = counts[tid]
        if not is_fine:
            share_out[0] = light[tid, 0] / light[tid, 1] if counts[tid] > 0 else 0.0
    place = counts[tid] - count
    for n in range(first, end):
        left = bright.pixels[n]
        while left != NOTHING:
            part = first_part(left)
            left &= ~part
            top, side = n // across * TILE, n % across * TILE
            write_lamp(part, picture, depth, top, side, lens, eye, forward, lamps_out, place)
            place += 1


@cuda_kernel
def dim_lamps(many, picture_out):
    """Make the colours of a picture no brighter than BRIGHT if it shows lamps, as on the CPU.

    many : device array of shape (1,), int32
        Number of lamps.
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
        Number of lamps; the array of lamps may be longer.
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


class Search:
    """Room for the search in level pictures of at most a size [px]."""

    def __init__(self, width, height):
        squares = -(-width // TILE) * -(-height // TILE)
        self._bright = Bright(
            cuda.device_array(squares, np.uint64), cuda.device_array((squares, 2), np.float64)
        )

    def launch(self, seen, size, horizon, camera, is_fine, found, stream):
        """Queue the search.

        seen : tuple. Picture and depth.
        size, horizon. As `mark_bright` takes them.
        camera : tuple. Lens, eye and forward.
        is_fine : bool
        found : tuple. Share, number of lamps and lamps, as `gather_lamps` writes
            them.
        stream : numba.cuda.stream
        """
        grid = -(-len(self._bright.pixels) // THREADS), THREADS, stream
        mark_bright[grid](*seen, size, horizon, is_fine, found[0], *self._bright)
        gather_lamps[1, GATHERERS, stream](*seen, size, *camera, is_fine, self._bright, *found)


class FinePicture:
    """The level picture at FINE_RESOLUTION, by which the lamps of dark scenes are found.

    splats : DeviceSplats. Of the level picture.
    stream : numba.cuda.stream
    rasterizer : Rasterizer
    """

    def __init__(self, splats, stream):
        self.rasterizer = Rasterizer(splats, stream, first_room=splats.count)
        self._room = None

    def room_for(self, width, height):
        """Allocate pictures of at most a size [px]; return whether they are others than before."""
        if self._room == (width, height):
            return False
        self._room = width, height
        self.picture = cuda.device_array((height, width, 3), np.float32)
        self.depth, self.clearance = (
            cuda.device_array((height, width), np.float32) for _ in range(2)
        )
        self.search = Search(width, height)
        return True


class Lamps:
    """The lamps that the wet ground of one frame after another mirrors.

    splats : DeviceSplats. Of the level picture.
    stream : numba.cuda.stream
    fine : FinePicture or None. None until a frame has needed it.
    version : int. Of the arrays, see `cuda.graph.new_version`.
    """

    def __init__(self, splats, stream):
        self._splats, self._stream, self.fine = splats, stream, None
        self._many = cuda.to_device(np.zeros(1, np.int32))
        self._share, self._seen_share = cuda.to_device(np.zeros(1)), pinned(1, np.float64)
        self._seen_share[0] = 0.0
        self._room, self.version = None, new_version()

    def room_for(self, level, width, height):
        """Make room for level pictures of at most a size [px] like that of a level camera."""
        grow = FINE_RESOLUTION / level.fx
        fine = math.ceil(width * grow), math.ceil(height * grow)
        is_new = self.fine is not None and self.fine.room_for(*fine)
        if self._room != (width, height):
            self._room, is_new = (width, height), True
            self._search = Search(width, height)
            most = max(room_for(height, width), room_for(*fine[::-1]))
            self._lamps = cuda.device_array((most, NUMBERS), np.float32)
        if is_new:
            self.version = new_version()

    def fine_camera(self, level):
        """Return the camera of the finer picture and the room of its arrays, columns and rows."""
        return scaled(level, FINE_RESOLUTION), self.fine.picture.shape[1::-1]

    @property
    def lacks(self):
        """Whether the finished frame lacked the finer picture."""
        return self.fine is None and self._seen_share[0] > WORTH_FINE

    def is_amiss(self):
        """Return the same."""
        return self.lacks

    def grow(self):
        """Draw the finer picture from now on if the finished frame lacked it."""
        if self.lacks:
            self.fine = FinePicture(self._splats, self._stream)

    def make_ahead(self):
        """Do nothing: what a frame lacks is known when it is finished."""

    def search(self, seen, size, horizon, camera, stream):
        """Queue the search for the lamps of a level picture, see `Search.launch`."""
        found = self._share, self._many, self._lamps
        self._search.launch(seen, size, horizon, camera, False, found, stream)
        copy_small(self._share, self._seen_share, stream)

    def search_fine(self, horizon, eye, forward, stream):
        """Queue the search in the finer picture, whose lamps count where lamps have much light."""
        fine, found = self.fine, (self._share, self._many, self._lamps)
        camera = fine.rasterizer.lens, eye, forward
        fine.search.launch(
            (fine.picture, fine.depth), fine.rasterizer.size, horizon, camera, True, found, stream
        )

    def dim(self, picture, stream):
        """Queue the dimming of the level picture where it shows lamps."""
        dim_lamps[blocks(*picture.shape[:2]), BLOCK, stream](self._many, picture)

    def add(self, camera, step, ground, level, level_size, field, stream):
        """Queue the sum of the field of mirrored light and the lamps' light."""
        seen = LampView(self._lamps, level.depth, level.lens, level.forward)
        add_lamps[blocks(*field.shape[:2]), BLOCK, stream](
            self._many, camera, step, ground, seen, level_size, field
        )


def shines(scene):
    """Return whether a scene or one of its actors has splats as bright as lamps."""
    return any(may_shine(part.splats) for part in (scene, *scene.actors))
