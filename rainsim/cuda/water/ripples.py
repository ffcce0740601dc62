"""Rings on water on a CUDA device: twin of `rainsim.water.ripples.RippleTile`.

The tile's spectrum is evolved as on the CPU. Two real maps make one complex one, so that a frame
takes one transform for each two parts of the interval, one for both slopes and one for the heights.
A block transforms a row in shared memory and writes it as a column; twice that is a transform in
two dimensions.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.cuda.driver import SentRows
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.errors import ParameterError
from rainsim.reflection.slope_moments import MOMENTS, mean_of_four, place_of, ripple_moments
from rainsim.water.ripples import _LONGEST_STEP, SIZE_MOMENTA, SIZES

MOST = 256  # cells along a side of the tile
THREADS = 32 if SIMULATED else 128
CELLS = (4, 4) if SIMULATED else (32, 4)  # threads of a block that take a cell each
# kg m/s: momentum is summed in whole numbers of it, so that the order of drops does not matter.
PUSH_UNIT = 2.0**-60


class RippleTile(NamedTuple):
    """The periodic tile on which drops ring.

    size : float [m]. Side.
    steps, cells : int. Parts of an interval, and cells along a side.
    """

    size: float
    steps: int
    cells: int


@cuda_kernel
def ring_each(count, drops, tile, pushes_out):
    """Let drops ring on the tile.

    count : int
    drops : float64 device array (room, 4). Place (x, y) [m], momentum [kg m/s], and
        the time since it came down over the interval's length.
    tile : RippleTile
    pushes_out : int64 device array (SIZES * 2 * maps * cells * cells,). Momentum by
        size of the drops, part of the interval (two in a map) and cell of the
        tile, in PUSH_UNIT; added to.
    """
    for n in range(cuda.grid(1), count, cuda.gridsize(1)):
        _ring(drops[n, 0], drops[n, 1], drops[n, 2], drops[n, 3], tile, pushes_out)


@cuda.jit(device=True)
def _ring(x, y, momentum, age, tile, pushes_out):
    """Let a drop ring on the tile; see `ring_each`."""
    push, steps, cells = momentum / PUSH_UNIT, tile.steps, tile.cells
    step = min(max(steps - 1 - int(age * steps), 0), steps - 1)
    for least in SIZE_MOMENTA:
        if momentum >= least:
            step += 2 * ((steps + 1) // 2)
    x, y = x / tile.size, y / tile.size
    x, y = (x - math.floor(x)) * cells, (y - math.floor(y)) * cells
    i, j = int(x), int(y)
    right, up = x - i, y - j
    for side in range(4):
        di, dj = side & 1, side >> 1
        part = (right if di == 1 else 1.0 - right) * (up if dj == 1 else 1.0 - up)
        place = (step * cells + (j + dj) % cells) * cells + (i + di) % cells
        cuda.atomic.add(pushes_out, place, _whole(push * part))


@cuda.jit(device=True)
def _whole(x):
    return np.int64(math.floor(x + 0.5))


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

    pushes : int64 device array (2 * maps * n * n,). Momentum in PUSH_UNIT.
    cosines, sines : float32 device array (n,). Of full turns over n.
    re_out, im_out : float32 device array (maps * n * n,). Transposed.
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

    sign : float32. -1 for forward, 1 for backward; not scaled.
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
def turn(re, im, steps, n, inverse_size, cosine, sine, push, wave, waves_out, re_out, im_out):
    """Evolve all waves over an interval, add its drops, and give spectra of slopes and heights.

    re, im : float32 device array (SIZES * maps * n * n,). Transforms of the
        momentum by size of the drops and part of the interval, two in one.
    cosine, sine : device array of shape (n * (n // 2 + 1),), float32. What a wave
        turns by in a part of the interval, damping included.
    push : device array of shape (SIZES * n * (n // 2 + 1),), float32. What
        momentum adds, by size of the drops.
    wave : float32 device array (n,) [rad/m]. Wavenumbers along an axis; 0 for the
        shortest, whose slope is not defined.
    waves_out : device array of shape (4, n * (n // 2 + 1)), float32. Elevation
        and the quarter period behind it, real and imaginary parts; modified in
        place.
    re_out, im_out : float32 device array (2 * n * n,). Spectra of slope along x +
        i slope along y, and of height over the tile's size; over n * n.
    """
    wide = n // 2 + 1
    here = cuda.grid(1)
    if here >= n * wide:
        return
    row, column = here // wide, here % wide
    back_row, back_column = (n - row) % n, (n - column) % n
    a, b, p, q = waves_out[0, here], waves_out[1, here], waves_out[2, here], waves_out[3, here]
    c, s, maps = cosine[here], sine[here], (steps + 1) // 2
    for step in range(steps):
        a, b, p, q = c * a + s * p, c * b + s * q, c * p - s * a, c * q - s * b
        for size in range(SIZES):
            which, g = size * maps + step // 2, push[size * n * wide + here]
            at = (which * n + row) * n + column
            back = (which * n + back_row) * n + back_column
            x, y, z, w = re[at], im[at], re[back], im[back]
            if step % 2 == 0:
                p += g * HALF * (x + z)
                q += g * HALF * (y - w)
            else:
                p += g * HALF * (y + w)
                q += g * HALF * (z - x)
    waves_out[0, here], waves_out[1, here], waves_out[2, here], waves_out[3, here] = a, b, p, q
    kx, ky = wave[column], wave[row]
    scale = np.float32(1.0 / (n * n))
    at = row * n + column
    re_out[at], im_out[at] = -(ky * a + kx * b) * scale, (kx * a - ky * b) * scale
    # Waves without a slope have no height either, as where heights are found from slopes.
    high, height = n * n + at, scale * inverse_size if kx != ZERO or ky != ZERO else ZERO
    re_out[high], im_out[high] = a * height, b * height
    if 0 < column < n // 2:
        back = back_row * n + back_column
        re_out[n * n + back], im_out[n * n + back] = a * height, -b * height
        re_out[back], im_out[back] = (ky * a - kx * b) * scale, -(kx * a + ky * b) * scale


@cuda_kernel
def lay_moments(re, im, moments_out):
    """Write the moments of the finest resolution; see `reflection.slope_moments.ripple_moments`.

    moments_out : float32 device array (n, n + n // 2, MOMENTS). Its first n
        columns are written.
    """
    i, j = cuda.grid(2)
    n = re.shape[1]
    if j < n and i < n:
        a, b = re[0, j, i], im[0, j, i]
        m = moments_out[j, i]
        m[0], m[1], m[2], m[3], m[4], m[5] = a, b, a * a, b * b, a * b, re[1, j, i]


@cuda_kernel
def halve_moments(level, moments):
    """Write the moments of a level, from 1 up, from those of the level before."""
    i, j = cuda.grid(2)
    n = moments.shape[0]
    if j < n >> level and i < n >> level:
        top, left = place_of(n, level)
        for c in range(MOMENTS):
            moments[top + j, left + i, c] = mean_of_four(moments, n, level, j, i, c)


class Ripples:
    """A tile of rings on a CUDA device.

    tile : RippleTile. Its `steps` are the parts of the interval in which
        impacts are put together.
    pushes : device array, int64. Momentum of drops that fell since, in
        PUSH_UNIT: for each size of drops and each part a map of
        (cells, cells), one after the other.
    moments : float32 device array (n, n + n // 2, MOMENTS). Of slopes and
        heights, see `rainsim.reflection.slope_moments`; of the last `advance`.
    Raises ParameterError if the tile's cells are no power of two or too many.
    """

    def __init__(self, tile, duration):
        n = tile.cells
        if n & (n - 1) or not 8 <= n <= MOST:
            raise ParameterError(
                f"the tile has {n} cells a side; on a CUDA device it must be a power of two from 8 "
                f"to {MOST}"
            )
        steps = max(math.ceil(duration / _LONGEST_STEP - 1e-9), 1)
        self.tile = RippleTile(tile.size, steps, n)
        self._maps = SIZES * ((steps + 1) // 2)
        step = duration / steps
        shrink, angle = np.exp(-tile._damping * step), tile._omega * step
        wave = np.array(tile._ky[:, 0])
        wave[n // 2] = 0.0
        around = 2 * np.pi * np.arange(n) / n
        tables = (
            shrink * np.cos(angle), shrink * np.sin(angle), tile._push, wave, np.cos(around),
            np.sin(around),
        )  # fmt: skip
        tables = [np.ascontiguousarray(t, dtype=np.float32).reshape(-1) for t in tables]
        *self._turn, self._cosines, self._sines = map(cuda.to_device, tables)
        parts = tile._eta.real, tile._eta.imag, tile._lag.real, tile._lag.imag
        waves = np.stack([part.reshape(-1) for part in parts]).astype(np.float32)
        self._waves = cuda.to_device(waves)
        self._drops = SentRows((4,), np.float64)
        self.pushes = cuda.to_device(np.zeros(2 * self._maps * n * n, np.int64))
        maps, flat = np.zeros(self._maps * n * n, np.float32), np.zeros((2, n, n), np.float32)
        self._maps_on_device = [cuda.to_device(maps) for _ in range(4)]
        self._surface = cuda.to_device(flat), cuda.to_device(flat)
        self.moments = cuda.to_device(ripple_moments(tile.slopes()))

    def ring(self, position, momentum, age):
        """Queue the ringing of drops of the host.

        age : array (n,). Time since they came down over that of the frame.
        """
        if len(age):
            count, drops = len(age), self._drops.send(np.column_stack([position, momentum, age]))
            ring_each[-(-count // THREADS), THREADS](count, drops, self.tile, self.pushes)

    def advance(self):
        """Queue a frame of ripples: waves advance, new drops excite rings, slope moments follow."""
        n, re, im, other_re, other_im = self.tile.cells, *self._maps_on_device
        tables = self._cosines, self._sines, n
        rows = n, self._maps
        transform_pushes[rows, n // 2](self.pushes, *tables, re, im)
        forth, back = -ONE, ONE
        transform[rows, n // 2](re, im, *tables, forth, other_re, other_im)
        blocks = -(-n * (n // 2 + 1) // THREADS)
        turn[blocks, THREADS](
            other_re, other_im, self.tile.steps, n, np.float32(1 / self.tile.size), *self._turn,
            self._waves, re, im,
        )  # fmt: skip
        both, surface = (n, 2), [part.reshape(2 * n * n) for part in self._surface]
        transform[both, n // 2](re, im, *tables, back, other_re, other_im)
        transform[both, n // 2](other_re, other_im, *tables, back, *surface)
        lay_moments[_cells(n), CELLS](*self._surface, self.moments)
        for level in range(1, n.bit_length()):
            halve_moments[_cells(n >> level), CELLS](level, self.moments)


def _cells(n):
    """Return the blocks of CELLS threads that cover n x n cells."""
    return -(-n // CELLS[0]), -(-n // CELLS[1])
