"""Claims on parts: one holder at a time, taken over when stale, by one alone."""

import os
import subprocess
import sys
import threading
import time

import pytest

from rainsim.io import part_claims
from rainsim.io.part_claims import PartClaims, create

STALE = 0.3  # s


def left_behind(folder, part, host=None):
    """Claim a part as a process that has ended."""
    done = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"],
                          capture_output=True, text=True)  # fmt: skip
    who = f"process {done.stdout.strip()} on {host or part_claims.platform.node()} since then"
    assert create(folder / f"{part}.0", who)


def test_a_part_is_claimed_once(tmp_path):
    with PartClaims(tmp_path, 60) as one, PartClaims(tmp_path, 60) as other:
        assert one.take("a") and not other.take("a") and other.take("b") and not one.take("b")
        assert not one.take("a")  # it is one's already
        one.finish("a")
        assert not other.take("a")  # finished parts stay claimed
        other.give_up("b")
        assert one.take("b")
    assert sorted(os.listdir(tmp_path)) == ["a.0"]  # what was not finished was given up
    assert f"process {os.getpid()} on " in (tmp_path / "a.0").read_text()


def test_a_claim_of_a_dead_process_of_this_machine_is_taken_over_at_once(tmp_path):
    left_behind(tmp_path, "a")
    left_behind(tmp_path, "b", host="elsewhere")
    with PartClaims(tmp_path, 60) as claims:
        assert claims.take("a") and not claims.take("b")


def test_a_stale_claim_is_taken_over_and_a_refreshed_one_is_not(tmp_path):
    with PartClaims(tmp_path, STALE) as alive, PartClaims(tmp_path, STALE) as other:
        assert alive.take("kept")
        left_behind(tmp_path, "lost", host="elsewhere")
        began, got = time.monotonic(), False
        while not got and time.monotonic() < began + 10:
            got = other.take("lost")
            assert not other.take("kept")
            time.sleep(0.02)
        assert got and time.monotonic() - began >= STALE
        assert not alive.take("lost")


def test_who_hangs_loses_its_claim(tmp_path, monkeypatch):
    monkeypatch.setattr(part_claims, "PATIENCE", 1)
    with PartClaims(tmp_path, STALE) as hangs, PartClaims(tmp_path, STALE) as other:
        assert hangs.take("a")
        deadline = time.monotonic() + 10
        while not (got := other.take("a")) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert got


def test_of_many_takers_one_wins(tmp_path):
    for part in range(20):
        if part == 0:
            left_behind(tmp_path, part)
        else:
            create(tmp_path / f"{part}.0", (tmp_path / "0.0").read_text())
    start, won = threading.Barrier(8), []

    def take_all():
        with PartClaims(tmp_path, 60) as claims:
            start.wait()
            mine = [part for part in range(20) if claims.take(str(part))]
            won.append(mine)
            start.wait()

    threads = [threading.Thread(target=take_all) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(part for mine in won for part in mine) == list(range(20))


def test_without_hard_links_files_are_created_exclusively(tmp_path, monkeypatch):
    def refuse(*names):
        raise OSError(part_claims.errno.EPERM, "no links here")

    monkeypatch.setattr(part_claims.os, "link", refuse)
    assert create(tmp_path / "a", "x") and not create(tmp_path / "a", "y")
    assert (tmp_path / "a").read_text() == "x" and os.listdir(tmp_path) == ["a"]


def test_a_lost_answer_of_a_network_disk_is_no_refusal(tmp_path, monkeypatch):
    real = os.link

    def made_but_not_heard(old, new):
        real(old, new)
        raise FileExistsError(17, "again", str(new))

    monkeypatch.setattr(part_claims.os, "link", made_but_not_heard)
    assert create(tmp_path / "a", "x")


def test_a_folder_that_is_gone_is_an_error(tmp_path):
    with PartClaims(tmp_path / "gone", 60) as claims, pytest.raises(FileNotFoundError):
        claims.take("a")
