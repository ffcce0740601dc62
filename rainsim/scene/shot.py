"""Shots: a camera over the frames that a 3D program has for it, from USD, glTF or Blender.

Such files have metres, an up axis and a frame rate; a shot is in metres with z up, as the ground
frame is, whatever the file has. Blender's cameras come from `examples/blender_camera.py`, which
writes a `transforms.json` with one more key, `shot`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rainsim.errors import InputError
from rainsim.io.files import MAX_LENGTH, read_json
from rainsim.scene.camera_entry import Entry
from rainsim.scene.cameras import cameras_from_data
from rainsim.scene.formats import USD_SUFFIXES
from rainsim.scene.gltf_cameras import read_gltf
from rainsim.scene.shot_camera import MOST_FPS, Z_UP, World, require_chosen
from rainsim.scene.types import GroundFrame
from rainsim.scene.usd_cameras import read_usd

GLTF_SUFFIXES = (".gltf", ".glb")
SHOT = "shot"  # key of a transforms.json
MOST_FRAME = 10**8  # number of a frame


@dataclass(frozen=True, slots=True)
class Shot:
    """One camera over the frames of a file.

    cameras : tuple of Camera. One per frame, in metres with z up; a single one if
        nothing changes.
    fps : float [1/s] or None. None if the file does not say.
    """

    cameras: tuple
    fps: float | None
    first: float
    notes: tuple = ()


def read_shot(path, name=None, fps=24.0, as_stands=False):
    """Return the `Shot` in a file, None if the file is of another kind.

    path : path-like. USD, glTF, or JSON; JSON without the key `shot` is of
        another kind.
    name : str, optional. Of the camera or its path, in a file with several.
    fps : float [1/s]. At which glTF is sampled, which has seconds and no frames.
    as_stands : bool. Numbers and axes as they stand in the file, which then has
        the capture's own coordinates.
    Raises InputError if the file cannot be read, or names the camera and the
        value that is wrong.
    Raises ParameterError if it has several cameras and none of them is named, or
        none has the name.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in USD_SUFFIXES:
        found, world = read_usd(path, name)
    elif suffix in GLTF_SUFFIXES:
        found, world = read_gltf(path, name, fps)
    elif suffix == ".json" and path.is_file():
        data = read_json(path, "a camera file")
        if not isinstance(data, dict) or SHOT not in data:
            return None
        world = _world_of(Entry(path, SHOT, data[SHOT]))
        found = cameras_from_data(data, path)
        require_chosen([str(data[SHOT].get("camera", "Camera"))], name, path)
    else:
        return None
    if not abs(world.first) <= MOST_FRAME:  # true for NaN
        raise InputError(
            f"{path} begins at frame {world.first:g}; it must be from {-MOST_FRAME:g} to "
            f"{MOST_FRAME:g}; number its frames again"
        )
    notes = []
    if all(_alike(camera, found[0]) for camera in found):
        if len(found) > 1:
            notes.append(f"the camera stands still in the {len(found)} frames of {path.name}")
        found = found[:1]
    if as_stands:
        turn, scale = np.eye(3), 1.0
    else:
        turn, scale = Z_UP[world.up], world.meters
    frame = GroundFrame(turn, scale, np.zeros(3))
    cameras = tuple(
        replace(frame.camera_in_ground(camera), name=f"frame_{world.first + k:g}")
        for k, camera in enumerate(found)
    )
    return Shot(cameras, world.fps, world.first, tuple(notes))


def is_shot(path):
    """Return whether a file is one that `read_shot` reads."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".json" and path.is_file():
        data = read_json(path, "a camera file")
        return isinstance(data, dict) and SHOT in data
    return suffix in (*USD_SUFFIXES, *GLTF_SUFFIXES)


def _world_of(entry):
    """Return the `World` of the key `shot` of a transforms.json."""
    up = entry.get("up_axis")
    if up not in Z_UP:
        raise entry.error("up_axis", "Y or Z")
    meters = entry.number("meters_per_unit", 0, MAX_LENGTH)
    return World(
        up, meters, entry.number("fps", 0, MOST_FPS),
        entry.number("first_frame", -MAX_LENGTH, MAX_LENGTH),
    )  # fmt: skip


def _alike(one, other):
    lens = ("width", "height", "fx", "fy", "cx", "cy")
    return np.array_equal(one.camera_from_world, other.camera_from_world) and all(
        getattr(one, name) == getattr(other, name) for name in lens
    )
