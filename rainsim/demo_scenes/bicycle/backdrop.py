"""The surroundings of the garden: a line of far trees and a bright overcast sky."""

import numpy as np

from rainsim.demo_scenes.bicycle.plants import crown
from rainsim.demo_scenes.build import discs, grid, join, spiral

SKY_RADIUS = 70.0  # m
ZENITH, HORIZON = np.array([0.640, 0.710, 0.800]), np.array([0.885, 0.900, 0.910])
CLOUD = np.array([0.945, 0.945, 0.945])
HAZE = np.array([0.640, 0.685, 0.690])  # what the air adds to far trees


FAR_RADII = (17.5, 20.0, 22.5)  # m, three rows of far trees; the look of 30 m is in their haze
FAR_HAZE = (0.10, 0.20, 0.32)  # share of haze in each row's colour
FAR_GREENS = np.array(
    [(0.400, 0.480, 0.225), (0.345, 0.440, 0.210), (0.450, 0.500, 0.240), (0.370, 0.430, 0.230)]
)


def sky_cloud(noise, count=4200, radius=SKY_RADIUS):
    """Return the sky as large splats on a dome, from just below the horizon to the zenith."""
    z = -0.10 + 1.10 * (np.arange(count) + 0.5) / count
    direction = spiral(z)
    spread = np.clip(z, 0, 1)[:, None] ** 0.6
    colour = HORIZON + spread * (ZENITH - HORIZON)
    plane = direction[:, :2] / (z[:, None] + 0.22)  # cloud sheets crowd towards the horizon
    cover = noise(plane + 3.0, (1.5, 0.8), octaves=4)
    cover = np.clip(0.40 + 0.75 * cover, 0, 1)[:, None]
    belly = np.clip(noise(plane + np.array([3.2, 3.25]), (1.5, 0.8), octaves=4), 0, 1)[:, None]
    colour = colour + cover * (CLOUD - 0.20 * belly - colour)
    cell = radius * np.sqrt(2 * np.pi * 1.10 / count)
    return discs(direction * radius, direction, colour, 0.80 * cell, thickness=0.3, opacity=0.97)


def far_trees(rng, count=84):
    """Return hazy trees all round, in rows from near and low to far and tall."""
    parts = []
    for k, turn in enumerate(
        (np.arange(count) + rng.uniform(-0.4, 0.4, count)) * 2 * np.pi / count
    ):
        row = (0, 2, 1)[k % 3]
        radius = FAR_RADII[row] + rng.normal(0, 0.5)
        spot = np.array([radius * np.cos(turn), radius * np.sin(turn)])
        height = (2.0, 2.9, 3.8)[row] * rng.uniform(0.75, 1.2)
        across = (1.3, 1.6, 1.9)[row] * rng.uniform(0.85, 1.15)
        colour = FAR_GREENS[rng.integers(0, len(FAR_GREENS))]
        leaves, _ = crown(
            (*spot, 0.52 * height), np.array([across, across, 0.52 * height]), colour,
            (0.062, 0.07, 0.078)[row], 18, 46, rng, clump=(0.38, 0.60), plump=0.5,
        )  # fmt: skip
        leaves.colour[:] += FAR_HAZE[row] * (HAZE - leaves.colour)
        parts.append(leaves)
    return join([*parts, _undergrowth(rng)])


def _undergrowth(rng):
    """Return the dark band below the far crowns, without which the sky shows through."""
    parts = []
    for radius, height, haze in zip(FAR_RADII, (0.7, 1.2, 1.7), FAR_HAZE, strict=True):
        step = 0.36
        turn, z = grid(np.arange(0, 2 * np.pi, step / radius), np.arange(0, height, step))
        outward = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        points = outward * (radius + 0.7) + np.column_stack([0 * z, 0 * z, z])
        colour = np.array([0.250, 0.310, 0.165]) * rng.uniform(0.65, 1.35, (len(z), 1))
        colour = colour + haze * (HAZE - colour)
        parts.append(discs(points, outward, colour, 0.24, thickness=0.07))
    return join(parts)
