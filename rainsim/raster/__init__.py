"""CPU tile splatting: splats and a camera in, colour, alpha, depth and normals out.

The pipeline of Kerbl et al. 2023 (ACM TOG 42(4)), section 6: project every splat to an ellipse,
list the splats of each tile of 16 x 16 pixels, sort each list by depth, blend front to back. Ours
differs in what suits a CPU: splats lie in Morton order in memory, each tile sorts its own short
list while it is in cache, and a row of 16 pixels is blended at once by vector instructions.

Rules of the picture (those of gsplat's classic mode): 0.3 px^2 is added to the projected
covariance, contributions under 1/255 are skipped, opacity is capped at 0.999, a splat's depth order
is that of its centre. A row of a tile stops when each of its pixels lets less than 1e-4 through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rainsim.harmonics import sh_color
from rainsim.jit import cpu_kernel, device_function, prange, serial_kernel
from rainsim.prepared import PreparedSplats, prepare, select

__all__ = ["Layers", "PreparedSplats", "Rasterizer", "prepare", "rasterize", "select"]

TILE = 16  # px; also the number of lanes that are blended at once
CHUNK = 2048  # splats that one loop iteration projects
BLOCKS = 32  # parts of the scene with tile counts of their own; fixed, whatever the threads
RECORD = 16  # float32 numbers of a projected splat: one cache line
CHANNELS = 9  # transmittance, colour, depth, normal, distance of the splat's plane

LOW_PASS = np.float32(0.3)  # px^2, added to the projected covariance (Kerbl et al. 2023)
MIN_ALPHA_LOG2 = np.float32(np.log2(1 / 255))  # below this an 8-bit image does not change
MAX_ALPHA = np.float32(0.999)  # gsplat 1.5; the original code has 0.99
TRANSMITTANCE_STOP = np.float32(1e-4)  # what is behind cannot change an 8-bit image
MIN_COVERAGE = np.float32(0.02)  # alpha below which a pixel has no depth
EDGE_ON = np.float32(0.02)  # cosine at which a blended plane no longer tells the depth
PLANE_LIMIT = np.float32(0.2)  # share of the depth by which the plane may correct it
NO_PLANE = np.array([0, 0, 0, -1], np.float32)  # cuts nothing away
FRUSTUM_MARGIN = 0.15  # of the picture's size: where the linearised projection is clamped

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)
TWO = np.float32(2)
TWO_LN2 = np.float32(2 * np.log(2))
HALF_LOG2E = np.float32(0.5 / np.log(2))
EIGHTH = np.float32(0.125)

# 2^x on [-1.02, 0], Chebyshev interpolation of degree 5; the eighth power of it is within 1e-6.
E0, E1, E2, E3, E4, E5 = (
    np.float32(c)
    for c in (0.999999937, 0.693142739, 0.240175324, 0.0552866627, 0.00919464691, 0.000940499363)
)


@dataclass(frozen=True)
class Layers:
    """A splatted picture.

    Attributes
    ----------
    color : ndarray of shape (height, width, 3), float32
        Display-referred, over black (multiplied by alpha).
    alpha : ndarray of shape (height, width), float32
    depth : ndarray of shape (height, width), float32 [world units]
        Mean depth along the camera's z axis of the splats' centres, weighted as the colour is;
        infinite where alpha is below 0.02.
    plane_depth : ndarray of shape (height, width), float32 [world units]
        Depth at which the pixel's ray meets the blended plane of the splats (PGSR, Chen et al.
        2024, eq. 4): exact on flat surfaces. Equals `depth` where the plane is seen edge-on.
    normal : ndarray of shape (height, width, 3), float32
        Unit, camera frame, towards the camera; zero where there is no depth.
    """

    color: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    plane_depth: np.ndarray
    normal: np.ndarray


class Rasterizer:
    """Draws prepared splats; keeps its working memory from one picture to the next."""

    def __init__(self, prepared):
        self.prepared = prepared
        n = len(prepared.position)
        self._chunks = (n + CHUNK - 1) // CHUNK
        self._record = np.empty((self._chunks * CHUNK, RECORD), np.float32)
        self._box = np.empty((self._chunks * CHUNK, 4), np.int16)
        self._visible = np.zeros(self._chunks, np.int64)
        self._entry = np.empty(0, np.uint64)

    def draw(self, camera, near, plane=None):
        """Return the `Layers` that `camera` sees; the same bytes for any number of threads.

        Parameters
        ----------
        camera : Camera
            Its matrix may also be a rotation with a reflection: a mirrored view.
        near : float [world units]
            Splats whose centres are nearer are left out.
        plane : array_like of shape (4,), optional
            (a, b, c, d): splats whose centres have a x + b y + c z < d are left out.
        """
        height, width = camera.height, camera.width
        across, down = -(-width // TILE), -(-height // TILE)
        count = np.zeros((BLOCKS, across * down), np.int64)
        view = camera.camera_from_world.astype(np.float32)
        eye = camera.position.astype(np.float32)
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
        if camera.orthographic:
            eye = camera.forward.astype(np.float32)
        p = self.prepared
        plane = NO_PLANE if plane is None else np.asarray(plane, np.float32)
        _project(
            p.position, p.covariance, p.normal, p.opacity_log2, p.sh, view, eye, lens, plane,
            width, height, np.float32(near), camera.orthographic,
            self._record, self._box, self._visible, count,
        )  # fmt: skip
        start = _tile_starts(count)
        if start[-1] > len(self._entry):
            self._entry = np.empty(int(start[-1] * 1.25), np.uint64)
        _list_tiles(self._record, self._box, self._visible, across, count, self._entry)
        layers = Layers(
            np.empty((height, width, 3), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width, 3), np.float32),
        )
        _blend(
            self._record, self._entry, start, lens, camera.orthographic, layers.color,
            layers.alpha, layers.depth, layers.plane_depth, layers.normal,
        )  # fmt: skip
        return layers


def rasterize(prepared, camera, near=0.01):
    """Return the `Layers` that `camera` sees of `prepared` splats; see `Rasterizer.draw`."""
    return Rasterizer(prepared).draw(camera, near)


@cpu_kernel
def _project(
    position, covariance, normal, opacity_log2, sh, view, eye, lens, plane, width, height, near,
    orthographic, record_out, box_out, visible_out, count_out,
):  # fmt: skip
    """Project the splats of each chunk to ellipses and count those that each tile meets.

    Visible splats of a chunk are written one after the other from the chunk's first place on.
    Record: u, v, conic (3, of log2), log2 opacity, colour (3), depth, normal (3), plane distance,
    first and last row. Box: first and last tile across, first and last down.
    """
    chunks = len(visible_out)
    across = (width + TILE - 1) // TILE
    bands = 1
    if sh.shape[1] >= 48:
        bands = 4
    elif sh.shape[1] >= 27:
        bands = 3
    elif sh.shape[1] >= 12:
        bands = 2
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    margin = np.float32(FRUSTUM_MARGIN)
    w, h = np.float32(width), np.float32(height)
    x_low, x_high = (-cx - margin * w) / fx, (w - cx + margin * w) / fx
    y_low, y_high = (-cy - margin * h) / fy, (h - cy + margin * h) / fy
    v00, v01, v02, v03 = view[0, 0], view[0, 1], view[0, 2], view[0, 3]
    v10, v11, v12, v13 = view[1, 0], view[1, 1], view[1, 2], view[1, 3]
    v20, v21, v22, v23 = view[2, 0], view[2, 1], view[2, 2], view[2, 3]
    for block in prange(BLOCKS):
        for chunk in range(block * chunks // BLOCKS, (block + 1) * chunks // BLOCKS):
            o = chunk * CHUNK
            for s in range(chunk * CHUNK, min(len(position), (chunk + 1) * CHUNK)):
                px, py, pz = position[s, 0], position[s, 1], position[s, 2]
                z = v20 * px + v21 * py + v22 * pz + v23
                level = opacity_log2[s] - MIN_ALPHA_LOG2
                if not (z >= near and level > ZERO):  # also drops NaN
                    continue
                if plane[0] * px + plane[1] * py + plane[2] * pz < plane[3]:
                    continue
                x = v00 * px + v01 * py + v02 * pz + v03
                y = v10 * px + v11 * py + v12 * pz + v13
                a, b = fx, fy
                tx, ty, lx, ly = x, y, ZERO, ZERO
                if not orthographic:
                    iz = ONE / z
                    tx, ty = x * iz, y * iz
                    lx, ly = min(max(tx, x_low), x_high), min(max(ty, y_low), y_high)
                    a, b = fx * iz, fy * iz
                u, v = fx * tx + cx, fy * ty + cy
                # Rows of J V: the linearised projection (Zwicker et al. 2001).
                j00, j01, j02 = a * (v00 - lx * v20), a * (v01 - lx * v21), a * (v02 - lx * v22)
                j10, j11, j12 = b * (v10 - ly * v20), b * (v11 - ly * v21), b * (v12 - ly * v22)
                c0, c1, c2 = covariance[s, 0], covariance[s, 1], covariance[s, 2]
                c3, c4, c5 = covariance[s, 3], covariance[s, 4], covariance[s, 5]
                t0 = c0 * j00 + c1 * j01 + c2 * j02
                t1 = c1 * j00 + c3 * j01 + c4 * j02
                t2 = c2 * j00 + c4 * j01 + c5 * j02
                m00 = j00 * t0 + j01 * t1 + j02 * t2 + LOW_PASS
                m01 = j10 * t0 + j11 * t1 + j12 * t2
                m11 = (
                    j10 * (c0 * j10 + c1 * j11 + c2 * j12)
                    + j11 * (c1 * j10 + c3 * j11 + c4 * j12)
                    + j12 * (c2 * j10 + c4 * j11 + c5 * j12)
                    + LOW_PASS
                )
                reach = TWO_LN2 * level  # -2 ln(1/255 / opacity)
                ex, ey = np.sqrt(reach * m00), np.sqrt(reach * m11)
                # Pixels whose centres lie in the ellipse's box.
                left = np.ceil(max(u - ex - HALF, ZERO))
                right = np.floor(min(u + ex - HALF, w - ONE))
                first = np.ceil(max(v - ey - HALF, ZERO))
                last = np.floor(min(v + ey - HALF, h - ONE))
                determinant = m00 * m11 - m01 * m01
                if not (right >= left and last >= first and determinant > ZERO):
                    continue
                scale = HALF_LOG2E / determinant
                record_out[o, 0], record_out[o, 1] = u, v
                record_out[o, 2] = m11 * scale
                record_out[o, 3] = -TWO * m01 * scale
                record_out[o, 4] = m00 * scale
                record_out[o, 5] = opacity_log2[s]
                dx, dy, dz = eye[0], eye[1], eye[2]  # the view direction if orthographic
                if not orthographic:
                    dx, dy, dz = px - eye[0], py - eye[1], pz - eye[2]
                    length = ONE / np.sqrt(dx * dx + dy * dy + dz * dz)
                    dx, dy, dz = dx * length, dy * length, dz * length
                for c in range(3):
                    record_out[o, 6 + c] = sh_color(sh, s, c, bands, dx, dy, dz)
                record_out[o, 9] = z
                nx, ny, nz = normal[s, 0], normal[s, 1], normal[s, 2]
                n0 = v00 * nx + v01 * ny + v02 * nz
                n1 = v10 * nx + v11 * ny + v12 * nz
                n2 = v20 * nx + v21 * ny + v22 * nz
                away = n2 if orthographic else n0 * x + n1 * y + n2 * z
                if away > ZERO:
                    n0, n1, n2 = -n0, -n1, -n2
                record_out[o, 10], record_out[o, 11], record_out[o, 12] = n0, n1, n2
                record_out[o, 13] = n0 * x + n1 * y + n2 * z
                record_out[o, 14], record_out[o, 15] = first, last
                left_tile, right_tile = np.int64(left) // TILE, np.int64(right) // TILE
                top_tile, bottom_tile = np.int64(first) // TILE, np.int64(last) // TILE
                box_out[o, 0], box_out[o, 1] = left_tile, right_tile
                box_out[o, 2], box_out[o, 3] = top_tile, bottom_tile
                for j in range(top_tile, bottom_tile + 1):
                    for i in range(left_tile, right_tile + 1):
                        count_out[block, j * across + i] += 1
                o += 1
            visible_out[chunk] = o - chunk * CHUNK


@serial_kernel
def _tile_starts(count):
    """Turn counts per block and tile into places; return the first place of each tile."""
    blocks, tiles = count.shape
    start = np.empty(tiles + 1, np.int64)
    place = 0
    for tile in range(tiles):
        start[tile] = place
        for block in range(blocks):
            n = count[block, tile]
            count[block, tile] = place
            place += n
    start[tiles] = place
    return start


@cpu_kernel
def _list_tiles(record, box, visible, across, place, entry_out):
    """Write (depth bits, record index) of each splat into the list of each tile that it meets.

    `place` (blocks, tiles) holds the next free place of each block's share; modified in place.
    """
    chunks = len(visible)
    bits = record.view(np.uint32)  # positive floats sort like their bits
    for block in prange(BLOCKS):
        for chunk in range(block * chunks // BLOCKS, (block + 1) * chunks // BLOCKS):
            for o in range(chunk * CHUNK, chunk * CHUNK + visible[chunk]):
                key = np.uint64(bits[o, 9]) << np.uint64(32) | np.uint64(o)
                for j in range(box[o, 2], box[o, 3] + 1):
                    for i in range(box[o, 0], box[o, 1] + 1):
                        tile = j * across + i
                        entry_out[place[block, tile]] = key
                        place[block, tile] += 1


@device_function
def _sort_keys(key, spare, histogram, n):
    """Sort key[:n]; radix sort on the bytes of the depth that differ, indices break ties."""
    if n < 48:
        for i in range(1, n):
            k = key[i]
            j = i - 1
            while j >= 0 and key[j] > k:
                key[j + 1] = key[j]
                j -= 1
            key[j + 1] = k
        return
    low, high = key[0], key[0]
    for i in range(n):
        low, high = min(low, key[i]), max(high, key[i])
    low = low >> np.uint64(32) << np.uint64(32)
    span = (high - low) >> np.uint64(32)
    bits = 0
    while span >> np.uint64(bits):
        bits += 1
    passes = (bits + 7) // 8
    passes += passes & 1  # an even number leaves the result in `key`
    if passes == 0:
        return
    digit_bits = (bits + passes - 1) // passes
    mask = np.uint64((1 << digit_bits) - 1)
    for turn in range(passes):
        shift = np.uint64(32 + digit_bits * turn)
        source, target = (key, spare) if turn % 2 == 0 else (spare, key)
        histogram[: 1 << digit_bits] = 0
        for i in range(n):
            histogram[((source[i] - low) >> shift) & mask] += 1
        place = 0
        for d in range(1 << digit_bits):
            number = histogram[d]
            histogram[d] = place
            place += number
        for i in range(n):
            d = ((source[i] - low) >> shift) & mask
            target[histogram[d]] = source[i]
            histogram[d] += 1


@device_function
def _blend_row(state, row, u, dy, x0, a, b, c, level, red, green, blue, z, nx, ny, nz, distance):
    """Blend one splat into the 16 pixels of `row`: state[row, channel * 16 + lane]."""
    flat = state[row]
    constant = level - c * dy * dy
    slope = b * dy
    for i in range(TILE):
        dx = x0 + np.float32(i) - u
        power = constant - dx * (a * dx + slope)  # log2 of alpha
        q = max(power, np.float32(-8.16)) * EIGHTH
        e = E0 + q * (E1 + q * (E2 + q * (E3 + q * (E4 + q * E5))))
        e *= e
        e *= e
        alpha = min(e * e, MAX_ALPHA)
        alpha = alpha if power >= MIN_ALPHA_LOG2 else ZERO
        weight = alpha * flat[i]
        flat[i] -= weight
        flat[TILE + i] += weight * red
        flat[2 * TILE + i] += weight * green
        flat[3 * TILE + i] += weight * blue
        flat[4 * TILE + i] += weight * z
        flat[5 * TILE + i] += weight * nx
        flat[6 * TILE + i] += weight * ny
        flat[7 * TILE + i] += weight * nz
        flat[8 * TILE + i] += weight * distance


@cpu_kernel
def _blend(
    record, entry, start, lens, orthographic,
    color_out, alpha_out, depth_out, plane_out, normal_out,
):  # fmt: skip
    """Sort each tile's list, blend it front to back and write the tile's pixels."""
    height, width = alpha_out.shape
    across = (width + TILE - 1) // TILE
    tiles = len(start) - 1
    longest = 0
    for tile in range(tiles):
        longest = max(longest, start[tile + 1] - start[tile])
    low_word = np.uint64(0xFFFFFFFF)
    stripes = 64
    for stripe in prange(stripes):
        spare = np.empty(longest, np.uint64)
        histogram = np.empty(256, np.int64)
        state = np.empty((TILE, CHANNELS * TILE), np.float32)
        open_row = np.empty(TILE, np.bool_)
        for tile in range(stripe, tiles, stripes):
            n = start[tile + 1] - start[tile]
            listed = entry[start[tile] : start[tile + 1]]
            _sort_keys(listed, spare, histogram, n)
            top, left = tile // across * TILE, tile % across * TILE
            rows, columns = min(TILE, height - top), min(TILE, width - left)
            state[:, :TILE] = ONE
            state[:, TILE:] = ZERO
            open_row[:] = True
            x0 = np.float32(left) + HALF
            for k in range(n):
                if k & 31 == 31:
                    any_open = False
                    for j in range(rows):
                        if open_row[j]:
                            most = ZERO
                            for i in range(columns):
                                most = max(most, state[j, i])
                            open_row[j] = most > TRANSMITTANCE_STOP
                            any_open |= open_row[j]
                    if not any_open:
                        break
                g = listed[k] & low_word
                u, v = record[g, 0], record[g, 1]
                a, b, c, level = record[g, 2], record[g, 3], record[g, 4], record[g, 5]
                red, green, blue, z = record[g, 6], record[g, 7], record[g, 8], record[g, 9]
                nx, ny, nz, distance = record[g, 10], record[g, 11], record[g, 12], record[g, 13]
                first = max(np.int64(record[g, 14]) - top, 0)
                last = min(np.int64(record[g, 15]) - top, rows - 1)
                for j in range(first, last + 1):
                    if open_row[j]:
                        dy = np.float32(top + j) + HALF - v
                        _blend_row(
                            state, j, u, dy, x0, a, b, c, level,
                            red, green, blue, z, nx, ny, nz, distance,
                        )  # fmt: skip
            for j in range(rows):
                for i in range(columns):
                    y, x = top + j, left + i
                    alpha = ONE - state[j, i]
                    for q in range(3):
                        color_out[y, x, q] = state[j, (1 + q) * TILE + i]
                    alpha_out[y, x] = alpha
                    nx, ny = state[j, 5 * TILE + i], state[j, 6 * TILE + i]
                    nz = state[j, 7 * TILE + i]
                    length = np.sqrt(nx * nx + ny * ny + nz * nz)
                    if alpha < MIN_COVERAGE or length <= ZERO:
                        depth_out[y, x] = np.inf
                        plane_out[y, x] = np.inf
                        normal_out[y, x, :] = ZERO
                        continue
                    z = state[j, 4 * TILE + i] / alpha
                    depth_out[y, x] = z
                    plane_out[y, x] = plane_depth(
                        np.float32(x) + HALF, np.float32(y) + HALF, lens, orthographic,
                        nx, ny, nz, state[j, 8 * TILE + i], alpha, z,
                    )  # fmt: skip
                    normal_out[y, x, 0] = nx / length
                    normal_out[y, x, 1] = ny / length
                    normal_out[y, x, 2] = nz / length


@device_function
def plane_depth(u, v, lens, orthographic, nx, ny, nz, distance, alpha, z):
    """Return the depth where the ray of image point (u, v) meets the blended plane.

    The plane is n.p = distance with n and distance blended alike. Falls back on the mean depth `z`
    where the plane is nearly edge-on or its answer is far from the splats that were blended.
    """
    a, b = (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
    if orthographic:
        across, along = nx * a + ny * b, nz
    else:
        across, along = ZERO, nx * a + ny * b + nz
    if along > -EDGE_ON * alpha:
        return z
    depth = (distance - across) / along
    limit = PLANE_LIMIT * z if not orthographic else np.float32(np.inf)
    return depth if abs(depth - z) < limit else z
