"""The wait of a kernel that is looked up on disk for the processes that compile it."""

POOLS = []  # what compiles for this process at present, see `pool.Pool`


def wait_for(kernel):
    """Wait until no other process compiles the kernel "module:name", or is going to."""
    for pool in list(POOLS):
        pool.wait_for(kernel)
