"""Several processes at one run: the same bytes as in one go, and one owner for each frame."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from made_frames import MadeUpFrames
from rainsim.errors import InputError, ParameterError, RainsimError
from rainsim.farm.shared_run import SharedRun
from rainsim.io.journal import SHARED_FOLDER
from rainsim.output_folder.claims import claimed
from rainsim.output_folder.frames import FrameFolder
from rainsim.output_folder.names import JOURNAL, read_record
from rainsim.output_folder.record import Record
from run_folders import assert_same_run
from scenes import tiny_scene

FRAMES = 12
KILLS = 4


def draw(folder, first=0, end=FRAMES, seed=0, resume=False, **how):
    """Draw a range of a shared run; return the frames drawn here, and how many are left."""
    frames = MadeUpFrames(**how)
    config = replace(frames.config, frame_range=(first, end))
    scene = tiny_scene()
    with claimed(folder, shared=True):
        record = Record(Path(folder), scene, {"layers": ["depth"]}, seed=seed)
        run = SharedRun(Path(folder), record, scene.cameras[:1], config, None, resume)
        reports = run.draw(frames)
        left = run.complete()
    assert [report.index for report in reports] == list(range(first, end))
    return frames.drawn, left


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a run in one go, by a process that shares it with none."""
    folder, frames, scene = tmp_path_factory.mktemp("whole") / "out", MadeUpFrames(), tiny_scene()
    with claimed(folder):
        record = Record(folder, scene, {"layers": ["depth"]}, seed=0)
        with FrameFolder(folder, record, scene.cameras[:1], frames.config) as film:
            for frame in frames.frames(range(FRAMES)):
                film.add(*frame)
    return folder


def same(folder, whole):
    assert_same_run(folder, whole, FRAMES)
    assert {path.name for path in folder.iterdir()} == {path.name for path in whole.iterdir()}


def test_ranges_one_after_another_give_the_whole(tmp_path, whole):
    assert draw(tmp_path / "a", 6, 9) == ([6, 7, 8], FRAMES - 3)
    assert not read_record(tmp_path / "a")["complete"]
    assert not (tmp_path / "a" / "preview.webp").exists()
    assert draw(tmp_path / "a", 7, FRAMES)[0] == [9, 10, 11]  # what is finished is not drawn again
    assert draw(tmp_path / "a", 0, 8) == (list(range(6)), 0)
    same(tmp_path / "a", whole)
    assert draw(tmp_path / "a", 3, 5)[0] == []  # there is nothing left to draw
    same(tmp_path / "a", whole)


def test_a_run_that_shares_with_none_and_a_shared_one_refuse_each_other(tmp_path):
    folder = tmp_path / "a"
    with claimed(folder), pytest.raises(ParameterError, match="another run writes"):
        draw(folder)
    with claimed(folder, shared=True), claimed(folder, shared=True):  # those who share it do not
        with pytest.raises(ParameterError, match="another run writes"), claimed(folder):
            pass
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterError, match="is a file"):
        draw(tmp_path / "file")


def test_an_unfinished_shared_run_is_gone_on_with_in_one_go(tmp_path, whole):
    draw(tmp_path / "a", 3, 6)
    frames, scene = MadeUpFrames(), tiny_scene()
    with claimed(tmp_path / "a", resume=True):
        record = Record(tmp_path / "a", scene, {"layers": ["depth"]}, seed=0)
        film = FrameFolder(tmp_path / "a", record, scene.cameras[:1], frames.config, resume=True)
        missing = [index for index in range(FRAMES) if index not in film.kept]
        with film:
            for frame in frames.frames(missing):
                film.add(*frame)
    assert missing == [0, 1, 2, *range(6, FRAMES)]
    same(tmp_path / "a", whole)


def test_frames_that_are_damaged_are_said_and_drawn_again(tmp_path, whole):
    folder = tmp_path / "a"
    draw(folder, 0, 10)
    (folder / "frames" / "00003.png").write_bytes(b"cut")
    (folder / "frames" / "00009.png").unlink()
    with pytest.raises(ParameterError, match=r"frames 9 to 9 were left undone.*with --resume"):
        draw(folder, 8, FRAMES)
    with pytest.raises(RainsimError, match=r"1 frames in .* the first is 3;.*with --resume"):
        draw(folder, 8, FRAMES, resume=True)
    assert draw(folder, 0, FRAMES, resume=True)[0] == [3]
    same(folder, whole)
    shutil.rmtree(folder / "frames")
    assert draw(folder)[0] == list(range(FRAMES))
    same(folder, whole)


def test_what_an_interrupted_process_left_undone_is_said_and_drawn_by_resume(tmp_path, whole):
    with pytest.raises(KeyboardInterrupt):
        draw(tmp_path / "a", at=5)
    for first in (0, 9):
        with pytest.raises(ParameterError, match=r"to 11 were left undone.*go on with --resume"):
            draw(tmp_path / "a", first)
    assert draw(tmp_path / "a", 3, 7, resume=True)[0] == [5, 6]
    assert draw(tmp_path / "a", resume=True)[0] == list(range(7, FRAMES))
    same(tmp_path / "a", whole)


def test_a_frame_has_one_owner(tmp_path, whole):
    class Meanwhile(MadeUpFrames):
        def frames(self, indices, tell=None):
            for resume in (False, True):  # nothing is stolen
                with pytest.raises(ParameterError, match=r"frames 7 to 7 are drawn by process \d+"):
                    draw(tmp_path / "a", 7, FRAMES, resume=resume)
            draw(tmp_path / "a", 8, FRAMES)
            return super().frames(indices)

    config, scene = replace(MadeUpFrames().config, frame_range=(0, 8)), tiny_scene()
    with claimed(tmp_path / "a", shared=True):
        record = Record(tmp_path / "a", scene, {"layers": ["depth"]}, seed=0)
        run = SharedRun(tmp_path / "a", record, scene.cameras[:1], config)
        run.draw(Meanwhile())
        assert run.complete() == 0
    same(tmp_path / "a", whole)


def test_a_folder_that_vanishes_ends_in_one_line(tmp_path):
    class Vanish(MadeUpFrames):
        def frames(self, indices, tell=None):
            for frame in super().frames(indices):
                shutil.rmtree(tmp_path / "a" / SHARED_FOLDER)
                yield frame

    config, scene = replace(MadeUpFrames().config, frame_range=(0, 4)), tiny_scene()
    with pytest.raises(InputError, match=r"is gone while frames are drawn.*--resume"):
        with claimed(tmp_path / "a", shared=True):
            record = Record(tmp_path / "a", scene)
            SharedRun(tmp_path / "a", record, scene.cameras, config).draw(Vanish())


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_to(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError), claimed(tmp_path / "a", shared=True):
        pass


CODE = "import sys; import test_shared_run as t; t.draw(*eval(sys.argv[1]), pause=0.05)"


def start(folder, first=0, end=FRAMES, resume=False):
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    call = repr((str(folder), first, end, 0, resume))
    return subprocess.Popen(
        [sys.executable, "-c", CODE, call], env=os.environ | {"PYTHONPATH": paths},
        stderr=subprocess.DEVNULL,
    )  # fmt: skip


def drawn_by(folder):
    """How often each frame was noted, from the journal of the whole and those of processes."""
    lines = []
    for path in [folder / JOURNAL, *(folder / SHARED_FOLDER).glob("*.jsonl")]:
        lines += path.read_text().splitlines() if path.is_file() else []
    return sorted(json.loads(line)["index"] for line in lines)


def test_processes_beside_each_other_complete_the_run(tmp_path, whole):
    running = [start(tmp_path / "a", k, k + 4) for k in range(0, FRAMES, 4)]
    assert [process.wait() for process in running] == [0, 0, 0]
    same(tmp_path / "a", whole)


def test_of_processes_of_one_range_one_draws_it(tmp_path, whole):
    running = [start(tmp_path / "a", 0, FRAMES - 1) for _ in range(3)]
    ended = [process.wait() for process in running]
    assert 0 in ended
    assert drawn_by(tmp_path / "a") == list(range(FRAMES - 1))  # none twice
    draw(tmp_path / "a", FRAMES - 1)
    same(tmp_path / "a", whole)


def killed_at_random(folder, count, seed, many):
    """Start `many` processes on ranges of their own and kill them; return how many died."""
    rng, killed, running = random.Random(seed), 0, []
    while count > 0 or running:
        while count > 0 and len(running) < many:
            part = count % many
            ends = FRAMES * part // many, FRAMES * (part + 1) // many
            running.append(start(folder, *ends, resume=True))
            count -= 1
        time.sleep(rng.uniform(0.4, 1.5) / many)
        process = running.pop(rng.randrange(len(running)))
        process.send_signal(rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM]))
        killed += process.wait() != 0
    return killed


def test_processes_killed_at_random_moments_lose_nothing(tmp_path, whole):
    assert killed_at_random(tmp_path / "a", KILLS, seed=2, many=2) > 0
    draw(tmp_path / "a", resume=True)
    same(tmp_path / "a", whole)
