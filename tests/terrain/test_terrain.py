"""Terrain from made-up splats whose ground is known."""

import numpy as np
import pytest
from scipy import ndimage

import factories
from rainsim import terrain
from rainsim.config.settings import TerrainConfig
from rainsim.errors import GroundError, InputError
from rainsim.scene.types import GroundFrame, Scene

GREY, GREEN, BROWN = (0.5, 0.5, 0.5), (0.25, 0.5, 0.2), (0.4, 0.3, 0.2)


def sheet(x, y, z, size, color, thin=0.0005):
    """Flat level splats at the given points."""
    n = x.size
    position = np.stack([x.ravel(), y.ravel(), np.broadcast_to(z, x.shape).ravel()], axis=1)
    sh = (np.asarray(color) - 0.5) / 0.28209479177387814
    return (position, np.tile((size, size, thin), (n, 1)), np.tile(sh, (n, 1, 1)))


def lattice(low, high, step):
    return np.meshgrid(np.arange(low, high, step), np.arange(low, high, step))


def scene_of(*parts, frame=None):
    """A scene from sheets given in ground metres, put into a tilted frame of other units."""
    if frame is None:
        a, b = 0.4, -1.1
        tilt = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        turn = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
        frame = GroundFrame(turn @ tilt, 0.6, np.array([0.3, -0.2, 1.1]))
    position = np.concatenate([p[0] for p in parts])
    scale = np.concatenate([p[1] for p in parts])
    sh = np.concatenate([p[2] for p in parts])
    # The splats' axes are the ground frame's.
    m = frame.rotation.T
    w = np.sqrt(max(1e-12, 1 + np.trace(m))) / 2
    q = np.array([w, (m[2, 1] - m[1, 2]) / (4 * w), (m[0, 2] - m[2, 0]) / (4 * w),
                  (m[1, 0] - m[0, 1]) / (4 * w)])  # fmt: skip
    place = frame.to_capture(position)
    splats = factories.splats(place, q, scale / frame.meters_per_unit, sh=sh)
    return Scene("made", splats, (), frame)


def dip(x, y, deep=0.02, radius=0.4):
    r = np.hypot(x, y) / radius
    return np.where(r < 1, -deep * (1 - r * r) ** 2, 0)


def courtyard(frame=None):
    """Paving with a dip, a lawn in the west, a table over the dip, a solid box in the east."""
    x, y = lattice(-1.5, 1.5, 0.02)
    z = dip(x, y)
    lawn = x < -0.9
    paving = sheet(x[~lawn], y[~lawn], z[~lawn], 0.015, GREY)
    grass = sheet(x[lawn], y[lawn], 0.0, 0.015, GREEN)
    tx, ty = lattice(-0.3, 0.3, 0.02)
    table = sheet(tx, ty, 0.7, 0.015, BROWN)
    bx, by = lattice(0.8, 1.2, 0.02)
    box_top = sheet(bx, by, 0.4, 0.015, BROWN)
    return scene_of(paving, grass, table, box_top, frame=frame)


CONFIG = TerrainConfig(spacing=0.025, extent=1.4)


@pytest.fixture(scope="module")
def yard():
    return terrain.extract_terrain(courtyard(), CONFIG)


def centres(ground):
    ny, nx = ground.grid.shape
    x = ground.grid.origin[0] + (np.arange(nx) + 0.5) * ground.grid.spacing
    y = ground.grid.origin[1] + (np.arange(ny) + 0.5) * ground.grid.spacing
    return np.meshgrid(x, y)


def test_bed_is_that_of_the_splats_even_under_the_table(yard):
    x, y = centres(yard)
    error = yard.bed - dip(x, y)
    inside = (np.hypot(x, y) < 1.2) & (x > -0.8) & ~((x > 0.7) & (np.abs(y - 1) < 0.5))
    assert np.abs(error[inside]).max() < 0.003  # a 4 cm Gaussian flattens the dip's middle
    assert yard.bed[np.hypot(x, y) < 0.05].mean() < -0.015
    assert (yard.source[np.hypot(x, y) < 0.25] == terrain.MEASURED).all()


def test_cover_top_and_underside(yard):
    x, y = centres(yard)
    table = (np.abs(x) < 0.25) & (np.abs(y) < 0.25)
    np.testing.assert_allclose(yard.top[table], 0.7, atol=0.005)
    np.testing.assert_allclose(yard.underside[table], 0.7, atol=0.005)
    assert yard.covered[table].all()
    open_ground = (np.hypot(x, y) > 0.5) & (np.hypot(x, y) < 0.8)
    np.testing.assert_array_equal(yard.top[open_ground], yard.bed[open_ground])
    assert not yard.covered[open_ground].any()


def test_classes_by_colour(yard):
    x, y = centres(yard)
    assert (yard.ground_class[(x < -1.0) & (np.abs(y) < 1.2)] == terrain.GRASS).mean() > 0.95
    assert (yard.ground_class[(np.abs(x) < 0.7) & (np.abs(y) < 1.2)] == terrain.HARD).all()
    np.testing.assert_allclose(yard.color[(x > -0.7) & (np.hypot(x, y) < 0.6)], 0.5, atol=0.03)


def test_other_units_and_tilt_give_the_same_terrain(yard):
    identity = GroundFrame(np.eye(3), 1.0, np.zeros(3))
    plain = terrain.extract_terrain(courtyard(identity), CONFIG)
    np.testing.assert_allclose(plain.bed, yard.bed, atol=2e-5)
    # A cell on the lawn's very edge may fall to either side by rounding.
    assert np.mean(plain.ground_class != yard.ground_class) < 0.01


def test_noise_is_measured_and_smoothed():
    rng = np.random.default_rng(2)
    x, y = lattice(-1.5, 1.5, 0.02)
    rough = scene_of(sheet(x, y, rng.normal(0, 0.002, x.shape), 0.008, GREY))
    ground = terrain.extract_terrain(rough, CONFIG)
    cx, cy = centres(ground)
    inside = np.hypot(cx, cy) < 1
    assert 0.0005 < np.median(ground.noise[inside]) < 0.002
    assert ground.bed[inside].std() < 0.5 * np.median(ground.noise[inside])


def test_a_kerb_stays_sharp():
    x, y = lattice(-1.5, 1.5, 0.02)
    z = np.where(x > 0.2, 0.1, 0.0)
    ground = terrain.extract_terrain(scene_of(sheet(x, y, z, 0.01, GREY)), CONFIG)
    row = ground.bed[ground.grid.shape[0] // 2]
    cx = centres(ground)[0][0]
    np.testing.assert_allclose(row[cx < 0.1], 0, atol=0.01)
    np.testing.assert_allclose(row[(cx > 0.3) & (cx < 1)], 0.1, atol=0.01)


def test_jags_of_an_edge_go_and_walls_and_corners_stay():
    rng = np.random.default_rng(3)
    x = np.tile((np.arange(100) + 0.5) * 0.02, (100, 1))
    jags = rng.uniform(-0.03, 0.03, (100, 1))
    height = np.where(x > 1.0 + jags, np.float32(0.1), np.float32(0))
    step = np.abs(x - 1.0) < 0.08
    edge = terrain.bed.straighten(height, step, 0.02)
    assert (edge != height).mean() > 0.005
    assert np.abs((edge > 0.05).sum(axis=1) - 50).max() <= 1  # columns above; were 1.5 either way
    wall = np.where(np.abs(x - 1.0) < 0.045, np.float32(0.1), np.float32(0))
    np.testing.assert_array_equal(terrain.bed.straighten(wall, step, 0.02), wall)
    corner = np.where((x > 1) & (x.T > 1), np.float32(0.1), np.float32(0))
    around = ndimage.binary_dilation(corner > 0, iterations=4) & (x < 1.1)
    assert (terrain.bed.straighten(corner, around, 0.02) != corner).sum() < 12


def test_no_ground_is_an_error_with_the_remedy():
    x, y = lattice(-0.1, 0.1, 0.02)
    floating = scene_of(sheet(x, y, 1.0, 0.015, GREY))
    with pytest.raises(GroundError, match="--up"):
        terrain.extract_terrain(floating, CONFIG)


def test_round_trip_and_bad_files(yard, tmp_path):
    paths = terrain.write_terrain(tmp_path / "map", yard)
    assert all(p.is_file() and p.stat().st_size > 100 for p in paths)
    again = terrain.read_terrain(tmp_path / "map")
    assert again.grid == yard.grid and again.notes == yard.notes
    for name in ("bed", "top", "underside", "source", "ground_class", "noise", "color"):
        np.testing.assert_array_equal(getattr(again, name), getattr(yard, name))
    with pytest.raises(InputError, match="does not exist"):
        terrain.read_terrain(tmp_path / "nowhere")
    (tmp_path / "bad.npz").write_bytes(b"PK not really")
    with pytest.raises(InputError, match="no height map"):
        terrain.read_terrain(tmp_path / "bad.npz")


def test_inpainting_keeps_what_is_known_and_fills_between():
    values = np.tile(np.linspace(0, 1, 40, dtype=np.float32), (40, 1))
    known = np.ones((40, 40), bool)
    known[15:25, 15:25] = False
    holed = np.where(known, values, np.float32(99))
    filled = terrain.inpaint(holed, known)
    np.testing.assert_array_equal(filled[known], values[known])
    np.testing.assert_allclose(filled, values, atol=0.06)
