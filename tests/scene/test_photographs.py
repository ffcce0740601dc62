"""Photographs beside a capture: scale and sun of their EXIF, how true the capture is, bad ones."""

import json
import math
import os
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from PIL import Image

from made_captures import patio, ring, splats_at
from made_formats import write_splats
from rainsim.daylight.kept_light import sun_by_clock
from rainsim.errors import InputError, ParameterError
from rainsim.scene import photographs
from rainsim.scene.cameras import look_at, read_cameras, write_transforms
from rainsim.scene.folder import read_scene, write_scene
from rainsim.scene.ground import ground_axes
from rainsim.scene.library import load_scene
from rainsim.scene.photographs import fidelity_notes, lay_over, sun_position, with_photographs
from rainsim.scene.types import GroundFrame, Scene

SCALE, TURN = 2.5, math.radians(40)  # m per unit; of x of the ground frame from east to north
PLACE, TIME = (55.69, 13.19), datetime(2014, 6, 7, 10, 24)  # in Lund, the sun at 162.3, 56.2
UP, AHEAD = np.array([0.0, -1, 0]), np.array([1.0, 0, 0])  # of the capture
FRAME = GroundFrame(
    np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), 1.0, np.zeros(3), scale_assumed=True,
    notes=("up is y", "SCALE IS ASSUMED: so"),
)  # fmt: skip


def walk(count=24):
    """Cameras of a bent walk of 150 m, in the capture frame, 1.6 units over the ground."""
    along = np.linspace(0, 60, count)
    eyes = np.stack([along, np.full(count, -1.6), 0.1 * along + 8 * np.sin(along / 15)], -1)
    return tuple(
        look_at(eye, eye + AHEAD, UP, 60, 24, 16, name=f"{k:02}") for k, eye in enumerate(eyes)
    )


def places(cameras, seed=1, error=4.0):
    """Fixes (latitude, longitude) of cameras, each off by some metres."""
    east_north = np.array([c.position[0] + 1j * c.position[2] for c in cameras])
    noise = np.random.default_rng(seed).normal(0, error, (2, len(cameras)))
    east_north = SCALE * east_north * np.exp(1j * TURN) + noise[0] + 1j * noise[1]
    degree = 111_200.0
    east = east_north.real / degree / math.cos(math.radians(PLACE[0]))
    return np.stack([PLACE[0] + east_north.imag / degree, PLACE[1] + east], -1)


def sixtieths(value):
    value = abs(value)
    minutes = value % 1 * 60
    return float(int(value)), float(int(minutes)), minutes % 1 * 60


def photograph(file, place=None, gps_time=TIME, clock=None, zone=None, size=(24, 16), color=90):
    """Write a small picture whose EXIF has what is given."""
    exif = Image.Exif()
    gps, own = {}, {}
    if place is not None:
        gps |= {1: "S" if place[0] < 0 else "N", 2: sixtieths(place[0])}
        gps |= {3: "W" if place[1] < 0 else "E", 4: sixtieths(place[1])}
    if gps_time is not None:
        gps |= {29: gps_time.strftime("%Y:%m:%d"), 7: (gps_time.hour, gps_time.minute, 0.0)}
    if clock is not None:
        own[0x9003] = clock
    if zone is not None:
        own[0x9011] = zone
    exif.get_ifd(0x8825).update(gps)
    exif.get_ifd(0x8769).update(own)
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (color,) * 3).save(file, exif=exif)


def scene_of(cameras, frame=FRAME):
    return Scene("walk", None, cameras, frame)


def photographed(folder, cameras, fixes=None, **more):
    """Write photographs of cameras into a folder; return the scene with what they tell."""
    fixes = places(cameras) if fixes is None else fixes
    for camera, place in zip(cameras, fixes, strict=True):
        photograph(folder / f"{camera.name}.jpg", place, **more)
    return with_photographs(scene_of(cameras), folder, photos=folder)


def off_by(scene):
    """Degrees between the captured sun of a scene and the true one."""
    azimuth, elevation = sun_position(*PLACE, TIME)
    turn = math.pi / 2 - azimuth - TURN
    true = np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)
    cosine = scene.ground_frame.rotation @ scene.captured_sun @ true
    return math.degrees(math.acos(min(1.0, cosine)))


# --- scale and sun --------------------------------------------------------------------------------


def test_gps_gives_metres_and_the_sun(tmp_path):
    scene = photographed(tmp_path, walk())
    frame = scene.ground_frame
    assert frame.meters_per_unit == pytest.approx(SCALE, rel=0.04) and not frame.scale_assumed
    assert frame.notes[0] == "up is y" and len(frame.notes) == 2
    assert frame.notes[1].startswith("scale by GPS of the photographs: 2.")
    assert "(16 to 84 %)" in frame.notes[1]
    assert off_by(scene) < 3
    azimuth, elevation = map(math.degrees, sun_by_clock(scene))
    (note,) = scene.notes
    assert f"--captured-sun={azimuth:.0f},{elevation:.0f}" in note and elevation == pytest.approx(
        56.2, abs=0.2
    )


def test_one_misplaced_camera_and_one_wrong_fix_change_nothing(tmp_path):
    cameras = walk()
    fixes = places(cameras)
    right = photographed(tmp_path / "right", cameras, fixes)
    lost = cameras[7]
    moved = lost.camera_from_world.copy()
    moved[:3, 3] += 300
    fixes[15] += 0.4  # 40 km away
    cameras = (*cameras[:7], lost.posed(moved), *cameras[8:])
    wrong = photographed(tmp_path / "wrong", cameras, fixes)
    scales = [scene.ground_frame.meters_per_unit for scene in (wrong, right)]
    assert scales[0] == pytest.approx(scales[1], rel=0.02) and off_by(wrong) < 3
    assert "2 left out" in wrong.ground_frame.notes[-1]


def test_fixes_that_follow_no_path_are_not_used(tmp_path):
    cameras = walk()
    fixes = places(cameras)[np.random.default_rng(3).permutation(len(cameras))]
    scene = photographed(tmp_path, cameras, fixes)
    assert scene.ground_frame == FRAME and scene.captured_sun is None
    assert "do not lie as the cameras do" in scene.notes[0]


@pytest.mark.parametrize(
    "share", [0.02, 0.2], ids=["all at one place", "within the error of a fix"]
)
def test_a_short_path_has_no_scale_and_no_north(tmp_path, share):
    cameras = walk()
    fixes = places(cameras, error=1.0)
    scene = photographed(tmp_path, cameras, fixes.mean(0) + share * (fixes - fixes.mean(0)))
    assert scene.ground_frame == FRAME and scene.captured_sun is None
    assert "does not give the scale" in scene.notes[0] and "8 m off" in scene.notes[0]
    assert "--captured-sun=AZIMUTH,56" in scene.notes[1]  # its elevation is offered


def test_a_scale_that_is_known_stays(tmp_path):
    cameras = walk()
    photographed(tmp_path, cameras)
    known = replace(FRAME, scale_assumed=False)
    for frame, keep in ((known, False), (FRAME, True)):
        scene = with_photographs(scene_of(cameras, frame), tmp_path, photos=tmp_path,
                                 keep_scale=keep)  # fmt: skip
        assert scene.ground_frame == frame and off_by(scene) < 3


@pytest.mark.parametrize("south_west", [(-1, 1), (1, -1)])
def test_all_quarters_of_the_earth(south_west, monkeypatch, tmp_path):
    monkeypatch.setattr("test_photographs.PLACE", tuple(np.multiply(PLACE, south_west)))
    scene = photographed(tmp_path, walk())
    assert scene.ground_frame.meters_per_unit == pytest.approx(SCALE, rel=0.04)


def test_across_the_date_line(monkeypatch, tmp_path):
    monkeypatch.setattr("test_photographs.PLACE", (-16.8, 180.0))
    cameras = walk()
    fixes = places(cameras)
    fixes[:, 1] = (fixes[:, 1] + 180) % 360 - 180
    scene = photographed(tmp_path, cameras, fixes)
    assert scene.ground_frame.meters_per_unit == pytest.approx(SCALE, rel=0.04)


# --- time -----------------------------------------------------------------------------------------


def test_a_clock_with_its_zone_is_as_good_as_gps_time(tmp_path):
    scene = photographed(tmp_path, walk(), gps_time=None, clock="2014:06:07 12:24:00",
                         zone="+02:00")  # fmt: skip
    assert off_by(scene) < 3


def test_a_clock_without_a_zone_is_offered_and_not_taken(tmp_path):
    scene = photographed(tmp_path, walk(), gps_time=None, clock="2014:06:07 12:24:00")
    assert scene.captured_sun is None
    (note,) = scene.notes
    summer = note.rpartition("--captured-sun=")[2].split(",")
    azimuth = math.degrees(math.pi / 2 - sun_position(*PLACE, TIME)[0] - TURN)
    assert "no zone" in note and abs(float(summer[0]) - azimuth) < 3 and summer[1] == "56"


@pytest.mark.parametrize(
    "more, said",
    [
        ({"gps_time": datetime(2014, 6, 7, 23, 30)}, "down"),
        ({"gps_time": datetime(1970, 1, 1)}, "make no sense"),
        ({"gps_time": None}, None),
        ({"gps_time": None, "clock": "0000:00:00 00:00:00", "zone": "+02:00"}, "make no sense"),
        ({"gps_time": None, "clock": "yesterday", "zone": "Z"}, "make no sense"),
        ({"gps_time": None, "clock": "2014:06:07 12:24:00", "zone": "noon"}, "make no sense"),
    ],
)
def test_times_that_tell_no_sun(tmp_path, more, said):
    scene = photographed(tmp_path, walk(), **more)
    assert scene.captured_sun is None and not scene.ground_frame.scale_assumed
    assert (said is None and not scene.notes) or said in " ".join(scene.notes)


def test_photographs_of_a_whole_day_have_no_one_sun(tmp_path):
    cameras = walk()
    photographed(tmp_path, cameras)
    for k, (camera, place) in enumerate(zip(cameras, places(cameras), strict=True)):
        photograph(tmp_path / f"{camera.name}.jpg", place, TIME.replace(hour=6 + k // 3))
    scene = with_photographs(scene_of(cameras), tmp_path, photos=tmp_path)
    assert scene.captured_sun is None and "no one sun" in scene.notes[-1]


# National Renewable Energy Laboratory, SPA (2003), table A5.1; Meeus (1998), example 25.a: the
# declination of the sun is its elevation over the pole; the same example gives its ascension and
# 12.a sidereal time of another day, from which follows where it is noon.
def test_the_sun_stands_where_published_values_have_it():
    azimuth, elevation = sun_position(39.742476, -105.1786, datetime(2003, 10, 17, 19, 30, 30))
    assert math.degrees(azimuth) == pytest.approx(194.34024, abs=0.03)
    assert 90 - math.degrees(elevation) == pytest.approx(50.11162 + 0.016, abs=0.03)  # refraction
    for pole in (90, -90):
        _, elevation = sun_position(pole, 0, datetime(1992, 10, 13))
        assert math.degrees(elevation) == pytest.approx(math.copysign(7.78507, -pole), abs=0.02)
    noon = 198.38083 - 21.758  # ascension less sidereal time at Greenwich [degrees]
    azimuth, elevation = sun_position(40, noon, datetime(1992, 10, 13))
    assert math.degrees(azimuth) == pytest.approx(180, abs=0.1)
    assert math.degrees(elevation) == pytest.approx(50 - 7.785, abs=0.03)


# --- where they lie -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A trained model's folder, without photographs."""
    folder = tmp_path_factory.mktemp("capture")
    inner = folder / "point_cloud/iteration_7000"
    inner.mkdir(parents=True)
    write_splats(inner / "point_cloud.ply", splats_at(patio(3000)))
    write_transforms(folder / "cameras.json", ring())
    return folder


def put(folder, names=None):
    for camera in ring():
        photograph(folder / f"{camera.name}.JPG", (0.0, 0.0) if names is None else names)


@pytest.mark.parametrize("layout", ["images", "input", "images/left", "file_path", "cfg", "photos"])
def test_where_photographs_are_found(capture, tmp_path, layout):
    (model := tmp_path / "model").symlink_to(capture)
    made, given = tmp_path / "elsewhere", {}
    if layout == "cfg":
        folder = made / "pictures"
        text = f"Namespace(sh_degree=3, source_path='{made}', images='pictures', eval=False)"
        (capture / "cfg_args").write_text(text)
    elif layout == "file_path":
        folder, data = made / "a", json.loads((capture / "cameras.json").read_text())
        for frame in data["frames"]:
            frame["file_path"] = f"a/{frame['name']}.JPG"
        (made / "a").mkdir(parents=True)
        (made / "transforms.json").write_text(json.dumps(data))
        given = {"cameras": made / "transforms.json"}
    elif layout == "photos":
        folder, given = made / "b", {"photos": made / "b"}
    else:
        folder = capture / layout
    assert not load_scene(model, cameras=given.get("cameras")).photographs
    put(folder)
    try:
        scene = load_scene(model, **given)
        names = [camera.name for camera in scene.cameras]
        assert [file.stem for file in scene.photographs] == names
        assert scene.ground_frame.scale_assumed and scene.captured_sun is None
        assert scene.notes == (f"of {len(names)} photographs file, place or time make no sense: "
                               "left aside",)  # fmt: skip
    finally:
        (capture / "cfg_args").unlink(missing_ok=True)
        for file in (*capture.glob("i*/*.JPG"), *capture.glob("i*/*/*.JPG")):
            file.unlink()


def test_photos_that_were_named_must_be_there(capture, tmp_path):
    photograph(tmp_path / "other.jpg")
    for folder in (tmp_path, tmp_path / "nowhere", tmp_path / "other.jpg"):
        with pytest.raises(InputError, match=r"no photograph .* named as a camera"):
            load_scene(capture, photos=folder)
    with pytest.raises(ParameterError, match="built in"):
        load_scene("bicycle", photos=tmp_path)


def test_scale_and_sun_go_into_a_scene_folder_and_nothing_else(tmp_path):
    scene = replace(photographed(tmp_path / "p", walk()), splats=splats_at(np.zeros((5, 3)), 4))
    write_scene(tmp_path / "scene", scene)
    text = (tmp_path / "scene/scene.json").read_text()
    assert not any(word in text for word in ("2014", "10:24", "55.6", "13.19", ".jpg", "photos"))
    again = read_scene(tmp_path / "scene")
    assert again.captured_sun == pytest.approx(scene.captured_sun, abs=1e-12)
    assert again.ground_frame.meters_per_unit == scene.ground_frame.meters_per_unit


# --- bad ones -------------------------------------------------------------------------------------


def bad_files(folder):
    """Write files that are named as photographs; return their names."""
    os.mkfifo(folder / "00.jpg")
    (folder / "01.jpg").symlink_to("/dev/zero")
    (folder / "02.jpg").symlink_to(folder / "00.jpg")
    (folder / "03.jpg").mkdir()
    (folder / "04.jpg").write_bytes(b"no picture at all")
    (folder / "05.jpg").write_bytes(b"")
    (folder / "06.jpg").symlink_to(folder / "06.jpg")
    header = Image.new("L", (1, 1))
    header.save(folder / "07.png")
    data = bytearray((folder / "07.png").read_bytes())
    data[16:24] = (60_000).to_bytes(4, "big") * 2  # pixels that the file claims
    (folder / "07.png").write_bytes(data)
    photograph(folder / "08.jpg", places(walk())[8])
    cut = bytearray((folder / "08.jpg").read_bytes())
    for at in range(40, 200, 3):  # directories of EXIF that point anywhere
        cut[at] ^= 0xFF
    (folder / "08.jpg").write_bytes(cut)
    photograph(folder / "09.jpg", (95.0, 200.0))
    photograph(folder / "10.jpg", (0.0, 0.0))


def test_bad_photographs_are_counted_and_left_aside(tmp_path):
    cameras = walk()
    for camera, place in list(zip(cameras, places(cameras), strict=True))[11:]:
        photograph(tmp_path / f"{camera.name}.jpg", place)
    bad_files(tmp_path)
    scene = with_photographs(scene_of(cameras), tmp_path, photos=tmp_path)
    assert scene.notes[0].startswith(("of 10 photographs", "of 11 photographs"))
    assert scene.ground_frame.meters_per_unit == pytest.approx(SCALE, rel=0.05)


def test_nothing_but_bad_photographs(tmp_path):
    bad_files(tmp_path)
    cameras = walk()
    scene = with_photographs(scene_of(cameras), tmp_path, photos=tmp_path)
    assert scene.ground_frame == FRAME and scene.captured_sun is None
    assert fidelity_notes(scene, lambda camera: np.zeros((camera.height, camera.width, 3))) == []


def test_paths_of_no_length_and_scales_of_no_capture():
    fixes = 100 * np.exp(1j * np.arange(12.0))
    assert lay_over(np.zeros(12, complex), fixes)[0] is None
    assert lay_over(fixes / 3, fixes)[0].factor == pytest.approx(3)
    cameras = walk()
    laid = photographs.Laid(complex(1e9), np.array([1e9, 1e9]), 100.0, 0)
    frame, notes = photographs._scaled(FRAME, cameras, laid, "")
    assert frame is FRAME and "no capture has such a scale" in notes[0]


# --- how true -------------------------------------------------------------------------------------


def test_a_capture_far_from_its_photographs_is_told_once(tmp_path):
    cameras, rng = walk(8), np.random.default_rng(0)
    shown = {c.name: np.kron(rng.random((4, 6, 3)), np.ones((4, 4, 1))) for c in cameras}
    for name, picture in shown.items():
        darker = (0.6 * 255 * picture**1.0).astype(np.uint8)
        Image.fromarray(darker).save(tmp_path / f"{name}.png")
    scene = with_photographs(scene_of(cameras), tmp_path, photos=tmp_path)
    drawn = []

    def true(camera):
        drawn.append(camera.name)
        return shown[camera.name]

    assert fidelity_notes(scene, true) == [] and len(drawn) == 5  # another exposure is no fault
    (note,) = fidelity_notes(scene, lambda camera: shown[camera.name][::-1])
    assert "dB from the photographs" in note
    bent = replace(scene, notes=("lens distortion of the cameras (OPENCV) is ignored",))
    assert fidelity_notes(bent, lambda camera: shown[camera.name][::-1]) == []
    for file in scene.photographs:  # of another shape: not undistorted
        Image.new("RGB", (24, 17)).save(file)
    assert fidelity_notes(scene, lambda camera: shown[camera.name][::-1]) == []


# --- a real walk ----------------------------------------------------------------------------------


def test_a_real_walk_by_phone(shared):
    folder = shared("data/real/lund")
    cameras = read_cameras(folder / "transforms.json")
    up = np.array([-0.519, 0.045, -0.854])
    axes = ground_axes(up / np.linalg.norm(up), cameras)
    frame = replace(FRAME, rotation=axes, meters_per_unit=12.0)
    scene = with_photographs(scene_of(tuple(cameras), frame), folder, photos=folder / "images")
    assert 0.94 < scene.ground_frame.meters_per_unit / 16.3 < 1.06
    azimuth, elevation = map(math.degrees, sun_by_clock(scene))
    assert azimuth == pytest.approx(177, abs=3) and elevation == pytest.approx(56, abs=0.5)
