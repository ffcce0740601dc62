"""Splats from binary glTF (.glb) with the extension KHR_gaussian_splatting, uncompressed.

glTF has y up. splat-transform, the one converter that was tried, turns a capture half about z when
it writes one. Splats are turned back, so that they fit the cameras of the capture they come from.
Names, types and formulas are those of the extension's specification (Khronos Group, 2026).
"""

import json
import mmap
import os
import struct
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.errors import InputError, shown
from rainsim.io.files import MAX_LENGTH, number_array
from rainsim.scene.activate import MAX_BROKEN_SHARE, activate, require_believable
from rainsim.scene.harmonics import turned
from rainsim.scene.splat_sets import joined

REMEDY = "it is damaged, export it again"
EXTENSION = "KHR_gaussian_splatting"
KNOWN = (EXTENSION, "KHR_mesh_quantization")
PREFIX = EXTENSION + ":"
HEADER, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
MOST_JSON = 1 << 26  # bytes; a capture in tiles has some thousands of nodes
MOST_NODES = 1 << 16
DEEPEST = 256  # nodes one in the other
COLORS = "srgb_rec709_display"
DEFAULTS = {"kernel": "ellipse", "projection": "perspective", "sortingMethod": "cameraDistance"}
TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
WIDEST_STRIDE = 252  # bytes, of the glTF specification
COEFFICIENTS = {1: 3, 2: 5, 3: 7}  # of each degree
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
SKEWED = 1e-3  # the determinant of a rotation may be so far from 1
UNEVEN = 1e-5  # relative difference of scales up to which they are one


@dataclass(frozen=True, slots=True)
class Model:
    """The JSON and the binary chunk of a file; values are taken out only after a check."""

    path: object
    data: dict
    binary: memoryview

    def wrong(self, what):
        """Return the InputError for a fault of the file."""
        return InputError(f"{self.path}: {what}; {REMEDY}")

    def item(self, kind, index):
        """Return object `index` of the list `kind`."""
        items = self.data.get(kind)
        good = isinstance(items, list) and isinstance(index, int) and not isinstance(index, bool)
        if not good or not 0 <= index < len(items) or not isinstance(items[index], dict):
            raise self.wrong(f"{kind} has no {shown(index)}")
        return items[index]

    def indices(self, holder, key):
        """Return the list of numbers `key` of an object, empty if there is none."""
        value = holder.get(key, [])
        if not isinstance(value, list):
            raise self.wrong(f"{key} is {shown(value)}; it must be a list")
        return value

    def whole(self, holder, key, default, most):
        """Return the whole number `key` of an object, from 0 to `most`."""
        value = holder.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
            raise self.wrong(f"{key} is {shown(value)}; it must be 0 to {most}")
        return value


def read_glb(path):
    """Return the Splats of a binary glTF, which are usable, and notes."""
    model = opened(path)
    required = model.indices(model.data, "extensionsRequired")
    foreign = [name for name in required if name not in KNOWN]
    if foreign:
        raise InputError(
            f"{path} requires {shown(foreign[0])}; of splats in glTF {EXTENSION} without "
            "compression is read; export it so, or as PLY, SPZ or SOG"
        )
    parts, others = [], 0
    for mesh, place in _instances(model):
        for primitive in model.indices(mesh, "primitives"):
            if _is_splats(primitive):
                parts.append((primitive, place))
            else:
                others += 1
    if not parts:
        raise InputError(
            f"{path} is a glTF without splats; a primitive must have {EXTENSION}; "
            "export the capture as splats"
        )
    # Each value takes a byte at least, unless attributes share bytes.
    total = sum(_count(model, primitive) * len(primitive["attributes"]) for primitive, _ in parts)
    require_believable(path, total, len(model.binary))
    notes = _notes(model, parts, others)
    logarithms = _has_logarithms(model, parts)
    if logarithms:
        notes.append(
            f"scales below 0 are logarithms, as in drafts of {EXTENSION} before April 2026"
        )
    read, good = zip(*(_read(model, *part, logarithms) for part in parts), strict=True)
    return joined(read), np.concatenate(good), notes


def opened(path):
    """Return the `Model` of a binary file."""
    data = mapped(path)
    if len(data) < HEADER.size + CHUNK.size:
        raise InputError(f"{path} ends within its header; {REMEDY}")
    _, version, length = HEADER.unpack_from(data)
    if version != 2:
        raise InputError(f"{path} is glTF of version {version}; it must be 2; export it again")
    if length > len(data):
        raise InputError(f"{path} ends after {len(data)} of {length} bytes; {REMEDY}")
    chunks, start = {}, HEADER.size
    while start + CHUNK.size <= length:
        size, kind = CHUNK.unpack_from(data, start)
        start += CHUNK.size
        if start + size > length:
            raise InputError(f"{path} ends within a chunk; {REMEDY}")
        chunks.setdefault(kind, data[start : start + size])
        start += size
    text = chunks.get(b"JSON", memoryview(b""))
    if not 0 < len(text) <= MOST_JSON:
        raise InputError(
            f"{path} has {len(text)} bytes of JSON; 1 to {MOST_JSON} are read; {REMEDY}"
        )
    try:
        tree = json.loads(bytes(text).decode("utf-8"))
    except (ValueError, RecursionError):
        raise InputError(f"{path} has JSON that cannot be read; {REMEDY}") from None
    if not isinstance(tree, dict):
        raise InputError(f"{path} has JSON that is no object; {REMEDY}")
    return Model(path, tree, chunks.get(b"BIN\0", memoryview(b"")))


def mapped(path):
    """Return the bytes of a file as a memoryview; a page is read when it is looked at."""
    with open(path, "rb") as file:
        if not os.fstat(file.fileno()).st_size:
            return memoryview(b"")
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


# --- nodes ----------------------------------------------------------------------------------------


def _instances(model):
    """Return each mesh of the shown scene with the matrix (4, 4) that places it."""
    if not model.data.get("nodes"):
        count = len(model.indices(model.data, "meshes"))
        return [(model.item("meshes", number), np.eye(4)) for number in range(count)]
    found = []
    for chain in node_chains(model):
        nodes = [model.item("nodes", number) for number in chain]
        if "mesh" in nodes[-1]:
            found.append((model.item("meshes", nodes[-1]["mesh"]), place_of(model, nodes)))
    return found


def place_of(model, nodes):
    """Return the matrix (4, 4) of the last of some nodes, each the parent of the next."""
    place = np.eye(4)
    for node in nodes:
        place = place @ node_matrix(model, node)
    return place


def node_chains(model):
    """Return of each node of the shown scene the numbers from the root's down to its own."""
    nodes = model.data.get("nodes", [])
    if not isinstance(nodes, list) or len(nodes) > MOST_NODES:
        raise model.wrong(f"nodes must be a list of at most {MOST_NODES}")
    if model.data.get("scenes"):
        roots = model.indices(model.item("scenes", model.data.get("scene", 0)), "nodes")
    else:
        children = (model.indices(model.item("nodes", n), "children") for n in range(len(nodes)))
        below = {child for some in children for child in some if isinstance(child, int)}
        roots = [n for n in range(len(nodes)) if n not in below]
    found, seen, waiting = [], set(), [(root, ()) for root in reversed(roots)]
    while waiting:
        number, above = waiting.pop()
        node, chain = model.item("nodes", number), (*above, number)
        if number in seen:
            raise model.wrong(f"node {number} is reached twice; nodes must be a tree")
        if len(chain) > DEEPEST:
            raise model.wrong(f"nodes stand in one another more than {DEEPEST} deep")
        seen.add(number)
        found.append(chain)
        children = model.indices(node, "children")
        waiting += [(child, chain) for child in reversed(children)]
    return found


def node_matrix(model, node):
    """Return the matrix (4, 4) of a node: its own, or of its translation, rotation and scale."""

    def numbers(key, default):
        value = number_array(node.get(key, default), (len(default),))
        if value is None:
            raise model.wrong(
                f"{key} of a node is {shown(node[key])}; it must be {len(default)} numbers"
            )
        return value

    if "matrix" in node:
        return numbers("matrix", [0.0] * 16).reshape(4, 4).T  # glTF stores columns
    turn = numbers("rotation", [0.0, 0.0, 0.0, 1.0])
    if not np.linalg.norm(turn) > 0:
        raise model.wrong("rotation of a node is zero")
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(turn).as_matrix() * numbers("scale", [1.0] * 3)
    matrix[:3, 3] = numbers("translation", [0.0] * 3)
    return matrix


# --- splats ---------------------------------------------------------------------------------------


def _is_splats(primitive):
    extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
    return isinstance(extensions, dict) and isinstance(extensions.get(EXTENSION), dict)


def _notes(model, parts, others):
    """Return notes on parts drawn otherwise or left out; raise InputError for features not read."""
    notes = []
    for about in (primitive["extensions"][EXTENSION] for primitive, _ in parts):
        if about.get("extensions"):
            raise InputError(
                f"{model.path} has splats by {shown(about['extensions'])}; {EXTENSION} without "
                "further extensions is read; export it without compression, or as PLY, SPZ or SOG"
            )
        if about.get("colorSpace", COLORS) != COLORS:
            raise InputError(
                f"{model.path} has the colour space {shown(about['colorSpace'])}; it must be "
                f"{COLORS}, in which captures are blended; export it so"
            )
        for key, usual in DEFAULTS.items():
            if about.get(key, usual) != usual:
                notes.append(f"glTF asks for {key} {shown(about[key])}; drawn as {usual}")
    if others:
        notes.append(f"{others} glTF primitives without splats are left out")
    return list(dict.fromkeys(notes))


def _count(model, primitive):
    """Return how many splats a primitive has."""
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict) or "POSITION" not in attributes:
        raise model.wrong("a primitive of splats lacks POSITION")
    accessor = model.item("accessors", attributes["POSITION"])
    return model.whole(accessor, "count", None, 1 << 31)


def _has_logarithms(model, parts):
    """Tell whether the scales of a file are logarithms: scales themselves are never below 0."""
    below = count = 0
    for primitive, _ in parts:
        index = primitive["attributes"].get(PREFIX + "SCALE")
        if index is not None:
            scales = values_of(model, index, _count(model, primitive), 3)
            below, count = below + np.count_nonzero((scales < 0).any(axis=1)), count + len(scales)
    return below > MAX_BROKEN_SHARE * count


def _read(model, primitive, place, logarithms):
    """Return the Splats of a primitive, turned into the capture's frame, and which are usable."""
    count, attributes = _count(model, primitive), primitive["attributes"]

    def values(name, width):
        if name not in attributes:
            raise model.wrong(f"a primitive of splats lacks {name}")
        return values_of(model, attributes[name], count, width)

    matrix = HALF_TURN @ place[:3, :3]
    rotation, scales = decomposed(matrix, model.wrong)
    harmonics = [values(PREFIX + "SH_DEGREE_0_COEF_0", 3)]
    for degree, number in COEFFICIENTS.items():
        names = [f"{PREFIX}SH_DEGREE_{degree}_COEF_{k}" for k in range(number)]
        if not any(name in attributes for name in names):
            break
        harmonics += [values(name, 3) for name in names]
    sh = turned(np.stack(harmonics, axis=1), rotation)
    with np.errstate(all="ignore"):  # what is not usable is counted afterwards
        position = values("POSITION", 3) @ matrix.T + HALF_TURN @ place[:3, 3]
        turn = np.roll(values(PREFIX + "ROTATION", 4), 1, axis=1)  # w first
        scale = values(PREFIX + "SCALE", 3)
        turn, scale = placed(turn, np.exp(scale) if logarithms else scale, rotation, scales)
        opacity = values(PREFIX + "OPACITY", 1)[:, 0].astype(np.float64)
        logit = np.log(opacity) - np.log1p(-opacity)
        return activate(
            position.astype(np.float32), np.log(scale), turn, logit, sh[:, 0],
            sh[:, 1:] if sh.shape[1] > 1 else None,
        )  # fmt: skip


def decomposed(matrix, wrong):
    """Return the rotation and scales whose product a matrix (3, 3) is, or raise `wrong(text)`."""
    scales = np.linalg.norm(matrix, axis=0)
    if not (np.isfinite(scales) & (scales > 0) & (scales < MAX_LENGTH)).all():
        raise wrong(f"a node scales by {shown(scales.tolist())}")
    rotation = matrix / scales
    if abs(np.linalg.det(rotation) - 1) > SKEWED:
        raise wrong("a node mirrors or shears; it must turn, move and scale")
    return rotation, scales


def placed(turn, scale, rotation, scales):
    """Return the quaternions and scales of splats that a node turns and scales.

    Where the node's scales differ the axes of a splat's ellipsoid are no longer what its own were:
    they are the left singular vectors of the product, its scales the singular values.
    """
    lengths = np.linalg.norm(turn, axis=1)
    own = np.isfinite(lengths) & (lengths > 0) & np.isfinite(scale).all(axis=1)
    turn = turn.astype(np.float64)
    scale = scale.astype(np.float64)
    matrices = Rotation.from_quat(np.roll(turn[own], -1, axis=1)).as_matrix()
    if np.ptp(scales) <= UNEVEN * scales.max():
        scale = scale * scales.mean()
        matrices = rotation @ matrices
    else:
        left, sizes, _ = np.linalg.svd((rotation * scales) @ matrices * scale[own, None, :])
        matrices = left * np.sign(np.linalg.det(left))[:, None, None]
        scale[own] = sizes
    turn[own] = np.roll(Rotation.from_matrix(matrices).as_quat(), 1, axis=1)
    return turn, scale


# --- accessors ------------------------------------------------------------------------------------


def values_of(model, index, count, width):
    """Return the values of an accessor as (count, width) float32; whole numbers as it says."""
    accessor = model.item("accessors", index)
    if "sparse" in accessor or "bufferView" not in accessor:
        raise model.wrong("sparse accessors, and those without a bufferView, are not read")
    kind, wide = accessor.get("componentType"), accessor.get("type")
    if not (isinstance(kind, int) and kind in TYPES):
        raise model.wrong(f"an accessor has the componentType {shown(kind)}")
    if not isinstance(wide, str) or WIDTHS.get(wide) != width:
        raise model.wrong(f"an accessor is {shown(wide)}; its values must have {width} parts")
    if model.whole(accessor, "count", None, 1 << 31) != count:
        raise model.wrong(f"an accessor has {accessor['count']} values; there must be {count}")
    view = model.item("bufferViews", accessor["bufferView"])
    if view.get("buffer") != 0 or "uri" in model.item("buffers", 0):
        raise model.wrong("data lies in another file; it must lie in the binary chunk")
    size, end = np.dtype(TYPES[kind]).itemsize * width, len(model.binary)
    start = model.whole(view, "byteOffset", 0, end) + model.whole(accessor, "byteOffset", 0, end)
    stride = model.whole(view, "byteStride", size, WIDEST_STRIDE)
    if stride < size or start + stride * (count - 1) + size > end:
        raise model.wrong(f"an accessor of {count} values ends behind the file's {end} bytes")
    stored = np.ndarray(
        (count, width), TYPES[kind], model.binary, start, (stride, size // width)
    )  # fmt: skip
    values = stored.astype(np.float32)
    if accessor.get("normalized") is True and stored.dtype.kind != "f":
        values /= np.iinfo(stored.dtype).max
        np.maximum(values, -1, out=values)
    return values
