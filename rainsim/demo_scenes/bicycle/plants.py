"""Lawn, hedges, bushes and trees."""

import numpy as np

from rainsim.demo_scenes.bicycle.paving import FAR_EDGE, NEAR_EDGE
from rainsim.demo_scenes.bicycle.paving import HALF_LENGTH as PATH_REACH
from rainsim.demo_scenes.build import discs, grid, join, lit, strands, tinted, tube, unit

SOIL_HEIGHT = 0.012  # m, of the lawn's soil above the path's edge
LAWN_REACH = 26.0  # m
GRASS = np.array(  # lush, light, deep, dry
    [(0.375, 0.475, 0.180), (0.455, 0.530, 0.215), (0.325, 0.430, 0.160), (0.540, 0.540, 0.285)]
)
# Inner and outer radius, cell size of the turf's rings [m]
TURF_RINGS = ((0, 5, 0.085), (5, 8, 0.14), (8, 13, 0.30), (13, LAWN_REACH, 1.2))
# Along the path: x from and to (both ways), distance from the edge from and to, cell [m], tone
VERGES = (
    (PATH_REACH, 0, 0.004, 0.17, 0.033, 0.52), (PATH_REACH, 4, 0.20, 0.50, 0.09, 0.70),
    (PATH_REACH, 7, 0.55, 1.30, 0.20, 0.72),
)  # fmt: skip
HEDGE_FACES = (6.6, -8.6)  # m, y of the two hedges' faces towards the path
HEDGE_HEIGHT = 1.75  # m

# x, y [m], height of the crown's centre [m], its radii across and up [m], leaf colour
TREES = (
    (-4.6, 9.6, 3.15, 1.75, 1.45, (0.375, 0.475, 0.190)),
    (4.4, 11.0, 3.35, 1.90, 1.60, (0.430, 0.500, 0.200)),
    (12.6, 4.2, 3.20, 1.85, 1.50, (0.345, 0.445, 0.185)),
    (10.5, -5.6, 3.30, 1.90, 1.55, (0.390, 0.470, 0.185)),
    (-10.2, 3.9, 3.20, 1.80, 1.50, (0.440, 0.480, 0.190)),
    (-9.0, -5.8, 3.10, 1.80, 1.45, (0.370, 0.460, 0.195)),
    (1.5, -12.5, 3.40, 1.95, 1.60, (0.350, 0.450, 0.185)),
)

# x, y [m], radius [m], height [m], leaf colour, flower colour or None
BUSHES = (
    (-3.1, 5.7, 0.62, 0.85, (0.400, 0.480, 0.225), (0.86, 0.84, 0.80)),
    (-1.7, 6.0, 0.50, 0.62, (0.330, 0.430, 0.200), (0.60, 0.46, 0.74)),
    (3.3, 5.9, 0.66, 0.90, (0.340, 0.425, 0.175), None),
    (4.6, 5.6, 0.50, 0.66, (0.420, 0.485, 0.215), (0.82, 0.52, 0.60)),
    (-6.3, 5.6, 0.62, 0.80, (0.350, 0.430, 0.190), (0.84, 0.80, 0.56)),
    (8.0, 5.4, 0.70, 0.92, (0.370, 0.450, 0.200), None),
)


def on_path(x, y, margin=0.0):
    """Whether points lie on the paved path, `margin` [m] inside its edges."""
    return (y > NEAR_EDGE + margin) & (y < FAR_EDGE - margin) & (np.abs(x) < PATH_REACH)


def _lawn_colour(points, noise):
    """Colour of the grass: patches of several greens, worn and yellowish in places."""
    patch = np.clip(0.5 + 0.55 * noise(points[:, :2], 2.6, octaves=3), 0, 1)[:, None]
    dry = np.clip(noise(points[:, :2] + 40.0, 1.1, octaves=3) - 0.35, 0, 0.9)[:, None]
    colour = GRASS[2] + patch * (GRASS[1] - GRASS[2])
    return colour + dry * 0.6 * (GRASS[3] - colour)


def lawn_height(points, noise):
    """Height of the soil under the grass [m]: level with the path at its edges."""
    x, y = points[:, 0], points[:, 1]
    away = np.maximum(np.maximum(NEAR_EDGE - y, y - FAR_EDGE), 0)
    rough = 0.012 * noise(points[:, :2], 1.7, octaves=2) * np.clip(away, 0, 1)
    return SOIL_HEIGHT + 0.015 * np.clip(away / 1.5, 0, 1) + rough + 0 * x


def lawn_cloud(noise, rng, ground_light, blades):
    """Return the soil and `blades` blades of grass, sparser and larger away from the bench."""
    parts = [_turf(noise, rng)]
    radius = 12.5 * rng.random(3 * blades) ** 0.92  # thins out with distance from the bench
    turn = rng.uniform(0, 2 * np.pi, 3 * blades)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * radius], axis=1)
    fringe = rng.uniform(-0.035, 0.01, len(points))  # some blades hang over the kerb
    keep = ~on_path(points[:, 0], points[:, 1], margin=fringe)
    points, radius = points[keep][:blades], radius[keep][:blades]
    n = len(points)
    larger = np.clip(radius / 5.5, 0.75, 2.6)
    tuft = 1 + 0.35 * noise(points[:, :2], 0.35, octaves=2)
    length = rng.uniform(0.013, 0.026, n) * tuft * larger**0.6
    lean = rng.normal(0, 0.42, (n, 2))
    direction = unit(np.stack([lean[:, 0], lean[:, 1], np.ones(n)], axis=1))
    points[:, 2] = lawn_height(points, noise) + direction[:, 2] * length * 1.15
    tone = rng.uniform(0.78, 1.22, (n, 1)) * (1 + rng.normal(0, 0.05, (n, 3)))
    straw = rng.random(n) < 0.04
    colour = _lawn_colour(points, noise) * tone
    colour[straw] = (0.60, 0.55, 0.33)
    side = np.stack([*rng.normal(0, 1, (2, n)), 0.4 * np.ones(n)], axis=1)
    parts.append(
        strands(points, direction, colour, length, 0.0021 * larger * rng.uniform(0.8, 1.3, n),
                normal=side, flat=0.3, opacity=0.92)
    )  # fmt: skip
    parts.append(_daisies(noise, rng))
    cloud = join(parts)
    return lit(cloud, ground_light(cloud.position))


def _turf(noise, rng):
    """Return the ground between the blades, in three rings of growing cell size."""
    parts = []
    for inner, outer, cell in TURF_RINGS:
        ticks = np.arange(-outer, outer, cell)
        x, y = grid(ticks, ticks)
        x, y = x + rng.normal(0, 0.2 * cell, x.size), y + rng.normal(0, 0.2 * cell, y.size)
        r = np.hypot(x, y)
        keep = (r >= inner) & (r < outer) & ~on_path(x, y, margin=-0.06 - 1.1 * cell)
        points = np.stack([x[keep], y[keep], 0 * x[keep]], axis=1)
        points[:, 2] = lawn_height(points, noise)
        colour = _lawn_colour(points, noise) * rng.uniform(0.62, 0.98, (len(points), 1))
        parts.append(discs(points, (0, 0, 1), colour, 0.68 * cell, thickness=0.003))
    parts.append(_verge(noise, rng))
    return join(parts)


def _verge(noise, rng):
    """Return the ground along the path's edges, in cells fine enough not to spill over the kerb."""
    parts = []
    for reach, inner, start, stop, cell, tone in VERGES:
        x = np.arange(-reach, reach, 2 * cell)
        x = x[np.abs(x) >= inner]
        for away in np.arange(start, stop, cell):
            for edge, side in ((NEAR_EDGE, -1), (FAR_EDGE, 1)):
                y = np.full(x.size, edge + side * away)
                points = np.stack([x + rng.normal(0, 0.3 * cell, x.size), y, 0 * x], axis=1)
                points[:, 2] = lawn_height(points, noise) - 0.018 * (away < 0.02)
                shade = rng.uniform(tone, tone + 0.25, (x.size, 1))
                colour = _lawn_colour(points, noise) * shade
                size = np.tile([1.36 * cell, 0.66 * cell], (x.size, 1))
                parts.append(discs(points, (0, 0, 1), colour, size, thickness=0.002))
    x = np.arange(-PATH_REACH, PATH_REACH, 0.07)
    for edge, side in ((NEAR_EDGE, -1), (FAR_EDGE, 1)):  # the step down to the kerb
        points = np.stack([x, np.full(x.size, edge + 0.001 * side), np.zeros(x.size)], axis=1)
        colour = np.array([0.215, 0.215, 0.125]) * rng.uniform(0.7, 1.2, (x.size, 1))
        size = np.tile([0.046, 0.013], (x.size, 1))
        parts.append(discs(points, (0, -side, 0), colour, size, thickness=0.003))
    return join(parts)


def _daisies(noise, rng, count=420):
    """Return small white flowers in drifts on the lawn."""
    points = np.stack([rng.uniform(-9, 9, 6 * count), rng.uniform(-7, 6, 6 * count)], axis=1)
    drift = noise(points - 20.0, 2.2, octaves=2) > 0.35
    points = points[drift & ~on_path(points[:, 0], points[:, 1], margin=-0.1)][:count]
    n = len(points)
    z = lawn_height(points, noise) + rng.uniform(0.045, 0.07, n)
    centre = np.column_stack([points, z])
    normal = unit(np.stack([*rng.normal(0, 0.25, (2, n)), np.ones(n)], axis=1))
    petals = discs(
        centre, normal, (0.88, 0.88, 0.84), rng.uniform(0.006, 0.010, n), thickness=0.001
    )
    heart = discs(
        centre + np.array([0, 0, 0.002]), normal, (0.80, 0.66, 0.16), 0.003, thickness=0.001
    )
    return join([petals, heart])


def _leaves(points, outward, colour, size, light, rng, plump=0.0):
    """Return leaves: small discs facing roughly `outward`; `plump` is thickness over size."""
    n = len(points)
    normal = unit(outward + rng.normal(0, 0.55, (n, 3)) + (0, 0, 0.25))
    tone = rng.uniform(0.80, 1.20, (n, 1)) * (1 + rng.normal(0, 0.045, (n, 3)))
    scale = np.stack([size, size * rng.uniform(0.5, 0.8, n)], axis=1)
    cloud = discs(
        points, normal, np.asarray(colour) * tone, scale,
        along=rng.normal(0, 1, (n, 3)), thickness=np.maximum(0.0012, plump * size),
        opacity=0.9, sheen=0.15,
    )  # fmt: skip
    return lit(cloud, light)


def _ball(count, rng):
    """Return `count` random unit vectors."""
    return unit(rng.normal(0, 1, (count, 3)))


def crown(centre, radii, colour, leaf, clumps, per_clump, rng, clump=(0.26, 0.42), plump=0.0):
    """Return a crown and the centres of its clumps of leaves, dark inside and below.

    `leaf` is the deviation of a leaf splat [m], `clump` the range of clump over crown radius.
    """
    middle = _ball(clumps, rng) * rng.uniform(0.45, 1.0, (clumps, 1)) ** 0.5 * (1.2 - clump[1])
    centres = np.asarray(centre) + middle * radii
    size = rng.uniform(*clump, clumps) * np.mean(radii)
    which = np.repeat(np.arange(clumps), per_clump)
    outward = _ball(len(which), rng)
    depth = rng.uniform(0.35, 1.0, len(which)) ** 0.45
    points = centres[which] + outward * (size[which] * depth)[:, None] * (1, 1, 0.72)
    height = np.clip((points[:, 2] - centre[2]) / radii[2], -1, 1)
    light = (0.36 + 0.84 * (0.5 + 0.5 * outward[:, 2]) ** 1.2) * (0.78 + 0.32 * height) * depth**1.6
    light *= rng.uniform(0.75, 1.2, clumps)[which]
    leaf = leaf * rng.uniform(0.75, 1.3, len(which))
    foliage = _leaves(points, outward, colour, leaf, light, rng, plump)
    core = np.repeat(np.arange(clumps), 5)
    inside = centres[core] + _ball(len(core), rng) * size[core, None] * 0.30
    dark = discs(
        inside, _ball(len(core), rng), np.asarray(colour) * 0.55, size[core] * 0.24,
        thickness=size[core] * 0.20, opacity=0.93,
    )  # fmt: skip
    return join([foliage, dark]), centres


def tree(spot, noise, rng):
    """Return a tree: bark, a few boughs into the crown, leaves."""
    x, y, height, across, up, colour = spot
    leaves, centres = crown(
        (x, y, height), np.array([across, across, up]), colour, 0.041, 60, 105, rng
    )
    fork = np.array([x, y, height - 0.78 * up])
    trunk = np.array([(x, y, -0.1), (x + 0.03, y, 0.25), (x - 0.02, y, 1.2), fork])
    parts = [tube(trunk, (0.24, 0.155, 0.125, 0.11), (0.330, 0.285, 0.235), piece=0.05, around=22)]
    for k in np.argsort(rng.random(len(centres)))[:7]:
        bend = 0.5 * (fork + centres[k]) + (0, 0, 0.25)
        parts.append(tube([fork, bend, centres[k]], (0.06, 0.04, 0.02), (0.30, 0.26, 0.215),
                          piece=0.10, around=8))  # fmt: skip
    bark = join(parts)
    furrows = noise(bark.position, (0.05, 0.05, 0.45), octaves=2)
    bark = tinted(bark, 1 + 0.22 * furrows)
    shade = np.interp(bark.position[:, 2], (0, 0.4, height - up, height), (0.55, 0.85, 0.5, 0.25))
    return join([lit(bark, shade * (0.55 + 0.45 * np.abs(bark.normal[:, 1]))), leaves])


def bush(spot, rng):
    """Return a round bush, some with flowers."""
    x, y, radius, height, colour, flower = spot
    radii = np.array([radius, radius, height / 2])
    leaves, _ = crown((x, y, height / 2), radii, colour, 0.021, 26, 62, rng)
    if flower is None:
        return leaves
    outward = _ball(70, rng)
    outward[:, 2] = np.abs(outward[:, 2])
    points = np.array([x, y, height / 2]) + outward * radii * rng.uniform(0.95, 1.1, (70, 1))
    tone = np.asarray(flower) * rng.uniform(0.85, 1.08, (70, 1))
    return join([leaves, discs(points, outward, tone, 0.017, thickness=0.004)])


def hedge(face, leaf, count, noise, rng):
    """Return a clipped hedge along x; `face` is the y of its side towards the path [m]."""
    inward = np.sign(face)
    depth = 0.9
    top = rng.random(count) < depth / (depth + HEDGE_HEIGHT) * 0.75
    x = rng.uniform(-12.5, 12.5, count)
    u = rng.random(count)
    sunk = rng.gamma(1.2, 0.045, count)
    points = np.stack([x, np.full(count, float(face)), u * HEDGE_HEIGHT], axis=1)
    outward = np.tile([0.0, -inward, 0.15], (count, 1))
    points[top, 1] = face + inward * u[top] * depth
    points[top, 2] = HEDGE_HEIGHT
    outward[top] = (0, -0.2 * inward, 1)
    bulge = 0.10 * noise(points, 0.85, octaves=3)
    shoots = rng.random(count) < 0.06
    points += unit(outward) * (bulge - sunk + 0.09 * shoots)[:, None]
    rounded = np.clip((points[:, 2] - HEDGE_HEIGHT + 0.25) / 0.25, 0, 1)
    points[~top, 1] += (inward * 0.12 * rounded**2)[~top]
    light = np.where(
        top, 0.95, np.interp(points[:, 2], (0, 0.3, 1.4, 1.75), (0.26, 0.55, 0.78, 1.0))
    )
    light = light * np.exp(-sunk / 0.10) * np.clip(1 + 3.6 * bulge, 0.3, 1.6)
    colour = np.array([0.325, 0.430, 0.170]) + 0.045 * noise(points, 1.9, octaves=2)[:, None]
    cloud = _leaves(points, outward, colour, leaf * rng.uniform(0.7, 1.3, count), light, rng)
    return join([cloud, _hedge_core(face, inward)])


def _hedge_core(face, inward):
    """Return the dark inside of a hedge, so that nobody looks through it."""
    cell = 0.16
    x, z = grid(np.arange(-12.5, 12.5, cell), np.arange(0.05, 1.50, cell))
    front = np.stack([x, np.full(x.size, face + inward * 0.16), z], axis=1)
    colour = (0.085, 0.115, 0.055)
    return discs(front, (0, -1, 0), colour, 0.72 * cell, thickness=0.02, opacity=0.97)
