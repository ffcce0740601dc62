"""What the user sees while a command runs: lines and bars on stderr."""

from __future__ import annotations

import sys
import threading
import time

import click

from rainsim.errors import one_line

LOUD = ("ASSUMED", "WARNING", "NOT TO BE BELIEVED")  # words of notes that are printed bold
QUARTERS = 4  # without a terminal a stage reports this often


class Status:
    """Says on stderr what is being done; silent when `quiet`.

    `progress(stage, done, total)` is the callable that the pipeline's functions take. As a context
    manager it ends the bar on the way out, also on an error.
    """

    def __init__(self, quiet=False):
        self.quiet = quiet
        self._stage, self._bar, self._told = None, None, 0
        self._compiling, self._lock = None, threading.RLock()
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

    def say(self, text, indent="", bold=False):
        """Print a line, above the bar if there is one; files' names may hold what no line holds."""
        if self.quiet:
            return
        with self._lock:
            for bar in (self._bar, self._compiling and self._compiling.bar):
                if bar is not None:
                    bar.clear()
            click.echo(indent + click.style(one_line(text), bold=bold or None), err=True)

    def notes(self, notes):
        """Print notes that were not printed before, as indented lines."""
        for note in notes:
            if note not in self._said:
                self._said.add(note)
                # An assumption that everything rests on must not drown among the other lines.
                self.say(note, "  ", bold=any(word in note for word in LOUD))

    def progress(self, stage, done, total):
        """Show that `done` of `total` parts of a stage are done."""
        if self.quiet:
            return
        with self._lock:
            if self._compiling is not None:
                self._compiling.beside(stage, done, total)
            else:
                self._progress(stage, done, total)

    def _progress(self, stage, done, total):
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

    def compiling(self, share, done, total, processes=1):
        """Show that `done` of `total` kernels are compiled, a `share` of the work, 0 to 1.

        May be called from another thread. Until all are done a stage that `progress` reports is
        named beside this bar and gets none of its own.
        """
        if self.quiet:
            return
        with self._lock:
            if self._compiling is None and done < total:
                self.close()
                self._compiling = _Compiling(total, processes)
            if self._compiling is not None:
                self._compiling.update(share, done)
                if done == total:
                    self._end_compiling()

    def _end_compiling(self):
        compiling, self._compiling = self._compiling, None
        compiling.close()
        if compiling.stage is None:
            return
        stage, done, total = compiling.stage
        if compiling.bar is None:  # the stage has been named
            self._stage, self._told = stage, done * QUARTERS // max(total, 1)
        elif done < total:
            self._progress(stage, done, total)  # the stage that is under way gets its bar

    def close(self):
        """End the bar that is shown."""
        with self._lock:
            if self._compiling is not None:
                self._compiling.close()
                self._compiling = None
            if self._bar is not None:
                self._bar.close()
            self._bar, self._stage = None, None


class _Compiling:
    """The bar, or the lines, of kernels that are being compiled; weighed by what each costs."""

    def __init__(self, total, processes):
        self.total, self.bar, self.stage, self._told = total, None, None, 0
        many = f"{processes} processes" if processes > 1 else "one process"
        if not sys.stderr.isatty():
            click.echo(f"compiling {total} kernels for this machine in {many}, once", err=True)
            return
        from tqdm import tqdm

        self.bar = tqdm(
            total=1.0, desc=f"compiling {total} kernels, once", file=sys.stderr, leave=False,
            dynamic_ncols=True, bar_format="{desc}: {percentage:3.0f}%|{bar}| "
            "{elapsed}<{remaining} {postfix}",
        )  # fmt: skip

    def update(self, share, done):
        """Show a share of the work, from 0 to 1."""
        if self.bar is not None:
            self.bar.update(max(share - self.bar.n, 0.0))
        elif int(share * QUARTERS) > self._told:
            self._told = int(share * QUARTERS)
            click.echo(f"compiling {done}/{self.total}", err=True)

    def beside(self, stage, done, total):
        """Name the stage that goes on meanwhile."""
        if self.stage is None or self.stage[0] != stage:
            if self.bar is None:
                click.echo(f"{stage} ...", err=True)
            else:
                self.bar.set_postfix_str(stage)
        self.stage = (stage, done, total)

    def close(self):
        """End the bar."""
        if self.bar is not None:
            self.bar.close()


def say_scene(status, scene):
    """Say what was loaded, and what was found or is only assumed about it."""
    cameras = len(scene.cameras)
    status.say(
        f"scene {scene.name}: {len(scene.splats):,} splats, {cameras} "
        f"camera{'' if cameras == 1 else 's'}"
    )
    status.notes(scene.notes)
    status.notes(scene.ground_frame.notes)
