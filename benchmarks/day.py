"""`benchmarks day`: captures of a sunny and a dull day, made rainy, against a path tracer.

Two made-up gardens of known geometry and materials: `day_patio`, which never changes, and
`day_court`, on which nothing is tuned. Splats of the radiance of a sunny day (with and without
splats of its sky) and of a dull dry day are the captures. The truth is the same garden traced under
an overcast sky, wet, with water in its dips. What falls is left out of the comparison.
Two captures of another patio were trained from pictures, as users' are: see `day_trained`.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks import day_data, day_score, day_trained
from benchmarks.chart import COLORS, require_matplotlib, save
from benchmarks.day_capture import capture, frames
from benchmarks.day_case import TINT, WIDTH
from benchmarks.day_court import COURT
from benchmarks.day_patio import PATIO
from benchmarks.day_score import LADDER, LAND, SCALARS
from benchmarks.suite import machine, quiet
from rainsim.errors import InputError

CASES = PATIO, COURT
DAYS = {"sun": ("sun", True), "no sky": ("sun", False), "dull": ("dull", True)}
LARGE = 0.01  # share of the picture from which a region stands in the table
ON_LAND = "PSNR on land"  # panel of the chart
COVERED = 0.9  # coverage from which a pixel of a puddle counts as water


def run(quick=False, say=quiet, remake=False, before=None):
    """Return all figures, see `benchmarks.suite`; `quick` compares one view of the sunny patio.

    `remake`: captures and traced pictures are made again first; `before` is the result of an
    earlier run, kept with this one for the chart.
    """
    if remake:
        from benchmarks.day_remake import remake as remake_files

        remake_files(CASES, say=say)
    start, found = time.perf_counter(), {}
    for case in CASES[:1] if quick else CASES:
        shapes, _ = case.build()
        arrays = day_data.read(case.name)
        if arrays["checksum"] != day_data.checksum(shapes.joined()[0]):
            raise InputError(
                f"the splats of {case.name} do not stand where its colours were baked: numpy draws "
                "other random numbers here, or the generator was edited; run with --remake"
            )
        days = {}
        for day, (baked, sky) in DAYS.items():
            if quick and day != "sun":
                continue
            say(f"{case.name}, {day}")
            scene = capture(case, shapes, arrays, baked, sky)
            days[day] = _compare_day(case, scene, arrays, quick, with_wind=day == "sun")
        found[case.name] = days
    if not quick:
        found["trained"] = {}
        for name, scene, arrays in day_trained.scenes():
            say(f"trained, {name}")
            found["trained"][name] = _compare_rain(scene, arrays, day_trained.RAIN)[0]
    return {
        "cases": found, "seconds": time.perf_counter() - start, "before": before,
        "machine": machine(),
    }  # fmt: skip


def _compare_day(case, scene, arrays, quick, with_wind):
    """Return the figures of one capture: its main rain, and effects of choices of the truth."""
    main, *others = case.rains
    found, drawn = _compare_rain(scene, arrays, main, main.views[:1] if quick else main.views)
    for rain in () if quick else others:
        if rain.wind == main.wind and rain.past == main.past:
            found["choices"][rain.name] = {
                view: compare_view(arrays, rain, view, *drawn[view]) for view in rain.views
            }
        elif with_wind:
            found["choices"][rain.name] = {
                view: compare_view(arrays, rain, view, *frame)
                for view, *frame in frames(scene, rain, rain.views, WIDTH)
            }
    return found


def _compare_rain(scene, arrays, rain, views=None):
    """Return the figures of a capture's views in a rain, and the frames that were drawn."""
    found, drawn = {"views": {}, "choices": {}}, {}
    for view, *frame in frames(scene, rain, views or rain.views, WIDTH):
        drawn[view] = frame
        found["views"][view] = compare_view(arrays, rain, view, *frame)
    # The factor that gives land its level, over that of the truth: the level of the true land
    # differs from view to view, too.
    factors = [one["exposure"] / one["zenith"] for one in found["views"].values()]
    found["spread"] = day_score.spread(factors)
    return found, drawn


def compare_view(arrays, rain, view, parts, zenith, brightness):
    """Return the figures of one view against its traced picture.

    `arrays` are those of `day_data.read`; `parts`, `zenith` and `brightness` come of
    `day_capture.frames`.
    """
    labels = day_data.unpack_labels(arrays[f"labels {view}"])
    truth, gain = traced(arrays, f"{rain.name} {view}", labels)
    picture = parts["picture"]
    factor = LAND / day_score.luminance(picture, ~labels.shows("sky"))
    own, true = (day_score.ratios(one, labels) for one in (picture, truth))
    scalars = {name: own[name] / true[name] for name in own.keys() & true.keys()}
    scalars["zenith"] = zenith * factor / gain
    found = {
        "exposure": factor, "zenith": gain, "ratios": {"truth": true, "drawn": own},
        "regions": day_score.by_region(picture, truth, labels, brightness),
        "ladder": day_score.ladder(picture, truth, labels),
        "patches": {
            name: day_score.patches(one, parts["clean"], labels)
            for name, one in (("truth", truth), ("drawn", picture))
        },
    }  # fmt: skip
    if rain.gloss:
        without, _ = traced(arrays, f"{rain.name} dull {view}", labels, gain)
        mirrored = truth - without
        true = day_score.gloss(mirrored, labels, gain)
        own = day_score.gloss(parts["gloss"], labels, zenith)
        found["gloss"] = {"truth": true, "drawn": own}
        if "paving" in true:
            scalars["film"] = own["paving"] / true["paving"]
        water = labels.shows("puddle") & (parts["coverage"] > COVERED)
        if water.sum() >= day_score.FEWEST:
            bare = mirrored / parts["fresnel"].clip(0.01)[..., None]
            true = day_score.luminance(bare, water) / gain
            scalars["water"] = day_score.luminance(parts["mirrored"], water) / zenith / true
        puddle = labels.shows("puddle")
        if puddle.any():
            found["covered"] = float(parts["coverage"][puddle].mean())
    found["scalars"] = scalars
    return found


def traced(arrays, name, labels, gain=None):
    """Return a traced picture, white-balanced, and the factor that gave its land LAND."""
    picture = day_data.unpack_picture(arrays[name]) / arrays.get("tint", TINT)
    if gain is None:
        gain = LAND / day_score.luminance(picture, ~labels.shows("sky"))
    return gain * picture, gain


def table(result):
    """Return all figures as text."""
    parts = []
    for case, days in result["cases"].items():
        for day, found in days.items():
            parts.append(_lines(f"{case}, {day}", found))
    return "\n\n".join([*parts, f"{result['seconds']:.0f} s"])


def _lines(title, found):
    """Return the table of one capture: a column for each view."""
    views = {int(view): one for view, one in found["views"].items()}
    head = "".join(f"{f'camera {view}':>22s}" for view in views)
    lines = [f"{title:36s}{head}", f"  {'on land':34s}" + f"{'dB  SSIM   dE':>22s}" * len(views)]
    for rung in LADDER:
        cells = (one["ladder"][rung] for one in views.values())
        lines.append(f"  {rung:34s}" + "".join(
            f"{c['psnr']:13.1f} {c['ssim']:.3f} {c['color']:4.1f}"[-22:].rjust(22) for c in cells
        ))  # fmt: skip
    lines.append(f"  {'drawn over true':34s}")
    for name, words in SCALARS.items():
        if name == "spread":
            lines.append(f"  {words:34s}{found['spread']:22.1%}")
            continue
        cells = (one["scalars"].get(name) for one in views.values())
        lines.append(f"  {words:34s}" + "".join(
            f"{'':22s}" if c is None else f"{c:22.2f}" for c in cells
        ))  # fmt: skip
    lines.append(f"  {'region':34s}" + f"{'ratio    dB  as is':>22s}" * len(views))
    names = dict.fromkeys(
        name for one in views.values() for name, r in one["regions"].items() if r["share"] >= LARGE
    )
    for name in names:
        cells = (one["regions"].get(name) for one in views.values())
        lines.append(f"  {name:34s}" + "".join(
            f"{'':22s}" if c is None else f"{c['ratio']:10.2f} {c['psnr']:5.1f} {c['as_is']:5.1f}"
            for c in cells
        ))  # fmt: skip
    lines.append(f"  {'patches: rms of log gain':34s}" + f"{'drawn  true':>22s}" * len(views))
    for name in day_score.PATCHED:
        cells = ([one["patches"][side].get(name) for side in ("drawn", "truth")]
                 for one in views.values())  # fmt: skip
        lines.append(f"  {name:34s}" + "".join(
            f"{'':22s}" if drawn is None else f"{drawn:16.3f} {true:5.3f}" for drawn, true in cells
        ))  # fmt: skip
    for choice, others in found["choices"].items():
        cells = ", ".join(
            f"camera {view} {one['ladder']['as is']['psnr']:.1f} dB, "
            f"last rung {one['ladder'][LADDER[-1]]['psnr']:.1f}" for view, one in others.items()
        )  # fmt: skip
        lines.append(f"  truth '{choice}': {cells}")
    return "\n".join(lines)


def draw(result, path):
    """Draw accuracy and scalars of all views as PNG, beside those of an earlier run if given."""
    pyplot = require_matplotlib()
    sets = {"drawn": result["cases"]}
    if result.get("before"):
        sets = {"drawn before": result["before"]["cases"], **sets}
    rows = [
        f"{case}, {day}, camera {view}" for case, days in result["cases"].items()
        for day, found in days.items() for view in found["views"]
    ]  # fmt: skip
    panels = [ON_LAND, *(name for name in SCALARS if name != "spread")]
    figure, axes = pyplot.subplots(
        1, len(panels), figsize=(2.6 * len(panels), 0.32 * len(rows) + 1.4), sharey=True,
        layout="constrained",
    )  # fmt: skip
    for name, cases in sets.items():
        color, fill = (COLORS[0], "full") if name == "drawn" else (COLORS[2], "none")
        style = {"linestyle": "", "marker": "o", "markersize": 5, "color": color,
                 "fillstyle": fill, "label": name}  # fmt: skip
        for axis, panel in zip(axes, panels, strict=True):
            marks = list(_marks(cases, rows, panel))
            axis.plot([x for x, _, _ in marks], [y for _, y, _ in marks], **style)
            if name == "drawn" and panel == ON_LAND:
                ends = [end for _, _, end in marks]
                axis.plot(ends, [y for _, y, _ in marks], linestyle="", marker="|", color="0.3",
                          markersize=8, label="colours right")  # fmt: skip
    for axis, panel in zip(axes, panels, strict=True):
        axis.set_title(SCALARS.get(panel, panel), fontsize=8)
        axis.grid(alpha=0.3)
        if panel in SCALARS:
            axis.set(xscale="log", xlim=(0.18, 5.5))
            axis.set_xticks((0.25, 0.5, 1, 2, 4), ("1/4", "1/2", "1", "2", "4"))
            axis.minorticks_off()
            axis.axvline(1, color="0.4", linestyle=":", linewidth=1)
            axis.set_xlabel("drawn over true")
    axes[0].set_xlabel("PSNR [dB]")
    axes[0].set_yticks(range(len(rows)), rows)
    axes[0].invert_yaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=len(labels))
    figure.suptitle("Captured days made rainy against path-traced rainy days")
    save(figure, path)


def _marks(cases, rows, panel):
    """Yield x, row and last rung of a panel's figures."""
    for case, days in cases.items():
        for day, found in days.items():
            for view, one in found["views"].items():
                row = f"{case}, {day}, camera {view}"
                if row not in rows:
                    continue
                rungs = one["ladder"]
                if panel in SCALARS:
                    value = one["scalars"].get(panel, np.nan)
                else:
                    value = rungs[LADDER[0]]["psnr"]
                yield value, rows.index(row), rungs[LADDER[-1]]["psnr"]
