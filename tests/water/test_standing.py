"""Standing water: hand-made basins, a parcel-by-parcel oracle, the full fill, volumes."""

import heapq

import numpy as np
import pytest
from scipy import ndimage

from rainsim.errors import ParameterError
from rainsim.water.fill_spill_merge import standing_water

CROSS = ndimage.generate_binary_structure(2, 1)


def trough(heights):
    """A bed of one row of `heights` between high walls, with its edges closed off by them."""
    bed = np.full((3, len(heights) + 2), 100.0)
    bed[1, 1:-1] = heights
    return bed


def rain_on(bed, columns, amounts):
    """Rain map of a trough: `amounts` [m] at `columns`."""
    rain = np.zeros(bed.shape)
    rain[1, np.asarray(columns) + 1] = amounts
    return rain


def filled_by_morphology(bed):
    """Full fill by scikit-image's reconstruction with a cross, water leaving over the edge."""
    from skimage.morphology import reconstruction

    seed = np.full_like(bed, bed.max())
    seed[[0, -1]], seed[:, [0, -1]] = bed[[0, -1]], bed[:, [0, -1]]
    return reconstruction(seed, bed, method="erosion", footprint=CROSS)


def pour_parcels(bed, rain, parcels, open_edges):
    """Slow truth: rain in small parcels, each of which seeks the lowest cell that it can reach.

    A parcel starts at the pit below its cell and looks around, the lowest surface first. It raises
    the lowest cell seen as soon as it would have to climb, so ponds are level to within a parcel.
    Over a dry rim it runs down the steepest bed to the next pit.
    """
    ny, nx = bed.shape
    surface, out = bed.copy(), 0.0
    leaves = np.zeros(bed.shape, bool)
    if open_edges:
        leaves[[0, -1]] = leaves[:, [0, -1]] = True

    def around(j, i):
        return [(j, max(i - 1, 0)), (j, min(i + 1, nx - 1)),
                (max(j - 1, 0), i), (min(j + 1, ny - 1), i)]  # fmt: skip

    def pit(cell):
        low = min(around(*cell), key=lambda c: bed[c])
        return cell if leaves[cell] or bed[low] >= bed[cell] else pit(low)

    def end(cell):
        seen, queue, lowest = {cell}, [(surface[cell], cell)], cell
        while queue:
            height, here = heapq.heappop(queue)
            if height > surface[lowest]:
                break
            if leaves[here]:
                return here
            lowest = min(lowest, here, key=lambda c: surface[c])
            others = set(around(*here)) - seen
            below = [c for c in others if surface[c] < height]
            if below and height == bed[here]:
                return end(pit(min(below, key=lambda c: bed[c])))
            for other in others:
                seen.add(other)
                heapq.heappush(queue, (surface[other], other))
        return lowest

    starts = {cell: pit(cell) for cell in np.ndindex(ny, nx)}
    for _ in range(parcels):
        for cell, start in starts.items():
            stop = end(start)
            if leaves[stop]:
                out += rain[cell] / parcels
            else:
                surface[stop] += rain[cell] / parcels
    return surface - bed, out


def test_a_full_basin_spills_into_the_next_and_they_merge():
    bed = trough([9.0, 0.0, 2.0, 1.0, 9.0])
    spilt = standing_water(bed, rain_on(bed, [1], [2.5]), 1.0)[0][1, 1:-1]
    np.testing.assert_allclose(spilt, [0, 2.0, 0, 0.5, 0], atol=1e-12)
    merged = standing_water(bed, rain_on(bed, [1], [6.0]), 1.0)[0][1, 1:-1]
    np.testing.assert_allclose(merged, [0, 3.0, 1.0, 2.0, 0], atol=1e-12)


def test_permeable_cells_take_what_reaches_them():
    bed = trough([9.0, 0.0, 2.0, 1.0, 9.0])
    permeable = np.zeros(bed.shape, bool)
    permeable[1, 4] = True  # the floor of the second basin
    depth, out, soaked = standing_water(bed, rain_on(bed, [1], [3.0]), 1.0, permeable)
    np.testing.assert_allclose(depth[1, 1:-1], [0, 2.0, 0, 0, 0], atol=1e-12)
    assert (out, soaked) == (0.0, pytest.approx(1.0))
    permeable[:] = False
    permeable[1, 3] = True  # the saddle: neither basin rises above it
    depth, _, soaked = standing_water(bed, rain_on(bed, [1, 3], [3.0, 3.0]), 1.0, permeable)
    np.testing.assert_allclose(depth[1, 1:-1], [0, 2.0, 0, 1.0, 0], atol=1e-12)
    assert soaked == pytest.approx(3.0)


def test_shallow_basins_pass_water_on():
    bed = trough([9.0, 4.9, 5.0, 2.0, 9.0])
    rain = rain_on(bed, [1], [1.0])
    np.testing.assert_allclose(
        standing_water(bed, rain, 1.0, minimum_depth=0.2)[0][1, 1:-1], [0, 0, 0, 1.0, 0]
    )
    np.testing.assert_allclose(
        standing_water(bed, rain, 1.0, minimum_depth=0.05)[0][1, 1:-1],
        [0, 0.1, 0, 0.9, 0],
        atol=1e-12,
    )


def test_closed_level_ground_holds_the_rain_evenly():
    bed = np.zeros((6, 9))
    depth, out, _ = standing_water(bed, 0.01, 0.1, open_edges=False)
    np.testing.assert_allclose(depth, 0.01, rtol=1e-12)
    assert out == 0.0
    assert standing_water(bed, 0.01, 0.1)[1] == pytest.approx(0.01 * 54 * 0.01)


@pytest.mark.parametrize("open_edges", [True, False])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_agrees_with_pouring_parcels(seed, open_edges):
    rng = np.random.default_rng(seed)
    bed = rng.random((9, 8))
    rain = 0.15 * rng.random(bed.shape)
    parcels = 400
    depth, out, _ = standing_water(bed, rain, 1.0, open_edges=open_edges)
    slow, slow_out = pour_parcels(bed, rain, parcels, open_edges)
    assert out == pytest.approx(slow_out, abs=0.01 * rain.sum())
    np.testing.assert_allclose(depth, slow, atol=0.012)
    assert depth.max() > 0.1


@pytest.mark.parametrize("smooth", [0, 3])
def test_endless_rain_fills_to_the_brim(smooth):
    rng = np.random.default_rng(smooth)
    bed = np.round(rng.random((60, 70)), 2)  # with ties
    bed = ndimage.gaussian_filter(bed, smooth) if smooth else bed
    truth = filled_by_morphology(bed)
    np.testing.assert_allclose(bed + standing_water(bed, 1e4, 0.02)[0], truth, atol=1e-12)
    assert (truth > bed).sum() > 100


@pytest.mark.parametrize("height", [0.0, 2000.0])
@pytest.mark.parametrize("options", [{}, {"open_edges": False}, {"minimum_depth": 0.02}])
def test_volume_is_exact_and_ponds_are_level(options, height):
    rng = np.random.default_rng(4)
    bed = ndimage.gaussian_filter(rng.random((80, 60)), 2) + height
    rain = 0.02 * rng.random(bed.shape)
    permeable = rng.random(bed.shape) < 0.01
    depth, out, soaked = standing_water(bed, rain, 0.1, permeable, **options)
    total = rain.sum() * 0.01
    assert depth.sum() * 0.01 + out + soaked == pytest.approx(total, rel=1e-9)
    assert (depth[permeable] == 0.0).all()
    ponds, count = ndimage.label(depth > 0.0, CROSS)
    level = bed + depth
    spans = ndimage.maximum(level, ponds, range(1, count + 1)) - ndimage.minimum(
        level, ponds, range(1, count + 1)
    )
    assert count > 5
    assert np.max(spans) < 1e-9
    # At rest: a pond's dry neighbours stand no lower than its level.
    rim = ndimage.minimum_filter(np.where(depth > 0, np.inf, bed), footprint=CROSS, mode="nearest")
    held = (depth > 0) & (rim < level - 1e-9)
    assert not held.any()


def test_mirrored_bed_gives_mirrored_water():
    rng = np.random.default_rng(5)
    bed = rng.random((40, 50))
    depth, out, _ = standing_water(bed, 0.05, 0.1)
    mirrored, mirrored_out, _ = standing_water(bed[:, ::-1], 0.05, 0.1)
    np.testing.assert_allclose(mirrored[:, ::-1], depth, atol=1e-12)
    assert mirrored_out == pytest.approx(out)


def test_still_water_of_the_flow_solver():
    from rainsim.grid import WaterSolver

    rng = np.random.default_rng(6)
    bed = ndimage.gaussian_filter(rng.random((50, 50)), 2)
    depth = standing_water(bed, 0.01, 0.05)[0]
    solver = WaterSolver(bed, 0.05, boundary="open")
    solver.set_state(depth)
    report = solver.advance(10.0)
    assert report.max_speed == 0.0
    assert report.ledger.outflow == 0.0


BOWL = np.zeros((4, 5))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: standing_water(np.full((3, 3), np.nan), 0.1, 1.0), r"\(9 such cells\)"),
        (lambda: standing_water(np.zeros(3), 0.1, 1.0), r"shape \(3,\)"),
        (lambda: standing_water(BOWL, -0.1, 1.0), "rainfall is -0.1 m"),
        (lambda: standing_water(BOWL, np.ones((5, 4)), 1.0), r"rainfall has shape \(5, 4\)"),
        (lambda: standing_water(BOWL, 0.1, 0.0), "spacing is 0.0 m"),
        (lambda: standing_water(BOWL, 0.1, 1.0, minimum_depth=-1), "minimum_depth is -1"),
        (lambda: standing_water(BOWL, 0.1, 1.0, np.ones((4, 5))), "mask"),
    ],
)
def test_bad_input_is_named(call, words):
    with pytest.raises(ParameterError, match=words):
        call()
