"""`rainsim doctor`: versions, threads, backends, memory, cache, and what is wrong."""

import click

from rainsim.commands.options import echo, json_option


@click.command(short_help="Check the installation and this machine.")
@json_option
@click.pass_context
def doctor(ctx, as_json):
    """Show versions, threads, backends, GPU, memory and cache folder, and what is wrong with them.

    Exits with 1 if something is wrong. A missing GPU is not wrong.

    \b
    Example:
        rainsim doctor
        rainsim doctor --json
    """
    from rainsim.commands.environment import report, table

    found = report()
    echo(found, as_json, table(found))
    ctx.exit(1 if found["wrong"] else 0)
