"""The ripples' twin in numba's CUDA simulator; `tests/unit/test_cuda.py` runs this file."""

import numpy as np
import pytest

from rainsim.cuda import simulated
from rainsim.cuda.drops import PUSH_UNIT
from rainsim.cuda.ripples import Ripples
from rainsim.errors import ParameterError
from rainsim.ripples import _LONGEST_STEP, RippleTile
from rainsim.watersurface import ripple_levels

assert simulated()
N = 8


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_two_frames_are_those_of_the_cpu(parts):
    duration = parts * _LONGEST_STEP
    rng = np.random.default_rng(2)
    tile = RippleTile(size=0.2, cells=N, depth=0.01, dtype=np.float32)
    tile.set_elevation(1e-4 * rng.normal(size=(N, N)))
    twin = Ripples(tile, duration)
    assert twin.steps == parts
    for _ in range(2):
        pushes = 1e-6 * rng.random((twin.steps, N, N))
        waiting = np.zeros(twin.pushes.shape, np.int64)
        waiting[: pushes.size] = np.rint(pushes / PUSH_UNIT).astype(np.int64).reshape(-1)
        twin.pushes.copy_to_device(waiting)
        row, column = np.mgrid[:N, :N] * 0.2 / N
        position = np.stack([column.ravel(), row.ravel()], axis=1)
        before = tile.slopes()
        tile.advance(
            duration, np.concatenate([position] * parts), pushes.ravel(),
            np.repeat((parts - 0.5 - np.arange(parts)) / parts * duration, N * N),
        )  # fmt: skip
        twin.launch()
        wanted = ripple_levels(tile.slopes())
        scale = np.abs(wanted[0]).max()
        assert np.abs(before - wanted[0]).max() > 0.1 * scale > 0
        for found, level in zip(twin.slopes, wanted, strict=True):
            np.testing.assert_allclose(found.copy_to_host(), level, atol=1e-5 * scale)
        rms = [np.sqrt(np.mean(level.astype(float) ** 2)) for level in wanted]
        np.testing.assert_allclose(twin.rms.copy_to_host(), rms, rtol=1e-4, atol=1e-6 * scale)
        assert not twin.pushes.copy_to_host().any()


def test_tiles_that_cannot_be_transformed_are_refused():
    with pytest.raises(ParameterError, match="power of two"):
        Ripples(RippleTile(cells=24), 1 / 30)
