"""A journal of finished parts: a line of JSON for each, with the hashes of the files it wrote.

A part is noted when all of its files are whole. A run that was killed therefore leaves at most one
part that is not noted, and a line that is cut off; both count as not done.
"""

from __future__ import annotations

import json
from pathlib import Path

from rainsim.io.files import parsed_json
from rainsim.io.fingerprint import hash_of_file


class Journal:
    """The journal of a folder.

    Parameters
    ----------
    folder : Path
    name : str
        Of its file.
    ours : callable
        ours(name) says whether a file's name is one that the program gives: no other is looked at.
    """

    def __init__(self, folder, name, ours):
        self.folder, self.name, self._ours = Path(folder), name, ours

    @property
    def path(self):
        """Of the journal."""
        return self.folder / self.name

    def add(self, index, names, **facts):
        """Note a part whose files, named relative to the folder, are whole."""
        files = {name: hash_of_file(self.folder / name) for name in names}
        line = json.dumps({"index": index, "files": files, **facts}, allow_nan=False)
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(line + "\n")

    def entries(self):
        """Return the last entry of each part, whatever has become of its files, by index."""
        try:
            text = self.path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return {}
        found = {}
        for line in text.split("\n"):
            entry = parsed_json(line)
            if self._is_entry(entry):
                found[entry["index"]] = entry
        return found

    def finished(self, indices):
        """Return the entries of the parts `indices` whose files are as they were written."""
        entries = self.entries()
        return {i: entries[i] for i in indices if i in entries and self._is_whole(entries[i])}

    def begin_line(self):
        """End a line that was cut off, so that the next entry has a line of its own."""
        if self.path.is_file() and not self.path.read_bytes().endswith(b"\n"):
            with open(self.path, "a", encoding="utf-8") as file:
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
