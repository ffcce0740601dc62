"""The commands that make frames: `run`, and its second and third stage, `simulate` and `render`."""

from __future__ import annotations

from pathlib import Path

import click

from rainsim.commands import options
from rainsim.commands.compile import compiled_beside, uses_of
from rainsim.commands.forecast import Forecast, exr_of, format_of
from rainsim.commands.given import (
    cameras_of,
    check_camera_options,
    first_frame,
    mask_of,
    masks_named,
    paths_in,
    require_backend,
    settings,
    view_on,
    water_mask_of,
)
from rainsim.commands.optics import content_of, drawn_camera, optics_of
from rainsim.commands.status import Status, loaded_scene
from rainsim.errors import InputError, ParameterError, counted

SIMULATION = "simulation.json"
VERSION = 1  # of simulation.json; those without a version are of version 1


@click.command(short_help="Draw a scene in the rain, from capture to frames.")
@options.scene_option
@options.preset_option
@options.rain_options
@options.light_options
@options.camera_options
@options.picture_options
@options.optics_options
@options.shutter_option
@options.big_options
@options.backend_option
@options.shared_range_options
@options.farm_options
@options.ground_options
@options.terrain_options
@options.ground_map_option
@options.mask_options
@options.resume_option
@options.output_options("rainsim-out/SCENE-PRESET")
def run(
    scene, preset, out, overwrite, resume, as_json, quiet, video, layers, backend, stale,
    class_mask, **given,
):  # fmt: skip
    """Draw a scene in the rain, all steps from a capture to frames.

    Writes DIR/frames/00000.png and so on, preview.webp, transforms.json (the frames' cameras) and
    provenance.json (command, settings, versions, ground frame, account of the water).

    \b
    Example:
        rainsim run
        rainsim run --scene garden/ --preset moderate --camera DSC07956
        rainsim run --scene garden/ --rain 50 --wind 4,90 --orbit --frames 48 --out wet
    """
    status = Status(quiet)
    config = settings(preset, given)
    video, exr, names, optics = _check_before_loading(given, config, video, layers, backend)
    mask, water = mask_of(class_mask), water_mask_of(given)
    uses = uses_of(scene, config, names, backend)
    with status, compiled_beside(status, uses, config.threads) as pool:
        loaded = loaded_scene(status, scene, given)
        cameras, config = cameras_of(loaded, config, given, say=status.notes)
        _say_moments(status, config)
        _require_memory(loaded, cameras, names, exr, optics, backend)  # without the map's cells
        out = out or options.default_out(loaded.name, Path(preset).stem)

        def film(config):
            from rainsim.pipeline import FrameSequence, ground_of

            tell = status.progress, status.notes
            ground = ground_of(loaded, config, cameras, backend, mask, *tell, water)
            path = view_on(loaded, ground, cameras, config, given, status)
            _say_memory(status, loaded, ground, path, names, exr, optics, backend)
            more = {"exr": exr, "optics": optics}
            return path, FrameSequence(loaded, ground, path, config, backend, names, **more)

        content = {"layers": names, "backend": backend, **masks_named(class_mask, given)}
        content |= content_of(exr, optics)
        files = {"out": out, "overwrite": overwrite, "resume": resume, "video": video}
        files |= {"stale": stale, "as_json": as_json, "farm": (given, backend, pool)}
        files["sources"] = [loaded.source, class_mask, *paths_in(given)]
        _write_frames(status, film, loaded, config, preset, content, **files)


@click.command(short_help="Let it rain on a height map.")
@click.argument("terrain", type=click.Path(path_type=Path))
@options.preset_option
@options.rain_options
@options.range_option
@options.resume_option
@options.output_options("rainsim-out/TERRAIN-PRESET-states")
def simulate(terrain, preset, out, overwrite, resume, threads, as_json, quiet, **given):
    """Let it rain on TERRAIN, a folder that `rainsim heightmap` wrote.

    Writes DIR/states/00000.npz and so on: water depth, flow, ripples and impacts at the time of
    each frame; and simulation.json with the settings, for `rainsim render`.

    \b
    Example:
        rainsim simulate rainsim-out/bicycle-terrain --preset downpour --out states
    """
    status = Status(quiet)
    config = settings(preset, {**given, "threads": threads})
    from rainsim.output_folder import claimed, relative
    from rainsim.render.memory import require_memory_of_water
    from rainsim.terrain.map_files import read_terrain

    ground = read_terrain(terrain)
    status.notes(require_memory_of_water(ground.bed.size))
    source = terrain if terrain.is_dir() else terrain.parent
    name = source.resolve().name.removesuffix("-terrain")
    out = out or options.default_out(name, Path(preset).stem, "states")
    from rainsim.compiling.uses import SIMULATE

    with (
        status,
        claimed(out, overwrite, resume, [terrain, *paths_in(given)]),
        compiled_beside(status, [SIMULATE], config.threads),
    ):
        _set_up(config)
        record, ledger = _write_states(status, ground, terrain, config, preset, out, resume)
    status.say(f"{counted(len(config.indices), 'water state')} in {relative(out)}")
    result = {"out": str(out), "states": record.files, "ledger": ledger}
    options.echo(result, as_json, str(out))


def _write_states(status, ground, terrain, config, preset, out, resume):
    """Simulate and write the states that are not finished yet; return the record and the ledger."""
    from rainsim import output_folder
    from rainsim.io.fingerprint import hash_of_file
    from rainsim.io.states import write_state
    from rainsim.pipeline import frames_of
    from rainsim.pipeline import simulate as simulate_water

    source = terrain if terrain.is_dir() else terrain.parent
    map_file = source / "terrain.npz" if terrain.is_dir() else terrain
    origin = output_folder.read_record(source).get("input")
    facts = output_folder.settings_facts(config, preset)
    content = {
        "settings": output_folder.settings_content(config), "terrain": hash_of_file(map_file),
    }  # fmt: skip
    record = output_folder.Record(out, None, content, **facts, terrain_input=origin)
    part, kinds = output_folder.STATE, output_folder.STATE_FACTS
    kept = record.resume(config.indices, part, kinds) if resume else {}
    ledgers = {index: entry["ledger"] for index, entry in kept.items()}
    if kept:
        status.say(f"{len(kept)} of {len(config.indices)} states are finished and kept")
    water = simulate_water(ground, config)
    for state in frames_of(water, config, status.progress, kept):
        if not record.files:  # now that there is something to write
            _write_simulation(out, source, map_file, record, config, preset, origin)
        status.notes(state.notes)
        name = part.format(state.index)
        write_state(out / name, state)
        ledgers[state.index] = state.ledger
        host = output_folder.host_facts()
        record.journal.add(
            state.index, [name], ledger=state.ledger, notes=list(state.notes), host=host
        )
        status.progress("simulate frames", len(ledgers), len(config.indices))
    if not record.files:
        _write_simulation(out, source, map_file, record, config, preset, origin)
    record.add(output_folder.JOURNAL, *(part.format(index) for index in config.indices))
    ledger = ledgers[max(ledgers)]
    record.write(complete=True, ledger=ledger)
    return record, ledger


def _write_simulation(out, source, map_file, record, config, preset, origin):
    """Begin to write; write what `render` needs besides the states: settings, map, ground frame."""
    from rainsim.config.preset_files import SKIES
    from rainsim.io.files import named_path, path_named, replacing, write_json

    record.begin()
    (out / "states").mkdir(exist_ok=True)
    copied = {"terrain.npz": map_file}
    if (source / "ground_frame.json").is_file():
        copied["ground_frame.json"] = source / "ground_frame.json"
    for name, path in copied.items():
        if path.resolve() != (out / name).resolve():
            with replacing(out / name) as temporary:
                temporary.write_bytes(path.read_bytes())
    settings = config.as_dict()
    if config.render.sky not in SKIES:
        settings["render"]["sky"] = named_path(config.render.sky, out)
    if isinstance(origin, dict) and isinstance(origin.get("source"), str):
        origin = {**origin, "source": named_path(path_named(origin["source"], source), out)}
    facts = {"rainsim_simulation": VERSION, "preset": str(preset), "settings": settings}
    write_json(out / SIMULATION, {**facts, "input": origin})
    record.add(SIMULATION, *copied)
    record.write(complete=False)


@click.command(short_help="Draw frames from simulated water.")
@click.argument("states", type=options.FOLDER)
@options.option("scene -s", str, "The capture to draw.", "NAME|PATH",
                "the one that the states were made for")  # fmt: skip
@options.light_options
@options.camera_options
@options.picture_options
@options.optics_options
@options.shutter_option
@options.big_options
@options.backend_option
@options.shared_range_options
@options.farm_options
@options.ground_options
@options.resume_option
@options.output_options("rainsim-out/STATES-frames")
def render(
    states, scene, out, overwrite, resume, as_json, quiet, video, layers, backend, stale, **given
):  # fmt: skip
    """Draw frames from STATES, a folder that `rainsim simulate` wrote, for any camera.

    The drops in the air follow from the seed. The rain is that of the simulation; light, camera and
    size can be chosen here.

    \b
    Example:
        rainsim render states --orbit --width 960 --out frames
    """
    from rainsim.io.files import path_named
    from rainsim.output_folder import states_content

    status = Status(quiet)
    made = read_simulation(states)
    config = settings(None, given, base=made["config"])
    video, exr, names, optics = _check_before_loading(given, config, video, layers, backend)
    origin = made["origin"]
    if scene is None and origin["source"]:
        scene = str(path_named(origin["source"], states))
    scene = scene or origin["scene"]
    if scene is None:
        raise ParameterError(
            f"{states} does not say which scene it was made for; one is needed; give --scene"
        )
    ground = ("up", "meters_per_unit", "camera_height", "ground_frame")
    frame_file = states / "ground_frame.json"
    if all(given.get(name) is None for name in ground) and frame_file.is_file():
        given["ground_frame"] = frame_file  # the very frame of the height map
    with status:
        loaded = loaded_scene(status, scene, given)
    if origin["sha256"] not in (None, "", loaded.source_hash):
        raise InputError(
            f"the states in {states} were made for other splats than scene {loaded.name}; both "
            "must be of one capture; give the right --scene, or simulate again"
        )
    cameras, config = cameras_of(loaded, config, given, config.frames, status.notes)
    _say_moments(status, config)
    out = out or options.default_out(states.resolve().name, "frames")

    def film(config):
        from rainsim.io.states import read_state
        from rainsim.pipeline import FrameSequence
        from rainsim.terrain.map_files import read_terrain

        ground = read_terrain(states)
        path = view_on(loaded, ground, cameras, config, given, status)
        _say_memory(status, loaded, ground, path, names, exr, optics, backend)

        def state_of(index):
            return read_state(_state_file(states, index), ground)

        more = {"states": state_of, "exr": exr, "optics": optics}
        return path, FrameSequence(loaded, ground, path, config, backend, names, **more)

    for index in config.indices:
        _state_file(states, config.moment(index))
    preset = made["preset"]
    content = {"layers": names, "backend": backend, "states": states_content(states)}
    content |= content_of(exr, optics)
    files = {"out": out, "overwrite": overwrite, "resume": resume, "video": video}
    files["sources"] = [states, loaded.source, *paths_in(given)]
    uses = uses_of(loaded.source or loaded.name, config, names, backend)
    with status, compiled_beside(status, uses, config.threads) as pool:
        files |= {"stale": stale, "as_json": as_json, "farm": (given, backend, pool)}
        _write_frames(status, film, loaded, config, preset, content, **files)


def _state_file(states, index):
    path = states / f"states/{index:05d}.npz"
    if not path.is_file():
        raise InputError(
            f"{path} does not exist; each frame needs its state; simulate more frames or give a "
            "--frame-range of those that there are"
        )
    return path


def read_simulation(states):
    """Return what simulation.json holds, with its settings as a Config under "config"."""
    from rainsim.config.preset_files import SKIES
    from rainsim.config.settings import Config
    from rainsim.io.files import path_named, read_json

    path = states / SIMULATION
    if states.is_dir() and not path.is_file():
        raise InputError(
            f"{states} has no {SIMULATION}; it must be a folder that `rainsim simulate` wrote"
        )
    made = read_json(path, "a simulation")
    remedy = "`rainsim simulate` writes it; simulate again"
    if not isinstance(made, dict) or made.get("rainsim_simulation", 1) != VERSION:
        raise InputError(f"{path} is no simulation of version {VERSION}; {remedy}")
    try:
        render = made["settings"]["render"]
        if isinstance(render.get("sky"), str) and render["sky"] not in SKIES:
            render["sky"] = str(path_named(render["sky"], states))
        config = Config.from_dict(made["settings"])
    except (AttributeError, KeyError, TypeError, ParameterError) as error:
        raise InputError(f"{path} has no usable settings ({error}); {remedy}") from None
    return {"config": config, "preset": str(made.get("preset", "")), "origin": _origin(made, path)}


def _origin(made, path):
    """Return scene, source and hash of the capture that states were made for, each text or None."""
    facts = made.get("input") or {}
    names = ("scene", "source", "sha256")
    found = {name: facts.get(name) for name in names} if isinstance(facts, dict) else {"scene": 0}
    if not all(value is None or isinstance(value, str) for value in found.values()):
        raise InputError(f"{path} names its scene by what is no text; give --scene, or correct it")
    return found


# --- what run and render share --------------------------------------------------------------------


def _check_before_loading(given, config, video, layers, backend):
    """Return formats of video and EXR, layers and optics; raise for what could only fail later."""
    check_camera_options(given)
    _check_farm(given)
    require_backend(backend)
    start = round(first_frame(given, config.fps))
    video = format_of(video, given, start)
    from rainsim.render.aov import parse_names

    exr, names = exr_of(given, config.fps, parse_names(layers), start, video)
    return video, exr, names, optics_of(given, backend, names, exr, config)


def _check_farm(given):
    """Raise if the options of workers contradict each other or their engine is lacking."""
    ways = [n for n in ("workers", "scheduler", "frame_range") if given.get(n) is not None]
    if len(ways) > 1:
        one, other = (f"--{name.replace('_', '-')}" for name in ways[:2])
        raise ParameterError(
            f"{one} and {other} are both given; frames must be shared out in one way; leave one out"
        )
    if ways and ways != ["frame_range"]:
        from rainsim.farm.cluster import require

        require()


def _require_memory(scene, cameras, names, exr, optics, backend):
    """Raise ParameterError before minutes of work if the frames' size alone is too much."""
    from rainsim.backend import free_device_memory
    from rainsim.render.memory import layers_held, require_memory

    free, layers = free_device_memory(backend), layers_held(names, exr, optics)
    require_memory(scene, drawn_camera(cameras[0], optics), layers=layers, device_free=free)


def _say_memory(status, scene, terrain, cameras, names, exr, optics, backend):
    """Say what the frames take, if it is much; raise ParameterError if it is too much."""
    from rainsim.backend import free_device_memory
    from rainsim.render.memory import layers_held, memory_notes

    free, layers = free_device_memory(backend), layers_held(names, exr, optics)
    status.notes(memory_notes(scene, drawn_camera(cameras[0], optics), terrain.cells, layers, free))


def _say_moments(status, config):
    """Say which times of the rain frames show, if a path says so."""
    if config.moments:
        first, last = (moment / config.fps for moment in (config.moments[0], config.moments[-1]))
        status.notes([
            f"frames show the rain from {first:g} to {last:g} s, as render_time of the path says"
        ])  # fmt: skip


def _write_frames(
    status, film, scene, config, preset, content, *,
    out, overwrite, resume, sources, video, stale, farm, as_json,
):  # fmt: skip
    """Draw frames into the folder `out` and say how it went.

    `film(config)` returns the cameras and the `FrameSequence`; `content` is what the frames depend
    on besides scene, settings and cameras; `farm` is the options, the backend and the `Pool` that
    compiles.
    """
    from dataclasses import replace

    from rainsim import output_folder
    from rainsim.farm.shared_run import joined
    from rainsim.render.frame_files import FRAME, mean_milliseconds

    shared = config.frame_range is not None and not overwrite
    with joined(out) if shared else output_folder.claimed(out, overwrite, resume, sources):
        _set_up(config)
        facts = output_folder.settings_facts(config, preset)
        content["settings"] = output_folder.settings_content(config)
        cameras, sequence = film(replace(config, frame_range=None) if shared else config)
        facts |= {"optics": content["optics"]} if "optics" in content else {}
        record = output_folder.Record(
            out, scene, content, **facts, cameras=output_folder.cameras_facts(cameras)
        )
        run = out, record, cameras, config, video
        forecast = Forecast(status, *run)
        if farm[0].get("workers") or farm[0].get("scheduler"):
            reports = _draw_with_workers(forecast, sequence, run, resume, *farm)
        elif shared:
            reports = _draw_shared(forecast, sequence, run, stale)
        else:
            reports = _draw_alone(forecast, sequence, run, resume)
    total = counted(len(config.indices), "frame")
    also = " and one OpenEXR file for each in exr" if "exr" in content else ""
    status.say(f"{total} in {output_folder.relative(out)}/frames{also} ({status.seconds:.1f} s)")
    result = {
        "out": str(out),
        "frames": [FRAME.format(report.index) for report in reports],
        "seconds": round(status.seconds, 3),
        "milliseconds": mean_milliseconds(reports),
        "ledger": reports[-1].ledger,
        "notes": [*scene.notes, *scene.ground_frame.notes],
    }
    options.echo(result, as_json, str(out))


def _draw_alone(status, sequence, run, resume):
    """Draw the frames that are missing in a folder of this run alone; return all reports."""
    from rainsim.output_folder import FrameFolder

    indices = sequence.config.indices
    with FrameFolder(*run, resume) as folder:
        if folder.kept:
            status.say(f"{len(folder.kept)} of {len(indices)} frames are finished and kept")
        missing = [index for index in indices if index not in folder.kept]
        tell = _then_frames(status, len(indices), folder.done)
        for picture, report in sequence.frames(missing, tell):
            status.notes(report.notes)
            folder.add(picture, report)
            status.progress("frames", folder.done, len(indices))
    return folder.reports


def _draw_shared(status, sequence, run, stale):
    """Draw frames of a folder that other processes fill too; return the reports of the range."""
    from rainsim.farm.shared_run import SharedRun

    shared = SharedRun(*run, stale)
    reports = shared.draw(sequence, _then_frames(status, len(run[3].indices)), status.notes)
    left = shared.left
    if left:
        status.say(f"{left} of {sequence.config.frames} frames are still to be drawn elsewhere")
    return reports


def _draw_with_workers(status, sequence, run, resume, given, backend, pool):
    """Draw frames by workers of dask.distributed; return all reports."""
    from rainsim.farm.cluster import client_of, draw_with_workers

    threads, address = sequence.config.threads, given.get("scheduler")
    if address is None and pool is not None:
        pool.join()  # once for all of them
    with client_of(address, given.get("workers"), backend, threads) as client:
        threads = None if address is None else threads  # the workers here share them
        return draw_with_workers(client, sequence, run, resume, status, threads)


def _then_frames(status, total, kept=0):
    def progress(stage, done, all_of_it):
        status.progress(stage, done, all_of_it)
        if stage != "frames" and done == all_of_it:  # what follows unannounced is the first frame
            status.progress("frames", kept, total)

    return progress


def _set_up(config):
    from rainsim.jit import set_threads

    set_threads(config.threads)
