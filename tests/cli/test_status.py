"""What a command says while it works, without a terminal and with one."""

import io
import re
import sys
import threading
import time
from itertools import pairwise

import pytest

from rainsim.commands import status as module
from rainsim.commands.status import Status, in_words


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test moves on: a list with the time [s]."""
    now = [100.0]
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    return now


def test_counts_and_the_time_left_are_said_without_a_terminal(clock, capsys):
    status = Status()
    status.progress("frames", 0, 240)
    for done in range(1, 241):
        clock[0] += 20.0 if done == 1 else 2.0  # the first compiles
        status.progress("frames", done, 240)
    lines = capsys.readouterr().err.splitlines()
    assert "frames 21/240, 60 s so far, about 7 min left" in lines
    counts = [int(re.search(r"(\d+)/240", line)[1]) for line in lines]
    assert max(after - before for before, after in pairwise(counts)) <= 5
    assert len(lines) < 70


def test_a_stage_that_cannot_count_says_that_it_goes_on(monkeypatch, capsys):
    monkeypatch.setattr(module, "BEAT", 0.05)
    monkeypatch.setattr(module, "TICK", 0.01)
    threads = threading.active_count()
    with Status() as status:
        status.progress("terrain", 0, 1)
        time.sleep(0.3)
        status.progress("terrain", 1, 1)
        time.sleep(0.1)
        assert threading.active_count() == threads + 1
    assert threading.active_count() == threads
    lines = capsys.readouterr().err.splitlines()
    assert 1 <= len(lines) < 8
    assert all(line == "terrain, 0 s so far" for line in lines)


def test_notes_are_short_unless_all_are_asked_for(capsys):
    notes = ["sky: overcast; 12 splats", "albedo: 0.6", "SCALE IS ASSUMED: 1; --up"]
    Status(verbose=False).notes(notes)
    assert capsys.readouterr().err == "  sky: overcast\n  SCALE IS ASSUMED: 1; --up\n"
    Status().notes(notes)
    assert capsys.readouterr().err.count("\n") == 3


def test_quiet_is_quiet_and_nothing_ticks_outside_a_block(capsys):
    threads = threading.active_count()
    with Status(quiet=True) as quiet:
        quiet.progress("frames", 1, 2)
        assert threading.active_count() == threads
    Status().progress("frames", 0, 2)
    assert threading.active_count() == threads
    assert capsys.readouterr().err == ""


def test_compiling_says_how_long_it_will_take(clock, capsys):
    status = Status()
    status.compiling(0.0, 0, 80, 2)
    for second in range(1, 61):
        clock[0] += 1.0
        status.compiling(second / 60, second, 80, 2)
    lines = capsys.readouterr().err.splitlines()
    assert "compiling 10/80, about 50 s left" in lines and len(lines) < 12


def test_a_terminal_gets_a_bar_with_the_totals_that_are_found(monkeypatch):
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", screen)
    status = Status()
    status.progress("terrain", 0, 1)
    status.progress("terrain", 3, 8)
    status.progress("terrain", 8, 8)
    assert "3/8" in screen.getvalue() and "terrain" in screen.getvalue()


def test_times_in_words():
    assert [in_words(s) for s in (4.4, 99, 185, 7500)] == ["4 s", "99 s", "3 min", "2 h 5 min"]
