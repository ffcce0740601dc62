"""Random terrains under random weather: every scheme keeps volume, depth and speed in bounds.

The default lane takes a few terrains and steps. The campaign takes 50 terrains and 10^5 steps in
all for each scheme; by hand, with figures by terrain and STEPS on each:
`PYTHONPATH=.:tests python benchmarks/tests/test_water_campaign.py SCHEME TERRAINS STEPS SEED`.
"""

import sys
import time
from typing import NamedTuple

import numpy as np
import pytest

from benchmarks.stress import MOST_SPEED, _Extremes
from rainsim.errors import DivergedError
from rainsim.grid import WaterSolver
from rainsim.jit import set_threads

SCHEMES = ("accurate", "lean", "auto")
TERRAINS, STEPS, SEED = 50, 2_000, 16
QUICK_TERRAINS, QUICK_STEPS = 8, 600
MOST_DRIFT = 1e-6
# s for a metre of a cell: between looks water must not rise and fall unseen, or the bound of its
# speed, which follows from the highest surface that was seen, comes out too low.
LOOK = 0.5
SIDES = 24, 48  # cells
BURST = 300 / 3.6e6  # m/s of rain at most
POUR = 0.3  # m that a column of water poured at once has at most
DRY_SPELL, POURING = 0.3, 0.05  # shares of the frames without rain, and with a column of water
LARGEST_DROP = 1e-6  # m3


class Ground(NamedTuple):
    """A terrain and what stands and happens on it, SI units."""

    bed: np.ndarray
    spacing: float
    depth: np.ndarray
    options: dict


def random_ground(seed):
    """Slopes, hills, noise, steps, walls and pits; dry, flooded or with columns of water."""
    rng = np.random.default_rng(seed)
    ny, nx = rng.integers(SIDES[0], SIDES[1] + 1, 2)
    y, x = np.mgrid[:ny, :nx] / max(ny, nx)
    bed = rng.uniform(-0.5, 0.5) * x + rng.uniform(-0.5, 0.5) * y
    bed += rng.uniform(0, 0.1) * np.sin(rng.uniform(3, 20) * x) * np.cos(rng.uniform(3, 20) * y)
    bed += 10.0 ** rng.uniform(-4, -1.5) * rng.random(bed.shape)
    if rng.random() < 0.4:  # steps
        side = int(rng.integers(3, 8))
        blocks = rng.random((-(-ny // side), -(-nx // side)))
        bed += rng.uniform(0.05, 2) * np.kron(blocks, np.ones((side, side)))[:ny, :nx]
    for height in rng.choice([-1.0, -0.2, 0.1, 0.5, 3.0], rng.integers(0, 5)):  # pits and walls
        j, i = rng.integers(0, ny - 2), rng.integers(0, nx - 2)
        high, wide = (1, rng.integers(4, nx)) if rng.random() < 0.5 else (rng.integers(2, ny), 2)
        bed[j : j + high, i : i + wide] += height
    depth = np.zeros(bed.shape)
    start = rng.random()
    if start < 0.3:  # a lake
        depth = np.maximum(np.quantile(bed, rng.uniform(0.1, 0.9)) - bed, 0)
    elif start < 0.7:  # columns of water on dry ground
        for _ in range(rng.integers(1, 4)):
            away = np.hypot(x - rng.random(), y - rng.random())
            depth = np.maximum(depth, np.where(away < 0.15, rng.uniform(0.01, 0.5), 0))
    count = int(rng.integers(0, 4))
    cells = rng.choice(ny * nx, count, replace=False)
    options = {
        "manning": float(rng.choice([0.0, 0.02, 0.05])),
        "boundary": "open" if rng.random() < 0.4 else "wall",
        "drains": [(c // nx, c % nx, 10.0 ** rng.uniform(-5, -1)) for c in cells.tolist()],
        "storage": float(rng.choice([0.0, 1e-3])),
        "infiltration": float(rng.choice([0.0, 1e-5])),
    }
    return Ground(bed, float(rng.choice([0.01, 0.05, 0.2])), depth, options)


@pytest.fixture(autouse=True)
def one_thread(threads):
    """Two take longer for so small a map."""
    threads(1)


def endure(ground, scheme, steps, seed, dtype=np.float32):
    """Let it rain in bursts, drop and pour on a ground for at least `steps` steps; return facts."""
    rng, begun = np.random.default_rng(seed), time.perf_counter()
    solver = WaterSolver(ground.bed, ground.spacing, scheme, dtype=dtype, **ground.options)
    solver.set_state(ground.depth)
    extremes, count, drift, fastest = _Extremes(ground.bed, ground.depth), 0, 0.0, 0.0
    ny, nx = ground.bed.shape
    while count < steps:
        before, weather = solver.depth.astype(np.float64), rng.random()
        rain = 0.0 if weather < DRY_SPELL else BURST * rng.random() ** 3
        if weather > 1 - POURING:
            j, i = rng.integers(0, ny), rng.integers(0, nx)
            before[j, i] += (height := POUR * rng.random())
            solver.deposit(j, i, height * ground.spacing**2)
            extremes.update(before)  # what is poured counts for the bound of the speed
        places = rng.integers(0, ny, 10), rng.integers(0, nx, 10)
        solver.deposit(*places, LARGEST_DROP * rng.random(10) ** 3)
        report = solver.advance(LOOK * ground.spacing, rain=rain)
        depth, velocity = solver.depth, solver.velocity
        assert np.isfinite(depth).all() and np.isfinite(velocity).all()
        assert depth.min() >= 0
        extremes.update(depth, report)
        count, drift = count + report.substeps, max(drift, abs(report.residual))
        fastest = max(fastest, report.max_speed)
    return {
        "steps": count, "drift": drift, "speed": extremes.speed, "least": extremes.least,
        "moved": extremes.moved, "fastest": fastest, "drained": solver.ledger.drained,
        "seconds": time.perf_counter() - begun,
    }  # fmt: skip


def require_bounds(facts):
    """Volume, depth and speed hold, and the water has moved: nothing at all holds everything."""
    assert facts["drift"] <= MOST_DRIFT, facts
    assert facts["least"] >= 0, facts
    assert facts["speed"] <= MOST_SPEED, facts
    assert facts["moved"] > 1e-3 and facts["fastest"] > 0.01, facts


def campaign(scheme, terrains, steps, seed, say=print):
    """Run a campaign; return the facts of each terrain, or its error."""
    found = []
    for number in range(terrains):
        try:
            facts = endure(random_ground((seed, number)), scheme, steps, (seed, number))
        except (AssertionError, DivergedError) as error:
            facts = {"error": f"{type(error).__name__} {error}"}
        say(number, random_ground((seed, number)).bed.shape, facts)
        found.append(facts)
    return found


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_few_terrains(scheme):
    for number in range(QUICK_TERRAINS):
        ground = random_ground((SEED, number))
        require_bounds(endure(ground, scheme, QUICK_STEPS, (SEED, number)))


def test_grounds_are_many_and_what_is_asked_for_happens():
    grounds = [random_ground((SEED, number)) for number in range(TERRAINS)]
    assert len({ground.bed.tobytes() for ground in grounds}) == TERRAINS
    assert {ground.options["boundary"] for ground in grounds} == {"open", "wall"}
    assert sum(ground.depth.max() > 0 for ground in grounds) > TERRAINS // 4
    assert sum((ground.depth == 0).mean() > 0.3 for ground in grounds) > TERRAINS // 4  # dry fronts
    assert max(np.ptp(ground.bed) for ground in grounds) > 2
    drained = next(ground for ground in grounds if ground.options["drains"])
    assert endure(drained, "lean", QUICK_STEPS, SEED)["drained"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_campaign(scheme):
    for facts in campaign(scheme, TERRAINS, STEPS, SEED):
        assert "error" not in facts, facts
        require_bounds(facts)


def main(scheme, terrains, steps, seed):
    """Run a campaign by hand; say what was worst."""
    set_threads(1)
    found = campaign(scheme, int(terrains), int(steps), int(seed))
    whole = [facts for facts in found if "error" not in facts]
    print(len(whole), "of", len(found), "ended;", sum(f["steps"] for f in whole), "steps", end="; ")
    print({name: max(f[name] for f in whole) for name in ("drift", "speed", "fastest")}, end="; ")
    print("seconds", round(sum(f["seconds"] for f in whole)), [f for f in found if "error" in f])


if __name__ == "__main__":
    main(*sys.argv[1:])
