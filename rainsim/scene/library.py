"""Scenes by name or path: the user's own folders first, then the built-in stand-ins."""

import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from rainsim.actors.actor import with_actors
from rainsim.actors.actor_files import actors_from_arrays, actors_to_arrays
from rainsim.errors import InputError, ParameterError
from rainsim.io import cache
from rainsim.scene.folder import (
    ARRAYS,
    import_scene,
    is_scene,
    override_ground_frame,
    scene_from_data,
    scene_to_data,
)
from rainsim.scene.formats import SUFFIXES
from rainsim.scene.ground import require_known_scale
from rainsim.scene.photographs import with_photographs
from rainsim.scene.types import Splats

FOLDERS_VARIABLE = "RAINSIM_SCENES"  # folders of scenes, separated as in PATH
ACTORS = "actor_"  # begins the names of the arrays of what moves
KIND = "demo_scenes"  # of entries of `rainsim.io.cache`
BUILT_IN = {  # modules with make_bicycle and so on
    "bicycle": "rainsim.demo_scenes.bicycle", "street": "rainsim.demo_scenes.street",
    "traffic": "rainsim.demo_scenes.traffic",
}  # fmt: skip
LONG = ("street", "traffic")  # with make_long_street, too, for any length: street:300
LENGTHS = 60.0, 500.0  # m: a longer street is more than one picture's memory holds


def load_scene(
    name_or_path="bicycle",
    cameras=None,
    up=None,
    meters_per_unit=None,
    camera_height=None,
    ground_frame=None,
    photos=None,
    spz_frame=None,
):
    """Load a scene by name or path.

    Parameters
    ----------
    name_or_path : str or path-like
        What exists as a path or has a path separator is read as a path (`import_scene`). Any other
        is a name, looked up in the folders that RAINSIM_SCENES lists, in the user's data folder
        (rainsim/scenes) and among the built-in scenes, in this order. street:300 and traffic:300
        are built-in streets of 300 m.
    cameras, up, meters_per_unit, camera_height, ground_frame, spz_frame
        Override what the scene says; see `import_scene`.
    photos : path-like, optional
        Folder of the photographs of the capture's cameras, where it is not found beside the
        capture; see `rainsim.scene.photographs`.

    Returns
    -------
    Scene

    Raises
    ------
    ParameterError
        If the name is not known or not allowed.
    InputError, GroundError
        If the scene cannot be read.

    Examples
    --------
    >>> scene = rainsim.load_scene("my-capture/")
    >>> len(scene.cameras)
    3
    """
    given = {
        "up": up,
        "meters_per_unit": meters_per_unit,
        "camera_height": camera_height,
        "ground_frame": ground_frame,
    }
    path = find_scene(name_or_path)
    if path is not None:
        try:
            scene = import_scene(path, cameras=cameras, spz_frame=spz_frame, **given)
            given_frame = ground_frame is not None
            scene = with_photographs(scene, path, cameras, photos, keep_scale=given_frame)
            require_known_scale(scene.ground_frame, scene.cameras)
        except InputError as error:
            if str(name_or_path) not in BUILT_IN:
                raise
            hides = f"it hides the built-in scene {name_or_path}: rename it, or run elsewhere"
            known = f"the built-in scene {name_or_path} needs no import: `run` knows its name"
            raise InputError(f"{error}; {hides if Path(path).exists() else known}") from None
        if _is_name(name_or_path):
            scene = replace(scene, name=str(name_or_path))
        return scene
    for own, its in ("cameras", cameras), ("photographs", photos):
        if its is not None:
            raise ParameterError(
                f"scene {name_or_path} is built in and has its own cameras; other {own} need a "
                f"scene of yours; leave the {own} out"
            )
    scene = _built_in(str(name_or_path))
    note = (
        f"scene {name_or_path} is generated, not captured; one of yours of that name, in a folder "
        f"of {FOLDERS_VARIABLE}, takes its place"
    )
    return override_ground_frame(replace(scene, notes=(*scene.notes, note)), **given)


def _built_in(name):
    """Return a built-in scene: kept from an earlier run, or generated and kept for the next."""
    kind, *length = _long(name) or (name,)
    function = f"make_long_{kind}" if length else f"make_{kind}"

    def generated():
        made = getattr(import_module(BUILT_IN[kind]), function)(*length)
        arrays = {array: getattr(made.splats, array) for array in ARRAYS}
        if made.actors:
            actors = actors_to_arrays(made.actors)
            arrays |= {ACTORS + name: values for name, values in actors.items()}
        return scene_to_data(made), arrays

    facts, arrays = cache.kept(KIND, generated, function, *length)
    actors = {n.removeprefix(ACTORS): a for n, a in arrays.items() if n.startswith(ACTORS)}
    scene = scene_from_data(facts, Splats(**{n: arrays[n] for n in ARRAYS}), name)
    return with_actors(scene, actors_from_arrays(actors)) if actors else scene


def list_scenes():
    """Return all scenes known by name as (name, where, built-in) tuples, sorted by name.

    A name that stands in several folders is listed once, for the one that `load_scene` takes.

    Examples
    --------
    >>> [name for name, where, is_built_in in rainsim.list_scenes() if is_built_in]
    ['bicycle', 'street', 'traffic']
    """
    found = {}
    for folder in scene_folders():
        for path in sorted(_entries(folder)):
            name = path.name if path.is_dir() else path.stem
            if is_scene(path) and not name.startswith("."):
                found.setdefault(name, (name, str(path), False))
    for name in BUILT_IN:
        found.setdefault(name, (name, "built-in stand-in", True))
    return [found[name] for name in sorted(found)]


def find_scene(name_or_path):
    """Return the path that a scene's name or path means, None if it is built in."""
    if not _is_name(name_or_path):
        return Path(name_or_path)
    name = str(name_or_path)
    if not name or name.startswith(".") or "\\" in name or not name.isprintable():
        raise ParameterError(
            f"scene name is {name!r}; a name must not be empty, start with a dot or hold a "
            "separator; give a path that exists or a name that rainsim scenes lists"
        )
    for folder in scene_folders():
        for path in (folder / name, *(folder / f"{name}{suffix}" for suffix in SUFFIXES)):
            if is_scene(path):
                return path
    if name in BUILT_IN or _long(name):
        return None
    known = ", ".join(scene[0] for scene in list_scenes())
    raise ParameterError(
        f"scene {name!r} is not known; it must be a path that exists or one of {known}; folders of "
        f"scenes are taken from {FOLDERS_VARIABLE}"
    )


def is_capture(name_or_path):
    """Tell whether a scene is a capture and not a built-in one; False for what is neither."""
    try:
        return find_scene(name_or_path) is not None
    except ParameterError:
        return False


def _long(name):
    """Return kind and length [m] of a built-in scene's name such as street:300, None of others."""
    kind, colon, text = name.partition(":")
    if not colon or kind not in LONG:
        return None
    try:
        length = float(text)
    except ValueError:
        length = 0.0
    low, high = LENGTHS
    if not low <= length <= high:
        raise ParameterError(
            f"scene {name!r} asks for a street of {text or 'no'} m; a built-in street is "
            f"{low:g} to {high:g} m long; give a length such as {kind}:300"
        )
    return kind, length


def scene_folders():
    """Return the folders in which scenes are looked up by name, in order."""
    listed = os.environ.get(FOLDERS_VARIABLE, "").split(os.pathsep)
    data = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    folders = [*filter(None, listed), f"{data}/rainsim/scenes"]
    folders = map(os.path.expanduser, folders)  # an account may have no home
    return [Path(folder) for folder in folders if not folder.startswith("~")]


def _is_name(name_or_path):
    """Whether it is to be looked up: no separator, and no path that exists."""
    if not isinstance(name_or_path, str):
        return False
    if any(mark and mark in name_or_path for mark in (os.sep, os.altsep)):
        return False
    try:
        return not name_or_path or not Path(name_or_path).exists()
    except ValueError:  # a zero byte
        return True


def _entries(folder):
    try:
        return list(folder.iterdir())
    except OSError:  # a folder that is not there holds no scenes
        return []
