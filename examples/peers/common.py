"""The cases of `benchmarks water` for other programs: the same start, the same exact depth.

A program is a function `prepare(make, cells)` that returns `advance()`, which runs the case to its
end and returns the depth of the cells, ndarray of shape (ny, nx) [m]. Processor time is that of
`advance` alone: setting up is left out, as in the bench.
"""

import argparse
import time

from benchmarks.cases import error_of
from benchmarks.water import SUITE

CASES = {"stoker": 256, "ritter": 256, "bowl planar": 100, "bowl radial": 100, "ripple": 128}


def measure(prepare, name, cells):
    """Return the relative L1 error and the seconds of processor time of a program on a case."""
    make = SUITE[name][0]
    advance = prepare(make, cells)
    start = time.process_time()
    depth = advance()
    seconds = time.process_time() - start
    return error_of(make(cells), depth), seconds


def main(program, prepare, words=None):
    """Print error and time of each case that the command line names, or of all."""
    parser = argparse.ArgumentParser(description=program)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--cells", type=int, help="along the longer side; that of the table")
    given = parser.parse_args(words)
    for name in given.cases or CASES:
        if name not in CASES:
            parser.error(f"{name!r} is no case; give some of {', '.join(CASES)}")
        cells = given.cells or CASES[name]
        try:
            error, seconds = measure(prepare, name, cells)
        except Exception as problem:  # programs fail in ways of their own; the others go on
            print(f"{program:22s} {name:12s} {cells:4d} fails: {problem}".splitlines()[0])
            continue
        print(f"{program:22s} {name:12s} {cells:4d} error {error:.4f}  {seconds:8.3f} s")
