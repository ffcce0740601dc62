"""Keyframes of camera and settings, and the smooth path through them."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from rainsim.config.frame_settings import MAX_FRAMES
from rainsim.config.settings import Config
from rainsim.config.tables import CHANGING
from rainsim.errors import ParameterError, require_positive
from rainsim.view.session import Viewpoint


@dataclass(frozen=True)
class Keyframe:
    """A camera and settings that a path passes through.

    view : Viewpoint
    config : Config. Of it those settings count that can change with time, see
        `timeline.CHANGING`.
    seconds : float. From the keyframe before.
    time : float or None. Of the rain that it shows [s]; None: time goes on along
        the path.
    """

    view: Viewpoint
    config: Config
    seconds: float = 2.0
    time: float | None = None


def times_of(keyframes):
    """Return the rising times [s] of keyframes, (n,); the first is 0; else ParameterError."""
    for keyframe in keyframes[1:]:
        require_positive("time between keyframes", keyframe.seconds, "s", "2 is usual")
    return np.concatenate([[0.0], np.cumsum([k.seconds for k in keyframes[1:]])])


def placed(keyframes, times):
    """Return keyframes in the order of their times [s], the first of which becomes 0."""
    order = np.argsort(times, kind="stable")
    apart = np.diff(np.asarray(times, np.float64)[order], prepend=0.0)
    if (apart[1:] <= 0).any():
        at = times[order[int(np.argmin(apart[1:])) + 1]]
        raise ParameterError(
            f"two keyframes are at {at:g} s; each needs a time of its own; move or delete one"
        )
    usual = Keyframe.__dataclass_fields__["seconds"].default
    return [
        replace(keyframes[k], seconds=usual if n == 0 else float(apart[n]))
        for n, k in enumerate(order)
    ]


def without(keyframes, n):
    """Return keyframes without one; the others keep their times, but that the first is 0."""
    times = times_of(keyframes)
    kept = [k for k in range(len(keyframes)) if k != n]
    return placed([keyframes[k] for k in kept], times[kept])


def with_timeline(keyframes, config, view):
    """Return keyframes with the settings of a timeline, and more of them at its times.

    keyframes : sequence of Keyframe. They keep their cameras and times; the
        timeline's other times get the camera that the path has there. May be
        empty.
    config : Config. With the timeline.
    view : Viewpoint. The camera where there is no path yet.
    """
    own = times_of(keyframes) if keyframes else np.zeros(0)
    given = dict.fromkeys([0.0, *(time for time, _ in config.keyframes)])
    more = [time for time in given if not np.isclose(own, time).any()]
    views = [view_at(keyframes, time) if keyframes else view for time in more]
    found = [*keyframes, *(Keyframe(view, config) for view in views)]
    times = np.array([*own, *more])
    if any(keyframe.time is not None for keyframe in keyframes):
        found = [replace(keyframe, time=None) for keyframe in found]
    config = [config.at(float(time)) for time in times]
    return placed([replace(k, config=c) for k, c in zip(found, config, strict=True)], times)


def view_at(keyframes, time):
    """Return the view that the path through keyframes has at a time [s]; at its ends it rests."""
    return _views_at(keyframes, np.array([time]))[0]


def smooth_path(keyframes, fps):
    """Return the views of all frames from the first keyframe to the last.

    Positions are a cubic spline and turns a rotation spline: neither jumps in speed. The camera
    starts and ends at rest; the angle of view does not overshoot.

    Returns list of Viewpoint. One per frame; a single one if there is one
        keyframe.
    Raises ParameterError if there is no keyframe, or more frames than a run can
        have.
    """
    if not keyframes:
        raise ParameterError("there is no keyframe; a path needs one; add the camera you see")
    if len(keyframes) == 1:
        return [keyframes[0].view]
    at = times_of(keyframes)
    count = math.floor(at[-1] * fps + 1e-9) + 1
    if count > MAX_FRAMES:
        raise ParameterError(
            f"the path has {count} frames; it must have at most {MAX_FRAMES}; shorten it"
        )
    return _views_at(keyframes, np.arange(count) / fps)


def _views_at(keyframes, times):
    """Return the views at some times [s]."""
    views = [keyframe.view for keyframe in keyframes]
    if len(views) == 1:
        return views * len(times)
    at = times_of(keyframes)
    turns = Rotation.from_matrix([view.rotation for view in views])
    when = np.clip(times, 0.0, at[-1])
    position = CubicSpline(at, [view.position for view in views], bc_type="clamped")(when)
    fov = PchipInterpolator(at, [view.fov for view in views])(when)
    quaternion = RotationSpline(at, turns)(when).as_quat()
    return [
        Viewpoint(tuple(map(float, p)), tuple(map(float, (q[3], q[0], q[1], q[2]))), float(f))
        for p, q, f in zip(position, quaternion, fov, strict=True)
    ]


def moments_of(keyframes, fps):
    """Return the number of the rain's state that each frame shows; () if time just goes on."""
    times = rain_times_of(keyframes)
    if times is None:
        return ()
    count = len(smooth_path(keyframes, fps))
    when = np.minimum(np.arange(count) / fps, times_of(keyframes)[-1])
    moments = np.rint(np.interp(when, times_of(keyframes), times) * fps).astype(int)
    return () if (moments == np.arange(count)).all() else tuple(moments.tolist())


def rain_times_of(keyframes):
    """Return the times of the rain [s] that keyframes show, (n,); None where time goes on."""
    times = [keyframe.time for keyframe in keyframes]
    if all(time is None for time in times):
        return None
    if None in times:
        raise ParameterError(
            "some keyframes have a time of the rain and others have none; all must or none; let "
            "time go on, or add the keyframes again"
        )
    if any(b < a for a, b in itertools.pairwise(times)):
        shown = ", ".join(f"{time:g}" for time in times)
        raise ParameterError(
            f"the keyframes show the rain at {shown} s; it runs forwards only; let time go on, or "
            "add the keyframes in the order of their times"
        )
    return np.array(times, np.float64)


def timeline_of(keyframes):
    """Return the `Config.keyframes` of the settings that change from keyframe to keyframe."""
    changes = []
    for name in CHANGING:
        values = [keyframe.config.value(name) for keyframe in keyframes]
        if all(value == values[0] for value in values):
            continue
        if None in values:
            raise ParameterError(
                f"{name} is set at some keyframes only; it must be at all or none; a flood cannot "
                "begin between two of them: give the others a low level"
            )
        changes.append((name, values))
    if not changes:
        return ()
    times = rain_times_of(keyframes)
    times = times_of(keyframes) if times is None else times
    if (np.diff(times) <= 0).any():
        names = ", ".join(name for name, _ in changes)
        raise ParameterError(
            f"{names} change between keyframes at which the rain stands still; settings change "
            "with its time; give these keyframes the same settings, or let time go on"
        )
    return tuple(
        (float(time), tuple((name, values[n]) for name, values in sorted(changes)))
        for n, time in enumerate(times)
    )


def path_config(keyframes, config):
    """Return a run's settings along a path: what keyframes do not change is that of `config`."""
    frames = len(smooth_path(keyframes, config.fps))
    steady = config.replace(**{n: keyframes[0].config.value(n) for n in CHANGING})
    moments = moments_of(keyframes, config.fps)
    steady = replace(steady, frames=frames, moments=moments)
    return replace(steady, keyframes=timeline_of(keyframes)).check()
