"""A run by workers of dask.distributed, on this machine or behind a scheduler's address.

The frames that are missing are cut into as many ranges as there are workers. Each range is one
task, and runs what a process with --frame-range runs.
"""

import asyncio
import logging
import os
import platform
import tempfile
import time
from collections import Counter
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from rainsim import __version__
from rainsim.compiling.pool import cores
from rainsim.errors import BackendError, RainsimError, one_line
from rainsim.farm.shared_run import SharedRun
from rainsim.io.fingerprint import versions
from rainsim.output_folder.frames import FrameFolder, complete_film

HERE = "127.0.0.1"
POLL = 0.5  # s between looks at what is drawn
PATIENCE = 60.0  # s for the first worker to come
NO_PATIENCE = 0.1  # s for a worker here to end by itself
VERSIONS = ("python", "numpy", "numba", "llvmlite")  # that change what kernels compute
# What the engine does beside a frame: pages that show its state, a profile of each worker, and an
# environment in which every large array is given back to the system at once.
SPARE = {
    "distributed.scheduler.http.routes": [], "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False, "distributed.nanny.pre-spawn-environ": {},
}  # fmt: skip


def require():
    """Raise BackendError unless dask.distributed is installed; return the module."""
    try:
        import distributed
    except ImportError:
        raise BackendError(
            'workers need dask.distributed, which is not installed; pip install "rainsim[farm]"'
        ) from None
    return distributed


@contextmanager
def client_of(address=None, workers=1, backend="cpu", threads=None):
    """Yield a client of a scheduler, or of `workers` processes that are started on this machine.

    `address` is that of a scheduler that runs, such as tls://host:8786. Processes that are started
    listen on 127.0.0.1 alone, without a dashboard, and end with the block; with the backend "cuda"
    each of them has a GPU of its own, in turn. `threads` is the number for all of them together, by
    default that of the cores.
    """
    distributed = require()
    import dask

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the run says what matters
    if address is not None:
        with _connected(distributed, address) as client:
            yield client
        return
    each = max((threads or cores()) // workers, 1)
    quiet = {"host": HERE, "dashboard_address": f"{HERE}:0"}
    nannies = {
        n: {"cls": distributed.Nanny, "options": {
            **quiet, "nthreads": 1, "silence_logs": logging.CRITICAL, "memory_limit": 0,
            "env": {"NUMBA_NUM_THREADS": str(each), **_gpu(n, backend)},
        }}
        for n in range(workers)
    }  # fmt: skip
    scheduler = {"cls": distributed.Scheduler, "options": {**quiet, "dashboard": False, "port": 0}}
    with (
        dask.config.set(SPARE),
        distributed.SpecCluster(nannies, scheduler, silence_logs=logging.CRITICAL) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client
        # All frames are drawn: nothing is lost with a worker that is not asked to tidy up.
        cluster.sync(_end, cluster.workers.values())


async def _end(nannies):
    """Kill the processes of workers; one that lingers after that on a busy machine is let go."""
    closing = (nanny.close(timeout=NO_PATIENCE) for nanny in nannies)
    await asyncio.gather(*closing, return_exceptions=True)


async def _require_answer(distributed, address, seconds):
    """Raise OSError or ValueError unless a scheduler answers in time.

    A client goes on trying for minutes where something takes the connection and says nothing.
    """
    arguments = distributed.Security().get_connection_args("client")
    answer = distributed.comm.connect(address, timeout=seconds, **arguments)
    try:
        (await asyncio.wait_for(answer, seconds)).abort()
    except TimeoutError:
        raise OSError(f"not within {seconds:g} s") from None


def _connected(distributed, address):
    """Return a client of the scheduler at an address."""
    if address.startswith("tls://"):
        security = distributed.Security().get_connection_args("client")
        if security.get("ssl_context") is None:
            raise BackendError(
                f"the scheduler at {address} wants TLS, and dask's configuration names no "
                "certificate of the client; it must; see docs/many_machines.md"
            )
    try:
        asyncio.run(_require_answer(distributed, address, PATIENCE / 4))
        return distributed.Client(address, timeout=PATIENCE / 4, set_as_default=False)
    except (OSError, ValueError) as error:
        raise BackendError(
            f"the scheduler at {address} does not answer ({error}); it must run there; start "
            "it with `dask scheduler`, or let --workers N start processes on this machine"
        ) from None


def _gpu(number, backend):
    """Return the environment that leaves a worker one GPU."""
    if backend != "cuda":
        return {}
    from rainsim.cuda import gpus

    given = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = given.split(",") if given else [str(n) for n in range(gpus())]
    return {"CUDA_VISIBLE_DEVICES": names[number % len(names)]}


def facts(token, text):
    """Return what must be equal on all machines, the processor, and the host."""
    from rainsim.jit import processor

    seen = token.is_file() and token.read_text(encoding="utf-8") == text
    equal = {"rainsim": __version__, **versions(VERSIONS)}
    equal["the output folder"] = "seen" if seen else "not seen"
    return equal, processor(), platform.node()


def draw_part(sequence, run, first, end, threads, workers):
    """Draw a range of a run's frames in a worker's process.

    `run` is as `SharedRun` takes it, `threads` the number for kernels, by default the share of a
    worker of the machine's cores; `workers` has their number on each host.
    """
    from rainsim.jit import set_threads

    set_threads(threads or max(cores() // workers[platform.node()], 1))
    folder, record, cameras, config, video = run
    part = replace(config, frame_range=(first, end))
    SharedRun(folder, record, cameras, part, video, resume=True).draw(sequence)


def _hosts(client, folder, say):
    """Return the host of each worker; BackendError unless all draw as we do into the folder."""
    here = client.cluster
    with suppress(TimeoutError):
        client.wait_for_workers(len(here.workers) if here else 1, timeout=PATIENCE)
    with tempfile.NamedTemporaryFile("w", prefix=".", dir=folder) as token:
        token.write(token.name)
        token.flush()
        which = Path(token.name).resolve(), token.name
        found, ours = client.run(facts, *which, on_error="return"), facts(*which)
    why = None if found else f"no worker came within {PATIENCE:g} s"
    for address, its in found.items():
        if isinstance(its, Exception):
            why = f"worker {address} cannot take part ({one_line(str(its))})"
            continue
        for name, value in ours[0].items():
            if its[0][name] != value:
                why = f"worker {address} differs: {name} is {its[0][name]} there and {value} here"
        if its[1] != ours[1]:
            say(
                f"WARNING: worker {address} ({its[2]}) has another processor: its frames "
                "may differ in the last digit of some pixels, see docs/many_machines.md"
            )
    if why:
        raise BackendError(
            f"{why}; workers must have our rainsim and libraries and see the output folder; "
            "start such ones with `dask worker ADDRESS`, stop others, and go on with --resume"
        )
    return {address: its[2] for address, its in found.items()}


def draw_with_workers(client, sequence, run, resume, status, threads=None):
    """Draw the frames that are missing in a folder by workers; return all reports.

    `sequence` is sent to the workers. `run` has folder, record, cameras, settings and the video's
    format, as `FrameFolder` takes them; `status` has `say`, `notes` and `progress`; `threads` is
    the number for each worker.
    """
    folder, record, cameras, config, video = run
    kept, total = FrameFolder(*run, resume).kept, len(config.indices)
    missing = [index for index in config.indices if index not in kept]
    if kept:
        status.say(f"{len(kept)} of {total} frames are finished and kept")
    if missing:
        hosts = _hosts(client, folder, status.say)
        record.begin()
        if client.cluster is not None:  # on this machine: the workers find what is kept
            sequence.keep_setup()
        there = {"workers": list(hosts), "allow_other_workers": False}
        sent = client.scatter(sequence, workers=list(hosts), broadcast=True, hash=False)
        job = Path(folder).resolve(), record, cameras, config, video
        parts = {}
        for part in np.array_split(missing, min(len(hosts), len(missing))):
            first, end = int(part[0]), int(part[-1]) + 1
            drawn = draw_part, sent, job, first, end, threads, Counter(hosts.values())
            parts[first, end] = client.submit(*drawn, pure=False, **there)
        _wait(client, parts, record.journal, set(missing), total, status)
    return complete_film(*run)


def _wait(client, parts, journal, missing, total, status):
    """Wait for all parts, and show what is drawn; RainsimError for the first that failed."""
    before, told, idle, is_over = journal.entries(), set(), 0.0, False
    while not is_over:
        time.sleep(POLL)
        is_over = all(future.done() for future in parts.values())
        try:
            idle = 0.0 if client.nthreads() else idle + POLL
        except (OSError, TimeoutError) as error:
            raise BackendError(
                f"the scheduler is gone ({error}); it must run to the end; start it again and go "
                "on with --resume"
            ) from None
        if idle > PATIENCE:
            raise BackendError("no worker is left; start workers, and go on with --resume")
        entries = journal.entries()
        for index in sorted(missing - told):
            if entries.get(index) != before.get(index):
                status.notes(entries[index]["notes"])
                told.add(index)
        status.progress("frames", total - len(missing) + len(told), total)
    for (first, end), future in parts.items():
        if future.status != "finished":
            why = future.exception() or ConnectionError("its worker is gone")
            raise RainsimError(
                f"frames {first} to {end - 1} were not all drawn by their worker "
                f"({type(why).__name__}: {one_line(str(why))}); frames that are finished are kept; "
                "go on with --resume"
            )
