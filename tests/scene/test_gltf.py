"""Splats in binary glTF: values, nodes, quantized numbers, and what is refused."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import made_formats as made
from rainsim.errors import InputError
from rainsim.scene.formats import read
from rainsim.scene.harmonics import basis, padded

HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # of y up to y down
SPLATS = made.tame_splats(40, 9)


def reading(folder, data):
    (folder / "a.glb").write_bytes(data)
    return read(folder / "a.glb")


def covariances(splats):
    axes = Rotation.from_quat(np.roll(splats.rotation, -1, axis=1)).as_matrix()
    axes = axes * splats.scale[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def colors(splats, directions):
    return np.einsum("dk,nkc->ndc", basis(directions), padded(splats.sh, 16))


def check_placed(found, stored, matrix, rotation, tolerance=1e-5):
    """Places, covariances and colours are those of splats that a matrix (3, 4) has placed."""
    np.testing.assert_allclose(
        found.position, stored.position @ matrix[:, :3].T + matrix[:, 3], atol=tolerance
    )
    np.testing.assert_allclose(
        covariances(found), matrix[:, :3] @ covariances(stored) @ matrix[:, :3].T, atol=tolerance
    )
    ways = np.random.default_rng(1).normal(size=(20, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    np.testing.assert_allclose(
        colors(found, ways @ rotation.T), colors(stored, ways), atol=10 * tolerance
    )
    np.testing.assert_allclose(found.opacity, stored.opacity, atol=tolerance)


def test_splats_are_turned_half_about_z(tmp_path):
    found = reading(tmp_path, made.glb(SPLATS))
    assert found.format == "glTF" and found.broken == 0 and not found.notes
    made.check_arrays(found.splats)
    check_placed(found.splats, SPLATS, HALF_TURN @ np.eye(4)[:3], HALF_TURN)


@pytest.mark.parametrize("scale", [(0.5, 0.5, 0.5), (0.5, 2.0, 1.0)])
def test_nodes_turn_move_and_scale(tmp_path, scale):
    inner = Rotation.from_euler("xyz", (20, -50, 80), degrees=True)
    outer = np.eye(4)
    outer[:3, :3] = 3 * Rotation.from_euler("xyz", (70, 10, 5), degrees=True).as_matrix()
    outer[:3, 3] = 1, 2, 3
    own = np.eye(4)
    own[:3, :3] = inner.as_matrix() * scale
    own[:3, 3] = -4, 0, 1
    nodes = [
        {"matrix": outer.T.ravel().tolist(), "children": [1]},
        {
            "mesh": 0, "translation": own[:3, 3].tolist(), "rotation": inner.as_quat().tolist(),
            "scale": scale,
        },
    ]  # fmt: skip
    found = reading(tmp_path, made.glb(SPLATS, nodes))
    made.check_arrays(found.splats)
    turn = HALF_TURN @ outer[:3, :3] / 3 @ inner.as_matrix()
    check_placed(found.splats, SPLATS, HALF_TURN @ (outer @ own)[:3], turn)


def test_a_mesh_in_two_nodes_is_there_twice(tmp_path):
    nodes = [{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [9, 0, 0]}]
    found = reading(tmp_path, made.glb(SPLATS, nodes)).splats
    assert len(found) == 80
    apart = found.position[40:] - found.position[:40]
    np.testing.assert_allclose(apart, [[-9, 0, 0]] * 40, atol=1e-5)


def test_whole_numbers_are_shares_of_the_largest(tmp_path):
    types = {"ROTATION": "i2", "SCALE": "u2", "OPACITY": "u1"}
    found = reading(tmp_path, made.glb(SPLATS, types=types)).splats
    plain = reading(tmp_path, made.glb(SPLATS)).splats
    np.testing.assert_allclose(found.opacity, plain.opacity, atol=0.003)
    np.testing.assert_allclose(found.scale, plain.scale, atol=1e-5)
    assert not np.array_equal(found.scale, plain.scale)
    assert np.abs(np.einsum("ni,ni->n", found.rotation, plain.rotation)).min() > 0.9999


def test_scales_of_early_drafts_are_logarithms(tmp_path):
    plain = reading(tmp_path, made.glb(SPLATS)).splats
    early = dataclasses.replace(SPLATS, scale=np.log(SPLATS.scale))
    assert (early.scale < 0).any()
    found = reading(tmp_path, made.glb(early))
    assert found.broken == 0 and any("logarithms" in note for note in found.notes)
    np.testing.assert_allclose(found.splats.scale, plain.scale, rtol=1e-5)


def test_attributes_that_share_bytes_cannot_promise_more_than_the_file_holds(tmp_path):
    few = made.tame_splats(1 << 14, 1)
    nodes = [{"children": list(range(1, 41))}, *({"mesh": 0} for _ in range(40))]
    with pytest.raises(InputError, match="promises"):
        reading(tmp_path, made.glb(few, nodes))
    nodes = [{"children": [1, 2]}, *({"mesh": 0} for _ in range(2))]
    assert len(reading(tmp_path, made.glb(few, nodes)).splats) == 2 * len(few)


def test_other_ways_of_drawing_are_noted(tmp_path):
    found = reading(tmp_path, made.glb(SPLATS, about={"sortingMethod": "byHand", "kernel": "box"}))
    assert len(found.notes) == 2 and "box" in found.notes[0] and "byHand" in found.notes[1]


def test_broken_splats_are_dropped(tmp_path):
    splats = made.tame_splats(1000, 1)
    splats.opacity[:3] = 1.5, -0.1, np.nan
    splats.scale[3] = -1
    splats.rotation[4] = 0
    splats.position[5] = np.inf
    found = reading(tmp_path, made.glb(splats))
    assert found.broken == 6 and "dropped 6 of 1000" in found.notes[-1]
    made.check_arrays(found.splats)


REFUSED = {
    "compressed": ({"about": {"extensions": {"KHR_x_spz_2": {}}}}, "KHR_x_spz_2"),
    "linear": ({"about": {"colorSpace": "lin_rec709_display"}}, "colour space"),
    "required": ({"more": {"extensionsRequired": ["EXT_meshopt_compression"]}}, "meshopt"),
    "no splats": ({"more": {"meshes": [{"primitives": [{"attributes": {}}]}]}}, "without splats"),
    "mirrored": ({"nodes": [{"mesh": 0, "scale": [-1, 1, 1]}]}, "mirrors"),
    "flat": ({"nodes": [{"mesh": 0, "scale": [0, 1, 1]}]}, "scales by"),
    "a ring": ({"nodes": [{"children": [1]}, {"children": [0]}]}, "reached twice"),
    "cut views": ({"more": {"bufferViews": [{"buffer": 0}]}}, "bufferViews has no"),
    "another file": ({"more": {"buffers": [{"uri": "../a.bin"}]}}, "another file"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_read_is_one_line(tmp_path, case):
    how, expected = REFUSED[case]
    with pytest.raises(InputError, match=expected) as caught:
        reading(tmp_path, made.glb(SPLATS, **how))
    assert "\n" not in str(caught.value) and ";" in str(caught.value)
