"""The layout of SemanticKITTI: a sequence of clouds with labels, poses and times; one a rain.

After its tools (semantic-kitti-api: generate_sequential.py, auxiliary/laserscan.py), which take the
folder of a rain as the data set: sequences/00 has velodyne/000000.bin, labels/000000.label,
image_2/000000.png, poses.txt of the camera, relative to the first, calib.txt with Tr from the
lidar's axes to the camera's, and times.txt.
"""

from __future__ import annotations

from rainsim.datasets.data_files import BYTES, PNG, TEXT, DataFile, condition
from rainsim.datasets.kitti import VELODYNE, calibration, poses

PROJECTIONS = 4  # lines P0 to P3 of a calibration


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    place, number = _sequence(sample.rate), f"{sample.view.index:06d}"
    yield DataFile(f"{place}/image_2/{number}.png", PNG, sample.picture)
    if sample.cloud is not None:
        points, labels = sample.cloud
        yield DataFile(f"{place}/velodyne/{number}.bin", BYTES, points.tobytes())
        yield DataFile(f"{place}/labels/{number}.label", BYTES, labels.tobytes())


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set."""
    lines = calibration(plan.views[0].camera).splitlines()[:PROJECTIONS]
    calib = "".join(f"{line}\n" for line in (*lines, f"Tr: {VELODYNE}"))
    times = "".join(f"{view.index * plan.interval:.6e}\n" for view in plan.views)
    for rate in plan.rates:
        for name, text in (("calib", calib), ("poses", poses(plan.views)), ("times", times)):
            yield DataFile(f"{_sequence(rate)}/{name}.txt", TEXT, text)


def _sequence(rate):
    return f"{condition(rate)}/sequences/00"
