"""Height maps from meshes and TIFFs."""

import numpy as np
import pytest

from rainsim.config.settings import TerrainConfig
from rainsim.errors import InputError, ParameterError
from rainsim.io import images
from rainsim.io.rasters import read_raster
from rainsim.terrain import MEASURED, UNKNOWN, is_surface, terrain_from_surface, write_terrain

CONFIG = TerrainConfig(spacing=0.05)


def hill(side=21):
    """Points and triangles of a smooth hill on 2 x 2 m."""
    u = np.linspace(-1, 1, side)
    x, y = np.meshgrid(u, u)
    points = np.stack([x, y, 0.3 * np.exp(-4 * (x * x + y * y))], axis=-1).reshape(-1, 3)
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    lower, upper = [a, a + 1, a + side], [a + 1, a + side + 1, a + side]
    return points, np.concatenate([np.stack(lower, 1), np.stack(upper, 1)])


def write_obj(path, points, triangles):
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in triangles]
    path.write_text("# a hill\n" + "\n".join(lines) + "\n")


def write_ply(path, points, triangles, form):
    head = f"ply\nformat {form} 1.0\nelement vertex {len(points)}\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    head += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    if form == "ascii":
        rows = [" ".join(map(str, p)) for p in points]
        rows += [f"3 {a} {b} {c}" for a, b, c in triangles]
        path.write_text(head + "\n".join(rows) + "\n")
        return
    order = "<" if "little" in form else ">"
    faces = np.zeros(len(triangles), [("n", "u1"), ("i", order + "i4", 3)])
    faces["n"], faces["i"] = 3, triangles
    path.write_bytes(head.encode() + points.astype(order + "f4").tobytes() + faces.tobytes())


def expected(ground):
    x, y = np.meshgrid(*ground.grid.centres())
    return 0.3 * np.exp(-4 * (x * x + y * y))


@pytest.mark.parametrize("form", ["obj", "ascii", "binary_little_endian", "binary_big_endian"])
def test_a_mesh_becomes_its_heights(form, tmp_path):
    points, triangles = hill()
    path = tmp_path / ("hill.obj" if form == "obj" else "hill.ply")
    if form == "obj":
        write_obj(path, points, triangles)
    else:
        write_ply(path, points, triangles, form)
    assert is_surface(path)
    ground = terrain_from_surface(path, CONFIG)
    assert ground.grid.shape == (40, 40) and (ground.source == MEASURED).all()
    np.testing.assert_allclose(ground.bed, expected(ground), atol=0.01)
    np.testing.assert_array_equal(ground.bed, ground.top)


def test_up_scale_and_holes(tmp_path):
    points, triangles = hill()
    turned = points[:, [1, 2, 0]] / 2  # y up, two metres per unit
    centre = points[triangles].mean(axis=1)
    keep = ~((np.abs(centre[:, 0] - 0.6) < 0.15) & (np.abs(centre[:, 1]) < 0.15))
    write_obj(tmp_path / "hill.obj", turned, triangles[keep])
    ground = terrain_from_surface(tmp_path / "hill.obj", CONFIG, up=(0, 1, 0), meters_per_unit=2.0)
    assert ground.grid.shape == (40, 40)
    hole = ground.source == UNKNOWN
    assert 0 < hole.sum() < 100 and ground.soaks[hole].all() and ground.sealed[~hole].all()
    assert ground.bed.max() == pytest.approx(0.3, abs=0.01)


def test_the_upper_of_two_surfaces_counts(tmp_path):
    points, triangles = hill(5)
    above = points + np.array([0, 0, 1])
    write_obj(tmp_path / "two.obj", np.concatenate([above, points]),
              np.concatenate([triangles, triangles + len(points)]))  # fmt: skip
    assert terrain_from_surface(tmp_path / "two.obj", CONFIG).bed.min() > 0.9


def test_a_tiff_is_taken_as_it_is(tmp_path):
    heights = np.arange(12, dtype=np.float32).reshape(3, 4) / 10
    heights[0, 0] = -9999e30
    images.write_tagged(tmp_path / "h.tif", heights, {})
    ground = terrain_from_surface(tmp_path / "h.tif", TerrainConfig(spacing=0.5))
    np.testing.assert_array_equal(ground.bed[:2], heights[:0:-1])
    assert ground.source[2, 0] == UNKNOWN and ground.grid.origin == (-1.0, -0.75)


def test_a_map_that_says_its_cells_needs_no_spacing(tmp_path):
    (tmp_path / "h.asc").write_text("ncols 3\nnrows 3\nxllcorner 0\nyllcorner 0\ncellsize 2\n"
                                    "1 2 3\n1 -9999 3\n1 2 3\n")  # fmt: skip
    ground = terrain_from_surface(tmp_path / "h.asc", TerrainConfig())
    assert ground.grid.spacing == 2 and ground.source[1, 1] == UNKNOWN
    write_terrain(tmp_path, ground)
    again = read_raster(tmp_path / "bed.tif")
    assert again.spacing == 2 and again.corner == (-3, -3)
    np.testing.assert_array_equal(again.values, ground.bed)
    images.write_tagged(tmp_path / "none.tif", ground.bed, {})
    with pytest.raises(ParameterError, match="give --spacing"):
        terrain_from_surface(tmp_path / "none.tif", TerrainConfig())


@pytest.mark.parametrize(
    "text, message",
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("v 0 0 0\nf 1 2 3\n", "names vertex 2"),
        ("v 0 zero 0\n", "line 1"),
        ("v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "not finite"),
    ],
)
def test_broken_meshes_are_told(text, message, tmp_path):
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(InputError, match=message):
        terrain_from_surface(tmp_path / "bad.obj", CONFIG)


def test_a_cut_ply_and_a_huge_map_are_told(tmp_path):
    points, triangles = hill(5)
    path = tmp_path / "cut.ply"
    write_ply(path, points, triangles, "binary_little_endian")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match="no mesh that can be read"):
        terrain_from_surface(path, CONFIG)
    write_obj(tmp_path / "big.obj", points * 1e4, triangles)
    with pytest.raises(ParameterError, match="too large"):
        terrain_from_surface(tmp_path / "big.obj", CONFIG)
    with pytest.raises(ParameterError, match="do not apply"):
        images.write_tagged(tmp_path / "h.tif", np.zeros((4, 4), np.float32), {})
        terrain_from_surface(tmp_path / "h.tif", CONFIG, up=(0, 0, 1))
