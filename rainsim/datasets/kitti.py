"""The layout of KITTI: pictures, depth, flow and calibration, a folder for each rain.

After the development kits of KITTI (https://www.cvlibs.net/datasets/kitti): the flow benchmark of
2015 pairs training/image_2/000000_10.png with 000000_11.png and has flow_occ (all pixels) and
flow_noc (those that stay in view); depth is 256 a metre in 16 bits; calib has the projections P0 to
P3; poses are those of the odometry benchmark: world_from_camera relative to the first, 12 numbers a
line. The folders of the rains are named as rain-rendering's (Halder et al. 2019).
"""

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.datasets.data_files import PNG, PNG16, PNG48, TEXT, DataFile, condition
from rainsim.datasets.kinds import kind_of
from rainsim.datasets.sample import kitti_depth
from rainsim.render.labels import SEEN
from rainsim.scene.view import camera_points, image_point
from rainsim.sensors.rig import CAMERA_FROM_LIDAR

LEAST_DEPTH = 0.05  # m: a box with a nearer corner is beside the camera
CORNERS = 0.5 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
OCCLUDED = (0.1, 0.5)  # shares of an actor's pixels from which it is partly and largely occluded
COLOR, CAMERAS = 2, 4  # KITTI's left colour camera, and how many it has
AXES = np.column_stack([CAMERA_FROM_LIDAR, np.zeros(3)])


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    view, channel = sample.view, channel_of(sample.view, plan)
    training, number = f"{condition(sample.rate)}/training", f"{view.number:06d}"
    yield DataFile(f"{training}/image_{channel}/{number}_10.png", PNG, sample.picture)
    depth, place = kitti_depth(sample.depth), f"{training}/proj_depth/groundtruth"
    yield DataFile(f"{place}/image_{channel:02d}/{number}_10.png", PNG16, depth)
    if is_first(view, plan):
        yield DataFile(f"{training}/calib/{number}.txt", TEXT, calibration(view.camera, plan.rig))
    if sample.actor_id is not None:
        yield box_file(sample, plan)
    if sample.flow is None:
        return
    if view.number > 0:
        before = f"{view.number - 1:06d}_11.png"
        yield DataFile(f"{training}/image_{channel}/{before}", PNG, sample.picture)
    if channel == COLOR and not plan.is_last(view):
        flow, seen = sample.flow_picture, sample.flow_mask == SEEN
        yield DataFile(f"{training}/flow_occ/{number}_10.png", PNG48, flow)
        yield DataFile(f"{training}/flow_noc/{number}_10.png", PNG48, flow * seen[..., None])


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set."""
    for rate in plan.rates:
        yield DataFile(f"{condition(rate)}/training/poses.txt", TEXT, poses(plan.views))


def channel_of(view, plan):
    """Return the number of a view's camera: those of a rig are 2, 3, 0 and 1 in their order."""
    place = 0 if plan.rig is None else plan.rig.cameras.index(view.mount)
    return (COLOR + place) % CAMERAS


def is_first(view, plan):
    """Whether a view's camera is the one that places are given by: without a rig the only one."""
    return plan.rig is None or view.mount is plan.rig.cameras[0]


def camera_from_first(sensor, rig):
    """Return the matrix (4, 4) [m] that takes places of the rig's first camera to a sensor's."""
    return np.linalg.inv(sensor.vehicle_from_sensor) @ rig.cameras[0].vehicle_from_sensor


def first_from_ground(view, plan):
    """Return the matrix (4, 4) [m] of the first camera at the time of a view."""
    matrix = view.camera.camera_from_world
    if is_first(view, plan):
        return matrix
    return np.linalg.inv(camera_from_first(view.mount, plan.rig)) @ matrix


def box_file(sample, plan):
    """Return the `DataFile` of the boxes that a picture shows, see `object_labels`."""
    view = sample.view
    name = f"label_{channel_of(view, plan)}/{view.number:06d}.txt"
    actors = sample.facts.get("actors", ())
    boxes = object_labels(actors, view.camera, first_from_ground(view, plan))
    return DataFile(f"{condition(sample.rate)}/training/{name}", TEXT, boxes)


def object_labels(actors, camera, matrix=None):
    """Return a label_2 file: a line for each actor that the picture shows.

    After the object development kit: type, truncated, occluded, alpha, box in the picture, height,
    width and length [m], middle of the bottom in the camera's frame [m] and rotation about its y
    axis. A box is taken to stand upright in the camera's frame, as KITTI's do.

    actors : sequence of dict. See `rainsim.render.actor_labels.facts_of_actors`;
        `hidden`, the share of its pixels that other things hide, may be missing.
    matrix : float64 array (4, 4) [m], optional. From the ground frame to the
        camera that places are given by, by default this one.
    """
    return "".join(
        f"{kind_of(actor['class']).kitti} {cut:.2f} {hidden} {box}\n"
        for actor, cut, hidden, box in object_boxes(actors, camera, matrix)
    )


def object_boxes(actors, camera, matrix=None):
    """Yield each actor that a picture shows, its truncation, its occlusion and its box as text.

    The text has alpha, the box in the picture, size, place and rotation, see `object_labels`.
    """
    matrix = camera.camera_from_world if matrix is None else matrix
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

    shown : sequence of float [px]. The part that the picture shows: left, top,
        right and bottom.
    """
    x, y, z = camera_points(camera, corners).T
    if z.min() < LEAST_DEPTH:
        return 1.0
    u, v = image_point(camera, x, y, z)
    whole = np.ptp(u) * np.ptp(v)
    part = (shown[2] - shown[0]) * (shown[3] - shown[1])
    return float(np.clip(1 - part / max(whole, 1e-9), 0, 1))


def calibration(camera, rig=None):
    """Return a calib file: P0 to P3, no rectification, and the first lidar's place.

    Without a rig all four are this camera; in a rig those that it lacks are its first, from whose
    frame each projects.
    """
    projections, lidar = [_pinhole(camera)] * CAMERAS, AXES
    if rig is not None:
        own = [_pinhole(s.camera) @ camera_from_first(s, rig) for s in rig.cameras]
        own += [own[0]] * (CAMERAS - len(own))
        projections = own[COLOR:] + own[:COLOR]
        if rig.lidars:
            lidar = np.linalg.inv(camera_from_first(rig.lidars[0], rig))[:3]
    lines = [f"P{k}: {_numbers(matrix)}" for k, matrix in enumerate(projections)]
    lines += [f"R0_rect: {_numbers(np.eye(3))}", f"Tr_velo_to_cam: {_numbers(lidar)}"]
    return "\n".join([*lines, f"Tr_imu_to_velo: {_numbers(np.eye(3, 4))}"]) + "\n"


def _pinhole(camera):
    """Return a camera's projection (3, 4) [px] of its own frame."""
    # KITTI's image points have the middle of the first pixel at 0, 0.
    rows = (camera.fx, 0, camera.cx - 0.5, 0), (0, camera.fy, camera.cy - 0.5, 0), (0, 0, 1, 0)
    return np.array(rows, float)


def _numbers(matrix):
    return " ".join(f"{v:.12e}" for v in np.ravel(matrix) + 0.0)


def poses(views):
    """Return the poses of the odometry benchmark: the first is the identity."""
    views = [view for view in views if view.mount is views[0].mount]
    first = views[0].camera.camera_from_world
    lines = [
        " ".join(
            f"{v:.9e}" for v in (first @ np.linalg.inv(view.camera.camera_from_world))[:3].ravel()
        )
        for view in views
    ]
    return "\n".join(lines) + "\n"
