"""The layout of Cityscapes as cityscapesScripts and torchvision read it."""

import json
import re

import numpy as np
import pytest
from test_datasets import plan_with, sample_of

from rainsim.datasets import cityscapes
from rainsim.datasets.data_files import write_file
from rainsim.datasets.kinds import KINDS, LAST_ID, OTHER, TRAIN_IDS

CAR, TENT = slice(2, 8), slice(24, 28)  # rows of the picture that show actors


def driven(plan, index, **more):
    """Return a sample with a car and a tent, the second and first actor of the scene."""
    number = np.zeros((30, 40), np.uint16)
    number[CAR, 10:30], number[TENT] = 2, 1
    sample = sample_of(plan, index, actor_id=number, **more)
    sample.class_id[number > 0] = 255
    actors = [{"number": 2, "class": "Car"}, {"number": 1, "class": "tent"}]
    return sample.__class__(**{**sample.__dict__, "facts": {**sample.facts, "actors": actors}})


def write(folder, plan, **more):
    for index in range(3):
        for file in cityscapes.sample_files(driven(plan, index, **more), plan):
            write_file(folder, file)
    return folder / "rain/10mm"


def test_names_ids_and_instances():
    plan = plan_with()
    files = {f.name: f for f in cityscapes.sample_files(driven(plan, 1), plan)}
    stem = "train/yard/yard_000000_000001"
    gt = f"rain/10mm/gtFine/{stem}_gtFine"
    assert set(files) == {
        f"rain/10mm/leftImg8bit/{stem}_leftImg8bit.png", f"{gt}_labelIds.png",
        f"{gt}_labelTrainIds.png", f"{gt}_instanceIds.png", f"{gt}_color.png",
        f"rain/10mm/depth/{stem}_depth.png",
    }  # fmt: skip
    ids, train, instances = (files[f"{gt}_{n}.png"].content
                             for n in ("labelIds", "labelTrainIds", "instanceIds"))  # fmt: skip
    assert (ids[CAR, 10:30] == 26).all() and (train[CAR, 10:30] == 13).all()
    assert (instances[CAR, 10:30] == 26001).all()  # the second actor
    assert (ids[TENT] == 5).all() and (instances[TENT] == 5).all() and (train[TENT] == 255).all()
    assert (ids[10:20] == 7).all() and (ids[20:24] == 7).all()  # paving, and the puddle on it
    assert (train[8:10] == 255).all() and (ids[8:10] == 0).all()
    own = np.full((30, 40), 21, np.uint16)
    own[:4], own[4:6], own[15] = 26, 255, 24007
    mine = driven(plan, 0, labels=own)
    assert cityscapes.label_ids(mine)[[1, 4, 15, 20], 5].tolist() == [26, 0, 24, 21]
    assert cityscapes.label_ids(mine)[4, 15] == 26  # the actor, where the user has no label
    found = cityscapes.instance_ids(mine, cityscapes.label_ids(mine))
    assert found[2, [5, 15]].tolist() == [26, 26001]  # a group, and the actor
    assert found[15, 5] == 24007
    assert cityscapes.city_of("my_yard-2.5") == "myyard25" and cityscapes.city_of("__") == "scene"


def test_ids_are_those_of_cityscapes_scripts():
    labels = pytest.importorskip("cityscapesscripts.helpers.labels")
    trained = {k: v.trainId for k, v in labels.id2label.items() if 0 <= v.trainId < 255}
    assert trained == TRAIN_IDS
    for name, kind in (*KINDS.items(), ("dynamic", OTHER)):
        known = labels.id2label[kind.cityscapes].name
        same = {"vehicle": "car", "van": "car", "tram": "train", "pedestrian": "person",
                "cyclist": "rider"}  # fmt: skip
        assert known == same.get(name, name)
    known = [labels.id2label[k].color for k in range(LAST_ID + 1)]
    np.testing.assert_array_equal(cityscapes.COLORS, known)
    assert all(v.hasInstances == (k >= 24) for k, v in labels.id2label.items() if k >= 0)


def test_cityscapes_scripts_read_and_score_it(tmp_path, capsys, monkeypatch):
    """Its own score of the truth against itself is 1; its instances are the actors."""
    helpers = pytest.importorskip("cityscapesscripts.helpers.csHelpers")
    from cityscapesscripts.evaluation import evalPixelLevelSemanticLabeling as score
    from cityscapesscripts.evaluation.instances2dict import instances2dict
    from cityscapesscripts.preparation.createPanopticImgs import convert2panoptic

    monkeypatch.setattr(np, "in1d", np.isin, raising=False)  # it calls what numpy 2.4 dropped
    root = write(tmp_path, plan_with())
    truth = sorted((root / "gtFine").glob("*/*/*_gtFine_labelIds.png"))
    assert [helpers.getCsFileInfo(str(p)).frameNb for p in truth] == [f"00000{k}" for k in range(3)]
    assert helpers.getCoreImageFileName(str(truth[0])) == "yard_000000_000000"
    names = [str(path) for path in truth]
    score.args.JSONOutput, score.args.quiet = False, True
    score.args.evalInstLevelScore = True
    found = score.evaluateImgLists(names, names, score.args)
    assert found["classScores"]["road"] == found["classScores"]["car"] == 1.0
    places = [str(p).replace("labelIds", "instanceIds") for p in truth]
    for path, things in instances2dict(places, verbose=False).items():
        cars = [thing for thing in things["car"] if thing["instID"] >= 1000]
        assert [c["instID"] for c in cars] == [26001] and cars[0]["pixelCount"] == 120, path
    convert2panoptic(str(root / "gtFine"), str(tmp_path), useTrainId=False, setNames=["val"])
    panoptic = json.loads((tmp_path / "cityscapes_panoptic_val.json").read_text())
    segments = {s["category_id"] for s in panoptic["annotations"][0]["segments_info"]}
    assert segments == {7, 26}
    capsys.readouterr()


def test_torchvision_reads_it(tmp_path):
    datasets = pytest.importorskip("torchvision.datasets")
    plan = plan_with()
    root = write(tmp_path, plan)
    both = datasets.Cityscapes(root, "train", "fine", ["semantic", "instance"])
    assert len(both) == 2 and len(datasets.Cityscapes(root, "val", "fine")) == 1
    by_name = {re.search(r"_(\d+)_left", path)[1]: k for k, path in enumerate(both.images)}
    picture, (ids, instances) = both[by_name["000001"]]
    sample = driven(plan, 1)
    np.testing.assert_array_equal(np.array(picture), sample.picture)
    np.testing.assert_array_equal(np.array(ids), cityscapes.label_ids(sample))
    assert np.array(instances).max() == 26001
    _, colors = datasets.Cityscapes(root, "train", "fine", "color")[by_name["000001"]]
    np.testing.assert_array_equal(np.array(colors)[CAR, 10:30], [[(0, 0, 142)] * 20] * 6)
