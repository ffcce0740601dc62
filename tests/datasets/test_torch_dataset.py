"""The example of a torch data set reads what exports write, and torch's loader takes it."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from test_datasets import plan_with, sample_of, write_set

from rainsim.datasets import nerfstudio
from rainsim.datasets.data_files import write_file

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
