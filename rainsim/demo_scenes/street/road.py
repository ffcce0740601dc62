"""The street's ground: cambered asphalt, gutters that fall to drains, kerbs, flagged footways."""

from __future__ import annotations

import numpy as np

from rainsim.demo_scenes.build import (
    OVERLAP,
    box,
    discs,
    join,
    lit,
    replace_colour,
    strands,
    tube,
    unit,
)

ENDS = (-26.0, 60.0)  # m, x range of the street
GUTTER, KERB, FACADE = 2.95, 3.45, 5.9  # m from the middle: gutter and kerb begin, houses stand
KERB_WIDTH, KERB_HEIGHT = 0.15, 0.115  # m
CROWN = 0.030  # m, height of the middle of the road
CAMBER = 0.058  # m that the road falls to the gutter, as a parabola
GUTTER_FALL = 0.008  # m across the gutter
FOOTWAY_FALL = 0.014  # slope of the footway to the kerb
DRAINS = np.array([(11.2, -3.27), (-7.5, -3.27), (29.0, -3.27), (8.6, 3.27), (27.0, 3.27)])  # x, y
DRAIN_SAG, DRAIN_REACH = 0.034, 9.0  # m that the gutter falls towards a drain, and from where
DRAIN_HALF = (0.24, 0.16)  # m
GRATE_RISE = 0.012  # m that a grating stands proud of a worn gutter: so much water stays before it
UNEVENNESS = 0.0036  # m

# Settlements that hold water: x, y, depth, half length, half width [m], angle [rad]
DIPS = np.array(
    [
        (4.3, -0.8, 0.0184, 1.32, 0.53, 0.05),
        (6.9, 0.95, 0.0196, 1.8, 0.62, -0.06),
        (8.8, -0.55, 0.0196, 1.56, 0.69, 0.12),
        (12.4, 0.4, 0.023, 2.04, 0.94, -0.1),
        (14.8, -1.05, 0.0196, 1.56, 0.56, 0.0),
        (17.6, 0.8, 0.0218, 2.16, 0.75, 0.08),
        (20.2, -0.7, 0.023, 2.04, 0.75, -0.05),
        (24.0, 0.3, 0.0253, 2.52, 1.0, 0.1),
        (28.5, -0.6, 0.023, 2.4, 0.88, 0.0),
        (33.0, 0.6, 0.0253, 2.88, 1.0, -0.05),
        (1.0, 0.6, 0.0172, 1.44, 0.62, 0.1),
        (-3.0, -0.7, 0.0184, 1.68, 0.62, 0.0),
        (10.4, -2.25, 0.0138, 1.08, 0.4, 0.0),
        (15.5, -3.05, 0.0126, 1.92, 0.31, 0.0),
        (7.4, -3.05, 0.0115, 1.68, 0.31, 0.0),
    ]
)
ASPHALT = np.array([0.300, 0.302, 0.308])
PATCHES = ((5.6, 8.2, -2.1, -0.9, 0.86), (15.2, 17.0, 0.2, 1.9, 0.90), (21, 29, -1.2, -0.5, 0.84))
PAINT = np.array([0.735, 0.735, 0.715])
CROSSING = (18.6, 21.8)  # m, x range of the zebra crossing
GRANITE, FLAG = np.array([0.470, 0.465, 0.455]), np.array([0.460, 0.450, 0.430])
IRON = np.array([0.135, 0.132, 0.130])


def bed_height(x, y, noise):
    """Height of the ground [m] from house to house, without joints."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    away = np.abs(y)
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    height = CROWN - CAMBER * np.minimum(away / GUTTER, 1) ** 2
    height = height - GUTTER_FALL * np.clip((away - GUTTER) / (KERB - GUTTER), 0, 1)
    sag = np.zeros_like(x)
    grate = np.zeros_like(x)
    for dx, dy in DRAINS:
        beside = np.sign(y) == np.sign(dy)
        sag = np.maximum(sag, beside * np.clip(1 - np.abs(x - dx) / DRAIN_REACH, 0, 1))
        inside = (np.abs(x - dx) < DRAIN_HALF[0]) & (np.abs(y - dy) < DRAIN_HALF[1])
        grate = np.maximum(grate, inside)
    height = height - DRAIN_SAG * sag * np.minimum(away / KERB, 1) ** 3 + GRATE_RISE * grate
    height = height + UNEVENNESS * noise(points, 2.3, octaves=3).reshape(x.shape)
    # Tracks of tyres: worn by the millimetre, so water stands in them for a while.
    ruts = np.exp(-(((away - 0.80) / 0.26) ** 2)) * (0.6 + 0.5 * np.sin(0.9 * x + 1.7))
    height = height - 0.0060 * ruts
    warped_x = x + 0.35 * noise(points + 17.0, 1.3, octaves=3).reshape(x.shape)
    warped_y = y + 0.16 * noise(points + 31.0, 1.1, octaves=3).reshape(x.shape)
    for cx, cy, depth, along, across, angle in DIPS:
        u = (warped_x - cx) * np.cos(angle) + (warped_y - cy) * np.sin(angle)
        v = (warped_y - cy) * np.cos(angle) - (warped_x - cx) * np.sin(angle)
        height = height - depth * np.exp(-(((u / along) ** 2 + (v / across) ** 2) ** 1.2))
    footway = CROWN - CAMBER - GUTTER_FALL + KERB_HEIGHT + FOOTWAY_FALL * (away - KERB)
    footway = footway + 0.0015 * noise(points, 1.4, octaves=2).reshape(x.shape)
    return np.where(away > KERB, footway, height)


def _cell(x, fine=0.046):
    """Cell size [m] at x: fine where the drive comes close, growing away from it."""
    ahead, behind = np.maximum(x - 21.0, 0), np.maximum(2.0 - x, 0)
    return fine + 0.0052 * ahead + 0.03 * behind


def lattice(y_low, y_high, rng, fine=0.046, jitter=0.14):
    """Return places (n, 2) and cell sizes (n, 2) [m] over the street between two y."""
    parts, sizes = [], []
    x = ENDS[0]
    while x < ENDS[1]:
        cell = _cell(x, fine)
        dx = cell * (1.0 if 2.0 < x < 21.0 else 1.35)
        count = max(1, round((y_high - y_low) / cell))
        dy = (y_high - y_low) / count
        y = y_low + (np.arange(count) + 0.5) * dy
        row = np.stack([np.full(count, x + dx / 2), y], axis=1)
        row += rng.normal(0, jitter, row.shape) * (dx, dy)
        row[:, 1] = np.clip(row[:, 1], y_low + 0.3 * dy, y_high - 0.3 * dy)
        parts.append(row)
        sizes.append(np.tile([dx, dy], (count, 1)))
        x += dx
    return np.concatenate(parts), np.concatenate(sizes)


def _normals(points, noise, reach=0.03):
    x, y, z = points.T
    dx = bed_height(x + reach, y, noise) - z
    dy = bed_height(x, np.where(y > 0, y - reach, y + reach), noise) - z
    dy = np.where(y > 0, -dy, dy)
    return unit(np.stack([-dx / reach, -dy / reach, np.ones_like(dx)], axis=1))


def road_cloud(noise, rng):
    """Return the `Cloud` of the carriageway with its gutters, paint, cracks, covers and grates.

    `noise` (a `Noise`) gives unevenness and stains; `rng` is numpy's.
    """
    where, size = lattice(-KERB, KERB, rng)
    x, y = where.T
    points = np.column_stack([where, bed_height(x, y, noise)])
    grain = rng.normal(0, 0.055, len(x))
    mottle = 0.10 * noise(where, 0.55, octaves=3) + 0.09 * noise(where + 9, 3.1, octaves=2)
    tracks = np.exp(-(((np.abs(y + 0.0) - 0.78) / 0.22) ** 2))  # polished by tyres
    shade = 1 + grain + mottle + 0.06 * tracks - 0.10 * np.exp(-((y / 0.3) ** 2))
    for x0, x1, y0, y1, tone in PATCHES:
        inside = (x > x0) & (x < x1) & (y > y0) & (y < y1)
        shade = np.where(inside, tone * (1 + grain), shade)
    colour = ASPHALT * shade[:, None] * (1 + rng.normal(0, 0.012, (len(x), 3)))
    gutter = np.abs(y) > GUTTER + 0.06
    setts = 1 + 0.10 * np.sign(np.sin(2 * np.pi * x / 0.24)) * (_cell(x) < 0.1)
    silt = np.clip((np.abs(y) - KERB + 0.16) / 0.16, 0, 1)[:, None]
    stone = np.array([0.370, 0.362, 0.350]) * ((1 + grain + 0.6 * mottle) * setts)[:, None]
    stone = stone + silt * (np.array([0.235, 0.215, 0.180]) - stone)
    colour[gutter] = stone[gutter]
    colour = _painted(colour, x, y, noise, rng)
    cloud = discs(points, _normals(points, noise), colour, size * OVERLAP, sheen=0.06, opacity=0.97)
    return join([cloud, _specks(noise, rng), *_lines(noise, rng), *_covers(noise, rng)])


def _painted(colour, x, y, noise, rng):
    """Put the worn paint of the crossing and of the parking bays on the asphalt."""
    stripe = np.floor((y + KERB) / 0.5).astype(int) % 2 == 0
    on = (x > CROSSING[0]) & (x < CROSSING[1]) & stripe & (np.abs(y) < GUTTER)
    bay = (np.abs(np.abs(y) - 1.52) < 0.045) & ((x < 9.0) | (x > 23.0)) & (np.mod(x, 1.2) < 0.75)
    worn = np.stack([x, y], axis=1)
    worn = np.clip(0.80 + 0.55 * noise(worn, 0.35, octaves=3) + rng.normal(0, 0.07, len(x)), 0, 1)
    worn = np.where(bay, 0.8 * worn, worn) * (on | bay)
    tracks = 1 - 0.35 * np.exp(-(((np.abs(y) - 0.78) / 0.22) ** 2))
    return colour + (worn * tracks)[:, None] * (PAINT - colour)


def _specks(noise, rng, count=26_000):
    """Return single stones of the asphalt, light and dark, where the camera comes close."""
    x = 2.5 + 18.5 * rng.random(count)
    y = rng.uniform(-GUTTER, GUTTER, count)
    z = bed_height(x, y, noise) + 0.0012
    tone = np.where(rng.random(count) < 0.5, 1.35, 0.62) * rng.uniform(0.9, 1.1, count)
    colour = ASPHALT * tone[:, None] * (1 + rng.normal(0, 0.03, (count, 3)))
    crossing = (x > CROSSING[0]) & (x < CROSSING[1])
    size = rng.uniform(0.004, 0.009, count)
    keep = ~crossing
    points = np.stack([x, y, z], axis=1)[keep]
    return discs(points, (0, 0, 1), colour[keep], size[keep], thickness=8e-4, opacity=0.75)


def _lines(noise, rng):
    """Return cracks sealed with tar and the joint between road and gutter."""
    for side in (-1, 1):
        x = np.arange(-6.0, 40.0, 0.12)
        y = np.full(x.size, side * (GUTTER + 0.05))
        points = np.stack([x, y, bed_height(x, y, noise) + 0.001], axis=1)
        yield strands(points, (1, 0, 0), (0.150, 0.148, 0.145), 0.08, 0.006, flat=0.2)
    for x0, y0, turn, length in (
        (3.4, -1.9, 0.5, 3.6), (9.5, 1.9, -0.7, 3.2), (13.6, -1.4, 0.2, 4.2), (6.2, 0.3, 1.2, 1.8),
        (17.2, 1.2, -2.2, 2.4),
    ):  # fmt: skip
        steps = int(length / 0.05)
        heading = turn + 0.35 * np.cumsum(rng.normal(0, 0.28, steps))
        x, y = x0 + 0.05 * np.cumsum(np.cos(heading)), y0 + 0.05 * np.cumsum(np.sin(heading))
        keep = np.abs(y) < GUTTER
        x, y, heading = x[keep], y[keep], heading[keep]
        points = np.stack([x, y, bed_height(x, y, noise) + 0.001], axis=1)
        along = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
        width = rng.uniform(0.008, 0.016, len(x))
        yield strands(points, along, (0.165, 0.165, 0.168), 0.034, width, flat=0.1)


def _covers(noise, rng):
    """Return the grates of the drains and two manhole covers."""
    for x, y in DRAINS:
        z = float(bed_height(np.array([x]), np.array([y]), noise)[0])
        half = (*DRAIN_HALF, 0.004)
        yield box((x, y, z - 0.002), half, 0.35 * IRON, spacing=0.05, stretch=1)
        for k in np.linspace(-DRAIN_HALF[0] + 0.03, DRAIN_HALF[0] - 0.03, 10):
            yield box((x + k, y, z + 0.005), (0.010, DRAIN_HALF[1], 0.004), 2.2 * IRON,
                      spacing=0.02, along=1, stretch=4, sheen=0.3)  # fmt: skip
        for side in (-1, 1):
            yield box((x, y + side * DRAIN_HALF[1], z + 0.005), (DRAIN_HALF[0], 0.014, 0.005),
                      2.0 * IRON, spacing=0.03, stretch=3, sheen=0.3)  # fmt: skip
    for x, y in ((9.9, 0.15), (25.3, -0.4)):
        z = float(bed_height(np.array([x]), np.array([y]), noise)[0]) + 0.004
        k = np.arange(900) + 0.5
        r, turn = 0.31 * np.sqrt(k / 900), k * np.pi * (3 - np.sqrt(5))
        points = np.stack([x + r * np.cos(turn), y + r * np.sin(turn), 0 * r + z], axis=1)
        knobs = np.sin(points[:, 0] * 90) * np.sin(points[:, 1] * 90) > 0
        tone = np.where(r > 0.275, 1.25, np.where(knobs, 1.7, 1.05)) * rng.uniform(0.92, 1.08, 900)
        yield discs(points, (0, 0, 1), IRON * tone[:, None], 0.0075, sheen=0.25)
        ring = np.linspace(0, 2 * np.pi, 40)
        points = np.stack([x + 0.325 * np.cos(ring), y + 0.325 * np.sin(ring), 0 * ring + z], 1)
        yield tube(points, 0.006, 1.5 * IRON, piece=0.05, around=5)


def footway_cloud(noise, rng):
    """Return the `Cloud` of the kerbs and flagged footways on both sides of the street.

    `noise` (a `Noise`) mottles the flags and raises and lowers the ground; `rng` is numpy's.
    """
    parts = []
    for side in (-1, 1):
        parts.append(_kerb(side, rng))
        low, high = sorted((side * (KERB + KERB_WIDTH), side * (FACADE + 0.15)))
        where, size = lattice(low, high, rng, fine=0.062, jitter=0.08)
        x, y = where.T
        points = np.column_stack([where, bed_height(x, y, noise)])
        row = np.floor((np.abs(y) - KERB) / 0.45)
        flag = np.floor((x + 0.37 * row) / 0.6) * 17 + row * 5 + 1000 * (side > 0)
        tone = np.random.Generator(np.random.PCG64(7)).uniform(0.86, 1.10, 4096)
        shade = tone[np.mod(flag, 4096).astype(int)]
        shade = shade * (1 + rng.normal(0, 0.03, len(x)) + 0.10 * noise(where, 0.8, octaves=3))
        colour = FLAG * shade[:, None]
        parts.append(discs(points, (0, 0, 1), colour, size * OVERLAP, sheen=0.08))
        parts += _joints(side, noise)
    return join(parts)


def _kerb(side, rng):
    """Return a row of granite blocks whose faces stand above the gutter."""
    parts = []
    base = CROWN - CAMBER - GUTTER_FALL
    x = ENDS[0]
    while x < ENDS[1]:
        length = 0.92 if 0 < x < 24 else 2.0
        spacing = 0.045 if 0 < x < 24 else 0.11
        tone = GRANITE * rng.uniform(0.88, 1.08)
        lift = rng.normal(0, 0.002)
        low, high = base - 0.05, base + KERB_HEIGHT + lift
        part = box(
            (x + length / 2, side * (KERB + KERB_WIDTH / 2), (low + high) / 2),
            (length / 2 - 0.005, KERB_WIDTH / 2, (high - low) / 2), tone,
            spacing=spacing, along=0, stretch=1.6, sheen=0.08,
        )  # fmt: skip
        keep = part.normal[:, 2] > -0.5
        part = type(part)(*(getattr(part, n)[keep] for n in type(part).__slots__))
        shade = rng.uniform(0.88, 1.12, len(part)) * np.where(
            np.abs(part.normal[:, 2]) > 0.5, 1.0, 0.80 - 0.25 * (part.position[:, 2] < base + 0.02)
        )
        parts.append(replace_colour(part, part.colour * shade[:, None]))
        x += length
    return join(parts)


def _joints(side, noise):
    """Return the dark joints between the flags where they can be seen."""
    for row in range(1, 6):
        away = KERB + 0.45 * row
        if away > FACADE:
            continue
        x = np.arange(0.0, 26.0, 0.11)
        y = np.full(x.size, side * away)
        points = np.stack([x, y, bed_height(x, y, noise) + 0.0006], axis=1)
        yield strands(points, (1, 0, 0), (0.225, 0.220, 0.205), 0.06, 0.0045, flat=0.1)
    for row in range(6):
        low, high = KERB + max(0.45 * row, KERB_WIDTH), min(KERB + 0.45 * (row + 1), FACADE)
        first = np.ceil(0.37 * row / 0.6) * 0.6 - 0.37 * row
        x = np.repeat(np.arange(first, 26.0, 0.6), 4)
        part = (np.tile(np.arange(4), x.size // 4) + 0.5) / 4
        y = side * (low + (high - low) * part)
        points = np.stack([x, y, bed_height(x, y, noise) + 0.0006], axis=1)
        reach = 0.6 * (high - low) / 4
        yield strands(points, (0, 1, 0), (0.225, 0.220, 0.205), reach, 0.0045, flat=0.1)


def ground_light(cars):
    """Return a function that gives the light at ground points, (n, 3) to (n,).

    `cars` are rows of x, y, half length and half width [m]: the sky hardly reaches below them.
    """

    def light(points):
        x, y = points[:, 0], points[:, 1]
        value = np.ones(len(points))
        for cx, cy, along, across in cars:
            dx = np.maximum(np.abs(x - cx) - along + 0.12, 0)
            dy = np.maximum(np.abs(y - cy) - across + 0.12, 0)
            value *= 1 - 0.88 * np.exp(-((np.hypot(dx, dy) / 0.30) ** 1.5))
        value *= 1 - 0.35 * np.exp(-np.maximum(FACADE - np.abs(y), 0) / 0.5)
        corner = np.maximum(KERB - np.abs(y), 0) + 10 * (np.abs(y) > KERB)
        return value * (1 - 0.30 * np.exp(-corner / 0.06))

    return light


def lit_ground(cloud, light, glows):
    """Return ground splats in the light of the sky and of lamps and windows.

    `glows` are rows of x, y, reach [m] and strength: warm light that falls on the ground near them.
    """
    value = light(cloud.position)
    cloud = lit(cloud, value)
    warm = np.zeros(len(cloud))
    for x, y, reach, strength in glows:
        d2 = ((cloud.position[:, 0] - x) ** 2 + (cloud.position[:, 1] - y) ** 2) / reach**2
        warm += strength * np.exp(-d2)
    tint = 1 + warm[:, None] * np.array([0.42, 0.27, 0.08])
    return replace_colour(cloud, cloud.colour * tint)
