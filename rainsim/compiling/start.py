"""Compile the kernels that a run needs and the cache on disk lacks, in other processes."""

import importlib
import os

from rainsim.compiling import gpu, shipped
from rainsim.compiling.folder import CACHE_FOLDER, stamp
from rainsim.compiling.pool import Pool, processes
from rainsim.compiling.recorded import needed, on_gpu
from rainsim.compiling.uses import ALL

KEPT_STAMPS = 64


def start(uses, most=None, progress=None, in_line=None):
    """Start to compile the kernels of some uses that have not been compiled; return the `Pool`.

    uses : list of str. Names of `uses`.
    most : int, optional. Number of processes at most; as many as there are cores
        unless given.
    progress : callable, optional. As for `Pool`.
    in_line : callable, optional. in_line(count) is called if kernels are lacking
        that only this process may compile.
    Returns Pool or None. None if there is nothing to compile, if one process
        alone may compile (which then is this one, when it calls a kernel), or if
        NUMBA_DISABLE_JIT is set. The caller must close the pool, by `end`.
    """
    entries, capability = _for_here(uses)
    names = [entry.name for entry in entries] + gpu.versions(capability)
    if not entries or (ready := stamp(names)).exists():
        return None
    lacking = missing(entries)
    if not lacking:
        _note(ready)
        return None
    count = processes(most)
    if count == 1:
        if in_line is not None:
            in_line(len(lacking))
        return None
    pool = Pool(lacking, count, progress, {gpu.CAPABILITY: capability} if capability else None)
    pool.ready = ready
    return pool


def end(pool):
    """Close a pool; if it has compiled everything the next run need not look for the kernels."""
    if pool is None:
        return
    if pool.finished and not pool.stale:
        _note(pool.ready)
    pool.close()


def compile_here(uses, progress):
    """Compile in this process the kernels that some uses lack, one after another."""
    from rainsim.compiling.worker import compile_kernel

    entries = missing(_for_here(uses)[0])
    total, behind = sum(entry.seconds for entry in entries), 0.0
    for done, entry in enumerate(entries):
        progress(behind / total if total else 1.0, done, len(entries))
        compile_kernel(entry.kernel, [entry.arguments])
        behind += entry.seconds
    if entries:
        progress(1.0, len(entries), len(entries))


def missing(entries):
    """Return the recorded kernels that neither the cache on disk nor rainsim-kernels has."""
    modules = {entry.kernel.partition(":")[0] for entry in entries}
    places = [CACHE_FOLDER] if shipped.PACK is None else [CACHE_FOLDER, shipped.PACK.folder]
    known = {name for name in modules if any((place / name).is_dir() for place in places)}
    lacking = [entry for entry in entries if entry.kernel.partition(":")[0] not in known]
    return lacking + [
        entry for entry in entries if entry.kernel.partition(":")[0] in known and _lacks(entry)
    ]


def not_shipped():
    """Return the recorded kernels that the package rainsim-kernels lacks, if it is used."""
    from rainsim.jit import shipped_for

    return [entry for entry in needed(ALL) if _lacks(entry, shipped_for)]


def _lacks(entry, held=None):
    """Return whether a kernel that may have been compiled has not been; imports its module."""
    from rainsim import jit
    from rainsim.compiling.signatures import UnknownType, from_text, split

    held = held or jit.held
    try:
        importlib.import_module(entry.kernel.partition(":")[0])
        kernel = jit.KERNELS[entry.kernel]
        return not held(kernel, tuple(from_text(text) for text in split(entry.arguments)))
    except (ImportError, KeyError, UnknownType):
        return False


def _for_here(uses):
    """Return the recorded kernels of some uses that can run here, and the GPU's capability."""
    entries = [] if _disabled() else needed(uses)
    capability = gpu.capability() if any(map(on_gpu, entries)) else None
    return [entry for entry in entries if capability or not on_gpu(entry)], capability


def _disabled():
    return os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")


def _note(ready):
    """Write the stamp file `ready`; delete the oldest stamps."""
    try:
        ready.parent.mkdir(parents=True, exist_ok=True)
        ready.touch()
        stamps = sorted(ready.parent.iterdir(), key=lambda file: -file.stat().st_mtime)
        for old in stamps[KEPT_STAMPS:]:
            old.unlink(missing_ok=True)
    except OSError:  # another process tidies up, or nothing can be written: look again next time
        pass
