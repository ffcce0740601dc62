"""Data sets: clear and rainy pictures with labels, in the layouts that loaders read."""

LAYOUTS = (
    "nerfstudio",
    "colmap",
    "kitti",
    "acdc",
    "cityscapes",
    "replicator",
)  # modules of this room
