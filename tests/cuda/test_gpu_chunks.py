"""A street in chunks on a real GPU: `pytest -m gpu`; prints time, memory and chunks with `-s`."""

import time

import numpy as np
import pytest

from benchmarks import lod
from rainsim.config.settings import Config
from rainsim.lod.paged import rasterizer_of_scene

pytestmark = pytest.mark.gpu
LENGTH = 60.0  # m


def test_a_drive_through_chunks_is_that_of_the_cpu(tmp_path):
    pytest.importorskip("gsply")
    pytest.importorskip("imagecodecs")
    from rainsim.cuda import device
    from rainsim.cuda.raster import Rasterizer

    lod.make(tmp_path / "street", LENGTH)
    free, render = device()["free"], Config().render
    scenes = [lod.long_street(tmp_path / "street", LENGTH) for _ in range(2)]
    mine = rasterizer_of_scene(scenes[0], render, Rasterizer)
    theirs = rasterizer_of_scene(scenes[1], render)
    sent, used = [], set()
    for camera in lod.drive(scenes[0], LENGTH, 648)[:48:6]:
        begin = time.perf_counter()
        found = mine.draw(camera, 0.05)
        milliseconds = (time.perf_counter() - begin) * 1e3
        wanted = theirs.draw(camera, 0.05)
        assert mine.used == theirs.used
        used.add(tuple(mine.wanted(camera, 0.05)))
        error = np.mean((found.color.astype(float) - wanted.color) ** 2)
        assert error < 1e-6  # 60 dB
        sent.append(mine._rasterizer.splats.sent)
        print(f"{mine.used} {milliseconds:.1f} ms, {sent[-1] / 1e6:.1f} MB sent so far")
    print(f"{(free - device()['free']) / 1e6:.0f} MB of the GPU")
    assert len(used) > 1 and sent[0] < sent[-1] < 2 * sent[0]
