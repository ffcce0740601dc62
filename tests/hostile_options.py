"""Values of options that nobody means, for every command that draws or simulates."""

import os
import resource
import subprocess
import sys
import time

import click

from rainsim.cli import cli

NUMBERS = ("0", "-1", "1e-300", "1e300", "-1e300", "1e30", "1e-30", "nan", "inf", "1e9", "-0",
           "1e-9", "99999999999999999999", "", "x")  # fmt: skip
PARTS = ("1e300", "-1e300", "0", "nan", "1e-300", "1e30")  # of values with several parts
BYTES, SECONDS = 6 << 30, 60  # that a command may take
# What does not belong to the values: what is read and written, and how.
LEFT_OUT = {"out", "scene", "terrain", "states", "scheduler", "workers", "threads", "port",
            "path", "cameras", "ground_frame", "class_mask", "labels", "sky", "preset", "camera",
            }  # fmt: skip


def values_of(option):
    """Yield hostile texts for an option; none for flags and choices."""
    if option.is_flag or isinstance(option.type, click.Choice | click.Path):
        return
    parts = getattr(option.type, "parts", None)
    if parts is None:
        yield from NUMBERS
        return
    for text in PARTS:
        yield ",".join([text] * len(parts))
        for k in range(len(parts)):
            yield ",".join(text if n == k else "1" for n in range(len(parts)))


def cases(command, *more):
    """Yield the arguments of a command, each with one hostile option."""
    for option in cli.commands[command].params:
        if not isinstance(option, click.Option) or option.name in LEFT_OUT:
            continue
        name = option.opts[0]
        for text in values_of(option):
            extra = [*more]
            if name in extra:  # instead of the value that keeps the run small
                at = extra.index(name)
                del extra[at : at + 2]
            if name in ("--eye", "--look-at", "--fov"):
                own = {"--eye": "0,-2,1", "--look-at": "0,0,0"} | {name: text}
                extra += [f"{key}={value}" for key, value in own.items()]
            else:
                extra.append(f"{name}={text}")
            yield [command, *extra]


def run(arguments, folder):
    """Run a command with bounded memory and time; return what was wrong with its end, or None."""

    def bounded():
        resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))

    begun = time.monotonic()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "rainsim", *map(str, arguments)], cwd=folder, text=True,
            capture_output=True, timeout=SECONDS, preexec_fn=bounded,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"went on after {SECONDS} s"
    errors = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    took = f"{time.monotonic() - begun:.1f} s"
    if done.returncode not in (0, 1, 2):
        return f"ended with {done.returncode} after {took}: {done.stderr[-300:]}"
    if "Traceback" in done.stderr or "Warning: " in done.stderr:
        return f"traceback or warning after {took}: {done.stderr[-300:]}"
    if "not enough memory" in done.stderr:
        return f"ran out of memory after {took}"
    if (done.returncode != 0) != (len(errors) == 1):
        return f"{len(errors)} errors with code {done.returncode}: {done.stderr[-300:]}"
    return None
