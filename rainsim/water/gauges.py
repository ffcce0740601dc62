"""Readings of a `WaterSolver` over time: depths and speeds in cells, hydrographs of edges."""

import csv
import math
from collections import Counter

import numpy as np

from rainsim.errors import InputError, ParameterError, require_not_negative, require_positive
from rainsim.io.files import replacing
from rainsim.water.series import table_of

DIGITS = 1e-8  # relative: a table has nine digits


class Gauges:
    """Gauges in cells, and hydrographs of the open edges and of the conditions.

    Parameters
    ----------
    solver : WaterSolver
    cells : dict of str to (int, int), optional
        Row and column of each gauge by its name.

    Attributes
    ----------
    names : list of str
        Of the columns: the time; for each gauge its depth and its speeds towards east and north;
        for each open edge the flow that leaves; for each condition the flow that came in over the
        last step, less what left. The examples show how they are spelt.
    rows : list of list of float
        One for each reading.

    Examples
    --------
    >>> slope = -0.02 * np.arange(50.0) * np.ones((4, 1))
    >>> solver = rainsim.WaterSolver(slope, 1.0, boundary={"east": "open"}, manning=0.02)
    >>> gauges = rainsim.Gauges(solver, {"middle": (2, 25)})
    >>> report = gauges.run(60.0, period=20.0, rain=rainsim.mm_per_hour(50))
    >>> gauges.names
    ['time_s', 'middle_depth_m', 'middle_u_m_s', 'middle_v_m_s', 'outflow_east_m3_s']
    >>> [row[0] for row in gauges.rows]
    [20.0, 40.0, 60.0]
    """

    def __init__(self, solver, cells=None):
        self._solver, self.rows = solver, []
        for name, (row, column) in (cells or {}).items():
            if not (0 <= row < solver.shape[0] and 0 <= column < solver.shape[1]):
                raise ParameterError(
                    f"gauge {name!r} is at row {row}, column {column}; the map has rows from 0 to "
                    f"{solver.shape[0] - 1} and columns from 0 to {solver.shape[1] - 1}"
                )
        self._cells = [(int(row), int(column)) for row, column in (cells or {}).values()]
        self._edges = solver.flow.open_edges()
        names = [f"{name}_{what}" for name in cells or {} for what in ("depth_m", "u_m_s", "v_m_s")]
        names += [f"outflow_{edge}_m3_s" for edge in self._edges]
        seen = Counter()
        for condition in solver.conditions:
            name = f"inflow_{type(condition).__name__.lower()}_{condition.edge}"
            seen[name] += 1
            names.append(f"{name}{'' if seen[name] == 1 else f'_{seen[name]}'}_m3_s")
        self.names = ["time_s", *names]

    def read(self):
        """Take a reading of the present state."""
        solver, flow = self._solver, self._solver.flow
        (u, v), (h, remainder, _, _), row = flow.faces(), flow.water, [solver.time]
        for j, i in self._cells:
            at = j + flow.pad, i + flow.pad
            wet = h[at] > 0
            row.append(float(solver.sources.film[at]) + float(h[at] + remainder[at]))
            row.append(0.5 * float(u[j, i] + u[j, i + 1]) if wet else 0.0)
            row.append(0.5 * float(v[j, i] + v[j + 1, i]) if wet else 0.0)
        row += [solver.discharge(edge) for edge in self._edges]
        row += [condition.flow for condition in solver.conditions]
        self.rows.append(row)

    def run(self, duration, period, rain=0.0, progress=None, begin=None):
        """Advance the solver by `duration` [s] with a reading every `period` [s].

        Parameters
        ----------
        duration, period : float [s]
        rain, progress
            See `WaterSolver.advance`. Where `progress` returns False the run stops; there is a
            reading of that moment only if it was to be one.
        begin : float, optional [s]
            Time when the run began, if it goes on after a stop: duration and period count from
            it, and all is to the same bytes as without the stop. Now by default.

        Returns
        -------
        WaterReport
            The last; of a `GpuWaterSolver` the steps.
        """
        require_positive("period", period, "s")
        solver = self._solver
        begin, report = solver.time if begin is None else begin, None
        goes_on = True

        def told(now):
            nonlocal goes_on
            goes_on = progress(now) is not False
            return goes_on

        end = begin + require_not_negative("duration", duration, "s")
        count = int(np.ceil((end - begin) / period - 1e-9))
        # A run that was killed at the time of a reading has a state of it, but no reading yet.
        for n in range(max(math.ceil((solver.time - begin) / period - 1e-9), 1), count + 1):
            stop = end if n == count else begin + n * period
            reached = stop - 1e-9 * max(abs(stop), 1.0)  # times from which on it counts as such
            if solver.time < reached:
                report = solver.advance(stop - solver.time, rain, progress and told)
            if solver.time >= reached and not self._has_read(solver.time):
                self.read()
            if not goes_on:
                break
        return solver.advance(0.0, rain) if report is None else report

    def _has_read(self, time):
        """Tell whether the last reading is of that time [s], to the digits of the table."""
        return bool(self.rows) and math.isclose(self.rows[-1][0], time, rel_tol=DIGITS)

    def write(self, path):
        """Write all readings as a CSV table with a line of names."""
        with (
            replacing(path) as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(self.names)
            writer.writerows([[f"{number:.9g}" for number in row] for row in self.rows])

    def load(self, path):
        """Take the readings that `write` wrote, up to the solver's time.

        Raises
        ------
        InputError
            If the file is no such table, or one of other gauges.
        """
        names, *rows = table_of(path) or [[]]
        try:
            rows = [[float(number) for number in row] for row in rows]
        except ValueError:
            rows = [[]]
        if names != self.names or any(len(row) != len(names) for row in rows):
            raise InputError(
                f"{path} is no table of readings of these gauges; put it back, or begin a new one"
            )
        self.rows = [row for row in rows if row[0] <= self._solver.time * (1 + DIGITS)]
