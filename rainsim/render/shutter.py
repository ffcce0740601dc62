"""Where a camera is when its shutter closes, from the cameras of the frames before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

FASTEST = 60.0  # m/s; a camera that moves faster from frame to frame was cut to another place
FASTEST_TURN = 2 * np.pi  # rad/s; and one that turns faster


def shutter_end(cameras, index, exposure, fps):
    """Return the camera of frame `index` as it is when the shutter closes, or None if it is still.

    Parameters
    ----------
    cameras : sequence of Camera
        One per frame, in the ground frame, in metres; one alone stands still.
    index : int
    exposure : float [s]
        The shutter opens at the frame's time.
    fps : float [1/s]

    Returns
    -------
    Camera or None
        On the way to the next frame's pose: the position in a straight line, the turn about one
        axis, both even. The last frame goes on as it came. None too where the next frame is a cut:
        faster than FASTEST or FASTEST_TURN.
    """
    if len(cameras) < 2:
        return None
    here = cameras[index]
    step = 1 if index + 1 < len(cameras) else -1
    there = cameras[index + step]
    move = step * (there.position - here.position)
    here_turn = here.camera_from_world[:3, :3]
    turn = Rotation.from_matrix(there.camera_from_world[:3, :3] @ here_turn.T).as_rotvec() * step
    speed, turning = np.linalg.norm(move) * fps, np.linalg.norm(turn) * fps
    if speed > FASTEST or turning > FASTEST_TURN or speed == turning == 0:
        return None
    share = exposure * fps
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(share * turn).as_matrix() @ here_turn
    matrix[:3, 3] = -matrix[:3, :3] @ (here.position + share * move)
    return replace(here, camera_from_world=matrix)
