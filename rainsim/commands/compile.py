"""Compiling before and beside a run, as the user sees it."""

import contextlib


def refused_folders():
    """Return a note on each folder of compiled kernels that others can write to: it is not used."""
    from rainsim.compiling.folder import CACHE_FOLDER, REFUSED

    return [f"{refused}; {CACHE_FOLDER} is used" for refused in REFUSED]


@contextlib.contextmanager
def compiled_beside(status, uses, threads=None):
    """Compile in other processes what some recorded uses lack, while the block runs.

    `uses` are names of `rainsim.compiling.uses`; at most as many processes compile as the run may
    use threads.
    """
    from rainsim.compiling import folder, shipped
    from rainsim.compiling.start import end, start

    def in_line(count):
        status.say(f"{count} kernels are compiled for this machine, once; it takes minutes")

    status.notes(refused_folders())
    pool = start(uses, threads, status.compiling, in_line)
    if pool is not None and shipped.FAULT is not None:
        status.say(f"the package rainsim-kernels is not used: {shipped.FAULT}")
    try:
        yield pool
    finally:
        end(pool)
        if folder.unsaved is not None:
            status.say(
                f"compiled kernels could not be kept ({folder.unsaved}); make room there, or set "
                "NUMBA_CACHE_DIR"
            )
        if pool is not None and pool.stale:
            count = len(pool.stale)
            status.say(
                f"{count} recorded kernel{'s' if count > 1 else ''} no longer fit"
                f"{'' if count > 1 else 's'}; compiled when called ({pool.stale[0]})"
            )


def uses_of(scene, config, layers=(), backend="cpu"):
    """Return the recorded uses that a run of a scene, a name or a path, is like."""
    from rainsim.compiling.uses import cuda_uses, uses_like
    from rainsim.config.settings import Config
    from rainsim.scene.library import is_capture

    captured = is_capture(scene)
    name = "" if captured else str(scene)
    if backend == "cuda":
        return cuda_uses(layers, captured, name)

    def config_of(preset, changes):
        return Config.from_preset(preset).replace(**changes)

    return uses_like(config, config_of, layers, captured, name)
