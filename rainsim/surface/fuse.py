"""The surface of a capture: the depth pictures of its cameras, put together.

A trained splat lies where training left it: before walls hangs half-transparent haze, and the sky
is made of splats that hang anywhere in the air. What several cameras see at one place from
different sides is solid. So each camera's depth picture is cut into voxels, the mean of all samples
in a voxel is a place of the surface, and a place that other cameras look through is left out.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from rainsim.jit import cpu_kernel, prange, serial_kernel
from rainsim.numerics.blocks import in_blocks
from rainsim.numerics.places import group_means, groups_of
from rainsim.surface.views import DepthView
from rainsim.surface.walls import to_walls

VOXEL = 0.04  # m, within the radius of what the cameras look at; beyond it twice that, and so on
COARSE = 1.75  # times that, of a pixel from which on voxels are twice as wide
LEVELS = 8  # of voxels, each twice as large
JUMP = np.float32(0.04)  # of the depth, between pixels: the edge of something
SLACK, LEAST_SLACK = np.float32(0.015), np.float32(0.02)  # of the depth, and m: places that agree
FEW_VIEWS, LEAST_VIEWS, MANY = 2, 3, 36  # cameras that see a place; of many; so many are many
MOST_THROUGH = 0.3  # of these, that may look through it
NEIGHBOURS = 20  # places about one that its plane is fitted to
# Voxels off the plane (rms), from which on a place has none: where texture tells the depth, and
# where none does.
ROUND, PLAIN_ROUND = 0.45, 1.0
AROUND = 9  # of them, of whose flatness the median is taken
# Of a voxel: samples, and sums over them: place from the middle [m], colour, direction to the
# camera, how plain the picture is there.
SUMS = 11
# Of plain parts: cells that are taken together, and the deviation of the weights of those about a
# place, both in m; how many of them; off a plane, over that deviation: half their weight; farthest.
SCALES, NODES = ((0.24, 0.7), (0.12, 0.3)), 32
BARELY_PLAIN = 0.15  # of places that are moved to a wall beside them
ROBUST, FARTHEST = 0.2, 1.5
EVEN = 0.15  # of the variance along a plane, that across it may be
KEY_BITS = 19  # of a voxel's place along each axis


class CaptureSurface(NamedTuple):
    """Places on the surface of a capture, in the ground frame."""

    position: np.ndarray  # (n, 3), float32, m
    normal: np.ndarray  # (n, 3), float32, unit, towards the cameras that see it
    flat: np.ndarray  # (n,), float32: places around lie in one plane, 0 (leaves) to 1 (paving)
    light: np.ndarray  # (n, 3), float32, linear captured colour, relative to display white
    size: np.ndarray  # (n,), float32, m, side of its voxel
    views: np.ndarray  # (n,), uint8, cameras that see it


def fused(views, middle, radius):
    """Return the `CaptureSurface` that depth pictures show.

    Voxels are VOXEL wide within a radius [m] about `middle` [m], which the cameras look at, and
    twice that where pixels are about as wide.
    """
    middle = np.asarray(middle, np.float32)
    voxel = VOXEL if pixel_of(views) < COARSE * VOXEL else 2 * VOXEL
    count, most = 0, sum(view.depth.size for view in views)
    # What is not written to takes no memory. The table always has an empty place.
    keys, sums = np.empty(most, np.int64), np.zeros((most, SUMS))
    table = np.full(1 << most.bit_length(), -1, np.int32)
    for view in views:
        count = add_view(
            view, middle, np.float32(radius), np.float32(voxel), count, table, keys, sums
        )
    keys, sums = keys[:count], sums[:count]
    number = np.maximum(sums[:, 0], 1)[:, None]
    position = np.ascontiguousarray(sums[:, 1:4] / number + middle, np.float32)
    size = voxel * 2.0 ** (keys >> 3 * KEY_BITS)
    found = counted(position, size.astype(np.float32), views)
    least = LEAST_VIEWS if len(views) >= MANY else FEW_VIEWS
    solid = are_agreed(found, least)
    position, towards = position[solid], sums[solid, 7:10]
    light = (sums[solid, 4:7] / number[solid]).astype(np.float32)
    size = size[solid].astype(np.float32)
    plain = (sums[solid, 10] / number[solid, 0]).astype(np.float32)
    position, upright = evened(position, plain, towards, size, found[solid, 0], views)
    normal, flat, smooth = planes(position, towards, size, plain)
    wall = upright.any(axis=1)
    side = np.where(np.einsum("ij,ij->i", upright[wall], towards[wall]) < 0, -1, 1)
    normal[wall], flat[wall], smooth[wall] = upright[wall] * side[:, None], 1, position[wall]
    return thinned(CaptureSurface(smooth, normal, flat, light, size, found[solid, 0]))


def pixel_of(views):
    """Return the usual width of a pixel on the surfaces that depth pictures show [m]."""
    shown = [(view, view.depth[view.depth < 1e6]) for view in views]
    wide = [np.median(depth) / view.lens[0] for view, depth in shown if len(depth)]
    return float(np.median(wide)) if wide else 0.0


def evened(position, plain, towards, size, weight, views):
    """Return places (n, 3), where the capture is plain moved to planes, and the normals of walls.

    Where nothing tells the depth, what is seen lies in a thick layer about the surface. A plane
    fitted to the layer, over a wider neighbourhood, is surer than any of its places: that of a
    whole wall, or of the widest neighbourhood that is a layer.
    """
    which = np.flatnonzero(plain > BARELY_PLAIN)
    result, upright = position.copy(), np.zeros_like(position)
    result[which], upright[which] = to_walls(
        position[which], towards[which], size[which], plain[which], weight[which], views
    )
    which = np.flatnonzero((plain > 0.5) & ~upright.any(axis=1))
    for cell, wide in SCALES:
        if len(which) < 4 * NODES:
            break
        moved, even, _ = to_planes(position[which], weight[which].astype(np.float64), cell, wide)
        result[which[even]] = moved[even]
        which = which[~even]
    return result, upright


def to_planes(position, weight, cell, wide):
    """Return places moved to planes of those `wide` [m] around, where they are layers, and normals.

    weight : array (n,). Of each place. Normals (n, 3) are unit, of either sign.
    """
    place = np.floor(position / cell).astype(np.int64)
    group = groups_of(place, 0)
    total, node = np.bincount(group, weight), group_means(group, position, weight)
    tree, k = cKDTree(node), min(NODES, len(node))
    result, normal, even = position.copy(), position.copy(), np.zeros(len(position), bool)

    def work(part):
        at = position[part].astype(np.float64)
        away, near = tree.query(at, k=range(1, k + 1))
        around = node[near]
        weights = base = total[near] * np.exp(-0.5 * (away / wide) ** 2)
        for _ in range(3):
            weights = weights / weights.sum(axis=1, keepdims=True)
            middle = np.einsum("ij,ijk->ik", weights, around)
            offset = around - middle[:, None]
            value, axes = np.linalg.eigh(np.einsum("ij,ijk,ijl->ikl", weights, offset, offset))
            up = axes[:, :, 0]
            off = np.einsum("ijk,ik->ij", offset, up)
            weights = base / (1 + (off / (ROBUST * wide)) ** 2)
        lift = np.einsum("ij,ij->i", middle - at, up)
        even[part] = (value[:, 0] < EVEN * value[:, 1]) & (np.abs(lift) < FARTHEST * wide)
        result[part] += (lift[:, None] * up).astype(np.float32)
        normal[part] = up

    in_blocks(work, len(position), 1 << 13)
    return result, even, normal


def thinned(surface):
    """Return a surface with one place in each voxel."""
    size = surface.size.astype(np.float64)
    place = np.floor(surface.position / size[:, None]).astype(np.int64)
    level = np.rint(np.log2(size / VOXEL)).astype(np.int64)
    key = np.stack([level, *place.T, surface.normal @ [1, 2, 4] > 0])
    key -= key.min(axis=1, keepdims=True, initial=0)
    key = np.ravel_multi_index(tuple(key), tuple(key.max(axis=1, initial=0) + 1))
    group = np.unique(key, return_inverse=True)[1]
    means = group_means(group, np.column_stack(surface[:5]), surface.views.astype(np.float64))
    means = np.split(means.astype(np.float32), [3, 6, 7, 10], axis=1)
    position, normal, flat, light, size = map(np.ascontiguousarray, means)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    views = np.zeros(len(size), np.uint8)
    np.maximum.at(views, group, surface.views)
    return CaptureSurface(position, normal, flat[:, 0], light, size[:, 0], views)


def counted(position, size, views):
    """Return how many views see, look through and have something before each place, (n, 3).

    Places and their sizes are in metres, see `count_views`.
    """
    found = np.zeros((len(position), 3), np.uint8)
    for view in views:
        count_views(position, size, view, found)
    return found


def are_agreed(found, least):
    """Return which places `least` views see and few look through; `found` is of `counted`."""
    return (found[:, 0] >= least) & (found[:, 1] <= MOST_THROUGH * found[:, 0])


@serial_kernel
def add_view(view: DepthView, middle, radius, voxel, count, table_out, keys_out, sums_out):
    """Add a view's samples to voxels, and return how many voxels there are.

    voxel : float32 [m]. Side of the finest.
    count : int. Voxels so far.
    table_out : int32 array. Hash table of their numbers, -1 where none is; its
        length is a power of two.
    keys_out : int64 array (n,). Level and place of each voxel.
    sums_out : float64 array (n, SUMS)
    """
    height, width = view.depth.shape
    mask = len(table_out) - 1
    m, eye = view.matrix, view.eye
    half = 1 << (KEY_BITS - 1)
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            d = view.depth[row, column]
            if not d < 1e6:
                continue
            jump = max(
                abs(view.depth[row, column + 1] - d), abs(view.depth[row, column - 1] - d),
                abs(view.depth[row + 1, column] - d), abs(view.depth[row - 1, column] - d),
            )  # fmt: skip
            if not jump < JUMP * d:
                continue
            a = (np.float32(column) + np.float32(0.5) - view.lens[2]) / view.lens[0]
            b = (np.float32(row) + np.float32(0.5) - view.lens[3]) / view.lens[1]
            x = (m[0, 0] * a + m[1, 0] * b + m[2, 0]) * d
            y = (m[0, 1] * a + m[1, 1] * b + m[2, 1]) * d
            z = (m[0, 2] * a + m[1, 2] * b + m[2, 2]) * d
            away = math.sqrt(x * x + y * y + z * z)
            px, py, pz = x + eye[0] - middle[0], y + eye[1] - middle[1], z + eye[2] - middle[2]
            far = math.sqrt(px * px + py * py + pz * pz) / radius
            level = 0
            while far > 1 and level < LEVELS:
                far *= np.float32(0.5)
                level += 1
            side = voxel * np.float32(1 << level)
            i = math.floor(px / side) + half
            j = math.floor(py / side) + half
            k = math.floor(pz / side) + half
            if not (0 < i < 2 * half and 0 < j < 2 * half and 0 < k < 2 * half):
                continue
            key = (((level << KEY_BITS | i) << KEY_BITS) | j) << KEY_BITS | k
            at = ((key * 0x9E3779B1) ^ (key >> 29)) & mask
            while table_out[at] >= 0 and keys_out[table_out[at]] != key:
                at = (at + 1) & mask
            n = table_out[at]
            if n < 0:
                n = count
                table_out[at], keys_out[n] = n, key
                count += 1
            sums_out[n, 0] += 1
            sums_out[n, 1] += px
            sums_out[n, 2] += py
            sums_out[n, 3] += pz
            for c in range(3):
                sums_out[n, 4 + c] += view.light[row, column, c]
            sums_out[n, 7] -= x / away
            sums_out[n, 8] -= y / away
            sums_out[n, 9] -= z / away
            sums_out[n, 10] += view.plain[row, column]
    return count


@cpu_kernel
def count_views(position, size, view: DepthView, found_out):
    """Count the views that see each place, look through it, and have something before it.

    `position`, (n, 3) [m], may be off by half of `size`, (n,) [m]; `found_out` is (n, 3), uint8.
    """
    height, width = view.depth.shape
    m, lens = view.matrix, view.lens
    for n in prange(len(position)):
        x, y, z = position[n, 0], position[n, 1], position[n, 2]
        far = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if not far > np.float32(0.1):
            continue
        u = lens[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / far + lens[2]
        v = lens[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / far + lens[3]
        if not (u >= 0 and v >= 0 and u < width and v < height):
            continue
        slack = LEAST_SLACK + SLACK * far + np.float32(0.5) * size[n]
        if view.least[int(v), int(u)] - far > np.float32(2) * slack:
            found_out[n, 1] += np.uint8(1)
        elif abs(view.depth[int(v), int(u)] - far) < slack:
            found_out[n, 0] += np.uint8(1)
        elif view.depth[int(v), int(u)] < far:
            found_out[n, 2] += np.uint8(1)


def planes(position, towards, size, plain):
    """Return normals (n, 3), how flat it is (n,), and the places (n, 3) moved to planes fitted.

    `position` and `size` are in metres, `towards` is the sum of the directions to the cameras that
    see each place, `plain` how little texture tells the depth, 0 to 1.
    """
    count = len(position)
    normal, flat = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    smooth = position.copy()
    k = min(NEIGHBOURS, count)
    if k < 4:
        return normal, flat, smooth
    tree = cKDTree(position, compact_nodes=False, balanced_tree=False)
    nearest = np.empty((count, min(AROUND, k)), np.int32)
    order = tree.indices  # those of a leaf after one another, which have the same neighbours

    def work(part):
        part = order[part]
        away, near = tree.query(position[part], k=k)
        nearest[part] = near[:, :AROUND]
        side, here = size[part], position[part].astype(np.float64)
        weight = np.exp(-0.5 * (away / (2 * side[:, None])) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        off = position[near].astype(np.float64)
        mean = (weight[:, None] @ off)[:, 0]
        off -= mean[:, None]
        value, axes = np.linalg.eigh((weight[..., None] * off).transpose(0, 2, 1) @ off)
        thick, wide = 2 * np.sqrt(np.maximum(value[:, :2], 0)).T / side
        up = axes[:, :, 0]
        even = np.clip(2 - thick / (ROUND + (PLAIN_ROUND - ROUND) * plain[part]), 0, 1)
        even *= np.minimum(wide, 1)
        facing, lift = ((up * v).sum(axis=1) for v in (towards[part], mean - here))
        normal[part] = np.where(facing < 0, -1, 1)[:, None] * up
        smooth[part] = here + (even * lift)[:, None] * up
        flat[part] = even

    def typical(part):
        middle[part] = np.median(flat[nearest[part]], axis=1)

    in_blocks(work, count, 1 << 12)
    middle = np.empty_like(flat)
    in_blocks(typical, count)
    return normal, middle, smooth
