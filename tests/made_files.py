"""The program's own files, made small with numpy alone: no kernel is compiled for them."""

import io
import zipfile

import numpy as np

from rainsim.io.states import DRIP_COLUMNS, SimState
from rainsim.ledger import Ledger
from rainsim.terrain.types import Grid, Terrain, Tops

SHAPE = (9, 12)


def small_terrain():
    """Level paving of 9 x 12 cells with one top over its middle."""
    flat = np.zeros(SHAPE, np.float32)
    top = flat.copy()
    top[3:6, 4:8] = 0.5
    index = np.where(top > 0, 0, -1).astype(np.int16)
    tops = Tops(
        index, np.zeros((1, 3)), np.zeros((1, 2)), np.array([0.0048]),
        np.array([[0, 5, 6]]), np.zeros((1, 2)), 0.01,
        np.zeros((5, 6), np.float32), np.ones((5, 6), bool),
    )  # fmt: skip
    grid = Grid(SHAPE, (-0.12, -0.09), 0.02)
    return Terrain(
        grid, flat, top, top.copy(), np.full(SHAPE, 2, np.uint8), np.zeros(SHAPE, np.uint8),
        np.full(SHAPE, 1e-3, np.float32), np.full((*SHAPE, 3), 0.5, np.float32),
        ("made for a test",), tops=tops,
    )  # fmt: skip


def small_state(index=2):
    """A state of a few millimetres of water on `small_terrain`."""
    drips = np.zeros((2, len(DRIP_COLUMNS)))
    drips[:, 4:7] = 0.005, 0.1, 0.3  # diameter, begin, end
    return SimState(
        index, index / 24, np.full(SHAPE, 2e-3, np.float32), np.zeros((2, *SHAPE), np.float32),
        np.zeros((2, 8, 8), np.float32), 1.0, Ledger(initial=1.0).as_dict(),
        ("a note",), drips, np.arange(2, dtype=np.uint64), np.zeros(1),
    )  # fmt: skip


def arrays_in(path):
    """The arrays of an .npz file by name."""
    with np.load(path) as archive:
        return dict(archive)


def rezipped(arrays, compression=zipfile.ZIP_STORED):
    """The bytes of an .npz file of arrays, or of what stands for them as bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, values in arrays.items():
            if not isinstance(values, bytes):
                data = io.BytesIO()
                np.lib.format.write_array(data, np.asanyarray(values))
                values = data.getvalue()
            archive.writestr(f"{name}.npy", values)
    return buffer.getvalue()
