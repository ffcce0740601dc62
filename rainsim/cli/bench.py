"""`rainsim bench`: measure accuracy against time; what is measured loads when it is asked for."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.group()
def bench():
    """Measure accuracy against time on cases with known answers.

    \b
    Example:
        rainsim bench water --quick
    """


@bench.command()
@click.option(
    "--json", "json_path", type=click.Path(dir_okay=False, path_type=Path),
    help="Write all results to this file.",
)  # fmt: skip
@click.option(
    "--chart", "chart_path", type=click.Path(dir_okay=False, path_type=Path),
    help='Draw error against time to this PNG; needs pip install "rainsim[chart]".',
)  # fmt: skip
@click.option("--quick", is_flag=True, help="Small sizes, a minute at most.")
def water(json_path, chart_path, quick):
    """Run dam breaks, bowls, a ripple, a lake and rain on every water scheme.

    Prints relative error and time of each, then a table with the front of accuracy against time in
    bold.

    \b
    Example:
        rainsim bench water --json water.json --chart water.png
    """
    from rainsim.bench import chart
    from rainsim.bench import water as suite

    if chart_path:
        chart.require_matplotlib()  # before minutes are spent
    result = suite.run(quick, tell=lambda line: click.echo(line, err=True))
    if json_path:
        json_path.write_text(json.dumps(result, indent=1), encoding="utf-8")
    if chart_path:
        suite.draw(result, chart_path)
    click.echo(suite.table(result))


@bench.command()
@click.option(
    "--json", "json_path", type=click.Path(dir_okay=False, path_type=Path),
    help="Write all results to this file.",
)  # fmt: skip
@click.option(
    "--chart", "chart_path", type=click.Path(dir_okay=False, path_type=Path),
    help='Draw error against time to this PNG; needs pip install "rainsim[chart]".',
)  # fmt: skip
@click.option("--quick", is_flag=True, help="Few captures, a minute at most.")
def ground(json_path, chart_path, quick):
    """Find the ground of generated captures whose truth is known.

    Yards with dips, a kerb, a lawn, a table and floaters, tilted and scaled, and a street of 300 m:
    prints the error of up, bed, kerb and puddles and the time.

    \b
    Example:
        rainsim bench ground --json ground.json --chart ground.png
    """
    from rainsim.bench import chart
    from rainsim.bench import ground as suite

    if chart_path:
        chart.require_matplotlib()  # before minutes are spent
    result = suite.run(quick, tell=lambda line: click.echo(line, err=True))
    if json_path:
        json_path.write_text(json.dumps(result, indent=1), encoding="utf-8")
    if chart_path:
        suite.draw(result, chart_path)
    click.echo(suite.table(result))


@bench.command()
@click.option(
    "--json", "json_path", type=click.Path(dir_okay=False, path_type=Path),
    help="Write all results to this file.",
)  # fmt: skip
@click.option(
    "--chart", "chart_path", type=click.Path(dir_okay=False, path_type=Path),
    help='Draw omega(k) and costs to this PNG; needs pip install "rainsim[chart]".',
)  # fmt: skip
@click.option("--quick", is_flag=True, help="Fewer drops and rounds, a minute at most.")
def rain(json_path, chart_path, quick):
    """Read a gauge, fit ripples, and time streaks, splashes and ripples.

    Prints what the rain is against what was asked for, and what its parts cost.

    \b
    Example:
        rainsim bench rain --json rain.json --chart rain.png
    """
    from rainsim.bench import chart
    from rainsim.bench import rain as suite

    if chart_path:
        chart.require_matplotlib()  # before minutes are spent
    result = suite.run(quick, tell=lambda line: click.echo(line, err=True))
    if json_path:
        json_path.write_text(json.dumps(result, indent=1), encoding="utf-8")
    if chart_path:
        suite.draw(result, chart_path)
    click.echo(suite.table(result))
