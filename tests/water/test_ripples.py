"""Ripples: they run, spread and fade as theory says, and drops give them the right energy."""

import math

import numpy as np
import pytest

from rainsim.drops import RainField, RainSpectrum, drop_volume, flat_surfaces, impacts
from rainsim.errors import ParameterError
from rainsim.rain.size_distribution import terminal_speed
from rainsim.reflection.puddle_rings import puddle_rings
from rainsim.reflection.wet_tops import BOARD_RINGS
from rainsim.water.ripples import (
    FOOTPRINT,
    LAYERS,
    REFERENCE_DROP,
    RING_SHARE,
    RippleTile,
    angular_frequency,
    block_reach,
    damping_rate,
    drop_momentum,
    footprint,
    mean_chord,
    ring_reach,
    ring_share,
    sheltered_rings,
    stirring,
    taller_rings,
    tile_impacts,
)


def momentum(diameter):
    return np.array([1000 * drop_volume(diameter) * terminal_speed(diameter)])


def wave(tile, waves):
    """Put a cosine with `waves` waves per tile on the water; return its wavenumber."""
    x = np.arange(tile.cells) / tile.cells
    tile.set_elevation(np.broadcast_to(1e-4 * np.cos(2 * np.pi * waves * x), (tile.cells,) * 2))
    return 2 * np.pi * waves / tile.size


def height_over_time(tile, duration, steps):
    heights = [tile.elevation[0, 0]]
    for _ in range(steps):
        tile.advance(duration / steps)
        heights.append(tile.elevation[0, 0])
    return np.arange(steps + 1) * duration / steps, np.array(heights)


@pytest.mark.parametrize("depth", [2e-3, 1e-2, 1e-1])
@pytest.mark.parametrize("waves", [1, 5, 20])  # 10, 2 and 0.5 cm
def test_the_tile_shows_the_frequency_and_decay_of_theory(depth, waves):
    """Fit a damped oscillation to the height at a crest; a tile of 10 cm."""
    tile = RippleTile(size=0.1, cells=48, depth=depth)
    k = wave(tile, waves)
    exact = np.sqrt((9.81 * k + 0.0728e-3 * k**3) * np.tanh(k * depth))
    time, height = height_over_time(tile, 6 * np.pi / exact, 120)
    crossings = np.flatnonzero(np.diff(np.sign(height)))
    at = time[crossings] - height[crossings] * np.diff(time)[0] / np.diff(height)[crossings]
    assert np.pi / np.diff(at).mean() == pytest.approx(exact, rel=0.03)
    bulk = 2 * 1e-6 * k**2
    bottom = k * np.sqrt(1e-6 * exact / 2) / np.sinh(2 * k * depth)
    peaks = np.abs(height[[20 * 2, 20 * 4, 20 * 6]])  # whole periods
    decay = np.log(peaks[0] / peaks[-1]) / (time[120] - time[40])
    assert decay == pytest.approx(bulk + bottom, rel=0.1)


def test_one_long_step_equals_many_short_ones():
    tiles = [RippleTile(0.5, 64) for _ in range(2)]
    for tile in tiles:
        tile.advance(0.0, np.array([[0.2, 0.3]]), momentum(3e-3))
    tiles[0].advance(0.5)
    for _ in range(50):
        tiles[1].advance(0.01)
    np.testing.assert_allclose(tiles[0].elevation, tiles[1].elevation, atol=1e-14)
    assert np.ptp(tiles[0].elevation) > 1e-5


@pytest.mark.parametrize(("depth", "share"), [(3e-3, 0.0056), (1e-2, 0.0093), (1e-1, 0.01)])
def test_a_ring_has_one_percent_of_the_drops_energy_less_what_a_shallow_bed_takes(depth, share):
    """Averaged over places in the cell, for drops about the reference; the share goes with mass."""
    for diameter in (2.2e-3, REFERENCE_DROP, 2.8e-3):
        kinetic = 0.5 * momentum(diameter)[0] * terminal_speed(diameter)
        shares = []
        for place in (0.0, 0.3, 0.6):
            tile = RippleTile(0.5, 128, depth)
            tile.advance(0.0, np.array([[place, 0.7 * place]]) / 128, momentum(diameter))
            shares.append(tile.energy() / kinetic)
        expected = share * (diameter / REFERENCE_DROP) ** 3
        assert np.mean(shares) == pytest.approx(expected, rel=0.1)


def test_large_drops_make_long_waves_and_rings_keep_their_energy():
    """Energy over the drop's momentum squared is one number; wavenumbers go with the crater."""
    k = 2 * np.pi * np.fft.fftfreq(256, 0.5 / 256)
    k = np.hypot(k[None], k[:, None])
    energies, means = [], []
    for diameter in (1.3e-3, 2.5e-3, 4.2e-3):
        tile = RippleTile(0.5, 256, 0.1)
        tile.advance(0.0, np.array([[0.2, 0.2]]), np.array([drop_momentum(diameter)]))
        energies.append(tile.energy() / drop_momentum(diameter) ** 2)
        tile.advance(0.15)
        power = np.abs(np.fft.fft2(tile.elevation)) ** 2 * (9810 + 0.0728 * k**2)
        means.append((k * power).sum() / power.sum())
    np.testing.assert_allclose(energies, energies[1], rtol=0.08)
    # of k^2 exp(-k^2 width^2): 2 / (sqrt(pi) width)
    np.testing.assert_allclose(means, [455, 226, 139], rtol=0.09)
    assert footprint(REFERENCE_DROP) == FOOTPRINT
    assert footprint(1.3e-3) < 0.6 * FOOTPRINT and footprint(4.2e-3) > 1.5 * FOOTPRINT


def test_a_calm_disc_grows_behind_the_ring_at_the_least_group_speed():
    """0.178 m/s in deep water: inside it is calm, outside the ring has not come yet."""
    tile = RippleTile(1.0, 256, 0.1)
    tile.advance(0.0, np.array([[0.5, 0.5]]), momentum(3e-3))
    tile.advance(1.0)
    y, x = (np.indices((256, 256)) / 256) - 0.5
    radius, height = np.hypot(x, y), tile.elevation
    inside = np.sqrt((height[radius < 0.10] ** 2).mean())
    ring = np.sqrt((height[(radius > 0.17) & (radius < 0.25)] ** 2).mean())
    beyond = np.sqrt((height[(radius > 0.45) & (radius < 0.5)] ** 2).mean())
    assert inside < 0.1 * ring and beyond < 0.2 * ring and ring > 1e-6


def test_slopes_are_the_gradient_of_the_elevation():
    tile = RippleTile(0.1, 64)
    k = wave(tile, 4)
    slopes = tile.slopes()
    x = np.arange(64) / 64 * 0.1
    np.testing.assert_allclose(slopes[0], np.tile(-1e-4 * k * np.sin(k * x), (64, 1)), atol=1e-8)
    assert abs(slopes[1]).max() < 1e-9 and slopes.dtype == np.float32


def test_random_rain_roughens_the_water():
    field, ground = RainField(RainSpectrum(50), seed=1), flat_surfaces(2, 2, 0.1)
    tile = RippleTile(1.0, 128)
    received = 0
    for n in range(12):
        found = impacts(field, ground, n / 24, (n + 1) / 24)
        place, push, age = tile_impacts(found, ground.area, tile.size, (n + 1) / 24)
        assert ((age >= 0) & (age <= 1 / 24 + 1e-9)).all()
        received += len(place)
        tile.advance(1 / 24, place, push, age)
    expected = field.spectrum.density @ field.spectrum.speed * 0.5 / LAYERS
    assert abs(received - expected) < 4 * np.sqrt(expected)
    slopes = tile.slopes().astype(np.float64)
    assert 0.01 < np.sqrt((slopes**2).sum(axis=0).mean()) < 0.3


def test_falls_are_wrapped_and_born_when_they_fell():
    a, b, late = (RippleTile(0.5, 64) for _ in range(3))
    a.advance(0.04, np.array([[0.1, 0.2]]), momentum(3e-3), np.array([0.04]))
    b.advance(0.04, np.array([[-1.4, 2.7]]), momentum(3e-3), np.array([0.04]))
    late.advance(0.04, np.array([[0.1, 0.2]]), momentum(3e-3), np.array([0.0]))
    np.testing.assert_allclose(a.elevation, b.elevation, atol=1e-15)
    assert np.ptp(a.elevation) > 0
    assert np.ptp(late.elevation) < 1e-3 * np.ptp(a.elevation)  # pushed, but not yet moved


def test_bad_tiles_are_refused():
    with pytest.raises(ParameterError, match="tile depth"):
        RippleTile(depth=0.0)
    with pytest.raises(ParameterError, match="cells"):
        RippleTile(cells=3)
    with pytest.raises(ParameterError, match="elevation"):
        RippleTile(cells=8).set_elevation(np.zeros((4, 4)))
    with pytest.raises(ParameterError, match="duration"):
        RippleTile(cells=8).advance(-1.0)


@pytest.mark.parametrize(("wavelength", "life"), [(0.01, 0.36), (0.02, 1.05), (0.005, 0.11)])
def test_a_surface_film_damps_as_the_physics_notes_say(wavelength, life):
    k = 2 * np.pi / wavelength
    assert 1 / (damping_rate(k, 0.1, 1.0) - damping_rate(k, 0.1)) == pytest.approx(life, rel=0.04)
    clean, filmed = RippleTile(0.5, 64, 0.05), RippleTile(0.5, 64, 0.05, film=1.0)
    for tile in (clean, filmed):
        tile.advance(0.0, np.array([[0.2, 0.2]]), momentum(3e-3))
        tile.advance(0.3)
    # exp(-2 t / life) with a life of 2 s at 200 rad/m, where most of the energy is
    assert filmed.energy() == pytest.approx(0.74 * clean.energy(), rel=0.1)


def test_a_tile_in_float32_shows_the_slopes_of_float64():
    tiles = [RippleTile(0.5, 64, 0.05, dtype=d) for d in (np.float32, np.float64)]
    for tile in tiles:
        tile.advance(0.0, np.array([[0.2, 0.2]]), momentum(3e-3))
        for _ in range(30):
            tile.advance(1 / 30)
    single, double = (tile.slopes() for tile in tiles)
    assert np.abs(single - double).max() < 1e-3 * np.abs(double).max() > 0


def in_balance(rate, diameter, depth=0.3):
    """Variances of the elevation [m2] and the slope of the rings that drops of one size keep up."""
    k = np.geomspace(2.0, 1500.0, 2000)
    mass, speed = 998.0 * drop_volume(diameter), float(terminal_speed(diameter))
    falling = rate / 3.6e6 / drop_volume(diameter)  # drops per m2 and s
    ring = k**2 * np.tanh(k * depth) * np.exp(-((k * FOOTPRINT) ** 2))
    ring *= RING_SHARE * 0.5 * mass * speed**2 / np.trapezoid(ring, k)
    ring *= mass / (998.0 * drop_volume(REFERENCE_DROP))  # a smaller drop puts in a smaller share
    fading = 2 * damping_rate(k, depth, stirred=stirring(rate))
    spectrum = falling * ring / fading / (998.0 * 9.81 + 0.0728 * k**2)
    return np.trapezoid(spectrum, k), np.trapezoid(k**2 * spectrum, k)


@pytest.mark.parametrize("rate", [5.0, 20.0, 50.0, 200.0])
def test_stirred_water_keeps_the_rings_that_were_measured_under_rain(rate):
    # Bliven, Sobieski and Craeye: S = Sp exp(-pi (ln(f / fp) / (df / fp))^2), Sp in cm2 / Hz,
    # constants as commonly quoted
    f = np.geomspace(0.5, 40.0, 2000)
    peak, wide = 5.772 - 0.0018 * rate, 4.42 + 0.0028 * rate
    measured = 6e-4 * rate**0.53 * np.exp(-np.pi * (np.log(f / peak) / (wide / peak)) ** 2)
    k = np.geomspace(2.0, 1500.0, 2000)
    slope = np.interp(2 * np.pi * f, angular_frequency(k, 0.3), k) ** 2 * measured
    elevation, steepness = in_balance(rate, 2.8e-3)
    assert math.sqrt(elevation / np.trapezoid(measured, f) * 1e4) == pytest.approx(1, rel=0.2)
    assert math.sqrt(steepness / np.trapezoid(slope, f) * 1e4) == pytest.approx(0.8, abs=0.1)
    assert stirring(0.0) == 0 and stirring(50.0) > 1


def test_rings_beside_what_moves_are_those_of_the_rain_that_it_lets_through():
    """Two shelters' windows against a transform of the whole map; apart, they add."""
    spacing, reach = 0.05, ring_reach(5e-3)
    rained = np.ones((80, 220), np.float32)
    rained[:, :60] = 0.3
    thinned, shelters = rained.copy(), []
    for part in ((slice(5, 75), slice(20, 100)), (slice(4, 76), slice(140, 215))):
        let_through = np.ones([s.stop - s.start for s in part], np.float32)
        let_through[25:45, 30:50] = 0.0
        thinned[part] *= let_through
        shelters.append((part, let_through))
    share = ring_share(rained, spacing, *reach)
    found, windows = sheltered_rings(2 * share, share, rained, shelters, spacing, reach)
    wanted = 2 * ring_share(thinned, spacing, *reach)
    np.testing.assert_allclose(found, wanted, atol=4e-3)
    assert np.abs(found - 2 * share).max() > 1
    for window in windows:
        found[window] = 2 * share[window]
    np.testing.assert_array_equal(found, 2 * share)  # no other cells differ
    assert sheltered_rings(share, share, rained, [], spacing, reach) == (share, [])


def test_rings_travel_in_under_cover_and_fade_there():
    open_half = np.zeros((40, 200), np.float32)
    open_half[:, :100] = 1.0
    near, far = (ring_share(open_half, 0.02, np.array([r]), np.ones(1)) for r in (0.1, 0.4))
    for share in (near, far):
        line = share[20]
        assert (np.diff(line) <= 2e-3).all() and line[0] > 0.95
        assert line[99:101].mean() == pytest.approx(np.sqrt(0.5), abs=0.02)
    assert near[20, 130] < 0.06 < 0.2 < far[20, 130]
    np.testing.assert_allclose(ring_share(np.ones((9, 9)), 0.1, *ring_reach(0.01)), 1, atol=1e-5)
    # 0.3 m in, by the integral of exp(-l / r) / (2 pi l r) over the open half
    angle = (np.arange(2000) + 0.5) / 2000 * np.pi / 2
    energy = np.exp(-0.31 / 0.4 / np.cos(angle)).mean() / 2
    assert far[20, 115] == pytest.approx(np.sqrt(energy), rel=0.03)
    reach = [(a * b).sum() for a, b in (ring_reach(0.1), ring_reach(0.01), ring_reach(0.01, 1.0))]
    assert reach[0] > reach[1] > reach[2] > 0.05


def test_a_tile_under_heavy_rain_is_damped_by_it():
    still, stirred = RippleTile(0.5, 64, 0.05), RippleTile(0.5, 64, 0.05, rate=50.0)
    for tile in (still, stirred):
        tile.advance(0.0, np.array([[0.2, 0.2]]), np.array([1e-4]))
        tile.advance(4.0)
    assert stirred.energy() < 0.75 * still.energy()


def test_shores_take_the_waves_of_a_small_puddle():
    y, x = (np.indices((200, 200)) + 0.5) * 0.01
    disc = np.where(np.hypot(x - 1, y - 1) < 0.5, 0.01, 0.0)
    assert mean_chord(disc, 0.01, 2e-3) == pytest.approx(np.pi / 2 * 0.5, rel=0.03)
    assert mean_chord(np.ones((9, 9)), 0.01, 2e-3) == math.inf
    small, wide = RippleTile(0.5, 64, 0.05, chord=0.4), RippleTile(0.5, 64, 0.05)
    k = 2 * np.pi * 10 / 0.5
    for tile in (small, wide):
        wave(tile, 10)
        tile.advance(1.0)
    speed = (angular_frequency(k * 1.001, 0.05) - angular_frequency(k, 0.05)) / (0.001 * k)
    lost = small.energy() / wide.energy()
    assert lost == pytest.approx(np.exp(-speed / 0.4), rel=0.02) and lost < 0.8


def slopes_in_balance(rate, depth, way):
    """Mean square slope of the rings of rain that run a `way` [m] to the shore, in one unit."""
    k = np.geomspace(20.0, 1000.0, 2000)
    omega = angular_frequency(k, depth)
    pushed = k**2 * np.tanh(k * depth) * np.exp(-((k * FOOTPRINT) ** 2))
    fading = 2 * damping_rate(k, depth, stirred=stirring(rate))
    left = -np.expm1(-way * fading / np.gradient(omega, k))
    slopes = k**2 * pushed * left / fading / (9810 + 0.0728 * k**2)
    return np.trapezoid(slopes, k) / np.trapezoid(pushed, k)


@pytest.mark.parametrize("rate", [10.0, 50.0])
def test_rings_on_a_board_are_as_high_as_its_small_puddles_let_them(rate):
    puddle = slopes_in_balance(rate, 6e-3, 0.5)
    for depth in (0.5e-3, 1e-3, 3e-3):
        for radius in (0.03, 0.05):
            share = math.sqrt(slopes_in_balance(rate, depth, radius) / puddle)
            assert share == pytest.approx(BOARD_RINGS, abs=0.1)
    assert slopes_in_balance(rate, 6e-3, 0.05) < 0.4 * puddle


def test_shores_calm_the_rings_of_small_puddles_as_the_balance_says():
    cell, reach = 0.01, ring_reach(6e-3, rate=50.0)
    around = block_reach(8 * cell, *reach)
    y, x = (np.indices((480, 480)) + 0.5) * cell - 2.4
    usual = slopes_in_balance(50.0, 6e-3, 0.5)
    found = []
    for radius in (0.05, 0.1, 1.5):
        depth = np.where(np.hypot(x, y) < radius, np.float32(6e-3), np.float32(0))
        rings = puddle_rings(depth, np.ones(depth.shape, bool), around)
        found.append(float(rings[29:31, 29:31].mean()))
        assert rings[0, 0] < 0.1
    for amplitude, radius in zip(found, (0.05, 0.1), strict=False):
        wanted = math.sqrt(slopes_in_balance(50.0, 6e-3, radius) / usual)
        assert amplitude == pytest.approx(wanted, abs=0.15)
    assert found[0] < 0.75 * found[1] < 0.75 * found[2] == 0.75
    lawn = puddle_rings(depth, np.zeros(depth.shape, bool), around)
    assert (lawn == 0).all()  # grass stands out of it


def test_taller_rings_are_as_many_times_as_high_also_under_cover():
    rings, sheltered = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4), 0.07
    drawn = sheltered + (1 - sheltered) * rings  # the amplitude that a pixel has
    for height in (0.0, 0.5, 1.0, 2.0):
        taller = taller_rings(rings, height, sheltered)
        assert taller.dtype == np.float32
        np.testing.assert_allclose(
            sheltered + (1 - sheltered) * taller, height * drawn, atol=1e-6
        )  # fmt: skip
