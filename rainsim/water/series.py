"""Numbers that change with time: rain, stages and discharges, given or read from a table."""

import csv
import io
import math
import re

import numpy as np

from rainsim.errors import InputError, ParameterError
from rainsim.io.files import read_text

MOST_TABLE = 1 << 26  # bytes of a table that is read
PIECE = 1.0  # s, for which the rate of an interpolated rain is taken for its mean
OTHER_TIMES = re.compile(r"(t|time)[\W_]+(min|h|d|ms)|min$|.*(minute|hour|days|date)", re.I)


class Series:
    """Numbers at times; before the first and after the last they hold.

    Parameters
    ----------
    times : array_like of shape (n,) [s]
        Rising.
    values : array_like of shape (n,)
    holds : bool
        Whether each value holds until the next one, as rain gauges have it; else the numbers
        between two times are interpolated.

    Examples
    --------
    >>> rain = rainsim.Series([0, 600, 1800], np.array([20, 50, 0]) / 3.6e6, holds=True)  # m/s
    >>> round(3.6e6 * rain(700.0)), rain(1e5)
    (50, 0.0)
    """

    def __init__(self, times, values, holds=False):
        self.times = np.atleast_1d(np.asarray(times, np.float64))
        self.values = np.atleast_1d(np.asarray(values, np.float64))
        self.holds = holds
        if self.times.shape != self.values.shape or self.times.ndim != 1 or not len(self.times):
            raise ParameterError(
                f"times and values of a series have shapes {self.times.shape} and "
                f"{self.values.shape}; they must be lists of one length, of one number at least"
            )
        for name, numbers in (("times", self.times), ("values", self.values)):
            if not np.isfinite(numbers).all():
                raise ParameterError(f"{name} of a series must be finite; leave gaps out")
        late = np.flatnonzero(np.diff(self.times) <= 0)
        if len(late):
            raise ParameterError(
                f"time {self.times[late[0] + 1]:g} s of a series follows {self.times[late[0]]:g} "
                "s; times must rise; sort them and name none twice"
            )

    def __call__(self, time):
        """Return the value at `time` [s]."""
        if self.holds:
            return float(self.values[max(np.searchsorted(self.times, time, "right") - 1, 0)])
        return float(np.interp(time, self.times, self.values))

    def mean(self, start, end):
        """Return the mean of the value from `start` to `end` [s]."""
        if end <= start:
            return self(start)
        at = np.concatenate([[start], self.times[self._between(start, end)], [end]])
        if self.holds:
            return float(np.dot([self(t) for t in at[:-1]], np.diff(at)) / (end - start))
        return float(np.trapezoid([self(t) for t in at], at) / (end - start))

    def most(self, start, end):
        """Return the largest value from `start` to `end` [s]."""
        return float(max(self(start), self(end), *self.values[self._between(start, end)]))

    def _between(self, start, end):
        """Return the slice of the times after `start` and before `end` [s]."""
        return slice(
            np.searchsorted(self.times, start, "right"), np.searchsorted(self.times, end, "left")
        )


def series(value):
    """Return `value`, a number or a `Series`, as a `Series`."""
    return value if isinstance(value, Series) else Series([0.0], [value])


def rain_pieces(rain, start, end):
    """Return the rain from `start` to `end` [s] as a list of (end [s], rate [m/s] or map)."""
    if not isinstance(rain, Series):
        return [(end, rain)]
    if (rain.values < 0).any():
        raise ParameterError(f"rain is {rain.values.min():g} m/s; it must not be negative")
    stops = rain.times[rain._between(start, end)].tolist()
    if not rain.holds:
        count = math.ceil((end - start) / PIECE)
        stops += [start + n * PIECE for n in range(1, count)]
    pieces, before = [], start
    for stop in sorted({*stops, end}):
        pieces.append((stop, rain.mean(before, stop)))
        before = stop
    return pieces


def table_of(path):
    """Return the lines of a CSV file, lists of str, or raise InputError."""
    try:
        return list(csv.reader(io.StringIO(read_text(path, "table", MOST_TABLE))))
    except csv.Error as fault:  # a zero byte, a field of more than 131,072 characters
        raise InputError(f"{path} is no CSV table ({fault}); write it again") from None


def read_series(path, column=None, factor=1.0, holds=False):
    """Read a `Series` from a CSV table with a line of names, the time [s] in its first column.

    Parameters
    ----------
    path : path-like
    column : str, optional
        Name of the column; the second one by default.
    factor : float
        By which its numbers are multiplied: 1 / 3.6e6 makes mm/h m/s.
    holds : bool
        See `Series`.

    Raises
    ------
    InputError
        If the file is not such a table.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> table = pathlib.Path(tempfile.mkdtemp(), "rain.csv")
    >>> _ = table.write_text("time_s,rain_mm_h\\n0,20\\n600,50\\n")
    >>> rain = rainsim.read_series(table, factor=1 / 3.6e6, holds=True)
    >>> solver = rainsim.WaterSolver(np.zeros((4, 4)), 1.0)
    >>> round(solver.advance(3.6, rain=rain).ledger.rain / 16 * 1000, 6)  # mm
    0.02
    """
    rows = table_of(path)
    rows = [row for row in rows if any(cell.strip() for cell in row)]
    if len(rows) < 2 or len(rows[0]) < 2:
        raise InputError(
            f"{path} has no table; it must have a line of names and lines of numbers, the time in "
            "s first: time_s,rain_mm_h"
        )
    names = [name.strip() for name in rows[0]]
    if OTHER_TIMES.match(names[0]):
        raise InputError(f"{path} has times under {names[0]!r}; they must be in s from the start")
    if re.fullmatch(r"[-+.\de]+", names[0]):
        raise InputError(f"the first line of {path} holds numbers; add a line: time_s,rain_mm_h")
    if column is not None and column not in names[1:]:
        raise InputError(
            f"{path} has no column {column!r}; it has {', '.join(names[1:])}; name one of these"
        )
    number = names.index(column) if column is not None else 1
    points = []
    for line, row in enumerate(rows[1:], 2):
        try:
            points.append((float(row[0]), factor * float(row[number])))
        except (ValueError, IndexError):
            raise InputError(
                f"line {line} of {path} has no number in its first column or under "
                f"{names[number]!r}; each line needs both, times in s and no dates; leave gaps out"
            ) from None
    try:
        return Series(*zip(*points, strict=True), holds=holds)
    except ParameterError as fault:
        raise InputError(f"{path}: {fault}") from None
