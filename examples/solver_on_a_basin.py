"""Rain on a small valley: where it stands afterwards, and how a dumped bucket settles there.

Run: python examples/solver_on_a_basin.py
"""

import numpy as np

from rainsim.grid import WaterSolver
from rainsim.water.fill_spill_merge import standing_water


def make_valley(cells, spacing):
    """A slope of 2 % to the east with a dip of 8 cm in it [m]."""
    y, x = (np.mgrid[:cells, :cells] + 0.5) * spacing
    size = cells * spacing
    dip = np.exp(-((x - 0.6 * size) ** 2 + (y - 0.5 * size) ** 2) / (0.15 * size) ** 2)
    return -0.02 * x - 0.08 * dip


def main(cells=100, spacing=0.04, seconds=10):
    """Print what stands after 20 mm of rain, then follow one more bucket for some seconds."""
    bed = make_valley(cells, spacing)
    depth, outflow, _ = standing_water(bed, 0.020, spacing)
    wet = (depth > 0.001).mean()
    print(f"20 mm of rain: {1000 * depth.max():.0f} mm deep at most, {100 * wet:.0f} % wet")
    print(f"{1000 * outflow:.0f} litres ran off the edge")

    solver = WaterSolver(bed, spacing, boundary="open", manning=0.015)
    solver.set_state(depth)
    report = solver.advance(60.0)
    print(f"at rest for a minute: {report.substeps} steps, {report.max_speed:g} m/s")

    middle, west = cells // 2, cells // 4  # uphill of the dip
    rows, columns = np.mgrid[middle - 2 : middle + 3, west - 2 : west + 3].reshape(2, -1)
    solver.deposit(rows, columns, np.full(25, 0.010 / 25))  # 10 litres
    for _ in range(seconds):
        report = solver.advance(1.0, rain=10 / 3.6e6)  # 10 mm/h go on falling
        print(
            f"{report.time - 60:3.0f} s  {report.substeps:3d} steps  "
            f"fastest {report.max_speed:.3f} m/s  deepest {1000 * solver.depth.max():5.1f} mm  "
            f"ran off {1000 * report.ledger.outflow:5.2f} l  ledger {report.residual:+.0e}"
        )
    return report


if __name__ == "__main__":
    main()
