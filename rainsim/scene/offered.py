"""What is offered where a capture does not say where up is, how long a metre is, or what to see.

Nothing of it is known. It is a start from which a person mends up and scale by what is seen.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.errors import GroundError
from rainsim.scene.cameras import look_at
from rainsim.scene.ground import (
    ASSUMED_CAMERA_HEIGHT,
    UP_HINT_ANGLE,
    ground_axes,
    mean_image_up,
    width_of,
)
from rainsim.scene.ground_search import ground_candidates, said, search_ground
from rainsim.scene.types import GroundFrame

USUAL_UP = (0.0, -1.0, 0.0)  # image-up of COLMAP's world, whose axes most captures keep
WIDTH = 10.0  # m across what lies on the ground: a yard
LOWEST = 2.0  # percentile of the splats' heights that is ground where no surface is found
VIEWS, VIEW_SIZE, VIEW_FOV = 12, (648, 432), 60.0  # cameras on a ring, px, degrees
AWAY = 0.75  # of the ground's width from its middle to the ring
NEAREST, FARTHEST = 0.2, 10.0  # m from the middle to the ring
EYE, LEAST_EYE = 1.6, 0.1  # m: the eyes of a person who stands; no lower than this
STEEPEST = 0.5  # of the ring's radius: the eye is no higher
SLAB = 0.3  # m about the ground's height in which splats lie on it


def offered_ground_frame(splats, cameras=(), up=None, meters_per_unit=None):
    """Return a `GroundFrame` for a capture whose own cannot be estimated.

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
        In the capture frame.
    up : array_like of shape (3,), optional
        Roughly up; otherwise the flattest wide surface with most of the capture above it counts as
        level. Without such a surface it is the mean image-up of the cameras, or -y.
    meters_per_unit : float, optional
        Otherwise the cameras stand 1.5 m above the ground, or the ground is 10 m wide.

    Returns
    -------
    GroundFrame
        Its one note says what is offered and why.

    Raises
    ------
    GroundError
        If fewer than three splats are solid.
    """
    eyes = np.array([camera.position for camera in cameras]).reshape(-1, 3)
    hint = None if up is None else np.array(up, np.float64) / np.linalg.norm(up)
    points, _ = ground_candidates(splats)
    try:
        plane, centre = search_ground(
            splats, np.zeros((0, 3)), hint, math.pi if hint is None else UP_HINT_ANGLE, 0,
            hint is not None,
        )  # fmt: skip
        normal, confidence = plane.normal, plane.confidence
        on_it = points[np.abs(plane.height(points)) < plane.threshold]
        centre = centre - plane.height(centre) * normal
        why = "the flattest wide surface with most of the capture above it is taken as level"
    except GroundError:
        normal = hint if hint is not None else mean_image_up(cameras)
        normal = np.array(USUAL_UP) if normal is None else normal
        on_it, centre, confidence = points, np.median(points, axis=0), 0.0
        low = np.percentile(points @ normal, LOWEST)
        centre = centre + (low - centre @ normal) * normal
        why = "no flat surface was found"
    scale, length = meters_per_unit, "the scale is given"
    heights = (eyes - centre) @ normal
    if scale is None and len(eyes) and heights.mean() > 0:
        scale = ASSUMED_CAMERA_HEIGHT / float(heights.mean())
        length = f"the cameras stand {ASSUMED_CAMERA_HEIGHT} m above it"
    elif scale is None:
        scale, length = WIDTH / width_of(on_it), f"it is {WIDTH:g} m wide"
    rotation = ground_axes(normal, cameras)
    note = (
        f"UP AND SCALE ARE ASSUMED, nothing tells them: {why}, up is {said(normal)} of the capture;"
        f" {length}, {scale:.4g} m per unit"
    )
    return GroundFrame(
        rotation, float(scale), -scale * rotation @ centre, confidence, (note,), True
    )


def offered_cameras(splats, frame):
    """Return cameras on a ring about the middle of the ground, for a capture that has none.

    Parameters
    ----------
    splats : Splats
    frame : GroundFrame

    Returns
    -------
    list of Camera
        In the capture frame. They stand three quarters of the ground's width from its middle, as
        high as a person's eyes but no higher than half that distance, and look at the middle.
    """
    points = frame.to_ground(ground_candidates(splats)[0])
    near = np.abs(points[:, 2]) < SLAB
    near = points[near] if near.any() else points
    low, high = np.percentile(near[:, :2], (5, 95), axis=0)
    middle = (low + high) / 2
    radius = float(np.clip(AWAY * np.linalg.norm(high - low) / math.sqrt(2), NEAREST, FARTHEST))
    height = float(np.clip(STEEPEST * radius, LEAST_EYE, EYE))
    found = []
    for n in range(VIEWS):
        angle = 2 * math.pi * n / VIEWS + math.pi  # the first one looks along x
        eye = (*(middle + radius * np.array([math.cos(angle), math.sin(angle)])), height)
        camera = look_at(
            eye, (*middle, height / 5), (0, 0, 1), VIEW_FOV, *VIEW_SIZE, f"offered_{n:02d}"
        )
        found.append(frame.camera_in_capture(camera))
    return found


def levelled_frame(frame, up, point):
    """Return a ground frame with another up, whose ground goes through a point; none is searched.

    Parameters
    ----------
    frame : GroundFrame
        Its scale stays, and its x axis as far as it is level.
    up, point : array_like of shape (3,)
        In the capture frame; `point` in capture units.
    """
    up, point = np.array(up, np.float64) / np.linalg.norm(up), np.array(point, np.float64)
    axes = [axis - (axis @ up) * up for axis in (frame.rotation[0], frame.rotation[2])]
    x = max(axes, key=np.linalg.norm)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    origin = frame.to_capture(np.zeros(3))
    origin = origin - ((origin - point) @ up) * up
    notes = [note for note in frame.notes if note.lower().startswith("scale")]
    note = "up is given, and the ground goes through a point that is given; no plane was fitted"
    scale = frame.meters_per_unit
    return GroundFrame(
        rotation, scale, -scale * rotation @ origin, 1.0, (note, *notes), frame.scale_assumed
    )
