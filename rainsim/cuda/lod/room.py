"""Twin of `rainsim.lod.room`: the places of a room for chunks, in the memory of a device.

A chunk has on the device the place that it has on the host, so what the host lets go, least
recently used first, makes room here, too. A chunk is sent when it is drawn for the first time since
its place was written.
"""

import numpy as np

from rainsim.cuda.jit import cuda
from rainsim.cuda.splatting import project
from rainsim.cuda.splatting.merged import clean
from rainsim.cuda.splatting.prepared import ROW, DeviceSplats, reach_of
from rainsim.errors import ParameterError
from rainsim.splatting.prepared import LANES

AT_ONCE = 4096  # chunks that are sent together


class DeviceRoom(DeviceSplats):
    """A room for chunks on the device; each `Rasterizer` draws those that were chosen for it.

    prepared : rainsim.raster.PreparedSplats. All places of a `ChunkRoom`, see
        `take`.
    sent : int. Bytes of chunks that were sent so far.
    """

    def __init__(self, prepared):
        self.room = self._first = self.static = self.chunks = self.leading = self.sent = 0
        # Each rasterizer has its own.
        self.span, self.rank = np.zeros((0, 2), np.float32), np.zeros(0, np.int32)
        self.count, self.centre, self.reach, self._places = 0, np.zeros(3), 1.0, None
        self._there = np.zeros(0, np.int64)  # how often a place was written when it was sent
        self.take(prepared)

    def take(self, prepared):
        """Take over the places of a room, larger ones if it has grown; nothing is sent yet."""
        self.compensate, self._order = prepared.compensate, lambda: prepared.order
        if self._places is None or prepared.geometry is not self._places.geometry:
            self._grow(prepared)
        self._places = prepared

    def _grow(self, prepared):
        chunks, before = len(prepared.box), self.chunks
        if chunks * LANES > project.MOST_SPLATS:
            raise ParameterError(
                f"chunks of a capture may take places of {chunks * LANES} splats; backend cuda has "
                f"at most {project.MOST_SPLATS}; give less --memory"
            )
        count = 3 * (prepared.degree + 1) ** 2
        self.bands, self.groups = int(np.sqrt(count // 3)), -(-count // 8)
        for name, row, kind in (
            ("geometry", ROW, np.float32), ("sh", self._row, np.float16), ("box", 6, np.float32),
        ):  # fmt: skip
            larger = cuda.device_array(max(chunks, 1) * row, kind)
            if before:
                larger[: before * row].copy_to_device(getattr(self, name).reshape(before * row))
            setattr(self, name, larger)
        self.box = self.box.reshape(max(chunks, 1), 6)
        self.around = cuda.to_device(np.zeros((max(chunks, 1), 6), np.float32))
        self._there = np.concatenate([self._there, np.zeros(chunks - before, np.int64)])
        self.static = self.chunks = self.leading = chunks

    @property
    def host_box(self):
        """Boxes of all places on the host, see `PreparedSplats`."""
        return self._places.box

    @property
    def _row(self):
        """Numbers of a chunk's harmonics."""
        return self.groups * 8 * LANES

    def send_colors(self, prepared):
        """Take over the places of a room: chunks in other colours lie in others."""
        self.take(prepared)

    def aim_at(self, box):
        """Take over boxes (n, 6) of chunks to be drawn: there levels of depth are dense."""
        self.count = len(box) * LANES
        self.centre, self.reach = reach_of(box)

    def send(self, chunks):
        """Send those of some chunks that are not there."""
        written = self._places.written
        stale = np.unique(chunks[self._there[chunks] != written[chunks]])
        breaks = np.flatnonzero(np.diff(stale) != 1) + 1
        for run in np.split(stale, breaks) if len(stale) else ():
            for first in range(int(run[0]), int(run[-1]) + 1, AT_ONCE):
                self._send_run(slice(first, min(first + AT_ONCE, int(run[-1]) + 1)))
        self._there[stale] = written[stale]

    def _send_run(self, run):
        places, first, end = self._places, run.start, run.stop
        geometry = np.ascontiguousarray(clean(places.geometry[run]), np.float32).reshape(-1)
        halves = project.in_groups(places.harmonics(first, end)).reshape(-1)
        box = np.ascontiguousarray(places.box[run])
        self.geometry[first * ROW : end * ROW].copy_to_device(geometry)
        self.sh[first * self._row : end * self._row].copy_to_device(halves)
        self.box[first:end].copy_to_device(box)
        self.sent += geometry.nbytes + halves.nbytes + box.nbytes
