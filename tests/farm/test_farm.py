"""Workers of dask.distributed: the same bytes as in one go, whatever befalls them."""

import os
import pickle
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from test_shared_run import FRAMES, same, whole  # noqa: F401

from made_frames import MadeUpFrames
from rainsim.config.settings import Config
from rainsim.errors import BackendError, RainsimError
from rainsim.farm import cluster
from rainsim.output_folder.claims import claimed
from rainsim.output_folder.frames import FrameFolder
from rainsim.output_folder.record import Record
from rainsim.pipeline import FrameSequence, extract_terrain
from scenes import tiny_scene

pytest.importorskip("distributed")


class Said:
    """In place of `Status`: keeps what is said."""

    def __init__(self):
        self.lines = []

    def say(self, text):
        self.lines.append(text)

    def notes(self, notes):
        self.lines += notes

    def progress(self, stage, done, total):
        self.lines.append(f"{stage} {done}/{total}")


def start(count):
    folders = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
    before = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join([*folders, before])
    try:
        with cluster.client_of(workers=count, threads=count) as client:
            yield client
    finally:
        os.environ["PYTHONPATH"] = before


@pytest.fixture(scope="module")
def client():
    """Two workers for all tests; those that are killed are started again."""
    yield from start(2)


def draw(client, folder, resume=False, **how):
    """Draw a run by workers; return what was said."""
    frames, scene, said = MadeUpFrames(**how), tiny_scene(), Said()
    with claimed(folder, resume=resume):
        record = Record(Path(folder), scene, {"layers": ["depth"]}, seed=0)
        run = Path(folder), record, scene.cameras[:1], frames.config, None
        missing = len(FrameFolder(*run, resume).kept) < frames.config.frames
        reports = cluster.draw_with_workers(client, frames, run, resume, said)
        assert frames.setups == missing  # once for all workers
    assert [report.index for report in reports] == list(range(frames.config.frames))
    return said.lines


def test_workers_draw_the_same_bytes(tmp_path, client, whole):  # noqa: F811
    said = draw(client, tmp_path / "a")
    same(tmp_path / "a", whole)
    assert said[-1] == f"frames {FRAMES}/{FRAMES}" and said.count("a note") == FRAMES


def test_a_worker_that_dies_loses_nothing(tmp_path, client, whole):  # noqa: F811
    draw(client, tmp_path / "a", at=5, fault="die", once=tmp_path / "once")
    same(tmp_path / "a", whole)


def test_a_part_that_fails_is_said_and_drawn_by_resume(tmp_path, client, whole):  # noqa: F811
    fault = r"frames 0 to 5 were not all drawn .*\(OSError: the disk of the.*go on with --resume"
    with pytest.raises(RainsimError, match=fault):
        draw(client, tmp_path / "a", at=3, fault="error")
    said = draw(client, tmp_path / "a", resume=True)
    assert said[0] == f"9 of {FRAMES} frames are finished and kept"
    same(tmp_path / "a", whole)


def test_workers_of_another_kind_are_refused_or_named(tmp_path, client, monkeypatch):
    from rainsim import jit

    with monkeypatch.context() as patch:
        patch.setattr(jit, "processor", lambda: "another")
        said = draw(client, tmp_path / "a")
    assert "WARNING" in " ".join(said) and "has another processor" in " ".join(said)
    with monkeypatch.context() as patch:
        patch.setattr(cluster, "__version__", "0.1")
        with pytest.raises(BackendError, match=r"rainsim is \S+ there and 0\.1 here.*--resume"):
            draw(client, tmp_path / "b")


def test_nothing_listens_beyond_this_machine(client):
    psutil = pytest.importorskip("psutil")  # the engine's own
    me = psutil.Process()
    found = {
        link.laddr.ip
        for process in (me, *me.children(recursive=True))
        for link in process.net_connections()
        if link.status == "LISTEN"
    }
    assert len(client.run(os.getpid)) == 2 and found == {"127.0.0.1"}


def test_without_the_engine_one_line_says_what_brings_it(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(BackendError, match=r'pip install "rainsim\[farm\]"'):
        cluster.require()


def test_a_scheduler_that_is_not_there(monkeypatch):
    monkeypatch.setattr(cluster, "PATIENCE", 2.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:  # takes connections and says nothing
        port, begun = silent.getsockname()[1], time.monotonic()
        for address, why in (
            ("tcp://127.0.0.1:9", "does not answer"), ("tls://a:9", "no certificate"),
            (f"tcp://127.0.0.1:{port}", r"not within 0\.5 s"), ("nonsense://a", "does not answer"),
        ):  # fmt: skip
            with pytest.raises(BackendError, match=why), cluster.client_of(address):
                pass
        assert time.monotonic() - begun < 5


@pytest.mark.slow
def test_a_scheduler_that_dies_is_said_and_resume_goes_on(tmp_path, client, whole):  # noqa: F811
    folders = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    where, folder = tmp_path / "where.json", tmp_path / "a"

    def serve(kind, *options):
        line = [sys.executable, "-m", "dask", kind, "--no-dashboard", "--host", "127.0.0.1"]
        return subprocess.Popen([*line, "--scheduler-file", str(where), *options],
                                env=os.environ | {"PYTHONPATH": folders},
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip

    def die():
        while len(list(folder.glob("frames/*.png"))) < 2:
            time.sleep(0.05)
        scheduler.kill()

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    scheduler = serve("scheduler", "--port", str(port))
    worker = serve("worker", "--nthreads", "1", "--no-nanny")
    try:
        while not where.is_file():
            time.sleep(0.05)
        threading.Thread(target=die, daemon=True).start()
        with pytest.raises(BackendError, match=r"scheduler is gone.*go on with --resume"):
            with cluster.client_of(f"tcp://127.0.0.1:{port}") as there:
                draw(there, folder, pause=0.5)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    said = draw(client, folder, resume=True)
    assert said[0].endswith("frames are finished and kept")
    same(folder, whole)


def test_the_set_up_is_kept_for_the_workers(tmp_path, monkeypatch):
    scene, config = tiny_scene(), Config().replace(frames=1, width=64, extent=1.0, spacing=0.05)
    cameras = [scene.cameras[0].resized(64, 48)]
    for value, is_kept in (("off", False), (str(tmp_path / "kept"), True)):
        monkeypatch.setenv("RAINSIM_CACHE", value)
        sequence = FrameSequence(scene, extract_terrain(scene, config), cameras, config)
        before = set(tmp_path.glob("kept/*"))
        sequence.keep_setup()
        kinds = {file.name.split("-")[0] for file in set(tmp_path.glob("kept/*")) - before}
        assert ("skyline" in kinds) == is_kept
        assert pickle.loads(pickle.dumps(sequence))._renderer._renderer is None  # it is not sent
