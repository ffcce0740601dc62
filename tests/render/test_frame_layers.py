"""Layers: they make the frame again, mean what they say, and cost nothing unless asked for."""

from dataclasses import replace

import numpy as np
import pytest

from made_shots import wet_shot
from rainsim.errors import ParameterError
from rainsim.io import images
from rainsim.render import aov
from rainsim.render.aov import AOVS, NEEDED, recompose
from run_folders import layer


@pytest.fixture(scope="module")
def shot():
    """A frame of a small wet scene with all layers: picture, report and renderer."""
    return wet_shot(tuple(AOVS))


def test_layers_make_the_frame_again(shot):
    picture, report, *_ = shot
    again = recompose(report.aovs, **report.light)
    assert np.abs(again.astype(int) - picture).max() <= 1
    # Each part is needed: without it the frame is another.
    for name in NEEDED:
        other = {**report.aovs, name: np.zeros_like(report.aovs[name])}
        if report.aovs[name].any():
            changed = recompose(other, **report.light).astype(int)
            assert np.abs(changed - picture).max() > 1, name


def test_every_layer_has_the_frames_size_and_its_kind(shot):
    picture, report, *_ = shot
    assert set(report.aovs) == set(AOVS)
    for name, values in report.aovs.items():
        assert values.shape[:2] == picture.shape[:2], name
        kind = AOVS[name].kind
        if kind == aov.SHARE:
            assert values.min() >= 0 and values.max() <= 1
        elif kind == aov.DATA:
            assert values.dtype == np.float32 and values.ndim == 2 + (len(AOVS[name].channels) > 1)


def test_layers_say_what_is_there(shot):
    _, report, *_ = shot
    found = report.aovs
    water = found["coverage"] > 0
    assert 0.01 < water.mean() < 0.9
    assert (found["water_depth"][water] > 0).all() and not found["water_depth"][~water].any()
    assert set(np.unique(found["reflection_source"][water])) <= {1, 2, 3, 4}
    assert not found["reflection_source"][~water].any()
    up = found["normal"][water] @ [0, 0, 1]
    assert np.median(up) > 0.95  # the ground below water is level
    assert found["wetness"][water].min() > 0.2
    assert np.median(np.abs(found["height"][water])) < 0.02  # it lies in dips of the ground
    assert np.isinf(found["height"][np.isinf(found["depth"])]).all()
    assert found["highlight"].max() > 0  # the sun is given
    assert ((found["splash_id"] > 0) <= (found["splash_alpha"] > 0)).all()


def test_flow_is_that_of_falling_drops(shot):
    _, report, _, camera, _ = shot
    flow = report.aovs["drop_flow"]
    seen = np.abs(flow).max(axis=-1) > 0
    assert seen.any() and (report.aovs["rain_alpha"][seen] > 0).all()
    assert np.median(flow[seen][:, 1]) > 5  # down the picture
    # A drop of v m/s at depth z moves f v / (z fps) pixels: between the fastest near, slowest far.
    fastest = 10.0 * camera.fy / 0.3 / 24
    assert np.linalg.norm(flow[seen], axis=1).max() < fastest


def test_nothing_is_computed_unless_asked(shot):
    picture, _, renderer, camera, state = shot
    again, report = renderer.draw(replace(camera), state)
    assert report.aovs == {} and "compose" in report.milliseconds
    assert not any("layer" in stage for stage in report.milliseconds)
    assert (again == picture).mean() > 0.999


def test_names_are_checked():
    assert aov.parse_names("all") == tuple(AOVS)
    assert aov.parse_names("depth, wet,depth") == ("depth", "wet")
    with pytest.raises(ParameterError, match=r"no layer 'depht'.*known are all, clean"):
        aov.parse_names("depht")


def test_every_layer_is_documented():
    from pathlib import Path

    text = (Path(__file__).parents[2] / "docs/layers.md").read_text(encoding="utf-8")
    for name, about in AOVS.items():
        row = f"| `{name}` | {about.kind} | {about.unit} |"
        assert row in text, f"docs/layers.md has no row that begins with {row}"


@pytest.mark.parametrize("suffix", ["npz", "exr"])
def test_float_pictures_come_back_exactly(tmp_path, rng, suffix):
    if suffix == "exr":
        pytest.importorskip("OpenEXR")
    for channels in (("Z",), ("X", "Y"), ("R", "G", "B")):
        values = rng.normal(size=(7, 9, len(channels))).astype(np.float32)
        values[0, 0] = np.inf
        values = values[..., 0] if len(channels) == 1 else values
        path = tmp_path / f"a{len(channels)}.{suffix}"
        images.write_data(path, values, channels)
        np.testing.assert_array_equal(layer(path, channels), values)


def test_indices_come_back_exactly(tmp_path):
    values = np.arange(0, 65536, 257, dtype=np.uint16).reshape(16, 16)
    images.write_png16(tmp_path / "i.png", values)
    np.testing.assert_array_equal(images.read_image(tmp_path / "i.png"), values)
    for wrong in (-1.0, 65535.4, np.nan):
        with pytest.raises(ParameterError, match="do not fit a 16-bit PNG"):
            images.write_png16(tmp_path / "wrong.png", np.full((2, 2), wrong))
    assert not (tmp_path / "wrong.png").exists()
