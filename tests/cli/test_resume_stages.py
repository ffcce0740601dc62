"""The stages of one step, gone on with: the same map or scene again, or a refusal."""

import json

MAP = ["--spacing", "0.04", "--extent", "1"]


def contents(folder):
    """The files of a folder by name, without the record, which holds times."""
    return {
        path.name: path.read_bytes() for path in folder.iterdir() if path.name != "provenance.json"
    }


def unfinished(folder, *names):
    """Make a folder look as if its run had been killed: files gone, the record not complete."""
    record = json.loads((folder / "provenance.json").read_text())
    left = {"complete": False, "files": []}
    (folder / "provenance.json").write_text(json.dumps(record | left))
    for name in names:
        (folder / name).unlink()
    (folder / ".bed.tif.abcd1234.tif").write_text("half")


def test_height_maps_and_scenes(rainsim, scene_folder, tmp_path):
    map_of = ["heightmap", scene_folder, "--out", "map"]
    assert rainsim(*map_of, *MAP).code == 0
    whole = contents(tmp_path / "map")
    unfinished(tmp_path / "map", "classes.png", "bed.tif")
    refused = rainsim(*map_of, "--resume", "--spacing", "0.05", "--extent", "1")
    assert refused.code == 2 and "was another" in refused.error
    done = rainsim(*map_of, *MAP, "--resume")
    assert done.code == 0, done.err
    assert contents(tmp_path / "map") == whole
    assert json.loads((tmp_path / "map" / "provenance.json").read_text())["complete"]

    assert rainsim("import", scene_folder, "--out", "scene").code == 0
    whole = contents(tmp_path / "scene")
    unfinished(tmp_path / "scene", "splats.npz")
    done = rainsim("import", scene_folder, "--out", "scene", "--resume")
    assert done.code == 0, done.err
    assert contents(tmp_path / "scene") == whole
    other = ["import", scene_folder, "--meters-per-unit", "2", "--out", "scene", "--resume"]
    assert rainsim(*other).code == 2
