"""The layout of ACDC: rainy pictures, labels, clear partners.

After Sakaridis et al. 2021 (ACDC) and its loaders: rgb_anon/rain/train/SEQUENCE holds
..._rgb_anon.png, gt/rain/train/SEQUENCE ..._gt_labelTrainIds.png and ..._gt_invIds.png, and the
clear partner of each is rgb_anon/rain/train_ref/SEQUENCE/..._rgb_ref_anon.png. A sequence is the
scene in one rain; its name ends in the severity. Views held out are in val and val_ref.
"""

from dataclasses import replace

import numpy as np

from rainsim.datasets.cityscapes import label_ids
from rainsim.datasets.data_files import PNG, PNG16, DataFile
from rainsim.datasets.kinds import IGNORED, TRAIN_TABLE, class_of
from rainsim.datasets.sample import depth_mm
from rainsim.render.labels import OTHER_CLASS


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    split = "val" if sample.view.held_out else "train"
    number = f"frame_{sample.view.index:06d}"
    if sample.rate > 0:
        name = sequence(plan.name, sample.rate)
        rgb, gt = (f"{kind}/rain/{split}/{name}/{name}_{number}" for kind in ("rgb_anon", "gt"))
        yield DataFile(f"{rgb}_rgb_anon.png", PNG, sample.picture)
        yield DataFile(f"{gt}_gt_labelTrainIds.png", PNG, train_ids(sample))
        yield DataFile(f"{gt}_gt_invIds.png", PNG, np.where(sample.keep, 0, 1).astype(np.uint8))
        yield DataFile(f"depth/rain/{split}/{name}/{name}_{number}_depth.png", PNG16,
                       depth_mm(sample.depth))  # fmt: skip
        return
    # Each rain has its own copy of the clear partner, where its loader looks for it.
    for rate in plan.rates:
        if rate > 0:
            name = sequence(plan.name, rate)
            place = f"rain/{split}_ref/{name}/{name}_{number}"
            yield DataFile(f"rgb_anon/{place}_rgb_ref_anon.png", PNG, sample.picture)
            yield DataFile(f"gt/{place}_gt_ref_labelTrainIds.png", PNG, train_ids(sample))


def sequence(name, rate):
    """Return the name of the sequence of a scene in a rain [mm/h]."""
    plain = "".join(c for c in name if c.isalnum()) or "scene"
    return f"{plain}{rate:g}mm"


def train_ids(sample):
    """Return the ids to train with, (height, width), uint8: the user's, or ground's; actors'.

    A puddle counts as the road that it stands on; water else is ignored, as Cityscapes knows none.
    """
    ids = TRAIN_TABLE[label_ids(replace(sample, labels=None))]
    if sample.labels is None:
        return ids
    actors = False if sample.actor_id is None else sample.actor_id > 0
    own = np.minimum(class_of(sample.labels), IGNORED).astype(np.uint8)
    return np.where(actors & (sample.labels == OTHER_CLASS), ids, own)
