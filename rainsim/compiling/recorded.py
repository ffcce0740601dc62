"""The recorded list: kernels that a use needs, their argument types and their times to compile.

`python -m benchmarks.record` makes the list; a test fails when it is out of date. At run time
an entry that no longer fits is skipped, and its kernel compiled when it is called, as one that is
not on the list.
"""

import json
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).with_name("kernels.json")
CUDA_FILE = Path(__file__).with_name("cuda_kernels.json")  # of uses on a GPU, recorded on one
SORT = "rainsim.cuda.splatting.sort:radix_sort"  # a library's, compiled where its driver is
TERRAIN = "terrain"  # the stage that a run begins with
STAGES = (TERRAIN, "frames")


@dataclass(frozen=True)
class Recorded:
    """A kernel as it was compiled for one list of arguments.

    kernel : str. "module:name".
    arguments : str. Their types, see `signatures`.
    seconds : float. Of one core, to compile it where it was recorded.
    stage : str. One of `STAGES`: when a run first calls it.
    uses : tuple of str. Of `uses.USES`, those that call it.
    """

    kernel: str
    arguments: str
    seconds: float
    stage: str
    uses: tuple

    @property
    def name(self):
        """The name in the list: the kernel and its argument types."""
        return f"{self.kernel}({self.arguments})"


def read_list(file=FILE):
    """Return the recorded kernels as a list of `Recorded`."""
    rows = json.loads(file.read_text(encoding="utf-8"))
    return [Recorded(**{**row, "uses": tuple(row["uses"])}) for row in rows]


def needed(uses, files=(FILE, CUDA_FILE)):
    """Return the entries that any of some uses need, each once."""
    entries = [entry for file in files if file.is_file() for entry in read_list(file)]
    return list({e.name: e for e in entries if set(e.uses) & set(uses)}.values())


def on_gpu(entry):
    """Return whether a kernel is one of the GPU's."""
    return entry.kernel.startswith("rainsim.cuda.")
