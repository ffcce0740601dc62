"""Frames from the command line, end to end on a tiny scene."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import llvmlite.binding as llvm
import numpy as np
import pytest

from rainsim import pipeline, simulation
from rainsim.commands.status import Status, interrupts_remembered
from rainsim.errors import DivergedError
from rainsim.io.images import read_image
from rainsim.output_folder.frames import FrameFolder
from rainsim.render.aov import AOVS, recompose
from rainsim.scene.cameras import read_cameras
from rainsim.scene.library import load_scene
from rainsim.shading import environment
from run_folders import layer

WARM_UP = simulation.RIPPLE_WARM_UP  # s
FACE = environment.FACE  # px
MAP = ["--spacing", "0.04", "--extent", "1"]
LIGHT = ["--relight", "off"]  # looking for a sun takes a third of the time
FILM = [*MAP, *LIGHT, "--width", "64", "--preset", "downpour"]


@pytest.fixture
def film(rainsim, scene_folder):
    """Return a function that runs `rainsim run` on the tiny scene into the folder `out`."""

    def run(out, *more, frames=3):
        count = [] if frames is None else ["--frames", frames]
        return rainsim("run", "--scene", scene_folder, *FILM, *count, "--out", out, *more)

    return run


def pictures(folder):
    """The frames in an output folder by name."""
    return {path.name: read_image(path) for path in sorted((folder / "frames").iterdir())}


def record(folder):
    return json.loads((folder / "provenance.json").read_text())


def same(one, two):
    return one.keys() == two.keys() and all(np.array_equal(one[name], two[name]) for name in one)


def test_run_writes_all_that_it_promises(film, tmp_path):
    done = film("out")
    assert done.code == 0, done.err
    assert done.out == "out\n"
    assert "ground: " in done.err and "3 frames in out/frames" in done.err
    folder = tmp_path / "out"
    frames = pictures(folder)
    assert list(frames) == ["00000.png", "00001.png", "00002.png"]
    for picture in frames.values():
        assert picture.shape == (48, 64, 3) and picture.dtype == np.uint8
        assert picture.std() > 5
    assert not np.array_equal(frames["00000.png"], frames["00001.png"])  # it rains
    assert len(read_cameras(folder / "transforms.json")) == 3
    assert (folder / "preview.webp").stat().st_size > 100
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    kept = record(folder)
    assert names == {*kept["files"], "provenance.json"}  # and no temporary file
    assert kept["complete"] and kept["frames"] == [0, 1, 2] and kept["rainsim_record"] == 1
    stages = {"start", "reading", "terrain", "light", "water", "frames"}
    assert stages <= kept["stages"].keys() and " s: " in done.err
    assert kept["seed"] == 0 and kept["preset"] == "downpour"
    assert kept["settings"]["rain"]["rate"] == pytest.approx(50 / 3.6e6)
    assert kept["input"]["ground_frame"]["meters_per_unit"] == 0.6
    assert kept["versions"]["numba"] and kept["command"][0] == "rainsim"
    assert abs(kept["ledger"]["residual"]) < 1e-5
    assert kept["milliseconds"]


def test_the_stages_one_by_one_give_the_same_frames(
    film, rainsim, scene_folder, tmp_path, monkeypatch
):
    assert film("whole").code == 0
    shutil.copytree(scene_folder, tmp_path / "capture")
    done = rainsim("heightmap", "./capture", *MAP, "--out", "terrain", "--json")
    assert done.code == 0, done.err
    shown = json.loads(done.out)
    assert shown["shape"] == [50, 50] and shown["spacing"] == 0.04
    for name in ("terrain.npz", "bed.tif", "top.tif", "hillshade.png", "ground_frame.json"):
        assert (tmp_path / "terrain" / name).is_file()
    done = rainsim("simulate", "terrain", "--preset", "downpour", "--frames", 3, "--out", "states")
    assert done.code == 0, done.err
    wet = {path.name: path.read_bytes() for path in (tmp_path / "states" / "states").iterdir()}
    assert len(wet) == 3
    (tmp_path / "states" / "states" / "00001.npz").unlink()
    again = ["simulate", "terrain", "--preset", "downpour", "--out", "states", "--resume"]
    assert rainsim(*again, "--frames", 4).code == 2  # another run
    done = rainsim(*again, "--frames", 3)
    assert done.code == 0 and "2 of 3 states are finished and kept" in done.err, done.err
    found = (tmp_path / "states" / "states").iterdir()
    assert {path.name: path.read_bytes() for path in found} == wet
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")  # the source is found from where the states lie
    done = rainsim("render", "../states", *LIGHT, "--width", 64, "--out", "../frames")
    assert done.code == 0, done.err
    monkeypatch.chdir(tmp_path)
    assert same(pictures(tmp_path / "whole"), pictures(tmp_path / "frames"))
    assert record(tmp_path / "whole")["ledger"] == record(tmp_path / "frames")["ledger"]
    missing = rainsim("render", "states", "--width", 64, "--frame-range", "0:4")
    assert missing.code == 2 and "frame range is 0:4" in missing.error
    (tmp_path / "states" / "states" / "00001.npz").unlink()
    missing = rainsim("render", "states", "--width", 64, "--out", "again")
    assert missing.code == 1 and "00001.npz does not exist" in missing.error
    assert not (tmp_path / "again").exists()


def test_an_unfinished_run_is_gone_on_with(film, rainsim, tmp_path):
    assert film("whole", "--layers", "depth,splash_id").code == 0
    shutil.copytree(tmp_path / "whole", tmp_path / "part")
    for name in ("frames/00001.png", "preview.webp", "layers/00001.json"):
        (tmp_path / "part" / name).unlink()
    refused = film("part", "--layers", "depth", "--resume")
    assert refused.code == 2 and "was another" in refused.error
    assert film("part", "--layers", "depth,splash_id").code == 2  # without --resume
    done = film("part", "--layers", "depth,splash_id", "--resume", "--threads", 1)
    assert done.code == 0 and "2 of 3 frames are finished and kept" in done.err, done.err
    whole, part = (
        {path.relative_to(folder).as_posix(): path.read_bytes()
         for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path / "whole", tmp_path / "part")
    )  # fmt: skip
    assert {n for n in whole if whole[n] != part.get(n)} <= {"provenance.json", "finished.jsonl"}
    assert set(whole) == set(part)
    one, other = record(tmp_path / "whole"), record(tmp_path / "part")
    for name in ("complete", "frames", "files", "ledger", "notes", "fingerprint"):
        assert one[name] == other[name], name


def test_states_of_another_scene_are_refused(rainsim, scene_folder, tmp_path):
    rainsim("heightmap", scene_folder, *MAP, "--out", "terrain")
    rainsim("simulate", "terrain", "--frames", 1, "--out", "states")
    text = (tmp_path / "states" / "simulation.json").read_text()
    (tmp_path / "states" / "simulation.json").write_text(text.replace("0" * 64, "1" * 64))
    done = rainsim("render", "states", "--width", 64)
    assert done.code == 1 and "made for other splats" in done.error
    with open(tmp_path / "states" / "terrain.npz", "ab") as file:
        file.write(b"of another capture")
    done = rainsim("render", "states", "--width", 64)
    assert done.code == 1 and "is not the file that the states beside it were made" in done.error


def test_frames_of_a_range_are_those_of_the_whole(film, tmp_path):
    assert film("whole").code == 0
    done = film("part", "--frame-range", "1:3")
    assert done.code == 0, done.err
    assert "1 of 3 frames are left to other ranges" in done.err
    whole, part = pictures(tmp_path / "whole"), pictures(tmp_path / "part")
    assert list(part) == ["00001.png", "00002.png"]
    assert all(np.array_equal(part[name], whole[name]) for name in part)
    refused = film("part", "--frame-range", "0:1", "--seed", 7)
    assert refused.code == 2 and "was another" in refused.error
    # The other frames of the very same run may join them; another run replaces it.
    shutil.copytree(tmp_path / "part", tmp_path / "joined")
    assert film("joined", "--frame-range", "0:2").code == 0
    one, other = record(tmp_path / "whole"), record(tmp_path / "joined")
    for name in ("complete", "frames", "files", "ledger", "notes", "fingerprint"):
        assert one[name] == other[name], name
    for name in set(one["files"]) - {"finished.jsonl"}:
        assert (tmp_path / "joined" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert film("part", "--frame-range", "0:1", "--overwrite").code == 0
    assert same(pictures(tmp_path / "part"), whole)
    assert film("part", "--frame-range", "0:1", "--seed", 7, "--overwrite").code == 0
    assert list(pictures(tmp_path / "part")) == ["00000.png"]


def test_workers_draw_the_same_frames(film, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(simulation, "RIPPLE_WARM_UP", WARM_UP)  # as in the workers' processes
    monkeypatch.setattr(environment, "FACE", FACE)
    assert film("whole", frames=2).code == 0
    done = film("farm", "--workers", 1, frames=2)
    assert done.code == 0 and "2 frames in farm/frames" in done.err, done.err
    one, other = record(tmp_path / "whole"), record(tmp_path / "farm")
    for name in ("complete", "frames", "files", "ledger", "notes", "fingerprint"):
        assert one[name] == other[name], name
    for name in set(one["files"]) - {"finished.jsonl"}:
        assert (tmp_path / "farm" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    done = film("other", "--workers", 2, "--frame-range", "0:1")
    assert done.code == 2 and "--workers and --frame-range are both given" in done.error


def test_threads_change_nothing_and_the_seed_does(film, tmp_path, threads):
    assert film("one", "--threads", 1).code == 0
    assert film("two", "--threads", 2).code == 0
    assert film("other", "--seed", 5).code == 0
    assert same(pictures(tmp_path / "one"), pictures(tmp_path / "two"))
    assert not same(pictures(tmp_path / "one"), pictures(tmp_path / "other"))


def test_overwriting_removes_old_frames_and_nothing_else(film, tmp_path):
    assert film("out", frames=3).code == 0
    (tmp_path / "out" / "frames" / "notes.txt").write_text("mine")
    (tmp_path / "out" / "00000.png").write_text("mine")
    assert film("out", frames=2).code == 2
    assert len(record(tmp_path / "out")["frames"]) == 3
    assert film("out", "--overwrite", frames=2).code == 0
    names = sorted(path.name for path in (tmp_path / "out" / "frames").iterdir())
    assert names == ["00000.png", "00001.png", "notes.txt"]
    assert (tmp_path / "out" / "00000.png").read_text() == "mine"


def test_overwriting_never_removes_what_is_read(rainsim, scene_folder, tmp_path):
    map_of = ["heightmap", scene_folder, *MAP, "--out", "map"]
    assert rainsim(*map_of).code == 0
    assert rainsim("simulate", "map", "--frames", 1, "--out", "states").code == 0
    assert rainsim("import", scene_folder, "--out", "scene").code == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    frame = ["--ground-frame", "map/ground_frame.json"]
    for command in (
        ["simulate", "map", "--out", "map"],
        ["simulate", "map/terrain.npz", "--out", "map"],
        ["render", "states", "--width", 64, "--out", "states"],
        ["render", "states", "--scene", "scene", "--width", 64, "--out", "scene"],
        ["run", "--scene", "scene", "--width", 64, *MAP, "--out", "scene"],
        ["run", "--scene", "scene/splats.npz", "--width", 64, *MAP, "--out", "scene"],
        ["import", "scene", "--out", "scene"],
        ["heightmap", "scene", *MAP, "--out", "scene"],
        ["heightmap", "map/bed.tif", "--spacing", 0.04, "--out", "map"],
        [*map_of, "--class-mask", "map/classes.png"],
        ["run", "--scene", scene_folder, *frame, "--width", 64, *MAP, "--out", "map"],
    ):
        done = rainsim(*command, "--overwrite")
        assert done.code in (1, 2), command
        assert "this run reads" in done.error or command[2] == "scene/splats.npz", done.error
        now = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        assert now == before, command


def test_an_error_before_the_first_frame_changes_nothing(film, tmp_path, monkeypatch):
    assert film("out").code == 0
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}

    def fail(*arguments, **options):
        raise DivergedError("depth is NaN at 0.1 s; it must be finite; lower --water-scheme")
        yield

    monkeypatch.setattr(pipeline.FrameSequence, "frames", fail)
    for folder in ("out", "new"):
        done = film(folder, "--overwrite", frames=2)
        assert done.code == 1 and "depth is NaN" in done.error
    after = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert before == after
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt, 130), (DivergedError, 1)])
def test_what_was_finished_is_kept(film, tmp_path, monkeypatch, error, code):
    real = pipeline.FrameSequence.frames

    def breaks_off(*arguments, **options):
        for n, each in enumerate(real(*arguments, **options)):
            if n == 2:
                raise error("stopped")
            yield each

    monkeypatch.setattr(pipeline.FrameSequence, "frames", breaks_off)
    done = film("out", frames=4)
    assert done.code == code
    assert list(pictures(tmp_path / "out")) == ["00000.png", "00001.png"]
    kept = record(tmp_path / "out")
    assert not kept["complete"] and kept["frames"] == [0, 1]
    assert (tmp_path / "out" / "preview.webp").is_file()
    assert done.out == ""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_ends_a_process_with_130(scene_folder, tmp_path, root):
    out = tmp_path / "out"
    arguments = ["run", "--scene", scene_folder, *FILM, "--frames", "9999", "--out", out]
    with subprocess.Popen(
        [sys.executable, "-m", "rainsim", *map(str, arguments)],
        cwd=root,
        stderr=subprocess.PIPE,
        text=True,
        # a shell that runs the tests in the background has all below it ignore the signal
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        deadline = time.monotonic() + 200
        first = out / "frames" / "00000.png"
        while not first.exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        try:
            _, text = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130, text
    assert "interrupted; what was finished is kept" in text and "Traceback" not in text
    assert not record(out)["complete"]
    assert read_image(out / "frames" / "00000.png").shape == (48, 64, 3)
    assert not [path for path in out.rglob(".*")]  # no temporary files


@pytest.mark.parametrize("pressed", [True, False])
def test_ctrl_c_that_a_callback_swallows_still_ends_a_run(film, tmp_path, monkeypatch, pressed):
    # A shell that runs the tests in the background has all below it ignore the signal.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    add = FrameFolder.add

    class Swallows:
        def __del__(self):
            if pressed:
                signal.raise_signal(signal.SIGINT)

    def swallow(*given):
        add(*given)
        Swallows()  # goes at once: what its finalizer raises is dropped

    monkeypatch.setattr(FrameFolder, "add", swallow)
    printed = []
    monkeypatch.setattr(sys, "unraisablehook", printed.append)
    done = film("out")
    assert not printed and sys.unraisablehook == printed.append
    assert done.code == (130 if pressed else 0)
    assert len(pictures(tmp_path / "out")) == (1 if pressed else 3)
    assert record(tmp_path / "out")["complete"] != pressed
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def test_ctrl_c_while_a_kernel_is_loaded_waits_for_the_next_progress():
    module = llvm.parse_assembly("define i32 @one() { ret i32 1 }")
    machine = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(module, machine)
    went_on = []

    def find_kept(module):
        signal.raise_signal(signal.SIGINT)
        went_on.append(module)

    engine.set_object_cache(None, find_kept)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with interrupts_remembered():
            engine.finalize_object()
            assert len(went_on) == 1
            with pytest.raises(KeyboardInterrupt):
                Status(quiet=True).progress("simulate", 0, 1)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.slow
def test_cameras_in_every_way(film, tmp_path, scene_folder):
    frame_of = {}
    for name, options in {
        "chosen": [],
        "first": ["--camera", "view_0"],
        "second": ["--camera", "view_1"],
        "eye": ["--eye", "2,1,-1", "--look-at", "0.5,0.2,-1.2", "--fov", "70"],
        "path": ["--path", "first/transforms.json"],
        "both": ["--height", "40"],
    }.items():
        done = film(name, *options, frames=None if name == "path" else 1)
        assert done.code == 0, done.err
        frame_of[name] = pictures(tmp_path / name)["00000.png"]
        if name in ("chosen", "both"):
            assert re.search(r"camera view_\d is drawn, which shows most water", done.err)
        else:
            assert "most water" not in done.err
    own = load_scene(str(scene_folder)).cameras
    chosen = read_cameras(tmp_path / "chosen" / "transforms.json")[0]
    assert sum(np.allclose(chosen.position, camera.position) for camera in own) == 1
    assert np.array_equal(frame_of["first"], frame_of["path"])
    assert not np.array_equal(frame_of["first"], frame_of["second"])
    assert frame_of["both"].shape == (40, 64, 3)
    assert frame_of["eye"].shape == (43, 64, 3)
    placed = read_cameras(tmp_path / "eye" / "transforms.json")[0]
    assert np.allclose(placed.position, (2, 1, -1))
    done = film("orbit", "--orbit", frames=2)
    assert done.code == 0, done.err
    one, two = read_cameras(tmp_path / "orbit" / "transforms.json")
    assert np.linalg.norm(one.position - two.position) > 1
    done = film("drive", "--drive", frames=None)
    assert done.code == 0, done.err
    assert "WARNING: drive: 3 frames along 3.133 m at 24/s: 135 km/h" in done.err
    driven = read_cameras(tmp_path / "drive" / "transforms.json")
    assert len(pictures(tmp_path / "drive")) == len(driven) == len(own)
    assert all(np.allclose(a.position, b.position) for a, b in zip(driven, own, strict=True))
    done = film("both ways", "--drive", "--orbit")
    assert done.code == 2 and "--orbit and --drive are both given" in done.error
    done = film("long", "--path", "orbit/transforms.json", frames=9)
    assert done.code == 2 and "frames is 9; it must be at most 2" in done.error
    done = film("still", "--path", "first/transforms.json", frames=3)  # one camera stands still
    assert done.code == 0 and len(pictures(tmp_path / "still")) == 3, done.err


def test_layers_are_written_and_make_the_frame(film, tmp_path):
    done = film("out", "--layers", "all", frames=1)
    assert done.code == 0, done.err
    folder = tmp_path / "out"
    facts = json.loads((folder / "layers/00000.json").read_text())
    assert set(facts["units"]) == set(AOVS)
    assert set(facts["files"]) < set(record(folder)["files"])
    found = {}
    for file in facts["files"]:
        name = file.split("/")[1]
        if file.endswith(".png"):
            values = read_image(folder / file)
            found[name] = values / 65535 if AOVS[name].kind == "share" else values
        else:
            found[name] = layer(folder / file, AOVS[name].channels)
    frame = pictures(folder)["00000.png"].astype(int)
    assert np.abs(recompose(found, **facts["light"]) - frame).max() <= 1
    assert film("out", "--overwrite", "--rain", 3, frames=1).code == 0  # another film
    assert not (folder / "layers/00000.json").exists()
    done = film("other", "--layers", "depth,wetnes")
    assert done.code == 2 and "there is no layer 'wetnes'" in done.error
    assert not (tmp_path / "other").exists()


def test_json_is_the_only_thing_on_stdout(film, tmp_path):
    done = film("out", "--json", "--quiet", frames=2)
    assert done.code == 0 and done.err == ""
    shown = json.loads(done.out)
    assert shown["frames"] == ["frames/00000.png", "frames/00001.png"]
    assert shown["out"] == "out" and shown["seconds"] > 0
    assert shown["ledger"] == record(tmp_path / "out")["ledger"]


def test_video_has_all_frames(film, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    done = film("out", "--video", frames=2)
    assert done.code == 0, done.err
    frames, _ = ffmpeg.count_frames_and_secs(str(tmp_path / "out" / "video.mp4"))
    assert frames == 2
    assert "video.mp4" in record(tmp_path / "out")["files"]


def test_a_drive_of_two_legs_gives_a_frame_by_itself_and_goes_on(
    rainsim, scene_folder, tmp_path, monkeypatch
):
    for name, value in {"AHEAD": 0.5, "BEHIND": 0.2, "ASIDE": 0.5, "LEG_CELLS": 100}.items():
        monkeypatch.setattr(f"rainsim.terrain.path_ground.{name}", value)
    how = ["run", "--scene", scene_folder, "--spacing", "0.1", "--width", "64", "--drive"]
    how += ["--preset", "moderate", "--ground-map", "path"]
    done = rainsim(*how, "--out", "all", "--verbose")
    assert done.code == 0, done.err
    assert "ground map along the path: " in done.err and " legs of at most" in done.err
    assert rainsim(*how, "--frame-range", "2:3", "--out", "one").code == 0
    assert list(pictures(tmp_path / "one")) == ["00002.png"]
    name = "frames/00002.png"
    assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "all" / name).read_bytes()
    assert record(tmp_path / "all")["settings"]["terrain"]["ground_map"] == "path"
    whole = pictures(tmp_path / "all")
    (tmp_path / "all" / name).unlink()
    assert rainsim(*how, "--out", "all", "--resume").code == 0
    assert (tmp_path / "all" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
    assert list(pictures(tmp_path / "all")) == list(whole)


def test_ground_along_a_path_needs_a_path(rainsim, scene_folder):
    done = rainsim("run", "--scene", scene_folder, "--width", "64", "--ground-map", "path")
    assert done.code == 2 and "give --drive, --path, --orbit or --camera" in done.error
