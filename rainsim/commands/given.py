"""Settings, scene and cameras from the options of a command."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from rainsim.errors import ParameterError

DEFAULT_FOV = 60.0  # degrees
DEFAULT_WIDTH = 648  # px, of cameras placed by hand
DEFAULT_SHAPE = 1.5  # width / height of cameras placed by hand
MOST_SHOWN = 8  # names of cameras in an error message
AS_THEY_ARE = ("frame_range", "threads")  # options that no preset file has
CAMERA_WAYS = ("camera", "path", "orbit", "drive", "eye")
ONE_OF = (  # options of which one at most may be given, and what they choose
    (CAMERA_WAYS, "the camera"),
    (("known_length", "meters_per_unit"), "the scale"),
    (("known_length", "camera_height"), "the scale"),
    (("workers", "scheduler", "frame_range"), "who draws which frames"),
    (("fov", "ortho_height"), "the size of the picture"),
)
NEEDS = {  # options that say nothing without another, and what both are about
    "eye": ("look_at", "a camera placed by hand"),
    "look_at": ("eye", "a camera placed by hand"),
    "fov": ("eye", "a camera placed by hand"),
    "video_codec": ("video", "a video"),
    "video_quality": ("video", "a video"),
    "exr_name": ("exr", "OpenEXR files"),
    "colorspace": ("exr", "OpenEXR files"),
    "wiper": ("glass", "drops on glass"),
    "drive_speed": ("drive", "the capture's own cameras in their order"),
}


def require_backend(backend):
    """Raise BackendError before any work where a backend cannot run."""
    if backend == "cuda":
        from rainsim.cuda import require

        require()


def settings(preset, given, base=None):
    """Return the checked Config of a preset with the options that were given on top.

    Without a preset `base` is taken. `given` has values in the command line's units by option name;
    None is not given. A path that is given as `cameras` stands under `path` afterwards.
    """
    from rainsim.config.settings import Config
    from rainsim.config.tables import OPTION_KEYS

    changes = {}
    for name, value in given.items():
        if value is None:
            continue
        if name in OPTION_KEYS:
            attribute, value = _in_si(OPTION_KEYS[name], value)
            changes[attribute] = value
        elif name in AS_THEY_ARE:
            changes[name] = value
    if "height" in changes:
        changes.setdefault("width", None)  # follows from the camera's shape
    config = Config.from_preset(preset) if base is None else base
    config = config.replace(**changes)
    _shot_as_path(given)
    if base is None and given.get("fps") is None:
        shot = shot_in(given, config.fps)
        if shot is not None and shot.fps:
            config = config.replace(fps=shot.fps)
    has_path = bool(given.get("path") or given.get("drive"))
    if base is None and config.frame_range and "frames" not in changes and has_path:
        # The path's length is known once it is read: `cameras_of` checks the range by it.
        config = config.replace(frames=max(config.frames, config.frame_range[1]))
    return config.check()


def _shot_as_path(given):
    """Take a --cameras that is a `Shot` as the --path of a command that has one."""
    from rainsim.scene.shot import is_shot

    cameras = given.get("cameras")
    if "path" in given and isinstance(cameras, Path) and is_shot(cameras):
        if given["path"] is not None:
            raise ParameterError(
                f"--cameras {cameras.name} is a path and --path is given, too; the path must be "
                "given in one way; leave one out"
            )
        given["path"], given["cameras"] = cameras, None


def shot_in(given, fps):
    """Return the `Shot` that --path names, None of other files; `fps` [1/s] is that of the run."""
    from rainsim.scene.shot import read_shot

    path, name, frame = (given.get(key) for key in ("path", "path_camera", "path_in"))
    shot = None if path is None else read_shot(path, name, fps, frame == "capture")
    for key, value in (("camera", name), ("in", frame)):
        if shot is None and value is not None:
            raise ParameterError(
                f"--path-{key} {value} is about a --path of USD, glTF or Blender; there is none; "
                "leave it out"
            )
    return shot


def first_frame(given, fps):
    """Return the number of the first frame: --frame-start, else that of a `Shot`, else 0."""
    if given.get("frame_start") is not None:
        return given["frame_start"]
    shot = shot_in(given, fps)
    return shot.first if shot else 0


def shot_cameras(shot, scene, given, fps):
    """Return the cameras of a `Shot` in the capture frame, and notes on them; `fps` in 1/s."""
    notes = list(shot.notes)
    if shot.fps and abs(shot.fps - fps) > 1e-6 * fps:
        notes.append(f"the path has {shot.fps:g} frames/s and is drawn at {fps:g}")
    if given.get("path_in") == "capture":
        return list(shot.cameras), notes
    return [scene.ground_frame.camera_in_capture(camera) for camera in shot.cameras], notes


def _in_si(keys, value):
    """Return the attribute that an option's preset keys fill, and its value in SI units."""
    from rainsim.config.tables import HUMAN_KEYS, SUN_WORDS, si_value

    attribute = HUMAN_KEYS[keys[0]][0]
    if len(keys) == 1:
        return attribute, si_value(keys[0], value)
    if isinstance(value, str):
        return attribute, SUN_WORDS[value]
    return attribute, tuple(si_value(key, part) for key, part in zip(keys, value, strict=True))


def scene_of(name, given):
    """Load a scene with the ground options that were given."""
    from rainsim.scene.library import load_scene

    names = ("cameras", "up", "meters_per_unit", "camera_height", "ground_frame", "photos",
             "spz_frame")  # fmt: skip
    require_own_cameras(given.get("cameras"))
    _check_camera(name, given)
    found, length = {n: given.get(n) for n in names}, given.get("known_length")
    found["meters_per_unit"] = _scale_in_space(length) or found["meters_per_unit"]
    scene = load_scene(name, **found)
    if length is not None and length[0] is not None:
        from rainsim.scene.folder import override_ground_frame

        scale = _scale_in_picture(scene, *length)
        scene = override_ground_frame(scene, meters_per_unit=scale)
    if given.get("fall") is not None:
        from rainsim.scene.ground import with_fall

        percent, direction = given["fall"]
        frame = with_fall(scene.ground_frame, percent / 100, math.radians(direction))
        scene = replace(scene, ground_frame=frame)
    return scene


def _check_camera(name, given):
    """Raise ParameterError if a capture's cameras lack the one that is asked for."""
    from rainsim.scene.cameras import load_cameras
    from rainsim.scene.folder import ACTORS_FILE, SCENE_FILE, cameras_beside, locate
    from rainsim.scene.library import find_scene

    path, own = find_scene(name), given.get("cameras")
    if given.get("camera") is None or path is None:
        return
    if own is None and any((path / file).is_file() for file in (SCENE_FILE, ACTORS_FILE)):
        return  # it is read at once
    cameras, _ = cameras_beside(*locate(path)) if own is None else load_cameras(own)
    if cameras:
        named_camera(SimpleNamespace(name=name, cameras=tuple(cameras)), given["camera"])


def require_own_cameras(cameras):
    """Raise ParameterError for a file of a --path where cameras of the capture are meant."""
    from rainsim.scene.shot import is_shot

    if isinstance(cameras, Path) and is_shot(cameras):
        raise ParameterError(
            f"--cameras {cameras} is a camera of a film; here the capture's own cameras are meant; "
            "draw along it with `rainsim run --path`"
        )


def scene_to_look_at(name, given):
    """Load a scene as `scene_of` does, or with an offered ground frame where it has none.

    Return the scene and whether its up and scale are offered.
    """
    from rainsim.errors import GroundError

    require_own_cameras(given.get("cameras"))
    try:
        return scene_of(name, given), False
    except GroundError:
        if given.get("ground_frame") is not None:
            raise
    import numpy as np

    from rainsim.scene.assumed_ground import assumed_ground_frame
    from rainsim.scene.library import load_scene
    from rainsim.scene.types import GroundFrame

    nowhere = GroundFrame(np.eye(3), 1.0, np.zeros(3))  # until one is offered
    scene = load_scene(name, cameras=given.get("cameras"), ground_frame=nowhere)
    scale = _scale_in_space(given.get("known_length")) or given.get("meters_per_unit")
    frame = assumed_ground_frame(scene.splats, scene.cameras, given.get("up"), scale)
    return replace(scene, ground_frame=frame), True


def _scale_in_space(length):
    """Return the metres per unit from a --known-length between points in space, else None."""
    from rainsim.scene.ground import scale_from_length

    if length is None or length[0] is not None:
        return None
    numbers = length[1]
    return scale_from_length(numbers[:3], numbers[3:6], numbers[6])


def _scale_in_picture(scene, camera, numbers):
    """Return the metres per unit from two pixels of a camera and the metres between them."""
    from rainsim.scene.ground import scale_from_length
    from rainsim.terrain.pictures import points_at

    u1, v1, u2, v2, length = numbers
    ends = points_at(scene.splats, named_camera(scene, camera), ((u1, v1), (u2, v2)))
    return scale_from_length(*ends, length)


def masks_named(given):
    """Return hashes of the masks that are given, as what a folder is made of."""
    from rainsim.io.fingerprint import hash_of_file

    found = {}
    if given.get("class_mask") is not None:
        found["mask"] = hash_of_file(given["class_mask"])
    if given.get("water_mask") is not None:
        found["water_mask"] = [hash_of_file(given["water_mask"]), given["water_mask_use"]]
    return found


def optics_of(given):
    """Return the `Optics` of the options, None where they change nothing."""
    samples = given.get("shutter_samples", 1)
    if given["lens"] is None and given["glass"] is None and not given["rolling"] and samples == 1:
        return None
    from rainsim.sensors.glass import Pane
    from rainsim.sensors.lens_files import lens_named
    from rainsim.sensors.optics import Optics

    lens = None if given["lens"] is None else lens_named(given["lens"])
    pane = None
    if given["glass"] is not None:
        age, speed = given["glass"]
        if not (0 <= age <= 3600 and 0 <= speed <= 100):
            raise ParameterError(
                f"--glass is {age:g},{speed:g}; it must be 0 to 3600 s and 0 to 100 m/s; 10,15 is "
                "usual"
            )
        pane = Pane(age=age, speed=speed, wiper=given["wiper"])
    return Optics(lens, pane, given["rolling"] * 1e-3, samples)


def paths_in(given):
    """Return the files that options name, a list of Path."""
    return [value for value in given.values() if isinstance(value, Path)]


def check_options(given):
    """Raise ParameterError if options contradict each other, or lack one that they go with."""

    def is_given(name):
        return given.get(name) is not None and given[name] is not False

    for names, what in ONE_OF:
        both = [dashed(name) for name in names if is_given(name)][:2]
        if len(both) == 2:
            raise ParameterError(
                f"{' and '.join(both)} are both given; {what} must be given in one way only; leave "
                "one out"
            )
    for name, (other, what) in NEEDS.items():
        if is_given(name) and not is_given(other):
            raise ParameterError(
                f"{dashed(name)} is given without {dashed(other)}; they go together, for {what}; "
                "give both, or leave it out"
            )


def dashed(name):
    """Return an option as it is typed."""
    return f"--{name.replace('_', '-')}"


def cameras_of(scene, config, given, say=None):
    """Return the frames' cameras in the frames' size, and the Config with their number of frames.

    There is a camera for each frame or one for all. `given` has camera, path, orbit, drive, eye,
    look_at, fov and frames as they were typed. `say` is called with notes on a path.
    """
    from rainsim.demo_scenes import FIRST_VIEWS
    from rainsim.scene.cameras import orbit, read_path
    from rainsim.scene.origin import near_origin
    from rainsim.surface.offered_views import with_offered_cameras

    if given.get("eye") is not None:
        cameras = [placed_camera(given, scene.ground_frame.up, config.width, config.height)]
    elif given.get("path") is not None:
        shot = shot_in(given, config.fps)
        if shot is None:
            path, moments = read_path(given["path"])
        else:
            (path, notes), moments = shot_cameras(shot, scene, given, config.fps), ()
            if say is not None:
                say(notes)
        cameras, config = _one_per_frame(path, given["path"], config, given)
        if len(moments) >= config.frames:
            config = config.replace(moments=moments[: config.frames])
    elif given.get("orbit"):
        around = with_offered_cameras(scene).cameras
        cameras = orbit(scene.ground_frame, around, count=config.frames)
    elif given.get("drive"):
        if not scene.cameras:
            raise ParameterError(
                f"scene {scene.name} has no cameras; --drive moves along them; give --orbit, "
                "--path transforms.json or --cameras cameras.json"
            )
        cameras, config = _one_per_frame(scene.cameras, f"scene {scene.name}", config, given)
    elif given.get("camera") is None and scene.source is None and scene.name in FIRST_VIEWS:
        eye, target = FIRST_VIEWS[scene.name]
        first, up = {"eye": eye, "look_at": target}, scene.ground_frame.up
        cameras = [placed_camera(first, up, config.width, config.height)]
    else:
        cameras = [named_camera(scene, given.get("camera"))]
    return _sized(near_origin(cameras, scene.origin), config), config


def view_on(scene, terrain, cameras, config, given, status):
    """Return the frames' cameras: `cameras`, or where none was asked for the one with most water.

    `cameras` and `given` are those of `cameras_of`. `status` reports which camera was chosen, and
    how fast a drive is. ParameterError if none was asked for and the ground follows the path.
    """
    if given.get("drive"):
        from rainsim.datasets.pace import film_note

        frame = scene.ground_frame
        path = [frame.camera_in_ground(camera) for camera in cameras]
        status.notes([film_note(path, config.fps, frame.scale_assumed)])
    if scene.source is None:  # the first cameras of the built-in scenes were made to be looked at
        return cameras
    if any(given.get(name) not in (None, False) for name in CAMERA_WAYS):
        return cameras
    from rainsim.pipeline import PathGround, view_of_water
    from rainsim.surface.offered_views import with_offered_cameras

    if isinstance(terrain, PathGround):
        raise ParameterError(
            "ground_map is path and no camera is named; legs of a drive follow cameras that are "
            "given; give --drive, --path, --orbit or --camera, or --ground-map whole"
        )
    offered = with_offered_cameras(scene)
    chosen = view_of_water(offered, terrain)
    about = "which shows most water; --camera takes another"
    if not scene.cameras:
        last = offered.cameras[-1].name
        about = f"one of view_00 to {last} (--camera, or --eye and --look-at, takes another)"
    status.notes([f"camera {chosen.name} is drawn, {about}"])
    return _sized([chosen], config)


def _one_per_frame(cameras, where, config, given):
    """Return one camera for each frame, and the Config with the number of frames."""
    if given.get("frames") is None:
        config = config.replace(frames=len(cameras)).check()
    if len(cameras) == 1:
        return list(cameras), config  # it stands still
    if len(cameras) < config.frames:
        raise ParameterError(
            f"frames is {config.frames}; it must be at most {len(cameras)}, the number of "
            f"cameras in {where}; lower --frames or leave it out"
        )
    return list(cameras[: config.frames]), config


def placed_camera(given, up, width=None, height=None):
    """Return the camera of --eye, with `up` in its picture; what it lacks of a size is usual."""
    from rainsim.scene.cameras import look_at

    width = width or round((height or DEFAULT_WIDTH / DEFAULT_SHAPE) * DEFAULT_SHAPE)
    height = height or max(round(width / DEFAULT_SHAPE), 1)
    fov = DEFAULT_FOV if given.get("fov") is None else given["fov"]
    return look_at(given["eye"], given["look_at"], up, fov, width, height, "eye")


def named_camera(scene, name):
    """Return the camera of a scene, or the offered one, with a name; its first if that is None."""
    from rainsim.surface.offered_views import with_offered_cameras

    scene = with_offered_cameras(scene)
    if name is None:
        return scene.cameras[0]
    for camera in scene.cameras:
        if camera.name == name:
            return camera
    for camera in scene.cameras:  # picture names are often kept with their suffix
        if camera.name.rpartition(".")[0] == name:
            return camera
    from rainsim.config.settings import nearest

    names = [camera.name for camera in scene.cameras]
    shown = names if len(names) <= MOST_SHOWN else [*names[:3], "...", names[-1]]
    raise ParameterError(
        f"scene {scene.name} has no camera {name!r}; it must be one of its {len(names)}: "
        f"{', '.join(shown)}" + nearest(name, names, "; the nearest is {!r}", "")
    )


def _sized(cameras, config):
    from rainsim.scene.cameras import resize_to

    sized = [resize_to(camera, config.width, config.height) for camera in cameras]
    for camera in sized:
        if (camera.width, camera.height) != (sized[0].width, sized[0].height):
            raise ParameterError(
                f"frames would be {sized[0].width} x {sized[0].height} and {camera.width} x "
                f"{camera.height} px; all must be equal; give --width and --height"
            )
    return sized
