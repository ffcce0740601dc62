"""Actors, the rigid things that move through a scene, and scenes with them.

An actor's splats and box stand in the actor's own frame, whose unit of length is the capture's. Its
track says where that frame is in the capture frame at a time, and whether the actor is there.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.actors.motion import Track
from rainsim.errors import ParameterError
from rainsim.scene.harmonics import padded, turned
from rainsim.scene.splat_sets import joined, own_turns
from rainsim.scene.types import Splats

NO_LABEL, MOST_LABEL = 255, 2**16 - 1  # of the user's own labels
SOLID = 0.3  # opacity of splats that an actor ends at, and that stop drops


class ColorSeries(NamedTuple):
    """First coefficients of harmonics that change over time: a Fourier series.

    At a phase p, which rises from 0 at `begin` to 1 at `end` (and stays in that range), term j has
    the factor cos(pi p j) for even j and sin(pi p (j + 1)) for odd j (Street Gaussians, Yan et al.
    2024, equation 5, as an inverse real discrete Fourier transform of the phase).

    terms : float32 array (n, m, 3)
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

    box : float64 array (2, 3) [capture units]. Centre and size of the actor's box
        along the axes of the actor frame.
    series : ColorSeries or None. Colours over time in place of the first
        coefficients of `splats`.
    turning : bool. Whether the harmonics turn with the actor. Models that were
        trained with directions of the capture frame have harmonics that do not
        (Street Gaussians, drivestudio).
    wheels : float64 array (n, 5) [capture units], or None. x, y, z of the middle
        of each tyre's contact patch in the actor frame, the tyre's width and
        radius. None: those that the class and the box give, see `actors.wheels`.
    label : int. What `rainsim export --labels` gives its pixels, 0 to 65535; 255
        is no label.
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
    """Return a scene with actors of different ids; all splats get harmonics of one degree."""
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
    """Raise ParameterError if there are actors, which `what` does not know."""
    if actors:
        raise ParameterError(
            f"the scene has {len(actors)} actors; {what} takes scenes without any; {remedy}"
        )


def scene_at(scene, time):
    """Return the scene at a time [s] as one static set, without actors."""
    if not scene.actors:
        return scene
    poses = [actor.track.at(time) for actor in scene.actors]
    there = [a.placed(p, time) for a, p in zip(scene.actors, poses, strict=True) if p is not None]
    return replace(scene, splats=joined([scene.splats, *there]), actors=())
