"""Landlab 2.11.0, OverlandFlow: python examples/peers/landlab_cases.py [CASE ...].

Cells are core nodes within a ring of closed ones. Without friction. Its Courant number is 0.4: with
0.7, its default, the ring wave grows. `h_init` is added to every depth; its default of 10
micrometres is half the height of the ring wave.
"""

import numpy as np
from common import main
from landlab import RasterModelGrid
from landlab.components import OverlandFlow


def prepare(make, cells):
    """Return the function that runs a case."""
    case = make(cells)
    ny, nx = case.bed.shape
    grid = RasterModelGrid((ny + 2, nx + 2), xy_spacing=case.spacing)
    grid.set_closed_boundaries_at_grid_edges(True, True, True, True)
    bed = np.pad(case.bed, 1, mode="edge").reshape(-1)
    depth = np.pad(case.depth, 1).reshape(-1)
    grid.add_field("topographic__elevation", bed, at="node")
    grid.add_field("surface_water__depth", depth.copy(), at="node")
    flow = OverlandFlow(grid, mannings_n=0.0, g=9.81, alpha=0.4, h_init=1e-9)
    speed = np.pad(np.broadcast_to(case.v, case.bed.shape), 1).reshape(-1)
    carried = grid.map_mean_of_link_nodes_to_link(depth * speed)
    carried[grid.status_at_link != grid.BC_LINK_IS_ACTIVE] = 0
    grid.at_link["surface_water__discharge"][grid.vertical_links] = carried[grid.vertical_links]

    def advance():
        left = case.duration
        while left > 0:
            step = min(flow.calc_time_step(), left)
            flow.overland_flow(dt=step)
            left -= step
        return grid.at_node["surface_water__depth"].reshape(ny + 2, nx + 2)[1:-1, 1:-1]

    return advance


if __name__ == "__main__":
    main("Landlab OverlandFlow", prepare)
