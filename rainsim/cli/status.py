"""What the user sees while a command runs: lines and bars on stderr."""

from __future__ import annotations

import sys
import time

import click

QUARTERS = 4  # without a terminal a stage reports this often


class Status:
    """Says on stderr what is being done; silent when `quiet`.

    `progress(stage, done, total)` is the callable that the pipeline's functions take. As a context
    manager it ends the bar on the way out, also on an error.
    """

    def __init__(self, quiet=False):
        self.quiet = quiet
        self._stage, self._bar, self._told = None, None, 0
        self._said = set()
        self._start = time.perf_counter()

    @property
    def seconds(self):
        """Time since the command began [s]."""
        return time.perf_counter() - self._start

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    def say(self, text):
        """Print a line, above the bar if there is one."""
        if self.quiet:
            return
        if self._bar is not None:
            self._bar.clear()
        click.echo(text, err=True)

    def notes(self, notes):
        """Print notes that were not printed before, as indented lines."""
        for note in notes:
            if note not in self._said:
                self._said.add(note)
                # An assumption that everything rests on must not drown among the other lines.
                self.say(click.style(f"  {note}", bold=True) if "ASSUMED" in note else f"  {note}")

    def progress(self, stage, done, total):
        """Show that `done` of `total` parts of a stage are done."""
        if self.quiet:
            return
        if stage != self._stage:
            self.close()
            self._stage, self._told = stage, 0
            self._open(stage, total)
        if self._bar is not None:
            self._bar.update(done - self._bar.n)
            if done == total:
                self.close()
        elif total > 1 and done * QUARTERS // total > self._told:
            self._told = done * QUARTERS // total
            click.echo(f"{stage} {done}/{total}", err=True)

    def _open(self, stage, total):
        if not sys.stderr.isatty():
            click.echo(f"{stage} ...", err=True)
            return
        from tqdm import tqdm  # not needed for --help

        self._bar = tqdm(
            total=total, desc=stage, file=sys.stderr, dynamic_ncols=True, leave=total > 1
        )

    def close(self):
        """End the bar that is shown."""
        if self._bar is not None:
            self._bar.close()
        self._bar, self._stage = None, None


def tell_scene(status, scene):
    """Say what was loaded, and what was found or is only assumed about it."""
    cameras = len(scene.cameras)
    status.say(
        f"scene {scene.name}: {len(scene.splats):,} splats, {cameras} "
        f"camera{'' if cameras == 1 else 's'}"
    )
    status.notes(scene.notes)
    status.notes(scene.ground_frame.notes)


def tell_compiling(status):
    """Say so if the kernels have not been compiled on this machine yet."""
    from rainsim.jit import CACHE_FOLDER

    if next(CACHE_FOLDER.rglob("*.nbi"), None) is None:
        status.say("first run of this version: compiling for this machine takes a minute or two")
