"""What a run has left in its output folder, for comparison with another run's."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np

from rainsim.io.journal import Journal
from rainsim.output_folder.names import JOURNAL, PROVENANCE, read_record

NOT_COMPARED = (PROVENANCE, JOURNAL)  # they hold times
FACTS = ("complete", "frames", "ledger", "notes", "files", "fingerprint", "milliseconds")


def written(folder):
    """What lies in a folder: hashes by name."""
    files = [path for path in Path(folder).rglob("*") if path.is_file()]
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files if path.name not in NOT_COMPARED
    }  # fmt: skip


def layer(path, channels):
    """The values of a float layer, (height, width[, n])."""
    if path.suffix == ".exr":
        import OpenEXR

        with OpenEXR.File(str(path), separate_channels=True) as file:
            parts = {name: channel.pixels for name, channel in file.channels().items()}
    else:
        parts = np.load(path)
    planes = np.stack([parts[name] for name in channels], axis=-1)
    return planes[..., 0] if len(channels) == 1 else planes


def exr_parts(path):
    """The parts of an OpenEXR file as its own library reads them: header and channels by name."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {
            part.name(): (dict(part.header), {n: c.pixels for n, c in part.channels.items()})
            for part in file.parts
        }


def facts(folder):
    """What a record says but times."""
    record = read_record(folder)
    return {name: record.get(name) for name in FACTS}


def assert_same_run(folder, whole, frames):
    """Assert that a folder holds the files, the record and the `frames` frames of another."""
    assert written(folder) == written(whole) and facts(folder) == facts(whole)
    assert set(Journal(folder, JOURNAL, re.compile(".*").fullmatch).entries()) == {*range(frames)}
