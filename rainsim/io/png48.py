"""Colour pictures of 16 bits a channel, which Pillow does not write: optical flow as KITTI has it.

PNG, W3C Recommendation, second edition: signature, IHDR, IDAT, IEND; colour type 2, no filter but
the difference to the pixel before, which halves the size of smooth flow.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from rainsim.errors import ParameterError
from rainsim.io.files import replacing

SIGNATURE = b"\x89PNG\r\n\x1a\n"
SUB = 1  # filter type: minus the byte of the pixel before
STEP = 6  # bytes of a pixel
LEVEL = 6


def write_png48(path, values):
    """Write a picture (height, width, 3) of whole numbers 0 to 65535 as a 48-bit PNG."""
    values = np.asarray(values)
    if values.dtype != np.uint16 or values.ndim != 3 or values.shape[2] != 3:
        raise ParameterError(
            f"the picture for {path} is {values.dtype} of shape {values.shape}; a 48-bit PNG must "
            "be uint16 of three channels"
        )
    height, width = values.shape[:2]
    lines = np.ascontiguousarray(values.astype(">u2")).view(np.uint8).reshape(height, -1)
    filtered = np.empty((height, 1 + lines.shape[1]), np.uint8)
    filtered[:, 0] = SUB
    filtered[:, 1 : 1 + STEP] = lines[:, :STEP]
    filtered[:, 1 + STEP :] = lines[:, STEP:] - lines[:, :-STEP]
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    body = zlib.compress(filtered.tobytes(), LEVEL)
    with replacing(path) as temporary:
        chunks = ((b"IHDR", header), (b"IDAT", body), (b"IEND", b""))
        temporary.write_bytes(SIGNATURE + b"".join(_chunk(*chunk) for chunk in chunks))


def _chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
