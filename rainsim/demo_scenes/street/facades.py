"""Houses along the street: brick and render, windows dark and lit, shops on the ground floor."""

import numpy as np

from rainsim.demo_scenes.build import OVERLAP, box, cells, discs, grid, join, line, replace_colour

GROUND_FLOOR, STOREY = 3.5, 2.95  # m
WALLS = np.array(
    [
        (0.430, 0.250, 0.195), (0.545, 0.510, 0.445), (0.365, 0.275, 0.235), (0.500, 0.380, 0.270),
        (0.420, 0.435, 0.430), (0.470, 0.290, 0.225), (0.585, 0.555, 0.500), (0.330, 0.340, 0.355),
    ]
)  # fmt: skip
BRICK = (True, False, True, False, False, True, False, True)
FRAME, SILL = np.array([0.640, 0.630, 0.600]), np.array([0.560, 0.545, 0.515])
# Brighter than white: lamps are, and what water mirrors of them shows it.
WARM = np.array([(1.30, 1.00, 0.56), (1.34, 1.10, 0.72), (1.24, 0.88, 0.45), (1.10, 1.14, 1.18)])
SIGNS = np.array([(0.10, 0.20, 0.17), (0.28, 0.07, 0.07), (0.08, 0.11, 0.22), (0.14, 0.13, 0.12)])


class Wall:
    """The vertical plane of a house front: u goes along it, z up, `out` towards the street.

    `corner` is (x, y) [m] where u = 0; `along` and `out` are unit vectors (x, y); `spacing` [m] is
    the distance of its splats at the foot: higher up it grows.
    """

    def __init__(self, corner, along, out, spacing):
        self.corner, self.spacing = np.array([*corner, 0.0]), spacing
        self.along, self.out = np.array([*along, 0.0]), np.array([*out, 0.0])

    def at(self, u, z, out=0.0):
        """Return points (n, 3) of the wall, `out` metres before it."""
        u, z, out = np.broadcast_arrays(np.asarray(u, float), z, out)
        return (
            self.corner + u[:, None] * self.along + out[:, None] * self.out + z[:, None] * (0, 0, 1)
        )

    def panel(self, u0, u1, z0, z1, colour, *, out=0.0, fine=1.0, shape=1.0, sheen=0.0):
        """Return the `Cloud` of a rectangle of the wall, or None if it has no area.

        The rectangle goes from `u0` and `z0` to `u1` and `z1` [m], `out` [m] before the wall.
        `colour` takes u and z of n splats and gives display-referred colours (n, 3). `fine` is a
        factor on the wall's spacing, which also grows with z0, `shape` the width of a cell over its
        height.
        """
        if u1 - u0 < 1e-3 or z1 - z0 < 1e-3:
            return None
        cell = self.spacing * fine * (1 + 0.05 * z0)
        a, da = cells(u1 - u0, min(cell * shape, u1 - u0))
        b, db = cells(z1 - z0, min(cell, z1 - z0))
        u, z = grid(a + u0, b + z0)
        size = np.stack([*grid(da, db)], axis=1) * OVERLAP
        return discs(
            self.at(u, z, out), self.out, colour(u, z), size, along=self.along, sheen=sheen
        )

    def block(self, u0, u1, z0, z1, out, colour, spacing=None):
        """Return the `Cloud` of a box on the wall whose front stands `out` metres before it."""
        axes = np.stack([self.along, self.out, (0, 0, 1)])
        middle = self.at(np.array([(u0 + u1) / 2]), (z0 + z1) / 2, out / 2)[0]
        part = box(middle, ((u1 - u0) / 2, out / 2, (z1 - z0) / 2), colour,
                   spacing=spacing or self.spacing, along=0, stretch=3, axes=axes)  # fmt: skip
        below = np.minimum(part.normal[:, 2], 0)  # the sky does not reach undersides
        return replace_colour(part, part.colour * (1 + 0.45 * below)[:, None])

    def bar(self, points, colour, width, out=0.02):
        """Return the `Cloud` of a thin line of `width` [m] through points (n, 2) of u and z."""
        u, z = np.array(points, float).T
        return line(self.at(u, z, out), colour, width, piece=3 * self.spacing)


def house(wall, width, storeys, style, noise, rng):
    """Return a house front of `width` [m], and where warm light leaves it: (u, strength) rows."""
    colour, brick = WALLS[style], BRICK[style]
    glows, parts = [], []
    shift = rng.uniform(0, 50)

    def bricks(u, z):
        tone = rng.normal(0, 0.085 if brick else 0.018, (len(u), 1))
        where = np.stack([u + shift, z], axis=1)
        weather = 0.09 * noise(where, (2.5, 3.5), octaves=3)
        streaks = 0.07 * noise(np.stack([u * 4 + shift, z * 0.4], axis=1), 1.3, octaves=2)
        foot = 0.30 * np.exp(-z / 0.35)
        shade = (1 + weather + streaks - foot)[:, None] + tone
        return colour * shade * (1 + rng.normal(0, 0.02, (len(u), 3)) * brick)

    shape = 1.9 if brick else 1.0
    fine = 0.85 if brick else 1.15

    def wall_part(u0, u1, z0, z1):
        parts.append(wall.panel(u0, u1, z0, z1, bricks, fine=fine, shape=shape))

    shop = rng.random() < 0.72
    if shop:
        glows += _shop(wall, width, parts, wall_part, rng)
    else:
        glows += _dwelling(wall, width, parts, wall_part, rng)
    count = max(2, round(width / 2.25))
    step = width / count
    top = GROUND_FLOOR
    for floor in range(storeys):
        low, high = top + 0.75, top + 0.75 + (1.65 if floor == 0 else 1.5)
        wall_part(0, width, top, low)
        edge = 0.0
        for k in range(count):
            middle = (k + 0.5) * step
            u0, u1 = middle - 0.52, middle + 0.52
            wall_part(edge, u0, low, high)
            warm = rng.random() < 0.34
            parts += _window(wall, u0, u1, low, high, warm, rng)
            edge = u1
        wall_part(edge, width, low, high)
        wall_part(0, width, high, top + STOREY)
        top += STOREY
    parts.append(wall.block(0, width, top - 0.22, top + 0.10, 0.22, SILL * 0.85))
    wall_part(0, width, top + 0.10, top + 0.55)
    # A dark wall behind each front, so that no sky shows between its splats.
    dark = np.array([0.30, 0.27, 0.24])
    parts.append(
        wall.panel(0, width, 0, top + 0.5, lambda u, z: _flat(u, dark), out=-0.2, fine=2.5)
    )
    # a roof, seen at a slant from below
    parts.append(_roof(wall, width, top + 0.55, rng))
    parts.append(wall.bar([(0.06, 0.2), (0.06, top)], (0.17, 0.17, 0.18), 0.035, out=0.07))
    return join([part for part in parts if part is not None]), glows


def _roof(wall, width, base, rng):
    a, da = cells(width, 3 * wall.spacing)
    b, db = cells(2.4, 3 * wall.spacing)
    u, v = grid(a, b)
    points = wall.at(u, base + 0.62 * v, -0.78 * v + 0.15)
    tone = np.array([0.215, 0.215, 0.235]) * rng.uniform(0.85, 1.12, (len(u), 1))
    normal = 0.62 * wall.out + 0.78 * np.array([0, 0, 1])
    size = np.stack([*grid(da, db)], axis=1) * OVERLAP
    return discs(points, normal, tone, size, along=wall.along, sheen=0.15)


def _glass(z0, z1, rng):
    """Return the colour of a dark pane: a little sky in its upper part, a curtain's edge."""
    tint = rng.uniform(0.8, 1.2)

    def colour(u, z):
        rise = np.clip((z - z0) / (z1 - z0), 0, 1)[:, None]
        base = np.array([0.085, 0.095, 0.105]) + rise**1.5 * np.array([0.115, 0.130, 0.145]) * tint
        return base * rng.uniform(0.94, 1.06, (len(u), 1))

    return colour


def _glow(u0, u1, z0, z1, rng):
    """Return the colour of a lit pane: a warm room, brightest below its lamp, curtains aside."""
    warm = WARM[rng.choice(4, p=(0.4, 0.3, 0.2, 0.1))] * rng.uniform(0.82, 1.05)
    lamp = rng.uniform(0.25, 0.75)
    curtain = rng.uniform(0.05, 0.28) * (rng.random() < 0.7)
    blind = rng.uniform(0.3, 0.7) if rng.random() < 0.25 else 1.0

    def colour(u, z):
        s, t = (u - u0) / (u1 - u0), (z - z0) / (z1 - z0)
        light = 0.62 + 0.38 * np.exp(-(((s - lamp) / 0.45) ** 2) - ((t - 0.72) / 0.5) ** 2)
        light = np.where((s < curtain) | (s > 1 - curtain), 0.72 * light, light)
        light = np.where(t > blind, 0.86 + 0 * light, light)
        sill = np.where(t < 0.10, 0.55, 1.0)
        return warm * (light * sill)[:, None]

    return colour


def _window(wall, u0, u1, z0, z1, warm, rng):
    """Return a sash window: pane, frame, sill and lintel."""
    colour = _glow(u0, u1, z0, z1, rng) if warm else _glass(z0, z1, rng)
    middle = (z0 + z1) / 2
    yield wall.panel(u0, u1, z0, z1, colour, out=-0.08, fine=0.8, sheen=0.0)
    corners = [(u0, z0), (u0, z1), (u1, z1), (u1, z0), (u0, z0)]
    yield wall.bar(corners, FRAME * 0.92, 0.026, out=-0.04)
    yield wall.bar([(u0, middle), (u1, middle)], FRAME * 0.85, 0.016, out=-0.06)
    if u1 - u0 > 0.9:
        yield wall.bar([((u0 + u1) / 2, z0), ((u0 + u1) / 2, z1)], FRAME * 0.85, 0.011, out=-0.06)
    yield wall.block(u0 - 0.09, u1 + 0.09, z0 - 0.10, z0 - 0.02, 0.11, SILL)
    yield wall.panel(u0 - 0.1, u1 + 0.1, z1 + 0.03, z1 + 0.22, lambda u, z: _flat(u, SILL * 0.9),
                     out=0.012)  # fmt: skip


def _flat(u, colour):
    return np.broadcast_to(colour, (len(u), 3)).copy()


def _shop(wall, width, parts, wall_part, rng):
    """Add a shop front to `parts`: lit windows with goods, a door, a sign, perhaps an awning.

    `wall_part(u0, u1, z0, z1)` adds a stretch of the bare wall. Returns where warm light leaves
    the front: (u, strength) rows.
    """
    sign = SIGNS[rng.integers(0, len(SIGNS))]
    door = rng.uniform(0.18, 0.32) * width if rng.random() < 0.5 else rng.uniform(0.65, 0.8) * width
    d0, d1 = door - 0.5, door + 0.5
    panes = [(0.35, d0 - 0.22), (d1 + 0.22, width - 0.35)]
    wall_part(0, width, 0, 0.45)
    edge = 0.0
    glows = []
    for u0, u1 in panes:
        if u1 - u0 < 0.8:
            continue
        wall_part(edge, u0, 0.45, 2.65)
        parts.append(wall.panel(u0, u1, 0.45, 2.65, _goods(u0, rng), out=-0.06, fine=0.7))
        bars = [(u0, 0.45), (u0, 2.65), (u1, 2.65), (u1, 0.45), (u0, 0.45)]
        parts.append(wall.bar(bars, sign * 1.3, 0.035, out=0.0))
        for k in np.arange(1, round((u1 - u0) / 1.5)):
            u = u0 + k * (u1 - u0) / round((u1 - u0) / 1.5)
            parts.append(wall.bar([(u, 0.45), (u, 2.65)], sign * 1.3, 0.025, out=0.0))
        glows.append(((u0 + u1) / 2, 0.9 * min(1.0, (u1 - u0) / 3)))
        edge = u1
    wall_part(edge, width, 0.45, 2.65)
    glow = WARM[1] * 0.75
    parts.append(wall.panel(d0, d1, 0.30, 2.30, lambda u, z: glow * (0.6 + 0.15 * z)[:, None],
                            out=0.01, fine=0.8))  # fmt: skip
    parts.append(wall.bar([(d0, 0.0), (d0, 2.32), (d1, 2.32), (d1, 0.0)], sign * 1.2, 0.05))
    parts.append(wall.panel(d0, d1, 0.0, 0.32, lambda u, z: _flat(u, sign), out=0.015, fine=0.8))
    wall_part(0, width, 2.65, GROUND_FLOOR)
    parts.append(wall.block(0.15, width - 0.15, 2.72, 3.25, 0.10, sign, spacing=wall.spacing))
    parts.append(_letters(wall, width, rng))
    if rng.random() < 0.55:
        parts.append(_awning(wall, 0.3, width - 0.3, sign, rng))
    return glows


def _goods(u0, rng):
    """Return colour(u, z) of a shop window: shelves of goods before a bright back wall."""
    warm = WARM[rng.integers(0, 4)] * 0.98
    palette = rng.uniform(0.15, 1.0, (9, 3)) * (1.0, 0.85, 0.65)
    width = rng.uniform(0.10, 0.24)
    offset = rng.integers(0, 99)

    def colour(u, z):
        shelf = np.floor((z - 0.45) / 0.42).astype(int)
        item = np.floor((u - u0) / width + 0.37 * shelf).astype(int)
        pick = (item * 7 + shelf * 13 + offset) % 9
        tall = 0.10 + 0.26 * (((item * 5 + shelf * 3 + offset) % 7) / 6)
        within = np.mod(z - 0.45, 0.42)
        is_item = (within < tall) & (shelf < 4) & ((item * 3 + shelf) % 5 > 0)
        back = warm * (0.62 + 0.40 * np.clip((z - 0.45) / 2.2, 0, 1))[:, None]
        value = np.where(is_item[:, None], 0.42 * back + 0.42 * palette[pick], back)
        plank = (within < 0.035) & (shelf > 0) & (shelf < 5)
        return np.where(plank[:, None], 0.35 * value, value)

    return colour


def _letters(wall, width, rng):
    """Return a row of light marks on a sign that read as writing from afar."""
    n = int(rng.integers(5, 11))
    u = width / 2 + (np.arange(n) - (n - 1) / 2) * 0.30
    points = wall.at(u, 2.98 + 0 * u, 0.115)
    size = np.stack([rng.uniform(0.05, 0.085, n), rng.uniform(0.08, 0.11, n)], axis=1)
    return discs(points, wall.out, (0.86, 0.80, 0.62), size, along=wall.along)


def _awning(wall, u0, u1, colour, rng):
    """Return a striped awning over a shop window."""
    a, da = cells(u1 - u0, 0.16 * max(1.0, wall.spacing / 0.12))
    b, db = cells(1.05, 0.16)
    u, v = grid(a + u0, b)
    stripe = (np.floor((u - u0) / 0.32).astype(int) % 2 == 0)[:, None]
    tone = np.where(stripe, colour * 1.9 + 0.06, (0.62, 0.60, 0.55))
    tone = tone * rng.uniform(0.94, 1.05, (len(u), 1))
    points = wall.at(u, 2.85 - 0.38 * v, 0.12 + 0.92 * v)
    size = np.stack([*grid(da, db)], axis=1) * OVERLAP
    slope = discs(points, 0.38 * wall.out + np.array([0, 0, 0.92]), tone, size, along=wall.along)
    edge = a + u0
    points = wall.at(edge, 2.39 + 0 * edge, 1.09)
    stripe = (np.floor((edge - u0) / 0.32).astype(int) % 2 == 0)[:, None]
    tone = np.where(stripe, colour * 1.6 + 0.04, (0.52, 0.50, 0.46))
    size = np.stack([da * OVERLAP, np.full(len(a), 0.06)], axis=1)
    return join([slope, discs(points, wall.out, tone, size, along=wall.along)])


def _dwelling(wall, width, parts, wall_part, rng):
    """Add a ground floor of a front door and windows."""
    door = 0.9 if rng.random() < 0.5 else width - 0.9
    spots = [u for u in np.linspace(1.2, width - 1.2, max(2, round(width / 2.4)))
             if abs(u - door) > 1.25]  # fmt: skip
    marks = sorted([(door, None), *((u, rng.random() < 0.5) for u in spots)], key=lambda m: m[0])
    wall_part(0, width, 2.75, GROUND_FLOOR)
    edge, glows = 0.0, []
    paint = SIGNS[rng.integers(0, len(SIGNS))] * 1.8
    for u, warm in marks:
        half = 0.48 if warm is None else 0.58
        wall_part(edge, u - half, 0, 2.75)
        if warm is None:
            parts.append(wall.panel(u - half, u + half, 0.02, 2.2, lambda a, z: _flat(a, paint),
                                    out=-0.06, fine=0.8, sheen=0.15))  # fmt: skip
            parts.append(wall.panel(u - half, u + half, 2.2, 2.75, _glow(u - half, u + half, 2.2,
                                    2.75, rng), out=-0.06, fine=0.8))  # fmt: skip
            frame = [(u - half, 0), (u - half, 2.75), (u + half, 2.75), (u + half, 0)]
            parts.append(wall.bar(frame, FRAME, 0.04))
            parts.append(wall.block(u - half - 0.1, u + half + 0.1, 0.0, 0.14, 0.32, SILL * 0.8))
        else:
            wall_part(u - half, u + half, 0, 0.95)
            parts.extend(_window(wall, u - half, u + half, 0.95, 2.75, warm, rng))
            if warm:
                glows.append((u, 0.45))
        edge = u + half
    wall_part(edge, width, 0, 2.75)
    return glows


def houses(noise, rng, reach, depth):
    """Return all fronts and the glows on the ground: rows of x, y, reach [m], strength."""
    parts, glows = [], []
    for side in (-1, 1):
        x = reach[0]
        style = 0 if side < 0 else 3
        while x < reach[1]:
            width = float(rng.uniform(6.2, 9.4))
            spacing = 0.105 + 0.010 * max(x - 20, 0) + 0.02 * max(-x - width, 0)
            wall = Wall((x, side * depth), (1, 0), (0, -side), spacing)
            style = (style + int(rng.integers(1, 4))) % len(WALLS)
            front, warm = house(wall, width, int(rng.integers(2, 4)), style, noise, rng)
            parts.append(front)
            glows += [(x + u, side * (depth - 0.6), 1.5, strength) for u, strength in warm]
            x += width
    for x, out, spacing in ((reach[1] + 7, -1, 0.42), (reach[0] - 5, 1, 0.55)):
        y = -16.0
        while y < 16:
            width = float(rng.uniform(7, 10))
            wall = Wall((x, y), (0, 1), (out, 0), spacing)
            style = (style + int(rng.integers(1, 4))) % len(WALLS)
            parts.append(house(wall, width, 3, style, noise, rng)[0])
            y += width
    return _hazy(join(parts)), np.array(glows)


def _hazy(cloud, reach=260.0):
    """Return the cloud with the dull air between it and the start of the street."""
    away = np.linalg.norm(cloud.position, axis=1, keepdims=True)
    share = 1 - np.exp(-away / reach)
    return replace_colour(
        cloud, cloud.colour + share * (np.array([0.60, 0.62, 0.63]) - cloud.colour)
    )
