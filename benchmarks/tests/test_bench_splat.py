"""`bench splat`: the truth is the tests' own, variants are what they say, a quick run is whole."""

import dataclasses

import numpy as np
import pytest

import factories
import naive
from benchmarks import splat, splat_choices, suite
from benchmarks.splat_truth import draw_truth
from benchmarks.variants import variant
from rainsim import raster
from scenes import tiny_scene


def fog(count=300, bands=16):
    rng = np.random.default_rng(3)
    rotation = rng.normal(size=(count, 4))
    return factories.splats(
        rng.uniform((-2, -2, 2), (2, 2, 9), (count, 3)),
        rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        np.exp(rng.normal(-1.5, 0.8, (count, 3))), rng.uniform(0, 1, count),
        rng.normal(0, 0.3, (count, bands, 3)),
    )  # fmt: skip


def camera(**changes):
    one = tiny_scene(48, 32).cameras[0]
    return dataclasses.replace(one, camera_from_world=np.eye(4), **changes)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("drop_last", [False, True])
def test_the_truth_is_that_of_the_plain_loops(orthographic, drop_last):
    splats = fog()
    cam = camera(orthographic=orthographic, **({"fx": 9.0, "fy": 9.0} if orthographic else {}))
    truth = draw_truth(splats, cam, 0.2, drop_last)
    plain = naive.splat_layers(splats, cam, 0.2, drop_last)
    assert plain["alpha"].max() > 0.99
    np.testing.assert_allclose(truth.color, plain["color"], atol=1e-6)
    np.testing.assert_allclose(truth.alpha, plain["alpha"], atol=1e-6)
    solid = plain["alpha"] > 0.5
    assert solid.mean() > 0.3
    for mine, name in ((truth.depth, "depth"), (truth.median_depth, "median"),
                       (truth.plane_depth, "plane_depth"), (truth.normal, "normal")):  # fmt: skip
        np.testing.assert_allclose(mine[solid], plain[name][solid], rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_a_variant_has_its_own_constants_and_leaves_the_product_alone():
    splats, cam = fog(), camera()
    prepared = raster.prepare(splats)
    before = raster.rasterize(prepared, cam, 0.2)
    early = variant(TRANSMITTANCE_STOP=np.float32(0.1)).rasterize(prepared, cam, 0.2)
    after = raster.rasterize(prepared, cam, 0.2)
    assert before.color.tobytes() == after.color.tobytes()
    assert early.alpha.max() < before.alpha.max()
    assert splat.decibel(early.color, before.color) < 80
    assert variant() is raster
    with pytest.raises(KeyError, match="NO_SUCH_NAME"):
        variant(NO_SUCH_NAME=1)


def test_every_choice_reaches_the_modules_that_its_rasterizer_calls():
    choices = [choice for group in splat_choices.all_choices().values() for choice in group]
    assert sum(bool(choice.changes) for choice in choices) > 10
    for choice in choices:
        copy = variant(**choice.changes)
        assert (copy is raster) == (not choice.changes) and copy.Rasterizer
        for name, value in choice.changes.items():
            if hasattr(raster.project, name):
                assert getattr(copy.project, name) is value


@pytest.mark.slow
def test_harmonics_in_sixteen_bits_are_nearly_those_in_thirty_two():
    splats, cam = fog(), camera()
    prepared = raster.prepare(splats)
    truth, found = draw_truth(splats, cam).color, {}
    for choice in splat_choices.all_choices()["storage of harmonics"]:
        drawer = choice.rasterizer(splats, prepared)
        found[choice.name] = splat.decibel(drawer.draw(cam, 0.01).color, truth)
    assert drawer.prepared.fine.dtype == np.float32
    assert 70 < found["half precision"] < found["degree 2 and 3 in 16 bits"] - 6
    assert 90 < found["degree 2 and 3 in 16 bits"] < found["32 bits"]


def test_pairs_merged_keep_place_size_and_cover():
    """Two equal splats at one place are one of twice the cover; a scene merged looks alike."""
    one = fog(1, 1).take([0, 0])
    faint = dataclasses.replace(one, opacity=np.full(2, 0.2, np.float32))
    merged = splat_choices.merge_pairs(faint)
    assert len(merged) == 1 and merged.opacity[0] == pytest.approx(0.4, rel=1e-5)
    np.testing.assert_allclose(merged.position[0], one.position[0], rtol=1e-6)
    np.testing.assert_allclose(np.sort(merged.scale[0]), np.sort(one.scale[0]), rtol=1e-3)
    scene = tiny_scene(48, 32)
    half = splat_choices.merge_pairs(scene.splats)
    assert len(half) == len(scene.splats) // 2
    pictures = [
        raster.rasterize(raster.prepare(s), scene.cameras[0]).color for s in (scene.splats, half)
    ]
    assert 22 < splat.decibel(*pictures) < 60


@pytest.mark.slow
def test_a_quick_run_measures_every_choice(monkeypatch, tmp_path):
    scene, groups = tiny_scene(48, 32), splat_choices.all_choices()
    for name in ("polynomial of 2^x", "cut-off of a splat", "storage of harmonics"):
        del groups[name]  # the same, but minutes of compiling
    monkeypatch.setattr(splat, "all_choices", lambda: groups)
    monkeypatch.setattr(splat, "load_scene", lambda name: scene)
    monkeypatch.setattr(suite, "list_scenes", list)
    monkeypatch.setitem(splat.WIDTH, True, 48)
    told = []
    result = splat.run(quick=True, say=told.append)
    assert {r["group"] for r in result["records"]} == set(groups) and len(told) == 2 + len(groups)
    for r in result["records"]:
        if r["default"]:
            assert r["decibel"] > 90 and r["depth_error"] < 1e-4 and r["ratio"] == 1
    machine = result["machine"]
    assert machine["threads"] == 1 and machine["dtype"] == "float32"
    stages = [r for r in result["scaling"] if r["threads"] == 1]
    assert {r["stage"] for r in stages} == {*splat.STAGES, "all"}
    assert sum(r["least_ms"] for r in stages if r["stage"] != "all") < 2 * stages[-1]["median_ms"]
    assert result["scenes"]["bicycle"] == {"width": 48, "height": 32, "splats": len(scene.splats)}
    text = splat.table(result)
    assert "| stop | **0.0001** |" in text and "| stop | 0.1 |" in text
    pytest.importorskip("matplotlib")
    splat.draw(result, tmp_path / "c.png")
    assert (tmp_path / "c.png").read_bytes()[:4] == b"\x89PNG"
