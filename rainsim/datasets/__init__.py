"""Data sets: clear and rainy pictures with labels, in the layouts that loaders read."""

LAYOUTS = (  # modules of this room
    "nerfstudio", "colmap", "kitti", "kitti_object", "acdc", "cityscapes", "replicator"
)  # fmt: skip
SCANNED = "kitti_object"  # the layout that has clouds of a lidar
