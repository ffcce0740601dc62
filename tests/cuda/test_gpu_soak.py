"""Renderers made and freed one after the other on a real GPU: `pytest -m gpu`."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.gpu
SOAK = Path(__file__).with_name("soak.py")
ROOT = SOAK.parents[2]


@pytest.mark.parametrize("spoil", [None, "3f", "ff"])
def test_pictures_do_not_depend_on_what_was_drawn_and_freed_before(spoil):
    """As fresh processes draw them; also where memory is full of other bytes than zeros."""
    roots = [str(ROOT), str(ROOT / "tests"), str(SOAK.parent), os.environ.get("PYTHONPATH", "")]
    own = {"PYTHONPATH": os.pathsep.join(filter(None, roots))}
    if spoil is not None:
        own |= {"NUMBA_CUDA_MEMORY_MANAGER": "guarded", "RAINSIM_SPOIL": spoil}
    command = [sys.executable, str(SOAK), "--renderers", "24"]
    done = subprocess.run(command, env=os.environ | own, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "Traceback" not in done.stderr
