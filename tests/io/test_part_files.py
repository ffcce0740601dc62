"""OpenEXR files are read back as they were written; broken ones end in one line."""

import numpy as np
import pytest

from rainsim.errors import InputError
from rainsim.io.exr import half, read_parts, write_parts

pytest.importorskip("OpenEXR")


def written(path):
    light = {name: half(np.full((4, 6), k)) for k, name in enumerate("RGBA")}
    parts = [
        ("rain", light, {"chromaticities": (0.7, 0.3, 0.2, 0.8, 0.1, 0.1, 0.3, 0.3)}),
        ("depth", {"Z": np.arange(24, dtype=np.float32).reshape(4, 6)}, {}),
    ]
    write_parts(path, parts, {"imageCounter": 7}, 24.0)
    return path.read_bytes()


def test_parts_come_back_with_their_channels_and_headers(tmp_path):
    written(tmp_path / "a.exr")
    parts = read_parts(tmp_path / "a.exr")
    assert list(parts) == ["rain", "depth"]
    channels, header = parts["rain"]
    assert {name: values.max() for name, values in channels.items()} == dict(
        zip("RGBA", range(4), strict=True)
    )
    assert header["imageCounter"] == 7 and header["chromaticities"][1] == pytest.approx(0.3)
    np.testing.assert_array_equal(parts["depth"][0]["Z"].ravel(), np.arange(24))


@pytest.mark.parametrize("kept", [0, 3, 40, 700, -9])
def test_files_that_are_cut_off_end_in_one_line(tmp_path, kept):
    whole = written(tmp_path / "a.exr")
    (tmp_path / "b.exr").write_bytes(whole[:kept])
    with pytest.raises(InputError, match=r"b\.exr cannot be read as OpenEXR") as caught:
        read_parts(tmp_path / "b.exr")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"not a picture", b"\x89PNG\r\n\x1a\n" + bytes(64)])
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "b.exr").write_bytes(content)
    with pytest.raises(InputError, match="cannot be read as OpenEXR"):
        read_parts(tmp_path / "b.exr")
    with pytest.raises(InputError, match="cannot be read as OpenEXR"):
        read_parts(tmp_path / "missing.exr")
