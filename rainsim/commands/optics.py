"""Options of lens, glass and shutter, the same for frames and data sets."""

from __future__ import annotations

import click

from rainsim.commands.options import Numbers, group
from rainsim.errors import ParameterError

optics_options = group(
    click.option(
        "--lens",
        metavar="MODEL:K1,K2,...|FILE",
        show_default="pinhole",
        help="Distort pictures, layers and labels: opencv:k1,k2,p1,p2[,k3] or "
        "fisheye:k1,k2,k3,k4, as OpenCV has them, or that of a transforms.json or COLMAP model.",
    ),
    click.option(
        "--rolling",
        type=float,
        default=0.0,
        show_default=True,
        metavar="MS",
        help="Readout time of a rolling shutter from the first row to the last, in ms.",
    ),
    click.option(
        "--glass",
        type=Numbers("seconds,speed"),
        help="Drops on a pane before the lens: for how many seconds it has rained on it, and the "
        "camera's speed ahead in m/s, at which drops come.",
    ),
    click.option(
        "--wiper",
        type=float,
        metavar="SECONDS",
        show_default="none",
        help="A wiper clears the glass every so many seconds since it began to rain on it; with "
        "--glass.",
    ),
)
shot_options = group(  # of frames
    optics_options,
    click.option(
        "--shutter-samples",
        type=click.IntRange(1, 256),
        default=1,
        show_default=True,
        metavar="N",
        help="Blur what moves, and all of it with a moving camera: the mean of N pictures over "
        "the exposure. Falling drops are blurred without it.",
    ),
)


def lens_of(given):
    """Return the `Lens` of the options, None for a pinhole."""
    if given["lens"] is None:
        return None
    from rainsim.sensors.lens_files import lens_named

    return lens_named(given["lens"])


def readout_of(given):
    """Return the readout time of a rolling shutter [s]."""
    if not given["rolling"]:
        return 0.0
    from rainsim.sensors.rolling import check_readout

    check_readout(given["rolling"] * 1e-3)
    return given["rolling"] * 1e-3


def pane_of(given):
    """Return the `Pane` before the lens, None without one."""
    if given["glass"] is None:
        if given["wiper"] is not None:
            raise ParameterError("--wiper clears the glass of --glass; give that too")
        return None
    from rainsim.sensors.glass import Pane

    age, speed = given["glass"]
    if not (0 <= age <= 3600 and 0 <= speed <= 100):
        raise ParameterError(
            f"--glass is {age:g},{speed:g}; it must be 0 to 3600 s and 0 to 100 m/s; 10,15 is usual"
        )
    return Pane(age=age, speed=speed, wiper=given["wiper"])


def optics_of(given, backend, names, exr, config):
    """Return the `Optics` of the options, None where they change nothing."""
    lens, readout, pane = lens_of(given), readout_of(given), pane_of(given)
    samples = given["shutter_samples"]
    if lens is None and pane is None and not readout and samples == 1:
        return None
    from rainsim.sensors.optics import Optics

    optics = Optics(lens, pane, readout, samples)
    optics.check(backend, names, exr, config)
    return optics


def content_of(exr, optics):
    """Return what frames depend on besides scene and settings, for their fingerprint."""
    content = {"exr": exr.content} if exr else {}
    return content | ({"optics": optics.facts} if optics else {})


def drawn_camera(camera, optics):
    """Return the camera that is drawn for one; its picture may be larger than the frame."""
    return camera if optics is None else optics.drawn(camera)
