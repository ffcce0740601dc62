"""Wetness: films fill first and dry first, classes by their storage and pores."""

import numpy as np
import pytest

from rainsim import wetness
from rainsim.config import Config
from rainsim.puddles import puddles_of
from rainsim.simulation import initial_water
from rainsim.terrain import extract_terrain
from rainsim.terrain.table import GRASS, HARD, SOIL, class_table
from scenes import tiny_scene


def after(hours, **changes):
    base = {"rate": 0.0, "past": 3e-3, "cloudiness": 1.0, "drying": hours * 3600.0}
    return Config().replace(**{**base, **changes})


def hours_to_dry(film, porosity, config):
    """Return the hours until the film, and until the darkening, of a surface are gone."""
    rate = wetness.evaporation_rate(config) * 3600
    return film / rate, (film + porosity * wetness.PORE_DEPTH) / rate


def damp(code, config, reach=1.0):
    table = class_table()
    film, pores = table.column("storage")[code], table.column("porosity")[code]
    return float(wetness.dampness(config, film, pores, reach))


def test_rain_fills_the_film_of_a_class():
    little = after(0, past=0.3e-3)
    assert damp(HARD, little) == 1.0 and 0.1 < damp(SOIL, little) < 0.5
    assert damp(GRASS, little) < damp(SOIL, little)
    assert damp(HARD, after(0, past=0.0)) == 0.0
    assert damp(HARD, after(0, past=0.0, rate=10 / 3.6e6)) == 1.0  # it rains
    assert damp(HARD, after(0), reach=0.0) > 0.1  # spray


def test_ground_dries_by_class_and_faster_under_a_clear_sky():
    table = class_table()
    hours = {}
    for code in (HARD, SOIL):
        film, pores = (float(table.column(n)[code]) for n in ("storage", "porosity"))
        gone, dry = hours_to_dry(film, pores, after(0))
        hours[code] = dry
        assert damp(code, after(0.9 * gone)) == 1.0
        assert 0 < damp(code, after(0.5 * (gone + dry))) < 1
        assert damp(code, after(1.01 * dry)) == pytest.approx(0, abs=1e-6)
        assert wetness.film_left(after(1.01 * gone), film) == 0
    assert hours[SOIL] > 3 * hours[HARD]
    clear = hours_to_dry(0.3e-3, 0.05, after(0, cloudiness=0.0))
    dull = hours_to_dry(0.3e-3, 0.05, after(0, cloudiness=1.0))
    assert dull[1] == pytest.approx(6 * clear[1])
    # Gloss goes before darkness.
    config = after(hours_to_dry(0.3e-3, 0.05, after(0))[0] * 1.1)
    assert damp(HARD, config) > 0.5 and wetness.film_left(config, 0.3e-3) == 0


def test_puddles_evaporate_with_the_rest():
    scene = tiny_scene()
    config = after(0, extent=1.0, spacing=0.025, past=6e-3)
    terrain = extract_terrain(scene, config.terrain)
    reach = np.ones(terrain.grid.shape)
    fresh, _ = initial_water(terrain, config, reach)
    later, _ = initial_water(terrain, config.replace(drying=5 * 3600.0), reach)
    puddles = puddles_of(terrain)
    puddles.rain(6e-3 * reach)
    puddles.evaporate(5 * 0.1e-3)
    np.testing.assert_allclose(later, puddles.depth)
    assert later.sum() < fresh.sum()


def test_other_things_are_wetted_by_slanting_rain():
    calm, windy = wetness.others(after(0)), wetness.others(after(0, wind=(5.0, 0.0)))
    assert calm[1] == calm[2] == 0 and windy[1] > 0.5 and windy[2] == pytest.approx(0)
    assert wetness.others(after(0, past=0.0))[0] == 0
    assert wetness.others(after(400))[0] == 0
