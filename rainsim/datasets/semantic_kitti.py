"""The layout of SemanticKITTI: a sequence of clouds with labels, poses and times; one a rain.

After its tools (semantic-kitti-api: generate_sequential.py, auxiliary/laserscan.py), which take the
folder of a rain as the data set: sequences/00 has velodyne/000000.bin, labels/000000.label,
image_2/000000.png, poses.txt of the camera, relative to the first, calib.txt with Tr from the
lidar's axes to the camera's, and times.txt. The poses are in poses/00.txt, too, where KITTI's
odometry benchmark has them and pykitti 0.3.1 looks for them.
"""

from rainsim.datasets.data_files import PNG, TEXT, DataFile, condition
from rainsim.datasets.kitti import CAMERAS, calibration, channel_of, is_first, poses
from rainsim.datasets.kitti_object import cloud_files as object_cloud_files
from rainsim.datasets.kitti_object import point_files

TO_CAMERA, SEQUENCE = "Tr_velo_to_cam", "sequences/00"


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    place, number = _sequence(sample.rate), f"{sample.view.number:06d}"
    channel = channel_of(sample.view, plan)
    yield DataFile(f"{place}/image_{channel}/{number}.png", PNG, sample.picture)
    if sample.cloud is not None:
        yield from point_files(place, number, sample.cloud)


def cloud_files(sample, plan):
    """Yield the `DataFile`s of a turn of a rig's lidar."""
    yield from object_cloud_files(sample, plan, SEQUENCE)


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set."""
    lines = calibration(plan.views[0].camera, plan.rig).splitlines()
    lidar = next(line for line in lines if line.startswith(TO_CAMERA))
    lines = [*lines[:CAMERAS], lidar.replace(TO_CAMERA, "Tr")]
    calib = "".join(f"{line}\n" for line in lines)
    first = [view for view in plan.views if is_first(view, plan)]
    seconds = [v.index * plan.interval if plan.rig is None else v.time for v in first]
    times = "".join(f"{second:.6e}\n" for second in seconds)
    way = poses(plan.views)
    for rate in plan.rates:
        for name, text in (("calib", calib), ("poses", way), ("times", times)):
            yield DataFile(f"{_sequence(rate)}/{name}.txt", TEXT, text)
        yield DataFile(f"{condition(rate)}/poses/00.txt", TEXT, way)


def _sequence(rate):
    return f"{condition(rate)}/{SEQUENCE}"
