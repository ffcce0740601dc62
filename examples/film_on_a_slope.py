"""Rain on a smooth slope: the depth of the laminar film against Nusselt's exact solution.

Run: python examples/film_on_a_slope.py
"""

import numpy as np

from rainsim.constants import GRAVITY, WATER_VISCOSITY
from rainsim.grid import WaterSolver


def exact_depth(x, rain, slope):
    """Depth [m] of a film in equilibrium with `rain` [m/s], `x` [m] below the upper edge.

    All rain that falls above x flows through there: rain x = g slope h^3 / (3 nu).
    """
    return (3 * WATER_VISCOSITY * rain * x / (GRAVITY * slope)) ** (1 / 3)


def main(length=2.0, spacing=0.05, slope=0.02, mm_per_hour=50, seconds=120):
    """Print the film's depth along the slope; return it and the exact one [m]."""
    cells = round(length / spacing)
    bed = -slope * spacing * np.broadcast_to(np.arange(cells), (4, cells))
    # Manning's formula is for rough ground; a film a millimetre deep is laminar.
    solver = WaterSolver(
        bed, spacing, boundary={"east": "open"}, kinematic_viscosity=WATER_VISCOSITY
    )
    rain = mm_per_hour / 3.6e6
    report = solver.advance(seconds, rain=rain)
    x = (np.arange(cells) + 1.0) * spacing
    depth, exact = solver.depth[2], exact_depth(x, rain, slope)
    for k in range(cells // 4, cells, cells // 4):
        print(f"{x[k]:.2f} m down: {1e3 * depth[k]:.3f} mm deep, exactly {1e3 * exact[k]:.3f}")
    print(f"ledger's residual {report.residual:+.0e}")
    return depth, exact


if __name__ == "__main__":
    main()
