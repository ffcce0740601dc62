"""OpenEXR files of a run: names, numbers, what is kept, and options that make no sense."""

import json
import sys

import numpy as np
import pytest

from rainsim.io.images import read_image
from run_folders import exr_parts, layer

FILM = ["--spacing", "0.04", "--extent", "1", "--relight", "off", "--width", "64", "--preset",
        "moderate"]  # fmt: skip


@pytest.fixture
def film(rainsim, scene_folder):
    """Return a function that runs `rainsim run` on the tiny scene into the folder `out`."""

    def run(out, *more, frames=1):
        return rainsim("run", "--scene", scene_folder, *FILM, "--frames", frames, "--out", out,
                       *more)  # fmt: skip

    return run


def record(folder):
    return json.loads((folder / "provenance.json").read_text())


def pictures(folder):
    return [read_image(path) for path in sorted((folder / "frames").iterdir())]


def test_exr_files_are_named_numbered_and_kept(film, tmp_path):
    pytest.importorskip("OpenEXR")
    named = ["--exr", "--exr-name", "shot.%04d.exr", "--frame-start", 1001]
    done = film("out", *named, "--layers", "depth", frames=2)
    assert done.code == 0, done.err
    folder = tmp_path / "out"
    assert {path.name for path in (folder / "exr").iterdir()} == {"shot.1001.exr", "shot.1002.exr"}
    assert {path.name for path in (folder / "layers").iterdir()} == {
        "depth", "00000.json", "00001.json",
    }  # fmt: skip
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert files == {*record(folder)["files"], "provenance.json"}
    assert film("plain", "--layers", "depth", frames=2).code == 0  # the same but for the files
    np.testing.assert_array_equal(pictures(folder), pictures(tmp_path / "plain"))
    first = exr_parts(folder / "exr/shot.1001.exr")
    header, channels = first["beauty"]
    assert header["imageCounter"] == 1001 and header["framesPerSecond"] == 24
    assert channels["R"].shape == (48, 64)
    np.testing.assert_array_equal(
        first["depth"][1]["Z"], layer(next((folder / "layers/depth").glob("00000.*")), ("Z",))
    )
    lost = folder / "exr/shot.1002.exr"
    whole = lost.read_bytes()
    lost.write_bytes(whole[:100])
    done = film("out", *named, "--layers", "depth", "--resume", frames=2)
    assert done.code == 0 and "1 of 2 frames are finished" in done.err, done.err
    assert lost.read_bytes() == whole
    assert film("out", *named, "--colorspace", "acescg", "--resume", frames=2).code == 2
    assert film("out", "--overwrite", frames=1).code == 0  # another film
    assert not list((folder / "exr").iterdir())


@pytest.mark.parametrize(("more", "fault"), [
    (["--colorspace", "acescg"], "--colorspace is given without --exr"),
    (["--frame-start", 5], "--frame-start 5 is given without --exr"),
    (["--exr-name", "a.%d.exr"], "--exr-name is given without --exr"),
    (["--exr", "--exr-name", "a.exr"], "must hold the frame's number once"),
    (["--exr", "--exr-name", "../a.%d.exr"], "without a folder"),
    (["--exr", "--colorspace", "srgb"], "'srgb' is not one of"),
    (["--exr", "--frame-start", -1], "-1 is not in the range"),
])  # fmt: skip
def test_exr_options_are_checked_first(film, tmp_path, more, fault):
    done = film("out", *more)
    assert done.code == 2 and fault in done.error and not (tmp_path / "out").exists()


def test_exr_without_its_library_is_one_line(film, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    done = film("out", "--exr")
    assert done.code == 1 and 'pip install "rainsim[exr]"' in done.error
    assert not (tmp_path / "out").exists()
