"""`rainsim import --lod` and what runs on its chunks, as a user calls them."""

import json
import sys
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import pytest

from made_captures import write_model_folder
from rainsim.lod import cut
from run_folders import facts, written
from scenes import tiny_scene

pytest.importorskip("gsply")
pytest.importorskip("imagecodecs")
MAP = ["--extent", 1, "--spacing", 0.04]


@pytest.fixture
def model(tmp_path):
    """A trained model's folder with the splats of `tiny_scene`."""
    write_model_folder(tmp_path / "yard", tiny_scene(), ["a", "b", "c"])
    return tmp_path / "yard"


@pytest.mark.slow
def test_a_capture_is_cut_run_and_drawn(rainsim, model, tmp_path):
    scale = ["--meters-per-unit", 0.6]
    done = rainsim("import", model, "--lod", *scale, "--out", "scene", "--json")
    assert done.code == 0, done.error
    facts = json.loads(done.out)
    assert facts["name"] == "yard" and facts["cameras"] == ["a", "b", "c"]
    scene = json.loads((tmp_path / "scene" / "scene.json").read_text())
    assert scene["chunks"] == "lod-meta.json" and not (tmp_path / "scene" / "splats.npz").exists()
    assert (tmp_path / "scene" / "0_0" / "meta.json").is_file()
    fine = ["--detail", 0.5, "--memory", 0.2, "--layers", "depth"]
    size = ["--camera", "b", *MAP, "--width", 64, "--frames", 2]
    done = rainsim("run", "--scene", "scene", *size, *fine, "--out", "wet")
    assert done.code == 0, done.error
    assert len(list((tmp_path / "wet" / "frames").glob("*.png"))) == 2
    done = rainsim("splat", "scene", "--camera", "a", "--width", 64, "--out", "dry.png")
    assert done.code == 0, done.error
    assert rainsim("import", "--info", "scene").code == 0
    assert rainsim("import", "--info", "scene/lod-meta.json").code == 0


def test_what_cannot_be_cut_or_drawn_is_refused_in_one_line(rainsim, model, tmp_path):
    assert rainsim("import", model, "--lod", "--meters-per-unit", 0.6, "--out", "scene").code == 0
    before = {p: p.read_bytes() for p in Path(tmp_path / "scene").rglob("*") if p.is_file()}
    for command in (
        ["import", model, "--lod", "--out", "scene"],
        ["import", model, "--lod", "--out", "scene", "--resume"],
        ["import", "scene", "--lod", "--out", "again"],
        ["import", "scene/lod-meta.json", "--lod", "--out", "again"],
        ["import", "scene", "--out", "copy"],
        ["run", "--scene", "scene", "--detail", -1],
        ["run", "--scene", "scene", "--memory", 0],
    ):
        done = rainsim(*command)
        assert done.code in (1, 2), command
        assert "Traceback" not in done.err and done.err.count("Error:") == 1, done.err
    now = {p: p.read_bytes() for p in Path(tmp_path / "scene").rglob("*") if p.is_file()}
    assert now == before


def test_a_missing_reader_of_chunks_is_named_before_the_cut(rainsim, model, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    done = rainsim("import", model, "--lod", "--out", "scene")
    assert done.code == 1 and 'needs the package imagecodecs; pip install "rainsim[formats]"' in (
        done.err
    )
    assert not list(tmp_path.glob("scene/*_*"))


def test_an_interrupted_cut_is_made_again_or_replaced(rainsim, model, tmp_path, monkeypatch):
    monkeypatch.setattr(cut, "CHUNK", 500)
    monkeypatch.setattr(cut, "cut", partial(cut.cut, leaf=300))
    words = ["import", model, "--lod", "--meters-per-unit", 0.6, "--out"]
    assert rainsim(*words, "whole").code == 0
    with monkeypatch.context() as patch:
        patch.setattr(cut, "in_order", Mock(side_effect=KeyboardInterrupt))
        assert rainsim(*words, "out").code == 130
    assert not (tmp_path / "out/lod-meta.json").exists()
    assert rainsim(*words, "out").code == 2
    other = rainsim("import", model, "--lod", "--meters-per-unit", 1, "--out", "out", "--resume")
    assert other.code == 2 and "was another" in other.error
    assert rainsim(*words, "out", "--resume").code == 0
    assert written(tmp_path / "out") == written(tmp_path / "whole")
    assert facts(tmp_path / "out") == facts(tmp_path / "whole")

    (tmp_path / "out/notes.txt").write_text("keep")
    words[words.index(0.6)] = 1
    assert rainsim(*words, "out", "--overwrite").code == 0
    assert set(written(tmp_path / "out")) == {*facts(tmp_path / "out")["files"], "notes.txt"}
