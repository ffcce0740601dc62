"""Level from cameras that were carried: which way is up, and which of the cameras are misplaced.

A camera is held without roll, so its right-hand axis is level; the cameras of a walk are at about
one height, so their path is level. Both are fitted together, with weights that fall with what is
left over: a camera that a solver misplaced gets next to none. Upright walls are fitted with them.
The splats then need to tell only how far below the cameras the ground lies.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from rainsim.jit import get_num_threads
from rainsim.numerics.blocks import of_each

FEWEST = 4  # cameras that tell how they were held
# Standard deviations of the roll of a hand-held camera, of the mean pitch of the views, and of the
# climb of a path. Vertical lines of the photographs of three captures agree to .1, .4 and .7 degree
# with the up that is fitted so.
ROLL, PITCH, CLIMB = np.radians((3.0, 15.0, 1.5))
WALL = np.radians(0.7)  # of a wall from upright; the walls of four captures have .3 to .9 degree
DEVIATION = 1.4826  # standard deviation over the median of the absolute values
ROUNDS = 20  # of the fit
MISPLACED = 0.02  # weight below which a camera counts as misplaced
AGREE, AGREE_DOWN = 0.3, 0.9  # length of the mean of unit vectors: image-up; views down
LEAST_PATH = 0.05  # of the distance to the splats: cameras that moved less stand on a tripod
# Heights of the cameras are the unit of the search for the ground below them: how far about the
# path it reaches, the width of a cell, half the thickness of the ground, half the depth searched.
AROUND, CELL, LAYER, DEPTH = 12.0, 0.5, 0.1, 0.7
CHANCE = LAYER / DEPTH  # share of a cell's splats that lie in the layer by chance
SPREAD = 0.35  # standard deviation of that share, of cells with one splat
LOWEST, HIGHEST, STEP = 0.02, 0.4, 1.05  # heights tried, of the path's extent; their ratio
LIKELY = 2.0  # times more or less than the height above a plane of splats, that are tried
CLEARLY = 1.1  # times the support of ground that follows the path, for it to be level instead
SURE, FULL_SIGMAS = 4.0, 16.0  # deviations above chance: ground is there; of full confidence


class Level(NamedTuple):
    """Up by the cameras, unit (3,), how sure it is [rad], and the weight of each camera (n,)."""

    up: np.ndarray
    deviation: float
    weight: np.ndarray


class Support(NamedTuple):
    """How the ground below the cameras is supported by splats.

    `share` is the mean over cells of the splats' share in the ground's layer less that of chance,
    `sigmas` how many standard deviations that is, `height` that of the cameras [capture units].
    """

    share: float
    sigmas: float
    height: float


def level_of(cameras, reach, up=None, walls=()):
    """Return the `Level` of cameras; None if they are too few or do not agree on any up.

    reach : float [capture units]. Distance to what they look at. A path that is
        short beside it says nothing.
    """
    if len(cameras) < FEWEST:
        return None
    axes = np.array([camera.camera_from_world[:3, :3] for camera in cameras])
    eyes = np.array([camera.position for camera in cameras])
    walls = np.reshape(walls, (-1, 3))
    if up is not None:
        return _fitted(axes, eyes, reach, up, walls)
    held = [_fitted(axes, eyes, reach, first, walls) for first in _likely_ups(axes)]
    # Image-up is level where pictures were taken straight down: then the path climbs along it.
    return min(held, key=lambda level: level.deviation, default=None)


def _likely_ups(axes):
    """Return the directions that may be up by how the cameras (n, 3, 3) were held, best first."""
    found = []
    for direction, least in ((-axes[:, 1], AGREE), (-axes[:, 2], AGREE_DOWN)):
        mean = direction.mean(axis=0)
        if np.linalg.norm(mean) >= least:
            found.append(mean / np.linalg.norm(mean))
    return found


def _fitted(axes, eyes, reach, first, walls):
    """Return the `Level` near the direction `first`."""
    # Of a picture that was taken with the camera on its side the other axis is level.
    sideways = np.abs(axes[:, 0] @ first) > np.abs(axes[:, 1] @ first)
    hand = np.where(sideways[:, None], axes[:, 1], axes[:, 0])
    # The hands alone begin: a path that climbs for a part would tilt the first fit.
    weight, up, roll, climb = np.ones(len(eyes)), first, ROLL, np.inf
    across = np.linalg.svd(first[None])[2][1:].T  # (3, 2), of small turns
    # A street's fall is one for all cameras: where walls tell, their path counts as one.
    once = np.sqrt(len(eyes)) if len(walls) else 1.0
    for _ in range(ROUNDS):
        frame = np.linalg.svd(up[None])[2]
        away = eyes - weighted_median(eyes @ frame.T, weight) @ frame
        usual = max(float(np.median(np.linalg.norm(away, axis=1))), 1e-12)
        away *= (usual > LEAST_PATH * reach) / usual
        rows = np.concatenate([hand / roll, away / (climb * once)])
        rows = np.concatenate([rows * np.sqrt(np.tile(weight, 2))[:, None], walls / WALL])
        told = (rows @ across).T @ rows @ across + np.eye(2) * max(weight.sum(), 1) / PITCH**2
        up = first - across @ np.linalg.solve(told, (rows @ across).T @ rows @ first)
        up /= np.linalg.norm(up)
        # A path over a hill, and hands that were not steady, say less than was expected.
        roll = max(ROLL, DEVIATION * float(np.median(np.abs(hand @ up))))
        climb = max(CLIMB, DEVIATION * float(np.median(np.abs(away @ up))))
        off = np.hypot(hand @ up / roll, away @ up / climb)
        weight = 1 / (1 + (off / (2 * max(np.median(off), 0.75))) ** 2) ** 2
        weight /= weight.max()
    told -= np.eye(2) * (max(weight.sum(), 1) - 1) / PITCH**2  # all views lean alike
    return Level(up, 1 / np.sqrt(max(np.linalg.eigvalsh(told)[0], 1.0)), weight)


def weighted_median(values, weight):
    """Return the weighted median of each coordinate of values (n, 3), ndarray of shape (3,)."""
    order = np.argsort(values, axis=0)
    total = np.cumsum(weight[order], axis=0)
    row = (total < total[-1] / 2).sum(axis=0)
    return values[order[row, range(3)], range(3)]


class GroundBelow:
    """The splats below a path of cameras, asked for the ground at one height or another.

    Cells vote and not splats, which lie in veils before cameras where few pictures overlap.
    """

    def __init__(self, points, weights, eyes, up):
        flat = np.linalg.svd(up[None])[2][1:].T
        self._place, self._weights = points @ flat, weights
        self._away, nearest = cKDTree(eyes @ flat).query(self._place, workers=get_num_threads())
        along, usual = eyes @ up, np.median(eyes @ up)
        height = points @ up
        # The ground goes up and down with the path, or it is level and the cameras do.
        self.depths = along[nearest] - height, usual - height
        self.extent = float(np.median(np.linalg.norm(eyes - np.median(eyes, axis=0), axis=1)))

    def support(self, depth, height):
        """Return the `Support` of ground `height` below the cameras, by each splat's `depth`."""
        here = (self._away < AROUND * height) & (np.abs(depth - height) < DEPTH * height)
        if not here.any():
            return Support(0.0, 0.0, height)
        column, row = np.floor(self._place[here] / (CELL * height)).astype(np.int64).T
        _, group = np.unique(column * (np.ptp(row) + 1) + row, return_inverse=True)
        weights = self._weights[here]
        total = np.bincount(group, weights)
        layer = np.bincount(group, weights * (np.abs(depth[here] - height) < LAYER * height))
        share = float(np.mean(layer / total)) - CHANCE
        return Support(share, share * np.sqrt(len(total)) / SPREAD, height)

    def best(self, reach, usual=None):
        """Return the `Support` of the best supported height; near the `usual` one if there is one.

        `reach` is the distance to what the cameras look at [capture units].
        """
        extent = max(self.extent, reach)
        low, high = LOWEST * extent, HIGHEST * extent
        if usual is not None:
            low, high = usual / LIKELY, usual * LIKELY
        tried = low * STEP ** np.arange(int(np.log(high / low) / np.log(STEP)) + 1)
        path, level = (
            max(of_each(partial(self.support, depth), tried), key=lambda found: found.sigmas)
            for depth in self.depths
        )
        return level if level.sigmas > CLEARLY * max(path.sigmas, 0.0) else path
