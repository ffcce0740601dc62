"""Lens distortion from the files that a capture's cameras came with."""

from pathlib import Path

from rainsim.errors import InputError, ParameterError
from rainsim.io.files import MAX_LENGTH, read_json
from rainsim.scene.camera_entry import Entry
from rainsim.scene.colmap import find_model, read_lenses
from rainsim.sensors.lens import Lens, lens_of

FISHEYES = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE",
            "FISHEYE")  # fmt: skip
OPENCV_KEYS, FISHEYE_KEYS = ("k1", "k2", "p1", "p2", "k3"), ("k1", "k2", "k3", "k4")
SAME = "all must be of one lens; give its coefficients, such as opencv:k1,k2,p1,p2"


def lens_named(text):
    """Return the `Lens` of a text, or of a transforms.json or COLMAP model; None for pinholes."""
    if ":" in text and not Path(text).exists():
        return lens_of(text)
    path = Path(text)
    if path.is_dir() and find_model(path) is not None:
        lenses = {_of_colmap(path, *entry) for entry in read_lenses(path)}
    elif path.is_dir():
        raise InputError(f"{path} holds no COLMAP model; --lens takes one, or a transforms.json")
    elif path.is_file():
        lenses = _of_transforms(path)
    else:
        raise ParameterError(
            f"lens is {text!r}; it must be opencv:k1,k2,p1,p2[,k3], fisheye:k1,k2,k3,k4, "
            "division:k, eucm:alpha,beta, or name a transforms.json or the folder of a COLMAP model"
        )
    if len(lenses) != 1:
        raise InputError(f"{path} has cameras of {len(lenses)} lenses; {SAME}")
    return lenses.pop()


def _of_colmap(path, model, values):
    """Return the `Lens` of a COLMAP camera's coefficients, None for a pinhole."""
    if model in ("SIMPLE_PINHOLE", "PINHOLE") or not any(values):
        return Lens("fisheye", (0.0,) * 4) if model in FISHEYES else None
    if model in FISHEYES:
        return Lens("fisheye", (*values, 0.0, 0.0, 0.0)[:4])
    if model in ("SIMPLE_RADIAL", "RADIAL"):
        return Lens("opencv", ((*values, 0.0)[0], (*values, 0.0)[1], 0.0, 0.0))
    if model in ("SIMPLE_DIVISION", "DIVISION"):
        return Lens("division", values)
    if model == "EUCM":
        return Lens("eucm", values)
    if model == "OPENCV" or (model == "FULL_OPENCV" and not any(values[5:])):
        return Lens("opencv", values[:5])
    raise InputError(
        f"{path} has cameras of the model {model}; OPENCV, RADIAL, DIVISION, EUCM and the "
        "fisheyes OPENCV_FISHEYE, RADIAL_FISHEYE and FISHEYE are drawn; undistort it to one of "
        "these, or leave out --lens"
    )


def _of_transforms(path):
    """Return the lenses of the frames of a transforms.json, a set."""
    data = read_json(path, "a camera file")
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path} has no list named frames; it must be a transforms.json")
    lenses = set()
    for number, frame in enumerate(frames):
        entry = Entry(path, f"frame {number}", frame, data)
        fisheye = entry.get("camera_model") == "OPENCV_FISHEYE"
        keys = FISHEYE_KEYS if fisheye else OPENCV_KEYS
        values = tuple(
            0.0 if entry.get(key) is None else entry.number(key, -MAX_LENGTH, MAX_LENGTH)
            for key in keys
        )
        bent = any(values) or fisheye
        lenses.add(Lens("fisheye" if fisheye else "opencv", values) if bent else None)
    return lenses
