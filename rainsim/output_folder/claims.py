"""One run at a time in an output folder, and nothing in it lost that no run would make again."""

import os
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path

from rainsim.errors import ParameterError, one_line
from rainsim.io.claim import ClaimedError, claim
from rainsim.io.journal import Journal
from rainsim.output_folder import names


@contextmanager
def claimed(path, overwrite=False, resume=False, sources=(), shared=False):
    """Check and make an output folder and yield it; remove it again if it stays empty.

    Folders above it are made, too. With `overwrite` it may hold files already: earlier results are
    replaced, other files stay. With `resume` it may hold an unfinished run, see `Record.resume`.
    The run reads `sources`: results in the folder are not replaced while they are read. A `shared`
    folder is joined with others that share it, whatever it holds, see `rainsim.farm.shared_run`.

    ParameterError if it holds files and `overwrite` is not set, is no folder, or another run writes
    to it; or if results would replace what the run reads or files that no record of a run lists.
    OSError if it cannot be made or written to.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise ParameterError(f"output {path} is a file; it must be a folder; give another --out")
    require_empty(path, overwrite or resume or shared)
    made = [p for p in (path, *path.parents) if not p.exists()]
    try:
        with claim(path / names.CLAIM, shared):
            require_empty(path, overwrite or resume or shared)  # another run may have been first
            if overwrite and not resume:
                _require_replaceable(path, sources)
            tempfile.TemporaryFile(dir=path).close()  # before hours of work, not after
            yield path
    except ClaimedError as error:
        raise ParameterError(
            f"another run writes to output folder {path} ({error}); each run needs its own, and "
            "processes that share a run all have a --frame-range; give another --out, or remove "
            f"{path / names.CLAIM} if that run has ended"
        ) from None
    finally:
        own = () if shared else (path / "frames", path / "states", path / "layers")
        for folder in (*own, *made):
            with suppress(OSError):  # it is not empty, or not there
                folder.rmdir()


def require_empty(path, overwrite):
    """Raise ParameterError if an output folder holds files, unless it may (`overwrite`)."""
    if (
        path.is_dir()
        and not overwrite
        and any(entry.name != names.CLAIM for entry in path.iterdir())
    ):
        raise ParameterError(
            f"output folder {path} exists and is not empty; it must be new or empty; "
            "give another --out, --overwrite to replace results in it, or --resume to go on with "
            "an unfinished run"
        )


def _require_replaceable(path, sources):
    """Raise ParameterError if new results in `path` would cost more than results of before."""
    record, here = names.read_record(path), path.resolve()
    for source in (Path(source).resolve() for source in sources if source is not None):
        is_ours = source.parent == here and names.OURS.fullmatch(source.name)
        if is_ours or (record and source == here):
            raise ParameterError(
                f"output folder {path} holds what this run reads, {one_line(source.name)}; "
                "--overwrite would remove it; give another --out"
            )
    if record and not record.get("complete"):
        return  # a killed run leaves a file or two that it had no time to note
    noted = Journal(path, names.JOURNAL, names.OURS.fullmatch).entries().values()
    known = {*names.files_of(record), *(name for entry in noted for name in entry["files"])}
    known |= {names.JOURNAL, names.PROVENANCE} if record else set()
    for name in sorted(names.names_in(path)):
        if (name == names.PROVENANCE or names.OURS.fullmatch(name)) and name not in known:
            raise ParameterError(
                f"{path / name} is on no record of a run; --overwrite replaces recorded results "
                "only; give another --out, or move the file away"
            )


def relative(path):
    """Return a path as messages show it: relative if below the current folder, else as given."""
    path = Path(path)
    try:
        short = os.path.relpath(path)
    except ValueError:  # another drive
        return str(path)
    return str(path) if short.startswith("..") else short
