"""`rainsim export`, end to end on a tiny scene."""

import json
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from rainsim.commands.export import as_square_as
from rainsim.datasets import data_files as writing
from rainsim.io.images import read_image
from rainsim.render.shutter import moved
from rainsim.scene.cameras import read_cameras, resize_to, write_transforms
from rainsim.scene.colmap import read_model
from rainsim.scene.folder import write_scene
from rainsim.scene.library import load_scene
from rainsim.scene.types import Camera
from scenes import tiny_scene

MAP = ["--spacing", "0.04", "--extent", "1", "--relight", "off"]


@pytest.fixture
def export(rainsim, scene_folder):
    """Return a function that exports the tiny scene into the folder `out`."""
    return partial(rainsim, "export", scene_folder, *MAP, "--width", "64", "--out")


def files_in(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*")
            if p.is_file()}  # fmt: skip


def without_times(files):
    return {n: b for n, b in files.items() if n not in ("card.json", "pictures.jsonl")}


def test_pairs_of_clear_and_rainy_pictures(export, tmp_path):
    done = export("set", "--rain", "0,50", "--past-rain", "6", "--hold-out", "3")
    assert done.code == 0, done.err
    folder = tmp_path / "set"
    card = json.loads((folder / "card.json").read_text())
    assert card["complete"] and card["pictures"] == 6 and card["held_out"] == ["view_2"]
    assert "WARNING: 3 views: 2 in train, 0 in val, 1 in test; val holds no picture" in done.err
    meta = json.loads((folder / "clear/transforms.json").read_text())
    assert meta["train_filenames"] == ["images/view_0.png", "images/view_1.png"]
    assert (meta["val_filenames"], meta["test_filenames"]) == ([], ["images/view_2.png"])
    assert [rain["folder"] for rain in card["rains"]] == ["clear", "rain/50mm"]
    clear, rain = (read_image(folder / c / "images/view_0.png") for c in ("clear", "rain/50mm"))
    assert clear.shape == rain.shape == (48, 64, 3)
    assert np.abs(clear.astype(int) - rain).mean() > 3
    depths = [read_image(folder / c / "depths/view_0.png") for c in ("clear", "rain/50mm")]
    assert depths[0].dtype == np.uint16 and 800 < np.median(depths[0]) < 3000  # mm
    both = (depths[0] > 0) & (depths[1] > 0)
    assert np.abs(depths[0].astype(int) - depths[1])[both].max() <= 1
    keep = read_image(folder / "clear/masks/view_0.png")
    assert (keep == 255).all() and (read_image(folder / "rain/50mm/masks/view_0.png") == 0).any()
    for c in ("clear", "rain/50mm"):
        cameras = read_cameras(folder / c / "transforms.json")
        assert len(cameras) == 3
    puddles = read_image(folder / "rain/50mm/rainsim/puddle_id/view_0.png")
    about = json.loads((folder / "rain/50mm/rainsim/view_0.json").read_text())
    assert puddles.any() and {p["id"] for p in about["puddles"]} == set(np.unique(puddles)) - {0}
    assert about["weather"]["rain_mm_per_hour"] == pytest.approx(50)
    assert not read_image(folder / "clear/rainsim/puddle_id/view_0.png").any()
    text = (folder / "CARD.md").read_text()
    assert "| 50 | `rain/50mm` |" in text


def test_a_rig_goes_on_where_it_was_killed_too(rainsim, scene_folder, tmp_path):
    export = partial(rainsim, "export", scene_folder, *MAP, "--out")
    pair = "".join(f'[[camera]]\nname = "{n}"\nat = [0, {y}, 0]\nwidth = 48\nheight = 32\n'
                   f"fov = 60\n" for n, y in (("left", 0.05), ("right", -0.05)))  # fmt: skip
    lidar = '[[lidar]]\nname = "top"\nsensor = "vlp16"\nat = [0, 0, 0.1]\n'
    (tmp_path / "rig.toml").write_text(f"[vehicle]\nlevel = false\n{pair}{lidar}")
    words = "--rig", "rig.toml", "--rain", "25", "--layout", "kitti_object", "--views", "2"
    drive = "--drive", "--fps", "2"
    assert "must follow --drive or --path" in export("none", *words).err
    for own in ("--lidar", "hdl64"), ("--width", "32"):  # the file's sensors have their own
        said = export("none", *words, *drive, *own).err
        assert f"--rig is given with {own[0]}; the rig's file has the sensors" in said
    done = export("whole", *words, *drive)
    assert done.code == 0, done.err
    card = json.loads((tmp_path / "whole/card.json").read_text())
    assert (card["pictures"], card["turns"]) == (4, 2)
    files = files_in(tmp_path / "whole")
    for name in ("image_2/000001.png", "image_3/000001.png", "velodyne/000001.bin"):
        assert f"rain/25mm/training/{name}" in files
    journal = tmp_path / "whole/pictures.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:3]))
    (tmp_path / "whole/card.json").write_text(json.dumps({**card, "complete": False}))
    done = export("whole", *words, *drive, "--resume")
    assert done.code == 0 and "3 of 6" in done.err, done.err
    assert without_times(files_in(tmp_path / "whole")) == without_times(files)


def test_an_export_that_was_killed_goes_on(export, tmp_path):
    words = "--rain", "0,25", "--layout", "colmap", "--views", "view_0,view_2"
    assert export("whole", *words).code == 0
    shutil.copytree(tmp_path / "whole", tmp_path / "cut")
    folder = tmp_path / "cut"
    # As a kill leaves it: the last entry cut off, a temporary file, one picture damaged, no card.
    journal = folder / "pictures.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:3]) + lines[3][:40])
    card = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps({**card, "complete": False}))
    (folder / "clear/images/.view_2.png.abcdefgh.png").write_bytes(b"x")
    (folder / "clear/images/view_0.png").write_bytes(b"damaged")
    done = export("cut", *words, "--resume")
    assert done.code == 0 and "2 of 4 pictures are finished and kept" in done.err, done.err
    one, other = (without_times(files_in(tmp_path / n)) for n in ("whole", "cut"))
    assert one == other
    cameras, _ = read_model(folder / "rain/25mm")
    assert [c.name for c in cameras] == ["view_0", "view_2"]


def test_a_sample_that_cannot_be_written_is_the_error_and_the_others_stay(
    export, tmp_path, monkeypatch
):
    words = "--rain", "25", "--layout", "colmap"
    assert export("whole", *words).code == 0
    whole = writing.write_file

    def full(folder, file):
        if "view_1.png" in file.name and folder.name == "cut":
            raise OSError(28, "No space left on device", file.name)
        return whole(folder, file)

    monkeypatch.setattr(writing, "write_file", full)
    done = export("cut", *words)
    assert done.code == 1 and "view_1.png" in done.error
    lines = (tmp_path / "cut/pictures.jsonl").read_text().splitlines()
    noted = [json.loads(line) for line in lines]
    assert "view_1" not in {n["view"] for n in noted} and "view_0" in {n["view"] for n in noted}
    monkeypatch.setattr(writing, "write_file", whole)
    assert export("cut", *words, "--resume").code == 0
    one, other = (without_times(files_in(tmp_path / n)) for n in ("whole", "cut"))
    assert one == other


def test_folders_of_others_are_left_alone(export, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("keep")
    words = "--rain", "25", "--views", "view_1"
    for option in ((), ("--overwrite",), ("--resume",)):
        done = export("mine", *words, *option)
        assert (done.code == 2 and "holds notes.txt" in done.err) or "not empty" in done.err
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["notes.txt"]
    assert export("set", *words).code == 0
    (tmp_path / "set/notes.txt").write_text("keep")
    done = export("set", "--rain", "10", "--views", "view_1", "--resume")
    assert done.code == 2 and "was another" in done.error
    done = export("set", "--rain", "10", "--views", "view_1", "--overwrite")
    assert done.code == 0, done.err
    left = files_in(tmp_path / "set")
    assert left["notes.txt"] == b"keep" and not any("25mm" in name for name in left)


def test_a_number_of_views_is_no_name(rainsim, tmp_path):
    """Cameras of captures are often numbered; a comma makes a number a name."""
    scene = tiny_scene()
    numbered = [replace(camera, name=str(n)) for n, camera in enumerate(scene.cameras)]
    write_scene(tmp_path / "numbered", replace(scene, cameras=tuple(numbered)))
    words = "export", tmp_path / "numbered", *MAP, "--width", "64", "--rain", "0", "--views"
    for views, names in (("2", ["0.png", "2.png"]), ("2,", ["2.png"])):
        folder = tmp_path / f"set {views}"
        done = rainsim(*words, views, "--out", folder)
        assert done.code == 0, done.err
        assert sorted(p.name for p in (folder / "clear/images").iterdir()) == names


@pytest.fixture
def path_file(scene_folder, tmp_path):
    """A camera path of three places close to each other."""
    scene = load_scene(scene_folder)
    frame = scene.ground_frame
    first = frame.camera_in_ground(scene.cameras[0])
    path = [moved(first, k * np.array([0.03, -0.02, 0]), np.array([0, 0.01 * k, 0]))
            for k in range(3)]  # fmt: skip
    write_transforms(tmp_path / "path.json", [frame.camera_in_capture(c) for c in path],
                     [f"p{k}.png" for k in range(3)])  # fmt: skip
    return tmp_path / "path.json"


def test_a_sequence_has_flow(export, path_file, tmp_path):
    done = export("drive", "--layout", "kitti", "--rain", "10", "--path", path_file)
    assert done.code == 0, done.err
    training = tmp_path / "drive/rain/10mm/training"
    names = sorted(p.name for p in (training / "image_2").iterdir())
    assert names == ["000000_10.png", "000000_11.png", "000001_10.png", "000001_11.png",
                     "000002_10.png"]  # fmt: skip
    same = (training / "image_2/000000_11.png").read_bytes()
    assert same == (training / "image_2/000001_10.png").read_bytes()
    imagecodecs = pytest.importorskip("imagecodecs")
    flow = imagecodecs.png_decode((training / "flow_noc/000000_10.png").read_bytes())
    valid = flow[..., 2] == 1
    assert valid.mean() > 0.4
    moves = np.linalg.norm((flow[valid][:, :2].astype(float) - 2**15) / 64, axis=1)
    assert 0.3 < np.median(moves) < 20
    assert len((training / "poses.txt").read_text().splitlines()) == 3


def test_a_drive_says_how_fast_it_is_and_goes_as_fast_as_it_is_told(export, tmp_path):
    words = "--layout", "nerfstudio", "--rain", "0", "--drive"
    done = export("fast", *words)
    assert done.code == 2 and not (tmp_path / "fast").exists()
    assert "km/h at --fps 24" in done.error and "at most 130, as cars drive" in done.error
    done = export("slow", *words, "--fps", "2")
    assert done.code == 0 and "drive: 3 views along 3.133 m at 2/s: 11.3 km/h" in done.err
    done = export("told", *words, "--fps", "5", "--drive-speed", "9", "--views", "5")
    assert done.code == 0, done.err
    assert "drive: 5 views along 1.935 m at 5/s: 8.71 km/h" in done.err  # across the bend
    assert "  5 views: 3 in train, 1 in val, 1 in test" in done.err
    cameras = read_cameras(tmp_path / "told/clear/transforms.json")
    place = np.array([camera.position for camera in cameras])
    first = read_cameras(tmp_path / "slow/clear/transforms.json")[0]
    np.testing.assert_allclose(place[0], first.position, atol=1e-6)
    # Even steps of 0.5 m along the path; the third lies across its bend and is shorter.
    np.testing.assert_allclose(np.linalg.norm(np.diff(place[:3], axis=0), axis=1), 0.5, atol=1e-6)
    done = export("long", *words, "--fps", "5", "--drive-speed", "9", "--views", "9")
    assert done.code == 2 and "has room for 7, and must for 9" in done.error


@pytest.mark.slow
def test_rolling_shutters_and_wet_glass(export, path_file, tmp_path):
    words = "--layout", "kitti", "--rain", "0,25", "--path", path_file
    done = export("out", *words, "--rolling", "20", "--glass", "10,15")
    assert done.code == 0, done.err
    folder = tmp_path / "out"
    names = {p.name for p in (folder / "rain/25mm/rainsim/glass").iterdir()}
    assert len(names) == 3 and not (folder / "clear/rainsim/glass").exists()
    share = read_image(folder / "rain/25mm/rainsim/glass" / sorted(names)[0]) / 65535
    keep = read_image(folder / "rain/25mm/rainsim/keep" / sorted(names)[0]) == 255
    assert share.max() > 0.3 and not keep[share > 0.1].any()
    name = sorted(names)[0].removesuffix(".png")
    about = json.loads((folder / f"rain/25mm/rainsim/{name}.json").read_text())
    assert about["drops_on_glass"] > 10
    assert not (folder / "rain/25mm/training/flow_occ").exists()


@pytest.mark.slow
def test_wet_glass_behind_a_lens_and_a_wiper(export, path_file, tmp_path):
    """Drops gather from view to view and the lens distorts them; a wiper takes them away."""
    words = "--rain", "25", "--path", path_file, "--fps", "1", "--lens", "opencv:-0.2,0.05,0,0"
    assert export("out", *words, "--glass", "4,15").code == 0
    # The strokes are 4.5 s apart: the middle view, 5 s after the rain began, is just wiped.
    assert export("wiped", *words, "--glass", "4,15", "--wiper", "4.5").code == 0

    def counts(folder):
        found = sorted((tmp_path / folder / "rain/25mm/rainsim").glob("*.json"))
        return [json.loads(path.read_text())["drops_on_glass"] for path in found]

    dirty, wiped = counts("out"), counts("wiped")
    assert dirty[0] == wiped[0] and dirty[1] > wiped[1] and wiped[1] < wiped[0]
    last = max((tmp_path / "out/rain/25mm/rainsim/glass").iterdir())
    glass = read_image(last) / 65535
    keep = read_image(last.parent.parent / "keep" / last.name) == 255
    assert glass.shape == keep.shape and glass.max() > 0.3 and not keep[glass > 0.1].any()


@pytest.mark.parametrize(
    "words, message",
    [
        (("--rain", "a"), "--rain is 'a'; it must be"),
        (("--rain", "2000"), "rates from 0 to 1000 mm/h"),
        (("--views", "nobody"), "has no camera 'nobody'"),
        (("--views", "2,"), "has no camera '2'"),
        (("--views", "02"), "has no camera '02'"),
        (("--lens", "opencv:1"), "must be 4 or 5 finite numbers"),
        (("--path", "x.json", "--views", "2"), "sequence of its own"),
        (("--views", "view_1,view_1"), "--views names view_1 twice"),
        (("--hold-out", "4"), "--hold-out is 4 and holds out none of 3 views; it must be from 2"),
        (("--hold-out", "1"), "holds out all of 3 views; it must be from 2 to 3, or 0 for none"),
        (("--drive-speed", "40"), "--drive-speed is given without --drive"),
        (("--drive", "--drive-speed", "nan"), "--drive-speed is nan km/h; it must be from 1 to"),
        (("--labels", "none.npy"), "none.npy does not exist; a file of labels"),
        (("--rolling", "500"), "at most 200 ms"),
        (("--glass", "10,500"), "0 to 100 m/s"),
        (("--wiper", "2"), "--wiper is given without --glass"),
        (("--glass", "1,1", "--wiper", "-1"), "glass wiper is -1"),
    ],
)
def test_wrong_options_are_named(export, words, message, tmp_path):
    done = export("out", *words)
    assert done.code in (1, 2) and message in done.error
    assert not (tmp_path / "out").exists()


def test_partners_tell_effects_apart(export, tmp_path):
    """Without what falls only drops are missing, without drops on the glass only those."""
    words = "--rain", "0,50", "--views", "view_0", "--glass", "10,15", "--partners"
    done = export("set", *words, "--layout", "colmap", "--past-rain", "6")
    assert done.code == 0, done.err
    folder = tmp_path / "set/rain/50mm"
    about = json.loads((folder / "rainsim/view_0.json").read_text())
    assert set(about["partners"]) == {"clear_air", "no_glass", "dry"}
    card = json.loads((tmp_path / "set/card.json").read_text())
    assert set(card["partners"]) == set(about["partners"])
    assert "- `no_glass`: without drops on" in (tmp_path / "set/CARD.md").read_text()
    still, bare, dry = (read_image(folder / "rainsim" / about["partners"][k]).astype(int)
                        for k in ("clear_air", "no_glass", "dry"))  # fmt: skip
    rainy = read_image(folder / "images/view_0.png").astype(int)
    glass = read_image(folder / "rainsim/glass/view_0.png") > 0
    np.testing.assert_array_equal(rainy[~glass], bare[~glass])
    assert glass.any() and np.abs(rainy - bare)[glass].mean() > 3
    falls = np.abs(rainy - still)[~glass]
    assert 0 < falls.mean() < 3 and falls.max() < 120
    np.testing.assert_array_equal(dry, read_image(tmp_path / "set/clear/images/view_0.png"))
    assert np.abs(dry - still).mean() > np.abs(rainy - still)[~glass].mean()
    assert not (tmp_path / "set/clear/rainsim/clear_air").exists()


def test_pixels_keep_their_shape():
    """A height that is rounded to whole pixels squeezes none; the middle stays in the middle."""
    camera = Camera(5187, 3361, 3000.0, 3000.0, 2593.5, 1680.5, np.eye(4))
    for size in ((648, None), (648, 360), (None, 333)):
        sized = resize_to(camera, *size)
        square = as_square_as(sized, camera)
        assert square.fx == sized.fx == pytest.approx(square.fy, rel=1e-8)
        assert square.height == sized.height
        assert square.cy == pytest.approx(sized.height / 2)
        assert abs(square.fy / sized.fy - 1) < 2e-3
    oblong = Camera(100, 90, 50.0, 55.0, 40.0, 50.0, np.eye(4))
    assert as_square_as(oblong, oblong) == oblong


def test_clouds_belong_to_two_layouts(export, tmp_path):
    done = export("out", "--lidar", "vlp16")
    assert done.code == 2 and "--lidar is of --layout kitti_object" in done.error
    assert not (tmp_path / "out").exists()
    done = export("out", "--layout", "kitti_object", "--lidar", "vlp16", "--rain", "25",
                  "--views", "view_0")  # fmt: skip
    assert done.code == 0, done.err
    training = tmp_path / "out/rain/25mm/training"
    points = np.fromfile(training / "velodyne/000000.bin", "<f4").reshape(-1, 4)
    assert len(points) * 4 == (training / "labels/000000.label").stat().st_size > 4000
    assert (training / "label_2/000000.txt").read_text() == ""
    done = export("drive", "--layout", "semantic_kitti", "--lidar", "vlp16", "--rain", "0,25",
                  "--views", "view_0", "--drive", "--fps", "4")  # fmt: skip
    assert done.code == 0, done.err
    for place in ("clear", "rain/25mm"):
        root = tmp_path / f"drive/{place}/sequences/00"
        points = np.fromfile(root / "velodyne/000000.bin", "<f4").reshape(-1, 4)
        assert len(points) * 4 == (root / "labels/000000.label").stat().st_size > 4000
        assert (root / "times.txt").read_text() == "0.000000e+00\n"
