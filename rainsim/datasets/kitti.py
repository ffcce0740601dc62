"""The layout of KITTI: pictures, depth, flow and calibration, a folder for each rain.

After the development kits of KITTI (https://www.cvlibs.net/datasets/kitti): the flow benchmark of
2015 pairs training/image_2/000000_10.png with 000000_11.png and has flow_occ (all pixels) and
flow_noc (those that stay in view); depth is 256 a metre in 16 bits; calib has the projections P0 to
P3; poses are those of the odometry benchmark: world_from_camera relative to the first, 12 numbers a
line. The folders of the rains are named as rain-rendering's (Halder et al. 2019).
"""

from __future__ import annotations

import numpy as np

from rainsim.datasets.files import PNG, PNG16, PNG48, TEXT, DataFile
from rainsim.datasets.sample import condition, flow_known, kitti_depth, kitti_flow

SAME = " ".join(f"{v:.12e}" for v in np.eye(3).ravel())
SAME_PLACE = " ".join(f"{v:.12e}" for v in np.eye(3, 4).ravel())


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    training, number = f"{condition(sample.rate)}/training", f"{sample.view.index:06d}"
    yield DataFile(f"{training}/image_2/{number}_10.png", PNG, sample.picture)
    depth = kitti_depth(sample.depth)
    yield DataFile(f"{training}/proj_depth/groundtruth/image_02/{number}_10.png", PNG16, depth)
    yield DataFile(f"{training}/calib/{number}.txt", TEXT, calibration(sample.view.camera))
    if sample.flow is None:
        return
    if sample.view.index > 0:
        before = f"{sample.view.index - 1:06d}_11.png"
        yield DataFile(f"{training}/image_2/{before}", PNG, sample.picture)
    if sample.view.index < len(plan.views) - 1:
        for name, hidden_too in (("flow_occ", True), ("flow_noc", False)):
            flow = kitti_flow(sample.flow, flow_known(sample, hidden_too))
            yield DataFile(f"{training}/{name}/{number}_10.png", PNG48, flow)


def plan_files(plan):
    """Yield the `DataFile`s of the whole data set."""
    for rate in plan.rates:
        yield DataFile(f"{condition(rate)}/training/poses.txt", TEXT, poses(plan.views))


def calibration(camera):
    """Return a calib file: the same pinhole as P0 to P3, no rectification."""
    matrix = np.zeros((3, 4))
    matrix[0, 0], matrix[1, 1], matrix[2, 2] = camera.fx, camera.fy, 1
    # KITTI's image points have the middle of the first pixel at 0, 0.
    matrix[0, 2], matrix[1, 2] = camera.cx - 0.5, camera.cy - 0.5
    numbers = " ".join(f"{v:.12e}" for v in matrix.ravel())
    lines = [f"P{k}: {numbers}" for k in range(4)]
    lines += [f"R0_rect: {SAME}", f"Tr_velo_to_cam: {VELODYNE}", f"Tr_imu_to_velo: {SAME_PLACE}"]
    return "\n".join(lines) + "\n"


# The camera's axes x right, y down, z ahead from those of KITTI's lidar: x ahead, y left, z up.
VELODYNE = " ".join(f"{v:.12e}" for v in (0, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0))


def poses(views):
    """Return the poses of the odometry benchmark: the first is the identity."""
    first = views[0].camera.camera_from_world
    lines = [
        " ".join(
            f"{v:.9e}" for v in (first @ np.linalg.inv(view.camera.camera_from_world))[:3].ravel()
        )
        for view in views
    ]
    return "\n".join(lines) + "\n"
