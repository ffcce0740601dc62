"""Captures in large coordinates, as those of a survey: whole numbers are taken off in float64.

float32 has steps of half a metre at 5,000 km, where northings of UTM lie. Splats and cameras are
therefore kept near 0, and the whole numbers that were taken off with the scene.
"""

import numpy as np

from rainsim.io.files import MAX_LENGTH
from rainsim.scene.types import pose_at

FAR = 1e4  # capture units; from there on a step of float32 is a thousandth or more
SAMPLE = 1 << 16  # splats that are looked at
NOWHERE = (0.0, 0.0, 0.0)


def whole_origin(places):
    """Return whole numbers near the middle of float64 places (n, 3), 0 on axes where it is near."""
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        return NOWHERE
    middle = np.median(places, axis=0)
    return tuple(float(np.round(v)) if FAR < abs(v) < MAX_LENGTH else 0.0 for v in middle)


def origin_note(origin):
    """Return a list with a note on what is taken off splats, empty if nothing is."""
    if not any(origin):
        return []
    taken = ", ".join(f"{v:.0f}" for v in origin)
    return [f"large coordinates: ({taken}) is taken off splats and cameras, and kept in the scene"]


def step_note(splats):
    """Return a list with a note if splats lie where float32 has coarse steps, else an empty one."""
    places = splats.position[:: max(1, len(splats) // SAMPLE)]
    far = np.abs(np.median(places, axis=0)).max()
    if far < FAR:
        return []
    return [
        f"splats lie {far:.3g} units from 0 as 32-bit numbers, whose step there is "
        f"{np.spacing(far):.2g}: less is lost; export 64-bit numbers, or take an offset off first"
    ]


def moved(cameras, shift):
    """Return cameras that are moved by a vector [capture units]."""
    return [
        camera.posed(pose_at(camera.camera_from_world[:3, :3], camera.position + shift))
        for camera in cameras
    ]


def near_origin(cameras, origin):
    """Return cameras as the splats lie from which `origin` was taken off."""
    shift = np.array(origin)
    if not len(cameras) or not shift.any():
        return list(cameras)
    middle = np.median([camera.position for camera in cameras], axis=0)
    is_far = np.linalg.norm(middle - shift) < np.linalg.norm(middle)
    return moved(cameras, -shift) if is_far else list(cameras)


def capture_from_ground(scene):
    """Return the matrix (4, 4) that takes the ground frame [m] to the capture's own coordinates."""
    frame = scene.ground_frame
    matrix = np.eye(4)
    matrix[:3, :3] = frame.rotation.T / frame.meters_per_unit
    matrix[:3, 3] = frame.to_capture(np.zeros(3)) + scene.origin
    return matrix
