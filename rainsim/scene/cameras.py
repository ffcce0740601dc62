"""Cameras: files of capture tools in and out, and cameras placed by hand.

Four formats are read: `cameras.json` of the original 3D Gaussian Splatting code, the NeRF style
`transforms.json`, whose cameras look along their own -z with y up, COLMAP sparse models, and the
camera paths of nerfstudio, see `rainsim.scene.camera_path`.
"""

import math
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from rainsim.errors import InputError, ParameterError
from rainsim.io.files import json_number, number_array, printable_name, read_json, write_json
from rainsim.scene.camera_entry import FLIP, Entry
from rainsim.scene.camera_path import is_camera_path, path_cameras, path_moments
from rainsim.scene.camera_rule import (
    LEAST_FOV,
    MAX_FOCAL,
    MAX_SIDE,
    MOST_FOV,
    ROUNDING,
    focal_length,
    require_camera,
)
from rainsim.scene.colmap import MODEL_FILES, read_model
from rainsim.scene.picture_size import with_size
from rainsim.scene.types import Camera, pose_at

JSON_FILES = ("cameras.json", "transforms.json")  # looked for in a folder, in this order
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
MIRROR_CLEARANCE = 0.015  # m above the water: lower things cannot be distinguished from the ground
PLACED = "choose another view, --width or --height"
# Models whose poses and focal lengths are a pinhole's; their distortion is left out and said.
PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "OPENCV_FISHEYE")


def read_cameras(path):
    """Read the cameras of a `cameras.json`, a `transforms.json`, a path or a COLMAP sparse model.

    path : path-like. A JSON file of any kind; one of the files of a COLMAP model;
        or a folder with `cameras.json`, `transforms.json` or sparse/0 in it.
    Returns list of Camera. In the file's order (of a COLMAP model sorted by
        name), in the capture frame. Lens distortion is not applied: splats are
        drawn as an undistorted pinhole camera sees them.
    Raises InputError: Names the camera and the value that is missing or wrong.
    """
    return load_cameras(path)[0]


def load_cameras(path):
    """Return the cameras that `read_cameras` reads, and notes on ignored lens distortion.

    Examples
    --------
    >>> rainsim.write_transforms("path.json", scene.cameras)
    >>> cameras, notes = rainsim.load_cameras("path.json")
    >>> len(cameras), notes
    (3, [])
    """
    path = Path(path)
    if path.is_dir():
        found = next((path / name for name in JSON_FILES if (path / name).is_file()), None)
        if found is None:
            return read_model(path)
        path = found
    elif path.name in MODEL_FILES:
        return read_model(path.parent)
    data, notes = with_size(read_json(path, "a camera file"), path)
    return cameras_from_data(data, path), [*notes, *_distortion_notes(data)]


def read_path(path):
    """Return the cameras that `read_cameras` reads, and the moments of a path.

    The second are those of `camera_path.path_moments`; of other files there are none.
    """
    cameras, path = read_cameras(path), Path(path)
    if path.suffix.lower() != ".json":
        return cameras, ()
    data = read_json(path, "a camera file")
    return cameras, path_moments(data, path) if is_camera_path(data) else ()


def _distortion_notes(data):
    """Return a list with a note if a transforms.json has lens distortion, else an empty list."""
    if not isinstance(data, dict):
        return []
    entries = [data, *(f for f in data.get("frames") or () if isinstance(f, dict))]
    bent = sorted({key for entry in entries for key in DISTORTION if json_number(entry.get(key))})
    if any(entry.get("camera_model") == "OPENCV_FISHEYE" for entry in entries):
        bent = ["OPENCV_FISHEYE", *bent]
    if not bent:
        return []
    return [
        f"lens distortion of the cameras ({', '.join(bent)}) is ignored: pictures are those of a "
        "pinhole camera"
    ]


def cameras_from_data(data, source):
    """Return the cameras in `data`, read from JSON in `source`; see `read_cameras`."""
    if isinstance(data, list) and data:
        return [_capture_camera(Entry(source, f"camera {i}", c)) for i, c in enumerate(data)]
    if isinstance(data, dict) and isinstance(data.get("frames"), list) and data["frames"]:
        return [
            _nerf_camera(Entry(source, f"frame {i}", frame, data))
            for i, frame in enumerate(data["frames"])
        ]
    if is_camera_path(data):
        return path_cameras(data, source)
    raise InputError(
        f"{source} holds no cameras; it must be a list of cameras (cameras.json) or have a list "
        "named frames (transforms.json) or camera_path (camera_path.json); check the path"
    )


def write_transforms(path, cameras, file_paths=None, lens=None):
    """Write cameras as a NeRF style `transforms.json` that `read_cameras` reads back exactly.

    Parameters
    ----------
    path : path-like
        Replaced whole or not at all.
    cameras : sequence of Camera
        Pinhole cameras.
    file_paths : sequence of str, optional
        The pictures that belong to the cameras; by default the cameras' names.
    lens : dict, optional
        camera_model and coefficients of the lens that distorts the pictures.
    """
    write_json(path, cameras_to_data(cameras, file_paths) | (lens or {}))


def cameras_to_data(cameras, file_paths=None):
    """Return the content of the file that `write_transforms` writes, as a dict."""
    file_paths = [c.name for c in cameras] if file_paths is None else list(file_paths)
    frames = [
        _nerf_frame(camera, file_path)
        for camera, file_path in zip(cameras, file_paths, strict=True)
    ]
    return {"camera_model": "PINHOLE", "frames": frames}


def _nerf_frame(camera, file_path):
    if camera.orthographic:
        raise ParameterError(
            f"camera {camera.name!r} is orthographic; transforms.json holds pinhole cameras only"
        )
    return {
        "name": camera.name,
        "file_path": str(file_path),
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "transform_matrix": _nerf_matrix(camera.camera_from_world).tolist(),
        # Inverting a pose rounds; this copy makes the way there and back exact.
        "camera_from_world": camera.camera_from_world.tolist(),
    }


def _nerf_matrix(camera_from_world):
    matrix = np.eye(4)
    rotation = camera_from_world[:3, :3].T
    matrix[:3, :3] = rotation * FLIP
    matrix[:3, 3] = -rotation @ camera_from_world[:3, 3]
    return matrix


# --- reading --------------------------------------------------------------------------------------


def _capture_camera(entry):
    # `rotation` has the camera's axes as columns; `position` is its centre.
    rotation = entry.rotation("rotation", entry.array("rotation", (3, 3)))
    width, height = entry.side("width"), entry.side("height")
    name = entry.get("img_name")
    focal = entry.number("fx", 0, MAX_FOCAL), entry.number("fy", 0, MAX_FOCAL)
    return entry.camera(
        (width, height), (*focal, width / 2, height / 2),
        pose_at(rotation.T, entry.array("position", (3,))),
        printable_name(entry.get("id") if name is None else name),
    )  # fmt: skip


def _nerf_camera(entry):
    model = entry.get("camera_model")
    if model is not None and model not in PINHOLES:
        raise entry.error("camera_model", f"one of {', '.join(PINHOLES)}")
    width, height = entry.side("w"), entry.side("h")
    cx = width / 2 if entry.get("cx") is None else entry.number("cx", -MAX_FOCAL, MAX_FOCAL)
    cy = height / 2 if entry.get("cy") is None else entry.number("cy", -MAX_FOCAL, MAX_FOCAL)
    lens = *_focal_lengths(entry, width, height), cx, cy
    return entry.camera((width, height), lens, _nerf_pose(entry), _nerf_name(entry))


def _focal_lengths(entry, width, height):
    """Return fx, fy [px] from the focal lengths or angles in the file; pixels default to square."""
    found = []
    for axis, size in (("x", width), ("y", height)):
        if entry.get(f"fl_{axis}") is not None:
            found.append(entry.number(f"fl_{axis}", 0, MAX_FOCAL))
        elif entry.get(f"camera_angle_{axis}") is not None:
            angle = entry.number(f"camera_angle_{axis}", 0, math.pi)
            found.append(focal_length(size, angle))
    if not found:
        raise entry.error("fl_x", "a number above 0, unless there is a camera_angle_x [radians]")
    return found[0], found[-1]


def _nerf_pose(entry):
    key = "transform_matrix"
    matrix = number_array(entry.get(key), (3, 4))  # some programs leave out the last row
    if matrix is None:
        matrix = entry.array(key, (4, 4))[:3]
    rotation = entry.rotation(key, matrix[:, :3]) * FLIP
    pose = pose_at(rotation.T, matrix[:, 3])
    exact = entry.values.get("camera_from_world")
    if exact is not None:
        exact = entry.array("camera_from_world", (4, 4))
        # If another program has edited transform_matrix and not our copy, transform_matrix counts.
        if np.allclose(_nerf_matrix(exact)[:3], matrix, rtol=1e-12, atol=1e-12):
            return exact
    return pose


def _nerf_name(entry):
    name = entry.values.get("name")
    if name is None:
        name = PurePosixPath(str(entry.values.get("file_path") or "")).stem
    return printable_name(name)


# --- placing --------------------------------------------------------------------------------------


def look_at(eye, target, up, fov_degrees, width, height, name=""):
    """Return a camera at `eye` that looks at `target`.

    Parameters
    ----------
    eye, target : array_like of shape (3,)
        In the frame that the camera is for.
    up : array_like of shape (3,)
        A direction that points up in the picture; need not be at right angles to the view.
    fov_degrees : float [degrees]
        Horizontal field of view.
    width, height : int [px]
    name : str

    Returns
    -------
    Camera
        With square pixels and the principal point at the centre.

    Raises
    ------
    ParameterError
        If eye and target are the same point, the view runs along `up`, or a value is out of range.

    Examples
    --------
    >>> camera = rainsim.look_at((0, -3, 1.5), (0, 0, 1.5), (0, 0, 1), 60, 640, 480)
    >>> camera.position.tolist(), camera.forward.tolist()
    ([0.0, -3.0, 1.5], [0.0, 1.0, 0.0])
    """
    eye, target, up = (_vector(n, v) for n, v in (("eye", eye), ("look-at", target), ("up", up)))
    width, height = _side("width", width), _side("height", height)
    if not LEAST_FOV / ROUNDING <= fov_degrees <= MOST_FOV * ROUNDING:  # false for NaN
        raise ParameterError(
            f"fov is {fov_degrees} degrees; it must be from {LEAST_FOV:g} to {MOST_FOV:g}; 60 is "
            "usual"
        )
    forward = target - eye
    distance = np.linalg.norm(forward)
    if distance <= 1e-9 * np.abs(eye).max():
        raise ParameterError(
            f"eye and look-at are both {_shown(eye)}; they must differ; move one of them"
        )
    forward /= distance
    right = np.cross(forward, up)
    length = np.linalg.norm(right)
    if length <= 1e-6 * np.linalg.norm(up):
        raise ParameterError(
            f"the view from {_shown(eye)} to {_shown(target)} runs along up {_shown(up)}; it must "
            "not; move the eye a little aside"
        )
    right /= length
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = focal_length(width, math.radians(fov_degrees))
    camera = Camera(
        width, height, focal, focal, width / 2, height / 2, pose_at(rotation, eye), name=name
    )
    return require_camera(camera, "the camera that is placed", ParameterError, PLACED)


def orbit(ground_frame, cameras, target=None, count=24, width=None, height=None):
    """Return `count` cameras on a full circle about the point that the capture's cameras look at.

    The circle is level and runs counter-clockwise seen from above, starts at the first camera's
    side, and has the cameras' mean height and mean horizontal distance from its axis.

    Parameters
    ----------
    ground_frame : GroundFrame
    cameras : sequence of Camera
        The capture's cameras, in the capture frame; at least one.
    target : array_like of shape (3,), optional
        The point to look at, in the capture frame; by default the point nearest to all the
        cameras' view axes (least squares).
    count : int
    width, height : int [px], optional
        See `resize_to`; the horizontal field of view is always the first camera's.

    Returns
    -------
    list of Camera
        In the capture frame, named "orbit_000" and so on.

    Examples
    --------
    >>> cameras = rainsim.orbit(scene.ground_frame, scene.cameras, count=4)
    >>> [camera.name for camera in cameras]
    ['orbit_000', 'orbit_001', 'orbit_002', 'orbit_003']
    """
    if not cameras:
        raise ParameterError(
            "an orbit needs the capture's cameras and there are none; give a path or an eye and a "
            "look-at point instead"
        )
    if count < 1:
        raise ParameterError(f"the orbit has {count} frames; it must have at least 1")
    first = resize_to(cameras[0], width, height)
    grounded = [ground_frame.camera_in_ground(camera) for camera in cameras]
    eyes = np.array([camera.position for camera in grounded])
    centre = _looked_at(grounded) if target is None else ground_frame.to_ground(target)
    offsets = eyes[:, :2] - centre[:2]
    radius = np.hypot(*offsets.T).mean()
    start = math.atan2(offsets[0, 1], offsets[0, 0])
    fov = 2 * math.degrees(math.atan(first.width / 2 / first.fx))
    placed = []
    for i in range(count):
        angle = start + 2 * math.pi * i / count
        eye = (
            centre[0] + radius * math.cos(angle),
            centre[1] + radius * math.sin(angle),
            eyes[:, 2].mean(),
        )
        camera = look_at(eye, centre, (0, 0, 1), fov, first.width, first.height, f"orbit_{i:03d}")
        placed.append(ground_frame.camera_in_capture(camera))
    return placed


def _looked_at(cameras):
    """Return the point nearest to all view axes, or one ahead of them if they do not meet.

    For axes through p_i along unit d_i it solves sum (I - d_i d_i^T) (x - p_i) = 0.
    """
    eyes = np.array([camera.position for camera in cameras])
    views = np.array([camera.forward for camera in cameras])
    across = np.eye(3) - views[:, :, None] * views[:, None, :]
    total = across.sum(axis=0)
    spread = np.linalg.eigvalsh(total)[0] / len(cameras)
    if spread > 0.01:  # the axes differ by more than some 10 degrees: their crossing is well placed
        point = np.linalg.solve(total, np.einsum("nij,nj->i", across, eyes))
        if np.einsum("nj,nj->n", point - eyes, views).mean() > 0:
            return point
    middle, ahead = eyes.mean(axis=0), views.mean(axis=0)
    # To where the mean view meets the ground, but no further than four times the height.
    return middle + ahead * (abs(middle[2]) / max(-ahead[2], 0.25))


def mirrored_camera(camera, frame, level):
    """Return the plane to cut at and the camera mirrored at the water `level` [m].

    The mirrored camera sees, pixel for pixel, what level water mirrors to the camera; its matrix
    holds a reflection. What lies below the water is cut away.
    """
    up = frame.up
    height = (level - frame.translation[2]) / frame.meters_per_unit  # along up, capture units
    flip = np.eye(4)
    flip[:3, :3] -= 2 * (up[:, None] * up)
    flip[:3, 3] = 2 * height * up
    plane = np.empty(4)
    plane[:3], plane[3] = up, height + MIRROR_CLEARANCE / frame.meters_per_unit
    return plane, camera.posed(camera.camera_from_world @ flip)


def cropped(camera, window):
    """Return the camera that takes only a window (left, top, right, bottom) [px] of the picture."""
    left, top, right, bottom = window
    return replace(
        camera, width=right - left, height=bottom - top, cx=camera.cx - left, cy=camera.cy - top
    )


def resize_to(camera, width=None, height=None):
    """Return the camera with its picture `width` px wide, its shape kept unless `height` is given.

    With both, the picture is cropped or widened about its centre line rather than squeezed: the
    horizontal field of view and the shape of a pixel stay.

    Examples
    --------
    >>> rainsim.resize_to(scene.cameras[0], width=32).height
    24
    """
    if width is None and height is None:
        return camera
    if width is None:
        width = max(1, round(camera.width * _side("height", height) / camera.height))
    same_shape = max(1, round(camera.height * _side("width", width) / camera.width))
    scaled = camera.resized(width, same_shape)
    if height is None or _side("height", height) == same_shape:
        return scaled
    scaled = replace(scaled, height=height, cy=scaled.cy + (height - same_shape) / 2)
    return require_camera(scaled, f"camera {camera.name}", ParameterError, PLACED)


def _vector(name, value):
    vector = number_array(value, (3,))
    if vector is None:
        raise ParameterError(f"{name} is {value!r}; it must be three finite numbers x,y,z")
    return vector


def _side(name, value):
    if isinstance(value, bool) or value != int(value) or not 1 <= value <= MAX_SIDE:
        raise ParameterError(
            f"{name} is {value} px; it must be a whole number from 1 to {MAX_SIDE}"
        )
    return int(value)


def _shown(vector):
    return "(" + ", ".join(f"{v:g}" for v in vector) + ")"
