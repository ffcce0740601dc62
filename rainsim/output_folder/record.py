"""The record of a run: what it was, which files it wrote, and whether another may go on with it."""

import shutil
import sys
import time

from rainsim import __version__
from rainsim.errors import ParameterError, one_line
from rainsim.io.files import write_json
from rainsim.io.fingerprint import fingerprint
from rainsim.io.journal import SHARED_FOLDER, Journal
from rainsim.output_folder.facts import input_facts, scene_content, versions
from rainsim.output_folder.names import (
    FRAME_FACTS,
    JOURNAL,
    OURS,
    PROVENANCE,
    RECORD_VERSION,
    TEMPORARY,
    VERSION,
    files_of,
    names_in,
    others_in,
    read_record,
)
from rainsim.render.frame_files import FRAME

WRITER = {RECORD_VERSION: VERSION, "program": "rainsim", "version": __version__}
NOT_OF_THE_CONTENT = ("preset", "terrain_input")  # facts that name things and change none


class Record:
    """The record of a run: `provenance.json` in its output folder.

    Facts are more entries, plain JSON values, and so is `content`: what the results depend on
    besides the scene and the facts, or in place of facts of the same name.
    """

    def __init__(self, folder, scene=None, content=None, resume=False, **facts):
        self.folder, self._start = folder, time.perf_counter()
        self.facts = {
            **WRITER,
            "command": ["rainsim", *sys.argv[1:]],
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "versions": versions(),
            "input": input_facts(scene, folder),
            **facts,
        }
        own = {k: v for k, v in facts.items() if k not in NOT_OF_THE_CONTENT}
        own |= content or {}
        self.fingerprint = fingerprint({"scene": scene_content(scene), **own})
        self.files = []
        self.journal = Journal(folder, JOURNAL, OURS.fullmatch)
        if resume:
            self.require_same()

    def share(self, folder, name):
        """Note in a journal of this process's own, `name`; `folder` is the folder as seen here."""
        self.folder = folder
        self.journal = Journal(folder, JOURNAL, OURS.fullmatch, name)

    def begin(self):
        """Delete the files of an earlier run, unless it was the same, and write this record."""
        before = read_record(self.folder)
        noted = (name for entry in self.journal.entries().values() for name in entry["files"])
        kept = sorted({*files_of(before), *noted})
        if before.get("fingerprint") == self.fingerprint:
            self.files = kept  # other frames of the same frame sequence
        else:
            for name in (*kept, JOURNAL):
                (self.folder / name).unlink(missing_ok=True)
            shutil.rmtree(self.folder / SHARED_FOLDER, ignore_errors=True)
        self.journal.gather()
        shutil.rmtree(self.folder / SHARED_FOLDER, ignore_errors=True)
        self.journal.begin_line()
        for name in list(names_in(self.folder)):
            folder, _, last = name.rpartition("/")
            while temporary := TEMPORARY.fullmatch(last):  # of a temporary file, too
                last = temporary[1]
            meant = f"{folder}/{last}".lstrip("/")
            if meant != name and (meant == PROVENANCE or OURS.fullmatch(meant)):
                (self.folder / name).unlink()
        self.write(complete=False)  # first of all: a run that is killed can be gone on with

    def resume(self, indices, part=FRAME, facts=FRAME_FACTS):
        """Return the journal's entries of finished parts, whose files are named by `part`."""
        self.require_same()
        return {
            index: entry
            for index, entry in self.journal.finished(indices).items()
            if part.format(index) in entry["files"]
            and all(isinstance(entry.get(name), kind) for name, kind in facts.items())
        }

    def require_same(self):
        """Raise ParameterError if the folder holds what no run with this fingerprint wrote."""
        # First the files, then the record: others may just begin, and write the record first.
        others = others_in(self.folder)
        before = read_record(self.folder)
        if not before:
            if others:
                raise ParameterError(
                    f"output folder {self.folder} holds {one_line(others[0])} and no record of a "
                    "run; --resume and --frame-range go on with an unfinished run only; give "
                    "another --out"
                )
        elif before.get("fingerprint") != self.fingerprint:
            raise ParameterError(
                f"the run in {self.folder} was another: other scene, settings, cameras, layers, "
                "version of rainsim or of its libraries; --resume and --frame-range go on with "
                "the very same run only; give another --out, or --overwrite to replace its results"
            )

    def add(self, *names):
        """Note that files, named relative to the folder, are written."""
        self.files += [name for name in names if name not in self.files]

    def write(self, complete, **facts):
        """Write the record as it stands."""
        self.facts.update(facts)
        write_json(
            self.folder / PROVENANCE,
            {
                **self.facts,
                "complete": complete,
                "seconds": round(time.perf_counter() - self._start, 3),
                "fingerprint": self.fingerprint,
                "files": sorted(self.files),
            },
        )
