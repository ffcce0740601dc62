"""What `rainsim import --info` tells about files."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import made_formats as made
from made_captures import random_splats, ring, splats_at
from made_formats import write_splats
from rainsim.cli import cli
from rainsim.errors import InputError
from rainsim.scene.cameras import write_transforms
from rainsim.scene.folder import import_scene, write_scene
from rainsim.scene.info import as_text, describe
from rainsim.scene.types import GroundFrame


def odd_splats():
    """A thousand splats in a cube of side 2 with some of each odd kind."""
    rng = np.random.default_rng(0)
    splats = splats_at(rng.uniform(-1, 1, (1000, 3)), coefficients=4, scale=0.02, opacity=0.5)
    splats.position[0] = 500, 0, 0  # a stray far out
    splats.opacity[:10] = 0.001
    splats.scale[10:17] = 0
    splats.scale[17:22] = 5.0
    splats.scale[22:34] = 0.001, 0.5, 0.001
    splats.scale[34:84, 2] = 1e-4
    splats.rotation[90:93] = 0  # has no direction: unusable
    splats.position[93, 1] = np.nan
    return splats


def test_numbers_of_a_made_scene(tmp_path):
    splats = odd_splats()
    write_splats(tmp_path / "a.ply", splats)
    write_transforms(tmp_path / "transforms.json", ring(count=7))
    info = describe(tmp_path / "a.ply")
    assert info["splats"] == 996 and info["broken"] == 4 and info["sh_degree"] == 1
    assert info["cameras"] == 7 and info["format"] == "3DGS PLY"
    assert info["bytes"] == (tmp_path / "a.ply").stat().st_size
    assert info["invisible"] == 10 and info["oversized"] == 5 and info["needles"] == 12
    assert info["without_size"] == 7 or info["without_size"] == 0  # a file cannot store a zero
    assert info["flat"] == 50
    assert info["bounds"]["high"][0] == 500 and info["core"]["high"][0] < 1
    assert info["core"]["low"][1] == pytest.approx(-0.98, abs=0.01)
    assert info["opacity"]["50"] == pytest.approx(0.5) and info["opacity"]["0"] < 0.002
    assert info["scale_longest"]["100"] == pytest.approx(5, rel=1e-5)
    assert info["scale_thinnest"]["50"] == pytest.approx(0.02, rel=1e-5)
    assert info["memory"]["splats"] == 996 * 4 * (3 + 4 + 3 + 1 + 12)
    assert info["memory"]["drawing"] > 2 * info["memory"]["splats"]
    assert "dropped 4 of 1000" in info["notes"][0]


def test_files_that_are_too_broken_to_read_are_still_described(tmp_path):
    splats = random_splats(100)
    splats.position[:40] = np.nan
    write_splats(tmp_path / "a.ply", splats)
    with pytest.raises(InputError, match="at most 1 %"):
        import_scene(tmp_path / "a.ply")
    info = describe(tmp_path / "a.ply")
    assert info["broken"] == 40 and info["splats"] == 60
    assert "40 (40 %)" in as_text(info)
    splats.position[:] = np.nan
    write_splats(tmp_path / "a.ply", splats)
    with pytest.raises(InputError, match="100 of 100"):
        describe(tmp_path / "a.ply")


def test_folders_of_models_and_scenes(tmp_path):
    model = tmp_path / "garden"
    (model / "point_cloud/iteration_7").mkdir(parents=True)
    write_splats(model / "point_cloud/iteration_7/point_cloud.ply", random_splats(30))
    write_transforms(model / "transforms.json", ring(count=4))
    info = describe(model)
    assert info["splats"] == 30 and info["cameras"] == 4
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3))
    write_scene(tmp_path / "scene", import_scene(model, ground_frame=frame))
    again = describe(tmp_path / "scene")
    assert again["format"] == "rainsim scene folder" and again["cameras"] == 4
    for key in ("splats", "sh_degree", "bounds", "opacity", "memory"):
        assert again[key] == info[key], key


def test_the_command_tells_people_and_programs(tmp_path):
    path = tmp_path / "a.splat"
    path.write_bytes(made.splat_records(splats_at(np.eye(3) * 2)))
    result = CliRunner().invoke(cli, ["import", "--info", str(path)])
    assert result.exit_code == 0, result.output
    assert "3, spherical harmonics of degree 0" in result.output
    assert "(0, 0, 0) to (2, 2, 2)" in result.output and "NaN or unusable" in result.output
    result = CliRunner().invoke(cli, ["import", "--info", "--json", str(path)])
    found = json.loads(result.output)
    assert found["splats"] == 3 and found["format"] == ".splat"
    assert found == describe(path) and sorted(p.name for p in tmp_path.iterdir()) == ["a.splat"]
