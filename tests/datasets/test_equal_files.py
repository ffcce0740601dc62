"""Files of the same content are packed once, and each is there."""

import numpy as np

from rainsim.datasets import kitti
from rainsim.datasets.data_files import PNG, DataFile, write_files
from rainsim.datasets.export import DataSetFolder
from rainsim.datasets.sample import Plan, Sample, View, kitti_flow
from rainsim.io import images
from rainsim.render.labels import NO_FLOW, OCCLUDED, OUTSIDE, SEEN
from rainsim.scene.types import Camera


def counted(monkeypatch):
    """Return a list to which each picture that is packed is added."""
    packed, write = [], images.write_png
    monkeypatch.setattr(images, "write_png", lambda path, v: (packed.append(v), write(path, v)))
    return packed


def two_views():
    views = [View(k, f"v{k}", Camera(40, 30, 40.0, 40.0, 20.0, 15.0, np.eye(4))) for k in (0, 1)]
    none = np.zeros((0, 3), np.float32)
    return Plan("yard", tuple(views), (10.0,), True, none, none.astype(np.uint8), {})


def second_sample(plan, rng):
    """A sample that shows flow of each kind."""
    shape = 30, 40
    depth, ids = rng.uniform(1, 9, shape).astype(np.float32), np.zeros(shape, np.uint16)
    mask = rng.choice([NO_FLOW, SEEN, OCCLUDED, OUTSIDE], shape).astype(np.uint16)
    return Sample(
        plan.views[1], 10.0, rng.integers(0, 256, (*shape, 3)).astype(np.uint8), depth, depth, ids,
        ids, ids, ids == 0, rng.normal(0, 9, (*shape, 2)).astype(np.float32), mask,
    )  # fmt: skip


def test_one_content_is_packed_once(tmp_path, monkeypatch, rng):
    packed = counted(monkeypatch)
    picture = rng.integers(0, 256, (9, 8, 3)).astype(np.uint8)
    names = "a/one.png", "b/two.png", "b/three.png"
    write_files(tmp_path, [DataFile(name, PNG, picture) for name in names])
    assert len(packed) == 1
    for name in names:
        np.testing.assert_array_equal(images.read_image(tmp_path / name), picture)
    assert [p.name for p in tmp_path.rglob(".*")] == []  # nothing temporary is left


def test_the_second_picture_of_a_pair_is_a_copy_and_other_pictures_are_not(
    tmp_path, monkeypatch, rng
):
    packed, plan = counted(monkeypatch), two_views()
    sample = second_sample(plan, rng)
    folder = DataSetFolder(tmp_path, "kitti", plan, {}, None)
    names = folder.write(sample)
    assert len(set(names)) == len(names) and all((tmp_path / n).is_file() for n in names)
    both = [n for n in names if n.endswith(("image_2/000001_10.png", "image_2/000000_11.png"))]
    assert len(both) == 2 and len({(tmp_path / n).read_bytes() for n in both}) == 1
    assert sum(v is sample.picture for v in packed) == 1
    others = [n for n in names if n.endswith(("class_id/v1.png", "keep/v1.png"))]
    assert len({(tmp_path / n).read_bytes() for n in others}) == 2


def test_both_flows_of_kitti_come_from_one(rng):
    plan = two_views()
    first = Plan(**{**vars(plan), "views": (*plan.views, View(2, "v2", plan.views[0].camera))})
    sample = second_sample(plan, rng)
    flows = {f.name.split("/")[-2]: f.content for f in kitti.sample_files(sample, first)
             if "flow" in f.name}  # fmt: skip
    mask = sample.flow_mask
    np.testing.assert_array_equal(flows["flow_occ"], kitti_flow(sample.flow, mask != NO_FLOW))
    np.testing.assert_array_equal(flows["flow_noc"], kitti_flow(sample.flow, mask == SEEN))
    assert flows["flow_noc"].dtype == np.uint16 and (flows["flow_occ"] != flows["flow_noc"]).any()
    assert sample.flow_picture is flows["flow_occ"]
