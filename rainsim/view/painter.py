"""The thread that draws: pictures for all clients, and whatever else needs the kernels."""

import queue
import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from rainsim.errors import GroundError, RainsimError
from rainsim.jit import set_threads
from rainsim.view import schedule
from rainsim.view.clock import PlayClock
from rainsim.view.modes import RAIN, mode_picture
from rainsim.view.schedule import Schedule
from rainsim.view.session import OutOfDateError
from rainsim.view.threads import ThreadChoice


@dataclass(frozen=True)
class Shown:
    """A picture, the depth [m] of its pixels if it is finished, and the seconds that it took."""

    picture: np.ndarray
    depth: np.ndarray | None
    job: object
    seconds: float


def named(error):
    """Return an error as pages show it: those of the program itself by their kind, too."""
    if isinstance(error, RainsimError | OSError):
        return error
    return RainsimError(f"that cannot be done ({type(error).__name__}: {error}); undo the change")


class Painter:
    """Draws for all clients in one thread, the one that runs `run`.

    Other threads call `add`, `remove`, `look`, `set_mode`, `set_config`, `ask` and the methods of
    time; they return at once.

    say : callable, optional. say(text) reports the state in words: what is drawn
        or made.
    fail : callable, optional. fail(error) reports a RainsimError that settings
        led to.
    badly_seen : callable, optional. badly_seen(key, share) gets the share of a
        finished picture that the capture's cameras hardly saw.
    """

    def __init__(self, session, show, say=None, fail=None, now=time.perf_counter, badly_seen=None):
        self.session, self._show, self._now, self._badly_seen = session, show, now, badly_seen
        self._say, self._fail = say or (lambda text: None), fail or (lambda error: None)
        self.schedule = Schedule(full=session.config.width)
        self.clock = PlayClock(session.config.frames, session.config.fps)
        self._lock = threading.Condition()
        self._asked = queue.SimpleQueue()
        self._config, self._modes, self._ended = session.config, {}, False
        self._wrong = None  # settings that could not be drawn
        self._touched = -schedule.STILL_AFTER  # when the settings last changed
        self._threads, self._choice = None, ThreadChoice(1)

    # --- from other threads -----------------------------------------------------------------------

    def add(self, key):
        """Begin to draw for a client, first the rain."""
        with self._lock:
            self.schedule.add(key, self._now())
            self._modes[key] = (RAIN, 0.0)

    def remove(self, key):
        """Forget a client."""
        with self._lock:
            self.schedule.remove(key)
            self._modes.pop(key, None)

    def look(self, key, view, aspect):
        """Note the present camera of a client."""
        with self._lock:
            if self.schedule.move(key, view, aspect, self._now()):
                self._lock.notify_all()

    def set_mode(self, key, name, amount=0.0):
        """Show a client another mode, see `modes`; `amount` is the mm of rain of `puddles`."""
        self._change(lambda: self._modes.__setitem__(key, (name, amount)), key)

    def set_config(self, change):
        """Set what change(config) returns for the next pictures, or raise ParameterError."""
        config = change(self._config).check()
        if config == self._config:
            return

        def store():
            self._config, self._wrong = change(self._config).check(), None
            self._touched = self._now()
            self.clock.resize(self._config.frames, self._config.fps)

        self._change(store)

    @property
    def config(self):
        """The settings that are wanted."""
        return self._config

    def turn(self, change):
        """Change the clock by change(clock, now)."""
        self._change(lambda: change(self.clock, self._now()))

    def set_sizes(self, full=None, least=None, adapts=None, simplifies=None):
        """Choose the pictures' widths [px], and whether they are smaller or simpler in motion."""

        def store():
            plan = self.schedule
            plan.full = plan.full if full is None else full
            plan.least = min(plan.least if least is None else least, plan.full)
            plan.adapts = plan.adapts if adapts is None else adapts
            plan.simplifies = plan.simplifies if simplifies is None else simplifies

        self._change(store)

    def ask(self, function):
        """Return the Future of function(session), which the drawing thread calls."""
        future = Future()
        self._asked.put((function, future))
        with self._lock:
            self._lock.notify_all()
        return future

    def redraw(self):
        """Note that all pictures are out of date, and that failed settings may be tried again."""
        self._change(lambda: setattr(self, "_wrong", None))

    def end(self):
        """Let `run` return as soon as its present work allows."""
        with self._lock:
            self._ended = True
            self._lock.notify_all()

    def _change(self, store, key=None):
        with self._lock:
            store()
            self.schedule.plays = self.clock.plays
            self.schedule.change(self._now(), key)
            self._lock.notify_all()

    # --- the thread that draws --------------------------------------------------------------------

    def run(self):
        """Draw until `end` is called."""
        self._threads = set_threads(self._config.threads)  # each thread has its own number
        if self.session.backend == "cpu":
            self._choice = ThreadChoice(self._threads)
        while not self._ended:
            self._answer()
            job = self._next()
            if job is not None:
                self._draw(job)
        while not self._asked.empty():
            self._asked.get()[1].cancel()

    def step(self):
        """Do the work that is due now, for tests; return whether there was any."""
        asked = not self._asked.empty()
        self._answer()
        job = self._next(wait=False)
        if job is not None:
            self._draw(job)
        return asked or job is not None

    def _answer(self):
        """Call the functions that were asked for."""
        while not self._asked.empty():
            function, future = self._asked.get()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(function(self.session))
            except BaseException as error:
                future.set_exception(error)

    def _next(self, wait=True):
        """Return the next Job; wait for something to do, or return None."""
        with self._lock:
            now = self._now()
            if self.clock.tick(now):
                self.schedule.change(now)
            self.schedule.plays = self.clock.plays
            if self._config is not self.session.config:
                self.session.set_config(self._config)
            self.schedule.stale = bool(self.session.stale)
            job, pause = self.schedule.next(now)
            if job is not None or not wait or self._ended or not self._asked.empty():
                return job
            waits = [w for w in (pause, self.clock.wait(now)) if w is not None]
            self._lock.wait(min(waits, default=None))
            return None

    def _draw(self, job):
        """Draw one picture and show it, unless it is out of date before."""

        def check():
            if self._ended or not self.schedule.may_go_on(job):
                raise OutOfDateError

        session, begin = self.session, self._now()
        try:
            calm = begin - self._touched > schedule.STILL_AFTER
            if job.step == schedule.EXACT or not session.is_ready or (self.schedule.plays and calm):
                self._make(check)
            if job.step != schedule.SMALL:
                self._say(f"drawing {job.width} x {job.height}")
            threads = self._choice.next() if job.step == schedule.SMALL else self._threads
            set_threads(threads if self._threads else None)
            begin = self._now()
            try:
                picture, depth = self._picture(job, check)
            finally:
                set_threads(self._threads)
        except OutOfDateError:
            self.schedule.given_up(job, self._now())
            return
        except Exception as error:  # of any kind: the thread must go on for the other pages
            self._give_in(job, named(error))
            return
        seconds = self._now() - begin
        if job.step == schedule.SMALL:
            self._choice.took(threads, schedule.pace_of(job, seconds))
        with self._lock:
            self.schedule.done(job, seconds, self._now())
        finished = job.step == schedule.EXACT
        self._show(job.client, Shown(picture, depth if finished else None, job, seconds))
        what = "finished" if finished else "moving"
        self._say(f"{what}: {job.width} x {job.height}, {seconds * 1e3:.0f} ms")
        if finished and self._badly_seen is not None:
            share = session.badly_seen(job.view, job.width, job.height)
            if share is not None:
                self._badly_seen(job.client, share)

    def _make(self, check):
        """Make the parts that are out of date, once for each choice of settings that fails."""
        if self.session.stale and self._wrong is not self.session.config:
            self._say("computing " + ", ".join(sorted(self.session.stale)))
            try:
                self.session.make(check)
            except GroundError as error:  # the capture alone is drawn, for up to be mended
                self._wrong = self.session.config
                self._fail(error)
            self._say("drawing")

    def _give_in(self, job, error):
        """Report settings that cannot be drawn, once; draw nothing more until they change."""
        with self._lock:
            self.schedule.done(job, 0.0, self._now())
            client = self.schedule.clients.get(job.client)
            if client is not None:
                client.shown = (job.generation, job.width, schedule.EXACT)
        if self._wrong is not self.session.config:
            self._wrong = self.session.config
            self._fail(error)

    def _picture(self, job, check):
        """Return the picture of a client's mode, and the picture's depth [m]."""
        session = self.session
        if not session.is_ready:
            return session.draw_bare(job.view, job.width, job.height)
        name, amount = self._modes.get(job.client, (RAIN, 0.0))
        return mode_picture(
            session, name, amount, (job.view, job.width, job.height, self.clock.index), check,
            with_depth=job.step == schedule.EXACT, simple=job.simple,
        )  # fmt: skip
