"""Splashes: who splashes, where the droplets are, and that they live and die."""

import numpy as np
import pytest

from rainsim.drops import RainField, RainSpectrum, flat_surfaces, impacts
from rainsim.particles.splash import LONGEST_LIFE, longest_flight, splashes_on
from rainsim.rain.size_distribution import terminal_speed
from splash_lines import fallen, splash_droplets


def test_thresholds_are_those_of_the_cited_papers():
    diameters = np.linspace(0.5e-3, 3e-3, 2501)
    speed = terminal_speed(diameters)
    wet, dry = (diameters[splashes_on(h, diameters, speed)].min() for h in (1e-3, 0.0))
    assert wet == pytest.approx(1.27e-3, rel=0.02)
    assert dry == pytest.approx(0.68e-3, rel=0.03)


@pytest.mark.parametrize("rate", [10, 50])
def test_splashes_per_area_and_second(rate):
    spectrum = RainSpectrum(rate)
    found = impacts(RainField(spectrum, seed=1), flat_surfaces(4, 4, 0.1), 0, 2.0)
    diameter = np.linspace(1.27e-3, 6e-3, 20_001)  # sqrt(We) = 20 at terminal speed
    flux = spectrum.intercept * np.exp(-spectrum.decay * diameter) * terminal_speed(diameter)
    expected = np.trapezoid(flux, diameter)
    splash = splashes_on(1e-3, found.diameter, -found.velocity[:, 2])
    assert splash.sum() / 32 == pytest.approx(expected, rel=0.03)
    assert 500 < expected < 2500


def test_droplets_fly_up_and_come_down_with_gravity_and_drag():
    impact = fallen([3e-3])
    first = splash_droplets(impact, 1e-3, 0.01)
    assert 4 <= len(first) <= 12
    position, velocity = first.position.copy(), first.velocity.copy()
    drag = 9.81 / (4000 * first.diameter[:, None])  # g over the fall speed
    step = 1e-4
    for _ in range(300):
        middle = velocity + 0.5 * step * (-drag * velocity - [0, 0, 9.81])
        position += step * middle
        velocity += step * (-drag * middle - [0, 0, 9.81])
    second = splash_droplets(impact, 1e-3, 0.04)
    assert np.array_equal(first.id, second.id)
    np.testing.assert_allclose(second.position, position, atol=2e-6)
    np.testing.assert_allclose(second.velocity, velocity, atol=2e-4)
    assert (first.position[:, 2] > 0).all() and (first.velocity[:, 2] > 0.1).all()
    reach = np.hypot(first.position[:, 0], first.position[:, 1])
    assert reach.min() > 0 and first.diameter.max() < 0.25 * 3e-3
    angles = np.sort(np.arctan2(first.position[:, 1], first.position[:, 0]))
    assert np.diff(angles).max() < np.pi  # all around


def test_splashes_live_and_die():
    impact = fallen(np.full(200, 3e-3))
    alive = [len(splash_droplets(impact, 1e-3, t)) for t in (-1e-6, 0.0, 0.07, 0.25, 0.37)]
    assert alive[0] == 0 and alive[1] > 800 and alive[-1] == 0
    assert alive[1] == alive[2] > alive[3] > 0
    late = splash_droplets(impact, 1e-3, 0.355)
    assert len(late) and (late.position[:, 2] > -1e-9).all() and (late.position[:, 2] < 0.01).all()


def test_droplets_fly_as_high_and_long_as_was_measured():
    """Of drops of 5 mm on a film most were caught 15 to 20 cm high, and none a metre away."""
    impact = fallen(np.full(60, 5e-3))
    seen = [splash_droplets(impact, 1e-3, t) for t in np.arange(0.0, 0.45, 0.01)]
    high = np.concatenate([s.position[:, 2] for s in seen])
    far = np.concatenate([np.hypot(*s.position[:, :2].T) for s in seen])
    assert 0.15 < high.max() < 0.25 and 0.3 < far.max() < 1.0
    assert len(seen[20]) > 0.5 * len(seen[0]) and not len(seen[-1])
    speed = np.linalg.norm(seen[0].velocity, axis=1)
    assert 0.4 < speed.min() < 1.0 and 3.0 < speed.max() < 5.0
    weak = [splash_droplets(fallen(np.full(60, 1.5e-3)), 1e-3, t) for t in (0.05, 0.1, 0.25)]
    assert 0.02 < weak[1].position[:, 2].max() < 0.08 and not len(weak[2])
    assert longest_flight(terminal_speed(5e-3)) < LONGEST_LIFE


def test_bigger_splashes_on_a_film_of_a_third_of_the_diameter():
    impact = fallen(np.full(50, 3e-3))
    thin, peak, pool = (splash_droplets(impact, h, 0.01).diameter.mean() for h in (2e-4, 1e-3, 0.1))
    assert thin < peak > pool > 0.5 * peak


def test_the_wind_carries_droplets():
    still, windy = (splash_droplets(fallen([3e-3], wind=w), 1e-3, 0.0) for w in (0.0, 4.0))
    np.testing.assert_allclose(windy.velocity[:, 0] - still.velocity[:, 0], 0.6, atol=1e-12)


def test_a_splash_does_not_depend_on_the_other_impacts():
    many = fallen(np.linspace(1e-3, 4e-3, 40))
    alone = splash_droplets(many.take(slice(20, 21)), 1e-3, 0.02)
    among = splash_droplets(many, 1e-3, 0.02)
    at = np.flatnonzero(np.isin(among.id, alone.id))
    assert len(at) == len(alone) > 0
    assert np.array_equal(among.position[at], alone.position)
