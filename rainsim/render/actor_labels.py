"""Labels of actors: which pixels show them, their boxes in space and in the picture, flow."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.actors.motion import Motion
from rainsim.render.labels import boxes_of
from rainsim.scene.view import camera_points, image_point

NEAREST = 0.05  # m before the camera: nearer parts of a box are cut off
EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])


class ActorsSeen(NamedTuple):
    """The actors of a frame.

    actors : sequence of Actor
    time, interval : float [s]. Of the frame, and to the next one.
    frame : GroundFrame
    number : uint16 array (height, width). Of the actor that each pixel shows,
        from 1 on in the order of `actors`; 0 for none.
    """

    actors: tuple
    time: float
    interval: float
    frame: object
    number: np.ndarray

    def present(self):
        """Yield number, `Motion` and present `Pose` in the ground frame of each that is there."""
        for number, actor in enumerate(self.actors, start=1):
            motion = Motion(actor, self.frame)
            pose = motion.at(self.time)
            if pose is not None:
                yield number, motion, pose


def moves_of(actors):
    """Return how the actors that are there move until the next frame.

    actors : ActorsSeen
    Returns dict of int to float64 array (4, 4). By the actor's number: takes
        ground points [m] on the actor to where they are then. An actor that is
        gone then goes on as it did.
    """
    return {
        number: motion.step(actors.time, actors.interval) for number, motion, _ in actors.present()
    }


def facts_of_actors(actors, camera):
    """Return the labels of each actor that is present in a frame, a list of plain values.

    actors : ActorsSeen
    camera : Camera. In the ground frame.
    Returns list of dict. `number` in the layer `actor_id`, `track` and `class`;
        `box3d`, see `box_in_space`; `box2d`, the corners' box in the picture,
        (left, top, right, bottom) [px], cut at its edges, None if it lies beside
        the picture or behind the camera; `box2d_seen`, the box of the pixels that
        show the actor, None if none does, and their number, `pixels`.
    """
    seen = {box["id"]: box for box in boxes_of(actors.number)}
    facts = []
    for number, motion, pose in actors.present():
        actor = motion.actor
        corners = pose.places(actor.corners() * actors.frame.meters_per_unit)
        mine = seen.get(number)
        facts.append({
            "number": number, "track": actor.id, "class": actor.kind,
            "box3d": box_in_space(motion, actors.time, actors.interval),
            "box2d": box_in_picture(corners, camera),
            "box2d_seen": mine and mine["box"], "pixels": mine["pixels"] if mine else 0,
        })  # fmt: skip
    return facts


def box_in_space(motion, time, interval):
    """Return an actor's box at a time [s] in the ground frame, as plain values; None if it is away.

    Centre [m], size [m] along its own axes, rotation (quaternion, w first), and velocity [m/s] over
    `interval` [s] from then on. `motion` is the actor's `Motion`.
    """
    pose = motion.at(time)
    if pose is None:
        return None
    centre, size = motion.box
    turn = Rotation.from_matrix(pose.rotation).as_quat(canonical=True, scalar_first=True)
    return {
        "centre": _rounded(pose.places(centre)), "size": _rounded(size),
        "rotation": _rounded(turn, 9), "velocity": _rounded(motion.velocity(time, interval)),
    }  # fmt: skip


def box_in_picture(corners, camera):
    """Return the box of eight corners (ground frame) in a camera's picture, cut at its edges.

    corners : array (8, 3) [m]. In the order of `Actor.corners`; what lies behind
        the camera is cut off.
    camera : Camera. In the ground frame.
    Returns list of float or None. Left, top, right and bottom [px].
    """
    points = camera_points(camera, corners)
    ends = points[EDGES]
    ahead = points[points[:, 2] > NEAREST]
    cut = (ends[:, 0, 2] > NEAREST) != (ends[:, 1, 2] > NEAREST)
    first, last = ends[cut, 0], ends[cut, 1]
    share = (NEAREST - first[:, 2:]) / (last[:, 2:] - first[:, 2:]) if cut.any() else 0.0
    points = np.concatenate([ahead, first + share * (last - first)])
    if not len(points):
        return None
    u, v = image_point(camera, *points.T)
    left, right = np.clip([u.min(), u.max()], 0, camera.width)
    top, bottom = np.clip([v.min(), v.max()], 0, camera.height)
    if left >= right or top >= bottom:
        return None
    return _rounded([left, top, right, bottom], 3)


def _rounded(values, digits=6):
    return [round(float(value), digits) + 0.0 for value in values]  # no -0.0
