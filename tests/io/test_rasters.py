"""Maps in files keep numbers, cell size, place and which way is north."""

import numpy as np
import pytest

from rainsim.errors import InputError
from rainsim.io.rasters import Raster, read_raster, write_raster

VALUES = np.arange(12.0).reshape(3, 4) + 0.25
TAGS = {33550: (2.0, 2.0, 0.0), 33922: (0.0, 0.0, 0.0, 100.0, 56.0, 0.0),
        34735: (1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32632)}  # fmt: skip


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
    ],
)
def test_other_files_are_refused(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_raster(tmp_path / name)


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ({34735: (1, 1, 0, 1, 1024, 0, 1, 2)}, "in degrees"),
        ({33550: (2.0, 3.0, 0.0)}, "cells of 2 x 3 m"),
    ],
)
def test_a_picture_in_degrees_or_without_squares_is_refused(tmp_path, tags, words):
    write_raster(tmp_path / "a.tif", VALUES, Raster(VALUES, kind=".tif", tags=tags))
    with pytest.raises(InputError, match=words):
        read_raster(tmp_path / "a.tif")
