"""Splats from SOG: lossless WebP pictures whose pixels are splats, and a meta.json about them.

Bundled, all lie in one zip file; unbundled, in one folder. Both are checked and handed to the
decoder as a fresh bundle in memory, so that it meets no name, size or value it cannot trust.
"""

import io
import json
import struct
import zipfile
from pathlib import PurePosixPath

from rainsim.errors import InputError, one_line
from rainsim.io.files import MAX_LENGTH, require_file
from rainsim.scene.activate import require_believable
from rainsim.scene.camera_entry import Entry
from rainsim.scene.formats.extra import activated, decoding, load_extra

KIND = "SOG"
META = "meta.json"
REMEDY = "it is damaged, export it again"
META_LIMIT = 1 << 22  # bytes; real ones have some 15,000
MEMBER_FREE = 1 << 20  # bytes that a zip member may unpack to, whatever the bundle's size
MEMBER_GROWTH = 4  # times the bundle's size that it may unpack to; WebP does not shrink in a zip
SPARE_PIXELS = 1 << 16  # beyond twice the splats; pictures are nearly full
CODES = 256  # entries of a codebook
PALETTE_ROW = 64  # palette entries in a row of the picture of spherical harmonics
PALETTE_LIMIT = 1 << 16
BANDS = {1: 3, 2: 8, 3: 15}  # SH degree -> coefficients beyond the first


def read_bundle(path):
    """Return the Splats of a bundled SOG file, which are usable, and no notes."""
    size = path.stat().st_size
    try:
        with zipfile.ZipFile(path) as archive:
            infos = {info.filename: info for info in archive.infolist()}
            root = _root(path, infos)

            def load(name):
                return _unpack(path, archive, infos.get(root + name), name, size)

            return *_read(path, load, size), []
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, RuntimeError) as error:
        raise InputError(
            f"{path} is not a whole zip file ({type(error).__name__}); {REMEDY}"
        ) from None
    except (EOFError, OSError, ValueError, struct.error) as error:
        raise InputError(f"{path} cannot be unpacked ({type(error).__name__}); {REMEDY}") from None


def read_folder(path):
    """Return the Splats of an unbundled SOG whose meta.json is `path`; see `read_bundle`."""
    return *read_rows(path), []


def read_rows(path):
    """Return all splats of an unbundled SOG in their order, and which are usable (n,)."""

    def load(name):
        file = path if name == META else path.parent / name
        return require_file(file, "a part of a SOG").read_bytes()

    if path.stat().st_size > META_LIMIT:  # before it is read
        raise InputError(f"{path} is too large for the meta.json of a SOG; check the path")
    size = sum(f.stat().st_size for f in path.parent.glob("*.webp") if f.is_file())
    return _read(path, load, size)


# --- the archive ----------------------------------------------------------------------------------


SPLATS = (".ply", ".splat", ".spz", ".sog", ".glb", ".ksplat")


def _root(path, infos):
    """Return the folder in the archive that holds meta.json, as a prefix of names."""
    found = [name for name in infos if PurePosixPath(name).name == META]
    inside = [name for name in infos if PurePosixPath(name).suffix.lower() in SPLATS]
    if not found and inside:
        raise InputError(
            f"{path} is a zip file with the capture {one_line(inside[0])} in it; a SOG bundle has "
            "a meta.json; unpack the zip and name the folder"
        )
    if len(found) != 1:
        raise InputError(
            f"{path} is a zip file with {len(found)} meta.json; a SOG bundle has one; check the "
            "path or export it again"
        )
    return found[0].removesuffix(META)


def _unpack(path, archive, info, name, size):
    if info is None:
        raise InputError(f"{path} lacks {name}, which its meta.json names; {REMEDY}")
    limit = max(MEMBER_FREE, MEMBER_GROWTH * size)
    if info.file_size > limit:
        raise InputError(
            f"{path}: {name} unpacks to {info.file_size} bytes; from a file of {size} at most "
            f"{limit} are believable; {REMEDY}"
        )
    try:
        with archive.open(info) as member:
            data = member.read(limit + 1)  # zipfile stops at the declared size
    except Exception as error:  # decompressors raise errors of their own
        raise InputError(
            f"{path}: {name} cannot be unpacked ({type(error).__name__}); {REMEDY}"
        ) from None
    if len(data) != info.file_size:
        raise InputError(f"{path}: {name} is cut off; {REMEDY}")
    return data


# --- meta.json and pictures -----------------------------------------------------------------------


class _Meta(Entry):
    """The values of a meta.json, each taken out only after a check."""

    remedy = REMEDY

    def group(self, key):
        return _Meta(self.label, key, self.get(key))

    def whole(self, key, low, high):
        value = self.get(key)
        if type(value) is not int or not low <= value <= high:
            raise self.error(key, f"a whole number from {low} to {high}")
        return value

    def files(self, count):
        names = self.get("files")
        good = isinstance(names, list) and len(names) == count
        if not good or not all(isinstance(n, str) and _is_plain_name(n) for n in names):
            raise self.error("files", f"a list of {count} names of .webp files beside it")
        return names


def _is_plain_name(name):
    """Whether it names a picture in the same folder and nothing else."""
    return name.endswith(".webp") and name.isprintable() and not set(name) & set("/\\:")


def _read(path, load, size):
    meta = _Meta(path, "(SOG)", _parse(path, load(META)))
    first = meta.get("version") is None  # version 1 did not name itself
    if not first and meta.get("version") != 2:
        raise meta.error("version", "2, or missing as in version 1")
    checked = {} if first else {"version": 2}
    if first:
        means = meta.group("means")
        shape = means.get("shape")
        count = shape[0] if isinstance(shape, list) and shape else None
        if type(count) is not int:
            raise means.error("shape", "a list of whole numbers")
    else:
        count = meta.whole("count", 0, 1 << 40)
        checked["count"] = count
    require_believable(path, count, size)
    load_extra(path, KIND, "imagecodecs")
    pictures = _Pictures(path, load, count)
    checked |= _checked_splats(meta, pictures, first, count)
    if "shN" in meta.values:
        checked["shN"] = _checked_harmonics(meta.group("shN"), pictures, first)
    with decoding(path, KIND):
        from gsply.sog_reader import sogread

        return activated(sogread(pictures.bundle(checked)))


def _parse(path, data):
    if len(data) > META_LIMIT:
        raise InputError(f"{path}: meta.json is too large for a SOG; check the path")
    try:
        meta = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise InputError(f"{path}: meta.json is not valid JSON; {REMEDY}") from None
    if isinstance(meta, dict) and "asset" in meta and "means" not in meta:
        raise InputError(f"{path} is a glTF in text; export it as binary glTF, .glb")
    if not isinstance(meta, dict) or "means" not in meta:
        raise InputError(
            f"{path} does not describe splats; the meta.json of a SOG has means, scales, quats and "
            "sh0; check the path"
        )
    return meta


def _checked_splats(meta, pictures, first, count):
    """Return the parts of meta.json that all SOG files have, checked, pictures included."""
    means, quats, scales, sh0 = (meta.group(k) for k in ("means", "quats", "scales", "sh0"))
    checked = {
        "means": {
            "mins": means.array("mins", (3,)).tolist(),
            "maxs": means.array("maxs", (3,)).tolist(),
            "files": pictures.take(means.files(2)),
        },
        "quats": {"files": pictures.take(quats.files(1))},
        "scales": {"files": pictures.take(scales.files(1))},
        "sh0": {"files": pictures.take(sh0.files(1))},
    }
    if not first:
        checked["scales"]["codebook"] = scales.array("codebook", (CODES,)).tolist()
        checked["sh0"]["codebook"] = sh0.array("codebook", (CODES,)).tolist()
        return checked
    checked["means"]["shape"] = [count, 3]
    for group, key, channels in ((scales, "scales", 3), (sh0, "sh0", 4)):
        for end in ("mins", "maxs"):
            checked[key][end] = group.array(end, (channels,)).tolist()
    return checked


def _checked_harmonics(harmonics, pictures, first):
    centroids, labels = harmonics.files(2)
    if first:
        pictures.take([labels])
        pictures.take_palette(centroids, [PALETTE_ROW * n for n in BANDS.values()])
        checked = {end: harmonics.number(end, -MAX_LENGTH, MAX_LENGTH) for end in ("mins", "maxs")}
    else:
        bands = harmonics.whole("bands", 1, 3)
        palette = harmonics.whole("count", 1, PALETTE_LIMIT)
        pictures.take([labels])
        _, height = pictures.take_palette(centroids, [PALETTE_ROW * BANDS[bands]])
        if height * PALETTE_ROW < palette:
            raise harmonics.error("count", f"at most {height * PALETTE_ROW}")
        codebook = harmonics.array("codebook", (CODES,)).tolist()
        checked = {"count": palette, "bands": bands, "codebook": codebook}
    return checked | {"files": [centroids, labels]}


class _Pictures:
    """The pictures that were checked, ready to be bundled for the decoder."""

    def __init__(self, path, load, count):
        self.path, self.load, self.count = path, load, count
        self.data = {}

    def take(self, names):
        """Load pictures with a pixel for each splat; return their names."""
        for name in names:
            width, height = self._load(name)
            if not self.count <= width * height <= 2 * self.count + SPARE_PIXELS:
                raise InputError(
                    f"{self.path}: {name} has {width} x {height} pixels for {self.count} splats; "
                    f"it must have one for each and few more; {REMEDY}"
                )
        return names

    def take_palette(self, name, widths):
        """Load the picture of spherical harmonics; return its size."""
        width, height = self._load(name)
        if width not in widths or height * PALETTE_ROW > PALETTE_LIMIT:
            raise InputError(
                f"{self.path}: {name} has {width} x {height} pixels; its width must be "
                f"{' or '.join(map(str, widths))} and its height at most "
                f"{PALETTE_LIMIT // PALETTE_ROW}; {REMEDY}"
            )
        return width, height

    def _load(self, name):
        self.data[name] = data = self.load(name)
        size = webp_size(data)
        if size is None:
            raise InputError(f"{self.path}: {name} is no lossless WebP picture; {REMEDY}")
        return size

    def bundle(self, meta):
        """Return a SOG bundle of `meta` and the pictures as bytes."""
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as archive:  # stored, not compressed
            archive.writestr(META, json.dumps(meta))
            for name, data in self.data.items():
                archive.writestr(name, data)
        return buffer.getvalue()


def webp_size(data):
    """Return width and height of a lossless still WebP picture from its first bytes, else None.

    The header is read by hand so that no picture is unpacked before its size is known.
    """
    if len(data) < 30 or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        return None
    if data[12:16] == b"VP8L" and data[20] == 0x2F:
        bits = int.from_bytes(data[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if data[12:16] == b"VP8X" and not data[20] & 2:  # 2: animated
        return (
            int.from_bytes(data[24:27], "little") + 1,
            int.from_bytes(data[27:30], "little") + 1,
        )
    return None
