"""Splats from `.splat` files, the 32-byte records of the first web viewers.

A record holds the centre and the linear scales (6 float32), red, green, blue and opacity (4 bytes)
and a quaternion, w first (4 bytes about 128). There is no header; the numbers themselves show that
a file is of this format.
"""

import numpy as np

from rainsim.constants import SH_0
from rainsim.errors import InputError
from rainsim.io.files import MAX_LENGTH
from rainsim.scene.activate import empty_splats

RECORD = np.dtype(
    [("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("turn", "u1", 4)]
)
BELIEVABLE = 0.98  # least share of usable records at the start of a .splat file


def looks_like_records(start):
    """Return whether `start`, the first bytes of a file, looks like 32-byte splat records."""
    count = len(start) // RECORD.itemsize
    if count == 0 or _is_text(start[:4096]):
        return False
    records = np.frombuffer(start, RECORD, count)
    usable = _usable(records)
    seen = records[usable]
    blank = not seen["scale"].any() or not seen["color"][:, 3].any()
    return not blank and usable.mean() >= BELIEVABLE


def _is_text(data):
    return not data.translate(None, bytes([9, 10, 13, *range(32, 127)]))


def _usable(records):
    """Return the mask of the records whose numbers a splat can have."""
    with np.errstate(invalid="ignore"):
        good = (np.abs(records["position"]) < MAX_LENGTH).all(axis=1)  # false for NaN
        good &= ((records["scale"] >= 0) & (records["scale"] < MAX_LENGTH)).all(axis=1)
    return good & (records["turn"] != 128).any(axis=1)


def read_antimatter(path):
    """Return the Splats of a `.splat` file, which are usable, and no notes."""
    size = path.stat().st_size
    if size % RECORD.itemsize:
        raise InputError(
            f"{path} has {size} bytes; a .splat file holds whole records of {RECORD.itemsize} "
            "bytes; it is cut off, copy or export it again"
        )
    records = np.fromfile(path, RECORD)
    splats = empty_splats(len(records), 1)
    with np.errstate(all="ignore"):
        splats.position[:] = records["position"]
        splats.scale[:] = records["scale"]
        splats.opacity[:] = records["color"][:, 3] / np.float32(255)
        splats.sh[:, 0] = (records["color"][:, :3] / np.float32(255) - np.float32(0.5)) / SH_0
        turn = records["turn"].astype(np.float32) - 128
        np.divide(turn, np.linalg.norm(turn, axis=1, keepdims=True), out=splats.rotation)
    return splats, _usable(records), []
