"""Splats in USD stages: values, places, what the stage says of up and metres, what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_gltf import check_placed

import made_formats as made
from made_captures import random_splats
from rainsim.errors import InputError
from rainsim.scene.folder import import_scene
from rainsim.scene.formats import read, sha256_of, usd
from rainsim.scene.types import GroundFrame, Scene
from rainsim.world.usd_files import Clock, capture_layer
from scenes import tiny_scene

pytest.importorskip("pxr")
SPLATS = made.tame_splats(40, 9)
SAYS = 'upAxis = "{}"\nmetersPerUnit = {}'.format
TURN = Rotation.from_euler("xyz", (20, -50, 80), degrees=True).as_matrix()
FRAME = GroundFrame(TURN, 0.37, np.array([1.0, 2.0, 3.0]))


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Read USD here: half a second a file is saved."""
    monkeypatch.setattr(usd, "apart", lambda function, *given: function(*given))


def stage(path, inside, head=""):
    path.write_text(f"#usda 1.0\n(\n{head}\n)\n{inside}", encoding="utf-8")
    return path


def placed(rows):
    rows = ", ".join(str(tuple(row)) for row in np.asarray(rows).tolist())
    order = 'uniform token[] xformOpOrder = ["xformOp:transform"]'
    return f"matrix4d xformOp:transform = ({rows})\n{order}\n"


def test_what_world_writes_comes_back(tmp_path, monkeypatch):
    monkeypatch.undo()  # in a process of its own, as for users
    scene = Scene("a", random_splats(500, 16, 3), (), FRAME)
    capture_layer(scene, Clock(0, 0, 24.0)).write(tmp_path / "capture.usdc")
    found = read(tmp_path / "capture.usdc")
    assert found.format == "USD" and found.broken == 0
    made.check_arrays(found.splats)
    matrix = np.column_stack([0.37 * TURN, FRAME.translation])
    check_placed(found.splats, scene.splats, matrix, TURN, 2e-6)


@pytest.mark.parametrize("scale", [(0.5, 0.5, 0.5), (0.5, 2.0, 1.0)])
def test_a_stage_in_centimetres_with_y_up_and_parents(tmp_path, scale):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 100 * TURN * scale, (100, 200, 300)
    moved = "float3 xformOp:translate = (50, 0, 0)"
    order = 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    inside = made.usda_splats(SPLATS, lines=placed(matrix.T))
    inside = f'def Xform "Rig"\n{{\n{moved}\n{order}\n{inside}}}\n'
    found = read(stage(tmp_path / "a.usda", inside, SAYS("Y", 0.01)))
    matrix[0, 3] += 50
    y_up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    check_placed(found.splats, SPLATS, 0.01 * y_up @ matrix[:3], y_up @ TURN)


def test_half_precision_and_several_prims(tmp_path):
    hidden = made.usda_splats(SPLATS, lines='token visibility = "invisible"')
    named = [
        made.usda_splats(SPLATS, "h").replace("Splats", "A", 1),
        made.usda_splats(SPLATS).replace("Splats", "B", 1),
        hidden.replace("Splats", "C", 1),
    ]
    found = read(stage(tmp_path / "a.usda", "".join(named), SAYS("Z", 1))).splats
    assert len(found) == 2 * len(SPLATS)
    straight = np.eye(4)[:3]
    check_placed(found.take(slice(0, 40)), SPLATS, straight, np.eye(3), 3e-3)
    check_placed(found.take(slice(40, 80)), SPLATS, straight, np.eye(3))


def test_the_stage_says_up_and_metres_and_is_the_ground_frame_if_it_fits(tmp_path):
    scene = tiny_scene()
    capture_layer(scene, Clock(0, 0, 24.0)).write(tmp_path / "capture.usdc")
    found = import_scene(tmp_path / "capture.usdc")
    ours = scene.ground_frame.to_ground(scene.splats.position)
    np.testing.assert_allclose(found.ground_frame.to_ground(found.splats.position), ours, atol=1e-5)
    assert not found.ground_frame.scale_assumed
    assert not any("ASSUMED" in note for note in found.ground_frame.notes)
    given = import_scene(tmp_path / "capture.usdc", meters_per_unit=0.5).ground_frame
    assert given.meters_per_unit == 0.5
    high = 'def Xform "High" (references = @capture.usdc@)\n{\n' + placed(
        np.eye(4) + 5 * np.eye(4)[[3]].T @ np.eye(4)[[2]]
    )
    high = import_scene(stage(tmp_path / "high.usda", high + "}\n", SAYS("Z", 1)))
    ground = high.ground_frame.to_ground(high.splats.position)[:, 2]
    assert abs(np.median(ground) - np.median(ours[:, 2])) < 0.02  # its ground is found again
    silent = stage(tmp_path / "silent.usda", made.usda_splats(SPLATS))
    assert not read(silent).notes  # neither axes nor unit are said


def test_all_files_of_a_stage_are_hashed(tmp_path):
    stage(tmp_path / "b.usda", made.usda_splats(SPLATS), 'defaultPrim = "Splats"')
    path = stage(tmp_path / "a.usda", 'def "A" (references = @b.usda@)\n{\n}\n')
    before = sha256_of(path)
    stage(tmp_path / "b.usda", made.usda_splats(made.tame_splats(30, 9)), 'defaultPrim = "Splats"')
    assert len(read(path).splats) == 30 and sha256_of(path) != before


@pytest.mark.parametrize(
    ("changed", "lines", "message"),
    [
        ({"scales": ""}, "", "scales has no value"),
        ({"positions": ""}, "", "positions has no value"),
        ({"opacities": "double[] opacities = [1]"}, "", "opacities is a DoubleArray; it must be"),
        ({"scales": "float3 scales = (1, 2, 3)"}, "", "scales is a Vec3f; it must be Vec3fArray"),
        ({"orientations": "float4[] orientations = [(1, 0, 0, 0)]"}, "", "orientations is a Vec4f"),
        ({"opacities": "float[] opacities = [0.5, 0.5]"}, "", "has 2 values; it must be 40"),
        ({"sphericalHarmonicsDegree": ""}, "", "Coefficients has 360 values; it must be 640"),
        ({"sphericalHarmonicsDegree": "uniform int radiance:sphericalHarmonicsDegree = 4"}, "",
         "sphericalHarmonicsDegree is 4; it must be 0 to 3"),
        ({"opacities": f"float[] opacities = [{', '.join(['nan'] * 40)}]"}, "", "40 of 40 splats"),
        ({}, placed(np.diag([1, 1, -1, 1])), "mirrors or shears"),
        ({}, placed(np.diag([1, 0, 1, 1])), "a node scales by"),
        ({}, placed(np.diag([1, 1, np.inf, 1])), "its place is no finite matrix"),
        ({}, placed(np.diag([1, 1, 1, 5])), "its place is no finite matrix"),
        ({}, 'token xformOp:translate = "a"\nuniform token[] xformOpOrder = ["xformOp:translate"]',
         "xformOp:translate is a str; it must be a|cannot be read as USD"),
    ],
)  # fmt: skip
def test_broken_splats_end_in_one_line(tmp_path, changed, lines, message):
    path = stage(tmp_path / "a.usda", made.usda_splats(SPLATS, lines=lines, **changed))
    with pytest.raises(InputError, match=message) as error:
        read(path)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


def test_bytes_that_are_no_text_end_in_one_line(tmp_path):
    path = stage(tmp_path / "a.usda", made.usda_splats(SPLATS))
    path.write_bytes(path.read_bytes().replace(b"point3f[]", b"\xff\xceint3f[]"))
    with pytest.raises(InputError, match="cannot be read as USD"):
        read(path)


def test_a_stage_without_splats_and_what_is_no_stage(tmp_path):
    with pytest.raises(InputError, match="is a USD stage without splats"):
        read(stage(tmp_path / "a.usda", 'def Xform "A"\n{\n}\n'))
    (tmp_path / "b.usdz").write_bytes(b"no zip")
    with pytest.raises(InputError, match="cannot be opened as USD"):
        read(tmp_path / "b.usdz")
