"""`rainsim doctor`: versions, threads, backends, memory, cache, and what is wrong."""

from __future__ import annotations

import json

import click

from rainsim.cli.options import json_option


@click.command(short_help="Tell what rainsim runs on and what is wrong.")
@json_option
@click.pass_context
def doctor(ctx, as_json):
    """Tell versions, threads, backends, GPU, memory and cache folder, and what is wrong.

    Exits with 1 if something is wrong. A missing GPU is not.

    \b
    Example:
        rainsim doctor
        rainsim doctor --json
    """
    from rainsim.doctor import report, table

    found = report()
    click.echo(json.dumps(found, indent=1) if as_json else table(found))
    ctx.exit(1 if found["wrong"] else 0)
