"""`bench growth`: fits find the exponent that times were made with; halves look like the whole."""

from dataclasses import replace

import numpy as np
import pytest

import factories
from benchmarks import chart, growth
from rainsim.raster import prepare, rasterize
from rainsim.scene.cameras import look_at


def rows_of(power, counts=(1000, 2000, 8000)):
    return [{"count": n, "least_ms": 3e-3 * n**power, "water_ms": 1.0} for n in counts]


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_the_exponent_is_that_of_the_times(power):
    assert growth.exponent(rows_of(power)) == pytest.approx(power, abs=1e-9)
    assert growth.exponent(rows_of(power), "water_ms") == pytest.approx(0, abs=1e-9)


def test_one_count_or_no_wet_pixel_has_no_exponent():
    assert np.isnan(growth.exponent(rows_of(1.0, (1000,))))
    assert np.isnan(growth.exponent(rows_of(1.0, (0, 1000))))


def test_halved_splats_are_twice_as_many_and_look_the_same():
    rng = np.random.default_rng(5)
    n = 400
    turn = rng.normal(size=(n, 4))
    splats = factories.splats(
        rng.uniform(-0.5, 0.5, (n, 3)), turn / np.linalg.norm(turn, axis=1)[:, None],
        rng.uniform(0.01, 0.05, (n, 3)), rng.uniform(0.1, 0.9, n), rng.normal(0, 0.5, (n, 1, 3)),
    )  # fmt: skip
    camera = look_at((0, -2, 0), (0, 0, 0), (0, 0, 1), 40, 48, 48)
    halves = growth.halved(splats)
    assert len(halves) == 2 * n
    whole, two, gone = (
        rasterize(prepare(s), camera).color
        for s in (splats, halves, replace(splats, opacity=0 * splats.opacity))
    )
    assert np.abs(two - whole).mean() < 0.15 * np.abs(gone - whole).mean()


@pytest.mark.slow
def test_a_quick_run_measures_every_quantity(tmp_path):
    result = growth.run(quick=True)
    assert [row["quantity"] for row in result["rows"]] == [
        name for name in growth.QUANTITIES for _ in range(2)
    ]
    for quantity in growth.QUANTITIES:
        first, second = (row for row in result["rows"] if row["quantity"] == quantity)
        assert 0 < first["count"] < second["count"]
        assert min(first["least_ms"], second["least_ms"], first["water_ms"]) > 0
    assert "| bicycle | wet pixels |" in growth.table(result)
    chart.require_matplotlib()
    growth.draw(result, tmp_path / "c.png")
    assert (tmp_path / "c.png").stat().st_size > 10_000
