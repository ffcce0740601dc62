"""Twin of `splatting.merged`: actors are sent once, in frames of their own, and posed on a device.

A thread takes a splat: its place, covariance and normal turn with the actor, and its harmonics are
mixed within each degree. The static set and all addresses stay as they are.
"""

import math

import numpy as np

from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.splatting.project import FAINT
from rainsim.scene.harmonics import BANDS, mixings
from rainsim.splatting.prepared import GEOMETRY, LANES, NOBODY, OPACITY

THREADS = 8 if SIMULATED else 128
POSE = 12  # numbers of a pose: rotation, row by row, and place
MOST = np.float32(6e4)  # that a half holds


@cuda_kernel
def pose_splats(
    owner, poses, mixing, boxes, geometry, sh, groups, box_out, span_out, geometry_out, sh_out
):
    """Put splats where their actors are; chunks of none are not drawn.

    owner : int32 device array (chunks,). Actor of each chunk; -1 for none.
    mixing : float32 device array (actors, k, k). Takes the k harmonics of a
        channel to those after the turn.
    boxes : float32 device array (chunks, 6). Middle and half sides of each
        chunk's box in its actor's frame.
    groups : int. Of eight halves, see `project.splat_color`.
    box_out, span_out, geometry_out, sh_out. Of a `DeviceSplats`, whose first
        chunks are written.
    """
    place = cuda.grid(1)
    chunk, lane = place // LANES, place % LANES
    if chunk >= owner.shape[0]:
        return
    actor, g = owner[chunk], geometry[chunk]
    if lane == 0:
        span_out[chunk, 0] = np.float32(0) if actor >= 0 else np.float32(math.inf)
    if actor >= 0 and lane < 3:  # an axis each, around the box as it has turned
        middle, half = poses[actor, 9 + lane], np.float32(0)
        for k in range(3):
            middle += poses[actor, 3 * lane + k] * boxes[chunk, k]
            half += abs(poses[actor, 3 * lane + k]) * boxes[chunk, 3 + k]
        box_out[chunk, lane], box_out[chunk, 3 + lane] = middle - half, middle + half
    if actor < 0 or g[OPACITY, lane] <= FAINT:
        return
    a, b, c, x = poses[actor, 0], poses[actor, 1], poses[actor, 2], poses[actor, 9]
    d, e, f, y = poses[actor, 3], poses[actor, 4], poses[actor, 5], poses[actor, 10]
    h, i, j, z = poses[actor, 6], poses[actor, 7], poses[actor, 8], poses[actor, 11]
    xx, xy, xz, yy, yz, zz = g[3, lane], g[4, lane], g[5, lane], g[6, lane], g[7, lane], g[8, lane]
    # The rotation times the covariance, then times the rotation's transpose.
    p, q, r = a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz
    s, t, u = d * xx + e * xy + f * xz, d * xy + e * yy + f * yz, d * xz + e * yz + f * zz
    v, w, o = h * xx + i * xy + j * xz, h * xy + i * yy + j * yz, h * xz + i * yz + j * zz
    px, py, pz = g[0, lane], g[1, lane], g[2, lane]
    nx, ny, nz = g[9, lane], g[10, lane], g[11, lane]
    at = chunk * (GEOMETRY * LANES) + lane
    geometry_out[at] = a * px + b * py + c * pz + x
    geometry_out[at + LANES] = d * px + e * py + f * pz + y
    geometry_out[at + 2 * LANES] = h * px + i * py + j * pz + z
    geometry_out[at + 3 * LANES] = p * a + q * b + r * c
    geometry_out[at + 4 * LANES] = p * d + q * e + r * f
    geometry_out[at + 5 * LANES] = p * h + q * i + r * j
    geometry_out[at + 6 * LANES] = s * d + t * e + u * f
    geometry_out[at + 7 * LANES] = s * h + t * i + u * j
    geometry_out[at + 8 * LANES] = v * h + w * i + o * j
    geometry_out[at + 9 * LANES] = a * nx + b * ny + c * nz
    geometry_out[at + 10 * LANES] = d * nx + e * ny + f * nz
    geometry_out[at + 11 * LANES] = h * nx + i * ny + j * nz
    geometry_out[at + OPACITY * LANES] = g[OPACITY, lane]
    count = mixing.shape[1]
    for k in range(count):
        for channel in range(3):
            value = np.float32(0)
            for m in range(count):
                value += mixing[actor, k, m] * sh[chunk, 3 * m + channel, lane]
            row = 3 * k + channel
            half = ((chunk * groups + row // 8) * LANES + lane) * 8 + row % 8
            sh_out[half] = max(-MOST, min(value, MOST))


class PosedActors:
    """The actors of a `DeviceSplats`, one moment after another.

    parts : sequence of PreparedSplats. Of each actor, in its frame; harmonics of
        the degree of `splats`.
    """

    def __init__(self, splats, parts, turning):
        self._splats, self._turning = splats, turning
        counts = [len(part.box) for part in parts]
        self._first = np.cumsum([0, *counts])
        used, room = int(self._first[-1]), splats.room
        self._owner = np.repeat(np.arange(len(parts), dtype=np.int32), counts)
        low, high = np.split(np.concatenate([part.box for part in parts]).astype(np.float64), 2, 1)
        with np.errstate(invalid="ignore"):  # a chunk of holes has no box, which stays so
            boxes = np.hstack([0.5 * (low + high), 0.5 * (high - low)])
        self._orders = [part.order for part in parts]
        self._degrees = parts[0].degree + 1
        geometry = np.concatenate([clean(part.geometry) for part in parts])
        self._data = tuple(cuda.to_device(np.ascontiguousarray(a, np.float32)) for a in (
            boxes, geometry.reshape(used, GEOMETRY, LANES),
            np.concatenate([part.harmonics() for part in parts]),
        ))  # fmt: skip
        self._used, self._room = used, room

    def put(self, poses):
        """Queue the putting of actors at their poses, None of those that are away."""
        splats, used, count = self._splats, self._used, self._degrees**2
        shown = np.array([pose is not None for pose in poses] or [False] * len(self._turning))
        rows = np.zeros((len(shown), POSE), np.float32)
        mixing = np.zeros((len(shown), count, count), np.float32)
        for k, pose in enumerate(poses):
            if pose is not None:
                rows[k] = (*pose.rotation.ravel(), *pose.position)
                turn = pose.rotation if self._turning[k] else np.eye(3)
                for band, each in zip(BANDS, mixings(turn, self._degrees), strict=False):
                    mixing[k, band, band] = each
        there = np.where(shown[self._owner], self._owner, np.int32(-1))
        pose_splats[-(-used * LANES // THREADS), THREADS](
            *map(cuda.to_device, (there, rows, mixing)), *self._data, splats.groups, splats.box,
            splats.span, splats.geometry, splats.sh,
        )  # fmt: skip

    def order(self, static, shown, first):
        """Return the numbers of all places' splats, those of the static set behind the actors'.

        shown : sequence of bool. Which actors are there: only they have numbers.
        """
        found = np.full(self._room * LANES, NOBODY, np.int32)
        for begin, order, seen in zip(self._first, self._orders, shown, strict=False):
            if seen:
                found[begin * LANES : begin * LANES + len(order)] = order + first
                first += len(order)
        return np.concatenate([found, static])


def clean(geometry):
    """Return the geometry with a finite opacity everywhere and nothing that is not a number."""
    rows = geometry.reshape(len(geometry), -1, LANES)
    bad = ~np.isfinite(rows).all(axis=1)
    if bad.any():
        rows = rows.copy()
        rows[bad[:, None].repeat(rows.shape[1], axis=1)] = 0
        rows[:, OPACITY][bad] = FAINT
    return rows
