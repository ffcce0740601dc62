"""The program's own files: whatever is in them is read whole and right, or refused in one line."""

import errno
import io
import pickle
import zipfile
from dataclasses import replace

import numpy as np
import pytest

import made_files as made
from made_captures import capture_cameras, ring, splats_at
from rainsim.commands.film import SIMULATION, read_simulation
from rainsim.config.settings import Config
from rainsim.errors import InputError
from rainsim.io.arrays import Field, read_arrays, write_arrays
from rainsim.io.files import write_json
from rainsim.io.states import read_state, write_state
from rainsim.scene.cameras import load_cameras, write_transforms
from rainsim.scene.folder import read_scene, write_scene
from rainsim.scene.ground import read_ground_frame, write_ground_frame
from rainsim.scene.types import GroundFrame, Scene
from rainsim.terrain.map_files import read_terrain, write_terrain
from refusals import one_clear_line, refused_within


def make_terrain(folder):
    write_terrain(folder, made.small_terrain())
    return folder / "terrain.npz"


def make_state(folder):
    write_state(folder / "state.npz", made.small_state())
    return folder / "state.npz"


def make_splats(folder):
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3))
    write_scene(folder, Scene("a", splats_at(np.zeros((20, 3)), 4), (), frame))
    return folder / "splats.npz"


KINDS = {
    "terrain": (make_terrain, read_terrain),
    "state": (make_state, lambda path: read_state(path, made.small_terrain())),
    "splats": (make_splats, lambda path: read_scene(path.parent)),
}


@pytest.fixture(params=KINDS)
def kind(request, tmp_path):
    """A sound file of one kind and what reads it."""
    make, read = KINDS[request.param]
    path = make(tmp_path)
    read(path)
    return path, read


def refused(read, path):
    with pytest.raises(InputError) as caught:
        read(path)
    one_clear_line(caught.value)
    return str(caught.value)


def test_a_disk_that_goes_away_is_no_damage(tmp_path, monkeypatch):
    path = make_terrain(tmp_path)

    def gone(*_, **__):
        raise OSError(errno.ESTALE, "Stale file handle")

    monkeypatch.setattr(zipfile.ZipFile, "open", gone)
    with pytest.raises(OSError, match=rf"Stale file handle.*{path.name}"):
        read_terrain(path)


def wrong_versions_of(values):
    """Arrays that an array must not be: of another type, shape or with values in no range."""
    values = np.asanyarray(values)
    yield values.astype("c16") if values.dtype.kind != "U" else np.zeros(values.shape, "S3")
    yield values[None]
    yield np.array([{}], dtype=object)
    if values.dtype.kind != "U" and values.itemsize > 1:
        yield values.astype(values.dtype.newbyteorder("S"))
    if values.ndim:
        yield values.reshape(-1)[:1].reshape(())
        yield np.repeat(values, 2, axis=-1)
    if values.dtype.kind == "f":
        for bad in (np.nan, 1e30):
            changed = values.copy()
            changed.reshape(-1)[-1:] = bad
            yield changed


def test_arrays_of_another_type_shape_or_range_are_refused(kind):
    path, read = kind
    arrays = made.arrays_in(path)
    count = read_anyway = 0
    for name in arrays:
        for wrong in wrong_versions_of(arrays[name]):
            count += 1
            path.write_bytes(made.rezipped(arrays | {name: wrong}))
            try:
                read(path)
            except InputError as error:
                one_clear_line(error)
            else:
                read_anyway += 1
                # A row of no meaning may have any length; the others may not.
                # Old versions wrote three terms more of a top's surface, which were zero.
                known = "notes", "sh", "version", "tops_surface"
                assert name in known or "impact" in name, name
        if name not in ("version", "water", "notes") and not name.startswith("impact"):
            path.write_bytes(made.rezipped({n: a for n, a in arrays.items() if n != name}))
            refused(read, path)
    assert count >= 20 and read_anyway <= 6, (count, read_anyway)


@pytest.mark.parametrize(
    ("make", "name", "value", "text"),
    [
        (make_state, "tile_size", 1e-30, "tile_size is 1e-30"),
        (make_state, "index", np.int64(-1), "index is -1"),
        (make_state, "time", 1e-9, "its frame 2 is at 1e-09 s; frame 0 must be at 0 s"),
        (make_state, "time", -1.0, "time is -1"),
        (make_state, "time", np.nan, "time is from nan"),
        (make_state, "ledger", '{"rain": 1e999}', "its ledger"),
        (make_state, "ledger", "[" * 5000, "its ledger"),
        (make_state, "notes", '["a", 1' + "0" * 5000 + "]", "its notes"),
        (make_state, "top_water", np.zeros(7), "other tops"),
        (make_state, "drips", np.full((2, 9), 400.0), "its drips do not fall"),
        (make_state, "depth", np.full(made.SHAPE, -1, np.float32), "depth is -1"),
        (make_terrain, "ground_class", np.full(made.SHAPE, 200, np.uint8), "from 0 to 5"),
        (make_terrain, "spacing", 0.0, "spacing is 0"),
        (make_terrain, "bed", np.full(made.SHAPE, 3, np.float32), "wrong order"),
        (make_terrain, "tops_index", np.full(made.SHAPE, 3, np.int16), "do not fit together"),
        (make_terrain, "tops_patch", np.array([[3, 5, 6]]), "do not fit together"),
        (make_terrain, "version", np.int64(99), "version 99"),
        (make_splats, "opacity", np.full(20, 1.5, np.float32), "from 0 to 1"),
        (make_splats, "rotation", np.zeros((20, 4), np.float32), "unit quaternions"),
        (make_splats, "sh", np.zeros((20, 25, 3), np.float32), "25 coefficients"),
    ],
)
def test_values_that_no_run_writes(tmp_path, make, name, value, text):
    path = make(tmp_path)
    read = next(read for known, read in KINDS.values() if known is make)
    path.write_bytes(made.rezipped(made.arrays_in(path) | {name: value}))
    assert text in refused(read, path)


def test_a_state_of_another_map_is_refused(tmp_path):
    path = make_state(tmp_path)
    state = made.arrays_in(path)
    depth, velocity = np.zeros((4, 5), np.float32), np.zeros((2, 4, 5), np.float32)
    state |= {"depth": depth, "velocity": velocity}
    path.write_bytes(made.rezipped(state))
    read_state(path)  # by itself it is sound
    with pytest.raises(InputError, match="not of this height map"):
        read_state(path, made.small_terrain())
    terrain = made.small_terrain()
    write_state(path, made.small_state(), terrain)
    assert read_state(path, terrain).index == 2
    with pytest.raises(InputError, match="height map, whose ground is another"):
        read_state(path, replace(terrain, bed=terrain.bed - np.float32(1e-3)))


def test_a_ground_frame_of_another_capture_is_said(tmp_path):
    path = tmp_path / "g.json"
    write_ground_frame(path, GroundFrame(np.eye(3), 1.0, np.zeros(3)), "a" * 64)
    assert read_ground_frame(path, "a" * 64).notes == read_ground_frame(path).notes == ()
    assert "OF ANOTHER CAPTURE" in read_ground_frame(path, "b" * 64).notes[0]


def test_files_of_before_versions_are_read(kind):
    path, read = kind
    now = pickle.dumps(read(path))
    arrays = made.arrays_in(path)
    del arrays["version"]
    path.write_bytes(made.rezipped(arrays))
    assert pickle.dumps(read(path)) == now


def test_sizes_are_compared_before_memory_is_taken(tmp_path):
    field = {"a": Field("float64", ("n",))}
    path = tmp_path / "a.npz"
    header = io.BytesIO()
    described = {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(header, described)

    def read(path):
        return read_arrays(path, "thing", field, 1, "write it again")

    path.write_bytes(made.rezipped({"a": header.getvalue() + bytes(80)}))
    assert "does not fill its place" in refused_within(10e6, path, read)
    path.write_bytes(made.rezipped({"a": np.zeros(5_000_000)}, zipfile.ZIP_DEFLATED))
    assert "packed" in refused_within(10e6, path, read)
    with zipfile.ZipFile(path, "w") as archive, pytest.warns(UserWarning, match="Duplicate"):
        for _ in range(2):
            archive.writestr("a.npy", b"")
    assert "twice" in refused_within(10e6, path, read)


def test_order_of_columns_and_types_come_back(tmp_path):
    columns = np.asfortranarray(np.arange(12.0).reshape(3, 4))
    write_arrays(tmp_path / "a.npz", 1, {"a": columns, "text": "so", "texts": ["a", "bc"]})
    fields = {"a": Field("float64", (3, 4)), "text": Field("text"), "texts": Field("text", ("n",))}
    found = read_arrays(tmp_path / "a.npz", "thing", fields, 1, "write it again")
    np.testing.assert_array_equal(found["a"], columns)
    assert found["a"].flags.c_contiguous and found["a"].flags.writeable
    assert found["text"] == "so" and found["texts"] == ["a", "bc"]


# --- JSON -----------------------------------------------------------------------------------------


def make_simulation(folder):
    keyframes = ((0.0, (("rate", 1e-6), ("wind", (3.0, 0.5)))), (2.0, (("rate", 2e-6),)))
    settings = replace(Config(), keyframes=keyframes).as_dict()
    source = {"scene": "a", "source": "b/c", "sha256": "0" * 64}
    data = {"rainsim_simulation": 1, "preset": "drizzle", "settings": settings, "input": source}
    write_json(folder / SIMULATION, data)
    return folder / SIMULATION


def make_scene_file(folder):
    make_splats(folder)
    scene = replace(read_scene(folder), cameras=tuple(ring(count=2)), drains=((0.0, 1.0, 2.0),))
    write_scene(folder, scene)
    return folder / "scene.json"


def make_ground_frame(folder):
    write_ground_frame(folder / "g.json", GroundFrame(np.eye(3), 1.0, np.zeros(3), notes=("a",)))
    return folder / "g.json"


def make_transforms(folder):
    write_transforms(folder / "transforms.json", ring(count=3))
    return folder / "transforms.json"


def make_capture_cameras(folder):
    write_json(folder / "cameras.json", capture_cameras(ring(count=3)))
    return folder / "cameras.json"


def read_json_cameras(path):
    cameras, _ = load_cameras(path)
    for camera in cameras:
        assert camera.name.isprintable() and len(camera.name) < 300
        assert np.isfinite(camera.camera_from_world).all() and camera.fx > 0 < camera.width


JSON_KINDS = {
    "simulation": (make_simulation, lambda path: read_simulation(path.parent)),
    "scene": (make_scene_file, lambda path: read_scene(path.parent)),
    "ground frame": (make_ground_frame, read_ground_frame),
    "transforms": (make_transforms, read_json_cameras),
    "cameras": (make_capture_cameras, read_json_cameras),
}


def test_a_sky_whose_name_no_file_can_have(tmp_path):
    path = make_simulation(tmp_path)
    path.write_text(path.read_text().replace('"overcast"', f'"{"a" * 9000}.hdr"'))
    with pytest.raises(InputError, match="there is no sky file"):
        read_simulation(tmp_path)
