"""Headers of PLY files: which elements lie where in the file, checked against its size."""

import os
from dataclasses import dataclass

import numpy as np

from rainsim.errors import InputError

HEADER_LIMIT = 1 << 18  # bytes; a real header has some 2,000
REMEDY = "export the capture as a standard 3D Gaussian Splatting PLY"

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class Element:
    """`count` rows of type `row` from byte `offset` on; both None where lists hide the size."""

    name: str
    count: int
    names: tuple
    row: np.dtype | None
    offset: int | None
    room: int

    def require_room(self, path):
        """Raise InputError unless the file can hold all rows."""
        size = self.row.itemsize if self.row is not None else 0
        thing = "splats" if self.name == "vertex" else f"{self.name} rows"
        if self.count == 0 or size == 0:
            raise InputError(f"{path} holds 0 {thing}; it must hold at least one; {REMEDY}")
        if self.count * size > self.room:
            raise InputError(
                f"{path} promises {self.count} {thing} of {size} bytes but has room for "
                f"{max(self.room, 0) // size}; it is truncated or damaged; copy or export it again"
            )


@dataclass(frozen=True, slots=True)
class Header:
    """The elements of a PLY file in their order, and its comments."""

    elements: tuple
    comments: tuple = ()

    def find(self, name):
        """Return the first element with a name, or None."""
        return next((element for element in self.elements if element.name == name), None)

    @property
    def antialiased(self):
        """Whether the splats were trained to be weakened where a pixel widens them.

        Brush notes `SplatRenderMode: mip` (`default` and `2dgs` otherwise), Postshot `antialiased
        1` (or 0). The last such comment counts.
        """
        found = False
        for comment in self.comments:
            match comment.lower().split():
                case ["splatrendermode:", mode, *_] if mode in ("default", "mip", "2dgs"):
                    found = mode == "mip"
                case ["antialiased", ("0" | "1") as value, *_]:
                    found = value == "1"
        return found

    @property
    def compressed(self):
        """Whether the splats are packed as PlayCanvas compressed PLY files have them."""
        vertex = self.find("vertex")
        return vertex is not None and "packed_position" in vertex.names


def read_header(path, file):
    """Return the Header of the PLY file that is open as `file`, or raise InputError."""
    start = file.read(HEADER_LIMIT)
    end = start.find(b"\nend_header")
    stop = start.find(b"\n", end + 1)
    if end < 0 or stop < 0:
        raise InputError(f"{path} has no end_header line; a PLY must have one; {REMEDY}")
    size, offset = os.fstat(file.fileno()).st_size, stop + 1
    text, elements = start[:end].decode("ascii", "replace"), []
    for name, count, properties in _parse(path, text):
        names = tuple(name for name, _ in properties)
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{path} has the property {twice} twice; names must differ; {REMEDY}")
        row = None
        if not any(kind == "list" for _, kind in properties):
            row = np.dtype(properties)
        room = 0 if offset is None else size - offset
        elements.append(Element(name, count, names, row, offset, room))
        offset = None if offset is None or row is None else offset + count * row.itemsize
    comments = (line.strip() for line in text.splitlines())
    comments = tuple(c.removeprefix("comment ") for c in comments if c.startswith("comment "))
    return Header(tuple(elements), comments)


def header_of(path):
    """Return the Header of a file, None if it is no PLY."""
    with open(path, "rb") as file:
        if not file.read(4).startswith((b"ply\n", b"ply\r")):
            return None
        file.seek(0)
        return read_header(path, file)


def _parse(path, text):
    """Return the elements in order, each as (name, count, [(property, numpy type)])."""
    order, elements = None, []
    for number, line in enumerate(text.splitlines()[1:], start=2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", "ascii", *_]:
                raise InputError(
                    f"{path} is an ASCII PLY; splats must be stored as binary; {REMEDY}"
                )
            case ["format", kind, *_] if kind in ORDERS:
                order = ORDERS[kind]
            case ["element", name, count] if count.isdecimal() and len(count) < 19:
                elements.append((name, int(count), []))
            case ["property", "list", _, _, name] if elements:
                elements[-1][2].append((name, "list"))
            case ["property", kind, name] if elements and order and kind in TYPES:
                elements[-1][2].append((name, order + TYPES[kind]))
            case _:
                shown = line.strip()[:60]
                raise InputError(f"{path} line {number} is {shown!r}; no PLY has that; {REMEDY}")
    if order is None:
        raise InputError(f"{path} has no format line; a PLY must have one; {REMEDY}")
    return elements
