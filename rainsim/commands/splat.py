"""`rainsim splat`: the dry capture from any camera, as a picture or as arrays."""

from dataclasses import replace
from pathlib import Path

import click

from rainsim.commands import options
from rainsim.commands.compile import refused_folders
from rainsim.commands.given import (
    DEFAULT_WIDTH,
    check_options,
    dashed,
    named_camera,
    placed_camera,
    require_backend,
    require_own_cameras,
    scene_to_look_at,
    settings,
)
from rainsim.commands.options import FILE, Numbers, group, option
from rainsim.errors import ParameterError, require_positive

NEAR = 0.01  # capture units, as gsplat has it
SIDES = (1, 16384)  # px

# fmt: off
_splat_options = group(
    option("camera", str, "A camera of the capture. [default: its first]", "NAME"),
    option("cameras", FILE, "Cameras instead of the capture's.", "FILE.json"),
    options.eye_options,
    option("fov", float, "Horizontal field of view in degrees, with --eye. [default: 60]", "DEG"),
    option("up", Numbers("x,y,z"), "Up in the picture, with --eye. [default: the cameras' mean]"),
    option("ortho-height", float, "Orthographic camera, with --eye: height of the picture in "
           "units.", "UNITS"),
    option("width", int, "Width in px. [default: 648]", "PX"),
    option("height", int, "Height in px. [default: the camera's shape]", "PX"),
    option("depth", click.Choice(["expected", "median", "plane"]), "expected, the mean depth of "
           "the splats' centres; median, the splat at which half of the light is stopped; or "
           "plane, where the ray meets the blended plane.", default="expected"),
    option("background", Numbers("r,g,b"), "Colour behind the splats, 0 to 1, display-referred. "
           "[default: 0,0,0]", shows=False, default=(0.0, 0.0, 0.0)),
    option("hit", bool, "Add an array hit to FILE.npz: the index in the file of the splat at which "
           "half of the light is stopped, int32; -1 for none."),
    option("compensate", bool, "Lower the opacity of splats smaller than a pixel, as Mip-Splatting "
           "does."),
    option("out -o", FILE, "Picture, or float32 arrays rgb, alpha, depth, normal.",
           "FILE.png|FILE.npz", required=True),
    option("overwrite", bool, "Replace the file if it exists."),
)
# fmt: on


@click.command(short_help="Draw the capture from a camera, without rain.")
@click.argument("scene", default="bicycle")
@_splat_options
@options.threads_option
@options.big_options
@options.backend_option
@options.json_option
def splat(scene, out, overwrite, as_json, **given):
    """Draw the dry capture SCENE from a camera; the views of one without are those of `run`.

    Arrays: rgb (height, width, 3) display-referred over the background; alpha; depth in capture
    units, infinite where nothing is; normal in the capture frame, zero where nothing is. As in the
    codes that train captures, a splat that would bring a pixel's transmittance under 1e-4 is left
    out.

    \b
    Example:
        rainsim splat garden --camera DSC07956 --out view.png
        rainsim splat truck.splat --up 0,-1,0 --eye 1.2,-.25,-1.6 --look-at 0,.25,0 -o truck.png
    """
    from rainsim.scene.library import load_scene
    from rainsim.scene.types import GroundFrame

    if out.suffix.lower() not in (".png", ".npz"):
        raise ParameterError(f"--out is {out}; it must end in .png or .npz; correct the name")
    if out.exists() and not overwrite:
        raise ParameterError(f"{out} exists; it is kept; give --overwrite or another --out")
    if not out.parent.is_dir():
        raise ParameterError(f"the folder {out.parent} does not exist; make it first")
    if given["hit"] and out.suffix.lower() != ".npz":
        raise ParameterError(f"--hit goes with --out FILE.npz, not {out}; leave it out")
    _check(given)
    config = settings("moderate", {name: given[name] for name in ("detail", "memory", "threads")})
    require_own_cameras(given["cameras"])
    import numpy as np

    from rainsim.jit import set_threads

    set_threads(config.threads)
    nowhere = GroundFrame(np.eye(3), 1.0, np.zeros(3))  # drawing needs no ground
    capture = load_scene(scene, cameras=given["cameras"], ground_frame=nowhere)
    if not capture.cameras and given["eye"] is None:  # those that are offered stand on the ground
        capture, _ = scene_to_look_at(scene, {})
    camera = _camera(capture, given)
    require_backend(given["backend"])
    notes = [*refused_folders(), *capture.notes, *_memory(capture, camera, out, given["backend"])]
    layers, milliseconds = draw(
        capture, camera, given["depth"], given["backend"], compensate=given["compensate"],
        background=given["background"], hit=given["hit"], render=config.render,
    )  # fmt: skip
    _write(Path(out), layers, camera)
    facts = {
        "out": str(out), "camera": camera.name, "width": camera.width, "height": camera.height,
        "splats": len(capture.splats), "milliseconds": round(milliseconds, 1),
        "notes": notes,
    }  # fmt: skip
    if as_json:
        options.echo(facts, as_json, "")
        return
    for note in notes:
        click.echo(note, err=True)
    click.echo(f"{out}: {len(capture.splats)} splats in {milliseconds:.0f} ms", err=True)


def _check(given):
    """Raise ParameterError if camera options contradict each other or a value is out of range."""
    if not all(0 <= channel <= 1 for channel in given["background"]):
        shown = ",".join(f"{channel:g}" for channel in given["background"])
        raise ParameterError(f"--background is {shown}; it must be r,g,b from 0 to 1 each")
    check_options(given)
    for name in ("up", "ortho_height"):
        if given[name] is not None and given["eye"] is None:
            raise ParameterError(
                f"{dashed(name)} goes with --eye and --look-at; give them or leave it"
            )
    if given["ortho_height"] is not None:
        require_positive("--ortho-height", given["ortho_height"], "units")
    for name in ("width", "height"):
        if given[name] is not None and not SIDES[0] <= given[name] <= SIDES[1]:
            low, high = SIDES
            raise ParameterError(f"--{name} is {given[name]}; it must be {low} to {high} px")


def _camera(capture, given):
    """Return the camera that the options name or place, in the size asked for."""
    from rainsim.scene.camera_rule import require_camera
    from rainsim.scene.cameras import PLACED

    refusal = "the camera", ParameterError, PLACED
    width, height = given["width"], given["height"]
    if given["eye"] is None:
        camera = named_camera(capture, given["camera"])
        if height is None:
            width = width or DEFAULT_WIDTH
            height = max(round(width * camera.height / camera.width), 1)
        width = width or round(height * camera.width / camera.height)
        return require_camera(camera.resized(width, height), *refusal)
    camera = placed_camera(given, _up(capture, given), width, height)
    if given["ortho_height"] is not None:
        scale = camera.height / given["ortho_height"]
        camera = replace(camera, fx=scale, fy=scale, orthographic=True)
        require_camera(camera, *refusal)
    return camera


def _up(capture, given):
    import numpy as np

    if given["up"] is not None:
        return given["up"]
    if not capture.cameras:
        raise ParameterError(
            f"{capture.name} has no cameras to find the up direction from; give --up x,y,z"
        )
    return np.mean([camera.image_up for camera in capture.cameras], axis=0)


def _memory(capture, camera, out, backend):
    """Return a list of notes on the memory that the picture takes, or raise ParameterError."""
    from rainsim import cuda
    from rainsim.render.memory import require_memory_of_dry

    free = cuda.free_memory() if backend == "cuda" else None
    return require_memory_of_dry(capture.splats, camera, out.suffix.lower() == ".npz", free)


def draw(capture, camera, depth="expected", backend="cpu", render=None, **options):
    """Return the `Layers` of a camera, with the depth that `depth` names, and the time [ms]."""
    import time

    from rainsim.actors.actor import require_no_actors, scene_at
    from rainsim.config.settings import Config
    from rainsim.lod.numbers import FinestNumbers
    from rainsim.lod.paged import rasterizer_of_scene
    from rainsim.raster import Rasterizer, prepare

    if backend == "cuda":
        require_backend(backend)
        from rainsim.cuda.raster import Rasterizer
    if capture.pages is None:
        prepared = prepare(scene_at(capture, 0.0).splats)
        drawer = Rasterizer(replace(prepared, compensate=capture.antialiased))
    else:
        require_no_actors(capture.actors, "rainsim splat of chunks", "draw the static set")
        numbers_of = FinestNumbers(capture.pages).of_run if options.get("hit") else None
        render = render or Config().render
        drawer = rasterizer_of_scene(capture, render, Rasterizer, numbers_of)
    begin = time.perf_counter()
    mode = "median" if depth == "median" else "expected"
    layers = drawer.draw(camera, NEAR, depth=mode, drop_last=True, **options)
    milliseconds = (time.perf_counter() - begin) * 1e3
    if depth == "plane":
        layers = replace(layers, depth=layers.plane_depth)
    return layers, milliseconds


def _write(out, layers, camera):
    import numpy as np

    from rainsim.io import images

    if out.suffix.lower() == ".png":
        shown = np.clip(layers.color, 0, 1) * 255 + 0.5
        images.write_png(out, shown.astype(np.uint8))
        return
    normal = layers.normal @ camera.camera_from_world[:3, :3].astype(np.float32)
    hit = {} if layers.hit is None else {"hit": layers.hit}
    images.write_npz(
        out, rgb=layers.color, alpha=layers.alpha, depth=layers.depth,
        normal=np.ascontiguousarray(normal, dtype=np.float32), **hit,
    )  # fmt: skip
