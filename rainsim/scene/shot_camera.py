"""A camera of a shot as its file has it: its lens, its place, and the world that it stands in."""

from typing import NamedTuple

import numpy as np

from rainsim.errors import InputError, ParameterError, counted, shown
from rainsim.scene.camera_entry import FLIP, Entry
from rainsim.scene.types import pose_at

NOMINAL = 1920  # px, width of the pictures of files that give their shape alone
SHAPE = 1.5  # width over height where a file does not even give that
MOST_FRAMES = 100_000
MOST_LISTED = 8  # cameras in an error message
MOST_FPS = 1e4  # frames/s
Z_UP = {"Z": np.eye(3), "Y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}


class Lens(NamedTuple):
    """A lens in widths and heights of the picture.

    focal : float. Focal length over the picture's width.
    right, down : float. Principal point from the middle, over width and height.
    shape : float. Width over height, as lengths.
    size : (int, int) or None. Width and height [px].
    """

    focal: float
    right: float
    down: float
    shape: float
    size: tuple | None = None


class World(NamedTuple):
    """Of a file: its up axis, metres per unit, frames/s if it names them, and its first frame."""

    up: str
    meters: float
    fps: float | None
    first: float


def require_chosen(names, wanted, path):
    """Return the index of the camera that is wanted by its path, or by the last part of it."""
    if not names:
        raise InputError(
            f"{path} holds no camera; it must have one; export it again, cameras included"
        )
    if wanted is None and len(names) == 1:
        return 0
    for known in (names, [name.rpartition("/")[2] for name in names]):
        if known.count(wanted) == 1:
            return known.index(wanted)
    listed = names if len(names) <= MOST_LISTED else [*names[: MOST_LISTED - 1], "..."]
    asked = "none is named" if wanted is None else f"none is {shown(wanted)}"
    raise ParameterError(
        f"{path} has {counted(len(names), 'camera')} ({', '.join(listed)}) and {asked}; one must "
        "be; give --path-camera NAME"
    )


def frame_times(begin, end, step, path):
    """Return the times of frames from `begin` to `end`, `step` apart; InputError for too many."""
    count = np.floor((end - begin) / step + 1e-3) + 1 if step > 0 else np.nan
    if not 1 <= count <= MOST_FRAMES:  # false for NaN
        raise InputError(
            f"{path} has frames from {begin:g} to {end:g}; there must be 1 to {MOST_FRAMES}; set "
            "the range again"
        )
    return begin + step * np.arange(int(count))


def camera_at(path, label, matrix, lens):
    """Return the Camera of a place in a file's world, with OpenGL axes, and a `Lens`.

    `matrix` (4, 4) is world_from_camera; scales of its parents do not matter to a camera.
    """
    entry = Entry(path, label, {"place": np.asarray(matrix).tolist()})
    matrix = entry.array("place", (4, 4))
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not (lengths > 0).all() or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise entry.error("place", "a rotation, a translation and scales above 0")
    turn = entry.rotation("place", matrix[:3, :3] / lengths) * FLIP
    if not np.isfinite(lens[:4]).all() or min(lens.focal, lens.shape) <= 0:
        raise InputError(
            f"{entry.label} has a focal length of {lens.focal:g} widths of the picture, whose "
            f"shape is {lens.shape:g}; both must be above 0; correct the lens"
        )
    if lens.size:
        width, height = lens.size
        lens_px = lens.focal * width, lens.focal * lens.shape * height
        down = lens.down * height
    else:
        width, height = NOMINAL, max(1, round(NOMINAL / lens.shape))
        lens_px = (lens.focal * width,) * 2
        down = lens.down * width / lens.shape
    centre = width * (0.5 + lens.right), height / 2 + down
    return entry.camera((width, height), (*lens_px, *centre), pose_at(turn.T, matrix[:3, 3]), "")
