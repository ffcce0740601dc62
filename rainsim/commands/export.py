"""`rainsim export`: clear and rainy pictures with labels, in the layouts that loaders read."""

import math
from dataclasses import replace
from pathlib import Path

import click

from rainsim.commands import options
from rainsim.commands.compile import uses_of
from rainsim.commands.given import optics_of, require_backend
from rainsim.commands.job import Job
from rainsim.commands.options import FILE, PRESETS, group, option
from rainsim.datasets import LAYOUTS, SCANNED
from rainsim.errors import ParameterError, counted

DEFAULT_RAINS = "0,1,5,10,25,50"
MOST_RAINS = 64
ROUNDED = 1e-9  # by which the shape of a pixel may differ from rounding alone
MOST_LAYERS = 29  # AOVs of a picture's labels, and those of two that are being written

# fmt: off
_data_options = group(
    option("layout", click.Choice(LAYOUTS, case_sensitive=False),
           "Whose names, folders and encodings.", default="nerfstudio"),
    option("rain rains", str, "Rain rates in mm/h; 0 is the clear picture: the dry capture as it "
           "was taken. The preset's rate does not count.", "MM/H,MM/H", default=DEFAULT_RAINS),
    option("views", str, "Cameras of the capture: all, N of them evenly in their order, or by name "
           "(12, is the camera 12). All see one moment.", "all|N|NAME,NAME", default="all"),
    option("path", FILE, "A camera path instead, as `rainsim run` takes it: its views follow one "
           "another in time, and have flow.", "FILE"),
    options.shot_options,
    option("drive", bool, "The chosen views follow one another in time, and have flow."),
    option("fps", float, "Views per second with --drive.", shows=PRESETS),
    option("drive-speed", float, "Place the views of --drive by this speed along the path of the "
           "cameras: all that it has room for, or the first N of --views N.", "KM/H",
           shows="what views and --fps make"),
    option("hold-out", click.IntRange(0), "Hold out every N-th view to test and to validate, in "
           "turn; 0 holds none out.", "N",
           shows="8; of fewer than 16 views so that two are"),
    options.optics_options,
    option("lidar", click.Choice(("vlp16", "hdl32", "hdl64")), "Which lidar stands at the camera; "
           "with --layout kitti_object or semantic_kitti.", shows="hdl64"),
    option("rig", FILE, "Cameras and lidars on a vehicle that follows --drive or --path, each at "
           "its own times.", "FILE.toml"),
    option("partners", bool, "Of each rainy picture also the same without what falls, without "
           "drops on the glass, and dry: in the folder rainsim."),
    option("labels", click.Path(path_type=Path), "Your own ids: one for each splat, or masks named "
           "as the capture's cameras.", "FILE.npy|FOLDER"),
)
_size_options = group(
    option("width", int, "Width of the pictures in px.", "PX", shows="648"),
    option("height", int, "Height of the pictures in px; with --width the picture is cropped.",
           "PX", shows="the camera's shape"),
)
# fmt: on


@click.command(short_help="Write a data set: clear and rainy pictures with labels.")
@click.argument("scene", default="bicycle")
@_data_options
@options.preset_option
@options.shower_options
@options.light_options
@_size_options
@options.backend_option
@options.ground_options
@options.terrain_options
@options.resume_option
@options.output_options("rainsim-out/SCENE-LAYOUT")
def export(scene, layout, rains, **given):
    """Write a data set of SCENE: each view clear and in each rain, with labels.

    Labels: depth, range, classes of ground and water, puddles, splashes, wetness, masks of what
    rain spoils, weather; with --drive or --path optical flow. What a layout cannot hold lies beside
    it, in the folder rainsim. card.json and CARD.md say by which numbers it rained.

    \b
    Example:
        rainsim export bicycle --layout nerfstudio --rain 0,10,50 --views 24
        rainsim export street --layout kitti --drive --rain 0,25 --out street-kitti
    """
    rates = rains_of(rains)
    job = Job({**given, "frames": None})
    given, config, backend = job.given, job.config, job.backend
    if given["path"] is not None and (given["views"] != "all" or given["drive"]):
        raise ParameterError("--path is a sequence of its own; leave out --views and --drive")
    if given["drive_speed"] is not None:
        from rainsim.datasets.pace import check_speed

        check_speed(given["drive_speed"])
    if layout not in SCANNED and given["lidar"] is not None:
        raise ParameterError(
            f"--lidar is of --layout {' or '.join(SCANNED)}; give one, or leave it out"
        )
    from rainsim.sensors.optics import Optics

    optics, rig = optics_of(given) or Optics(), _rig(given, config, layout)
    if backend == "cuda":
        from rainsim.sensors.rolling import check_rows

        own = [] if rig is None else [sensor.readout for sensor in rig.cameras]
        check_rows(max(optics.readout, *own, 0.0), config)
    require_backend(backend)
    from rainsim.datasets.shots import FLOWS, LABELS

    uses = uses_of(scene, config, (*LABELS, *FLOWS), backend)
    with job.compiling(uses):
        job.load(scene)
        job.out = job.out or options.default_out(job.scene.name, layout)
        plan = _plan(job, _cameras(job), optics.lens, rates, layout, rig)
        card = _write(job, plan, layout, optics)
    job.finish(counted(card["pictures"], "picture"), card, more=f" ({job.status.seconds:.1f} s)")


def _rig(given, config, layout):
    """Return the `Rig` of --rig, None without one."""
    if given["rig"] is None:
        return None
    own = [key for key in ("lens", "rolling", "glass", "lidar", "width", "height") if given[key]]
    if own or not (given["drive"] or given["path"] is not None):
        raise ParameterError(
            f"--rig is given with --{own[0]}; the rig's file has the sensors; leave that out"
            if own
            else "--rig needs a way; it must follow --drive or --path; give one of them"
        )
    from rainsim.datasets.rig_shots import check_rig
    from rainsim.sensors.rig import read_rig

    rig = read_rig(given["rig"], config.fps)
    check_rig(rig, layout)
    return rig


def rains_of(text):
    """Return the rain rates [mm/h] of a text with commas, rising, each once."""
    from rainsim.config.rain_settings import MAX_RATE

    try:
        rates = sorted({float(part) for part in text.split(",")})
    except ValueError:
        rates = []
    good = rates and all(math.isfinite(r) and 0 <= r <= MAX_RATE for r in rates)
    if not good or len(rates) > MOST_RAINS:
        raise ParameterError(
            f"--rain is {text!r}; it must be up to {MOST_RAINS} rates from 0 to {MAX_RATE:g} mm/h "
            f"with commas, such as {DEFAULT_RAINS}; `rainsim presets` lists those of presets"
        )
    return tuple(rates)


def _cameras(job):
    """Return the data set's cameras, sized, in the capture frame."""
    from rainsim.commands.given import named_camera, shot_cameras, shot_in
    from rainsim.scene.cameras import read_cameras, resize_to
    from rainsim.surface.offered_views import with_offered_cameras

    given, config, scene = job.given, job.config, with_offered_cameras(job.scene)
    views = given["views"]
    if given["path"] is not None:
        shot = shot_in(given, config.fps)
        if shot is None:
            cameras = read_cameras(given["path"])
        else:
            cameras, notes = shot_cameras(shot, scene, given, config.fps)
            job.status.notes(notes)
    elif views == "all" or (given["drive_speed"] is not None and _number_of(views)):
        cameras = scene.cameras
    elif _number_of(views):
        count = min(int(views), len(scene.cameras))
        if count < int(views):
            job.status.say(f"WARNING: --views is {views}, the scene has {count} cameras: all are "
                           "taken; --drive-speed places more between them")  # fmt: skip
        step = len(scene.cameras) / count
        cameras = [scene.cameras[int((k + 0.5) * step)] for k in range(count)]
    else:
        names = views.removesuffix(",").split(",")
        cameras = [named_camera(scene, name.strip()) for name in names]
        for place, camera in enumerate(cameras):
            if any(camera is other for other in cameras[:place]):
                raise ParameterError(
                    f"--views names {camera.name} twice; each must be named once; leave one out"
                )
    sized = [resize_to(camera, config.width, config.height) for camera in cameras]
    return [as_square_as(*both) for both in zip(sized, cameras, strict=True)]


def as_square_as(sized, camera):
    """Return a camera that was sized with pixels of the shape that they had before.

    A height that is rounded to whole pixels squeezes them, by up to a part in a thousand; here less
    than half a row is cut off or added instead.
    """
    fy = sized.fx * (camera.fy / camera.fx)
    if abs(fy / sized.fy - 1) < ROUNDED:
        return sized
    middle = sized.height / 2
    return replace(sized, fy=fy, cy=middle + (sized.cy - middle) * fy / sized.fy)


def _number_of(views):
    """Return the number that --views is, None if it is none or written as none: 07."""
    is_number = views.isdecimal() and len(views) < 10 and views[0] != "0"
    return int(views) if is_number else None


def _plan(job, cameras, lens, rates, layout, rig=None):
    from rainsim.datasets.export import check_lenses, safe_names
    from rainsim.datasets.points import points_of
    from rainsim.datasets.sample import Plan, View
    from rainsim.datasets.splits import check_hold_out, held_out, split_note, usual_hold_out
    from rainsim.render.labels import class_names

    given, scene, fps = job.given, job.scene, job.config.fps
    sequence = given["drive"] or given["path"] is not None
    if sequence and len({(c.width, c.height) for c in cameras}) > 1:
        raise ParameterError(
            "the views of a sequence differ in size; all must be equal; give --width and --height"
        )
    cameras = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]
    if given["drive"]:
        cameras = _driven(job, cameras)
    every, turns = given["hold_out"], ()
    if every is None:
        every = usual_hold_out(len(cameras))
    check_hold_out(every, len(cameras), layout)
    if rig is not None:
        from rainsim.datasets.rig_shots import offset_notes, rig_views

        job.status.notes(offset_notes(rig, layout))
        views, turns = rig_views(rig, cameras, fps, layout)
    else:
        named = zip(safe_names(cameras), cameras, strict=True)
        views = [View(k, name, camera, lens) for k, (name, camera) in enumerate(named)]
    check_lenses(views, layout)
    views = held_out(views, every)
    job.status.notes([split_note(views, layout)])
    partners = ("clear_air", "dry") if given["partners"] else ()
    if partners and given["glass"] is not None:
        partners += ("no_glass",)
    return Plan(
        options.plain(scene.name), views, rates, sequence, *points_of(scene), class_names(),
        partners, 1 / fps if sequence else 0.0, rig, turns,
    )  # fmt: skip


def _driven(job, cameras):
    """Return the views of a drive, in the ground frame; say how fast it is, or refuse it."""
    from rainsim.datasets.pace import check_pace, pace_note, placed_by_speed

    fps, speed = job.config.fps, job.given["drive_speed"]
    assumed = job.scene.ground_frame.scale_assumed
    if speed is not None:
        cameras = placed_by_speed(cameras, speed, fps, _number_of(job.given["views"]))
    else:
        check_pace(cameras, fps, assumed)
    job.status.notes([pace_note(cameras, fps, assumed)])
    return cameras


def _write(job, plan, layout, optics):
    """Draw and write the data set; return its card."""
    from rainsim.datasets.export import DataSetFolder
    from rainsim.datasets.export import export as write_all
    from rainsim.datasets.shots import Shots
    from rainsim.io.files import card_in
    from rainsim.io.fingerprint import hash_of, hash_of_array
    from rainsim.output_folder.facts import scene_content, settings_content
    from rainsim.render.memory import memory_notes
    from rainsim.scene.cameras import cameras_to_data
    from rainsim.sensors.optics import Optics

    given, scene, config, status = job.given, job.scene, job.config, job.status
    user_labels = None
    if given["labels"] is not None:
        from rainsim.datasets.user_labels import read_labels

        user_labels = read_labels(given["labels"], scene, config.render)
    content = {
        "scene": scene_content(scene), "settings": settings_content(config),
        "rates": plan.rates, "sequence": plan.sequence, "backend": job.backend,
        "cameras": hash_of(cameras_to_data([view.camera for view in plan.views])),
        "names": [[view.name, view.held_out] for view in plan.views],
        "lens": str(plan.views[0].lens), "rolling": given["rolling"],
        "glass": given["glass"], "wiper": given["wiper"], "partners": given["partners"],
        "lidar": given["lidar"], "rig": None if plan.rig is None else plan.rig.facts(),
        "labels": None if user_labels is None else hash_of_array(user_labels.ids),
    }  # fmt: skip
    if optics.pane is not None:
        for view in plan.views:
            Optics(view.lens, optics.pane).drawn(view.camera)  # raises
    with job.folder(scene.source):
        kept = job.resume, job.overwrite
        folder = DataSetFolder(job.out, layout, plan, content, scene, *kept)
        if folder.kept:
            status.say(f"{len(folder.kept)} of {folder.count} pictures are finished and kept")
        terrain = job.extract_terrain()
        lidar = (given["lidar"] or "hdl64") if layout in SCANNED else None
        if plan.rig is not None:
            from rainsim.datasets.rig_shots import RigShots

            more = job.backend, user_labels, given["partners"]
            shots = RigShots(scene, terrain, plan, config, *more)
        else:
            shots = Shots(
                scene, terrain, plan.views, config, plan.sequence, job.backend, user_labels,
                optics.readout, optics.pane, given["partners"], lidar,
            )  # fmt: skip
        largest = max((shots.drawn_camera(v) for v in plan.views), key=lambda c: c.width * c.height)
        status.notes(memory_notes(scene, largest, terrain.bed.size, MOST_LAYERS))
        write_all(shots, folder, shots.config_of, status.progress)
    return card_in(folder.card_file)
