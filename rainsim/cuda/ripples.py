"""Rings on water on a CUDA device: twin of `rainsim.ripples.RippleTile`.

The tile's spectrum is evolved as on the CPU. Two real maps make one complex one, so that a frame
takes one transform for each two parts of the interval and one for both slopes. A block transforms a
row in shared memory and writes it as a column; twice that is a transform in two dimensions.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.cuda.account import block_sum
from rainsim.cuda.drops import PUSH_UNIT
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.errors import ParameterError
from rainsim.ripples import _LONGEST_STEP

MOST = 256  # cells along a side of the tile
LEVELS = 4  # resolutions, each half of the one before
THREADS = 32 if SIMULATED else 128
_ZERO, _HALF, _QUARTER = np.float32(0), np.float32(0.5), np.float32(0.25)


@cuda.jit(device=True)
def _transform(re, im, cosines, sines, n, sign):
    """Transform the row in re[0], im[0] (Stockham, radix 2); return which half holds the result.

    One thread for each two numbers.
    """
    lane, half = cuda.threadIdx.x, n // 2
    source, m = 0, 1
    while m < n:
        k = lane & (m - 1)
        turn = lane - k
        c, s = cosines[turn], sign * sines[turn]
        a, b = re[source, lane], im[source, lane]
        p, q = re[source, lane + half], im[source, lane + half]
        at, target = lane + turn, 1 - source
        re[target, at], im[target, at] = a + p, b + q
        p, q = a - p, b - q
        re[target, at + m], im[target, at + m] = c * p - s * q, c * q + s * p
        cuda.syncthreads()
        source, m = target, m * 2
    return source


@cuda_kernel
def transform_pushes(pushes, cosines, sines, n, re_out, im_out):
    """Transform the rows of maps of momentum, two in one, and blank them; a block for each row.

    Parameters
    ----------
    pushes : device array of shape (2 * maps * n * n,), int64
        Momentum in PUSH_UNIT.
    cosines, sines : device array of shape (n,), float32
        Of full turns over n.
    n : int
    re_out, im_out : device array of shape (maps * n * n,), float32
        Transposed.
    """
    re = cuda.shared.array((2, MOST), np.float32)
    im = cuda.shared.array((2, MOST), np.float32)
    row, which, lane = cuda.blockIdx.x, cuda.blockIdx.y, cuda.threadIdx.x
    for at in range(lane, n, cuda.blockDim.x):
        first = (2 * which * n + row) * n + at
        second = first + n * n
        re[0, at] = np.float32(np.float64(pushes[first]) * PUSH_UNIT)
        im[0, at] = np.float32(np.float64(pushes[second]) * PUSH_UNIT)
        pushes[first], pushes[second] = 0, 0
    cuda.syncthreads()
    source = _transform(re, im, cosines, sines, n, np.float32(-1))
    for at in range(lane, n, cuda.blockDim.x):
        there = (which * n + at) * n + row
        re_out[there], im_out[there] = re[source, at], im[source, at]


@cuda_kernel
def transform(re_in, im_in, cosines, sines, n, sign, re_out, im_out):
    """Transform the rows of complex maps; a block for each row.

    Parameters
    ----------
    re_in, im_in : device array of shape (maps * n * n,), float32
    cosines, sines : device array of shape (n,), float32
        Of full turns over n.
    n : int
    sign : float32
        -1 for forward, 1 for backward; not scaled.
    re_out, im_out : as `re_in`
        Transposed.
    """
    re = cuda.shared.array((2, MOST), np.float32)
    im = cuda.shared.array((2, MOST), np.float32)
    row, which, lane = cuda.blockIdx.x, cuda.blockIdx.y, cuda.threadIdx.x
    for at in range(lane, n, cuda.blockDim.x):
        here = (which * n + row) * n + at
        re[0, at], im[0, at] = re_in[here], im_in[here]
    cuda.syncthreads()
    source = _transform(re, im, cosines, sines, n, sign)
    for at in range(lane, n, cuda.blockDim.x):
        there = (which * n + at) * n + row
        re_out[there], im_out[there] = re[source, at], im[source, at]


@cuda_kernel
def turn(re, im, steps, n, cosine, sine, push, wave, waves_out, re_out, im_out):
    """Evolve all waves over an interval, add its drops, and give the spectrum of the slopes.

    Parameters
    ----------
    re, im : device array of shape (maps * n * n,), float32
        Transforms of the momentum in the parts of the interval, two in one.
    steps, n : int
        Parts of the interval, and cells along a side.
    cosine, sine, push : device array of shape (n * (n // 2 + 1),), float32
        What a wave turns by in a part of the interval, damping included, and what momentum adds.
    wave : device array of shape (n,), float32 [rad/m]
        Wavenumbers along an axis; 0 for the shortest, whose slope is not defined.
    waves_out : device array of shape (4, n * (n // 2 + 1)), float32
        Elevation and the quarter period behind it, real and imaginary parts; modified in place.
    re_out, im_out : device array of shape (n * n,), float32
        Spectrum of slope along x + i slope along y, over n * n.
    """
    wide = n // 2 + 1
    here = cuda.grid(1)
    if here >= n * wide:
        return
    row, column = here // wide, here % wide
    back_row, back_column = (n - row) % n, (n - column) % n
    a, b, p, q = waves_out[0, here], waves_out[1, here], waves_out[2, here], waves_out[3, here]
    c, s, g = cosine[here], sine[here], push[here]
    for which in range((steps + 1) // 2):
        at = (which * n + row) * n + column
        back = (which * n + back_row) * n + back_column
        x, y, z, w = re[at], im[at], re[back], im[back]
        for part in range(min(steps - 2 * which, 2)):
            a, b, p, q = c * a + s * p, c * b + s * q, c * p - s * a, c * q - s * b
            if part == 0:
                p += g * _HALF * (x + z)
                q += g * _HALF * (y - w)
            else:
                p += g * _HALF * (y + w)
                q += g * _HALF * (z - x)
    waves_out[0, here], waves_out[1, here], waves_out[2, here], waves_out[3, here] = a, b, p, q
    kx, ky = wave[column], wave[row]
    scale = np.float32(1.0 / (n * n))
    at = row * n + column
    re_out[at], im_out[at] = -(ky * a + kx * b) * scale, (kx * a - ky * b) * scale
    if 0 < column < n // 2:
        back = back_row * n + back_column
        re_out[back], im_out[back] = (ky * a - kx * b) * scale, -(kx * a + ky * b) * scale


@cuda_kernel
def coarsen(n, slopes0, slopes1, slopes2, slopes3, sums_out):
    """Halve the slopes three times and sum up their squares; a thread for each coarsest cell.

    Parameters
    ----------
    n : int
    slopes0 : device array of shape (2, n, n), float32
    slopes1, slopes2, slopes3 : device arrays of shape (2, n / 2, n / 2) and so on, float32
        Overwritten.
    sums_out : device array of shape (LEVELS, blocks), float64
    """
    room = cuda.shared.array(THREADS, np.float64)
    far = n // 8
    cell = cuda.grid(1)
    sum0, sum1, sum2, sum3 = 0.0, 0.0, 0.0, 0.0
    if cell < 2 * far * far:
        axis, row, column = cell // (far * far), cell // far % far, cell % far
        top = _ZERO
        for j in range(2 * row, 2 * row + 2):
            for i in range(2 * column, 2 * column + 2):
                middle = _ZERO
                for b in range(2 * j, 2 * j + 2):
                    for a in range(2 * i, 2 * i + 2):
                        low = _ZERO
                        for y in range(2 * b, 2 * b + 2):
                            for x in range(2 * a, 2 * a + 2):
                                slope = slopes0[axis, y, x]
                                low += slope
                                sum0 += np.float64(slope * slope)
                        low *= _QUARTER
                        slopes1[axis, b, a] = low
                        middle += low
                        sum1 += np.float64(low * low)
                middle *= _QUARTER
                slopes2[axis, j, i] = middle
                top += middle
                sum2 += np.float64(middle * middle)
        top *= _QUARTER
        slopes3[axis, row, column] = top
        sum3 = np.float64(top * top)
    lane = cuda.threadIdx.x
    sum0, sum1 = block_sum(room, lane, sum0), block_sum(room, lane, sum1)
    sum2, sum3 = block_sum(room, lane, sum2), block_sum(room, lane, sum3)
    if lane == 0:
        block = cuda.blockIdx.x
        sums_out[0, block], sums_out[1, block] = sum0, sum1
        sums_out[2, block], sums_out[3, block] = sum2, sum3


@cuda_kernel
def root_mean_square(sums, n, rms_out):
    """Turn sums of squares into root mean squares; one thread for each level.

    Parameters
    ----------
    sums : device array of shape (LEVELS, blocks), float64
    n : int
        Cells along a side at the finest level.
    rms_out : device array of shape (LEVELS,), float32
    """
    level = cuda.threadIdx.x
    total = 0.0
    for block in range(sums.shape[1]):
        total += sums[level, block]
    cells = n >> level
    rms_out[level] = np.float32(math.sqrt(total / (2.0 * cells * cells)))


class Ripples:
    """A tile of rings on a CUDA device.

    Parameters
    ----------
    tile : RippleTile
        Its state is copied and it is left alone.
    duration : float [s]
        From one frame to the next.
    stream : cuda.stream

    Attributes
    ----------
    size, cells, steps : float [m], int, int
        Of the tile, along a side; parts of the interval in which impacts are put together.
    pushes : device array, int64
        Momentum of drops that fell since, in `drops.PUSH_UNIT`: a map of (cells, cells) for each
        part, one after the other.
    slopes : list of device arrays of shape (2, n, n), float32
        Slopes along x and y at four resolutions, each half of the one before.
    rms : device array of shape (4,), float32
        Root mean square slope along one axis that each level holds.

    Raises
    ------
    ParameterError
        If the tile's cells are no power of two or too many.
    """

    def __init__(self, tile, duration, stream=0):
        n = tile.cells
        if n & (n - 1) or not 8 <= n <= MOST:
            raise ParameterError(
                f"the tile has {n} cells a side; on a CUDA device it must be a power of two from 8 "
                f"to {MOST}"
            )
        self.stream, self.size, self.cells = stream, tile.size, n
        self.steps = max(math.ceil(duration / _LONGEST_STEP - 1e-9), 1)
        self._maps = (self.steps + 1) // 2
        step = duration / self.steps
        shrink, angle = np.exp(-tile._damping * step), tile._omega * step
        wave = np.array(tile._ky[:, 0])
        wave[n // 2] = 0.0
        around = 2 * np.pi * np.arange(n) / n
        tables = (
            shrink * np.cos(angle), shrink * np.sin(angle), tile._push, wave, np.cos(around),
            np.sin(around),
        )  # fmt: skip
        tables = [np.ascontiguousarray(t, dtype=np.float32).reshape(-1) for t in tables]
        *self._turn, self._cosines, self._sines = (cuda.to_device(t, stream) for t in tables)
        parts = tile._eta.real, tile._eta.imag, tile._lag.real, tile._lag.imag
        waves = np.stack([part.reshape(-1) for part in parts]).astype(np.float32)
        self._waves = cuda.to_device(waves, stream)
        self.pushes = cuda.to_device(np.zeros(2 * self._maps * n * n, np.int64), stream)
        maps = np.zeros(self._maps * n * n, np.float32)
        self._maps_on_device = [cuda.to_device(maps, stream) for _ in range(4)]
        levels = [np.zeros((2, n >> k, n >> k), np.float32) for k in range(LEVELS)]
        self.slopes = [cuda.to_device(level, stream) for level in levels]
        self._flat = self.slopes[0].reshape(2 * n * n)
        blocks = -(-2 * (n // 8) ** 2 // THREADS)
        self._sums = cuda.to_device(np.zeros((LEVELS, blocks)), stream)
        self.rms = cuda.to_device(np.zeros(LEVELS, np.float32), stream)

    def launch(self):
        """Queue a frame: waves run on, the drops that fell ring, the slopes follow."""
        n, re, im, other_re, other_im = self.cells, *self._maps_on_device
        tables = self._cosines, self._sines, n
        rows, plane = (n, self._maps), n * n
        transform_pushes[rows, n // 2, self.stream](self.pushes, *tables, re, im)
        forth, back = np.float32(-1), np.float32(1)
        transform[rows, n // 2, self.stream](re, im, *tables, forth, other_re, other_im)
        blocks = -(-n * (n // 2 + 1) // THREADS)
        turn[blocks, THREADS, self.stream](
            other_re, other_im, self.steps, n, *self._turn, self._waves, re, im
        )
        one = n, 1
        transform[one, n // 2, self.stream](re, im, *tables, back, other_re, other_im)
        transform[one, n // 2, self.stream](
            other_re, other_im, *tables, back, self._flat[:plane], self._flat[plane:]
        )
        coarsen[self._sums.shape[1], THREADS, self.stream](n, *self.slopes, self._sums)
        root_mean_square[1, LEVELS, self.stream](self._sums, n, self.rms)
