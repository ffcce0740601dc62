"""`rainsim world`: camera, ground, water, rain and capture as USD, for other renderers."""

import click

from rainsim.commands import options
from rainsim.commands.given import first_frame, masks_named, view_on
from rainsim.commands.job import Job
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
@options.resume_option
@options.output_options("rainsim-out/SCENE-world")
def world(scene, parts, **given):
    """Write SCENE in the rain for other renderers, as USD in metres with z up (needs rainsim[usd]).

    Writes DIR/world.usda, which joins a layer for each part: camera, the ground's mesh, puddles
    with depth and flow, drops and splashes before the camera, and the capture's splats. Also
    ground.glb. The options are those of `rainsim run`, and frames show the same water and drops.

    \b
    Example:
        rainsim world bicycle --frames 24
        rainsim world garden/ --path shot.usda --rain 25 --width 1920 --out shot
    """
    from rainsim.compiling.uses import SIMULATE
    from rainsim.output_folder.facts import settings_content, settings_facts
    from rainsim.output_folder.record import Record
    from rainsim.scene.usd_cameras import require_usd

    parts = _parts(parts)
    job = Job(given)
    require_usd("rainsim world")
    first = first_frame(given, job.config.fps)
    with job.compiling([SIMULATE]):
        job.load(scene)
        job.find_cameras()
        loaded, config, status = job.scene, job.config, job.status
        job.out = job.out or options.default_out(loaded.name, "world")
        with job.folder(loaded.source):
            terrain = job.extract_terrain(*job.read_masks())
            cameras = view_on(loaded, terrain, job.cameras, config, given, status)
            content = {
                "settings": settings_content(config), "parts": parts, "first": first,
                **masks_named(given),
            }  # fmt: skip
            facts = settings_facts(config, job.preset)
            record = Record(job.out, loaded, content, job.resume, **facts)
            record.begin()
            from rainsim.world.write import write_parts

            names, notes = write_parts(
                job.out, loaded, terrain, cameras, config, parts, first, status.progress
            )
            status.notes(notes)
            record.add(*names)
            record.write(complete=True, notes=notes)
    total = f", {counted(config.frames, 'frame')} from {first:g} on ({status.seconds:.1f} s)"
    result = {"files": names, "frames": config.frames, "fps": config.fps, "first_frame": first,
              "notes": notes}  # fmt: skip
    job.finish(", ".join(parts), result, more=total)


def _parts(text):
    """Return the parts that --parts names, in their order."""
    wanted = PARTS if text is None else tuple(name.strip() for name in text.split(","))
    for name in wanted:
        if name not in PARTS:
            raise ParameterError(
                f"--parts has {name!r}; each must be one of {', '.join(PARTS)}; correct the name"
            )
    return [name for name in PARTS if name in wanted]
