"""PyClaw of Clawpack 5.14.0: python examples/peers/pyclaw_cases.py [CASE ...].

With GeoClaw's Riemann solver (`sw_aug_2D`), the van Leer limiter and walls; dry is less than a
micrometre, as in rainsim. Its installation needs a Fortran compiler.
"""

import logging

import numpy as np
from clawpack import pyclaw, riemann
from common import main


def prepare(make, cells):
    """Return the function that runs a case."""
    case = make(cells)
    ny, nx = case.bed.shape
    solver = pyclaw.ClawSolver2D(riemann.sw_aug_2D)
    solver.num_eqn, solver.num_waves, solver.fwave = 3, 3, True
    solver.limiters, solver.dt_initial = pyclaw.limiters.tvd.vanleer, 1e-4
    solver.max_steps = 10**6
    for ends in (solver.bc_lower, solver.bc_upper, solver.aux_bc_lower, solver.aux_bc_upper):
        ends[0] = ends[1] = pyclaw.BC.wall
    sides = [pyclaw.Dimension(0.0, n * case.spacing, n, name=k) for k, n in (("x", nx), ("y", ny))]
    domain = pyclaw.Domain(sides)
    state = pyclaw.State(domain, 3, 1)
    numbers = {"grav": 9.81, "dry_tolerance": 1e-6, "sea_level": 0.0}
    state.problem_data.update(numbers)
    state.aux[0], state.q[0], state.q[1] = case.bed.T, case.depth.T, 0.0
    state.q[2] = (case.depth * case.v).T
    logging.getLogger("pyclaw").setLevel(logging.ERROR)
    solution = pyclaw.Solution(state, domain)
    solver.setup(solution)

    def advance():
        solver.evolve_to_time(solution, case.duration)
        depth = np.array(state.q[0]).T
        if not np.isfinite(depth).all():
            raise FloatingPointError("the depth is not finite")
        return depth

    return advance


if __name__ == "__main__":
    main("PyClaw", prepare)
