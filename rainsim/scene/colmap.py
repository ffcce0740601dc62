"""Cameras of COLMAP sparse models: cameras and images, binary (.bin) or text (.txt).

COLMAP's camera axes (x right, y down, z forward) and pixel centres are ours. An image's pose takes
world points to its camera.
"""

import math
import mmap
import struct
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from rainsim.errors import InputError
from rainsim.io.files import MAX_LENGTH, printable_name, read_text, require_file
from rainsim.scene.camera_rule import require_camera
from rainsim.scene.types import Camera

PLACES = ("", "0", "sparse/0", "sparse", "colmap/sparse/0", "distorted/sparse/0")
NUMBERED = "[0-9]*"  # folders of one solver's models, the largest of which is taken
MODEL_FILES = ("cameras.bin", "images.bin", "cameras.txt", "images.txt")
MOST_TEXT = 1 << 32  # bytes of a model as text; it lists each point that an image shows
REMEDY = "export the model from COLMAP again"
NAME_LIMIT = 4096  # bytes of an image's name
POINT = 24  # bytes of an observed point, which are skipped

# Name: (COLMAP's number, parameters, separate focal lengths, distorts)
MODELS = {
    "SIMPLE_PINHOLE": (0, 3, False, False),
    "PINHOLE": (1, 4, True, False),
    "SIMPLE_RADIAL": (2, 4, False, True),
    "RADIAL": (3, 5, False, True),
    "OPENCV": (4, 8, True, True),
    "OPENCV_FISHEYE": (5, 8, True, True),
    "FULL_OPENCV": (6, 12, True, True),
    "FOV": (7, 5, True, True),
    "SIMPLE_RADIAL_FISHEYE": (8, 4, False, True),
    "RADIAL_FISHEYE": (9, 5, False, True),
    "THIN_PRISM_FISHEYE": (10, 12, True, True),
    "RAD_TAN_THIN_PRISM_FISHEYE": (11, 16, True, True),
    "SIMPLE_DIVISION": (12, 4, False, True),
    "DIVISION": (13, 5, True, True),
    "SIMPLE_FISHEYE": (14, 3, False, True),
    "FISHEYE": (15, 4, True, True),
    "EUCM": (16, 6, True, True),
}
PANORAMA = 17, "EQUIRECTANGULAR"  # has no focal length
NAMES = {number: name for name, (number, *_) in MODELS.items()}


@dataclass(frozen=True, slots=True)
class _Lens:
    model: str
    width: int
    height: int
    values: tuple


@dataclass(frozen=True, slots=True)
class _Image:
    name: str
    lens: int
    turn: tuple
    shift: tuple


def find_model(folder):
    """Return the folder of the COLMAP sparse model in or below `folder`, or None."""
    for place in PLACES:
        found = Path(folder) / place
        if any(_has_model(found, suffix) for suffix in (".bin", ".txt")):
            beside = _beside(found) if found.name == "0" else []
            return max(beside, key=_size, default=found)
    return None


def _beside(found):
    """Return the numbered models in a folder of models: a solver splits what does not connect."""
    models = sorted(path for path in found.parent.glob(NUMBERED) if path.name.isdecimal())
    return [path for path in models if any(_has_model(path, end) for end in (".bin", ".txt"))]


def _size(model):
    """Return the bytes of a model's images, which grow with their number, and prefer the first."""
    found = (model / f"images{suffix}" for suffix in (".bin", ".txt"))
    return max(path.stat().st_size for path in found if path.is_file())


def _has_model(folder, suffix):
    return (folder / f"cameras{suffix}").is_file() and (folder / f"images{suffix}").is_file()


def read_model(folder):
    """Read the cameras of a COLMAP sparse model.

    folder : path-like. Holds cameras.bin and images.bin, or cameras.txt and
        images.txt; or is the folder above (with sparse/0 and the like).
    Returns cameras : list of Camera. One for each image, sorted by name; named as
        the images are, without their ending.
        notes : list of str. Which lens distortion is ignored.
    Raises InputError if there is no model, or it is damaged; names the image or
        camera.
    """
    found = find_model(folder)
    if found is None:
        raise InputError(
            f"{folder} holds no COLMAP model; it must have cameras and images, .bin or .txt; check "
            "the path"
        )
    lenses, image_file = _lenses_of(found)
    binary = image_file.suffix == ".bin"
    images = _read_binary(image_file, _images) if binary else _text_images(image_file)
    if not images:
        raise InputError(f"{image_file} has no images; it must have some; {REMEDY}")
    images = sorted(images, key=lambda image: image.name)
    names = _short_names([image.name for image in images])
    cameras = [
        _camera(image_file, image, lenses, name) for image, name in zip(images, names, strict=True)
    ]
    notes = _lens_notes(lenses[image.lens] for image in images)
    chosen = found.name.isdecimal() and found != Path(folder)
    others = len(_beside(found)) - 1 if chosen else 0
    if others > 0:
        notes.append(
            f"the solver left {others + 1} models; the largest, {found.parent.name}/{found.name} "
            f"of {len(images)} images, is taken"
        )
    return cameras, notes


def read_lenses(folder):
    """Return the models and distortion coefficients of a sparse model's cameras.

    Returns set of (str, tuple of float). COLMAP's name of each model and its
        parameters after the principal point.
    """
    lenses, _ = _lenses_of(find_model(folder))
    return {(n.model, n.values[4 if MODELS[n.model][2] else 3 :]) for n in lenses.values()}


def _lenses_of(found):
    """Return the lenses of the model in a folder, by number, and the file of its images."""
    if _has_model(found, ".bin"):
        return _read_binary(found / "cameras.bin", _lenses), found / "images.bin"
    return _text_lenses(found / "cameras.txt"), found / "images.txt"


def _short_names(names):
    """Return camera names from file names, without folder and suffix where that is unique."""
    paths = [PurePosixPath(name) for name in names]
    stems = [path.stem for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    return [str(path.with_suffix("")) if path.name else str(path) for path in paths]


def _lens_notes(lenses):
    bent = sorted({lens.model for lens in lenses if _distorts(lens)})
    if not bent:
        return []
    return [
        f"lens distortion of the cameras ({', '.join(bent)}) is ignored: pictures are those of a "
        "pinhole camera"
    ]


def _distorts(lens):
    _, _, two, distorts = MODELS[lens.model]
    fisheye = "FISHEYE" in lens.model or lens.model == "FOV"  # bent even with all values zero
    return distorts and (fisheye or any(lens.values[4 if two else 3 :]))


def _camera(path, image, lenses, name):
    """Return the Camera of an image, all its values checked."""
    lens, label = lenses.get(image.lens), f"{path}: image {image.name[:80]}"
    if lens is None:
        raise InputError(f"{label} has camera {image.lens}; the model has no such camera; {REMEDY}")
    two = MODELS[lens.model][2]
    fx, fy = lens.values[0], lens.values[1 if two else 0]
    cx, cy = lens.values[2 if two else 1 :][:2]
    length = math.hypot(*image.turn)
    if not 1e-6 < length < 1e6 or not all(abs(v) < MAX_LENGTH for v in image.shift):
        raise InputError(
            f"{label} has rotation {image.turn} and translation {image.shift}; "
            f"they must be finite and the rotation not zero; {REMEDY}"
        )
    pose = np.eye(4)
    pose[:3, :3] = _rotation(np.array(image.turn) / length)
    pose[:3, 3] = image.shift
    camera = Camera(lens.width, lens.height, fx, fy, cx, cy, pose, name)
    return require_camera(camera, label, remedy=REMEDY)


def _rotation(turn):
    """Return the rotation matrix of a unit quaternion, w first."""
    w, x, y, z = turn
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def _no_pinhole(path, number):
    return InputError(
        f"{path}: camera {number} is {PANORAMA[1]}, a panorama all around; pictures are drawn by "
        "pinhole cameras; cut it into such views (as cubemaps) and solve those"
    )


# --- binary ---------------------------------------------------------------------------------------


def _read_binary(path, parse):
    path = require_file(path, "a part of a COLMAP model")
    with open(path, "rb") as file:
        try:  # mapped: observed points, most of the file, are never read
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise InputError(f"{path} is empty; {REMEDY}") from None
        with data:
            try:
                return parse(path, _Bytes(data))
            except struct.error:
                raise InputError(f"{path} ends within an entry; it is cut off; {REMEDY}") from None


class _Bytes:
    """A reader of consecutive binary values; it raises struct.error if the data end early."""

    def __init__(self, data):
        self.data, self.place = data, 0

    def take(self, form):
        values = struct.unpack_from(form, self.data, self.place)
        self.place += struct.calcsize(form)
        return values

    def text(self):
        end = self.data.find(b"\0", self.place, self.place + NAME_LIMIT)
        if end < 0:
            raise struct.error
        raw = self.data[self.place : end]
        self.place = end + 1
        return printable_name(raw.decode("utf-8", "replace"))

    def skip(self, count):
        if count > len(self.data) - self.place:
            raise struct.error
        self.place += count


def _lenses(path, data):
    lenses = {}
    for _ in range(data.take("<Q")[0]):  # a count that is too large ends in struct.error
        number, model, width, height = data.take("<IiQQ")
        if model == PANORAMA[0]:
            raise _no_pinhole(path, number)
        if model not in NAMES:
            raise InputError(
                f"{path}: camera {number} has the model {model}; models 0 to {max(NAMES)} are "
                f"known; {REMEDY}"
            )
        values = data.take(f"<{MODELS[NAMES[model]][1]}d")
        lenses[number] = _Lens(NAMES[model], width, height, values)
    return lenses


def _images(path, data):
    images = []
    for _ in range(data.take("<Q")[0]):
        _, *pose, lens = data.take("<I7dI")
        name = data.text()
        data.skip(POINT * data.take("<Q")[0])
        images.append(_Image(name, lens, tuple(pose[:4]), tuple(pose[4:])))
    return images


# --- text -----------------------------------------------------------------------------------------


def _lines(path):
    """Return (number, text) of the lines of a text file, comments left out."""
    lines = read_text(path, "a part of a COLMAP model", MOST_TEXT).split("\n")
    return [(n, line.strip()) for n, line in enumerate(lines, 1) if not line.startswith("#")]


def _wrong(path, number, line, rule):
    shown = line if len(line) <= 60 else line[:57] + "..."
    return InputError(f"{path} line {number} is {shown!r}; it must be {rule}; {REMEDY}")


def _text_lenses(path):
    lenses = {}
    for n, line in _lines(path):
        if not line:
            continue
        try:
            number, model, width, height, *values = line.split()
            if model == PANORAMA[1]:
                raise _no_pinhole(path, number)
            lens = _Lens(model, int(width), int(height), tuple(map(float, values)))
            if len(values) != MODELS[model][1] or max(lens.width, lens.height) > 1 << 63:
                raise ValueError
            lenses[int(number)] = lens
        except (KeyError, ValueError):
            rule = "a camera: number, model, width, height and the model's parameters"
            raise _wrong(path, n, line, rule) from None
    return lenses


def _text_images(path):
    images, lines = [], iter(_lines(path))
    for n, line in lines:
        if not line:
            continue
        try:
            _, *pose, lens, name = line.split(maxsplit=9)
            turn, shift = tuple(map(float, pose[:4])), tuple(map(float, pose[4:]))
            if len(pose) != 7:
                raise ValueError
            images.append(_Image(printable_name(name), int(lens), turn, shift))
        except ValueError:
            rule = "an image: number, rotation (4), translation (3), camera and name"
            raise _wrong(path, n, line, rule) from None
        next(lines, None)  # the observed points, an empty line if there are none
    return images
