"""Data of `benchmarks day`: colours of captures and small path-traced pictures, packed.

Geometry is made again from its seeds, so a capture is three bytes a splat. A checksum of the places
says whether they are still those that the colours were baked for.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rainsim.errors import InputError

FOLDER = Path(__file__).parent / "tests/day_data"  # 15 MB
HALF = 2  # the traced pictures have the size of a frame over this
ROOT_STEP = 1 / 1023  # of the root of radiance, in which traced pictures are kept
REGIONS = ("sky", "paving", "puddle", "rim", "lawn", "wall", "tabletop", "leaf", "core", "box",
           "glass", "frame", "table", "post", "globe", "kerb", "trunk")  # fmt: skip
LIT, COVERED = 1, 2  # bits: the sun of the captured day meets it; something stands above it


@dataclass(frozen=True)
class Labels:
    """Region, sunlight and cover of the pixels of a traced picture, maps of its size."""

    region: np.ndarray  # uint8, number in REGIONS
    lit: np.ndarray  # bool, in the sun on the captured day
    covered: np.ndarray  # bool, below a top
    openness: np.ndarray  # light of the overcast sky over that of open level ground

    def shows(self, *names):
        """Return where one of the named regions is shown."""
        return np.isin(self.region, [REGIONS.index(name) for name in names])


def pack_colors(colors):
    """Return colours (n, 3), uint8, in a form that compresses: green, and the others less green."""
    red, green, blue = np.asarray(colors, np.uint8).T
    return np.stack([green, red - green, blue - green])


def unpack_colors(packed):
    """Return the colours, shape (n, 3), uint8, that `pack_colors` was given."""
    green, red, blue = packed
    return np.stack([red + green, green, blue + green], axis=1)


def pack_picture(radiance):
    """Return a picture of radiance as steps of its root, differences along rows, uint16."""
    steps = np.round(np.sqrt(np.maximum(radiance, 0)) / ROOT_STEP).astype(np.uint16)
    packed = np.moveaxis(steps, -1, 0).copy()
    packed[:, :, 1:] -= steps.transpose(2, 0, 1)[:, :, :-1]
    return packed


def unpack_picture(packed):
    """Return the radiance, shape (height, width, 3), that `pack_picture` was given."""
    steps = np.add.accumulate(packed, axis=2, dtype=np.uint16)
    return np.moveaxis((steps * ROOT_STEP) ** 2, 0, -1)


def pack_labels(labels):
    """Return labels as bytes of shape (3, height, width)."""
    bits = LIT * labels.lit + COVERED * labels.covered
    openness = np.round(np.clip(labels.openness, 0, 1.2) / 1.2 * 60)
    return np.stack([labels.region, bits, openness]).astype(np.uint8)


def unpack_labels(packed):
    """Return the `Labels` that `pack_labels` was given; openness in steps of 0.02."""
    region, bits, openness = packed
    return Labels(region, (bits & LIT) > 0, (bits & COVERED) > 0, openness / 60 * 1.2)


def checksum(spots):
    """Return a number that says whether splats stand where they stood, to 0.1 mm."""
    return zlib.crc32(np.round(spots.position * 1e4).astype(np.int32).tobytes())


def write(case, arrays, folder=FOLDER):
    """Write the arrays of a case."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / f"{case}.npz", **arrays)


def read(case, folder=FOLDER):
    """Return the arrays of a case by name; InputError if there are none."""
    path = folder / f"{case}.npz"
    if not path.is_file():
        raise InputError(
            f"{path} does not exist; benchmarks day needs its captures and traced pictures; "
            "take them from rainsim's source, or run python -m benchmarks day --remake"
        )
    with np.load(path) as file:
        return {name: file[name] for name in file.files}
