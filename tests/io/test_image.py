"""Pictures: exact round trips, whole files or none, and HDR files in every coding."""

import itertools
import os
import struct
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from PIL import Image

from rainsim.errors import InputError, ParameterError
from rainsim.io import files, images, png


def test_png_comes_back_exactly(tmp_path, rng):
    picture = rng.integers(0, 256, (13, 17, 3), dtype=np.uint8)
    images.write_png(tmp_path / "a.png", picture)
    assert np.array_equal(images.read_image(tmp_path / "a.png"), picture)
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]  # no temporary file stays


@pytest.mark.parametrize("kind", ["u1", "u2"])
@pytest.mark.parametrize("shape", [(5, 7), (1, 1), (3, 9, 3), (1, 1, 3), (4, 2, 4)])
def test_another_program_reads_each_kind_of_png(rng, kind, shape):
    imagecodecs = pytest.importorskip("imagecodecs")
    values = rng.integers(0, np.iinfo(kind).max, shape).astype(kind)
    for given in (values, values[:, ::-1]):  # not in one piece
        found = imagecodecs.png_decode(png.png_bytes(given))
        assert found.dtype == kind
        np.testing.assert_array_equal(found, given)


def test_png_refuses_other_types(tmp_path):
    with pytest.raises(ParameterError, match="must be uint8"):
        images.write_png(tmp_path / "a.png", np.zeros((4, 4, 3)))
    with pytest.raises(ParameterError, match=r"shape \(4, 4, 5\)"):
        images.write_png(tmp_path / "a.png", np.zeros((4, 4, 5), np.uint8))
    assert not list(tmp_path.iterdir())


def test_tiff_keeps_float32_exactly(tmp_path, rng):
    values = rng.standard_normal((9, 5)).astype(np.float32)
    images.write_tagged(tmp_path / "h.tif", values, {})
    back = images.read_image(tmp_path / "h.tif")
    assert back.dtype == np.float32 and np.array_equal(back, values)


def test_npz_comes_back(tmp_path):
    images.write_npz(tmp_path / "a.npz", a=np.arange(3), b=np.float32(2))
    with np.load(tmp_path / "a.npz") as data:
        assert np.array_equal(data["a"], [0, 1, 2]) and data["b"] == 2
        assert data["version"] == images.VERSION


def test_a_failed_write_keeps_what_was_there(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_bytes(b"before")

    def fail(*args, **kwargs):
        raise OSError("disk full")

    monkeypatch.setattr(png, "png_bytes", fail)
    with pytest.raises(OSError, match="disk full"):
        images.write_png(tmp_path / "a.png", np.zeros((4, 4, 3), np.uint8))
    assert (tmp_path / "a.png").read_bytes() == b"before"
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_threads_that_ask_for_the_permissions_of_new_files_agree():
    before, often = os.umask(0o027), sys.getswitchinterval()
    sys.setswitchinterval(1e-7)
    try:
        with ThreadPoolExecutor(8) as pool:
            masks = set(pool.map(lambda _: files._umask(), range(20_000)))
        assert masks == {0o027} and os.umask(0o027) == 0o027
    finally:
        sys.setswitchinterval(often)
        os.umask(before)


def test_damaged_pictures_are_one_clear_error(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\nrubbish")
    with pytest.raises(InputError, match=r"a\.png cannot be read as a picture"):
        images.read_image(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"none\.png"):
        images.read_image(tmp_path / "none.png")


def test_a_picture_of_more_pixels_than_its_bytes_hold_is_refused(tmp_path):
    path = tmp_path / "h.tif"
    for side in (10, 4000):  # as tight as it gets: equal pixels
        Image.fromarray(np.zeros((side, side), np.float32)).save(path, compression="tiff_deflate")
        assert images.read_image(path).shape == (side, side)
    images.write_tagged(path, np.zeros((10, 10), np.float32), {})
    data = bytearray(path.read_bytes())
    directory = int.from_bytes(data[4:8], "little")
    for entry in range(directory + 2, len(data) - 12, 12):
        if int.from_bytes(data[entry : entry + 2], "little") == 257:  # ImageLength
            data[entry + 2 : entry + 12] = struct.pack("<HII", 4, 1, 2_162_696)
            break
    path.write_bytes(data)
    assert images.picture_size(path) == (10, 2_162_696)
    with pytest.raises(InputError, match=r"claims 10 x 2162696 pixels and has \d+ bytes"):
        images.read_image(path)


def test_preview_shrinks_thins_and_keeps_the_time(tmp_path):
    preview = images.Preview(images.PREVIEW_FRAMES * 2, fps=25.0)
    for n in range(8):
        preview.add(np.full((90, 1000, 3), 30 * n, np.uint8))
    preview.write(tmp_path / "p.webp")
    frames = images.iio.imread(tmp_path / "p.webp", plugin="pillow", index=...)
    assert frames.shape == (4, 30, 333, 3)  # every second frame, a third of each side
    assert frames.mean(axis=(1, 2, 3)) == pytest.approx([0, 60, 120, 180], abs=3)
    with Image.open(tmp_path / "p.webp") as animation:
        animation.seek(1)
        animation.load()
        assert animation.info["duration"] == 80  # ms: two frames at 25 a second


def test_preview_of_nothing_writes_nothing(tmp_path):
    images.Preview(3, 24.0).write(tmp_path / "p.webp")
    assert not list(tmp_path.iterdir())


# --- Radiance HDR ---------------------------------------------------------------------------------

WIDTH, HEIGHT = 16, 3


def _header(width=WIDTH, height=HEIGHT, more=""):
    text = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{more}\n-Y {height} +X {width}\n"
    return text.encode()


def _pixels(rng):
    rgbe = rng.integers(3, 256, (HEIGHT, WIDTH, 4), dtype=np.uint8)
    rgbe[..., 3] = rng.integers(120, 136, (HEIGHT, WIDTH))
    rgbe[1, 4:12] = rgbe[1, 4]  # something for runs to find
    rgbe[2, 5] = 0  # exponent 0 is black
    return rgbe


def _value(rgbe):
    """The obvious decoding, in plain Python."""
    out = np.zeros((*rgbe.shape[:2], 3), np.float32)
    for row, column in np.ndindex(rgbe.shape[:2]):
        *mantissas, exponent = map(int, rgbe[row, column])
        for channel in range(3):
            if exponent:
                out[row, column, channel] = mantissas[channel] * 2.0 ** (exponent - 136)
    return out


def _runs(values):
    """Yield each value of an array's first axis that differs from the one before, and its count."""
    for value, same in itertools.groupby(values.tolist()):
        yield value, len(list(same))


def _new_runs(rgbe):
    """Run-length code of today: each channel of a line by itself."""
    data = b""
    for line in rgbe:
        data += bytes((2, 2, 0, WIDTH))
        for channel in line.T:
            for value, run in _runs(channel):
                data += bytes((128 + run if run > 1 else 1, value))
    return data


def _old_runs(rgbe):
    """Run-length code of old: a pixel 1 1 1 n repeats the one before n times."""
    data = b""
    for line in rgbe:
        for pixel, run in _runs(line):
            data += bytes(pixel) + (bytes((1, 1, 1, run - 1)) if run > 1 else b"")
    return data


@pytest.mark.parametrize("code", [lambda p: p.tobytes(), _new_runs, _old_runs])
def test_hdr_in_every_coding(tmp_path, rng, code):
    rgbe = _pixels(rng)
    (tmp_path / "s.hdr").write_bytes(_header() + code(rgbe))
    back = images.read_hdr(tmp_path / "s.hdr")
    assert back.dtype == np.float32 and back.shape == (HEIGHT, WIDTH, 3)
    assert np.array_equal(back, _value(rgbe))


def test_hdr_divides_out_the_exposure(tmp_path, rng):
    rgbe = _pixels(rng)
    (tmp_path / "s.hdr").write_bytes(_header(more="EXPOSURE=2\nEXPOSURE= 4\n") + rgbe.tobytes())
    assert images.read_hdr(tmp_path / "s.hdr") == pytest.approx(_value(rgbe) / 8)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("code", [lambda p: p.tobytes(), _new_runs, _old_runs])
def test_a_cut_off_hdr_is_one_clear_error(tmp_path, rng, code, share):
    data = _header() + code(_pixels(rng))
    (tmp_path / "s.hdr").write_bytes(data[: int(len(data) * share)])
    with pytest.raises(InputError, match=r"s\.hdr"):
        images.read_hdr(tmp_path / "s.hdr")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"P6 3 3 255 ", "is not a Radiance HDR picture"),
        (_header().replace(b"rgbe", b"xyze"), "the format 32-bit_rle_xyze"),
        (_header(width=10**9, height=10**9), "promises 1000000000 x 1000000000 pixels"),
        (_header(width=0), "promises 0 x 3 pixels"),
        (_header().replace(b"-Y", b"+Y"), "the size line '[+]Y 3 [+]X 16'"),
        (_header(more="EXPOSURE=0\n"), "the exposure 0"),
        (_header() + bytes((2, 2, 0, 16)) + bytes((255, 7)) * 50, "is damaged"),
    ],
)
def test_a_wrong_hdr_is_named_with_its_rule(tmp_path, data, message):
    (tmp_path / "s.hdr").write_bytes(data)
    with pytest.raises(InputError, match=message):
        images.read_hdr(tmp_path / "s.hdr")
