"""`rainsim heightmap` on the command line: what it tells and draws, its masks and its meshes."""

import json

import numpy as np
import pytest

from rainsim.io import images
from rainsim.io.states import read_state
from rainsim.scene.folder import read_scene

MAP = ("--extent", 1, "--spacing", 0.04)


def test_heightmap_tells_and_draws(rainsim, scene_folder, tmp_path):
    done = rainsim("heightmap", scene_folder, *MAP, "--out", "a", "--check", "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["shares"]["measured"] > 0.4 and 0 < told["noise_mm"] < 20
    assert abs(sum(told["classes"].values()) - 1) < 1e-6
    rows = told["puddles"]["after_rain"]
    assert [row["rain_mm"] for row in rows] == [1, 3, 8, 20]
    assert rows[-1]["litres"] >= rows[0]["litres"] and told["puddles"]["residual"] < 1e-9
    check = images.read_image(tmp_path / "a" / "check.png")
    assert (check[..., 0].astype(int) - check[..., 2] > 60).any()  # yellow and red lines
    mask = np.zeros((50, 50, 3), np.uint8)
    mask[:, :] = (80, 150, 60)
    images.write_png(tmp_path / "grass.png", mask)
    done = rainsim("heightmap", scene_folder, *MAP, "--out", "b", "--class-mask", "grass.png")
    assert done.code == 0 and "grass 100%" in done.out, done.err
    water = np.zeros((50, 50))
    water[10:20, 10:20] = 25
    images.write_png16(tmp_path / "water.png", water)
    done = rainsim("heightmap", scene_folder, *MAP, "--out", "d", "--water-mask", "water.png")
    assert done.code == 0 and "water mask: dents of 4 litres" in done.err, done.err
    done = rainsim("simulate", "d", "--frames", 1, "--past-rain", 0, "--rain", 0, "--out", "still")
    assert done.code == 0, done.err
    depth = read_state(tmp_path / "still" / "states" / "00000.npz").depth
    assert depth.max() > 5e-3
    done = rainsim("heightmap", scene_folder, "--out", "e", "--water-mask", "grass.png")
    assert done.code == 1 and "must be grey" in done.err


def test_a_mesh_can_be_rained_on(rainsim, tmp_path):
    u = np.linspace(-1, 1, 9)
    x, y = np.meshgrid(u, u)
    lines = [f"v {a} {b} {0.1 * (a * a + b * b)}" for a, b in zip(x.flat, y.flat, strict=True)]
    for j in range(8):
        for i in range(8):
            a = 9 * j + i + 1
            lines.append(f"f {a} {a + 1} {a + 10} {a + 9}")
    (tmp_path / "bowl.obj").write_text("\n".join(lines))
    done = rainsim("heightmap", "bowl.obj", "--spacing", 0.05, "--out", "bowl")
    assert done.code == 0 and "paving 100%" in done.out, done.err
    done = rainsim("simulate", "bowl", "--frames", 1, "--out", "states")
    assert done.code == 0, done.err
    refused = rainsim("heightmap", "bowl.obj", "--check", "--out", "c")
    assert refused.code == 2 and "--check" in refused.error


def test_fall_and_length_reach_the_frame(rainsim, scene_folder):
    common = (*MAP, "--json", "--overwrite", "--out", "t")
    plain = json.loads(rainsim("heightmap", scene_folder, *common).out)
    done = rainsim("heightmap", scene_folder, *common, "--fall", "2,0")
    up, tilted = (np.array(t["ground_frame"]["up"]) for t in (plain, json.loads(done.out)))
    np.testing.assert_allclose(np.degrees(np.arccos(up @ tilted)), 1.146, atol=0.01)
    both = ("--known-length", "0,0,0,1,0,0,0.6", "--meters-per-unit", 1)
    refused = rainsim("heightmap", scene_folder, *common, *both)
    assert refused.code == 2 and "one way only" in refused.error


def test_a_length_picked_in_a_picture_gives_the_scale(rainsim, scene_folder):
    common = (*MAP, "--json", "--overwrite", "--out", "t")
    scene = read_scene(scene_folder)
    camera, frame = scene.cameras[0], scene.ground_frame
    # Two places on the ground, as the camera's picture shows them.
    ends = []
    for place in ((0.5, -0.4, 0.0), (0.5, 0.4, 0.0)):
        x, y, z = camera.camera_from_world[:3] @ np.append(frame.to_capture(place), 1.0)
        ends += [camera.cx + camera.fx * x / z, camera.cy + camera.fy * y / z]
    pick = ",".join(f"{v:.2f}" for v in ends)
    done = rainsim(
        "heightmap", scene_folder, *common, "--known-length", f"{camera.name}:{pick},1.6"
    )
    assert done.code == 0, done.err
    told = json.loads(done.out)["ground_frame"]
    assert told["meters_per_unit"] == pytest.approx(2 * frame.meters_per_unit, rel=0.05)
    assert not told["scale_assumed"]
    for wrong, message in (
        (f"{camera.name}:-5,0,{pick.split(',', 2)[2]},1.6", "outside the picture"),
        (f"{camera.name}:{pick}", "5 finite numbers"),
        (f"nobody:{pick},1", "no camera 'nobody'"),
        ("1,2,3", "7 finite numbers"),
    ):
        refused = rainsim("heightmap", scene_folder, *common, "--known-length", wrong)
        assert refused.code == 2 and message in refused.err, refused.err
