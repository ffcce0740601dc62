"""Mirrored passes on the GPU: the levels at which water stands, and the capture seen from below.

Which mirrors a picture needs is told by the heights of the water that it shows, as on the CPU (see
`rainsim.waterview.mirror_levels`), and the mirrored camera follows from the level: both are worked
out on the device, so that the host need not be asked in the middle of a frame. How many passes lie
in a recorded queue is fixed; when a frame wants more, it is recorded anew and drawn again.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda import project, shading
from rainsim.cuda.jit import cuda, cuda_kernel, pinned
from rainsim.cuda.raster import Rasterizer
from rainsim.optics import HALF, ZERO
from rainsim.render import _pose, mirrored_camera
from rainsim.waterview import LEAST_SHARE, LEVEL_STEP, LEVEL_STEPS, MOST_MIRRORS

BINS = 4096  # of LEVEL_STEP: 8 m of water heights
THREADS = 256
UNUSED = 1e30  # distance of a plane that cuts everything away


@cuda_kernel
def clear_counts(count):
    """Set all counts to zero."""
    i = cuda.grid(1)
    if i < count.size:
        count[i] = 0


@cuda_kernel
def count_heights(hit, coverage, ground_from_camera, eye, lens, first_bin, count_out):
    """Count the pixels that show water of each height."""
    column, row = cuda.grid(2)
    height, width = coverage.shape
    if row >= height or column >= width or coverage[row, column] == ZERO:
        return
    m = ground_from_camera
    a = (np.float32(column) + HALF - lens[2]) / lens[0]
    b = (np.float32(row) + HALF - lens[3]) / lens[1]
    z = eye[2] + hit[row, column] * (m[2, 0] * a + m[2, 1] * b + m[2, 2])
    place = np.int64(math.floor(np.float64(z) / LEVEL_STEP)) - first_bin
    cuda.atomic.add(count_out, min(max(place, 0), BINS - 1), 1)


@cuda_kernel
def choose_levels(count, first_bin, most, everywhere, served_out, wanted_out):
    """Choose mirrors as `rainsim.waterview.mirror_levels` does; one block of THREADS threads.

    served_out : ndarray of shape (most, 3), float64 [m]
        Level, lowest height served and the height from which on not; inverted if not wanted.
    wanted_out : ndarray of shape (1,), int32
        Number of mirrors.
    """
    sums, places = cuda.shared.array(THREADS, np.int64), cuda.shared.array(THREADS, np.int64)
    tid = cuda.threadIdx.x
    lowest, total = np.int64(BINS), np.int64(0)
    for k in range(tid, BINS, THREADS):
        total += count[k]
        if count[k] > 0:
            lowest = min(lowest, np.int64(k))
    sums[tid], places[tid] = total, lowest
    cuda.syncthreads()
    total, lowest = np.int64(0), np.int64(BINS)
    for k in range(THREADS):
        total += sums[k]
        lowest = min(lowest, places[k])
    wanted, left = 0, total
    for mirror in range(most):
        cuda.syncthreads()
        best, at = np.int64(-1), np.int64(BINS)
        for k in range(tid, BINS, THREADS):
            if k >= lowest:
                inside = np.int64(0)
                for j in range(k, min(k + LEVEL_STEPS, BINS)):
                    inside += count[j]
                if inside > best:
                    best, at = inside, np.int64(k)
        sums[tid], places[tid] = best, at
        cuda.syncthreads()
        best, at = np.int64(-1), np.int64(BINS)
        for k in range(THREADS):
            if sums[k] > best or (sums[k] == best and places[k] < at):
                best, at = sums[k], places[k]
        enough = total > 0 and left >= LEAST_SHARE * total and best >= LEAST_SHARE * total
        cuda.syncthreads()
        if tid == 0:
            served_out[mirror, 0] = 0.0
            served_out[mirror, 1], served_out[mirror, 2] = UNUSED, -UNUSED
            if enough and wanted == mirror:
                middle, inside = at, np.int64(0)
                for k in range(at, min(at + LEVEL_STEPS, BINS)):
                    inside += count[k]
                    if 2 * inside >= best:
                        middle = np.int64(k)
                        break
                served_out[mirror, 0] = (first_bin + middle + 0.5) * LEVEL_STEP
                served_out[mirror, 1] = -UNUSED if everywhere else (first_bin + at) * LEVEL_STEP
                top = (first_bin + at + LEVEL_STEPS) * LEVEL_STEP
                served_out[mirror, 2] = UNUSED if everywhere else top
                for k in range(at, min(at + LEVEL_STEPS, BINS)):
                    count[k] = 0
        if enough and wanted == mirror:
            wanted += 1
            left -= best
    if tid == 0:
        wanted_out[0] = wanted


@cuda_kernel
def aim(served, mirror, numbers, eye, now_out, eye_out, range_out):
    """Turn a mirror's level into the numbers of its camera.

    numbers : ndarray of shape (2, project.CAMERA), float64
        Those of the camera mirrored at level 0, and what a metre more adds.
    """
    k = cuda.grid(1)
    level = served[mirror, 0]
    if k < project.REST:
        value = numbers[0, k] + level * numbers[1, k]
        if k == project.PLANE + 3 and served[mirror, 1] > served[mirror, 2]:
            value = UNUSED
        now_out[k] = np.float32(value)
        if 8 <= k < 12:  # the third row of the view matrix
            now_out[project.REST + k - 8] = np.float32(value - np.float64(np.float32(value)))
    if k == 0:
        eye_out[0], eye_out[1] = eye[0], eye[1]
        eye_out[2] = np.float32(2.0 * level - np.float64(eye[2]))
        range_out[mirror, 0] = np.float32(level)
        range_out[mirror, 1] = np.float32(served[mirror, 1])
        range_out[mirror, 2] = np.float32(served[mirror, 2])


class _MirroredRasterizer(Rasterizer):
    """A rasterizer whose camera is aimed on the device."""

    def aim_by(self, queue):
        """Let queue(now) put the camera's numbers into a device array, at each launch."""
        self._aim = queue

    def _bring_numbers(self):
        self._aim(self._now)


class Mirrors:
    """The wet capture as cameras mirrored at the levels of the water see it.

    Parameters
    ----------
    renderer : rainsim.cuda.frame.Renderer
        Owns the buffers of the picture itself.
    name : {"auto", "mirror", "ssr"}
        Of the reflections: "mirror" takes one level for all water, "ssr" none.

    Attributes
    ----------
    passes : int
        That a queue holds.
    picture : device array of shape (most, height, width, 3), float32
    depth : device array of shape (most, height, width), float32 [m]
    range : device array of shape (most, 3), float32 [m]
        Level of each mirror and the heights from which and below which water looks into it.
    """

    def __init__(self, renderer, name):
        self.renderer, self.stream, self.name = renderer, renderer.stream, name
        self.most = {"auto": MOST_MIRRORS, "mirror": 1, "ssr": 0}[name]
        self.passes = 0
        self._first_bin = math.floor(float(renderer.terrain.bed.min()) / LEVEL_STEP) - 8
        self._count = cuda.device_array(BINS, np.int32)
        rows = max(self.most, 1)
        self._served = cuda.device_array((rows, 3), np.float64)
        empty = np.tile(np.array([0, UNUSED, -UNUSED], np.float32), (rows, 1))
        self.range = cuda.to_device(empty)
        self._wanted, self._wanted_seen = cuda.device_array(1, np.int32), pinned(1, np.int32)
        self._numbers = cuda.device_array((2, project.CAMERA), np.float64)
        self._numbers_host = pinned((2, project.CAMERA), np.float64)
        self._eye = cuda.device_array(3, np.float32)
        self._turn, self._turn_host = cuda.device_array((3, 3), np.float32), pinned((3, 3), "f4")
        self._rasterizers = []
        self.room_for(1, 1)

    def room_for(self, height, width):
        """Allocate the pictures."""
        rows = max(self.most, 1)
        self._size = height, width
        self.picture = cuda.device_array((rows, height, width, 3), np.float32)
        self.depth = cuda.device_array((rows, height, width), np.float32)
        self._clearance = cuda.device_array((height, width), np.float32)

    def update(self, camera, near, frame):
        """Take over the camera that is to be mirrored."""
        if not self.most:
            return
        tables = []
        for level in (0.0, 1.0):
            plane, mirrored = mirrored_camera(camera, frame, level)
            tables.append(self.renderer.rasterizer.numbers_of(mirrored, near, plane))
        self._numbers_host[0] = tables[0]
        self._numbers_host[1] = tables[1] - tables[0]
        self._numbers_host[1, project.SCALE :] = 0
        self._turn_host[...] = _pose(frame.camera_in_ground(mirrored))[0]
        for rasterizer in self._rasterizers:
            rasterizer.update(mirrored, near, plane)
        self._mirrored = mirrored, near, plane

    @property
    def queue(self):
        """What a recorded queue depends on."""
        return self.passes, *(rasterizer.queue for rasterizer in self._rasterizers)

    def grow(self):
        """Make room for what the finished frame wanted; return whether it lacked anything."""
        lacking = False
        wanted = min(int(self._wanted_seen[0]), self.most)
        while self.passes < wanted:
            rasterizer = _MirroredRasterizer(self.renderer.rasterizer.splats, self.stream)
            rasterizer.update(*self._mirrored)
            rasterizer.aim_by(self._aim(self.passes))
            self._rasterizers.append(rasterizer)
            self.passes += 1
            lacking = True
        for rasterizer in self._rasterizers:
            if rasterizer.overflows():
                rasterizer.make_room()
                lacking = True
        return lacking

    def make_ahead(self):
        """Make room where little is left; return whether any was made."""
        tight = [rasterizer for rasterizer in self._rasterizers if rasterizer.is_tight()]
        for rasterizer in tight:
            rasterizer.make_room()
        return bool(tight)

    def _aim(self, mirror):
        def queue(now):
            aim[1, 64, self.stream](
                self._served, mirror, self._numbers, self.renderer.numbers["eye"], now, self._eye,
                self.range,
            )  # fmt: skip

        return queue

    def launch(self, hit, coverage):
        """Queue the choice of levels and the passes."""
        if not self.most:
            return
        n, grid = self.renderer.numbers, shading.blocks(*self._size)
        clear_counts[BINS // THREADS, THREADS, self.stream](self._count)
        count_heights[grid, shading.BLOCK, self.stream](
            hit, coverage, n["turn"], n["eye"], n["lens"], self._first_bin, self._count
        )
        choose_levels[1, THREADS, self.stream](
            self._count, self._first_bin, self.most, self.name == "mirror", self._served,
            self._wanted,
        )  # fmt: skip
        self._wanted.copy_to_host(self._wanted_seen, stream=self.stream)
        self._numbers.copy_to_device(self._numbers_host, stream=self.stream)
        self._turn.copy_to_device(self._turn_host, stream=self.stream)
        for mirror, rasterizer in enumerate(self._rasterizers):
            rasterizer.launch()
            self.renderer.grade(
                rasterizer.layers, self._turn, self._eye, self.picture[mirror],
                self.depth[mirror], self._clearance,
            )  # fmt: skip
