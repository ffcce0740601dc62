"""The street's kerbs and flagged footways."""

import numpy as np

from rainsim.demo_scenes.build import OVERLAP, box, discs, join, replace_colour, strands
from rainsim.demo_scenes.street.layout import CORNER, SIDE_FACADE, SIDE_KERB, SIDE_REACH
from rainsim.demo_scenes.street.road import (
    FACADE,
    FLAG,
    GRANITE,
    GUTTER_FALL,
    KERB,
    KERB_HEIGHT,
    KERB_WIDTH,
    LAYOUT,
    bed_height,
    crown_of,
    from_middle,
    lattice,
    own_sides,
    side_lattices,
    span,
)

ARC = 7  # blocks of a kerb at a corner


def footway_cloud(noise, rng, layout=LAYOUT):
    """Return the `Cloud` of the kerbs and flagged footways on both sides of the street."""
    parts = []
    for side in (-1, 1):
        parts.append(_kerb(side, rng, layout))
        low, high = sorted((side * (KERB + KERB_WIDTH), side * (FACADE + 0.15)))
        where, size = lattice(low, high, rng, layout, fine=0.062, jitter=0.08)
        outside = ~layout.beside_side_street(where[:, 0], SIDE_FACADE)
        parts.append(_flags(where[outside], size[outside], 0, side, noise, rng, layout))
        parts += _joints(side, noise, layout)
    if own_sides(layout):
        where, size = side_lattices(layout, rng, 0.062, 0.08)
        foot = from_middle(*where.T, layout) > KERB + KERB_WIDTH
        parts.append(_flags(where[foot], size[foot], 1, 1, noise, rng, layout))
        parts += _side_kerbs(rng, layout)
    return join(parts)


def _flags(where, size, axis, side, noise, rng, layout):
    """Return flags over places (n, 2), in rows along x (axis 0) or y (axis 1)."""
    x, y = where.T
    points = np.column_stack([where, bed_height(x, y, noise, layout)])
    row = np.floor((from_middle(x, y, layout) - KERB) / 0.45)
    flag = np.floor((where[:, axis] + 0.37 * row) / 0.6) * 17 + row * 5 + 1000 * (side > 0)
    tone = np.random.Generator(np.random.PCG64(7)).uniform(0.86, 1.10, 4096)
    shade = tone[np.mod(flag, 4096).astype(int)]
    shade = shade * (1 + rng.normal(0, 0.03, len(x)) + 0.10 * noise(where, 0.8, octaves=3))
    return discs(points, (0, 0, 1), FLAG * shade[:, None], size * OVERLAP, sheen=0.08)


def _kerb(side, rng, layout):
    """Return a row of granite blocks whose faces stand above the gutter."""
    parts = []
    fine, sides = span(layout, 2, 3), own_sides(layout)
    for begin, last in layout.between(layout.ends, sides, SIDE_KERB + CORNER):
        x = begin
        while x < last:
            near = fine[0] < x < fine[1]
            length = 0.92 if near else 2.0
            if sides:  # a block at the corner of a side street is cut to fit
                length = min(length, last - x + 1e-6)
            middle = (x + length / 2, side * (KERB + KERB_WIDTH / 2))
            parts.append(_block(middle, length, 0.045 if near else 0.11, rng, layout))
            x += length
    return join(parts)


def _side_kerbs(rng, layout):
    """Yield the kerbs of side streets: round the corners, then along the street."""
    for street in own_sides(layout):
        for right in (-1, 1):
            for up in (-1, 1):
                centre = np.array([
                    street + right * (SIDE_KERB + CORNER), up * (KERB + CORNER)
                ])  # fmt: skip
                for k in range(ARC):
                    turn = (k + 0.5) / ARC * np.pi / 2
                    out = np.array([-right * np.sin(turn), -up * np.cos(turn)])
                    axes = np.array([(-out[1], out[0], 0), (*out, 0), (0, 0, 1.0)])
                    length = CORNER * np.pi / 2 / ARC
                    middle = centre + out * (CORNER - KERB_WIDTH / 2)
                    yield _block(middle, length, 0.06, rng, layout, axes)
                y, axes = KERB + CORNER, np.array([(0, 1.0, 0), (-1.0, 0, 0), (0, 0, 1.0)])
                while y < SIDE_REACH:
                    middle = (street + right * (SIDE_KERB + KERB_WIDTH / 2), up * (y + 0.6))
                    yield _block(middle, 1.2, 0.06 + 0.006 * y, rng, layout, axes)
                    y += 1.2


def _block(middle, length, spacing, rng, layout, axes=None):
    """Return one block of a kerb about a place (x, y)."""
    base = crown_of(layout) - layout.camber - GUTTER_FALL
    tone = GRANITE * rng.uniform(0.88, 1.08)
    lift = rng.normal(0, 0.002)
    low, high = base - 0.05, base + KERB_HEIGHT + lift
    part = box(
        (*middle, (low + high) / 2), (length / 2 - 0.005, KERB_WIDTH / 2, (high - low) / 2), tone,
        spacing=spacing, along=0, stretch=1.6, axes=axes, sheen=0.08,
    )  # fmt: skip
    keep = part.normal[:, 2] > -0.5
    part = type(part)(*(getattr(part, n)[keep] for n in type(part).__slots__))
    shade = rng.uniform(0.88, 1.12, len(part)) * np.where(
        np.abs(part.normal[:, 2]) > 0.5, 1.0, 0.80 - 0.25 * (part.position[:, 2] < base + 0.02)
    )
    return replace_colour(part, part.colour * shade[:, None])


def _joints(side, noise, layout):
    """Yield the dark joints between the flags where they can be seen."""
    begin, end = span(layout, 2, 5)
    for row in range(1, 6):
        away = KERB + 0.45 * row
        if away > FACADE:
            continue
        x = np.arange(begin, end, 0.11)
        x = x[~layout.beside_side_street(x, SIDE_FACADE)]
        y = np.full(x.size, side * away)
        points = np.stack([x, y, bed_height(x, y, noise, layout) + 0.0006], axis=1)
        yield strands(points, (1, 0, 0), (0.225, 0.220, 0.205), 0.06, 0.0045, flat=0.1)
    for row in range(6):
        low, high = KERB + max(0.45 * row, KERB_WIDTH), min(KERB + 0.45 * (row + 1), FACADE)
        first = np.ceil((begin + 0.37 * row) / 0.6) * 0.6 - 0.37 * row
        x = np.arange(first, end, 0.6)
        x = np.repeat(x[~layout.beside_side_street(x, SIDE_FACADE)], 4)
        part = (np.tile(np.arange(4), x.size // 4) + 0.5) / 4
        y = side * (low + (high - low) * part)
        points = np.stack([x, y, bed_height(x, y, noise, layout) + 0.0006], axis=1)
        reach = 0.6 * (high - low) / 4
        yield strands(points, (0, 1, 0), (0.225, 0.220, 0.205), reach, 0.0045, flat=0.1)
