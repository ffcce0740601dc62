"""Frames are shared out to workers; what comes back is checked."""

import hashlib
import re

import numpy as np
import pytest

from rainsim.errors import RainsimError
from rainsim.farm import chunks as chunks_file
from rainsim.farm.chunks import Chunks, accept
from rainsim.io.images import write_png


def test_all_frames_are_given_once_and_last_chunks_are_small():
    chunks, given, sizes = Chunks(range(100)), [], []
    while chunks.left:
        for worker in "ab":
            indices = chunks.give(worker, 2)
            if indices:
                assert indices == sorted(indices)
                given += indices
                sizes.append(len(indices))
                assert chunks.drawn(worker) == indices
    assert sorted(given) == list(range(100)) and max(sizes) == 16 and sizes[-1] == 1


def test_a_worker_goes_on_behind_what_it_drew():
    chunks = Chunks(range(40))
    first, second = chunks.give("a", 2), chunks.give("b", 2)
    assert (first[0], second[0]) == (0, 20)  # each has a part of its own
    chunks.failed("a", "it died")
    chunks.drawn("b")
    assert chunks.give("b", 2)[0] == second[-1] + 1  # not back to what the other lost
    assert chunks.give("a", 2) == first[:1]  # lost frames are given one by one


def test_a_frame_that_ends_all_its_workers_is_named():
    chunks = Chunks(range(3), tries=3)
    assert chunks.give("a", 1) == [0]
    chunks.failed("a", "it died")
    assert chunks.give("b", 1) == [0]
    chunks.failed("b", "it died")
    chunks.give("a", 1)
    with pytest.raises(RainsimError, match=r"frame 0 was given to workers 3 times.*it died.*0:1"):
        chunks.failed("a", "it died")
    assert chunks.give("b", 1) == [1] and chunks.left == 2


def test_who_takes_far_longer_than_the_others_hangs(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(chunks_file.time, "monotonic", lambda: now[0])
    chunks = Chunks(range(100))
    chunks.give("a", 2), chunks.give("b", 2)
    now[0] = 1700.0  # the first chunk compiles
    assert not chunks.hangs("a")
    now[0] = 1801.0
    assert chunks.hangs("a")
    now[0] = 16.0
    chunks.drawn("a")
    steps = chunks.give("a", 2)[-1] + 1 - 16  # it simulates what the other draws
    now[0] += 60 + 20 * 1.0 * steps - 1
    assert not chunks.hangs("a")
    now[0] += 2
    assert chunks.hangs("a")


def result(folder, index=3, shape=(48, 64, 3), **changes):
    """What a worker returns of a frame that it wrote to a folder."""
    (folder / "frames").mkdir(exist_ok=True)
    name = f"frames/{index:05d}.png"
    write_png(folder / name, np.full(shape, 9, np.uint8))
    facts = {"time": 0.1, "milliseconds": {}, "ledger": {}, "notes": []}
    files = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest()}
    return {"index": index, "files": files, "facts": facts, **changes}


def judged(folder, frames, indices=(3,)):
    return accept(frames, list(indices), folder, (48, 64), re.compile(r"[a-z/]+\d+\.png").fullmatch)


def test_what_a_worker_wrote_is_checked(tmp_path):
    assert judged(tmp_path, [result(tmp_path)]) is None
    for frames in (None, 3, [], [3], [{}], [result(tmp_path, 4)], [result(tmp_path)] * 2):
        assert "other frames" in judged(tmp_path, frames)
    for files in ({}, None, {"../../secret": "0"}, {"frames/00004.png": "0"}):
        assert "other files" in judged(tmp_path, [result(tmp_path, files=files)])
    evil = result(tmp_path)
    evil["files"] |= {"../x.png": "0"}
    assert "other files" in judged(tmp_path, [evil])
    assert "not complete" in judged(tmp_path, [result(tmp_path, facts={"time": 3})])
    assert "no picture of 64 x 48" in judged(tmp_path, [result(tmp_path, shape=(16, 64, 3))])
    good = result(tmp_path)
    (tmp_path / "frames/00003.png").write_bytes(b"cut")
    assert "damaged" in judged(tmp_path, [good])
    forged = {"frames/00003.png": hashlib.sha256(b"cut").hexdigest()}
    assert "no picture" in judged(tmp_path, [{**good, "files": forged}])


def test_what_a_worker_sent_is_checked_and_written(tmp_path):
    (tmp_path / "worker").mkdir()
    sent = result(tmp_path / "worker")
    name = "frames/00003.png"
    sent["bytes"] = {name: (tmp_path / "worker" / name).read_bytes()}
    for wrong in ({}, {name: b"other"}, {name: None}):
        assert "damaged" in judged(tmp_path, [{**sent, "bytes": wrong}])
        assert not (tmp_path / name).exists()
    assert judged(tmp_path, [sent]) is None
    assert (tmp_path / name).read_bytes() == sent["bytes"][name]
