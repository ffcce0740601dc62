"""Mirrored passes on the GPU: the levels at which water stands, and the capture seen from below.

The heights of the water in a picture decide which mirrors it needs, as on the CPU (see
`reflection.mirror_choice.mirror_levels`), and the mirrored camera follows from the level: the
device works out both, so that no frame waits for the host. A recorded queue holds a fixed number of
passes; when a frame needs more, the queue is recorded with more and the frame drawn again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from rainsim.cuda import free_memory
from rainsim.cuda.driver import Event
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel
from rainsim.cuda.lod.paged import ChunkPicture
from rainsim.cuda.raster import Rasterizer
from rainsim.cuda.reflection.mirror_choice import THREADS, UNUSED, LevelChoice
from rainsim.cuda.shading.wet_pass import grade_layers
from rainsim.cuda.splatting import project
from rainsim.numerics.mipmap import COARSEST, coarse_shape, mean_of_four, top_of
from rainsim.reflection.mirror_choice import merged_cells
from rainsim.reflection.water_pass import WINDOW_SLOPE, WINDOW_STEP, mirror_window
from rainsim.scene.cameras import cropped, mirror_at, mirrored_camera
from rainsim.splatting.project import FRUSTUM_MARGIN

SQUARE_CELLS = 1 << (COARSEST - 1)  # of half the resolution in one of the coarsest
TWICE_SLOPE = 2 * WINDOW_SLOPE
MARGIN = float(FRUSTUM_MARGIN)
SPARE = 1.5  # times the usual room, after a picture that had too little: mirrors change fast
SPARED = 0.1  # of the free memory that a pass may take to be drawn beside others


class MirrorArrays(NamedTuple):
    """Mirrored pictures of all mirror levels, as device arrays."""

    # (k, 3) float32 [m]: level of each mirror and the heights from which and below which water
    # looks into it; water at other heights is marched.
    range: object
    window: object  # (6,) float32: lens, columns and rows [px] of all pictures
    ground_from_camera: object  # (3, 3) float32, of the mirrored camera: holds a reflection
    picture: object  # (k, rows, columns, 3) float32
    coarse: object  # (k, rows, columns // 2, 3) float32, see numerics.mipmap.coarsened
    depth: object  # (k, rows, columns) float32 [m]


@cuda_device
def mirror_of(mirror_range, z):
    """Return which mirror serves water at height z [m]; -1: none."""
    for k in range(mirror_range.shape[0]):
        if z >= mirror_range[k, 1] and z < mirror_range[k, 2]:
            return k
    return -1


@cuda_device
def window_edge(pixel, reach, step):
    """Return the last multiple of WINDOW_STEP up to `reach` before a pixel (after: step -1)."""
    return step * math.floor((step * pixel - reach) / WINDOW_STEP) * WINDOW_STEP


@cuda_kernel
def aim(served, mirror, numbers, step, eye, extent, now_out, eye_out, range_out, window_out):
    """Turn a mirror's level and the water's extent into the numbers of its camera.

    numbers : ndarray of shape (2, project.CAMERA), float64
        Those of the camera mirrored at level 0, and what a metre more adds.
    step : ndarray of shape (1,), float64
        Pixels of the picture, along either side, for one of the mirrored picture.
    extent : ndarray of shape (4,), int32
        As `count_heights` left it. What is drawn is a window about it, whole tiles, which reaches
        beyond the picture where ripples look there, as `rainsim.reflection.water_pass` has it.
    window_out : ndarray of shape (6,), float32
        Lens (fx, fy, cx, cy), width and height of the mirrored picture [px].
    """
    k = cuda.threadIdx.x
    level = served[mirror, 0]
    unused = served[mirror, 1] > served[mirror, 2]
    fx, fy = numbers[0, project.LENS], numbers[0, project.LENS + 1]
    across, down = TWICE_SLOPE * fx, TWICE_SLOPE * fy
    left, top = window_edge(extent[0], across, 1), window_edge(extent[1], down, 1)
    width = window_edge(extent[2] + 1, across, -1) - left
    height = window_edge(extent[3] + 1, down, -1) - top
    cx, cy = numbers[0, project.LENS + 2] - left, numbers[0, project.LENS + 3] - top
    if unused or extent[2] < 0:
        width, height = 0.0, 0.0
    share = 1.0 / step[0]
    fx, fy, cx, cy = share * fx, share * fy, share * cx, share * cy
    width, height = share * width, share * height
    if k < project.REST:
        value = numbers[0, k] + level * numbers[1, k]
        if k == project.PLANE + 3 and unused:
            value = UNUSED
        elif k == project.LENS:
            value = fx
        elif k == project.LENS + 1:
            value = fy
        elif k == project.LENS + 2:
            value = cx
        elif k == project.LENS + 3:
            value = cy
        elif k == project.NEAR + 1:
            value = width
        elif k == project.NEAR + 2:
            value = height
        elif k == project.LIMITS:
            value = (-cx - MARGIN * width) / fx
        elif k == project.LIMITS + 1:
            value = (width - cx + MARGIN * width) / fx
        elif k == project.LIMITS + 2:
            value = (-cy - MARGIN * height) / fy
        elif k == project.LIMITS + 3:
            value = (height - cy + MARGIN * height) / fy
        now_out[k] = np.float32(value)
        if 8 <= k < 12:  # the third row of the view matrix
            now_out[project.REST + k - 8] = np.float32(value - np.float64(np.float32(value)))
    if k == 0:
        eye_out[0], eye_out[1] = eye[0], eye[1]
        eye_out[2] = np.float32(2.0 * level - np.float64(eye[2]))
        range_out[mirror, 0] = np.float32(level)
        range_out[mirror, 1] = np.float32(served[mirror, 1])
        range_out[mirror, 2] = np.float32(served[mirror, 2])
        if not unused:
            window_out[0], window_out[1] = np.float32(fx), np.float32(fy)
            window_out[2], window_out[3] = np.float32(cx), np.float32(cy)
            window_out[4], window_out[5] = np.float32(width), np.float32(height)


@cuda_kernel
def coarsen(window, picture, coarse_out):
    """Write all coarser resolutions of a picture's window; see `rainsim.numerics.mipmap.coarsened`.

    A block of threads takes a square that is one cell of the coarsest resolution.
    """
    cells = cuda.shared.array((SQUARE_CELLS, SQUARE_CELLS, 3), np.float32)
    tid = cuda.threadIdx.x
    width, height = int(window[4]), int(window[5])
    side = SQUARE_CELLS
    for level in range(1, COARSEST + 1):
        top, apart = top_of(height, level), 1 << (level - 1)
        for k in range(tid, side * side, THREADS):
            y, x = k // side, k % side
            row, column = cuda.blockIdx.y * side + y, cuda.blockIdx.x * side + x
            if row < height >> level and column < width >> level:
                # A finer cell lies where the first of those that it is the mean of has lain.
                j, i = y * apart, x * apart
                for c in range(3):
                    if level == 1:
                        value = mean_of_four(picture, 2 * row, 2 * column, 1, c)
                    else:
                        value = mean_of_four(cells, j, i, apart >> 1, c)
                    cells[j, i, c] = value
                    coarse_out[top + row, column, c] = value
        cuda.syncthreads()
        side //= 2


class MirrorPass(NamedTuple):
    """A mirrored picture's rasterizer, stream and arrays, which no other picture shares.

    rasterizer : Rasterizer
    stream : numba.cuda.stream. That all of its work is queued on.
    eye : float32 device array (3,) [m]. The mirrored camera's place.
    done : Event. When the picture is finished.
    """

    rasterizer: object
    stream: object
    eye: object
    done: object


class Mirrors:
    """The wet capture as cameras mirrored at the levels of the water see it.

    frame : rainsim.cuda.render.device_frame.DeviceFrame. Owns the buffers of the
        picture itself.
    reflections : {"auto", "mirror", "ssr"}. See `LevelChoice`.
    arrays : MirrorArrays. The pictures as kernels take them, one for each pass of
        a queue; only the window is drawn.
    chunks : ChunkPicture or None. What all passes draw of a capture in chunks.
    """

    def __init__(self, frame, reflections):
        self._frame, self._stream = frame, frame.stream
        self._levels = LevelChoice(reflections, float(frame.conductor.ground.terrain.bed.min()))
        self._now = FrameUniforms(frame.stream, {
            "camera": ((2, project.CAMERA), np.float64), "turn": ((3, 3), np.float32),
            "step": ((1,), np.float64),
        })  # fmt: skip
        empty = np.tile(np.array([0, UNUSED, -UNUSED], np.float32), (max(self._levels.most, 1), 1))
        window = np.array([1, 1, 0, 0, 1, 1], np.float32)
        self.arrays = MirrorArrays(
            cuda.to_device(empty), cuda.to_device(window), self._now["turn"], None, None, None
        )
        ground = frame.conductor.wet_scene.frame
        self._plane, self._flip = mirror_at(ground, 0.0)
        self._rise = 2 / ground.meters_per_unit * ground.up
        self._forked = Event()
        self._passes = []  # `MirrorPass`
        self._mirrored = None  # what the rasterizers are updated with
        self.chunks, paged = None, frame.conductor.wet_scene.capture.paged
        if paged is not None and self._levels.most:
            self.chunks = ChunkPicture(
                paged.whole, frame.rasterizer.splats, lambda: self._rasterizers
            )
        self.forget_size()

    def forget_size(self):
        """Let go of the pictures: the camera's are of another size from now on."""
        self._allocate(1, 1)

    def _allocate(self, rows, columns):
        passes, f4 = max(len(self._passes), 1), np.float32
        self.arrays = self.arrays._replace(picture=None, coarse=None, depth=None)
        self._clearance = None  # freed before more is asked for
        self.arrays = self.arrays._replace(
            picture=cuda.device_array((passes, rows, columns, 3), f4),
            coarse=cuda.device_array((passes, *coarse_shape(rows, columns)), f4),
            depth=cuda.device_array((passes, rows, columns), f4),
        )
        self._clearance = cuda.device_array((passes, rows, columns), f4)
        self._version = new_version()

    def update(self, camera, capture, step):
        """Take over the camera that is mirrored in a `DrawnCapture`, and the `mirror_step`."""
        if not self._levels.most:
            return
        if self.chunks is not None and self._passes:
            self._choose_chunks(camera, capture, step)
        frame, largest = capture.frame, largest_window(camera)
        plane, mirrored = self._plane, camera.posed(camera.camera_from_world @ self._flip)
        mirrored = replace(mirrored, width=largest[1], height=largest[0])
        turn = mirrored.camera_from_world[:3, :3]
        numbers = self._now.host["camera"]
        numbers[0] = self._frame.rasterizer.numbers_of(
            mirrored, capture.near, plane=plane, detail=merged_cells(capture.merge, step)
        )
        # A metre higher the mirrored camera is two metres higher, and the plane one.
        numbers[1, project.VIEW + 3 : project.EYE : 4] = turn @ -self._rise
        numbers[1, project.EYE : project.EYE + 3] = 0 if camera.orthographic else self._rise
        numbers[1, project.PLANE + 3] = 1.0 / frame.meters_per_unit
        self._now.host["step"][0] = step
        self._now.host["turn"][...] = frame.rotation @ turn.T
        self._mirrored = mirrored, capture.near, plane
        if self._passes and self.arrays.depth.shape != (len(self._passes), *largest):
            self._allocate(*largest)
        for rasterizer in self._rasterizers:
            rasterizer.update(*self._mirrored)

    def _choose_chunks(self, camera, capture, step):
        """Choose the chunks of all passes before the levels are known: as from a usual level.

        The window is the largest, and of what lies below the levels only what is below the ground
        is left out.
        """
        bed = self._frame.conductor.ground.terrain.bed
        plane, _ = mirrored_camera(camera, capture.frame, float(bed.min()))
        _, mirrored = mirrored_camera(camera, capture.frame, float(np.median(bed)))
        shape = camera.height, camera.width
        lens = camera.fx, camera.fy, camera.cx, camera.cy
        ends = np.array([0, camera.height * camera.width - 1])
        mirrored = cropped(mirrored, mirror_window(ends, shape, lens))
        mirrored = mirrored.resized(mirrored.width // step, mirrored.height // step)
        self.chunks.choose(self._frame.pending, mirrored, capture.near, plane, leading=True)

    @property
    def _rasterizers(self):
        return [each.rasterizer for each in self._passes]

    @property
    def apart(self):
        """Whether the passes share no memory with the picture itself, so may be drawn beside it."""
        own = self._frame.rasterizer.workspace
        return all(rasterizer.workspace is not own for rasterizer in self._rasterizers)

    @property
    def queue(self):
        """The values that a recorded queue depends on."""
        return self._version, *(rasterizer.queue for rasterizer in self._rasterizers)

    @property
    def lacks(self):
        """Whether the frame wanted more passes, or more room in them, than there are."""
        wanted = self._levels.wanted
        return len(self._passes) < wanted or any([each.lacks for each in self._rasterizers])

    def grow(self):
        """Make the room that the finished frame wanted and lacked; the device must be idle."""
        lacking = len(self._passes) < self._levels.wanted
        while len(self._passes) < self._levels.wanted:
            self._passes.append(self._new_pass())
        if lacking:
            mirrored = self._mirrored[0]
            self._allocate(mirrored.height, mirrored.width)
            for rasterizer in self._rasterizers:
                rasterizer.update(*self._mirrored)
        for rasterizer in self._rasterizers:
            rasterizer.grow(SPARE)

    def make_ahead(self):
        """Make room where little is left, and free the room that pictures in turn left unused."""
        for rasterizer in self._rasterizers:
            rasterizer.make_ahead()

    def _new_pass(self):
        """Return one more pass: beside the others, with memory of its own, if there is plenty."""
        own, stream, eye = self._frame.rasterizer, self._stream, cuda.device_array(3, np.float32)
        roomy = own.workspace.size < SPARED * free_memory()
        if roomy and self._passes:
            stream = cuda.stream()
        rasterizer = Rasterizer(
            own.splats, stream, workspace=None if roomy else own.workspace,
            first_room=own.room.entries, leading=True,
            aim=partial(self._aim, len(self._passes), stream, eye),
        )  # fmt: skip
        return MirrorPass(rasterizer, stream, eye, Event())

    def _aim(self, mirror, stream, eye, now):
        aim[1, 64, stream](
            self._levels.served, mirror, self._now["camera"], self._now["step"],
            self._frame.uniforms["eye"], self._levels.extent, now, eye, self.arrays.range,
            self.arrays.window,
        )  # fmt: skip

    def launch(self, stream):
        """Queue the choice of levels and the passes, on the frame's stream."""
        if not self._levels.most:
            return
        frame, arrays = self._frame, self.arrays
        self._levels.launch(frame["hit"], frame["coverage"], frame.view, stream)
        self._now.send()
        self._forked.record(stream)
        size = arrays.depth.shape[1:]
        rows, columns = (-(-side // (2 * SQUARE_CELLS)) for side in size)
        for mirror, (rasterizer, lane, eye, done) in enumerate(self._passes):
            if lane is not stream:
                self._forked.wait(lane)
            rasterizer.launch()
            grade_layers(
                frame, rasterizer, size, arrays.ground_from_camera, eye, arrays.picture[mirror],
                arrays.depth[mirror], self._clearance[mirror], self._clearance[0, :0], lane,
            )  # fmt: skip
            coarsen[(columns, rows), THREADS, lane](
                arrays.window, arrays.picture[mirror], arrays.coarse[mirror]
            )
            if lane is not stream:
                done.record(lane)
        for each in self._passes:
            if each.stream is not stream:
                each.done.wait(stream)


def largest_window(camera):
    """Return rows and columns of the largest window that any water in a picture asks for."""
    sizes = []
    for pixels, focal in ((camera.height, camera.fy), (camera.width, camera.fx)):
        reach = TWICE_SLOPE * focal
        first = math.floor(-reach / WINDOW_STEP)
        sizes.append(int(math.ceil((pixels + reach) / WINDOW_STEP) - first) * WINDOW_STEP)
    return tuple(sizes)
