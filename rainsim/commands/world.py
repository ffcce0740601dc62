"""`rainsim world`: camera, ground, water, rain and capture as USD, for other renderers."""

from __future__ import annotations

import click

from rainsim.commands import options
from rainsim.commands.compile import compiled_beside
from rainsim.commands.given import (
    cameras_of,
    check_camera_options,
    first_frame,
    mask_of,
    masks_named,
    paths_in,
    settings,
    view_on,
    water_mask_of,
)
from rainsim.commands.status import Status, loaded_scene
from rainsim.errors import ParameterError, counted

PARTS = ("camera", "ground", "water", "rain", "capture")


@click.command(short_help="Write camera, ground, puddles, rain and capture as USD.")
@click.argument("scene", default="bicycle")
@options.option("parts", str, "Which parts are written.", "NAME,NAME", ",".join(PARTS))
@options.option("frame-start", click.IntRange(-(10**8), 10**8), "Number of the first frame.", "N",
                "the path's, or 0")  # fmt: skip
@options.preset_option
@options.rain_options
@options.camera_options
@options.size_options
@options.ground_options
@options.terrain_options
@options.mask_options
@options.output_options("rainsim-out/SCENE-world")
def world(scene, parts, frame_start, preset, out, overwrite, as_json, quiet, class_mask, **given):
    """Write SCENE in the rain for other renderers, as USD in metres with z up (needs rainsim[usd]).

    Writes DIR/world.usda, which joins a layer for each part: camera, the ground's mesh, puddles
    with depth and flow, drops and splashes before the camera, and the capture's splats. Also
    ground.glb. The options are those of `rainsim run`, and frames show the same water and drops.

    \b
    Example:
        rainsim world bicycle --frames 24
        rainsim world garden/ --path shot.usda --rain 25 --width 1920 --out shot
    """
    status = Status(quiet)
    parts = _parts(parts)
    config = settings(preset, given)
    check_camera_options(given)
    _require_usd()
    first = first_frame({**given, "frame_start": frame_start}, config.fps)
    from rainsim.compiling.uses import SIMULATE
    from rainsim.jit import set_threads
    from rainsim.output_folder import Record, claimed, relative, settings_content, settings_facts

    with status, compiled_beside(status, [SIMULATE], config.threads):
        loaded = loaded_scene(status, scene, given)
        cameras, config = cameras_of(loaded, config, given, say=status.notes)
        out = out or options.default_out(loaded.name, "world")
        with claimed(out, overwrite, sources=[loaded.source, class_mask, *paths_in(given)]):
            set_threads(config.threads)
            from rainsim.pipeline import extract_terrain

            tell = status.progress, status.notes
            water = water_mask_of(given)
            terrain = extract_terrain(loaded, config, mask_of(class_mask), *tell, water)
            cameras = view_on(loaded, terrain, cameras, config, given, status)
            content = {
                "settings": settings_content(config), "parts": parts, "first": first,
                **masks_named(class_mask, given),
            }  # fmt: skip
            record = Record(out, loaded, content, **settings_facts(config, preset))
            record.begin()
            from rainsim.world.write import write_parts

            names, notes = write_parts(
                out, loaded, terrain, cameras, config, parts, first, status.progress
            )
            status.notes(notes)
            record.add(*names)
            record.write(complete=True, notes=notes)
    total = f"{counted(config.frames, 'frame')} from {first:g} on"
    status.say(f"{', '.join(parts)} in {relative(out)}, {total} ({status.seconds:.1f} s)")
    result = {"out": str(out), "files": names, "frames": config.frames, "fps": config.fps,
              "first_frame": first, "notes": notes}  # fmt: skip
    options.echo(result, as_json, str(out))


def _parts(text):
    """Return the parts that --parts names, in their order."""
    wanted = PARTS if text is None else tuple(name.strip() for name in text.split(","))
    for name in wanted:
        if name not in PARTS:
            raise ParameterError(
                f"--parts has {name!r}; each must be one of {', '.join(PARTS)}; correct the name"
            )
    return [name for name in PARTS if name in wanted]


def _require_usd():
    from rainsim.scene.usd_cameras import require_usd

    require_usd("rainsim world")
