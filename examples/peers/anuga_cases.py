"""ANUGA 4.1.0 on the cases of the bench: python examples/peers/anuga_cases.py [CASE ...].

Each square has four triangles. They get bed, depth and velocity of their own centres, which are
cells of the case at a third of the spacing; the depth of a square is the mean of its triangles.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # read when ANUGA is imported

import anuga
import numpy as np
from common import main


def prepare(algorithm):
    """Return the function that prepares a case for an algorithm of ANUGA."""

    def prepared(make, cells):
        case, fine = make(cells), make(3 * cells)
        (ny, nx), side = case.bed.shape, case.spacing
        domain = anuga.rectangular_cross_domain(nx, ny, nx * side, ny * side)
        domain.set_flow_algorithm(algorithm)
        domain.set_store(False)
        domain.g, domain.verbose = 9.81, False
        centres = domain.get_centroid_coordinates() / side
        rows, columns = (np.floor(3 * centres[:, k]).astype(int) for k in (1, 0))
        at = rows % fine.bed.shape[0], columns
        bed, depth = fine.bed[at], fine.depth[at]
        v = np.broadcast_to(fine.v, fine.bed.shape)[at]
        values = {"elevation": bed, "stage": bed + depth, "friction": 0 * bed,
                  "ymomentum": depth * v}  # fmt: skip
        for name, numbers in values.items():
            domain.set_quantity(name, numeric=numbers, location="centroids")
        wall = anuga.Reflective_boundary(domain)
        domain.set_boundary(dict.fromkeys(("left", "right", "top", "bottom"), wall))

        def advance():
            for _ in domain.evolve(yieldstep=case.duration, finaltime=case.duration):
                pass
            level, bed = (domain.quantities[k].centroid_values for k in ("stage", "elevation"))
            sums = np.bincount(rows // 3 * nx + columns // 3, level - bed)
            return sums.reshape(ny, nx) / 4

        return advance

    return prepared


if __name__ == "__main__":
    for name in ("DE1", "DE0"):
        main(f"ANUGA {name}", prepare(name))
