"""Splats from SPZ files, versions 2 and 3 (gzip) and 4 (a zstd stream for each quantity).

SPZ stores x right, y up, z back where PLY files of capture tools have x right, y down, z forward:
a half turn about x, which positions, rotations and spherical harmonics all make. Many converters
leave the turn out (nianticlabs/spz, issue 84); an extension of the format names the axes.
"""

import struct
import zlib
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from rainsim.errors import InputError
from rainsim.scene.activate import require_believable
from rainsim.scene.formats.extra import activated, decoding, load_extra

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

EXTENSION = struct.Struct("<II")  # type and bytes of its value
AXES = 0xADBE0003  # type of the extension that names the axes, a uint32
RIGHT, UP, FORWARD = 1, 2, 4  # bits of that value less one
DOCUMENTED = RIGHT + UP + 1
UNSAID = "SPZ does not say its axes: taken for right, up, back (rub)"


def read_spz(path):
    """Return the Splats of an SPZ file, which are usable, and notes."""
    gzipped, header, packed = _read_head(path)
    _, version, count, degree, bits, flags, _ = header
    if version not in (GZIP_VERSIONS if gzipped else (ZSTD_VERSION,)):
        kind = "gzip" if gzipped else "zstd"
        if version in GZIP_VERSIONS:
            raise InputError(
                f"{path} is SPZ of version {version}, unpacked; it must be in gzip; pack it again "
                "(gzip -k) or export it again"
            )
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
    check = _check_gzip if gzipped else _check_zstd
    extensions = check(path, packed, _section_sizes(count, version, degree))
    axes, others = _axes_in(extensions) if flags & EXTENDED else (0, False)
    if axes > RIGHT + UP + FORWARD + 1:
        raise InputError(
            f"{path} has its y and z axes exchanged (axes {axes}); up must be y; export it with "
            "the axes right, up, back"
        )
    with decoding(path, KIND), _plain_backend(gsply):
        data = gsply.read_spz(path)
        if data.means.shape != (count, 3) or (degree and data.shN.shape[1] != REST[degree]):
            raise InputError(f"{path} changed while it was read; try again")
        splats, good = activated(data)
    bits = (axes or DOCUMENTED) - 1
    splats = mirrored(splats, [bits & RIGHT, not bits & UP, bits & FORWARD])
    notes = [] if axes else [UNSAID]
    if flags & ANTIALIASED:
        notes.append("SPZ says that the capture was trained with Mip-Splatting's screen filter")
    if others:
        notes.append("SPZ extensions beside that of the axes are not read")
    return splats, good, notes


def mirrored(splats, keeps):
    """Return splats with the axes turned round that `keeps` has not; those of PLY are all kept.

    A splat mirrored in a plane is a splat whose quaternion has the product of the other two signs
    in each part, and each spherical harmonic has the signs of the coordinates that it multiplies.
    """
    x, y, z = (np.float32(1 if keep else -1) for keep in keeps)
    one = np.float32(1)
    harmonics = [one, y, z, x, x * y, y * z, one, x * z, one, y, x * y * z, y, z, x, z, x]
    return replace(
        splats,
        position=splats.position * (x, y, z),
        rotation=splats.rotation * (one, y * z, x * z, x * y),
        sh=splats.sh * np.array(harmonics)[: splats.sh.shape[1], None],
    )


def half_turned(splats):
    """Return splats turned half about x: from right, up, back to right, down, forward, or back."""
    return mirrored(splats, (True, False, False))


def _axes_in(extensions):
    """Return the value of the extension that names the axes, 0 without it, and if there are others.

    `extensions` are bytes: type, length and value of each, one after the other.
    """
    axes, others, start = 0, False, 0
    while start + EXTENSION.size <= len(extensions):
        kind, size = EXTENSION.unpack_from(extensions, start)
        start += EXTENSION.size
        value = extensions[start : start + size]
        if kind == AXES and len(value) == 4:
            axes = int.from_bytes(value, "little")
        else:
            others = True
        start += size
    return axes, others


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
    """Return what lies behind the splats that an SPZ header promises, or raise InputError.

    It is EXTENSION_LIMIT bytes at most, and nothing may follow the gzip stream. So a small file
    that unpacks to gigabytes is found before it is read.
    """
    need, stream = PACKED.size + sum(sizes), zlib.decompressobj(31)
    try:
        data = stream.decompress(packed, need + EXTENSION_LIMIT + 1)
    except zlib.error:
        raise InputError(f"{path} is not whole gzip; {REMEDY}") from None
    if len(data) > need + EXTENSION_LIMIT:
        raise InputError(f"{path} unpacks to more than the {need} bytes of its splats; {REMEDY}")
    if not stream.eof or len(data) < need:
        raise InputError(f"{path} ends after {len(data)} of {need} unpacked bytes; {REMEDY}")
    if stream.unused_data:
        raise InputError(f"{path} has {len(stream.unused_data)} bytes behind its end; {REMEDY}")
    return data[need:]


def _check_zstd(path, packed, sizes):
    """Return what lies before the table of contents, or raise InputError on a wrong section."""
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
    return packed[HEADER_4:place]


@contextmanager
def _plain_backend(gsply):
    """Make gsply decode in Python and numba; its C++ decoder has not been tested here."""
    before = gsply.active_backend()
    gsply.use_backend("python")
    try:
        yield
    finally:
        gsply.use_backend(before)
