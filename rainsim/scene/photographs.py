"""What photographs beside a capture tell: its scale by GPS, its sun by place and time.

Two results of their EXIF are kept, metres per unit and the direction of the sun; places and times
are neither written nor said.
"""

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
# COLMAP's folder; the original code's of photographs as taken: undistorting drops their EXIF.
FOLDERS = "images", "input"
MOST_FOLDERS, MOST_FILES = 32, 100_000  # that are looked into; of a folder
MOST_READ = 400  # photographs of a capture, evenly spaced
FIX_ERROR, SPAN = 8.0, 5.0  # m, of a phone's fix; times it, from which two fixes lie apart
FEWEST, LEAST_KEPT = 4, 2 / 3  # fixes; share of them that must fit the path of the cameras
MOST_SPREAD = 2.0  # ratio between the 84th and 16th percentile of metres per unit
DEGREE = 111_200.0  # m of latitude, within .5 %
YEARS = range(1990, 2100)  # of photographs: clocks that were never set say 1970 or 1980
MOST_HOURS, LOWEST_SUN = 1.0, 3.0  # between photographs; degrees: beyond them no sun is taken
VIEWS, LEAST_VIEWS, WIDTH, LEAST_PSNR = 5, 3, 320, 20.0  # beside their photographs; px; dB
OTHER_SHAPE = 0.01  # of width over height: a photograph of that shape is not the camera's
FAULTS = ValueError, TypeError, ArithmeticError, AttributeError, LookupError  # of EXIF


class Taken(NamedTuple):
    """Where and when a photograph was taken, as far as its EXIF says so."""

    place: tuple | None = None  # latitude and longitude [degrees]
    utc: datetime | None = None
    clock: datetime | None = None  # of the camera, whose zone is not known


class Laid(NamedTuple):
    """The level path of the cameras, laid over the fixes of their photographs."""

    factor: complex  # east + i north [m] over x + i y [units] of the ground frame
    spread: np.ndarray  # (2,): 16th and 84th percentile of metres per unit over pairs
    span: float  # m
    out: int  # fixes that do not fit


def with_photographs(scene, path, cameras=None, photos=None, keep_scale=False):
    """Return a scene with what the photographs of its cameras tell, and notes on it.

    They are looked for beside the capture at `path` and the file `cameras`, if it is one; or in the
    folder `photos`: InputError if it has none that is named as a camera is. `keep_scale` leaves the
    scale alone even if it is assumed.
    """
    folders = _folders(Path(path), cameras) if photos is None else [Path(photos)]
    found = [_pictures_in(folder) for folder in folders]
    names = [(camera.name, camera.name.rpartition(".")[0]) for camera in scene.cameras]
    files = [[own[key] for own in found for key in keys if key in own] for keys in names]
    if not any(files):
        if photos is None:
            return scene
        raise InputError(
            f"{photos} holds no photograph ({', '.join(SUFFIXES)}) named as a camera of the scene "
            f"is ({', '.join(name for name, _ in names[:3])}); give their folder, or no --photos"
        )
    taken, notes = _taken(files)
    frame, laid, why = scene.ground_frame, None, ""
    which = [k for k, one in enumerate(taken) if one.place]
    if which:
        eyes = np.array([scene.cameras[k].position for k in which])
        path = eyes @ frame.rotation[:2].T @ [1, 1j]
        laid, why = lay_over(path, metres_of([taken[k].place for k in which]))
        if frame.scale_assumed and not keep_scale:
            frame, more = _scaled(frame, scene.cameras, laid, why)
            notes += more
    sun, more = _sun_of([taken[k] for k in which], laid, why)
    return replace(
        scene, ground_frame=frame, notes=(*scene.notes, *notes, *more),
        captured_sun=scene.captured_sun if sun is None else tuple((sun @ frame.rotation).tolist()),
        photographs=tuple(own[0] if own else None for own in files),
    )  # fmt: skip


def _folders(path, cameras):
    """Return the folders in which photographs of a capture may lie, none for a scene folder."""
    if (path if path.is_dir() else path.parent).joinpath(SCENE_FILE).is_file():
        return []
    try:
        splat_file, model = locate(path)
    except InputError:  # what an actors.json names
        return []
    beside = [splat_file.parent, model]
    if isinstance(cameras, str | Path):
        beside.insert(0, Path(cameras).parent)
    found = []
    for file in [folder / "transforms.json" for folder in beside]:
        try:
            frames = read_json(file, "a camera file")["frames"]
            found += [file.parent / Path(frame["file_path"]).parent for frame in frames]
        except (InputError, *FAULTS):  # none, or one without pictures
            continue
    found += [folder / name for folder in beside for name in FOLDERS]
    try:  # "Namespace(..., images='images', source_path='/captures/garden', ...)"
        said = dict(
            re.findall(r"\b(source_path|images)='([^']+)'", read_text(model / "cfg_args", ""))
        )
        found += [Path(said["source_path"], name) for name in (said.get("images", ""), *FOLDERS)]
    except (InputError, KeyError):
        pass
    return list(dict.fromkeys(found))[:MOST_FOLDERS]


def _pictures_in(folder):
    """Return the pictures in a folder and in its folders, by path and by name without suffix."""
    found = {}
    try:
        inside = islice(chain(folder.glob("*"), folder.glob("*/*")), MOST_FILES)
        inside = [path for path in inside if path.suffix.lower() in SUFFIXES]
    except (OSError, ValueError):  # may not be read; no name that a folder can have
        return found
    for path in sorted(inside, key=lambda path: (len(path.parts), path)):
        for key in (path.relative_to(folder).with_suffix("").as_posix(), path.stem):
            found.setdefault(key, path)
    return found


# --- EXIF -----------------------------------------------------------------------------------------


def _taken(files):
    """Return a `Taken` for each camera, whose files are given as lists, and notes on bad ones."""
    from rainsim.io.images import of_photograph  # brings imageio, which few captures need

    found, bad = [Taken()] * len(files), 0
    named = [k for k, own in enumerate(files) if own]
    for k in named[:: max(1, -(-len(named) // MOST_READ))]:
        wrong = False
        for file in files[k]:
            try:
                found[k], damaged = of_photograph(file, taken_of)
            except InputError:
                damaged = True
            wrong |= damaged
            if any(found[k]):
                break
        bad += wrong
    what = f"of {counted(bad, 'photograph')} file, place or time make no sense: left aside"
    return found, [what] if bad else []


def taken_of(picture):
    """Return the `Taken` of a Pillow picture, and whether a part of it made no sense."""
    whole = picture.getexif()
    exif, gps = whole.get_ifd(0x8769), whole.get_ifd(0x8825)
    place, times, damaged = None, (None, None), False
    try:
        if 2 in gps and 4 in gps:
            place = _place(gps)
    except FAULTS:
        damaged = True
    try:
        times = _times(exif, gps, _text(exif.get(0x9003) or whole.get(0x132)))
    except FAULTS:
        damaged = True
    return Taken(place, *times), damaged


def _place(gps):
    """Return latitude and longitude [degrees], to the north and to the east."""
    latitude, longitude = _sixtieths(gps[2]), _sixtieths(gps[4])
    if not (0 <= latitude <= 90 and 0 <= longitude <= 180 and latitude + longitude > 0):
        raise ValueError
    south, west = _text(gps.get(1)) == "S", _text(gps.get(3)) == "W"
    return -latitude if south else latitude, -longitude if west else longitude


def _times(exif, gps, clock):
    """Return UTC and the camera's clock, None what is not known."""
    zone, text = _text(exif.get(0x9011) or exif.get(0x9010)), "%Y:%m:%d %H:%M:%S"
    clock = datetime.strptime(clock, text) if clock else None
    utc = None
    if 29 in gps and 7 in gps:  # GPSDateStamp and GPSTimeStamp are UTC
        utc = datetime.strptime(_text(gps[29]).replace("-", ":"), "%Y:%m:%d")
        utc += timedelta(hours=_sixtieths(gps[7]))
    elif clock and zone:
        utc = clock - datetime.strptime(zone, "%z").utcoffset()
    if any(time and time.year not in YEARS for time in (utc, None if utc else clock)):
        raise ValueError
    return utc, clock


def _sixtieths(parts):
    """Return degrees of degrees, minutes and seconds, or hours likewise."""
    return sum(float(part) / 60**k for k, part in enumerate(parts))


def _text(value):
    return (value.decode() if isinstance(value, bytes) else value or "").strip("\0 ")


# --- scale ----------------------------------------------------------------------------------------


def metres_of(places):
    """Return places (latitude, longitude) [degrees] as east + i north of their middle [m], (n,)."""
    latitude, longitude = np.array(places).T
    east = (longitude - longitude[0] + 180) % 360 - 180  # one may lie beyond 180
    east = (east - np.median(east)) * math.cos(math.radians(float(np.median(latitude))))
    return DEGREE * (east + 1j * (latitude - np.median(latitude)))


def lay_over(path, fixes):
    """Return the `Laid` of a path and fixes, both complex (n,), or None; and why it is not used.

    The first factor is the median over pairs of fixes that lie apart, which a few wrong ones do not
    move; least squares over those that fit, several times, make it better.
    """
    kept = np.ones(len(fixes), bool)

    def pairs(factor=None):  # apart by their fixes; by the path once its factor is known
        i, j = np.triu_indices(int(kept.sum()), 1)
        units, metres = (values[kept][i] - values[kept][j] for values in (path, fixes))
        long = np.abs(metres if factor is None else factor * units)
        apart = (long >= SPAN * FIX_ERROR) & (np.abs(units) > 0)
        return metres[apart] / units[apart], float(long.max(initial=0))

    def middle(values):
        return complex(np.median(values.real), np.median(values.imag))

    ratio, span = pairs()
    if kept.sum() < FEWEST or len(ratio) < FEWEST:
        return None, f"{kept.sum()} fixes span {span:.0f} m, and a phone's are {FIX_ERROR:g} m off"
    factor = np.median(np.abs(ratio)) * np.exp(1j * np.angle(middle(ratio / np.abs(ratio))))
    for _ in range(8):
        off = fixes - factor * path
        off = np.abs(off - middle(off[kept]))
        kept = off <= max(3 * float(np.median(off)), FIX_ERROR)
        units, metres = (values[kept] - values[kept].mean() for values in (path, fixes))
        factor = np.vdot(units, metres) / max(float(np.vdot(units, units).real), 1e-30)
    ratio, span = pairs(factor)
    low, high = spread = np.percentile(np.abs(ratio), (16, 84)) if len(ratio) >= FEWEST else (0, 0)
    fits = low / 1.1 < abs(factor) < 1.1 * high and high < MOST_SPREAD * low
    if kept.mean() < LEAST_KEPT or not fits:
        return None, "its fixes do not lie as the cameras do"
    return Laid(complex(factor), spread, span, int((~kept).sum())), ""


def _scaled(frame, cameras, laid, why):
    """Return the ground frame in the metres of GPS, and a list with a note where it is not used."""
    try:
        scaled = laid and rescale_ground_frame(frame, cameras, abs(laid.factor))
    except ParameterError:
        scaled, why = None, "no capture has such a scale"
    if scaled is None:
        return frame, [f"GPS of the photographs does not give the scale: {why}"]
    note = scaled.notes[-1].replace("scale given:", "scale by GPS of the photographs:")
    note += "; by pairs of fixes {:.3g} to {:.3g} (16 to 84 %)".format(*laid.spread)
    note += f" over {laid.span:.0f} m" + f", {laid.out} left out that do not fit" * bool(laid.out)
    return replace(scaled, notes=(*scaled.notes[:-1], note)), []


# --- sun ------------------------------------------------------------------------------------------


def sun_position(latitude, longitude, utc):
    """Return azimuth, from north towards east, and elevation of the sun [rad].

    The place is in degrees, to the north and to the east, and `utc` a datetime without a zone.
    Within .02 degrees, without refraction, which lifts the sun by .1 degrees at 8 degrees.
    J. Meeus, "Astronomical Algorithms" (1998), chapters 12, 13 and 25 (low accuracy).
    """
    days = (utc - datetime(2000, 1, 1, 12)).total_seconds() / 86400
    anomaly = math.radians(357.529 + 0.98560028 * days)
    along = 280.459 + 0.98564736 * days + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly)
    along, tilt = math.radians(along), math.radians(23.439 - 3.6e-7 * days)  # on the ecliptic
    ascension = math.atan2(math.cos(tilt) * math.sin(along), math.cos(along))
    declination = math.asin(math.sin(tilt) * math.sin(along))
    hour = math.radians(280.46061837 + 360.98564736629 * days + longitude) - ascension
    north, polar = math.cos(math.radians(latitude)), math.sin(math.radians(latitude))
    out, high = math.cos(declination) * math.cos(hour), math.sin(declination)
    azimuth = math.atan2(-math.cos(declination) * math.sin(hour), high * north - out * polar)
    return azimuth % (2 * math.pi), math.asin(np.clip(high * polar + out * north, -1, 1))


def _sun_of(taken, laid, why):
    """Return the unit vector to the captured sun in the ground frame or None, and notes.

    `taken` are those with a place; `laid` and `why` are as `lay_over` returns them.
    """
    times = sorted(one.utc for one in taken if one.utc)
    zoned = bool(times)
    times = times or sorted(one.clock for one in taken if one.clock)
    if not times:
        return None, []
    trim, by = len(times) // 10, "by place and time of the photographs the captured sun "
    hours = (times[-1 - trim] - times[trim]).total_seconds() / 3600
    if hours > MOST_HOURS:
        return None, [f"the photographs were taken over {hours:.1f} hours: no one sun is known"]
    latitude, longitude = np.median([one.place for one in taken], axis=0)
    north = 1j if laid is None else 1j * abs(laid.factor) / laid.factor

    def at(zone):
        utc = times[len(times) // 2] - timedelta(hours=zone)
        azimuth, elevation = sun_position(latitude, longitude, utc)
        flat = cmath.rect(math.cos(elevation), -azimuth) * north
        angle = "AZIMUTH" if laid is None else f"{math.degrees(cmath.phase(flat)):.0f}"
        said = f"--captured-sun={angle},{math.degrees(elevation):.0f}"
        return np.array([flat.real, flat.imag, math.sin(elevation)]), said

    if not zoned:
        zone = round(longitude / 15)
        return None, [
            "the photographs' times have no zone, so that the captured sun is not taken from them; "
            f"in that of their longitude it is {at(zone)[1]}, in summer time {at(zone + 1)[1]}"
        ]
    sun, said = at(0)
    if sun[2] < math.sin(math.radians(LOWEST_SUN)):
        return None, [by + "was down or at the horizon: it is not taken"]
    if laid is None:
        return None, [f"{by}is {said}, where GPS does not tell north: {why}"]
    return sun, [f"{by}is {said}; the option takes another"]


# --- pictures -------------------------------------------------------------------------------------


def fidelity_notes(scene, draw):
    """Return a list with a note if a capture is drawn far from its photographs.

    A few views are compared, exposures aligned; photographs that are not undistorted tell nothing.
    `draw(camera)` returns the picture of the capture, (height, width, 3), display-referred.
    """
    from rainsim.io.images import of_photograph

    pairs = [pair for pair in zip(scene.cameras, scene.photographs, strict=False) if pair[1]]
    if scene.pages is not None or any("lens distortion" in note for note in scene.notes):
        return []
    found = []
    for camera, file in pairs[:: max(1, len(pairs) // VIEWS)][:VIEWS]:
        small = resize_to(camera, min(WIDTH, camera.width))

        def read(picture, size=(small.width, small.height)):
            if abs(picture.width / picture.height / (size[0] / size[1]) - 1) < OTHER_SHAPE:
                picture.draft("RGB", (2 * size[0], 2 * size[1]))  # a JPEG is not unpacked finer
                return np.asarray(picture.convert("RGB").resize(size, reducing_gap=3.0))
            return None

        try:
            photograph = of_photograph(file, read)
        except InputError:
            continue
        if photograph is not None:
            found.append(psnr(draw(small), photograph / 255))
    if len(found) < LEAST_VIEWS or np.median(found) >= LEAST_PSNR:
        return []
    return [
        f"WARNING: from its own cameras the capture is drawn {np.median(found):.1f} dB from the "
        f"photographs (median of {len(found)}, exposures aligned): it is not true to them, nor "
        "will its rain be"
    ]


def psnr(drawn, photograph):
    """Return the PSNR [dB] of two display-referred pictures, the exposure of the first aligned."""
    drawn = linear(np.clip(drawn, 0, 1))
    bright = [np.maximum(p @ LUMINANCE_WEIGHTS, 1e-2) for p in (drawn, linear(photograph))]
    drawn = display(drawn * np.exp(np.median(np.log(bright[1] / bright[0]))))
    error = float(np.mean((np.clip(drawn, 0, 1) - photograph) ** 2))
    return -10 * math.log10(max(error, 1e-10))
