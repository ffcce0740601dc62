"""Splat files that are cut off or lie: a clear error, and memory in proportion."""

import gzip
import struct

import numpy as np
import pytest

import made_formats as made
import mutate
from made_captures import random_splats
from rainsim.scene.formats import read
from refusals import refused_within

COUNT = 300  # splats of the files that are mutated
SMALL = made.tame_splats(COUNT, 4)
TWO_NODES = [{"scale": [1, 2, 1], "children": [1]}, {"mesh": 0}]


def ply_with_everything():
    columns = made.stored_columns(random_splats(COUNT, 9)) | {"filter_3D": np.full(COUNT, 0.01)}
    return made.ply(columns)


READERS = {
    "ply": (ply_with_everything, mutate.plain),
    "splat": (lambda: made.splat_records(SMALL), mutate.plain),
    "compressed": (lambda: made.compressed_ply(SMALL), mutate.plain),
    "spz 2": (lambda: made.spz(SMALL, 2), mutate.zipped),
    "spz 3": (lambda: made.spz(SMALL, 3), mutate.zipped),
    "spz 4": (lambda: made.spz(SMALL, 4), mutate.plain),
    "sog": (lambda: made.sog(SMALL), mutate.bundled),
    "sog folder": (lambda: made.sog(SMALL), mutate.one_mutated),
    "glb": (lambda: made.glb(SMALL, TWO_NODES), mutate.plain),
    "sog 1": (lambda: made.sog_v1(SMALL), mutate.one_mutated),
}
NEED_EXTRA = {name for name in READERS if name.startswith(("compressed", "spz", "sog"))}


BOMB = 200_000_000  # bytes that unpack from a small file


def test_gzip_bombs(tmp_path):
    pytest.importorskip("gsply")
    read_once = tmp_path / "warm"  # compiling and importing take memory of their own
    read_once.write_bytes(made.spz(SMALL, 3))
    read(read_once)
    head = made.spz_head(SMALL, 3)
    (tmp_path / "more").write_bytes(gzip.compress(head + bytes(BOMB), 9))
    assert "unpacks to more" in refused_within(40e6, tmp_path / "more")
    head = made.spz_head(SMALL, 3, count=BOMB // 20, degree=0)
    (tmp_path / "lying").write_bytes(gzip.compress(head + bytes(BOMB), 9))
    assert "splats in" in refused_within(40e6, tmp_path / "lying")


def test_zstd_frames_that_promise_a_terabyte(tmp_path):
    pytest.importorskip("gsply")
    pytest.importorskip("zstandard")
    data = bytearray(made.spz(SMALL, 4))
    streams = data[15]
    start = 32 + 16 * streams
    # Frame: magic, descriptor (8-byte size, no single segment), window, size.
    data[start : start + 14] = struct.pack("<IBBQ", 0xFD2FB528, 0xC0, 0x60, 10**12)
    (tmp_path / "a").write_bytes(data)
    assert "1000000000000 bytes" in refused_within(10e6, tmp_path / "a")
    data = bytearray(made.spz(SMALL, 4))
    struct.pack_into("<Q", data, 40, 10**12)  # the table of contents lies
    (tmp_path / "b").write_bytes(data)
    assert "stream 0" in refused_within(10e6, tmp_path / "b")


def test_zip_bombs(tmp_path):
    files = made.sog(SMALL)
    bomb = files | {"quats.webp": bytes(BOMB)}
    (tmp_path / "a").write_bytes(made.bundle(bomb, 8))
    pytest.importorskip("gsply")
    assert "quats.webp unpacks to 200000000" in refused_within(10e6, tmp_path / "a")


def test_pictures_that_promise_a_gigapixel(tmp_path):
    pytest.importorskip("gsply")
    files = made.sog(SMALL)
    side = (1 << 14) - 1
    lying = bytearray(files["scales.webp"])
    assert lying[12:16] == b"VP8L"
    bits = int.from_bytes(lying[21:25], "little") | side | side << 14
    lying[21:25] = bits.to_bytes(4, "little")
    folder = made.write_folder(tmp_path / "a", files | {"scales.webp": bytes(lying)})
    assert "16384 x 16384 pixels for 300" in refused_within(10e6, folder)


def test_names_that_climb_out_of_the_folder(tmp_path):
    pytest.importorskip("gsply")
    files = made.sog(SMALL)
    made.write_folder(tmp_path, {"secret.webp": files["quats.webp"]})
    for name in ("../secret.webp", "..\\\\secret.webp", "/etc/passwd", "C:secret.webp", "a.json"):
        meta = files["meta.json"].replace(b"quats.webp", name.encode())
        folder = made.write_folder(tmp_path / "sog", files | {"meta.json": meta})
        assert "names of .webp files" in refused_within(10e6, folder)


def test_deeply_nested_and_huge_meta(tmp_path):
    files = made.sog(SMALL)
    for meta in (b'{"means":' + b"[" * 200_000, b'{"a":"' + b"a" * (1 << 23) + b'"}'):
        folder = made.write_folder(tmp_path / "sog", files | {"meta.json": meta})
        assert "meta.json" in refused_within(60e6, folder)
