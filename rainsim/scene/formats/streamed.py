"""Streamed SOG: a capture in chunks at several levels of detail, and the index of them.

The layout is version 1 of PlayCanvas' format (developer.playcanvas.com, The Streamed SOG Format).
`lod-meta.json` names the chunks, each an unbundled SOG of one level, and holds a binary tree of
boxes. A leaf of the tree has for each level a run of splats in one chunk. All levels of a leaf show
the same part of the scene; level 0 is the finest.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from rainsim.errors import InputError, shown
from rainsim.io.files import number_array, require_file
from rainsim.scene.formats.sog import META, read_rows

LOD_META = "lod-meta.json"
VERSION = 1
MOST_BYTES = 1 << 28  # of the index: a leaf takes some 500
MOST_LEVELS = 32
MOST_LEAVES = 1 << 21
NONE = -1  # in `ChunkTree.file`: the leaf has no splats at that level
SIDES = "rainsim_merged_to"  # our own key: the side of the cells that each level was merged to
REMEDY = "it is damaged, or no Streamed SOG; export it again"


@dataclass(frozen=True)
class ChunkTree:
    """The index of a Streamed SOG, its leaves one after the other.

    folder : Path. That the names of chunks are seen from.
    names : tuple of str. The meta.json of each chunk.
    environment : str or None. That of the splats that are always drawn.
    box : float32 array (leaves, 6) [capture units]. Lowest and highest x, y, z
        that any splat of the leaf reaches.
    file, offset, count : int64 array (leaves, levels). Chunk of each level of a
        leaf, NONE where it has none; first splat in it; splats.
    side : float32 array (leaves, levels) [capture units]. How coarse each level
        is, rising: splats smaller than it are merged. Written by `rainsim import
        --lod`, else judged from counts, see `_judged_sides`.
    """

    folder: Path
    names: tuple
    environment: str | None
    box: np.ndarray
    file: np.ndarray
    offset: np.ndarray
    count: np.ndarray
    side: np.ndarray

    @property
    def levels(self):
        """Number of levels."""
        return self.file.shape[1]

    def fingerprint(self):
        """Return a SHA-256 of the index, all meta.json and the sizes of all pictures.

        The codebooks and ranges in a chunk's meta.json follow from its splats, so that other splats
        have another fingerprint, without gigabytes of pictures being read.
        """
        digest = hashlib.sha256((self.folder / LOD_META).read_bytes())
        for name in (*self.names, *filter(None, (self.environment,))):
            meta = require_file(self.folder / name, "a chunk of a Streamed SOG")
            digest.update(meta.read_bytes())
            for picture in sorted(meta.parent.glob("*.webp")):
                digest.update(f"{picture.name} {picture.stat().st_size}".encode())
        return digest.hexdigest()


def read_tree(path):
    """Return the `ChunkTree` of a lod-meta.json, all of it checked; its files are in its folder."""
    path = require_file(Path(path), "the index of a Streamed SOG")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path} is too large for the index of a Streamed SOG; check the path")
    try:
        data = json.loads(path.read_bytes().decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not valid JSON; {REMEDY}") from None
    if not isinstance(data, dict) or not isinstance(data.get("tree"), dict):
        raise InputError(f"{path} has no tree of chunks; {REMEDY}")
    version = data.get("version", VERSION)  # files from before versions had none
    if version != VERSION:
        raise InputError(
            f"{path} has version {shown(version)}; it must be {VERSION}; export it with a tool "
            "that writes that version"
        )
    names = data.get("filenames")
    if not isinstance(names, list) or not names:
        raise InputError(f"{path}: filenames is {shown(names)}; it must list chunks; {REMEDY}")
    names = tuple(_inside(path, name) for name in names)
    environment = data.get("environment")
    if environment is not None:
        environment = _inside(path, environment)
    levels = data.get("lodLevels")
    if type(levels) is not int or not 1 <= levels <= MOST_LEVELS:
        raise InputError(
            f"{path}: lodLevels is {shown(levels)}; it must be a whole number from 1 to "
            f"{MOST_LEVELS}; {REMEDY}"
        )
    box, runs = _leaves(path, data["tree"], levels, len(names))
    file, offset, count = runs.transpose(2, 0, 1)
    side = _sides(path, data.get(SIDES), box, count)
    return ChunkTree(path.parent, names, environment, box, file, offset, count, side)


def _inside(path, name):
    """Return the name of a chunk's meta.json, refused unless it lies in the index's folder."""
    good = isinstance(name, str) and name.isprintable() and not set(name) & set("\\:")
    parts = PurePosixPath(name).parts if good else ()
    if not parts or parts[0] == "/" or ".." in parts or parts[-1] != META:
        raise InputError(
            f"{path} names the chunk {shown(name)}; it must be a {META} in a folder beside the "
            f"index; {REMEDY}"
        )
    return name


def _leaves(path, tree, levels, files):
    """Return the boxes of all leaves and their runs (leaves, levels, 3), depth first."""
    boxes, runs, ahead, seen = [], [], [tree], 0
    while ahead:
        node = ahead.pop()
        seen += 1
        if seen > 2 * MOST_LEAVES:
            raise InputError(f"{path} has more than {MOST_LEAVES} leaves; {REMEDY}")
        if not isinstance(node, dict):
            raise InputError(f"{path} has the node {shown(node)}; it must be an object; {REMEDY}")
        children = node.get("children")
        if children is not None:
            if not isinstance(children, list) or len(children) != 2:
                raise InputError(f"{path} has a node without two children; {REMEDY}")
            ahead.extend(reversed(children))
            continue
        boxes.append(_box(path, node.get("bound")))
        runs.append(_runs(path, node.get("lods"), levels, files))
    runs = np.array(runs, np.int64).reshape(-1, levels, 3)
    filled = (runs[:, :, 0] != NONE).any(axis=1)
    if not filled.any():
        raise InputError(f"{path} has no splats; {REMEDY}")
    return np.array(boxes, np.float32)[filled], runs[filled]


def _box(path, bound):
    ends = [bound.get(end) for end in ("min", "max")] if isinstance(bound, dict) else None
    box = number_array(ends, (2, 3))
    if box is None:
        raise InputError(
            f"{path} has the bound {shown(bound)}; min and max must be three numbers; {REMEDY}"
        )
    if (box[0] > box[1]).any():
        raise InputError(f"{path} has a bound whose min is above its max; {REMEDY}")
    return box.ravel()


def _runs(path, lods, levels, files):
    found = [(NONE, 0, 0)] * levels
    if not isinstance(lods, dict):
        raise InputError(f"{path} has a leaf without lods; {REMEDY}")
    for key, run in lods.items():
        level = int(key) if key.isdecimal() and len(key) < 4 else levels
        values = [run.get(k) for k in ("file", "offset", "count")] if isinstance(run, dict) else []
        good = level < levels and len(values) == 3 and all(
            type(v) is int and 0 <= v < 1 << 40 for v in values
        )  # fmt: skip
        if not good or values[0] >= files:
            raise InputError(
                f"{path}: level {shown(key)} of a leaf is {shown(run)}; it must have file (below "
                f"{files}), offset and count, and a level below {levels}; {REMEDY}"
            )
        if values[2]:
            found[level] = tuple(values)
    return found


def _sides(path, own, box, count):
    """Return how coarse each level of each leaf is, (leaves, levels), see `ChunkTree.side`."""
    levels = count.shape[1]
    if own is None:
        return _judged_sides(box, count)
    sides = number_array(own, (levels,))
    if sides is None or sides[0] < 0 or (np.diff(sides) < 0).any():
        raise InputError(
            f"{path}: {SIDES} is {shown(own)}; it must be {levels} rising lengths; {REMEDY}"
        )
    return np.broadcast_to(sides.astype(np.float32), count.shape)


def _judged_sides(box, count):
    """Return the sides of cells that levels without a note on them are as coarse as.

    Splats lie on surfaces. A leaf's surface is taken to be as large as the largest face of its box,
    so n splats stand for cells of the root of that area over n. Level 0 is not coarse at all.
    """
    width = np.sort(box[:, 3:] - box[:, :3], axis=1).astype(np.float64)
    area = width[:, 2] * width[:, 1]
    with np.errstate(divide="ignore"):
        side = np.sqrt(area[:, None] / count)
    side[count == 0] = 0
    side[:, 0] = 0
    return np.maximum.accumulate(side, axis=1).astype(np.float32)


def read_chunk(tree, name):
    """Return the splats of a chunk in the order they are stored in, and which are usable."""
    return read_rows(require_file(tree.folder / name, "a chunk of a Streamed SOG"))


def require_run(tree, name, splats, offset, count):
    """Raise InputError unless a chunk has the splats of a run."""
    if offset + count > len(splats):
        raise InputError(
            f"{tree.folder / name} has {len(splats)} splats; {LOD_META} counts on "
            f"{offset + count}; the files must belong together; export them again"
        )
