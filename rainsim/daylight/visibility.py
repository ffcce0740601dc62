"""What of a scene is seen from far away: height maps along many directions, and look-ups in them.

Each place of the capture's surface is drawn as a disc, without blending: of each pixel the height
nearest to the far end counts. This takes a tenth of the time of a splatted picture, and shadows
need no more.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, QUARTER, TWO, ZERO
from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.numerics.places import group_means, groups_of

# Of a place of the surface: deviation over the side of its voxel, and square of the deviations
# within which it hides what is behind it.
ROUND_SHARE, REACH = 0.55, np.float32(1.6)
LOW_PASS = np.float32(0.25)  # px^2 added to each splat's spread: none falls between pixels
NOTHING = np.float32(-1e30)  # height where nothing stands
MOST_REACH = np.float32(4.5)  # square of the deviations within which merged splats stop light
# px by which splats are drawn wider than they are: a plane that is seen on edge would hide itself.
WIDENED = np.float32(1.3)
LEAST_SLANT = np.float32(0.15)  # cosine: planes that are steeper to the direction count as this


RAGGED = np.float32(2)  # times the margin, that what hides a place without a plane stands above it


PACKED = (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)  # rows and columns of a `Solids` covariance
BATCH = 8  # maps that are drawn at once
COARSER = 3.0  # px of a map within which splats are drawn as one


class Solids(NamedTuple):
    """What stops light, as Gaussians of the ground frame; read-only."""

    position: np.ndarray  # (n, 3) float32 [m]
    covariance: np.ndarray  # (n, 6) float32 [m2]: xx, xy, xz, yy, yz, zz
    reach: np.ndarray  # (n,) float32: square of the deviations within which it is solid


class Window(NamedTuple):
    """What the maps show: a square about the middle."""

    middle: np.ndarray  # (3,) float32 [m]
    side: int  # px
    pixel: np.float32  # m


def resized(window, side):
    """Return the window in another number of pixels."""
    return Window(window.middle, side, np.float32(window.side * float(window.pixel) / side))


def solids_of(surface):
    """Return the places of a `Surface` as `Solids`: discs in their planes, balls where is none."""
    normal, flat = surface.normal.astype(np.float64), surface.flat.astype(np.float64)
    spread = ROUND_SHARE**2 * surface.area.astype(np.float64)
    covariance = np.empty((len(spread), 6), np.float32)
    for k, (i, j) in enumerate(PACKED):
        covariance[:, k] = spread * ((i == j) - flat * normal[:, i] * normal[:, j])
    return Solids(surface.position, covariance, np.full(len(spread), REACH, np.float32))


def with_splats(solids, splats):
    """Return solids and solid splats of a `surface.kept_surface.Found`, whose leaves are finer."""
    return Solids(
        np.concatenate([solids.position, splats[:, :3]]),
        np.concatenate([solids.covariance, splats[:, 3:9]]),
        np.concatenate([solids.reach, splats[:, 9]]),
    )  # fmt: skip


def with_plane(solids, surface):
    """Return the solids of a `Surface` that lie in a plane with those around: no leaves."""
    which = surface.flat > HALF
    return Solids(*(values[which] for values in solids))


def coarsened(solids, cell):
    """Return solids of which those finer than a cell [m] are one a cell, of their moments.

    As `splatting.detail` merges splats, without colours.
    """
    size = solids.covariance[:, 0] + solids.covariance[:, 3] + solids.covariance[:, 5]
    fine = size < (0.5 * cell) ** 2
    position = solids.position[fine]
    if not len(position):
        return solids
    which = groups_of(np.floor(position / cell).astype(np.int64), 0)
    area = np.sqrt(_minors(solids.covariance[fine])) * solids.reach[fine]
    total, middle = np.bincount(which, area), group_means(which, position, area).astype(np.float32)
    i, j = np.transpose(PACKED)
    away = position - middle[which]
    covariance = solids.covariance[fine] + away[:, i] * away[:, j]
    covariance = group_means(which, covariance, area).astype(np.float32)
    # As much of the cell is covered as its splats cover together, at most what one Gaussian of
    # their spread does.
    new = np.minimum(total / np.maximum(np.sqrt(_minors(covariance)), 1e-12), MOST_REACH)
    return Solids(
        np.concatenate([solids.position[~fine], middle]),
        np.concatenate([solids.covariance[~fine], covariance]),
        np.concatenate([solids.reach[~fine], new.astype(np.float32)]),
    )  # fmt: skip


def _minors(covariance):
    """Return the sum of the principal minors: the square of a splat's mean shadow, but a factor."""
    xx, xy, xz, yy, yz, zz = covariance.T.astype(np.float64)
    minors = xx * yy - xy * xy + yy * zz - yz * yz + xx * zz - xz * xz
    return np.maximum(minors, 1e-24)


def axes_of(directions):
    """Return right, up and the direction itself for unit vectors (m, 3), as (m, 3, 3) float32."""
    z = np.asarray(directions, np.float64).reshape(-1, 3)
    steep = np.abs(z[:, 2:]) > 0.9
    other = np.where(steep, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    x = np.cross(other, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=1).astype(np.float32)


@cpu_kernel
def draw_heights(solids: Solids, axes, window: Window, heights_out):
    """Draw the height along each direction of what is nearest to its far end.

    `axes` are those of `axes_of`. Heights of shape (m, side, side) [m] are above the window's
    middle; NOTHING where nothing stands.
    """
    for k in prange(len(axes)):
        heights = heights_out[k]
        heights[:] = NOTHING
        for i in range(len(solids.reach)):
            _draw(solids, i, axes[k], window, heights)


@device_function
def _draw(solids, i, a, window, heights):
    """Draw one splat into a map of heights."""
    side, scale = window.side, ONE / window.pixel
    c = solids.covariance[i]
    x = solids.position[i, 0] - window.middle[0]
    y = solids.position[i, 1] - window.middle[1]
    z = solids.position[i, 2] - window.middle[2]
    u = (a[0, 0] * x + a[0, 1] * y + a[0, 2] * z) * scale + HALF * np.float32(side)
    v = (a[1, 0] * x + a[1, 1] * y + a[1, 2] * z) * scale + HALF * np.float32(side)
    if not (u > -100 and v > -100 and u < side + 100 and v < side + 100):
        return
    w = a[2, 0] * x + a[2, 1] * y + a[2, 2] * z
    p0 = c[0] * a[0, 0] + c[1] * a[0, 1] + c[2] * a[0, 2]
    p1 = c[1] * a[0, 0] + c[3] * a[0, 1] + c[4] * a[0, 2]
    p2 = c[2] * a[0, 0] + c[4] * a[0, 1] + c[5] * a[0, 2]
    q0 = c[0] * a[1, 0] + c[1] * a[1, 1] + c[2] * a[1, 2]
    q1 = c[1] * a[1, 0] + c[3] * a[1, 1] + c[4] * a[1, 2]
    q2 = c[2] * a[1, 0] + c[4] * a[1, 1] + c[5] * a[1, 2]
    uu = (p0 * a[0, 0] + p1 * a[0, 1] + p2 * a[0, 2]) * scale * scale + LOW_PASS
    uv = (p0 * a[1, 0] + p1 * a[1, 1] + p2 * a[1, 2]) * scale * scale
    vv = (q0 * a[1, 0] + q1 * a[1, 1] + q2 * a[1, 2]) * scale * scale + LOW_PASS
    uw = (p0 * a[2, 0] + p1 * a[2, 1] + p2 * a[2, 2]) * scale
    vw = (q0 * a[2, 0] + q1 * a[2, 1] + q2 * a[2, 2]) * scale
    inverse = ONE / (uu * vv - uv * uv)
    # The mean height of a Gaussian at a place: along its plane.
    rise_u, rise_v = (uw * vv - vw * uv) * inverse, (vw * uu - uw * uv) * inverse
    reach = solids.reach[i]
    wide, high = math.sqrt(uu * reach), math.sqrt(vv * reach)
    left, right = max(math.ceil(u - wide - HALF), 0), min(int(u + wide - HALF), side - 1)
    first, last = max(math.ceil(v - high - HALF), 0), min(int(v + high - HALF), side - 1)
    if u + wide < HALF or v + high < HALF:
        return
    for row in range(first, last + 1):
        dv = np.float32(row) + HALF - v
        for column in range(left, right + 1):
            du = np.float32(column) + HALF - u
            if (du * du * vv - TWO * du * dv * uv + dv * dv * uu) * inverse <= reach:
                height = w + rise_u * du + rise_v * dv
                if height > heights[row, column]:
                    heights[row, column] = height


@device_function
def seen_share(heights, a, window, position, normal, flat, margin):
    """Return the share of a place that nothing hides from a direction, 0 to 1.

    heights : float32 array (side, side) [m]. See `draw_heights`.
    a : float32 array (3, 3). See `axes_of`.
    position, normal : float32 array (3,). Of the place; the plane of its
        surroundings is followed to the centres of the pixels.
    flat : float32. How far the surroundings are a plane, 0 to 1.
    margin : float32 [m]. By which what hides it must stand above it.
    """
    x = position[0] - window.middle[0]
    y = position[1] - window.middle[1]
    z = position[2] - window.middle[2]
    scale, side = ONE / window.pixel, window.side
    u = (a[0, 0] * x + a[0, 1] * y + a[0, 2] * z) * scale + HALF * np.float32(side) - HALF
    v = (a[1, 0] * x + a[1, 1] * y + a[1, 2] * z) * scale + HALF * np.float32(side) - HALF
    w = a[2, 0] * x + a[2, 1] * y + a[2, 2] * z
    if not (u >= ZERO and v >= ZERO and u < side - 1 and v < side - 1):
        return ONE
    n0 = a[0, 0] * normal[0] + a[0, 1] * normal[1] + a[0, 2] * normal[2]
    n1 = a[1, 0] * normal[0] + a[1, 1] * normal[1] + a[1, 2] * normal[2]
    n2 = abs(a[2, 0] * normal[0] + a[2, 1] * normal[1] + a[2, 2] * normal[2])
    sign = a[2, 0] * normal[0] + a[2, 1] * normal[1] + a[2, 2] * normal[2]
    fall = -flat * window.pixel / max(n2, LEAST_SLANT)
    if sign < ZERO:
        fall = -fall
    rise_u, rise_v = fall * n0, fall * n1
    slope = abs(fall) * math.sqrt(n0 * n0 + n1 * n1)
    i, j = int(u), int(v)
    f, g = u - np.float32(i), v - np.float32(j)
    # Leaves are seen less sharply than planes.
    margin *= ONE + RAGGED * (ONE - flat)
    over = w + max(margin + window.pixel * HALF, WIDENED * slope)
    seen = ZERO
    for b in range(2):
        for c in range(2):
            du, dv = np.float32(c) - f, np.float32(b) - g
            weight = (ONE - abs(du)) * (ONE - abs(dv))
            if heights[j + b, i + c] <= over + rise_u * du + rise_v * dv:
                seen += weight
    return seen


@cpu_kernel
def find_seen(heights, axes, window: Window, position, normal, flat, margin, seen_out):
    """Find the share of each place that is seen from each direction; see `seen_share`.

    seen_out : ndarray of shape (n, m), float32
    """
    for i in prange(len(position)):
        for k in range(len(axes)):
            seen_out[i, k] = seen_share(
                heights[k], axes[k], window, position[i], normal[i], flat[i], margin
            )


@cpu_kernel
def add_light(
    heights, axes, window: Window, position, normal, flat, margin, radiance, light_out
):  # fmt: skip
    """Add the light of some directions to what each place has received.

    heights, axes, window, position, normal, flat, margin. See `seen_share`.
    radiance : float32 array (m, r). Of each direction, in several skies; times
        the solid angle.
    light_out : float32 array (n, r). Irradiance; of a place without a plane the
        mean over all ways that it may face.
    """
    for i in prange(len(position)):
        for k in range(len(axes)):
            a = axes[k, 2]
            cosine = a[0] * normal[i, 0] + a[1] * normal[i, 1] + a[2] * normal[i, 2]
            facing = flat[i] * max(cosine, ZERO) + (ONE - flat[i]) * QUARTER
            if facing > ZERO:
                seen = seen_share(
                    heights[k], axes[k], window, position[i], normal[i], flat[i], margin
                )
                for r in range(radiance.shape[1]):
                    light_out[i, r] += facing * seen * radiance[k, r]
