"""Cameras of USD stages, read by OpenUSD's own library, from the extra `usd`."""

import numpy as np

from rainsim.errors import InputError, RainsimError
from rainsim.io.files import MAX_LENGTH, require_file
from rainsim.scene import shot_camera
from rainsim.scene.usd_guard import apart, opened, require_types

INSTALL = 'pip install "rainsim[usd]"'


def require_usd(purpose):
    """Raise RainsimError unless USD can be read and written; `purpose` begins the message."""
    try:
        import pxr.Usd  # noqa: F401  (an extra: most runs need no USD)
    except ImportError:
        raise RainsimError(
            f"{purpose} needs OpenUSD and the package usd-core is not installed; {INSTALL}"
        ) from None


def read_usd(path, name=None):
    """Return the cameras of a stage's frames, in its axes and units, and its `World`."""
    require_file(path, "a USD file")
    require_usd(f"{path} is USD; reading it")
    return apart(_read, path, name)


def _read(path, name):
    with opened(path) as (stage, _):
        return _cameras(path, stage, name)


def _cameras(path, stage, name):
    from pxr import Usd, UsdGeom

    prims = [
        prim
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        if prim.IsA(UsdGeom.Camera)
    ]
    index = shot_camera.require_chosen([str(prim.GetPath()) for prim in prims], name, path)
    require_types(path, prims[index])
    world = world_of(stage, path)
    times = _times(stage, prims[index], world, path)
    cameras = [_camera(path, stage, prims[index], time) for time in times]
    per_frame = stage.GetTimeCodesPerSecond() / (world.fps or stage.GetTimeCodesPerSecond())
    first = times[0] / per_frame if np.isfinite(times[0]) else 0.0
    return cameras, world._replace(first=float(first))


def world_of(stage, path):
    """Return the `World` of a stage."""
    from pxr import UsdGeom

    up, meters = str(UsdGeom.GetStageUpAxis(stage)), UsdGeom.GetStageMetersPerUnit(stage)
    if up not in shot_camera.Z_UP:
        raise InputError(f"{path} has the up axis {up}; it must be Y or Z; export it again")
    if not 0 < meters < MAX_LENGTH:  # false for NaN
        raise InputError(f"{path} has {meters:g} metres per unit; it must be above 0; correct it")
    fps = None
    for key in ("framesPerSecond", "timeCodesPerSecond"):
        if fps is None and stage.HasAuthoredMetadata(key):
            fps = float(stage.GetMetadata(key))
            if not 0 < fps < shot_camera.MOST_FPS:
                raise InputError(f"{path}: {key} is {fps:g}; it must be above 0; correct it")
    return shot_camera.World(up, meters, fps, 0.0)


def _times(stage, prim, world, path):
    """Return the time codes of the frames: of the stage's range, else of what is animated."""
    from pxr import Usd, UsdGeom

    codes = stage.GetTimeCodesPerSecond()
    begin, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not stage.HasAuthoredTimeCodeRange():
        samples = {time for one in prim.GetAttributes() for time in one.GetTimeSamples()}
        while prim:
            samples.update(UsdGeom.Xformable(prim).GetTimeSamples() if prim.IsA(
                UsdGeom.Xformable) else ())  # fmt: skip
            prim = prim.GetParent()
        if not samples:
            return [float(Usd.TimeCode.Default().GetValue())]
        begin, end = min(samples), max(samples)
    return shot_camera.frame_times(begin, end, codes / (world.fps or codes), path)


def _camera(path, stage, prim, time):
    from pxr import Gf, Usd, UsdGeom

    code = Usd.TimeCode(float(time)) if np.isfinite(time) else Usd.TimeCode.Default()
    label = f"{prim.GetPath()}" + (f" at {time:g}" if np.isfinite(time) else "")
    found = UsdGeom.Camera(prim).GetCamera(code)
    if found.projection == Gf.Camera.Orthographic:
        raise InputError(
            f"{path} {label} is orthographic; a perspective camera is needed; give another"
        )
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim)).T
    wide, tall = found.horizontalAperture, found.verticalAperture
    if not (np.isfinite([wide, tall]).all() and min(wide, tall) > 0):
        raise InputError(
            f"{path} {label} has an aperture of {wide:g} x {tall:g}; both must be above 0; correct "
            "the lens"
        )
    size, pixel, policy = _rendered(stage, prim)
    if size:
        wide, tall = _conformed(wide, tall, size[0] * pixel / size[1], policy)
    lens = shot_camera.Lens(
        found.focalLength / wide, -found.horizontalApertureOffset / wide,
        found.verticalApertureOffset / tall, wide / tall, size,
    )  # fmt: skip
    return shot_camera.camera_at(path, label, matrix, lens)


def _rendered(stage, prim):
    """Return size [px], shape of a pixel and conform policy of the stage's render settings."""
    from pxr import UsdRender

    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    if not settings:
        return None, 1.0, ""
    targets = settings.GetCameraRel().GetForwardedTargets()
    if targets and prim.GetPath() not in targets:
        return None, 1.0, ""
    size = tuple(settings.GetResolutionAttr().Get())
    pixel = float(settings.GetPixelAspectRatioAttr().Get())
    if min(size) < 1 or not 0 < pixel < MAX_LENGTH:
        return None, 1.0, ""
    return size, pixel, str(settings.GetAspectRatioConformPolicyAttr().Get())


def _conformed(wide, tall, shape, policy):
    """Return the apertures that a picture of a shape shows, by a policy of UsdRenderSettings."""
    narrow = wide / tall < shape
    if policy == "adjustPixelAspectRatio" or abs(wide / tall / shape - 1) < 1e-6:
        return wide, tall
    widens = {"expandAperture": narrow, "cropAperture": not narrow}
    if widens.get(policy, policy == "adjustApertureWidth"):
        return tall * shape, tall
    return wide, wide / shape
