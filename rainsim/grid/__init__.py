"""Water on the ground: shallow water on a staggered (MAC) grid.

`WaterSolver` owns the fields and names the phases of a step; `paper` holds the kernels of the
scheme of that name, `sources` what rain, films and infiltration do to a cell.
"""

from rainsim.grid.choose import SCHEMES
from rainsim.grid.inputs import Horton
from rainsim.grid.solver import WaterReport, WaterSolver

__all__ = ["SCHEMES", "Horton", "WaterReport", "WaterSolver"]
