"""A journal of finished parts: a line of JSON for each, with the hashes of the files it wrote.

A part is noted when all of its files are whole. A run that was killed leaves parts that are not
noted, those that were being written, and a line that is cut off; all count as not done. Where
several processes fill one folder, on one machine or on many, each has a journal of its own until
all is done: a shared disk does not keep lines apart that two machines append to one file.
"""

import json
from contextlib import suppress
from pathlib import Path

from rainsim.io.files import naming, parsed_json, replacing
from rainsim.io.fingerprint import hash_of_file

SHARED_FOLDER = ".rainsim-shared"  # what processes that fill one folder say to each other


class Journal:
    """The journal of a folder, in its file `name`.

    ours(name) says whether a file's name is one that the program gives: no other is looked at.
    `own` is the name of this process's journal, without ".jsonl", in the subfolder SHARED_FOLDER;
    without one the journal itself is written.
    """

    def __init__(self, folder, name, ours, own=None):
        self.folder, self.name, self._ours = Path(folder), name, ours
        self._parts, self._own = self.folder / SHARED_FOLDER, own

    @property
    def path(self):
        """Path of the journal."""
        return self.folder / self.name

    def add(self, index, names, **facts):
        """Note a part whose files, named relative to the folder, are whole.

        `names` may be a dict of their hashes, None where they are not known.
        """
        known = names if isinstance(names, dict) else dict.fromkeys(names)
        files = {name: known[name] or hash_of_file(self.folder / name) for name in known}
        line = json.dumps({"index": index, "files": files, **facts}, allow_nan=False)
        path = self._parts / f"{self._own}.jsonl" if self._own else self.path
        with naming(path), open(path, "a", encoding="utf-8") as file:
            file.write(line + "\n")

    def entries(self):
        """Return the last entry of each part, whatever has become of its files, by index."""
        found = {}
        for path in (self.path, *sorted(self._parts.glob("*.jsonl"))):
            with suppress(OSError):
                *lines, _ = path.read_bytes().split(b"\n")  # one without an end is left for later
                for entry in map(parsed_json, lines):
                    if self._is_entry(entry):
                        found[entry["index"]] = entry
        return found

    def gather(self):
        """Write all entries to the journal itself, in order, and remove those of processes."""
        parts = sorted(self._parts.glob("*.jsonl"))
        if parts:
            entries = self.entries()
            with replacing(self.path) as temporary:
                lines = [json.dumps(entries[index]) for index in sorted(entries)]
                temporary.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        for path in parts:
            path.unlink(missing_ok=True)

    def finished(self, indices):
        """Return the entries of the parts `indices` whose files are as they were written."""
        entries = self.entries()
        return {i: entries[i] for i in indices if i in entries and self._is_whole(entries[i])}

    def begin_line(self):
        """End a line that was cut off, so that the next entry has a line of its own."""
        if self.path.is_file() and not self.path.read_bytes().endswith(b"\n"):
            with naming(self.path), open(self.path, "a", encoding="utf-8") as file:
                file.write("\n")

    def _is_entry(self, entry):
        files = entry.get("files") if isinstance(entry, dict) else None
        return (
            isinstance(files, dict) and type(entry.get("index")) is int
            and all(self._ours(name) and isinstance(files[name], str) for name in files)
        )  # fmt: skip

    def _is_whole(self, entry):
        for name, known in entry["files"].items():
            path = self.folder / name
            if not path.is_file() or hash_of_file(path) != known:
                return False
        return True
