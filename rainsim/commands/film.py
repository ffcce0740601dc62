"""The commands that make frames: `run`, and its second and third stage, `simulate` and `render`."""

from dataclasses import replace
from pathlib import Path

import click

from rainsim.commands import given as inputs
from rainsim.commands import options
from rainsim.commands.compile import uses_of
from rainsim.commands.forecast import Forecast, exr_of, format_of
from rainsim.commands.job import Job
from rainsim.errors import InputError, ParameterError, counted

SIMULATION = "simulation.json"
VERSION = 1  # of simulation.json; those without a version are of version 1
LATE = 1e-6  # s by which a state may be beside its frame's time


@click.command(cls=options.Grouped, short_help="Draw a scene in the rain, from capture to frames.")
@click.argument("place", metavar="[SCENE]", required=False)
@options.run_options
def run(place, scene, **given):
    """Draw SCENE in the rain, all steps from a capture to frames.

    SCENE is a name from `rainsim scenes`, a trained model's folder, a splat file or a scene folder;
    without it the built-in bicycle is drawn.

    Writes DIR/frames/00000.png and so on, preview.webp, transforms.json (the frames' cameras) and
    provenance.json (command, settings, versions, ground frame, account of the water).

    \b
    Example:
        rainsim run
        rainsim run garden/ --preset moderate --camera DSC07956
        rainsim run garden/ --rain 50 --wind 4,90 --orbit --frames 48 --out wet
    """
    if place and scene:
        raise ParameterError(f"SCENE {place} and --scene {scene} are both given; leave one out")
    scene = place or scene or "bicycle"
    job = FilmJob(given)
    masks = job.read_masks()
    with job.compiling(uses_of(scene, job.config, job.layers, job.backend)):
        job.load(scene)
        job.find_cameras()
        job.memory_notes(job.cameras)  # raises; the map's cells come later
        job.out = job.out or options.default_out(job.scene.name, Path(job.preset).stem)

        def frames(config):
            from rainsim.pipeline import ground_of

            tell = job.status.progress, job.status.notes
            mask, water = masks
            ground = ground_of(job.scene, config, job.cameras, job.backend, mask, *tell, water)
            return job.frames(ground, config)

        job.write(frames, inputs.masks_named(given), job.scene.source)


@click.command(short_help="Let it rain on a height map.")
@click.argument("terrain", type=click.Path(path_type=Path))
@options.preset_option
@options.rain_options
@options.range_option
@options.resume_option
@options.output_options("rainsim-out/TERRAIN-PRESET-states")
def simulate(terrain, **given):
    """Let it rain on TERRAIN, a folder that `rainsim heightmap` wrote.

    Writes DIR/states/00000.npz and so on: water depth, flow, ripples and impacts at the time of
    each frame; and simulation.json with the settings, for `rainsim render`.

    \b
    Example:
        rainsim simulate rainsim-out/bicycle-terrain --preset downpour --out states
    """
    from rainsim.compiling.uses import SIMULATE
    from rainsim.render.memory import require_memory_of_water
    from rainsim.terrain.map_files import read_terrain

    job = Job(given)
    ground = read_terrain(terrain)
    job.status.notes(require_memory_of_water(ground.bed.size))
    source = terrain if terrain.is_dir() else terrain.parent
    name = source.resolve().name.removesuffix("-terrain")
    job.out = job.out or options.default_out(name, Path(job.preset).stem, "states")
    with job.folder(terrain), job.compiling([SIMULATE]):
        map_file = source / "terrain.npz" if terrain.is_dir() else terrain
        record, ledger = _write_states(job, ground, source, map_file)
    states = counted(len(job.config.indices), "water state")
    job.finish(states, {"states": record.files, "ledger": ledger})


def _write_states(job, ground, source, map_file):
    """Simulate and write the states that are not finished yet; return the record and the ledger."""
    from rainsim.io.fingerprint import hash_of_file
    from rainsim.io.states import write_state
    from rainsim.output_folder.facts import host_facts, settings_content, settings_facts
    from rainsim.output_folder.names import JOURNAL, STATE, STATE_FACTS, read_record
    from rainsim.output_folder.record import Record
    from rainsim.pipeline import frames_of
    from rainsim.pipeline import simulate as simulate_water

    config, status = job.config, job.status
    content = {
        "settings": settings_content(config), "terrain": hash_of_file(map_file),
    }  # fmt: skip
    origin = read_record(source).get("input")
    facts = settings_facts(config, job.preset)
    record = Record(job.out, None, content, **facts, terrain_input=origin)
    kept = record.resume(config.indices, STATE, STATE_FACTS) if job.resume else {}
    ledgers = {index: entry["ledger"] for index, entry in kept.items()}
    if kept:
        status.say(f"{len(kept)} of {len(config.indices)} states are finished and kept")
    water = simulate_water(ground, config)
    for state in frames_of(water, config, status.progress, kept):
        if not record.files:  # now that there is something to write
            _write_simulation(job, record, source, map_file, origin)
        status.notes(state.notes)
        name = STATE.format(state.index)
        write_state(job.out / name, state, ground)
        ledgers[state.index] = state.ledger
        facts = {"ledger": state.ledger, "notes": list(state.notes), "host": host_facts()}
        record.journal.add(state.index, [name], **facts)
        status.progress("simulate frames", len(ledgers), len(config.indices))
    if not record.files:
        _write_simulation(job, record, source, map_file, origin)
    record.add(JOURNAL, *(STATE.format(index) for index in config.indices))
    ledger = ledgers[max(ledgers)]
    record.write(complete=True, ledger=ledger)
    return record, ledger


def _write_simulation(job, record, source, map_file, origin):
    """Begin to write; write what `render` needs besides the states: settings, map, ground frame."""
    from rainsim.config.preset_files import SKIES
    from rainsim.io.files import named_path, path_named, replacing, write_json
    from rainsim.io.fingerprint import hash_of_file

    record.begin()
    out, config = job.out, job.config
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
    facts = {"rainsim_simulation": VERSION, "preset": str(job.preset), "settings": settings}
    facts["sha256"] = {name: hash_of_file(path) for name, path in copied.items()}
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
@options.shared_range_option
@options.farm_options
@options.ground_options
@options.resume_option
@options.output_options("rainsim-out/STATES-frames")
@options.verbose_option
def render(states, scene, **given):
    """Draw frames from STATES, a folder that `rainsim simulate` wrote, for any camera.

    The drops in the air follow from the seed. The rain is that of the simulation; light, camera and
    size can be chosen here.

    \b
    Example:
        rainsim render states --orbit --width 960 --out frames
    """
    from rainsim.io.files import path_named
    from rainsim.output_folder.facts import states_content

    made = read_simulation(states)
    job = FilmJob(given, base=made["config"])
    _require_own_files(states, made["sha256"])
    job.preset, origin = made["preset"], made["origin"]
    if scene is None and origin["source"]:
        scene = str(path_named(origin["source"], states))
    scene = scene or origin["scene"]
    if scene is None:
        raise ParameterError(
            f"{states} does not say which scene it was made for; one is needed; give --scene"
        )
    ground = ("up", "meters_per_unit", "camera_height", "ground_frame")
    frame_file = states / "ground_frame.json"
    if all(given[name] is None for name in ground) and frame_file.is_file():
        job.given["ground_frame"] = frame_file  # the very frame of the height map
    with job.status:
        job.load(scene)
    loaded = job.scene
    if origin["sha256"] not in (None, "", loaded.source_hash):
        raise InputError(
            f"the states in {states} were made for other splats than scene {loaded.name}; both "
            "must be of one capture; give the right --scene, or simulate again"
        )
    job.find_cameras()
    job.out = job.out or options.default_out(states.resolve().name, "frames")
    for index in job.config.indices:
        _state_file(states, job.config.moment(index))

    def frames(config):
        from rainsim.terrain.map_files import read_terrain

        ground, folder = read_terrain(states), states.resolve()  # workers are elsewhere
        fps = made["config"].fps
        return job.frames(ground, config, lambda index: _state_of(folder, index, fps, ground))

    with job.compiling(uses_of(loaded.source or loaded.name, job.config, job.layers, job.backend)):
        job.write(frames, {"states": states_content(states)}, states, loaded.source)


def _require_own_files(states, hashes):
    """Raise InputError unless map and ground frame beside states are those they were made with.

    `hashes` are what simulation.json says, {} in older ones.
    """
    from rainsim.io.fingerprint import hash_of_file

    for name in ("terrain.npz", "ground_frame.json"):
        path = states / name
        if name in hashes and path.is_file() and hash_of_file(path) != hashes[name]:
            raise InputError(
                f"{path} is not the file that the states beside it were made with; water lies on "
                "its own map only; copy it back, or simulate again"
            )


def _state_of(states, index, fps, ground):
    """Return the state of a frame, which must be of its time at `fps` frames/s, and of `ground`."""
    from rainsim.io.states import read_state

    path = _state_file(states, index)
    state = read_state(path, ground)
    if state.index != index or abs(state.time - index / fps) > LATE:
        raise InputError(
            f"{path} is frame {state.index} at {state.time:g} s; it must be frame {index} at "
            f"{index / fps:g} s, as {SIMULATION} has it; simulate again"
        )
    return state


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
    hashes = made.get("sha256")
    return {
        "config": config, "preset": str(made.get("preset", "")), "origin": _origin(made, path),
        "sha256": hashes if isinstance(hashes, dict) else {},
    }  # fmt: skip


def _origin(made, path):
    """Return scene, source and hash of the capture that states were made for, each text or None."""
    facts = made.get("input") or {}
    names = ("scene", "source", "sha256")
    found = {name: facts.get(name) for name in names} if isinstance(facts, dict) else {"scene": 0}
    if not all(value is None or isinstance(value, str) for value in found.values()):
        raise InputError(f"{path} names its scene by what is no text; give --scene, or correct it")
    return found


# --- what run and render share --------------------------------------------------------------------


class FilmJob(Job):
    """A job that draws frames: their cameras, and the files that they are written to.

    All that can be known to fail is refused before a scene is loaded. `video` and `exr` are the
    formats of files besides the frames, `layers` the names of the layers that frames need.
    """

    def __init__(self, given, base=None):
        super().__init__(given, base)
        from rainsim.output_folder.claims import require_empty

        if given.get("workers") or given.get("scheduler"):
            from rainsim.farm import cluster

            cluster.require()
        if self.out is not None:
            shared = given.get("frame_range") is not None
            require_empty(self.out, self.overwrite or self.resume or shared)
        inputs.require_backend(self.backend)
        start = round(inputs.first_frame(given, self.config.fps))
        self.video = format_of(given, start)
        from rainsim.render.aov import parse_names

        names = parse_names(given["layers"])
        self.exr, self.layers = exr_of(given, self.config.fps, names, start)
        self.optics = inputs.optics_of(given)
        if self.optics is not None:
            self.optics.check(self.backend, self.layers, self.exr, self.config)

    def find_cameras(self):
        """Find the frames' cameras; say which times of the rain they see if their path says so."""
        super().find_cameras()
        if moments := self.config.moments:
            first, last = (moments[k] / self.config.fps for k in (0, -1))
            rain = f"the rain from {first:g} to {last:g} s"
            self.status.notes([f"frames show {rain}, as render_time of the path says"])

    def memory_notes(self, cameras, cells=0):
        """Return a note on the memory that frames take, if it is much, or raise ParameterError."""
        from rainsim.backend import free_device_memory
        from rainsim.render.memory import layers_held, memory_notes

        layers = layers_held(self.layers, self.exr, self.optics)
        camera = cameras[0] if self.optics is None else self.optics.drawn(cameras[0])
        return memory_notes(self.scene, camera, cells, layers, free_device_memory(self.backend))

    def frames(self, ground, config, states=None):
        """Return the `FrameSequence` on a ground; `states` are those of the water, if simulated."""
        from rainsim.pipeline import FrameSequence

        cameras = inputs.view_on(self.scene, ground, self.cameras, config, self.given, self.status)
        self.tell_ground(ground)
        self.status.notes(self.memory_notes(cameras, ground.cells))
        return FrameSequence(
            self.scene, ground, cameras, config, self.backend, self.layers, states, self.exr,
            self.optics,
        )  # fmt: skip

    def write(self, frames, content, *sources):
        """Draw frames into the output folder and say how it went.

        `frames(config)` returns the `FrameSequence`; `content` is what they depend on besides
        scene, settings, cameras and what this job writes; `sources` are read besides what options
        name.
        """
        from rainsim.output_folder.facts import cameras_facts, settings_content, settings_facts
        from rainsim.output_folder.record import Record
        from rainsim.render.frame_files import FRAME, mean_milliseconds

        config, status = self.config, self.status
        content |= {"layers": self.layers, "backend": self.backend}
        if self.exr is not None:
            content["exr"] = self.exr.content
        if self.optics is not None:
            content["optics"] = self.optics.facts
        shared = config.frame_range is not None and not self.overwrite
        with self.folder(*sources, shared=shared):
            facts = settings_facts(config, self.preset)
            content["settings"] = settings_content(config)
            sequence = frames(replace(config, frame_range=None) if shared else config)
            if self.optics is not None:
                facts["optics"] = self.optics.facts
            facts["cameras"] = cameras_facts(sequence.cameras)
            record = Record(self.out, self.scene, content, **facts)
            record.facts["stages"] = status.spent  # seconds, as far as stages are over
            run = self.out, record, sequence.cameras, config, self.video
            forecast, given = Forecast(status, self.out), self.given
            if given.get("workers") or given.get("scheduler"):
                farm = given, self.backend, self.pool
                reports = _draw_with_workers(forecast, sequence, run, self.resume, *farm)
            elif shared:
                reports = _draw_shared(forecast, sequence, run, self.resume)
            else:
                reports = _draw_alone(forecast, sequence, run, self.resume)
        result = {
            "frames": [FRAME.format(report.index) for report in reports],
            "seconds": round(status.seconds, 3),
            "stages": status.spent,
            "milliseconds": mean_milliseconds(reports),
            "ledger": reports[-1].ledger,
            "notes": [*self.scene.notes, *self.scene.ground_frame.notes],
        }
        also = " and one OpenEXR file for each in exr" if self.exr is not None else ""
        total = counted(len(config.indices), "frame")
        self.finish(total, result, more=f"/frames{also} ({status.in_stages()})")


def _draw_alone(status, sequence, run, resume):
    """Draw the frames that are missing in a folder of this run alone; return all reports."""
    from rainsim.output_folder.frames import FrameFolder

    indices = sequence.config.indices
    with FrameFolder(*run, resume, sequence.backend == "cuda") as folder:
        if folder.kept:
            status.say(f"{len(folder.kept)} of {len(indices)} frames are finished and kept")
        missing = [index for index in indices if index not in folder.kept]
        tell = _then_frames(status, len(indices), folder.done)
        for picture, report in sequence.frames(missing, tell):
            status.notes(report.notes)
            folder.add(picture, report)
            status.progress("frames", folder.done, len(indices))
        status.count("writing")
    return folder.reports


def _draw_shared(status, sequence, run, resume):
    """Draw frames of a folder that other processes fill too; return the reports of the range."""
    from rainsim.farm.shared_run import SharedRun

    shared = SharedRun(*run, resume)
    reports = shared.draw(sequence, _then_frames(status, len(run[3].indices)), status.notes)
    left = shared.complete()
    if left:
        status.say(f"{left} of {sequence.config.frames} frames are left to other ranges; with the "
                   "last come preview.webp and transforms.json")  # fmt: skip
    return reports


def _draw_with_workers(status, sequence, run, resume, given, backend, pool):
    """Draw frames by workers of dask.distributed; return all reports."""
    from rainsim.farm.cluster import client_of, draw_with_workers

    threads, address = sequence.config.threads, given.get("scheduler")
    if address is None and pool is not None:
        pool.join()  # once for all of them
    with client_of(address, given.get("workers"), backend, threads) as client:
        return draw_with_workers(client, sequence, run, resume, status, threads)


def _then_frames(status, total, kept=0):
    def progress(stage, done, all_of_it):
        status.progress(stage, done, all_of_it)
        if stage != "frames" and done == all_of_it:  # what follows unannounced is the first frame
            status.progress("frames", kept, total)

    return progress
