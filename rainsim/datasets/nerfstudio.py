"""The layout of nerfstudio: a folder with transforms.json for each rain.

After nerfstudio's data parser of this name (nerfstudio_dataparser.py, Apache-2.0, commit 01595f7):
frames are sorted by their file's name; depth is 16-bit PNG, times 0.001 in the
poses' unit, which is why poses are in metres; masks are 0 where a pixel is to be left out, for all
frames or none; the splits name files, all three or none; the camera model is one for all frames.
"""

import numpy as np

from rainsim.datasets.data_files import BYTES, FOLDER, JSON, PNG, PNG16, DataFile, condition
from rainsim.datasets.points import ply_bytes
from rainsim.datasets.sample import depth_mm
from rainsim.datasets.splits import lists_of
from rainsim.scene.cameras import FLIP
from rainsim.sensors.optics import lens_keys


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    folder, name = condition(sample.rate), sample.view.name
    yield DataFile(f"{folder}/images/{name}.png", PNG, sample.picture)
    yield DataFile(f"{folder}/depths/{name}.png", PNG16, depth_mm(sample.depth))
    yield DataFile(f"{folder}/masks/{name}.png", PNG, np.where(sample.keep, 255, 0).astype("u1"))


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set."""
    for rate in plan.rates:
        folder = condition(rate)
        yield DataFile(f"{folder}/transforms.json", JSON, transforms(plan))
        for name in plan.partners if rate > 0 else ():
            yield DataFile(f"{folder}/transforms_{name}.json", JSON, transforms(plan, name))
        yield DataFile(f"{folder}/points.ply", BYTES, ply_bytes(plan.points, plan.colors))


def transforms(plan, partner=None):
    """Return what transforms.json holds: poses in the ground frame [m], OpenGL's camera axes.

    Its pictures are the rain's, or those of a partner, a name in `sample.PARTNERS`. Masks are those
    of the rain, but for the dry partner, of which all counts.
    """
    pictures = "images" if partner is None else f"{FOLDER}/{partner}"
    usual = {"camera_model": "OPENCV"}
    bent = [usual | lens_keys(view.lens) for view in plan.views]
    train, val, test = ([f"{pictures}/{view.name}.png" for view in part]
                        for part in lists_of(plan.views))  # fmt: skip
    frames = [{
        "file_path": f"{pictures}/{view.name}.png",
        "depth_file_path": f"depths/{view.name}.png",
        **({} if partner == "dry" else {"mask_path": f"masks/{view.name}.png"}),
        "w": view.camera.width, "h": view.camera.height,
        "fl_x": view.camera.fx, "fl_y": view.camera.fy,
        "cx": view.camera.cx, "cy": view.camera.cy,
        **{key: own[key] for key in own if key != "camera_model"},
        "transform_matrix": opengl_pose(view.camera).tolist(),
    } for view, own in zip(plan.views, bent, strict=True)]  # fmt: skip
    return {
        "camera_model": bent[0]["camera_model"],
        "orientation_override": "none",  # z is up already
        "ply_file_path": "points.ply",
        "train_filenames": train, "val_filenames": val, "test_filenames": test,
        "frames": frames,
    }  # fmt: skip


def opengl_pose(camera):
    """Return world_from_camera, (4, 4), of a camera with x right, y up and z back."""
    matrix = np.linalg.inv(camera.camera_from_world)
    matrix[:3, :3] *= FLIP
    return matrix
