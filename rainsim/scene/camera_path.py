"""Camera paths as nerfstudio's viewer writes them (`camera_path.json`), in and out.

One camera for each frame: `camera_to_world`, a 4 x 4 matrix as 16 numbers row by row with OpenGL
axes (x right, y up, z back), and `fov`, the angle of the picture's height in degrees. The pictures'
size is `render_width` x `render_height`; pixels are square, the principal point is the middle.
`render_time`, of frames and keyframes, is the time of the rain in seconds that they show; without
it time goes on from frame to frame. Its seconds are those of the file's own `fps`: a run at another
frame rate shows the same states of the rain, faster or slower.
"""

import math

import numpy as np

from rainsim.errors import InputError
from rainsim.io.files import json_number
from rainsim.scene.camera_entry import FLIP, Entry
from rainsim.scene.camera_rule import focal_length
from rainsim.scene.types import pose_at

KINDS = ("perspective",)  # of `camera_type`: others are no pinhole cameras
MOST_SECONDS = 86_400.0  # between two keyframes, and of rain
MOST_FPS = 1e4  # frames/s of a file
USUAL_SECONDS = 2.0


def is_camera_path(data):
    """Return whether data read from JSON have the form of a camera path."""
    return (
        isinstance(data, dict)
        and isinstance(data.get("camera_path"), list)
        and bool(data["camera_path"])
    )


def path_cameras(data, source):
    """Return the cameras of a camera path, in the capture frame, named "path_00000" and so on."""
    whole = Entry(source, "camera path", data)
    if str(data.get("camera_type", KINDS[0])).lower() not in KINDS:
        raise whole.error("camera_type", "perspective: only pinhole cameras are drawn")
    return [
        _camera(Entry(source, f"camera_path {i}", frame, data), i)
        for i, frame in enumerate(data["camera_path"])
    ]


def path_moments(data, source):
    """Return the number of the rain's state that each frame of a camera path shows.

    Returns tuple of int. Those nearest to the frames' `render_time`; empty where
        no frame has one, and where time goes on from frame to frame at the file's
        `fps`.
    Raises InputError if some frames have no time, or one less than the frame
        before: rain runs forwards.
    """
    frames = data["camera_path"]
    times = [_rain_time(Entry(source, f"camera_path {i}", f)) for i, f in enumerate(frames)]
    if all(time is None for time in times):
        return ()
    fps, moments = Entry(source, "camera path", data).number("fps", 0, MOST_FPS), []
    for i, time in enumerate(times):
        entry = Entry(source, f"camera_path {i}", frames[i])
        if time is None:
            raise entry.error("render_time", "a time in seconds, as other frames have one")
        if i and time < times[i - 1]:
            raise entry.error("render_time", f"{times[i - 1]:g} or more, as rain runs forwards")
        moments.append(round(time * fps))
    return () if moments == list(range(len(frames))) else tuple(moments)


def _rain_time(entry):
    """Return the `render_time` [s] of a frame or keyframe, None if it has none."""
    if entry.values.get("render_time") is None:
        return None
    time = json_number(entry.values["render_time"])
    if time is None or not 0 <= time < MOST_SECONDS:
        raise entry.error("render_time", f"a time from 0 to {MOST_SECONDS:g} s")
    return time


def path_keyframes(data, source):
    """Return the keyframes that a camera path goes through.

    Returns list of (Camera, float, float or None). In the capture frame; the
        seconds from the keyframe before; the time of the rain [s] that it shows,
        if it has one. A closed path ends with its first keyframe again.
    Raises InputError if there is none, or names the keyframe and the value that
        is missing or wrong.
    """
    keyframes = data.get("keyframes") if isinstance(data, dict) else None
    if not isinstance(keyframes, list) or not keyframes:
        raise InputError(
            f"{source} has no keyframes; a path of this page or of nerfstudio's viewer has a list "
            "`keyframes`; give such a camera_path.json"
        )
    found = []
    for i, keyframe in enumerate(keyframes):
        entry = Entry(source, f"keyframe {i}", keyframe, data)
        # There is none before the first one, whose seconds may therefore be zero.
        seconds = _transition(entry) if i else USUAL_SECONDS
        found.append((_camera(entry, i, "matrix"), seconds, _rain_time(entry)))
    if data.get("is_cycle") is True and len(found) > 1:
        seconds = _transition(Entry(source, "keyframe 0", keyframes[0], data))
        found.append((found[0][0], seconds, found[-1][2]))
    return found


def _transition(entry):
    """Return the time [s] from the keyframe before to this one."""
    own = entry.values.get("override_transition_enabled")
    key = "override_transition_sec" if own else "default_transition_sec"
    return entry.number(key, 0, MOST_SECONDS)


def _camera(entry, index, key="camera_to_world"):
    width, height = entry.side("render_width"), entry.side("render_height")
    focal = focal_length(height, math.radians(entry.number("fov", 0, 180)))
    matrix = np.reshape(entry.array(key, (16,)), (4, 4))
    rotation = entry.rotation(key, matrix[:3, :3]) * FLIP
    camera_from_world = pose_at(rotation.T, matrix[:3, 3])
    name = f"path_{index:05d}"
    lens = focal, focal, width / 2, height / 2
    return entry.camera((width, height), lens, camera_from_world, name)


def camera_path_data(poses, width, height, fps, keyframes=(), moments=()):
    """Return a camera path as nerfstudio's viewer writes it, a dict of plain values.

    poses : sequence of (float array (4, 4)). For each frame capture_from_camera
        with OpenCV axes (x right, y down, z forward) and the angle of the
        picture's height [rad].
    keyframes : sequence of (float array (4, 4), float, float or None). Pose and
        angle as in `poses`, the seconds from the keyframe before, and the time of
        the rain [s] that it shows, None where time goes on.
    moments : sequence of int. The number of the rain's state that each frame
        shows; without it its own.
    """
    aspect = width / height
    moments = moments or range(len(poses))
    return {
        "default_fov": math.degrees(poses[0][1]), "default_transition_sec": USUAL_SECONDS,
        "keyframes": [
            {
                "matrix": _flat(matrix), "fov": math.degrees(fov), "aspect": aspect,
                "override_transition_enabled": True, "override_transition_sec": float(seconds),
                **({} if time is None else {"render_time": time, "override_time_enabled": True}),
            }
            for matrix, fov, seconds, time in keyframes
        ],
        "camera_type": KINDS[0], "render_height": int(height), "render_width": int(width),
        "fps": float(fps), "seconds": len(poses) / fps, "is_cycle": False, "smoothness_value": 0.0,
        "camera_path": [
            {
                "camera_to_world": _flat(matrix), "fov": math.degrees(fov), "aspect": aspect,
                "render_time": moment / fps,
            }
            for moment, (matrix, fov) in zip(moments, poses, strict=True)
        ],
    }  # fmt: skip


def _flat(matrix):
    """Return capture_from_camera with OpenCV axes as 16 numbers with OpenGL axes."""
    turned = np.array(matrix, np.float64)
    turned[:3, :3] *= FLIP
    return [float(value) for value in turned.ravel()]
