"""The layout of KITTI's object benchmark, with its tracking labels: pictures, clouds and boxes.

After its development kits (https://www.cvlibs.net/datasets/kitti): training/image_2/000000.png,
velodyne/000000.bin, calib/000000.txt and label_2/000000.txt; label_02/0000.txt has the boxes of a
sequence with the number of their frame and of their track. labels/000000.label has SemanticKITTI's
classes of the points. ImageSets names the pictures to train on and to validate, as OpenPCDet and
MMDetection3D read it.
"""

from rainsim.datasets import beside, kitti
from rainsim.datasets.data_files import BYTES, FOLDER, PNG, TEXT, DataFile, condition
from rainsim.datasets.kinds import kind_of
from rainsim.io.files import read_json

TRUNCATED = (0.01, 0.5)  # shares from which tracking has a box as partly and largely truncated


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    view, training = sample.view, f"{condition(sample.rate)}/training"
    number = f"{view.number:06d}"
    yield DataFile(
        f"{training}/image_{kitti.channel_of(view, plan)}/{number}.png", PNG, sample.picture
    )
    if kitti.is_first(view, plan):
        yield DataFile(
            f"{training}/calib/{number}.txt", TEXT, kitti.calibration(view.camera, plan.rig)
        )
    yield kitti.box_file(sample, plan)
    if sample.cloud is not None:
        yield from point_files(training, number, sample.cloud)


def point_files(place, number, cloud):
    """Yield the `DataFile`s of a cloud: its points and their labels."""
    points, labels = cloud
    yield DataFile(f"{place}/velodyne/{number}.bin", BYTES, points.tobytes())
    yield DataFile(f"{place}/labels/{number}.label", BYTES, labels.tobytes())


def cloud_files(sample, plan, place="training"):
    """Yield the `DataFile`s of a turn of a rig's lidar: the first is KITTI's."""
    if sample.view.mount is not plan.rig.lidars[0]:
        yield from beside.cloud_files(sample, plan)
        return
    yield from point_files(f"{condition(sample.rate)}/{place}", f"{sample.view.frame:06d}",
                           sample.cloud)  # fmt: skip
    yield beside.turn_facts(sample)


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set; `folder` has the samples' files."""
    for rate in plan.rates:
        place = condition(rate)
        for name, held in (("train", False), ("val", True)):
            lines = [f"{v.number:06d}\n" for v in plan.views
                     if v.held_out == held and kitti.is_first(v, plan)]  # fmt: skip
            yield DataFile(f"{place}/ImageSets/{name}.txt", TEXT, "".join(lines))
        if plan.sequence and folder is not None:
            by_channel = {}
            for view in plan.views:
                by_channel.setdefault(kitti.channel_of(view, plan), []).append(view)
            for channel, views in by_channel.items():
                facts = [read_json(folder / place / FOLDER / f"{view.name}.json", "facts")
                         for view in views]  # fmt: skip
                text = tracking_labels(views, facts, plan)
                yield DataFile(f"{place}/training/label_{channel:02d}/0000.txt", TEXT, text)


def tracking_labels(views, facts, plan):
    """Return a label_02 file: frame, track, type, truncation and occlusion as levels, and box."""
    lines = []
    for view, known in zip(views, facts, strict=True):
        for actor, cut, hidden, box in kitti.object_boxes(
            known.get("actors", ()), view.camera, kitti.first_from_ground(view, plan)
        ):  # fmt: skip
            level = sum(cut >= share for share in TRUNCATED)
            kind = kind_of(actor["class"]).kitti
            lines.append(f"{view.number} {actor['number'] - 1} {kind} {level} {hidden} {box}\n")
    return "".join(lines)
