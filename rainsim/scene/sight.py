"""Whether cameras and splats belong together: what each camera sees, and in which frame.

Two valid files need not be of one place: cameras of another capture, splats that a tool has turned
or scaled on export. What the cameras see tells it before anything is computed.
"""

import numpy as np

from rainsim.errors import InputError, ParameterError, require_choice
from rainsim.io.files import MAX_LENGTH, read_json
from rainsim.scene.camera_entry import Entry
from rainsim.scene.formats.spz import UNSAID, half_turned
from rainsim.scene.plyheader import header_of
from rainsim.scene.types import pose_at
from rainsim.scene.view import camera_points, image_point

SAMPLE = 20_000  # splats that are looked for in each camera's picture
MOST_CAMERAS = 200
LEAST_SEEN = 5e-4  # share of the splats; a camera in a street of a kilometre sees some per cent
SPECK = 0.05  # of a picture's width; splats that cover less are those of a far place
BLIND_SHARE = 0.2  # of the cameras that may see less without a word
CLEARER = 1.3  # times as many splats must be seen in one frame as in the other
SPZ_FRAMES = ("rub", "rdf")
NERFSTUDIO_AXIS = "vertical axis: z"  # a comment of its PLY files
DATAPARSER = "dataparser_transforms.json"


def seen_shares(splats, cameras):
    """Return the share of the splats whose centres lie in each camera's picture, (cameras,).

    It is 0 where they all lie in a speck of it. Of many splats a sample is looked for, the same in
    every run.
    """
    step = max(1, len(splats) // SAMPLE)
    places = splats.position[::step].astype(np.float64)
    shares = np.empty(len(cameras))
    for k, camera in enumerate(cameras):
        seen = camera_points(camera, places)
        ahead = seen[:, 2] > 0
        x, y, z = seen[ahead].T
        x, y = image_point(camera, x, y, 1.0 if camera.orthographic else z)
        within = (x > 0) & (x < camera.width) & (y > 0) & (y < camera.height)
        wide = np.ptp(np.percentile(x[within], (5, 95))) if within.any() else 0.0
        shares[k] = within.mean() * ahead.mean() if wide > SPECK * camera.width else 0.0
    return shares


def require_sight(path, splats, cameras):
    """Note that many cameras see next to none of the splats; InputError if all of them do."""
    chosen = _some_of(cameras)
    if not chosen:
        return []
    shares = seen_shares(splats, chosen)
    blind = int((shares < LEAST_SEEN).sum())
    if blind == len(chosen):
        raise InputError(
            f"{path}: none of its {len(cameras)} cameras sees the splats; they lie about "
            f"{_text(np.median(splats.position, axis=0))}, cameras about "
            f"{_text(np.median([c.position for c in chosen], axis=0))}; they are of another place "
            "or another frame; give the capture's own with --cameras"
        )
    if blind > BLIND_SHARE * len(chosen):
        return [
            f"{blind} of {len(chosen)} cameras see less than {100 * LEAST_SEEN:g} % of the splats "
            f"(the others {100 * np.median(shares[shares >= LEAST_SEEN]):.2g} %); are they all of "
            "this capture?"
        ]
    return []


def _some_of(cameras):
    return list(cameras)[:: max(1, len(cameras) // MOST_CAMERAS)]


def _text(place):
    return "(" + ", ".join(f"{v:.4g}" for v in place) + ")"


def settled(splats, notes, cameras, asked=None):
    """Return the splats of an SPZ file that does not say its frame in that frame, and notes.

    They are taken as the format describes them (right, up, back) unless the cameras see far more
    of them as converters from PLY store them, unturned (right, down, forward), or `asked`, "rub"
    or "rdf", says so.
    """
    if UNSAID not in notes:
        if asked is not None:
            raise ParameterError(
                f"--spz-frame is {asked}; this capture is no SPZ file or says its frame itself; "
                "leave it out"
            )
        return splats, notes
    if asked is not None:
        require_choice("--spz-frame", asked, SPZ_FRAMES)
    turned, how, chosen = asked == "rdf", "as given", _some_of(cameras)
    other = half_turned(splats) if turned or (asked is None and chosen) else splats
    if asked is None:
        seen, seen_turned = (
            float(np.median(seen_shares(s, chosen))) if chosen else 0.0 for s in (splats, other)
        )
        turned = seen_turned > CLEARER * seen
        sure = turned or seen > CLEARER * seen_turned
        how = (
            f"in which its cameras see {100 * max(seen, seen_turned):.0f} % of the splats, "
            f"{100 * min(seen, seen_turned):.0f} % in the other"
            if sure
            else "as the format describes it, which its cameras neither confirm nor deny; if the "
            "capture lies on its head give --spz-frame rdf"
        )
    frame = "right, down, forward (rdf)" if turned else "right, up, back (rub)"
    note = f"SPZ does not say its axes: taken for {frame}, {how}"
    return other if turned else splats, [note if text == UNSAID else text for text in notes]


def in_nerfstudio_frame(splat_file, camera_file, cameras):
    """Return cameras of a transforms.json in the frame of splats that nerfstudio has exported.

    Its dataparser turns, moves and scales a capture, `ns-export gaussian-splat` leaves the splats
    so, and the run's dataparser_transforms.json, beside either file, says how: x' = scale T x for
    places before the `applied_transform` of transforms.json. Other cameras come back as they are.

    Returns cameras : list of Camera
        notes : list of str
    """
    if not _is_nerfstudio(splat_file) or camera_file.name != "transforms.json":
        return cameras, []
    cameras_data = read_json(camera_file, "a camera file")
    if any("camera_from_world" in frame for frame in cameras_data["frames"]):
        return cameras, []  # our own, which has the splats' frame
    folders = dict.fromkeys((splat_file.parent, camera_file.parent))
    file = next((f / DATAPARSER for f in folders if (f / DATAPARSER).is_file()), None)
    if file is None:
        return cameras, [
            "WARNING: nerfstudio exported the splats in a frame of its own; cameras of "
            f"transforms.json are in it only with the run's {DATAPARSER} beside the splats "
            "(outputs/NAME/METHOD/TIME/); copy it there"
        ]
    entry = Entry(file, "transform", read_json(file, "a nerfstudio transform"))
    usual = {"applied_transform": np.eye(3, 4), "applied_scale": 1.0}
    applied = Entry(camera_file, "transform", cameras_data, usual)
    matrix, before = entry.array("transform", (3, 4)), applied.array("applied_transform", (3, 4))
    for own, key, values in (entry, "transform", matrix), (applied, "applied_transform", before):
        if abs(abs(np.linalg.det(values[:, :3])) - 1) > 1e-3:
            raise own.error(key, "a rotation and translation")
    scale = entry.number("scale", 0, MAX_LENGTH)
    scale_before = applied.number("applied_scale", 0, MAX_LENGTH)
    turn = matrix[:, :3] @ np.linalg.inv(before[:, :3])
    shift, scale = matrix[:, 3] - turn @ before[:, 3], scale / scale_before
    moved = []
    for camera in cameras:
        place = scale * (turn @ camera.position + shift)
        moved.append(camera.posed(pose_at(camera.camera_from_world[:3, :3] @ turn.T, place)))
    return moved, [
        f"cameras are in the frame of nerfstudio's splats, by {DATAPARSER} (scale {scale:.4g})"
    ]


def _is_nerfstudio(splat_file):
    header = header_of(splat_file) if splat_file.suffix.lower() == ".ply" else None
    return header is not None and NERFSTUDIO_AXIS in (c.lower() for c in header.comments)
