"""The layout of COLMAP: images, a sparse model, masks and dense depth for each rain.

After COLMAP's format pages (https://colmap.github.io/format.html): cameras.bin, images.bin,
points3D.bin; a mask is named as its image with .png appended, black is left out; depth maps are
float32 after the text width&height&channels&. World is the ground frame in metres.
"""

from __future__ import annotations

import struct

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.datasets.data_files import BYTES, PNG, DataFile, condition
from rainsim.scene.colmap import MODELS


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    folder, name = condition(sample.rate), f"{sample.view.name}.png"
    yield DataFile(f"{folder}/images/{name}", PNG, sample.picture)
    mask = np.where(sample.keep, 255, 0).astype(np.uint8)
    yield DataFile(f"{folder}/masks/{name}.png", PNG, mask)
    depth = depth_map(sample.depth)
    yield DataFile(f"{folder}/stereo/depth_maps/{name}.geometric.bin", BYTES, depth)


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set."""
    model = {
        "cameras.bin": cameras_bytes(plan.views), "images.bin": images_bytes(plan.views),
        "points3D.bin": points_bytes(plan.points, plan.colors),
    }  # fmt: skip
    for rate in plan.rates:
        for name, content in model.items():
            yield DataFile(f"{condition(rate)}/sparse/0/{name}", BYTES, content)


def model_of(view):
    """Return COLMAP's name of a view's camera model, and its parameters."""
    camera, lens = view.camera, view.lens
    pinhole = (camera.fx, camera.fy, camera.cx, camera.cy)
    if lens is None:
        return "PINHOLE", pinhole
    if lens.model == "fisheye":
        return "OPENCV_FISHEYE", (*pinhole, *lens.values)
    if len(lens.values) == 4 or lens.values[4] == 0:
        return "OPENCV", (*pinhole, *lens.values[:4])
    return "FULL_OPENCV", (*pinhole, *lens.values, 0.0, 0.0, 0.0)


def cameras_bytes(views):
    """Return cameras.bin: one camera for each view, numbered from 1."""
    parts = [struct.pack("<Q", len(views))]
    for view in views:
        name, values = model_of(view)
        size = view.camera.width, view.camera.height
        parts.append(struct.pack("<iiQQ", view.index + 1, MODELS[name][0], *size))
        parts.append(struct.pack(f"<{len(values)}d", *values))
    return b"".join(parts)


def images_bytes(views):
    """Return images.bin: pose (quaternion with w first, translation), camera and name of each."""
    parts = [struct.pack("<Q", len(views))]
    for view in views:
        matrix = view.camera.camera_from_world
        x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
        parts.append(struct.pack("<i7d", view.index + 1, w, x, y, z, *matrix[:3, 3]))
        parts.append(struct.pack("<i", view.index + 1) + f"{view.name}.png".encode() + b"\0")
        parts.append(struct.pack("<Q", 0))  # no observed points
    return b"".join(parts)


def points_bytes(places, colors):
    """Return points3D.bin: number, place, colour, error 0 and an empty track of each point."""
    kind = [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
    rows = np.zeros(len(places), kind)
    rows["id"], rows["xyz"], rows["rgb"] = np.arange(1, len(places) + 1), places, colors
    return struct.pack("<Q", len(places)) + rows.tobytes()


def depth_map(depth):
    """Return a dense depth map as COLMAP's workspace has it; 0 where there is none."""
    height, width = depth.shape
    values = np.where(np.isfinite(depth), depth, 0).astype("<f4")
    return f"{width}&{height}&1&".encode() + values.tobytes()
