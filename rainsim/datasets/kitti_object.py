"""The layout of KITTI's object benchmark, with its tracking labels: pictures, clouds and boxes.

After its development kits (https://www.cvlibs.net/datasets/kitti): training/image_2/000000.png,
velodyne/000000.bin, calib/000000.txt and label_2/000000.txt; label_02/0000.txt has the boxes of a
sequence with the number of their frame and of their track. labels/000000.label has SemanticKITTI's
classes of the points. ImageSets names the pictures to train on and to validate, as OpenPCDet and
MMDetection3D read it.
"""

from __future__ import annotations

from rainsim.datasets.data_files import BYTES, FOLDER, PNG, TEXT, DataFile, condition
from rainsim.datasets.kinds import kind_of
from rainsim.datasets.kitti import calibration, object_boxes, object_labels
from rainsim.io.files import read_json

TRUNCATED = (0.01, 0.5)  # shares from which tracking has a box as partly and largely truncated


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample."""
    training, number = f"{condition(sample.rate)}/training", f"{sample.view.index:06d}"
    yield DataFile(f"{training}/image_2/{number}.png", PNG, sample.picture)
    yield DataFile(f"{training}/calib/{number}.txt", TEXT, calibration(sample.view.camera))
    boxes = object_labels(sample.facts.get("actors", ()), sample.view.camera)
    yield DataFile(f"{training}/label_2/{number}.txt", TEXT, boxes)
    if sample.cloud is not None:
        points, labels = sample.cloud
        yield DataFile(f"{training}/velodyne/{number}.bin", BYTES, points.tobytes())
        yield DataFile(f"{training}/labels/{number}.label", BYTES, labels.tobytes())


def plan_files(plan, folder):
    """Yield the `DataFile`s of the whole data set; `folder` has the samples' files."""
    for rate in plan.rates:
        place = condition(rate)
        for name, held in (("train", False), ("val", True)):
            lines = [f"{v.index:06d}\n" for v in plan.views if v.held_out == held]
            yield DataFile(f"{place}/ImageSets/{name}.txt", TEXT, "".join(lines))
        if plan.sequence and folder is not None:
            facts = [read_json(folder / place / FOLDER / f"{view.name}.json", "facts")
                     for view in plan.views]  # fmt: skip
            text = tracking_labels(plan.views, facts)
            yield DataFile(f"{place}/training/label_02/0000.txt", TEXT, text)


def tracking_labels(views, facts):
    """Return a label_02 file: frame, track, type, truncation and occlusion as levels, and box."""
    lines = []
    for view, known in zip(views, facts, strict=True):
        for actor, cut, hidden, box in object_boxes(known.get("actors", ()), view.camera):
            level = sum(cut >= share for share in TRUNCATED)
            kind = kind_of(actor["class"]).kitti
            lines.append(f"{view.index} {actor['number'] - 1} {kind} {level} {hidden} {box}\n")
    return "".join(lines)
