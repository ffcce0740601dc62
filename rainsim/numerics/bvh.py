"""A bounding volume hierarchy over the ellipsoids of splats, for rays."""

import numpy as np

from rainsim.constants import HALF, ONE, TWO, ZERO
from rainsim.jit import cpu_kernel, prange, serial_kernel

LEAF = 4  # splats of a leaf at most
BINS = 16  # of centres along the axis that is split
LEAST_ALPHA = np.float32(1 / 255)  # where a splat ends

# Numbers of a splat's record: position (3), covariance xx, xy, xz, yy, yz, zz, normal (3), opacity.
RECORD = 16


@cpu_kernel
def lay_out(position, scale, rotation, opacity, record_out, box_out):
    """Write each splat's record and the box that it reaches to with an alpha of 1/255.

    Boxes (n, 6) hold the lowest and highest x, y, z; the box of a splat that is nowhere so dense
    is its centre.
    """
    for o in prange(len(position)):
        w, x, y, z = rotation[o, 0], rotation[o, 1], rotation[o, 2], rotation[o, 3]
        r00, r01 = ONE - TWO * (y * y + z * z), TWO * (x * y - w * z)
        r10, r11 = TWO * (x * y + w * z), ONE - TWO * (x * x + z * z)
        r20, r21 = TWO * (x * z - w * y), TWO * (y * z + w * x)
        r02, r12, r22 = TWO * (x * z + w * y), TWO * (y * z - w * x), ONE - TWO * (x * x + y * y)
        s0, s1, s2 = scale[o, 0], scale[o, 1], scale[o, 2]
        a, b, c = s0 * s0, s1 * s1, s2 * s2
        r = record_out[o]
        r[0], r[1], r[2] = position[o, 0], position[o, 1], position[o, 2]
        r[3] = a * r00 * r00 + b * r01 * r01 + c * r02 * r02
        r[4] = a * r00 * r10 + b * r01 * r11 + c * r02 * r12
        r[5] = a * r00 * r20 + b * r01 * r21 + c * r02 * r22
        r[6] = a * r10 * r10 + b * r11 * r11 + c * r12 * r12
        r[7] = a * r10 * r20 + b * r11 * r21 + c * r12 * r22
        r[8] = a * r20 * r20 + b * r21 * r21 + c * r22 * r22
        if s0 <= s1 and s0 <= s2:
            r[9], r[10], r[11] = r00, r10, r20
        elif s1 <= s2:
            r[9], r[10], r[11] = r01, r11, r21
        else:
            r[9], r[10], r[11] = r02, r12, r22
        r[12] = opacity[o]
        reach = np.sqrt(TWO * np.log(max(opacity[o] / LEAST_ALPHA, ONE)))
        for axis in range(3):
            half = reach * np.sqrt(r[3] if axis == 0 else (r[6] if axis == 1 else r[8]))
            box_out[o, axis], box_out[o, 3 + axis] = r[axis] - half, r[axis] + half


@serial_kernel
def build(box, order, node_box_out, child_out):
    """Build the tree from the top by the surface area heuristic over BINS bins.

    box : float32 array (n, 6)
    order : int64 array (n,). All splats; put into the order of the leaves, in
        place.
    node_box_out : float32 array (m, 6). Box of each node; m of 2 n is enough.
    child_out : int64 array (m, 2). An inner node's children; a leaf's first place
        in `order` and, negative, its number.
    Returns int. Number of nodes.
    """
    n = len(order)
    stack = np.empty((128, 3), np.int64)  # node, begin, end
    stack[0] = (0, 0, n)
    top, nodes = 1, 1
    count = np.empty(BINS, np.int64)
    bins = np.empty((BINS, 6), np.float32)
    right_area = np.empty(BINS, np.float32)
    while top > 0:
        top -= 1
        node, begin, end = stack[top]
        low, high = np.full(3, np.inf, np.float32), np.full(3, -np.inf, np.float32)
        first, last = np.full(3, np.inf, np.float32), np.full(3, -np.inf, np.float32)
        for k in range(begin, end):
            b = box[order[k]]
            for a in range(3):
                low[a], high[a] = min(low[a], b[a]), max(high[a], b[3 + a])
                middle = HALF * (b[a] + b[3 + a])
                first[a], last[a] = min(first[a], middle), max(last[a], middle)
        for a in range(3):
            node_box_out[node, a], node_box_out[node, 3 + a] = low[a], high[a]
        axis = 0
        for a in range(1, 3):
            if last[a] - first[a] > last[axis] - first[axis]:
                axis = a
        span = last[axis] - first[axis]
        if end - begin <= LEAF or top + 2 > len(stack):
            child_out[node, 0], child_out[node, 1] = begin, -(end - begin)
            continue
        middle = (begin + end) // 2
        if span > ZERO:
            count[:] = 0
            bins[:, :3], bins[:, 3:] = np.inf, -np.inf
            per = np.float32(BINS) * (ONE - np.float32(1e-6)) / span
            for k in range(begin, end):
                b = box[order[k]]
                i = int((HALF * (b[axis] + b[3 + axis]) - first[axis]) * per)
                i = min(max(i, 0), BINS - 1)
                count[i] += 1
                for a in range(3):
                    bins[i, a] = min(bins[i, a], b[a])
                    bins[i, 3 + a] = max(bins[i, 3 + a], b[3 + a])
            split = _best_split(bins, count, right_area)
            if split > 0:
                # Partition in place by the bin.
                i, j = begin, end - 1
                while i <= j:
                    b = box[order[i]]
                    at = int((HALF * (b[axis] + b[3 + axis]) - first[axis]) * per)
                    if min(max(at, 0), BINS - 1) < split:
                        i += 1
                    else:
                        order[i], order[j] = order[j], order[i]
                        j -= 1
                if begin < i < end:
                    middle = i
        child_out[node, 0], child_out[node, 1] = nodes, nodes + 1
        stack[top] = (nodes, begin, middle)
        stack[top + 1] = (nodes + 1, middle, end)
        top += 2
        nodes += 2
    return nodes


@serial_kernel
def _best_split(bins, count, right_area):
    """Return the first bin of the right part whose cost is least."""
    low, high = np.full(3, np.inf, np.float32), np.full(3, -np.inf, np.float32)
    for i in range(BINS - 1, 0, -1):
        for a in range(3):
            low[a], high[a] = min(low[a], bins[i, a]), max(high[a], bins[i, 3 + a])
        d0, d1, d2 = high[0] - low[0], high[1] - low[1], high[2] - low[2]
        right_area[i] = d0 * d1 + d1 * d2 + d2 * d0 if d0 >= ZERO else ZERO
    low[:], high[:] = np.inf, -np.inf
    total = count.sum()
    best, cost, left = -1, np.inf, 0
    for i in range(1, BINS):
        left += count[i - 1]
        for a in range(3):
            low[a], high[a] = min(low[a], bins[i - 1, a]), max(high[a], bins[i - 1, 3 + a])
        if left == 0 or left == total:
            continue
        d0, d1, d2 = high[0] - low[0], high[1] - low[1], high[2] - low[2]
        c = (d0 * d1 + d1 * d2 + d2 * d0) * left + right_area[i] * (total - left)
        if c < cost:
            cost, best = c, i
    return best
