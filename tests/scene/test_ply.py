"""Reading and writing splat PLY files, good and bad."""

import struct

import numpy as np
import pytest

from made_captures import random_splats
from made_formats import write_splats
from rainsim.errors import InputError
from rainsim.scene.formats import read_splats

USUAL = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
]  # fmt: skip
# One splat: log scales of 0.1, 0.2, 0.3, opacity 0.75, a quaternion twice too long.
VALUES = dict(zip(USUAL, [1, 2, 3, 0.5, 0.6, 0.7, np.log(3), *np.log([0.1, 0.2, 0.3]), 0, 2, 0, 0],
                  strict=True))  # fmt: skip


def header(names, count=1, kind="float", form="binary_little_endian"):
    lines = ["ply", f"format {form} 1.0", "comment made for a test", f"element vertex {count}"]
    lines += [f"property {kind} {name}" for name in names]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def one_splat(names=USUAL, kind="float", form="binary_little_endian", **changed):
    values = {**VALUES, **changed}
    mark = (">" if "big" in form else "<") + {"float": "f", "double": "d"}[kind]
    body = b"".join(struct.pack(mark, values.get(name, 7)) for name in names)
    return header(names, kind=kind, form=form) + body


def check_one(splats):
    np.testing.assert_allclose(splats.position, [[1, 2, 3]])
    np.testing.assert_allclose(splats.scale, [[0.1, 0.2, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(splats.opacity, [0.75], rtol=1e-6)
    np.testing.assert_allclose(splats.rotation, [[0, 1, 0, 0]])
    np.testing.assert_allclose(splats.sh[:, 0], [[0.5, 0.6, 0.7]], rtol=1e-6)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_what_is_written_is_read(tmp_path, coefficients):
    splats = random_splats(40_000, coefficients)  # more than one block of rows
    write_splats(tmp_path / "a.ply", splats)
    back, notes = read_splats(tmp_path / "a.ply")
    assert notes == []
    np.testing.assert_array_equal(back.position, splats.position)
    np.testing.assert_array_equal(back.sh, splats.sh)
    np.testing.assert_allclose(back.scale, splats.scale, rtol=1e-5)
    np.testing.assert_allclose(back.opacity, splats.opacity, rtol=1e-5)
    np.testing.assert_allclose(back.rotation, splats.rotation, atol=1e-6)
    for name in ("position", "rotation", "scale", "opacity", "sh"):
        array = getattr(back, name)
        assert array.dtype == np.float32 and array.flags.c_contiguous, name


def test_values_without_a_finite_logit_or_logarithm_are_written(tmp_path):
    splats = random_splats(2)
    splats.opacity[:] = 0, 1
    splats.scale[0] = 0
    write_splats(tmp_path / "a.ply", splats)
    back, notes = read_splats(tmp_path / "a.ply")
    assert notes == []
    np.testing.assert_allclose(back.opacity, [0, 1], atol=1e-6)
    assert (back.scale[0] < 1e-30).all()


@pytest.mark.parametrize("kind", ["float", "double"])
@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian"])
def test_order_width_and_extra_properties_do_not_matter(tmp_path, kind, form):
    names = ["extra", *reversed(USUAL), "nx", "label"]
    (tmp_path / "a.anything").write_bytes(one_splat(names, kind, form))
    check_one(read_splats(tmp_path / "a.anything")[0])


def test_harmonics_are_stored_channel_by_channel(tmp_path):
    rest = [f"f_rest_{i}" for i in range(9)]
    (tmp_path / "a.ply").write_bytes(
        one_splat([*USUAL, *rest], **{name: i for i, name in enumerate(rest)})
    )
    splats, _ = read_splats(tmp_path / "a.ply")
    np.testing.assert_array_equal(splats.sh[0, 1:], [[0, 3, 6], [1, 4, 7], [2, 5, 8]])


def test_windows_line_ends_and_elements_before_the_vertices(tmp_path):
    data = one_splat()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    head = data[:end].replace(b"\n", b"\r\n")
    head = head.replace(b"element vertex", b"element seal 3\r\nproperty uchar a\r\nelement vertex")
    (tmp_path / "a.ply").write_bytes(head + b"abc" + data[end:] + b"more behind")
    check_one(read_splats(tmp_path / "a.ply")[0])


def broken(count, total=1000):
    splats = random_splats(total)
    places = [splats.position, splats.rotation, splats.sh[:, 1], splats.scale]
    for i in range(count):
        places[i % 4][7 * i] = (np.nan, 0, -np.inf, np.inf)[i % 4]  # rotation 0 has no direction
    return splats


def test_few_broken_splats_are_dropped_and_counted(tmp_path):
    splats = broken(10)
    write_splats(tmp_path / "a.ply", splats)
    back, notes = read_splats(tmp_path / "a.ply")
    assert len(back) == 990 and "dropped 10 of 1000" in notes[0]
    good = np.ones(1000, bool)
    good[7 * np.arange(10)] = False
    np.testing.assert_array_equal(back.position, splats.position[good])
    assert all(np.isfinite(a).all() for a in (back.rotation, back.scale, back.opacity, back.sh))


def test_many_broken_splats_are_refused(tmp_path):
    write_splats(tmp_path / "a.ply", broken(11))
    with pytest.raises(InputError, match=r"11 of 1000 splats .*1 % are tolerated"):
        read_splats(tmp_path / "a.ply")


def test_absurd_scales_and_opacities_count_as_broken(tmp_path):
    (tmp_path / "a.ply").write_bytes(one_splat(scale_1=80.0))
    with pytest.raises(InputError, match="1 of 1 splats"):
        read_splats(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(one_splat(opacity=np.nan))
    with pytest.raises(InputError, match="1 of 1 splats"):
        read_splats(tmp_path / "a.ply")


MESH = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
BAD = {
    "mesh": (MESH + bytes(49), "mesh or point cloud"),
    "truncated": (one_splat()[:-1], "promises 1 splats of 56 bytes but has room for 0"),
    "a trillion": (header(USUAL, 10**12) + bytes(560), "1000000000000 splats .* room for 10"),
    "digits": (header(USUAL, "9" * 5000), "line 4"),
    "negative": (header(USUAL, -5), "line 4 is 'element vertex -5'"),
    "none": (header(USUAL, 0), "0 splats"),
    "ascii": (header(USUAL, form="ascii"), "ASCII PLY"),
    "middle endian": (header(USUAL, form="binary_middle_endian"), "line 2"),
    "missing": (one_splat(USUAL[:-1]), "lacks the property rot_3"),
    "degree": (one_splat([*USUAL, "f_rest_0", "f_rest_1"]), "2 f_rest"),
    "gap": (one_splat([*USUAL, *(f"f_rest_{i}" for i in range(1, 10))]), "9 f_rest"),
    "twice": (one_splat([*USUAL, "x"]), "property x twice"),
    "type": (header(USUAL, kind="quad"), "line 5 is 'property quad x'"),
    "no vertices": (MESH.replace(b"vertex 3", b"corner 3"), "no vertex element|lists before"),
    "no end": (header(USUAL)[:-12], "no end_header"),
    "no format": (b"ply\nelement vertex 1\nend_header\n", "no format"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_end_in_one_clear_line(tmp_path, case):
    data, expected = BAD[case]
    (tmp_path / "bad.ply").write_bytes(data)
    with pytest.raises(InputError, match=expected) as caught:
        read_splats(tmp_path / "bad.ply")
    message = str(caught.value)
    assert str(tmp_path / "bad.ply") in message and "\n" not in message
    assert len(message.removeprefix(str(tmp_path))) < 300


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_splats(tmp_path / "none.ply")
    with pytest.raises(InputError, match="is a folder"):
        read_splats(tmp_path)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write_splats(tmp_path / "a.ply", random_splats(3))
    before = (tmp_path / "a.ply").read_bytes()
    bad = random_splats(3)
    object.__setattr__(bad, "rotation", bad.rotation[:2])
    with pytest.raises(ValueError):
        write_splats(tmp_path / "a.ply", bad)
    assert (tmp_path / "a.ply").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]
