"""Twin of `rainsim.lod.paged`: the chunks of a frame's pictures, chosen by the host.

The host chooses, reads and prepares as for the CPU, before a frame begins; what the device lacks is
sent while it draws nothing. A picture that needs the same chunks as the last one sends nothing.
"""

from __future__ import annotations

from rainsim.lod.paged import Held


class ChunkPicture:
    """The chunks that one kind of picture is drawn of, frame after frame.

    paged : PagedRasterizer. Chooses them.
    splats : DeviceRoom
    rasterizers : callable. rasterizers() returns a list of the `Rasterizer` that
        draw them.
    """

    def __init__(self, paged, splats, rasterizers):
        self._paged, self._splats, self._rasterizers = paged, splats, rasterizers
        self._held = Held()
        paged.let_go()  # of the last picture of the set-up

    def choose(self, pending, camera, near, plane=None, leading=False, threshold=None):
        """Choose the chunks of the next picture; the parameters are those of `Rasterizer.draw`.

        If others are to be drawn than are, `send` is added to the list `pending`.
        """
        self._paged.hold(self._held, camera, near, plane, leading, threshold)
        if self._is_behind():
            pending.append(self.send)

    def boxes(self):
        """Return the boxes of the chosen chunks, see `PreparedSplats`."""
        return self._paged.room.prepared.box[self._held.chunks]

    def _is_behind(self):
        chunks = self._held.chunks
        return any(each.chosen is not chunks for each in self._rasterizers())

    def send(self):
        """Send what is new; the device must draw nothing meanwhile."""
        if self._held.chunks is None or not self._is_behind():
            return
        self._splats.take(self._paged.prepared)
        for rasterizer in self._rasterizers():
            rasterizer.choose(self._held.chunks)
