"""The user's own labels: ids of splats, or masks of the capture's pictures carried over to splats.

A label belongs to a splat. A picture's pixel has the label of the splat at which half of its light
is stopped. Masks vote: each of their pixels votes for its id, for the splat that it shows; splats
that no mask shows have the id of the nearest splat that has one. An actor that moves has one label.

Of a capture in chunks the splats of the finest level have labels, numbered as `FinestNumbers` says.
"""

import numpy as np
from scipy.spatial import cKDTree

from rainsim.actors.actor import MOST_LABEL
from rainsim.errors import InputError
from rainsim.io import images
from rainsim.io.arrays import npy_header
from rainsim.io.files import require_file
from rainsim.lod.numbers import FinestNumbers
from rainsim.lod.paged import rasterizer_of_scene
from rainsim.render.labels import OTHER_CLASS

NEAR = 0.05  # m
REACH = 0.1  # m from a lidar's point, beyond which no splat is taken for what it met
NEAREST = 0.5  # m from the next labelled splat, beyond which a splat has no label


class UserLabels:
    """Labels of a scene's splats: the id of each, (n,), uint16.

    Of a scene in chunks ids are by the numbers of `FinestNumbers`, and `detail` and `memory` of
    `render` hold.
    """

    def __init__(self, scene, ids, render):
        self.ids, self._scene, self._tree = ids, scene, None
        self._of_actors = np.array([OTHER_CLASS, *(a.label for a in scene.actors)], np.uint16)
        self._near = NEAR / scene.ground_frame.meters_per_unit
        self._rasterizer = _numbered_rasterizer(scene, render)

    def picture(self, camera, actor=None):
        """Return the labels that a camera sees, uint16; pixels of actors have theirs."""
        hit = self._rasterizer.draw(camera, self._near, hit=True).hit
        labels = np.where(hit >= 0, self.ids[np.maximum(hit, 0)], np.uint16(OTHER_CLASS))
        return labels if actor is None else np.where(actor > 0, self._of_actors[actor], labels)

    def of_points(self, places):
        """Return the ids of points (n, 3) [m] by the nearest splat; OTHER_CLASS for none."""
        if self._scene.pages is not None:
            return np.full(len(places), OTHER_CLASS, np.uint16)
        frame = self._scene.ground_frame
        if self._tree is None:
            self._tree = cKDTree(self._scene.splats.position)
        away, which = self._tree.query(
            frame.to_capture(places), distance_upper_bound=REACH / frame.meters_per_unit
        )
        found = np.isfinite(away)
        return np.where(found, self.ids[np.where(found, which, 0)], np.uint16(OTHER_CLASS))


def read_labels(path, scene, render):
    """Return the `UserLabels` of a file of ids by splat (.npy) or of a folder of masks (.png).

    Masks are named as the capture's cameras and hold an id in each pixel; 255 is no label. `detail`
    and `memory` of `render` hold for a scene in chunks. InputError if the ids do not fit the scene,
    or no mask belongs to a camera.
    """
    numbers = None if scene.pages is None else FinestNumbers(scene.pages)
    count = len(scene.splats) if numbers is None else numbers.count
    masks = path.is_dir()
    ids = _from_masks(path, scene, count, render) if masks else _from_file(path, count)
    return UserLabels(scene, ids, render)


def _numbered_rasterizer(scene, render):
    """Return what draws a scene and names the splats that pixels show."""
    if scene.pages is None:
        return rasterizer_of_scene(scene, render)
    return rasterizer_of_scene(scene, render, numbers_of=FinestNumbers(scene.pages).of_run)


def _from_file(path, count):
    remedy = (
        f"give an .npy of {count} whole numbers from 0 to {MOST_LABEL}, one a splat, or a folder"
    )
    try:
        with open(require_file(path, "a file of labels", remedy), "rb") as file:
            shape, dtype = npy_header(file)  # before memory is taken for what it promises
            fits = dtype.kind in "iu" and shape == (count,)
            ids = np.fromfile(file, dtype, count) if fits else np.zeros(0, int)
    except InputError:
        raise
    except Exception as error:  # numpy raises whatever a damaged header leads to
        text = f"labels {path} cannot be read ({type(error).__name__}: {error}); {remedy}"
        raise InputError(text) from None
    if len(ids) != count or ids.min() < 0 or ids.max() > MOST_LABEL:
        values = f", cut or beyond 0 to {MOST_LABEL}" if fits else ""
        raise InputError(
            f"labels {path} are {dtype} of shape {shape}{values}; they must fit the scene's "
            f"splats; {remedy}"
        )
    return ids.astype(np.uint16)


def _from_masks(folder, scene, count, render):
    files = {p.stem: p for p in sorted(folder.glob("*.png"))}
    named = [(c, files[n]) for c in scene.cameras for n in (c.name, c.name.rpartition(".")[0])
             if n in files]  # fmt: skip
    if not named:
        raise InputError(
            f"no picture in {folder} is named as one of the scene's cameras; masks must be PNGs "
            f"such as {scene.cameras[0].name if scene.cameras else 'CAMERA'}.png; rename them"
        )
    rasterizer, shown, given = _numbered_rasterizer(scene, render), [], []
    near = NEAR / scene.ground_frame.meters_per_unit
    for camera, path in named:
        mask = images.read_image(path)
        if mask.ndim != 2 or mask.dtype.kind not in "ui":
            raise InputError(f"mask {path} has shape {mask.shape}; it must be grey, an id a pixel")
        hit = rasterizer.draw(camera.resized(mask.shape[1], mask.shape[0]), near, hit=True).hit
        seen = (hit >= 0) & (mask != OTHER_CLASS)
        shown.append(hit[seen].astype(np.int64))
        given.append(mask[seen].astype(np.int64))
    shown, given = np.concatenate(shown), np.concatenate(given)
    if not len(shown):
        raise InputError(f"the masks in {folder} label nothing but 255; give an id other than 255")
    ids, voted = np.full(count, OTHER_CLASS, np.uint16), np.zeros(count, np.bool_)
    key, votes = np.unique(shown * (MOST_LABEL + 1) + given, return_counts=True)
    # Each splat's last entry has the most votes, and of equal ones the least id.
    order = np.lexsort((-(key % (MOST_LABEL + 1)), votes, key // (MOST_LABEL + 1)))
    splat = key[order] // (MOST_LABEL + 1)
    ids[splat], voted[splat] = key[order] % (MOST_LABEL + 1), True
    _spread(scene, ids, voted)
    return ids


def _spread(scene, ids, voted):
    """Give splats without a vote the id of the nearest one that has one, if it is near."""
    unit = scene.ground_frame.meters_per_unit
    if scene.pages is None:
        positions = scene.splats.position
        labelled, parts = positions[voted], [np.arange(len(ids))]
        position_of = positions.__getitem__
    else:
        numbers = FinestNumbers(scene.pages)
        position_of, parts = numbers.positions, numbers.runs()
        labelled = position_of(np.flatnonzero(voted))
    tree, known = cKDTree(labelled), ids[voted]
    for part in parts:
        part = part[~voted[part]]
        away, nearest = tree.query(position_of(part))
        close = away * unit < NEAREST
        ids[part] = np.where(close, known[nearest], np.uint16(OTHER_CLASS))
