"""A tiny scene on disk, and a way to run the command line in this process."""

from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from rainsim.cli import cli

TINY = ["--spacing", "0.04", "--extent", "1"]  # of the height map, in metres
SMALL = ["--width", "64"]


@pytest.fixture
def rainsim(tmp_path, monkeypatch):
    """Return a function that runs `rainsim ARGUMENTS` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RAINSIM_SCENES", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "no-data"))

    def run(*arguments):
        result = CliRunner().invoke(cli, [str(a) for a in arguments], prog_name="rainsim")
        assert result.exception is None or isinstance(result.exception, SystemExit), (
            result.exception
        )
        return SimpleNamespace(
            code=result.exit_code, out=result.stdout, err=result.stderr, error=_error(result.stderr)
        )

    return run


def _error(text):
    """The last line of stderr, which must be the only one that begins with Error."""
    errors = [line for line in text.splitlines() if line.startswith("Error: ")]
    assert len(errors) <= 1
    assert "Traceback" not in text
    return errors[0].removeprefix("Error: ") if errors else None
