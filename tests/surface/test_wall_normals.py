"""Splats of windows, sills and edges face as the wall does that they belong to; others do not."""

import numpy as np
import pytest

from rainsim.surface.fuse import CaptureSurface
from rainsim.surface.wall_normals import wall_normals

OUT = np.array([0.6, 0.8, 0], np.float32)  # the wall's normal
ALONG = np.array([-0.8, 0.6, 0], np.float32)
PLANE = 2.0  # m


def at(along, up, before=0.0):
    """Return a place beside the wall, in metres."""
    return (PLANE + before) * OUT + along * ALONG + np.array([0, 0, up], np.float32)


def wall(hole=((4.0, 5.2), (0.9, 2.0)), flat=1.0):
    """Return a `CaptureSurface`: a wall of 8 x 3 m with a hole, and level ground before it."""
    along, up = (a.ravel() for a in np.meshgrid(np.arange(0, 8, 0.05), np.arange(0, 3, 0.05)))
    inside = np.logical_and.reduce(
        [hole[0][0] < along, along < hole[0][1], hole[1][0] < up, up < hole[1][1]]
    )
    places = np.array([at(*place) for place in zip(along[~inside], up[~inside], strict=True)])
    ground = np.array([at(a, 0.0, b) for a in np.arange(0, 8, 0.2) for b in np.arange(0.2, 4, 0.2)])
    position = np.concatenate([places, ground]).astype(np.float32)
    normal = np.concatenate([np.tile(OUT, (len(places), 1)), np.tile([0, 0, 1], (len(ground), 1))])
    count = len(position)
    return CaptureSurface(
        position, normal.astype(np.float32), np.full(count, flat, np.float32),
        np.full((count, 3), 0.5, np.float32), np.full(count, 0.04, np.float32),
        np.full(count, 9, np.uint8),
    )  # fmt: skip


def share_of(surface, *places):
    normal, share = wall_normals(np.array(places, np.float32), surface)
    np.testing.assert_allclose(normal[share > 0], np.tile(OUT, (np.sum(share > 0), 1)), atol=1e-6)
    return share


@pytest.mark.parametrize("place", [
    (1.0, 1.5, 0.0), (1.0, 1.5, 0.15),  # on the wall, and haze before it
    (1.0, 1.5, -0.3),  # what shines through
    (4.5, 0.85, 0.05),  # a sill
    (4.6, 1.4, 0.0), (4.6, 1.4, -0.9),  # a pane, and what it mirrors
])  # fmt: skip
def test_what_belongs_to_a_wall_faces_as_it_does(place):
    assert share_of(wall(), at(*place))[0] == 1


@pytest.mark.parametrize("place", [
    (1.0, 1.5, 0.4), (4.6, 1.4, 0.4),  # things before it
    (1.0, 1.5, -0.6), (4.6, 1.4, -1.2),  # far behind it, and behind its hole
    (1.0, 2.95, 0.0),  # its coping
    (1.0, 0.0, 0.1),  # the ground at its foot
    (9.0, 1.5, 0.0), (-1.0, 1.5, 0.0),  # in its plane, beside it
])  # fmt: skip
def test_other_things_face_as_they_do(place):
    assert share_of(wall(), at(*place))[0] == 0


def test_an_open_end_is_no_hole():
    gap = ((4.0, 5.2), (0.9, 3.1))
    assert share_of(wall(gap), at(4.6, 1.6, -0.9))[0] == 0
    assert share_of(wall(gap), at(1.0, 1.6, -0.3))[0] == 1


def test_a_surface_without_walls_changes_nothing():
    assert share_of(wall(flat=0.5), at(1.0, 1.5), at(4.6, 1.4)).max() == 0
    none = CaptureSurface(*(values[:0] for values in wall()))
    assert share_of(none, at(1.0, 1.5))[0] == 0


def test_absurd_places_belong_to_no_wall():
    far = np.array([1e30, -1e30, 1e30], np.float32)
    assert share_of(wall(), at(1.0, 1.5), far).tolist() == [1, 0]
