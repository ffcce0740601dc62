"""The search for the ground among a capture's splats, level as its cameras were held."""

import math
from dataclasses import replace

import numpy as np

from rainsim.errors import GroundError
from rainsim.scene.level import (
    AGREE_DOWN,
    CHANCE,
    FULL_SIGMAS,
    MISPLACED,
    SURE,
    GroundBelow,
    level_of,
    weighted_median,
)
from rainsim.scene.plane import ROUGHER, THRESHOLD, Plane, find_plane, upright_planes

UP_HINT_ANGLE = math.radians(20)  # how far the ground may lean from an up that the user gives
IMAGE_UP_ANGLE = math.radians(70)  # from image-up, which leans as far as a camera looks down
LEVEL_ANGLE = math.radians(3)  # from the cameras' level; three of its deviations, if that is more
BY_VIEWS = math.radians(45)  # from image-up: such a level was found by views down
# A plane of splats of this confidence is taken as it is; a poorer one, unless the plane that is
# level by the cameras has so many times its share of places with ground.
SURE_PLANE, CLEARLY = 0.5, 1.25
# Support from which on ground that is not found is taken below cameras whose level is so sure.
HINTED, SURE_LEVEL = 1.0, math.radians(2)
LOOKS_IN = 0.5  # mean cosine of views to the cameras' middle, from which on they look at a thing
FROM_THE_AIR = "the cameras look straight down: a survey from the air"
TOO_POOR = "the ground is too poor to be found"  # begins the note on a plane that was not found
MOST_NAMED = 4  # misplaced cameras in a note
LEAST_IMAGE_UP = 0.3  # mean of unit vectors; shorter means that the cameras do not agree

LEAST_CONFIDENCE = 0.2  # below this a found plane is more likely something else
MAX_POINTS = 120_000  # that the plane is fitted to; more cost time and change nothing
LEAST_SPLATS = 3  # that a plane goes through
LEAST_OPACITY = 0.1  # fainter splats are haze and floaters
AREA_CAP = 4.0  # times the median area: a big splat must not outweigh the paving's many
LEAST_SHARE = 0.1  # of the splats must be as near as the cameras, or the search starts wider:
START_SHARE = 0.4  # around one garden camera 0.2 sees lawn only, 2 degrees off; 0.4 is 0.2 off
GROWTH = 1.5  # of the search radius when the ground is not within it
LEAST_RADIUS = 1e-4  # of the farthest: where many splats are in one point a radius of 0 never grows


def ground_below(splats, cameras, up, seed):
    """Return the ground Plane below cameras, its middle, which cameras count, and notes.

    Flat ground seen from all around is the best level. The sheets of splats before few cameras are
    none: then the cameras tell what is level, and the splats how far below them the ground lies.
    With `up` given some plane is always taken.

    cameras : list of Camera. In the capture frame, at least one.
    up : array (3,) or None. Roughly up, unit.
    Returns plane : Plane
        centre : array (3,) [capture units]
        placed : bool array (n,). Which cameras are not misplaced.
        notes : tuple of str
    """
    points, weights = ground_candidates(splats)
    eyes = np.array([camera.position for camera in cameras])
    reach = float(np.median(np.linalg.norm(points - np.median(eyes, axis=0), axis=1)))
    level, placed, notes = level_of(cameras, reach), np.ones(len(eyes), bool), []
    if level is None and up is not None:
        level = level_of(cameras, reach, up)
    if level is not None and up is not None and angle_between(level.up, up) > UP_HINT_ANGLE:
        off = math.degrees(angle_between(level.up, up))
        notes.append(f"the cameras were held {off:.0f} degrees from the up that is given")
        level = None
    if level is not None and up is None:
        level = _upright(level, splats, cameras, reach, seed)
    if level is not None:
        level = _with_walls(level, cameras, points, reach, seed)
    hint, angle = up, UP_HINT_ANGLE
    if level is not None:
        hint, angle = level.up, max(LEVEL_ANGLE, 3 * level.deviation)
        placed = level.weight >= MISPLACED
        notes += _about_misplaced(cameras, placed)
    elif up is None:
        hint = mean_image_up(cameras)
        angle = math.pi if hint is None else IMAGE_UP_ANGLE
    above = hint is not None and looks_down(cameras, hint)
    if above:
        notes.append(FROM_THE_AIR)
    try:
        sure = level is not None or up is not None
        # From far above the ground fills the picture: it lies about the splats' middle.
        around = eyes[:0] if above else eyes[placed]
        plane, centre = search_ground(splats, around, hint, angle, seed, sure, ambiguous=sure)
    except GroundError:
        if not sure:
            raise
        plane, centre = None, None
    if not sure:
        return plane, centre, placed, notes
    below, height, own = GroundBelow(points, weights, eyes[placed], hint), None, None
    if plane is not None:
        plane = replace(plane, rival=None)
        height = float(np.median(plane.height(eyes[placed])))
        own = below.support(height - plane.height(points), height)
        if level is None or plane.confidence >= SURE_PLANE:
            if level is not None and angle_between(plane.normal, hint) > 3 * level.deviation:
                # The ground slopes, or what a few cameras look down on does.
                plane = _level_plane(hint, eyes[placed], own)
            return plane, centre, placed, notes
    best = below.best(reach, reach if above and height is None else height)
    if own is not None and best.share <= CLEARLY * own.share:
        return plane, centre, placed, notes
    if own is None and best.sigmas < SURE:
        hinted = best.sigmas > HINTED and level is not None and level.deviation < SURE_LEVEL
        if up is None and not (hinted and _looks_around(cameras)):
            raise _no_ground_below(best)
        notes.append(f"{TOO_POOR}: the plane {best.height:.3g} units below the cameras is taken")
    return _level_plane(hint, eyes[placed], best), None, placed, notes


def _about_misplaced(cameras, placed):
    """Return a list with a note that names the misplaced cameras, empty without any."""
    wrong = [camera.name for camera, fine in zip(cameras, placed, strict=True) if not fine]
    if not wrong:
        return []
    more = ", ..." if len(wrong) > MOST_NAMED else ""
    return [
        f"{len(wrong)} of {len(cameras)} cameras are misplaced and do not count for the ground: "
        f"{', '.join(wrong[:MOST_NAMED])}{more}"
    ]


def _with_walls(level, cameras, points, reach, seed):
    """Return the `Level` of cameras and walls; as it is, if there are no walls.

    Of cameras that look at one front from one side the path alone gives the pitch; it may climb.
    """
    eye = np.median([camera.position for camera in cameras], axis=0)
    walls = upright_planes(points, eye, level.up, reach, seed)
    if not len(walls):
        return level
    # Cameras that climb against the walls are not misplaced: the weights stay.
    return level_of(cameras, reach, level.up, walls)._replace(weight=level.weight)


def looks_down(cameras, up):
    """Tell whether the cameras look straight down, as those of a survey from the air do."""
    return float(np.mean([camera.forward @ -up for camera in cameras])) > AGREE_DOWN


def mean_image_up(cameras):
    """Return the cameras' mean image-up, a unit vector; None without any that they share."""
    if not len(cameras):
        return None
    mean = np.mean([camera.image_up for camera in cameras], axis=0)
    length = np.linalg.norm(mean)
    return None if length < LEAST_IMAGE_UP else mean / length


def _upright(level, splats, cameras, reach, seed):
    """Return the `Level` by image-up where ground lies below that; else `level`, by views down.

    From a straight path before a front the front looks as ground does from the air.
    """
    own = mean_image_up(cameras)
    if own is None or angle_between(level.up, own) < BY_VIEWS:
        return level
    upright = level_of(cameras, reach, own)
    eyes = np.array([camera.position for camera in cameras])[upright.weight >= MISPLACED]
    angle = max(LEVEL_ANGLE, 3 * upright.deviation)
    try:
        plane, _ = search_ground(splats, eyes, upright.up, angle, seed, True, ambiguous=True)
    except GroundError:
        return level
    return upright if plane.confidence >= SURE_PLANE else level


def _looks_around(cameras):
    """Tell whether cameras look ahead or outwards, as on a walk, and not at a thing from around."""
    eyes = np.array([camera.position for camera in cameras])
    inwards = np.median(eyes, axis=0) - eyes
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    ahead = np.array([camera.forward for camera in cameras])
    return float(np.mean(np.sum(inwards * ahead, axis=1))) < LOOKS_IN


def _level_plane(up, eyes, support):
    """Return the Plane that is level by the cameras, at the height that its `support` says."""
    confidence = float(np.clip(support.sigmas / FULL_SIGMAS, 0, 1))
    return Plane(
        up, support.height - float(np.median(eyes @ up)), confidence,
        support=support.share + CHANCE, by_cameras=True,
    )  # fmt: skip


def _no_ground_below(support):
    return GroundError(
        "the ground cannot be found: no plane of splats lies below the cameras, and at no height "
        f"below them lies more than chance puts there ({support.sigmas:.1f} deviations, {SURE:g} "
        "count); --up x,y,z takes the plane below the cameras all the same, --ground-frame "
        "FILE.json gives the whole frame"
    )


def search_ground(splats, eyes, up, max_angle, seed, up_given, ambiguous=False):
    """Return the ground Plane and the middle of the splats on it; the radius grows until found.

    Flat ground is looked for first, then rougher. Of two planes that are as good one is taken if it
    may be `ambiguous`, else that is an error.
    """
    points, weights = ground_candidates(splats)
    centre = eyes.mean(axis=0) if len(eyes) else weighted_median(points, weights)
    distance = np.linalg.norm(points - centre, axis=1)
    radius = np.linalg.norm(eyes - centre, axis=1).max(initial=0.0)
    start, farthest = np.quantile(distance, [START_SHARE, 0.95])
    if np.mean(distance <= radius) < LEAST_SHARE:  # one camera, a few close together, or none
        radius = start
    if not len(eyes) and up is None:  # only its width distinguishes the ground from a table
        radius = farthest
    radii = [max(radius, LEAST_RADIUS * farthest)]
    while radii[-1] < farthest:
        radii.append(radii[-1] * GROWTH)
    best = None
    for thickness in (THRESHOLD, *ROUGHER):
        for radius in radii:
            near = distance <= radius
            step = max(1, math.ceil(np.count_nonzero(near) / MAX_POINTS))
            here, weight = points[near][::step], weights[near][::step]
            plane = find_plane(here, weight, eyes, up, max_angle, radius, seed, thickness)
            if plane is None:
                continue
            plane = _nearer(plane, up) if up_given else plane
            if plane.confidence >= LEAST_CONFIDENCE:
                if (
                    plane.rival is not None and not ambiguous
                ):  # a wider search would find a plane between the two
                    raise _two_grounds(plane)
                on_it = np.abs(plane.height(here)) < 2 * thickness * radius
                return plane, weighted_median(here[on_it], weight[on_it])
            if best is None or plane.confidence > best.confidence:
                best = plane
    raise _not_found(best)


def _nearer(plane, up):
    """Return the plane or its rival, if one is clearly nearer to `up`; else the plane as it is."""
    if plane.rival is None:
        return plane
    own, other = angle_between(plane.normal, up), angle_between(plane.rival.normal, up)
    if abs(own - other) < angle_between(plane.normal, plane.rival.normal) / 2:
        return plane
    return replace(plane if own < other else plane.rival, rival=None)


def angle_between(a, b):
    """Return the angle between two directions [rad]."""
    return math.atan2(np.linalg.norm(np.cross(a, b)), a @ b)


def ground_candidates(splats):
    """Return positions (n, 3) and weights (n,), float64, of the splats that may be ground."""
    solid = splats.opacity >= LEAST_OPACITY  # false for NaN
    solid &= np.isfinite(splats.position).all(axis=1) & np.isfinite(splats.scale).all(axis=1)
    if np.count_nonzero(solid) < LEAST_SPLATS:
        raise GroundError(
            f"{np.count_nonzero(solid)} of the capture's {len(splats)} splats can be ground "
            f"(opacity {LEAST_OPACITY} or more); it takes {LEAST_SPLATS} to find a plane; check "
            "that this is the whole capture, or give --ground-frame FILE.json"
        )
    scale = splats.scale[solid]
    area = scale.prod(axis=1, dtype=np.float64) / np.maximum(scale.min(axis=1), 1e-30)
    cap = AREA_CAP * np.median(area)
    weight = splats.opacity[solid] * (np.minimum(area, cap) if cap > 0 else 1.0)
    fine = weight > 0
    return splats.position[solid][fine].astype(np.float64), weight[fine].astype(np.float64)


def _not_found(best):
    if best is None:
        found = "no plane of splats lies below the cameras and across up"
    else:
        found = (
            f"the best plane has a confidence of {best.confidence:.2f}, below "
            f"{LEAST_CONFIDENCE:g} ({reasons_of(best)})"
        )
    return GroundError(
        f"the ground cannot be found: {found}; give --up x,y,z to say roughly where up is, or the "
        "whole frame with --ground-frame FILE.json"
    )


def _two_grounds(plane):
    between = math.degrees(angle_between(plane.normal, plane.rival.normal))
    return GroundError(
        f"the ground is ambiguous: two planes {between:.1f} degrees apart are as good, with up "
        f"{said(plane.normal)} and {said(plane.rival.normal)}; give the right one, as "
        f"--up={said(plane.normal)}, or the whole frame with --ground-frame FILE.json"
    )


def said(direction):
    """Return a direction as --up takes it."""
    return ",".join(f"{v:.3f}" for v in direction + 0.0)


def reasons_of(plane):
    """Return a sentence with the figures behind a plane's confidence: support, peak and spread."""
    if plane.by_cameras:
        return (
            f"level by the cameras; where they went, {plane.support:.0%} of the splats lie in the "
            f"ground's layer, {CHANCE:.0%} by chance"
        )
    ratio = plane.peak / max(1 - plane.peak, 1e-3)
    return (
        f"{plane.support:.0%} of the splats near by lie within {plane.threshold:.2g} units of it, "
        f"{min(ratio, 999):.2g} times as many as beside it, across {plane.spread:.0%} of the region"
    )
