"""Splats from SPZ files, versions 2 and 3 (gzip) and 4 (a zstd stream for each quantity).

SPZ stores x right, y up, z back where PLY files of capture tools have x right, y down, z forward:
a half turn about x, which positions, rotations and spherical harmonics all make.
"""

from __future__ import annotations

import struct
import zlib
from contextlib import contextmanager

import numpy as np

from rainsim.errors import InputError
from rainsim.scene.activate import activate, dropped_note, keep_good, require_believable
from rainsim.scene.formats.extra import decoding, load_extra

KIND = "an SPZ file"
REMEDY = "it is damaged, export it again"
MAGIC = 0x5053474E  # "NGSP"
GZIP_MAGIC = b"\x1f\x8b"
PACKED = struct.Struct("<IIIBBBB")  # magic, version, count, degree, position bits, flags, streams
HEADER_4 = 32  # bytes; PACKED with the place of the table of contents behind
REST = {0: 0, 1: 3, 2: 8, 3: 15}  # SH degree -> coefficients beyond the first
GZIP_VERSIONS, ZSTD_VERSION = (
    (2, 3),
    4,
)  # version 1 was never released and stored positions differently
MAX_POSITION_BITS = 24
ANTIALIASED, EXTENDED = 1, 2  # flags
EXTENSION_LIMIT = 1 << 16  # bytes behind the splats that are not read
STEP = 1 << 20  # bytes that are unpacked at a time

HALF_TURN = np.float32([1, -1, -1])  # of vectors; quaternions' x, y, z turn alike
# Sign of each basis function under (x, -y, -z): y, z, x; xy, yz, zz, xz, xx - yy; degree 3.
HALF_TURN_SH = np.float32([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])


def read_spz(path, max_broken):
    """Return the Splats of an SPZ file, notes and how many splats were dropped."""
    gzipped, header, packed = _read_head(path)
    _, version, count, degree, bits, flags, _ = header
    if version not in (GZIP_VERSIONS if gzipped else (ZSTD_VERSION,)):
        kind = "gzip" if gzipped else "zstd"
        raise InputError(
            f"{path} is SPZ of version {version} in {kind}; versions 2 and 3 (gzip) and 4 (zstd) "
            "are read; export it in one of these"
        )
    if degree not in REST:
        raise InputError(
            f"{path} has spherical harmonics of degree {degree}; it must be 0 to 3; export it with "
            "a lower one"
        )
    if not 1 <= bits <= MAX_POSITION_BITS:
        raise InputError(f"{path} has {bits} position bits; they must be 1 to 24; {REMEDY}")
    require_believable(path, count, len(packed))
    modules = () if gzipped else ("zstandard",)
    gsply = load_extra(path, KIND, *modules)
    (_check_gzip if gzipped else _check_zstd)(path, packed, _section_sizes(count, version, degree))
    with decoding(path, KIND), _plain_backend(gsply):
        data = gsply.read_spz(path)
        rest = data.shN if degree else None
        if data.means.shape != (count, 3) or (degree and rest.shape[1] != REST[degree]):
            raise InputError(f"{path} changed while it was read; try again")
        splats, broken, notes = _turned(path, data, rest, max_broken)
    return splats, [*_flag_notes(flags), *notes], broken


def _turned(path, data, rest, max_broken):
    turn = data.quats.copy()
    turn[:, 1:] *= HALF_TURN
    if rest is not None:
        rest = rest * HALF_TURN_SH[: rest.shape[1], None]
    splats, good = activate(
        data.means * HALF_TURN, data.scales, turn, data.opacities.reshape(-1), data.sh0, rest
    )
    splats, broken = keep_good(path, splats, good, max_broken)
    return splats, broken, dropped_note(broken, len(splats))


def _flag_notes(flags):
    notes = []
    if flags & ANTIALIASED:
        notes.append("SPZ says that the capture was trained with Mip-Splatting's screen filter")
    if flags & EXTENDED:
        notes.append("SPZ extensions are not read")
    return notes


def _read_head(path):
    """Return whether it is gzip, the header's values and the whole file as it stands."""
    packed = path.read_bytes()
    gzipped = packed.startswith(GZIP_MAGIC)
    start = packed[: PACKED.size]
    if gzipped:
        try:
            start = zlib.decompressobj(31).decompress(packed, PACKED.size)
        except zlib.error:
            raise InputError(f"{path} is not whole gzip; {REMEDY}") from None
    if len(start) < PACKED.size:
        raise InputError(f"{path} ends within its header; {REMEDY}")
    header = PACKED.unpack(start)
    if header[0] != MAGIC:
        raise InputError(
            f"{path} is gzip but not SPZ; the unpacked file must start with NGSP; unpack it first"
        )
    return gzipped, header, packed


def _section_sizes(count, version, degree):
    """Return the unpacked bytes of each section of splats that is not empty, in order."""
    rotation = 4 if version >= 3 else 3
    strides = (9, 1, 3, 3, rotation, 3 * REST[degree])
    return [count * stride for stride in strides if stride]


def _check_gzip(path, packed, sizes):
    """Raise InputError unless the gzip stream holds the splats that its SPZ header promises.

    Behind the splats it may hold EXTENSION_LIMIT bytes at most; nothing may follow the stream. So a
    small file that unpacks to gigabytes is found before it is read.

    Parameters
    ----------
    path : Path
        For the message.
    packed : bytes
        The whole file.
    sizes : list of int
        Unpacked bytes of each section, see `_section_sizes`.
    """
    need = PACKED.size + sum(sizes)
    stream, data, done = zlib.decompressobj(31), packed, 0
    try:
        while not stream.eof:
            piece = len(stream.decompress(data, STEP))
            done += piece
            data = stream.unconsumed_tail
            if done > need + EXTENSION_LIMIT:
                raise InputError(
                    f"{path} unpacks to more than the {need} bytes of its splats; {REMEDY}"
                )
            if not piece and not data:
                break
    except zlib.error:
        raise InputError(f"{path} is not whole gzip; {REMEDY}") from None
    if not stream.eof or done < need:
        raise InputError(f"{path} ends after {done} of {need} unpacked bytes; {REMEDY}")
    if stream.unused_data:
        raise InputError(f"{path} has {len(stream.unused_data)} bytes behind its end; {REMEDY}")


def _check_zstd(path, packed, sizes):
    """Raise InputError unless each zstd stream lies in the file and announces its section's size.

    Arguments as `_check_gzip` has them.
    """
    import zstandard

    if len(packed) < HEADER_4:
        raise InputError(f"{path} ends within its header; {REMEDY}")
    streams, place = packed[PACKED.size - 1], struct.unpack_from("<I", packed, PACKED.size)[0]
    if streams != len(sizes) or not HEADER_4 <= place <= len(packed) - 16 * streams:
        raise InputError(
            f"{path} has {streams} streams listed at byte {place} of {len(packed)}; it must have "
            f"{len(sizes)} within the file; {REMEDY}"
        )
    start = place + 16 * streams
    for number, size in enumerate(sizes):
        stored, unpacked = struct.unpack_from("<QQ", packed, place + 16 * number)
        if unpacked != size or stored > len(packed) - start:
            raise InputError(
                f"{path}: stream {number} has {stored} bytes for {unpacked}; it must end within "
                f"the file and hold {size}; {REMEDY}"
            )
        try:
            frame = zstandard.get_frame_parameters(packed[start : start + min(stored, 64)])
        except zstandard.ZstdError:
            raise InputError(f"{path}: stream {number} is not zstd; {REMEDY}") from None
        # The decoder allocates what the frame says, whatever the table of contents says.
        if frame.content_size not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise InputError(
                f"{path}: stream {number} says it unpacks to {frame.content_size} bytes; it must "
                f"be {size}; {REMEDY}"
            )
        start += stored


@contextmanager
def _plain_backend(gsply):
    """Make gsply decode in Python and numba; its C++ decoder has not been tested here."""
    before = gsply.active_backend()
    gsply.use_backend("python")
    try:
        yield
    finally:
        gsply.use_backend(before)
