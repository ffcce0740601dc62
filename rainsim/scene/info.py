"""The content of a splat file in numbers: for `rainsim import --info` and for scripts."""

from pathlib import Path

import numpy as np

from rainsim.scene.big import open_pages
from rainsim.scene.folder import SCENE_FILE, SPLAT_FILE, cameras_beside, locate, read_scene
from rainsim.scene.formats import read, source_files
from rainsim.scene.formats.streamed import LOD_META

PERCENTILES = (0, 5, 25, 50, 75, 95, 100)
CORE = (1, 99)  # percentiles of the positions' core: strays far out do not count
INVISIBLE = 1 / 255  # opacity below which a splat changes no 8-bit picture
FLAT = 0.1  # thinnest over middle axis below which a splat has a plane, as PGSR and 2DGS train them
NEEDLE = 100.0  # longest over middle axis above which it is a needle
DRAWING_SHARE = 1.3  # what drawing needs on top, at most, as a share of the splats' own arrays


def describe(path):
    """Return the content of a splat file, model folder or scene folder, in numbers.

    Broken splats are counted however many they are, where reading a scene refuses more than 1 %.

    path : path-like
    Returns dict. Ready for JSON: `path`, `format`, `bytes`, `splats`,
        `sh_degree`, `bounds` and `core` (`low`, `high` [capture units]; all
        splats, and between the 1st and 99th percentile of each axis), `opacity`,
        `scale_longest`, `scale_thinnest` (percentiles by name [capture units]),
        `broken` (unusable values, dropped on reading), `invisible`,
        `without_size`, `oversized`, `needles`, `flat` (counts), `cameras`,
        `memory` (`splats` and `drawing`, bytes) and `notes`.
    Raises InputError if it cannot be read at all, or holds not one usable splat.
    """
    path = Path(path)
    folder = path.parent if path.name == SCENE_FILE else path
    if (folder / SCENE_FILE).is_file():
        scene = read_scene(folder)
        if scene.pages is not None:
            return _of_chunks(folder, scene.splats, len(scene.cameras), scene.notes)
        size = (folder / SPLAT_FILE).stat().st_size
        head = {"path": str(path), "format": "rainsim scene folder", "bytes": size}
        return head | _numbers(scene.splats, 0, len(scene.cameras), scene.notes)
    splat_file, model = locate(path)
    if splat_file.name == LOD_META:
        cameras, notes = cameras_beside(splat_file, model)
        _, splats, _, own = open_pages(splat_file)
        return _of_chunks(splat_file.parent, splats, len(cameras), (*own, *notes))
    reading = read(splat_file, max_broken=1.0)
    cameras, camera_notes = cameras_beside(splat_file, model)
    size = sum(file.stat().st_size for file in source_files(splat_file))
    head = {"path": str(splat_file), "format": reading.format, "bytes": size}
    notes = (*reading.notes, *camera_notes)
    return head | _numbers(reading.splats, reading.broken, len(cameras), notes)


def _of_chunks(folder, splats, cameras, notes):
    """Return the content of a folder of chunks; its numbers are of a level that fits the memory."""
    size = sum(file.stat().st_size for file in folder.glob("*/*") if file.is_file())
    head = {"path": str(folder), "format": "Streamed SOG, in chunks", "bytes": size}
    return head | _numbers(splats, 0, cameras, notes)


def _numbers(splats, broken, cameras, notes):
    ordered = np.sort(splats.scale, axis=1)
    thin, middle, long = ordered.T
    low, high = np.percentile(splats.position, CORE, axis=0)
    extent = float(np.linalg.norm(high - low))
    arrays = (splats.position, splats.rotation, splats.scale, splats.opacity, splats.sh)
    size = sum(array.nbytes for array in arrays)
    tiny = np.finfo(np.float32).tiny
    return {
        "splats": len(splats),
        "sh_degree": round(splats.sh.shape[1] ** 0.5) - 1,
        "bounds": _box(splats.position.min(axis=0), splats.position.max(axis=0)),
        "core": _box(low, high),
        "opacity": _percentiles(splats.opacity),
        "scale_longest": _percentiles(long),
        "scale_thinnest": _percentiles(thin),
        "broken": broken,
        "invisible": int(np.count_nonzero(splats.opacity < INVISIBLE)),
        "without_size": int(np.count_nonzero(long < tiny)),
        "oversized": int(np.count_nonzero(long > max(extent, tiny))),
        "needles": int(np.count_nonzero(long > NEEDLE * np.maximum(middle, tiny))),
        "flat": int(np.count_nonzero(thin < FLAT * middle)),
        "cameras": cameras,
        "memory": {"splats": size, "drawing": round(size * (1 + DRAWING_SHARE))},
        "notes": list(notes),
    }


def _box(low, high):
    return {"low": [float(v) + 0.0 for v in low], "high": [float(v) + 0.0 for v in high]}


def _percentiles(values):
    found = np.percentile(values, PERCENTILES)
    return {str(p): float(v) for p, v in zip(PERCENTILES, found, strict=True)}


def as_text(info):
    """Return the result of `describe` as lines for people."""
    count = info["splats"]
    whole = count + info["broken"]

    def share(key, of):
        number = info[key]
        return f"{number:,}" + (f" ({100 * number / of:.3g} %)" if number else "")

    memory = info["memory"]
    rows = [
        ("file", info["path"]),
        ("format", f"{info['format']}, {in_bytes(info['bytes'])}"),
        ("splats", f"{count:,}, spherical harmonics of degree {info['sh_degree']}"),
        ("cameras beside it", f"{info['cameras']:,}"),
        ("bounds", _box_text(info["bounds"])),
        ("98 % core", _box_text(info["core"])),
        ("percentiles", "  ".join(f"{p:>9}" for p in map(_ordinal, PERCENTILES))),
        ("opacity", _row(info["opacity"])),
        ("longest axis", _row(info["scale_longest"])),
        ("thinnest axis", _row(info["scale_thinnest"])),
        ("NaN or unusable", share("broken", whole)),
        ("invisible", f"{share('invisible', count)}, opacity under 1/255"),
        ("without size", share("without_size", count)),
        ("oversized", f"{share('oversized', count)}, longer than the core"),
        ("needles", f"{share('needles', count)}, {NEEDLE:g} times longer than wide"),
        ("flat", f"{share('flat', count)}, thinner than {FLAT:g} of their width"),
        ("memory", f"{in_bytes(memory['splats'])} loaded, {in_bytes(memory['drawing'])} to draw"),
        *(("note", note) for note in info["notes"]),
    ]
    return "\n".join(f"{name:<18}{text}" for name, text in rows)


def _ordinal(p):
    return {0: "least", 50: "median", 100: "most"}.get(p, f"{p} %")


def _row(values):
    return "  ".join(f"{value:>9.3g}" for value in values.values())


def _box_text(box):
    low, high = (", ".join(f"{v:.4g}" for v in box[end]) for end in ("low", "high"))
    return f"({low}) to ({high})"


def in_bytes(number):
    """Return a number of bytes for people: 12 bytes, 3.4 kB, 120 MB, 5 GB."""
    for unit in ("bytes", "kB", "MB"):
        if number < 999.5:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} GB"
