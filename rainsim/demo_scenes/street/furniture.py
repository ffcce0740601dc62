"""Things on the footways: lamp posts, bollards, a post box, bins and street trees."""

import numpy as np

from rainsim.demo_scenes.bicycle.plants import crown
from rainsim.demo_scenes.build import discs, join, lit, spiral, tinted, tube
from rainsim.demo_scenes.street.road import FACADE, KERB

POST = np.array([0.110, 0.125, 0.120])
LAMPS = ((5.2, 1), (11.8, -1), (21.5, 1), (30.5, -1), (40.0, 1), (50.0, -1), (-9.0, -1))  # x, side
LAMP_LIGHT = np.array([3.5, 2.9, 1.9])  # display-referred: 20 times white
BOLLARDS = tuple((x, -1) for x in (8.4, 9.6, 13.4, 17.9, 22.6)) + tuple(
    (x, 1) for x in (16.6, 18.0, 22.8)
)
TREES = ((16.4, 1, 4.6, 1.35), (29.0, 1, 5.0, 1.5), (34.5, -1, 4.8, 1.45), (-4.0, 1, 4.8, 1.4))
FOOT = 0.078  # m, height of the footway near the kerb


def lamp_glows(lamps=LAMPS):
    """Return the light of the lamps on the ground: x, y, reach [m], strength."""
    return np.array([(x, side * (KERB - 0.3), 3.0, 0.55) for x, side in lamps]).reshape(-1, 4)


def furniture(rng):
    """Return everything that stands on the footways of the built-in street."""
    parts = lamps_and_bollards(LAMPS, BOLLARDS, (-2, 24))
    parts.append(_post_box(12.9, -1))
    parts.append(_bin(14.6, 1, rng))
    for x, side, height, across in TREES:
        parts.append(tree(x, side, height, across, rng))
    return join(parts)


def lamps_and_bollards(lamps, bollards, near):
    """Return clouds of lamps and bollards (x, side); lamps with x in `near` [m] are rounder."""
    parts = []
    for x, side in lamps:
        parts.append(_lamp(x, side, 10 if near[0] < x < near[1] else 6))
    for x, side in bollards:
        y = side * (KERB + 0.38)
        points = [(x, y, FOOT), (x, y, FOOT + 0.05), (x, y, FOOT + 0.82), (x, y, FOOT + 0.90)]
        parts.append(tube(points, (0.085, 0.065, 0.052, 0.06), POST, piece=0.045, around=10,
                          sheen=0.3))  # fmt: skip
        ring = [(x, y, FOOT + 0.66), (x, y, FOOT + 0.74)]
        parts.append(tube(ring, 0.060, (0.72, 0.71, 0.68), piece=0.04, around=10))
    return parts


def _lamp(x, side, around):
    """Return a lamp post whose arm reaches over the road."""
    y = side * (KERB + 0.42)
    post = [(x, y, FOOT), (x, y, FOOT + 0.3), (x, y, FOOT + 0.9), (x, y, FOOT + 4.6)]
    parts = [tube(post, (0.10, 0.085, 0.055, 0.042), POST, piece=0.07, around=around, sheen=0.3)]
    turn = np.linspace(0, 0.55 * np.pi, 9)
    arm = np.stack(
        [np.full(9, x), y - side * 0.75 * (1 - np.cos(turn)), FOOT + 4.6 + 0.62 * np.sin(turn)], 1
    )
    parts.append(tube(arm, 0.028, POST, piece=0.07, around=7, sheen=0.3))
    head = arm[-1] - (0, side * 0.12, 0.13)
    ball = spiral(1 - 2 * (np.arange(90) + 0.5) / 90)
    globe = head + ball * (0.15, 0.15, 0.13)
    colour = np.where(ball[:, 2:] > 0.35, POST * 1.3, LAMP_LIGHT)
    parts.append(discs(globe, ball, colour, 0.032, thickness=3e-3))
    # What any lens shows about a lamp in wet air, faint.
    halo = discs(head[None], (-1, 0, 0), (1.15, 0.95, 0.66), 0.30, thickness=0.2, opacity=0.10)
    return join([*parts, halo])


def _post_box(x, side):
    """Return a red pillar box."""
    y = side * (FACADE - 1.6)
    red = (0.510, 0.055, 0.050)
    body = [(x, y, FOOT), (x, y, FOOT + 0.12), (x, y, FOOT + 0.14), (x, y, FOOT + 1.35)]
    cap = [(x, y, FOOT + 1.35), (x, y, FOOT + 1.42), (x, y, FOOT + 1.50), (x, y, FOOT + 1.53)]
    parts = [
        tube(body, (0.26, 0.26, 0.225, 0.225), red, piece=0.05, around=26, sheen=0.3),
        tube(cap, (0.26, 0.27, 0.16, 0.04), red, piece=0.03, around=24, sheen=0.3),
    ]
    parts.append(tube([(x, y, FOOT), (x, y, FOOT + 0.1)], 0.262, (0.05, 0.05, 0.05), piece=0.05,
                      around=24))  # fmt: skip
    cloud = join(parts)
    facing = np.where(cloud.normal[:, 2] > 0.3, 1.0, 0.62 - 0.25 * side * cloud.normal[:, 1])
    return lit(cloud, facing)


def _bin(x, side, rng):
    y = side * (FACADE - 0.5)
    points = [(x, y, FOOT + 0.02), (x, y, FOOT + 0.05), (x, y, FOOT + 0.95), (x, y, FOOT + 1.02)]
    cloud = tube(points, (0.24, 0.26, 0.29, 0.30), (0.10, 0.17, 0.13), piece=0.06, around=18)
    return tinted(cloud, rng.uniform(0.85, 1.1, len(cloud)))


def tree(x, side, height, across, rng):
    """Return a slim street tree in autumn."""
    y = side * (KERB + 0.75)
    colour = np.array([(0.430, 0.330, 0.110), (0.360, 0.350, 0.140), (0.450, 0.260, 0.090)])
    leaves, centres = crown(
        (x, y, height), np.array([across, 0.75 * across, 1.35 * across]),
        colour[rng.integers(0, 3)], 0.045, 40, 60, rng, clump=(0.30, 0.45),
    )  # fmt: skip
    fork = np.array([x, y, height - 0.9 * across])
    trunk = np.array([(x, y, FOOT - 0.02), (x + 0.02, y, 0.4), (x - 0.02, y, 1.5), fork])
    bark = tube(trunk, (0.15, 0.105, 0.09, 0.07), (0.215, 0.190, 0.160), piece=0.06, around=14)
    bark = tinted(bark, rng.uniform(0.8, 1.15, len(bark)))
    boughs = [
        tube([fork, 0.5 * (fork + centre) + (0, 0, 0.15), centre], (0.045, 0.03, 0.015),
             (0.20, 0.175, 0.15), piece=0.12, around=6)
        for centre in centres[:7]
    ]  # fmt: skip
    return join([bark, *boughs, leaves])
