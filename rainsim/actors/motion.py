"""Where actors are at a time: their tracks in the capture frame, and their motion over the ground.

All that follows a moving thing asks here: pictures, labels, sensors, the rain that a thing keeps
off and the water that its tyres throw.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from rainsim.actors.wheels import wheels_of
from rainsim.errors import ParameterError

STILL = 1e-9  # of a pose's numbers: two that are nearer count as one pose
COMING = 0.1  # s after the first key whose mean velocity the time before the key has
BEFORE = 1.5  # s before its first key that an actor has moved already


class Pose(NamedTuple):
    """Where an actor's frame is at one time, in the capture frame or the ground frame.

    rotation : float64 array (3, 3). Actor frame to that frame.
    position : float64 array (3,) [capture units], or [m] in the ground frame
    """

    rotation: np.ndarray
    position: np.ndarray

    def places(self, points):
        """Take points (n, 3) of the actor frame to that frame, in its unit of length."""
        return points @ self.rotation.T + self.position

    def same_as(self, other):
        """Whether another pose has the same rotation and position."""
        return np.array_equal(self.rotation, other.rotation) and np.array_equal(
            self.position, other.position
        )


@dataclass(frozen=True)
class Track:
    """The way of an actor.

    Between two keys the position is interpolated linearly and the rotation spherically; before the
    first and after the last key the actor stays as it is there. A key's visibility holds until the
    next key.

    time : float64 array (k,) [s]. Of the keys, rising; 0 is the first frame.
    position : float64 array (k, 3) [capture units]
    rotation : float64 array (k, 4). Unit quaternions, w first: actor frame to
        capture frame.
    visible : bool array (k,)
    """

    time: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    visible: np.ndarray

    def __post_init__(self):
        """Check lengths and order, and scale the quaternions to unit length."""
        k = len(self.time)
        shapes = (self.position.shape, self.rotation.shape, self.visible.shape)
        if k == 0 or shapes != ((k, 3), (k, 4), (k,)):
            raise ParameterError(
                f"a track has {k} times and keys of shapes {shapes}; it must have one time, place, "
                "quaternion and visibility for each of at least one key"
            )
        length = np.linalg.norm(self.rotation, axis=1)
        if not np.isfinite(self.time).all() or (np.diff(self.time) <= 0).any():
            raise ParameterError("the times of a track must be finite and rise from key to key")
        if not np.isfinite(self.position).all() or not (np.isfinite(length) & (length > 0)).all():
            raise ParameterError(
                "places and quaternions of a track must be finite, no quaternion 0"
            )
        object.__setattr__(self, "rotation", self.rotation / length[:, None])

    @property
    def parked(self):
        """Whether the actor stands in one place and is always there."""
        apart = np.abs(self.position - self.position[0]).max()
        turned_by = 1 - np.abs(self.rotation @ self.rotation[0]).min()
        still = apart <= STILL * (1 + np.abs(self.position).max()) and turned_by <= STILL
        return bool(still and self.visible.all())

    def at(self, time):
        """Return the `Pose` at a time [s], or None while the actor is not there."""
        k = max(int(np.searchsorted(self.time, time, side="right")) - 1, 0)
        return self.pose(time) if self.visible[k] else None

    def poses(self, times):
        """Return rotation (n, 3, 3), position (n, 3) and whether it is there, at times [s]."""
        times = np.asarray(times, np.float64)
        visible = self.visible[np.searchsorted(self.time, times, side="right").clip(1) - 1]
        at = times.clip(self.time[0], self.time[-1])
        position = np.stack([np.interp(at, self.time, axis) for axis in self.position.T], -1)
        turns = Rotation.from_quat(self.rotation, scalar_first=True)
        if len(self.time) == 1:
            return np.tile(turns[0].as_matrix(), (len(at), 1, 1)), position, visible
        return Slerp(self.time, turns)(at).as_matrix(), position, visible

    def pose(self, time):
        """Return the `Pose` at a time [s], whether the actor is visible or not."""
        turns, angles, about = self._turns
        k = max(int(np.searchsorted(self.time, time, side="right")) - 1, 0)
        if time <= self.time[0] or k == len(self.time) - 1:
            return Pose(turns[k].copy(), self.position[k].copy())
        share = (time - self.time[k]) / (self.time[k + 1] - self.time[k])
        angle = share * angles[k]
        # The formula of Rodrigues: scipy's Slerp takes a frame of traffic some ms.
        turn = np.eye(3) + math.sin(angle) * about[k]
        turn += (1 - math.cos(angle)) * (about[k] @ about[k])
        place = (1 - share) * self.position[k] + share * self.position[k + 1]
        return Pose(turns[k] @ turn, place)

    @cached_property
    def _turns(self):
        """The keys' rotations (k, 3, 3), and what leads from each to the next.

        That is an angle [rad] (k - 1,) and, for the axis, the matrix (k - 1, 3, 3) that takes a
        vector to its cross product with it.
        """
        turns = Rotation.from_quat(self.rotation, scalar_first=True)
        steps = (turns[:-1].inv() * turns[1:]).as_rotvec()
        angles = np.linalg.norm(steps, axis=1)
        x, y, z = (steps / np.maximum(angles, 1e-300)[:, None]).T
        zero = np.zeros_like(x)
        about = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
        return turns.as_matrix(), angles, about

    def came(self, times):
        """Return what `poses` does; an actor that is there from its first key on has come to it.

        It came as it goes on, for BEFORE seconds, and was not there earlier.
        """
        rotation, position, visible = self.poses(times)
        first = float(self.time[0])
        early = np.minimum(np.asarray(times) - first, 0.0)
        if self.visible[0] and len(self.time) > 1:
            step = min(COMING, float(self.time[1]) - first)
            way = self.pose(first + step).position - self.pose(first).position
            position = position + (early / step)[:, None] * way
        return rotation, position, visible & (early >= -BEFORE)

    @property
    def first_seen(self):
        """The `Pose` at the first key at which the actor is there; the first key's if at none."""
        return self.pose(self.time[int(np.argmax(self.visible))])


@dataclass(frozen=True)
class Motion:
    """An actor's motion in the ground frame.

    Its poses take points of the actor frame, in metres, to the ground frame [m].
    """

    actor: object
    frame: object

    @property
    def box(self):
        """Centre and size of the box in the actor frame, ndarray of shape (2, 3) [m]."""
        return self.actor.box * self.frame.meters_per_unit

    @cached_property
    def wheels(self):
        """The tyres as `wheels_of` returns them [m], those in front first."""
        wheels = wheels_of(self.actor, self.frame.meters_per_unit)
        return wheels[np.argsort(-wheels[:, 0], kind="stable")]

    def at(self, time):
        """Return the `Pose` at a time [s], or None while the actor is not there."""
        return self._over_ground(self.actor.track.at(time))

    def pose(self, time):
        """Return the `Pose` at a time [s], whether the actor is visible or not."""
        return self._over_ground(self.actor.track.pose(time))

    def came(self, times):
        """Return rotations, places [m] and whether it is there at many times, see `Track.came`."""
        rotation, position, visible = self.actor.track.came(times)
        return self.frame.rotation @ rotation, self.frame.to_ground(position), visible

    def _over_ground(self, pose):
        """Return a pose in the capture frame as a pose in the ground frame; None for None."""
        if pose is None:
            return None
        turn, scale = self.frame.rotation, self.frame.meters_per_unit
        place = turn @ pose.position * scale + self.frame.translation
        return Pose(turn @ pose.rotation, place)

    def velocity(self, time, interval):
        """Return the mean velocity [m/s] (3,) of the box's centre over an interval from a time."""
        now, then = (self.pose(t).places(self.box[:1])[0] for t in (time, time + interval))
        return (then - now) / interval

    def step(self, time, interval):
        """Return the matrix (4, 4) that takes ground points [m] along from `time` on [s]."""
        return _matrix(self.pose(time + interval)) @ np.linalg.inv(_matrix(self.pose(time)))

    def speeds(self):
        """Return the speed [m/s] after each key but the last, 0 while the actor is not there."""
        track = self.actor.track
        way = np.linalg.norm(np.diff(track.position, axis=0), axis=1) * self.frame.meters_per_unit
        return way / np.diff(track.time) * track.visible[:-1]


def same_place(pose, other):
    """Tell whether two poses, or absences (None), are the same."""
    if pose is None or other is None:
        return pose is other
    return pose.same_as(other)


def _matrix(pose):
    """Return a pose as a matrix of shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose
    return matrix


def moves_between(actors, begin, end):
    """Tell whether any of some actors moves or changes its colours between two times [s]."""
    for actor in actors:
        here, there = actor.track.at(begin), actor.track.at(end)
        if here is None or there is None:
            if here is not there:
                return True
        elif actor.series is not None or not here.same_as(there):
            return True
    return False
