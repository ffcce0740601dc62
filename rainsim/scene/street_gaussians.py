"""Models of Street Gaussians (Yan et al. 2024): a PLY with an element for each node, and tracks.

The PLY has the elements vertex_background, vertex_obj_NNN and, in older models, vertex_sky,
each with the properties of 3DGS. A node's f_dc properties hold, channel by channel, the terms of a
Fourier series over its frames. Its frame has the middle of its box as origin and x along its
heading, in metres; its harmonics take directions of the capture frame.

The PLY has no poses. They come from the data that the model was trained on, as Street Gaussians'
scripts for Waymo lay them out: track/track_info.txt (a line for each node and frame: frame, track,
class, alpha, height, width, length, centre x, y, z and heading in the vehicle's frame, speed),
ego_pose/NNNNNN.txt (4 x 4, vehicle to world, less the mean place), timestamps.json.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.actors.actor import Actor, ColorSeries
from rainsim.actors.motion import Track
from rainsim.errors import InputError, shown
from rainsim.io.files import MAX_LENGTH, json_number, printable_name, read_json, read_text
from rainsim.scene.camera_rule import is_rigid
from rainsim.scene.ply import read_element
from rainsim.scene.plyheader import read_header
from rainsim.scene.splat_sets import joined

BACKGROUND, SKY, NODE = "vertex_background", "vertex_sky", "vertex_obj_"
TRACKS, POSES, TIMES = "track/track_info.txt", "ego_pose", "timestamps.json"
COLUMNS = 11  # of a line that are read: up to the heading
BEYOND = 0.1  # s before its first frame and after its last that a node is there
PICTURE = re.compile(r"(\d{6})_(\d)")  # frame and camera in a picture's name
MOST_TRACKS = 1 << 28  # bytes of text
REMEDY = "it must be laid out as Street Gaussians' scripts for Waymo write it; check --tracks"


@dataclass(frozen=True)
class StreetModel:
    """The content of a PLY of Street Gaussians.

    Attributes
    ----------
    static : Splats
        Background and sky.
    nodes : dict of int to (Splats, ndarray of shape (n, m, 3))
        By track: splats in the node's frame, and the terms of their first coefficients.
    notes : tuple of str
    """

    static: object
    nodes: dict
    notes: tuple


def is_street_ply(path):
    """Whether a file is a PLY with a background of Street Gaussians."""
    with open(path, "rb") as file:
        if not file.read(4).startswith((b"ply\n", b"ply\r")):
            return False
        file.seek(0)
        return read_header(path, file).find(BACKGROUND) is not None


def read_street_ply(path):
    """Return the `StreetModel` of a PLY; unusable splats are dropped as in any other file."""
    with open(path, "rb") as file:
        header = read_header(path, file)
    static, nodes, notes = [], {}, []
    for element in header.elements:
        if element.count == 0:
            notes.append(f"{printable_name(element.name)} is empty and left out")
        elif element.name in (BACKGROUND, SKY):
            splats, _, said = read_element(path, element)
            static.append(splats)
            notes += [f"{element.name.removeprefix('vertex_')}: {note}" for note in said]
        elif element.name.startswith(NODE):
            number = element.name.removeprefix(NODE)
            if not number.isdecimal() or len(number) > 9 or int(number) in nodes:
                raise InputError(
                    f"{path} has the element {printable_name(element.name)}; a node's name must "
                    "end in the number of its track, once; export the model again"
                )
            nodes[int(number)], said = _node(path, element)
            notes += [f"node {int(number)}: {note}" for note in said]
        else:
            notes.append(f"element {printable_name(element.name)} is not known and left out")
    if not static:
        raise InputError(f"{path} has no splats in {BACKGROUND}; export the model again")
    return StreetModel(joined(static), nodes, tuple(notes))


def _node(path, element):
    """Return the splats of one node with the terms of its colours, and notes."""
    names = [name for name in element.names if name.startswith("f_dc_")]
    terms = len(names) // 3
    every = [f"f_dc_{k}" for k in range(3 * terms)]
    if not terms or sorted(names) != sorted(every):
        raise InputError(
            f"{path} has {len(names)} f_dc properties in {printable_name(element.name)}; they must "
            "be numbered and three for each term of a Fourier series; export the model again"
        )
    first = tuple(f"f_dc_{k * terms}" for k in range(3))  # the constant term of each channel
    splats, more, notes = read_element(path, element, first, every)
    return (splats, np.ascontiguousarray(more.reshape(-1, 3, terms).transpose(0, 2, 1))), notes


# --- tracks ---------------------------------------------------------------------------------------


def street_actors(model, folder, cameras=()):
    """Return the actors of a model whose tracks lie in a folder, and notes.

    Parameters
    ----------
    model : StreetModel
    folder : path-like
        The data that the model was trained on.
    cameras : sequence of Camera
        Of the model: the first frame in their names is that of time 0.

    Returns
    -------
    actors : tuple of Actor
    notes : list of str
    """
    folder = Path(folder)
    rows = _rows(folder / TRACKS)
    frames = [int(m[1]) for m in map(PICTURE.match, (c.name for c in cameras)) if m]
    begin, end = (min(frames), max(frames)) if frames else (0, max(r.frame for r in rows))
    times, poses = _times(folder / TIMES), _poses(folder / POSES)
    actors, notes, lost = [], [], []
    for number, (splats, terms) in sorted(model.nodes.items()):
        mine = sorted((r for r in rows if r.track == number and begin <= r.frame <= end),
                      key=lambda r: r.frame)  # fmt: skip
        if not mine:
            lost.append(str(number))
            continue
        actors.append(_actor(folder, number, mine, splats, terms, times, poses, begin))
    if lost:
        notes.append(f"nodes {', '.join(lost)} have no track in {folder / TRACKS}: left out")
    walkers = [a.id for a in actors if a.kind == "pedestrian"]
    if walkers:
        notes.append(f"pedestrians ({', '.join(walkers)}) move along their tracks as one piece")
    notes.append(
        f"{len(actors)} nodes with tracks; poses that the training corrected are in its checkpoint "
        "and not read"
    )
    return tuple(actors), notes


@dataclass(frozen=True)
class _Row:
    """One node in one frame: size [m], place [m] and heading [rad] in the vehicle's frame."""

    frame: int
    track: int
    kind: str
    size: tuple
    place: tuple
    heading: float


def _rows(path):
    lines = read_text(path, "a list of tracks", MOST_TRACKS).splitlines()[1:]
    rows = []
    for number, line in enumerate(lines, start=2):
        words = line.split()
        if not words:
            continue
        values = [_number(word) for word in words[3:COLUMNS]]
        whole = len(words) >= COLUMNS and words[0].isdecimal() and words[1].isdecimal()
        whole = whole and _number(words[2]) is None  # the class: nothing is missing before it
        if not whole or None in values or max(len(words[0]), len(words[1])) > 9:
            raise InputError(f"{path} line {number} is {shown(line)}; {REMEDY}")
        height, width, length, x, y, z, heading = values[1:]
        rows.append(_Row(int(words[0]), int(words[1]), printable_name(words[2]),
                         (length, width, height), (x, y, z), heading))  # fmt: skip
    if not rows:
        raise InputError(f"{path} has no tracks; {REMEDY}")
    return rows


def _number(word):
    try:
        value = json_number(float(word))
    except ValueError:
        return None
    return None if value is None or abs(value) > MAX_LENGTH else value


def _times(path):
    """Return the time [s] of each frame, a dict by its number."""
    data = read_json(path, "a list of times")
    found = data.get("FRAME") if isinstance(data, dict) else None
    times = {}
    for name, value in found.items() if isinstance(found, dict) else ():
        seconds = json_number(value)
        if seconds is None or not name.isdecimal() or len(name) > 9:
            raise InputError(f"{path}: FRAME has {shown(name)}: {shown(value)}; {REMEDY}")
        times[int(name)] = seconds
    if not times:
        raise InputError(f"{path} lacks FRAME, times by frame; {REMEDY}")
    return times


def _poses(folder):
    """Return world_from_vehicle of each frame, a dict of (4, 4) by its number; centred."""
    poses = {}
    for path in sorted(folder.glob("*.txt")) if folder.is_dir() else ():
        if not path.stem.isdecimal() or len(path.stem) > 9:
            continue  # of a camera, NNNNNN_C.txt
        values = [_number(word) for word in read_text(path, "a pose").split()]
        if len(values) != 16 or None in values:
            raise InputError(f"{path} holds no 4 x 4 numbers; {REMEDY}")
        pose = np.array(values).reshape(4, 4)
        if not is_rigid(pose):
            raise InputError(
                f"{path} is no pose; it must be a rotation, not mirrored or scaled, and a place; "
                f"{REMEDY}"
            )
        poses[int(path.stem)] = pose
    if not poses:
        raise InputError(f"{folder} has no poses NNNNNN.txt; {REMEDY}")
    middle = np.mean([pose[:3, 3] for pose in poses.values()], axis=0)
    for pose in poses.values():
        pose[:3, 3] -= middle
    return poses


def _actor(folder, number, rows, splats, terms, times, poses, begin):
    """Return the Actor of one node from its rows in rising order of frames."""
    frames = [row.frame for row in rows]
    for frame in (begin, *frames):
        if frame not in times or frame not in poses:
            raise InputError(f"{folder} has no time or no pose of frame {frame}; {REMEDY}")
    if len(set(frames)) < len(frames):
        raise InputError(f"{folder / TRACKS} has track {number} twice in one frame; {REMEDY}")
    time = np.array([times[frame] - times[begin] for frame in frames])
    if (np.diff(time) <= 0).any():
        raise InputError(f"{folder / TIMES}: times of frames must rise; {REMEDY}")
    place = np.array([poses[r.frame][:3, :3] @ r.place + poses[r.frame][:3, 3] for r in rows])
    turn = np.array([_quaternion(poses[r.frame][:3, :3] @ _about_z(r.heading)) for r in rows])
    series = None
    if terms.shape[1] > 1:
        series = ColorSeries(terms, float(time[0]), float(time[-1]))
    size = np.max([row.size for row in rows], axis=0)
    track = _seen_for_a_while(time, place, turn)
    return Actor(
        str(number), rows[0].kind, splats, np.stack([np.zeros(3), size]), track, series, False
    )


def _seen_for_a_while(time, place, turn):
    """Return the Track of a node that is there from a little before its first key to its last."""
    first, last = time[0] - BEYOND, time[-1] + BEYOND
    keys = np.concatenate([[first - BEYOND, first], time, [last]])
    seen = np.ones(len(keys), bool)
    seen[[0, -1]] = False

    def around(values):
        return np.concatenate([values[:1], values[:1], values, values[-1:]])

    return Track(keys, around(place), around(turn), seen)


def _about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _quaternion(matrix):
    return np.roll(Rotation.from_matrix(matrix).as_quat(), 1)


def in_order(cameras):
    """Return cameras sorted as a drive: camera by camera, each in the order of its frames."""
    places = [PICTURE.match(camera.name) for camera in cameras]
    if not all(places):
        return list(cameras)
    pairs = sorted(zip(((m[2], m[1]) for m in places), range(len(cameras)), strict=True))
    return [cameras[k] for _, k in pairs]
