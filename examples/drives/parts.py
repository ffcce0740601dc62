"""The parts of a drive, and the scene that is made of them."""

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import rainsim


def write_ply(path, columns):
    """Write splats, a dict of columns (n,) by the names that the original 3DGS code gives them."""
    names = "".join(f"property float {name}\n" for name in columns)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(columns['x'])}\n{names}"
    rows = np.stack(list(columns.values()), axis=1).astype("<f4")
    path.write_bytes(head.encode() + b"end_header\n" + rows.tobytes())


def actor(name, kind, size, times, positions, rotations, visible):
    """Return the entry of an actor in actors.json; both projects train colours as seen."""
    track = {"times": times, "positions": positions, "rotations": rotations, "visible": visible}
    track = {key: np.asarray(values).tolist() for key, values in track.items()}
    box = {"centre": [0, 0, 0], "size": np.asarray(size).tolist()}
    return {"id": name, "class": kind, "box": box, "track": track, "harmonics": "scene"}


def scene_of(cameras, static, actors, notes, series):
    """Return the Scene of sets of columns that stand still and of actors as (entry, columns).

    `series` has the ColorSeries of those whose colours change, by their ids.
    """
    if not static:
        raise ValueError("it has no background")
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        still = {name: np.concatenate([part[name] for part in static]) for name in static[0]}
        write_ply(folder / "static.ply", still)
        for number, (entry, columns) in enumerate(actors):
            entry["splats"] = f"{number}.ply"
            write_ply(folder / entry["splats"], columns)
        content = {"rainsim_actors": 1, "scene": "static.ply", "nodes": [e for e, _ in actors]}
        (folder / "actors.json").write_text(json.dumps(content), encoding="utf-8")
        read = folder / ("actors.json" if actors else "static.ply")
        scene = rainsim.load_scene(read, cameras=cameras or None, meters_per_unit=1.0)
    for moving in scene.actors:
        if moving.id in series and len(series[moving.id].terms) != len(moving.splats):
            raise ValueError(f"node {moving.id} has splats that are not usable")
    moving = tuple(replace(a, series=series.get(a.id)) for a in scene.actors)
    return replace(scene, actors=moving, notes=(*scene.notes, *notes))
