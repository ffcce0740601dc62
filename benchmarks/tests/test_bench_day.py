"""`benchmarks day`: its measures on pictures whose answer is known, its gardens, what it ships."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from benchmarks import day, day_capture, day_data, day_ground, day_score, day_shapes, day_trained
from benchmarks.day_case import Rain, Sun
from benchmarks.day_court import COURT
from benchmarks.day_data import REGIONS, Labels
from benchmarks.day_mitsuba import DULL, Garden, require_mitsuba, under_skin
from benchmarks.day_patio import PATIO
from benchmarks.day_remake import small
from rainsim.errors import InputError, ParameterError
from rainsim.scene.types import Splats

SHAPE = 40, 60


def labels():
    """Sky above, a wall beside paving half in the sun, a covered corner, a puddle."""
    region = np.full(SHAPE, REGIONS.index("paving"), np.uint8)
    region[:10] = REGIONS.index("sky")
    region[10:, :15] = REGIONS.index("wall")
    region[30:, 30:45] = REGIONS.index("puddle")
    lit = np.zeros(SHAPE, bool)
    lit[10:25, 15:] = True
    covered = np.zeros(SHAPE, bool)
    covered[25:30, 50:] = True
    return Labels(region, lit, covered, np.ones(SHAPE))


@pytest.fixture
def truth(rng):
    """Radiance with structure, its land at the level of the bench."""
    return day_score.align(rng.uniform(0.05, 0.3, (*SHAPE, 3)), labels())


def test_the_true_picture_is_perfect_at_any_exposure(truth):
    found = day_score.by_region(3 * truth, truth, labels(), 1 / 3)
    for measures in found.values():
        assert measures["ratio"] == pytest.approx(1) and measures["psnr"] == pytest.approx(120)
        assert measures["as_is"] == pytest.approx(120) and measures["ssim"] == pytest.approx(1)
        assert measures["color"] == pytest.approx(0, abs=1e-6)
    rungs = day_score.ladder(3 * truth, truth, labels())
    assert all(rung["psnr"] == pytest.approx(120) for rung in rungs.values())


def test_measures_are_those_of_the_region_alone(truth):
    where = labels()
    wrong = truth.copy()
    wrong[where.shows("wall")] *= 1.5
    found = day_score.by_region(wrong, truth, where, 1.0)
    share = day_score.LAND / day_score.luminance(wrong, ~where.shows("sky"))
    assert found["wall"]["ratio"] == pytest.approx(1.5 * share)
    assert found["paving"]["ratio"] == pytest.approx(share)
    assert found["paving"]["as_is"] == pytest.approx(120) and found["wall"]["as_is"] < 30
    error = day_score.shown(share * wrong) - day_score.shown(truth)
    paving = where.shows("paving")
    assert found["paving"]["psnr"] == pytest.approx(-10 * np.log10((error[paving] ** 2).mean()))
    pair = (rgb2lab(day_score.shown(v)) for v in (truth, share * wrong))
    assert found["wall"]["color"] == pytest.approx(
        deltaE_ciede2000(*pair)[where.shows("wall")].mean()
    )


def test_inner_leaves_are_those_away_from_the_sky(truth):
    where = labels()
    where.region[:] = REGIONS.index("leaf")
    where.region[:10] = REGIONS.index("sky")
    mixed = truth.copy()
    mixed[10 : 10 + day_score.EDGE] += 0.5  # leaves before the sky, of whose light they hold some
    found = day_score.by_region(mixed, truth, where, 1.0)
    inner = found["leaf, inner"]
    assert inner["share"] == pytest.approx(1 - (10 + day_score.EDGE) / SHAPE[0])
    assert found["leaf"]["psnr"] < inner["psnr"] - 1
    # What is left is the level alone, which the wrong pixels took from all land.
    assert inner["ratio"] == pytest.approx(
        day_score.LAND / day_score.luminance(mixed, ~where.shows("sky")), rel=1e-6
    )


def test_each_rung_of_the_ladder_repairs_what_it_says(truth):
    where = labels()
    shadow = truth.copy()
    shadow[where.shows("paving") & ~where.lit] *= 0.3
    rungs = day_score.ladder(shadow, truth, where)
    assert rungs["as is"]["psnr"] < 25 and rungs["shadows gone"]["psnr"] > 100
    level = truth.copy()
    level[where.shows("wall")] *= 0.5
    rungs = day_score.ladder(level, truth, where)
    assert rungs["shadows gone"]["psnr"] < 25 and rungs["levels right"]["psnr"] > 100
    blue = truth.copy()
    blue[where.shows("wall")] *= (0.5, 1, 2)
    rungs = day_score.ladder(blue, truth, where)
    assert rungs["levels right"]["psnr"] < 30 and rungs["colours right"]["psnr"] > 100


def test_scalars_are_quotients_of_what_they_name(truth):
    where = labels()
    even = np.full_like(truth, 0.2)
    even[where.shows("paving") & ~where.lit & ~where.covered] *= 0.25
    even[where.covered] *= 0.5
    found = day_score.ratios(even, where)
    assert found["shadow"] == pytest.approx(0.25) and found["under"] == pytest.approx(0.5)
    paving = where.shows("paving") & ~where.covered
    assert found["wall"] == pytest.approx(0.2 / day_score.luminance(even, paving))
    assert day_score.spread([1, 1, 1]) == 0 and day_score.spread([1, 3]) == pytest.approx(0.5)
    assert day_score.gloss(even, where, 2.0)["puddle"] == pytest.approx(0.1)


def test_patches_are_what_the_gain_has_beside_its_smooth_part(rng):
    where, row = labels(), np.arange(SHAPE[0])[:, None]
    clean = np.full((*SHAPE, 3), 0.5)
    smooth = np.broadcast_to(0.2 * np.exp(row / 200)[..., None], clean.shape)
    none = day_score.patches(smooth, clean, where)
    assert none["paving"] < 0.02 and none["wall"] < 0.02
    speckled = smooth * np.exp(0.1 * rng.choice([-1, 1], SHAPE))[..., None]
    found = day_score.patches(speckled, clean, where)
    assert found["paving"] == pytest.approx(0.1, rel=0.2)
    puddle = smooth * np.where(where.shows("puddle"), 3, 1)[..., None]
    assert day_score.patches(puddle, clean, where) == pytest.approx(none)


def test_the_shown_picture_is_the_programs_own():
    from rainsim.shading import composite

    radiance = np.linspace(0, 3, 256).astype(np.float32)
    image = np.empty(256, np.uint8)
    composite.encode(radiance, image)
    assert np.abs(255 * day_score.shown(radiance) - image).max() < 1.01


def test_pictures_colours_and_labels_come_back(rng):
    colors = rng.integers(0, 256, (500, 3), dtype=np.uint8)
    assert np.array_equal(day_data.unpack_colors(day_data.pack_colors(colors)), colors)
    light = rng.uniform(0, 2, (9, 7, 3))
    back = day_data.unpack_picture(day_data.pack_picture(light))
    assert np.abs(np.sqrt(back) - np.sqrt(light)).max() <= day_data.ROOT_STEP / 2 * 1.001
    before = labels()
    after = day_data.unpack_labels(day_data.pack_labels(before))
    for name in ("region", "lit", "covered"):
        assert np.array_equal(getattr(after, name), getattr(before, name))
    assert np.abs(after.openness - before.openness).max() <= 0.01


def test_full_dips_stand_at_their_spill_and_half_full_ones_hold_the_rain():
    y, x = np.mgrid[0:41, 0:61] / 20.0
    bed = 0.02 * np.minimum((x - 1) ** 2 + (y - 1) ** 2, 0.5) + 0.02 * np.maximum(x - 2, 0)
    full = day_ground.spill_level(bed)
    assert full[20, 20] == pytest.approx(0.01, abs=1e-6)
    level = day_ground.filled_level(bed, full, 1e-4)
    depth = np.where(level > bed, level - bed, 0)
    caught = depth.sum() / 1e-4  # cells whose rain stands in the dip
    assert (depth > 0).sum() < caught == pytest.approx(bed.size)
    assert np.ptp(level[depth > 0]) < 1e-12
    brim = day_ground.filled_level(bed, full, 1.0)
    assert np.allclose(brim[full > bed + 1e-6], full[full > bed + 1e-6])


def test_shapes_face_outwards_and_their_splats_lie_on_them():
    shapes = day_shapes.Shapes()
    shapes.box("box", (0, 0, 0), (1, 2, 3), 0.5, 0.1)
    shapes.tube("tube", (5, 0), 0.5, 0, 1, 0.5, 0.05)
    shapes.disk("disk", (9, 0), 0.5, 1.0, 1, 0.5, 0.05)
    for part, middle in (("box", (0.5, 1, 1.5)), ("tube", (5, 0, 0.5)), ("disk", (9, 0, 0))):
        mesh = shapes.meshes[part]
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        out = np.cross(b - a, c - a)
        apart = np.linalg.norm(out, axis=1) > 1e-9
        assert ((out * (a - middle)).sum(axis=1)[apart] > 0).all(), part
    spots, part, names = shapes.joined()
    assert names == ["box", "tube", "disk"]
    tube = spots.position[part == 1]
    assert np.allclose(np.hypot(tube[:, 0] - 5, tube[:, 1]), 0.5)
    assert np.allclose(np.linalg.norm(spots.normal, axis=1), 1)
    assert np.allclose((spots.normal * spots.along).sum(axis=1), 0)


def test_a_coat_over_a_skin_leaves_its_albedo():
    below = under_skin(np.array([0.1, 0.4]))
    assert np.allclose(0.934 * 0.5254 * below / (1 - 0.4746 * below), [0.1, 0.4], rtol=1e-3)


def test_the_sun_stands_where_it_is_said():
    sun = Sun((3.0, 4.0), 30.0, 3.0).direction
    assert np.allclose(sun, [0.6 * np.sqrt(0.75), 0.8 * np.sqrt(0.75), 0.5])


@pytest.mark.parametrize("case", [PATIO, COURT], ids=lambda case: case.name)
def test_what_is_shipped_belongs_to_the_geometry(case):
    shapes, _ = case.build()
    arrays = day_data.read(case.name)
    spots, _, _ = shapes.joined()
    assert arrays["checksum"] == day_data.checksum(spots)
    for baked in ("sun", "dull"):
        assert arrays[baked].shape == (3, len(spots.position))
    for rain in case.rains:
        for view in rain.views:
            where = day_data.unpack_labels(arrays[f"labels {view}"])
            light, _ = day.traced(arrays, f"{rain.name} {view}", where)
            assert light.shape == (*where.region.shape, 3) and where.shows("paving").mean() > 0.2
            assert day_score.luminance(light, ~where.shows("sky")) == pytest.approx(0.16)


def test_trained_captures_come_back(rng):
    position = rng.normal(0, 5, (50, 3)).astype(np.float32)
    rotation = rng.normal(0, 1, (50, 4)).astype(np.float32)
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    scale = np.exp(rng.uniform(-12, 1, (50, 3))).astype(np.float32)
    sh = rng.normal(0, 1, (50, 4, 3)).astype(np.float32)
    splats = Splats(position, rotation, scale, rng.uniform(0, 1, 50).astype(np.float32), sh)
    found = day_trained.unpack(day_trained.pack(splats))
    assert (np.abs(found.position - position) < 1e-4 * (1 + np.abs(position))).all()
    np.testing.assert_allclose(found.rotation, rotation, atol=0.01)
    np.testing.assert_allclose(found.scale, scale, rtol=0.05)
    np.testing.assert_allclose(found.opacity, splats.opacity, atol=0.003)
    np.testing.assert_allclose(found.sh[:, 0], sh[:, 0], atol=0.01)
    assert found.sh.shape == (50, 1, 3)


def test_trained_captures_have_their_cameras_and_truth():
    trained = list(day_trained.scenes())
    for name, scene, _ in trained:
        assert name in day_trained.NAMES and len(scene.splats) > 200_000
        names = [camera.name for camera in scene.cameras[:3]]
        assert names == ["test_c00", "test_c01", "test_c02"]
        assert len(scene.cameras) == 95
    arrays = trained[0][2]
    for view in range(3):
        where = day_data.unpack_labels(arrays[f"labels {view}"])
        truth, _ = day.traced(arrays, f"rain {view}", where)
        assert truth.shape == (210, 324, 3) and where.shows("puddle").any()
        assert day_score.luminance(truth, ~where.shows("sky")) == pytest.approx(day_score.LAND)


def test_the_files_are_small():
    files = {file: file.stat().st_size for file in day_data.FOLDER.glob("*.npz")}
    trained = [size for file, size in files.items() if file.name.startswith("trained")]
    assert len(trained) == 3 and sum(trained) < 9e6
    assert len(files) > 3 and sum(files.values()) - sum(trained) < 10e6


def test_wind_goes_the_same_way_in_any_ground_frame():
    scene = day_capture.capture(PATIO, *_tiny_capture())
    config = day_capture.settings(scene, Rain("wind", (), 0.01, (4.0, 0.3)), 96)
    x, y = config.rain.wind_velocity
    back = scene.ground_frame.rotation.T @ (x, y, 0)
    assert np.allclose(back, [4 * np.cos(0.3), 4 * np.sin(0.3), 0], atol=0.05)


def _tiny_capture():
    """Shapes, arrays and day of a bare court, for a capture of some thousand splats."""
    shapes = day_shapes.Shapes()
    shapes.rectangle("paving", (-4, -4, 0), (8, 0, 0), (0, 8, 0), 0.3, 0.1)
    shapes.leaves("leaf", day_shapes.leaf_cards(
        np.random.default_rng(0), 20, (0, 0, 1), (1, 1, 2), 0.1
    ), np.full((20, 3), 0.1))  # fmt: skip
    count = len(shapes.joined()[0].position)
    colors = day_data.pack_colors(np.full((count, 3), 140, np.uint8))
    dome = day_data.pack_colors(np.full((300, 3), 200, np.uint8))
    return shapes, {"dull": colors, "dull sky": dome}, "dull"


def test_what_is_missing_is_named_with_its_remedy(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(ParameterError, match=r"rainsim\[truth\]"):
        require_mitsuba()
    with pytest.raises(InputError, match="--remake"):
        day_data.read("patio", tmp_path)


def test_table_and_chart_hold_all_views_and_an_earlier_run(truth, tmp_path):
    pytest.importorskip("matplotlib")
    where, days = labels(), {}
    for name, factor in (("sun", 2.0), ("dull", 1.0)):
        picture = truth.copy()
        picture[where.shows("wall")] *= factor
        view = {
            "scalars": {"wall": factor}, "ladder": day_score.ladder(picture, truth, where),
            "regions": day_score.by_region(picture, truth, where, 1.0),
            "patches": {"drawn": {"wall": 0.1234}, "truth": {"wall": 0.04}},
        }  # fmt: skip
        days[name] = {"views": {0: view, 1: view}, "spread": 0.125, "choices": {}}
    result = {"cases": {"patio": days}, "seconds": 1.0, "before": {"cases": {"patio": days}}}
    text = day.table(result)
    assert "patio, sun" in text and "patio, dull" in text and "12.5%" in text
    assert text.count("camera 1") == 2 and "wall over paving" in text
    assert text.count("0.123 0.040") == 4
    day.draw(result, tmp_path / "chart.png")
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_open_ground_under_the_overcast_sky_has_its_known_radiance():
    pytest.importorskip("mitsuba")
    shapes = day_shapes.Shapes()
    shapes.rectangle("lawn", (-20, -20, 0), (40, 0, 0), (0, 40, 0), (0.3, 0.2, 0.1), 1.0)
    garden = Garden(require_mitsuba(), PATIO, shapes, None, DULL)
    places, down = np.tile([0, 0, 1.0], (8, 1)), np.tile([0, 0, -1.0], (8, 1))
    light = garden.radiance(places, down, 512, 1).mean(axis=0)
    sky = np.array([0.95, 1.0, 1.06]) * 7 / 9  # Moon and Spencer: E = 7/9 pi Lz
    assert np.allclose(light, sky * [0.3, 0.2, 0.1], rtol=0.02)


@pytest.mark.slow
def test_albedo_under_a_coat_lies_where_its_picture_has_it(monkeypatch):
    """A lawn under a coat: dark but for one bright corner, traced from above."""
    pytest.importorskip("mitsuba")
    shapes = day_shapes.Shapes()
    shapes.rectangle("lawn", (0, 0, 0), (4, 0, 0), (0, 4, 0), 0.1, 1.0)
    albedo = np.full((4, 4, 3), 0.1)
    albedo[0, 3] = 0.5  # the least y, the greatest x
    for name in ("lawn", "paving"):
        shapes.pictures[name] = day_shapes.Picture(albedo, (0, 4, 0, 4))
    away = {"type": "sphere", "center": [0, 0, -99], "radius": 1.0}
    monkeypatch.setattr(Garden, "_water", lambda *_: away)  # no puddles
    garden = Garden(require_mitsuba(), COURT, shapes, None, COURT.rains[0], False)
    places = np.array([[x, y, 1.0] for y in (0.5, 3.5) for x in (0.5, 3.5)])
    light = garden.radiance(places, np.tile([0, 0, -1.0], (4, 1)), 256, 1)[:, 1]
    assert light[1] > 3 * light[[0, 2, 3]].max()


@pytest.mark.parametrize("case", [PATIO, COURT], ids=lambda case: case.name)
def test_slabs_are_as_bright_in_the_traced_rain_as_in_the_dull_capture(case):
    """Slabs of the paving, told apart by place: capture and truth show the same ones."""
    _, paving = case.build()
    arrays = day_data.read(case.name)
    found = []
    for view in case.rains[0].views:
        camera = small(case.cameras()[view])
        where = day_data.unpack_labels(arrays[f"labels {view}"])
        x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
        y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
        ray = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
        ray = ray @ camera.camera_from_world[:3, :3]
        ray = ray[where.shows("paving")]
        place = camera.position + ray * (-camera.position[2] / ray[:, 2])[:, None]
        light = day_data.unpack_picture(arrays[f"rain dull {view}"])[where.shows("paving")]
        column = (place[:, 0] - paving.x[0]) / (paving.x[1] - paving.x[0])
        row = (place[:, 1] - paving.y[0]) / (paving.y[1] - paving.y[0])
        inside = (np.minimum(row, column) > 1) & (row < len(paving.y) - 1)
        inside &= column < len(paving.x) - 1
        albedo = paving.albedo[..., 1][row[inside].astype(int), column[inside].astype(int)]
        shade = where.openness[where.shows("paving")][inside]
        found.append((albedo, light[inside][:, 1] / np.maximum(shade, 0.1)))
    albedo, light = (np.concatenate(values) for values in zip(*found, strict=True))
    assert np.corrcoef(albedo, light)[0, 1] > 0.5


@pytest.mark.slow
def test_a_small_patio_made_again_is_like_the_one_shipped(tmp_path):
    pytest.importorskip("mitsuba")
    from benchmarks.day_remake import remake

    def build():
        shapes, paving = PATIO.build()
        arrays = "position", "normal", "along", "spacing"
        for part, lots in shapes.spots.items():
            thin = (day_shapes.Spots(*(getattr(lot, a)[::200] for a in arrays)) for lot in lots)
            shapes.spots[part] = list(thin)
        return shapes, paving

    def cameras():
        return [camera.resized(64, 42) for camera in PATIO.cameras()]

    rain = replace(PATIO.rains[0], views=(0,))
    case = replace(PATIO, name="tiny", build=build, cameras=cameras, rains=(rain,))
    remake([case], tmp_path, baked=8, traced=64)
    made, shipped = day_data.read("tiny", tmp_path), day_data.read("patio")
    for name in ("rain 0", "rain dull 0"):
        one, other = (day_data.unpack_picture(a[name]).mean(axis=(0, 1)) for a in (made, shipped))
        assert np.allclose(one, other, rtol=0.03), name
    for baked in ("sun", "dull"):
        one, other = (day_data.unpack_colors(a[baked]).mean(axis=0) for a in (made, shipped))
        assert np.allclose(one, other, rtol=0.05), baked


@pytest.mark.slow
def test_a_view_of_the_patio_has_the_known_figures():
    result = day.run(quick=True)
    view = result["cases"]["patio"]["sun"]["views"][0]
    rungs = [view["ladder"][name]["psnr"] for name in day_score.LADDER]
    assert 23.5 < rungs[0] < rungs[-1] < 32
    limits = {"shadow": (0.7, 1.3), "wall": (0.6, 1.5), "under": (0.7, 1.5), "zenith": (0.7, 1.6)}
    for name, (low, high) in limits.items():
        assert low < view["scalars"][name] < high, name
    assert view["regions"]["land"]["ratio"] == pytest.approx(1)
    assert "camera 0" in day.table(result)
