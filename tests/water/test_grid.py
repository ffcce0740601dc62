"""The water solver: exact solutions, invariants with a mover beside each, the ledger, bad input."""

import math

import numpy as np
import pytest

from rainsim.errors import DivergedError, ParameterError
from rainsim.grid import WaterSolver
from rainsim.numerics.approximations import cube_root
from rainsim.water.bundles import Ground, StepNumbers
from rainsim.water.paper import BLOCK, accelerate_rough, extrapolate, flow, slowed
from rainsim.water.sources import apply_sources

G = 9.81
DTYPES = [np.float32, np.float64]


def rough_bed(n=48):
    """A bed with waves, noise, single tall cells and an island, and a lake of level 0.2 m on it."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:n, :n] * (10 / n)
    bed = 0.3 * np.sin(1.3 * x) * np.cos(1.7 * y) + 0.15 * rng.random((n, n))
    bed[rng.random((n, n)) < 0.01] += 1.0
    bed[n // 4 : n // 3, n // 4 : n // 3] = 1.2
    return bed, np.maximum(0.2 - bed, 0.0)


def dam_break(n, right, time=6.0, left=0.005, length=10.0, dtype=np.float32):
    """Return (depth along the middle, x) after a dam between two depths [m] has gone."""
    x = (np.arange(n) + 0.5) * length / n
    solver = WaterSolver(np.zeros((8, n)), length / n, dtype=dtype)
    solver.set_state(np.broadcast_to(np.where(x < length / 2, left, right), (8, n)))
    solver.advance(time)
    return solver.depth[4].astype(float), x


def ritter(x, left=0.005, middle=5.0, time=6.0):
    """Exact depth of a dam break on dry ground (Ritter 1892; SWASHES 3.1.2)."""
    c = math.sqrt(G * left)
    fan = 4 / (9 * G) * (c - (x - middle) / (2 * time)) ** 2
    return np.where(x < middle - time * c, left, np.where(x < middle + 2 * time * c, fan, 0.0))


def stoker(x, left=0.005, right=0.001, middle=5.0, time=6.0):
    """Exact depth of a dam break on shallower water (Stoker 1957; SWASHES 3.1.1)."""
    c_left, c_right = math.sqrt(G * left), math.sqrt(G * right)

    def mismatch(c):
        jump = c**2 - c_right**2
        return -8 * c_right**2 * c**2 * (c_left - c) ** 2 + jump**2 * (c**2 + c_right**2)

    low, high = 1.0001 * c_right, 0.9999 * c_left
    for _ in range(80):
        c = 0.5 * (low + high)
        low, high = (c, high) if mismatch(low) * mismatch(c) > 0 else (low, c)
    shock = middle + time * 2 * c**2 * (c_left - c) / (c**2 - c_right**2)
    fan = 4 / (9 * G) * (c_left - (x - middle) / (2 * time)) ** 2
    after_fan = np.where(x < shock, c**2 / G, right)
    within = np.where(x < middle + time * (2 * c_left - 3 * c), fan, after_fan)
    return np.where(x < middle - time * c_left, left, within)


@pytest.mark.parametrize("dtype", DTYPES)
def test_lake_at_rest_stays_and_costs_nothing(dtype):
    bed, depth = rough_bed()
    solver = WaterSolver(bed, 0.2, dtype=dtype)
    solver.set_state(depth)
    before = solver.depth
    solver.advance(1.0)
    report = solver.advance(1000.0)
    assert report.max_speed == 0.0
    assert report.substeps == 0
    assert report.time == 1001.0
    np.testing.assert_array_equal(solver.depth, before)


def test_lake_with_a_bump_moves():
    bed, depth = rough_bed()
    solver = WaterSolver(bed, 0.2)
    depth[depth > 0.3] += 0.05
    solver.set_state(depth)
    before = solver.depth
    report = solver.advance(1.0)
    assert report.max_speed > 0.05
    assert report.substeps > 3
    assert np.abs(solver.depth - before).max() > 0.01
    assert abs(report.residual) < 1e-12


# The scheme's errors at 256 cells are .024 and .017; before the step they are .6 and 1.2.
@pytest.mark.parametrize(
    ("right", "exact", "bound"), [(0.001, stoker, 0.027), (0.0, ritter, 0.020)]
)
def test_dam_break(right, exact, bound):
    depth, x = dam_break(256, right)
    truth = exact(x)
    assert np.abs(depth - truth).mean() / truth.mean() < bound
    still = np.where(x < 5, 0.005, right)
    assert np.abs(still - truth).mean() / truth.mean() > 4 * bound


@pytest.mark.parametrize("dtype", DTYPES)
def test_rain_on_a_slope_signals_the_exact_depth(dtype):
    # Kinematic wave in equilibrium: q = rain * x = h^(5/3) sqrt(slope) / n.
    slope, rough, rain, spacing, nx = 0.01, 0.02, 50 / 3.6e6, 0.25, 40
    bed = -slope * spacing * np.broadcast_to(np.arange(nx), (4, nx))
    solver = WaterSolver(bed, spacing, boundary={"east": "open"}, manning=rough, dtype=dtype)
    solver.advance(400.0, rain=rain)
    x = (np.arange(nx) + 1.0) * spacing  # at the east face, where upwind depth makes the flux
    truth = (rough * rain * x / math.sqrt(slope)) ** 0.6
    np.testing.assert_allclose(solver.depth[2, 8:-2], truth[8:-2], rtol=0.02)
    assert solver.discharge("east") == pytest.approx(rain * nx * 4 * spacing**2, rel=2e-3)
    assert solver.discharge("west") == 0.0


@pytest.mark.parametrize("scheme", ["accurate", "lean"])
def test_rain_on_dry_ground_flows_from_the_first_step_on(scheme):
    slope = -0.1 * np.arange(12) * np.ones((6, 1))
    solver = WaterSolver(slope, 1.0, scheme=scheme)
    report = solver.advance(0.02, rain=1e-3)
    fall = solver.gravity * 0.02 * 0.1  # m/s, what gravity makes of the slope in that step
    assert report.substeps == 1 and report.max_speed == pytest.approx(fall, rel=0.01)
    assert solver.advance(0.5, rain=1e-3).max_speed > 10 * fall
    dry, level = WaterSolver(slope, 1.0, scheme=scheme), WaterSolver(0 * slope, 1.0, scheme=scheme)
    assert dry.advance(0.5).max_speed == 0 == level.advance(0.5, rain=1e-3).max_speed


@pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 1e-12), (np.float32, 1e-9)])
def test_ledger_closes_with_every_term_in_play(dtype, bound):
    bed, depth = rough_bed(32)
    rng = np.random.default_rng(2)
    solver = WaterSolver(
        bed, 0.3, boundary={"west": "open", "north": "open"}, manning=0.03,
        storage=0.001 * rng.random(bed.shape), infiltration=1e-6 * rng.random(bed.shape),
        dtype=dtype,
    )  # fmt: skip
    solver.set_state(0.5 * depth, u=0.1, v=-0.2)
    drops = 0.0
    for _ in range(5):
        volumes = 1e-6 * rng.random(200)
        solver.deposit(rng.integers(0, 32, 200), rng.integers(0, 32, 200), volumes)
        drops += volumes.sum()
        report = solver.advance(0.4, rain=1e-5 * rng.random(bed.shape))
        assert abs(report.residual) < bound
    ledger = report.ledger
    assert ledger.initial == pytest.approx(0.5 * depth.sum() * 0.09, rel=1e-6)
    assert ledger.rain > drops
    for name in ("ground", "film", "infiltrated", "outflow"):
        assert getattr(ledger, name) > 0.0, name
    assert ledger.as_dict()["residual"] == report.residual
    assert solver.depth.sum(dtype=float) * 0.09 == pytest.approx(ledger.ground + ledger.film, 1e-6)


def test_film_on_a_steep_rough_slope_keeps_its_volume_and_sign():
    n = 32
    rng = np.random.default_rng(0)
    bed = -(np.arange(n) / n) * 2.0 + 0.01 * rng.random((n, n))
    solver = WaterSolver(bed, 2.0 / n)
    solver.set_state(1e-4)
    deepest = 0.0
    for _ in range(50):
        report = solver.advance(0.05)
        assert report.min_depth >= 0.0
        deepest = max(deepest, solver.depth.max())
        bound = 2 * math.sqrt(G * deepest) + math.sqrt(2 * G * (np.ptp(bed) + deepest))
        assert report.max_speed < bound
    assert abs(report.residual) < 1e-10
    assert solver.depth[:, -4:].mean() > 5e-4  # it has run down


def test_float32_does_not_lose_rain_on_deep_water():
    solver = WaterSolver(np.zeros((4, 4)), 0.02)
    solver.set_state(0.3)
    rate = 50 / 3.6e6
    for _ in range(1000):
        solver.advance(1e-3, rain=rate)  # 1.4e-8 m at a time, under half the rounding of 0.3 m
    np.testing.assert_allclose(solver.depth - np.float32(0.3), rate, rtol=5e-3)


def test_a_drop_on_dry_ground_waits_in_the_film():
    solver = WaterSolver(np.zeros((5, 5)), 0.1, storage=1e-3)
    solver.deposit([2, 2], [3, 3], [4e-9, 6e-9])  # 1e-6 m, less than can flow
    report = solver.advance(0.1)
    assert solver.depth[2, 3] == pytest.approx(1e-6)
    assert report.ledger.film == pytest.approx(1e-8)
    solver.deposit([2], [3], [1e-4])  # 10 mm: all but the storage flows away
    solver.advance(20.0)
    assert solver.depth[2, 3] > 1e-3
    assert solver.depth[2, 2] > 1e-3
    assert abs(solver.advance(0.1).residual) < 1e-7


def test_a_drop_too_small_to_flow_is_kept():
    solver = WaterSolver(np.zeros((5, 5)), 0.1)
    for _ in range(3):
        solver.deposit([2], [2], [4e-9])
        report = solver.advance(0.1)
        assert report.ledger.ground == pytest.approx(report.ledger.rain, rel=1e-6)
    assert report.ledger.rain == pytest.approx(1.2e-8)
    solver.advance(60.0)
    assert solver.depth[2, 2] < 1.19e-6  # three of them flow, slowly
    assert solver.depth[2, 1] > 1e-9


def test_the_ground_drinks_no_more_than_there_is():
    solver = WaterSolver(np.zeros((4, 6)), 0.1, infiltration=1e-4, storage=1e-3)
    solver.set_state(2e-3)
    ledger = solver.advance(100.0).ledger
    assert ledger.infiltrated == pytest.approx(ledger.initial, rel=1e-6)
    assert solver.depth.max() == pytest.approx(0.0, abs=1e-12)
    assert solver.advance(100.0).substeps == 0


def test_water_leaves_through_an_open_edge_only():
    bed = 0.01 * np.broadcast_to(np.arange(12.0)[:, None], (12, 6))  # falls to the south
    left = {}
    for kind in ("wall", "open"):
        solver = WaterSolver(bed, 0.1, boundary={"south": kind}, manning=0.01)
        solver.set_state(0.01)
        solver.advance(2.0)
        left[kind] = solver.advance(0.0).ledger.outflow
        assert (solver.discharge("south") > 0.0) == (kind == "open")
    assert left["wall"] == 0.0
    assert left["open"] > 0.3 * 0.01 * 72 * 0.01


@pytest.mark.parametrize("flip", [np.s_[::-1], np.s_[:, ::-1], "transpose"])
def test_mirrored_input_gives_mirrored_output(flip):
    def turned(a):
        return a.T if flip == "transpose" else a[flip]

    bed, depth = rough_bed(24)
    depth = depth + 0.1 * (np.hypot(*(np.mgrid[:24, :24] - 8)) < 4)
    ways = []
    for change in (lambda a: a, turned):
        solver = WaterSolver(change(bed), 0.4, manning=0.02, dtype=np.float64)
        solver.set_state(change(depth))
        solver.advance(2.0)
        ways.append(solver.depth)
    np.testing.assert_allclose(ways[1], turned(ways[0]), rtol=1e-9, atol=1e-12)
    assert np.abs(ways[0] - depth).max() > 0.01


def test_threads_agree(threads):
    bed, depth = rough_bed(40)
    results = []
    for count in (1, 2):
        threads(count)
        solver = WaterSolver(bed, 0.2, boundary="open", manning=0.02, storage=1e-4)
        solver.set_state(depth, u=0.3)
        report = solver.advance(1.0, rain=1e-4)
        results.append((solver.depth, *solver.velocity, np.float64(report.ledger.outflow)))
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("scheme", ["accurate", "paper"])
def test_fields_are_allocated_once(scheme):
    solver = WaterSolver(np.zeros((8, 8)), 0.1, scheme=scheme)
    solver.set_state(0.1 + 0.05 * (np.arange(64).reshape(8, 8) > 30))
    flow = solver.flow

    def places():
        return {array.ctypes.data for array in (*flow.water, *flow._spare)}

    owned = places()
    assert len(owned) >= 6
    for _ in range(10):
        solver.advance(0.1)
        assert places() == owned


def test_kernels_write_every_inner_value(poisoned):
    rng = np.random.default_rng(3)
    ny, nx, dtype = BLOCK + 3, 7, np.float32
    h = np.where(rng.random((ny, nx)) < 0.5, rng.random((ny, nx)), 0).astype(dtype)
    bed, u, v = (rng.random(s).astype(dtype) for s in ((ny, nx), (ny, nx + 1), (ny + 1, nx)))
    u[:, [0, -1]] = v[[0, -1]] = 0
    h_out, u_out, v_out = poisoned(h.shape), poisoned(u.shape), poisoned(v.shape)
    remainder = np.zeros_like(h)
    flow(h, u, v, dtype(0.2), dtype(1e-6), remainder, h_out, u_out, v_out)
    assert np.isfinite(h_out).all()
    assert np.isfinite(u_out[:, 1:-1]).all()
    assert np.isfinite(v_out[1:-1]).all()
    assert (h_out + remainder).sum(dtype=float) == pytest.approx(h.sum(dtype=float), rel=1e-6)
    assert np.abs(h_out - h).max() > 0.01

    numbers = StepNumbers(*(dtype(a) for a in (0.2, 0.1, 0.0, G, 3.0, 1e-7, 1e-6)))
    for drag in (dtype(0), dtype(0.01)):
        signals = poisoned((2, nx))
        a, b = u.copy(), v.copy()
        accelerate_rough(h, Ground(bed, bed), u, v, drag, numbers, a, b, signals)
        assert signals.max() == pytest.approx(_fastest_signal(h, a, b), rel=1e-6)
        assert np.abs(a - u)[:, 1:-1].max() > 0.01

    extrapolate(h, u, v, u_out, v_out)
    assert np.isfinite(u_out[:, 1:-1]).all()
    assert np.isfinite(v_out[1:-1]).all()
    infiltrated = poisoned(1, np.float64)
    film = np.zeros_like(h)
    tiles = np.array([[0, ny, 0, nx]])
    apply_sources(tiles, bed, bed, bed, 0.1, 1e-6, h_out, remainder, film, infiltrated)
    assert np.isfinite(infiltrated).all()


def _fastest_signal(h, u, v):
    """Largest |speed| + max(wave speed, |speed|) over the inner faces, plainly."""
    deep_u, deep_v = np.maximum(h[:, 1:], h[:, :-1]), np.maximum(h[1:], h[:-1])
    w, x = np.abs(u[:, 1:-1]), np.abs(v[1:-1])
    return max(
        (w + np.maximum(np.sqrt(G * deep_u), w)).max(),
        (x + np.maximum(np.sqrt(G * deep_v), x)).max(),
    )


def test_extrapolation_fills_dry_faces_from_wet_ones():
    h = np.zeros((3, 5), np.float32)
    h[1, 0] = 1.0  # its east face is wet; the next face east is dry
    u, v = np.zeros((3, 6), np.float32), np.zeros((4, 5), np.float32)
    u[1, 1] = 2.0
    u_out, v_out = np.zeros_like(u), np.zeros_like(v)
    extrapolate(h, u, v, u_out, v_out)
    expected = np.zeros_like(u)
    expected[1, 1] = expected[1, 2] = expected[0, 1] = expected[2, 1] = 2.0
    np.testing.assert_array_equal(u_out, expected)


def test_velocity_starts_on_faces_between_wet_cells_and_is_carried():
    bed = np.zeros((6, 30))
    bed[:, 20:] = 1.0
    solver = WaterSolver(bed, 0.1, boundary="open")
    depth = np.where(np.arange(30) < 20, 0.2, 0.0) * np.ones((6, 1))
    solver.set_state(depth, u=0.4)
    u, v = solver.velocity
    np.testing.assert_allclose(u[:, 2:19], 0.4, rtol=1e-6)
    np.testing.assert_array_equal(u[:, 20:], 0.0)  # nothing flows up the step
    np.testing.assert_array_equal(v, 0.0)
    assert solver.discharge("west") == 0.0  # inward, which an open edge does not let in
    solver.advance(0.2)
    assert solver.depth[3, 19] > 0.21  # it piles up at the step


@pytest.mark.parametrize("depth", np.geomspace(1e-6, 100.0, 9))
def test_cube_root(depth):
    assert cube_root(depth) ** 3 == pytest.approx(depth, rel=1e-5)


@pytest.mark.parametrize("along", [0.0, 0.3, -2.0])
@pytest.mark.parametrize("wanted", [-4.0, 1e-3, 0.5])
def test_friction_solves_its_equation(wanted, along):
    depth, drag = 0.003, 9.81 * 0.01 * 0.03**2
    w = slowed(wanted, along, depth, depth, 0.0, 0.0, drag, 1e-6)
    c = drag / depth ** (4 / 3)
    assert w * (1 + c * math.hypot(w, along)) == pytest.approx(wanted, rel=1e-2)
    assert abs(w) < abs(wanted)


def test_report_names_scheme_and_reason():
    report = WaterSolver(np.zeros((3, 3)), 0.1).advance(0.0)
    assert (report.scheme, report.substeps) == ("accurate", 0)
    assert report.reason.startswith("auto: ")
    assert WaterSolver(np.zeros((3, 3)), 0.1, scheme="paper").advance(0.0).reason


def test_absurd_speed_is_divergence_not_a_number():
    solver = WaterSolver(np.zeros((4, 4)), 0.1)
    solver.set_state(0.1, u=1e5)
    with pytest.raises(DivergedError, match="m/s"):
        solver.advance(1.0)


FLAT = np.zeros((4, 5))
HOLED = np.where(np.arange(20).reshape(4, 5) == 7, np.nan, 0.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: WaterSolver(HOLED, 0.1), "bed is nan at row 1, column 2"),
        (lambda: WaterSolver(np.zeros(4), 0.1), r"shape \(4,\)"),
        (lambda: WaterSolver(FLAT, 0.0), "spacing is 0.0 m"),
        (lambda: WaterSolver(FLAT, 0.1, scheme="magic"), "scheme is 'magic'.*auto, accurate, lean"),
        (lambda: WaterSolver(FLAT, 0.1, courant=0.9), "courant is 0.9.*from 0.001 to 0.7"),
        (lambda: WaterSolver(FLAT, 0.1, boundary="lid"), "'lid'.*wall, open"),
        (lambda: WaterSolver(FLAT, 0.1, boundary={"up": "wall"}), "'up'.*west, east"),
        (lambda: WaterSolver(FLAT, 0.1, manning=np.zeros((5, 4))), r"manning has shape \(5, 4\)"),
        (lambda: WaterSolver(FLAT, 0.1, storage=-1.0), "storage is -1.0"),
        (lambda: WaterSolver(FLAT, 0.1, infiltration=np.inf), "infiltration is inf"),
        (lambda: WaterSolver(FLAT, 0.1, dtype=np.float16), "float16"),
        (lambda: WaterSolver(FLAT, 0.1).set_state(-0.1), "depth is -0.1"),
        (lambda: WaterSolver(FLAT, 0.1).set_state(0.1, u=np.nan), "u is nan"),
        (lambda: WaterSolver(FLAT, 0.1).advance(-1.0), "duration is -1.0"),
        (lambda: WaterSolver(FLAT, 0.1).advance(1.0, rain=-1e-6), "rain is -1e-06"),
        (lambda: WaterSolver(FLAT, 0.1).deposit([0], [5], [1e-9]), "columns.*0 to 4"),
        (lambda: WaterSolver(FLAT, 0.1).deposit([0.5], [1], [1e-9]), "rows.*whole"),
        (lambda: WaterSolver(FLAT, 0.1).deposit([0], [1], [-1e-9]), "-1e-09 m3"),
        (lambda: WaterSolver(FLAT, 0.1).deposit([0, 1], [1], [1e-9]), "one length"),
        (lambda: WaterSolver(FLAT, 0.1).discharge("up"), "'up'.*west"),
    ],
)
def test_bad_input_is_named(call, words):
    with pytest.raises(ParameterError, match=words):
        call()
