"""Wrong input on the command line: one line with the value, the rule and the remedy."""

import json
import os
import re

import pytest

from made_formats import write_splats

MAP = ("--extent", 1, "--spacing", 0.04)


def splat_ply(path):
    from scenes import tiny_scene

    write_splats(path, tiny_scene().splats)
    return path


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--rain", "-1"], 2, "rain is -1.0 mm/h; it must not be negative"),
        (["--rain", "nan"], 2, "rain is nan; it must be a finite number"),
        (["--rain", "much"], 2, "Invalid value for '--rain': 'much' is not a valid float"),
        (["--wind", "3"], 2, "'3' is not 2 finite numbers speed,direction"),
        (["--sun", "high"], 2, "'high' is not 2 finite numbers azimuth,elevation without spaces"),
        (["--sky", "none.hdr"], 1, "there is no sky file none.hdr"),
        (["--frame-range", "3"], 2, "'3' is not a range A:B"),
        (["--preset", "drizle"], 2, "there is no preset 'drizle'; the nearest is 'drizzle'"),
        (["--preset", "none.toml"], 1, "none.toml does not exist"),
        (["--scene", "nowhere"], 2, "nowhere"),
        (["--scene", "no/where.ply"], 1, "no/where.ply"),
        (["--scene", "../bicycle"], 1, "../bicycle"),
        (["--scene", ".."], 1, "point_cloud"),
        (["--camera", "a", "--orbit"], 2, "--camera and --orbit are both given"),
        (["--eye", "0,0,0"], 2, "--eye is given without --look-at"),
        (["--look-at", "0,0,0"], 2, "--look-at is given without --eye"),
        (["--eye", "0,0"], 2, "'0,0' is not 3 finite numbers x,y,z"),
        (["--eye", "0,0,nan", "--look-at", "1,1,1"], 2, "is not 3 finite numbers"),
        (["--fov", "60"], 2, "--fov is given without --eye"),
        (["--no-such-option"], 2, "No such option"),
    ],
    ids=lambda v: "_".join(v) if isinstance(v, list) else None,
)
def test_a_bad_option_ends_in_one_line(rainsim, tmp_path, arguments, code, message):
    done = rainsim("run", *arguments)
    assert done.code == code
    assert message in done.error
    assert done.out == ""
    assert list(tmp_path.iterdir()) == []  # nothing was written


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--camera", "nobody"], 2, "has no camera 'nobody'; it must be one of its 3: view_0"),
        (["--camera", "view_7"], 2, "the nearest is 'view_"),
        (["--path", "none.json"], 1, "none.json does not exist"),
        (["--eye", "1,1,1", "--look-at", "0,0,0", "--fov", "200"], 2, "fov is 200"),
        (["--ground-frame", "none.json"], 1, "none.json"),
        (["--meters-per-unit", "-1"], 2, "meters-per-unit is -1"),
        (["--cameras", "none.json"], 1, "none.json"),
    ],
    ids=lambda v: "_".join(v) if isinstance(v, list) else None,
)
def test_a_bad_choice_for_a_scene_ends_in_one_line(
    rainsim, tmp_path, scene_folder, arguments, code, message
):
    done = rainsim("run", "--scene", scene_folder, *arguments)
    assert done.code == code
    assert message in done.error
    assert list(tmp_path.iterdir()) == []


def test_a_bare_file_is_drawn_and_says_what_is_assumed(rainsim, tmp_path):
    splat_ply(tmp_path / "s.ply")
    done = rainsim("run", "--scene", "./s.ply", "--frames", 1, "--width", 96, "--out", "wet", *MAP)
    assert done.code == 0, done.err
    assert (tmp_path / "wet/frames/00000.png").is_file()
    for assumed, remedy in (
        ("UP IS ASSUMED", "--up x,y,z"), ("if a unit is", "--meters-per-unit S"),
        ("camera view_0", "--eye and --look-at"),
    ):  # fmt: skip
        (line,) = (line for line in done.err.splitlines() if assumed in line)
        assert remedy in line
    done = rainsim("heightmap", "s.ply", *MAP, "--up", "0.727,-0.570,-0.383")
    assert done.code == 0 and "UP IS" not in done.err and "SCALE IS ASSUMED" in done.err, done.err
    done = rainsim("run", "--scene", "./s.ply", "--drive")
    assert done.code == 2 and "no cameras" in done.error and "--orbit" in done.error


def test_an_output_that_cannot_be_written(rainsim, tmp_path, scene_folder):
    (tmp_path / "file").write_text("mine")
    done = rainsim("run", "--scene", scene_folder, "--out", "file/under")
    assert done.code == 1 and "file" in done.error
    done = rainsim("run", "--scene", scene_folder, "--out", "file")
    assert done.code == 2
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write all")
def test_an_output_without_permission(rainsim, tmp_path, scene_folder):
    (tmp_path / "locked").mkdir(mode=0o500)
    done = rainsim("run", "--scene", scene_folder, "--out", "locked/out")
    assert done.code == 1 and "Permission denied" in done.error


def test_a_video_without_an_encoder_is_told_before_anything_is_drawn(
    rainsim, tmp_path, scene_folder, monkeypatch
):
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    done = rainsim("run", "--scene", scene_folder, "--video")
    assert done.code == 1
    assert 'pip install "rainsim[video]"' in done.error
    assert list(tmp_path.iterdir()) == []


def test_folders_that_are_not_what_a_stage_needs(rainsim, tmp_path):
    (tmp_path / "empty").mkdir()
    done = rainsim("render", "empty")
    assert done.code == 1 and "simulation.json" in done.error
    (tmp_path / "empty" / "simulation.json").write_text('{"settings": {"rain": {"rate": -1}}}')
    done = rainsim("render", "empty")
    assert done.code == 1 and "no usable settings" in done.error
    done = rainsim("simulate", "empty")
    assert done.code == 1 and "rainsim heightmap" in done.error
    done = rainsim("simulate", "nowhere")
    assert done.code == 1 and "nowhere" in done.error


def test_scenes_and_presets_are_listed(rainsim, scene_folder, monkeypatch):
    monkeypatch.setenv("RAINSIM_SCENES", str(scene_folder.parent))
    assert "tiny" in rainsim("scenes").out and "bicycle" in rainsim("scenes").out
    found = {row["name"]: row for row in json.loads(rainsim("scenes", "--json").out)}
    assert found["bicycle"]["built_in"] and not found["tiny"]["built_in"]
    assert rainsim("presets").out.split("\n")[0].startswith("drizzle   2.5 mm/h  Light")
    assert list(json.loads(rainsim("presets", "--json").out)) == [
        "drizzle",
        "moderate",
        "downpour",
        "flood",
        "after",
        "dusk",
        "paper",
    ]


def test_a_printed_preset_is_a_file_to_start_from(rainsim, tmp_path):
    text = rainsim("presets", "flood").out
    (tmp_path / "mine.toml").write_text(text)
    shown = json.loads(rainsim("presets", "mine.toml", "--json").out)
    assert shown == json.loads(rainsim("presets", "flood", "--json").out)
    assert shown["water"]["level"] > 0
    assert rainsim("presets", "floods").code == 2


def test_options_say_their_unit_and_default(rainsim):
    text = " ".join(rainsim("run", "--help-all").out.split())
    for words in ("mm/h", "in mm.", "m/s", "degrees", "in ms", "px", "default: (the preset's)"):
        assert words in text
    assert "[default: downpour]" in text


def test_the_usual_options_stand_in_groups(rainsim):
    short, full = (rainsim("run", name).out for name in ("--help", "--help-all"))
    assert len(re.findall("^  -", short, re.M)) <= 25 < len(re.findall("^  -", full, re.M))
    for heading in ("Scene:", "Rain:", "Look:", "Camera:", "Output:"):
        assert f"\n{heading}\n" in short and f"\n{heading}\n" in full
    assert "--water-scheme" in full and "--water-scheme" not in short


def test_what_can_be_known_is_refused_before_the_scene_is_read(rainsim, scene_folder, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.txt").write_text("mine")
    full = rainsim("run", scene_folder, "--out", "full")
    twice = rainsim("run", scene_folder, "--scene", "street")
    assert full.code == 2 and "--overwrite" in full.error and "scene" not in full.err
    assert twice.code == 2 and "both given" in twice.error


def test_a_cameras_name_is_checked_before_splats_are_read(rainsim, tmp_path, monkeypatch):
    from made_captures import write_model_folder
    from scenes import tiny_scene

    write_model_folder(tmp_path / "model", tiny_scene(), ["front", "left", "right"])
    monkeypatch.setattr("rainsim.scene.folder.read_splats", None)
    done = rainsim("run", "model", "--camera", "back")
    assert done.code == 2 and "no camera 'back'" in done.error


def test_presets_lists_all_keys(rainsim):
    import json

    from rainsim.config.preset_files import HUMAN_KEYS

    printed = rainsim("presets", "--keys").out.splitlines()
    assert [line.split()[0] for line in printed] == list(HUMAN_KEYS)
    rows = json.loads(rainsim("presets", "--keys", "--json").out)
    assert rows[0]["unit"] == "mm/h" and rows[0]["default"] == 10


def test_ctrl_c_while_the_command_line_is_loaded_is_one_line(monkeypatch, capsys):
    from rainsim import __main__ as entry

    def pressed():
        raise KeyboardInterrupt

    monkeypatch.setattr("rainsim.cli.main", pressed)
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert ended.value.code == 130 and capsys.readouterr().err == "interrupted\n"
