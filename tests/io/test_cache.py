"""Kept results: equal to fresh ones to the byte, and never taken for other inputs."""

import dataclasses
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from made_captures import patio, ring, splats_at
from made_formats import write_splats
from rainsim import jit, pipeline
from rainsim.config.settings import Config
from rainsim.io import cache
from rainsim.scene import library
from rainsim.scene.cameras import write_transforms
from rainsim.scene.folder import import_scene
from rainsim.scene.library import load_scene
from rainsim.terrain import kept_terrain
from scenes import tiny_scene

CONFIG = Config.from_preset("moderate").replace(spacing=0.04, extent=1.0, width=48, frames=2)


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """The folder of kept results of a test's own."""
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path / "kept"))
    return tmp_path / "kept"


def same(a, b):
    """Assert that two results are equal to the byte, and of the same types."""
    assert type(a) is type(b)
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    elif isinstance(a, tuple | list):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            same(one, other)
    else:
        assert a == b


# --- entries --------------------------------------------------------------------------------------


def test_an_entry_comes_back_to_the_byte(folder, rng):
    arrays = {
        "floats": rng.normal(size=(37, 3)).astype(np.float32), "none": np.zeros((0, 3)),
        "flags": rng.random(11) > 0.5, "turned": np.arange(12, dtype=np.int64).reshape(3, 4).T,
        "odd": np.array([np.nan, -0.0, np.inf]),
    }  # fmt: skip
    facts = {"notes": ["a", "ü"], "number": 0.1 + 0.2, "nothing": None}
    assert cache.read("test", "name") is None
    cache.write("test", "name", facts, arrays)
    found, back = cache.read("test", "name")
    assert found == facts and list(back) == list(arrays)
    for name, array in arrays.items():
        same(back[name], np.ascontiguousarray(array))
        assert back[name].flags.writeable
    assert cache.read("test", "other") is None and cache.read("other", "name") is None
    assert [path.name for path in folder.iterdir()] == ["test-name.kept"]


def test_a_flipped_bit_anywhere_gives_the_same_or_nothing(folder):
    arrays = {"one": np.arange(9.0), "two": np.zeros((2, 3), np.float32)}
    cache.write("test", "name", {"a": [1, "x"]}, arrays)
    path = folder / "test-name.kept"
    content, dropped = path.read_bytes(), 0
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 0x81
        path.write_bytes(damaged)
        found = cache.read("test", "name")
        dropped += found is None
        assert found is None or found[0] == {"a": [1, "x"]}
        for name, array in arrays.items() if found else ():
            same(found[1][name], array)
    assert dropped > len(content) / 3


@pytest.mark.parametrize(
    "flipped, length", [*((k, None) for k in (0, 200, 700, -5)),
                        *((None, n) for n in (0, 5, 60, 300, -1))],
)  # fmt: skip
def test_a_damaged_entry_counts_as_none_and_is_removed(folder, flipped, length):
    cache.write("test", "name", {"one": 1}, {"array": np.arange(100.0)})
    path = folder / "test-name.kept"
    content = bytearray(path.read_bytes())
    if flipped is not None:
        content[flipped] ^= 1
    path.write_bytes(content[:length])
    assert cache.read("test", "name") is None and not path.exists()


def test_a_folder_that_cannot_be_written_is_no_error(monkeypatch, tmp_path):
    file = tmp_path / "file"
    file.write_text("in the way")
    monkeypatch.setenv("RAINSIM_CACHE", str(file / "kept"))
    cache.write("test", "name", {}, {"array": np.zeros(3)})
    assert cache.read("test", "name") is None
    assert cache.summary()["entries"] == 0 and not cache.summary()["writable"]


def test_a_full_disk_is_no_error_and_leaves_nothing(folder, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    cache.write("test", "name", {}, {"array": np.zeros(3)})
    assert list(folder.iterdir()) == []


def test_keeping_can_be_turned_off(monkeypatch, tmp_path):
    monkeypatch.setenv("RAINSIM_CACHE", "off")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache.write("test", "name", {}, {"array": np.zeros(3)})
    assert cache.folder() is None and cache.read("test", "name") is None
    assert list(tmp_path.iterdir()) == [] and cache.summary()["folder"] is None
    monkeypatch.delenv("RAINSIM_CACHE")
    assert cache.folder() == tmp_path / "rainsim" / "results"


def write_aged(folder, *entries):
    """Write small entries, each an age [s], a kind and a name."""
    now = time.time()
    for age, kind, name in entries:
        cache.write(kind, name, {}, {"array": np.zeros(3)})
        os.utime(folder / f"{kind}-{name}.kept", (now - age, now - age))


def test_what_was_not_used_for_the_longest_time_is_deleted(folder, monkeypatch):
    write_aged(folder, (30, "test", "old"), (20, "test", "used"), (10, "test", "new"))
    monkeypatch.setattr(cache, "MOST_BYTES", cache.summary()["size"])
    assert cache.read("test", "old") is not None  # used now
    cache.write("test", "newest", {}, {"array": np.zeros(3)})
    assert {p.name for p in folder.iterdir()} == {
        "test-old.kept", "test-new.kept", "test-newest.kept",
    }  # fmt: skip


def test_entries_take_no_more_than_their_share_of_the_disk(folder, monkeypatch):
    monkeypatch.setattr(cache, "MOST_BYTES", 20_000)
    now = time.time()
    for number in range(4):
        cache.write("test", str(number), {}, {"array": np.zeros(1000)})
        if number < 3:
            os.utime(folder / f"test-{number}.kept", (now - 10 + number, now - 10 + number))
    assert {p.name for p in folder.iterdir()} == {"test-2.kept", "test-3.kept"}
    cache.write("test", "large", {}, {"array": np.zeros(3000)})
    assert cache.read("test", "large") is None and cache.read("test", "3") is not None


def test_what_a_killed_run_left_is_deleted_when_room_is_needed(folder, monkeypatch):
    write_aged(folder, (10, "test", "one"))
    left = folder / ".test-two.kept.abc.kept"
    left.write_bytes(b"half" * 200)
    os.utime(left, (time.time() - 20,) * 2)
    cache.write("test", "three", {}, {})
    assert left.exists()
    monkeypatch.setattr(cache, "MOST_BYTES", cache.summary()["size"] - 1)
    cache.write("test", "four", {}, {})
    assert not left.exists() and len(list(folder.iterdir())) == 3


# --- names ----------------------------------------------------------------------------------------


def test_equal_inputs_share_a_name_and_others_do_not():
    inputs = [
        None, True, 1, 1.0, "1", b"1", Path("1"), (), (1,), (1, (1,)), (1, 1), {"a": 1}, {"a": 1.0},
        np.float32(1), np.float64(1), np.zeros(3), -np.zeros(3), np.zeros(3, np.float32),
        np.zeros((3, 1)), np.zeros(24, np.uint8), 0.0, -0.0, 0.1, np.nextafter(0.1, 1),
        tiny_scene().cameras[0], tiny_scene().ground_frame,
    ]  # fmt: skip
    names = [cache.name_of(value) for value in inputs]
    assert len(set(names)) == len(names)
    assert names == [cache.name_of(value) for value in inputs]
    assert cache.name_of("scene", "ab", "c") != cache.name_of("scene", "a", "bc")
    with pytest.raises(TypeError, match="has no hash"):
        cache.name_of("scene", {1, 2})


def test_every_byte_of_an_array_counts(rng):
    array = rng.integers(0, 255, 1000, dtype=np.uint8)
    name = cache.name_of("scene", array)
    for place in (0, 63, 64, 500, 999):
        other = array.copy()
        other[place] ^= 1
        assert cache.name_of("scene", other) != name
    swapped = np.concatenate([array[64:128], array[:64], array[128:]])
    assert cache.name_of("scene", swapped) != name


def test_what_is_known_of_an_array_stands_for_its_bytes(folder, rng):
    first, second = rng.random((2, 4))
    plain = cache.name_of("scene", first)
    for array in (first, second):
        cache.know_hash(array, "of one file", "position")
    known = cache.name_of("scene", first)
    assert known == cache.name_of("scene", second) != plain
    cache.know_hash(second, "of one file", "scale")
    assert known != cache.name_of("scene", second)
    assert cache.name_of("scene", first.copy()) == plain
    cache.write("test", "a", {}, {"x": second})
    assert (cache.read("test", "a")[1]["x"] == second).all()  # kept bytes are checked as such


def test_what_was_known_of_an_array_goes_with_it():
    before = len(cache._known)
    array = np.zeros(3)
    cache.know_hash(array, "a")
    assert len(cache._known) == before + 1
    del array
    assert len(cache._known) == before


def test_the_versions_the_format_and_the_processor_count(monkeypatch):
    name = cache.name_of("terrain", 1)
    for place, what, value in (
        (cache, "__version__", "0.1"), (cache, "KEPT_FORMAT", cache.KEPT_FORMAT + 1),
        (cache, "versions", lambda names: {"numpy": "1"}), (jit, "processor", lambda: "another"),
    ):  # fmt: skip
        with monkeypatch.context() as patch:
            patch.setattr(place, what, value)
            assert cache.name_of("terrain", 1) != name
    assert cache.name_of("terrain", 1) == name


# --- what is kept ---------------------------------------------------------------------------------


def test_a_kept_built_in_scene_is_the_generated_one(folder, monkeypatch):
    fresh = load_scene("bicycle")
    made = library.import_module
    monkeypatch.setattr(library, "import_module", lambda name: pytest.fail("generated again"))
    same(load_scene("bicycle"), fresh)
    monkeypatch.setattr(library, "import_module", made)
    monkeypatch.setenv("RAINSIM_CACHE", "off")
    same(load_scene("bicycle"), fresh)


def test_a_kept_ground_frame_is_the_estimated_one(folder, tmp_path):
    def at(path, cameras, **given):
        write_splats(path, splats_at(patio(3000)))
        write_transforms(tmp_path / "cameras.json", cameras)
        before = len(list(folder.glob("frame-*")))
        scene = import_scene(path, **given)
        return scene.ground_frame, len(list(folder.glob("frame-*"))) - before

    fresh, added = at(tmp_path / "yard.ply", ring())
    assert added == 1
    again, added = at(tmp_path / "yard.ply", ring())
    assert added == 0
    same(again, fresh)
    up = tuple(fresh.up)
    for given in ({"up": up}, {"meters_per_unit": 2.0}, {"camera_height": 1.7}):
        assert at(tmp_path / "yard.ply", ring(), **given)[1] == 1
    assert at(tmp_path / "yard.ply", ring(count=7))[1] == 1
    write_splats(tmp_path / "other.ply", splats_at(patio(3001)))
    before = len(list(folder.glob("frame-*")))
    import_scene(tmp_path / "other.ply")
    assert len(list(folder.glob("frame-*"))) == before + 1


def entry_name(*inputs):
    return cache.name_of(*kept_terrain.inputs_of(*inputs))


def test_each_input_of_a_terrain_changes_its_name():
    scene, config, mask = tiny_scene(), CONFIG.terrain, np.full((50, 50), -1)
    names = [entry_name(scene, config), entry_name(scene, config, mask)]
    splats, frame, camera = scene.splats, scene.ground_frame, scene.cameras[0]
    for field in dataclasses.fields(splats):
        changed = getattr(splats, field.name).copy()
        changed.reshape(-1)[-1] += np.float32(1e-3)
        other = replace(splats, **{field.name: changed})
        names.append(entry_name(replace(scene, splats=other), config))
    scenes = [
        replace(scene, splats=splats.take(np.arange(len(splats) - 1))),
        replace(scene, ground_frame=replace(frame, meters_per_unit=0.61)),
        replace(scene, ground_frame=replace(frame, translation=frame.translation + 1e-9)),
        replace(scene, cameras=scene.cameras[1:]),
        replace(scene, cameras=(replace(camera, fx=camera.fx + 1e-9), *scene.cameras[1:])),
        replace(scene, drains=((0.1, 0.2, 0.3),)),
    ]
    names += [entry_name(other, config) for other in scenes]
    for change in ({"spacing": 0.05}, {"extent": 1.1}):
        names.append(entry_name(scene, replace(config, **change)))
    painted = mask.copy()
    painted[3, 4] = 1
    names.append(entry_name(scene, config, painted))
    assert len(set(names)) == len(names)
    assert entry_name(tiny_scene(), config) == names[0]


def test_pictures_of_kept_results_are_the_same(folder, monkeypatch):
    def frames():
        scene = tiny_scene()
        return [
            (picture.copy(), report.ledger)
            for picture, report in pipeline.render_rain(scene, scene.cameras[:1], CONFIG)
        ]

    fresh, again = frames(), frames()
    kinds = sorted(path.name.partition("-")[0] for path in folder.iterdir())
    assert kinds == ["bodies", "relief", "skyline", "terrain"]
    monkeypatch.setenv("RAINSIM_CACHE", "off")
    for run in (again, frames()):
        for (picture, ledger), (first, account) in zip(run, fresh, strict=True):
            same(picture, first)
            assert ledger == account


def test_a_kept_terrain_loads_nothing_that_extracts_one(folder, root):
    scene = "from scenes import tiny_scene\nfrom rainsim.config.settings import Config\n"
    code = scene + (
        "import sys\nfrom rainsim.terrain.kept_terrain import kept_terrain\n"
        "config = Config().replace(spacing=0.04, extent=1.0).terrain\n"
        "print(kept_terrain(tiny_scene(), config).bed.sum())\n"
        "print('rainsim.terrain.extract' in sys.modules, 'skimage' in sys.modules)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), str(root / "tests")])}

    def run():
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    first, second = run(), run()
    assert first[0] == second[0] and second[1:] == ["False", "False"]


HOMELESS = """
import os, pwd
for name in ("HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME", "NUMBA_CACHE_DIR", "RAINSIM_CACHE"):
    os.environ.pop(name, None)

def getpwuid(uid):
    raise KeyError(uid)

pwd.getpwuid = getpwuid
from rainsim.compiling import folder
from rainsim.io import cache
from rainsim.scene import library
assert cache.folder() is None and library.scene_folders() == []
assert "~" not in str(folder.CACHE_FOLDER)
"""


@pytest.mark.skipif(os.name != "posix", reason="homes are found by pwd")
def test_an_account_without_a_home_gets_no_folder_named_tilde(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", HOMELESS], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == []
