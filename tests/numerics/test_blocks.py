"""Work in blocks and in strips gives the bytes of the plain calls."""

import numpy as np
import pytest
from scipy import ndimage

from rainsim.numerics import blocks
from rainsim.numerics.blocks import in_blocks, stable_order
from rainsim.scene.types import GroundFrame
from rainsim.splatting.prepared import morton_order
from rainsim.terrain import filters
from scenes import ground_frame, tiny_scene


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 30])
def test_blocks_cover_each_row_once(count):
    times = np.zeros(count, int)

    def work(part):
        times[part] += 1

    in_blocks(work, count, 8)
    assert (times == 1).all()


def test_an_error_in_a_block_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_blocks(lambda part: 1 // (part.start - 8), 30, 8)


def test_blocks_handle_floating_point_errors_as_their_caller_does():
    def work(part):
        np.zeros(2)[:1] / np.zeros(2)[:1]

    with np.errstate(invalid="ignore"):
        in_blocks(work, 30, 8)
    with np.errstate(invalid="raise"), pytest.raises(FloatingPointError):
        in_blocks(work, 30, 8)


@pytest.mark.parametrize("side_by_side", [False, True])
def test_what_is_found_beside_is_found_once_and_its_error_raised(side_by_side, monkeypatch):
    calls = []
    monkeypatch.setattr(blocks, "may_run_beside", lambda: side_by_side)
    monkeypatch.setattr(blocks, "get_num_threads", lambda: 2)
    found = blocks.beside(lambda value: calls.append(value) or len(calls), 7)
    assert found() == found() == 1 and calls == [7]
    with pytest.raises(ZeroDivisionError):
        blocks.beside(lambda: 1 // 0)()


def test_splats_are_taken_by_mask_by_places_and_by_slice():
    splats = tiny_scene().splats
    mask = np.arange(len(splats)) % 3 == 1
    for which in (mask, np.flatnonzero(mask), slice(1, None, 3), [], slice(4, 2)):
        taken = splats.take(which)
        for name in ("position", "rotation", "scale", "opacity", "sh"):
            array = getattr(taken, name)
            np.testing.assert_array_equal(array, getattr(splats, name)[which])
            assert array.flags.c_contiguous and array.dtype == np.float32
    with pytest.raises(IndexError):
        splats.take(mask[:-1])


@pytest.mark.parametrize("most", [1, 5, 2**32 - 1])
def test_stable_order_is_that_of_argsort(rng, most):
    numbers = rng.integers(0, most, 5000, dtype=np.int64, endpoint=True)
    order = stable_order(numbers)
    assert order.dtype == np.int64
    np.testing.assert_array_equal(order, np.argsort(numbers, kind="stable"))
    assert len(stable_order(numbers[:0])) == 0


@pytest.mark.parametrize("shape", [(61, 47), (640, 515)])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_filters_are_those_of_scipy_to_the_byte(rng, shape, kind):
    values = rng.normal(size=shape).astype(kind)
    assert (values.size > filters.BAND) == (shape[0] > 100)  # several bands
    pairs = [
        (filters.gaussian_filter(values, 2.3), ndimage.gaussian_filter(values, 2.3)),
        (
            filters.uniform_filter(values, 5).astype("f4"),
            ndimage.uniform_filter(values, 5).astype("f4"),
        ),  # its sums run from row to row
        (filters.minimum_filter(values, 4), ndimage.minimum_filter(values, 4)),
        (filters.maximum_filter(values, 7), ndimage.maximum_filter(values, 7)),
        (filters.median_filter(values), ndimage.median_filter(values, 3)),
    ]
    for size in (5, 6):
        opened = ndimage.grey_opening(values, size=(size, size))
        pairs.append((filters.grey_opening(values, size), opened))
    for ours, theirs in pairs:
        assert ours.dtype == theirs.dtype and ours.tobytes() == theirs.tobytes()
    turned = values[::-1]
    np.testing.assert_array_equal(filters.median_filter(turned), ndimage.median_filter(turned, 3))


@pytest.mark.parametrize("share", [0.0, 0.001, 0.2])
def test_distances_are_exact_as_far_as_they_are_asked_for(rng, share):
    mask = rng.random((320, 90)) >= share
    mask[:100], mask[200] = True, True
    found = filters.distance(mask, 9.5)
    exact = ndimage.distance_transform_edt(mask) if share else np.full(mask.shape, np.inf)
    near = exact <= 9.5
    assert found[near].tobytes() == exact[near].tobytes() and (found[~near] > 9.5).all()


def test_points_go_to_the_ground_frame_block_by_block(rng):
    frame: GroundFrame = ground_frame()
    points = rng.normal(size=(200_001, 3)).astype(np.float32)
    plain = points @ frame.rotation.T * frame.meters_per_unit + frame.translation
    np.testing.assert_allclose(frame.to_ground(points), plain, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(frame.to_ground(points[5]), plain[5], rtol=1e-13, atol=1e-13)


def test_morton_order_of_many_splats_is_that_of_their_codes(rng):
    position = rng.normal(size=(150_000, 3)).astype(np.float32)
    order = morton_order(position)
    assert order.dtype == np.int32 and (np.sort(order) == np.arange(150_000)).all()
    # A splat lies nearer to the next in the order than to one at random.
    steps, random = (
        np.median(np.linalg.norm(np.diff(p, axis=0), axis=1)) for p in (position[order], position)
    )
    assert steps < 0.1 * random
