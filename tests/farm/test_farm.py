"""Workers of dask.distributed: the same bytes as in one go, whatever befalls them."""

import asyncio
import os
import pickle
import random
import signal
import socket
import threading
import time
from pathlib import Path

import pytest
from test_shared_run import FRAMES, same, whole  # noqa: F401

import made_frames
from made_frames import MadeUpFrames
from rainsim.config.settings import Config
from rainsim.errors import BackendError, RainsimError
from rainsim.farm import cluster, worker
from rainsim.io import cache
from rainsim.output_folder import FrameFolder, Record, claimed
from rainsim.pipeline import FrameSequence, extract_terrain
from run_folders import facts, written
from scenes import tiny_scene

pytest.importorskip("distributed")
MANY_KILLS = 50


class Said:
    """In place of `Status`: keeps what is said."""

    def __init__(self):
        self.lines = []

    def say(self, text):
        self.lines.append(text)

    def notes(self, notes):
        pass

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


def draw(client, folder, resume=False, limits=None, **how):
    """Draw a run by workers; return what was said."""
    frames, scene, said = MadeUpFrames(**how), tiny_scene(), Said()
    with claimed(folder, resume=resume):
        record = Record(Path(folder), scene, {"layers": ["depth"]}, seed=0)
        run = Path(folder), record, scene.cameras[:1], frames.config, False
        missing = len(FrameFolder(*run, resume).kept) < frames.config.frames
        reports = cluster.draw_with_workers(client, frames, run, resume, said, **(limits or {}))
        assert frames.setups == missing  # once for all workers
    assert [report.index for report in reports] == list(range(frames.config.frames))
    return said.lines


def test_workers_draw_the_same_bytes(tmp_path, client, whole):  # noqa: F811
    said = draw(client, tmp_path / "a")
    same(tmp_path / "a", whole)
    assert said[-1] == f"frames {FRAMES}/{FRAMES}" and said == sorted(set(said), key=said.index)


def test_frames_are_sent_where_the_folder_is_not_seen(tmp_path, client, whole, monkeypatch):  # noqa: F811
    monkeypatch.setattr(cluster.on_worker, "sees", made_frames.sees_nothing)
    said = draw(client, tmp_path / "a")
    assert "sends its frames" in " ".join(said)
    same(tmp_path / "a", whole)


def test_an_unfinished_run_is_gone_on_with_by_workers(tmp_path, client, whole):  # noqa: F811
    frames, scene = MadeUpFrames(at=5), tiny_scene()
    with pytest.raises(KeyboardInterrupt), claimed(tmp_path / "a"):
        record = Record(tmp_path / "a", scene, {"layers": ["depth"]}, seed=0)
        with FrameFolder(tmp_path / "a", record, scene.cameras[:1], frames.config) as film:
            for frame in frames.frames(range(FRAMES)):
                film.add(*frame)
    said = draw(client, tmp_path / "a", resume=True)
    assert said[0] == f"5 of {FRAMES} frames are finished and kept"
    same(tmp_path / "a", whole)


@pytest.mark.parametrize(
    ("fault", "why"),
    [("die", "died"), ("garbage", "no picture of"), ("error", "disk of the worker is full"),
     pytest.param("hang", "hung", marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_worker_that_fails_loses_nothing(tmp_path, client, whole, fault, why):  # noqa: F811
    limits = {"patience": 0.5, "first": 1.0} if fault == "hang" else {}
    said = draw(client, tmp_path / "a", False, limits, at=5, fault=fault, once=tmp_path / "once")
    assert any("drawn again" in line and why in line for line in said), said
    same(tmp_path / "a", whole)


def test_a_frame_that_no_worker_draws_is_named(tmp_path, client):
    with pytest.raises(RainsimError, match=r"frame 5 was given to workers 2 times.*disk of the"):
        draw(client, tmp_path / "a", at=5, limits={"tries": 2}, fault="error")


def test_workers_of_another_kind_are_refused_or_named(tmp_path, client, monkeypatch):
    from rainsim import jit

    with monkeypatch.context() as patch:
        patch.setattr(jit, "processor", lambda: "another")
        said = draw(client, tmp_path / "a")
    assert "WARNING" in " ".join(said) and "has another processor" in " ".join(said)
    monkeypatch.setattr(cluster, "PATIENCE", 6.0)
    for name, value, why in (
        ("sources", lambda: "others", "has other sources than ours"),
        ("versions", lambda: {**dict.fromkeys(cluster.VERSIONS), "numpy": "1"}, "and we"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(cluster, name, value)
            with pytest.raises(BackendError, match=why):
                draw(client, tmp_path / name)


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


class Nanny:
    """In place of the engine's: notes that it is closed, and raises a fault."""

    def __init__(self, fault=None):
        self.fault, self.closed = fault, False

    async def close(self, timeout):
        self.closed = True
        if self.fault:
            raise self.fault


def test_killed_workers_that_linger_fail_no_finished_run():
    slow, quick = Nanny(TimeoutError()), Nanny()
    asyncio.run(cluster._end([slow, quick]))
    assert slow.closed and quick.closed
    with pytest.raises(RuntimeError, match="of another kind"):
        asyncio.run(cluster._end([Nanny(RuntimeError("of another kind")), slow]))


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


def killer(client, ended, seed, killed):
    """Kill workers at random moments until `ended`; they are started again."""
    rng = random.Random(seed)
    while not ended.wait(rng.uniform(0.5, 4.0)):
        try:
            pids = list(client.run(os.getpid, on_error="ignore").values())
        except Exception:  # the client is closing
            return
        if pids and not ended.is_set():
            os.kill(rng.choice(pids), signal.SIGKILL)  # SIGTERM ends a worker for good
            killed.append(time.monotonic())


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 5])
def test_workers_killed_at_many_random_moments_lose_nothing(tmp_path, workers):
    draw_alone(tmp_path / "alone")
    killed, runs, clusters, resume = [], 0, 0, False
    while len(killed) < MANY_KILLS // 3 or resume:  # a run that was begun is gone on with
        clusters += 1
        for client in start(workers):
            ended = threading.Event()
            thread = threading.Thread(target=killer, args=(client, ended, clusters, killed))
            if len(killed) >= MANY_KILLS // 3:
                ended.set()  # left alone, it comes to an end that can be compared
            thread.start()
            try:
                draw(client, tmp_path / str(runs), resume, {"tries": 1000}, frames=60, pause=0.05)
            except BackendError as error:  # the engine replaces none that dies while it starts
                assert "none came" in str(error)
                resume = True
                continue
            finally:
                ended.set()
                thread.join()
            first, last = tmp_path / "alone", tmp_path / str(runs)
            assert written(first) == written(last) and facts(first) == facts(last)
            runs, resume = runs + 1, False
    print(f"{workers} workers: {len(killed)} kills in {runs} runs of {clusters} clusters")


def draw_alone(folder):
    """Draw the frames of the campaign in one go."""
    frames, scene = MadeUpFrames(frames=60), tiny_scene()
    with claimed(folder):
        record = Record(folder, scene, {"layers": ["depth"]}, seed=0)
        with FrameFolder(folder, record, scene.cameras[:1], frames.config) as film:
            for frame in frames.frames(range(60)):
                film.add(*frame)


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


def test_a_worker_finds_what_others_kept_of_a_capture():
    frames = MadeUpFrames()
    splats = frames.scene.splats
    kept, plain = splats.position, cache.name_of("scene", splats.position)
    cache.know_hash(kept, "splats", "of a file", "position")
    assert cache.name_of("scene", kept) != plain
    hashes = worker.known_hashes(frames.scene)
    assert list(hashes) == ["position"]
    copy = pickle.loads(pickle.dumps(frames))
    assert cache.name_of("scene", copy.scene.splats.position) == plain  # the bytes' own
    worker.take_job("a job", copy, hashes)
    assert cache.name_of("scene", copy.scene.splats.position) == cache.name_of("scene", kept)
    worker._SEQUENCES.clear()
