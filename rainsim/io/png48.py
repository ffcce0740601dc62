"""Colour pictures of 16 bits a channel, which Pillow does not write: optical flow as KITTI has it.

PNG, W3C Recommendation, second edition: signature, IHDR, IDAT, IEND; colour type 2, no filter but
the difference to the pixel before, which halves the size of smooth flow.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from rainsim.errors import InputError, ParameterError
from rainsim.io.files import replacing, require_file

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


def read_png48(path):
    """Return the picture that `write_png48` wrote, shape (height, width, 3), uint16."""
    data = require_file(path, "a 48-bit picture").read_bytes()
    try:
        if data[:8] != SIGNATURE:
            raise ValueError
        place, body, size = 8, b"", None
        while place < len(data):
            length, kind = struct.unpack_from(">I4s", data, place)
            chunk = data[place + 8 : place + 8 + length]
            if kind == b"IHDR":
                size = struct.unpack(">IIBBBBB", chunk)
            body += chunk if kind == b"IDAT" else b""
            place += 12 + length
        width, height = size[:2]
        limit = height * (1 + STEP * width)
        if size[2:] != (16, 2, 0, 0, 0):
            raise ValueError
        raw = zlib.decompressobj().decompress(body, limit)
        lines = np.frombuffer(raw, np.uint8).reshape(height, -1)
        if not (lines[:, 0] == SUB).all():
            raise ValueError
        pixels = np.cumsum(lines[:, 1:].reshape(height, width, STEP), axis=1, dtype=np.uint8)
        return pixels.view(">u2").astype(np.uint16)
    except (ValueError, TypeError, struct.error, zlib.error):
        raise InputError(
            f"{path} is no 48-bit picture as rainsim writes it; export it again"
        ) from None
