"""Every example runs, at tiny size."""

import importlib.util
import inspect
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from scenes import tiny_scene

FOLDER = Path(__file__).resolve().parent.parent.parent / "examples"
EXAMPLES = sorted(path.stem for path in FOLDER.glob("*.py"))
TINY = {"spacing": 0.04, "extent": 1.0}


def load(name):
    spec = importlib.util.spec_from_file_location(f"example_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_a_script_with_a_main(name):
    text = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    assert 'if __name__ == "__main__":\n    main()\n' in text
    for parameter in inspect.signature(load(name).main).parameters.values():
        optional = parameter.default is not parameter.empty
        assert optional or parameter.kind is parameter.VAR_KEYWORD


def test_ten_lines(tmp_path, capsys):
    load("ten_lines").main(tmp_path, tiny_scene(), width=64, frames=2, **TINY)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["00000.png", "00001.png"]
    assert "frame 1: " in capsys.readouterr().out


def test_height_map(tmp_path, capsys):
    depth = load("height_map").main(tmp_path, tiny_scene(), **TINY)
    text = capsys.readouterr().out
    assert (tmp_path / "hillshade.png").is_file()
    assert "litres stand" in text
    assert 1e-3 < depth.max() < 15e-3  # the dip of 10 mm holds water


def test_camera_path(tmp_path):
    module = load("camera_path")
    module.main(tmp_path, tiny_scene(), frames=2, width=64, height=48, **TINY)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "00000.png", "00001.png", "transforms.json",
    ]  # fmt: skip
    scene = tiny_scene()
    near, far = (np.linalg.norm(camera.position) for camera in module.dolly(scene, 2, 64, 48))
    assert near != far


@pytest.mark.parametrize("space", ["rec709", "acescg"])
def test_rain_over_a_plate(tmp_path, space):
    """Over white, over a plate in ACEScg, and none of it behind a plate that is nearer."""
    pytest.importorskip("OpenEXR")
    from rainsim.io.exr import half, write_parts
    from rainsim.io.images import read_image, write_png
    from rainsim.numerics.color_spaces import SPACES, from_rec709

    def part(name, color, depth, space, alpha=0.5):
        own = from_rec709(SPACES[space]) @ color
        channels = dict(zip("RGBAZ", (*own, alpha, depth), strict=True))
        channels = {k: half(np.full((4, 6), v)) for k, v in channels.items()}
        return name, channels, {"chromaticities": SPACES[space].chromaticities}

    def over(*plate):
        load("rain_over_a_plate").main([*map(str, (tmp_path / "exr", "--out", out, *plate))])
        return read_image(out / "a.0001.png")

    def shown(light):
        return np.rint(255 * (1.055 * np.array(light) ** (1 / 2.4) - 0.055))

    (tmp_path / "exr").mkdir()
    out, rain = tmp_path / "over", (0.1, 0.2, 0.0)
    names = {"near": 0.5, "streaks": 0, "spray": 0, "splashes": 0, "air": 0.5}
    parts = [part(n, np.multiply(rain, a / 0.5), 3.0, space, a) for n, a in names.items()]
    write_parts(tmp_path / "exr/a.0001.exr", parts, {}, 24.0)
    write_png(tmp_path / "plate.png", np.full((4, 6, 3), 255, np.uint8))
    picture = over("--plate", tmp_path / "plate.png")
    assert np.abs(picture - shown((0.6, 0.7, 0.5))).max() <= 1  # half of white shows through
    assert picture.shape == (4, 6, 3)
    assert np.abs(over() - shown((0.19, 0.29, 0.09))).max() <= 1
    for depth, light in ((2.0, (0.4, 0.2, 0.3)), (4.0, (0.3, 0.3, 0.15))):
        plate = part("beauty", (0.4, 0.2, 0.3), depth, "acescg")
        write_parts(tmp_path / "plate.exr", [plate], {}, 24.0)
        assert np.abs(over("--plate", tmp_path / "plate.exr") - shown(light)).max() <= 1
    write_png(tmp_path / "plate.png", np.full((4, 7, 3), 255, np.uint8))
    with pytest.raises(SystemExit):
        over("--plate", tmp_path / "plate.png")


def test_solver_on_a_basin(capsys):
    load("solver_on_a_basin").main(cells=16, seconds=1)
    assert any(character.isdigit() for character in capsys.readouterr().out)


def test_film_on_a_slope(capsys):
    depth, exact = load("film_on_a_slope").main()
    np.testing.assert_allclose(depth[8:-2], exact[8:-2], rtol=0.03)
    assert "mm deep, exactly" in capsys.readouterr().out


def test_contact_sheet(tmp_path):
    scene, sheet = tiny_scene(), tmp_path / "sheet.png"
    module = load("contact_sheet")
    module.main(sheet, scene, presets=("downpour",), views=2, width=64, **TINY)
    picture = imageio.imread(sheet)
    assert picture.shape == (2 * 48, 2 * 64, 3)
    dry, rainy = picture[:48].astype(float), picture[48:].astype(float)
    assert np.abs(dry - rainy).mean() > 5
    # The same place: both pictures show the same edges where the capture has splats.
    land = dry.max(axis=-1) > 10
    same, turned = (
        np.corrcoef(dry[land].ravel(), other[land].ravel())[0, 1]
        for other in (rainy, rainy[:, ::-1])
    )
    assert land.mean() > 0.3 and same > 0.5 and same > turned + 0.2
    low, steep = module.views_of(scene, 2)
    assert low.forward @ scene.ground_frame.up > steep.forward @ scene.ground_frame.up


def test_parts_of_the_rain(capsys):
    module = load("parts_of_the_rain")
    presets = ("flood", "downpour", "after")
    module.main(tiny_scene(), ("view_1",), presets, width=96, **TINY)
    wet, heavy, dry = (line.split("|") for line in capsys.readouterr().out.splitlines()[2:])
    assert wet[2:3] == [" flood "] and float(wet[5].strip(" %")) > 0.5 and float(wet[6]) > 0.002
    assert float(heavy[4].strip(" %")) > 0.04 and float(heavy[6]) > 2 * float(wet[6])
    assert [cell.strip(" %") for cell in dry[3:7]] == ["0.0", "0.0", "0.0", "0.000"]


@pytest.mark.slow
def test_beside_the_paper(capsys):
    load("beside_the_paper").main(tiny_scene(), width=64, frames=3, **TINY)
    paper, ours = (line.split("|") for line in capsys.readouterr().out.splitlines()[2:])
    assert "the paper's choices" in paper[1] and "defaults" in ours[1]
    assert all(0 < float(row[4].strip(" %")) < 100 for row in (paper, ours))
    assert float(paper[5].strip(" %")) > 2 * float(ours[5].strip(" %")) > 0  # opaque streaks
    assert all(float(row[k].split()[0]) > 0 for row in (paper, ours) for k in (2, 3))


def test_smog_and_flood(tmp_path, capsys):
    load("smog_and_flood").main(tmp_path / "both.jpg", tiny_scene(), 0, width=64, **TINY)
    *rates, flood = capsys.readouterr().out.splitlines()
    extinction = [float(line.split()[2]) for line in rates[::2]]
    rain, smog = zip(
        *((float(x[2].strip(",")), float(x[4])) for x in map(str.split, rates[1::2])), strict=True
    )
    assert extinction == sorted(extinction) and extinction[0] > 0
    np.testing.assert_allclose(rain, smog, rtol=0.5)
    assert 5 < float(flood.split()[1]) < 40
    assert imageio.imread(tmp_path / "both.jpg").shape == (48, 128, 3)


def test_every_example_is_run_here():
    tests = sorted(Path(__file__).parents[1].glob("*/test_*.py"))
    text = "".join(test.read_text(encoding="utf-8") for test in tests)
    for name in EXAMPLES:
        assert f'load("{name}")' in text or f"examples/{name}.py" in text


def test_flat_rain(tmp_path, capsys):
    settings = {"width": 96, "rates": (50,), "views": 1, **TINY}
    load("flat_rain").main(tmp_path / "pair.png", tiny_scene(), **settings)
    picture = imageio.imread(tmp_path / "pair.png")
    assert picture.shape == (144, 192) and picture.any()
    line = capsys.readouterr().out.splitlines()[-1]
    rate, ours, _, theirs, _ = line.split()
    assert rate == "50" and 0 <= float(theirs) <= 1 and 0 <= float(ours) <= 1


def test_the_notebook(monkeypatch, capsys):
    import json

    import rainsim

    notebook = json.loads((FOLDER / "steps.ipynb").read_text(encoding="utf-8"))
    monkeypatch.setattr(rainsim, "load_scene", lambda name: tiny_scene(), raising=False)
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"] and cell["execution_count"] is None
            exec("".join(cell["source"]), names)
    printed = capsys.readouterr().out
    assert "of the pixels show water" in printed and printed.count("residual") == 3
    assert names["picture"].shape == (240, 320, 3) and names["water"].max() > 0
