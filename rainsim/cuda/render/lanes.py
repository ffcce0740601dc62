"""Streams for the passes of a frame: which pass waits for which follows from what they read.

A part of a frame (`rainsim.render.frame`) is queued on one stream, its main lane. Passes on other
lanes run beside those on it. A lane waits for what its passes read of others, and for no more.
"""

from __future__ import annotations

from typing import NamedTuple

from rainsim.cuda.driver import Event
from rainsim.render.frame import reads_of


class Launch(NamedTuple):
    """How a pass is queued.

    queue : callable. queue(stream) queues the work of the pass.
    lane : numba.cuda.stream or None. That it lies on; None: the main lane of its
        part.
    """

    queue: object
    lane: object = None


class Lanes:
    """Queues the parts of a frame.

    passes : sequence of Pass
    launches : dict of str to Launch. By the names of the passes; what has no
        entry is computed with the passes that read it.
    """

    def __init__(self, passes, launches):
        self._passes = [each for each in passes if each.name in launches]
        self._reads, self._launches = reads_of(passes, launches), launches
        self._done = {each.name: Event() for each in self._passes}
        self._begun = Event()

    def of(self, part):
        """Return the passes of a part that are launched, in their order."""
        return [each for each in self._passes if each.part == part]

    def waits(self, part):
        """Return for each pass of a part the names of those on other lanes that it waits for.

        Under None stand those that the main lane waits for at the end: the last of each lane.
        """
        passes, waits = self.of(part), {}
        awaited = set()  # (name of a pass, lane that waits for it)
        for n, each in enumerate(passes):
            lane = self._launches[each.name].lane
            waits[each.name] = [
                before.name for before in passes[:n]
                if self._launches[before.name].lane is not lane
                and not self._reads[each.name].isdisjoint(before.writes)
                and (before.name, id(lane)) not in awaited
            ]  # fmt: skip
            awaited.update((name, id(lane)) for name in waits[each.name])
        last = {id(self._launches[each.name].lane): each.name for each in passes}
        last.pop(id(None), None)
        waits[None] = [name for name in last.values() if (name, id(None)) not in awaited]
        return waits

    def queue(self, part, main):
        """Queue a part of the frame on a stream, `main`, which then waits for all of it."""
        passes, waits = self.of(part), self.waits(part)
        awaited = {name for names in waits.values() for name in names}
        begun = set()
        self._begun.record(main)
        for each in passes:
            launch = self._launches[each.name]
            stream = main if launch.lane is None else launch.lane
            if launch.lane is not None and id(stream) not in begun:
                begun.add(id(stream))
                self._begun.wait(stream)
            for name in waits[each.name]:
                self._done[name].wait(stream)
            launch.queue(stream)
            if each.name in awaited:
                self._done[each.name].record(stream)
        for name in waits[None]:
            self._done[name].wait(main)
