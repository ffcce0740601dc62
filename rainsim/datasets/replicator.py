"""The layout of Omniverse Replicator's BasicWriter: a flat folder for each rain.

After the pages of Replicator's output (https://docs.omniverse.nvidia.com/extensions/latest/
ext_replicator/annotators_details.html): rgb_0000.png; distance_to_image_plane_0000.npy and
distance_to_camera_0000.npy, float32, infinite where nothing is; semantic_segmentation_0000.png in
RGBA with semantic_segmentation_labels_0000.json; bounding_box_2d_tight_0000.npy with its labels,
bounding_box_3d_0000.npy of what moves;
camera_params_0000.json with matrices for row vectors, flattened, camera axes as OpenGL's.
"""

import hashlib

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.datasets.data_files import JSON, NPY, PNG, DataFile, condition
from rainsim.datasets.kinds import class_of
from rainsim.datasets.nerfstudio import opengl_pose
from rainsim.render.labels import OTHER_CLASS
from rainsim.terrain.table import class_table

APERTURE = 20.955  # mm, horizontal, USD's default
NEAR, FAR = 0.01, 1e6  # m
BOX = [("semanticId", "<u4"), ("x_min", "<i4"), ("y_min", "<i4"), ("x_max", "<i4"),
       ("y_max", "<i4"), ("occlusionRatio", "<f4")]  # fmt: skip
BOX_3D = [("semanticId", "<u4"), *((f"{axis}_{end}", "<f4") for end in ("min", "max")
          for axis in "xyz"), ("transform", "<f4", (4, 4)), ("occlusionRatio", "<f4")]  # fmt: skip
BOXED = ("puddles", "splashes")  # facts with boxes; semanticId counts from 0 in this order
BACKGROUND = (0, 0, 0, 0)


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    folder, number = condition(sample.rate), f"{sample.view.index:04d}"
    yield DataFile(f"{folder}/rgb_{number}.png", PNG, sample.picture)
    for name, values in (("image_plane", sample.depth), ("camera", sample.range)):
        yield DataFile(f"{folder}/distance_to_{name}_{number}.npy", NPY, values)
    colors, names = segmentation(sample, plan.names)
    yield DataFile(f"{folder}/semantic_segmentation_{number}.png", PNG, colors)
    yield DataFile(f"{folder}/semantic_segmentation_labels_{number}.json", JSON, names)
    boxes = boxes_of(sample.facts)
    yield DataFile(f"{folder}/bounding_box_2d_tight_{number}.npy", NPY, boxes)
    labels = {"0": {"class": "puddle"}, "1": {"class": "splash"}}
    kinds = actor_kinds(sample.facts)
    labels |= {str(number): {"class": kind} for kind, number in kinds.items()}
    yield DataFile(f"{folder}/bounding_box_2d_tight_labels_{number}.json", JSON, labels)
    if sample.actor_id is not None:
        boxes = boxes_in_space(sample.facts)
        yield DataFile(f"{folder}/bounding_box_3d_{number}.npy", NPY, boxes)
        names = {str(k): {"class": kind} for kind, k in kinds.items()}
        yield DataFile(f"{folder}/bounding_box_3d_labels_{number}.json", JSON, names)
    params = camera_params(sample.view)
    yield DataFile(f"{folder}/camera_params_{number}.json", JSON, params)


def segmentation(sample, names):
    """Return the colours (height, width, 4), uint8, of the classes, and the labels by colour."""
    ids = np.minimum(sample.class_id, OTHER_CLASS)
    table, labels = np.zeros((256, 4), np.uint8), {str(BACKGROUND): {"class": "BACKGROUND"}}
    for code in np.unique(ids):
        if code != OTHER_CLASS:
            table[code] = (*class_table().colors[code], 255)
            labels[str(tuple(int(c) for c in table[code]))] = {"class": names[str(code)]}
    colors = table[ids]
    if sample.labels is not None:
        own = class_of(sample.labels)
        for code in np.unique(own[own != OTHER_CLASS]).tolist():
            _paint(colors, labels, own == code, f"label_{code}")
    for actor in sample.facts.get("actors", ()):
        shown = sample.actor_id == actor["number"]
        if sample.labels is not None:
            shown &= sample.labels == OTHER_CLASS
        if shown.any():
            _paint(colors, labels, shown, actor["class"])
    return colors, labels


def _paint(colors, labels, where, name):
    """Give pixels the colour of a class by its name, from the name alone."""
    color = (*hashlib.blake2s(name.encode(), digest_size=3).digest(), 255)
    colors[where], labels[str(color)] = color, {"class": name}


def boxes_of(facts):
    """Return the boxes of puddles, splashes and actors; right and bottom pixels are within."""
    rows = []
    for number, kind in enumerate(BOXED):
        for entry in facts.get(kind, ()):
            left, top, right, bottom = entry["box"]
            rows.append((number, left, top, right - 1, bottom - 1, 0.0))
    kinds = actor_kinds(facts)
    for actor in facts.get("actors", ()):
        if actor["pixels"]:
            left, top, right, bottom = actor["box2d_seen"]
            box = left, top, right - 1, bottom - 1
            rows.append((kinds[actor["class"]], *box, actor.get("hidden") or 0.0))
    return np.array(rows, BOX)


def boxes_in_space(facts):
    """Return actors' boxes: extents in their frames [m], `transform` to the world (row vectors)."""
    rows, kinds = [], actor_kinds(facts)
    for actor in facts.get("actors", ()):
        if actor["pixels"]:
            box, transform = actor["box3d"], np.eye(4)
            turn = Rotation.from_quat(box["rotation"], scalar_first=True).as_matrix()
            transform[:3, :3], transform[3, :3] = turn.T, box["centre"]
            half = 0.5 * np.array(box["size"])
            rows.append((kinds[actor["class"]], *-half, *half, transform,
                         actor.get("hidden") or 0.0))  # fmt: skip
    return np.array(rows, BOX_3D)


def actor_kinds(facts):
    """Return the semanticId of each class of actors in a picture's facts, a dict."""
    kinds = sorted({actor["class"] for actor in facts.get("actors", ())})
    return {kind: number for number, kind in enumerate(kinds, start=len(BOXED))}


def camera_params(view):
    """Return what camera_params holds of a `View`, in metres."""
    camera, lens = view.camera, view.lens
    per_px = APERTURE / camera.width  # mm
    projection = np.zeros((4, 4))  # of columns, depth from 1 at NEAR to 0 at FAR
    projection[0, 0], projection[1, 1] = 2 * camera.fx / camera.width, 2 * camera.fy / camera.height
    projection[0, 2] = 1 - 2 * camera.cx / camera.width
    projection[1, 2] = 2 * camera.cy / camera.height - 1
    projection[2, 2], projection[2, 3] = NEAR / (FAR - NEAR), NEAR * FAR / (FAR - NEAR)
    projection[3, 2] = -1
    offset = [(camera.width / 2 - camera.cx) * per_px, (camera.cy - camera.height / 2) * per_px]
    return {
        "cameraModel": "pinhole" if lens is None else f"opencv{lens.model.removeprefix('opencv')}",
        "lensCoefficients": [] if lens is None else list(lens.values),
        "cameraAperture": [APERTURE, camera.height * per_px],
        "cameraApertureOffset": offset,
        "cameraFocalLength": camera.fx * per_px,
        "cameraNearFar": [NEAR, FAR],
        "cameraProjection": projection.T.ravel().tolist(),
        "cameraViewTransform": np.linalg.inv(opengl_pose(camera)).T.ravel().tolist(),
        "metersPerSceneUnit": 1.0,
        "renderProductResolution": [camera.width, camera.height],
    }
