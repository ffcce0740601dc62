"""Maps in files keep numbers, cell size, place and which way is north."""

import io

import numpy as np
import pytest

from rainsim.errors import InputError
from rainsim.io.rasters import Raster, read_raster, write_raster

VALUES = np.arange(12.0).reshape(3, 4) + 0.25
TAGS = {33550: (2.0, 2.0, 0.0), 33922: (0.0, 0.0, 0.0, 100.0, 56.0, 0.0),
        34735: (1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32632)}  # fmt: skip


def npy(dtype, shape, size):
    """A .npy file that promises an array, with `size` bytes of it."""
    file = io.BytesIO()
    head = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, head)
    return file.getvalue() + bytes(size)


@pytest.mark.parametrize(
    ("kind", "spacing", "corner"),
    [(".asc", 2.0, (100.0, 50.0)), (".tif", 2.0, (100.0, 50.0)), (".txt", None, None),
     (".npy", None, None)],
)  # fmt: skip
def test_what_is_written_is_read(tmp_path, kind, spacing, corner):
    like = Raster(VALUES, spacing, corner, kind, TAGS if kind == ".tif" else None)
    write_raster(tmp_path / f"a{kind}", VALUES, like)
    found = read_raster(tmp_path / f"a{kind}")
    np.testing.assert_array_equal(found.values, VALUES)
    assert (found.spacing, found.corner, found.kind) == (spacing, corner, kind)
    assert found.tags == like.tags


def test_the_first_line_is_the_north_and_no_data_is_nan(tmp_path):
    (tmp_path / "a.txt").write_text(
        "NCOLS 2\nNROWS 2\nXLLCENTER 5\nYLLCENTER 7\nCELLSIZE 2\nNODATA_VALUE -9\n1 2\n3 -9\n"
    )
    found = read_raster(tmp_path / "a.txt")
    np.testing.assert_array_equal(found.values, [[3, np.nan], [1, 2]])
    assert found.corner == (4, 6) and found.kind == ".asc"
    (tmp_path / "b.txt").write_text("1 2\n3 4\n")
    np.testing.assert_array_equal(read_raster(tmp_path / "b.txt").values, [[3, 4], [1, 2]])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"", "one of .asc"),
        ("a.npy", b"no array", "no .npy file"),
        ("a.txt", b"1 2\n3\n", "as many numbers"),
        ("a.asc", b"ncols 2\nnrows 2\n1 2 3 4", "no cellsize"),
        ("a.asc", b"ncols 2\nnrows 2\ncellsize 1\n1 2 3", "no map"),
        ("a.asc", b"ncols two\n", "line 1"),
        ("a.tif", b"II*\0", "cannot be read"),
        ("a.asc", b"ncols 2\nnrows 2\ncellsize 0,5\n1 2 3 4", "write it with a point"),
        ("a.asc", b"ncols 2\nnrows 2\ncellsize 5\n1 2 3 0,4", "a point, not a comma"),
        ("a.asc", b"ncols 2\nnrows 2\ncellsize 1e300\n1 2 3 4", "must be below"),
        ("a.asc", b"ncols 2\nnrows inf\ncellsize 1\n1 2 3 4", "must be below"),
        ("a.asc", b"ncols 2\nnrows 2\ndx 1\ndy 2\n1 2 3 4", "cells of dx 1 by dy 2 m"),
        ("a.asc", b"ncols 2\nnrows 2\ncellsize 1\n1 2 inf 4", "is inf at row 0 from the south"),
        ("a.npy", npy("<c16", (2, 2), 64), "real numbers"),
        ("a.npy", npy("<f8", (1 << 20, 1 << 20), 64), "in 64 bytes"),
        ("a.npy", npy("<f8", (2, 2), 64).replace(b"False", b"Fal(e"), "real numbers"),
    ],
)
def test_other_files_are_refused(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_raster(tmp_path / name)


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ({34735: (1, 1, 0, 1, 3076, 0, 1, 9036)}, "linear unit 9036"),
        ({33550: (2.0, float("nan"), 0.0)}, "no numbers"),
        ({33550: (2.0, 2.0, 0.0), 33922: (0.0, 1.0)}, "no numbers"),
        ({34735: (1, 1, 0, 1, 1024, 0, 1, 2)}, "in degrees"),
        ({33550: (2.0, 3.0, 0.0)}, "cells of 2 x 3 m"),
    ],
)
def test_a_picture_in_degrees_or_without_squares_is_refused(tmp_path, tags, words):
    write_raster(tmp_path / "a.tif", VALUES, Raster(VALUES, kind=".tif", tags=tags))
    with pytest.raises(InputError, match=words):
        read_raster(tmp_path / "a.tif")


def test_squares_by_dx_and_dy_and_the_usual_nodata(tmp_path):
    (tmp_path / "a.asc").write_text("ncols 2\nnrows 1\ndx 3\ndy 3\n-9999 2\n")
    found = read_raster(tmp_path / "a.asc")
    assert found.spacing == 3 and np.isnan(found.values[0, 0]) and found.values[0, 1] == 2
    write_raster(tmp_path / "b.asc", found.values, found)
    np.testing.assert_array_equal(read_raster(tmp_path / "b.asc").values, found.values)


@pytest.mark.parametrize(("upwards", "high"), [((), 1200 / 3937), ((4099, 0, 1, 9001), 1.0)])
def test_feet_become_metres_once(tmp_path, upwards, high):
    foot = 1200 / 3937
    keys = (1, 1, 0, 1 + len(upwards) // 4, 3076, 0, 1, 9003, *upwards)
    like = Raster(VALUES, kind=".tif", tags=TAGS | {34735: keys})
    write_raster(tmp_path / "feet.tif", VALUES, like)
    found = read_raster(tmp_path / "feet.tif")
    np.testing.assert_allclose(found.values, VALUES * high, rtol=1e-6)
    assert found.spacing == pytest.approx(2 * foot) and "US survey feet" in found.notes[0]
    assert found.corner == pytest.approx((100 * foot, 50 * foot))
    assert ("--height-unit" in found.notes[0]) == (not upwards)
    write_raster(tmp_path / "depth.tif", found.values, found)
    again = read_raster(tmp_path / "depth.tif")
    np.testing.assert_allclose(again.values, found.values, rtol=1e-6)
    assert again.spacing == found.spacing
