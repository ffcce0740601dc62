"""The example of a torch data set reads what exports write, and torch's loader takes it."""

import json
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_datasets import plan_with, sample_of, write_set

from rainsim.datasets import beside, nerfstudio
from rainsim.datasets.card import VERSION, VERSION_KEY
from rainsim.datasets.data_files import write_file
from rainsim.datasets.reading import read_turn
from rainsim.datasets.rig_shots import rig_views
from rainsim.datasets.sample import Cloud
from rainsim.datasets.splits import held_out
from rainsim.errors import ParameterError
from rainsim.sensors.rig import read_rig

EXAMPLE = Path(__file__).resolve().parent.parent.parent / "examples/torch_dataset.py"


def test_torch_dataset(tmp_path):
    plan, module = plan_with(), runpy.run_path(str(EXAMPLE))
    samples = write_set(tmp_path, plan)
    for index in range(3):
        for file in nerfstudio.sample_files(sample_of(plan, index, rate=0.0), plan):
            write_file(tmp_path, file)
    pairs = module["RainyPairs"](tmp_path, 10.0)
    assert len(pairs) == 2 and len(module["RainyPairs"](tmp_path, 10.0, "test")) == 1
    item = pairs[1]
    assert item["rainy"].shape == item["clear"].shape == (3, 30, 40)
    np.testing.assert_allclose(item["rainy"][:, 4, 7] * 255, samples[1].picture[4, 7], atol=1e-4)
    np.testing.assert_array_equal(item["keep"], samples[1].keep)
    pytest.importorskip("torch")
    items = module["main"](tmp_path, 10.0)
    assert items["rainy"].shape == (2, 3, 30, 40) and not items["keep"].dtype.is_floating_point


def test_a_rigs_camera_and_lidar(tmp_path):
    folder, path = tmp_path, tmp_path / "rig.toml"
    path.write_text(
        '[[camera]]\nname = "left"\nat = [0.0, 0.2, 1.0]\nwidth = 40\nheight = 30\nfov = 60\n'
        '[[camera]]\nname = "side"\nat = [0.0, -0.2, 1.0]\nwidth = 40\nheight = 30\nfov = 70\n'
        '[[lidar]]\nname = "top"\nsensor = "vlp16"\nat = [0.0, 0.0, 1.2]\nlook = [30, 0, 0]\n'
    )
    rig, plain = read_rig(path, 2.0), plan_with()
    views, turns = rig_views(rig, [view.camera for view in plain.views], 2.0)
    plan = replace(plain, views=held_out(views, 3), rig=rig, turns=turns)
    partners = {"clear_air": np.full((30, 40, 3), 51, np.uint8)}
    own = np.full((30, 40), 26001, np.uint16)
    for index in range(len(plan.views)):
        for rate in plan.rates:
            more = {} if rate == 0 else {"partners": partners, "labels": own}
            sample = sample_of(plan, index, rate, **more)
            for room in (nerfstudio, beside):
                for file in room.sample_files(sample, plan):
                    write_file(folder, file)
    points = np.array([[1, 2, 3, 0.5], [4, 0, 0, 0.1]], np.float32)
    for file in beside.cloud_files(Cloud(turns[0], 10.0, (points, np.array([40, 1], "<u4"))), plan):
        write_file(folder, file)
    for file in nerfstudio.plan_files(plan, folder):
        write_file(folder, file)
    card = {VERSION_KEY: VERSION, "layout": "nerfstudio", "complete": True}
    (folder / "card.json").write_text(json.dumps(card))
    module = runpy.run_path(str(EXAMPLE))
    pairs = module["RainyPairs"](folder, 10.0, sensor="side")
    side = [v for v in plan.views if v.mount.name == "side" and not v.held_out]
    assert len(pairs) == len(side) < len(module["RainyPairs"](folder, 10.0))
    item = pairs[1]
    assert item["time"] == side[1].time > 0
    assert item["lens"][0] == pytest.approx(side[1].camera.fx)
    np.testing.assert_allclose(item["camera_from_ground"], side[1].camera.camera_from_world, 1e-5)
    np.testing.assert_allclose(item["clear_air"], 0.2)
    assert (item["labels"] == 26001).all() and "actor_id" not in item
    assert set(np.unique(item["class_id"])) == {0, 4, 255}
    with pytest.raises(ParameterError, match=r"sensor is .*rear.*; .* has no view of it in train"):
        module["RainyPairs"](folder, 10.0, sensor="rear")
    places, labels = read_turn(folder, 10.0, "top", 0)
    turn = turns[0].ground_from_sensor
    np.testing.assert_allclose(places, points[:, :3] @ turn[:3, :3].T + turn[:3, 3], atol=1e-5)
    assert labels.tolist() == [40, 1]
