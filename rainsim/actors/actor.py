"""Actors, the rigid things that move through a scene: their splats, boxes, classes and tracks.

An actor's splats and box stand in the actor's own frame, whose unit of length is the capture's. Its
track says where that frame is in the capture frame at a time, and whether the actor is there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from rainsim.errors import ParameterError
from rainsim.scene.harmonics import padded, turned
from rainsim.scene.splat_sets import joined, own_turns
from rainsim.scene.types import Splats

STILL = 1e-9  # of a pose's numbers: two that are nearer count as one pose
NO_LABEL, MOST_LABEL = 255, 2**16 - 1  # of the user's own labels
SOLID = 0.3  # opacity of splats that a body ends at, and that stop drops


class Pose(NamedTuple):
    """Where an actor's frame is at one time.

    Attributes
    ----------
    rotation : ndarray of shape (3, 3), float64
        Actor frame to capture frame.
    position : ndarray of shape (3,), float64 [capture units]
    """

    rotation: np.ndarray
    position: np.ndarray

    def places(self, points):
        """Take points (n, 3) of the actor frame to the capture frame."""
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

    Attributes
    ----------
    time : ndarray of shape (k,), float64 [s]
        Of the keys, rising; 0 is the first frame.
    position : ndarray of shape (k, 3), float64 [capture units]
    rotation : ndarray of shape (k, 4), float64
        Unit quaternions, w first: actor frame to capture frame.
    visible : ndarray of shape (k,), bool
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
        """Return where the actor is at many times [s], and whether it is there.

        Parameters
        ----------
        times : ndarray of shape (n,), float64

        Returns
        -------
        rotation : ndarray of shape (n, 3, 3), float64
        position : ndarray of shape (n, 3), float64
        visible : ndarray of shape (n,), bool
        """
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
        turns = Rotation.from_quat(self.rotation, scalar_first=True)
        k = max(int(np.searchsorted(self.time, time, side="right")) - 1, 0)
        if time <= self.time[0] or k == len(self.time) - 1:
            return Pose(turns[k].as_matrix(), self.position[k].copy())
        share = (time - self.time[k]) / (self.time[k + 1] - self.time[k])
        rotation = Slerp((0.0, 1.0), turns[[k, k + 1]])(share).as_matrix()
        return Pose(rotation, (1 - share) * self.position[k] + share * self.position[k + 1])

    @property
    def first_seen(self):
        """The `Pose` at the first key at which the actor is there; the first key's if at none."""
        return self.pose(self.time[int(np.argmax(self.visible))])


class ColorSeries(NamedTuple):
    """First coefficients of harmonics that change over time: a Fourier series.

    At a phase p, which rises from 0 at `begin` to 1 at `end` (and stays in that range), term j has
    the factor cos(pi p j) for even j and sin(pi p (j + 1)) for odd j (Street Gaussians, Yan et al.
    2024, equation 5, as an inverse real discrete Fourier transform of the phase).

    Attributes
    ----------
    terms : ndarray of shape (n, m, 3), float32
    begin, end : float [s]
    """

    terms: np.ndarray
    begin: float
    end: float

    def at(self, time):
        """Return the coefficients (n, 3), float32, at a time [s]."""
        phase = np.clip((time - self.begin) / max(self.end - self.begin, 1e-9), 0.0, 1.0)
        j = np.arange(self.terms.shape[1])
        factor = np.where(j % 2 == 0, np.cos(np.pi * phase * j), np.sin(np.pi * phase * (j + 1)))
        return np.einsum("nmc,m->nc", self.terms, factor.astype(np.float32))


@dataclass(frozen=True)
class Actor:
    """A rigid thing that moves, or could.

    Attributes
    ----------
    id : str
        Of the track; differs from actor to actor.
    kind : str
        Class of the thing, such as car.
    splats : Splats
        In the actor frame, lengths in capture units.
    box : ndarray of shape (2, 3), float64 [capture units]
        Centre and size of the actor's box along the axes of the actor frame.
    track : Track
    series : ColorSeries or None
        Colours over time in place of the first coefficients of `splats`.
    turning : bool
        Whether the harmonics turn with the actor. Models that were trained with directions of the
        capture frame have harmonics that do not (Street Gaussians, drivestudio).
    wheels : ndarray of shape (n, 5), float64 [capture units], or None
        x, y, z of the middle of each tyre's contact patch in the actor frame, the tyre's width and
        radius. None: those that the class and the box give, see `actors.wheels`.
    label : int
        What `rainsim export --labels` gives its pixels, 0 to 65535; 255 is no label.
    """

    id: str
    kind: str
    splats: Splats
    box: np.ndarray
    track: Track
    series: ColorSeries | None = None
    turning: bool = True
    wheels: np.ndarray | None = None
    label: int = NO_LABEL

    def corners(self):
        """Return the corners of the box in the actor frame, ndarray of shape (8, 3)."""
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return self.box[0] + 0.5 * signs * self.box[1]

    def placed(self, pose, time):
        """Return the actor's splats in the capture frame, at a `Pose` and a time [s]."""
        splats = self.splats
        sh = turned(splats.sh, pose.rotation) if self.turning else splats.sh.copy()
        if self.series is not None:
            sh[:, 0] = self.series.at(time)
        turn = Rotation.from_matrix(pose.rotation)
        own = own_turns(splats)
        return Splats(
            np.ascontiguousarray(pose.places(splats.position.astype(np.float64)), np.float32),
            np.ascontiguousarray(np.roll((turn * own).as_quat(), 1, axis=1), np.float32),
            splats.scale, splats.opacity, sh,
        )  # fmt: skip


def box_of(splats):
    """Return the box (2, 3) around an actor's splats, out to one standard deviation.

    Faint splats and the outermost five-hundredth on each side are left out.
    """
    solid = splats.opacity > SOLID
    solid = solid if solid.any() else np.ones(len(splats), bool)
    place = splats.position[solid].astype(np.float64)
    reach = _spread(splats.take(solid))
    low = np.percentile(place - reach, 0.2, axis=0)
    high = np.percentile(place + reach, 99.8, axis=0)
    return np.stack([0.5 * (low + high), high - low])


def _spread(splats):
    """Return one standard deviation of each splat along the three axes of its frame, (n, 3)."""
    axes = own_turns(splats).as_matrix()
    return np.sqrt(np.einsum("nij,nj->ni", axes**2, splats.scale.astype(np.float64) ** 2))


def with_actors(scene, actors, notes=()):
    """Return a scene with actors; all splats get harmonics of one degree.

    Parameters
    ----------
    scene : Scene
    actors : sequence of Actor
    notes : sequence of str
        Added to those of the scene.

    Raises
    ------
    ParameterError
        If two actors have the same id.
    """
    actors = tuple(actors)
    ids = [actor.id for actor in actors]
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise ParameterError(f"two actors have the id {twice!r}; ids must differ; rename one")
    most = max(part.sh.shape[1] for part in (scene.splats, *(a.splats for a in actors)))
    splats = scene.splats
    if splats.sh.shape[1] < most:
        splats = replace(splats, sh=padded(splats.sh, most))
    actors = tuple(
        replace(a, splats=replace(a.splats, sh=padded(a.splats.sh, most))) for a in actors
    )
    return replace(scene, splats=splats, actors=actors, notes=(*scene.notes, *notes))


def require_no_actors(actors, what, remedy):
    """Raise ParameterError if there are actors, which `what` does not know.

    Parameters
    ----------
    actors : sequence
        Of a scene.
    what, remedy : str
        For the message.
    """
    if actors:
        raise ParameterError(
            f"the scene has {len(actors)} actors; {what} takes scenes without any; {remedy}"
        )


def scene_at(scene, time):
    """Return the scene at a time [s] as one static set, without actors.

    For what takes a single moment: the dry capture, sensors that hold one set of splats.
    """
    if not scene.actors:
        return scene
    poses = [actor.track.at(time) for actor in scene.actors]
    there = [a.placed(p, time) for a, p in zip(scene.actors, poses, strict=True) if p is not None]
    return replace(scene, splats=joined([scene.splats, *there]), actors=())
