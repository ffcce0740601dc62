"""Itzi 25.8 on the cases of the bench: python examples/peers/itzi_cases.py [CASE ...].

Itzi's surface flow alone, without GRASS: the program reads its maps from GRASS, the solver takes
arrays. Its limits are Itzi's, but for `hmin`, below which water is routed by slope: 5 mm by
default, as deep as the water of the dam breaks. Fields are float64: in float32, which the program
takes, the ring wave drowns in rounding. Its rows begin in the north.
"""

import numpy as np
from common import main
from itzi.rasterdomain import RasterDomain
from itzi.surfaceflow import SurfaceFlowSimulation

GIVEN = {"dtmax": 5.0, "cfl": 0.7, "g": 9.81, "theta": 0.9, "hmin": 1e-5, "slmax": 0.1,
         "vrouting": 0.1}  # fmt: skip


def prepare(make, cells):
    """Return the function that runs a case."""
    case = make(cells)
    mask = np.zeros(case.bed.shape, bool)
    domain = RasterDomain(np.float64, mask, (case.spacing, case.spacing))
    depth = case.depth[::-1]
    for name, values in (("dem", case.bed[::-1]), ("water_depth", depth), ("friction", 0 * depth)):
        domain.update_array(name, values.copy())
    southward = -(depth * np.broadcast_to(case.v, depth.shape)[::-1])
    domain.get_array("qs")[:-1] = 0.5 * (southward[:-1] + southward[1:])
    domain.get_array("bctype")[:] = 1  # walls
    flow = SurfaceFlowSimulation(domain, GIVEN)
    flow.update_flow_dir()

    def advance():
        left = case.duration
        while left > 0:
            flow.solve_dt()
            flow._dt = min(flow._dt, left)
            flow.step()
            left -= flow._dt
        return domain.get_array("water_depth")[::-1].astype(float)

    return advance


if __name__ == "__main__":
    main("Itzi", prepare)
