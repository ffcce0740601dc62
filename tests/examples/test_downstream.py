"""The downstream experiment, at tiny size and on the CPU, where torch is installed."""

import json

import imageio.v3 as imageio
import numpy as np
import pytest
from test_examples import load

from benchmarks import downstream
from benchmarks.stored_views import StoredView, read_views
from rainsim.errors import ParameterError
from rainsim.raster import prepare, rasterize
from rainsim.scene.cameras import look_at
from rainsim.scene.types import Splats

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.slow

CAMERA = look_at((0, -3, 0.4), (0, 0, 0), (0, 0, 1), 50, 40, 30)


@pytest.fixture(scope="module")
def module():
    return downstream


def some_splats(module, rng, count=60):
    places = rng.normal(0, 0.5, (count, 3)).astype(np.float32)
    colors = rng.integers(0, 256, (count, 3)).astype(np.uint8)
    splats = module.Splats(places, colors, 0, "cpu")
    with torch.no_grad():
        splats.values["scale"] += torch.tensor(rng.normal(-0.5, 0.5, (count, 3)))
        splats.values["turn"] += torch.tensor(rng.normal(0, 1, (count, 4)))
        splats.values["opacity"] += torch.tensor(rng.normal(1, 2, count))
    return splats


def test_the_plain_renderer_draws_what_the_rasterizer_draws(module, rng):
    splats = some_splats(module, rng)
    v = {name: value.detach() for name, value in splats.values.items()}
    turn = torch.nn.functional.normalize(v["turn"], dim=1)
    ours = Splats(*(np.ascontiguousarray(a.numpy(), np.float32) for a in (
        v["place"], turn, v["scale"].exp(), v["opacity"].sigmoid(), v["color"])))  # fmt: skip
    wanted = rasterize(prepare(ours), CAMERA, module.NEAR).color
    found = splats.picture(CAMERA).detach().numpy()
    assert wanted.max() > 0.5
    np.testing.assert_allclose(found, wanted, atol=2e-4)


def test_training_comes_nearer_and_masked_pixels_teach_nothing(module, rng):
    target = some_splats(module, rng)
    cameras = [look_at((3 * np.sin(a), -3 * np.cos(a), 0.4), (0, 0, 0), (0, 0, 1), 50, 40, 30)
               for a in (0.0, 1.0, 2.0)]  # fmt: skip
    pictures = [target.picture(c).detach().clamp(0, 1).numpy() for c in cameras]
    views = [
        StoredView("v", np.rint(p * 255).astype(np.uint8), np.zeros((30, 40)),
                   np.ones((30, 40), bool), np.zeros((30, 40), np.uint8), c, False)
        for p, c in zip(pictures, cameras, strict=True)
    ]  # fmt: skip
    points = (target.values["place"].detach().numpy(), np.full((60, 3), 128, np.uint8))
    given = {"seed": 1, "degree": 0, "device": "cpu"}
    everything = [view.keep for view in views]
    before = module.train(views, points, everything, steps=0, **given)
    after = module.train(views, points, everything, steps=60, **given)
    (bad, low, _), _ = module.judge(before, views)
    (good, high, _), _ = module.judge(after, views)
    assert good > bad + 2 and high > low
    nothing = [np.zeros((30, 40), bool) for view in views]
    same = module.train(views, points, nothing, steps=3, **given)
    for name, value in before.values.items():
        np.testing.assert_array_equal(same.values[name].detach(), value.detach(), name)


def test_the_partner_in_clear_air_parts_what_falls_from_the_light(module, tmp_path, scene_folder):
    """Judged in the light of the rain little is lost; by the clear pictures nearly all is light."""
    more = ("--fps", "2", "--spacing", "0.04", "--extent", "1", "-q")
    training = {"steps": 30, "most": 300, "degree": 0, "say": lambda line: None}
    run = load("downstream").main
    typed = load("downstream").typed_words()
    assert typed.parse_args(["--against", "clear_air"]).against == "clear_air"
    assert typed.parse_args([]).against == "clear"
    given = tmp_path, str(scene_folder), (0, 50), 8, 48, 36, more
    table = run(*given, against="clear_air", **training)
    assert [(row["mm_per_hour"], row["left_out"]) for row in table] == [
        (50, name) for name in (module.WHAT_FALLS, *module.MASKS)
    ]  # fmt: skip
    assert table[0]["share"] == table[1]["share"] == 0 < table[2]["share"]
    found = json.loads((tmp_path / "table.json").read_text())
    assert found["against"] == "clear_air" and found["rows"] == table
    assert imageio.imread(tmp_path / "downstream.png").shape == (2 * 36, 4 * 48, 3)
    # The picture that is judged by is the partner: without what falls, with its light.
    views = [v for v in read_views(tmp_path / "data", 50, "clear_air") if v.held_out]
    rain = [v for v in read_views(tmp_path / "data", 50) if v.held_out]
    falls = np.mean([(a.picture != b.picture).mean() for a, b in zip(views, rain, strict=True)])
    assert 0 < falls < 0.9 and [v.name for v in views] == [v.name for v in rain]
    splats = module.Splats(np.zeros((4, 3), np.float32), np.zeros((4, 3)), 0, "cpu")
    (own, *_), _ = module.judge(splats, views)
    assert own != pytest.approx(module.judge(splats, rain)[0][0], abs=1e-6)
    by_clear = run(*given, against="clear", **training)
    assert [row["left_out"] for row in by_clear] == ["nothing", *module.MASKS]
    left = [row["share"] for row in by_clear]
    assert left[:2] == [0, 0] and 0 < left[2] < left[3] < 0.9
    assert all(5 < row["psnr"] < 60 and 0 < row["ssim"] < 1 for row in by_clear)
    assert by_clear[1]["psnr"] != pytest.approx(table[1]["psnr"], abs=0.1)
    with pytest.raises(ParameterError, match="against is 'wet'"):
        module.measure(tmp_path / "data", tmp_path, against="wet")


def test_a_set_without_partners_is_refused(module, tmp_path, scene_folder):
    more = ("--fps", "2", "--spacing", "0.04", "--extent", "1", "-q")
    folder = load("downstream").export(tmp_path, str(scene_folder), (0, 50), 4, 48, 36, more)
    with pytest.raises(ParameterError, match="export it again with --partners"):
        module.measure(folder, tmp_path, degree=0, against="clear_air", say=lambda line: None)
    with pytest.raises(ParameterError, match="has no partner dry at 0 mm/h"):
        read_views(folder, 0, "dry")


def test_metrics(module, rng):
    from skimage.metrics import structural_similarity

    a = rng.random((40, 50, 3)).astype(np.float32)
    b = np.clip(a + rng.normal(0, 0.1, a.shape), 0, 1).astype(np.float32)
    rules = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    wanted = structural_similarity(a, b, channel_axis=2, data_range=1, full=True, **rules)[1]
    found = module.ssim(torch.tensor(a), torch.tensor(b))
    np.testing.assert_allclose(found, wanted[5:-5, 5:-5], atol=2e-4)
    assert module.psnr(a, a + 0.1) == pytest.approx(20, abs=1e-4)
    turned = a @ np.array([[0.5, 0.1, 0], [0, 0.6, 0.1], [0.1, 0, 0.7]]) + 0.05
    np.testing.assert_allclose(module.tint_fitted(turned, a), a, atol=1e-6)
