"""Data sets: clear and rainy pictures with labels, in the layouts that loaders read."""

LAYOUTS = (  # modules of this room
    "nerfstudio", "colmap", "kitti", "kitti_object", "semantic_kitti", "acdc", "cityscapes",
    "replicator",
)  # fmt: skip
SCANNED = "kitti_object", "semantic_kitti"  # layouts that have clouds of a lidar
