"""A disk that fills up or goes away at any moment: one line with path and remedy, then the same.

Every access to the output folder counts, and from the one of some number on all fail. The default
lane lets some fail, the slow one each in turn.
"""

import builtins
import errno
import io
import os
import tempfile

import pytest
from test_killed_runs import FRAMES, MAP

from rainsim.scene.folder import write_scene
from run_folders import written
from scenes import tiny_scene

WIDTH = ["--width", "64", "--relight", "off"]
STAGES = {
    "import": ["import", "tiny"],
    "heightmap": ["heightmap", "tiny", *MAP],
    "simulate": ["simulate", "map", *FRAMES[2:], "--frames", "2"],
    "render": ["render", "states", "--scene", "tiny", *WIDTH, "--layers", "depth"],
    "run": ["run", "--scene", "tiny", *MAP, *FRAMES[2:], "--frames", "2", *WIDTH],
}
# Moments for each error in the default lane; `render` writes frames as `run` does.
SOME = {"import": 2, "heightmap": 1, "simulate": 1, "run": 1}


class Disk:
    """Lets accesses to a folder fail from one on; counts them.

    Attributes
    ----------
    count : int
        Accesses so far.
    first : float
        The one from which on all fail.
    error : int
        ENOSPC: what writes fails, and a file that was opened takes no byte. Otherwise everything
        fails, as where a network disk is gone.
    """

    def __init__(self, folder, monkeypatch):
        self.folder, self.count = os.path.realpath(folder), 0
        self.first, self.error = float("inf"), errno.ENOSPC
        opens = self._opening(builtins.open)
        monkeypatch.setattr(builtins, "open", opens)
        monkeypatch.setattr(io, "open", opens)
        for name in ("open", "replace", "mkdir"):
            monkeypatch.setattr(os, name, self._failing(getattr(os, name)))
        for name in ("unlink", "stat", "listdir", "scandir"):
            monkeypatch.setattr(os, name, self._failing(getattr(os, name), writes=False))
        monkeypatch.setattr(tempfile, "_os", os)

    def _is_inside(self, path):
        if isinstance(path, int):
            return False
        return os.path.abspath(os.fspath(path)).startswith(self.folder)

    def _fails(self, path, writes):
        if not self._is_inside(path) or (self.error == errno.ENOSPC and not writes):
            return False
        self.count += 1
        return self.count >= self.first

    def _failing(self, real, writes=True):
        def access(path, *arguments, **named):
            if self._fails(path, writes):
                raise OSError(self.error, os.strerror(self.error), str(path))
            return real(path, *arguments, **named)

        return access

    def _opening(self, real):
        def opened(path, mode="r", *arguments, **named):
            if self._fails(path, not mode.startswith("r") or "+" in mode):
                if self.error != errno.ENOSPC:
                    raise OSError(self.error, os.strerror(self.error), str(path))
                path = "/dev/full"  # it opens, and takes no byte
            return real(path, mode, *arguments, **named)

        return opened


@pytest.fixture
def stage(rainsim, tmp_path):
    """Return a function that makes what a stage reads and returns a function that runs it."""

    def prepare(name):
        write_scene(tmp_path / "tiny", tiny_scene())
        if name in ("simulate", "render"):
            assert rainsim(*STAGES["heightmap"], "--out", "map").code == 0
        if name == "render":
            assert rainsim(*STAGES["simulate"], "--out", "states").code == 0
        return lambda out, *more: rainsim(*STAGES[name], "--out", out, "--quiet", *more)

    return prepare


def let_fail(run, folder, monkeypatch, moments):
    """Run a stage in one go, then with a disk that fails at some moments of `moments(count)`."""
    assert run("whole").code == 0
    whole = written(folder / "whole")
    for error in (errno.ENOSPC, errno.ESTALE):
        with monkeypatch.context() as patch:
            disk = Disk(folder / f"counted-{error}", patch)
            disk.error = error
            assert run(f"counted-{error}").code == 0
        assert disk.count > 5
        for moment in moments(disk.count):
            out = f"out-{error}-{moment}"
            with monkeypatch.context() as patch:
                broken = Disk(folder / out, patch)
                broken.error, broken.first = error, moment
                done = run(out)
            assert done.code == 1, (moment, disk.count, done)
            assert out in done.error and ";" in done.error, (moment, done.error)
            assert os.strerror(error) in done.error, (moment, done.error)
            again = run(out, "--resume")
            assert again.code == 0, (moment, again.error)
            assert written(folder / out) == whole, moment


@pytest.mark.parametrize("name", SOME)
def test_some_moments(stage, tmp_path, monkeypatch, name):
    def some(count):
        return [1 + (2 * n + 1) * count // (2 * SOME[name]) for n in range(SOME[name])]

    let_fail(stage(name), tmp_path, monkeypatch, some)


@pytest.mark.slow
@pytest.mark.parametrize("name", STAGES)
def test_every_moment(stage, tmp_path, monkeypatch, name):
    let_fail(stage(name), tmp_path, monkeypatch, lambda count: range(1, count))
