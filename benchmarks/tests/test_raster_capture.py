"""A real capture from float64 and from gsplat's picture of it; skipped where the data is not."""

import runpy

import numpy as np
import pytest

from benchmarks.splat import decibel
from benchmarks.splat_truth import draw_truth
from rainsim import raster
from rainsim.scene.activate import activate
from rainsim.scene.cameras import load_cameras

SIZE = (648, 420)


@pytest.fixture(scope="module")
def capture(shared):
    """The garden's splats and its cameras by name."""
    load = runpy.run_path(str(shared("data/unpack.py")))["load_garden"]
    position, log_scale, turn, logit, base, rest = load()
    splats, good = activate(position, log_scale, turn, logit, base, rest)
    assert good.all()
    cameras, _ = load_cameras(shared("data/garden_cameras.json"))
    return splats, {camera.name: camera.resized(*SIZE) for camera in cameras}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["DSC07956", "DSC07996"])
def test_the_garden_agrees_with_float64_and_with_gsplat(capture, shared, name):
    splats, cameras = capture
    prepared = raster.prepare(splats)
    with np.load(shared("reference/garden_gsplat.npz")) as pictures:
        theirs, alpha = pictures[f"{name}_rgb"] / 32768, pictures[f"{name}_alpha"] / 65535
        depth = pictures[f"{name}_depth"]
    truth = draw_truth(splats, cameras[name])
    films = raster.rasterize(prepared, cameras[name])
    assert decibel(films.color, truth.color) > 90
    assert 69 < decibel(films.color, theirs) < 71  # the other stop, nothing else
    alike = raster.rasterize(prepared, cameras[name], drop_last=True)
    assert decibel(alike.color, theirs) > 80
    assert decibel(alike.alpha, alpha) > 95
    solid = (alpha > 0.5) & (truth.alpha > 0.5)
    for layers, wanted in ((films, truth.depth), (alike, depth)):
        assert np.percentile(np.abs(layers.depth[solid] / wanted[solid] - 1), 99.9) < 1e-4
    turned = np.linalg.norm(np.cross(films.normal, truth.normal), axis=-1)[solid]
    assert np.degrees(np.arcsin(np.percentile(turned, 99.9))) < 0.1
