"""`benchmarks stress`: volume and speed of the water on cases in which schemes fail.

Each case is a closed box, some with a drain. A record holds the ledger's residual, the largest
speed over the bound that the energy sets, 2 sqrt(g h) + sqrt(2 g fall) with running maxima, and the
smallest depth.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from benchmarks.chart import draw_marks
from benchmarks.suite import markdown, quiet
from rainsim.constants import GRAVITY
from rainsim.errors import DivergedError, ParameterError
from rainsim.grid import WaterSolver

SCHEMES = ("auto", "accurate", "lean", "paper")
COURANTS = (0.3, 0.5, 0.7, 0.9, 1.1)
MOST_DRIFT = {np.float32: 3e-6, np.float64: 1e-12}
LONG_DRIFT = 1e-5  # float32, after 1e5 steps
MOST_SPEED = 1.1  # of the energy bound
CELLS = {False: 64, True: 24}
SPAN = {False: 3.0, True: 0.5}  # s
TERRAINS = {False: 10, True: 2}
CHECKS = 30  # of the water, evenly in SPAN
LONG_STEPS = {False: 3_000, True: 300}  # of random rain
FRAME = 0.1  # s
DROPS = 40  # in a frame of random rain
LARGEST_DROP = 1e-6  # m3
HEAVIEST_RAIN = 100 / 3.6e6  # m/s


@dataclass(frozen=True)
class Trial:
    """A difficult case in a closed box, in SI units; maps of shape (ny, nx)."""

    name: str
    bed: np.ndarray
    spacing: float
    depth: np.ndarray
    rain: float = 0.0
    drains: tuple = ()
    infiltration: float = 0.0
    stays_dry: np.ndarray | None = None  # cells that no water can reach


def _grid(cells):
    y, x = (np.mgrid[:cells, :cells] + 0.5) * (2 / cells) - 1
    return x, y, 2 / cells


def dam(cells):
    """A column of water falls on dry ground and against a step."""
    x, y, spacing = _grid(cells)
    bed, start = np.where(x > 0.4, 0.15, 0.0), np.where(np.hypot(x + 0.3, y) < 0.3, 0.5, 0.0)
    return Trial("dam on a step", bed, spacing, start)


def film(cells):
    """A tenth of a millimetre of water without friction on rough ground at 45 degrees."""
    x, _, spacing = _grid(cells)
    bed = -x + 0.01 * np.random.default_rng(0).random(x.shape)
    return Trial("film at 45 degrees", bed, spacing, np.full(x.shape, 1e-4))


def steps(cells):
    """Blocks up to 3 m high and 20 cm wide under a centimetre of water, and rain."""
    rng = np.random.default_rng(2)
    blocks = -(-cells // 4)
    bed = 3 * np.kron(rng.random((blocks, blocks)), np.ones((4, 4)))[:cells, :cells]
    return Trial("tall steps, rain", bed, 0.05, np.full(bed.shape, 0.01), rain=50 / 3.6e6)


def peak(cells):
    """Water is set down on a peak."""
    x, y, spacing = _grid(cells)
    r = np.hypot(x, y)
    return Trial("water on a peak", np.maximum(0, 1 - 2 * r), spacing, np.where(r < 0.1, 0.3, 0.0))


def drain(cells):
    """A drain in a full basin that takes more than can flow to it in the end."""
    x, y, spacing = _grid(cells)
    middle = cells // 2
    bed, drains = 0.3 * (x**2 + y**2), ((middle, middle, 0.05),)
    return Trial("drain in a basin", bed, spacing, np.maximum(0.3 - bed, 0), drains=drains)


def thin_film(cells):
    """Five micrometres of water on the ground of `film`."""
    return replace(film(cells), name="five micrometres at 45 degrees", depth=film(cells).depth / 20)


def drying(cells):
    """A lake with islands that sinks into the ground within 1.5 s."""
    x, y, spacing = _grid(cells)
    bed = 0.2 * (x**2 + y**2) + 0.1 * np.random.default_rng(5).random(x.shape)
    return Trial("drying lake", bed, spacing, np.maximum(0.25 - bed, 0), infiltration=0.15)


def walls(cells):
    """A dam breaks in a yard whose walls are one cell thin, one of them oblique; dry outside."""
    x, y, spacing = _grid(cells)
    j, i = np.mgrid[:cells, :cells]
    low, high = cells // 6, cells - cells // 6
    yard = (i > low) & (i < high) & (j > low) & (j < high) & (i + j < int(1.4 * cells))
    around = np.pad(yard, 1)
    beside = around[:-2, 1:-1] | around[2:, 1:-1] | around[1:-1, :-2] | around[1:-1, 2:]
    bed = np.where(beside & ~yard, 3.0, 0.0) + 0.01 * np.sin(9 * x * y)
    start = np.where(yard & (i < cells // 2), 0.4, 0.0)
    return Trial("walls a cell thin", bed, spacing, start, stays_dry=~yard)


def terrain(cells, seed):
    """Random ground, from smooth hills (`seed` 0) to steps and needles (9), under rain."""
    rng = np.random.default_rng(seed)
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(cells), np.fft.rfftfreq(cells), indexing="ij"))
    roughness = 3 - 0.25 * seed  # exponent of the spectrum's fall
    waves = np.exp(2j * np.pi * rng.random(k.shape)) / np.maximum(k, 1 / cells) ** roughness
    bed = np.fft.irfft2(waves, (cells, cells))
    bed = np.round(4 * bed / np.ptp(bed)) / 4 if seed % 3 == 2 else bed / np.ptp(bed)
    start = np.maximum(np.median(bed) - bed, 0)
    start[: cells // 2] *= 1.5
    return Trial(f"terrain {seed}", bed, 2 / cells, start, rain=100 / 3.6e6)


def bumps(cells):
    """Uneven ground: hills, stones with walls and noise, dry at first."""
    x, y, _ = _grid(cells)
    rng = np.random.default_rng(3)
    bed = 0.05 * np.sin(7 * x) * np.cos(5 * y) + 0.02 * rng.random(x.shape) - 0.05 * x
    bed += 0.3 * (np.hypot((3 * x) % 1 - 0.5, (3 * y) % 1 - 0.5) < 0.15)
    return Trial("random rain", bed, 0.05, np.zeros(x.shape))


TRIALS = (dam, film, thin_film, steps, peak, drain, drying, walls)


class _Extremes:
    """Largest speed over its bound, smallest depth and largest change of depth seen so far."""

    def __init__(self, bed, start):
        self._bed, self._lowest, self._start = bed, float(bed.min()), start
        self._deepest, self._highest = 0.0, self._lowest
        self.speed, self.least, self.moved, self.leaked = 0.0, math.inf, 0.0, 0.0
        self.update(start)

    def update(self, depth, report=None):
        """Update the extremes with a depth [m] and, if given, a report of `WaterSolver.advance`."""
        depth = depth.astype(np.float64)
        self.moved = max(self.moved, float(np.abs(depth - self._start).max()))
        wet = depth > 0
        self._deepest = max(self._deepest, float(depth.max()))
        if wet.any():
            self._highest = max(self._highest, float((self._bed + depth)[wet].max()))
        fall = math.sqrt(2 * GRAVITY * (self._highest - self._lowest))
        bound = 2 * math.sqrt(GRAVITY * self._deepest) + fall
        if report is not None:
            self.speed = max(self.speed, report.max_speed / bound if bound > 0 else 0.0)
            self.least = min(self.least, report.min_depth)


class _Run(NamedTuple):
    """A run: the case's name, the scheme, the type of the fields and a Courant number."""

    case: str
    scheme: str
    dtype: type
    courant: float | None = None


def _record(run, extremes, drift, allowed, count, seconds, why=None):
    """Return the record of a run; `why` says that it was refused or diverged."""
    if why is None:
        holds = [
            ("loses depth", extremes.least >= 0),
            ("changes volume", abs(drift) <= allowed),
            ("too fast", extremes.speed <= MOST_SPEED),
            ("leaks", extremes.leaked == 0),
        ]
        why = ", ".join(word for word, good in holds if not good) or "holds"
    return {
        "case": run.case, "scheme": run.scheme, "dtype": np.dtype(run.dtype).name,
        "courant": run.courant,
        "outcome": why, "drift": drift, "speed": extremes.speed if extremes else math.nan,
        "least": extremes.least if extremes else math.nan,
        "moved": extremes.moved if extremes else math.nan, "steps": count, "seconds": seconds,
    }  # fmt: skip


def endure(trial, scheme, span=3.0, dtype=np.float32, courant=None, forced=False):
    """Run a trial for `span` [s] on a scheme; return its record, even if it fails.

    A Courant number that the solver refuses is taken where it is `forced`.
    """
    allowed, count, start = MOST_DRIFT[dtype], 0, time.perf_counter()
    run = _Run(trial.name, scheme, dtype, courant)
    try:
        solver = WaterSolver(
            trial.bed, trial.spacing, scheme=scheme, courant=None if forced else courant,
            drains=list(trial.drains), infiltration=trial.infiltration, gravity=GRAVITY,
            dtype=dtype,
        )  # fmt: skip
    except ParameterError:
        return _record(run, None, math.nan, 0, 0, 0, "refused")
    solver.set_state(trial.depth)
    if forced:
        solver._asked_courant = courant
        solver._choose_scheme()
    extremes, worst = _Extremes(trial.bed, trial.depth), 0.0
    try:
        for _ in range(CHECKS):
            report = solver.advance(span / CHECKS, rain=trial.rain)
            count += report.substeps
            depth = solver.depth
            extremes.update(depth, report)
            if trial.stays_dry is not None:
                extremes.leaked = max(extremes.leaked, float(depth[trial.stays_dry].max()))
            worst = max(worst, abs(report.residual))
    except DivergedError as error:
        why = f"diverges: {error}".partition(";")[0]
        return _record(run, extremes, math.nan, 0, count, 0, why)
    seconds = time.perf_counter() - start
    return _record(run, extremes, worst, allowed, count, seconds)


def endure_rain(trial, scheme, most_steps, dtype=np.float32, seed=0):
    """Let random rain fall for at least `most_steps` steps: drops, and a rate that changes."""
    rng, start = np.random.default_rng(seed), time.perf_counter()
    solver = WaterSolver(
        trial.bed, trial.spacing, scheme=scheme, manning=0.02, gravity=GRAVITY, dtype=dtype
    )
    extremes, count, worst = _Extremes(trial.bed, trial.depth), 0, 0.0
    ny, nx = trial.bed.shape
    while count < most_steps:
        places = rng.integers(0, ny, DROPS), rng.integers(0, nx, DROPS)
        solver.deposit(*places, LARGEST_DROP * rng.random(DROPS) ** 3)
        report = solver.advance(FRAME, rain=HEAVIEST_RAIN * rng.random() ** 2)
        count += report.substeps
        extremes.update(solver.depth, report)
        worst = max(worst, abs(report.residual))
    allowed = MOST_DRIFT[dtype] if most_steps < 100_000 else LONG_DRIFT
    seconds = time.perf_counter() - start
    return _record(_Run(trial.name, scheme, dtype), extremes, worst, allowed, count, seconds)


def run(quick=False, say=quiet):
    """Run all trials on all schemes in both types, and the dam at several Courant numbers.

    The result has "quick" and "records", a list of dicts.
    """
    records = []

    def note(record):
        records.append(record)
        say(_line(record))

    for scheme in SCHEMES:
        for make in TRIALS:
            for dtype in (np.float32, np.float64):
                note(endure(make(CELLS[quick]), scheme, SPAN[quick], dtype))
        for courant in COURANTS:
            record = endure(dam(CELLS[quick]), scheme, SPAN[quick], courant=courant)
            note(record)
            if record["outcome"] == "refused":
                note(endure(dam(CELLS[quick]), scheme, SPAN[quick], courant=courant, forced=True))
                records[-1]["case"] = "dam, forced"
        for seed in range(TERRAINS[quick]):
            note(endure(terrain(CELLS[quick], seed), scheme, SPAN[quick]))
        for dtype in (np.float32, np.float64):
            note(endure_rain(bumps(CELLS[quick]), scheme, LONG_STEPS[quick], dtype))
    return {"quick": quick, "records": records}


def _line(record):
    at = f" at {record['courant']:g}" if record["courant"] else ""
    return (
        f"{record['case'] + at:20s} {record['scheme']:9s} {record['dtype']}  drift "
        f"{record['drift']:.0e}  speed {record['speed']:.2f}  {record['steps']:6d} steps  "
        f"{record['outcome']}"
    )


def table(result):
    """Return drift and speed over its bound as a Markdown table, float32, failures in bold."""
    rows = {}
    for record in result["records"]:
        if record["dtype"] == "float32":
            name = record["case"]
            if record["courant"]:
                name += f", Courant {record['courant']:g}"
            text = f"{record['drift']:.0e} / {record['speed']:.2f}"
            if record["outcome"] == "refused":
                text = "refused"
            elif record["outcome"] != "holds":
                text = f"**{text} {record['outcome'].partition(':')[0]}**"
            rows.setdefault(name, {})[record["scheme"]] = text
    cells = [(name, *(row.get(scheme, "") for scheme in SCHEMES)) for name, row in rows.items()]
    return "\n".join(markdown(("case", *SCHEMES), cells))


def draw(result, path):
    """Draw the drift of every run and its speed over the bound to a PNG."""
    panels = {}
    for name, key, floor, limits in (
        ("change of volume, float32", "drift", 1e-17, [MOST_DRIFT[np.float32]]),
        ("change of volume, float64", "drift", 1e-17, [MOST_DRIFT[np.float64]]),
        ("speed over its bound, float32", "speed", 1e-2, [MOST_SPEED]),
    ):
        marks = {}
        for record in result["records"]:
            if record["dtype"] in name and record["outcome"] != "refused":
                label = record["case"]
                if record["courant"]:
                    label = f"{record['case']}, Courant {record['courant']:g}"
                value = record[key] if math.isfinite(record[key]) else math.inf
                marks.setdefault(record["scheme"], {})[label] = max(value, floor)
            elif record["dtype"] in name:
                marks.setdefault(record["scheme"], {})
        panels[name] = {"marks": marks, "limits": limits}
    draw_marks(path, panels, "Where methods fail (dotted: the limit; at the right edge: diverged)")
