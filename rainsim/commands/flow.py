"""The command `rainsim flow`: the water solver alone on a map of heights."""

import math
import signal
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import click

from rainsim.commands import options
from rainsim.commands.given import require_backend
from rainsim.commands.options import option
from rainsim.commands.status import Status, interrupt
from rainsim.errors import DivergedError, InputError, ParameterError, require_positive

SAVE_EVERY = 60.0  # s of the clock, after a step
GAUGES, STATE = "gauges.csv", "state.npz"
MAPS, PICTURE, LEAST_WIDTH = ("depth", "u", "v"), "depth.png", 640  # px, about
MOST_READINGS = 1_000_000
MOST_DIGITS = 10  # of a row or a column
HEIGHT_UNITS = {"m": 9001, "ft": 9002, "us-ft": 9003}  # their codes in GeoTIFF


class NumberOrFile(click.ParamType):
    """A number, or a path: float or Path."""

    name = "NUMBER|FILE"

    def convert(self, value, param, ctx):
        """Return a float or a Path."""
        try:
            return float(value)
        except (TypeError, ValueError):
            return Path(value)


class AtEdge(click.ParamType):
    """EDGE[:A:B]=VALUE: (edge, span or None, text)."""

    name = "EDGE[:A:B]=VALUE"

    def convert(self, value, param, ctx):
        """Return the edge, the first cell and the last cell + 1 or None, and what is given."""
        place, _, given = value.partition("=")
        edge, *cells = place.split(":")
        if not given or len(cells) not in (0, 2) or not all(map(_is_whole, cells)):
            self.fail(
                f"{value!r} is not EDGE=VALUE or EDGE:A:B=VALUE, cells from A to B, B excluded, "
                "such as west:8:12=river.csv",
                param,
                ctx,
            )
        return edge, tuple(map(int, cells)) or None, NumberOrFile().convert(given, param, ctx)


class Gauge(click.ParamType):
    """NAME=ROW,COLUMN: (name, (row, column))."""

    name = "NAME=ROW,COLUMN"

    def convert(self, value, param, ctx):
        """Return the name and the cell."""
        name, _, place = value.partition("=")
        cell = place.split(",")
        if not name or len(cell) != 2 or not all(_is_whole(n.strip()) for n in cell):
            self.fail(f"{value!r} is not NAME=ROW,COLUMN, such as bridge=10,30", param, ctx)
        return name, (int(cell[0]), int(cell[1]))


def _is_whole(text):
    """Tell whether a text is a number of some digits; `isdigit` is true of superscripts, too."""
    return text.isascii() and text.isdigit() and len(text) < MOST_DIGITS


# fmt: off
water_options = options.group(
    option("duration", float, "Simulated time [s] from the start, not from where --resume "
           "goes on.", "S", required=True),
    option("spacing", float, "Side of a cell [m]; the file's where it has one.", "M"),
    option("height-unit", click.Choice(list(HEIGHT_UNITS)), "Unit of the bed's heights, "
           "whatever the file says. [default: the file's, or m]"),
    option("nodata", click.Choice(["closed", "open"]), "Whether cells without a height are "
           "walls, or water leaves over their edge.", default="closed"),
    option("rain", NumberOrFile(), "mm/h, or a CSV of time [s] and mm/h, each until the "
           "next.", default="0"),
    option("level", float, "Water level at the start [m], in the heights of the bed.", "M"),
    option("depth", NumberOrFile(), "Water depth at the start [m]. [default: dry]"),
    option("manning", NumberOrFile(), "Manning's roughness [s m^(-1/3)].", default="0",
           shows="NO FRICTION"),
    option("viscosity", float, "Kinematic, for laminar films [m2/s].", "M2/S", default=0.0),
    option("infiltration", NumberOrFile(), "Rate that the ground takes [mm/h].", default="0"),
    option("storage", NumberOrFile(), "Depth that each cell holds back [mm].", default="0"),
    option("open", str, "Edge that water leaves over: west, east, south, north or all; else "
           "walls.", "EDGE", multiple=True),
    option("stage", AtEdge(), "Level at an edge: m, or a CSV of time [s] and m.",
           multiple=True),
    option("discharge", AtEdge(), "What comes in at an edge: m3/s, or a CSV of time [s] and "
           "m3/s.", multiple=True),
    option("rating", AtEdge(), "Rating curve at an edge: a CSV of level [m] and m3/s that "
           "leave.", multiple=True),
    option("gauge", Gauge(), "Cell whose depth and speed are read.", multiple=True),
    option("period", float, "Time between readings [s]. [default: a hundredth of --duration]",
           "S"),
    option("scheme", click.Choice(["auto", "accurate", "lean", "paper"]), "The water scheme.",
           default="auto"),
    option("courant", float, "Cells that the fastest wave crosses in a step. [default: the "
           "scheme's]"),
    option("double", bool, "float64 in place of float32."),
)
# fmt: on


@click.command(short_help="Solve the flow of water over a map of heights, without a scene.")
@click.argument("bed", type=click.Path(path_type=Path))
@water_options
@options.backend_option
@options.resume_option
@options.output_options("rainsim-out/BED-flow")
def flow(bed, duration, out, overwrite, resume, threads, as_json, quiet, **given):
    """Solve the flow of water over BED, a map of heights, without a scene.

    BED and other maps are ESRI ASCII grids (.asc), GeoTIFF (.tif) in metres or feet, lines of
    numbers (.txt), all with the north first, or .npy with the south first. Units are SI but for
    rain, infiltration and storage; rows count from the south, columns from the west. On cells
    without a height no rain falls.

    Writes depth, u and v at the end as maps like BED, depth.png to look at, gauges.csv with the
    readings of gauges, open edges and given edges, and state.npz. Ctrl-C stops after a step;
    --resume goes on, to a longer --duration, too. There is no friction unless --manning or
    --viscosity is given. --backend cuda takes the scheme lean in float32, and stops at the next
    reading.

    \b
    Example:
        rainsim flow valley.asc --duration 3600 --rain 50 --manning 0.03 --open east
        rainsim flow valley.asc --duration 3600 --discharge west:8:12=river.csv --gauge weir=10,55
    """
    status = Status(quiet)
    duration = require_positive("--duration", duration, "s")
    require_backend(given["backend"])
    _require_names(given["gauge"])
    if given["depth"] is not None and given["level"] is not None:
        raise ParameterError("--depth and --level are both given; leave one out")
    files = [bed, *_files_in(given)]
    out = out or options.default_out(bed.stem, "flow")
    from rainsim.io.fingerprint import hash_of_file
    from rainsim.io.rasters import read_raster
    from rainsim.output_folder.claims import claimed, relative
    from rainsim.output_folder.names import read_record
    from rainsim.output_folder.record import Record

    ground = _in_metres(read_raster(bed), given["height_unit"])
    content = {"flow": {k: str(v) for k, v in given.items() if k != "period"},
               "files": [hash_of_file(file) for file in files]}  # fmt: skip
    with status, claimed(out, overwrite, resume, files):
        status.notes(ground.notes)
        from rainsim.jit import set_threads

        set_threads(threads)
        record = Record(out, None, content, resume)
        period = _period(given["period"], duration, read_record(out) if resume else {})
        record.facts["period"] = period
        solver, rain, absent = _solver(ground, bed, given)
        status.say(solver.choice)
        if absent.any():
            status.notes([_about_nodata(absent, given["nodata"])])
        if solver.flow.roughness is None:
            status.notes(["no friction: neither --manning nor --viscosity is given"])
        if given["backend"] == "cuda":
            from rainsim.cuda.grid import GpuWaterSolver

            solver = GpuWaterSolver(solver)
        run = Run(solver, given, out, status)
        if resume and (out / STATE).is_file():
            run.load(duration, period)
        record.begin()
        record.add(GAUGES, STATE)
        finished = run.to(duration, period, rain)
        if finished:  # maps of millions of cells take longer than who ends a run should wait
            spacing = given["spacing"] or ground.spacing
            record.add(*_write_maps(out, ground, spacing, solver, absent))
        record.write(complete=finished, time=solver.time, ledger=solver.ledger.as_dict())
    if not finished:
        status.say(f"stopped at {solver.time:.6g} s; --resume goes on from there")
        raise KeyboardInterrupt
    if given["nodata"] == "open" and absent.any():
        status.notes([f"{solver.ledger.drained:.6g} m3 left over the edge of nodata"])
    status.say(f"maps, gauges and state in {relative(out)}")
    result = {"out": str(out), "files": record.files, "time": solver.time,
              "steps": run.steps, "scheme": solver.scheme,
              "ledger": solver.ledger.as_dict()}  # fmt: skip
    options.echo(result, as_json, _as_text(result["ledger"]))


def _require_names(gauges):
    """Raise ParameterError if two gauges have one name: their columns would have, too."""
    names = [name for name, _ in gauges]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ParameterError(f"--gauge {twice[0]} is given twice; give each its own name")


def _period(given, duration, before):
    """Return the time between readings [s]: as given, as the run before had it, or a hundredth."""
    from rainsim.io.files import json_number

    kept = json_number(before.get("period"))
    if kept and given is not None and not math.isclose(given, kept):
        raise ParameterError(
            f"--period is {given:g} s; the run that goes on has readings every {kept:g} s; leave "
            "it out"
        )
    period = given if given is not None else kept or duration / 100
    if duration / require_positive("--period", period, "s") > MOST_READINGS:
        raise ParameterError(
            f"--period is {period:g} s of {duration:g} s; there may be at most {MOST_READINGS} "
            "readings; give a longer one"
        )
    return period


def _in_metres(ground, unit):
    """Return the bed with heights that the user says are in another unit than the file."""
    if unit is None:
        return ground
    from rainsim.io.rasters import UNITS

    values = ground.values / ground.per_height * UNITS[HEIGHT_UNITS[unit]]
    return ground._replace(values=values, notes=(*ground.notes, f"heights are in {unit}, as given"))


def _about_nodata(absent, way):
    told = f"{int(absent.sum())} of {absent.size} cells have no height (nodata): "
    if way == "open":
        return told + "water leaves over their edge"
    return told + "walls, behind which water may stand; --nodata open lets it leave"


class Run:
    """A solver on its way, with its gauges and its files."""

    def __init__(self, solver, given, out, status):
        from rainsim.water.gauges import Gauges

        self._solver, self._out, self._status = solver, out, status
        self.gauges, self.steps = Gauges(solver, dict(given["gauge"])), 0

    def load(self, duration, period):
        """Take the state and the readings of the run that goes on."""
        self._solver.load(self._out / STATE)
        if self._solver.time > duration:
            raise ParameterError(
                f"--duration is {duration:g} s; the run in {self._out} is at "
                f"{self._solver.time:g} s already; give a longer one"
            )
        self.gauges.load(self._out / GAUGES)
        time, rows = self._solver.time, self.gauges.rows
        at_reading = abs(time / period - round(time / period)) < 1e-9
        if time < duration and rows and rows[-1][0] == time and not at_reading:
            self._status.notes([
                f"the run ended at {time:g} s, between readings every {period:g} s; a run that "
                "did not end there takes other steps, so its numbers differ a little"
            ])  # fmt: skip

    def to(self, duration, period, rain):
        """Go on to `duration` [s] with readings every `period` [s]; return if it is reached."""
        if not self.gauges.rows:
            self.gauges.read()
        saved = time.perf_counter()
        with _interrupts(lambda: self.steps > 0) as pressed:

            def goes_on(now):
                nonlocal saved
                self.steps += 1
                self._status.progress("flow s", math.floor(now), math.ceil(duration))
                if time.perf_counter() - saved > SAVE_EVERY:
                    self.save()
                    saved = time.perf_counter()
                return not pressed.is_set()

            self.gauges.run(duration, period, rain, goes_on, begin=0.0)
        self.save()
        return self._solver.time >= duration * (1 - 1e-9)

    def save(self):
        """Write the state and the readings."""
        self.gauges.write(self._out / GAUGES)
        self._solver.save(self._out / STATE)


@contextmanager
def _interrupts(has_begun):
    """Yield an event that Ctrl-C sets: raised within a step, it would leave half of one.

    It is raised all the same if pressed again, or before the first step is over, which may compile.
    """
    pressed = threading.Event()

    def press(number, frame):
        if pressed.is_set() or not has_begun():
            interrupt(number, frame)
        pressed.set()

    own = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, press) if own else None
    try:
        yield pressed
    finally:
        if own:
            signal.signal(signal.SIGINT, before)


def _files_in(given):
    """Return the files that options name, a list of Path."""
    found = [value for value in given.values() if isinstance(value, Path)]
    placed = (entry for name in ("stage", "discharge", "rating") for entry in given[name])
    return found + [value for _, _, value in placed if isinstance(value, Path)]


def _solver(ground, bed, given):
    """Return the solver, its rain (a rate [m/s] or a series), and which cells have no height."""
    from rainsim.config.rules import MM_PER_HOUR
    from rainsim.grid import WaterSolver
    from rainsim.water.conditions import Discharge, Rating, Stage
    from rainsim.water.inputs import EDGES
    from rainsim.water.nodata import require_heights, without_nodata
    from rainsim.water.series import read_series

    spacing = given["spacing"] if given["spacing"] is not None else ground.spacing
    if spacing is None:
        raise ParameterError(f"{bed} does not say how large its cells are; give --spacing")
    if ground.spacing is not None and abs(spacing - ground.spacing) > 1e-6 * ground.spacing:
        raise ParameterError(
            f"--spacing is {spacing:g} m; {bed} has cells of {ground.spacing:g} m; leave it out"
        )

    def series(value, factor=1.0, holds=False):
        return (
            read_series(value, None, factor, holds) if isinstance(value, Path) else value * factor
        )

    def curve(edge, span, value):
        if not isinstance(value, Path):
            raise ParameterError(f"--rating {edge}={value:g} is no curve; give a CSV file")
        table = read_series(value)
        return Rating(edge, table.times, table.values, span)

    heights, absent, drains = without_nodata(ground.values, given["nodata"])
    for name in ("stage", "discharge", "rating"):
        for edge, span, _ in given[name]:
            require_heights(absent, edge, span, f"--{name}")
    conditions = [Stage(edge, series(value), span) for edge, span, value in given["stage"]]
    conditions += [Discharge(edge, series(value), span) for edge, span, value in given["discharge"]]
    conditions += [curve(*entry) for entry in given["rating"]]
    edges = EDGES if "all" in given["open"] else given["open"]
    by_device = given["backend"] == "cuda" and given["scheme"] == "auto"
    scheme = "lean" if by_device else given["scheme"]
    solver = WaterSolver(
        heights, spacing, scheme, dict.fromkeys(edges, "open"),
        manning=_map(given["manning"], ground, "--manning"),
        kinematic_viscosity=given["viscosity"], courant=given["courant"],
        storage=1e-3 * _map(given["storage"], ground, "--storage"),
        infiltration=MM_PER_HOUR * _map(given["infiltration"], ground, "--infiltration"),
        drains=drains, dtype="float64" if given["double"] else "float32", conditions=conditions,
    )  # fmt: skip
    if absent.any():
        solver.sources.exposure = 1.0 - absent
    if given["depth"] is not None:
        solver.set_state(_map(given["depth"], ground, "--depth") * ~absent)
    elif given["level"] is not None:
        solver.set_state((given["level"] - heights).clip(0.0) * ~absent)
    if by_device:
        solver.reason = "auto: the scheme of a CUDA device"
    return solver, series(given["rain"], MM_PER_HOUR, holds=True), absent


def _map(value, ground, option):
    """Return a number, or the map of a file, which must have the shape of the bed."""
    if not isinstance(value, Path):
        return value
    import numpy as np

    from rainsim.io.rasters import read_raster

    found = read_raster(value).values
    if found.shape != ground.values.shape:
        raise InputError(
            f"{value} of {option} has {found.shape[0]} x {found.shape[1]} cells; it must have the "
            f"bed's {ground.values.shape[0]} x {ground.values.shape[1]}"
        )
    return np.where(np.isnan(ground.values), 0.0, found)


def _write_maps(out, ground, spacing, solver, absent):
    """Write depth and velocity as maps like the bed, and a picture; return their names."""
    import numpy as np

    from rainsim.io.images import write_png
    from rainsim.io.rasters import write_raster
    from rainsim.terrain.pictures import water_over

    maps = solver.depth, *solver.velocity
    if not all(np.isfinite(values).all() for values in maps):
        raise DivergedError(
            f"depth or velocity is not finite at {solver.time:.6g} s; give a smaller --courant"
        )
    names = [f"{name}{ground.kind}" for name in MAPS]
    for name, values in zip(names, maps, strict=True):
        write_raster(out / name, np.where(absent, np.nan, values), ground)
    picture = water_over(ground.values, spacing, maps[0])
    wide = max(1, LEAST_WIDTH // max(picture.shape))  # px of a cell
    write_png(out / PICTURE, picture.repeat(wide, 0).repeat(wide, 1))
    return [*names, PICTURE]


def _as_text(ledger):
    volumes = [f"{name} {volume:.6g} m3" for name, volume in ledger.items() if name != "residual"]
    return "\n".join([*volumes, f"residual {ledger['residual']:+.1e}"])
