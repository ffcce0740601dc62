"""Screen-space reflection: march the mirrored ray through the picture's own depth.

McGuire and Mara 2014 (JCGT 3(4)): a ray that is straight in space is straight in the picture, and
1/z is linear along it, so the march visits each pixel once, perspective-correct. Two things differ
from the paper (RainyGS): a hit is an overlap of depth intervals with a thickness in metres, not a
point within an epsilon, so that a fast ray cannot step through a surface; and the end of the ray
is bisected.
"""

from __future__ import annotations

import numpy as np

from rainsim.jit import device_function

ZERO = np.float32(0)
ONE = np.float32(1)
HALF = np.float32(0.5)
NEAR = np.float32(0.05)  # m: a ray that comes towards the camera ends here
FIRST_STEP = np.float32(1.5)  # px: so that a surface does not hit itself
BISECTIONS = 4


@device_function
def march(depth, lens, x, y, z, dx, dy, dz, thickness, stride, farthest):
    """Find where a ray first meets the picture.

    Parameters
    ----------
    depth : ndarray of shape (height, width), float32 [m]
        Depth along the camera's z axis; infinite where nothing can be hit.
    lens : ndarray of shape (4,), float32
        fx, fy, cx, cy [px].
    x, y, z, dx, dy, dz : float32
        Origin [m] and unit direction in the camera frame.
    thickness : float32 [m]
        How far behind its depth a surface still stops a ray.
    stride : float32 [px]
    farthest : float32 [m]
        Length of ray that is searched.

    Returns
    -------
    distance : float32 [m]
        Along the ray; negative if nothing was met within the picture.
    """
    height, width = depth.shape
    length = farthest
    if dz < ZERO:
        length = min(length, (z - NEAR) / -dz)
    if length <= ZERO:
        return -ONE
    ex, ey, ez = x + dx * length, y + dy * length, z + dz * length
    iz0, iz1 = ONE / z, ONE / ez
    u0, v0 = lens[0] * x * iz0 + lens[2], lens[1] * y * iz0 + lens[3]
    u1, v1 = lens[0] * ex * iz1 + lens[2], lens[1] * ey * iz1 + lens[3]
    span = max(abs(u1 - u0), abs(v1 - v0))
    if span < ONE:
        return -ONE
    # Along t from 0 to 1 in the picture, u, v and 1/z are linear.
    du, dv, diz = u1 - u0, v1 - v0, iz1 - iz0
    end = ONE
    w, h = np.float32(width), np.float32(height)
    if du > ZERO:
        end = min(end, (w - u0) / du)
    elif du < ZERO:
        end = min(end, -u0 / du)
    if dv > ZERO:
        end = min(end, (h - v0) / dv)
    elif dv < ZERO:
        end = min(end, -v0 / dv)
    step = stride / span
    t = FIRST_STEP / span
    before = ONE / (iz0 + diz * t)
    while t + step < end:
        t += step
        now = ONE / (iz0 + diz * t)
        low, high = min(before, now), max(before, now)
        i, j = int(u0 + du * t), int(v0 + dv * t)
        if i < 0 or j < 0 or i >= width or j >= height:
            break
        surface = depth[j, i]
        if high >= surface and low <= surface + thickness:
            a, b = t - step, t
            for _ in range(BISECTIONS):
                middle = HALF * (a + b)
                i, j = int(u0 + du * middle), int(v0 + dv * middle)
                if ONE / (iz0 + diz * middle) >= depth[j, i]:
                    b = middle
                else:
                    a = middle
            # s / z is linear in the picture, s the share of the ray's length.
            return b * iz1 / (iz0 + diz * b) * length
        before = now
    return -ONE


@device_function
def edge_fade(u, v, width, height, share):
    """Return 1 inside the picture, falling to 0 at its edge within `share` of its size."""
    from_side = min(u, np.float32(width) - u) / (share * np.float32(width))
    from_end = min(v, np.float32(height) - v) / (share * np.float32(height))
    return min(max(min(from_side, from_end), ZERO), ONE)
