"""The ripples' twin in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.water.ripples import PUSH_UNIT, Ripples
from rainsim.errors import ParameterError
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.water.ripples import _LONGEST_STEP, SIZE_MOMENTA, SIZES, RippleTile

assert simulated()
N = 8


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_two_frames_are_those_of_the_cpu(parts):
    duration = parts * _LONGEST_STEP
    rng = np.random.default_rng(2)
    tile = RippleTile(size=0.2, cells=N, depth=0.01, dtype=np.float32)
    tile.set_elevation(1e-4 * rng.normal(size=(N, N)))
    twin = Ripples(tile, duration)
    assert twin.tile.steps == parts
    for _ in range(2):
        pushes = rng.uniform(0.5, 1, (SIZES, twin.tile.steps, N, N))
        pushes *= np.array([SIZE_MOMENTA[0], *SIZE_MOMENTA])[:, None, None, None]
        pushes[1:] *= 2  # of each size
        waiting = np.zeros((SIZES, 2 * ((parts + 1) // 2), N, N), np.int64)
        waiting[:, :parts] = np.rint(pushes / PUSH_UNIT)
        twin.pushes.copy_to_device(waiting.reshape(-1))
        row, column = np.mgrid[:N, :N] * 0.2 / N
        position = np.stack([column.ravel(), row.ravel()], axis=1)
        before = tile.slopes()
        age = (parts - 0.5 - np.arange(parts)) / parts * duration
        tile.advance(
            duration, np.concatenate([position] * parts * SIZES), pushes.ravel(),
            np.tile(np.repeat(age, N * N), SIZES),
        )  # fmt: skip
        twin.advance()
        slopes = tile.slopes()
        scale = np.abs(slopes).max()
        assert np.abs(before - slopes).max() > 0.1 * scale > 0
        wanted, found = ripple_moments(slopes), twin.moments.copy_to_host()
        np.testing.assert_allclose(found[..., :2], wanted[..., :2], atol=1e-5 * scale)
        np.testing.assert_allclose(found[..., 2:5], wanted[..., 2:5], atol=1e-5 * scale**2)
        high = np.abs(wanted[..., 5]).max()
        assert high > 1e-3 * scale
        np.testing.assert_allclose(found[..., 5], wanted[..., 5], atol=1e-4 * high)
        assert not twin.pushes.copy_to_host().any()


def test_tiles_that_cannot_be_transformed_are_refused():
    with pytest.raises(ParameterError, match="power of two"):
        Ripples(RippleTile(cells=24), 1 / 30)
