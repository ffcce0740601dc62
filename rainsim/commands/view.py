"""`rainsim view`: a scene in the rain in the browser."""

import sys
import threading
from dataclasses import replace
from pathlib import Path

import click

from rainsim.commands import options
from rainsim.commands.compile import uses_of
from rainsim.commands.given import named_camera, require_backend, scene_to_look_at
from rainsim.commands.job import Job
from rainsim.commands.status import READING

PORT = 8080
FEWER_PIXELS = "?fixedDpr=0.5"  # of viser's page: a quarter of the pixels are drawn there
COARSE_UP_TO = 1000  # px of a picture at rest, which such a page still shows whole
GRAPHICS = ("/dev/dri", "/dev/dxg", "/dev/nvidiactl")  # one of them, where Linux has a GPU
WAIT = 0.5  # s between looks at whether Ctrl-C was pressed


@click.command(short_help="Look at a scene in the rain in the browser.")
@click.argument("scene", default="bicycle")
@options.preset_option
@options.rain_options
@options.light_options
@options.option(
    "camera", str, "Where to begin. [default: the camera that shows most water]", "NAME"
)
@options.option("width", int, "Width of a picture at rest, in px.", "PX", options.PRESETS)
@options.backend_option
@options.ground_options
@options.terrain_options
@options.mask_options
@options.option("port", click.IntRange(1, 65535), "Port on this machine; if it is in use, the next "
                "free one.", default=PORT)  # fmt: skip
@options.option("out -o", options.FOLDER, "Folder for what is saved on the page.", "DIR",
                "rainsim-out/SCENE-view")  # fmt: skip
@options.threads_option
@options.option("quiet -q", bool, "Print the address and errors only.")
@options.verbose_option
def view(scene, port, **given):
    """Look at SCENE in the rain in a browser, on this machine only; needs rainsim[view].

    SCENE is a name from `rainsim scenes`, a trained model's folder, a splat file or a scene folder.
    Prints the address to open; Ctrl-C ends it. Pictures are drawn here, by the same code as those
    of `rainsim run`: what is saved on the page is drawn by the command that it prints, to the byte.

    From another machine: ssh -L 8080:127.0.0.1:8080 user@host, and open http://127.0.0.1:8080.

    \b
    Example:
        rainsim view
        rainsim view garden/ --preset moderate --camera DSC07956
    """
    job = Job(given)
    _require_viser(job.backend)
    masks = job.read_masks()
    with job.compiling(uses_of(scene, job.config, ("clean",), job.backend)):
        job.status.progress(READING, 0, 1)
        loaded, is_offered = scene_to_look_at(scene, given)
        job.set_scene(loaded)
        session, first = _session(job, masks)
    greeting = _greeting(session, is_offered)
    if greeting:
        job.status.notes([greeting])
    out = job.out or options.default_out(loaded.name, "view")
    _serve(job.status, session, first, out, scene, _repeated(given), port, greeting)


def _require_viser(backend):
    """Raise BackendError where viser or the GPU is missing, before anything is computed."""
    from importlib.util import find_spec

    from rainsim.errors import BackendError

    if find_spec("viser") is None:
        from rainsim.view.page import REMEDY

        raise BackendError(REMEDY)
    require_backend(backend)


def _session(job, masks):
    """Return a `Session` with terrain, water and light made, and the Viewpoint to begin with."""
    from rainsim.errors import GroundError
    from rainsim.jit import set_threads
    from rainsim.pipeline import view_of_water
    from rainsim.surface.offered_views import with_offered_cameras
    from rainsim.view.session import Session

    set_threads(job.config.threads)
    config = replace(job.config, width=job.config.width or options.WIDTH, height=None)
    seen, status, camera = with_offered_cameras(job.scene), job.status, job.given["camera"]
    first = named_camera(seen, camera)  # an error before anything is computed
    session = Session(
        job.scene, _around(config, first), job.backend, masks[0], status.progress, status.notes,
        seen.cameras, masks[1],
    )  # fmt: skip
    try:
        session.make_ground()
    except GroundError:
        return session, session.viewpoint_of(first)
    if camera is None and job.scene.source is not None:
        first = view_of_water(seen, session.terrain)
        status.notes([f"camera {first.name} is shown first: it shows most water"])
        session.set_config(_around(config, first))
    session.make()
    return session, session.viewpoint_of(first)


def _greeting(session, is_offered):
    """Return what a user must know before believing the picture, one message; "" if nothing."""
    said = []
    frame = session.scene.ground_frame
    is_offered = is_offered or (frame.scale_assumed and not session.scene.cameras)
    if is_offered:
        said.append("; ".join(frame.notes))
    if not session.scene.cameras:
        said.append("the capture has no cameras: the view is offered")
    if session.no_ground is not None:
        said.append(f"there is no rain yet: {session.no_ground}")
    if is_offered or session.no_ground is not None:
        said.append("mend up and scale under Ground, then save them there")
    return ". ".join(said)


def _around(config, camera):
    """Return the settings with the surroundings drawn from a camera's place, if none is named."""
    if config.render.surroundings is not None:
        return config
    return config.replace(surroundings=tuple(float(v) for v in camera.position))


def _repeated(given):
    """Return the options that a printed command repeats: those that no saved file holds."""
    names = [name for name in ("cameras", "backend", "threads") if given[name] not in (None, "cpu")]
    return [word for name in names for word in (f"--{name}", str(given[name]))]


def _has_graphics():
    """Whether a browser on this machine can draw on a GPU; other systems than Linux count so."""
    return sys.platform != "linux" or any(Path(name).exists() for name in GRAPHICS)


def _address_for(address, width, has_graphics):
    """Return the address to open: with fewer pixels where a browser draws them on these cores.

    Pictures at rest that are wide (`width` [px]) keep the page's full resolution.
    """
    return address if has_graphics or width > COARSE_UP_TO else f"{address}/{FEWER_PIXELS}"


def _serve(status, session, first, out, scene, repeated, port, greeting):
    """Show the page until Ctrl-C."""
    from rainsim.view.home import Home
    from rainsim.view.page import Page
    from rainsim.view.painter import Painter

    page = drawing = None
    painter = Painter(
        session, lambda *shown: page.show(*shown), lambda text: page.say(text),
        lambda error: page.fail(error), badly_seen=lambda *told: page.show_badly_seen(*told),
    )  # fmt: skip
    try:
        page = Page(painter, Home(Path(out), scene, repeated, click.echo), port, first, greeting)
        drawing = threading.Thread(target=painter.run, name="painter")
        drawing.start()
        address = _address_for(page.address, session.config.width, _has_graphics())
        click.echo(address)
        status.say("open it in a browser; Ctrl-C ends it")
        if address != page.address:
            status.say(
                "no GPU was found here: the page draws a quarter of its pixels. In a browser on a "
                f"machine with a GPU: {page.address}"
            )
        while drawing.is_alive():
            drawing.join(WAIT)
    except KeyboardInterrupt:
        status.say("ended")
    finally:  # else a thread that draws or listens keeps the process alive
        painter.end()
        if drawing is not None and drawing.is_alive():
            drawing.join()
        if page is not None:
            page.close()
