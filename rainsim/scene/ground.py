"""Where the ground is, which way is up and how long a metre is in a capture.

The ground is the lowest well-supported plane near the cameras, found by random sampling weighted
with opacity; cameras stand above it and give its sign; its scale follows from a given length or,
said loudly, from an assumed height of the cameras.
"""

import math
from dataclasses import replace

import numpy as np

from rainsim.errors import (
    GroundError,
    InputError,
    ParameterError,
    one_line,
    require_finite,
    require_positive,
    shown,
)
from rainsim.io.files import MAX_LENGTH, json_number, number_array, read_json, write_json
from rainsim.scene.camera_entry import Entry
from rainsim.scene.ground_search import (
    UP_HINT_ANGLE,
    angle_between,
    ground_below,
    looks_down,
    reasons_of,
    search_ground,
)
from rainsim.scene.types import GroundFrame

VERSION_KEY, VERSION = "rainsim_ground_frame", 1  # of the file of a ground frame
# m, mean over the cameras, where it is not given. Five captures from photographs say 1.67 (laser
# scan), 1.7 (a table), 1.87 (laser scan), 1.95 (GPS) and some 2.0 (a bollard).
ASSUMED_CAMERA_HEIGHT = 1.8
MOST_NOTE = 4000  # characters of a note; those of a ground that is found have up to a thousand
STRAY = 10.0  # times the usual height of the cameras: one that is higher is misplaced
LARGEST_FALL = 0.3  # a steep drive has 0.2
LIKELY_CAMERA_HEIGHTS = (1.2, 2.4)  # m: pictures taken low, and with raised arms
SCALE_REMEDY = "--known-length, --camera-height or --meters-per-unit corrects it"


def estimate_ground_frame(
    splats, cameras, up=None, meters_per_unit=None, camera_height=None, *, seed=0
):
    """Estimate the similarity that takes a capture to metres with z up and the ground near z = 0.

    cameras : sequence of Camera. In the capture frame. They say where to look for
        the ground, stand above it and fix the scale; without any, `up` and
        `meters_per_unit` are needed: `assumed_ground_frame` does without them.
    up : array_like of shape (3,), optional. Roughly up in the capture frame. The
        ground is searched within 20 degrees of level and then made exactly level;
        to keep a known fall, give the whole ground frame instead.
    meters_per_unit : float, optional [m / capture unit]
    camera_height : float, optional [m]. Mean height of the cameras above the
        ground; 1.8 m is assumed if neither is given.
    seed : int. Of the random sampling; different seeds agree to some thousandths
        of a degree.
    Returns GroundFrame. x runs along the first camera's view direction on the
        ground (along its image-up if it looks straight down), or without cameras
        along the capture's x axis, or its y axis if up is within 45 degrees of
        the x axis. The origin is the foot of the mean camera position, without
        cameras the median of the splats on the ground.
    Raises GroundError if the ground cannot be found or something needed was not
        given.
    Raises ParameterError if a given value is out of range, or both ways to give
        the scale are used.
    """
    cameras = list(cameras)
    up = check_hints(up, meters_per_unit, camera_height)
    if not cameras and (up is None or meters_per_unit is None):
        raise GroundError(
            "there are no cameras to find up and scale from; without any both must be given; give "
            "--up x,y,z and --meters-per-unit S"
        )
    eyes, told = np.empty((0, 3)), ()
    if cameras:
        plane, centre, placed, told = ground_below(splats, cameras, up, seed)
        eyes = np.array([camera.position for camera in cameras])[placed]
    else:
        plane, centre = search_ground(splats, eyes, up, UP_HINT_ANGLE, seed, True)

    notes = [_plane_note(plane, up, cameras), *told]
    heights = plane.height(eyes)
    scale, assumed = _scale(heights, meters_per_unit, camera_height, notes)
    origin = (eyes.mean(axis=0) if cameras else centre).copy()
    origin -= plane.height(origin) * plane.normal
    rotation = ground_axes(plane.normal, cameras)
    return GroundFrame(
        rotation=rotation,
        meters_per_unit=scale,
        translation=-scale * rotation @ origin,
        confidence=plane.confidence,
        notes=tuple(notes),
        scale_assumed=assumed,
    )


def check_hints(up, meters_per_unit, camera_height):
    """Return `up` as a unit vector or None, after checking all that the user gave."""
    if meters_per_unit is not None and camera_height is not None:
        raise ParameterError(
            f"meters-per-unit is {meters_per_unit} and camera-height is {camera_height}; the scale "
            "must be given in one way only; leave one out"
        )
    if meters_per_unit is not None:
        require_positive("meters-per-unit", meters_per_unit)
    if camera_height is not None:
        require_positive("camera-height", camera_height, "m")
    if up is not None:
        given, up = up, number_array(up, (3,))
        if up is None or not np.linalg.norm(up) > 0:
            raise ParameterError(f"up is {given!r}; it must be three numbers, not all 0, as 0,-1,0")
        up /= np.linalg.norm(up)
    return up


def width_of(points):
    """Return the width of the area in which most points (n, 3) of a plane lie, in their units."""
    low, high = np.percentile(points, (5, 95), axis=0)
    return max(float(np.linalg.norm(high - low)) / math.sqrt(2), 1e-9)


# --- frame ----------------------------------------------------------------------------------------


def _plane_note(plane, up, cameras):
    how = "laid below the cameras" if plane.by_cameras else "fitted to splats"
    note = f"ground plane {how}, confidence {plane.confidence:.2f} ({reasons_of(plane)}); "
    note += "up is (" + ", ".join(f"{v:.4f}" for v in plane.normal) + ") of the capture"
    if up is None:
        return f"{note}, its sign from {len(cameras)} cameras that stand above the ground"
    lean = math.degrees(angle_between(plane.normal, up))
    return (
        f"{note}, {lean:.2f} degrees from the up that was given: the ground is made level "
        "(to keep its fall, give the whole ground frame)"
    )


def _scale(heights, meters_per_unit, camera_height, notes):
    """Return metres per unit and whether it is assumed; append one note that says why."""
    if len(heights):
        stand = (
            f"the cameras stand {heights.min():.3g} to {heights.max():.3g} units above the ground, "
            f"mean {heights.mean():.3g}"
        )
    if meters_per_unit is not None:
        notes.append(f"scale given: {meters_per_unit:g} m per unit")
        if len(heights):
            notes[-1] += f"; {stand} ({heights.mean() * meters_per_unit:.2f} m)"
        return float(meters_per_unit), False
    mean = float(heights.mean())
    if camera_height is not None:
        scale = camera_height / mean
        notes.append(f"scale from the mean camera height given: {camera_height:g} m; {stand}: "
                     f"{scale:.4g} m per unit")  # fmt: skip
        return scale, False
    scale = ASSUMED_CAMERA_HEIGHT / mean
    low, high = (height / mean for height in LIKELY_CAMERA_HEIGHTS)
    notes.append(
        f"SCALE IS ASSUMED: {scale:.4g} m per unit, likely {low:.2g} to {high:.2g}, as if the "
        f"{len(heights)} cameras stood {ASSUMED_CAMERA_HEIGHT} m above the ground; {SCALE_REMEDY}"
    )
    return scale, True


def ground_axes(up, cameras):
    """Return the rows x, y, z of the ground frame: x nearest to the first view, z `up`."""
    if len(cameras):
        wanted = [cameras[0].forward, cameras[0].image_up]
        least = 0.1  # a view within 6 degrees of straight down has no horizontal direction
    else:
        wanted, least = np.eye(3)[:2], math.sqrt(0.5)
    for direction in wanted:
        x = direction - (direction @ up) * up
        if np.linalg.norm(x) > least:
            break
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def require_known_scale(frame, cameras):
    """Raise GroundError if the scale is assumed of cameras that look down from the air.

    Nobody carried them; drones fly at 20 to 120 m, so nothing can be assumed.
    """
    if frame.scale_assumed and len(cameras) and looks_down(cameras, frame.up):
        raise GroundError(
            "the cameras look straight down from the air, so their height above the ground cannot "
            "be assumed; give it with --camera-height M (the drone's log and its photographs have "
            "it), or photographs with GPS by --photos, or --known-length or --meters-per-unit"
        )


def rescale_ground_frame(frame, cameras, meters_per_unit=None, camera_height=None):
    """Return the same ground frame with another scale, given as in `estimate_ground_frame`."""
    check_hints(frame.up, meters_per_unit, camera_height)
    if not len(cameras) and meters_per_unit is None:
        raise GroundError(
            "there are no cameras to find the scale from; without cameras --meters-per-unit S is "
            "needed; give it"
        )
    eyes = np.array([frame.to_ground(camera.position) for camera in cameras]).reshape(-1, 3)
    if len(eyes):  # what a solver misplaced does not count
        usual = float(np.median(np.abs(eyes[:, 2])))
        eyes = eyes[np.abs(eyes[:, 2]) <= STRAY * usual]
    notes = [note for note in frame.notes if not note.lower().startswith("scale")]
    scale, assumed = _scale(
        eyes[:, 2] / frame.meters_per_unit, meters_per_unit, camera_height, notes
    )
    return replace(
        frame,
        meters_per_unit=scale,
        translation=frame.translation * (scale / frame.meters_per_unit),
        notes=tuple(notes),
        scale_assumed=assumed,
    )


def scale_from_length(a, b, length):
    """Return the metres per unit if the points a and b [capture units] are `length` [m] apart."""
    length = require_positive("known-length", length, "m")
    ends = number_array([a, b], (2, 3))
    if ends is None:
        raise ParameterError(
            f"known-length has the points {shown((a, b))}; they must be finite and less than "
            f"{MAX_LENGTH:g} units away; pick points of the capture"
        )
    units = float(np.linalg.norm(ends[0] - ends[1]))
    if not units > 0:
        raise ParameterError(
            "known-length has the same point twice; the points must differ; pick two ends of "
            "something whose length is known"
        )
    return length / units


def with_fall(frame, fall, direction):
    """Return a ground frame whose ground slopes instead of being level.

    fall : float. Metres down per metre; patios are laid with 0.01 to 0.03.
    direction : float [rad]. The way it goes down, from x towards y.
    """
    require_finite("fall direction", direction)
    if not abs(require_finite("fall", fall)) <= LARGEST_FALL:
        raise ParameterError(
            f"fall is {fall * 100:g} percent; it must be within {LARGEST_FALL:.0%}; a slope that "
            "steep is seen in the splats"
        )
    angle = math.atan(fall)
    down = np.array([math.cos(direction), math.sin(direction), 0.0])
    z = np.array([0.0, 0.0, 1.0])
    across = np.cross(z, down)
    # Rodrigues' formula about the level axis across the fall.
    tilt = sum(
        np.outer(own, axis)
        for axis, own in (
            (across, across),
            (down, math.cos(angle) * down - math.sin(angle) * z),
            (z, math.cos(angle) * z + math.sin(angle) * down),
        )
    )
    note = f"a fall of {fall * 100:g} % towards {math.degrees(direction):g} degrees was given"
    return replace(
        frame,
        rotation=tilt @ frame.rotation,
        translation=tilt @ frame.translation,
        notes=(*frame.notes, note),
    )


# --- file -----------------------------------------------------------------------------------------


def ground_frame_to_dict(frame):
    """Return the frame as a dict for JSON; `ground_frame_from_dict` takes it back exactly."""
    return {
        "rotation": np.asarray(frame.rotation).tolist(),
        "meters_per_unit": float(frame.meters_per_unit),
        "translation": np.asarray(frame.translation).tolist(),
        "confidence": float(frame.confidence),
        "scale_assumed": bool(frame.scale_assumed),
        "notes": list(frame.notes),
    }


def ground_frame_from_dict(data, source):
    """Return the GroundFrame that `data`, read from JSON in `source`, describes."""
    entry = Entry(source, "ground frame", data)
    rotation = entry.array("rotation", (3, 3))
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{source}: the rotation's rows are not right-handed unit vectors at right angles; "
            "they must be the ground's x, y and z axes in the capture frame; correct the file"
        )
    confidence = json_number(data.get("confidence", 1.0))
    notes = data.get("notes", [])
    if confidence is None or not 0 <= confidence <= 1 or not isinstance(notes, list):
        raise InputError(f"{source}: confidence must be 0 to 1 and notes a list; correct the file")
    try:
        return GroundFrame(
            rotation=rotation,
            meters_per_unit=entry.number("meters_per_unit", 0, MAX_LENGTH),
            translation=entry.array("translation", (3,)),
            confidence=confidence,
            notes=tuple(one_line(note, MOST_NOTE) for note in notes),
            scale_assumed=data.get("scale_assumed") is True,
        )
    except ParameterError as error:
        raise InputError(f"{source}: {error}") from None


def read_ground_frame(path, source_hash=""):
    """Read the GroundFrame in the JSON file `path`, as `write_ground_frame` writes it.

    Only rotation (3 rows: the ground's x, y and z axes in the capture frame), meters_per_unit and
    translation [m] are required; a file without a version is of version 1. `source_hash` is that of
    the scene it is for: a note says if the file was made for another.
    """
    data = read_json(path, "a ground frame")
    if isinstance(data, dict) and data.get(VERSION_KEY, VERSION) != VERSION:
        raise InputError(
            f"{path} has {VERSION_KEY} {shown(data[VERSION_KEY])}; it must be {VERSION}; write it "
            "with rainsim import"
        )
    frame = ground_frame_from_dict(data, path)
    own = data.get("source_sha256")
    if not (own and source_hash) or own == source_hash:
        return frame
    note = (
        f"THE GROUND FRAME IS OF ANOTHER CAPTURE: {path} was made for other splats; it fits only a "
        "capture in the same coordinates, as one that was trained again"
    )
    return replace(frame, notes=(*frame.notes, note))


def write_ground_frame(path, frame, source_hash=""):
    """Write a scene's GroundFrame as a JSON file that reads back exactly."""
    source = {"source_sha256": source_hash} if source_hash else {}
    write_json(path, {VERSION_KEY: VERSION, **source, **ground_frame_to_dict(frame)})
