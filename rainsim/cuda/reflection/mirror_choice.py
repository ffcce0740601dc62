"""Twin of `rainsim.reflection.mirror_choice`: at which heights water stands, counted on the device.

The host chooses the levels by the counts, as for the CPU.
"""

import math

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.driver import fetch, send
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.reflection.mirror_choice import LEVEL_STEP, LEVEL_STEPS, MOST_MIRRORS, mirror_levels
from rainsim.scene.view import pixel_ray

BINS = 4096  # of LEVEL_STEP: 8 m of water heights
THREADS = 256
COUNT_ROWS = 8  # that a block of threads counts
NONE = 1 << 30  # first column of water where there is none
NO_COUNTS = np.array([0] * BINS + [NONE, NONE, -1, -1], np.int32)
EVERYWHERE = 1e30  # m; the one mirror of "mirror" serves water up to there


@cuda_kernel
def count_heights(hit, coverage, view, first_bin, count_out):
    """Count the pixels that show water of each height and find the rectangle that holds them.

    A block of THREADS threads takes COUNT_ROWS rows of as many columns; its counts are added up in
    shared memory, and each thread adds runs of equal heights at once: level water is one bin.

    count_out : int32 device array (BINS + 4,). Behind the counts the water's
        first column and row, last column and row.
    """
    bins = cuda.shared.array(BINS, np.int32)
    tid = cuda.threadIdx.x
    for k in range(tid, BINS, THREADS):
        bins[k] = 0
    cuda.syncthreads()
    height, width = coverage.shape
    column = cuda.blockIdx.x * THREADS + tid
    first = cuda.blockIdx.y * COUNT_ROWS
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
            cuda.atomic.min(count_out, BINS, column)
            cuda.atomic.min(count_out, BINS + 1, upper)
            cuda.atomic.max(count_out, BINS + 2, column)
            cuda.atomic.max(count_out, BINS + 3, lower)
    cuda.syncthreads()
    for k in range(tid, BINS, THREADS):
        if bins[k] > 0:
            cuda.atomic.add(count_out, k, bins[k])


class LevelChoice:
    """The levels at which the water of one picture after another is mirrored.

    lowest : float [m]. Of the ground that carries the water.
    """

    def __init__(self, lowest):
        self._first_bin = math.floor(lowest / LEVEL_STEP) - 8
        self._counts = cuda.device_array(len(NO_COUNTS), np.int32)

    def choose(self, hit, coverage, view, name):
        """Return the levels, and where water is seen; `group_levels` shares out likewise; waits.

        hit, coverage : device array. As `ray_water.meet_water` left them.
        view : View. Of the camera.
        name : {"auto", "mirror"}. "mirror" takes one level for all water.
        Returns levels : list of tuple of float [m]. The level of each mirror, and
            the heights from which on and below which water looks into it.
            extent : tuple of int [px]. First column and row, last column and row.
        """
        height, width = coverage.shape
        counts = self._counts
        send(counts, NO_COUNTS)
        count_heights[(-(-width // THREADS), -(-height // COUNT_ROWS)), THREADS](
            hit, coverage, view, self._first_bin, counts
        )
        seen = fetch(counts)
        filled, extent, levels = np.flatnonzero(seen[:BINS]), tuple(seen[BINS:].tolist()), []
        if not len(filled):
            return levels, extent
        count, lowest = seen[filled[0] : filled[-1] + 1], self._first_bin + int(filled[0])
        for first, middle in mirror_levels(count, MOST_MIRRORS if name == "auto" else 1):
            low, high = (lowest + first + k for k in (0, LEVEL_STEPS))
            served = (low * LEVEL_STEP, high * LEVEL_STEP)
            if name == "mirror":
                served = -EVERYWHERE, EVERYWHERE
            levels.append(((lowest + middle + 0.5) * LEVEL_STEP, *served))
        return levels, extent
