"""One OpenEXR file a frame: written parts make the beauty again, headers say what is in them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from made_shots import wet_shot
from rainsim.errors import ParameterError, RainsimError
from rainsim.io import exr as exr_files
from rainsim.numerics.color_spaces import SPACES, from_rec709, xyz_from
from rainsim.numerics.srgb import display
from rainsim.render import exr_frame
from rainsim.render.exr_frame import LAYERS, ExrFormat, parts_of, write_exr
from rainsim.render.rain_layers import NEAR_DROPS
from run_folders import exr_parts

ELEMENTS = ("near", "streaks", "spray", "splashes", "air")  # from the front to the back
# OpenColorIO's built-in transform of linear Rec. 709 to ACEScg, to ten places.
ACESCG = [
    [0.6130974024, 0.3395231462, 0.0473794514],
    [0.0701937225, 0.9163538791, 0.0134523985],
    [0.0206155929, 0.1095697729, 0.8698146342],
]
# Academy S-2014-004, annex B: ACEScg to CIE XYZ.
AP1_XYZ = [
    [0.6624541811, 0.1340042065, 0.1561876870],
    [0.2722287168, 0.6740817658, 0.0536895174],
    [-0.0055746495, 0.0040607335, 1.0103391003],
]


@pytest.fixture(scope="module")
def shot():
    """A frame of a small wet scene with the layers of an OpenEXR file: picture and report."""
    return wet_shot((*LAYERS, "drop_flow"))[:2]


def over(front, back):
    return front[..., :3] + (1 - front[..., 3:]) * back


def colors(part, names="RGB"):
    return np.stack([part[name].astype(np.float64) for name in names], axis=-1)


def put_together(parts):
    """The beauty, by the formula of `docs/layers.md`: with the rain whole, and with it apart."""
    share, cover = (parts[name]["Y"][..., None].astype(np.float64) for name in
                    ("fresnel", "coverage"))  # fmt: skip
    light = {name: colors(part) for name, part in parts.items() if "R" in part}
    water = (1 - share) * light["refraction"] + share * light["reflection"] + light["highlight"]
    scene = (1 - cover) * (light["wet"] + light["film"]) + cover * water + light["glare"]
    apart = scene
    for name in ELEMENTS[::-1]:
        apart = over(colors(parts[name], "RGBA"), apart)
    return over(colors(parts["rain"], "RGBA"), scene), apart


def test_the_matrix_of_acescg_is_the_published_one():
    np.testing.assert_allclose(from_rec709(SPACES["acescg"]), ACESCG, atol=1e-9)
    np.testing.assert_allclose(xyz_from(SPACES["acescg"]), AP1_XYZ, atol=1e-9)
    np.testing.assert_allclose(from_rec709(SPACES["rec709"]), np.eye(3), atol=1e-12)


@pytest.mark.parametrize("colorspace", ["rec709", "acescg"])
def test_written_parts_make_the_beauty(shot, tmp_path, colorspace):
    pytest.importorskip("OpenEXR")
    _, report = shot
    exr = ExrFormat(24.0, "a.%04d.exr", 1001, colorspace)
    name = write_exr(tmp_path, replace(report, exr=exr))
    assert name == "exr/a.1003.exr"
    assert [path.name for path in (tmp_path / "exr").iterdir()] == ["a.1003.exr"]
    parts = {part: channels for part, (_, channels) in exr_parts(tmp_path / name).items()}
    assert next(iter(parts)) == "beauty"  # what viewers show first
    beauty = colors(parts["beauty"])
    whole, apart = (np.mean((again - beauty) ** 2) for again in put_together(parts))
    assert max(whole, apart) < 1e-6  # 60 dB
    # Each part is needed: without it the beauty is another.
    for part in ("wet", "film", "reflection", "refraction", "highlight", "splashes", "streaks"):
        gone = {channel: np.zeros_like(values) for channel, values in parts[part].items()}
        again = put_together({**parts, part: gone})[1]
        if colors(parts[part]).any():
            assert np.mean((again - beauty) ** 2) > 10 * apart, part


def test_the_beauty_is_the_frame_before_its_tone_curve(shot):
    picture, report = shot
    beauty = report.aovs["beauty"].astype(np.float64)
    dark = beauty.max(axis=-1) < 0.5  # where the curve is that of sRGB
    assert dark.mean() > 0.3
    assert np.abs(display(beauty[dark]) * 255 - picture[dark]).max() <= 1
    written = colors(parts_of(report)["beauty"])
    np.testing.assert_allclose(written, beauty, rtol=1e-3, atol=1e-6)
    acescg = colors(parts_of(report, "acescg")["beauty"])
    np.testing.assert_allclose(acescg, beauty @ np.transpose(ACESCG), rtol=1e-3, atol=1e-6)


def test_headers_say_space_exposure_and_time(shot, tmp_path):
    openexr = pytest.importorskip("OpenEXR")
    _, report = shot
    for colorspace, space in SPACES.items():
        exr = ExrFormat(23.976, colorspace=colorspace)
        written = exr_parts(tmp_path / write_exr(tmp_path, replace(report, exr=exr)))
        header, _ = written["beauty"]
        assert np.allclose(header["chromaticities"], space.chromaticities)
        assert header["colorInteropID"] == space.identifier
        assert header["oiio:ColorSpace"] == space.name
        assert 2 ** header["rainsim:exposure_ev"] == pytest.approx(report.light["brightness"])
        assert header["imageCounter"] == report.index
        assert float(header["framesPerSecond"]) == pytest.approx(24000 / 1001, abs=1e-4)
        assert json.loads(header["rainsim:facts"])["weather"] == report.facts["weather"]
        assert "chromaticities" not in written["depth"][0]
        if hasattr(openexr, "checkColorMetadata"):
            for own, _ in written.values():
                assert openexr.checkColorMetadata(own, header) == openexr.OK
    types = {f"{part}.{name}": values.dtype for part, (_, channels) in written.items()
             for name, values in channels.items()}  # fmt: skip
    precise = {name for name, kind in types.items() if kind == np.float32}
    ids = {f"ids.{name}" for name in ("actor", "puddle", "class", "splash", "motion")}
    places = {"position.X", "position.Y", "position.Z", "depth.Z", "rain.Z"}
    places |= {f"{part}.Z" for part in ELEMENTS if part != "air"}
    assert precise == ids | places and set(types.values()) == {np.dtype("f2"), np.dtype("f4")}


def test_the_rain_has_parts_and_a_depth(shot):
    _, report = shot
    layers = report.aovs
    near, rain = layers["near_alpha"], layers["rain_alpha"]
    assert 0.01 < (near > 0).mean() and (near <= rain + 1e-6).all()
    assert (rain > near + 1e-3).any()  # others fall farther away
    z = layers["rain_depth"]
    falls = (rain > 0) | (layers["splash_alpha"] > 0)
    assert (np.isfinite(z) == falls).all() and (z <= layers["depth"])[falls].all()
    alone = falls & (rain < near + 1e-7) & (layers["splash_alpha"] == 0)
    assert alone.sum() > 100 and np.mean(z[alone] < NEAR_DROPS) > 0.9, np.mean(
        z[alone] < NEAR_DROPS
    )
    near_z, streak_z, spray_z = (layers[f"{n}_depth"] for n in ("near", "streak", "spray"))
    assert (np.isfinite(near_z) == (near > 0)).all() and near_z[near > 0].max() < NEAR_DROPS + 0.5
    both = np.isfinite(near_z) & np.isfinite(streak_z)
    assert both.sum() > 100 and np.mean(near_z[both] < streak_z[both]) > 0.9
    assert not np.isfinite(spray_z).any()  # nothing drives
    between = (near_z <= z + 1e-3) & (z <= streak_z + 1e-3)
    assert between[both & (layers["splash_alpha"] == 0)].mean() > 0.8
    parts = parts_of(report)
    through = np.prod([1 - parts[name]["A"].astype(np.float64) for name in ELEMENTS], axis=0)
    np.testing.assert_allclose(1 - parts["rain"]["A"], through, atol=2e-3)


def test_places_are_those_of_the_depth(shot):
    _, report = shot
    place, depth = report.aovs["position"], report.aovs["depth"]
    water = report.aovs["coverage"] > 0.5
    assert np.abs(place[water][:, 2]).max() < 0.5  # on the ground
    assert not place[~np.isfinite(depth)].any()
    matte = report.aovs["matte"]
    assert matte[np.isfinite(depth)].mean() > 0.9 and matte.min() >= 0 and matte.max() <= 1


def test_what_half_floats_cannot_hold_is_cut_off():
    values = exr_files.half(np.array([1e9, -1e9, 1.5, np.inf]))
    assert values.tolist() == [65504.0, -65504.0, 1.5, 65504.0]


@pytest.mark.parametrize("name", ["a.exr", "%04d.png", "a%s.exr", "%04d%04d.exr", "../%d.exr",
                                  "a b.%d.exr", ".%d.exr", "a%%.exr", "%5", ""])  # fmt: skip
def test_names_without_a_number_are_refused(name):
    with pytest.raises(ParameterError, match="--exr-name") as caught:
        ExrFormat(24.0, name)
    assert "\n" not in str(caught.value) and "give one such as rain.%04d.exr" in str(caught.value)


def test_bands_of_rows_make_no_difference(shot, monkeypatch):
    whole = parts_of(shot[1])
    monkeypatch.setattr(exr_frame, "ROWS", 5 * shot[0].shape[1])
    for part, channels in parts_of(shot[1]).items():
        for name, values in channels.items():
            np.testing.assert_array_equal(values, whole[part][name], err_msg=f"{part}.{name}")


def test_lamps_are_written_as_floats(shot, monkeypatch):
    _, report = shot
    monkeypatch.setattr(exr_frame, "ROWS", 5 * shot[0].shape[1])  # in one band of many
    aovs = {name: report.aovs[name] for name in LAYERS}
    for name in ("wet", "beauty"):
        aovs[name] = aovs[name] * np.float32(300 / aovs[name].max())
    parts = parts_of(replace(report, aovs=aovs))
    kinds = {part: channels["R"].dtype for part, channels in parts.items() if "R" in channels}
    assert kinds["wet"] == kinds["beauty"] == np.float32 and kinds["rain"] == np.float16


def test_names_count_from_the_first_frame():
    assert ExrFormat(24.0, "%d.exr", 1).path(9) == "exr/10.exr"
    assert ExrFormat(24.0, "a-%06d.exr", 7).path(0) == "exr/a-000007.exr"


def test_without_the_library_one_line_says_what_brings_it(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(RainsimError, match=r'pip install "rainsim\[exr\]"'):
        exr_files.require_exr()


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, rng):
    pytest.importorskip("OpenEXR")
    resource = pytest.importorskip("resource")
    noise = rng.random((200, 200)).astype(np.float32)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(RainsimError, match=r"could not be written.*make room") as caught:
            exr_files.write_parts(tmp_path / "a.exr", [("noise", {"R": noise}, {})], {}, 24.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())
