"""Unfinished runs are gone on with: the same bytes as in one go, whatever ended them."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from rainsim.config.settings import Config
from rainsim.errors import ParameterError
from rainsim.io import fingerprint
from rainsim.io.video import VideoFormat
from rainsim.output_folder.claims import claimed
from rainsim.output_folder.frames import FrameFolder
from rainsim.output_folder.names import JOURNAL, read_record
from rainsim.output_folder.record import Record
from rainsim.pipeline import frames_of
from rainsim.render.report import FrameReport
from run_folders import assert_same_run, written
from scenes import tiny_scene

FRAMES = 12


def picture(index):
    return np.random.default_rng(index).integers(0, 255, (48, 64, 3), dtype=np.uint8)


def report(index):
    layers = {"depth": np.full((48, 64), index, np.float32)}
    return FrameReport(index, index / 24, {"all": 1.0}, {"rain": index}, ("a note",), layers)


def draw(folder, seed=0, resume=False, video=None, stop=None, pause=0.0):
    """Write FRAMES frames into a folder, or those before `stop`; return which were drawn."""
    config, scene, drawn = Config().replace(frames=FRAMES), tiny_scene(), []
    with claimed(folder, resume=resume):
        record = Record(Path(folder), scene, {"layers": ["depth"]}, seed=seed)
        film = FrameFolder(Path(folder), record, scene.cameras[:1], config, video, resume)
        missing = [index for index in config.indices if index not in film.kept]
        with film:
            for index in missing:
                if index == stop:
                    raise KeyboardInterrupt
                film.add(picture(index), report(index))
                drawn.append(index)
                time.sleep(pause)
    return drawn


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a run in one go."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    assert draw(folder) == list(range(FRAMES))
    return folder


def same(folder, whole):
    assert_same_run(folder, whole, FRAMES)


def test_an_interrupted_run_is_gone_on_with(tmp_path, whole):
    with pytest.raises(KeyboardInterrupt):
        draw(tmp_path / "a", stop=5)
    assert not read_record(tmp_path / "a")["complete"]
    assert draw(tmp_path / "a", resume=True) == list(range(5, FRAMES))
    same(tmp_path / "a", whole)
    assert draw(tmp_path / "a", resume=True) == []  # there is nothing left to draw
    same(tmp_path / "a", whole)


def test_frames_and_layers_that_are_damaged_or_gone_are_drawn_again(tmp_path, whole):
    draw(tmp_path / "a")
    frames = tmp_path / "a" / "frames"
    (frames / "00003.png").write_bytes((frames / "00003.png").read_bytes()[:-7])
    (frames / "00004.png").unlink()
    next((tmp_path / "a" / "layers" / "depth").glob("00007.*")).write_bytes(b"other")
    (tmp_path / "a" / "preview.webp").unlink()
    assert draw(tmp_path / "a", resume=True) == [3, 4, 7]
    same(tmp_path / "a", whole)


def test_another_run_is_refused_and_left_as_it_is(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        draw(tmp_path / "a", stop=3)
    before = written(tmp_path / "a")
    with pytest.raises(ParameterError, match="was another"):
        draw(tmp_path / "a", seed=1, resume=True)
    assert written(tmp_path / "a") == before
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine.txt").write_text("mine")
    with pytest.raises(ParameterError, match=r"mine\.txt and no record"):
        draw(tmp_path / "b", resume=True)
    with pytest.raises(ParameterError, match="--resume"):
        draw(tmp_path / "b")


@pytest.mark.parametrize("text", ["", "\0\0", "[]", '{"index": 1}', "nonsense\n", "[" * 9999])
def test_a_journal_that_is_cut_or_made_up_keeps_nothing_that_is_not_whole(tmp_path, whole, text):
    draw(tmp_path / "a")
    journal = tmp_path / "a" / JOURNAL
    lines = journal.read_text().splitlines()
    forged = json.loads(lines[2]) | {"files": {"../../secret": "0"}}
    no_picture = json.loads(lines[3]) | {"files": {}}
    odd = json.loads(lines[4]) | {"ledger": 3}
    cut = [json.dumps(entry) for entry in (forged, no_picture, odd)] + [lines[5][:30], text]
    journal.write_text("\n".join([*lines[:2], *cut]))
    assert draw(tmp_path / "a", resume=True) == list(range(2, FRAMES))
    same(tmp_path / "a", whole)


def test_a_fingerprint_knows_content_and_no_names(tmp_path, monkeypatch):
    def of(scene, **facts):
        return Record(tmp_path, scene, **facts).fingerprint

    from dataclasses import replace

    scene = tiny_scene()
    first = of(scene, seed=1, preset="a")
    elsewhere = replace(scene, source=Path("/elsewhere"), name="other", notes=("another",))
    assert of(elsewhere, seed=1, preset="b") == first
    monkeypatch.setattr("platform.platform", lambda: "another kernel")
    monkeypatch.setattr("platform.node", lambda: "another host")
    assert of(scene, seed=1) == first
    assert of(scene, seed=2) != first
    assert of(replace(scene, source_hash="1" * 64), seed=1) != first
    assert of(replace(scene, cameras=scene.cameras[:1]), seed=1) != first
    monkeypatch.setattr(fingerprint, "__version__", "0.1")
    assert of(scene, seed=1) != first


class _State:
    def __init__(self, index):
        self.index = index


def test_states_of_kept_frames_are_simulated_and_not_drawn():
    config, made, skip = Config().replace(frames=8), [], set()

    def states():
        for index in range(100):
            made.append(index)
            yield _State(index)

    frames = frames_of(states(), config, skip=skip)
    skip |= {0, 1, 4, 7}  # known when the first frame is asked for
    assert [state.index for state in frames] == [2, 3, 5, 6] and made == list(range(7))
    assert list(frames_of(states(), config, skip=range(8))) == []


def test_a_video_is_the_same(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    draw(tmp_path / "whole", video=VideoFormat())
    with pytest.raises(KeyboardInterrupt):
        draw(tmp_path / "a", stop=5, video=VideoFormat())
    draw(tmp_path / "a", resume=True, video=VideoFormat())
    assert written(tmp_path / "a") == written(tmp_path / "whole")
    assert (tmp_path / "a" / "video.mp4").is_file()
