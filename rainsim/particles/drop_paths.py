"""Light of drops along their paths: which pixels a drop crosses while the shutter is open."""

import numpy as np

from rainsim.jit import lean_function, serial_kernel
from rainsim.particles.line_raster import NEAR

SAMPLES = 24  # places on a drop's path at which its motion and its depth are recorded
WEIGHT, DEPTH, RIGHT, DOWN = range(4)  # what a pixel gathers, see `gather_paths`


def path_sums(lines, duration, cameras, opened, depth, far, between=(0.0, np.inf)):
    """Return what each pixel gathers of the drops whose paths cross it.

    lines : float64 array (n, 7). Place [m] and velocity [m/s] in the ground
        frame, and diameter [m] of each drop.
    duration : float [s]. From the first to the second camera.
    cameras : tuple of Camera. At the start and at the end of the duration, in the
        ground frame.
    opened : float. Share of the duration while the shutter is open.
    depth : float32 array (height, width) [m]. Places behind it are left out, as
        are those beyond `far` [m].
    far : float [m]
    between : tuple of two float [m]. Depths that count, the first and not the
        second.
    Returns float64 array (4, height * width). WEIGHT, the sum of the squares of
        visual angles; and the sums, with that weight, of the DEPTH [m] and of the
        motion in the duration, RIGHT and DOWN [px].
    """
    sums = np.zeros((4, depth.size))
    start, end = cameras
    lens = np.array([start.fx, start.fy, start.cx, start.cy, end.fx, end.fy, end.cx, end.cy])
    place, stop = (np.ascontiguousarray(camera.camera_from_world[:3]) for camera in cameras)
    limits = np.array([duration, opened, far, *between], np.float64)
    gather_paths(np.ascontiguousarray(lines), place, stop, lens, limits, depth, sums)
    return sums


@serial_kernel
def gather_paths(lines, start, end, lens, limits, depth, sums_out):
    """Add up what pixels gather, see `path_sums`; the arrays of cameras are (3, 4)."""
    height, width = depth.shape
    duration, opened, far, nearest, farthest = limits
    for n in range(len(lines)):
        x, y, z = lines[n, 0], lines[n, 1], lines[n, 2]
        u, v, first = _in_camera(start, x, y, z)
        if not first > NEAR:
            continue
        u, v = lens[0] * u / first + lens[2], lens[1] * v / first + lens[3]
        right, down, last = _in_camera(
            end, x + duration * lines[n, 3], y + duration * lines[n, 4], z + duration * lines[n, 5]
        )
        if not last > NEAR:
            continue
        right, down = lens[4] * right / last + lens[6] - u, lens[5] * down / last + lens[7] - v
        farther = last - first
        # A path that stays on one side of the picture crosses none of its pixels.
        a, b = u + opened * right, v + opened * down
        if max(u, a) < 0 or min(u, a) >= width or max(v, b) < 0 or min(v, b) >= height:
            continue
        cover = (lines[n, 6] / first) ** 2
        for k in range(SAMPLES):
            part = opened * (k + 0.5) / SAMPLES
            a, b, away = u + part * right, v + part * down, first + part * farther
            if not (0 <= a < width and 0 <= b < height and nearest <= away < min(far, farthest)):
                continue
            row, column = int(b), int(a)
            if away < depth[row, column]:
                pixel = row * width + column
                sums_out[WEIGHT, pixel] += cover
                sums_out[DEPTH, pixel] += cover * away
                sums_out[RIGHT, pixel] += cover * right
                sums_out[DOWN, pixel] += cover * down


@lean_function
def _in_camera(pose, x, y, z):
    """Return a place in the frame of a camera whose pose is (3, 4)."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )
