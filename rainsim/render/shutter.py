"""Where a camera is when its shutter closes, from the cameras of the frames before and after."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.scene.types import pose_at

FASTEST = 60.0  # m/s; a camera that moves faster from frame to frame was cut to another place
FASTEST_TURN = 2 * np.pi  # rad/s; and one that turns faster


def is_too_fast(motion, fps):
    """Tell whether the motion from one frame to the next is a cut: too fast for a camera."""
    move, turn = motion
    return math.sqrt(move @ move) * fps > FASTEST or math.sqrt(turn @ turn) * fps > FASTEST_TURN


def next_camera(camera, camera_end, share):
    """Return a frame's camera at the time of the next frame, from where its shutter closes.

    camera, camera_end : Camera. As the shutter opens and closes.
    share : float. The exposure over the time from frame to frame.
    """
    move, turn = motion_to_next([camera, camera_end], 0)
    return moved(camera, move / share, turn / share)


class PathMotion:
    """How a camera moves from frame to frame.

    cameras : sequence of Camera. One per frame, in the ground frame, in metres;
        one alone stands still.
    fps : float [1/s]
    cuts : list of bool. Whether each frame ends in a cut, see `is_too_fast`.
    """

    def __init__(self, cameras, fps):
        self._cameras, self._fps = cameras, fps
        self._moves, self._turns = motions(cameras)
        each = list(zip(self._moves, self._turns, strict=True))
        self.cuts = [is_too_fast(motion, fps) for motion in each]

    def end(self, index, exposure):
        """Return the camera at the end of a frame's exposure, or None if it is still.

        index : int
        exposure : float [s]. The shutter opens at the frame's time.
        Returns Camera or None. On the way to the next frame's pose: the position in a straight
            line, the turn about one axis, both even. The last frame goes on as it came. None too
            where the next frame is a cut.
        """
        move, turn = self._moves[index], self._turns[index]
        if self.cuts[index] or not (move.any() or turn.any()):
            return None
        share = exposure * self._fps
        return moved(self._cameras[index], share * move, share * turn)


def moved(camera, move, turn):
    """Return a camera at another place: its position plus `move`, turned by the vector `turn`."""
    rotation = Rotation.from_rotvec(turn).as_matrix() @ camera.camera_from_world[:3, :3]
    return camera.posed(pose_at(rotation, camera.position + move))


def motion_of(cameras, index, fps):
    """Return velocity [m/s] and turning [rad/s] of a frame's camera; zero if still or at a cut."""
    move, turn = motion_to_next(cameras, index)
    if is_too_fast((move, turn), fps):
        return np.zeros(3), np.zeros(3)
    return move * fps, turn * fps


def motion_to_next(cameras, index):
    """Return how a frame's camera moves and turns [m, rad] until the next; one alone stands still.

    The last goes on as it came.
    """
    if len(cameras) < 2:
        return np.zeros(3), np.zeros(3)
    first = min(index, len(cameras) - 2)
    move, turn = motions(cameras[first : first + 2])
    return move[0], turn[0]


def motions(cameras):
    """Return `motion_to_next` of every frame: two arrays (n, 3), of moves [m] and turns [rad]."""
    if len(cameras) < 2:
        return np.zeros((len(cameras), 3)), np.zeros((len(cameras), 3))
    place = np.array([camera.position for camera in cameras])
    pose = np.array([camera.camera_from_world[:3, :3] for camera in cameras])
    turn = Rotation.from_matrix(pose[1:] @ pose[:-1].transpose(0, 2, 1)).as_rotvec()
    move = place[1:] - place[:-1]
    return np.concatenate([move, move[-1:]]), np.concatenate([turn, turn[-1:]])
