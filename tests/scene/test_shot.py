"""Cameras of USD, glTF and Blender: lens, place, units, axes, frames; and broken files."""

import base64
import importlib.util
import json
import os
import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rainsim.errors import InputError, ParameterError, RainsimError
from rainsim.scene import usd_cameras
from rainsim.scene.shot import read_shot

# A camera with a shift under a parent that scales, a point, and where Blender 5.0 has it in
# pictures of several shapes: x from the left and y from below, over width and height.
PLACE = [
    [0.936293363571167, 0.10382825881242752, 0.3355211317539215, 1.4367012977600098],
    [0.2896294891834259, 0.3121226131916046, -0.9048172235488892, 1.9260859489440918],
    [-0.19866932928562164, 0.9443511962890625, 0.2621666193008423, 4.950340747833252],
    [0.0, 0.0, 0.0, 1.0],
]
POINT = np.array([-2.31477952003479, 20.040546417236328, 3.611407995223999, 1.0])
SEEN = [  # width, height, pixel aspect, sensor fit, x, y
    (600, 900, 1, "AUTO", 0.5322916507720947, 0.7930555939674377),
    (800, 600, 2, "AUTO", 0.5215277671813965, 1.2814815044403076),
    (800, 600, 1, "VERTICAL", 0.5465277433395386, 0.8740741610527039),
]
APERTURES = [  # as Blender exports them for the same: wide, tall, and their offsets
    (0.21333334, 0.32, 0.032, -0.016), (0.32, 0.12, 0.032, -0.016), (0.32, 0.24, 0.024, -0.012),
]  # fmt: skip
EXAMPLE = Path(__file__).resolve().parents[2] / "examples/blender_camera.py"


def seen(camera, point):
    """Where a camera has a point, over width and height, from the left and from below."""
    x, y, z, _ = camera.camera_from_world @ point
    return (
        (camera.fx * x / z + camera.cx) / camera.width,
        1 - (camera.fy * y / z + camera.cy) / camera.height,
    )


class Matrix(list):
    """As much of Blender's matrices as the script uses."""

    def normalized(self):
        return self


def blender(width, height, pixel, fit, frames=(101, 101)):
    """Return a stand-in for the module bpy with one camera."""
    lens = SimpleNamespace(type="PERSP", sensor_fit=fit, sensor_width=32.0, sensor_height=24.0,
                           lens=35.0, shift_x=0.1, shift_y=-0.05)  # fmt: skip
    camera = SimpleNamespace(name="Shot", data=lens, matrix_world=Matrix(PLACE))
    render = SimpleNamespace(
        resolution_x=2 * width, resolution_y=2 * height, resolution_percentage=50, fps=25,
        fps_base=1.0, pixel_aspect_x=pixel, pixel_aspect_y=1.0,
    )  # fmt: skip
    scene = SimpleNamespace(
        camera=camera, render=render, frame_current=7, frame_start=frames[0], frame_end=frames[1],
        frame_step=1, unit_settings=SimpleNamespace(scale_length=0.5), frame_set=lambda n: None,
    )  # fmt: skip
    return SimpleNamespace(context=SimpleNamespace(scene=scene))


@pytest.mark.parametrize("case", SEEN)
def test_the_script_for_blender_writes_what_blender_sees(case, tmp_path, monkeypatch):
    *how, x, y = case
    monkeypatch.setitem(sys.modules, "bpy", blender(*how))
    spec = importlib.util.spec_from_file_location("blender_camera", EXAMPLE)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.main(tmp_path / "camera.json")
    as_stands = read_shot(tmp_path / "camera.json", as_stands=True)
    (camera,) = as_stands.cameras
    assert (camera.width, camera.height) == tuple(how[:2])
    np.testing.assert_allclose(seen(camera, POINT), (x, y), atol=1e-6)
    shot = read_shot(tmp_path / "camera.json")
    assert (shot.fps, shot.first) == (25, 101)
    np.testing.assert_allclose(shot.cameras[0].position, 0.5 * camera.position, rtol=1e-12)


def test_a_transforms_json_without_a_shot_is_another_kind(tmp_path):
    (tmp_path / "transforms.json").write_text("{}")
    assert read_shot(tmp_path / "transforms.json") is None


# --- glTF


def gltf(path, animated=True, **perspective):
    """Write a camera under a node that scales and moves; return its places at three times."""
    times = np.float32([0.0, 0.25, 0.5])
    moves = np.float32([[0, 0, 0], [1, 0, 0], [1, 2, 0]])
    turns = Rotation.from_euler("y", [[0], [30], [80]], degrees=True).as_quat().astype(np.float32)
    lifts = np.zeros((3, 3, 3), np.float32)
    lifts[:, 1, 1] = 0, 1, 0  # values of a cubic spline; tangents of zero
    arrays = [times, moves, turns, lifts]
    data = b"".join(a.tobytes() for a in arrays)
    starts = np.cumsum([0, *(a.nbytes for a in arrays)])
    types = ["SCALAR", "VEC3", "VEC4", "VEC3"]
    tree = {
        "asset": {"version": "2.0"},
        "nodes": [
            {"name": "rig", "children": [1], "scale": [2, 2, 2], "translation": [0, 5, 0]},
            {"name": "eye", "camera": 0},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.6, **perspective}}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(s), "byteLength": a.nbytes}
            for s, a in zip(starts, arrays, strict=False)
        ],
        "accessors": [
            {"bufferView": k, "componentType": 5126, "type": t, "count": a.size // n}
            for k, (t, a, n) in enumerate(zip(types, arrays, (1, 3, 4, 3), strict=True))
        ],
        "animations": [{
            "samplers": [
                {"input": 0, "output": 1, "interpolation": "STEP"}, {"input": 0, "output": 2},
                {"input": 0, "output": 3, "interpolation": "CUBICSPLINE"},
            ],
            "channels": [
                {"sampler": 0, "target": {"node": 1, "path": "translation"}},
                {"sampler": 1, "target": {"node": 1, "path": "rotation"}},
                {"sampler": 2, "target": {"node": 0, "path": "translation"}},
            ],
        }] * animated,
    }  # fmt: skip
    if path.suffix == ".gltf":
        uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        tree["buffers"][0]["uri"] = uri
        path.write_text(json.dumps(tree))
    else:
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        data += b"\0" * (-len(data) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    # At 8 frames/s: the keys at frames 0, 2 and 4, and what lies between.
    lift = np.array([0, 0.5, 1, 0.5, 0])  # half way of a spline without tangents
    step = np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 2, 0]])
    return step * 2 + np.outer(lift, [0, 1, 0]), np.array([0, 15, 30, 55, 80])


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_gltf_is_sampled_at_frames_with_its_parents(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    places, angles = gltf(path, aspectRatio=2.0)
    shot = read_shot(path, fps=8)
    assert shot.fps is None and shot.first == 0 and len(shot.cameras) == 5
    y_up = np.array([camera.position for camera in shot.cameras]) @ [
        [1, 0, 0],
        [0, 0, -1],
        [0, 1, 0],
    ]
    np.testing.assert_allclose(y_up, places, atol=1e-6)
    for camera, angle in zip(shot.cameras, np.radians(angles), strict=True):
        ahead = np.array([-np.sin(angle), np.cos(angle), 0])  # -z of glTF is y with z up
        np.testing.assert_allclose(camera.forward, ahead, atol=1e-6)
        np.testing.assert_allclose(camera.image_up, [0, 0, 1], atol=1e-6)
        assert (camera.width, camera.height) == (1920, 960)
        assert camera.fy == pytest.approx(480 / np.tan(0.3)) and camera.fx == camera.fy


def test_a_gltf_that_stands_still_is_one_camera(tmp_path):
    gltf(tmp_path / "a.gltf", animated=False)
    shot = read_shot(tmp_path / "a.gltf")
    np.testing.assert_allclose(shot.cameras[0].position, [0, 0, 5], atol=1e-12)
    assert len(shot.cameras) == 1 and shot.cameras[0].height == 1280


def changed(path, change):
    tree = json.loads(path.read_text())
    change(tree)
    path.write_text(json.dumps(tree))
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t["nodes"][1].pop("camera"), "holds no camera"),
        (lambda t: t["nodes"][0].update(camera=0), r"has 2 cameras \(rig, rig/eye\) and none is"),
        (lambda t: t["nodes"][1].update(children=[0]), "holds no camera"),  # no root is left
        (lambda t: t["cameras"][0].update(type="orthographic"), "must be perspective"),
        (lambda t: t["cameras"][0]["perspective"].update(yfov=0), "the angle must be above 0"),
        (lambda t: t["nodes"][0].update(scale=[0, 1, 1]), "scales above 0"),
        (lambda t: t["nodes"][0].update(scale=[-1, 1, 1]), "without scale or mirroring"),
        (
            lambda t: t["buffers"][0].update(uri="gone.bin"),
            "the data of a glTF must be a file",
        ),
        (lambda t: t["buffers"][0].update(uri="data:,@"), "no base64"),
        (lambda t: t["buffers"][0].update(uri="/dev/zero"), "or in a folder below"),
        (lambda t: t["buffers"][0].update(uri="../b.bin"), "or in a folder below"),
        (lambda t: t["accessors"][0].update(count=9999), "ends behind the file's"),
        (lambda t: t.pop("asset"), "is no glTF"),
        (lambda t: t["animations"][0]["samplers"][0].update(input=1), "must have 1 parts"),
    ],
)
def test_broken_gltf_ends_in_one_line(tmp_path, change, message):
    path = tmp_path / "a.gltf"
    gltf(path)
    with pytest.raises(RainsimError, match=message) as error:
        read_shot(changed(path, change))
    assert "\n" not in str(error.value)


def test_data_of_a_gltf_lie_in_its_folder_or_below_and_in_a_regular_file(tmp_path):
    (tmp_path / "in" / "parts").mkdir(parents=True)
    path = tmp_path / "in" / "a.gltf"
    gltf(path)
    tree = json.loads(path.read_text())
    data = base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2])
    expected = read_shot(path).cameras
    for name in ("parts/b.bin", "../b.bin"):
        (path.parent / name).write_bytes(data)
        tree["buffers"][0]["uri"] = name
        path.write_text(json.dumps(tree))
        if name.startswith(".."):
            with pytest.raises(InputError, match="or in a folder below"):
                read_shot(path)
        else:
            assert [c.position.tolist() for c in read_shot(path).cameras] == [
                c.position.tolist() for c in expected
            ]
    (path.parent / "b.bin").symlink_to(tmp_path / "b.bin")
    os.mkfifo(path.parent / "pipe.bin")
    for name, message in (("b.bin", "in a folder below"), ("pipe.bin", "a pipe or a device")):
        tree["buffers"][0]["uri"] = name
        path.write_text(json.dumps(tree))
        with pytest.raises(InputError, match=message):
            read_shot(path)


# --- USD


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Read USD here: half a second a file is saved."""
    monkeypatch.setattr(usd_cameras, "apart", lambda function, *given: function(*given))


def usda(path, inside, head="", up="Z", meters=1.0):
    text = f'#usda 1.0\n(\nupAxis = "{up}"\nmetersPerUnit = {meters}\n{head}\n)\n'
    path.write_text(text + inside)
    return path


def usd_camera(lines, name="Cam"):
    return f'def Camera "{name}"\n{{\n{lines}\n}}\n'


@pytest.mark.parametrize(("case", "apertures"), [*zip(SEEN, APERTURES, strict=True)])
def test_usd_has_the_lens_that_blender_wrote(case, apertures, tmp_path):
    pytest.importorskip("pxr")
    wide, tall, right, up = apertures
    rows = np.array(PLACE).T.tolist()
    lines = f"""float focalLength = 0.35
float horizontalAperture = {wide}
float verticalAperture = {tall}
float horizontalApertureOffset = {right}
float verticalApertureOffset = {up}
matrix4d xformOp:transform = ({", ".join(str(tuple(row)) for row in rows)})
uniform token[] xformOpOrder = ["xformOp:transform"]"""
    (camera,) = read_shot(usda(tmp_path / "a.usda", usd_camera(lines))).cameras
    np.testing.assert_allclose(seen(camera, POINT), case[-2:], atol=2e-6)


def test_usd_in_centimetres_with_y_up_and_parents(tmp_path):
    pytest.importorskip("pxr")
    inside = """def Xform "Rig"
{
    double3 xformOp:translate.timeSamples = { 10: (100, 0, 0), 12: (300, 0, 0) }
    float3 xformOp:scale = (10, 10, 10)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    def Camera "Cam"
    {
        float focalLength.timeSamples = { 10: 50, 14: 70 }
        double3 xformOp:translate = (0, 20, 5)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
    head = "startTimeCode = 10\nendTimeCode = 14\ntimeCodesPerSecond = 48\nframesPerSecond = 24"
    shot = read_shot(usda(tmp_path / "a.usda", inside, head, "Y", 0.01))
    assert (shot.fps, shot.first, len(shot.cameras)) == (24, 5, 3)
    x = [camera.position for camera in shot.cameras]
    np.testing.assert_allclose(x, [[1, -0.5, 2], [3, -0.5, 2], [3, -0.5, 2]], atol=1e-12)
    np.testing.assert_allclose(shot.cameras[0].forward, [0, 1, 0], atol=1e-12)
    focal = [camera.fx / camera.width * 20.955 for camera in shot.cameras]
    np.testing.assert_allclose(focal, [50, 60, 70], rtol=1e-6)
    (raw, *_) = read_shot(tmp_path / "a.usda", as_stands=True).cameras
    np.testing.assert_allclose(raw.position, [100, 200, 50])


@pytest.mark.parametrize(
    ("policy", "focal_x", "focal_y"),  # px of 200 x 100: the aperture is 2 x 2, the focal length 1
    [("expandAperture", 50, 50), ("cropAperture", 100, 100), ("adjustApertureHeight", 100, 100),
     ("adjustApertureWidth", 50, 50), ("adjustPixelAspectRatio", 100, 50)],
)  # fmt: skip
def test_render_settings_give_size_and_shape(policy, focal_x, focal_y, tmp_path):
    pytest.importorskip("pxr")
    lens = "float focalLength = 1\nfloat horizontalAperture = 2\nfloat verticalAperture = 2"
    settings = f"""def "Render"
{{
    def RenderSettings "Settings"
    {{
        uniform int2 resolution = (200, 100)
        uniform token aspectRatioConformPolicy = "{policy}"
    }}
}}
"""
    head = 'renderSettingsPrimPath = "/Render/Settings"'
    (camera,) = read_shot(usda(tmp_path / "a.usda", usd_camera(lens) + settings, head)).cameras
    assert (camera.width, camera.height) == (200, 100)
    assert (camera.fx, camera.fy) == pytest.approx((focal_x, focal_y), rel=1e-6)


UNEVEN = "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 5))"
RENDERED = 'def RenderSettings "R"\n{{\nuniform {}\n}}\n'.format
SET = {"head": 'renderSettingsPrimPath = "/R"'}
PLACED = 'uniform token[] xformOpOrder = ["xformOp:{0}"]\n{1} xformOp:{0} = {2}'.format


@pytest.mark.parametrize(
    ("inside", "settings", "message"),
    [
        ("", {}, "holds no camera"),
        (usd_camera("float focalLength = 0"), {}, "focal length of 0"),
        (usd_camera("float focalLength = nan"), {}, "focal length of nan"),
        (usd_camera("float verticalAperture = 0"), {}, "aperture of 20.955 x 0"),
        (usd_camera('token projection = "orthographic"'), {}, "perspective camera is needed"),
        (usd_camera(PLACED("scale", "float3", "(-1, 1, 1)")), {}, "without scale or mirroring"),
        (usd_camera(PLACED("scale", "float3", "(0, 1, 1)")), {}, "scales above 0"),
        (usd_camera(PLACED("translate", "double3", "(nan, 1, 1)")), {}, "finite numbers"),
        (usd_camera(PLACED("translate", "token", '"a"')), {}, "cannot be read as USD"),
        (usd_camera(PLACED("translate", "float", "3")), {}, "cannot be read as USD"),
        (usd_camera(PLACED("rotateX", "float3", "(1, 2, 3)")), {}, "cannot be read as USD"),
        (usd_camera(PLACED("nothing", "float3", "(1, 2, 3)")), {}, "cannot be read as USD"),
        (usd_camera(PLACED("orient", "float4", "(1, 0, 0, 0)")), {}, "orient is a Vec4f; it must"),
        (usd_camera(PLACED("transform", "matrix4d", UNEVEN)), {}, "a rotation, a translation"),
        (usd_camera('uniform token xformOpOrder = "a"'), {}, "xformOpOrder is a str; it must"),
        (usd_camera('string focalLength = "a"'), {}, "focalLength is a str; it must be a float"),
        (usd_camera("") + RENDERED("float resolution = 3"), SET, "cannot be read as USD"),
        (usd_camera("") + RENDERED('string pixelAspectRatio = "a"'), SET, "cannot be read as USD"),
        (usd_camera(""), {"up": "X"}, "up axis X; it must be Y or Z"),
        (usd_camera(""), {"meters": 0}, "0 metres per unit"),
        (usd_camera(""), {"head": "timeCodesPerSecond = 0"}, "timeCodesPerSecond is 0"),
        (usd_camera(""), {"head": "startTimeCode = 9\nendTimeCode = 1"}, "frames from 9 to 1"),
        (usd_camera(""), {"head": "startTimeCode = 0\nendTimeCode = 1e12"}, "must be 1 to 100000"),
        ("def Cam", {}, "cannot be read as USD"),
    ],
)
def test_broken_usd_ends_in_one_line(inside, settings, message, tmp_path):
    pytest.importorskip("pxr")
    with pytest.raises(InputError, match=message) as error:
        read_shot(usda(tmp_path / "a.usda", inside, **settings))
    assert "\n" not in str(error.value)


def test_several_cameras_of_usd_are_chosen_by_name_or_path(tmp_path):
    pytest.importorskip("pxr")
    inside = "".join(
        f'def Xform "{rig}"\n{{\n{usd_camera(f"float focalLength = {focal}", name)}}}\n'
        for rig, name, focal in (("L", "Wide", 20), ("R", "Wide", 30), ("R2", "Tele", 90))
    )
    path = usda(tmp_path / "a.usda", inside)
    focal = [read_shot(path, name).cameras[0].fx for name in ("/L/Wide", "/R/Wide", "Tele")]
    np.testing.assert_allclose(np.divide(focal, focal[0]), [1, 1.5, 4.5], rtol=1e-6)
    listed = r"has 3 cameras \(/L/Wide, /R/Wide, /R2/Tele\) and none is "
    for name, asked in ((None, "named"), ("Wide", "'Wide'"), ("Mid", "'Mid'")):
        with pytest.raises(ParameterError, match=listed + asked):
            read_shot(path, name)


def test_usd_without_its_library_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(RainsimError, match=r'usd-core is not installed; pip install "rainsim\[usd'):
        read_shot(usda(tmp_path / "a.usda", usd_camera("")))
