"""Rays through the splats themselves: beams of the lidar.

A ray blends the splats that it meets front to back by the rules of the picture (`raster`): a
splat's alpha is its opacity times its Gaussian at the ray, capped at 0.999 and left out under
1/255; its place in the order is that of its centre along the ray; what lies behind a transmittance
of 1e-4 is left out. The Gaussian at a ray is the splat's projection along it, which is also its
greatest value on the ray (3DGRT, Moenne-Loccoz et al. 2024, ACM TOG 43(6), eq. 8), widened by 0.3
pixels^2 at the distance where it stands, as the picture does. What differs from the picture is that
each ray projects on its own, where the picture takes one projection for all pixels of a splat.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rainsim.constants import FOUR, HALF, ONE, SH_0, SH_1, SH_2, SH_3, THREE, TWO, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, lean_function, prange
from rainsim.numerics.bvh import LEAST_ALPHA, RECORD, build, lay_out

MAX_ALPHA = np.float32(0.999)
TRANSMITTANCE_STOP = np.float32(1e-4)
LOW_PASS = np.float32(0.3)  # px^2
REACH = np.float32(3.34)  # sigmas at which an opaque splat falls to 1/255
MIN_COVERAGE = np.float32(0.02)  # alpha below which a ray has no depth
EDGE_ON = np.float32(0.02)  # cosine at which a blended plane no longer tells the depth
PLANE_LIMIT = np.float32(0.2)  # share of the depth by which the plane may correct it
MOST_HITS = 1024  # of a segment; more, and the segment is halved
STACK = 96
GROWTH = np.float32(2)  # of a segment over the one before
FAR = np.float32(1e30)

# Factors of the spherical harmonics of degrees 0 to 3 (Kerbl et al. 2023).
SH0, SH1 = np.float32(SH_0), np.float32(SH_1)
SH2A, SH2B, SH2C = (np.float32(factor) for factor in SH_2)
SH3A, SH3B, SH3C, SH3D, SH3E = (np.float32(factor) for factor in SH_3)


class SplatTree(NamedTuple):
    """Splats in a bounding volume hierarchy (BVH), see `rainsim.numerics.bvh`."""

    record: np.ndarray  # (n, bvh.RECORD) float32, in the order of the leaves
    box: np.ndarray  # (nodes, 6) float32
    child: np.ndarray  # (nodes, 2) int64
    order: np.ndarray  # (n,) int64, number of each record's splat
    sh: np.ndarray  # (n, 3 * bands**2) float32, colours in the splats' own order
    bands: int  # 1 to 4, degrees of the harmonics and one more


class Ray(NamedTuple):
    """A ray and the plane across it, float32, capture frame."""

    o0: np.float32  # origin
    o1: np.float32
    o2: np.float32
    d0: np.float32  # unit direction
    d1: np.float32
    d2: np.float32
    e0: np.float32  # unit vectors that span the plane across the ray
    e1: np.float32
    e2: np.float32
    f0: np.float32
    f1: np.float32
    f2: np.float32
    way: np.float32  # length of the way from the virtual eye to the origin
    per_focal: np.float32  # width of the picture's pixel over the distance


@dataclass(frozen=True)
class Traced:
    """Results of traced rays; distances from their virtual eye (see `Tracer.trace`), capture units.

    color : float32 array (n, 3). Display-referred, over black.
    distance : float32 array (n,). Mean of the splats' centres; infinite where
        alpha is below 0.02.
    plane_distance : float32 array (n,). To the blended plane of the splats.
    normal : float32 array (n, 3). Unit, capture frame, towards the ray's origin.
    """

    color: np.ndarray
    alpha: np.ndarray
    distance: np.ndarray
    plane_distance: np.ndarray
    normal: np.ndarray
    hits: np.ndarray


class Tracer:
    """Traces rays through splats."""

    def __init__(self, splats):
        n = len(splats)
        record, box = np.empty((n, RECORD), np.float32), np.empty((n, 6), np.float32)
        lay_out(splats.position, splats.scale, splats.rotation, splats.opacity, record, box)
        order = np.arange(n)
        node_box, child = np.empty((2 * n + 1, 6), np.float32), np.empty((2 * n + 1, 2), np.int64)
        nodes = build(box, order, node_box, child) if n else 0
        self.tree = SplatTree(
            record[order], node_box[:nodes].copy(), child[:nodes].copy(), order,
            splats.sh.reshape(n, 3 * splats.sh.shape[1]), math.isqrt(splats.sh.shape[1]),
        )  # fmt: skip

    @property
    def nbytes(self):
        """Memory of the hierarchy [bytes]; the colours are the scene's own."""
        return sum(a.nbytes for a in self.tree[:4])

    def trace(self, origin, direction, before=0.0, pixel=0.0, segment=1.0, plane=None,
              color_eye=None, stop=TRANSMITTANCE_STOP):  # fmt: skip
        """Trace rays through the splats; return blended colour, distance and normal as `Traced`.

        origin, direction : float32 array (n, 3). Capture frame; unit directions.
        before : array (n,) or float. Length of the way from the eye to the
            origin: distances count from the virtual eye that far behind the
            origin, and a splat there is as wide as the picture would widen it.
        segment : float. Length of ray that is searched at first; it changes only
            the speed.
        plane : array_like of shape (4,), optional. (a, b, c, d): splats whose
            centres lie at (x, y, z) from the ray's origin with a x + b y + c z <
            d are left out.
        color_eye : array_like of shape (3,), optional. Where colours are seen
            from; by default from each ray's own virtual eye.
        stop : float. Transmittance at which a ray ends: what lies behind counts
            in no mean.
        """
        n = len(origin)
        out = Traced(
            np.zeros((n, 3), np.float32), np.zeros(n, np.float32),
            np.full(n, np.inf, np.float32), np.full(n, np.inf, np.float32),
            np.zeros((n, 3), np.float32), np.zeros(n, np.int32),
        )  # fmt: skip
        if not len(self.tree.record) or not n:
            return out
        before, pixel = (np.full(n, a, np.float32) for a in (before, pixel))
        cut = np.array([0, 0, 0, -np.inf] if plane is None else plane, np.float32)
        eye = np.full(3, np.nan) if color_eye is None else np.asarray(color_eye)
        _trace(
            np.ascontiguousarray(origin, np.float32), np.ascontiguousarray(direction, np.float32),
            before, pixel, np.float32(segment), np.float32(stop), cut,
            eye.astype(np.float32), self.tree, out.color, out.alpha, out.distance,
            out.plane_distance, out.normal, out.hits,
        )  # fmt: skip
        return out


@cpu_kernel
def _trace(
    origin, direction, before, pixel, segment, stop, plane, color_eye, tree: SplatTree, color_out,
    alpha_out, distance_out, plane_out, normal_out, hits_out,
):  # fmt: skip
    """Trace each ray, segment after segment, until it is stopped or leaves the scene."""
    for n in prange(len(origin)):
        ray = ray_from(origin[n], direction[n], before[n], pixel[n])
        o0, o1, o2, d0, d1, d2, way = ray.o0, ray.o1, ray.o2, ray.d0, ray.d1, ray.d2, ray.way
        hit, place = np.empty(MOST_HITS, np.float32), np.empty(MOST_HITS, np.int64)
        weight, stack = np.empty(MOST_HITS, np.float32), np.empty(STACK, np.int64)
        own = not (color_eye[0] == color_eye[0])
        c0 = o0 - way * d0 if own else color_eye[0]
        c1 = o1 - way * d1 if own else color_eye[1]
        c2 = o2 - way * d2 if own else color_eye[2]
        clear, red, green, blue, mean = ONE, ZERO, ZERO, ZERO, ZERO
        n0, n1, n2, flat = ZERO, ZERO, ZERO, ZERO
        begin, size, blended = ZERO, segment, 0
        last = farthest(tree.box[0], ray)
        while begin < last and clear > stop:
            end = begin + size
            count = collect(tree, ray, plane, begin, end, stack, hit, place, weight)
            if count < 0:
                size *= HALF
                continue
            sort_hits(hit, place, weight, count)
            for k in range(count):
                r = tree.record[place[k]]
                alpha = weight[k]
                w = alpha * clear
                s, bands = tree.sh[tree.order[place[k]]], tree.bands
                x, y, z = r[0] - c0, r[1] - c1, r[2] - c2
                inv = ONE / max(math.sqrt(x * x + y * y + z * z), np.float32(1e-12))
                x, y, z = x * inv, y * inv, z * inv
                red += w * shaded(s, 0, bands, x, y, z)
                green += w * shaded(s, 1, bands, x, y, z)
                blue += w * shaded(s, 2, bands, x, y, z)
                mean += w * hit[k]
                away = r[9] * d0 + r[10] * d1 + r[11] * d2
                w_ = -w if away > ZERO else w
                n0, n1, n2 = n0 + w_ * r[9], n1 + w_ * r[10], n2 + w_ * r[11]
                flat += w_ * (r[9] * (r[0] - o0) + r[10] * (r[1] - o1) + r[11] * (r[2] - o2))
                clear -= w
                blended += 1
                if clear <= stop:
                    break
            begin = end
            size *= GROWTH
        alpha = ONE - clear
        color_out[n, 0], color_out[n, 1], color_out[n, 2] = red, green, blue
        alpha_out[n], hits_out[n] = alpha, blended
        length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if alpha < MIN_COVERAGE or length == ZERO:
            continue
        mean /= alpha
        along = n0 * d0 + n1 * d1 + n2 * d2
        level = flat / along if along < -EDGE_ON * alpha else mean
        total = way + mean
        distance_out[n] = total
        plane_out[n] = way + level if abs(level - mean) < PLANE_LIMIT * total else total
        normal_out[n, 0], normal_out[n, 1] = n0 / length, n1 / length
        normal_out[n, 2] = n2 / length


@inlined_function
def ray_from(origin, direction, way, per_focal):
    """Return the `Ray` of an origin (3,) and a unit direction (3,)."""
    d0, d1, d2 = direction[0], direction[1], direction[2]
    e0, e1, e2, f0, f1, f2 = across(d0, d1, d2)
    return Ray(origin[0], origin[1], origin[2], d0, d1, d2, e0, e1, e2, f0, f1, f2, way, per_focal)


@device_function
def across(x, y, z):
    """Return two unit vectors upright on it and on each other (Duff et al. 2017, JCGT 6(1))."""
    sign = ONE if z >= ZERO else -ONE
    a = -ONE / (sign + z)
    b = x * y * a
    return ONE + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y


@device_function
def farthest(b, ray):
    """Return how far along the ray the farthest corner of a box lies."""
    return (
        ((b[3] if ray.d0 > ZERO else b[0]) - ray.o0) * ray.d0
        + ((b[4] if ray.d1 > ZERO else b[1]) - ray.o1) * ray.d1
        + ((b[5] if ray.d2 > ZERO else b[2]) - ray.o2) * ray.d2
    )


@device_function
def nearest(b, ray):
    """Return how far along the ray the nearest corner of a box lies."""
    return (
        ((b[0] if ray.d0 > ZERO else b[3]) - ray.o0) * ray.d0
        + ((b[1] if ray.d1 > ZERO else b[4]) - ray.o1) * ray.d1
        + ((b[2] if ray.d2 > ZERO else b[5]) - ray.o2) * ray.d2
    )


@device_function
def meets(b, margin, ray, i0, i1, i2):
    """Tell whether the ray's line meets a box widened by a margin; i is 1 / direction."""
    a0, c0 = (b[0] - margin - ray.o0) * i0, (b[3] + margin - ray.o0) * i0
    a1, c1 = (b[1] - margin - ray.o1) * i1, (b[4] + margin - ray.o1) * i1
    a2, c2 = (b[2] - margin - ray.o2) * i2, (b[5] + margin - ray.o2) * i2
    enter = max(max(min(a0, c0), min(a1, c1)), min(a2, c2))
    leave = min(min(max(a0, c0), max(a1, c1)), max(a2, c2))
    return enter <= leave


@device_function
def inverse(d):
    """Return 1 / d, huge for 0."""
    return ONE / d if abs(d) > np.float32(1e-20) else FAR


@lean_function
def collect(tree, ray, plane, begin, end, stack, hit_out, place_out, alpha_out):
    """List the splats a ray meets whose centres lie from `begin` to `end`; negative: too many."""
    record, box, child = tree.record, tree.box, tree.child
    i0, i1, i2 = inverse(ray.d0), inverse(ray.d1), inverse(ray.d2)
    p0, p1, p2, p3 = plane[0], plane[1], plane[2], plane[3]
    widest = REACH * math.sqrt(LOW_PASS) * ray.per_focal  # of the low-pass, over the distance
    stack[0] = 0
    top, count = 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        b = box[node]
        to = farthest(b, ray)
        if to < begin or nearest(b, ray) >= end:
            continue
        if not meets(b, widest * (ray.way + min(to, end)), ray, i0, i1, i2):
            continue
        second = child[node, 1]
        if second > 0:
            stack[top], stack[top + 1] = child[node, 0], second
            top += 2
            continue
        first = child[node, 0]
        for k in range(first, first - second):
            r = record[k]
            x, y, z = r[0] - ray.o0, r[1] - ray.o1, r[2] - ray.o2
            t = x * ray.d0 + y * ray.d1 + z * ray.d2
            if t < begin or t >= end or x * p0 + y * p1 + z * p2 < p3:
                continue
            alpha = alpha_at(r, x, y, z, t + ray.way, ray)
            if alpha >= LEAST_ALPHA:
                if count == len(hit_out):
                    return -1
                hit_out[count], place_out[count], alpha_out[count] = t, k, alpha
                count += 1
    return count


@device_function
def alpha_at(r, x, y, z, distance, ray):
    """Return the alpha of a splat's record on a ray; (x, y, z) is its centre from the origin."""
    e0, e1, e2, f0, f1, f2 = ray.e0, ray.e1, ray.e2, ray.f0, ray.f1, ray.f2
    u, v = x * e0 + y * e1 + z * e2, x * f0 + y * f1 + z * f2
    a0, a1 = r[3] * e0 + r[4] * e1 + r[5] * e2, r[4] * e0 + r[6] * e1 + r[7] * e2
    a2 = r[5] * e0 + r[7] * e1 + r[8] * e2
    blur = distance * ray.per_focal
    blur *= blur * LOW_PASS
    s00 = a0 * e0 + a1 * e1 + a2 * e2 + blur
    s01 = a0 * f0 + a1 * f1 + a2 * f2
    b0, b1 = r[3] * f0 + r[4] * f1 + r[5] * f2, r[4] * f0 + r[6] * f1 + r[7] * f2
    b2 = r[5] * f0 + r[7] * f1 + r[8] * f2
    s11 = b0 * f0 + b1 * f1 + b2 * f2 + blur
    determinant = s00 * s11 - s01 * s01
    if determinant <= ZERO:
        return ZERO
    power = HALF * (s11 * u * u - TWO * s01 * u * v + s00 * v * v) / determinant
    if power > np.float32(5.6):  # 255 = exp(5.54)
        return ZERO
    return min(r[12] * math.exp(-power), MAX_ALPHA)


@device_function
def sort_hits(hit, place, alpha, count):
    """Sort by distance, ties by place: Shell's sort with Ciura's gaps (2001)."""
    for gap in (301, 132, 57, 23, 10, 4, 1):
        for k in range(gap, count):
            h, p, a = hit[k], place[k], alpha[k]
            j = k - gap
            while j >= 0 and (hit[j] > h or (hit[j] == h and place[j] > p)):
                hit[j + gap], place[j + gap], alpha[j + gap] = hit[j], place[j], alpha[j]
                j -= gap
            hit[j + gap], place[j + gap], alpha[j + gap] = h, p, a


@device_function
def shaded(sh, c, bands, x, y, z):
    """Return channel c of a splat's colour seen along the unit direction (x, y, z)."""
    value = SH0 * sh[c] + HALF
    if bands > 1:
        value += SH1 * (z * sh[6 + c] - y * sh[3 + c] - x * sh[9 + c])
    if bands > 2:
        xx, yy, zz = x * x, y * y, z * z
        value += SH2A * (x * y * sh[12 + c] - y * z * sh[15 + c] - x * z * sh[21 + c])
        value += SH2B * (TWO * zz - xx - yy) * sh[18 + c] + SH2C * (xx - yy) * sh[24 + c]
        if bands > 3:
            value += SH3B * x * y * z * sh[30 + c] - SH3A * y * (THREE * xx - yy) * sh[27 + c]
            value -= SH3C * (FOUR * zz - xx - yy) * (y * sh[33 + c] + x * sh[39 + c])
            value += SH3D * z * (TWO * zz - THREE * xx - THREE * yy) * sh[36 + c]
            value += SH3E * z * (xx - yy) * sh[42 + c] - SH3A * x * (xx - THREE * yy) * sh[45 + c]
    return max(value, ZERO)
