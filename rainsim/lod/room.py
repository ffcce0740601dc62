"""Memory in which the prepared splats of pages lie, so that a picture takes them where they are.

A picture names the chunks that it is drawn of, in the order of the index. Nothing is copied for it,
and its bytes do not depend on where a page came to lie.
"""

from dataclasses import replace

import numpy as np

from rainsim.scene.types import Splats
from rainsim.splatting.prepared import LANES, NOBODY, prepare

ARRAYS = ("geometry", "sh", "fine", "step", "box")
# Times the chunks that pages are expected to take: those of other pictures may be in use besides.
SLACK = 1.5
GROWTH = 1.5  # times the chunks that there was room for, where pages in use need more
NOTHING = Splats(*(np.zeros((0, *shape), np.float32) for shape in ((3,), (4,), (3,), (), (1, 3))))
NO_CHUNKS = np.zeros(0, np.int64)


class ChunkRoom:
    """Room for the chunks of pages, a chunk of any page in any place.

    Pages are expected to take `most` bytes, and have about `chunks` chunks in all. The system gives
    memory when a place is first written. `prepared` has all places: in its `order` a splat of a
    page has the number that its page gave it.
    """

    def __init__(self, most, chunks):
        self._most, self._chunks = most, chunks
        self.prepared = replace(prepare(NOTHING), written=np.zeros(0, np.int64))
        self._next, self._free = 0, []

    def put(self, prepared):
        """Copy the chunks of `PreparedSplats`; return their places, ndarray of int64."""
        if not len(prepared.box):
            return NO_CHUNKS
        places = self._take(prepared, len(prepared.box))
        room = self.prepared
        for name in ARRAYS:
            getattr(room, name)[places] = getattr(prepared, name)
        order = np.full(len(places) * LANES, NOBODY, np.int32)
        order[: len(prepared.order)] = prepared.order
        room.order.reshape(-1, LANES)[places] = order.reshape(-1, LANES)
        room.written[places] += 1
        return places

    def free(self, places):
        """Let other pages have some places; called from any thread."""
        self._free.extend(places.tolist())

    def _take(self, like, count):
        """Return `count` free places, those used before first."""
        again = [self._free.pop() for _ in range(min(count, len(self._free)))]
        fresh = count - len(again)
        if self._next + fresh > len(self.prepared.box):
            self._grow(like, self._next + fresh)
        places = np.array([*again[::-1], *range(self._next, self._next + fresh)], np.int64)
        self._next += fresh
        return places

    def _grow(self, like, least):
        """Make room for `least` chunks and some more."""
        before = self.prepared
        if not self._next:
            each = sum(getattr(like, name)[0].nbytes for name in ARRAYS) + 4 * LANES
            least = max(least, min(int(SLACK * self._most / each), self._chunks))
        else:
            least = max(least, int(GROWTH * len(before.box)))
        arrays = {}
        for name in ARRAYS:
            own = getattr(like, name)
            arrays[name] = np.empty((least, *own.shape[1:]), own.dtype)
        order, written = np.empty(least * LANES, np.int32), np.zeros(least, np.int64)
        written[: len(before.written)] = before.written
        if self._next:
            for name, array in arrays.items():
                array[: self._next] = getattr(before, name)[: self._next]
            order[: self._next * LANES] = before.order[: self._next * LANES]
        self.prepared = replace(
            like, **arrays, order=order, leading=None, compensate=False, written=written
        )


def room_for(pages):
    """Return the `ChunkRoom` for the runs of `Pages`, as large as they let it be."""
    return ChunkRoom(pages.kept.most, int((-(-pages.tree.count // LANES)).sum()))


class Stored:
    """Where a page lies in a room, which it leaves when nobody holds this any more.

    `last` are splats that mirrors leave out. The attributes `first` and `last` are the places of
    their chunks, int64.
    """

    def __init__(self, room, first, last=None):
        self._room, self.first, self.last = room, NO_CHUNKS, NO_CHUNKS
        self.first = room.put(first)
        if last is not None:
            self.last = room.put(last)

    def __del__(self):
        self._room.free(self.first)
        self._room.free(self.last)
