"""Parts of a big capture that are held whole: for a height map and for the beams of a lidar.

They are fine near by and coarser far away.
"""

from dataclasses import replace

import numpy as np

from rainsim.lod.levels import coarsest_levels
from rainsim.scene.formats.streamed import NONE
from rainsim.scene.pages import ALWAYS, levels_at
from rainsim.scene.splat_sets import joined

MOST = 3_000_000  # splats of such a part; some 150 bytes each
NEAR = 10.0  # m from the cameras up to which the map is as fine as its cells
LEAST = 1e-3  # m of a cell, from which on cells get wider
NEAREST = 4  # leaves that show how dense the ground is


def scene_over(scene, grid):
    """Return a scene that holds the splats over a map; of one that is held whole the scene itself.

    Levels whose cells are no wider than the map's are taken near the cameras, and in proportion to
    the distance farther away; if these are more than MOST splats, coarser ones.
    """
    if scene.pages is None:
        return scene
    tree, frame = scene.pages.tree, scene.ground_frame
    low, high = _boxes_on_ground(tree.box, frame)
    first, last = np.array(grid.origin), np.array(grid.origin) + grid.size
    over = ((high[:, :2] > first) & (low[:, :2] < last)).all(axis=1)
    away = np.zeros(len(tree.box))
    if scene.cameras:
        eyes = frame.to_ground(np.array([camera.position for camera in scene.cameras]))[:, :2]
        gap = np.maximum(np.maximum(low[:, None, :2] - eyes, eyes - high[:, None, :2]), 0)
        away = np.linalg.norm(gap, axis=-1).min(axis=1)
    return _as_fine(scene, over, grid.spacing * np.maximum(away / NEAR, 1))


def scene_in_reach(scene, places, far, angle):
    """Return a scene of the splats that beams from some places reach, as fine as the beams are.

    Levels are taken whose cells are no wider than a beam at the nearest point of the part that they
    show; if these are more than MOST splats, coarser ones. A scene that is held whole is returned
    as it is. `places` are (n, 3) [m] in the ground frame, `far` [m] is the reach of the beams and
    `angle` [rad] that by which they widen.
    """
    if scene.pages is None:
        return scene
    low, high = _boxes_on_ground(scene.pages.tree.box, scene.ground_frame)
    away = np.full(len(low), np.inf)
    for place in np.asarray(places, np.float64):
        gap = np.maximum(np.maximum(low - place, place - high), 0)
        away = np.minimum(away, np.linalg.norm(gap, axis=1))
    return _as_fine(scene, away <= far, angle * away)


def _as_fine(scene, wanted, width):
    """Return a scene of `wanted` leaves with cells at most so wide [m], of at most MOST splats."""
    tree = scene.pages.tree
    side = tree.side * scene.ground_frame.meters_per_unit
    while True:
        levels = coarsest_levels(tree, side <= width[:, None])
        count = tree.count[np.arange(len(levels)), levels][wanted].sum()
        if count <= MOST or (levels[wanted] == tree.levels - 1).all():
            return _of_runs(scene, [(n, levels[n]) for n in np.flatnonzero(wanted)])
        width = np.maximum(width, LEAST) * 2**0.5


def finest_near(scene, point):
    """Return a scene of the finest splats about a point (x, y) [m] on the ground."""
    tree = scene.pages.tree
    low, high = _boxes_on_ground(tree.box, scene.ground_frame)
    gap = np.linalg.norm(np.maximum(np.maximum(low - (*point, 0), (*point, 0) - high), 0), axis=1)
    nearest = np.argsort(gap, kind="stable")[:NEAREST]
    levels = levels_at(tree, 0)
    return _of_runs(scene, [(n, levels[n]) for n in sorted(nearest)])


def _of_runs(scene, runs):
    """Return a scene held whole of some runs and the splats that are always drawn."""
    pages = scene.pages
    wanted = [(int(n), int(level)) for n, level in runs if pages.tree.file[n, level] != NONE]
    every = [pages.splats(*run) for run in wanted]
    if pages.always:
        every.append(pages.splats(ALWAYS, 0))
    return replace(scene, splats=joined(every), pages=None) if every else scene


def _boxes_on_ground(box, frame):
    """Return lowest and highest (n, 3) [m] in the ground frame of boxes in the capture frame."""
    corners = box[:, [[0, 1, 2], [3, 1, 2], [0, 4, 2], [3, 4, 2],
                      [0, 1, 5], [3, 1, 5], [0, 4, 5], [3, 4, 5]]].astype(np.float64)  # fmt: skip
    places = frame.to_ground(corners.reshape(-1, 3)).reshape(-1, 8, 3)
    return places.min(axis=1), places.max(axis=1)
