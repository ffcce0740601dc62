"""Timelines: settings that change in time, as keyframes, and how they are read and interpolated.

A keyframe names a time and the settings that hold from then on; between two keyframes a setting
is interpolated linearly. A configuration without keyframes is steady.
"""

import math
from bisect import bisect_right
from itertools import pairwise

from rainsim.config.tables import CHANGING
from rainsim.errors import ParameterError, require_choice, require_finite

TIME_KEY = "time_s"
LIST_KEY = "keyframe"  # [[keyframe]] in TOML


def read_keyframes(tables, from_human, where):
    """Return keyframes, a tuple of (time [s], ((attribute, SI value), ...)), from TOML tables.

    `tables` are those under [[keyframe]]; from_human(table, where) gives attributes in SI units
    from the keys of a preset; `where` names the file in errors.
    """
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise ParameterError(
            f"{where}: {LIST_KEY} must be tables; write [[{LIST_KEY}]] above the keys of each"
        )
    frames = []
    for number, table in enumerate(tables, 1):
        place = f"{where}: keyframe {number}"
        own = dict(table)
        if TIME_KEY not in own:
            raise ParameterError(f"{place} has no {TIME_KEY}; each needs one; add {TIME_KEY} = 0.0")
        time = require_finite(f"{place}: {TIME_KEY}", own.pop(TIME_KEY))
        changes = from_human(own, place)
        for name in changes:
            if name not in CHANGING:
                raise ParameterError(
                    f"{place} sets {name}; only {', '.join(CHANGING)} can change with time; "
                    "move the key above the first keyframe"
                )
        frames.append((time, tuple(sorted(changes.items()))))
    return check_keyframes(tuple(frames), where)


def check_keyframes(frames, where="keyframes"):
    """Return `frames`, or raise ParameterError unless their times rise and all are numbers."""
    for time, changes in frames:
        for name, value in changes:
            for number in value if isinstance(value, tuple) else (value,):
                require_finite(f"{where}: {name} at {time:g} s", number)
    for (before, _), (after, _) in pairwise(frames):
        if not before < after:
            raise ParameterError(
                f"{where}: a keyframe at {after:g} s follows one at {before:g} s; times must rise; "
                "sort them"
            )
    return frames


def from_json(frames):
    """Return keyframes that were read from JSON, which has lists in place of tuples.

    ParameterError if they are not lists of a time and of pairs of a setting that can change and its
    value.
    """
    try:
        found = tuple(
            (
                require_finite("the time of a keyframe", time),
                tuple((name, tuple(v) if isinstance(v, list) else v) for name, v in changes),
            )
            for time, changes in frames
        )
    except (TypeError, ValueError):
        raise ParameterError(
            "the keyframes are no list of [time, [[setting, value], ...]]; correct them"
        ) from None
    for _, changes in found:
        for name, _ in changes:
            require_choice("a setting of a keyframe", name, CHANGING)
    return check_keyframes(found)


def without(frames, names):
    """Return the keyframes without the settings `names`, which become steady."""
    return tuple(
        (time, tuple((name, value) for name, value in changes if name not in names))
        for time, changes in frames
    )


def values_at(frames, base, time):
    """Return the settings, a dict of SI values, that the keyframes give at `time` [s].

    `base(name)` is the value that holds before the first keyframe that sets `name`.
    """
    names = {name for _, changes in frames for name, _ in changes}
    return {name: _value(frames, name, base(name), time) for name in sorted(names)}


def _value(frames, name, value, time):
    """Interpolate one setting between the keyframes that name it."""
    track = [(at, dict(changes)[name]) for at, changes in frames if name in dict(changes)]
    if track[0][0] > frames[0][0]:  # not named by the first: it starts from what held before
        if value is None:
            raise ParameterError(
                f"{name} is set by a later keyframe only; it has no value before; set it in the "
                "first keyframe too"
            )
        track.insert(0, (frames[0][0], value))
    later = bisect_right([at for at, _ in track], time)
    if later in (0, len(track)):
        return track[min(later, len(track) - 1)][1]
    (t0, a), (t1, b) = track[later - 1], track[later]
    part = (time - t0) / (t1 - t0)
    if name == "wind":
        return _between_winds(a, b, part)
    return a + (b - a) * part


def _between_winds(a, b, part):
    """Interpolate winds (speed, direction) as vectors."""
    x, y = (
        (1 - part) * a[0] * turn(a[1]) + part * b[0] * turn(b[1]) for turn in (math.cos, math.sin)
    )
    return math.hypot(x, y), math.atan2(y, x)


def check_moments(moments, frames):
    """Raise ParameterError unless there is a moment for each frame, or none at all.

    A moment is the number of the water's state that a frame shows; they rise.
    """
    if moments and len(moments) != frames:
        raise ParameterError(
            f"moments of frames are {len(moments)} for {frames}; give one for each or none"
        )
    for before, moment in pairwise((0, *moments)):
        whole = isinstance(moment, int) and not isinstance(moment, bool)
        if not whole or moment < before:
            raise ParameterError(
                f"moment of a frame is {moment!r}; it must be a whole number, {before} or more, as "
                "rain runs forwards; correct it"
            )
