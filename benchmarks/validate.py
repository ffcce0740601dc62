"""`benchmarks validate`: figures of our rain beside published laws and measurements.

Each row names the law, where its text or table stands, and a tolerance with its reason. The verdict
follows from one rule, `verdict_of`. What comes from drops, pictures and scans is counted in them,
not taken from the formulas that made them.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from benchmarks.chart import COLORS, MARKERS, log_ticks, require_matplotlib, save
from benchmarks.mie import DB, spectrum_attenuation
from benchmarks.rain import SIZES, WIND, level_camera, read_gauge
from benchmarks.suite import markdown, quiet
from rainsim.drops import RainField, RainSpectrum, flat_surfaces
from rainsim.particles.fog import fog_optical_depth
from rainsim.particles.streaks import draw_streaks, streak_reach
from rainsim.rain.size_distribution import SMALLEST
from rainsim.sensors.lidar import LidarScanner, Pose, Surface
from rainsim.sensors.lidar_model import EXTINCTION_EFFICIENCY, SCATTERED, SENSORS
from rainsim.sensors.lisa import loud_drops, scattered_share
from rainsim.sensors.radar import rain_attenuation

RATES = (1.0, 10.0, 25.0, 50.0, 100.0)  # mm/h
LIDAR_RATES = (10.0, 25.0, 50.0)  # those of REHEARSE-3D
PATH = {False: 200.0, True: 60.0}  # m, of 1 m2 section
TURNS = {False: 8, True: 2}
GAUGES = {False: (50_000, 4), True: (20_000, 1)}  # drops on each, and their number
BINS = (1.0, 2.0, 3.0, 5.0, 8.0)  # m
TARGET, REFLECTIVITY = 15.0, 0.3  # m
RADARS = (24.0, 77.0)  # GHz
EXPOSURES = (0.008, 0.016, 0.031, 0.062, 0.125)  # s, the span of Garg and Nayar's measurement
FRAMES = {False: 12, True: 3}
PICTURE = {False: SIZES["648 x 420"], True: (324, 210, 480.0)}  # of contrast; quick: its middle
FAR = 20.0  # m, of the wall behind the drawn rain
SPEEDS = {1.0: 4.03, 1.5: 5.40, 2.0: 6.49, 3.0: 8.06, 4.0: 8.83, 5.0: 9.09}  # mm: m/s
HALF_BIN = 0.05  # mm, of diameters whose speeds are averaged
DROP, AWAY, FOCAL = 2e-3, 5.0, 1000.0  # m, m, px of the drop whose streak is measured
SIGMAS = 3.0  # standard errors of a count that agrees
OPEN_AIR = flat_surfaces(1.0, 1.0, 1.0, origin=(1e9, 1e9))
VISIBLE = math.log(20)  # optical depth of the meteorological optical range: 5 % contrast (WMO)

MP = "Marshall and Palmer 1948: N0 8000 m-3 mm-1, 4.1 R^-0.21 per mm"
ATLAS = "Atlas, Srivastava and Sekhon 1973: 9.65 - 10.3 exp(-0.6 D)"
GUNN = "Gunn and Kinzer 1949, measured"
WEBER = "0.312 R^0.67 per km (Weber)"
FSO = "1.076 R^0.67 dB/km (Carbonneau and Wisely 1998)"
CAVE = "Garg and Nayar 2005, measured from 8 to 125 ms"
LISA = "LISA's model (Kilic and others 2021), same spectrum"
ITU = "ITU-R P.838-3, mean of both polarizations"
WHY = {
    "law": "25 %: rates from optical extinction differ so much from gauges on average "
    "(Ulbrich and Atlas 1985)",
    "count": "3 standard errors of the count",
    "own": "20 %: with real fall speeds the law returns 5 to 19 % more than its rate",
    "speed": "3 %: spread of the formulas for speeds (2 %) and our classes (1.6 %)",
    "shape": "3 %, and 3 standard errors",
    "power": "0.05 in the exponent",
    "bound": "at most the published bound",
    "geometry": "3 %: half a pixel",
}
BRING = (
    ("REHEARSE-3D", "share and range of rain points at 10, 25 and 50 mm/h"),
    ("SMART-Rain", "lidar and radar in natural rain"),
    ("ACDC", "contrast of rainy pictures against their clear partners; it has no rates"),
    ("RaindropGS", "drops on the lens"),
    ("arXiv 2606.11989", "a score of the joint spectrum of size and speed"),
)


class _Room(LidarScanner):
    """A scanner in open air amid a sphere of one reflectivity, infinitely far for no target."""

    def __init__(self, distance, reflectivity):
        self._distance, self._reflectivity = distance, reflectivity

    def surfaces_at(self, time):
        return OPEN_AIR

    def trace(self, origin, direction, before=0.0, time=0.0):
        count = len(direction)
        way = self._distance if math.isfinite(self._distance) else 0.0
        return Surface(
            np.full(count, self._distance), origin + way * direction, -direction,
            np.full(count, self._reflectivity),
        )  # fmt: skip


def run(quick=False, say=quiet):
    """Return all rows and the curves of the chart, see `benchmarks.suite`."""
    rows, curves = [], {}
    for name, measure in (
        ("drops along a path", drops_on_a_path), ("gauges", gauges),
        ("extinction in pictures", extinction), ("lidar", lidar_returns),
        ("radar", radar), ("streaks", streaks),
    ):  # fmt: skip
        say(name)
        found, curves[name] = measure(quick)
        rows += found
    return {"rows": rows, "curves": curves}


def row_of(what, rate, ours, published, unit, tolerance, why, source):
    """Return a row with its verdict.

    Parameters
    ----------
    what : str
    rate : float [mm/h] or None
    ours, published : float
    unit : str
    tolerance : float
        By which `ours` may differ, as a share of `published`; absolute where that is an exponent.
    why : str
        A key of WHY.
    source : str
    """
    row = {"what": what, "rate": rate, "ours": float(ours), "published": float(published),
           "unit": unit, "tolerance": float(tolerance), "why": why, "source": source}  # fmt: skip
    return {**row, "verdict": verdict_of(row)}


def verdict_of(row):
    """Return agrees if a figure is within its tolerance of the published one, else differs."""
    ours, published, why = row["ours"], row["published"], row["why"]
    if why == "bound":
        off, least = ours / published - 1, 0.0
    elif why == "power":
        off, least = abs(ours - published), row["tolerance"]
    else:
        off, least = abs(ours / published - 1), row["tolerance"]
    return "agrees" if off <= least else "differs"


def drops_on_a_path(quick):
    """Compare number, sizes and speeds of the drops in the air along a level path."""
    rows, curves = [], {}
    for rate in RATES:
        field = RainField(RainSpectrum(rate), WIND)
        length = PATH[quick]
        drops = field.drops_in_box(1.0, np.array([0.0, 0, 1]), np.array([length, 1.0, 2]))
        size, speed = drops.diameter * 1e3, -drops.velocity[:, 2]
        decay = 4.1 * rate**-0.21
        big = size > 1
        law = 8000 / decay * math.exp(-decay)
        sampled = SIGMAS / math.sqrt(max(big.sum(), 1))
        rows.append(row_of("drops above 1 mm", rate, big.sum() / length, law, "1/m3",
                           0.2 + sampled, "own", MP))  # fmt: skip
        fitted = 1 / (size.mean() - SMALLEST * 1e3)
        rows.append(row_of("decay of sizes", rate, fitted, decay, "1/mm",
                           0.03 + SIGMAS / math.sqrt(len(size)), "shape", MP))  # fmt: skip
        flux = (speed * math.pi / 6 * drops.diameter**3).sum() / length
        error = math.sqrt((drops.diameter**6 * speed**2).sum()) * math.pi / 6 / length / flux
        read = (flux + field.spectrum.fine_rate) * 3.6e6
        rows.append(row_of("rate along the path", rate, read, rate, "mm/h", SIGMAS * error,
                           "count", "the rate asked for"))  # fmt: skip
        edges = np.arange(0.5, 5.01, 0.25)
        count, _ = np.histogram(size, edges)
        curves[f"{rate:g}"] = {
            "diameter": (0.5 * (edges[1:] + edges[:-1])).tolist(),
            "number": (count / length / np.diff(edges)).tolist(),
        }
        if rate == RATES[-1]:  # the one with most large drops; speeds do not depend on the rate
            found, curves["speed"] = _speeds(size, speed)
            rows += found
    return rows, curves


def _speeds(size, speed):
    """Return rows of fall speeds [m/s] by diameter [mm], and the means of narrow bins."""
    rows, means = [], {}
    for at, measured in SPEEDS.items():
        near = np.abs(size - at) < HALF_BIN
        if near.sum() < 3:
            continue
        means[at] = float(speed[near].mean())
        atlas = float(np.mean(9.65 - 10.3 * np.exp(-0.6 * size[near])))
        rows += [row_of(f"speed of {at:g} mm", None, means[at], law, "m/s", 0.03, "speed", source)
                 for law, source in ((measured, GUNN), (atlas, ATLAS))]  # fmt: skip
    return rows, means


def gauges(quick):
    """Compare what gauges collect with the rate that was asked for."""
    rows = []
    for rate in RATES:
        gauge = read_gauge(rate, *GAUGES[quick])
        rows.append(row_of("gauge on the ground", rate, gauge["ratio"] * rate, rate, "mm/h",
                           SIGMAS * gauge["error"], "count", "the rate asked for"))  # fmt: skip
    return rows, {}


def extinction(quick):
    """Compare what drawn rain and its fog take from a wall's light with laws of extinction.

    A camera does not see the half that is diffraction; instruments and the laws do.
    """
    rows, curves = [], {}
    camera, depth = level_camera(*SIZES["648 x 420"])
    depth = np.full_like(depth, FAR)
    for rate in RATES:
        field, shares = RainField(RainSpectrum(rate), WIND), []
        reach = streak_reach(field, camera, 1 / 60, FAR)
        for k in range(FRAMES[quick]):
            alpha = np.empty(depth.shape, np.float32)
            draw_streaks(field, None, camera, float(k), 1 / 60, depth, reach, alpha)
            shares.append(-math.log1p(-float(alpha[_middle(depth)].mean(dtype=np.float64))))
        fog = float(fog_optical_depth(field, FAR, reach))
        whole = EXTINCTION_EFFICIENCY * 1e3 * (np.mean(shares) + fog) / FAR  # 1/km
        curves[f"{rate:g}"] = whole
        for law, source in ((0.312 * rate**0.67, WEBER), (1.076 * rate**0.67 / DB, FSO)):
            rows.append(row_of("extinction", rate, whole, law, "1/km", 0.25, "law", source))
        rows.append(row_of("visibility", rate, VISIBLE / whole,
                           VISIBLE / (0.312 * rate**0.67), "km", 0.25, "law", WEBER))  # fmt: skip
    return rows, curves


def _middle(depth):
    """Return the middle of a picture, where the way to a wall is nearly its depth."""
    height, width = depth.shape
    return np.s_[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3]


def lidar_returns(quick):
    """Compare false returns by range, targets that drops hide, and the rate that they lead to."""
    rows, curves, sensor = [], {}, SENSORS["vlp16"]
    pose = Pose(np.zeros(3), np.eye(3), np.zeros(3))
    local, _ = sensor.beams()
    bins = np.array(BINS)
    volume = math.pi / 12 * math.tan(sensor.divergence) ** 2 * np.diff(bins**3) * len(local)
    for rate in LIDAR_RATES:
        spectrum = RainSpectrum(rate)
        counts, hidden = np.zeros(len(bins) - 1), 0
        for seed in range(TURNS[quick]):
            field, rng = RainField(spectrum, WIND, seed), np.random.default_rng(0)
            scan = _Room(math.inf, 0.0).scan(sensor, pose, 3.0, rng, field)
            away = np.linalg.norm(scan.point[scan.label == SCATTERED], axis=1)
            counts += np.histogram(away, bins)[0]
            scan = _Room(TARGET, REFLECTIVITY).scan(sensor, pose, 3.0, rng, field)
            hidden += int((scan.label == SCATTERED).sum())
        turns = TURNS[quick]
        curves[f"{rate:g}"] = {"density": (counts / volume / turns).tolist(), "law": []}
        nearer = 0.0  # drops in a beam before this range: the loudest, mostly the nearest, counts
        for k, (low, high) in enumerate(pairwise(bins)):
            r = np.linspace(low, high, 201)
            loud = loud_drops(r, sensor.least_power, sensor, spectrum)
            law = float((loud * r**2).sum() / (r**2).sum()) * math.exp(-nearer)
            nearer += law * volume[k] / len(local)
            curves[f"{rate:g}"]["law"].append(law)
            expected = law * volume[k] * turns
            if expected >= 30:
                rows.append(row_of(
                    f"lidar returns {low:g} to {high:g} m", rate, counts[k] / volume[k] / turns,
                    law, "1/m3", SIGMAS / math.sqrt(expected), "count", LISA,
                ))  # fmt: skip
        share = hidden / len(local) / turns
        law = scattered_share(TARGET, REFLECTIVITY, sensor, spectrum)
        error = SIGMAS / math.sqrt(law * len(local) * turns)
        rows.append(row_of(f"targets at {TARGET:g} m behind drops", rate, 100 * share, 100 * law,
                           "%", error, "count", LISA))  # fmt: skip
        spread = _rate_of(law * (1 + error), sensor) / rate - 1
        rows.append(row_of("rate read back from the scan", rate, _rate_of(share, sensor), rate,
                           "mm/h", spread, "count", "the rate asked for"))  # fmt: skip
    return rows, curves


def _rate_of(share, sensor):
    """Return the rain rate [mm/h] at which LISA expects a share of the targets behind drops."""
    rates = np.geomspace(0.5, 200, 60)
    shares = [scattered_share(TARGET, REFLECTIVITY, sensor, RainSpectrum(r)) for r in rates]
    return float(np.interp(share, shares, rates))


def radar(quick):
    """Compare the attenuation of radar by the drop spectrum (Mie) with ITU-R P.838-3."""
    rows, curves = [], {}
    for frequency in RADARS:
        for rate in RATES:
            ours = spectrum_attenuation(RainSpectrum(rate), frequency)
            law = np.mean([rain_attenuation(rate, frequency, p)
                           for p in ("horizontal", "vertical")])  # fmt: skip
            curves[f"{frequency:g} {rate:g}"] = ours
            rows.append(row_of(f"radar at {frequency:g} GHz", rate, ours, law, "dB/km", 0.25,
                               "law", ITU))  # fmt: skip
    return rows, curves


def streaks(quick):
    """Compare length and contrast of streaks over the exposure with Garg and Nayar."""
    camera, depth = level_camera(*PICTURE[quick])
    depth, rate = np.full_like(depth, FAR), 25.0
    field, rows, curves = RainField(RainSpectrum(rate), WIND), [], {}
    for name in ("all drops drawn", "faint drops as fog"):
        contrast = []
        for exposure in EXPOSURES:
            reach, frames = FAR, []
            if name != "all drops drawn":
                reach = streak_reach(field, camera, exposure, FAR)
            for k in range(FRAMES[quick]):
                alpha = np.empty(depth.shape, np.float32)
                draw_streaks(field, None, camera, float(k), exposure, depth, reach, alpha)
                frames.append(alpha)
            # In time, as measured: over the picture the mean grows with the way through the rain.
            change = np.var(frames, axis=0, ddof=1, dtype=np.float64)
            contrast.append(float(np.sqrt(change.mean())))
        power = float(np.polyfit(np.log(EXPOSURES), np.log(contrast), 1)[0])
        rows.append(row_of(f"power of exposure in contrast, {name}", rate, power, -0.5, "", 0.05,
                           "power", CAVE))  # fmt: skip
        curves[name] = contrast
    length, peak = zip(*(_one_streak(exposure) for exposure in (1 / 250, 1 / 60)), strict=True)
    speed = 6.49
    rows.append(row_of("streak of 2 mm at 5 m, 1/250 to 1/60 s, longer by", None,
                       length[1] - length[0], FOCAL * speed / AWAY * (1 / 60 - 1 / 250), "px",
                       0.03, "geometry", f"speed times exposure, {GUNN}"))  # fmt: skip
    rows.append(
        row_of(
            "its contrast, 1/250 over 1/60 s",
            None,
            peak[0] / peak[1],
            250 / 60,
            "",
            0.03,
            "geometry",
            "Garg and Nayar 2007: time on a pixel over exposure",
        )
    )
    time = (field.spectrum.edges[1:] / field.spectrum.speed).max()
    rows.append(row_of("largest share of 30 ms that a drop is on a pixel", rate, time / 0.03,
                       0.039, "", 0, "bound", "Garg and Nayar 2007: 0 to 0.039"))  # fmt: skip
    return rows, curves


def _one_streak(exposure):
    """Return the length [px] of a drop's streak, and its alpha summed across where it is full."""
    camera, depth = level_camera(200, 300, FOCAL)
    depth, alpha = np.full_like(depth, FAR), np.empty(depth.shape, np.float32)
    speed = float(RainSpectrum(10.0).speed[_class_of(DROP)])
    line = np.array([[AWAY, 0.0, 1.5 + 0.5 * speed * exposure, 0.0, 0.0, -speed, DROP]])
    empty = RainField(RainSpectrum(0.0))
    draw_streaks(empty, None, camera, 0.0, exposure, depth, 1.0, alpha, more=line)
    along = alpha.sum(axis=1, dtype=np.float64)
    return float(along.sum() / along.max()), float(along.max())


def _class_of(diameter):
    return int(np.searchsorted(RainSpectrum(10.0).edges, diameter, "right") - 1)


def table(result):
    """Return the rows as text in Markdown, the tolerances' reasons, and what is not compared."""
    rows, heads = {}, [f"{rate:g}" for rate in RATES]
    for row in result["rows"]:
        name = f"{row['what']} [{row['unit']}]" if row["unit"] else row["what"]
        cells = rows.setdefault((name, row["source"], row["why"]), {})
        cells["" if row["rate"] is None else f"{row['rate']:g}"] = row
    by_rate = [(*key, cells) for key, cells in rows.items() if "" not in cells]
    single = [(*key, cells[""]) for key, cells in rows.items() if "" in cells]
    good = sum(row["verdict"] == "agrees" for row in result["rows"])
    return "\n".join([
        *markdown(
            ("ours / published", *(f"{rate} mm/h" for rate in heads), "tolerance", "source"),
            [(name, *(_cell(cells.get(rate)) for rate in heads), why, source)
             for name, source, why, cells in by_rate],
        ), "",
        *markdown(("figure", "ours / published", "tolerance", "source"),
                  [(name, _cell(row), why, source) for name, source, why, row in single]),
        "", f"{good} of {len(result['rows'])} figures agree; those that differ are in bold. "
        "Tolerances:", "",
        *(f"- {why}: {WHY[why]}" for why in dict.fromkeys(row["why"] for row in result["rows"])),
        "", "Not compared, since their tables could not be opened; bring the data:", "",
        *(f"- {name}: {text}" for name, text in BRING),
    ])  # fmt: skip


def _cell(row):
    if row is None:
        return ""
    text = f"{row['ours']:.3g} / {row['published']:.3g}"
    if row["why"] in ("count", "own", "shape"):
        text += f" ± {100 * row['tolerance']:.2g} %"
    return text if row["verdict"] == "agrees" else f"**{text}**"


def draw(result, path):
    """Draw spectrum, speeds, extinction, lidar returns, radar and contrast beside their laws."""
    pyplot = require_matplotlib()
    figure, axes = pyplot.subplots(2, 3, figsize=(12, 7), layout="constrained")
    curves = result["curves"]
    _draw_spectrum(*axes[0, :2], curves["drops along a path"])
    rate = np.geomspace(1, 100, 60)
    axes[0, 2].plot(rate, 0.312 * rate**0.67, color=COLORS[1], label="Weber")
    axes[0, 2].plot(rate, 1.076 * rate**0.67 / DB, color=COLORS[2], label="Carbonneau, Wisely")
    ours = curves["extinction in pictures"]
    axes[0, 2].plot([float(r) for r in ours], list(ours.values()), "o", color=COLORS[0],
                    label="ours, drawn")  # fmt: skip
    axes[0, 2].set(xlabel="rain [mm/h]", ylabel="[1/km]", title="Extinction")
    middle = [0.5 * (a + b) for a, b in pairwise(BINS)]
    for n, (name, curve) in enumerate(curves["lidar"].items()):
        axes[1, 0].plot(middle, curve["density"], MARKERS[n], color=COLORS[n],
                        label=f"{name} mm/h")  # fmt: skip
        axes[1, 0].plot(middle, curve["law"], color=COLORS[n], linewidth=1)
    axes[1, 0].plot([], [], color="0.3", label="LISA's model")
    axes[1, 0].set(xlabel="range [m]", ylabel="returns [1/m3]", title="Lidar, no target")
    for n, frequency in enumerate(RADARS):
        own = [curves["radar"][f"{frequency:g} {r:g}"] for r in RATES]
        axes[1, 1].plot(RATES, own, MARKERS[n], color=COLORS[n], label=f"ours, {frequency:g} GHz")
        law = [rain_attenuation(rate, frequency, p) for p in ("horizontal", "vertical")]
        axes[1, 1].fill_between(rate, *law, color=COLORS[n], alpha=0.4, label="ITU-R P.838-3")
    axes[1, 1].set(xlabel="rain [mm/h]", ylabel="[dB/km]", title="Radar")
    exposure = np.array(EXPOSURES)
    for n, (name, contrast) in enumerate(curves["streaks"].items()):
        axes[1, 2].plot(exposure * 1e3, contrast, MARKERS[n], color=COLORS[n], label=name)
        if n == 0:
            law = contrast[0] * np.sqrt(exposure[0] / exposure)
            axes[1, 2].plot(exposure * 1e3, law, color=COLORS[2], label="exposure^-0.5 (measured)")
    axes[1, 2].set(xlabel="exposure [ms]", ylabel="deviation of alpha", title="Contrast of rain")
    for axis in axes.flat:
        if axis is not axes[0, 0] and axis is not axes[0, 1]:
            log_ticks(axis)
        axis.legend(fontsize=8, loc="upper left" if axis is axes[0, 2] else "best")
    save(figure, path)


def _draw_spectrum(left, right, curves):
    """Draw number and speed of the drops along a path over their diameter."""
    size = np.linspace(0.5, 5, 100)
    for n, rate in enumerate(LIDAR_RATES):
        own = curves[f"{rate:g}"]
        left.plot(own["diameter"], own["number"], MARKERS[n], color=COLORS[n], markersize=4,
                  label=f"{rate:g} mm/h")  # fmt: skip
        left.plot(size, 8000 * np.exp(-4.1 * rate**-0.21 * size), color=COLORS[n], linewidth=1)
    left.plot([], [], color="0.3", label="Marshall and Palmer")
    left.set(xlabel="diameter [mm]", ylabel="[1/m3 mm]", yscale="log",
             title="Drops along a path")  # fmt: skip
    right.plot(size, 9.65 - 10.3 * np.exp(-0.6 * size), color=COLORS[1], label="Atlas")
    right.plot(list(SPEEDS), list(SPEEDS.values()), "s", color=COLORS[2], label="Gunn and Kinzer")
    means = {float(d): v for d, v in curves["speed"].items()}
    right.plot(list(means), list(means.values()), "o", color=COLORS[0], label="ours")
    right.set(xlabel="diameter [mm]", ylabel="[m/s]", title="Fall speed")
