"""Point clouds as bytes: KITTI's .bin with SemanticKITTI's .label, PCD of PCL, and PLY.

KITTI: rows of float32 x, y, z, reflectance (development kit of its object benchmark).
SemanticKITTI: a uint32 a point, its class in the lower 16 bits, in the upper 16 the number of the
actor that it lies on. PCD and PLY have a field `node` where the scene has actors. PCD 0.7:
https://pointclouds.org/documentation/tutorials/pcd_file_format.html. Points are in the sensor's
frame in metres. Lost pulses have no row; in a PCD, which holds all pulses, they are NaN.
"""

import numpy as np

from rainsim.sensors.lidar_model import LOST

FIELDS = (("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("time", "<f4"),
          ("label", "<u4"))  # fmt: skip
PCD_KIND = {"f": "F", "u": "U"}
PLY_KIND = {"<f4": "float", "<u4": "uint", "|u1": "uchar"}


def kitti_bin(scan):
    """Return the bytes of a KITTI .bin: the echoes of a `Scan` in the order of their pulses."""
    back = scan.label != LOST
    return np.column_stack([scan.point, scan.reflectivity])[back].astype("<f4").tobytes()


def kitti_labels(scan):
    """Return the bytes of a SemanticKITTI .label: a uint32 for each row of the .bin."""
    label = scan.label.astype("<u4")
    if scan.actor is not None:
        label |= scan.actor.astype("<u4") << 16
    return label[scan.label != LOST].tobytes()


def fields_of(scan):
    """Return names and types of the values of a point."""
    return FIELDS if scan.actor is None else (*FIELDS, ("node", "<u4"))


def rows_of(scan, lost_too):
    """Return a structured array of `fields_of` a scan, with or without the lost pulses."""
    rows = np.empty(len(scan.point), list(fields_of(scan)))
    point = np.where((scan.label == LOST)[:, None], np.float32(np.nan), scan.point)
    for axis, name in enumerate("xyz"):
        rows[name] = point[:, axis]
    rows["intensity"], rows["time"], rows["label"] = scan.reflectivity, scan.time, scan.label
    if scan.actor is not None:
        rows["node"] = scan.actor
    return rows if lost_too else rows[scan.label != LOST]


def pcd_bytes(scan, channels):
    """Return a binary PCD of all pulses, columns by channels, lost ones as NaN."""
    rows = rows_of(scan, lost_too=True)
    width = len(rows) // channels
    names, kinds = zip(*fields_of(scan), strict=True)
    header = "\n".join([
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join('4' for _ in names)}",
        f"TYPE {' '.join(PCD_KIND[kind[1]] for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in names)}", f"WIDTH {width}", f"HEIGHT {channels}",
        "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(rows)}", "DATA binary", "",
    ])  # fmt: skip
    # A row of the file is a channel; pulses come column by column.
    return header.encode() + rows.reshape(width, channels).T.tobytes()


def ply_bytes(scan):
    """Return a binary PLY of the echoes."""
    return ply_of(rows_of(scan, lost_too=False))


def ply_of(rows):
    """Return a binary PLY of points, a structured array."""
    header = "\n".join([
        "ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}",
        *(f"property {PLY_KIND[kind]} {name}" for name, kind in rows.dtype.descr), "end_header", "",
    ])  # fmt: skip
    return header.encode() + rows.tobytes()
