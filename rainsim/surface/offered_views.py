"""Cameras for a capture that has none: rings about its ground, those that see it well.

A capture is sharp where its pictures were taken from and is blurred, torn or full of haze from
elsewhere. Where that was nobody says, but it shows: splats that a near picture made are small, and
no splat hangs before a camera that stood there. So many cameras are tried, small, and those stay
that look through clear air at ground that is captured, by splats that are small in the picture.
"""

import math
from dataclasses import replace

import numpy as np

from rainsim.io import cache
from rainsim.raster import Rasterizer, prepare
from rainsim.scene.assumed_ground import ground_extent
from rainsim.scene.cameras import look_at, resize_to
from rainsim.scene.ground_search import ground_candidates

SIZE, FOV = (648, 432), 60.0  # px, degrees
TRIED = 162  # px across the pictures that are looked at
RINGS = (0.3, 0.5, 0.75)  # of the ground's width, from its middle
ON_RING = 12  # cameras on a ring
HEIGHTS = (1.6, 2.6)  # m: the eyes of a person who stands, and of one who climbs on something
NEAREST, FARTHEST, LEAST_EYE = 0.2, 12.0, 0.1  # m from the middle to a ring; m above the ground
LOOKED_AT = 0.3  # m over the ground
THING = 4.7  # times a thing's size that counts as width: then it is in the picture whole
STEEPEST = 0.6  # of the ring's radius: the eye is no higher
LEAST_NEAR, CLEAR = 0.02, 0.4  # of the way to the middle; nothing should hang between the two
FOOT = 0.75  # of the picture's height, below which the ground before one's feet may be nearer
MOST_BEFORE = 0.03  # of the picture's brightness that hangs there; the score falls to 1 / e
BLUR = 4.0  # px: deviation of a splat that halves the score
OFFERED, NEARLY = 8, 0.6  # cameras at most; of the best one's score, at least


_last = [None, None]  # name of the result that was asked for last, and the result


def with_offered_cameras(scene):
    """Return the scene, with cameras that are offered where it has none."""
    if scene.cameras:
        return scene
    return replace(scene, cameras=tuple(offered_cameras(scene)))


def offered_cameras(scene):
    """Return cameras for a capture that has none, the best first, in the capture frame.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    list of Camera
        At most OFFERED, view_00 and so on. They stand on rings about the middle of the ground, at
        the height of a person's eyes or somewhat above, and look at the middle.

    Examples
    --------
    >>> rainsim.offered_cameras(scene)[0].name
    'view_00'
    """
    tried = tried_cameras(scene)
    inputs = scene.splats, scene.ground_frame
    name = cache.name_of(*inputs)
    if _last[0] != name:
        kept = cache.kept_arrays("offered", lambda: {"best": _best(scene, tried)}, *inputs)
        _last[:] = name, kept["best"]
    return [replace(tried[k], name=f"view_{n:02d}") for n, k in enumerate(_last[1])]


def _best(scene, tried):
    """Return the indices of the cameras that are offered."""
    score = scores(scene, tried)
    best = np.argsort(-score, kind="stable")[:OFFERED]
    return best[score[best] >= NEARLY * score[best[0]]]


def tried_cameras(scene):
    """Return the cameras that are tried, in the capture frame."""
    middle, width, heights = _stage(scene)
    found = []
    for ring in RINGS:
        away = float(np.clip(ring * width, NEAREST, FARTHEST))
        target = (*middle[:2], middle[2] + min(LOOKED_AT, 0.1 * away))
        for height in heights:
            height = float(np.clip(height, LEAST_EYE, middle[2] + STEEPEST * away))
            for n in range(ON_RING):
                angle = 2 * math.pi * n / ON_RING + math.pi  # the first one looks along x
                eye = (*(middle[:2] + away * np.array([math.cos(angle), math.sin(angle)])), height)
                camera = look_at(eye, target, (0, 0, 1), FOV, *SIZE)
                found.append(scene.ground_frame.camera_in_capture(camera))
    return found


def _stage(scene):
    """Return the middle (3,) [m] of the area to look at, its width [m] and heights of eyes [m].

    It is the ground, or where none was found the whole: a thing without ground under it.
    """
    if scene.ground_frame.confidence:
        middle, width = ground_extent(scene.splats, scene.ground_frame)
        return np.array([*middle, 0.0]), np.linalg.norm(width) / math.sqrt(2), HEIGHTS
    points = scene.ground_frame.to_ground(ground_candidates(scene.splats)[0])
    low, high = np.percentile(points, (5, 95), axis=0)
    middle, size = (low + high) / 2, float((high - low).max())
    return middle, THING * size, middle[2] + np.array([0.05, 0.3]) * size


def scores(scene, cameras):
    """Return how well each camera sees the capture, ndarray (n,), from 0 to 1.

    The product of three: the share of the lower half of the picture that shows something; how
    little hangs before the middle; how small the splats are that the picture shows.
    """
    splats, frame = scene.splats, scene.ground_frame
    rasterizer = Rasterizer(prepare(splats))
    largest = splats.scale.max(axis=1)
    middle = frame.to_capture(_stage(scene)[0])
    found = np.zeros(len(cameras))
    for n, camera in enumerate(cameras):
        small = resize_to(camera, TRIED)
        away = float(np.linalg.norm(camera.position - middle))
        whole = rasterizer.draw(small, LEAST_NEAR * away, depth="median", hit=True)
        shows = whole.hit >= 0
        if not shows.any():
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            deviation = camera.fx * largest[whole.hit[shows]] / whole.depth[shows]
        color, foot = whole.color, round(FOOT * small.height)
        beyond = rasterizer.draw(small, CLEAR * away).color
        before = np.abs(beyond - color).max(axis=2)[:foot].mean()
        found[n] = whole.alpha[small.height // 2 :].mean() * math.exp(-before / MOST_BEFORE)
        found[n] /= 1 + float(np.median(deviation)) / BLUR
    return found
