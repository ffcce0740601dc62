"""The layout of KITTI: pictures, depth, flow and calibration, a folder for each rain.

After the development kits of KITTI (https://www.cvlibs.net/datasets/kitti): the flow benchmark of
2015 pairs training/image_2/000000_10.png with 000000_11.png and has flow_occ (all pixels) and
flow_noc (those that stay in view); depth is 256 a metre in 16 bits; calib has the projections P0 to
P3; poses are those of the odometry benchmark: world_from_camera relative to the first, 12 numbers a
line. The folders of the rains are named as rain-rendering's (Halder et al. 2019).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.datasets.data_files import PNG, PNG16, PNG48, TEXT, DataFile, condition
from rainsim.datasets.kinds import kind_of
from rainsim.datasets.sample import flow_known, kitti_depth, kitti_flow
from rainsim.scene.view import camera_points, image_point

LEAST_DEPTH = 0.05  # m: a box with a nearer corner is beside the camera
CORNERS = 0.5 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
OCCLUDED = (0.1, 0.5)  # shares of an actor's pixels from which it is partly and largely occluded
SAME = " ".join(f"{v:.12e}" for v in np.eye(3).ravel())
SAME_PLACE = " ".join(f"{v:.12e}" for v in np.eye(3, 4).ravel())


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    training, number = f"{condition(sample.rate)}/training", f"{sample.view.index:06d}"
    yield DataFile(f"{training}/image_2/{number}_10.png", PNG, sample.picture)
    depth = kitti_depth(sample.depth)
    yield DataFile(f"{training}/proj_depth/groundtruth/image_02/{number}_10.png", PNG16, depth)
    yield DataFile(f"{training}/calib/{number}.txt", TEXT, calibration(sample.view.camera))
    if sample.actor_id is not None:
        boxes = object_labels(sample.facts.get("actors", ()), sample.view.camera)
        yield DataFile(f"{training}/label_2/{number}.txt", TEXT, boxes)
    if sample.flow is None:
        return
    if sample.view.index > 0:
        before = f"{sample.view.index - 1:06d}_11.png"
        yield DataFile(f"{training}/image_2/{before}", PNG, sample.picture)
    if sample.view.index < len(plan.views) - 1:
        for name, hidden_too in (("flow_occ", True), ("flow_noc", False)):
            flow = kitti_flow(sample.flow, flow_known(sample, hidden_too))
            yield DataFile(f"{training}/{name}/{number}_10.png", PNG48, flow)


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set."""
    for rate in plan.rates:
        yield DataFile(f"{condition(rate)}/training/poses.txt", TEXT, poses(plan.views))


def object_labels(actors, camera):
    """Return a label_2 file: a line for each actor that the picture shows.

    After the object development kit: type, truncated, occluded, alpha, box in the picture, height,
    width and length [m], middle of the bottom in the camera's frame [m] and rotation about its y
    axis. A box is taken to stand upright in the camera's frame, as KITTI's do.

    Parameters
    ----------
    actors : sequence of dict
        See `rainsim.render.actor_labels.facts_of_actors`; `hidden`, the share of its pixels that
        other things hide, may be missing.
    camera : Camera
        In the ground frame.
    """
    return "".join(
        f"{kind_of(actor['class']).kitti} {cut:.2f} {hidden} {box}\n"
        for actor, cut, hidden, box in object_boxes(actors, camera)
    )


def object_boxes(actors, camera):
    """Yield each actor that a picture shows, its truncation, its occlusion and its box as text.

    The text has alpha, the box in the picture, size, place and rotation, see `object_labels`.
    """
    matrix = camera.camera_from_world
    for actor in actors:
        if not actor["pixels"]:
            continue
        box = actor["box3d"]
        size, centre = np.array(box["size"]), np.array(box["centre"])
        axes = Rotation.from_quat(box["rotation"], scalar_first=True).as_matrix()
        x, y, z = matrix[:3, :3] @ (centre - 0.5 * size[2] * axes[:, 2]) + matrix[:3, 3]
        ahead = matrix[:3, :3] @ axes[:, 0]
        turn = float(np.arctan2(-ahead[2], ahead[0]))
        alpha = (turn - np.arctan2(x, z) + np.pi) % (2 * np.pi) - np.pi
        corners = centre + (CORNERS * size) @ axes.T
        shown = actor["box2d"] or actor["box2d_seen"]
        numbers = (alpha, *(v - 0.5 for v in shown), size[2], size[1], size[0], x, y, z, turn)
        cut = truncation(corners, shown, camera)
        yield actor, cut, occlusion(actor.get("hidden")), " ".join(f"{v:.4f}" for v in numbers)


def occlusion(hidden):
    """Return KITTI's level of occlusion: 0 none, 1 partly, 2 largely, 3 not known.

    KITTI's were set by eye; here from `hidden`, the share of an actor's pixels that others hide.
    """
    return 3 if hidden is None else int(np.searchsorted(OCCLUDED, hidden, side="right"))


def truncation(corners, shown, camera):
    """Return the share of a box's picture that lies beyond the edges; 1 if it is beside the camera.

    Parameters
    ----------
    corners : ndarray of shape (8, 3) [m]
        In the ground frame.
    shown : sequence of float [px]
        The part that the picture shows: left, top, right and bottom.
    camera : Camera
        In the ground frame.
    """
    x, y, z = camera_points(camera, corners).T
    if z.min() < LEAST_DEPTH:
        return 1.0
    u, v = image_point(camera, x, y, z)
    whole = np.ptp(u) * np.ptp(v)
    part = (shown[2] - shown[0]) * (shown[3] - shown[1])
    return float(np.clip(1 - part / max(whole, 1e-9), 0, 1))


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
CAMERA_FROM_LIDAR = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], float)
VELODYNE = " ".join(f"{v:.12e}" for v in np.column_stack([CAMERA_FROM_LIDAR, np.zeros(3)]).ravel())


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
