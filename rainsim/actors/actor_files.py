"""Actors as files: `actors.json`, which lists the moving parts of a scene, and actors as arrays.

docs/actors.md describes `actors.json`. A scene folder holds its actors as `actors.npz`: the splats
of all actors one after the other, the keys of all tracks one after the other, and how many of them
belong to each actor.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rainsim.actors.actor import MOST_LABEL, NO_LABEL, Actor, ColorSeries, box_of
from rainsim.actors.motion import Track
from rainsim.actors.wheels import MOST_WHEELS, NO_WHEELS
from rainsim.errors import InputError, ParameterError, shown
from rainsim.io.arrays import TEXT, Field, read_arrays, write_arrays
from rainsim.io.files import number_array, path_named, printable_name, read_json
from rainsim.scene.formats import read_splats
from rainsim.scene.harmonics import padded
from rainsim.scene.lamps import LUMINANCE, Lamp, with_lamps
from rainsim.scene.types import Splats

ACTORS_FILE, ACTORS_ARRAYS = "actors.json", "actors.npz"
VERSION = 1
REMEDY = "docs/actors.md describes the file; correct it"
MOST_ACTORS = 4096
MOST_LAMPS = 4096
MOST_PATH, MOST_PART = 1000, 250  # bytes of a path and of a name in it; longer ones no system opens
FLOAT = float(np.finfo(np.float32).max)
LONGEST = 1e9  # s
SPLATS = ("position", "rotation", "scale", "opacity", "sh")
KEYS = ("time", "position", "rotation", "visible")  # of a track
_FIELDS = {
    "position": Field("float32", ("splats", 3)),
    "rotation": Field("float32", ("splats", 4), -2, 2),
    "scale": Field("float32", ("splats", 3), 0),
    "opacity": Field("float32", ("splats",), 0, 1),
    "sh": Field("float32", ("splats", "coefficients", 3), -FLOAT, FLOAT),
    "id": Field(TEXT, ("actors",)),
    "kind": Field(TEXT, ("actors",)),
    "box": Field("float64", ("actors", 2, 3)),
    "splat_count": Field("int64", ("actors",), 1, 1 << 40),
    "key_count": Field("int64", ("actors",), 1, 1 << 40),
    "term_count": Field("int64", ("actors",), 0, 1 << 16),
    "span": Field("float64", ("actors", 2), -LONGEST, LONGEST),
    "key_time": Field("float64", ("keys",), -LONGEST, LONGEST),
    "key_position": Field("float64", ("keys", 3)),
    "key_rotation": Field("float64", ("keys", 4), -2, 2),
    "key_visible": Field("bool", ("keys",)),
    "terms": Field("float32", ("terms", 3), -FLOAT, FLOAT),
    "turning": Field("bool", ("actors",)),
    "wheel": Field("float64", ("wheels", 5), needed=False),
    "wheel_count": Field("int64", ("actors",), -1, MOST_WHEELS, needed=False),
    "label": Field("int64", ("actors",), 0, MOST_LABEL, needed=False),
}


@dataclass(frozen=True)
class ActorsFile:
    """The content of an `actors.json`; `files` are all that were read, its splats' too."""

    static: Path
    actors: tuple
    files: tuple
    notes: tuple
    lamps: tuple = ()


def actors_file(path):
    """Return the `actors.json` that a path names, itself or in a folder; None if it does not."""
    path = Path(path)
    if path.is_dir():
        path = path / ACTORS_FILE
    return path if path.name == ACTORS_FILE and path.is_file() else None


def read_actors(path):
    """Read an `actors.json` by the rules of docs/actors.md, or raise InputError."""
    path = Path(path)
    data = read_json(path, "a description of actors")
    if not isinstance(data, dict) or data.get("rainsim_actors") != VERSION:
        raise InputError(f"{path} lacks rainsim_actors: {VERSION}; it must have it; {REMEDY}")
    static = path.parent / _name(path, "scene", data.get("scene"))
    entries = data.get("nodes")
    if not isinstance(entries, list) or not 0 < len(entries) <= MOST_ACTORS:
        raise InputError(f"{path}: nodes must be a list of 1 to {MOST_ACTORS} actors; {REMEDY}")
    if static.resolve() == path.resolve() or actors_file(static) is not None:
        raise InputError(f"{path}: scene must name a static set, not actors again; {REMEDY}")
    actors, files, notes, read = [], [path], [], {}
    for number, entry in enumerate(entries):
        where = f"{path}, actor {number}"
        if not isinstance(entry, dict):
            raise InputError(f"{where} is {shown(entry)}; it must be an object; {REMEDY}")
        file = path_named(_name(where, "splats", entry.get("splats")), path.parent)
        if file not in read:
            read[file] = read_splats(file)
            files.append(file)
            notes += [f"{file.name}: {note}" for note in read[file][1]]
        splats, lamps = read[file][0], _lamps(where, entry.get("lamps", []))
        if lamps:
            splats, counts = with_lamps(splats, lamps)
            notes += lamp_notes(where, counts)
        actors.append(_actor(where, entry, splats))
    lamps = _lamps(str(path), data.get("lamps", []))
    return ActorsFile(static, tuple(actors), tuple(files), tuple(notes), lamps)


def lamp_notes(where, counts):
    """Return notes on lamps, by how many splats each has."""
    dark = counts.count(0)
    return [f"{where}: {len(counts)} lamps of {sum(counts)} splats shine"
            + (f"; {dark} have no splat that is bright enough" if dark else "")]  # fmt: skip


def _lamps(where, data):
    """Return the lamps that a list describes, a tuple of Lamp."""
    lamps = []
    for entry in data if isinstance(data, list) and len(data) <= MOST_LAMPS else (None,):
        row = None
        if isinstance(entry, dict) and isinstance(entry.get("at"), list):
            row = number_array([*entry["at"], entry.get("radius")], (4,))
        kind = entry.get("class") if isinstance(entry, dict) else None
        if row is None or row[3] <= 0 or not isinstance(kind, str) or kind not in LUMINANCE:
            raise InputError(
                f"{where}: lamps has {shown(entry if entry is not None else data)}; it must be a "
                f"list of at most {MOST_LAMPS} objects with class ({', '.join(LUMINANCE)}), at "
                f"(three numbers) and radius above 0; {REMEDY}"
            )
        lamps.append(Lamp(entry["class"], row[:3], float(row[3])))
    return tuple(lamps)


def _name(where, key, value):
    name = value.encode() if isinstance(value, str) and value.isprintable() else b""
    if not 0 < len(name) <= MOST_PATH or max(map(len, name.split(b"/"))) > MOST_PART:
        raise InputError(f"{where}: {key} is {shown(value)}; it must be a path; {REMEDY}")
    return value


def _actor(where, entry, splats):
    """Return the Actor of an entry of `nodes` in an `actors.json`."""
    name, kind = entry.get("id"), entry.get("class", "object")
    if not isinstance(name, str | int) or isinstance(name, bool) or not str(name):
        raise InputError(f"{where}: id is {shown(name)}; it must be a text or number; {REMEDY}")
    if not isinstance(kind, str):
        raise InputError(f"{where}: class is {shown(kind)}; it must be a text; {REMEDY}")
    track = entry.get("track")
    if not isinstance(track, dict):
        raise InputError(f"{where}: track is {shown(track)}; it must be an object; {REMEDY}")
    times = track.get("times")
    count = len(times) if isinstance(times, list) else 0
    arrays = {
        "times": number_array(times, (count,)),
        "positions": number_array(track.get("positions"), (count, 3)),
        "rotations": number_array(track.get("rotations"), (count, 4)),
    }
    for key, array in arrays.items():
        if count == 0 or array is None:
            raise InputError(
                f"{where}: {key} of its track are not what they must be: as many as times, rows of "
                f"1 (times), 3 (positions) or 4 (rotations) finite numbers; {REMEDY}"
            )
    visible = track.get("visible", [True] * count)
    if not isinstance(visible, list) or len(visible) != count or (
        not all(isinstance(v, bool) for v in visible)
    ):  # fmt: skip
        raise InputError(f"{where}: visible must be {count} of true or false; {REMEDY}")
    harmonics = entry.get("harmonics", "node")
    if harmonics not in ("node", "scene"):
        raise InputError(
            f"{where}: harmonics is {shown(harmonics)}; it must be node or scene; {REMEDY}"
        )
    box = box_of(splats) if entry.get("box") is None else _box(where, entry["box"])
    try:
        way = Track(arrays["times"], arrays["positions"], arrays["rotations"], np.array(visible))
    except ParameterError as error:
        raise InputError(f"{where}: {error}; {REMEDY}") from None
    wheels = None if entry.get("wheels") is None else _wheels(where, entry["wheels"])
    label = entry.get("label", NO_LABEL)
    if not isinstance(label, int) or isinstance(label, bool) or not 0 <= label <= MOST_LABEL:
        raise InputError(
            f"{where}: label is {shown(label)}; it must be a whole number from 0 to {MOST_LABEL}; "
            f"{REMEDY}"
        )
    return Actor(
        printable_name(name), printable_name(kind), splats, box, way,
        turning=harmonics == "node", wheels=wheels, label=label,
    )  # fmt: skip


def _box(where, data):
    box = None
    if isinstance(data, dict):
        box = number_array([data.get("centre"), data.get("size")], (2, 3))
    if box is None or (box[1] <= 0).any():
        raise InputError(
            f"{where}: box is {shown(data)}; it must have centre and size, three numbers each, the "
            f"size above 0; {REMEDY}"
        )
    return box


def _wheels(where, data):
    """Return the wheels of an actor as `Actor` has them."""
    rows = None
    if isinstance(data, list) and len(data) <= MOST_WHEELS:
        rows = [
            [*wheel["at"], wheel["width"], wheel["radius"]]
            if isinstance(wheel, dict) and isinstance(wheel.get("at"), list)
            and {"width", "radius"} <= set(wheel) else None
            for wheel in data
        ]  # fmt: skip
        rows = number_array(rows, (len(data), 5)) if rows else NO_WHEELS
    if rows is None or (rows[:, 3:] <= 0).any() or (rows[:, 3] > 4 * rows[:, 4]).any():
        raise InputError(
            f"{where}: wheels is {shown(data)}; it must be a list of at most {MOST_WHEELS} objects "
            "with at (three numbers), width and radius, both above 0, the width at most four "
            f"times the radius; {REMEDY}"
        )
    return rows


# --- actors as arrays -----------------------------------------------------------------------------


def actors_to_arrays(actors):
    """Return actors as arrays by name, as `actors_from_arrays` takes them."""
    splats = [actor.splats for actor in actors]
    most = max(part.sh.shape[1] for part in splats)
    terms = [np.zeros((0, 0, 3)) if a.series is None else a.series.terms for a in actors]
    spans = [(0, 0) if a.series is None else (a.series.begin, a.series.end) for a in actors]
    arrays = {
        name: np.concatenate([getattr(part, name) for part in splats]) for name in SPLATS[:-1]
    }
    arrays["sh"] = np.concatenate([padded(part.sh, most) for part in splats])
    arrays |= {
        "key_" + name: np.concatenate([getattr(a.track, name) for a in actors]) for name in KEYS
    }
    return arrays | {
        "id": np.array([a.id for a in actors]), "kind": np.array([a.kind for a in actors]),
        "box": np.stack([a.box for a in actors]), "turning": np.array([a.turning for a in actors]),
        "splat_count": np.array([len(part) for part in splats]),
        "key_count": np.array([len(a.track.time) for a in actors]),
        "term_count": np.array([t.shape[1] for t in terms]),
        "span": np.array(spans, np.float64),
        "terms": np.concatenate([t.reshape(-1, 3) for t in terms]).astype(np.float32),
        "wheel": np.concatenate([NO_WHEELS if a.wheels is None else a.wheels for a in actors]),
        "wheel_count": np.array([-1 if a.wheels is None else len(a.wheels) for a in actors]),
        "label": np.array([a.label for a in actors]),
    }  # fmt: skip


def actors_from_arrays(arrays):
    """Return the actors that `actors_to_arrays` gave, or raise ParameterError."""
    counts = arrays["splat_count"], arrays["key_count"]
    terms = arrays["splat_count"] * arrays["term_count"]
    ends = [np.cumsum(n) for n in (*counts, terms)]
    for end, name in zip(ends, ("position", "key_time", "terms"), strict=True):
        if end[-1] != len(arrays[name]):
            raise ParameterError(f"the counts of {name} do not add up; write the actors again")
    wheel_count = arrays.get("wheel_count", np.full(len(arrays["id"]), -1))
    wheels, last = arrays.get("wheel", NO_WHEELS), np.cumsum(np.maximum(wheel_count, 0))
    if last[-1] != len(wheels):
        raise ParameterError("the counts of wheels do not add up; write the actors again")
    label = arrays.get("label", np.full(len(arrays["id"]), NO_LABEL)).tolist()
    actors = []
    for k in range(len(counts[0])):
        own, key, term = (
            slice(end[k] - n[k], end[k]) for end, n in zip(ends, (*counts, terms), strict=True)
        )
        splats = Splats(*(np.ascontiguousarray(arrays[name][own]) for name in SPLATS))
        track = Track(*(arrays["key_" + name][key] for name in KEYS))
        series = None
        if arrays["term_count"][k]:
            shape = int(counts[0][k]), int(arrays["term_count"][k]), 3
            series = ColorSeries(arrays["terms"][term].reshape(shape), *arrays["span"][k].tolist())
        name, kind = str(arrays["id"][k]), str(arrays["kind"][k])
        turning = bool(arrays["turning"][k])
        own = None if wheel_count[k] < 0 else wheels[last[k] - wheel_count[k] : last[k]]
        actors.append(
            Actor(name, kind, splats, arrays["box"][k], track, series, turning, own, label[k])
        )
    return tuple(actors)


def write_actor_arrays(path, actors):
    """Write actors as an .npz file of a scene folder."""
    write_arrays(path, VERSION, actors_to_arrays(actors))


def read_actor_arrays(path):
    """Return the actors of an .npz file that `write_actor_arrays` wrote, all of it checked."""
    arrays = read_arrays(path, "set of actors", _FIELDS, VERSION, "import the scene again")
    turn = np.einsum("ni,ni->n", arrays["rotation"], arrays["rotation"])
    if len(arrays["id"]) == 0 or len(turn) == 0 or np.abs(turn - 1).max() > 1e-2:
        raise InputError(f"{path} has no actors or rotations that are no unit quaternions; "
                         "import the scene again")  # fmt: skip
    try:
        actors = actors_from_arrays(arrays)
    except ParameterError as error:
        raise InputError(f"{path}: {error}; import the scene again") from None
    return tuple(replace(a, id=printable_name(a.id), kind=printable_name(a.kind)) for a in actors)
