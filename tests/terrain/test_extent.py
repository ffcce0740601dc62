"""Cell size and extent of the height map: chosen, told why, and bounded."""

import numpy as np
import pytest

from made_captures import ring, splats_at
from rainsim.config.settings import TerrainConfig
from rainsim.errors import ParameterError
from rainsim.scene.cameras import look_at
from rainsim.scene.types import GroundFrame, Scene
from rainsim.terrain import choose_grid
from rainsim.terrain.map_size import AUTO_CELLS, choose_spacing

FRAME = GroundFrame(np.eye(3), 1.0, np.zeros(3))


def made(points, cameras=()):
    return Scene("made", splats_at(np.asarray(points, float)), tuple(cameras), FRAME)


def ground(half, step, offset=(0.0, 0.0)):
    u = np.arange(-half, half, step)
    x, y = np.meshgrid(u + offset[0], u + offset[1])
    return np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])


def test_without_cameras_the_map_is_where_the_splats_are():
    grid, notes = choose_grid(made(ground(1.5, 0.02, (7.0, -3.0))), TerrainConfig())
    assert grid.size == pytest.approx((2.9, 2.9), abs=0.1)
    assert grid.origin == pytest.approx((5.55, -4.45), abs=0.1)
    assert "as far as splats lie" in notes[0] and grid.spacing == 0.02


def test_a_few_metres_in_a_scene_of_ten_kilometres():
    rng = np.random.default_rng(1)
    far = rng.uniform(-5000, 5000, (300, 3))
    grid, _ = choose_grid(made(np.concatenate([ground(5, 0.05), far])), TerrainConfig())
    assert max(grid.size) < 11
    far = np.concatenate([ground(5, 0.05), far])
    grid, _ = choose_grid(made(far, ring()), TerrainConfig())
    assert max(grid.size) < 12


def test_cameras_round_a_small_thing_need_no_map_behind_it():
    grid, notes = choose_grid(made(ground(3.5, 0.03), ring(radius=3.2)), TerrainConfig())
    assert max(grid.size) < 2 * 3.5 + 1.2 and "as far as splats lie" in notes[0]
    wide, notes = choose_grid(made(ground(12, 0.05), ring(radius=3.2)), TerrainConfig())
    assert 9 < max(wide.size) < 10 and "the cameras' reach" in notes[0]


def test_a_drive_sees_what_lies_ahead_of_its_end():
    drive = [look_at((x, 0, 1.5), (x + 4, 0, 1), (0, 0, 1), 60, 64, 48) for x in range(0, 40, 2)]
    grid, _ = choose_grid(made(ground(60, 0.2), drive), TerrainConfig())
    first, last = grid.origin[0], grid.origin[0] + grid.size[0]
    assert first > -8 and last > 38 + 14


@pytest.mark.parametrize(
    ("half", "gap", "footprint", "spacing", "why"),
    [
        (4.0, 0.01, 0.001, 0.02, "as usual"),
        (0.5, 0.001, None, 0.006, "the map is small"),
        (4.0, 0.10, 0.001, 0.05, "splats lie 10 cm apart"),
        (8.0, 0.01, 0.03, 0.03, "the cameras' pixels"),
        (400.0, 0.01, None, 0.5, "the map is wide"),
        (4000.0, 0.01, None, 0.5, "the map is wide"),
    ],
)
def test_the_cell_size_follows_from_what_can_be_seen(half, gap, footprint, spacing, why):
    assert choose_spacing(np.full(2, half), gap, footprint) == (spacing, why)


def test_a_chosen_map_fits_the_memory_and_a_given_one_is_refused():
    grid, _ = choose_grid(made(ground(300, 4.0)), TerrainConfig())
    assert grid.shape[0] * grid.shape[1] <= 2 * AUTO_CELLS
    with pytest.raises(ParameterError, match=r"larger --spacing or a smaller --extent"):
        choose_grid(made(ground(3, 0.05)), TerrainConfig(spacing=0.01, extent=100.0))
