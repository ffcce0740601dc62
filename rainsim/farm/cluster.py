"""A run by workers of dask.distributed, on this machine or behind a scheduler's address."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections import Counter
from contextlib import contextmanager, suppress
from copy import copy
from pathlib import Path

from rainsim.errors import BackendError, RainsimError
from rainsim.farm import worker as on_worker
from rainsim.farm.chunks import Chunks, accept
from rainsim.io.fingerprint import sources, versions
from rainsim.io.journal import SHARED_FOLDER
from rainsim.output_folder import OURS, FrameFolder

HERE = "127.0.0.1"
POLL = 0.5  # s between looks at who is there
PATIENCE = 60.0  # s for a worker to say what it is, and for the first worker to come
NO_PATIENCE = 0.1  # s for a worker here to end by itself
VERSIONS = ("python", "numpy", "numba", "llvmlite")  # that change what kernels compute
# What the engine does beside a frame: pages that show its state, a profile of each worker, and an
# environment in which every large array is given back to the system at once.
SPARE = {
    "distributed.scheduler.http.routes": [], "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False, "distributed.nanny.pre-spawn-environ": {},
}  # fmt: skip
NO_ENGINE = 'workers need dask.distributed, which is not installed; pip install "rainsim[farm]"'


def require():
    """Raise BackendError unless dask.distributed is installed; return the module."""
    try:
        import distributed
    except ImportError:
        raise BackendError(NO_ENGINE) from None
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
    each = max((threads or os.cpu_count() or 1) // workers, 1)
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
        # All frames are accepted: nothing is lost with a worker that is not asked to tidy up.
        cluster.sync(_end, cluster.workers.values())


async def _end(nannies):
    """Kill the processes of workers; one that lingers after that on a busy machine is let go."""
    closing = (nanny.close(timeout=NO_PATIENCE) for nanny in nannies)
    for fault in await asyncio.gather(*closing, return_exceptions=True):
        if isinstance(fault, BaseException) and not isinstance(fault, TimeoutError):
            raise fault


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


class FarmRun:
    """A run whose frames are drawn by the workers of a client.

    The states of `sequence`, where it has any, are sent along with each chunk; `chunks` has the
    frames that are to be drawn. say(line) is called with what happens to workers. `threads` is the
    number for each worker's kernels, by default its share of its machine's cores.
    """

    def __init__(self, client, sequence, record, chunks, say, threads=None):
        self._client, self._record, self._states = client, record, sequence.states
        self._sequence = copy(sequence)
        self._sequence.states = None
        self._chunks, self._say, self._threads = chunks, say, threads
        self._name = os.urandom(8).hex()  # of the job
        self._folder = Path(record.folder).resolve()
        self._admitted, self._refused = {}, {}  # what workers are, by address; why not
        self._futures, self._news = {}, threading.Event()

    def draw(self, progress):
        """Draw all frames and note them in the journal; progress(notes) is called as they come."""
        waited, token = 0.0, self._folder / SHARED_FOLDER / f"token-{self._name}"
        token.parent.mkdir(exist_ok=True)
        (self._folder / "frames").mkdir(exist_ok=True)
        token.write_text(self._name, encoding="utf-8")
        try:
            while self._chunks.left:
                there = self._workers()
                for address in there:
                    if address not in self._admitted and address not in self._refused:
                        self._admit(address, token)
                for address in [a for a in self._futures if a not in there]:
                    self._lose(address, "its worker died")
                self._collect(progress)
                self._hand_out([a for a in there if a in self._admitted])
                waited = 0.0 if self._futures else waited + POLL
                if waited > (PATIENCE / 6 if self._refused else PATIENCE):
                    raise self._no_worker()
                self._news.wait(POLL)
                self._news.clear()
        finally:
            for future in self._futures.values():
                with suppress(Exception):  # the scheduler may be gone
                    future.cancel()
            with suppress(OSError):
                token.unlink()
                token.parent.rmdir()

    def _workers(self):
        """Return the addresses of the workers that are there."""
        try:
            return list(self._client.nthreads())
        except (OSError, TimeoutError) as error:
            raise BackendError(
                f"the scheduler is gone ({error}); it must run to the end; start it again and go "
                "on with --resume"
            ) from None

    def _admit(self, address, token):
        """Ask a worker for its facts, and send it the job or refuse it."""
        try:
            facts = self._ask(address, on_worker.facts)
            fault = _difference(facts)
            if fault:
                self._refuse(address, fault)
                return
            facts["sees"] = self._ask(address, on_worker.sees, str(token), self._name)
            self._send_job(address)
        except Exception as error:  # whatever its rainsim, or the lack of one, leads to
            if address in self._workers():
                self._refuse(address, f"it cannot take part ({error})")
            return
        self._admitted[address] = facts
        from rainsim.jit import processor

        if facts["processor"] != processor():
            self._say(
                f"WARNING: worker {address} ({facts['host']}) has another processor: its frames "
                "may differ in the last digit of some pixels, see docs/many_machines.md"
            )
        if not facts["sees"]:
            self._say(f"worker {address} does not see the output folder and sends its frames")

    def _refuse(self, address, fault):
        self._refused[address] = fault
        self._say(f"worker {address} is refused: {fault}")

    def _ask(self, address, function, *arguments):
        """Return the result of a function that runs on a worker."""
        future = self._client.submit(
            function, *arguments, workers=[address], allow_other_workers=False, pure=False
        )
        return future.result(timeout=PATIENCE)

    def _send_job(self, address):
        held = self._client.scatter(self._sequence, workers=[address], hash=False)
        hashes = on_worker.known_hashes(self._sequence.scene)
        self._ask(address, on_worker.take_job, self._name, held, hashes)

    def _hand_out(self, workers):
        """Give each worker that has nothing to do a chunk."""
        hosts = Counter(self._admitted[address]["host"] for address in workers)
        for address in workers:
            indices = [] if address in self._futures else self._chunks.give(address, len(workers))
            if not indices:
                continue
            facts = self._admitted[address]
            threads = self._threads or max(facts["cores"] // hosts[facts["host"]], 1)
            states, where = None, {"workers": [address], "allow_other_workers": False}
            if self._states is not None:
                read = {index: self._states(index) for index in indices}
                states = self._client.scatter(read, workers=[address], hash=False)
            folder = str(self._folder) if facts["sees"] else None
            chunk = self._name, indices, folder, threads, states
            future = self._client.submit(on_worker.draw_chunk, *chunk, **where, pure=False)
            future.add_done_callback(lambda _: self._news.set())
            self._futures[address] = future, indices

    def _collect(self, progress):
        """Collect the frames that workers have drawn; give those of a faulty worker to others."""
        for address, (future, indices) in list(self._futures.items()):
            if not future.done():
                if self._chunks.hangs(address):
                    self._lose(address, "its worker hung")
                continue
            try:
                frames = future.result(timeout=PATIENCE)
            except RainsimError:
                raise  # every worker would say the same
            except Exception as error:  # of any kind: the worker's, the engine's, a frame's
                self._lose(address, f"its worker failed ({type(error).__name__}: {error})")
                continue
            if frames is None:  # it was started again at the same address
                del self._futures[address], self._admitted[address]
                self._chunks.taken_back(address)
                continue
            camera = self._sequence.cameras[0]
            shape = camera.height, camera.width
            fault = accept(frames, indices, self._folder, shape, OURS.fullmatch)
            if fault:
                self._lose(address, fault)
                continue
            del self._futures[address]
            self._chunks.drawn(address)
            for frame in frames:
                self._record.journal.add(frame["index"], list(frame["files"]), **frame["facts"])
            progress([note for frame in frames for note in frame["facts"]["notes"]])

    def _lose(self, address, why):
        """Give the frames of a worker to others, and have its process started again."""
        future, indices = self._futures.pop(address)
        with suppress(Exception):
            future.cancel(force=True)
        self._say(f"frames {indices[0]} to {indices[-1]} are drawn again: {why} ({address})")
        self._chunks.failed(address, why)
        if "hung" in why:  # who hangs cannot be asked; its nanny can be, where it has one
            self._admitted.pop(address, None)
            self._refused[address] = why
            with suppress(Exception):
                self._client.restart_workers([address], timeout=PATIENCE, raise_for_error=False)

    def _no_worker(self):
        why = "; ".join(f"{address}: {fault}" for address, fault in self._refused.items())
        return BackendError(
            f"no worker draws ({why or 'none came'}); at least one of the same rainsim and "
            "libraries is needed; start workers with `dask worker ADDRESS` in the same "
            "environment, and go on with --resume"
        )


def _difference(facts):
    """Return why a worker with these facts is refused, None if it draws the same bytes."""
    from rainsim import __version__

    ours = versions()
    if facts["version"] != __version__ or facts["sources"] != sources():
        return f"its rainsim {facts['version']} has other sources than ours, {__version__}"
    for name in VERSIONS:
        if facts["libraries"].get(name) != ours[name]:
            return f"it has {name} {facts['libraries'].get(name)}, and we {ours[name]}"
    return None


def draw_with_workers(client, sequence, run, resume, status, threads=None, **limits):
    """Draw the frames that are missing in a folder by workers; return all reports.

    `sequence` is sent to the workers. `run` has folder, record, cameras, settings and the video's
    format, as `FrameFolder` takes them; `status` has `say`, `notes` and `progress`; `threads` is
    the number for each worker, `limits` are those of `Chunks`.
    """
    folder, record, cameras, config, video = run
    kept = FrameFolder(*run, resume).kept
    missing = [index for index in config.indices if index not in kept]
    total = len(config.indices)
    if kept:
        status.say(f"{len(kept)} of {total} frames are finished and kept")
    if missing:
        record.begin()
        if client.cluster is not None:  # on this machine: the workers find what is kept
            sequence.keep_setup()
        chunks = Chunks(missing, **limits)
        farm = FarmRun(client, sequence, record, chunks, status.say, threads)

        def progress(notes):
            status.notes(notes)
            status.progress("frames", total - chunks.left, total)

        status.progress("frames", len(kept), total)
        farm.draw(progress)
    film = FrameFolder(folder, record, cameras, config, video, resume=True)
    lost = [index for index in config.indices if index not in film.kept]
    if lost:
        raise RainsimError(
            f"{len(lost)} frames in {folder} were damaged after they were drawn, the first is "
            f"{lost[0]}; they must stay as they are; go on with --resume"
        )
    with film:
        pass  # it takes over all frames on the way out
    return film.reports
