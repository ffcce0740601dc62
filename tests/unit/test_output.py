"""Output folders: what is not ours stays, whatever a record in the folder says."""

import json

import pytest

from rainsim.errors import ParameterError
from rainsim.output import PROVENANCE, Record, claimed, read_record


def test_a_folder_that_stays_empty_is_removed_with_those_above_it(tmp_path):
    with claimed(tmp_path / "a" / "b") as folder:
        assert folder.is_dir()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine").mkdir()
    with claimed(tmp_path / "mine"):  # empty, but not made by us
        pass
    assert (tmp_path / "mine").is_dir()


def test_a_filled_folder_stays_also_after_an_error(tmp_path):
    with pytest.raises(RuntimeError), claimed(tmp_path / "a") as folder:
        (folder / "result").write_text("half")
        raise RuntimeError
    assert (tmp_path / "a" / "result").read_text() == "half"


def test_a_folder_in_use_needs_overwrite(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ParameterError, match="not empty; it must be new or empty"):
        with claimed(tmp_path):
            pass
    with claimed(tmp_path, overwrite=True):
        pass
    assert (tmp_path / "mine.txt").read_text() == "mine"
    with pytest.raises(ParameterError, match=r"mine\.txt is a file; it must be a folder"):
        with claimed(tmp_path / "mine.txt", overwrite=True):
            pass


def _written(folder, *names, **facts):
    record = Record(folder, **facts)
    record.begin()
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("ours")
    record.add(*names)
    record.write(complete=True)


def test_results_of_other_settings_are_cleared_and_of_the_same_are_kept(tmp_path):
    _written(tmp_path, "frames/00000.png", "frames/00001.png", seed=1)
    _written(tmp_path, "frames/00002.png", seed=1)
    assert read_record(tmp_path)["files"] == [f"frames/0000{n}.png" for n in range(3)]
    assert len(list((tmp_path / "frames").iterdir())) == 3
    _written(tmp_path, "frames/00001.png", seed=2)
    assert [path.name for path in (tmp_path / "frames").iterdir()] == ["00001.png"]


def test_a_forged_record_removes_nothing_that_is_not_ours(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (tmp_path / "precious.txt").write_text("mine")
    (folder / "notes.md").write_text("mine")
    forged = ["../precious.txt", "notes.md", "frames/../../precious.txt", 3, None]
    record = {"program": "rainsim", "fingerprint": "other", "files": forged}
    (folder / PROVENANCE).write_text(json.dumps(record))
    _written(folder, "frames/00000.png")
    assert (tmp_path / "precious.txt").exists() and (folder / "notes.md").exists()


@pytest.mark.parametrize("text", ["", "[]", "{", '{"program": "other", "files": ["scene.json"]}'])
def test_a_record_that_is_not_ours_counts_for_nothing(tmp_path, text):
    (tmp_path / PROVENANCE).write_text(text)
    (tmp_path / "scene.json").write_text("mine")
    assert read_record(tmp_path) == {}
    Record(tmp_path).begin()
    assert (tmp_path / "scene.json").exists()
