"""Cameras of glTF files, with what moves them and their parents.

glTF has seconds and no frames, one lens for a whole animation, and no shift of it.
"""

import base64
import binascii
import json
import math
from urllib.parse import unquote

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from rainsim.errors import InputError, shown
from rainsim.io.files import json_number, read_json, require_file
from rainsim.scene.formats.gltf import Model, mapped, node_chains, opened, place_of, values_of
from rainsim.scene.shot_camera import SHAPE, Lens, World, camera_at, frame_times, require_chosen

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
COPY = "copy it there, or export a .glb"
MOST_KEYS = 1 << 20  # of all that moves a camera; an hour at 60 frames a second has 216,000
MAGIC = b"glTF"


def read_gltf(path, name=None, fps=24.0):
    """Return the cameras of a file's frames, in its own axes and units, and its `World`."""
    model = _opened(path)
    found = {}
    for chain in node_chains(model):
        node = model.item("nodes", chain[-1])
        if "camera" in node:
            label = "/".join(_name(model, number) for number in chain)
            found.setdefault(label, (chain, model.item("cameras", node["camera"])))
    label = list(found)[require_chosen(list(found), name, path)]
    chain, about = found[label]
    lens = _lens(model, about)
    moved, times = _moved(model, chain), np.zeros(1)
    spans = [keys for tracks in moved.values() for keys, _, _ in tracks.values()]
    if spans:
        begin, end = (ends(keys[k] for keys in spans) for ends, k in ((min, 0), (max, -1)))
        times = frame_times(begin, end, 1 / fps, path)
    cameras = []
    for time in times:
        nodes = []
        for number in chain:
            node = model.item("nodes", number)
            tracks = moved.get(number, {})
            nodes.append(node | {key: _at(track, key, time) for key, track in tracks.items()})
        place = place_of(model, nodes)
        cameras.append(camera_at(path, f"{label} at {time:g} s", place, lens))
    return cameras, World("Y", 1.0, None, float(round(times[0] * fps)))


def _opened(path):
    """Return the `Model` of a glTF file of either kind, its data in `binary`."""
    require_file(path, "a glTF file")
    with path.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            return opened(path)
    tree = read_json(path, "a glTF file")
    model = Model(path, tree if isinstance(tree, dict) else {}, memoryview(b""))
    if not isinstance(model.data.get("asset"), dict):
        raise model.wrong("it has no `asset` and is no glTF")
    if not model.data.get("buffers"):
        return model
    buffer = model.item("buffers", 0)
    uri = buffer.pop("uri", None)
    if not isinstance(uri, str):
        raise model.wrong("its buffer has no uri")
    if not uri.startswith("data:"):
        return Model(path, model.data, _beside(path, unquote(uri)))
    try:
        data = base64.b64decode(uri.partition(",")[2], validate=True)
    except (ValueError, binascii.Error):
        raise model.wrong(f"its data {shown(uri[:80])} are no base64") from None
    return Model(path, model.data, memoryview(data))


def _beside(path, name):
    """Return the bytes of a file that a glTF names; it must lie in its folder or below that.

    A capture comes from a stranger, and a name may lead to any file of the machine.
    """
    try:
        file = path.parent / name
        if file.resolve().is_relative_to(path.parent.resolve()):
            return mapped(require_file(file, "the data of a glTF", COPY))
    except (OSError, ValueError):  # ValueError: a zero byte
        pass
    raise InputError(
        f"{path}: its data {shown(name[:80])} cannot be read; the file must lie beside it or in a "
        f"folder below; {COPY}"
    )


def _name(model, number):
    name = model.item("nodes", number).get("name")
    return name if isinstance(name, str) and name else f"node{number}"


def _lens(model, about):
    if about.get("type") != "perspective" or not isinstance(about.get("perspective"), dict):
        raise model.wrong(f"a camera is {shown(about.get('type'))}; it must be perspective")
    angle = json_number(about["perspective"].get("yfov"))
    shape = json_number(about["perspective"].get("aspectRatio", SHAPE))
    if angle is None or shape is None or not (0 < angle < math.pi and shape > 0):
        raise model.wrong(
            f"yfov and aspectRatio of a camera are {json.dumps(about['perspective'])}; the angle "
            "must be above 0 and below pi, the ratio above 0"
        )
    return Lens(0.5 / math.tan(angle / 2) / shape, 0.0, 0.0, shape)


def _moved(model, chain):
    """Return of each node of a chain that moves its tracks: times [s], values, interpolation."""
    found = {}
    for animation in model.indices(model.data, "animations"):
        if not isinstance(animation, dict):
            raise model.wrong("an animation is no object")
        samplers = model.indices(animation, "samplers")
        inside = Model(model.path, {"samplers": samplers}, model.binary)
        for channel in model.indices(animation, "channels"):
            target = channel.get("target") if isinstance(channel, dict) else None
            key = target.get("path") if isinstance(target, dict) else None
            if not isinstance(key, str) or key not in WIDTHS or target.get("node") not in chain:
                continue
            if key in found.get(target["node"], {}):
                continue
            track = _track(model, inside.item("samplers", channel.get("sampler")), WIDTHS[key])
            found.setdefault(target["node"], {})[key] = track
    return found


def _track(model, sampler, width):
    kind = sampler.get("interpolation", "LINEAR")
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise model.wrong(f"an animation has the interpolation {shown(kind)}")
    accessor = model.item("accessors", sampler.get("input"))
    count = model.whole(accessor, "count", None, MOST_KEYS)
    times = values_of(model, sampler.get("input"), count, 1)[:, 0].astype(np.float64)
    if not count or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise model.wrong("times of an animation must rise")
    parts = 3 if kind == "CUBICSPLINE" else 1
    values = values_of(model, sampler.get("output"), count * parts, width).astype(np.float64)
    if not np.isfinite(values).all():
        raise model.wrong("values of an animation must be finite")
    return times, values.reshape(count, parts, width), kind


def _at(track, key, time):
    """Return the value of a track at a time [s], a list."""
    times, values, kind = track
    after = int(np.clip(np.searchsorted(times, time, side="right"), 1, max(len(times) - 1, 1)))
    k, n = after - 1, min(after, len(times) - 1)
    middle = values[:, values.shape[1] // 2]  # of a cubic spline between its tangents
    span = times[n] - times[k]
    s = float(np.clip((time - times[k]) / span, 0, 1)) if span > 0 else 0.0
    if kind == "STEP":
        found = middle[n] if s >= 1 else middle[k]
    elif kind == "CUBICSPLINE":
        out, into = span * values[k, 2], span * values[n, 0]
        found = (
            (2 * s**3 - 3 * s**2 + 1) * middle[k] + (s**3 - 2 * s**2 + s) * out
            + (3 * s**2 - 2 * s**3) * middle[n] + (s**3 - s**2) * into
        )  # fmt: skip
    elif key == "rotation" and k != n and np.linalg.norm(middle[[k, n]], axis=1).all():
        found = Slerp([0.0, 1.0], Rotation.from_quat(middle[[k, n]]))(s).as_quat()
    else:
        found = (1 - s) * middle[k] + s * middle[n]
    return found.tolist()
