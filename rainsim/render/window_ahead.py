"""Windows of the ground along a path, the next one made while frames of the present one are drawn.

A window is its part of the ground, the water up to its first frame, and what the renderer takes of
both. It depends on the path and on time alone: made ahead or when it is needed, it is the same.
"""

from __future__ import annotations

import atexit
import ctypes
import threading
from typing import NamedTuple

import numpy as np

from rainsim.io.allocator import trim
from rainsim.jit import get_num_threads, may_run_beside, set_threads
from rainsim.simulation import simulate, steady_water
from rainsim.terrain.path_ground import part_of

LAST_STEP = 5.0  # s that the end of the program waits for a thread's present call, at most
_threads = []  # that are at work, at most one of each sequence


class Window(NamedTuple):
    """Terrain, water and renderer's data that the frames of a station need.

    Attributes
    ----------
    station : Station
    depth : ndarray of shape (ny, nx), float32 [m]
        Of the water at the start, in the window and around it.
    around : Terrain
    reach : ndarray of shape (ny, nx), float32
        Share of the rain that reaches the ground there.
    states : iterator of SimState
        Those after `state`.
    state : SimState
        That the station's first frame shows.
    ready : ReadyGround or None
        What the renderer takes, if it was there when the window was made.
    """

    station: object
    depth: np.ndarray
    around: object
    reach: np.ndarray
    states: object
    state: object
    ready: object


class _StoppedError(Exception):
    """A window is no longer wanted."""


class Windows:
    """Makes the windows of a `PathGround`, one after the other.

    Parameters
    ----------
    ground : PathGround
    scene : Scene
    config : Config
    """

    def __init__(self, ground, scene, config):
        self._ground, self._scene, self._config = ground, scene, config
        self._work = self._ending = None  # the thread; the one before, if it was stopped

    def make_ahead(self, station, ready_ground=None):
        """Begin to make the window of a station on a thread, unless one is made already.

        Parameters
        ----------
        station : Station
        ready_ground : callable, optional
            See `Conductor.ready_ground`.
        """
        if self._work is None and may_run_beside():
            self._wait()
            self._work = _Work(station, lambda check: self._made(station, ready_ground, check))

    def is_ahead(self, station):
        """Tell whether the window of a station is made, or being made, already."""
        return self._work is not None and self._work.station == station

    def window(self, station, ready_ground=None):
        """Return the `Window` of a station, from the thread where it has begun there.

        An error of the thread is raised here.
        """
        work, self._work = self._work, None
        if work is not None and work.station == station:
            return work.result()
        if work is not None:
            work.stop()
            self._ending = work
        self._wait()
        return self._made(station, ready_ground)

    def stop(self):
        """Let the thread end after its present step."""
        if self._work is not None:
            self._work.stop()
            self._ending, self._work = self._work, None

    def _wait(self):
        """Wait until a stopped thread has let go of its memory, before another window takes it."""
        if self._ending is not None:
            self._ending.wait()
            self._ending = None

    def _made(self, station, ready_ground, check=lambda: None):
        """Return the `Window` of a station; `check()` is called between the steps."""
        config = self._config
        around = self._ground.around(self._scene, station, check)
        number, beyond = station.start(config), self._ground.about(around.grid)
        trim()
        check()
        begin = steady_water(around, config, number, beyond)
        trim()
        check()
        depth, reach = begin.depth.astype(np.float32), begin.exposure
        moment, ready = config.moment(station.first), None
        if ready_ground is not None:  # before the water's own maps take memory
            ready = ready_ground(around, reach, config.at(moment / config.fps))
            trim()
            check()
        part = part_of(around, station.window)
        states = simulate(part, config, begin=begin.within(station.window))
        del begin
        state = next(states)
        while state.index < moment:
            check()
            state = next(states)
        trim()
        return Window(station, depth, around, reach, states, state, ready)


class _Work:
    """A thread that makes the window of a station."""

    def __init__(self, station, make):
        self.station, self._make = station, make
        self._stopped, self._made, self._error = False, None, None
        self._threads = max(1, get_num_threads() // 2)  # the other half draws
        # As a daemon it does not keep an interrupted program from its end.
        self._thread = threading.Thread(target=self._run, name="window ahead", daemon=True)
        _threads.append(self)
        self._thread.start()

    def stop(self):
        """Let the thread end after its present step."""
        self._stopped = True

    def interrupt(self):
        """Raise an error in the thread, in the next line of Python that it runs."""
        thread = ctypes.c_ulong(self._thread.ident)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, ctypes.py_object(_StoppedError))

    def wait(self, seconds=None):
        """Wait until the thread has ended."""
        self._thread.join(seconds)

    def result(self):
        """Return the `Window` that was made; raise the error that came up."""
        self.wait()
        if self._error is not None:
            raise self._error
        return self._made

    def _run(self):
        try:
            set_threads(self._threads)  # kernels of each thread have their own number
            self._made = self._make(self._check)
        except BaseException as error:
            self._error = error
        finally:
            _threads.remove(self)

    def _check(self):
        if self._stopped:
            raise _StoppedError


@atexit.register
def _stop_all():
    """Let no kernel run while the interpreter ends: a thread ends with its present call."""
    for work in list(_threads):
        work.stop()
        work.interrupt()
        work.wait(LAST_STEP)
