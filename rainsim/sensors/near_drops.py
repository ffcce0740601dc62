"""The drops around a sensor: of each size those that are near enough to matter."""

import numpy as np

from rainsim.drops import Drops
from rainsim.jit import cpu_kernel, prange
from rainsim.rain import poisson_cells
from rainsim.rain.heightfield import HeightFields, first_hit
from rainsim.rain.impacts import run_listing


def near_drops(field, centre, reach, time, surfaces):
    """Return the `Drops` of each class within `reach` [m] of a place, not blocked on their way."""
    centre, around = np.asarray(centre, np.float64), np.asarray(reach, np.float64)[:, None]
    first, last = field.cubes_in(centre - around, centre + around, time)
    tasks = poisson_cells.slab_tasks(first, last)
    cubes = np.prod(last - first + 1, axis=1)[tasks[:, 0]] / (last - first + 1)[tasks[:, 0], 0]
    expected = field.mean_count[tasks[:, 0]] * cubes
    values, labels, ids = run_listing(
        expected, 4, 1, _fill_near, tasks, first, last, float(time), centre, around[:, 0],
        field.arrays(), surfaces.height_fields(),
    )  # fmt: skip
    velocity, diameter = field.velocity[labels[:, 0]], np.ascontiguousarray(values[:, 3])
    return Drops(np.ascontiguousarray(values[:, :3]), velocity, diameter, ids)


@cpu_kernel
def _fill_near(
    tasks, first, last, time, centre, reach, field: poisson_cells.DropField, surfaces: HeightFields,
    offset, values_out, labels_out, ids_out, needed_out,
):  # fmt: skip
    """List the drops of each slab of cubes that are in the ball; outputs: see `run_listing`."""
    for t in prange(tasks.shape[0]):
        b, i = tasks[t]
        found, radius = 0, reach[b] * reach[b]
        vx, vy, vz = field.velocity[b, 0], field.velocity[b, 1], field.velocity[b, 2]
        for j in range(first[b, 1], last[b, 1] + 1):
            for k in range(first[b, 2], last[b, 2] + 1):
                cube = poisson_cells.Cube(b, i, j, k)
                key = poisson_cells.cube_key(cube, field)
                for n in range(poisson_cells.drops_in_cube(key, b, field)):
                    word = poisson_cells.drop_id(key, n)
                    x0, y0, z0 = poisson_cells.drop_place(word, cube, field)
                    x, y, z = x0 + vx * time, y0 + vy * time, z0 + vz * time
                    away = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2
                    if away > radius or poisson_cells.thinned_out(word, b, z0, field):
                        continue
                    stop, _, _, _ = first_hit(x0, y0, z0, vx, vy, vz, -np.inf, time, surfaces)
                    if stop <= time:
                        continue
                    if offset[t] + found < offset[t + 1]:
                        out = offset[t] + found
                        values_out[out, 0], values_out[out, 1] = x, y
                        values_out[out, 2] = z
                        values_out[out, 3] = poisson_cells.drop_diameter(word, b, field)
                        labels_out[out, 0] = b
                        ids_out[out] = word
                    found += 1
        needed_out[t] = found
