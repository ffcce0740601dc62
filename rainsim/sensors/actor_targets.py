"""Hits of beams on the actors of a scene, each where it is as its pulse passes."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim.sensors.lidar_model import PASSED
from rainsim.sensors.ray_traced import Tracer
from rainsim.splatting.prepared import SIGMAS

WAY = 64  # times at which an actor's way in a turn is looked at, for the ball that it stays in


class Met(NamedTuple):
    """Hits of some of the beams on an actor, arrays (n, ...)."""

    beam: np.ndarray  # int64
    color: np.ndarray  # (n, 3), float32, multiplied by alpha
    alpha: np.ndarray  # float32
    distance: np.ndarray  # float32, capture units
    normal: np.ndarray  # (n, 3), float64, capture frame


class ActorTarget:
    """An actor as beams meet it: traced in its own frame, so that it may move from pulse to pulse.

    Of colours that change over time, those in the middle of their series are taken.
    """

    def __init__(self, actor):
        base, series = np.ascontiguousarray(actor.splats.sh[:, :1]), actor.series
        if series is not None:
            base[:, 0] = series.at(0.5 * (series.begin + series.end))
        splats = replace(actor.splats, sh=base)
        self._track, self._tracer = actor.track, Tracer(splats)
        far = np.linalg.norm(splats.position.astype(np.float64), axis=1)
        far = far + float(SIGMAS) * splats.scale.max(axis=1, initial=0.0)
        self._radius = float(far[np.isfinite(far)].max(initial=0.0))

    def meet(self, origin, direction, before, time, segment):
        """Return the hits of beams, as `Met`, in the capture frame.

        Origin and direction are of shape (n, 3), float64; `before` is the length of the way to the
        origins, (n,) [capture units]; `time` [s] says when each pulse is sent; `segment` is that of
        `Tracer.trace`.
        """
        beam = self._near(origin, direction, time)
        moments, which = np.unique(time[beam], return_inverse=True)
        rotation, position, visible = self._track.poses(moments)
        there = visible[which]
        beam, which = beam[there], which[there]
        turn, place = rotation[which], position[which]
        found = self._tracer.trace(
            np.einsum("nji,nj->ni", turn, origin[beam] - place).astype(np.float32),
            np.einsum("nji,nj->ni", turn, direction[beam]).astype(np.float32),
            before[beam], segment=segment, stop=PASSED,
        )  # fmt: skip
        normal = np.einsum("nij,nj->ni", turn, found.normal)
        return Met(beam, found.color, found.alpha, found.plane_distance, normal)

    def _near(self, origin, direction, time):
        """Return the beams that pass a ball in which the actor stays."""
        if not len(time):
            return np.zeros(0, np.int64)
        places = self._track.poses(np.linspace(time.min(), time.max(), WAY))[1]
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        step = np.linalg.norm(np.diff(places, axis=0), axis=1).max()
        reach = self._radius + np.linalg.norm(places - middle, axis=1).max() + step
        to = middle - origin
        along = np.einsum("ni,ni->n", to, direction)
        off = np.einsum("ni,ni->n", to, to) - np.maximum(along, 0) ** 2
        return np.flatnonzero(off <= reach**2)
