"""Twin of `splatting.prepared`: splats on a device, and room for those of actors before them.

The static set is sent once, and so are the actors, which `merged` puts into the room before it,
moment by moment. Those whose colours change are sent for each moment, as
`rainsim.splatting.merged` has them on the host. The room's other chunks are never drawn.
"""

import numpy as np

from rainsim.cuda.jit import cuda
from rainsim.cuda.splatting import project
from rainsim.cuda.splatting.merged import PosedActors, clean
from rainsim.errors import ParameterError
from rainsim.numerics.blocks import in_blocks
from rainsim.shading.wet_ground_mirror import as_in_level_picture
from rainsim.splatting.prepared import GEOMETRY, LANES, OPACITY, prepare

CHUNKS_AT_ONCE = 64  # of colours that a thread converts
ROW = GEOMETRY * LANES  # numbers of a chunk's geometry
MOST_NUMBERS = 1 << 24  # whole numbers that a float32 tells apart


class DeviceSplats:
    """Prepared splats on the device: sent once, shared by all pictures.

    room : int. Chunks of actors that there is room for.
    chunks, static, leading : int. Chunks with the room, without it, and with it
        those that were not to come last.
    rank : int32 device array (chunks,). The order in which splats of one depth
        are taken.
    """

    def __init__(self, prepared, room=0):
        self.room, self.static = room, len(prepared.box)
        self.count, self.chunks = len(prepared) + room * LANES, room + self.static
        self.compensate = prepared.compensate
        self.leading = room + (self.static if prepared.leading is None else prepared.leading)
        if self.chunks * LANES > project.MOST_SPLATS:
            raise ParameterError(
                f"the scene has {self.count} splats; backend cuda takes at most "
                f"{project.MOST_SPLATS}; take backend cpu"
            )
        geometry = self._with_room(clean(prepared.geometry).reshape(self.static, ROW), 0)
        geometry[:room, OPACITY * LANES :] = project.FAINT
        self.geometry = cuda.to_device(geometry.reshape(-1))
        count = 3 * (prepared.degree + 1) ** 2
        self.bands, self.groups = int(np.sqrt(count // 3)), -(-count // 8)
        self.sh = cuda.device_array(max(self.chunks, 1) * self.groups * 8 * LANES, np.float16)
        self.send_colors(prepared)
        self.centre, self.reach = reach_of(prepared.box)
        # A chunk of nothing but holes has an infinite box, which no comparison finds outside.
        self.box = cuda.to_device(self._with_room(prepared.box, 0))
        span, around = prepared.span, prepared.reach
        if span is None:
            span, around = np.zeros((self.static, 2)), np.zeros((self.static, 6))
            span[:, 1] = np.inf
        span = self._with_room(np.ascontiguousarray(span, np.float32), np.inf)
        self.span = cuda.to_device(span)
        self.rank = cuda.to_device(np.arange(self.chunks, dtype=np.int32))
        self.around = cuda.to_device(self._with_room(np.ascontiguousarray(around, np.float32), 0))
        self._static, self._posed = prepared.order, None
        self._order, self._first = lambda: prepared.order, room  # and the place of the first

    def _with_room(self, rows, value):
        """Return rows, one per chunk of the static set, with the room's before them."""
        if not self.room:
            return rows
        return np.concatenate([np.full((self.room, *rows.shape[1:]), value, rows.dtype), rows])

    def send_colors(self, prepared):
        """Send the static set's harmonics of `prepared`."""
        self._send_harmonics(prepared, self.static, self.room)

    def _send_harmonics(self, prepared, count, place):
        """Send the harmonics of the first `count` chunks to a place in the list of chunks."""
        if count == 0:
            return
        halves = np.empty((count, self.groups * 8 * LANES), np.float16)

        def convert(part):
            halves[part] = project.in_groups(prepared.harmonics(part.start, part.stop))

        in_blocks(convert, count, CHUNKS_AT_ONCE)
        at = place * halves.shape[1]
        self.sh[at : at + halves.size].copy_to_device(halves.reshape(-1))

    def put_actors(self, merged):
        """Send the actors of a merged set; its static chunks are on the device already."""
        used, room = len(merged.box) - self.static, self.room
        first = room - used
        if used:
            geometry = np.ascontiguousarray(clean(merged.geometry[:used]), np.float32)
            self.geometry[first * ROW : room * ROW].copy_to_device(geometry.reshape(-1))
            self.box[first:room].copy_to_device(np.ascontiguousarray(merged.box[:used]))
            self._send_harmonics(merged, used, first)
        self.show_room(np.arange(room) >= first)
        self._order, self._first = lambda: merged.order, first

    def pose_actors(self, actors, level=None):
        """Put the actors of an `ActorSplats` where they are, see `rainsim.raster.Rasterizer`."""
        if not actors.rigid:
            self.put_actors(actors.merged() if level is None else actors.standing(*level))
            return
        if self._posed is None:
            parts = [prepare(actor.splats) for actor in actors.actors]
            if level is not None:
                parts = [as_in_level_picture(part, level[1]) for part in parts]
            self._posed = PosedActors(self, parts, [actor.turning for actor in actors.actors])
        self._posed.put(actors.poses)
        shown = [pose is not None for pose in actors.poses]
        self._order, self._first = lambda: self._posed.order(self._static, shown, actors.first), 0

    def show_room(self, shown):
        """Draw those chunks of the room that the mask (room,) selects, no others."""
        if self.room:
            span = np.full((self.room, 2), np.inf, np.float32)
            span[shown, 0] = 0
            self.span[: self.room].copy_to_device(span)

    def divisors(self):
        """Return the divisors of the pictures that show which splat is hit, a digit each."""
        found = [1]
        while found[-1] * MOST_NUMBERS < self.chunks * LANES:
            found.append(found[-1] * MOST_NUMBERS)
        return found

    def of_digits(self, digits):
        """Return the splats that pictures of digits show, see `project.number_records`.

        digits : sequence of ndarray, float32. One for each of `divisors`;
            infinite where no splat stops half of the light.
        Returns ndarray, int32. Index in the scene that was prepared, actors
            behind it; -1 for none.
        """
        seen = np.isfinite(digits[0])
        hit, number = np.full(seen.shape, -1, np.int32), -self._first * LANES
        for divisor, digit in zip(self.divisors(), digits, strict=True):
            number = number + divisor * (digit[seen].astype(np.int64) - 1)
        hit[seen] = self._order()[number]
        return hit


def reach_of(box):
    """Return the middle of most chunks and the radius about it that holds nearly all."""
    middle = 0.5 * (box[:, :3] + box[:, 3:])
    middle = middle[np.isfinite(middle).all(axis=1)]
    if len(middle) == 0:
        return np.zeros(3), 1.0
    centre = np.median(middle, axis=0).astype(np.float64)
    return centre, float(np.percentile(np.linalg.norm(middle - centre, axis=1), 99))
