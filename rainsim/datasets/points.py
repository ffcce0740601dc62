"""Points of a scene with colours, which trainers of splats start from, and their files."""

import numpy as np

from rainsim.constants import SH_0
from rainsim.sensors.point_files import ply_of

MOST_POINTS = 100_000
LEAST_OPACITY = 0.3  # of a splat that stands for a surface
POINT = [*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]


def points_of(scene, most=MOST_POINTS):
    """Return centres [m] (n, 3) of `most` solid splats, drawn evenly, and their colours, uint8."""
    solid = np.flatnonzero(scene.splats.opacity >= LEAST_OPACITY)
    if len(solid) > most:
        solid = np.sort(np.random.Generator(np.random.PCG64(0)).choice(solid, most, replace=False))
    places = scene.ground_frame.to_ground(scene.splats.position[solid].astype(np.float64))
    colors = np.clip(0.5 + SH_0 * scene.splats.sh[solid, 0], 0, 1) * 255
    return places.astype(np.float32), np.rint(colors).astype(np.uint8)


def ply_bytes(places, colors):
    """Return a binary PLY file of points: x, y, z as float, red, green, blue as uchar."""
    rows = np.empty(len(places), POINT)
    for name, values in zip(rows.dtype.names, (*places.T, *colors.T), strict=True):
        rows[name] = values
    return ply_of(rows)
