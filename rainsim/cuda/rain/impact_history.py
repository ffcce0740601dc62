"""Impacts of the last moments on a CUDA device: each frame interval is listed once and kept.

Its water falls in one step of the simulation, and its splashes are seen for some frames.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from rainsim.cuda.driver import Event
from rainsim.cuda.drops import Impacts, Listed, room_for
from rainsim.cuda.graph import Graph, chain
from rainsim.cuda.jit import SIMULATED, cuda, pinned
from rainsim.cuda.small_copies import copy_small
from rainsim.errors import BackendError
from rainsim.particles.splash import LONGEST_LIFE


class RecentImpacts(Impacts):
    """The impacts of the last moments, interval by interval; each is listed once.

    weather : Weather. Of a rain.
    rate : float [Hz]. Interval n is from n to n + 1 over this.
    ahead : int. Intervals after a frame's time that its exposure sees.
    stream : cuda.stream
    relisted : bool. Whether what drops meet moves from frame to frame: then
        `list_again` lists all but the last interval for each frame, by what they
        meet at its time.
    listed : Event. Of the last `list_beside`.
    fallen : int64 array (1,). `obstacles` on the host, when what `settle` has
        queued is done.
    """

    def __init__(self, weather, surfaces, rate, ahead, stream=0):
        self._weather, self._rate, self._ahead = weather, rate, ahead
        field = weather.field(0.0, 1 / rate)
        # One more than a frame looks at: it may be listed while the frame before is drawn.
        slots = math.ceil(LONGEST_LIFE * rate) + ahead + 1
        super().__init__(field, surfaces, room_for(field, surfaces, 1 / rate), stream, slots)
        self._newest, self.relisted = None, False
        self._seen, self.fallen = pinned(slots, np.int32), pinned(1, np.int64)
        self.listed, self._recorded = Event(), None
        # Those that are listed again together have numbers of their own.
        self._again, self._recorded_again = [], None

    def update(self, frame):
        """Say that the frame of this number is next: `launch` then lists the last that it lacks.

        If it lacks more, because it does not follow on the frame before, they are listed here.
        """
        newest = frame + self._ahead - 1
        follows = self._newest is not None and newest in (self._newest, self._newest + 1)
        if not (follows or self.relisted):
            self._list_before(newest)
        self._say(newest)
        self._newest = newest
        times, slot = self._interval(frame - 1)
        self.settled.update(times=times, slot=slot)

    def next_list(self, frame):
        """Return which list the frame after this one fills, maybe while this one is drawn.

        What it holds until then is too old to be seen.
        """
        return (frame + self._ahead) % len(self._seen)

    def list_again(self):
        """Queue the listing of the intervals before the newest once more, on the own stream.

        It is recorded the first time, which waits.
        """
        numbers = self._before(self._newest)
        if not self._again:
            field = self._weather.field(*self._interval(numbers[0])[0])
            self._again = [Listed(self.stream, field) for _ in numbers]
        for now, number in zip(self._again, numbers, strict=True):
            times, slot = self._interval(number)
            self._set(now, self._weather.field(*times), *times, 0.0, slot)
        if self._recorded_again is None:
            queue = chain([partial(Impacts.launch, self, now=now) for now in self._again])
            cuda.synchronize()
            queue()  # compiles; that was the listing itself
            self._wait()
            self._recorded_again = Graph(self.stream, queue)
        else:
            self._recorded_again.launch()

    def _before(self, newest):
        """Return the numbers of the intervals that are seen before the newest one."""
        return range(newest - len(self._seen) + 2, newest)

    def _list_before(self, newest):
        cuda.synchronize()
        for number in self._before(newest):
            self._say(number)
            super().launch()
            self._wait()

    def _wait(self):
        if self.stream and not SIMULATED:
            self.stream.synchronize()
        else:
            cuda.synchronize()

    def launch(self, stream=None):
        """Queue the listing and the copy of its counts that `check` reads."""
        stream = self.stream if stream is None else stream
        super().launch(stream)
        copy_small(self.lists.found, self._seen, stream)

    def list_beside(self):
        """Queue the listing on the own stream; it is recorded the first time, which waits."""
        if self._recorded is None:
            self.launch()
            self.stream.synchronize()
            self._recorded = Graph(self.stream, self.launch)
        else:
            self._recorded.launch()
        self.listed.record(self.stream)

    def settle(self, water, ripples, stream=0, drips=None):
        """Queue what `Impacts.settle` does, and the copy to `fallen`."""
        super().settle(water, ripples, stream, drips)
        copy_small(self.obstacles, self.fallen, stream)

    def check(self):
        """Raise BackendError if a finished list had too little room."""
        if self._seen.max() > self.room:
            raise BackendError(
                f"{self._seen.max()} drops may end in one frame, which is more than there is room "
                "for; use more frames per second, or backend cpu"
            )

    def _interval(self, number):
        start, stop = number / self._rate, (number + 1) / self._rate
        return (start, stop), number % len(self._seen)

    def _say(self, number):
        times, slot = self._interval(number)
        super().update(self._weather.field(*times), *times, slot=slot)
