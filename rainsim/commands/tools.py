"""The commands around the frames: import, scenes, presets, warmup."""

import json
from itertools import takewhile
from pathlib import Path

import click

from rainsim.commands import options
from rainsim.commands.compile import compiled_beside
from rainsim.commands.given import require_backend
from rainsim.commands.job import Job
from rainsim.commands.status import Status
from rainsim.errors import RainsimError

GROUND_FRAME = "ground_frame.json"


@click.command("import", short_help="Read a capture, find its ground, store both.")
@click.argument("path", type=click.Path(path_type=Path))
@options.option("info", bool, "Only print what PATH holds; write nothing.")
@options.option("lod", bool, "Cut a capture that is too large for the memory into chunks at "
                "several levels of detail (Streamed SOG); it is read once, part by part."
                )  # fmt: skip
@options.ground_options
@options.resume_option
@options.output_options("NAME-scene")
def import_(path, info, lod, **given):
    """Read a capture, find its ground, and write it as a scene folder.

    PATH is a trained model's folder (point_cloud/iteration_*/point_cloud.ply and cameras.json) or a
    splat file (PLY, compressed PLY, SPZ, SOG, .splat, .glb, USD) with cameras.json, transforms.json
    or a COLMAP model (sparse/0) beside it; or a scene with things that move, an actors.json. Writes
    splats.npz, scene.json, with actors actors.npz, and ground_frame.json. Put the folder where
    RAINSIM_SCENES points to use it by name. Prints the ground frame and, from the height map, what
    the captured colours are taken for, which --ground-albedo of `run` corrects.

    With --lod the folder holds chunks in place of splats.npz: a Streamed SOG.

    With --info it prints counts, degree of spherical harmonics, bounds, percentiles of opacity and
    scale, unusable splats and the memory needed; lengths are in the capture's own units.

    \b
    Example:
        rainsim import garden/ --camera-height 1.6 --out ~/scenes/garden
        rainsim import plaza.ply --up 0,0,1 --meters-per-unit 1
        rainsim import drive/actors.json --out ~/scenes/drive
        rainsim import city.ply --lod --cameras transforms.json --out ~/scenes/city
        rainsim import --info biker.spz
    """
    if info:
        from rainsim.scene.info import as_text, describe

        found = describe(path)
        options.echo(found, given["as_json"], as_text(found))
        return
    from rainsim.actors.actor_files import ACTORS_ARRAYS
    from rainsim.commands.cutting import cut_to_scene, require_cuttable
    from rainsim.config.settings import Config
    from rainsim.output_folder.record import Record
    from rainsim.scene.folder import import_scene, write_scene
    from rainsim.scene.ground import ground_frame_to_dict, write_ground_frame

    job = Job(given, base=Config())
    if lod:
        whole = require_cuttable(path)
    else:
        with job.status:
            job.load(path)
    name = path.stem if lod else job.scene.name
    out = job.out = job.out or Path(f"{options.plain(name)}-scene")
    with job.folder(path):
        if lod:
            with job.status:
                record = cut_to_scene(job, *whole)
        else:
            record = Record(out, job.scene, resume=job.resume)
            record.begin()
        scene = job.scene
        frame = scene.ground_frame
        write_scene(out, scene)
        write_ground_frame(out / GROUND_FRAME, frame, scene.source_hash)
        arrays = () if scene.pages is not None else ("splats.npz",)
        moving = (ACTORS_ARRAYS,) if scene.actors else ()
        record.add("scene.json", *arrays, *moving, GROUND_FRAME)
        record.write(complete=True)
        if scene.pages is None:
            job.scene = scene = import_scene(out)  # its map is kept for the runs of the folder
        calibration = _calibration(job)
    result = {
        "out": str(out), "name": scene.name, "splats": len(scene.splats),
        "cameras": [camera.name for camera in scene.cameras],
        "ground_frame": ground_frame_to_dict(frame),
        "calibration": calibration, "notes": list(scene.notes),
    }  # fmt: skip
    options.echo(result, job.as_json, _as_text(out, frame, calibration))


def _as_text(out, frame, calibration):
    """Return the ground frame, and what colours are taken for, as lines for a person."""

    def numbers(vector):
        return ", ".join(f"{v:.5f}" for v in vector)

    assumed = " (ASSUMED)" if frame.scale_assumed else ""
    lines = [
        f"up                {numbers(frame.up)}",
        f"x axis            {numbers(frame.rotation[0])}",
        f"metres per unit   {frame.meters_per_unit:.6g}{assumed}",
        f"origin            {numbers(frame.to_capture((0.0, 0.0, 0.0)))} (capture units)",
        f"confidence        {frame.confidence:.2f}",
    ]
    if calibration is not None:
        lines += [
            f"albedo            {calibration['note'].partition(': ')[2]}",
            f"zenith            {calibration['zenith']:.2f} x white, under clouds",
        ]
    return "\n".join([*lines, f"scene folder      {out}"])


def _calibration(job):
    """Return what the captured colours are taken for, None where no height map can be made."""
    from rainsim.compiling.uses import HEIGHTMAP
    from rainsim.shading.calibration import calibration_of

    with job.compiling([HEIGHTMAP]):
        try:
            terrain = job.extract_terrain()
        except RainsimError as error:
            job.status.say(f"  no height map, so what the colours stand for is not known: {error}")
            return None
        return calibration_of(job.scene, terrain)


@click.command(short_help="List the scenes known by name.")
@options.json_option
def scenes(as_json):
    """List the scenes that are known by name.

    They are looked up in the folders named by RAINSIM_SCENES and in the user's data folder; the
    built-in ones are generated stand-ins. street:300 and traffic:300 are streets of 300 m.

    \b
    Example:
        RAINSIM_SCENES=~/scenes rainsim scenes
    """
    from rainsim.scene.library import list_scenes

    rows = [{"name": n, "where": str(w), "built_in": bool(b)} for n, w, b in list_scenes()]
    lines = [f"{row['name']:<20} {row['where']}" for row in rows]
    lines.append("street:300, traffic:300  the same, 300 m long")
    options.echo(rows, as_json, "\n".join(lines))


@click.command(short_help="List the presets, or print one.")
@click.argument("name", required=False)
@options.option("keys", bool, "List every key of a preset file with its meaning.")
@options.json_option
def presets(name, keys, as_json):
    """List the presets, or print the preset NAME as a file to start your own from.

    \b
    Example:
        rainsim presets
        rainsim presets moderate > mine.toml
        rainsim presets --keys
    """
    from rainsim.config.settings import Config, preset_names, preset_text

    if keys:
        _list_keys(as_json)
        return

    if name is not None:
        settings_of = Config.from_preset(name).as_dict()
        click.echo(json.dumps(settings_of, indent=1) if as_json else preset_text(name), nl=as_json)
        return
    about = {n: _comment(preset_text(n)) for n in preset_names()}
    rates = {n: 3.6e6 * Config.from_preset(n).rain.rate for n in about}
    lines = [f"{n:<10}{rates[n]:3g} mm/h  {text}" for n, text in about.items()]
    options.echo(about, as_json, "\n".join(lines))


def _list_keys(as_json):
    from rainsim.config.tables import table

    names = ("key", "unit", "default", "choices", "in_keyframes", "meaning")
    rows = [dict(zip(names, row, strict=True)) for row in table()]
    lines = []
    for row in rows:
        value = "-" if row["default"] is None else f"{row['default']} {row['unit']}"
        choices = f" ({', '.join(row['choices'])})" if row["choices"] else ""
        lines.append(f"{row['key']:<24} {value:<14} {row['meaning']}{choices}")
    options.echo(rows, as_json, "\n".join(lines))


def _comment(text):
    """Return the comment at the head of a preset as one line."""
    lines = takewhile(lambda line: line.startswith("#"), text.splitlines())
    return " ".join(line.lstrip("# ") for line in lines)


@click.command(short_help="Compile once for this machine.")
@options.backend_option
@options.quiet_option
def warmup(backend, quiet):
    """Compile everything for this machine, once; later runs start at once.

    With `--backend cuda` this is everything that runs on a GPU need.

    \b
    Example:
        rainsim warmup
    """
    from rainsim.compiling.start import compile_here
    from rainsim.compiling.uses import ALL, ALL_CUDA, CAPTURE, SIMULATE

    status = Status(quiet)
    require_backend(backend)
    uses = (SIMULATE, CAPTURE, *ALL_CUDA) if backend == "cuda" else ALL
    with status, compiled_beside(status, uses) as pool:
        if pool is None:
            compile_here(uses, status.compiling)
        else:
            pool.join()
    status.say(f"ready ({status.seconds:.0f} s)")
