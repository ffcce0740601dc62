"""Options of lens, glass and shutter, the same for frames and data sets."""

from __future__ import annotations

from rainsim.errors import ParameterError


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
