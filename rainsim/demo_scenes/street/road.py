"""The street's ground: cambered asphalt, gutters that fall to drains, kerbs, flagged footways."""

import numpy as np

from rainsim.demo_scenes import build
from rainsim.demo_scenes.street.layout import CORNER, SIDE_FACADE, SIDE_KERB, SIDE_REACH, Layout

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
CRACKS = (
    (3.4, -1.9, 0.5, 3.6), (9.5, 1.9, -0.7, 3.2), (13.6, -1.4, 0.2, 4.2), (6.2, 0.3, 1.2, 1.8),
    (17.2, 1.2, -2.2, 2.4),
)  # fmt: skip
LAYOUT = Layout(
    ENDS, DRAINS, DIPS, PATCHES, (CROSSING,), ((-np.inf, 9.0), (23.0, np.inf)),
    ((9.9, 0.15), (25.3, -0.4)), CRACKS, stones=26_000, camber=CAMBER,
)  # fmt: skip


def crown_of(layout):
    """Return the height of the middle of the road [m]: the footways lie equally high in all."""
    return CROWN + layout.camber - CAMBER


def from_middle(x, y, layout):
    """Return how far places are from the middle of the road [m]; KERB at every kerb."""
    away = np.abs(y)
    across = away - KERB
    for side in layout.sides:
        along = np.abs(x - side) - SIDE_KERB
        round_corner = CORNER - np.hypot(CORNER - along, CORNER - across)
        corner = (along < CORNER) & (across < CORNER)
        away = np.minimum(away, KERB + np.where(corner, round_corner, np.minimum(along, across)))
    return np.maximum(away, 0.0)


def bed_height(x, y, noise, layout=LAYOUT):
    """Height of the ground [m] from house to house, without joints."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    away = from_middle(x, y, layout)
    crown = crown_of(layout)
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    height = crown - layout.camber * np.minimum(away / GUTTER, 1) ** 2
    height = height - GUTTER_FALL * np.clip((away - GUTTER) / (KERB - GUTTER), 0, 1)
    sag = np.zeros_like(x)
    grate = np.zeros_like(x)
    for dx, dy in layout.drains:
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
    for cx, cy, depth, along, across, angle in layout.dips:
        u = (warped_x - cx) * np.cos(angle) + (warped_y - cy) * np.sin(angle)
        v = (warped_y - cy) * np.cos(angle) - (warped_x - cx) * np.sin(angle)
        height = height - depth * np.exp(-(((u / along) ** 2 + (v / across) ** 2) ** 1.2))
    footway = crown - layout.camber - GUTTER_FALL + KERB_HEIGHT + FOOTWAY_FALL * (away - KERB)
    footway = footway + 0.0015 * noise(points, 1.4, octaves=2).reshape(x.shape)
    return np.where(away > KERB, footway, height)


def _cell(x, fine, layout):
    """Cell size [m] at x: fine where the drive comes close, growing away from it."""
    ahead, behind = np.maximum(x - layout.near[1], 0), np.maximum(layout.near[0] - x, 0)
    return layout.fine * fine + layout.cell[0] * ahead + layout.cell[1] * behind


def lattice(y_low, y_high, rng, layout, fine=0.046, jitter=0.14):
    """Return places (n, 2) and cell sizes (n, 2) [m] over the street between two y."""
    parts, sizes = [], []
    x = layout.ends[0]
    while x < layout.ends[1]:
        cell = _cell(x, fine, layout)
        dx = cell * (layout.long if layout.near[0] < x < layout.near[1] else 1.35)
        row, size = _row(y_low, y_high, cell, dx, rng, jitter)
        row[:, 0] += x + dx / 2
        parts.append(row)
        sizes.append(size)
        x += dx
    return np.concatenate(parts), np.concatenate(sizes)


def _row(low, high, cell, step, rng, jitter):
    """Return places and sizes of a row of cells across a road from `low` to `high`."""
    count = max(1, round((high - low) / cell))
    width = (high - low) / count
    row = np.stack([np.zeros(count), low + (np.arange(count) + 0.5) * width], axis=1)
    row += rng.normal(0, jitter, row.shape) * (step, width)
    row[:, 1] = np.clip(row[:, 1], low + 0.3 * width, high - 0.3 * width)
    return row, np.tile([step, width], (count, 1))


def side_lattices(layout, rng, fine, jitter):
    """Return places and cell sizes over the side streets of a layout, from kerb to kerb."""
    where, sizes = [np.empty((0, 2))], [np.empty((0, 2))]
    for middle in own_sides(layout):
        for sign in (-1, 1):
            y = KERB
            while y < SIDE_REACH + 4:
                cell = layout.fine * fine * (1 + 0.10 * (y - KERB))
                row, size = _row(-SIDE_FACADE - 0.15, SIDE_FACADE + 0.15, cell, cell, rng, jitter)
                where.append(
                    np.column_stack([middle + row[:, 1], sign * (y + cell / 2 + row[:, 0])])
                )
                sizes.append(size)
                y += cell
    return np.concatenate(where), np.concatenate(sizes)


def own_sides(layout):
    """Return the middles of the side streets that leave a layout's own piece of street."""
    return [x for x in layout.sides if layout.ends[0] <= x < layout.ends[1]]


def span(layout, before, after):
    """Return where something fine begins and ends: at `near` and so much [m] before and after."""
    return (
        max(layout.near[0] - before, layout.ends[0]),
        min(layout.near[1] + after, layout.ends[1]),
    )


def _normals(points, noise, layout, reach=0.03):
    x, y, z = points.T
    dx = bed_height(x + reach, y, noise, layout) - z
    dy = bed_height(x, np.where(y > 0, y - reach, y + reach), noise, layout) - z
    dy = np.where(y > 0, -dy, dy)
    return build.unit(np.stack([-dx / reach, -dy / reach, np.ones_like(dx)], axis=1))


def road_cloud(noise, rng, layout=LAYOUT):
    """Return the `Cloud` of the carriageway with its gutters, paint, cracks, covers and grates."""
    where, size = lattice(-KERB, KERB, rng, layout)
    along = where[:, 0]
    if layout.sides:
        more, sizes = side_lattices(layout, rng, 0.046, 0.14)
        road = from_middle(*more.T, layout) < KERB
        where, size = np.concatenate([where, more[road]]), np.concatenate([size, sizes[road]])
        along = np.concatenate([along, more[road, 1]])
    x, y = where.T
    away = from_middle(x, y, layout)
    points = np.column_stack([where, bed_height(x, y, noise, layout)])
    grain = rng.normal(0, 0.055, len(x))
    mottle = 0.10 * noise(where, 0.55, octaves=3) + 0.09 * noise(where + 9, 3.1, octaves=2)
    tracks = np.exp(-(((away - 0.78) / 0.22) ** 2))  # polished by tyres
    shade = 1 + grain + mottle + 0.06 * tracks - 0.10 * np.exp(-((y / 0.3) ** 2))
    for x0, x1, y0, y1, tone in layout.patches:
        inside = (x > x0) & (x < x1) & (y > y0) & (y < y1)
        shade = np.where(inside, tone * (1 + grain), shade)
    colour = ASPHALT * shade[:, None] * (1 + rng.normal(0, 0.012, (len(x), 3)))
    gutter = away > GUTTER + 0.06
    setts = 1 + 0.10 * np.sign(np.sin(2 * np.pi * along / 0.24)) * (_cell(x, 0.046, layout) < 0.1)
    silt = np.clip((away - KERB + 0.16) / 0.16, 0, 1)[:, None]
    stone = np.array([0.370, 0.362, 0.350]) * ((1 + grain + 0.6 * mottle) * setts)[:, None]
    stone = stone + silt * (np.array([0.235, 0.215, 0.180]) - stone)
    colour[gutter] = stone[gutter]
    colour = _painted(colour, x, y, noise, rng, layout)
    cloud = build.discs(
        points,
        _normals(points, noise, layout),
        colour,
        size * build.OVERLAP,
        sheen=0.06,
        opacity=0.97,
    )
    return build.join([cloud, _specks(noise, rng, layout), *_lines(noise, rng, layout),
                 *_covers(noise, rng, layout)])  # fmt: skip


def _painted(colour, x, y, noise, rng, layout):
    """Put the worn paint of the crossing and of the parking bays on the asphalt."""
    stripe = np.floor((y + KERB) / 0.5).astype(int) % 2 == 0
    on = _within(x, layout.crossings) & stripe & (np.abs(y) < GUTTER)
    bay = (np.abs(np.abs(y) - 1.52) < 0.045) & _within(x, layout.bays) & (np.mod(x, 1.2) < 0.75)
    for side in layout.sides:  # give way: a dashed line at the mouth of the side street
        mouth = (np.abs(x - side) < SIDE_KERB - 0.4) & (np.mod(x - side, 0.6) < 0.36)
        on |= mouth & (np.abs(np.abs(y) - KERB - 0.45) < 0.12)
    worn = np.stack([x, y], axis=1)
    worn = np.clip(0.80 + 0.55 * noise(worn, 0.35, octaves=3) + rng.normal(0, 0.07, len(x)), 0, 1)
    worn = np.where(bay, 0.8 * worn, worn) * (on | bay)
    tracks = 1 - 0.35 * np.exp(-(((np.abs(y) - 0.78) / 0.22) ** 2))
    return colour + (worn * tracks)[:, None] * (PAINT - colour)


def _within(x, spans):
    """Return whether places x lie within one of `spans`."""
    found = np.zeros(np.shape(x), bool)
    for low, high in spans:
        found |= (x > low) & (x < high)
    return found


def _specks(noise, rng, layout):
    """Return single stones of the asphalt, light and dark, where the camera comes close."""
    count, (low, high) = layout.stones, span(layout, -0.5, 0)
    x = low + (high - low) * rng.random(count)
    y = rng.uniform(-GUTTER, GUTTER, count)
    z = bed_height(x, y, noise, layout) + 0.0012
    tone = np.where(rng.random(count) < 0.5, 1.35, 0.62) * rng.uniform(0.9, 1.1, count)
    colour = ASPHALT * tone[:, None] * (1 + rng.normal(0, 0.03, (count, 3)))
    size = rng.uniform(0.004, 0.009, count)
    keep = ~_within(x, layout.crossings)
    points = np.stack([x, y, z], axis=1)[keep]
    return build.discs(points, (0, 0, 1), colour[keep], size[keep], thickness=8e-4, opacity=0.75)


def _lines(noise, rng, layout):
    """Return cracks sealed with tar and the joint between road and gutter."""
    for side in (-1, 1):
        x = np.arange(*span(layout, 8, 19), 0.12)
        x = x[~layout.beside_side_street(x, SIDE_KERB + CORNER)]
        y = np.full(x.size, side * (GUTTER + 0.05))
        points = np.stack([x, y, bed_height(x, y, noise, layout) + 0.001], axis=1)
        yield build.strands(points, (1, 0, 0), (0.150, 0.148, 0.145), 0.08, 0.006, flat=0.2)
    for x0, y0, turn, length in layout.cracks:
        steps = int(length / 0.05)
        heading = turn + 0.35 * np.cumsum(rng.normal(0, 0.28, steps))
        x, y = x0 + 0.05 * np.cumsum(np.cos(heading)), y0 + 0.05 * np.cumsum(np.sin(heading))
        keep = np.abs(y) < GUTTER
        x, y, heading = x[keep], y[keep], heading[keep]
        points = np.stack([x, y, bed_height(x, y, noise, layout) + 0.001], axis=1)
        along = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
        width = rng.uniform(0.008, 0.016, len(x))
        yield build.strands(points, along, (0.165, 0.165, 0.168), 0.034, width, flat=0.1)


def _covers(noise, rng, layout):
    """Return the grates of the drains and the manhole covers."""
    for x, y in layout.drains:
        if not layout.ends[0] <= x < layout.ends[1]:
            continue
        z = float(bed_height(np.array([x]), np.array([y]), noise, layout)[0])
        half = (*DRAIN_HALF, 0.004)
        yield build.box((x, y, z - 0.002), half, 0.35 * IRON, spacing=0.05, stretch=1)
        for k in np.linspace(-DRAIN_HALF[0] + 0.03, DRAIN_HALF[0] - 0.03, 10):
            yield build.box((x + k, y, z + 0.005), (0.010, DRAIN_HALF[1], 0.004), 2.2 * IRON,
                      spacing=0.02, along=1, stretch=4, sheen=0.3)  # fmt: skip
        for side in (-1, 1):
            yield build.box((x, y + side * DRAIN_HALF[1], z + 0.005), (DRAIN_HALF[0], 0.014, 0.005),
                      2.0 * IRON, spacing=0.03, stretch=3, sheen=0.3)  # fmt: skip
    for x, y in layout.covers:
        z = float(bed_height(np.array([x]), np.array([y]), noise, layout)[0]) + 0.004
        k = np.arange(900) + 0.5
        r, turn = 0.31 * np.sqrt(k / 900), k * np.pi * (3 - np.sqrt(5))
        points = np.stack([x + r * np.cos(turn), y + r * np.sin(turn), 0 * r + z], axis=1)
        knobs = np.sin(points[:, 0] * 90) * np.sin(points[:, 1] * 90) > 0
        tone = np.where(r > 0.275, 1.25, np.where(knobs, 1.7, 1.05)) * rng.uniform(0.92, 1.08, 900)
        yield build.discs(points, (0, 0, 1), IRON * tone[:, None], 0.0075, sheen=0.25)
        ring = np.linspace(0, 2 * np.pi, 40)
        points = np.stack([x + 0.325 * np.cos(ring), y + 0.325 * np.sin(ring), 0 * ring + z], 1)
        yield build.tube(points, 0.006, 1.5 * IRON, piece=0.05, around=5)


def ground_light(cars, layout=LAYOUT):
    """Return a function for the light at ground points: little below cars (x, y, half sizes)."""

    def light(points):
        x, y = points[:, 0], points[:, 1]
        value = np.ones(len(points))
        for cx, cy, along, across in cars:
            dx = np.maximum(np.abs(x - cx) - along + 0.12, 0)
            dy = np.maximum(np.abs(y - cy) - across + 0.12, 0)
            value *= 1 - 0.88 * np.exp(-((np.hypot(dx, dy) / 0.30) ** 1.5))
        wall = FACADE - np.abs(y)
        for side in layout.sides:
            wall = np.maximum(wall, SIDE_FACADE - np.abs(x - side))
        value *= 1 - 0.35 * np.exp(-np.maximum(wall, 0) / 0.5)
        away = from_middle(x, y, layout)
        corner = np.maximum(KERB - away, 0) + 10 * (away > KERB)
        return value * (1 - 0.30 * np.exp(-corner / 0.06))

    return light


def lit_ground(cloud, light, glows):
    """Return ground splats in skylight and that of `glows`: rows of x, y, reach [m], strength."""
    value = light(cloud.position)
    cloud = build.lit(cloud, value)
    warm = np.zeros(len(cloud))
    for x, y, reach, strength in glows:
        d2 = ((cloud.position[:, 0] - x) ** 2 + (cloud.position[:, 1] - y) ** 2) / reach**2
        warm += strength * np.exp(-d2)
    tint = 1 + warm[:, None] * np.array([0.42, 0.27, 0.08])
    return build.replace_colour(cloud, cloud.colour * tint)
