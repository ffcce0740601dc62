"""The layout of COLMAP: images, a sparse model, masks and dense depth for each rain.

After COLMAP's format pages (https://colmap.github.io/format.html): cameras.bin, images.bin,
points3D.bin; a mask is named as its image with .png appended, black is left out; depth maps are
float32 after the text width&height&channels&. World is the ground frame in metres. Tracks say which
points which images see, by the depth of their pixels. Rigs have rigs.bin and frames.bin, as COLMAP
reads them from 3.12 on (reconstruction_io_binary.cc, commit 036535c).
"""

import struct

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.datasets.data_files import BYTES, PNG, DataFile, condition
from rainsim.datasets.kitti import camera_from_first, first_from_ground
from rainsim.scene.colmap import MODELS
from rainsim.scene.view import camera_points, image_point

NEAREST = 0.05  # m before the camera
WIDEST = 5.0  # slope off the axis up to which points are looked for
CAMERA = 0  # kind of a rig's sensor, by SensorType of COLMAP's sensor/models.h
SAME_DEPTH = 0.02  # of a point's depth, by which its pixel's may differ


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    folder, name = condition(sample.rate), f"{sample.view.name}.png"
    yield DataFile(f"{folder}/images/{name}", PNG, sample.picture)
    mask = np.where(sample.keep, 255, 0).astype(np.uint8)
    yield DataFile(f"{folder}/masks/{name}.png", PNG, mask)
    depth = depth_map(sample.depth)
    yield DataFile(f"{folder}/stereo/depth_maps/{name}.geometric.bin", BYTES, depth)


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set; `folder` has the samples' files, None for none.

    Depth is that of dry surfaces, so that one rain's depth maps say which points all views see.
    """
    seen = [observations(plan, view, _depth_in(folder, plan, view)) for view in plan.views]
    model = {
        "cameras.bin": cameras_bytes(plan.views), "images.bin": images_bytes(plan.views, seen),
        "points3D.bin": points_bytes(plan.points, plan.colors, plan.views, seen),
    }  # fmt: skip
    if plan.rig is not None:
        model |= {"rigs.bin": rigs_bytes(plan.rig, plan.views), "frames.bin": frames_bytes(plan)}
    for rate in plan.rates:
        for name, content in model.items():
            yield DataFile(f"{condition(rate)}/sparse/0/{name}", BYTES, content)


def _depth_in(folder, plan, view):
    """Return a view's depth map of the first rain, zero where nothing is known."""
    if folder is None:
        return np.zeros((view.camera.height, view.camera.width), np.float32)
    name = f"stereo/depth_maps/{view.name}.png.geometric.bin"
    data = (folder / condition(plan.rates[0]) / name).read_bytes()
    width, height, _, body = data.split(b"&", 3)
    return np.frombuffer(body, "<f4").reshape(int(height), int(width))


def observations(plan, view, depth):
    """Return numbers (k,) and places [px] of the plan's points at their pixel's depth."""
    camera = view.camera
    x, y, z = camera_points(camera, plan.points.astype(np.float64)).T
    ahead = z > NEAREST
    x, y = (np.where(ahead, part / np.where(ahead, z, 1), 0) for part in (x, y))
    reach = WIDEST if view.lens is None else view.lens.reach
    near = ahead & (np.hypot(x, y) < reach)
    x, y = (x, y) if view.lens is None else view.lens.distort(x, y)
    u, v = image_point(camera, x, y, 1.0)
    inside = near & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    number = np.flatnonzero(inside)
    here = depth[v[number].astype(np.int64), u[number].astype(np.int64)]
    number = number[np.abs(here - z[number]) < SAME_DEPTH * z[number]]
    return number, np.column_stack([u[number], v[number]])


def model_of(view):
    """Return COLMAP's name of a view's camera model, and its parameters."""
    camera, lens = view.camera, view.lens
    pinhole = (camera.fx, camera.fy, camera.cx, camera.cy)
    if lens is None:
        return "PINHOLE", pinhole
    if lens.model == "fisheye":
        return "OPENCV_FISHEYE", (*pinhole, *lens.values)
    if lens.model in ("division", "eucm"):
        return lens.model.upper(), (*pinhole, *lens.values)
    if len(lens.values) == 4 or lens.values[4] == 0:
        return "OPENCV", (*pinhole, *lens.values[:4])
    return "FULL_OPENCV", (*pinhole, *lens.values, 0.0, 0.0, 0.0)


def cameras_bytes(views):
    """Return cameras.bin: one camera for each view, or each of a rig, numbered from 1."""
    kinds = {camera_id(view, views): view for view in reversed(views)}
    parts = [struct.pack("<Q", len(kinds))]
    for number, view in sorted(kinds.items()):
        name, values = model_of(view)
        size = view.camera.width, view.camera.height
        parts.append(struct.pack("<iiQQ", number, MODELS[name][0], *size))
        parts.append(struct.pack(f"<{len(values)}d", *values))
    return b"".join(parts)


def camera_id(view, views):
    """Return the number of a view's camera: that of its first picture."""
    if view.mount is None:
        return view.index + 1
    return next(other.index for other in views if other.mount is view.mount) + 1


def rigs_bytes(rig, views):
    """Return rigs.bin: one rig, of which the first camera is the reference of all others.

    Numbers: rig, sensors; of each sensor its kind (0, a camera) and camera; of all but the first
    that a pose follows, and sensor_from_rig.
    """
    ids = [next(camera_id(v, views) for v in views if v.mount is s) for s in rig.cameras]
    parts = [struct.pack("<QIIiI", 1, 1, len(ids), CAMERA, ids[0])]
    for sensor, number in zip(rig.cameras[1:], ids[1:], strict=True):
        pose = _pose_bytes(camera_from_first(sensor, rig))
        parts.append(struct.pack("<iIB", CAMERA, number, 1) + pose)
    return b"".join(parts)


def frames_bytes(plan):
    """Return frames.bin: the pictures that the rig takes at one time are one frame."""
    frames = {}
    for view in plan.views:
        frames.setdefault(view.time, []).append(view)
    parts = [struct.pack("<Q", len(frames))]
    for number, (_, views) in enumerate(sorted(frames.items()), start=1):
        parts.append(struct.pack("<II", number, 1) + _pose_bytes(first_from_ground(views[0], plan)))
        parts.append(struct.pack("<I", len(views)))
        parts += [struct.pack("<iIQ", CAMERA, camera_id(v, plan.views), v.index + 1) for v in views]
    return b"".join(parts)


def _pose_bytes(matrix):
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return struct.pack("<7d", w, x, y, z, *matrix[:3, 3])


def images_bytes(views, seen):
    """Return images.bin: pose (quaternion with w first, translation), camera and name of each.

    `seen` has the `observations` of each view.
    """
    parts = [struct.pack("<Q", len(views))]
    for view, (number, place) in zip(views, seen, strict=True):
        pose = _pose_bytes(view.camera.camera_from_world)
        parts.append(struct.pack("<i", view.index + 1) + pose)
        parts.append(
            struct.pack("<i", camera_id(view, views)) + f"{view.name}.png".encode() + b"\0"
        )
        rows = np.zeros(len(number), [("place", "<f8", 2), ("point", "<u8")])
        rows["place"], rows["point"] = place, number + 1
        parts.append(struct.pack("<Q", len(rows)) + rows.tobytes())
    return b"".join(parts)


def points_bytes(places, colors, views, seen):
    """Return points3D.bin: number, place, colour, error 0 and track of each point.

    A track names the images that see the point, and which of their points it is. `seen` has the
    `observations` of each of the `views`.
    """
    kind = [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
    rows = np.zeros(len(places), kind)
    rows["id"], rows["xyz"], rows["rgb"] = np.arange(1, len(places) + 1), places, colors
    point = np.concatenate([number for number, _ in seen])
    track = np.zeros(len(point), [("image", "<i4"), ("which", "<i4")])
    track["image"] = np.repeat([view.index + 1 for view in views], [len(n) for n, _ in seen])
    track["which"] = np.concatenate([np.arange(len(number)) for number, _ in seen])
    track = track[np.argsort(point, kind="stable")]
    rows["track"] = np.bincount(point, minlength=len(places))
    ends = np.cumsum(rows["track"]).astype(np.int64)
    parts = [struct.pack("<Q", len(places))]
    for row, begin, end in zip(rows, ends - rows["track"].astype(np.int64), ends, strict=True):
        parts += [row.tobytes(), track[begin:end].tobytes()]
    return b"".join(parts)


def depth_map(depth):
    """Return a dense depth map as COLMAP's workspace has it; 0 where there is none."""
    height, width = depth.shape
    values = np.where(np.isfinite(depth), depth, 0).astype("<f4")
    return f"{width}&{height}&1&".encode() + values.tobytes()
