"""What a run has left in its output folder, for comparison with another run's."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from rainsim.io.journal import Journal
from rainsim.output_folder import JOURNAL, PROVENANCE, read_record

NOT_COMPARED = (PROVENANCE, JOURNAL)  # they hold times
FACTS = ("complete", "frames", "ledger", "notes", "files", "fingerprint", "milliseconds")


def written(folder):
    """What lies in a folder: hashes by name."""
    files = [path for path in Path(folder).rglob("*") if path.is_file()]
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files if path.name not in NOT_COMPARED
    }  # fmt: skip


def facts(folder):
    """What a record says but times."""
    record = read_record(folder)
    return {name: record.get(name) for name in FACTS}


def assert_same_run(folder, whole, frames):
    """Assert that a folder holds the files, the record and the `frames` frames of another."""
    assert written(folder) == written(whole) and facts(folder) == facts(whole)
    assert set(Journal(folder, JOURNAL, re.compile(".*").fullmatch).entries()) == {*range(frames)}
