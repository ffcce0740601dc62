"""Names of the files in an output folder, and the record that an earlier run left in one."""

import re
from pathlib import Path

from rainsim.errors import InputError
from rainsim.io.files import read_json
from rainsim.io.journal import SHARED_FOLDER

PROVENANCE, RECORD_VERSION, VERSION = "provenance.json", "rainsim_record", 1
CLAIM = ".rainsim-claim"  # locked by the run that writes to the folder
# Names that the program gives to files; other names in a provenance file are ignored.
OURS = re.compile(
    r"frames/\d{5}\.png|states/\d{5}\.npz|preview\.webp|(terrain|splats|actors)\.npz"
    r"|(scene|ground_frame|simulation|transforms)\.json|(bed|top)\.tif|puddles-\d+mm\.png"
    r"|(hillshade|classes|check)\.png|video\.(mp4|mov)|finished\.jsonl|lod-meta\.json"
    r"|layers/(\d{5}\.json|[a-z_]+/\d{5}\.(png|exr|npz))|(env|\d+_\d+)/\w+\.(webp|json)"
    r"|(world|camera)\.usda|(ground|water|rain|capture)\.usdc|ground\.glb"
    r"|(depth|u|v)\.(asc|txt|npy|tif)|depth\.png|gauges\.csv|state\.npz"
    r"|exr/[A-Za-z0-9_-][A-Za-z0-9_.-]*\.exr"
)
JOURNAL = "finished.jsonl"  # which frames or states are finished
STATE = "states/{:05d}.npz"
STATE_FACTS = {"ledger": dict, "notes": list}  # what the journal says of a state, and of a frame
FRAME_FACTS = STATE_FACTS | {"time": float, "milliseconds": dict}
# Files of a run that was killed while it wrote them, see `rainsim.io.files.replacing`.
TEMPORARY = re.compile(r"\.([\w.-]+)\.[a-z0-9_]{8}(\.[a-z0-9]+)?")
FOLDERS = ("", "frames", "states", "layers", "layers/*", "exr", "env", "[0-9]*_[0-9]*")


def others_in(folder):
    """Return the names in a folder besides claims and what a killed run left half written."""
    found = (path.name for path in folder.iterdir())
    return [name for name in found
            if name not in (CLAIM, SHARED_FOLDER) and not TEMPORARY.fullmatch(name)]  # fmt: skip


def remove_temporary(folder):
    """Remove the files anywhere in a folder that a killed run left half written."""
    for path in list(folder.rglob(".*")):
        if path.is_file() and TEMPORARY.fullmatch(path.name):
            path.unlink()


def names_in(folder):
    """Yield the names of all files where the program writes, relative to the folder."""
    for pattern in FOLDERS:
        for path in folder.glob(f"{pattern}/*".lstrip("/")):
            if path.is_file():
                yield path.relative_to(folder).as_posix()


def files_of(record):
    """Return the names of the program's files that a record lists."""
    listed = record.get("files") if isinstance(record.get("files"), list) else []
    return [f for f in listed if isinstance(f, str) and OURS.fullmatch(f)]


def read_record(folder):
    """Return the record of an earlier run in a folder, {} if nothing readable by this version."""
    try:
        record = read_json(Path(folder) / PROVENANCE, "a record")
    except (OSError, InputError):
        return {}
    ours = isinstance(record, dict) and record.get("program") == "rainsim"
    return record if ours and record.get(RECORD_VERSION, VERSION) == VERSION else {}
