"""What runs without the compiler, `NUMBA_DISABLE_JIT=1 python -m pytest`: formulas and small loops.

Machine code reads past the end of an array without a word; Python raises IndexError.
"""

from __future__ import annotations

import os
from pathlib import Path

CHOSEN = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
NAMES = ("light", "grade", "moments", "splash", "crowns", "puddles", "surface", "watersurface")
"""Files of formulas, which take Python seconds, by their names."""

SLOW = {"test_splashes_per_area_and_second"}  # minutes in Python

# Machine code wraps whole numbers and takes the difference of infinities silently; numpy warns.
WARNINGS = "ignore::RuntimeWarning"


def is_plain(path):
    """Tell whether the tests of a file run without the compiler."""
    path = Path(path)
    return path.stem.removeprefix("test_") in NAMES
