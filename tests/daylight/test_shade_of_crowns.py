"""Below a crown a splat's own colour says how much of it the sun shone on."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rainsim.daylight import relight
from rainsim.daylight.light import Light
from rainsim.daylight.lit_surface import Surface, surface_of
from rainsim.daylight.visibility import solids_of, with_plane
from rainsim.surface.fuse import CaptureSurface, planes

STEP, SIDE = 0.05, 48  # m, splats
UP = np.array([0.0, 0.0, 1.0])
RATIO = np.array([4.0, 3.0, 2.0])  # sun over sky
STONE, MOSS = np.array([0.2, 0.19, 0.17]), np.array([0.03, 0.09, 0.02])


@pytest.fixture(scope="module")
def floor():
    """A floor that is in the sun to the left, and has flecks of sun and moss to the right.

    Returns the surface, the light of its sky, the sun's true share and where moss grows.
    """
    rng = np.random.default_rng(3)
    row, column = np.mgrid[:SIDE, :SIDE].reshape(2, -1)
    position = np.stack([column * STEP, row * STEP, np.zeros(row.size)], -1).astype(np.float32)
    flecks = rng.random((SIDE // 4, SIDE // 4)) < 0.3
    share = np.where(column < SIDE // 2, 1.0, flecks[row // 4, column // 4])
    moss = (column > SIDE * 3 // 4) & (row < SIDE // 4)
    share[moss] = 0
    paint = np.where(moss[:, None], MOSS, STONE) * rng.uniform(0.85, 1.15, (row.size, 1))
    count = len(position)
    full = np.ones(count, np.float32)
    normal = np.tile(UP.astype(np.float32), (count, 1))
    neighbours = cKDTree(position).query(position, k=9)[1].astype(np.int32)
    color = (paint * (0.8 + share[:, None] * RATIO)).astype(np.float32)
    surface = Surface(position, normal, full, color, neighbours, full)
    sky, none = np.full((count, 3), 0.8, np.float32), np.zeros((count, 3), np.float32)
    light = Light(sky, full, np.zeros((count, 2), np.float32), none)
    return surface, light, share, moss


def shares_by_color(floor, plane):
    surface, light, _, _ = floor
    mapped = (surface.position[:, 0] < STEP * (SIDE // 2 - 0.5)).astype(np.float32)
    below = np.where(mapped > 0, np.float32(1), np.float32(plane))
    return relight.by_color(surface, (mapped, mapped), below, light, UP, RATIO)


def test_flecks_of_sun_below_a_crown_are_found_by_their_color(floor):
    _, _, share, moss = floor
    found = shares_by_color(floor, plane=1)
    right = (floor[0].position[:, 0] > STEP * SIDE / 2) & ~moss
    assert 0.1 < share[right].mean() < 0.5
    assert np.abs(found - share)[right].mean() < 0.05
    assert found[right & (share == 1)].min() > 0.5


def test_another_paint_is_not_taken_for_shade_or_sun(floor):
    _, _, _, moss = floor
    # The median over neighbours may bring a fleck from beside the moss.
    assert np.mean(shares_by_color(floor, plane=1)[moss] == 0) > 0.8


def test_paint_may_contradict_the_shade_of_a_wall(floor):
    _, _, share, moss = floor
    right = (floor[0].position[:, 0] > STEP * SIDE / 2) & ~moss
    found = shares_by_color(floor, plane=0)
    # Flecks that are as much brighter as the sun is are in the sun, whatever the map says.
    assert found[right & (share == 1)].mean() > 0.8
    assert found[right & (share == 0)].mean() < 0.2 and (found[moss] == 0).mean() > 0.8


def test_leaves_are_no_part_of_what_lies_in_planes():
    rng = np.random.default_rng(5)
    count = 400
    board = np.column_stack([rng.uniform(-1, 1, (count, 2)), np.full(count, 1.0)])
    leaves = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(2, 3, count)])
    position = np.concatenate([board, leaves]).astype(np.float32)
    size = np.full(2 * count, 0.12, np.float32)
    normal, flat, _ = planes(position, np.tile(UP, (2 * count, 1)), size, np.zeros(2 * count, "f4"))
    seen = np.full(2 * count, 5, np.uint8)
    surface = surface_of(CaptureSurface(position, normal, flat, 0 * position, size, seen))
    solids = solids_of(surface)
    plane = with_plane(solids, surface)
    assert len(solids.reach) == 2 * count
    assert (plane.position[:, 2] < 1.5).sum() > 0.95 * count  # the board
    assert (plane.position[:, 2] > 1.5).sum() < 0.05 * count  # leaves that lie alike by chance
