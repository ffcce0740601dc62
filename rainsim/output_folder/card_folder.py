"""Folders of numbered parts that a card describes: data sets, and the turns of a lidar."""

from contextlib import suppress

from rainsim.errors import ParameterError
from rainsim.io.files import card_in
from rainsim.io.fingerprint import fingerprint
from rainsim.io.journal import Journal
from rainsim.output_folder.names import others_in, remove_temporary


class CardFolder:
    """A folder of parts with a card and a journal of those that are whole; the caller claims it.

    ours(name) says whether the program gives a name; `what` names the content in errors. `kept` has
    the journal's entries, by number, of parts that an unfinished run before has left.
    """

    def __init__(self, folder, card, journal, ours, what, overwrite, resume):
        self.folder, self.journal, self.kept = folder, Journal(folder, journal, ours), {}
        self.card_file, self._ours, self._what = folder / card, ours, what
        self._before, self._resumes = card_in(self.card_file), resume
        if (overwrite or resume) and self._before is None and (found := others_in(folder)):
            raise ParameterError(
                f"output folder {folder} holds {found[0]} and no {what}; --overwrite and --resume "
                "replace those only; give another --out"
            )

    def find_kept(self, content, count):
        """Find the kept ones of `count` parts; `content` is what their bytes depend on."""
        self.fingerprint = fingerprint(content)
        if not self._resumes or self._before is None:
            return
        if self._before.get("fingerprint") != self.fingerprint:
            raise ParameterError(
                f"the {self._what} in {self.folder} was another: other scene, place, rains, "
                "settings or version; --resume goes on with the very same only; give another "
                "--out, or --overwrite to replace it"
            )
        self.kept = self.journal.finished(range(count))

    def clear(self):
        """Remove the files of an earlier result that are not kept, and folders that are empty."""
        noted = [name for entry in self.journal.entries().values() for name in entry["files"]]
        kept = {name for entry in self.kept.values() for name in entry["files"]}
        for name in (*noted, *(self._before or {}).get("files", ())):
            if isinstance(name, str) and self._ours(name) and name not in kept:
                path = self.folder / name
                path.unlink(missing_ok=True)
                with suppress(OSError):  # until one is not empty
                    for parent in path.parents[: len(path.relative_to(self.folder).parts) - 1]:
                        parent.rmdir()
        remove_temporary(self.folder)
        if self.kept:
            self.journal.begin_line()
        else:
            self.journal.path.unlink(missing_ok=True)
