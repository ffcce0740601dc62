"""Data for rasterizing a scene that no camera changes: prepared once, used for all pictures.

Splats lie in Morton order, near in space and near in memory, in chunks of 256. Within a chunk each
quantity has a row of its own, so that the projection runs on 16 splats at a time. Each chunk knows
the box its splats lie in: most of what is out of the picture is left out chunk by chunk.
"""

from dataclasses import dataclass, replace

import numpy as np

from rainsim.constants import ONE, TWO, ZERO
from rainsim.jit import cpu_kernel, prange
from rainsim.numerics.blocks import in_blocks, stable_order

LANES = 256  # splats of a chunk
SIGMAS = np.float32(3.33)  # sqrt(2 ln 255): an opaque splat ends here

# Runs of a chunk's geometry.
OPACITY, GEOMETRY = 12, 13  # after position (3), covariance (6) and normal (3)
# Harmonics of degree 0 and 1 are kept in float32, those above as 16-bit integers with a factor per
# run: a fifth of all memory less, and 110 dB from float32 on a capture.
COARSE = 4  # coefficients of a channel up to degree 1
LARGEST = np.float32(32767)
NOBODY = -1  # in `order`: a place that no splat fills


@dataclass(frozen=True)
class PreparedSplats:
    """A scene's splats in the order and layout that projection wants.

    geometry : float32 array (chunks, 13 * 256). In each chunk 13 runs of 256:
        position x, y, z [capture units]; covariance xx, xy, xz, yy, yz, zz; the
        thinnest axis x, y, z, sign free; log2 of the opacity (-inf for the places
        left over).
    sh : float32 array (chunks, 3 k * 256). In each chunk 3 k runs of 256, k = 1
        or 4: the three channels of a spherical harmonic one after the other, up
        to degree 1.
    fine : int16 array (chunks, 3 m * 256). The harmonics above, m = 0, 5 or 12,
        in the same way; to be multiplied by `step`.
    step : float32 array (chunks, 3 m). A factor per run of `fine`.
    box : float32 array (chunks, 6) [capture units]. Lowest and highest x, y, z
        that any splat of the chunk reaches.
    order : int32 array (n,). Index of each prepared splat in the scene it came
        from.
    leading : int or None. Number of the first chunks, which hold all splats but
        those that were to come last; None: all chunks.
    compensate : bool. Whether all pictures weaken splats that the low-pass
        widens.
    span : float32 array (chunks, 2) [capture units], or None. With levels of
        detail: the chunk is drawn where what the picture resolves is at least the
        first number and less than the second. None: all chunks are drawn.
    reach : float32 array (chunks, 6) [capture units], or None. Lowest and highest
        x, y, z of the centres of the group whose level the chunk is.
    written : int64 array (chunks,), or None. Of a room for chunks: how often each
        place was written. None: all stay as they are.
    """

    geometry: np.ndarray
    sh: np.ndarray
    fine: np.ndarray
    step: np.ndarray
    box: np.ndarray
    order: np.ndarray
    leading: int | None = None
    compensate: bool = False
    span: np.ndarray | None = None
    reach: np.ndarray | None = None
    written: np.ndarray | None = None

    def __len__(self):
        return len(self.order)

    @property
    def degree(self):
        """Highest degree of the spherical harmonics."""
        return round(((self.sh.shape[1] + self.fine.shape[1]) / (3 * LANES)) ** 0.5) - 1

    @property
    def is_leading(self):
        """Which splats lie in the leading chunks, ndarray of shape (n,), bool."""
        return (
            np.arange(len(self)) < (len(self.box) if self.leading is None else self.leading) * LANES
        )

    def harmonics(self, first=0, last=None):
        """Return all harmonics of a range of chunks, (chunks, 3 (degree + 1)^2, 256), float32."""
        sh, fine = (part.reshape(len(part), part.shape[1] // LANES, LANES)
                    for part in (self.sh[first:last], self.fine[first:last]))  # fmt: skip
        return np.concatenate([sh, fine * self.step[first:last, :, None]], axis=1)

    @property
    def position(self):
        """Positions in the prepared order, a copy of shape (n, 3), float32."""
        rows = self.geometry[:, : 3 * LANES].reshape(-1, 3, LANES).transpose(0, 2, 1)
        return rows.reshape(-1, 3)[: len(self)]


def prepare(splats, last=None):
    """Return the `PreparedSplats` of `splats`; quaternions may have any length.

    Splats with a number that is none, or with a quaternion of zero, are never drawn. Splats that
    the mask `last` (n,) selects lie in the last chunks, which a picture can leave out; the faintest
    of them fill the chunk in which the others end.
    """
    order, leading = morton_order(splats.position), None
    if last is not None and last.any():
        order, leading = _put_last(splats, order, last)
    chunks = -(-len(order) // LANES)
    geometry = np.empty((chunks, GEOMETRY, LANES), np.float32)
    _lay_out(splats.position, splats.scale, splats.rotation, splats.opacity, order, geometry)
    values = splats.sh.reshape(len(order), -1) if len(order) else np.zeros((0, 3), np.float32)
    bad = np.zeros((chunks, LANES), np.bool_)
    prepared = _finish(geometry, values, order, order, bad)
    geometry[:, OPACITY][bad] = -np.inf
    return replace(prepared, leading=leading)


def _put_last(splats, order, last):
    """Return the order with the splats of a mask behind the others, and the chunks before them."""
    first, behind = order[~last[order]], order[last[order]]
    leading = -(-len(first) // LANES)
    solid = splats.opacity[behind] * np.sort(splats.scale[behind], axis=1)[:, 1:].prod(axis=1)
    filling = np.zeros(len(behind), np.bool_)
    filling[np.argsort(solid, kind="stable")[: leading * LANES - len(first)]] = True
    return np.concatenate([first, behind[filling], behind[~filling]]), leading


def turn(prepared, normal, share):
    """Write other normals over those of prepared splats, levels of detail included, in place.

    A splat's own normal is its thinnest axis, which tells little of a thick one.

    prepared : PreparedSplats. Its `order` says which splat a place shows.
    normal : float32 array (n, 3). Unit, in the capture frame, of the scene's
        splats; either way along them.
    share : float32 array (n,). 0 keeps a splat's own normal, 1 takes the other.
    """
    geometry = prepared.geometry.reshape(-1, GEOMETRY, LANES)
    _turn(geometry, prepared.order, normal, share)


def recolored(prepared, splats):
    """Return the prepared splats with the harmonics of `splats`, the same ones in other colours."""
    names = "sh", "fine", "step"
    other = replace(prepared, **{name: np.empty_like(getattr(prepared, name)) for name in names})
    recolor(other, splats)
    return other


def recolor(prepared, splats):
    """Write the harmonics of `splats` over those of the prepared ones, which are the same splats.

    What shares the arrays of `prepared` shows the other colours, too.
    """
    values, n = splats.sh.reshape(len(splats), -1), len(prepared.box)
    sh, fine = prepared.sh.reshape(n, -1, LANES), prepared.fine.reshape(n, -1, LANES)
    bad = np.empty((n, LANES), np.bool_)
    _pack(values, prepared.order, sh, fine, prepared.step, bad)


def select(prepared, keep):
    """Return those of the prepared splats that the mask `keep` (n,), in their order, selects."""
    which = np.flatnonzero(keep).astype(np.int32)
    rows = by_splat(prepared.geometry.reshape(-1, GEOMETRY, LANES))[which]
    found = laid_out(rows, by_splat(prepared.harmonics()), which, prepared.order[which])
    return replace(found, compensate=prepared.compensate)


def laid_out(rows, values, which, order):
    """Return the `PreparedSplats` of n splats that have the order they are to be kept in.

    rows : float32 array (n, 13). Geometry of each splat, in the order of
        `PreparedSplats.geometry`.
    values : float32 array (m, 3 k). Harmonics, k coefficients of three channels,
        of these splats among others.
    which : int32 array (n,). Row of `values` that belongs to each splat.
    order : int32 array (n,). Index of each splat in the scene it came from.
    """
    chunks = -(-len(rows) // LANES)
    flat = np.zeros((chunks * LANES, GEOMETRY), np.float32)
    flat[: len(rows)] = rows
    flat[len(rows) :, OPACITY] = -np.inf  # the places left over hold nothing
    geometry = np.ascontiguousarray(flat.reshape(chunks, LANES, GEOMETRY).transpose(0, 2, 1))
    bad = np.empty((chunks, LANES), np.bool_)  # none: they have no opacity already
    return _finish(geometry, values, which, order, bad)


def by_splat(rows):
    """Return an array of chunks (chunks, m, 256) as one row for each splat, (256 chunks, m)."""
    return np.ascontiguousarray(rows.transpose(0, 2, 1)).reshape(-1, rows.shape[1])


def _finish(geometry, values, which, order, bad_out):
    """Return the PreparedSplats of a geometry and the harmonics values[which] (n, 3 k)."""
    n, coefficients = len(geometry), values.shape[1]
    coarse = min(coefficients, 3 * COARSE)
    sh = np.empty((n, coarse, LANES), np.float32)
    fine = np.empty((n, coefficients - coarse, LANES), np.int16)
    step = np.empty((n, coefficients - coarse), np.float32)
    _pack(values, which, sh, fine, step, bad_out)
    box = np.empty((n, 6), np.float32)
    boxes(geometry, len(which), box)
    runs = (a.reshape(n, a.shape[1] * LANES) for a in (geometry, sh, fine))
    return PreparedSplats(*runs, step, box, order)


def morton_order(position):
    """Return the order of `position` (n, 3) along a Morton curve, int32."""
    if len(position) == 0:
        return np.zeros(0, np.int32)
    low, high = np.percentile(position[:: max(1, len(position) // 100_000)], (0.5, 99.5), axis=0)
    width = np.maximum(high - low, np.finfo(np.float32).tiny)
    code = np.empty(len(position), np.uint32)

    def work(part):
        cell = (position[part] - low) / width * 1023
        cell = np.clip(np.nan_to_num(cell), 0, 1023).astype(np.uint32)
        code[part] = _spread_bits(cell[:, 0])
        code[part] |= _spread_bits(cell[:, 1]) << np.uint32(1)
        code[part] |= _spread_bits(cell[:, 2]) << np.uint32(2)

    in_blocks(work, len(position))
    return stable_order(code).astype(np.int32)


def _spread_bits(x):
    """Put two zero bits between the ten bits of each x."""
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        x = (x | x << np.uint32(shift)) & np.uint32(mask)
    return x


@cpu_kernel
def _lay_out(position, scale, rotation, opacity, order, geometry_out):
    """Write the geometry rows of each chunk."""
    for chunk in prange(len(geometry_out)):
        g = geometry_out[chunk]
        g[:] = 0
        g[OPACITY] = -np.inf
        for i in range(min(LANES, len(order) - chunk * LANES)):
            o = order[chunk * LANES + i]
            w, x, y, z = rotation[o, 0], rotation[o, 1], rotation[o, 2], rotation[o, 3]
            # A turn of no length makes what follows no number, and the splat is not drawn.
            unit = ONE / np.sqrt(w * w + x * x + y * y + z * z)
            w, x, y, z = w * unit, x * unit, y * unit, z * unit
            r00, r01 = ONE - TWO * (y * y + z * z), TWO * (x * y - w * z)
            r10, r11 = TWO * (x * y + w * z), ONE - TWO * (x * x + z * z)
            r20, r21 = TWO * (x * z - w * y), TWO * (y * z + w * x)
            r02, r12, r22 = (
                TWO * (x * z + w * y),
                TWO * (y * z - w * x),
                ONE - TWO * (x * x + y * y),
            )
            s0, s1, s2 = scale[o, 0], scale[o, 1], scale[o, 2]
            a, b, c = s0 * s0, s1 * s1, s2 * s2
            g[0, i], g[1, i], g[2, i] = position[o, 0], position[o, 1], position[o, 2]
            g[3, i] = a * r00 * r00 + b * r01 * r01 + c * r02 * r02
            g[4, i] = a * r00 * r10 + b * r01 * r11 + c * r02 * r12
            g[5, i] = a * r00 * r20 + b * r01 * r21 + c * r02 * r22
            g[6, i] = a * r10 * r10 + b * r11 * r11 + c * r12 * r12
            g[7, i] = a * r10 * r20 + b * r11 * r21 + c * r12 * r22
            g[8, i] = a * r20 * r20 + b * r21 * r21 + c * r22 * r22
            if s0 <= s1 and s0 <= s2:
                g[9, i], g[10, i], g[11, i] = r00, r10, r20
            elif s1 <= s2:
                g[9, i], g[10, i], g[11, i] = r01, r11, r21
            else:
                g[9, i], g[10, i], g[11, i] = r02, r12, r22
            g[OPACITY, i] = np.log2(opacity[o])


@cpu_kernel
def _turn(geometry_out, order, normal, share):
    """Blend the normals of each chunk with those of its splats."""
    for chunk in prange(len(geometry_out)):
        g = geometry_out[chunk]
        for i in range(min(LANES, len(order) - chunk * LANES)):
            o = order[chunk * LANES + i]
            if o < 0:
                continue
            x, y, z = g[9, i], g[10, i], g[11, i]
            a = (
                share[o]
                if x * normal[o, 0] + y * normal[o, 1] + z * normal[o, 2] >= 0
                else -share[o]
            )
            b = ONE - share[o]
            x, y, z = b * x + a * normal[o, 0], b * y + a * normal[o, 1], b * z + a * normal[o, 2]
            square = x * x + y * y + z * z
            if square > np.float32(1e-6):
                unit = ONE / np.sqrt(square)
                g[9, i], g[10, i], g[11, i] = x * unit, y * unit, z * unit


@cpu_kernel
def boxes(geometry, n, box_out):
    """Write each chunk's bounding box, out to SIGMAS deviations; only `n` splats are no padding."""
    for chunk in prange(len(box_out)):
        g, box = geometry[chunk], box_out[chunk]
        box[:3] = np.inf
        box[3:] = -np.inf
        for i in range(min(LANES, n - chunk * LANES)):
            for k in range(3):
                variance = g[3, i] if k == 0 else (g[6, i] if k == 1 else g[8, i])
                reach = SIGMAS * np.sqrt(variance)
                # Not a number compares false: such a splat does not move the box.
                if g[k, i] - reach < box[k]:
                    box[k] = g[k, i] - reach
                if g[k, i] + reach > box[3 + k]:
                    box[3 + k] = g[k, i] + reach


@cpu_kernel
def _pack(values, order, rows_out, fine_out, step_out, bad_out):
    """Write values[order] (n, m) as rows (chunks, a, 256) and the other m - a as `fine` and `step`.

    The places left over are zero. What is not finite counts as zero; `bad` (chunks, 256) tells
    which splats have such numbers.
    """
    coarse = rows_out.shape[1]
    for chunk in prange(len(rows_out)):
        rows, fine, step = rows_out[chunk], fine_out[chunk], step_out[chunk]
        count = min(LANES, len(order) - chunk * LANES)
        rows[:, count:] = 0
        fine[:, count:] = 0
        step[:] = 0
        for i in range(count):
            o = order[chunk * LANES + i]
            bad = False
            for k in range(coarse):
                finite = abs(values[o, k]) < np.inf
                rows[k, i] = values[o, k] if finite else ZERO
                bad |= not finite
            for k in range(len(step)):
                size = abs(values[o, coarse + k])
                finite = size < np.inf
                step[k] = max(step[k], size / LARGEST if finite else ZERO)
                bad |= not finite
            bad_out[chunk, i] = bad
        for i in range(count):
            o = order[chunk * LANES + i]
            for k in range(len(step)):
                value = values[o, coarse + k]
                usable = abs(value) < np.inf and step[k] > 0
                fine[k, i] = np.int16(np.rint(value / step[k])) if usable else np.int16(0)
