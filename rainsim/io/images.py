"""Pictures in and out: PNG frames, float TIFF maps, previews, and Radiance HDR panoramas.

The only module that imports imageio and Pillow. Every file is written whole under a temporary name
and then renamed, so that what stood there before survives a failure.
"""

import io
import math
import os
import stat
import warnings
from pathlib import Path

import imageio.v3 as iio
import numpy as np

from rainsim.errors import InputError, ParameterError
from rainsim.io.arrays import write_arrays
from rainsim.io.exr import openexr
from rainsim.io.files import replacing, require_file
from rainsim.io.png import write_png_file

VERSION = 1  # of files of float pictures
PREVIEW_WIDTH = 480  # px at most
PREVIEW_FRAMES = 60  # at most; a longer film's preview skips frames
PREVIEW_QUALITY = 75
MOST_PIXELS = 2**27  # of a picture
MOST_PIXELS_PER_BYTE = 10_000  # even zstd packs equal pixels no tighter
MAX_HDR_PIXELS = 2**27  # 16384 x 8192; more is a damaged header
RGBE_BIAS = 128 + 8  # of the exponent, and the eight bits of the mantissa
MIN_RLE_WIDTH, MAX_RLE_WIDTH = 8, 0x7FFF  # px between which lines may be run-length coded


def write_png(path, image):
    """Write an 8-bit picture.

    Parameters
    ----------
    path : path-like
    image : ndarray of shape (height, width, 3) or (height, width), uint8

    Examples
    --------
    >>> rainsim.write_png("grey.png", np.full((24, 32, 3), 128, np.uint8))
    """
    image = np.asarray(image)
    if image.dtype != np.uint8:
        raise ParameterError(f"the picture for {path} is {image.dtype}; a PNG here must be uint8")
    if not (image.size and (image.ndim == 2 or image.shape[2:] in ((1,), (2,), (3,), (4,)))):
        raise ParameterError(
            f"the picture for {path} has the shape {image.shape}; it must be (height, width) or "
            "(height, width, 3)"
        )
    write_png_file(path, image)


def lossless_webp(pixels):
    """Return pixels (height, width, 4) uint8 as lossless WebP; slower would be 5 % smaller."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "WEBP", lossless=True, exact=True, quality=0, method=0)
    return buffer.getvalue()


def write_png16(path, values):
    """Write whole numbers, 0 to 65535, as a grey 16-bit PNG; others are a ParameterError."""
    values = np.ascontiguousarray(values)
    if values.size and not (values.min() >= 0 and values.max() <= 65535):
        raise ParameterError(
            f"values from {values.min()} to {values.max()} do not fit a 16-bit PNG, 0 to 65535; "
            "write them as .npz"
        )
    write_png_file(path, values.astype(np.uint16))


def write_png48(path, values):
    """Write a picture (height, width, 3) of whole numbers 0 to 65535 as a 48-bit PNG."""
    values = np.asarray(values)
    if values.dtype != np.uint16 or values.ndim != 3 or values.shape[2] != 3:
        raise ParameterError(
            f"the picture for {path} is {values.dtype} of shape {values.shape}; a 48-bit PNG must "
            "be uint16 of three channels"
        )
    write_png_file(path, values)


def data_suffix():
    """Return how files of `write_data` end: exr with the extra `exr`, else npz."""
    return "npz" if openexr() is None else "exr"


def write_data(path, values, channels):
    """Write a float32 picture, exactly: OpenEXR if the name ends so, else an .npz of its channels.

    `values` are of shape (height, width) or (height, width, n); `channels` has a name for each.
    """
    values = np.asarray(values, np.float32)
    planes = values[..., None] if values.ndim == 2 else values
    if planes.shape[-1] != len(channels):
        raise ParameterError(
            f"the picture for {path} has {planes.shape[-1]} channels; it has {len(channels)} names"
        )
    parts = {n: np.ascontiguousarray(planes[..., k]) for k, n in enumerate(channels)}
    if not str(path).endswith(".exr"):
        write_arrays(path, VERSION, parts)
        return
    exr = openexr()
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    with replacing(path) as temporary, exr.File(header, parts) as file:
        file.write(str(temporary))


def read_image(path, most=MOST_PIXELS):
    """Return the pixels of the PNG or TIFF file `path` in the type that the file has.

    A file of more than `most` pixels, or of more than fit into it, is refused before its pixels are
    unpacked.

    Examples
    --------
    >>> rainsim.write_png("grey.png", np.full((24, 32, 3), 128, np.uint8))
    >>> rainsim.read_image("grey.png").shape
    (24, 32, 3)
    """
    width, height = picture_size(path)
    if width * height > most:
        raise InputError(
            f"{path} has {width} x {height} pixels; it must have at most {most} in all; make it "
            "smaller"
        )
    size = Path(path).stat().st_size
    if width * height > MOST_PIXELS_PER_BYTE * size:
        raise InputError(
            f"{path} claims {width} x {height} pixels and has {size} bytes, too few for them under "
            "any compression; it is cut off or damaged; write it again"
        )
    return _decoded(path, iio.imread)


def picture_size(path):
    """Return width and height of a picture without unpacking it."""
    shape = _decoded(path, iio.improps).shape
    return shape[1], shape[0]


def _decoded(path, read):
    """Return the result of imageio's `read` for a picture's first page, or raise InputError."""
    path = require_file(path, "a picture")
    try:
        with warnings.catch_warnings(action="ignore"):  # Pillow warns of large pictures
            return read(path, plugin="pillow", index=0)
    except Exception as error:  # Pillow raises whatever the damage leads to
        fault = _first_line(error.__cause__ or error)
        raise InputError(
            f"{path} cannot be read as a picture ({fault}); it must be PNG or TIFF; write it again"
        ) from None


def of_photograph(path, read):
    """Return `read(picture)` of a photograph, a Pillow picture that is not unpacked yet.

    InputError where `path` is no regular file (judged once it is open: nothing waits for a pipe or
    a device), is no picture, or claims too many pixels.
    """
    from PIL import Image

    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise ValueError("no regular file")
            with warnings.catch_warnings(action="ignore"), Image.open(file) as picture:
                if math.prod(picture.size) > min(MOST_PIXELS, MOST_PIXELS_PER_BYTE * found.st_size):
                    raise ValueError(f"{picture.width} x {picture.height} pixels")
                return read(picture)
    except Exception as error:  # Pillow raises whatever the damage leads to
        raise InputError(f"{path} cannot be read as a photograph ({_first_line(error)})") from None


def write_tagged(path, values, tags):
    """Write float32 values as a TIFF with tags (int to numbers or text), which imageio drops."""
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(values, np.float32))
    picture.save(path, tiffinfo=tags, compression="tiff_adobe_deflate")


def tags_of(path):
    """Return the tags of a TIFF, a dict of int to tuple, number or text."""
    from PIL import Image

    def read(path, **how):
        with Image.open(path) as picture:
            return dict(getattr(picture, "tag_v2", {}))

    return _decoded(path, read)


def write_npz(path, **arrays):
    """Write the arrays of a float picture as an uncompressed .npz file, whole or not at all."""
    write_arrays(path, VERSION, arrays)


class Preview:
    """Collects frames small, and writes them as one animation that loops."""

    def __init__(self, frame_count, fps):
        self._stride = -(-frame_count // PREVIEW_FRAMES)
        self._duration = 1000 * self._stride / fps  # ms
        self._frames, self._seen = [], 0

    def add(self, image):
        """Take the next frame, an ndarray of shape (height, width, 3), uint8."""
        if self._seen % self._stride == 0:
            self._frames.append(shrunk(image))
        self._seen += 1

    def write(self, path):
        """Write the added pictures as an animated WebP picture; with no frames do nothing."""
        if self._frames:
            with replacing(path) as temporary:
                # In memory: where a disk is full, Pillow's plugin would print a traceback.
                temporary.write_bytes(iio.imwrite(
                    "<bytes>", np.stack(self._frames), plugin="pillow", extension=".webp",
                    duration=round(self._duration), loop=0, quality=PREVIEW_QUALITY,
                    method=0, kmin=0, kmax=0,  # no key frames: they take most of the time
                ))  # fmt: skip


def shrunk(image):
    """Return a picture as a preview shows it: means of whole blocks, the remainder cut off."""
    block = -(-image.shape[1] // PREVIEW_WIDTH)
    rows, columns = image.shape[0] // block, image.shape[1] // block
    if block == 1 or rows == 0:
        return image.copy()
    total = np.zeros((rows, columns, *image.shape[2:]), np.float32)
    for row in range(block):  # slices: many times as fast as means over axes of a few pixels
        for column in range(block):
            total += image[row : rows * block : block, column : columns * block : block]
    return np.rint(total * np.float32(1 / block**2)).astype(np.uint8)


# --- Radiance HDR ---------------------------------------------------------------------------------


def read_hdr(path):
    """Read a Radiance RGBE picture (.hdr), flat or run-length coded.

    Return linear radiance, (height, width, 3), float32, row 0 at the top; exposure notes of the
    header are divided out. InputError if the file is not such a picture or ends early.

    G. Ward, "Real Pixels", Graphics Gems II (1991). A value is mantissa * 2^(exponent - 136); we
    leave out Ward's half step on the mantissa, as most readers do.
    """
    path = require_file(path, "a sky")
    data = path.read_bytes()
    width, height, exposure, start = _hdr_header(path, data)
    pixels = np.frombuffer(data, np.uint8, offset=start)
    rgbe = np.empty((height, width, 4), np.uint8)
    for row in range(height):
        packed_mark = bytes((2, 2, width >> 8 & 255, width & 255))
        if MIN_RLE_WIDTH <= width <= MAX_RLE_WIDTH and pixels[:4].tobytes() == packed_mark:
            used = 4 + _unpack_line(path, pixels[4:].data, rgbe[row], row, height)
        else:
            used = _flat_line(path, pixels, rgbe[row], row, height)
        pixels = pixels[used:]
    scale = np.ldexp(np.float32(1 / exposure), rgbe[..., 3:].astype(np.int32) - RGBE_BIAS)
    color = rgbe[..., :3] * np.where(rgbe[..., 3:] == 0, np.float32(0), scale)
    if not np.isfinite(color).all():
        raise InputError(f"{path} holds values beyond float32; it must be a radiance picture")
    return np.ascontiguousarray(color, dtype=np.float32)


def _hdr_header(path, data):
    """Return width, height, exposure and where the pixels begin."""
    end = data.find(b"\n\n", 0, 1 << 16)
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")) or end < 0:
        raise InputError(f"{path} is not a Radiance HDR picture; it must begin with #?RADIANCE")
    exposure = 1.0
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        key, _, value = line.partition("=")
        if key == "FORMAT" and value.strip() != "32-bit_rle_rgbe":
            raise InputError(
                f"{path} has the format {value.strip()}; it must be 32-bit_rle_rgbe; convert it"
            )
        if key == "EXPOSURE":
            exposure *= _positive(path, value)
    stop = data.find(b"\n", end + 2, end + 100)
    words = data[end + 2 : max(stop, 0)].decode("latin-1").split()
    if len(words) != 4 or (words[0], words[2]) != ("-Y", "+X"):
        raise InputError(
            f"{path} has the size line {' '.join(words)!r}; it must be -Y height +X width; "
            "write the picture again with its top line first"
        )
    height, width = (int(w) if w.isdecimal() else 0 for w in words[1::2])
    if not (width and height) or width * height > MAX_HDR_PIXELS:
        raise InputError(
            f"{path} promises {words[3]} x {words[1]} pixels; they must be positive and at most "
            f"{MAX_HDR_PIXELS} in all"
        )
    return width, height, exposure, stop + 1


def _positive(path, text):
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise InputError(f"{path} has the exposure {text.strip()}; it must be a positive number")
    return value


def _unpack_line(path, packed, line_out, row, height):
    """Undo the run-length code of one line, channel by channel; return the bytes used."""
    width = len(line_out)
    at = 0
    line = bytearray()
    for channel in range(4):
        line.clear()
        while len(line) < width:
            if at + 1 >= len(packed):
                raise _cut_off(path, row, height)
            count = packed[at]
            if count > 128:  # a run of one value
                line += bytes(packed[at + 1 : at + 2]) * (count - 128)
                at += 2
            else:
                line += packed[at + 1 : at + 1 + count]
                at += 1 + count
            if count == 0 or at > len(packed):
                raise _cut_off(path, row, height)
        if len(line) != width:
            raise _cut_off(path, row, height)
        line_out[:, channel] = np.frombuffer(line, np.uint8)
    return at


def _flat_line(path, pixels, line_out, row, height):
    """Read one line of plain or old run-length coded pixels; return the bytes used."""
    width = len(line_out)
    ahead = pixels[: 4 * width].reshape(-1, 4) if len(pixels) >= 4 * width else None
    if ahead is not None and not (ahead[:, :3] == 1).all(axis=1).any():
        line_out[:] = ahead
        return 4 * width
    # Old code: a pixel 1 1 1 n repeats the one before n times, more digits of n may follow.
    filled, at, shift = 0, 0, 0
    while filled < width:
        pixel = pixels[at : at + 4]
        if len(pixel) < 4:
            raise _cut_off(path, row, height)
        if (pixel[:3] == 1).all() and filled > 0:
            count = int(pixel[3]) << shift
            if count > width - filled:
                raise _cut_off(path, row, height)
            line_out[filled : filled + count] = line_out[filled - 1]
            filled += count
            shift += 8
        else:
            line_out[filled] = pixel
            filled += 1
            shift = 0
        at += 4
    return at


def _cut_off(path, row, height):
    return InputError(
        f"{path} ends or is damaged in line {row} of {height}; it must be whole; copy it again"
    )


def _first_line(error):
    return str(error).splitlines()[0] if str(error) else type(error).__name__
