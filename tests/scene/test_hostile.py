"""Input made to break readers: a clear line, soon, and in little memory."""

import errno
import os
import signal
import struct
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest

import made_captures as captures
import made_formats as made
from made_formats import write_splats
from rainsim.cli import cli
from rainsim.commands.given import named_camera
from rainsim.commands.status import Status
from rainsim.config.settings import Config
from rainsim.errors import GroundError, InputError, RainsimError
from rainsim.io.files import replacing, write_json
from rainsim.io.images import read_hdr, read_image
from rainsim.io.states import read_state
from rainsim.scene.cameras import read_cameras
from rainsim.scene.folder import import_scene
from rainsim.scene.ground import read_ground_frame
from rainsim.terrain.classify import read_mask
from rainsim.terrain.map_files import read_terrain
from rainsim.terrain.surface import is_surface, terrain_from_surface
from refusals import one_clear_line
from scenes import tiny_scene


@pytest.fixture(autouse=True)
def soon():
    """End a test that waits for a file without end."""

    def late(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


READERS = {
    "scene": ("a.ply", import_scene),
    "cameras": ("cameras.json", read_cameras),
    "ground frame": ("a.json", read_ground_frame),
    "preset": ("a.toml", Config.from_preset),
    "picture": ("a.png", read_image),
    "mask": ("a.png", read_mask),
    "sky": ("a.hdr", read_hdr),
    "terrain": ("terrain.npz", read_terrain),
    "state": ("a.npz", read_state),
    "mesh": ("a.obj", lambda path: terrain_from_surface(path, Config().terrain)),
    "PLY mesh": ("a.ply", lambda path: terrain_from_surface(path, Config().terrain)),
}


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("end", ["pipe", "zeros"])
def test_pipes_and_devices_are_refused(tmp_path, kind, end):
    name, read = READERS[kind]
    path = tmp_path / name
    if end == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    assert not is_surface(path)
    with pytest.raises(InputError, match="pipe or a device") as caught:
        read(path)
    one_clear_line(caught.value)


def test_a_pipe_among_the_pictures_of_a_sog(tmp_path):
    pytest.importorskip("gsply")
    folder = made.write_folder(tmp_path, made.sog(made.tame_splats(40, 4)))
    (folder / "quats.webp").unlink()
    os.mkfifo(folder / "quats.webp")
    with pytest.raises(InputError, match="pipe or a device"):
        import_scene(folder)


def mesh(count="3", faces="1", body="0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", form="ascii"):
    lines = ["ply", f"format {form} 1.0", f"element vertex {count}"]
    lines += [f"property float {axis}" for axis in "xyz"] + [f"element face {faces}"]
    lines += ["property list uchar int vertex_indices", "end_header", body]
    return "\n".join(lines).encode()


MESHES = {
    "digits in the header": ("a.ply", mesh(count="9" * 5000)),
    "digits in a face": ("a.ply", mesh(body="0 0 0\n1 0 0\n0 1 0\n" + "9" * 5000 + " 0 1 2\n")),
    "many vertices": ("a.ply", mesh(count="9" * 18)),
    "many faces": ("a.ply", mesh(faces="9" * 18)),
    "many binary faces": ("a.ply", mesh(faces="9" * 18, form="binary_little_endian")),
    "infinite length": ("a.ply", mesh(form="binary_little_endian").replace(b"uchar", b"float")),
    "no property": ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
                    b"element face 1\nend_header\n" + bytes(99)),
    "index beyond int64": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 " + b"9" * 20),
    "digits in an index": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 " + b"9" * 6000),
    "far away": ("a.obj", b"v 0 0 1e300\nv 1e308 0 0\nv 0 1e30 0\nf 1 2 3\n"),
    "not finite": ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1e999 0\nf 1 2 3\n"),
    "ragged": ("a.obj", b"v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "a line": ("a.obj", b"v 0 0 0\nv 0 0 1\nv 0 0 2\nf 1 2 3\n"),
    "zero bytes": ("a.obj", bytes(500)),
    "no TIFF": ("a.tif", b"II*\0" + b"\xff" * 64),
}  # fmt: skip


@pytest.mark.parametrize("case", MESHES)
def test_surfaces_that_are_none(tmp_path, case):
    name, data = MESHES[case]
    (tmp_path / name).write_bytes(data)
    settings = Config().replace(spacing=0.1).terrain
    with pytest.raises(RainsimError) as caught:
        terrain_from_surface(tmp_path / name, settings)
    one_clear_line(caught.value)


def png_head(width, height):
    """A PNG that promises its pixels and has none."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = b"IDAT" + zlib.compress(bytes(100))
    parts = [struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c))
             for c in (chunk, data, b"IEND")]  # fmt: skip
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize("side", [13_000, 60_000])
def test_a_mask_is_measured_before_it_is_unpacked(tmp_path, side):
    (tmp_path / "a.png").write_bytes(png_head(side, side))
    tracemalloc.start()
    with pytest.raises(InputError, match=r"13000 x 13000 pixels; it must|3600000000 pixels"):
        read_mask(tmp_path / "a.png")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10e6


def test_splats_in_one_point_are_no_ground(tmp_path):
    points = np.zeros((60, 3))
    points[-4:, :2] = (1, 0), (-1, 0), (0, 1), (0, -1)  # most distances from the middle are 0
    for few in (points, points * 1e-25, points[:20]):
        write_splats(tmp_path / "a.ply", captures.splats_at(few))
        with pytest.raises(GroundError, match="lie in one point"):
            import_scene(tmp_path / "a.ply", up=(0, 0, 1))
    write_splats(tmp_path / "a.ply", captures.splats_at(points[-5:]))  # the search for it ends
    frame = import_scene(tmp_path / "a.ply", up=(0, 0, 1)).ground_frame
    assert frame.scale_assumed and 1 < frame.meters_per_unit < 10


def test_byte_order_marks_are_passed_over(tmp_path):
    write_json(tmp_path / "cameras.json", captures.capture_cameras(captures.ring(count=2)))
    text = (tmp_path / "cameras.json").read_bytes()
    (tmp_path / "cameras.json").write_bytes(b"\xef\xbb\xbf" + text)
    assert len(read_cameras(tmp_path / "cameras.json")) == 2
    (tmp_path / "a.obj").write_bytes(b"\xef\xbb\xbfv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    settings = Config().replace(spacing=0.1).terrain
    assert terrain_from_surface(tmp_path / "a.obj", settings).grid.shape == (10, 10)


ESCAPE = "\x1b]0;title\x07\x1b[31m\u202e"


def test_names_in_files_cannot_command_the_terminal(tmp_path, capsys):
    data = captures.capture_cameras(captures.ring(count=2))
    data[0]["img_name"] = ESCAPE
    data[1]["img_name"] = "a" * 5000
    write_json(tmp_path / "cameras.json", data)
    first, second = read_cameras(tmp_path / "cameras.json")
    assert first.name.isprintable() and len(second.name) < 300
    scene = replace(tiny_scene(), cameras=(first, second), name=ESCAPE)
    with pytest.raises(RainsimError) as caught:
        named_camera(scene, ESCAPE)
    assert str(caught.value).isprintable()
    Status().say(f"scene {ESCAPE}")
    Status().notes([f"a note {ESCAPE}"])
    shown = capsys.readouterr().err
    assert "scene" in shown and shown.replace("\n", "").isprintable()


def test_messages_repeat_input_in_part_only(capsys):
    for arguments in (["run", "--seed", "9" * 5000], ["run", "--scene", "a" * 5000],
                      ["run", "--camera", "a", "--preset", ESCAPE * 999]):  # fmt: skip
        assert _run(arguments)
        shown = capsys.readouterr().err
        assert "Error: " in shown and len(shown) < 1500 and shown.replace("\n", "").isprintable()


def _run(arguments):
    try:
        cli(arguments, prog_name="rainsim")
    except SystemExit as end:
        assert end.code
        return end.code


def test_a_full_disk_names_the_file_and_the_remedy(tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match="No space left") as caught:
        with replacing(tmp_path / "frame.png"):
            full()
    assert caught.value.filename == str(tmp_path / "frame.png") and not any(tmp_path.iterdir())

    def write(*_):
        with replacing(tmp_path / "frame.png"):
            full()

    monkeypatch.setattr("rainsim.config.settings.preset_names", write)
    assert _run(["presets"]) == 1
    shown = capsys.readouterr().err
    assert f"{tmp_path / 'frame.png'}: No space left on device; make room there" in shown
