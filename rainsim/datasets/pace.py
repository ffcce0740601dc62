"""How fast a drive is: what its views and their rate make of it, or what is asked for."""

from dataclasses import replace

import numpy as np

from rainsim.errors import ParameterError
from rainsim.render.shutter import motions, moved

KMH = 3.6  # km/h in a m/s
FASTEST = 130.0  # km/h, the advised speed of German motorways
LEAST_SPEED, MOST_SPEED = 1.0, 200.0  # km/h; from 216 on a motion is taken for a cut
MOST_VIEWS = 100_000
INTRINSICS = "fx", "fy", "cx", "cy"


def pace_of(cameras, fps):
    """Return a drive's length [m], its mean speed and that of each of its steps [km/h].

    There is a camera for each view in its order, in the ground frame, in metres; `fps` is in 1/s.
    """
    steps = _steps(cameras)
    speeds = steps * fps * KMH
    return float(steps.sum()), float(speeds.mean()) if len(speeds) else 0.0, speeds


def pace_note(cameras, fps, assumed, unit="views"):
    """Return the line that says how fast the drive is; `assumed` if its scale is."""
    length, mean, speeds = pace_of(cameras, fps)
    if not len(speeds):
        return "drive: one view, which stands still"
    text = f"drive: {len(cameras)} {unit} along {length:.4g} m at {fps:g}/s: {mean:.3g} km/h"
    if speeds.max() > 1.05 * mean:
        text += f", {speeds.min():.3g} to {speeds.max():.3g} from view to view"
    return text + (" by the ASSUMED scale" if assumed else "")


def film_note(cameras, fps, assumed):
    """Return `pace_note` for a film, which may be faster than a car, with a remedy where it is."""
    text, speeds = pace_note(cameras, fps, assumed, "frames"), pace_of(cameras, fps)[2]
    if len(speeds) and speeds.max() > FASTEST:
        return f"WARNING: {text}; cars drive {FASTEST:g} at most: lower --fps"
    return text


def check_pace(cameras, fps, assumed):
    """Raise ParameterError if a step of the drive is faster than a car; see `pace_note`."""
    _, mean, speeds = pace_of(cameras, fps)
    if not len(speeds) or speeds.max() <= FASTEST:
        return
    at = int(speeds.argmax())
    remedy = "--drive-speed 40 places the views by the speed"
    if assumed:
        remedy += ", --meters-per-unit corrects the scale, which is assumed"
    raise ParameterError(
        f"the drive is {mean:.3g} km/h at --fps {fps:g}, and {speeds[at]:.3g} from view {at} to "
        f"{at + 1}; it must be at most {FASTEST:g}, as cars drive; {remedy}, or lower --fps or "
        "give more --views"
    )


def check_speed(speed):
    """Raise ParameterError unless a speed [km/h] can be driven at."""
    if not LEAST_SPEED <= speed <= MOST_SPEED:  # false for NaN
        raise ParameterError(
            f"--drive-speed is {speed:g} km/h; it must be from {LEAST_SPEED:g} to {MOST_SPEED:g}; "
            "30 to 50 is usual in towns"
        )


def placed_by_speed(cameras, speed, fps, most=None):
    """Return the views of a drive at an even speed [km/h] along a path from its first camera on.

    The path, in the ground frame, in metres, goes straight from one camera to the next, turning
    evenly. `fps` [1/s] is that of the views, of which there are `most`, by default as many as the
    path has room for. ParameterError if the path is too short for so many, or for two.
    """
    check_speed(speed)
    spacing, steps = speed / KMH / fps, _steps(cameras)
    length = steps.sum()
    room = int(length / spacing * (1 + 1e-9)) + 1
    count = room if most is None else most
    if room < max(count, 2):
        raise ParameterError(
            f"--drive-speed {speed:g} at --fps {fps:g} places views {spacing:.3g} m apart; the "
            f"path of {length:.3g} m has room for {room}, and must for {max(count, 2)}; lower "
            "--drive-speed or --views, or raise --fps"
        )
    if count > MOST_VIEWS:
        raise ParameterError(
            f"--drive-speed {speed:g} and --fps {fps:g} make {count} views; there must be at most "
            f"{MOST_VIEWS}; raise the speed, lower --fps or give --views"
        )
    reached = np.concatenate([[0.0], np.cumsum(steps)])
    way = np.minimum(np.arange(count) * spacing, length)
    before = np.clip(np.searchsorted(reached, way, side="right") - 1, 0, len(steps) - 1)
    share = np.clip((way - reached[before]) / np.maximum(steps[before], 1e-12), 0, 1)
    moves, turns = motions(cameras)
    return [
        replace(_between(cameras[k], cameras[k + 1], s, moves[k], turns[k]), name=f"drive_{n:05d}")
        for n, (k, s) in enumerate(zip(before.tolist(), share.tolist(), strict=True))
    ]


def _between(first, second, share, move, turn):
    values = {n: (1 - share) * getattr(first, n) + share * getattr(second, n) for n in INTRINSICS}
    return replace(moved(first, share * move, share * turn), **values)


def _steps(cameras):
    place = np.array([camera.position for camera in cameras]).reshape(-1, 3)
    return np.linalg.norm(np.diff(place, axis=0), axis=1)
