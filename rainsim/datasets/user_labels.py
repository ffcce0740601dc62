"""The user's own labels: ids of splats, or masks of the capture's pictures carried over to splats.

A label belongs to a splat. A picture's pixel has the label of the splat at which half of its light
is stopped. Masks vote: each of their pixels votes for its id, for the splat that it shows; splats
that no mask shows have the id of the nearest splat that has one. A node that moves has one label.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from rainsim.errors import InputError
from rainsim.io import images
from rainsim.raster import Rasterizer, prepare
from rainsim.render.labels import OTHER_CLASS
from rainsim.scene.actors import MOST_LABEL
from rainsim.scene.pages import require_whole

NEAR = 0.05  # m
NEAREST = 0.5  # m from the next labelled splat, beyond which a splat has no label


class UserLabels:
    """Labels of a scene's splats.

    Parameters
    ----------
    scene : Scene
    ids : ndarray of shape (n,), uint16
    """

    def __init__(self, scene, ids):
        self.ids = ids
        self._of_nodes = np.array([OTHER_CLASS, *(a.label for a in scene.actors)], np.uint16)
        self._near = NEAR / scene.ground_frame.meters_per_unit
        self._rasterizer = Rasterizer(prepare(scene.splats))

    def picture(self, camera, node=None):
        """Return the labels that a camera (capture frame) sees, uint16; OTHER_CLASS for none.

        `node`, ndarray of shape (height, width): the layer `actor_id`. Its pixels have the labels
        of their nodes.
        """
        hit = self._rasterizer.draw(camera, self._near, hit=True).hit
        labels = np.where(hit >= 0, self.ids[np.maximum(hit, 0)], np.uint16(OTHER_CLASS))
        return labels if node is None else np.where(node > 0, self._of_nodes[node], labels)


def read_labels(path, scene):
    """Return the `UserLabels` of a file of ids by splat (.npy) or of a folder of masks (.png).

    Parameters
    ----------
    path : Path
        A folder's masks are named as the capture's cameras and hold an id in each pixel; 255 is
        no label.
    scene : Scene

    Raises
    ------
    InputError
        If the ids do not fit the scene, or no mask belongs to a camera.
    """
    require_whole(scene, "export with labels of splats", "leave out --labels")
    ids = _from_masks(path, scene) if path.is_dir() else _from_file(path, len(scene.splats))
    return UserLabels(scene, ids)


def _from_file(path, count):
    remedy = (
        f"give an .npy of {count} whole numbers from 0 to {MOST_LABEL}, one a splat, or a folder"
    )
    try:
        ids = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"labels {path} cannot be read ({error}); {remedy}") from None
    whole = isinstance(ids, np.ndarray) and ids.dtype.kind in "iu"
    if not whole or ids.shape != (count,) or ids.min() < 0 or ids.max() > MOST_LABEL:
        shown = f"{ids.dtype} of shape {ids.shape}" if isinstance(ids, np.ndarray) else "no array"
        raise InputError(f"labels {path} are {shown}; they must fit the scene's splats; {remedy}")
    return ids.astype(np.uint16)


def _from_masks(folder, scene):
    files = {p.stem: p for p in sorted(folder.glob("*.png"))}
    named = [(c, files[n]) for c in scene.cameras for n in (c.name, c.name.rpartition(".")[0])
             if n in files]  # fmt: skip
    if not named:
        raise InputError(
            f"no picture in {folder} is named as one of the scene's cameras; masks must be PNGs "
            f"such as {scene.cameras[0].name if scene.cameras else 'CAMERA'}.png; rename them"
        )
    rasterizer, votes = Rasterizer(prepare(scene.splats)), {}
    near = NEAR / scene.ground_frame.meters_per_unit
    for camera, path in named:
        mask = images.read_image(path)
        if mask.ndim != 2 or mask.dtype.kind not in "ui":
            raise InputError(f"mask {path} has shape {mask.shape}; it must be grey, an id a pixel")
        hit = rasterizer.draw(camera.resized(mask.shape[1], mask.shape[0]), near, hit=True).hit
        seen = (hit >= 0) & (mask != OTHER_CLASS)
        for value in np.unique(mask[seen]):
            count = np.bincount(hit[seen & (mask == value)], minlength=len(scene.splats))
            votes[int(value)] = votes.get(int(value), 0) + count
    if not votes:
        raise InputError(f"the masks in {folder} label nothing but 255; give an id other than 255")
    values = np.array(sorted(votes), np.uint16)
    table = np.stack([votes[int(value)] for value in values])
    ids, voted = values[table.argmax(axis=0)], table.any(axis=0)
    ids[~voted] = OTHER_CLASS
    position = scene.splats.position
    away, nearest = cKDTree(position[voted]).query(position[~voted])
    found = np.where(away * scene.ground_frame.meters_per_unit < NEAREST, ids[voted][nearest],
                     np.uint16(OTHER_CLASS))  # fmt: skip
    ids[~voted] = found
    return ids
