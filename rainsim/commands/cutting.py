"""`rainsim import --lod`: a large capture cut into chunks, and the scene that it then is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rainsim.errors import InputError, ParameterError

STAGE = "cut"


def require_cuttable(path, overwrite, resume):
    """Return the splat file that is to be cut and its model's folder, or raise an error."""
    from rainsim.scene.actor_files import actors_file
    from rainsim.scene.drivestudio import is_checkpoint
    from rainsim.scene.folder import SCENE_FILE, locate
    from rainsim.scene.formats.streamed import LOD_META
    from rainsim.scene.street_gaussians import is_street_ply

    if overwrite or resume:
        raise ParameterError(
            "--lod writes to a new folder only, for a cut is made in one go; leave --overwrite and "
            "--resume out and give another --out"
        )
    path = Path(path)
    if actors_file(path) is not None or (path / SCENE_FILE).is_file():
        raise InputError(
            f"{path} is no splat file; --lod cuts one; name the file, and the chunks as the scene "
            "of an actors.json where there are nodes"
        )
    file, model = locate(path)
    street = file.suffix.lower() == ".ply" and is_street_ply(file)
    if street or is_checkpoint(file) or file.name == LOD_META:
        raise InputError(f"{file} is no plain splat file; --lod cuts a static set; leave --lod out")
    return file, model


def cut_to_scene(status, file, model, out, given):
    """Cut a splat file into chunks in a folder, and return the Scene of them.

    Parameters
    ----------
    status : Status
    file, model : Path
        As `require_cuttable` returns them.
    out : Path
    given : dict
        Options of the ground.
    """
    from rainsim.commands.choose import scene_of
    from rainsim.commands.status import say_scene
    from rainsim.lod.cut import cut
    from rainsim.scene.cameras import load_cameras
    from rainsim.scene.folder import cameras_beside
    from rainsim.scene.formats import splat_blocks, trained_antialiased
    from rainsim.scene.formats.streamed import LOD_META

    cameras = given.get("cameras")
    cameras, notes = load_cameras(cameras) if cameras else cameras_beside(file, model)
    blocks, _ = splat_blocks(file)
    cut(
        out, blocks, tell=lambda done, total: status.progress(STAGE, done, total),
        antialiased=trained_antialiased(file),
    )  # fmt: skip
    given = given | {"cameras": cameras, "tracks": None, "track_fps": None}
    scene = scene_of(str((out / LOD_META).resolve()), given)
    name = model.resolve().name if file.stem in ("point_cloud", "meta") else file.stem
    scene = replace(scene, name=name, source=file, notes=(*scene.notes, *notes))
    say_scene(status, scene)
    return scene
