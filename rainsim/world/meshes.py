"""Meshes of the ground and of its puddles, and the ground as a binary glTF."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter

from rainsim.io.files import replacing
from rainsim.numerics.srgb import linear
from rainsim.water.puddles import WET

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


class Ground(NamedTuple):
    """The ground at the cells' centres, in the ground frame.

    points, normals : float32 array (n, 3) [m]
    colors : float32 array (n, 3). Of the dry ground, linear.
    quads : int32 array (m, 4). Counter-clockwise seen from above.
    """

    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    quads: np.ndarray


class Water(NamedTuple):
    """The surface of the puddles at one time.

    points : float32 array (n, 3) [m]. Their heights are the level of the water.
    quads : int32 array (m, 4)
    depth : float32 array (n,) [m]
    flow : float32 array (n, 3) [m/s]. Velocity of the water, level.
    """

    points: np.ndarray
    quads: np.ndarray
    depth: np.ndarray
    flow: np.ndarray


def ground_mesh(terrain):
    """Return the `Ground` of a terrain, a vertex for each cell."""
    bed = terrain.bed.astype(np.float64)
    slope_y, slope_x = np.gradient(bed, terrain.grid.spacing)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(bed)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    quads = _quads(np.ones(bed.shape, bool))
    colors = linear(np.clip(terrain.color, 0, 1)).reshape(-1, 3).astype(np.float32)
    flat = normals.reshape(-1, 3).astype(np.float32)
    return Ground(_points(terrain.grid, terrain.bed), flat, colors, quads)


def water_mesh(terrain, depth, velocity):
    """Return the `Water` of puddles: of cells with a depth [m] of WET or more, and their rims.

    Beyond its rim the surface goes on level into the ground, or down to the thin water on it.
    """
    bed = terrain.bed.astype(np.float64)
    wet = depth >= WET
    level = np.where(wet, bed + depth, -np.inf)
    around = maximum_filter(level, 3, mode="nearest")
    height = np.where(wet, level, np.minimum(bed + depth, around))
    quads = _quads(wet)
    used = np.unique(quads)
    place = np.zeros(bed.size, np.int32)
    place[used] = np.arange(len(used))
    points = _points(terrain.grid, np.where(np.isfinite(height), height, 0.0))[used]
    flow = np.zeros((len(used), 3), np.float32)
    flow[:, :2] = velocity.reshape(2, -1).T[used]
    return Water(points, place[quads], depth.reshape(-1)[used].astype(np.float32), flow)


def write_glb(path, ground):
    """Write the `Ground` as a binary glTF, in metres with y up as glTF has it; needs trimesh."""
    import trimesh

    colors = np.round(ground.colors * 255).astype(np.uint8)
    triangles = ground.quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    mesh = trimesh.Trimesh(
        ground.points @ Y_UP.T, triangles, vertex_normals=ground.normals @ Y_UP.T,
        vertex_colors=np.column_stack([colors, np.full(len(colors), 255, np.uint8)]),
        process=False,
    )  # fmt: skip
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name="Ground", geom_name="Ground")
    data = scene.export(file_type="glb", include_normals=True)
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def _points(grid, height):
    x, y = grid.centres()
    points = np.empty((*grid.shape, 3), np.float32)
    points[..., 0], points[..., 1], points[..., 2] = x[None, :], y[:, None], height
    return points.reshape(-1, 3)


def _quads(chosen):
    """Return the squares between the centres of cells of which one or more are chosen."""
    some = chosen[:-1, :-1] | chosen[1:, :-1] | chosen[:-1, 1:] | chosen[1:, 1:]
    row, column = np.nonzero(some)
    first = (row * chosen.shape[1] + column).astype(np.int32)
    across = np.int32(chosen.shape[1])
    return np.stack([first, first + 1, first + across + 1, first + across], axis=1)
