"""Charts of accuracy against time; the one module that draws with matplotlib, an extra."""

from __future__ import annotations

import math
from pathlib import Path

from rainsim.errors import ParameterError

COLORS = ("#0b6e99", "#d1495b", "#8a8d91", "#5c8001", "#8d5a97", "#e09f3e")
MARKERS = "osv^DxP*"
DOTS = 110  # per inch
NARROW = 0.3  # decades, of a logarithmic axis whose ticks are evenly spaced numbers


def require_matplotlib():
    """Return matplotlib's pyplot for files, or raise an error that names the remedy."""
    try:
        import matplotlib
    except ImportError:
        raise ParameterError(
            'a chart needs matplotlib, which is not installed; run pip install "rainsim[chart]", '
            "or leave out --chart"
        ) from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def front(points):
    """Return the points (time, error) that no other point beats in both, sorted by time."""
    best, kept = float("inf"), []
    for time, error in sorted(points):
        if error < best:
            best = error
            kept.append((time, error))
    return kept


def draw_fronts(path, panels, title, default=None, error="relative error", time="time", own=False):
    """Draw error against time, one panel per case, one line per method, the front as steps.

    Parameters
    ----------
    path : path-like
        PNG to write.
    panels : dict
        {case: {"least": error or None, "lines": {method: [(seconds, error), ...]}, "peers": the
        same for other programs, may be missing}}; or, for bars side by side instead, {case:
        {"bars": {name: {stage: milliseconds}}}}
    title : str
    default : str, optional
        The method that is used where nothing else is asked for; it is marked. A panel's own
        "default" goes before it.
    error : str
        What the vertical axes show, with its unit.
    time : str
        What the horizontal axes show, in milliseconds.
    own : bool
        Whether each panel has methods of its own: they stand in a legend below it, and all panels
        have the same axes, but for the times of a panel with other programs.
    """
    pyplot = require_matplotlib()
    columns = 2 if len(panels) == 4 else min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = pyplot.subplots(
        rows, columns, figsize=(4.2 * columns, 3.4 * rows), squeeze=False, layout="constrained",
        sharey=own,
    )  # fmt: skip
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    styles, shown = {}, {}
    for axis, (name, panel) in zip(axes.flat, panels.items(), strict=False):
        if "bars" in panel:
            _draw_bars(axis, name, panel["bars"])
            continue
        styles = {} if own else styles
        _draw_lines(axis, panel, styles, panel.get("default", default))
        axis.set(title=name, xlabel=f"{time} [ms]", ylabel=error)
        if own and not panel.get("peers"):
            axis.set_xlim(*_span(panels))
        log_ticks(axis)
        if own:
            axis.legend(fontsize=7, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.18))
            continue
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, handle)
    if shown:
        figure.legend(
            shown.values(), shown, fontsize=8, loc="outside lower center", ncols=min(len(shown), 5)
        )
    figure.suptitle(title)
    save(figure, path)


def draw_orders(path, panels, title):
    """Draw errors against cells with a line for each method, and those of first and second order.

    `panels` is {case: {method: [(cells, error), ...]}}.
    """
    pyplot = require_matplotlib()
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = pyplot.subplots(
        rows, columns, figsize=(3.4 * columns, 3.0 * rows), squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (name, lines) in zip(axes.flat, panels.items(), strict=False):
        for n, (method, points) in enumerate(lines.items()):
            cells, error = zip(*sorted(points), strict=True)
            axis.plot(cells, error, marker=MARKERS[n], color=COLORS[n], label=method)
        top = max(error for points in lines.values() for _, error in points)
        for order, style in ((1, ":"), (2, "--")):
            ideal = [top * (cells[0] / many) ** order for many in cells]
            axis.plot(cells, ideal, color="0.6", linestyle=style, label=f"order {order}", zorder=1)
        axis.set(title=name, xlabel="cells along a side", ylabel="relative error")
        log_ticks(axis)
    axes.flat[0].legend(fontsize=8)
    figure.suptitle(title)
    save(figure, path)


def _span(panels):
    """Return the least and the greatest time [ms] of all methods, with a margin."""
    times = [1e3 * t for p in panels.values() for line in p["lines"].values() for t, _ in line]
    return min(times) / 1.1, max(times) * 1.1


def save(figure, path):
    """Write a figure as PNG at the resolution of all charts, and close it."""
    from matplotlib import pyplot

    figure.savefig(Path(path), dpi=DOTS, format="png")
    pyplot.close(figure)


def _draw_lines(axis, panel, styles, default):
    """Draw the methods of a case, those of other programs in grey, and the front."""
    everything = []
    for method, points in panel["lines"].items():
        n = styles.setdefault(method, len(styles))
        time, error = _milliseconds(points)
        is_default = method == default
        axis.plot(
            time, error, marker=MARKERS[n % len(MARKERS)], color=COLORS[n % len(COLORS)],
            label=f"{method} (default)" if is_default else method,
            linewidth=2.2 if is_default else 1.2, markersize=7 if is_default else 5,
            zorder=3 if is_default else 2,
        )  # fmt: skip
        everything += points
    for n, (peer, points) in enumerate(panel.get("peers", {}).items()):
        axis.plot(
            *_milliseconds(points), marker=MARKERS[-1 - n % len(MARKERS)], color="0.55",
            label=peer, linewidth=0.6, linestyle="--", markersize=4, zorder=1,
        )  # fmt: skip
    time, error = _milliseconds(front(everything))
    axis.step(time, error, where="post", color="0.8", linewidth=6, zorder=0, label="front")
    if panel.get("least"):
        axis.axhline(
            panel["least"], color="0.4", linestyle=":", linewidth=1, label="least to reach"
        )


def _milliseconds(points):
    """Return times [ms] and errors of (seconds, error) points, the quickest first."""
    time, error = zip(*sorted(points), strict=True)
    return [1e3 * t for t in time], error


def log_ticks(axis):
    """Put plain numbers on logarithmic axes, as many as have room."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    axis.set(xscale="log", yscale="log")
    for side in (axis.xaxis, axis.yaxis):
        low, high = side.get_view_interval()
        decades = math.log10(high / low)
        steps = (1, 1.5, 2, 3, 4, 5, 6, 8) if decades < 0.7 else (1, 2, 5)
        steps = steps if decades < 2 else (1,)
        locator = LogLocator(subs=steps, numticks=12) if decades > NARROW else MaxNLocator(5)
        side.set_major_locator(locator)
        side.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
        side.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3, which="major")


def plain(value):
    """Return a number as a tick shows it: a power of ten below a thousandth."""
    if not 0 < value < 9.99e-4:
        return f"{value:g}"
    mantissa, exponent = f"{value:e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def _draw_bars(axis, title, bars):
    """Draw the milliseconds of stages, one bar of all stages for each name."""
    stages = list(dict.fromkeys(stage for bar in bars.values() for stage in bar))
    left = dict.fromkeys(bars, 0.0)
    for n, stage in enumerate(stages):
        widths = [bar.get(stage, 0.0) for bar in bars.values()]
        hatch = "//" if n >= len(COLORS) else None
        axis.barh(
            list(bars), widths, left=list(left.values()), label=stage, hatch=hatch,
            color=COLORS[n % len(COLORS)], edgecolor="white", linewidth=0.4,
        )  # fmt: skip
        left = {name: at + w for (name, at), w in zip(left.items(), widths, strict=True)}
    axis.invert_yaxis()
    axis.set(title=title, xlabel="milliseconds")
    axis.legend(fontsize=7, ncols=3, loc="upper right", bbox_to_anchor=(1.0, -0.26))


def draw_marks(path, panels, title):
    """Draw how one number of each method stands in each case, side by side, and its limit, as PNG.

    `panels` is {name: {"limits": [number, ...], "marks": {method: {case: number}}}}; an infinite
    number stands at the right edge.
    """
    pyplot = require_matplotlib()
    cases = list(dict.fromkeys(
        case for panel in panels.values() for marks in panel["marks"].values() for case in marks
    ))  # fmt: skip
    figure, axes = pyplot.subplots(
        1, len(panels), figsize=(4.2 * len(panels), 0.45 * len(cases) + 1.6), squeeze=False,
        sharey=True, layout="constrained",
    )  # fmt: skip
    for axis, (name, panel) in zip(axes.flat, panels.items(), strict=True):
        numbers = [v for marks in panel["marks"].values() for v in marks.values()]
        edge = 10 * max([v for v in numbers if v != float("inf")] + panel["limits"])
        for n, (method, marks) in enumerate(panel["marks"].items()):
            rows = [cases.index(case) + 0.16 * (n - 1.5) for case in marks]
            axis.plot(
                [min(v, edge) for v in marks.values()], rows, linestyle="", label=method,
                marker=MARKERS[n % len(MARKERS)], color=COLORS[n % len(COLORS)], markersize=5,
            )  # fmt: skip
        for limit in panel["limits"]:
            axis.axvline(limit, color="0.4", linestyle=":", linewidth=1)
        axis.set(title=name, xscale="log")
        axis.set_yticks(range(len(cases)), cases)
        axis.grid(alpha=0.3)
    axes.flat[0].invert_yaxis()
    axes.flat[0].legend(fontsize=8)
    figure.suptitle(title)
    save(figure, path)
