"""Lists of views to train on, to validate and to test: no view is in two."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from test_datasets import plan_with, sample_of, write_set

from benchmarks.downstream import measure
from rainsim.datasets import LAYOUTS, acdc, cityscapes, nerfstudio
from rainsim.datasets.splits import check_hold_out, held_out, lists_of, split_note, usual_hold_out
from rainsim.errors import ParameterError

SPLITS = "train", "val", "test"


def views_of(count, every):
    views = plan_with(count=count).views
    return held_out(views, every)


@pytest.mark.parametrize("count", [*range(1, 20), 24, 48])
def test_no_view_is_in_two_lists_and_none_is_lost(count):
    for every in {usual_hold_out(count), 0, *range(2, min(count, 9) + 1)}:
        views = views_of(count, every)
        train, val, test = lists_of(views)
        assert sorted(v.index for v in (*train, *val, *test)) == list(range(count))
        assert len(train) > 0 and 0 <= len(test) - len(val) <= 1
        plan = SimpleNamespace(views=views)
        meta = json.loads(json.dumps(nerfstudio.transforms(plan)))
        named = [name for split in SPLITS for name in meta[f"{split}_filenames"]]
        assert sorted(named) == sorted(frame["file_path"] for frame in meta["frames"])


def test_the_usual_hold_out_leaves_no_list_empty():
    assert [usual_hold_out(n) for n in (1, 3, 4, 5, 8, 15, 16, 40)] == [0, 0, 2, 2, 4, 7, 8, 8]
    for count in range(4, 60):
        assert all(lists_of(views_of(count, usual_hold_out(count))))
    # As it was from 16 views on: every eighth, the last of each eight.
    assert [v.index for v in views_of(48, usual_hold_out(48)) if v.held_out] == [*range(7, 48, 8)]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_hold_out_that_holds_out_none_is_refused(layout):
    for every, count in ((0, 1), (0, 9), (2, 2), (9, 9), (8, 100)):
        check_hold_out(every, count, layout)
    with pytest.raises(ParameterError, match="is 8 and holds out none of 4 views; it must be from"):
        check_hold_out(8, 4, layout)
    if layout == "nerfstudio":
        with pytest.raises(ParameterError, match="none of 1 view; it must be 0 for none; leave"):
            check_hold_out(2, 1, layout)
        with pytest.raises(ParameterError, match="is 1 and holds out all of 4 views"):
            check_hold_out(1, 4, layout)
    else:
        check_hold_out(1, 4, layout)  # nothing but tests: no loader of theirs needs more


def test_an_empty_list_is_said_with_what_fills_it():
    def note(count, every, layout="nerfstudio"):
        return split_note(views_of(count, every), layout)

    assert note(16, 8) == "16 views: 14 in train, 1 in val, 1 in test"
    empty = "WARNING: 4 views: 4 in train, 0 in val, 0 in test; val and test hold no picture; give "
    assert note(4, 0) == empty + "--hold-out 2"
    assert note(12, 8).endswith("1 in test; val holds no picture; give --hold-out 6")
    assert note(1, 0).startswith("WARNING: 1 view: 1 in train") and note(1, 0).endswith("or more")
    rigged = [replace(view, mount="left", step=view.index // 3) for view in views_of(6, 0)]
    told = split_note(rigged, "nerfstudio")
    assert told.endswith("take 4 views or more of the path, which has 2")
    for count, every in ((4, 0), (12, 8), (30, 29)):  # the remedy is one
        told = int(note(count, every).rpartition(" ")[2])
        assert "WARNING" not in note(count, told)
    assert note(4, 2, "cityscapes") == "4 views: 2 in train, 2 in val"
    assert note(4, 1, "cityscapes").endswith("train holds no picture; give a greater --hold-out")
    assert note(9, 8, "colmap") == (
        "1 of 9 views held out for tests; card.json names them, files are not split"
    )
    told = note(9, 8, "colmap") + "; in a sequence the pair before each shows it, too: do not train"
    assert note(9, 8, "kitti").startswith(told)
    assert note(9, 0, "colmap") == "0 of 9 views held out for tests; files are not split"


@pytest.mark.parametrize("layout", [acdc, cityscapes])
def test_no_picture_lies_in_two_folders(layout):
    plan = plan_with(count=7)
    places = {}
    for index in range(7):
        for rate in plan.rates:
            for file in layout.sample_files(sample_of(plan, index, rate=rate), plan):
                split = next(p for p in file.name.split("/") if p[:3] in ("tra", "val"))
                split = split.removesuffix("_ref")
                places.setdefault(index, set()).add(split)
    assert [places[k] for k in range(7)] == [
        {"val"} if view.held_out else {"train"} for view in plan.views
    ]
    assert sum(view.held_out for view in plan.views) == 2


def test_what_is_judged_by_held_out_views_needs_some(tmp_path):
    plan = plan_with(count=2)  # every third of two is held out: none
    write_set(tmp_path, plan, views=["v0", "v1"])
    for name in ("images", "depths", "masks", "rainsim/class_id"):
        (tmp_path / "clear" / name).mkdir(parents=True, exist_ok=True)
        for path in (tmp_path / "rain/10mm" / name).iterdir():
            (tmp_path / "clear" / name / path.name).write_bytes(path.read_bytes())
    with pytest.raises(ParameterError, match="holds out none of its 2 views"):
        measure(tmp_path, tmp_path)
