"""Wetness: films fill first and dry first, classes by their storage and pores."""

from types import SimpleNamespace

import numpy as np
import pytest

from rainsim.config.settings import Config
from rainsim.render.wet_ground import WetGround
from rainsim.shading import wetness
from rainsim.simulation import initial_water
from rainsim.terrain import extract_terrain
from rainsim.terrain.table import GRASS, HARD, SOIL, class_table
from rainsim.terrain.types import NO_LAYER
from rainsim.water.puddles import puddles_of
from rainsim.water.tracks import NO_TRACKS
from scenes import tiny_scene


def after(hours, **changes):
    base = {"rate": 0.0, "past": 3e-3, "cloudiness": 1.0, "drying": hours * 3600.0}
    return Config().replace(**{**base, **changes})


def hours_until(gone, config):
    """Return after how many dry hours gone(config) becomes true, by bisection."""
    low, high = 0.0, 1000.0
    assert gone(config.replace(drying=high * 3600)) and not gone(config.replace(drying=0.0))
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (low, middle) if gone(config.replace(drying=middle * 3600)) else (middle, high)
    return high


def hours_to_dry(code, config):
    """Return the hours until the film, and until the darkening, of a class are gone."""
    film = class_table().column("storage")[code]
    return (
        hours_until(lambda later: wetness.film_left(later, film) == 0, config),
        hours_until(lambda later: damp(code, later) == 0, config),
    )


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
    table, dull, clear = class_table(), after(0), after(0, cloudiness=0.0)
    dry = {}
    for code in (HARD, SOIL):
        film, pores = (float(table.column(n)[code]) for n in ("storage", "porosity"))
        gone, dry[code] = hours_to_dry(code, dull)
        # A dull sky takes 0.1 mm an hour, a clear one 0.6 mm; 10 mm of ground show their pores.
        assert gone == pytest.approx(film / 0.1e-3)
        assert dry[code] == pytest.approx((film + 10e-3 * pores) / 0.1e-3)
        assert hours_to_dry(code, clear) == pytest.approx((gone / 6, dry[code] / 6))
        assert damp(code, after(0.9 * gone)) == 1.0
        # Gloss goes before darkness, which wanes from then on.
        waning = [damp(code, after(gone + k * (dry[code] - gone))) for k in (0.1, 0.5, 0.9)]
        assert waning == pytest.approx([0.9, 0.5, 0.1], abs=1e-5)
    assert dry[SOIL] > 3 * dry[HARD]


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
    calm = wetness.off_ground_wetness(after(0))
    windy = wetness.off_ground_wetness(after(0, wind=(5.0, 0.0)))
    assert calm.slant_x == calm.slant_y == 0
    assert windy.slant_x > 0.5 and windy.slant_y == pytest.approx(0)
    assert wetness.off_ground_wetness(after(0, past=0.0)).supply == 0
    assert wetness.off_ground_wetness(after(400)).supply == 0


@pytest.mark.parametrize("rows", [(), (0,), (2, 5), (7,)])
def test_tyres_thin_the_film_alone_and_only_where_they_rolled(rows):
    random = np.random.default_rng(1)
    before, tracks = random.random((8, 5, 4), np.float32), np.full((8, 5), 255, np.uint8)
    tracks[list(rows), 1:4] = random.integers(0, 255, (len(rows), 3))
    ground, film = before.copy(), wetness.Wetness._fields.index("film")
    expected = before.copy()
    expected[..., film] *= tracks.astype(np.float32) / np.float32(255)
    changed = wetness.thin_film(ground, tracks)
    np.testing.assert_array_equal(ground, expected)
    assert (changed.start, changed.stop) == ((rows[0], rows[-1] + 1) if rows else (0, 0))
    assert (expected != before).any() == bool(rows)


def test_tracks_of_each_time_lie_on_the_untouched_map_and_the_last_map_stays(monkeypatch):
    rng = np.random.default_rng(2)
    untouched = rng.random((9, 5, 4)).astype(np.float32)
    before, film = untouched.copy(), wetness.Wetness._fields.index("film")
    monkeypatch.setattr(wetness, "ground_wetness", lambda *_: untouched)
    terrain = SimpleNamespace(grassy=np.zeros((9, 5), bool), layer=NO_LAYER)
    ground = WetGround(terrain, None)
    ground.wet(None)
    assert ground.map is untouched
    last = None
    for first in (0, 3, 6, 1, 8):
        tracks = np.full((9, 5), 255, np.uint8)
        tracks[first : first + 2] = rng.integers(0, 200, tracks[first : first + 2].shape)
        kept = None if last is None else last.copy()
        assert ground.take_tracks(tracks) and not ground.take_tracks(tracks.copy())
        wanted = before.copy()
        wanted[..., film] *= tracks / np.float32(255)
        np.testing.assert_allclose(ground.map, wanted, rtol=1e-6)
        rows = ground.tracked.rows
        assert (rows.start, rows.stop) == (first, min(first + 2, 9))
        if last is not None:
            assert last is not ground.map
            np.testing.assert_array_equal(last, kept)
        last = ground.map
    np.testing.assert_array_equal(untouched, before)
    assert ground.take_tracks(NO_TRACKS) and ground.map is untouched
