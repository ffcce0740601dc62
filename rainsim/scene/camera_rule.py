"""The rule for cameras, wherever they come from: options, files, the page."""

import math

import numpy as np

from rainsim.errors import InputError
from rainsim.io.files import MAX_LENGTH

MAX_SIDE = 65_536  # px; anything longer is a damaged file
MAX_FOCAL = 1e9  # px
LEAST_FOV, MOST_FOV = 0.1, 170.0  # degrees, of the wider angle of a picture
MOST_STRETCH = 16.0  # of a pixel: its one side over the other
MOST_SLOPE = math.tan(math.radians(MOST_FOV / 2)) * (1 + 1e-6)  # of a pixel's ray to the axis
RIGID_TOLERANCE = 1e-3  # files with six decimals pass, scaled or mirrored poses do not
ROUNDING = 1 + 1e-9  # a camera of exactly an end of a range passes after a change of units


def focal_length(side, fov):
    """Return the focal length [px] of a picture whose `side` [px] takes an angle `fov` [rad]."""
    return side / 2 / max(math.tan(fov / 2), 1e-300)


def require_camera(camera, label, error=InputError, remedy="correct the file"):
    """Return a `Camera`, or raise `error` that begins with `label` unless it can be drawn from."""
    fault = _fault(camera)
    if fault:
        raise error(f"{label} {fault}; {remedy}")
    return camera


def _fault(camera):
    """Return the fault of a camera and the rule that it breaks, None without a fault."""
    sides = camera.width, camera.height
    if not all(side == int(side) and 1 <= side <= MAX_SIDE for side in sides):
        return f"is {sides[0]} x {sides[1]} px; each side must be a whole number to {MAX_SIDE}"
    fx, fy, cx, cy = lens = tuple(map(float, (camera.fx, camera.fy, camera.cx, camera.cy)))
    if not (all(map(math.isfinite, lens)) and min(fx, fy) > 0):
        return f"has focal lengths and centre {_shown(lens)} px; all finite, lengths above 0"
    if not is_rigid(camera.camera_from_world):
        return (
            "has a pose that is no rotation and translation; the rotation must have no scale and "
            f"no mirroring, and the place be below {MAX_LENGTH:g} units"
        )
    fov = math.degrees(2 * math.atan(max(sides[0] / fx, sides[1] / fy) / 2))
    if not camera.orthographic and not LEAST_FOV / ROUNDING <= fov <= MOST_FOV * ROUNDING:
        return f"sees an angle of {fov:.3g} degrees; it must be from {LEAST_FOV:g} to {MOST_FOV:g}"
    if max(fx, fy) > min(MOST_STRETCH * min(fx, fy), MAX_FOCAL) or min(fx, fy) < 1 / MAX_FOCAL:
        return (
            f"has focal lengths {_shown(lens[:2])} px; they must be from {1 / MAX_FOCAL:g} to "
            f"{MAX_FOCAL:g}, one at most {MOST_STRETCH:g} times the other"
        )
    farthest = max(max(cx, sides[0] - cx) / fx, max(cy, sides[1] - cy) / fy)
    if not camera.orthographic and farthest > MOST_SLOPE:
        return (
            f"has its principal point at {_shown(lens[2:])} px; no pixel may look more than "
            f"{MOST_FOV / 2:g} degrees away from the view axis"
        )
    return None


def is_rigid(pose):
    """Return whether a matrix (4, 4) is a rotation and a translation within reach."""
    turn = pose[:3, :3]
    if not (np.abs(pose) < MAX_LENGTH).all():  # false for NaN
        return False
    away = np.abs(turn @ turn.T - np.eye(3)).max()
    return bool(away <= RIGID_TOLERANCE and np.linalg.det(turn) > 0)


def _shown(values):
    return ", ".join(f"{value:g}" for value in values)
