"""Names and numbers that other data sets have for kinds of things and of ground.

Cityscapes: ids of cityscapesScripts' labels.py. KITTI: types of its object benchmark.
SemanticKITTI: labels of semantic-kitti.yaml of its API, standing and moving.
"""

from typing import NamedTuple

import numpy as np

from rainsim.terrain.table import DRAIN, GRASS, HARD, SOIL


class Kind(NamedTuple):
    """What Cityscapes, KITTI and SemanticKITTI (standing, moving) call an actor of a kind."""

    cityscapes: int
    kitti: str
    semantic: int
    moving: int


_CAR, _TRAM = Kind(26, "Car", 10, 252), Kind(31, "Tram", 16, 256)
_PERSON, _RIDER = Kind(24, "Pedestrian", 30, 254), Kind(25, "Cyclist", 31, 253)
KINDS = {
    "car": _CAR, "vehicle": _CAR, "van": _CAR._replace(kitti="Van"), "tram": _TRAM, "train": _TRAM,
    "truck": Kind(27, "Truck", 18, 258), "bus": Kind(28, "Truck", 13, 257),
    "pedestrian": _PERSON, "person": _PERSON, "cyclist": _RIDER, "rider": _RIDER,
    "bicycle": Kind(33, "Misc", 11, 11), "motorcycle": Kind(32, "Misc", 15, 15),
}  # fmt: skip
OTHER = Kind(5, "Misc", 99, 259)  # dynamic, and other objects
# Ids to train with of Cityscapes, by its ids; all others are ignored.
TRAIN_IDS = {7: 0, 8: 1, 11: 2, 12: 3, 13: 4, 17: 5, 19: 6, 20: 7, 21: 8, 22: 9, 23: 10, 24: 11,
             25: 12, 26: 13, 27: 14, 28: 15, 31: 16, 32: 17, 33: 18}  # fmt: skip
IGNORED = 255
UNLABELED, ROAD, TERRAIN = 0, 7, 22
LAST_ID, FIRST_WITH_INSTANCES = 33, 24
PER_CLASS = 1000  # instances that a class has room for, as Cityscapes numbers them
OUTLIER = 1  # of SemanticKITTI: what is no echo of the place that it seems to come from


def _table(numbers, other):
    """Return a table (256,) of numbers by id."""
    table = np.full(256, other, np.uint8)
    table[list(numbers)] = list(numbers.values())
    return table


TRAIN_TABLE = _table(TRAIN_IDS, IGNORED)
# By the class of the ground: ids of Cityscapes, and classes of SemanticKITTI.
GROUND_TABLE = _table({HARD: ROAD, DRAIN: ROAD, GRASS: TERRAIN, SOIL: TERRAIN}, UNLABELED)
SEMANTIC_TABLE = _table({HARD: 40, DRAIN: 40, GRASS: 72, SOIL: 72}, 0)


def class_of(own):
    """Return the classes of the user's ids, an array: id x 1000 + number is one of a class."""
    return np.where(own < PER_CLASS, own, own // PER_CLASS)


def kind_of(name):
    """Return the `Kind` of an actor's class by its name."""
    return KINDS.get(name.lower(), OTHER)
