"""Twin of `rainsim.particles.spray`: the spray of tyres in a picture on a CUDA device.

The host chooses the parcels whose drops are drawn one by one and the clouds of all others; the
device scatters the drops, a thread each, and draws them with the streaks of the rain. A thread
takes a pixel through all clouds.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.cuda.drops import BLOCKS
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.particles.splash_pass import draw_list
from rainsim.cuda.warp import GROUPS
from rainsim.numerics.approximations import exp_minus
from rainsim.numerics.random import subkey, uniform_triple
from rainsim.particles.spray import (
    FIRST_WORD,
    MOST_DRAWN,
    UNEVEN,
    cloud_of,
    cloud_table,
    cloud_thickness,
    passes_beside,
)

BLOCK = (8, 4) if SIMULATED else (32, 8)  # threads, one a pixel
THREADS = 8 if SIMULATED else 128
ROOM = 1024  # clouds, and parcels, that there is room for at first
SPREAD, DIAMETER, ROAD = 6, 7, 8  # columns of a table of flocks, after place and velocity


@cuda_kernel
def lay_clouds(many, clouds, lens, depth, alpha_out):
    """Put clouds before a picture; see the CPU's kernel.

    Parameters
    ----------
    many : device array of shape (1,), int32
    clouds : device array of shape (room, 5), float32
        See `cloud_table`.
    lens : device array of shape (7,), float32
        Whose first four are fx, fy, cx, cy [px].
    depth, alpha_out : device array of shape (height, width), float32
    """
    column, row = cuda.grid(2)
    height, width = alpha_out.shape
    if row >= height or column >= width:
        return
    a = (np.float32(column) + HALF - lens[2]) / lens[0]
    b = (np.float32(row) + HALF - lens[3]) / lens[1]
    deep, optical = depth[row, column], ZERO
    for n in range(many[0]):
        cloud = cloud_of(clouds[n, 0], clouds[n, 1], clouds[n, 2], clouds[n, 3], clouds[n, 4])
        if not passes_beside(a, b, cloud):
            optical += cloud_thickness(a, b, deep, cloud, cloud.nearest < ZERO)
    if optical > ZERO:
        alpha_out[row, column] = ONE - (ONE - alpha_out[row, column]) * exp_minus(optical)


@cuda_kernel
def scatter(ends, ids, table, count_out, drops_out):
    """List the drops of parcels around their middles; see `particles.spray.Flocks`.

    Parameters
    ----------
    ends : device array of shape (n,), int64
        Drops of each parcel and those before it; behind the last parcel those of all.
    ids : device array of shape (n,), uint64
    table : device array of shape (n, 9), float64
        Place, velocity, and the columns from SPREAD on.
    count_out : device array of shape (1,), int32
        0 before.
    drops_out : device array of shape (room, 7), float64
        In any order: the picture is a sum of whole numbers.
    """
    drop = cuda.grid(1)
    if drop >= ends[-1]:
        return
    low, high = 0, ends.shape[0] - 1
    while low < high:
        middle = (low + high) // 2
        if ends[middle] > drop:
            high = middle
        else:
            low = middle + 1
    within = drop - (ends[low - 1] if low > 0 else 0)
    words = subkey(ids[low], within + FIRST_WORD)
    a, b, c = uniform_triple(words)
    d, e, f = uniform_triple(subkey(words, 1))
    vx, vy, vz = table[low, 3], table[low, 4], table[low, 5]
    uneven = UNEVEN * math.sqrt(vx * vx + vy * vy + vz * vz)
    spread, radius = table[low, SPREAD], math.sqrt(-2 * math.log(c))
    z = table[low, 2] + spread * radius * math.cos(2 * math.pi * d)
    if z <= table[low, ROAD]:
        return
    place = cuda.atomic.add(count_out, 0, 1)
    drops_out[place, 2], drops_out[place, 6] = z, table[low, DIAMETER]
    drops_out[place, 3] = vx + uneven * radius * math.sin(2 * math.pi * d)
    radius = spread * math.sqrt(-2 * math.log(a))
    drops_out[place, 0] = table[low, 0] + radius * math.cos(2 * math.pi * b)
    drops_out[place, 1] = table[low, 1] + radius * math.sin(2 * math.pi * b)
    radius = uneven * math.sqrt(-2 * math.log(e))
    drops_out[place, 4] = vy + radius * math.cos(2 * math.pi * f)
    drops_out[place, 5] = vz + radius * math.sin(2 * math.pi * f)


class Spray:
    """The spray of one frame after another.

    Parameters
    ----------
    stream : numba.cuda.stream
        That it is sent on.

    Attributes
    ----------
    room : tuple of int
        Clouds and parcels that there is room for.
    version : int
        Of the lists, see `cuda.graph.new_version`.
    """

    def __init__(self, stream=0):
        self._stream, self.room = stream, (0, 0)
        self._drops = cuda.device_array((MOST_DRAWN, 7), np.float64)
        self._make_room(ROOM, ROOM)

    def _make_room(self, clouds, parcels):
        self.room = max(clouds, self.room[0]), max(parcels, self.room[1])
        clouds, parcels = self.room
        self._now = FrameUniforms(self._stream, {
            "count": ((1,), np.int32), "many": ((1,), np.int32),
            "clouds": ((clouds, 5), np.float32), "ends": ((parcels,), np.int64),
            "id": ((parcels,), np.uint64), "table": ((parcels, 9), np.float64),
        })  # fmt: skip
        self.version = new_version()

    def send(self, flocks, puffs, camera):
        """Send what `flocks_seen` returns; the device must draw nothing meanwhile."""
        clouds = cloud_table(puffs, camera)
        there = [] if flocks is None else np.flatnonzero(flocks.count)
        if len(clouds) > self.room[0] or len(there) > self.room[1]:
            self._make_room(2 * len(clouds), 2 * len(there))
        host, total = self._now.host, 0
        host["many"][0], host["clouds"][: len(clouds)] = len(clouds), clouds
        if len(there):
            *parts, ids, count = (part[there] for part in flocks)
            ends = np.cumsum(count)
            total = int(ends[-1])
            host["ends"][:] = total  # of those behind the last parcel, which have no drops
            host["ends"][: len(there)], host["id"][: len(there)] = ends, ids
            host["table"][: len(there)] = np.column_stack(parts)
        self._now.send()
        if total:
            now = self._now
            scatter[-(-total // THREADS), THREADS, self._stream](
                now["ends"], now["id"], now["table"], now["count"], self._drops
            )

    def draw(self, view, scene, picture, stream):
        """Queue the drawing of drops into the streaks' picture."""
        draw_list[BLOCKS, GROUPS, stream](self._now["count"], self._drops, view, scene, picture)

    def lay(self, lens, depth, alpha_out, stream):
        """Queue the clouds before the streaks' picture."""
        height, width = alpha_out.shape
        blocks = -(-width // BLOCK[0]), -(-height // BLOCK[1])
        now = self._now
        lay_clouds[blocks, BLOCK, stream](now["many"], now["clouds"], lens, depth, alpha_out)
