"""OpenEXR files of several parts. OpenEXR's own library writes them, from the extra `exr`."""

from fractions import Fraction

import numpy as np

from rainsim.errors import InputError, RainsimError
from rainsim.io.files import replacing
from rainsim.numerics.color_spaces import REC709, to_rec709

LARGEST_HALF = np.float32(65504)
BRIGHT = 8.0  # display white


def openexr():
    """Return the module OpenEXR, None where it is not installed."""
    try:
        import OpenEXR  # an extra: most runs need no float pictures
    except ImportError:
        return None
    return OpenEXR


def require_exr():
    """Raise RainsimError unless OpenEXR files can be written; to be asked before all work."""
    exr = openexr()
    if exr is None or not hasattr(exr, "Part"):
        raise RainsimError(
            "OpenEXR 3.3 or later is not installed; it reads and writes OpenEXR files (--exr); "
            'pip install "rainsim[exr]"'
        )


def half(values):
    """Return values as float16; what is too large for it is the largest that it has."""
    return np.clip(values, -LARGEST_HALF, LARGEST_HALF).astype(np.float16)


def half_or_float(values):
    """Return light as float16, or as float32 where lamps are so bright that rounding would show.

    A value of 8 times white is rounded by up to .002 of white in a half float.
    """
    return half(values) if fits_half(values) else values.astype(np.float32)


def fits_half(values):
    """Tell whether light is dark enough for half floats."""
    return bool(np.max(values, initial=0) <= BRIGHT)


def write_parts(path, parts, header, frame_rate):
    """Write a multipart OpenEXR file, whole or not at all.

    A part is its name, its channels by name, each an ndarray of shape (height, width), float16 or
    float32, and attributes of this part alone; `header` has those of all parts. `frame_rate` is in
    1/s.
    """
    exr = openexr()
    common = {
        **header, "compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage,
        "framesPerSecond": Fraction(frame_rate).limit_denominator(1001),
    }  # fmt: skip
    made = [
        exr.Part(
            {**common, **own},
            {name: np.ascontiguousarray(plane) for name, plane in channels.items()},
            part,
        )
        for part, channels, own in parts
    ]
    with replacing(path) as temporary, exr.File(made) as file:
        try:
            file.write(str(temporary))
        except RuntimeError as error:  # the library's way to say that the disk is full
            fault = str(error).replace(str(temporary), str(path)).splitlines()[0].rstrip(".")
            raise RainsimError(
                f"{path} could not be written ({fault}); its folder must have room and take files; "
                "make room, or give another --out"
            ) from None


def read_parts(path):
    """Return an OpenEXR file's parts by name: float32 channels by name, and header."""
    require_exr()
    fault = "some part's pixels are missing or damaged"
    try:
        with openexr().File(str(path), header_only=True) as file:
            wanted = [(part.name(), len(part.header["channels"])) for part in file.parts]
        with openexr().File(str(path), separate_channels=True) as file:
            found = {
                part.name(): (
                    {name: np.float32(each.pixels) for name, each in part.channels.items()},
                    dict(part.header),
                )
                for part in file.parts
            }
    except Exception as error:  # the library raises what it likes
        found, wanted, fault = {}, None, str(error).splitlines()[0]
    # The library leaves out a part that is damaged, and only prints a warning.
    if [(name, len(channels)) for name, (channels, _) in found.items()] != wanted:
        raise InputError(f"{path} cannot be read as OpenEXR: {fault}; write it again")
    return found


def light_of(channels, header):
    """Return the light of a part of `read_parts` in linear Rec. 709, (height, width, 3).

    Its channels R, G and B are in the space of the header's chromaticities; without them in
    Rec. 709, as OpenEXR has it.
    """
    matrix = to_rec709(header.get("chromaticities", REC709))
    return np.stack([channels[name] for name in "RGB"], axis=-1) @ matrix.T
