"""Twin of `rainsim.reflection.mirror_choice.mirror_levels`: which levels water is mirrored at."""

from __future__ import annotations

import math

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.jit import cuda, cuda_kernel, pinned
from rainsim.cuda.small_copies import copy_small
from rainsim.reflection.mirror_choice import LEAST_SHARE, LEVEL_STEP, LEVEL_STEPS, MOST_MIRRORS
from rainsim.scene.view import pixel_ray, view_from

BINS = 4096  # of LEVEL_STEP: 8 m of water heights
EDGES = BINS + 1
THREADS = 256
OWN_BINS = BINS // THREADS  # of a thread
COUNT_ROWS = 8  # that a block of threads counts
NONE = 1 << 30  # first column of water where there is none
UNUSED = 1e30  # distance of a plane that cuts everything away


@cuda_kernel
def clear_counts(count, extent):
    """Set all counts to zero and the water's extent to none."""
    i = cuda.grid(1)
    if i < count.size:
        count[i] = 0
    if i < 2:
        extent[i] = NONE
    elif i < 4:
        extent[i] = -1


@cuda_kernel
def count_heights(hit, coverage, camera, first_bin, count_out, extent_out):
    """Count the pixels that show water of each height and find the rectangle that holds them.

    A block of THREADS threads takes COUNT_ROWS rows of as many columns; its counts are added up in
    shared memory, and each thread adds runs of equal heights at once: level water is one bin.

    camera : View
    extent_out : ndarray of shape (4,), int32
        First column and row, last column and row.
    """
    bins = cuda.shared.array(BINS, np.int32)
    tid = cuda.threadIdx.x
    for k in range(tid, BINS, THREADS):
        bins[k] = 0
    cuda.syncthreads()
    height, width = coverage.shape
    column = cuda.blockIdx.x * THREADS + tid
    first = cuda.blockIdx.y * COUNT_ROWS
    view = view_from(camera)
    upper, lower, run, at = height, -1, 0, 0
    if column < width:
        for row in range(first, min(first + COUNT_ROWS, height)):
            if coverage[row, column] == ZERO or hit[row, column] < ZERO:  # on a sloping top
                continue
            z = view.eye[2] + hit[row, column] * pixel_ray(view, row, column)[2]
            place = np.int64(math.floor(np.float64(z) / LEVEL_STEP)) - first_bin
            place = min(max(place, 0), BINS - 1)
            if place != at:
                if run > 0:
                    cuda.atomic.add(bins, at, run)
                run, at = 0, place
            run += 1
            upper, lower = min(upper, row), row
        if run > 0:
            cuda.atomic.add(bins, at, run)
            cuda.atomic.min(extent_out, 0, column)
            cuda.atomic.min(extent_out, 1, upper)
            cuda.atomic.max(extent_out, 2, column)
            cuda.atomic.max(extent_out, 3, lower)
    cuda.syncthreads()
    for k in range(tid, BINS, THREADS):
        if bins[k] > 0:
            cuda.atomic.add(count_out, k, bins[k])


# long: one block of threads, whose steps share its memory and wait for one another
@cuda_kernel
def choose_levels(count, first_bin, most, everywhere, served_out, wanted_out):
    """Choose mirrors as `mirror_levels` does; one block of THREADS threads.

    served_out : ndarray of shape (most, 3), float64 [m]
        Level, lowest height served and the height from which on not; inverted if not wanted.
    wanted_out : ndarray of shape (1,), int32
        Number of mirrors.
    """
    # Counts up to a bin, its own excluded; then sums of runs of bins, or what to reduce.
    before = cuda.shared.array(EDGES, np.int32)
    sums = cuda.shared.array(THREADS, np.int32)
    places = cuda.shared.array(THREADS, np.int32)  # a line each: the simulator knows them by it
    tid = cuda.threadIdx.x
    first = tid * OWN_BINS
    wanted, left, total, lowest = 0, 0, 0, 0
    for mirror in range(most):
        own = 0
        for k in range(first, first + OWN_BINS):
            own += count[k]
        sums[tid] = own
        cuda.syncthreads()
        reach = 1
        while reach < THREADS:  # inclusive sums over threads
            other = sums[tid - reach] if tid >= reach else 0
            cuda.syncthreads()
            sums[tid] += other
            cuda.syncthreads()
            reach *= 2
        running = sums[tid] - own
        for k in range(first, first + OWN_BINS):
            before[k] = running
            running += count[k]
        if tid == THREADS - 1:
            before[BINS] = running
        cuda.syncthreads()
        if mirror == 0:
            left = total = before[BINS]
            low, high = 0, BINS  # the lowest bin that is not empty, by bisection
            while low < high:
                middle = (low + high) // 2
                if before[middle + 1] > 0:
                    high = middle
                else:
                    low = middle + 1
            lowest = low
        best, at = -1, BINS
        for k in range(max(first, lowest), first + OWN_BINS):
            inside = before[min(k + LEVEL_STEPS, BINS)] - before[k]
            if inside > best:
                best, at = inside, k
        sums[tid], places[tid] = best, at
        cuda.syncthreads()
        half = THREADS // 2
        while half > 0:
            if tid < half:
                better = sums[tid + half] > sums[tid]
                better |= sums[tid + half] == sums[tid] and places[tid + half] < places[tid]
                if better:
                    sums[tid], places[tid] = sums[tid + half], places[tid + half]
            cuda.syncthreads()
            half //= 2
        best, at = sums[0], places[0]
        enough = total > 0 and left >= LEAST_SHARE * total and best >= LEAST_SHARE * total
        enough = enough and wanted == mirror
        if tid == 0:
            served_out[mirror, 0] = 0.0
            served_out[mirror, 1], served_out[mirror, 2] = UNUSED, -UNUSED
            if enough:
                middle = at
                while 2 * (before[middle + 1] - before[at]) < best:
                    middle += 1
                served_out[mirror, 0] = (first_bin + middle + 0.5) * LEVEL_STEP
                served_out[mirror, 1] = -UNUSED if everywhere else (first_bin + at) * LEVEL_STEP
                top = (first_bin + at + LEVEL_STEPS) * LEVEL_STEP
                served_out[mirror, 2] = UNUSED if everywhere else top
        if enough:
            if at + tid < min(at + LEVEL_STEPS, BINS):
                count[at + tid] = 0
            wanted += 1
            left -= best
        elif wanted == mirror:  # no other will be wanted
            for k in range(mirror + 1 + tid, most, THREADS):
                served_out[k, 0], served_out[k, 1], served_out[k, 2] = 0.0, UNUSED, -UNUSED
            break
        cuda.syncthreads()
    if tid == 0:
        wanted_out[0] = wanted


class LevelChoice:
    """The levels at which the water of one picture after another is mirrored.

    reflections : {"auto", "mirror", "ssr"}. "mirror" takes one level for all
        water, "ssr" none.
    lowest : float [m]. Of the ground that carries the water.
    most : int. Levels that a picture may have.
    served : float64 device array (most or 1, 3) [m]. See `choose_levels`.
    extent : int32 device array (4,). See `count_heights`.
    """

    def __init__(self, reflections, lowest):
        self.most = {"auto": MOST_MIRRORS, "mirror": 1, "ssr": 0}[reflections]
        self._everywhere = reflections == "mirror"
        self._first_bin = math.floor(lowest / LEVEL_STEP) - 8
        self._count = cuda.device_array(BINS, np.int32)
        self.served = cuda.device_array((max(self.most, 1), 3), np.float64)
        self.extent = cuda.device_array(4, np.int32)
        self._wanted, self._wanted_seen = cuda.device_array(1, np.int32), pinned(1, np.int32)

    @property
    def wanted(self):
        """Number of levels that the finished picture asked for, at most `most`."""
        return min(int(self._wanted_seen[0]), self.most)

    def launch(self, hit, coverage, camera, stream):
        """Queue the choice; `hit` and `coverage` as `ray_water.meet_water` left them."""
        height, width = coverage.shape
        clear_counts[BINS // THREADS, THREADS, stream](self._count, self.extent)
        count_heights[(-(-width // THREADS), -(-height // COUNT_ROWS)), THREADS, stream](
            hit, coverage, camera, self._first_bin, self._count, self.extent
        )
        choose_levels[1, THREADS, stream](
            self._count, self._first_bin, self.most, self._everywhere, self.served, self._wanted
        )
        copy_small(self._wanted, self._wanted_seen, stream)
