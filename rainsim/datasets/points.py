"""Points of a scene with colours, which trainers of splats start from, and their files."""

import numpy as np

from rainsim.constants import SH_0

MOST_POINTS = 100_000
LEAST_OPACITY = 0.3  # of a splat that stands for a surface


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
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(places)}\n"
        + "".join(f"property float {axis}\n" for axis in "xyz")
        + "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
        + "end_header\n"
    )
    rows = np.empty(len(places), [("place", "<f4", 3), ("color", "u1", 3)])
    rows["place"], rows["color"] = places, colors
    return header.encode() + rows.tobytes()
