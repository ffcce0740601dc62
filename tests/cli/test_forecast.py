"""What a long run says of its time and its disk once three frames are drawn."""

import collections
import json
import re
import time

import pytest

from rainsim.commands import forecast
from rainsim.commands.forecast import Forecast, clock_time
from rainsim.commands.status import Status

SMALL = ["--spacing", "0.04", "--extent", "1", "--width", "64", "--preset", "downpour",
         "--relight", "off"]  # fmt: skip
LINE = re.compile(
    r"12 frames take about (.+) in all, until (\S+| ?\S+ \S+), and ([\d.]+ kB) of disk \((.*?)\)"
)
Disk = collections.namedtuple("Disk", "total used free")


def in_kilobytes(text):
    return {name: float(size) for name, size in re.findall(r"(\w+) ([\d.]+) kB", text)}


def on_disk(folder, name):
    return sum(p.stat().st_size for p in (folder / name).rglob("*") if p.is_file()) / 1e3


@pytest.mark.parametrize(
    "more",
    [[], pytest.param(["--workers", "2"], marks=pytest.mark.slow), ["--frame-range", "0:12"]],
)
def test_a_long_run_says_once_what_it_takes(rainsim, scene_folder, tmp_path, more):
    if more[:1] == ["--workers"]:
        pytest.importorskip("distributed")
    done = rainsim("run", scene_folder, *SMALL, "--frames", 12, "--layers", "depth", "-v",
                   "--out", "out", *more)  # fmt: skip
    assert done.code == 0, done.err
    found = LINE.findall(done.err)
    assert len(found) == 1 and "WARNING: " not in done.err, done.err
    sizes = in_kilobytes(found[0][3])
    assert sizes == {
        name: pytest.approx(on_disk(tmp_path / "out", name), rel=0.1) for name in sizes
    }
    assert set(sizes) == {"frames", "layers"}


def test_render_says_it_and_a_disk_that_is_too_full_is_a_warning(
    rainsim, scene_folder, tmp_path, monkeypatch
):
    monkeypatch.setattr(forecast.shutil, "disk_usage", lambda folder: Disk(10**9, 10**9, 20_000))
    assert rainsim("heightmap", scene_folder, *SMALL[:4], "--out", "map").code == 0
    assert rainsim("simulate", "map", "--frames", 12, "--out", "states").code == 0
    done = rainsim("render", "states", "--relight", "off", "--width", "64", "--out", "out")
    assert done.code == 0, done.err
    found = LINE.findall(done.err)
    assert len(found) == 1 and set(in_kilobytes(found[0][3])) == {"frames"}, done.err
    assert re.search(r"WARNING: 20 kB are free in out and [\d.]+ kB are still to be", done.err)
    assert json.loads((tmp_path / "out/provenance.json").read_text())["complete"]


def test_a_short_run_and_a_quiet_one_say_nothing(rainsim, scene_folder):
    run = ["run", "--scene", scene_folder, *SMALL]
    assert "in all" not in rainsim(*run, "--frames", 10, "--out", "short").err
    assert rainsim(*run, "--frames", 12, "--quiet", "--out", "quiet").err == ""
    done = rainsim(*run, "--frames", 12, "--resume", "--out", "quiet")
    assert "12 of 12 frames are finished" in done.err and "in all" not in done.err


def test_the_time_is_that_of_the_frames_after_the_first(tmp_path, monkeypatch):
    now, said = [100.0], []
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    status = Status()
    status.progress = lambda *stage: None
    status.say = lambda text, bold: said.append(text)
    watched = Forecast(status, tmp_path)
    watched.progress("frames", 100, 500)  # an earlier run drew a hundred
    now[0] += 300.0  # the first one compiles
    for done in range(101, 111):
        watched.progress("frames", done, 500)
        now[0] += 10.0
    # 397 frames of 10 s were left when the third was drawn, 320 s after the start.
    assert len(said) == 1 and said[0].startswith("500 frames take about 72 min in all, until ")


def test_a_disk_that_fails_meanwhile_ends_no_run(tmp_path):
    status = Status()
    status.progress = lambda *stage: None
    watched = Forecast(status, tmp_path / "gone")
    for done in range(21):
        watched.progress("frames", done, 20)
    assert watched._frames is None


def test_the_end_has_its_date_if_it_is_not_today():
    now = time.time()
    assert re.fullmatch(r"\d\d:\d\d", clock_time(now))
    assert clock_time(now + 7 * 86400).startswith(time.strftime("%Y-", time.localtime(now)[:9]))


@pytest.mark.parametrize(("name", "value"), [("codec", "h265"), ("quality", "60")])
def test_an_option_of_the_video_without_one_is_refused(rainsim, scene_folder, name, value):
    done = rainsim("run", "--scene", scene_folder, f"--video-{name}", value)
    assert done.code == 2
    assert f"--video-{name} is given without --video" in done.error


# The library leaves its pipes to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_prores_is_a_mov_of_the_record(rainsim, scene_folder, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    how = ["run", "--scene", scene_folder, *SMALL, "--frames", 2, "--video", "--out", "out"]
    done = rainsim(*how, "--video-codec", "prores", "--video-quality", "60")
    assert done.code == 0, done.err
    facts = next(ffmpeg.read_frames(str(tmp_path / "out/video.mov")))
    assert facts["codec"].startswith("prores") and facts["size"] == (64, 48)
    files = json.loads((tmp_path / "out/provenance.json").read_text())["files"]
    assert "video.mov" in files and "video.mp4" not in files
    assert rainsim(*how, "--overwrite", "--seed", "7").code == 0  # another run in its place
    assert [path.name for path in (tmp_path / "out").glob("video.*")] == ["video.mp4"]
