"""Drops: the gauge reads the rate asked for, sizes and speeds are right, roofs keep dry."""

import numpy as np
import pytest
from scipy import stats

from rainsim.drops import (
    GROUND,
    OBSTACLE,
    RainField,
    RainSpectrum,
    Surfaces,
    drop_volume,
    flat_surfaces,
    impacts,
)
from rainsim.errors import ParameterError
from rainsim.numerics.random import subkey, uniform, uniform_triple
from rainsim.rain.exposure import rain_exposure
from rainsim.rain.heightfield import BLOCK
from rainsim.rain.moving_surfaces import Heights
from rainsim.rain.size_distribution import SIZE_LAWS, SMALLEST, SizeLaw, terminal_speed
from rainsim.terrain.types import Grid

GUNN_KINZER = {1.0: 4.03, 1.5: 5.40, 2.0: 6.49, 3.0: 8.06, 4.0: 8.83, 5.0: 9.09}  # mm: m/s


def roofed(solid=False):
    """4 x 4 m of level ground with a roof at 1.9 to 2 m over 1 <= x, y < 3."""
    ground = np.zeros((80, 80), np.float32)
    top, underside = ground.copy(), ground.copy()
    top[20:60, 20:60], underside[20:60, 20:60] = 2.0, 0.0 if solid else 1.9
    return Surfaces(0.05, (0.0, 0.0), ground, top, underside)


# ---- spectrum


@pytest.mark.parametrize("diameter", GUNN_KINZER)
def test_class_speeds_are_within_3_percent_of_gunn_and_kinzer(diameter):
    spectrum = RainSpectrum(10)
    size_class = np.searchsorted(spectrum.edges, diameter * 1e-3) - 1
    assert spectrum.speed[size_class] == pytest.approx(GUNN_KINZER[diameter], rel=0.03)


def test_terminal_speed_of_mist_is_not_negative():
    assert terminal_speed(1e-6) == 0.0
    assert np.all(np.diff(terminal_speed(np.linspace(0.1e-3, 5.9e-3, 50))) > 0)


@pytest.mark.parametrize("rate, share", [(1, 0.065), (2.5, 0.034), (10, 0.012), (50, 0.0035)])
def test_water_flux_of_all_drops_is_the_rate(rate, share):
    spectrum = RainSpectrum(rate)
    diameter = np.linspace(0, 6e-3, 200_001)
    number = spectrum.intercept * np.exp(-spectrum.decay * diameter)
    flux = number * terminal_speed(diameter) * drop_volume(diameter)
    assert np.trapezoid(flux, diameter) == pytest.approx(spectrum.rate, rel=2e-3)
    assert spectrum.fine_rate / spectrum.rate == pytest.approx(share, rel=0.03)


def test_extinction_is_the_shadow_of_the_spectrum():
    # beta = (pi/2) N0 / Lambda^3, less the share above 6 mm
    spectrum = RainSpectrum(10)
    whole = np.pi / 2 * spectrum.intercept / spectrum.decay**3
    assert spectrum.extinction.sum() + spectrum.fine_extinction == pytest.approx(whole, rel=2e-3)


def gamma_rain(monkeypatch):
    """A rain of 10 mm/h whose diameters follow a gamma distribution of shape 3."""
    law = SizeLaw("a test", decay=3.8e3, shape=3.0)
    monkeypatch.setitem(SIZE_LAWS, "gamma", lambda rate: law)
    return RainSpectrum(10, "gamma")


def test_a_gamma_law_brings_the_rate_and_its_own_numbers_of_drops(monkeypatch):
    spectrum = gamma_rain(monkeypatch)
    diameter = np.linspace(0, 6e-3, 200_001)
    number = spectrum.intercept * (diameter * 1e3) ** 3 * np.exp(-3.8e3 * diameter)
    flux = number * terminal_speed(diameter) * drop_volume(diameter)
    assert np.trapezoid(flux, diameter) == pytest.approx(spectrum.rate, rel=2e-3)
    tracked = np.trapezoid(np.where(diameter >= SMALLEST, number, 0), diameter)
    assert spectrum.density.sum() == pytest.approx(tracked, rel=1e-3)
    between = spectrum.intercept * spectrum.law.number_between(SMALLEST, 6e-3)
    assert between == pytest.approx(tracked, rel=1e-3)
    assert spectrum.law.text == "N(D) = intercept (D / 1 mm)^3 exp(-decay D)"


def test_drops_of_a_gamma_law_have_its_sizes_within_the_classes_too(monkeypatch):
    spectrum = gamma_rain(monkeypatch)
    drops = RainField(spectrum, seed=3).drops_in_box(0.0, (-4, -4, 0), (4, 4, 4))
    low, high, law = SMALLEST, 6e-3, spectrum.law
    chance = law.number_between(low, drops.diameter) / law.number_between(low, high)
    assert len(drops) > 10_000
    assert stats.kstest(chance, "uniform").pvalue > 0.01
    exponential = np.exp(-3.8e3 * np.array([low, high]))
    chance = (exponential[0] - np.exp(-3.8e3 * drops.diameter)) / -np.diff(exponential)
    assert stats.kstest(chance, "uniform").pvalue < 1e-6


def test_no_rain_has_no_drops():
    field = RainField(RainSpectrum(0))
    assert len(field.drops_in_box(5.0, (0, 0, 0), (2, 2, 2))) == 0
    assert len(impacts(field, flat_surfaces(2, 2, 0.1), 0, 1)) == 0


@pytest.mark.parametrize("rate", [-1, float("nan"), 1e5, "much", True])
def test_bad_rates_are_refused(rate):
    with pytest.raises(ParameterError, match="rain rate"):
        RainSpectrum(rate)


# ---- the field


def test_a_box_holds_the_density_of_drops_and_the_spectrum_of_sizes():
    spectrum = RainSpectrum(10)
    drops = RainField(spectrum, (3, -2), seed=5).drops_in_box(100.0, (-3, -3, 0), (3, 3, 3))
    expected = spectrum.density.sum() * 108
    assert abs(len(drops) - expected) < 4 * np.sqrt(expected)
    # chi-square against the truncated exponential, 30 equally likely cells
    span = np.exp(-spectrum.decay * np.array([SMALLEST, 6e-3]))
    chance = (span[0] - np.exp(-spectrum.decay * drops.diameter)) / (span[0] - span[1])
    counts = np.bincount((chance * 30).astype(int), minlength=30)
    assert stats.chisquare(counts).pvalue > 0.01


def test_places_are_uniform_and_counts_are_poisson():
    field = RainField(RainSpectrum(50), (1, 1), seed=2)
    drops = field.drops_in_box(3.0, (0, 0, 0), (4, 4, 4))
    for axis in range(3):
        assert stats.kstest(drops.position[:, axis] / 4, "uniform").pvalue > 0.01
    cells = np.floor(drops.position / 0.4).astype(int)
    counts = np.bincount(cells @ [1, 10, 100], minlength=1000)
    assert counts.var() / counts.mean() == pytest.approx(1, abs=0.15)  # 3.4 standard errors


def test_a_box_is_the_union_of_its_parts():
    field = RainField(RainSpectrum(50), (2, 0.5), seed=1)
    whole = field.drops_in_box(7.3, (-1, 0, 0.2), (1, 2, 1.2))
    parts = [
        field.drops_in_box(7.3, (-1, 0, 0.2), (0.1, 2, 1.2)),
        field.drops_in_box(7.3, (0.1, 0, 0.2), (1, 0.77, 1.2)),
        field.drops_in_box(7.3, (0.1, 0.77, 0.2), (1, 2, 1.2)),
    ]
    ids = np.concatenate([p.id for p in parts])
    order = np.argsort(ids)
    assert np.array_equal(ids[order], whole.id)
    assert np.array_equal(np.concatenate([p.position for p in parts])[order], whole.position)
    assert len(np.unique(whole.id)) == len(whole) > 1000


def test_a_lighter_rain_is_nearly_all_in_a_heavier_one():
    light, heavy = (
        RainField(RainSpectrum(rate), seed=4).drops_in_box(9.0, (0, 0, 0), (3, 3, 3))
        for rate in (10, 12)
    )
    assert np.isin(light.id, heavy.id).mean() > 0.97
    assert len(light) < len(heavy)


def test_seeds_differ():
    a, b = (RainField(RainSpectrum(50), seed=s).drops_in_box(0, (0,) * 3, (1,) * 3) for s in (0, 1))
    assert not np.isin(a.id, b.id).any()


@pytest.mark.parametrize("wind", [(1.0,), (np.inf, 0), ("x", 0)])
def test_bad_winds_are_refused(wind):
    with pytest.raises(ParameterError, match="wind"):
        RainField(RainSpectrum(1), wind)


# ---- impacts


@pytest.mark.parametrize("rate", [1, 10, 100])
def test_the_gauge_reads_the_rate_within_2_percent(rate):
    """100,000 drops; the sample's own error is 0.6 to 0.8 %, so 2 % is about 2.5 of its sigma."""
    spectrum = RainSpectrum(rate)
    field = RainField(spectrum, (1.0, 0.5), seed=1)
    duration = 1e5 / (spectrum.density @ spectrum.speed) / 16
    found = impacts(field, flat_surfaces(4, 4, 0.1), 0.0, duration)
    assert len(found) == pytest.approx(1e5, rel=0.02)
    depth = found.volume.sum() / 16 + spectrum.fine_rate * duration
    assert depth == pytest.approx(spectrum.rate * duration, rel=0.02)
    assert (found.kind == GROUND).all()


def test_impacts_lie_on_the_ground_at_their_time_and_cell():
    field = RainField(RainSpectrum(50), (2, 1), seed=6)
    found = impacts(field, flat_surfaces(1, 2, 0.1, (3, -1), height=0.25), 5.0, 5.2)
    assert len(found) > 500 and (np.diff(found.id.astype(np.float64)) >= 0).all()
    np.testing.assert_allclose(found.position[:, 2], 0.25, atol=1e-9)
    assert ((found.time >= 5.0) & (found.time < 5.2)).all()
    cells = np.floor((found.position[:, :2] - [3, -1]) / 0.1).astype(int)
    assert np.array_equal(cells[:, 0], found.column) and np.array_equal(cells[:, 1], found.row)
    above = field.drops_in_box(5.0, (2, -2, 0.25), (4.5, 1.5, 3))
    start = above.position[np.searchsorted(above.id, found.id)]
    np.testing.assert_allclose(
        start + found.velocity * (found.time - 5.0)[:, None], found.position, atol=1e-9
    )


def test_big_drops_can_be_asked_for_alone():
    field, ground = RainField(RainSpectrum(50), seed=6), flat_surfaces(2, 2, 0.1)
    every, big = (impacts(field, ground, 0.0, 0.2, smallest=s) for s in (0.0, 2e-3))
    wanted = every.id[every.diameter >= 2e-3]
    assert np.isin(wanted, big.id).all() and len(wanted) <= len(big) < 0.3 * len(every)
    assert big.diameter.min() > 1.9e-3


def test_intervals_neither_share_nor_lose_a_drop():
    field, surfaces = RainField(RainSpectrum(50), (3, -1), seed=8), roofed()
    whole = impacts(field, surfaces, 1.0, 1.3)
    parts = [impacts(field, surfaces, a, a + 0.1) for a in (1.0, 1.1, 1.1 + 0.1)]
    ids = np.sort(np.concatenate([p.id for p in parts]))
    end = 1.1 + 0.1 + 0.1
    assert np.array_equal(ids, impacts(field, surfaces, 1.0, end).id)
    assert len(whole) > 10_000


def test_vertical_rain_keeps_the_ground_under_a_roof_dry_and_wets_the_rest():
    found = impacts(RainField(RainSpectrum(50), seed=1), roofed(), 0.0, 0.2)
    under = (abs(found.row - 39.5) < 20) & (abs(found.column - 39.5) < 20)
    assert (found.kind[under] == OBSTACLE).all() and under.sum() > 1000
    assert (found.kind[~under] == GROUND).all() and (~under).sum() > 3000
    np.testing.assert_allclose(found.position[under, 2], 2.0, atol=1e-6)


def test_wind_wets_the_ground_under_a_roof_and_shades_its_lee():
    """Each class draws its own slanted shadow, between the roof's two edges; their sum is known."""
    wind, duration = 4.0, 0.4
    spectrum = RainSpectrum(50)
    found = impacts(RainField(spectrum, (wind, 0.0), seed=1), roofed(), 0.0, duration)
    ground = found.take((found.kind == GROUND) & (abs(found.row - 39.5) < 19.9))
    counts = np.bincount(ground.column, minlength=80)
    x = (np.arange(80 * 8) + 0.5) * 0.05 / 8
    drift = wind / spectrum.speed  # m per m of height
    shaded = (x[:, None] - 1.9 * drift > 1.0) & (x[:, None] - 2.0 * drift < 3.0)
    flux = (~shaded * (spectrum.density * spectrum.speed)).sum(axis=1)
    expected = flux.reshape(80, 8).mean(axis=1) * duration * 2.0 * 0.05
    assert stats.chisquare(counts, expected * counts.sum() / expected.sum()).pvalue > 0.01
    assert counts.sum() == pytest.approx(expected.sum(), rel=0.02)
    assert expected[21:25].min() > 0.99 * expected[0] and expected[55] < 0.6 * expected[0]


def test_a_wall_catches_what_its_face_and_top_show_to_the_rain():
    """Volume on a solid block = vertical flux on its top + wind flux on its windward face."""
    spectrum = RainSpectrum(100)
    found = impacts(RainField(spectrum, (2.0, 0.0), seed=1), roofed(True), 0.0, 2.0)
    hit = found.take(found.kind == OBSTACLE)
    face = hit.position[:, 2] < 1.999
    expected = spectrum.density.sum() * 2.0 * (2 * 2) * 2.0  # drops: n u A t
    assert face.sum() == pytest.approx(expected, rel=0.02)
    assert (hit.column[face] == 20).all()
    top = (spectrum.density @ spectrum.speed) * 4 * 2.0
    assert (~face).sum() == pytest.approx(top, rel=0.02)


def test_ground_and_obstacles_share_all_the_rain_of_the_map():
    """Vertical rain on a rough map with occluders: every drop over the map ends on it once."""
    rng = np.random.Generator(np.random.PCG64(1))
    ground = rng.uniform(0, 0.3, (40, 50)).astype(np.float32)
    underside = ground + rng.uniform(-0.2, 0.5, ground.shape).astype(np.float32)
    top = np.where(rng.random(ground.shape) < 0.3, underside + 0.3, ground).astype(np.float32)
    field = RainField(RainSpectrum(50), seed=2)
    rough = Surfaces(0.05, (0, 0), ground, top, underside)
    found = impacts(field, rough, 0.0, 0.5)
    expected = (field.spectrum.density @ field.spectrum.speed) * rough.area * 0.5
    assert abs(len(found) - expected) < 4 * np.sqrt(expected)
    assert {0, 1} == set(found.kind)
    occluded = rough.top > rough.ground
    assert (occluded[found.row, found.column] == (found.kind == OBSTACLE)).all()


def naive_first_hit(surfaces, start, velocity, step=2e-5):
    """Oracle: walk down the path in tiny steps and stop at the first point inside a solid."""
    time = (float(surfaces.top.max()) + 0.02 - start[2]) / velocity[2]
    ny, nx = surfaces.shape
    while True:
        x, y, z = start + velocity * time
        i = int(np.floor((x - surfaces.origin[0]) / surfaces.spacing))
        j = int(np.floor((y - surfaces.origin[1]) / surfaces.spacing))
        if z < -0.1:
            return None
        if 0 <= i < nx and 0 <= j < ny:
            ground, top, low = surfaces.ground[j, i], surfaces.top[j, i], surfaces.underside[j, i]
            if top > ground and low < z <= top:
                return time, OBSTACLE, j, i
            if z <= ground:
                return time, GROUND, j, i
        time += step


def test_slanted_hits_agree_with_walking_the_path():
    rng = np.random.Generator(np.random.PCG64(3))
    shape = (2 * BLOCK + 3, BLOCK + 5)
    ground = rng.uniform(0, 0.05, shape).astype(np.float32)
    top, underside = ground.copy(), ground.copy()
    top[5:9, 4:12], underside[5:9, 4:12] = 0.35, 0.3
    top[20:24, 10:14] = 0.2
    surfaces = Surfaces(0.04, (-0.3, 0.1), ground, top, underside)
    found = impacts(RainField(RainSpectrum(20), (1.7, -2.3), seed=3), surfaces, 0.0, 0.05)
    for n in rng.choice(len(found), 60, replace=False):
        time, kind, row, column = naive_first_hit(
            surfaces, found.position[n] - found.velocity[n] * found.time[n], found.velocity[n]
        )
        assert time == pytest.approx(found.time[n], abs=3e-5)
        assert (kind, row, column) == (found.kind[n], found.row[n], found.column[n])
    assert {GROUND, OBSTACLE} == set(found.kind)


def test_threads_and_history_do_not_matter(threads):
    surfaces = roofed()
    results = []
    for count in (1, 2, 1):
        threads(count)
        field = RainField(RainSpectrum(50), (1, 2), seed=9)
        if count == 2:
            impacts(field, surfaces, 0.0, 0.1)
        results.append(impacts(field, surfaces, 0.4, 0.45))
    for name in ("position", "velocity", "diameter", "time", "kind", "row", "column", "id"):
        first, *others = (getattr(r, name).tobytes() for r in results)
        assert all(first == o for o in others), name
    assert len(results[0]) > 1000


def test_bad_surfaces_are_refused():
    level = np.zeros((4, 4), np.float32)
    with pytest.raises(ParameterError, match="top has shape"):
        Surfaces(0.1, (0, 0), level, np.zeros((4, 5)), level)
    with pytest.raises(ParameterError, match="not finite"):
        Surfaces(0.1, (0, 0), level + np.nan, level, level)
    with pytest.raises(ParameterError, match="spacing"):
        Surfaces(0.0, (0, 0), level, level, level)
    with pytest.raises(ParameterError, match="stop - start"):
        impacts(RainField(RainSpectrum(1)), flat_surfaces(1, 1, 0.1), 1.0, 0.5)


# ---- random numbers


def test_plain_and_compiled_random_numbers_agree():
    """The formulas as plain Python give the ids that the kernels gave."""
    field = RainField(RainSpectrum(50), seed=1)
    with np.errstate(over="ignore"):
        key = field.arrays()[2][7]
        for item in (3, -2, 1):
            key = subkey(key, np.int64(item))
        word = subkey(key, np.int64(1))
        place = (np.array([3, -2, 1]) + uniform_triple(word)) * field.cube[7]
    side = field.cube[7]
    box = field.drops_in_box(0.0, np.array([3, -2, 1]) * side, np.array([4, -1, 2]) * side)
    assert field.arrays()[3][7, 0] <= uniform(key)  # the cube is not empty
    at = np.flatnonzero(box.id == word)
    assert len(at) == 1
    np.testing.assert_allclose(box.position[at[0]], place, rtol=1e-12)


def test_hits_within_a_rectangle_are_those_of_all_that_lie_in_it():
    field, surfaces = RainField(RainSpectrum(50), (3, -1), seed=8), roofed()
    every = impacts(field, surfaces, 1.0, 1.1)
    low, high = np.array([0.7, 1.1]), np.array([2.3, 9.0])
    some = impacts(field, surfaces, 1.0, 1.1, within=np.stack([low, high]))
    inside = ((every.position[:, :2] >= low) & (every.position[:, :2] < high)).all(axis=1)
    assert np.array_equal(some.id, every.id[inside]) and 0 < inside.sum() < len(every)


@pytest.mark.parametrize("place", [(0, 0), (21, 30), (47, 83)])
def test_surfaces_changed_in_a_part_are_those_made_anew(rng, place):
    ground = rng.normal(0, 0.1, (53, 90)).astype(np.float32)
    still = Surfaces(0.05, (0.0, 0.0), ground, ground + 0.1, ground)
    part = tuple(slice(n, n + 7) for n in place)
    top = still.top.copy()
    top[part] += 1.5
    found = still.changed(top, still.underside, [part]).height_fields()
    wanted = Surfaces(0.05, (0.0, 0.0), ground, top, ground).height_fields()
    for name, value in wanted._asdict().items():
        np.testing.assert_array_equal(getattr(found, name), value, name)
    assert found.patch_high.max() > still.patch_high.max() + 1


@pytest.mark.parametrize("wind", [(0.0, 0.0), (7.0, 0.6), (7.0, -2.2)])
def test_ways_that_pass_beside_all_tops_are_followed_no_less(wind):
    """Posts in two corners make the rest of the map no longer lie beside all tops."""
    bed, top = np.zeros((2, 120, 160), np.float32)
    top[50:70, 60:80] = 1.2
    grid = Grid(bed.shape, (0.0, 0.0), 0.05)
    alone = rain_exposure(Heights(grid, bed, top, bed), wind)
    posts = top.copy()
    posts[0, 0] = posts[-1, -1] = 1.2
    beside = rain_exposure(Heights(grid, bed, posts, bed), wind)
    where = np.s_[30:90, 40:120]
    np.testing.assert_array_equal(alone[where], beside[where])
    assert alone.min() == 0 and 0.02 < (alone < 1).mean() < 0.5
