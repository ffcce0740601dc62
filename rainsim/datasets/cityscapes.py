"""The layout of Cityscapes, as cityscapesScripts 2.3 and torchvision read it; one for each rain.

After cityscapesScripts (labels.py, csHelpers.py): leftImg8bit/SPLIT/CITY holds
CITY_SEQUENCE_FRAME_leftImg8bit.png, gtFine the same names with _gtFine_labelIds.png,
_gtFine_instanceIds.png (16 bits: id x 1000 + number for what has instances, else the id) and
_gtFine_labelTrainIds.png and _gtFine_color.png. There are no polygons. Views held out are in val.
"""

import numpy as np

from rainsim.datasets import kinds
from rainsim.datasets.data_files import PNG, PNG16, DataFile, condition
from rainsim.datasets.sample import depth_mm
from rainsim.render.labels import OTHER_CLASS
from rainsim.terrain.table import WATER

COLORS = np.frombuffer(bytes.fromhex(
    # Red, green and blue of Cityscapes' ids from 0 on.
    "000000 000000 000000 000000 000000 6f4a00 510051 804080 f423e8 faaaa0 e6968c 464646"
    "66669c be9999 b4a5b4 966464 96785a 999999 999999 faaa1e dcdc00 6b8e23 98fb98 4682b4"
    "dc143c ff0000 00008e 000046 003c64 00005a 00006e 005064 0000e6 770b20"
), np.uint8).reshape(-1, 3)  # fmt: skip


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    city = city_of(plan.name)
    split = "val" if sample.view.held_out else "train"
    name = f"{split}/{city}/{city}_000000_{sample.view.index:06d}"
    folder, ids = condition(sample.rate), label_ids(sample)
    yield DataFile(f"{folder}/leftImg8bit/{name}_leftImg8bit.png", PNG, sample.picture)
    gt = f"{folder}/gtFine/{name}_gtFine"
    yield DataFile(f"{gt}_labelIds.png", PNG, ids)
    yield DataFile(f"{gt}_labelTrainIds.png", PNG, kinds.TRAIN_TABLE[ids])
    yield DataFile(f"{gt}_color.png", PNG, COLORS[ids])
    yield DataFile(f"{gt}_instanceIds.png", PNG16, instance_ids(sample, ids))
    depth = depth_mm(sample.depth)
    yield DataFile(f"{folder}/depth/{name}_depth.png", PNG16, depth)


def city_of(name):
    """Return the name of a scene's city: letters and digits, as file names are split at _."""
    return "".join(c for c in name if c.isascii() and c.isalnum()) or "scene"


def label_ids(sample):
    """Return Cityscapes' ids (height, width), uint8: the user's labels, else ground and actors.

    A puddle counts as the road that it stands on.
    """
    if sample.labels is not None:
        own = kinds.class_of(sample.labels)
        ids = np.where(own <= kinds.LAST_ID, own, kinds.UNLABELED).astype(np.uint8)
        return with_actors(ids, sample, sample.labels == OTHER_CLASS)
    ids = kinds.GROUND_TABLE[np.minimum(sample.class_id, 255)]
    ids[(sample.class_id == WATER) & (sample.puddle_id > 0)] = kinds.ROAD
    return with_actors(ids, sample, True)


def with_actors(ids, sample, where):
    """Return Cityscapes' ids with those of the actors that a sample shows, within a mask."""
    for actor in sample.facts.get("actors", ()):
        ids[(sample.actor_id == actor["number"]) & where] = kinds.kind_of(actor["class"]).cityscapes
    return ids


def instance_ids(sample, ids):
    """Return Cityscapes' ids of instances, (height, width), uint16: an actor is an instance.

    So is what the user labels with class x 1000 + number. What has neither counts as a group: its
    id alone.
    """
    found = ids.astype(np.uint16)
    if sample.labels is not None:
        numbered = (sample.labels >= kinds.FIRST_WITH_INSTANCES * kinds.PER_CLASS) & (ids > 0)
        found[numbered] = sample.labels[numbered]
    if sample.actor_id is None:
        return found
    own = (sample.actor_id > 0) & (ids >= kinds.FIRST_WITH_INSTANCES)
    number = (sample.actor_id.astype(np.int64) - 1) % kinds.PER_CLASS
    return np.where(own, ids.astype(np.int64) * kinds.PER_CLASS + number, found).astype(np.uint16)
