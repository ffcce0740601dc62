"""The commands of the command line, a file each."""

import os

# Products of small matrices gain nothing from threads of the linear algebra's own, which spin
# beside those of the kernels: half of a first run's processor time where there are 16 cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
