"""Rain, water and rings on the twin, frame by frame, in the simulator, against the CPU's."""

import dataclasses
import functools

import numpy as np
import pytest

from rainsim import simulation
from rainsim.config.settings import Config, mm_per_hour
from rainsim.cuda import simulated
from rainsim.cuda import simulation as twin
from rainsim.cuda.water.ripples import Ripples
from rainsim.errors import ParameterError
from rainsim.pipeline import extract_terrain
from rainsim.rain.dripping import KEPT
from rainsim.water.ripples import RippleTile
from scenes import rolling_scene, tiny_scene

assert simulated()
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.fixture(autouse=True)
def small_tile(monkeypatch):
    """Rings on few cells."""
    small = functools.partial(simulation.RippleTile, cells=16, size=0.5)
    monkeypatch.setattr(simulation, "RippleTile", small)


def test_frames_are_those_of_the_cpu():
    config = Config().replace(
        rate=mm_per_hour(200.0), past=3e-3, extent=0.5, spacing=0.1, wind=(0.5, 0.2), fps=60.0,
        scheme="lean", frames=3,
    )  # fmt: skip
    terrain = extract_terrain(tiny_scene(), config)
    wanted = simulation.simulate(terrain, config)
    found = twin.simulate(terrain, config)
    depths = []
    for _ in range(3):
        cpu, gpu = next(wanted), next(found)
        assert gpu.index == cpu.index and gpu.time == cpu.time
        depth = gpu.depth.copy_to_host()
        np.testing.assert_allclose(depth, cpu.depth, atol=1e-8)
        moments = gpu.moments.copy_to_host()
        slopes = np.moveaxis(moments[:, : len(moments), :2], -1, 0)
        assert np.abs(slopes - cpu.slopes).max() < 1e-3 * np.abs(cpu.slopes).max()
        ledger = gpu.ledger
        for name in ("initial", "rain", "obstacles", "airborne", "ground", "outflow"):
            assert ledger[name] == pytest.approx(cpu.ledger[name], rel=1e-5, abs=1e-12), name
        assert abs(ledger["residual"]) < 1e-6
        known = np.isin(gpu.drip_id, cpu.drip_id)  # some landed longer ago than the host keeps
        np.testing.assert_array_equal(gpu.drip_id[known], cpu.drip_id)
        np.testing.assert_allclose(gpu.drips[known], cpu.drips, rtol=1e-9, atol=1e-12)
        assert (gpu.drips[~known, 6] < gpu.time - KEPT).all()
        np.testing.assert_allclose(gpu.top_water, cpu.top_water, rtol=1e-9)
        depths.append(depth)
    assert (depths[2] != depths[1]).any() and np.abs(cpu.slopes).max() > 1e-6


def test_a_level_that_moves_is_followed():
    config = Config().replace(rate=0.0, extent=0.5, spacing=0.1, fps=20.0, scheme="lean", frames=6)
    terrain = extract_terrain(tiny_scene(), config)
    keys = tuple((t, (("level", h),)) for t, h in ((0.0, 0.02), (0.1, 0.05), (0.25, 0.01)))
    config = dataclasses.replace(config, keyframes=keys)
    wanted, found = simulation.simulate(terrain, config), twin.simulate(terrain, config)
    depths = []
    for _ in range(6):
        cpu, gpu = next(wanted), next(found)
        depths.append(gpu.depth.copy_to_host())
        np.testing.assert_allclose(depths[-1], cpu.depth, atol=1e-6)
        for name in ("initial", "inflow", "drained", "ground"):
            assert gpu.ledger[name] == pytest.approx(cpu.ledger[name], rel=1e-5, abs=1e-9), name
        assert abs(gpu.ledger["residual"]) < 1e-6
    assert depths[2].max() > 1.2 * depths[0].max() > 1.2 * depths[5].max()
    assert gpu.ledger["inflow"] > 0 and gpu.ledger["drained"] > 0


def test_what_moves_over_the_water_is_followed():
    """The shelter of a box that rolls over the water; the host sees the device's depths."""
    config = Config().replace(
        rate=mm_per_hour(200.0), past=8e-3, extent=0.7, spacing=0.05, wind=(0.5, 0.2), fps=12.0,
        scheme="lean", frames=6,
    )  # fmt: skip
    terrain = extract_terrain(rolling_scene(), config)
    assert len(terrain.footprints) == 1
    wanted, found = simulation.simulate(terrain, config), twin.simulate(terrain, config)
    still = twin.simulate(dataclasses.replace(terrain, footprints=()), config)
    for _ in range(5):
        cpu, gpu, without = next(wanted), next(found), next(still)
        depth = gpu.depth.copy_to_host()
        np.testing.assert_allclose(depth, cpu.depth, atol=1e-7)
        moments = gpu.moments.copy_to_host()
        slopes = np.moveaxis(moments[:, : len(moments), :2], -1, 0)
        assert np.abs(slopes - cpu.slopes).max() < 1e-3 * np.abs(cpu.slopes).max()
        ledger = gpu.ledger
        for name, volume in cpu.ledger.items():
            assert ledger[name] == pytest.approx(volume, rel=1e-4, abs=1e-9), name
        assert abs(ledger["residual"]) < 1e-6
    assert np.abs(without.depth.copy_to_host() - depth).max() > 1e-6


def test_what_fails_beside_the_drawing_is_raised_by_the_next_step(monkeypatch):
    config = Config().replace(rate=mm_per_hour(20.0), extent=0.5, spacing=0.1, scheme="lean")
    run = twin.simulate(extract_terrain(tiny_scene(), config), config)
    monkeypatch.setattr(twin, "may_run_beside", lambda: True)
    monkeypatch.setattr(simulation, "rain_on", lambda *_: 1 / 0)
    next(run)
    with pytest.raises(ZeroDivisionError):
        next(run)


def test_rings_on_cells_that_cannot_be_transformed_are_refused():
    with pytest.raises(ParameterError, match="power of two"):
        Ripples(RippleTile(cells=24), 1 / 30)
