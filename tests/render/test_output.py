"""Output folders: what is not ours stays, whatever a record in the folder says."""

import errno
import json
import os
import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from rainsim.config.settings import Config
from rainsim.errors import ParameterError, RainsimError
from rainsim.io import images
from rainsim.io.claim import ClaimedError, claim
from rainsim.output_folder.claims import claimed
from rainsim.output_folder.frames import FrameFolder
from rainsim.output_folder.names import CLAIM, PROVENANCE, read_record
from rainsim.output_folder.record import Record
from rainsim.render import frame_files
from rainsim.render.renderer import FrameReport
from scenes import tiny_scene


def test_a_folder_that_stays_empty_is_removed_with_those_above_it(tmp_path):
    with claimed(tmp_path / "a" / "b") as folder:
        assert folder.is_dir()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine").mkdir()
    with claimed(tmp_path / "mine"):  # empty, but not made by us
        pass
    assert (tmp_path / "mine").is_dir()


def test_a_filled_folder_stays_also_after_an_error(tmp_path):
    with pytest.raises(RuntimeError), claimed(tmp_path / "a") as folder:
        (folder / "result").write_text("half")
        raise RuntimeError
    assert (tmp_path / "a" / "result").read_text() == "half"


def test_a_folder_in_use_needs_overwrite(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ParameterError, match="not empty; it must be new or empty"):
        with claimed(tmp_path):
            pass
    with claimed(tmp_path, overwrite=True):
        pass
    assert (tmp_path / "mine.txt").read_text() == "mine"
    with pytest.raises(ParameterError, match=r"mine\.txt is a file; it must be a folder"):
        with claimed(tmp_path / "mine.txt", overwrite=True):
            pass


def test_of_many_runs_one_gets_the_folder(tmp_path):
    start, won = threading.Barrier(12), []

    def run(number):
        start.wait()
        try:
            with claimed(tmp_path / "a" / "b") as folder:
                (folder / f"{number}.txt").write_text("mine")
                won.append(number)
        except ParameterError as error:
            assert "another run writes" in str(error) or "not empty" in str(error)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(won) == 1 and [p.name for p in (tmp_path / "a" / "b").iterdir()] == [f"{won[0]}.txt"]


def test_overwriting_takes_no_folder_that_is_being_written(tmp_path):
    with claimed(tmp_path / "a") as folder:
        (folder / "result").write_text("half")
        with pytest.raises(ParameterError, match=f"process {os.getpid()} on"):
            with claimed(tmp_path / "a", overwrite=True):
                pass
    with claimed(tmp_path / "a", overwrite=True):
        pass
    assert [path.name for path in folder.iterdir()] == ["result"]


def test_the_claim_of_a_run_that_was_killed_is_taken_over(tmp_path):
    code = (
        "import sys, time; from rainsim.output_folder.claims import claimed\n"
        "with claimed(sys.argv[1]): print('held', flush=True); time.sleep(60)"
    )
    folder = tmp_path / "a"
    with subprocess.Popen([sys.executable, "-c", code, folder], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(ParameterError, match=f"process {process.pid} on"):
            with claimed(folder):
                pass
        process.kill()
        process.wait()
    assert (folder / CLAIM).is_file()  # nothing else is left of it
    with claimed(folder):
        (folder / "result").write_text("whole")
    assert [path.name for path in folder.iterdir()] == ["result"]


def test_a_claim_that_a_failing_disk_stopped_is_not_held_on(tmp_path, monkeypatch):
    path, look = tmp_path / "claim", os.stat

    def gone(name, *arguments, **named):
        if name == path:
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))
        return look(name, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(os, "stat", gone)
        with pytest.raises(OSError, match=os.strerror(errno.ESTALE)):
            with claim(path):
                pass
    assert path.is_file()
    with claim(path):  # the same process takes it again
        with pytest.raises(ClaimedError, match=f"process {os.getpid()} on"):
            with claim(path):
                pass


def _written(folder, *names, **facts):
    record = Record(folder, **facts)
    record.begin()
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("ours")
    record.add(*names)
    record.write(complete=True)


def test_results_of_other_settings_are_cleared_and_of_the_same_are_kept(tmp_path):
    _written(tmp_path, "frames/00000.png", "frames/00001.png", seed=1)
    _written(tmp_path, "frames/00002.png", seed=1)
    assert read_record(tmp_path)["files"] == [f"frames/0000{n}.png" for n in range(3)]
    assert len(list((tmp_path / "frames").iterdir())) == 3
    _written(tmp_path, "frames/00001.png", seed=2)
    assert [path.name for path in (tmp_path / "frames").iterdir()] == ["00001.png"]


def test_a_forged_record_removes_nothing_that_is_not_ours(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (tmp_path / "precious.txt").write_text("mine")
    (folder / "notes.md").write_text("mine")
    forged = ["../precious.txt", "notes.md", "frames/../../precious.txt", 3, None]
    record = {"program": "rainsim", "fingerprint": "other", "files": forged}
    (folder / PROVENANCE).write_text(json.dumps(record))
    _written(folder, "frames/00000.png")
    assert (tmp_path / "precious.txt").exists() and (folder / "notes.md").exists()


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", "[" * 100_000, "1" * 5000, '{"program": "other", "files": ["scene.json"]}',
     '{"rainsim_record": 2, "program": "rainsim", "files": ["scene.json"]}'],
)  # fmt: skip
def test_a_record_that_is_not_ours_counts_for_nothing(tmp_path, text):
    (tmp_path / PROVENANCE).write_text(text)
    (tmp_path / "scene.json").write_text("mine")
    assert read_record(tmp_path) == {}
    Record(tmp_path).begin()
    assert (tmp_path / "scene.json").exists()


@pytest.mark.parametrize("name", ["frames/00000.png", "transforms.json", "actors.npz", PROVENANCE])
def test_files_that_no_record_lists_are_not_replaced(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    with pytest.raises(ParameterError, match="is on no record of a run"):
        with claimed(tmp_path, overwrite=True):
            pass
    assert (tmp_path / name).read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == [name.split("/")[0]]
    (tmp_path / name).unlink()
    _written(tmp_path, "frames/00000.png", "transforms.json")
    with claimed(tmp_path, overwrite=True):  # now it is the program's own
        _written(tmp_path, seed=2)
    assert not (tmp_path / "frames/00000.png").exists()


def test_a_killed_run_is_replaced_though_its_last_frame_is_on_no_record(tmp_path):
    Record(tmp_path).begin()
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames/00000.png").write_text("half")
    with claimed(tmp_path, overwrite=True):
        pass


def test_temporary_files_of_the_program_go_and_those_of_others_stay(tmp_path):
    ours = [
        ".scene.json.a1b2c3d4.json",
        "..splats.npz.abcdefgh.npz.abcdefgh.npz",
        "frames/.00000.png.abcdefgh.png",
    ]
    ours += ["layers/depth/.00001.exr.abcdefgh.exr", ".video.mp4.abc_efgh.mp4"]
    others = [".my.settings", ".config.template.yml", "frames/.notes.txt.abcdefgh.txt"]
    others += ["mine/.00000.png.abcdefgh.png"]
    for name in (*ours, *others):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    Record(tmp_path).begin()
    left = [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()]
    assert sorted(left) == sorted([*others, PROVENANCE])


@pytest.fixture
def begin(tmp_path, monkeypatch):
    """A function that returns a folder for three frames, and one that draws into one array."""
    monkeypatch.setattr(frame_files, "WRITERS", 3)
    config = Config().replace(frames=3)
    picture = np.zeros((6, 8, 3), np.uint8)

    def add(film, index):
        picture[:] = 40 * (index + 1)
        film.add(picture, FrameReport(index, 0.0, {"draw": 1.0}, {"rain": index}))

    def begun(folder="threads", apart=False):
        folder, cameras = tmp_path / folder, tiny_scene().cameras[:1]
        folder.mkdir()
        film = FrameFolder(folder, Record(folder), cameras, config, apart=apart)
        return SimpleNamespace(film=film, add=add, folder=folder)

    return begun


@pytest.fixture
def sequence(begin):
    return begin()


def draw(sequence, *indices):
    with sequence.film as film:
        for index in indices:
            sequence.add(film, index)


def test_frames_are_written_while_the_next_overwrites_the_picture(sequence):
    draw(sequence, 0, 1, 2)
    for index in range(3):
        written = images.read_image(sequence.folder / f"frames/{index:05d}.png")
        assert (written == 40 * (index + 1)).all()
    record = read_record(sequence.folder)
    assert record["complete"] and record["frames"] == [0, 1, 2] and record["ledger"] == {"rain": 2}
    assert (sequence.folder / "preview.webp").is_file()


def test_processes_write_what_threads_do(begin):
    files = []
    for sequence in (begin(), begin("apart", apart=True)):
        draw(sequence, 0, 1, 2)
        names = ("preview.webp", *(f"frames/{index:05d}.png" for index in range(3)))
        files.append([(sequence.folder / name).read_bytes() for name in names])
        assert list(sequence.film.record.journal.finished(range(3))) == [0, 1, 2]  # by their hashes
    assert files[0] == files[1]


def test_what_a_process_cannot_write_is_an_error_of_the_run(begin):
    sequence = begin(apart=True)
    with pytest.raises(IsADirectoryError, match=r"00001\.png"), sequence.film as film:
        sequence.add(film, 0)
        (sequence.folder / "frames/00001.png").mkdir()
        sequence.add(film, 1)
        sequence.add(film, 2)
    assert read_record(sequence.folder)["frames"] == [0, 2]


def test_a_process_that_is_killed_ends_the_run_in_one_line(begin):
    sequence = begin(apart=True)
    processes = sequence.film._writer._encoders._processes
    assert len(processes) == 3  # as there are frames, at most
    for process in processes:
        process._process.kill()
    with pytest.raises(RainsimError, match=r"ended with status -9; .* go on with --resume"):
        draw(sequence, 0)


def test_a_slow_frame_is_noted_before_quick_ones_that_follow(sequence, monkeypatch):
    write, rest = images.write_png, threading.Event()

    def uneven(path, image):
        if path.name == "00000.png":
            assert rest.wait(30)  # until both others are on the disk
        write(path, image)
        if path.name == "00002.png":
            rest.set()

    monkeypatch.setattr(images, "write_png", uneven)
    with sequence.film as film:
        for index in range(3):
            sequence.add(film, index)
    assert read_record(sequence.folder)["frames"] == [0, 1, 2]
    assert [report.index for report in film.reports] == [0, 1, 2]


def test_a_frame_that_cannot_be_written_is_an_error_and_not_recorded(sequence, monkeypatch):
    def full(path, image):
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"), sequence.film as film:
        sequence.add(film, 0)
        sequence.add(film, 1)
        monkeypatch.setattr(images, "write_png", full)
        sequence.add(film, 2)
    record = read_record(sequence.folder)
    assert record["frames"] in ([0], [0, 1]) and not record["complete"]
    assert "frames/00002.png" not in record["files"]
