"""What photographs beside a capture tell: its scale by GPS, its sun by place and time.

Photographs are never needed. Of their EXIF two results are kept, metres per unit and the direction
of the sun; places and times are neither written nor said.
"""

from __future__ import annotations

import cmath
import math
import re
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rainsim.errors import InputError, ParameterError, counted
from rainsim.io.files import read_json, read_text
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, display, linear
from rainsim.scene.cameras import resize_to
from rainsim.scene.folder import SCENE_FILE, locate
from rainsim.scene.ground import rescale_ground_frame

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")
# Folders of photographs: COLMAP's, and that of the original code for those that are not undistorted
# yet, since undistorting drops EXIF.
FOLDERS = "images", "input"
MOST_FILES = 100_000  # of a folder
MOST_READ = 400  # photographs, evenly spaced
MOST_CFG = 1 << 20  # bytes of cfg_args
FIX_ERROR = 8.0  # m, of a phone's fix
SPAN = 5.0  # times that, from which the distance between two fixes counts
FEWEST = 4  # fixes
LEAST_KEPT = 2 / 3  # of the fixes, that must fit the path of the cameras
MOST_SPREAD = 2.0  # ratio between the 84th and 16th percentile of metres per unit
DEGREE = 111_200.0  # m of a degree of latitude, within .5 %
FAR_FIX = 5.0  # times the median distance from the middle, beyond which a fix is no fix
YEARS = range(1990, 2100)  # of photographs; clocks that were never set say 1970 or 1980
MOST_HOURS, LOWEST_SUN = 1.0, 3.0  # between the photographs; degrees: beyond them no sun is taken
VIEWS, WIDTH = 5, 320  # that are compared with their photographs; px
LEAST_PSNR = 20.0  # dB
EXIF_TIME = "%Y:%m:%d %H:%M:%S"


class Taken(NamedTuple):
    """Where and when a photograph was taken, as far as its EXIF says so."""

    place: tuple | None = None  # latitude and longitude [degrees]
    utc: datetime | None = None
    clock: datetime | None = None  # of a camera that does not say its zone


class Laid(NamedTuple):
    """The level path of the cameras, laid over the fixes of their photographs."""

    factor: complex  # east + i north [m] over x + i y [units] of the ground frame
    spread: tuple  # 16th and 84th percentile of metres per unit over pairs
    span: float  # m
    kept: np.ndarray  # bool (n,): which fixes fit


def with_photographs(scene, path, cameras=None, photos=None, keep_scale=False):
    """Return a scene with what the photographs of its cameras tell, and notes on it.

    Parameters
    ----------
    scene : Scene
    path : path-like
        The capture, beside which photographs are looked for.
    cameras : path-like or sequence of Camera, optional
        As `import_scene` takes them.
    photos : path-like, optional
        The folder of the photographs; InputError if it has none that is named as a camera is.
    keep_scale : bool
        Leave the scale alone even if it is assumed.
    """
    folders = _folders(Path(path), cameras) if photos is None else [Path(photos)]
    found = [_pictures_in(folder) for folder in folders]
    files = [
        tuple(own[key] for own in found for key in _keys(camera.name) if key in own)
        for camera in scene.cameras
    ]
    if not any(files):
        if photos is None:
            return scene
        names = ", ".join(camera.name for camera in scene.cameras[:3])
        raise InputError(
            f"{photos} holds no photograph that is named as a camera of the capture is "
            f"({names or 'it has no cameras'}; {', '.join(SUFFIXES)}); give their folder, or leave "
            "--photos out"
        )
    taken, notes = _taken(files)
    frame = scene.ground_frame
    which = [k for k, one in enumerate(taken) if one.place is not None]
    laid, why = None, ""
    if which:
        eyes = np.array([scene.cameras[k].position for k in which]) @ frame.rotation[:2].T
        fixes = metres_of([taken[k].place for k in which])
        laid, why = lay_over(eyes @ [1, 1j], fixes)
        if not keep_scale and frame.scale_assumed:
            frame, more = _scaled(frame, scene.cameras, laid, why)
            notes += more
    sun, more = _sun_of([taken[k] for k in which], laid, why)
    if sun is not None:
        sun = tuple((frame.rotation.T @ sun).tolist())
    return replace(
        scene, ground_frame=frame, captured_sun=sun, notes=(*scene.notes, *notes, *more),
        photographs=tuple(own[0] if own else None for own in files),
    )  # fmt: skip


# --- files ----------------------------------------------------------------------------------------


def _folders(path, cameras):
    """Return the folders in which photographs of a capture may lie, none for a scene folder."""
    if (path if path.is_dir() else path.parent).joinpath(SCENE_FILE).is_file():
        return []
    splat_file, model = locate(path)
    found, beside = [], [splat_file.parent, model]
    lists = [folder / "transforms.json" for folder in beside]
    if isinstance(cameras, str | Path):
        lists, beside = [Path(cameras)], [Path(cameras).parent, *beside]
    for file in lists:
        try:
            frames = read_json(file, "a camera file").get("frames")
            found += [file.parent / Path(frame["file_path"]).parent for frame in frames]
        except (InputError, AttributeError, KeyError, TypeError):  # another kind of cameras
            continue
    found += [folder / name for folder in beside for name in FOLDERS]
    try:  # "Namespace(..., images='images', source_path='/captures/garden', ...)"
        text = read_text(model / "cfg_args", "cfg_args", MOST_CFG)
    except InputError:
        text = ""
    if source := re.search(r"source_path='([^'\0]*)'", text):
        images = re.search(r"images='([^'\0]+)'", text)
        names = (images[1] if images else FOLDERS[0]), *FOLDERS
        found += [Path(source[1]) / name for name in names]
    return list(dict.fromkeys(found))


def _pictures_in(folder):
    """Return the pictures in a folder and in its folders, by path and by name without suffix."""
    found = {}
    try:
        inside = islice(chain(folder.glob("*"), folder.glob("*/*")), MOST_FILES)
        inside = [path for path in inside if path.suffix.lower() in SUFFIXES]
    except (OSError, ValueError):  # may not be read, or no name that a folder can have
        return found
    for path in sorted(inside, key=lambda path: (len(path.parts), path)):
        for key in (path.relative_to(folder).with_suffix("").as_posix(), path.stem):
            found.setdefault(key, path)
    return found


def _keys(name):
    """Return the names without suffix that the photograph of a camera may have."""
    return dict.fromkeys((name, name.rpartition(".")[0] or name))


def _taken(files):
    """Return a `Taken` for each camera, whose files are given as tuples, and a note on bad ones."""
    from rainsim.io.images import exif_of  # brings imageio, which captures without them do not need

    found, bad = [Taken()] * len(files), 0
    named = [k for k, own in enumerate(files) if own]
    for k in named[:: -(-len(named) // MOST_READ)]:
        wrong = False
        for file in files[k]:
            try:
                one, damaged = taken_of(*exif_of(file))
            except InputError:
                one, damaged = Taken(), True
            wrong |= damaged
            if one != Taken():
                found[k] = one
                break
        bad += wrong
    if not bad:
        return found, []
    which = counted(bad, "photograph")
    return found, [f"{which} cannot be read, or have a place or time that cannot be; left aside"]


# --- EXIF -----------------------------------------------------------------------------------------


def taken_of(exif, gps, picture):
    """Return the `Taken` of groups of EXIF, dicts by tag, and whether a part was no sense."""
    found, damaged = [], False
    for part in (_place, _utc, _clock):
        try:
            found.append(part(exif, gps, picture))
        except (ValueError, TypeError, ArithmeticError, AttributeError, LookupError):
            found.append(None)
            damaged = True
    return Taken(*found), damaged


def _place(exif, gps, picture):
    if 2 not in gps or 4 not in gps:
        return None
    place = _sixtieths(gps[2]), _sixtieths(gps[4])
    if not (0 <= place[0] <= 90 and 0 <= place[1] <= 180) or place == (0, 0):  # false for NaN
        raise ValueError
    south, west = _text(gps.get(1)) == "S", _text(gps.get(3)) == "W"
    return place[0] * (-1 if south else 1), place[1] * (-1 if west else 1)


def _utc(exif, gps, picture):
    if 29 in gps and 7 in gps:  # GPSDateStamp and GPSTimeStamp are UTC
        day = datetime.strptime(_text(gps[29]).replace("-", ":"), EXIF_TIME[:8])
        return _sensible(day + timedelta(hours=_sixtieths(gps[7])))
    clock, zone = _clock_of(exif, picture), _text(exif.get(0x9011) or exif.get(0x9010))
    if clock is None or not zone:
        return None
    return _sensible(datetime.strptime(clock + zone, EXIF_TIME + "%z"))


def _clock(exif, gps, picture):
    clock = _clock_of(exif, picture)
    return None if clock is None else _sensible(datetime.strptime(clock, EXIF_TIME))


def _clock_of(exif, picture):
    """Return DateTimeOriginal, or else DateTime, as text; None without one."""
    return _text(exif.get(0x9003) or picture.get(0x132)) or None


def _sensible(time):
    """Return a time in UTC, as far as its zone is known; ValueError if it cannot be."""
    time = (time - (time.utcoffset() or timedelta())).replace(tzinfo=None)
    if time.year not in YEARS:
        raise ValueError
    return time


def _sixtieths(parts):
    """Return degrees of degrees, minutes and seconds, or hours likewise."""
    return sum(float(part) / 60**k for k, part in enumerate(parts))


def _text(value):
    value = value.decode("ascii") if isinstance(value, bytes) else value
    return (value or "").strip("\0 ")


# --- scale ----------------------------------------------------------------------------------------


def metres_of(places):
    """Return places (latitude, longitude) [degrees] as east + i north of their middle [m], (n,)."""
    latitude, longitude = np.array(places).T
    east = (longitude - longitude[0] + 180) % 360 - 180  # of the first: one may lie beyond 180
    east = (east - np.median(east)) * math.cos(math.radians(float(np.median(latitude))))
    return DEGREE * (east + 1j * (latitude - np.median(latitude)))


def lay_over(path, fixes):
    """Return the `Laid` of a path and fixes, both complex (n,), or None; and why it is not used.

    The first factor is the median over pairs of fixes that lie apart, which a few wrong ones do not
    move; least squares over those that fit, several times, make it better.
    """
    kept = np.abs(fixes) <= FAR_FIX * max(float(np.median(np.abs(fixes))), FIX_ERROR)
    if kept.sum() < FEWEST:
        return None, f"{counted(len(fixes), 'fix').replace('fixs', 'fixes')}, {FEWEST} are needed"

    def ratios():
        i, j = np.triu_indices(int(kept.sum()), 1)
        units, far = (values[kept][i] - values[kept][j] for values in (path, fixes))
        apart = (np.abs(far) >= SPAN * FIX_ERROR) & (np.abs(units) > 0)
        return far[apart] / units[apart], float(np.abs(far).max(initial=0))

    ratio, span = ratios()
    short = f"they span {{:.0f}} m, and a phone's fix is {FIX_ERROR:g} m off"
    if len(ratio) < FEWEST:
        return None, short.format(span)
    turn = _median(ratio / np.abs(ratio))
    factor = np.median(np.abs(ratio)) * turn / max(abs(turn), 1e-9)
    for _ in range(8):
        off = fixes - factor * path
        off = np.abs(off - _median(off[kept]))
        kept = off <= max(3 * float(np.median(off)), FIX_ERROR)
        units, metres = (values[kept] - values[kept].mean() for values in (path, fixes))
        factor = np.vdot(units, metres) / max(float(np.vdot(units, units).real), 1e-30)
    ratio, span = ratios()
    if len(ratio) < FEWEST:
        return None, short.format(span)
    low, middle, high = np.percentile(np.abs(ratio), (16, 50, 84))
    fits = kept.mean() >= LEAST_KEPT and high <= MOST_SPREAD * low
    if not (fits and 1 / MOST_SPREAD < abs(factor) / middle < MOST_SPREAD):
        return None, "they do not lie as the cameras do"
    return Laid(complex(factor), (float(low), float(high)), span, kept), ""


def _median(values):
    return complex(np.median(values.real), np.median(values.imag))


def _scaled(frame, cameras, laid, why):
    """Return the ground frame in the metres of GPS, and a list with a note where it is not used."""
    try:
        if laid is not None:
            scaled = rescale_ground_frame(frame, cameras, abs(laid.factor))
    except ParameterError:  # beyond all scales
        laid, why = None, "no capture has such a scale"
    if laid is None:
        return frame, [f"GPS of the photographs does not give the scale: {why}"]
    low, high = laid.spread
    out = int((~laid.kept).sum())
    note = scaled.notes[-1].replace("scale given:", "scale by GPS of the photographs:")
    note += (
        f"; by pairs of {len(laid.kept)} fixes over {laid.span:.0f} m it is {low:.3g} to "
        f"{high:.3g} (16 to 84 %)" + (f", {out} left out, which fit nowhere" if out else "")
    )
    return replace(scaled, notes=(*scaled.notes[:-1], note)), []


# --- sun ------------------------------------------------------------------------------------------


def sun_position(latitude, longitude, utc):
    """Return azimuth, from north towards east, and elevation of the sun [rad].

    Within .02 degrees, refraction left out, which lifts the sun by .1 degrees at 8 degrees.

    Parameters
    ----------
    latitude, longitude : float [degrees]
        To the north and to the east.
    utc : datetime
        Without a zone.

    References
    ----------
    J. Meeus, "Astronomical Algorithms" (1998), chapters 12, 13 and 25 (low accuracy).
    """
    days = (utc - datetime(2000, 1, 1, 12)).total_seconds() / 86400
    anomaly = math.radians(357.529 + 0.98560028 * days)
    longitude_of_sun = math.radians(
        280.459 + 0.98564736 * days + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly)
    )
    tilt = math.radians(23.439 - 3.6e-7 * days)
    ascension = math.atan2(math.cos(tilt) * math.sin(longitude_of_sun), math.cos(longitude_of_sun))
    declination = math.asin(math.sin(tilt) * math.sin(longitude_of_sun))
    sidereal = math.radians(280.46061837 + 360.98564736629 * days)
    hour, place = sidereal + math.radians(longitude) - ascension, math.radians(latitude)
    high = math.sin(place) * math.sin(declination)
    high += math.cos(place) * math.cos(declination) * math.cos(hour)
    azimuth = math.atan2(
        -math.sin(hour) * math.cos(declination),
        math.sin(declination) * math.cos(place)
        - math.cos(declination) * math.sin(place) * math.cos(hour),
    )
    return azimuth % (2 * math.pi), math.asin(max(-1.0, min(1.0, high)))


def _sun_of(taken, laid, why):
    """Return the unit vector to the captured sun in the ground frame or None, and notes.

    `taken` are those with a place, `laid` and `why` as `lay_over` returns them.
    """
    times = sorted(one.utc for one in taken if one.utc is not None)
    sure = bool(times)
    times = times or sorted(one.clock for one in taken if one.clock is not None)
    if not times:
        return None, []
    trim = len(times) // 10
    hours = (times[-1 - trim] - times[trim]).total_seconds() / 3600
    if hours > MOST_HOURS:
        return None, [f"the photographs were taken over {hours:.1f} hours: no one sun is known"]
    latitude, longitude = np.median(np.array([one.place for one in taken]), axis=0)

    def at(hours_east):
        time = times[len(times) // 2] - timedelta(hours=hours_east)
        azimuth, elevation = sun_position(latitude, longitude, time)
        north = 1j if laid is None else 1j * abs(laid.factor) / laid.factor
        flat = north * cmath.exp(-1j * azimuth)
        return np.array([math.cos(elevation) * flat.real, math.cos(elevation) * flat.imag,
                         math.sin(elevation)])  # fmt: skip

    if not sure:
        zone = round(longitude / 15)
        options = [_as_option(at(hours), laid) for hours in (zone, zone + 1)]
        return None, [
            "the photographs say the time without its zone, so no sun is taken; if it is that of "
            f"their longitude, --captured-sun {options[0]}; in summer time {options[1]}"
        ]
    sun = at(0)
    if math.degrees(math.asin(sun[2])) < LOWEST_SUN:
        return None, ["by place and time of the photographs the sun was down; none is taken"]
    if laid is None:
        return None, [
            "by place and time of the photographs the sun stood at --captured-sun "
            f"{_as_option(sun, laid)}; where north is their GPS does not tell ({why})"
        ]
    return sun, [
        f"by place and time of the photographs the captured sun stood at {_as_option(sun, laid)} "
        "degrees (azimuth, elevation); --captured-sun takes another"
    ]


def _as_option(sun, laid):
    """Return the angles of a unit vector as --captured-sun takes them."""
    azimuth = "AZIMUTH" if laid is None else f"{math.degrees(math.atan2(sun[1], sun[0])):.0f}"
    return f"{azimuth},{math.degrees(math.asin(sun[2])):.0f}"


# --- pictures -------------------------------------------------------------------------------------


def fidelity_notes(scene, draw):
    """Return a note if a capture is drawn far from its photographs: a list of at most one.

    A few views are compared, exposures aligned. Photographs of another shape than their camera's
    and those of lenses that distort are not undistorted, and tell nothing.

    Parameters
    ----------
    scene : Scene
    draw : callable
        draw(camera) returns the picture of the capture, (height, width, 3), display-referred.
    """
    from rainsim.io.images import small_photograph

    pairs = [pair for pair in zip(scene.cameras, scene.photographs, strict=False) if pair[1]]
    if scene.pages is not None or any("lens distortion" in note for note in scene.notes):
        return []
    found = []
    for camera, file in pairs[:: max(1, len(pairs) // VIEWS)][:VIEWS]:
        camera = resize_to(camera, min(WIDTH, camera.width))
        try:
            photograph = small_photograph(file, camera.width, camera.height)
        except InputError:
            continue
        if photograph is not None:
            found.append(psnr(draw(camera), photograph / 255))
    if not found or np.median(found) >= LEAST_PSNR:
        return []
    return [
        f"from its own cameras the capture is drawn {np.median(found):.1f} dB from the photographs "
        f"(median of {len(found)}, exposure aligned): it is not true to them, and its rain will "
        "not be; more photographs or a longer training help"
    ]


def psnr(drawn, photograph):
    """Return the PSNR [dB] of two display-referred pictures, the exposure of one aligned."""
    drawn, light = linear(np.clip(drawn, 0, 1)), linear(photograph)
    both = [np.maximum(picture @ LUMINANCE_WEIGHTS, 1e-2) for picture in (drawn, light)]
    drawn = display(drawn * np.exp(np.median(np.log(both[1] / both[0]))))
    error = float(np.mean((np.clip(drawn, 0, 1) - photograph) ** 2))
    return -10 * math.log10(max(error, 1e-10))
