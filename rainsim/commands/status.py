"""What the user sees while a command runs: lines and bars on stderr."""

import os
import signal
import sys
import threading
import time
from contextlib import contextmanager
from traceback import walk_stack

import click

from rainsim.errors import one_line

LOUD = ("ASSUMED", "WARNING", "NOT TO BE BELIEVED")  # words of notes that are printed bold
READING = "scene"  # the stage before all others
SHOWN = {READING: "reading", "simulate": "water"}  # stages whose time has another name
BESIDE = "compiling beside"  # what goes on beside the stages
SHORT = (
    "scale", "up, plane and scale", "ground:", "relight:", "sky:", "camera ", "drive:", "the path",
)  # fmt: skip
QUARTERS = 4  # without a terminal compiling reports this often at least
BEAT = 10.0  # s after which a stage reports again without a terminal
TICK = 1.0  # s between looks at the clock
LEAST_LEFT = 5.0  # s; less is not worth saying
LOADING = os.path.join("llvmlite", "binding", "executionengine.py")  # calls back from LLVM

_pressed = threading.Event()  # Ctrl-C, in this command, and no interrupt has been seen since


@contextmanager
def interrupts_remembered():
    """Note that Ctrl-C was pressed, so that the next progress of the main thread raises it again.

    Python drops what a signal raises inside a finalizer or another callback, and the command would
    go on; the traceback that it prints of it is kept back. Outside the main thread, or where the
    signal is ignored or the caller's, nothing changes.
    """
    _pressed.clear()
    own = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not own or threading.current_thread() is not threading.main_thread():
        yield
        return
    said = sys.unraisablehook
    sys.unraisablehook = lambda lost: lost.exc_type is KeyboardInterrupt or said(lost)
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = said


def interrupt(number, frame):
    """Raise KeyboardInterrupt; while a kernel is loaded, leave that to the next progress.

    LLVM asks for a kept kernel by a callback. What is raised in there is dropped, and the kernel
    that LLVM then misses ends the process.
    """
    _pressed.set()
    if not any(above.f_code.co_filename.endswith(LOADING) for above, _ in walk_stack(frame)):
        raise KeyboardInterrupt


class Status:
    """Says on stderr what is being done; silent when `quiet`, and all of it when `verbose`.

    `progress(stage, done, total)` is the callable that the pipeline's functions take. As a context
    manager it ends the bar on the way out, also on an error. In a terminal a stage has a bar;
    elsewhere it has lines with counts and the time that is left, if it takes longer than BEAT.

    `spent` is the time of each stage that is over [s].
    """

    def __init__(self, quiet=False, verbose=True):
        self.quiet, self.verbose = quiet, verbose
        self._stage = self._bar = self._compiling = None
        self._lock, self._said = threading.RLock(), set()
        self._start = self._since = time.perf_counter()
        self.spent, self._counted, self._compiled_from = {}, "start", None
        self._ticking, self._ended = None, threading.Event()
        self._ended.set()  # the clock goes within a `with` block only

    @property
    def seconds(self):
        """Time since the command began [s]."""
        return time.perf_counter() - self._start

    def count(self, stage):
        """Count the time from now on as that of a stage."""
        now = time.perf_counter()
        self.spent[self._counted] = round(self.spent.get(self._counted, 0.0) + now - self._since, 3)
        self._counted, self._since = SHOWN.get(stage, stage), now

    def in_stages(self):
        """Return in words how long the command has taken, and each stage."""
        self.count(self._counted)
        parts = (f"{stage} {time:.1f}" for stage, time in self.spent.items() if time >= 0.05)
        return f"{self.seconds:.1f} s: {', '.join(parts)}"

    def __enter__(self):
        self._ended.clear()
        return self

    def __exit__(self, *exception):
        self.close()
        self._ended.set()
        if self._ticking is not None:
            self._ticking.join()
            self._ticking = None

    def say(self, text, indent="", bold=False):
        """Print a line, above the bar if there is one; files' names may hold what no line holds."""
        if self.quiet:
            return
        with self._lock:
            for bar in self._bars():
                bar.clear()
            click.echo(indent + click.style(one_line(text), bold=bold or None), err=True)

    def _bars(self):
        """Return the bars that are shown."""
        both = self._bar, self._compiling and self._compiling.bar
        return [bar for bar in both if bar is not None]

    def notes(self, notes):
        """Print notes that were not printed before, as indented lines.

        Unless `verbose` those that begin as SHORT says, up to their first semicolon, and all LOUD.
        """
        for note in notes:
            if note not in self._said:
                self._said.add(note)
                # An assumption that everything rests on must not drown among the other lines.
                loud = any(word in note for word in LOUD)
                if loud or self.verbose:
                    self.say(note, "  ", bold=loud)
                elif note.startswith(SHORT):
                    self.say(note.split("; ")[0], "  ")

    def progress(self, stage, done, total):
        """Show that `done` of `total` parts of a stage are done."""
        if _pressed.is_set() and threading.current_thread() is threading.main_thread():
            _pressed.clear()
            raise KeyboardInterrupt
        self.count(stage)
        if self.quiet:
            return
        with self._lock:
            if self._stage is None or stage != self._stage.name:
                self._end_stage()
                self._stage = StageProgress(stage)
                self._open(stage, done, total)
            self._stage.update(done, total)
            if self._bar is not None:
                self._bar.update(done - self._bar.n)
                if self._bar.total != total:  # now it is known
                    self._bar.total, self._bar.leave = total, total > 1
                    self._bar.refresh()
                if done == total:
                    self._end_stage()
            elif total > 1 and self._stage.is_late():
                self._stage.tell()
            self._tick()

    def _open(self, stage, done, total):
        if not sys.stderr.isatty():
            return
        from tqdm import tqdm  # not needed for --help

        self._bar = tqdm(
            total=total, initial=done, desc=stage, file=sys.stderr, dynamic_ncols=True,
            leave=total > 1,
        )  # fmt: skip

    def compiling(self, share, done, total, processes=1):
        """Show that `done` of `total` kernels are compiled, a `share` of the work, 0 to 1.

        May be called from another thread.
        """
        if self._compiled_from is None and done < total:
            self._compiled_from = time.perf_counter()
        if self._compiled_from is not None:
            self.spent[BESIDE] = round(time.perf_counter() - self._compiled_from, 3)
        if self.quiet:
            return
        with self._lock:
            if self._compiling is None and done < total:
                self._compiling = _CompileProgress(total, processes)
            if self._compiling is not None:
                self._compiling.update(share, done)
                if done == total:
                    self._compiling.close()
                    self._compiling = None

    def _tick(self):
        """Start the thread that looks at the clock."""
        if self._ticking is None and not self._ended.is_set():
            self._ticking = threading.Thread(target=self._look, daemon=True)
            self._ticking.start()

    def _look(self):
        """Move the clock of a bar on, or say that a stage goes on which has not been heard of."""
        while not self._ended.wait(TICK):
            with self._lock:
                for bar in self._bars():
                    bar.refresh()
                if self._bar is None and self._stage is not None and self._stage.is_late():
                    self._stage.tell()

    def close(self):
        """End the bars that are shown."""
        with self._lock:
            if self._compiling is not None:
                self._compiling.close()
                self._compiling = None
            self._end_stage()

    def _end_stage(self):
        if self._bar is not None:
            self._bar.close()
        self._bar, self._stage = None, None


class StageProgress:
    """A stage as lines without a terminal: how far it is, and how long it will still take."""

    def __init__(self, name):
        self.name, self.done, self.total = name, 0, 1
        self._begun = self._heard = time.perf_counter()
        self._base = None  # parts that were done before: no time of this stage went into them
        self._first = None  # parts done and time when the first were: they are slow

    def update(self, done, total):
        """Take over how many parts are done."""
        self.done, self.total = done, total
        if self._base is None:
            self._base = done
        elif done > self._base and self._first is None:
            self._first = done, time.perf_counter()

    def is_late(self):
        """Whether the stage goes on and nothing has been said of it for a while."""
        return self.done < self.total and time.perf_counter() - self._heard >= BEAT

    def tell(self):
        """Print a line."""
        self._heard = now = time.perf_counter()
        text = f"{self.name} {self.done}/{self.total}" if self.total > 1 else self.name
        left = self.seconds_left(now)
        if self.done < self.total and now - self._begun >= BEAT:
            text += f", {in_words(now - self._begun)} so far"
        if left is not None and left >= LEAST_LEFT:
            text += f", about {in_words(left)} left"
        click.echo(text, err=True)

    def seconds_left(self, now):
        """Return how long the stage will still take [s]; None if that is not known yet."""
        if self._first is None or self.done >= self.total:
            return None
        done, since = self._first
        if self.done > done:
            return (now - since) / (self.done - done) * (self.total - self.done)
        return (now - self._begun) / (done - self._base) * (self.total - done)

    @property
    def counts(self):
        """How many parts were done before, how many since, and how many after the first of these.

        What went before took no time, and the first are slow: neither says how fast the others are.
        """
        base = self._base or 0
        return base, self.done - base, self.done - self._first[0] if self._first else 0


def in_words(seconds):
    """Return a time for people: 45 s, 3 min, 2 h 5 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


class _CompileProgress:
    """The bar, or the lines, of kernels that are being compiled; weighed by what each costs."""

    def __init__(self, total, processes):
        self.total, self.bar, self._told = total, None, 0
        self._begun = self._heard = time.perf_counter()
        many = f"{processes} processes" if processes > 1 else "one process"
        if not sys.stderr.isatty():
            click.echo(f"compiling {total} kernels for this machine in {many}, once", err=True)
            return
        from tqdm import tqdm

        self.bar = tqdm(
            total=1.0, desc=f"compiling {total} kernels, once", file=sys.stderr, leave=False,
            dynamic_ncols=True, bar_format="{desc}: {percentage:3.0f}%|{bar}| "
            "{elapsed}<{remaining}",
        )  # fmt: skip

    def update(self, share, done):
        """Show a share of the work, from 0 to 1."""
        if self.bar is not None:
            self.bar.update(max(share - self.bar.n, 0.0))
            return
        now = time.perf_counter()
        if int(share * QUARTERS) > self._told or (share < 1 and now - self._heard >= BEAT):
            self._told, self._heard = int(share * QUARTERS), now
            left = (now - self._begun) / share * (1 - share) if share > 0 else 0.0
            more = f", about {in_words(left)} left" if left >= LEAST_LEFT else ""
            click.echo(f"compiling {done}/{self.total}{more}", err=True)

    def close(self):
        """End the bar."""
        if self.bar is not None:
            self.bar.close()
