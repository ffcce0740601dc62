"""Splat formats: what is written is read, whatever the file is called."""

import struct
import sys

import numpy as np
import pytest

import made_formats as made
import naive
from made_captures import random_splats
from made_formats import write_splats
from rainsim.errors import InputError
from rainsim.scene.folder import import_scene
from rainsim.scene.formats import read, read_splats
from rainsim.scene.formats.spz import UNSAID
from rainsim.scene.types import GroundFrame

UP = GroundFrame(np.eye(3), 1.0, np.zeros(3))


@pytest.fixture
def extra():
    """Skip unless the optional reader is installed."""
    for module in ("gsply", "imagecodecs", "zstandard"):
        pytest.importorskip(module)


def compare(found, splats, position, turn, scale, opacity, color, rest=None):
    """Compare with absolute tolerances; of `scale` relative, of `turn` up to the sign."""
    assert len(found) == len(splats)
    np.testing.assert_allclose(found.position, splats.position, atol=position)
    dots = np.abs(np.einsum("ni,ni->n", found.rotation, splats.rotation))
    assert dots.min() > 1 - turn
    np.testing.assert_allclose(found.scale, splats.scale, rtol=scale)
    np.testing.assert_allclose(found.opacity, splats.opacity, atol=opacity)
    np.testing.assert_allclose(found.sh[:, 0], splats.sh[:, 0], atol=color)
    if rest is not None:
        assert found.sh.shape == splats.sh.shape
        np.testing.assert_allclose(found.sh[:, 1:], splats.sh[:, 1:], atol=rest)
    made.check_arrays(found)


def test_splat_records(tmp_path):
    splats = made.tame_splats(300, 1)
    (tmp_path / "named.ply").write_bytes(made.splat_records(splats))  # the name lies
    reading = read(tmp_path / "named.ply")
    assert reading.format == ".splat" and reading.notes == ()
    compare(reading.splats, splats, 0, 1e-4, 1e-6, 0.003, 0.008)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize("with_colors", [True, False])
def test_compressed_ply(tmp_path, extra, coefficients, with_colors):
    splats = made.tame_splats(700, coefficients)  # two whole chunks and a part
    (tmp_path / "named.splat").write_bytes(made.compressed_ply(splats, with_colors))
    reading = read(tmp_path / "named.splat")
    assert reading.format == "compressed PLY" and reading.notes == ()
    compare(reading.splats, splats, 0.006, 1e-5, 0.005, 0.003, 0.01, 0.02)


def compare_turned(found, stored, turn, rng):
    """Compare places, shapes and colours with those of stored splats whose axes are turned."""
    np.testing.assert_allclose(found.position, stored.position @ turn, atol=2e-4)
    for s in range(10):
        parts = [naive.quaternion_matrix(q.rotation[s]) * q.scale[s] for q in (stored, found)]
        expected, got = (axes @ axes.T for axes in parts)
        np.testing.assert_allclose(got, turn @ expected @ turn, atol=0.12 * np.abs(expected).max())
    bands = round(stored.sh.shape[1] ** 0.5)
    for direction in rng.normal(size=(4, 3)):
        direction /= np.linalg.norm(direction)
        before = np.einsum("k,nkc->nc", naive.sh_basis(turn @ direction, bands), stored.sh)
        after = np.einsum("k,nkc->nc", naive.sh_basis(direction, bands), found.sh)
        np.testing.assert_allclose(after, before, atol=0.04)
    made.check_arrays(found)


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_spz_is_turned_into_the_frame_of_the_others(tmp_path, extra, version, coefficients, rng):
    stored = made.tame_splats(500, coefficients)  # these are x right, y up, z back
    (tmp_path / "a.bin").write_bytes(made.spz(stored, version))
    reading = read(tmp_path / "a.bin")
    assert reading.format == "SPZ" and reading.notes == (UNSAID,)
    np.testing.assert_allclose(reading.splats.opacity, stored.opacity, atol=0.003)
    np.testing.assert_allclose(reading.splats.scale, stored.scale, rtol=0.04)
    compare_turned(reading.splats, stored, np.diag([1.0, -1.0, -1.0]), rng)


def test_spz_rotations_are_as_exact_as_their_bits(tmp_path, extra):
    stored = made.tame_splats(500)
    for version, slack in ((2, 4e-3), (3, 1e-5), (4, 1e-5)):
        (tmp_path / "a.spz").write_bytes(made.spz(stored, version))
        turned = read_splats(tmp_path / "a.spz")[0].rotation * np.float32([1, 1, -1, -1])
        assert np.abs(np.einsum("ni,ni->n", turned, stored.rotation)).min() > 1 - slack


def test_spz_flags_are_noted(tmp_path, extra):
    other = struct.pack("<III", 0xADBE0002, 4, 9)
    data = made.spz(made.tame_splats(9), 3, flags=3, behind=other)
    (tmp_path / "a.spz").write_bytes(data)
    notes = read_splats(tmp_path / "a.spz")[1]
    assert "Mip-Splatting" in notes[1] and "extensions" in notes[2]


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("axes", [1, 2, 4, 6, 7, 8, 9])
def test_an_extension_names_the_axes_of_spz(tmp_path, extra, version, axes, rng):
    stored = made.tame_splats(50, 16)
    extension = struct.pack("<III", 0xDEAD0001, 4, 9) + struct.pack("<III", 0xADBE0003, 4, axes)
    (tmp_path / "a.spz").write_bytes(made.spz(stored, version, flags=2, behind=extension))
    if axes > 8:
        with pytest.raises(InputError, match="y and z axes exchanged"):
            read(tmp_path / "a.spz")
        return
    found = read(tmp_path / "a.spz")
    assert UNSAID not in found.notes
    right, up, forward = ((axes - 1) & bit for bit in (1, 2, 4))
    turn = np.diag([1.0 if right else -1.0, -1.0 if up else 1.0, 1.0 if forward else -1.0])
    compare_turned(found.splats, stored, turn, rng)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_sog_in_a_folder_and_in_one_file(tmp_path, extra, coefficients):
    splats = made.tame_splats(700, coefficients)
    files = made.sog(splats)
    folder = made.write_folder(tmp_path / "sog", files)
    (tmp_path / "plain.ply").write_bytes(made.bundle(files))
    (tmp_path / "deep.sog").write_bytes(made.bundle(files, 8, "inside/"))
    for path in (folder, folder / "meta.json", tmp_path / "plain.ply", tmp_path / "deep.sog"):
        reading = read(path)
        assert reading.format.startswith("SOG") and reading.notes == ()
        compare(reading.splats, splats, 5e-4, 1e-4, 0.02, 0.003, 0.005, 0.005)


def test_sog_of_the_first_version(tmp_path, extra):
    splats = made.tame_splats(700, 1)
    reading = read(made.write_folder(tmp_path / "sog", made.sog_v1(splats)))
    compare(reading.splats, splats, 5e-4, 1e-4, 0.03, 0.01, 0.01)


# --- relatives of the original PLY ----------------------------------------------------------------


def test_2dgs_discs_are_thin_along_their_third_axis(tmp_path):
    splats = random_splats(50)
    columns = made.stored_columns(splats)
    del columns["scale_2"]
    (tmp_path / "a.ply").write_bytes(made.ply(columns))
    found, notes = read_splats(tmp_path / "a.ply")
    np.testing.assert_allclose(found.scale[:, :2], splats.scale[:, :2], rtol=1e-5)
    np.testing.assert_allclose(found.scale[:, 2], 1e-3 * splats.scale[:, :2].min(1), rtol=1e-5)
    np.testing.assert_allclose(found.rotation, splats.rotation, atol=1e-6)
    assert len(notes) == 1 and "2DGS" in notes[0]


def test_3d_filter_of_mip_splatting_and_gof(tmp_path):
    splats = random_splats(50)
    width = np.random.default_rng(1).uniform(0, 0.1, 50).astype(np.float32)
    width[0] = 0
    columns = made.stored_columns(splats) | {"filter_3D": width}
    (tmp_path / "a.ply").write_bytes(made.ply(columns))
    found, notes = read_splats(tmp_path / "a.ply")
    # The projects' formula: scales add in squares, opacity times sqrt(det before / det after).
    before = splats.scale.astype(float) ** 2
    after = before + width.astype(float)[:, None] ** 2
    np.testing.assert_allclose(found.scale, np.sqrt(after), rtol=1e-5)
    opacity = splats.opacity * np.sqrt(before.prod(axis=1) / after.prod(axis=1))
    np.testing.assert_allclose(found.opacity, opacity, rtol=1e-4)
    np.testing.assert_allclose(found.opacity[0], splats.opacity[0], rtol=1e-5)
    assert (found.opacity[1:] < splats.opacity[1:]).all()
    assert len(notes) == 1 and "filter_3D" in notes[0]


def test_3d_filter_of_splats_so_small_that_squares_vanish(tmp_path):
    splats = random_splats(1)
    splats.scale[:] = 1e-20
    columns = made.stored_columns(splats) | {"filter_3D": np.float32([1e-20])}
    (tmp_path / "a.ply").write_bytes(made.ply(columns))
    found, _ = read_splats(tmp_path / "a.ply")
    np.testing.assert_allclose(found.scale, np.sqrt(2) * 1e-20, rtol=1e-4)
    np.testing.assert_allclose(found.opacity, splats.opacity / 2**1.5, rtol=1e-4)


def test_gaussian_shader_shows_its_base_color(tmp_path):
    splats = random_splats(40, 1)
    columns = made.stored_columns(splats)
    extras = ("nx2", "ny2", "nz2", *(f"f_rest_{i}" for i in range(12)), "roughness")
    columns |= {name: np.ones(40) for name in (*extras, "specular0", "specular1", "specular2")}
    (tmp_path / "a.ply").write_bytes(made.ply(columns))
    found, notes = read_splats(tmp_path / "a.ply")
    assert found.sh.shape == (40, 1, 3)
    color = found.sh[:, 0] * made.SH_C0 + 0.5
    expected = 1 / (1 + np.exp(-(splats.sh[:, 0].astype(float) - np.log(3))))
    np.testing.assert_allclose(color, expected, atol=1e-5)
    assert len(notes) == 1 and "specular colour" in notes[0] and "dropped" in notes[0]


@pytest.mark.parametrize("name", ["filter_3D", "f_dc_1", "scale_1"])
def test_broken_values_of_the_variants_are_counted(tmp_path, name):
    columns = made.stored_columns(random_splats(1000, 1)) | {
        "filter_3D": np.full(1000, 0.01), "roughness": np.ones(1000), "specular0": np.ones(1000),
    }  # fmt: skip
    columns[name] = np.array(columns[name], np.float32)
    columns[name][:3] = np.nan, np.inf, -np.inf
    (tmp_path / "a.ply").write_bytes(made.ply(columns))
    reading = read(tmp_path / "a.ply")
    # A scale whose logarithm is minus infinity is zero; the other values have no such excuse.
    bad = 2 if name == "scale_1" else 3
    assert reading.broken == bad and len(reading.splats) == 1000 - bad
    assert f"dropped {bad} of 1000" in reading.notes[-1]
    made.check_arrays(reading.splats)


def test_infinite_logits_and_logarithms_have_a_meaning(tmp_path):
    splats = random_splats(100, 1)
    columns = {n: np.array(c, np.float32) for n, c in made.stored_columns(splats).items()}
    columns["opacity"][:60] = np.inf  # as splat-transform writes opaque splats
    columns["opacity"][60:80] = -np.inf
    columns["scale_2"][80:] = -np.inf
    (tmp_path / "a.ply").write_bytes(made.ply(columns))
    reading = read(tmp_path / "a.ply")
    assert reading.broken == 0 and len(reading.splats) == 100 and not reading.notes
    assert (reading.splats.opacity[:60] == 1).all() and (reading.splats.opacity[60:80] == 0).all()
    assert (reading.splats.scale[80:, 2] == 0).all() and (reading.splats.scale[:80] > 0).all()
    made.check_arrays(reading.splats)
    columns["opacity"][:60] = np.nan
    (tmp_path / "a.ply").write_bytes(made.ply(columns))
    with pytest.raises(InputError, match="60 of 100 splats"):
        read(tmp_path / "a.ply")


# --- telling formats apart ------------------------------------------------------------------------


UNKNOWN = {
    "empty": (b"", "it is empty"),
    "text": (b"I am a text of at least thirty-two letters, really.\n" * 9, "no splat file"),
    "glb": (b"glTF" + bytes(60), "glTF"),
    "picture": (b"\x89PNG\r\n\x1a\n" + bytes(99), "picture"),
    "noise": (np.random.default_rng(0).bytes(3200), "no splat file"),
    "zeros": (bytes(3200), "no splat file"),
    "json": (b'{"frames": []}', "does not describe splats"),
    "gltf": (b'{"asset": {"version": "2.0"}}', "a glTF in text; export it as binary"),
    "a capture's zip": (
        made.bundle({"cameras.json": b"[]", "a/point_cloud.ply": b"ply"}),
        "the capture a/point_cloud.ply in it.*unpack the zip",
    ),
    "pointer": (b"version https://git-lfs.github.com/spec/v1\noid sha256:12\n", "git lfs pull"),
    "usd": (b"PXR-USDC" + bytes(80), "its name must end in .usd"),
    "unpacked spz": (__import__("gzip").decompress(made.spz(made.tame_splats(9))), "unpacked"),
    "other zip": (made.bundle({"a.txt": b"hello"}), "0 meta.json"),
    "other gzip": (__import__("gzip").compress(b"hello" * 9), "gzip but not SPZ"),
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_other_files_are_refused_in_one_line(tmp_path, case):
    data, expected = UNKNOWN[case]
    (tmp_path / "some.splat").write_bytes(data)
    with pytest.raises(InputError, match=expected) as caught:
        read(tmp_path / "some.splat")
    assert "\n" not in str(caught.value) and str(tmp_path) in str(caught.value)


def test_a_ksplat_is_named_by_its_suffix(tmp_path):
    (tmp_path / "a.ksplat").write_bytes(made.splat_records(made.tame_splats(50, 1)))
    with pytest.raises(InputError, match="one viewer's own"):
        read(tmp_path / "a.ksplat")


def test_missing_extra_is_named_with_the_command_that_installs_it(tmp_path, extra, monkeypatch):
    splats = made.tame_splats(30, 1)
    write_splats(tmp_path / "plain.ply", splats)
    cases = {
        "gsply": {"c.ply": made.compressed_ply(splats), "a.spz": made.spz(splats, 3)},
        "imagecodecs": {"a.sog": made.bundle(made.sog(splats))},
        "zstandard": {"a.spz": made.spz(splats, 4)},
    }
    for module, files in cases.items():
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, module, None)
            for name, data in files.items():
                (tmp_path / name).write_bytes(data)
                command = rf'{module}; pip install "rainsim\[formats\]"'
                with pytest.raises(InputError, match=command):
                    read(tmp_path / name)
            assert len(read(tmp_path / "plain.ply").splats) == 30


def test_import_takes_each_format(tmp_path, extra):
    splats = made.tame_splats(200, 4)
    write_splats(tmp_path / "a.ply", splats)
    (tmp_path / "b.ply").write_bytes(made.compressed_ply(splats))
    (tmp_path / "c.spz").write_bytes(made.spz(splats, 4))
    (tmp_path / "d.splat").write_bytes(made.splat_records(splats))
    (tmp_path / "e.sog").write_bytes(made.bundle(made.sog(splats)))
    made.write_folder(tmp_path / "f", made.sog(splats))
    hashes = set()
    (tmp_path / "g.glb").write_bytes(made.glb(splats))
    for name in ("a.ply", "b.ply", "c.spz", "d.splat", "e.sog", "f", "g.glb"):
        scene = import_scene(tmp_path / name, ground_frame=UP)
        assert len(scene.splats) == 200 and scene.name == name.partition(".")[0]
        hashes.add(scene.source_hash)
    assert len(hashes) == 7
    (tmp_path / "f/scales.webp").write_bytes((tmp_path / "f/sh0.webp").read_bytes())
    assert import_scene(tmp_path / "f", ground_frame=UP).source_hash not in hashes


# --- samples --------------------------------------------------------------------------------------


def test_the_same_object_in_two_formats(extra, shared):
    data = shared("data/formats")
    spz, packed = (read(data / f"biker.{e}").splats for e in ("spz", "compressed.ply"))
    assert len(spz) == len(packed) == 152_746
    np.testing.assert_allclose(spz.position, packed.position, atol=5e-4)
    assert np.median(np.abs(np.log(spz.scale / packed.scale))) < 0.03
    np.testing.assert_allclose(spz.opacity, packed.opacity, atol=0.01)
    np.testing.assert_allclose(spz.sh, packed.sh, atol=0.05)
    turn = np.abs(np.einsum("ni,ni->n", spz.rotation, packed.rotation))
    assert np.median(turn) > 0.99999 and np.quantile(turn, 0.01) > 0.999


def test_samples_hold_what_their_description_says(extra, shared):
    data = shared("data")
    samples = {
        "truck.splat": (116_544, 1),
        "flowers_sog": (26_895, 9),
        "formats/environment.sog": (8_688, 1),
        "formats/train_1000_sh3.ply": (1_000, 16),
    }
    for name, (count, coefficients) in samples.items():
        splats, notes = read_splats(data / name)
        assert splats.sh.shape == (count, coefficients, 3) and notes == [], name
        made.check_arrays(splats)
    flowers = read_splats(data / "flowers_sog")[0]
    assert np.ptp(np.percentile(flowers.position[:, 0], (1, 99))) == pytest.approx(0.65, abs=0.1)
