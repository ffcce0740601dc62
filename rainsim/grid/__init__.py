"""Water on the ground: shallow water on a staggered (MAC) grid.

`WaterSolver` keeps the account and names the phases of a step; `conserving`, `lean` and `paper`
hold the kernels of the schemes, `rows` the tiles and the rows that kernels work on, `friction` and
`sources` what slows water and what adds to it.
"""

from rainsim.grid.choose import SCHEMES
from rainsim.grid.inputs import Horton
from rainsim.grid.solver import WaterReport, WaterSolver

__all__ = ["SCHEMES", "Horton", "WaterReport", "WaterSolver"]
