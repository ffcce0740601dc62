"""Twin of `rainsim.shading.glare`: each pixel adds up what dazzling pixels scatter into it.

The CPU convolves by Fourier transforms. Lamps have few pixels, so that here their list is shorter.
It is in the order of rows and columns: the sums have the same bytes every time.
"""

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda.jit import SIMULATED, cuda, cuda_device, cuda_kernel
from rainsim.cuda.shading.wet_pass import pixel_grid
from rainsim.shading.glare import DAZZLES, spread_kernel

THREADS = 4 if SIMULATED else 32  # of a row, a part of it each
MOST = np.float32(DAZZLES)


@cuda_device
def dazzles(pixel, least):
    """Return whether one of a pixel's colours (3,) exceeds the radiance from which on it glares."""
    return max(pixel[0], pixel[1], pixel[2]) > least


@cuda_kernel
def list_dazzling(picture, brightness, column_out, count_out):
    """List the columns of each row's dazzling pixels; a block for each row.

    picture : float32 device array (height, width, 3)
    brightness : float32
    column_out : int32 device array (height, width). Its first columns are
        written.
    count_out : int32 device array (height,)
    """
    counts = cuda.shared.array(THREADS, np.int32)
    row, lane, width = cuda.blockIdx.x, cuda.threadIdx.x, picture.shape[1]
    begin, end = lane * width // THREADS, (lane + 1) * width // THREADS
    least, count = MOST / brightness, 0
    for i in range(begin, end):
        if dazzles(picture[row, i], least):
            count += 1
    counts[lane] = count
    cuda.syncthreads()
    place = 0
    for k in range(lane):
        place += counts[k]
    for i in range(begin, end):
        if dazzles(picture[row, i], least):
            column_out[row, place] = i
            place += 1
    if lane == THREADS - 1:
        count_out[row] = place


@cuda_kernel
def add_halos(picture, brightness, column, count, spread, dazzling_out):
    """Add to each pixel the light that dazzling pixels scatter into it.

    picture, brightness, column, count. As `list_dazzling` has them.
    spread : float32 device array (height, width). What a pixel scatters into one
        so many rows and columns away.
    dazzling_out : float32 device array (height, width, 3)
    """
    i, j = cuda.grid(2)
    if j >= picture.shape[0] or i >= picture.shape[1]:
        return
    least = MOST / brightness
    red = green = blue = ZERO
    for row in range(count.size):
        share = spread[abs(row - j)]
        for k in range(count[row]):
            there = column[row, k]
            part, pixel = share[abs(there - i)], picture[row, there]
            red += part * max(pixel[0] - least, ZERO)
            green += part * max(pixel[1] - least, ZERO)
            blue += part * max(pixel[2] - least, ZERO)
    here = picture[j, i]
    out = dazzling_out[j, i]
    out[0], out[1], out[2] = here[0] + red, here[1] + green, here[2] + blue


class Glare:
    """The halos of lamps in one frame after another."""

    def __init__(self):
        self._for = self._spread = None

    def added(self, shown, brightness, focal):
        """Queue the sum of a shown picture and its halos; return it.

        shown : float32 device array (height, width, 3)
        brightness : float32
        focal : float [px]
        """
        rows, columns = size = shown.shape[:2]
        if self._for is None or self._for[1] != size:
            self._column = cuda.device_array(size, np.int32)
            self._count = cuda.device_array(rows, np.int32)
            self._dazzling = cuda.device_array(shown.shape, np.float32)
        if self._for != (focal, size):
            self._for, spread = (focal, size), spread_kernel(focal, rows, columns)
            self._spread = cuda.to_device(
                np.ascontiguousarray(spread[rows - 1 :, columns - 1 :], np.float32)
            )
        lists = self._column, self._count
        list_dazzling[rows, THREADS](shown, brightness, *lists)
        add_halos[pixel_grid(size)](shown, brightness, *lists, self._spread, self._dazzling)
        return self._dazzling
