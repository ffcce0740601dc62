"""`python -m benchmarks`: programs that draw accuracy against time."""

from __future__ import annotations

import json
from functools import wraps
from importlib import import_module
from pathlib import Path

import click

from rainsim.cli import Commands
from rainsim.commands.options import backend_option

_FILE = click.Path(dir_okay=False, path_type=Path)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
def benchmarks():
    """Measure accuracy and time of the methods, each suite on one subject.

    \b
    Example:
        python -m benchmarks water --quick
    """


def _suite(short_help):
    """Make the suite `benchmarks.NAME` a command; the function below has its name and help.

    The function takes the options of this suite alone and may return what they stand for.
    """

    def add(function):
        @benchmarks.command(function.__name__, short_help=short_help)
        @click.option("--json", "json_path", type=_FILE, help="Write all results to this file.")
        @click.option(
            "--chart",
            "chart_path",
            type=_FILE,
            help='Draw the results to this PNG; needs pip install "rainsim[chart]".',
        )
        @click.option("--quick", is_flag=True, help="Small sizes, a minute at most.")
        @wraps(function)
        def run(json_path, chart_path, quick, **others):
            from benchmarks import chart

            others = function(**others) or others
            suite = import_module(f"benchmarks.{function.__name__}")
            if chart_path:
                chart.require_matplotlib()  # before minutes are spent
            result = suite.run(quick, say=lambda line: click.echo(line, err=True), **others)
            if json_path:
                json_path.write_text(json.dumps(result, indent=1), encoding="utf-8")
            if chart_path:
                suite.draw(result, chart_path)
            click.echo(suite.table(result))

        return run

    return add  # fmt: skip


@_suite("Accuracy and time of the water schemes.")
@backend_option
def water(**given):
    """Run dam breaks, bowls, a ripple, a lake and rain on every water scheme.

    Prints relative error and time of each, then a table with the front of accuracy against time in
    bold. With --backend cuda it prints cells a second of the GPU's solver at four sizes, with and
    without friction, beside a copy of the same bytes.

    \b
    Example:
        python -m benchmarks water --json water.json --chart water.png
    """


@_suite("Water schemes on cases where such schemes fail.")
def stress():
    """Try every water scheme on cases in which such schemes fail.

    Tall steps, thin water films, falls, drains, random rain, long time steps: prints whether the
    volume stays, depths stay positive and speeds stay below the bound that the energy sets.

    \b
    Example:
        python -m benchmarks stress --json stress.json --chart stress.png
    """


@_suite("Water schemes on analytic cases and hydrographs.")
def hydraulics():
    """Run steady channels, dam breaks, a bowl, rain on planes, a V-catchment and floods.

    Every water scheme in float32 and float64 at three sizes: prints error and time, then tables
    with the front of accuracy against time in bold, the orders at which errors fall with the grid
    (a second chart, -orders, draws them), what the catchment's hydrograph is beside kinematic
    theory, and when floods arrive beside a refined run.

    \b
    Example:
        python -m benchmarks hydraulics --json hydraulics.json --chart hydraulics.png
    """


@_suite("Accuracy of the ground found in generated captures.")
def ground():
    """Find the ground of generated captures whose true ground is known.

    Yards with dips, a kerb, a lawn, a table and floaters, tilted and scaled, and a street of 300 m:
    prints the errors of the up direction, bed, kerb and puddles, and the time.

    \b
    Example:
        python -m benchmarks ground --json ground.json --chart ground.png
    """


@_suite("Rain rate, ripples, and times of rain and splashes.")
def rain():
    """Read a gauge, fit ripples, and time streaks, splashes and ripples.

    Prints the collected rain over the rain rate that was asked for, and the time of each stage.

    \b
    Example:
        python -m benchmarks rain --json rain.json --chart rain.png
    """


@_suite("Accuracy and time of whole rainy frames.")
@backend_option
def frame(**given):
    """Draw whole rainy frames at several levels of quality, with a still and a moving camera.

    Prints the time of each stage, and time and error of each level against the same frame drawn at
    twice the size. A scene named garden in a folder of RAINSIM_SCENES is measured too, but not
    charted. On a GPU the camera moves, the times include the simulation, and three picture sizes,
    two maps, memory and frame sequences are measured too.

    \b
    Example:
        python -m benchmarks frame --json frame.json --chart frame.png
    """


@_suite("What a user waits for, from the command to the first picture.")
@backend_option
@click.option("--scene", multiple=True, metavar="NAME", help="Only these; may be given again.")
@click.option(
    "--compiled/--compile",
    default=True,
    help="Compile all kernels again for a run with empty caches, which takes minutes.",
)
@click.option("--growth", is_flag=True, help="Vary splats, cells and pixels of the bicycle.")
def wait(**given):
    """Draw the first picture of scenes by `rainsim run`, without kept results and with them.

    Prints time, processor time and memory of the whole process, and its stages. Scenes named
    garden, south and lund in a folder of RAINSIM_SCENES are measured beside the built-in ones.

    \b
    Example:
        python -m benchmarks wait --json wait.json --chart wait.png
        python -m benchmarks wait --growth --chart wait-growth.png
    """


@_suite("How the time of a frame grows with splats and pixels.")
def growth():
    """Draw moving frames with ever more splats, pixels and wet pixels.

    Prints times, and for each quantity n the exponent p of a fit of time = c n^p. A scene named
    garden in a folder of RAINSIM_SCENES is measured too, but not charted.

    \b
    Example:
        python -m benchmarks growth --json growth.json --chart growth.png
    """


@_suite("A long street in chunks: accuracy against memory and time.")
@click.option(
    "--length",
    type=click.FloatRange(40, 5000),
    metavar="M",
    show_default="200",
    help="Of the street; 1000 m are 13 million splats.",
)
@click.option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Keep the street's chunks there, or take them from there.",
)
@click.option(
    "--whole",
    is_flag=True,
    help="Only drive from end to end, one of three frames: time and memory along the way.",
)
def lod(**given):
    """Cut a long street into chunks and drive along it.

    Prints accuracy of rainy frames against frames of all splats, and their time and memory, over
    the threshold of --detail; then time and memory along a drive.

    \b
    Example:
        python -m benchmarks lod --length 1000 --json lod.json --chart lod.png
    """


@_suite("Accuracy and time of splatting.")
def splat():
    """Draw captures with each choice of the rasterizer and compare them with float64 pictures.

    Prints accuracy and time of each choice: polynomial of the exponential, cut-off, stop, storage
    and degree of harmonics, level of detail, depth. A scene named garden in a folder of
    RAINSIM_SCENES is measured too, but not charted.

    \b
    Example:
        python -m benchmarks splat --json splat.json --chart splat.png
    """


@_suite("Accuracy and time of reflections.")
def look():
    """Compare reflections with rays traced through the splats, and measure refraction and coverage.

    Prints accuracy, time and memory of each method of reflection, how many pixels of water mirror
    something that the camera does not see, and how far the paper's choices are from the defaults.

    \b
    Example:
        python -m benchmarks look --json look.json --chart look.png
    """


@_suite("Rainy pictures of captured days against a path tracer.")
@click.option(
    "--before",
    "before_path",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="The JSON of an earlier run, to stand beside this one in the chart.",
)
@click.option(
    "--remake",
    is_flag=True,
    help="Bake the captures and trace the truth again first, "
    'which takes Mitsuba (pip install "rainsim[truth]") 20 minutes on two cores.',
)
def day(before_path, **given):
    """Make captures of a sunny and a dull day rainy, and compare them with path-traced rainy days.

    Two made-up gardens: a patio that never changes, and a court under a tree on which nothing is
    tuned; and two captures that were trained from pictures, as users' are. Prints accuracy by
    region and what repairs by an oracle would win; cast shadows, walls, sky and film over what they
    should be; patches of the gain; and how far the result moves with what the truth chose.

    \b
    Example:
        python -m benchmarks day --json day.json --chart day.png
    """
    from rainsim.io.files import read_json

    before = None if before_path is None else read_json(before_path, "the result of benchmarks day")
    return {"before": before, **given}


@_suite("Figures of our rain beside published laws.")
def validate():
    """Compare figures of our rain with published laws and measurements.

    Drops along a path, gauges, extinction and visibility, false returns of a lidar, attenuation of
    radar, length and contrast of streaks: prints ours and the published figure, the tolerance, and
    the source.

    \b
    Example:
        python -m benchmarks validate --json validate.json --chart validate.png
    """


if __name__ == "__main__":
    benchmarks(prog_name="python -m benchmarks")
