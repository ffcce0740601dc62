"""Splat files in all formats that are read, recognised by their content and never by their name.

All readers return `Splats` in the frame that the capture tool used. SPZ stores other axes (right,
up, back) and glTF y up, so their splats are rotated. A USD stage says where up is and how long its
unit is; its splats are in metres with z up.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from rainsim.errors import InputError
from rainsim.io.files import require_file
from rainsim.scene.activate import MAX_BROKEN_SHARE, without_broken
from rainsim.scene.types import Splats

# Usual endings, by which the splat file of a folder is found.
SUFFIXES = (".ply", ".splat", ".spz", ".sog", ".glb")
META = "meta.json"  # of an unbundled SOG
START = 1 << 17  # bytes at the beginning of a file by which its format is recognised
USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")  # by which its library goes
# A note on a stage that names both.
LEVEL = "the stage says its up axis and unit: splats are in metres with z up"
USD_STARTS = (b"PXR-USDC", b"#usda")
REMEDY = "export the capture as a splat PLY, compressed PLY, SPZ, SOG, .glb, .splat or USD"
HINTS = {
    b"\x89PNG": " (it is a picture)",
    b"\xff\xd8\xff": " (it is a picture)",
    b"RIFF": " (it is a picture or sound; of a SOG name its meta.json)",
    b"version https://git-lfs": " (it is a pointer of Git LFS: `git lfs pull` gets the file)",
}


@dataclass(frozen=True, slots=True)
class Reading:
    """The splats read from a splat file, with its format and notes.

    format : str. For people: "3DGS PLY", "SPZ" and so on.
    notes : tuple of str. What was converted or dropped, one line each.
    """

    splats: Splats
    format: str
    notes: tuple
    broken: int


def read_splats(path):
    """Read a splat file of any format.

    path : path-like. The file; of an unbundled SOG its meta.json or its folder.
    Returns splats : Splats. Activated: linear scales, opacity in [0, 1], unit
        quaternions.
        notes : list of str. What was converted or dropped, one line each; usually
            empty.
    Raises InputError if it is no splat file, is damaged, lies about its size, or
        holds more than 1 % of splats with unusable values; or if the extra that
        reads the format is not installed.
    """
    reading = read(path)
    return reading.splats, list(reading.notes)


def read(path, max_broken=MAX_BROKEN_SHARE):
    """Return the Reading of a splat file of any format; see `read_splats`.

    Unusable splats are dropped up to the share `max_broken`; a file with more is refused.
    """
    path = Path(path)
    if path.is_dir() and (path / META).is_file():
        path = path / META
    path = require_file(path, "a splat file")
    with open(path, "rb") as file:
        start = file.read(START)
        kind, reader = _reader_of(path, start, file)
    splats, good, notes = reader(path)
    splats, dropped, broken = without_broken(path, splats, good, max_broken)
    return Reading(splats, kind, (*notes, *dropped), broken)


def splat_blocks(path):
    """Return a function that yields a splat file's `Splats` in parts, and the file's format."""
    from rainsim.scene.ply import BLOCK, plain_blocks
    from rainsim.scene.plyheader import header_of

    path = Path(path)
    if path.is_file():
        header = header_of(path)
        if header is not None and not header.compressed:
            return lambda: plain_blocks(path, header), "3DGS PLY"
    whole = read(path)

    def parts():
        for start in range(0, len(whole.splats), BLOCK):
            yield whole.splats.take(slice(start, start + BLOCK))

    return parts, whole.format


def trained_antialiased(path):
    """Tell whether a splat file says that its splats were trained antialiased (Mip-Splatting).

    A PLY says so in a comment, see `Header.antialiased`; the meta.json of a SOG by `model`, or by
    `antialias` in older files; a Streamed SOG by that of its first chunk. Other formats are not
    asked.

    path : path-like. As `read_splats` takes it, or a lod-meta.json.
    """
    from rainsim.io.files import read_json
    from rainsim.scene.formats.streamed import LOD_META, read_tree
    from rainsim.scene.plyheader import header_of

    path = Path(path)
    if path.name == LOD_META:
        tree = read_tree(path)
        path = tree.folder / tree.names[0]
    if path.name == META:
        meta = read_json(path, "the meta.json of a SOG")
        known = isinstance(meta, dict)
        return known and (meta.get("model") == "antialiased" or meta.get("antialias") is True)
    header = header_of(path)
    return header is not None and header.antialiased


def sha256_of(path):
    """Return the SHA-256 of a splat file, or of all files of a SOG folder one after the other."""
    digest = hashlib.sha256()
    for part in source_files(path):
        with open(require_file(part, "a picture of a SOG"), "rb") as file:
            hashlib.file_digest(file, lambda: digest)
    return digest.hexdigest()


def source_files(path):
    """Return the files that a splat file consists of: itself, all of a stage or unbundled SOG."""
    path = Path(path)
    if path.name == META:
        return [path, *sorted(path.parent.glob("*.webp"))]
    if path.suffix.lower() in USD_SUFFIXES:
        from rainsim.scene.formats.usd import files_of

        return files_of(path)
    return [path]


def _reader_of(path, start, file):
    """Return the format's name and its reader: reader(path) is splats, usable, notes."""
    if start.startswith((b"ply\n", b"ply\r")):
        return _ply_reader(path, file)
    if start.startswith(USD_STARTS) or path.suffix.lower() in USD_SUFFIXES:
        from rainsim.scene.formats.usd import read_usd_splats

        return "USD", read_usd_splats
    if start.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        if b"/data.pkl" in start[:300]:  # the first name in the archive
            raise InputError(
                f"{path} is a checkpoint of torch; {REMEDY}; of a drive by drivestudio "
                "examples/drives/convert.py makes a scene"
            )
        from rainsim.scene.formats.sog import read_bundle

        return "SOG (one file)", read_bundle
    if start.startswith((b"\x1f\x8b", b"NGSP")):
        from rainsim.scene.formats.spz import read_spz

        return "SPZ", read_spz
    if start.startswith(b"glTF"):
        from rainsim.scene.formats.gltf import read_glb

        return "glTF", read_glb
    if start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        from rainsim.scene.formats.sog import read_folder

        return "SOG (folder)", read_folder
    from rainsim.scene.formats.antimatter import looks_like_records, read_antimatter

    hint = next((text for magic, text in HINTS.items() if start.startswith(magic)), None)
    if hint is None and path.suffix.lower() != ".ksplat" and looks_like_records(start):
        return ".splat", read_antimatter
    if path.suffix.lower() == ".ksplat":
        hint = " (.ksplat is one viewer's own; its converters write .splat and PLY)"
    hint = hint or ("" if start else " (it is empty)")
    raise InputError(f"{path} is no splat file that is known{hint}; {REMEDY}")


def _ply_reader(path, file):
    from rainsim.scene.ply import read_plain
    from rainsim.scene.plyheader import read_header

    file.seek(0)
    header = read_header(path, file)
    if header.compressed:
        from rainsim.scene.formats.compressed import read_compressed

        return "compressed PLY", lambda path: read_compressed(path, header)
    return "3DGS PLY", lambda path: read_plain(path, header)
