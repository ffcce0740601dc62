"""Which parts of a big capture a camera needs, and how fine.

The choice depends on the camera, the index and two settings alone, never on what was drawn before:
a frame by itself is the same as in a sequence.
"""

import numpy as np

from rainsim.scene.formats.streamed import NONE
from rainsim.scene.pages import levels_at
from rainsim.scene.view import finest, lens_array
from rainsim.splatting.project import NO_PLANE, Frustum, find_chunks

COARSER = 2**0.5  # times the threshold, until the choice fits into memory


def chosen_levels(tree, camera, near, threshold, most, plane=None):
    """Return the level at which each leaf is drawn, NONE where it is out of the picture.

    A level is coarse enough to be seen where the cells that it was merged to are larger than the
    threshold [px] in the picture, at the nearest point of the leaf's box; 0 draws the finest level
    everywhere. A choice of more than `most` splats raises the threshold by steps until they fit:
    the one that was used is returned, too. The camera is in the capture frame and may be mirrored;
    splats whose centres are nearer than `near` [capture units] are not drawn; `plane` is that of
    `Rasterizer.draw`.
    """
    seen = seen_leaves(tree, camera, near, plane)
    size = pixels_per_unit(tree.box, camera, near)
    raised = max(threshold, 0.0)
    while True:
        levels = coarsest_levels(tree, tree.side * size[:, None] <= raised)
        count = tree.count[np.arange(len(levels)), levels][seen].sum()
        if count <= most or (levels[seen] == tree.levels - 1).all() or raised > 1e6:
            return np.where(seen, levels, NONE), raised
        raised = max(raised * COARSER, 0.25)


def coarsest_levels(tree, is_fine):
    """Return the coarsest level of each leaf of those that are fine enough (leaves, levels)."""
    is_fine[:, 0] = True
    return levels_at(tree, tree.levels - 1 - is_fine[:, ::-1].argmax(axis=1))


def pixels_per_unit(box, camera, near):
    """Return how many pixels one unit of length takes at the nearest point of boxes (n, 6)."""
    focal = finest(camera)
    if camera.orthographic:
        return np.full(len(box), focal)
    eye = camera.position
    away = np.maximum(np.maximum(box[:, :3] - eye, eye - box[:, 3:]), 0)
    return focal / np.maximum(np.linalg.norm(away, axis=1), near)


def seen_leaves(tree, camera, near, plane=None):
    """Return which leaves may touch the picture of a camera, ndarray of shape (leaves,), bool."""
    lens = lens_array(camera)
    frustum = Frustum(
        np.ascontiguousarray(camera.camera_from_world, np.float32), lens,
        np.array([camera.width, camera.height], np.float32), np.float32(near),
        NO_PLANE if plane is None else np.asarray(plane, np.float32), bool(camera.orthographic),
    )  # fmt: skip
    seen = np.empty(len(tree.box), np.bool_)
    find_chunks(tree.box, frustum, seen)
    return seen
