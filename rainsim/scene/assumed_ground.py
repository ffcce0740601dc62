"""The ground frame of a capture that does not say where up is or how long a metre is.

Nothing of it is known. It is a start from which a person mends up and scale by what is seen, so
each assumption is a note of its own, with the option that corrects it.
"""

import math
from dataclasses import replace

import numpy as np

from rainsim.errors import GroundError
from rainsim.scene import ground, ground_search
from rainsim.scene.types import GroundFrame

USUAL_UPS = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)  # COLMAP's, maps', glTF's
# How far a capture may lean from its usual up; weights of scores about these, and elsewhere, where
# what is not so wide is mostly the front of a house. By ten captures from photographs.
LEANS, WEIGHTS, ELSEWHERE, WIDE = math.radians(35), (1.0, 0.75, 0.75), 0.33, 0.5
WIDTH = 8.0  # m across what lies on the ground: a yard
SURE, LEAST_SURE = 0.5, 0.2  # scores of a surface: no other is looked for; it counts at all
LEAST_WIDTH = 1e-6  # of the greatest coordinate: less is one point, in float32
LOWEST = 2.0  # percentile of the splats' heights that is ground where no surface is found
TILT = math.radians(3.0)  # of the ground against a stage's up that counts as level
SLAB = 0.3  # m about the ground's height in which splats lie on it


def ground_frame_of(splats, cameras, up=None, meters_per_unit=None, camera_height=None):
    """Return the `GroundFrame` estimated with the cameras; without cameras one that is assumed."""
    if cameras or camera_height is not None:
        return ground.estimate_ground_frame(splats, cameras, up, meters_per_unit, camera_height)
    return assumed_ground_frame(splats, (), up, meters_per_unit)


def assumed_ground_frame(splats, cameras=(), up=None, meters_per_unit=None):
    """Return a `GroundFrame` for a capture of which too little is known to estimate one.

    up : array_like of shape (3,), optional. Roughly up; otherwise the flattest
        wide surface with most of the capture above it counts as level. Without
        such a surface it is the mean image-up of the cameras, or -y.
    meters_per_unit : float, optional. Otherwise the cameras stand 1.8 m above the
        ground, or the ground is 8 m wide.
    Returns GroundFrame. Each assumption is a note, with the option that corrects
        it.
    Raises GroundError if fewer than three splats are solid.
    Raises ParameterError if a given value is out of range.
    """
    eyes = np.array([camera.position for camera in cameras]).reshape(-1, 3)
    hint = ground.check_hints(up, meters_per_unit, None)
    points, _ = ground_search.ground_candidates(splats)
    found = _surface(splats, points, hint)
    if found is None:
        normal = hint if hint is not None else ground_search.mean_image_up(cameras)
        normal = np.array(USUAL_UPS[0]) if normal is None else normal
        on_it, centre, confidence = points, np.median(points, axis=0), 0.0
        low = np.percentile(points @ normal, LOWEST)
        centre = centre + (low - centre @ normal) * normal
        why = "no flat surface was found"
    else:
        plane, centre = found
        normal, confidence = plane.normal, plane.confidence
        on_it = points[np.abs(plane.height(points)) < plane.threshold]
        centre = centre - plane.height(centre) * normal
        why = "the flattest wide surface under most of the capture is taken as level"
    notes = [f"UP IS ASSUMED: {why}, up is {ground_search.said(normal)}; --up x,y,z corrects it"]
    if up is not None:
        notes = [f"up is {ground_search.said(normal)}, near the one that was given"]
    heights = (eyes - centre) @ normal
    scale = meters_per_unit
    if scale is None and len(eyes) and heights.mean() > 0:
        scale = ground.ASSUMED_CAMERA_HEIGHT / float(heights.mean())
    elif scale is None:
        scale = WIDTH / _require_width(ground.width_of(on_it), points)
    rotation = ground.ground_axes(normal, cameras)
    frame = GroundFrame(rotation, float(scale), -scale * rotation @ centre, confidence)
    length, width = sorted(ground_extent(splats, frame)[1], reverse=True)
    size = f"the ground is {length:.2g} m by {width:.2g} m"
    if meters_per_unit is None:
        notes.append(
            f"SCALE IS ASSUMED: if a unit is {scale:.3g} m, {size}; --meters-per-unit S or "
            "--known-length corrects it"
        )
    else:
        notes.append(f"scale given: {scale:g} m per unit; {size}")
    return replace(frame, notes=tuple(notes), scale_assumed=meters_per_unit is None)


def _require_width(width, points):
    """Return a width [capture units]; raise GroundError if it is that of a point."""
    if width > LEAST_WIDTH * max(1.0, float(np.abs(points).max())):
        return width
    raise GroundError(
        f"the ground cannot be found: most of the {len(points)} splats lie in one point; check "
        "that this is the whole capture, or give --ground-frame FILE.json"
    )


def _surface(splats, points, hint):
    """Return the Plane that counts as level and the middle of the splats on it; None without one.

    Nothing tells a lawn from a lawn upside down, nor a wall from ground: a surface counts by how
    sure it is, by how usual its up is and by how much more of the capture is above it than below.
    Where that decides nothing it is one that is level if the usual up is right.
    """

    def search(up, angle):
        try:
            return ground_search.search_ground(
                splats, np.zeros((0, 3)), up, angle, 0, hint is not None, ambiguous=True
            )
        except GroundError:
            return None

    def score(found):
        plane = found[0]
        height = plane.height(points)
        above, below = np.mean(height > plane.threshold), np.mean(height < -plane.threshold)
        usual = [w for up, w in zip(USUAL_UPS, WEIGHTS, strict=True)
                 if ground_search.angle_between(plane.normal, np.array(up)) < LEANS]  # fmt: skip
        usual = usual or [1.0 if plane.spread > WIDE else ELSEWHERE]
        sure = plane.confidence * usual[0]
        return sure * (above - below) / max(above + below, 1e-9)

    if hint is not None:
        return search(hint, ground_search.UP_HINT_ANGLE)
    found = [search(None, math.pi)]
    if found[0] is None or score(found[0]) < SURE:
        found += [search(np.array(up), ground_search.UP_HINT_ANGLE) for up in USUAL_UPS]
    best = max(filter(None, found), key=score, default=None)
    if best is not None and score(best) > LEAST_SURE:
        return best
    return found[1] if len(found) > 1 else None


def of_stage(frame, splats):
    """Return the ground frame of a USD stage in metres with z up: the stage's own if that fits.

    Cameras of the stage then fit too. `frame` is the one that was found.
    """
    middle = np.median(splats.position, axis=0)
    high = frame.to_ground(middle)[2] - middle[2]
    if frame.rotation[2, 2] < math.cos(TILT) or abs(high) > SLAB:
        return frame
    notes = ("the ground lies at z = 0 of the stage, whose axes and metres are kept",)
    return replace(frame, rotation=np.eye(3), translation=np.zeros(3), notes=notes)


def ground_extent(splats, frame):
    """Return the middle (2,) [m] of a capture's ground and its width along x and y (2,) [m]."""
    points = frame.to_ground(ground_search.ground_candidates(splats)[0])
    near = np.abs(points[:, 2]) < SLAB
    near = points[near] if near.any() else points
    low, high = np.percentile(near[:, :2], (5, 95), axis=0)
    return (low + high) / 2, high - low


def levelled_frame(frame, up, point):
    """Return a ground frame with another up, whose ground goes through a point; none is searched.

    frame : GroundFrame. Its scale stays, and its x axis as far as it is level.
    """
    up, point = np.array(up, np.float64) / np.linalg.norm(up), np.array(point, np.float64)
    axes = [axis - (axis @ up) * up for axis in (frame.rotation[0], frame.rotation[2])]
    x = max(axes, key=np.linalg.norm)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    origin = frame.to_capture(np.zeros(3))
    origin = origin - ((origin - point) @ up) * up
    notes = [note for note in frame.notes if note.lower().startswith("scale")]
    note = "up is given, and the ground goes through a point that is given; no plane was fitted"
    scale = frame.meters_per_unit
    return GroundFrame(
        rotation, scale, -scale * rotation @ origin, 1.0, (note, *notes), frame.scale_assumed
    )
