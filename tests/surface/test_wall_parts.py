"""Windows, sills and edges belong to the wall whose plane they lie in; other things do not."""

import numpy as np
import pytest

from rainsim.surface.fuse import CaptureSurface
from rainsim.surface.wall_parts import laid_on_walls

OUT = np.array([0.6, 0.8, 0], np.float32)  # the wall's normal
ALONG = np.array([-0.8, 0.6, 0], np.float32)
PLANE = 2.0  # m
ANYHOW = np.array([0, -0.6, 0.8], np.float32)  # a normal that tells nothing


def at(along, up, before=0.0):
    """Return a place beside the wall, in metres."""
    return (PLANE + before) * OUT + along * ALONG + np.array([0, 0, up], np.float32)


def surface_of(place, normal=ANYHOW, flat=0.0, light=0.5, top=2.0, shown=1.0):
    """Return a `CaptureSurface`: a place, and a wall of 8 x 3 m with a hole up to a height."""
    along, up = (a.ravel() for a in np.meshgrid(np.arange(0, 8, 0.05), np.arange(0, 3, 0.05)))
    hole = (along > 4) & (along < 5.2) & (up > 0.9) & (up < top)
    wall = [at(*each) for each in zip(along[~hole], up[~hole], strict=True)]
    position = np.array([at(*place), *wall], np.float32)
    count = len(position)
    surface = CaptureSurface(
        position, np.tile(OUT, (count, 1)), np.full(count, shown, np.float32),
        np.full((count, 3), 0.5, np.float32), np.full(count, 0.04, np.float32),
        np.full(count, 9, np.uint8),
    )  # fmt: skip
    surface.normal[0], surface.flat[0], surface.light[0] = normal, flat, light
    return surface


def laid(*place, **options):
    """Return whether a place comes to lie on the wall; all else stays as it is."""
    before = surface_of(place, **options)
    after = laid_on_walls(before)
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(old[1:], new[1:])
    for old, new in zip(surface_of(place, **options), before, strict=True):
        np.testing.assert_array_equal(old, new)  # what was given stays, too
    if np.array_equal(after.normal[0], before.normal[0]):
        np.testing.assert_array_equal(after.position[0], before.position[0])
        return False
    np.testing.assert_allclose(after.normal[0], OUT)
    np.testing.assert_allclose(after.position[0], at(*place[:2]), atol=1e-5)
    return True


@pytest.mark.parametrize("place", [
    (1.0, 1.5, 0.0), (1.0, 1.5, 0.15),  # on the wall, and haze before it
    (1.0, 1.5, -0.3),  # what shines through
    (4.5, 0.85, 0.05), (1.0, 0.05, 0.1),  # a sill; the foot
    (4.6, 1.4, 0.0), (4.6, 1.4, -0.9),  # a pane, and what it mirrors
])  # fmt: skip
def test_what_belongs_to_a_wall_is_laid_on_it(place):
    assert laid(*place)


@pytest.mark.parametrize("place", [
    (1.0, 1.5, 0.4), (4.6, 1.4, 0.4),  # things before it
    (1.0, 1.5, -0.6), (4.6, 1.4, -1.2),  # far behind it, and behind its hole
    (9.0, 1.5, 0.0), (-1.0, 1.5, 0.0), (1.0, 3.5, 0.0),  # in its plane, beside and above it
])  # fmt: skip
def test_other_things_stay_where_they_are(place):
    assert not laid(*place)


def test_ground_and_ledges_and_leaves_stay():
    level = np.array([0, 0.28, 0.96], np.float32)
    assert not laid(1.0, 0.0, 0.1, normal=level, flat=0.9)
    assert not laid(1.0, 1.5, 0.1, normal=level, flat=0.9)
    assert laid(1.0, 1.5, 0.1, normal=level, flat=0.1)  # noise
    assert not laid(1.0, 1.5, 0.1, light=(0.1, 0.3, 0.05))


def test_parallel_walls_are_two():
    near, far = surface_of((1.0, 1.5)), surface_of((1.0, 1.5, 3.0))
    far.position[1:] += 3 * OUT
    both = CaptureSurface(*(np.concatenate(pair) for pair in zip(near, far, strict=True)))
    found = laid_on_walls(both)
    count = len(near.position)
    np.testing.assert_allclose(
        found.position[[0, count]], [at(1.0, 1.5), at(1.0, 1.5, 3.0)], atol=1e-5
    )
    np.testing.assert_allclose(found.normal[[0, count]], [OUT, OUT])


def test_an_open_end_is_no_hole():
    assert laid(4.6, 1.6, -0.9)
    assert not laid(4.6, 1.6, -0.9, top=3.1)


def test_a_dark_pane_is_half_flat():
    found = [laid_on_walls(surface_of((4.6, 1.4), light=light)).flat[0] for light in (0.1, 0.4)]
    assert found == [0.5, 1]


def test_without_walls_nothing_changes():
    assert not laid(1.0, 1.5, shown=0.9)
    none = CaptureSurface(*(values[:0] for values in surface_of((1.0, 1.5))))
    assert len(laid_on_walls(none).position) == 0
