"""Ids that the user brings, and things that move, in layouts other than Cityscapes."""

from dataclasses import replace

import numpy as np
from test_cityscapes import CAR, driven
from test_datasets import RENDER, plan_with

from rainsim.datasets import acdc, clouds, replicator
from rainsim.datasets.user_labels import UserLabels
from scenes import tiny_scene

BOX = {"centre": [1.0, 2.0, 0.5], "size": [4.0, 2.0, 1.0], "rotation": [0.5**0.5, 0, 0, 0.5**0.5]}


def labelled():
    own = np.full((30, 40), 255, np.uint16)
    own[10:20], own[20:22] = 24007, 21
    sample = driven(plan_with(), 0, labels=own)
    seen = {"pixels": 90, "box2d_seen": [10, 2, 30, 8], "box3d": BOX, "hidden": 0.25}
    actors = [{**sample.facts["actors"][0], **seen},
              {**sample.facts["actors"][1], **seen, "pixels": 0}]  # fmt: skip
    return replace(sample, facts={**sample.facts, "actors": actors})


def test_acdc_has_what_moves_where_the_user_has_no_id():
    ids = acdc.train_ids(labelled())
    assert ids[[12, 21], 5].tolist() == [24, 21]
    assert (ids[CAR, 10:30] == 13).all() and (ids[CAR, :10] == 255).all()
    assert (acdc.train_ids(replace(labelled(), labels=None))[CAR, 10:30] == 13).all()


def test_replicator_has_classes_and_boxes():
    plan, sample = plan_with(), labelled()
    files = {f.name.rpartition("/")[2]: f.content for f in replicator.sample_files(sample, plan)}
    colors = files["semantic_segmentation_0000.png"]
    names = files["semantic_segmentation_labels_0000.json"]
    found = [names[str(tuple(colors[row, 15].tolist()))]["class"] for row in (4, 12, 21)]
    assert found == ["Car", "label_24", "label_21"]
    flat, kinds = (files[f"bounding_box_2d_tight_{n}0000{e}"] for n, e in (("", ".npy"),
                                                                ("labels_", ".json")))  # fmt: skip
    assert flat[-1].tolist()[1:5] == (10, 2, 29, 7) and flat[-1]["occlusionRatio"] == 0.25
    assert kinds[str(flat[-1]["semanticId"])] == {"class": "Car"}
    (box,) = files["bounding_box_3d_0000.npy"]
    corner = np.array([box["x_max"], box["y_max"], box["z_max"], 1]) @ box["transform"]
    np.testing.assert_allclose(corner, [0, 4, 1, 1], atol=1e-6)  # turned to the left by 90 degrees


def test_points_have_the_ids_of_the_splats_that_they_lie_on():
    scene = tiny_scene()
    ids = np.arange(len(scene.splats), dtype=np.uint16) % 7 + 30010
    labels = UserLabels(scene, ids, RENDER)
    places = scene.ground_frame.to_ground(scene.splats.position[[5, 400]].astype(float))
    places = np.concatenate([places + 1e-4, places + np.array([0, 0, 3.0])])
    found = labels.of_points(places)
    assert found.tolist() == [ids[5], ids[400], 255, 255]
    known = clouds.semantic_label(found[:2])
    assert (known & 0xFFFF).tolist() == [30, 30]
    assert (known >> 16).tolist() == (ids[[5, 400]] - 30000).tolist()
