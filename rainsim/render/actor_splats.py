"""The actors of a scene at one time: their splats, put before the static set's, and their poses."""

import numpy as np

from rainsim.actors.motion import same_place
from rainsim.raster import prepare
from rainsim.scene.splat_sets import joined
from rainsim.shading.wet_ground_mirror import as_in_level_picture, in_level_picture
from rainsim.splatting.merged import Merger


class ActorSplats:
    """The moving splats of a scene, one moment after another.

    actors : sequence of Actor
    static : PreparedSplats. Of the scene without them.
    poses : list of Pose or None. Of each actor at the present time; None while it
        is not there. Empty before the first time.
    rigid : bool. Whether none has colours that change over time.
    placed : float [s] or None. The time for which they were put there: they may
        stand still since.
    static : PreparedSplats. As it was given, in memory that is shared with the
        merged sets.
    first : int. Number that the first of the actors' splats has in the merged
        set.
    """

    def __init__(self, actors, static):
        self.actors, self.time, self.placed, self.poses = actors, None, None, []
        self._most = sum(len(actor.splats) for actor in actors)
        self._merger, self._standing = Merger(static, self._most), None
        self.static, self.first = self._merger.static, len(static)
        self.rigid, self._splats = all(actor.series is None for actor in actors), None
        self._ends = np.zeros(len(actors) + 1, np.int64)

    def set_time(self, time):
        """Take over the poses of a time [s], None for no actors; return whether they moved."""
        poses = [] if time is None else [actor.track.at(time) for actor in self.actors]
        same = len(poses) == len(self.poses) and all(
            same_place(a, b) for a, b in zip(poses, self.poses, strict=True)
        )
        self.time = time
        changing = any(a.series is not None and p for a, p in zip(self.actors, poses, strict=False))
        if same and not changing:
            return False
        self.poses, self._splats, self.placed = poses, None, time
        counts = [0 if p is None else len(a.splats)
                  for a, p in zip(self.actors, poses, strict=False)]  # fmt: skip
        self._ends = np.cumsum([0, *counts])
        return True

    @property
    def splats(self):
        """The `Splats` of those that are there, in the capture frame; None of none."""
        there = [(a, p) for a, p in zip(self.actors, self.poses, strict=False) if p is not None]
        if self._splats is None and there:
            self._splats = joined(actor.placed(pose, self.placed) for actor, pose in there)
        return self._splats

    def recolor(self, static):
        """Take over other colours of the static set, see `prepared.recolored`."""
        self._merger.recolor(static)
        self.static, self._standing = self._merger.static, None

    def merged(self, merger=None):
        """Return the `PreparedSplats` of the whole scene; overwritten by the next call.

        Or, with a `merger_of` other static splats, of those and the actors.
        """
        actors = None if self.splats is None else prepare(self.splats)
        return (merger or self._merger).merged(actors, self.first)

    def merger_of(self, static):
        """Return the `Merger` of other static splats, as many in the scene they came from."""
        return Merger(static, self._most)

    def standing_static(self, terrain, frame):
        """Return the standing splats of the static set for the level picture."""
        if self._standing is None:
            static = in_level_picture(self.static, terrain, frame)
            self._standing = Merger(static, self._most)
        return self._standing.static

    def standing(self, terrain, frame):
        """Return the standing splats for the level picture, actors included."""
        self.standing_static(terrain, frame)
        actors = None
        if self.splats is not None:
            actors = as_in_level_picture(prepare(self.splats), frame)
        return self._standing.merged(actors, 0)

    def numbers(self, hit):
        """Return the number of the actor that each pixel shows, from 1 on, 0 for the static set.

        hit : int32 array (height, width). See `raster.Layers`, of the merged set.
        Returns uint16 array (height, width)
        """
        found = np.searchsorted(self._ends[1:], hit - self.first, side="right") + 1
        return np.where(hit >= self.first, found, 0).astype(np.uint16)
