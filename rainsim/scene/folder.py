"""Scenes as files: captures in the layouts that users hold, and the program's own scene folder.

A scene folder holds `scene.json` (name, source, notes, cameras, ground frame) and `splats.npz` (the
activated arrays of Splats, uncompressed), and where there are any `actors.npz` and `classes.npz`.
"""

import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.linalg import norm

from rainsim.actors.actor import with_actors
from rainsim.actors.actor_files import (
    ACTORS_ARRAYS,
    ACTORS_FILE,
    REMEDY,
    actors_file,
    lamp_notes,
    read_actor_arrays,
    read_actors,
    write_actor_arrays,
)
from rainsim.errors import InputError, ParameterError, one_line, shown
from rainsim.io import cache
from rainsim.io.arrays import Field, read_arrays, write_arrays
from rainsim.io.files import (
    number_array,
    printable_name,
    read_json,
    replacing,
    require_file,
    write_json,
)
from rainsim.scene.assumed_ground import ground_frame_of, of_stage
from rainsim.scene.big import open_pages, require_home
from rainsim.scene.camera_entry import Entry
from rainsim.scene.cameras import JSON_FILES, cameras_from_data, cameras_to_data, load_cameras
from rainsim.scene.colmap import find_model
from rainsim.scene.formats import LEVEL, META, SUFFIXES, read_splats, sha256_of, trained_antialiased
from rainsim.scene.formats.streamed import LOD_META
from rainsim.scene.ground import (
    ground_frame_from_dict,
    ground_frame_to_dict,
    read_ground_frame,
    rescale_ground_frame,
)
from rainsim.scene.lamps import with_lamps
from rainsim.scene.origin import NOWHERE, near_origin, step_note
from rainsim.scene.painted import PAINTED_FILE, read_painted, write_painted
from rainsim.scene.ply import origin_of
from rainsim.scene.sight import in_nerfstudio_frame, require_sight, settled
from rainsim.scene.types import GroundFrame, Scene, Splats

SCENE_FILE, SPLAT_FILE = "scene.json", "splats.npz"
VERSION = 1
FLOAT = float(np.finfo(np.float32).max)
ARRAYS = {
    "position": Field("float32", ("splats", 3)),
    "rotation": Field("float32", ("splats", 4), -2, 2),
    "scale": Field("float32", ("splats", 3), 0),
    "opacity": Field("float32", ("splats",), 0, 1),
    "sh": Field("float32", ("splats", "coefficients", 3), -FLOAT, FLOAT),
}
MODEL_STEMS = ("point_cloud", "meta", "lod-meta")  # of files that have their model's name
COEFFICIENTS = (1, 4, 9, 16)
MOST_NAMED = 8  # files in an error message
NOT_UNIT = 1e-2  # of a quaternion's squared length from 1


def import_scene(
    path, cameras=None, up=None, meters_per_unit=None, camera_height=None, ground_frame=None,
    spz_frame=None,
):  # fmt: skip
    """Read a capture and find its ground frame.

    path : path-like. A trained model's folder
        (point_cloud/iteration_*/point_cloud.ply, the newest iteration, with
        cameras.json), a splat file of any format that `rainsim.scene.formats`
        reads with cameras.json, transforms.json or a COLMAP model (sparse/0)
        beside it, or a scene folder as `write_scene` writes it.
    cameras : path-like or sequence of Camera, optional. Cameras to use instead of
        those in files beside the splats; see `read_cameras`.
    up, meters_per_unit, camera_height. See `estimate_ground_frame`. Values not
        given are kept from a scene folder; without cameras they are assumed, see
        `assumed_ground_frame`.
    ground_frame : path-like or GroundFrame, optional. The whole ground frame;
        `up` and the scale are then ignored.
    spz_frame : {"rub", "rdf"}, optional. Axes of an SPZ file that does not name
        them; by default those in which the cameras see.
    """
    path, camera_notes = Path(path), []
    if actors_file(path) is not None:
        given = cameras, up, meters_per_unit, camera_height, ground_frame
        return _import_with_actors(path, actors_file(path), *given)
    camera_file = None
    if isinstance(cameras, str | os.PathLike):
        camera_file = Path(cameras)
        cameras, camera_notes = load_cameras(cameras)
    folder = path.parent if path.name == SCENE_FILE else path
    if (folder / SCENE_FILE).is_file():
        scene = read_scene(folder)
        settled(scene.splats, (), (), spz_frame)  # a scene folder has its frame
        if cameras is not None:
            notes, cameras = (*scene.notes, *camera_notes), near_origin(cameras, scene.origin)
            scene = replace(scene, cameras=tuple(cameras), notes=notes)
        return override_ground_frame(scene, up, meters_per_unit, camera_height, ground_frame)
    splat_file, model = locate(path)
    if splat_file.name == LOD_META:
        if cameras is None:
            cameras, camera_notes = cameras_beside(splat_file, model)
        given = up, meters_per_unit, camera_height
        return _import_chunks(path, splat_file, cameras, camera_notes, ground_frame, given)
    with ThreadPoolExecutor(1) as pool:  # hashing runs beside reading
        hashed = pool.submit(sha256_of, splat_file)
        read, notes = read_splats(splat_file)
        if cameras is None:
            camera_file = _camera_file(splat_file, model)
            cameras, camera_notes = cameras_beside(splat_file, model)
        if camera_file is not None:
            cameras, more = in_nerfstudio_frame(splat_file, camera_file, cameras)
            camera_notes = [*camera_notes, *more]
        source_hash = hashed.result()
    origin = origin_of(splat_file)
    cameras = near_origin(cameras, origin)
    splats, notes = settled(read, [*notes, *step_note(read)], cameras, spz_frame)
    if splats is not read:
        source_hash = hashlib.sha256(f"{source_hash} turned".encode()).hexdigest()
    camera_notes = [*camera_notes, *require_sight(path, splats, cameras)]
    for field in fields(splats):
        cache.know_hash(getattr(splats, field.name), "splats", source_hash, field.name)
    if ground_frame is not None:
        frame = _as_frame(ground_frame, source_hash)
    elif LEVEL in notes and (up, meters_per_unit, camera_height) == (None,) * 3:
        frame = of_stage(_kept_frame(source_hash, splats, cameras, (0, 0, 1), 1.0, None), splats)
    else:
        frame = _kept_frame(source_hash, splats, cameras, up, meters_per_unit, camera_height)
    name = path.resolve().name if path.is_dir() else _file_name(path, model)
    notes = (*notes, *camera_notes)
    return Scene(name, splats, tuple(cameras), frame, path, source_hash, notes,
                 antialiased=trained_antialiased(splat_file), origin=origin)  # fmt: skip


def _import_chunks(path, index, cameras, camera_notes, ground_frame, given):
    """Return the Scene of a Streamed SOG; `given` are the last arguments of `_kept_frame`."""
    pages, splats, source_hash, notes = open_pages(index)
    found = ground_frame is None and _kept_frame(source_hash, splats, cameras, *given)
    frame = found or _as_frame(ground_frame, source_hash)
    name, notes = _file_name(path, index.parent), (*notes, *camera_notes)
    return Scene(name, splats, tuple(cameras), frame, path, source_hash, notes, pages=pages,
                 antialiased=trained_antialiased(index))  # fmt: skip


def _import_with_actors(path, file, *given):
    """Read the static set that an `actors.json` names, and its actors; see `import_scene`."""
    found = read_actors(file)
    scene = import_scene(found.static, *given)
    if scene.actors:
        raise InputError(f"{file}: its scene has actors already; it must be a static set; {REMEDY}")
    if any(scene.origin):
        raise InputError(
            f"{file}: its static set has large coordinates, those of a map; actors need small "
            f"ones; take the same offset off all of its files; {REMEDY}"
        )
    notes = found.notes
    if found.lamps:
        splats, counts = with_lamps(scene.splats, found.lamps)
        scene, notes = replace(scene, splats=splats), (*notes, *lamp_notes(file.name, counts))
    digest = hashlib.sha256(scene.source_hash.encode())
    for part in found.files:
        digest.update(sha256_of(part).encode())
    try:
        scene = with_actors(scene, found.actors, notes)
    except ParameterError as error:
        raise InputError(f"{file}: {error}") from None
    name = file.parent.resolve().name
    return replace(scene, name=name, source=path, source_hash=digest.hexdigest())


def _kept_frame(source_hash, splats, *given):
    """Return the ground frame of the splats in a file: of an earlier run, or estimated and kept.

    `given` is what `ground_frame_of` takes besides the splats.
    """

    def estimated():
        return ground_frame_to_dict(ground_frame_of(splats, *given)), {}

    facts, _ = cache.kept("frame", estimated, source_hash, *given)
    return ground_frame_from_dict(facts, "kept ground frame")


def override_ground_frame(
    scene, up=None, meters_per_unit=None, camera_height=None, ground_frame=None
):
    """Return the scene with another ground frame, up or scale; see `import_scene`."""
    if ground_frame is not None:
        return in_ground_frame(scene, _as_frame(ground_frame, scene.source_hash))
    frame = scene.ground_frame
    if up is not None:
        if meters_per_unit is None and camera_height is None:
            if not frame.scale_assumed or not scene.cameras:
                meters_per_unit = frame.meters_per_unit
        frame = ground_frame_of(scene.splats, scene.cameras, up, meters_per_unit, camera_height)
    elif meters_per_unit is not None or camera_height is not None:
        frame = rescale_ground_frame(frame, scene.cameras, meters_per_unit, camera_height)
    return in_ground_frame(scene, frame)


def in_ground_frame(scene, frame):
    """Return the scene with a ground frame; classes painted in another one are left out."""
    same = all(
        np.array_equal(getattr(frame, name), getattr(scene.ground_frame, name))
        for name in ("rotation", "meters_per_unit", "translation")
    )
    if scene.painted is None or same:
        return replace(scene, ground_frame=frame)
    note = "the painted classes are left out: they were painted in another ground frame"
    return replace(scene, ground_frame=frame, painted=None, notes=(*scene.notes, note))


def is_scene(path):
    """Return whether the names at `path` are those of a scene that `import_scene` reads."""
    path = Path(path)
    if path.is_dir():
        files = (SCENE_FILE, META, LOD_META, ACTORS_FILE)
        named = any((path / name).is_file() for name in files)
        return named or newest_splat_file(path) is not None
    return path.is_file() and path.suffix.lower() in SUFFIXES


def newest_splat_file(folder):
    """Return the splat file of a trained model's folder, newest iteration, or None."""
    found = [
        (int(file.parent.name.removeprefix("iteration_")), file)
        for file in Path(folder).glob("point_cloud/iteration_*/point_cloud.ply")
        if file.parent.name.removeprefix("iteration_").isdecimal()
    ]
    return max(found)[1] if found else None


# --- capture --------------------------------------------------------------------------------------


def _as_frame(value, source_hash):
    return value if isinstance(value, GroundFrame) else read_ground_frame(value, source_hash)


def locate(path):
    """Return the splat file that `path` means and the folder of the model that it belongs to."""
    path = Path(path)
    if not path.exists():
        raise InputError(
            f"{path} does not exist; it must be a trained model's folder, a splat file or a scene "
            "folder; check the path"
        )
    if path.is_dir():
        return newest_splat_file(path) or _only_splat_file(path), path
    path = require_file(path, "a splat file")
    inside = path.parent.name.startswith("iteration_") and path.parent.parent.name == "point_cloud"
    return path, path.parent.parent.parent if inside else path.parent


def _only_splat_file(folder):
    """Return the one splat file that lies in a folder, or the index of a SOG."""
    for name in (LOD_META, META):
        if (folder / name).is_file():
            return folder / name
    loose = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
    if len(loose) > 1:
        names = ", ".join(path.name for path in loose[:MOST_NAMED])
        more = f" and {len(loose) - MOST_NAMED} more" if len(loose) > MOST_NAMED else ""
        raise InputError(
            f"{folder} holds {len(loose)} splat files ({names}{more}); one is a scene; name it, as "
            f"{loose[0]}"
        )
    if not loose:
        inner = sorted(p.parents[2] for p in folder.glob("*/point_cloud/iteration_*/*.ply"))
        raise InputError(
            f"{folder} has no point_cloud/iteration_*/point_cloud.ply, no {SCENE_FILE} and no "
            f"splat file ({', '.join(SUFFIXES)}); it must be a trained model's folder or a scene "
            f"folder; name {f'{inner[0]}, which is one' if inner else 'the splat file itself'}"
        )
    return loose[0]


def cameras_beside(splat_file, model):
    """Return the cameras found beside a splat file or in its model's folder, and notes."""
    found = _camera_file(splat_file, model)
    return ([], []) if found is None else load_cameras(found)


def _camera_file(splat_file, model):
    """Return the file or the COLMAP model that `cameras_beside` reads, None without one."""
    folders = list(dict.fromkeys((splat_file.parent, model)))
    named = [folder / name for folder in folders for name in JSON_FILES]
    found = next((file for file in named if file.is_file()), None)
    return found or next(filter(None, map(find_model, folders)), None)


def _file_name(path, model):
    return model.resolve().name if path.stem in MODEL_STEMS else path.stem


# --- scene folder ---------------------------------------------------------------------------------


def write_scene(folder, scene):
    """Write a scene folder; both files are replaced together, when both are whole."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if scene.pages is not None:
        require_home(scene, folder)
        write_json(folder / SCENE_FILE, scene_to_data(scene))
        return _write_parts(folder, scene)
    with replacing(folder / SCENE_FILE) as scene_file, replacing(folder / SPLAT_FILE) as splat_file:
        write_json(scene_file, scene_to_data(scene))
        write_arrays(splat_file, VERSION, {n: getattr(scene.splats, n) for n in ARRAYS})
        _write_parts(folder, scene)


def _write_parts(folder, scene):
    if scene.actors:
        write_actor_arrays(folder / ACTORS_ARRAYS, scene.actors)
    if scene.painted is not None:
        write_painted(folder / PAINTED_FILE, scene.painted)


def read_scene(folder):
    """Read a scene folder that `write_scene` wrote; every number comes back exactly.

    The scene's `source` is then the folder and its hash the one of the first source.
    """
    folder = Path(folder)
    path = folder / SCENE_FILE
    data = read_json(path, "a scene")
    if not isinstance(data, dict) or data.get("rainsim_scene") != VERSION:
        raise InputError(
            f"{path} is not a scene of version {VERSION}; it must be written by rainsim import; "
            "import the capture again"
        )
    pages, notes = None, ()
    if data.get("chunks") is not None:
        pages, splats, _, notes = open_pages(folder)
    else:
        splats = _read_arrays(folder / SPLAT_FILE)
    if len(splats) != data.get("splats"):
        raise InputError(
            f"{folder} has {len(splats)} splats but {SCENE_FILE} speaks of "
            f"{shown(data.get('splats'))}; the files must belong together; import the capture again"
        )
    scene = scene_from_data(data, splats, path, folder.name)
    scene = replace(scene, source=folder, pages=pages, notes=scene.notes or notes)
    if data.get("painted"):
        scene = replace(scene, painted=read_painted(folder / PAINTED_FILE))
    if not data.get("actors"):
        return scene
    actors = read_actor_arrays(folder / ACTORS_ARRAYS)
    if len(actors) != data["actors"]:
        raise InputError(
            f"{folder} has {len(actors)} actors but {SCENE_FILE} counts {shown(data['actors'])}; "
            "the files must belong together; import the capture again"
        )
    return with_actors(scene, actors)


def scene_to_data(scene):
    """Return all of a scene but its splats, as a dict for JSON."""
    return {
        "rainsim_scene": VERSION,
        "name": scene.name,
        "source": scene.source.name if scene.source else None,
        "source_sha256": scene.source_hash,
        "notes": list(scene.notes),
        "splats": len(scene.splats),
        "ground_frame": ground_frame_to_dict(scene.ground_frame),
        "cameras": cameras_to_data(scene.cameras) if scene.cameras else None,
        "drains": [list(map(float, place)) for place in scene.drains],
        **({"actors": len(scene.actors)} if scene.actors else {}),
        **({"painted": True} if scene.painted is not None else {}),
        **({} if scene.pages is None else {"chunks": LOD_META}),
        **({"antialiased": True} if scene.antialiased else {}),
        **({"captured_sun": scene.captured_sun} if scene.captured_sun else {}),
        **({"origin": list(scene.origin)} if any(scene.origin) else {}),
    }


def scene_from_data(data, splats, where, name=""):
    """Return the Scene of splats and `scene_to_data`'s data; `where` names these in messages."""
    cameras, notes, drains = data.get("cameras"), data.get("notes"), data.get("drains") or []
    if drains:
        count = len(drains) if isinstance(drains, list) else 1
        drains = Entry(where, "scene", data).array("drains", (count, 3)).tolist()
    sun = number_array(data.get("captured_sun"), (3,))
    origin = number_array(data.get("origin"), (3,))
    return Scene(
        name=printable_name(data.get("name", name)),
        splats=splats,
        cameras=tuple(cameras_from_data(cameras, where)) if cameras else (),
        ground_frame=ground_frame_from_dict(data.get("ground_frame"), where),
        source_hash=printable_name(data.get("source_sha256", "")),
        notes=tuple(map(one_line, notes)) if isinstance(notes, list) else (),
        drains=tuple(map(tuple, drains)),
        antialiased=data.get("antialiased") is True,
        captured_sun=None if sun is None or not sun.any() else tuple((sun / norm(sun)).tolist()),
        origin=NOWHERE if origin is None else tuple(origin.tolist()),
    )


def _read_arrays(path):
    """Return the Splats in an .npz file, all of it checked."""
    found = read_arrays(path, "set of splats", ARRAYS, VERSION, "import the capture again")
    splats = Splats(**found)
    turn = np.einsum("ni,ni->n", splats.rotation, splats.rotation)
    count, coefficients = splats.sh.shape[:2]
    if count == 0 or coefficients not in COEFFICIENTS or np.abs(turn - 1).max() > NOT_UNIT:
        raise InputError(
            f"{path} has {count} splats of {coefficients} coefficients of spherical harmonics, "
            "which must be 1, 4, 9 or 16, or rotations that are no unit quaternions; import the "
            "capture again"
        )
    return splats
