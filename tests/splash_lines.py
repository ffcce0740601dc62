"""What impacts throw up, one by one, by the formulas that the drawing kernels call."""

from dataclasses import dataclass

import numpy as np

from rainsim.drops import Impacts
from rainsim.particles.splash import Impact, droplet, droplets_of, relative_size, splashes_on
from rainsim.rain.size_distribution import terminal_speed


@dataclass(frozen=True)
class Lines:
    """Lines as the kernels list them: place [m], velocity [m/s], diameter [m]; and ids, if any."""

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray
    id: np.ndarray

    def __len__(self):
        return len(self.diameter)

    @staticmethod
    def of(rows, ids=()):
        rows = np.asarray(rows, np.float64).reshape(-1, 7)
        return Lines(rows[:, :3], rows[:, 3:6], rows[:, 6], np.array(ids, np.uint64))


def fallen(diameters, wind=0.0, first=77):
    """Drops that fell on the origin at terminal speed at time 0; their ids begin at `first`."""
    diameters = np.asarray(diameters, np.float64)
    n = len(diameters)
    velocity = np.zeros((n, 3))
    velocity[:, 0], velocity[:, 2] = wind, -terminal_speed(diameters)
    return Impacts(
        np.zeros((n, 3)), velocity, diameters, np.zeros(n), np.zeros(n, np.uint8),
        np.zeros(n, np.int32), np.zeros(n, np.int32), np.arange(n, dtype=np.uint64) + first,
    )  # fmt: skip


def splash_droplets(impacts, depth, now, exposure=0.0):
    """Return the droplets of impacts on water of a depth [m] that an exposure from `now` sees."""
    rows, ids = [], []
    with np.errstate(over="ignore"):
        for n in range(len(impacts)):
            diameter, speed = impacts.diameter[n], -impacts.velocity[n, 2]
            if not splashes_on(depth, diameter, speed):
                continue
            impact = Impact(
                impacts.id[n], *impacts.position[n], *impacts.velocity[n, :2], speed, diameter,
                depth, now - impacts.time[n],
            )  # fmt: skip
            count, size = int(droplets_of(diameter, speed)), relative_size(depth / diameter)
            for k in range(count):
                seen, *row, word = droplet(impact, k, count, size, exposure)
                if seen:
                    rows.append(row)
                    ids.append(word)
    return Lines.of(rows, ids)
