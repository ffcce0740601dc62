"""Data sets: clear and rainy pictures with labels, in the layouts that loaders read."""

LAYOUTS = (  # modules of this room
    "nerfstudio", "colmap", "kitti", "kitti_object", "semantic_kitti", "acdc", "cityscapes",
    "replicator",
)  # fmt: skip
RIGGED = "nerfstudio", "colmap", "kitti", "kitti_object", "semantic_kitti"  # hold rigs
ONE_LENS = "nerfstudio"  # has one camera model for all views
OPENCV_LENSES = "nerfstudio", "replicator"  # whose camera models are OpenCV's alone
SCANNED = "kitti_object", "semantic_kitti"  # layouts that have clouds of a lidar
