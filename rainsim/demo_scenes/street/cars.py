"""Parked cars: bodies lofted through cross-sections, wheels, lamps."""

import numpy as np

from rainsim.demo_scenes.build import box, discs, grid, join, lit, moved, polished, turn_about, unit

LENGTH, WIDTH = 4.25, 1.76  # m
WHEEL, TRACK = 0.315, 0.76  # m, radius, and half the distance between the wheels' middles
AXLES = (0.80, 3.38)  # m from the rear
SILL = 0.21  # m
GLASS = np.array([0.075, 0.085, 0.095])
RUBBER, RIM = np.array([0.085, 0.085, 0.088]), np.array([0.46, 0.47, 0.48])

# Side views, metres from the rear: belt line (where the glass begins), and roof or bonnet
HATCH = {
    "belt": [(0.0, 0.86), (0.3, 0.92), (1.5, 0.93), (3.0, 0.93), (3.3, 0.90), (4.0, 0.76),
             (4.25, 0.60)],
    "roof": [(0.0, 0.87), (0.10, 1.02), (0.42, 1.36), (0.9, 1.45), (1.9, 1.465), (2.45, 1.38),
             (3.18, 0.955), (3.6, 0.90), (4.0, 0.80), (4.25, 0.62)],
    "pillars": (0.30, 1.02, 1.92, 2.92),
}  # fmt: skip
SALOON = {
    "belt": [(0.0, 0.80), (0.5, 0.92), (1.5, 0.92), (2.9, 0.91), (3.3, 0.88), (4.0, 0.74),
             (4.25, 0.58)],
    "roof": [(0.0, 0.82), (0.12, 0.93), (0.62, 0.975), (1.15, 1.36), (1.5, 1.42), (2.1, 1.42),
             (2.5, 1.34), (3.15, 0.945), (3.6, 0.88), (4.0, 0.77), (4.25, 0.60)],
    "pillars": (0.95, 1.75, 2.05, 2.92),
}  # fmt: skip
VAN = {
    "belt": [(0.0, 1.02), (1.5, 1.05), (3.2, 1.04), (3.6, 0.98), (4.1, 0.80), (4.25, 0.62)],
    "roof": [(0.0, 1.72), (0.1, 1.84), (0.8, 1.90), (2.4, 1.90), (2.9, 1.80), (3.5, 1.10),
             (3.8, 0.99), (4.1, 0.84), (4.25, 0.64)],
    "pillars": (0.0, 2.05, 2.15, 3.2),
}  # fmt: skip

# x of the middle, side of the street, heading (1: with us), shape, paint, lamps lit
PARKED = (
    (0.6, -1, 1, HATCH, (0.310, 0.055, 0.060), False),
    (7.4, 1, -1, SALOON, (0.200, 0.260, 0.330), False),
    (2.2, 1, -1, HATCH, (0.560, 0.565, 0.570), False),
    (13.2, 1, -1, HATCH, (0.120, 0.125, 0.130), True),
    (15.9, -1, 1, SALOON, (0.615, 0.605, 0.575), True),
    (25.2, -1, 1, VAN, (0.640, 0.645, 0.640), False),
    (25.8, 1, -1, SALOON, (0.085, 0.150, 0.115), False),
    (31.0, 1, -1, HATCH, (0.500, 0.110, 0.085), False),
    (31.6, -1, 1, HATCH, (0.130, 0.170, 0.290), False),
    (37.0, -1, 1, SALOON, (0.380, 0.385, 0.390), False),
    (38.0, 1, -1, VAN, (0.230, 0.245, 0.250), False),
    (45.0, 1, -1, HATCH, (0.560, 0.540, 0.500), False),
    (-5.5, -1, 1, SALOON, (0.250, 0.255, 0.265), False),
    (-6.5, 1, -1, HATCH, (0.480, 0.480, 0.470), False),
)
PARKING = 2.42  # m from the middle of the street to the middle of a parked car


def footprints(parked=PARKED):
    """Return x, y, half length and half width of the cars [m], ndarray of shape (n, 4)."""
    places = [(x, s * PARKING, LENGTH / 2, WIDTH / 2) for x, s, *_ in parked]
    return np.array(places).reshape(-1, 4)


def lamp_glows(parked=PARKED):
    """Return the warm light of lit lamps on the road: x, y, reach [m], strength."""
    rows = []
    for x, side, heading, _, _, on in parked:
        if on:
            rows.append((x + heading * (LENGTH / 2 + 1.6), side * (PARKING - 0.3), 1.7, 0.5))
    return np.array(rows).reshape(-1, 4)


def parked_cars(rng, parked=PARKED, near=(-8, 20), finest=0.04):
    """Return cars in the street's frame; splats are `finest` m apart for x in `near` [m]."""
    parts = []
    for x, side, heading, shape, paint, on in parked:
        spacing = finest if near[0] < x < near[1] else 0.06
        cloud = car(shape, np.array(paint), on, spacing, rng)
        base = -0.030  # where the tyres stand on the camber
        turn = turn_about((0, 0, 1), 0.0 if heading > 0 else np.pi)
        parts.append(moved(cloud, turn, (x, side * PARKING, base)))
    return join(parts)


def _profile(points, u):
    """Interpolate a side view smoothly: straight pieces with rounded corners."""
    x, z = np.array(points).T
    fine = np.linspace(0, LENGTH, 341)
    value = np.interp(fine, x, z)
    kernel = np.hanning(17)
    padded = np.pad(value, 8, mode="edge")
    value = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return np.interp(u, fine, value)


def _section(shape, u):
    """Return the half cross-section at u: y and z of its corner points, from the sill up."""
    belt, roof = _profile(shape["belt"], u), _profile(shape["roof"], u)
    nose = np.clip(1 - np.abs(u - LENGTH / 2) / (LENGTH / 2), 0, 1)
    half = WIDTH / 2 * (1 - 0.16 * (1 - np.minimum(nose / 0.16, 1)) ** 2)
    rise = np.maximum(roof - belt, 0.0)
    shoulder = half * np.where(rise > 0.12, 0.955, 0.93)
    upper = np.maximum(half * (0.955 - 0.26 * np.clip(rise / 0.5, 0, 1)), 0.5 * half)
    if shape is VAN:
        upper = np.maximum(upper, half * 0.86)
    y = [0.90 * half, 0.985 * half, half, 0.985 * half, shoulder,
         upper, 0.80 * upper, 0.45 * upper, 0 * half]  # fmt: skip
    low = np.minimum(belt, roof)
    z = [SILL + 0 * u, SILL + 0.13 + 0 * u, 0.52 + 0 * u, low - 0.10, low,
         np.maximum(roof - 0.075, low), np.maximum(roof - 0.02, low), roof + 0.006,
         roof + 0.012]  # fmt: skip
    return np.stack(y, -1), np.stack(z, -1)


def car(shape, paint, lamps, spacing, rng):
    """Return a car that points to +x, its middle over the origin, tyres on z = 0."""
    stations = np.linspace(0.0, LENGTH, max(24, round(LENGTH / spacing)))
    y, z = _section(shape, stations)
    length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(np.stack([y[40 % len(y)],
                             z[40 % len(y)]]), axis=1)))])  # fmt: skip
    count = max(10, round(length[-1] / spacing))
    corner = np.interp(np.linspace(0, length[-1], count), length, np.arange(y.shape[1]))
    low = np.minimum(corner.astype(int), y.shape[1] - 2)
    part = corner - low
    y = y[:, low] * (1 - part) + y[:, low + 1] * part
    z = z[:, low] * (1 - part) + z[:, low + 1] * part
    grid = np.stack([np.broadcast_to(stations[:, None], y.shape), y, z], axis=-1)
    right = _skin(grid, corner, shape, paint, rng)
    left = _mirrored(right)
    body = join([right, left, *_ends(shape, paint, spacing, rng)])
    body = polished(body, 0.16)
    facing = 0.5 + 0.5 * body.normal[:, 2]
    body = lit(body, (0.42 + 0.58 * facing) * np.interp(body.position[:, 2], (0.15, 0.6), (0.5, 1)))
    parts = [body, *_wheels(), *_mirrors(shape, paint), *_lamps(shape, lamps, rng), _floor()]
    cloud = join(parts)
    return moved(cloud, np.eye(3), (-LENGTH / 2, 0, 0))


def _skin(grid, corner, shape, paint, rng):
    """Return one side of the body from its grid of points (stations, around, 3)."""
    middle = 0.25 * (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1])
    along = 0.5 * (grid[1:, 1:] + grid[1:, :-1] - grid[:-1, 1:] - grid[:-1, :-1])
    across = 0.5 * (grid[1:, 1:] - grid[1:, :-1] + grid[:-1, 1:] - grid[:-1, :-1])
    normal = unit(np.cross(along, across))  # y is to the left; outwards on that side
    size = np.stack([np.linalg.norm(along, axis=-1), np.linalg.norm(across, axis=-1)], -1) * 0.66
    size = np.minimum(size, 1.6 * np.median(size[..., 0]))  # steep places would stick out as spikes
    where = np.broadcast_to(0.5 * (corner[1:] + corner[:-1]), middle.shape[:2])
    u, z = middle[..., 0], middle[..., 2]
    belt, roof = _profile(shape["belt"], u), _profile(shape["roof"], u)
    colour = np.broadcast_to(paint, middle.shape).copy()
    side_glass = (where > 4.15) & (where < 5.0) & (roof - belt > 0.16)
    first, second, third, last = shape["pillars"]
    side_glass &= (u > first) & (u < last)
    for pillar in (second, third):
        side_glass &= np.abs(u - pillar) > 0.045
    slope = np.abs(np.gradient(_profile(shape["roof"], np.linspace(0, LENGTH, 341)),
                               LENGTH / 340))  # fmt: skip
    steep = np.interp(u, np.linspace(0, LENGTH, 341), slope) > 0.40
    screen = (where > 5.6) & steep & (z > belt + 0.03) & (roof - belt > 0.03)
    screen &= (u > 2.2) if shape is VAN else (u > -1)
    glass = side_glass | screen
    colour[glass] = GLASS + 0.11 * np.clip(normal[glass][:, 2:], 0, 1)
    trim = where < 1.0
    colour[trim] = 0.55 * paint + 0.03
    seam = (z > 0.3) & (z < belt) & (where < 4) & (
        (np.abs(u - 1.32) < 0.02) | (np.abs(u - 2.35) < 0.02) | (np.abs(u - 3.1) < 0.02)
    )  # fmt: skip
    colour[seam] *= 0.6
    for axle in AXLES:
        arch = np.hypot(u - axle, z - WHEEL) < WHEEL + 0.055
        colour[arch & (where < 3.6)] = 0.05
    colour *= 1 + rng.normal(0, 0.012, (*colour.shape[:2], 1))
    n = size.shape[0] * size.shape[1]
    return discs(
        middle.reshape(n, 3), normal.reshape(n, 3), colour.reshape(n, 3), size.reshape(n, 2),
        along=unit(along).reshape(n, 3), thickness=1.5e-3, sheen=0.25,
    )  # fmt: skip


def _mirrored(cloud):
    flip = np.array([1, -1, 1], np.float32)
    axes = cloud.axes * flip
    axes = axes * np.array([1, -1, 1], np.float32)[:, None]  # stays right-handed
    return type(cloud)(cloud.position * flip, axes, cloud.scale, cloud.colour, cloud.opacity,
                       cloud.sheen)  # fmt: skip


def _ends(shape, paint, spacing, rng):
    """Return the rear and front faces that close the loft, with bumpers, plates and a grille."""
    for u, out in ((0.0, -1), (LENGTH, 1)):
        y, z = _section(shape, np.array([u]))
        top = float(z.max())
        ys = np.arange(-y.max() + spacing / 2, y.max(), spacing)
        zs = np.arange(SILL + spacing / 2, top, spacing)
        yy, zz = grid(ys, zs)
        half = np.interp(zz, z[0], y[0])
        keep = np.abs(yy) < half + 0.01
        yy, zz = yy[keep], zz[keep]
        colour = np.broadcast_to(paint, (len(yy), 3)).copy()
        colour[zz < 0.50] = 0.45 * paint + 0.04
        if out > 0:
            colour[(np.abs(yy) < 0.42) & (zz > 0.38) & (zz < 0.56)] = 0.06
        glass = (out < 0) & (zz > 1.05) & (zz < top - 0.12) & (np.abs(yy) < 0.66)
        colour[glass] = GLASS + 0.02
        bulge = 0.05 * (1 - (yy / y.max()) ** 2)
        points = np.stack([u + out * bulge, yy, zz], axis=1)
        normal = unit(np.stack([np.full(len(yy), float(out)), 0.12 * yy, 0.1 + 0 * yy], axis=1))
        yield discs(points, normal, colour, 0.66 * spacing, along=(0, 1, 0), sheen=0.1)
        plate = np.array([0.80, 0.72, 0.30]) if out < 0 else np.array([0.82, 0.82, 0.80])
        yield box((u + out * 0.065, 0, 0.46), (0.006, 0.26, 0.055), plate, spacing=0.05, along=1)


def _wheels():
    """Return four wheels: tyres and rims as rings of splats."""
    for axle in AXLES:
        for side in (-1, 1):
            for radius, tone, out in (
                (0.285, RUBBER, 0.0), (0.245, RUBBER * 1.25, 0.01), (0.205, RIM, 0.004),
                (0.165, RIM * 0.55, -0.01), (0.12, RIM * 0.75, -0.01), (0.07, RIM, 0.0),
                (0.02, RIM * 0.8, 0.005),
            ):  # fmt: skip
                n = max(3, round(2 * np.pi * radius / 0.05))
                turn = 2 * np.pi * np.arange(n) / n
                points = np.stack(
                    [axle + radius * np.cos(turn), np.full(n, side * (TRACK + 0.09 + out)),
                     WHEEL + radius * np.sin(turn)], axis=1,
                )  # fmt: skip
                spoke = np.where(np.cos(5 * turn) > 0, 1.0, 0.5) if 0.06 < radius < 0.2 else 1.0
                colour = np.atleast_2d(tone) * np.broadcast_to(spoke, n)[:, None]
                yield discs(points, (0, side, 0), colour, 0.026, thickness=4e-3)
            n = 26
            turn = 2 * np.pi * np.arange(n) / n
            outward = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
            points = outward * WHEEL * 0.985 + (axle, side * TRACK, WHEEL)
            size = np.tile([0.052, 0.062], (n, 1))
            along = np.stack([-np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
            yield discs(points, outward, RUBBER * 0.8, size, along=along, thickness=4e-3)


def _lamps(shape, on, rng):
    """Return head and tail lamps."""
    tall = shape is VAN
    for side in (-1, 1):
        red = np.array([2.4, 0.20, 0.12]) if on else np.array([0.42, 0.055, 0.05])
        low, high = (0.72, 1.02) if tall else (0.62, 0.80)
        yield _cluster(-0.012, side * 0.66, low, high, 0.15, red, -1)
        white = np.array([3.4, 3.2, 2.7]) if on else np.array([0.60, 0.62, 0.64])
        yield _cluster(LENGTH - 0.055, side * 0.62, 0.55, 0.66, 0.16, white, 1)


def _cluster(u, y, low, high, half, colour, out):
    across = np.linspace(y - half + 0.03, y + half - 0.03, 6)
    ys, zs = grid(across, np.linspace(low + 0.02, high - 0.02, 4))
    points = np.stack([u + out * (0.06 + 0.05 * (1 - (ys / 0.88) ** 2)), ys, zs], axis=1)
    middle = np.exp(-(((ys - y) / half) ** 2))
    size = np.tile([half / 4.2, (high - low) / 4.4], (len(ys), 1))
    tone = colour * (0.75 + 0.35 * middle)[:, None]
    return discs(points, (out, 0, 0.08), tone, size, along=(0, 1, 0), thickness=3e-3)


def _floor():
    """Return the dark underside; its splats end within the body, or they would veil the wheels."""
    x, y = grid(np.arange(0.18, LENGTH - 0.1, 0.1), np.arange(-0.6, 0.61, 0.1))
    points = np.stack([x, y, np.full(x.size, SILL + 0.02)], axis=1)
    return discs(points, (0, 0, -1), (0.03, 0.03, 0.032), 0.075, thickness=4e-3)


def _mirrors(shape, paint):
    """Return the two door mirrors."""
    u = 2.72 if shape is VAN else 2.62
    z = 1.14 if shape is VAN else 1.0
    for side in (-1, 1):
        y = side * (WIDTH / 2 + 0.10)
        yield box((u, y, z), (0.05, 0.085, 0.055), 0.8 * paint, spacing=0.03, sheen=0.25)
        yield box((u - 0.053, y, z), (0.004, 0.07, 0.042), GLASS, spacing=0.025)
        yield box(
            (u + 0.01, side * (WIDTH / 2), z - 0.04), (0.02, 0.05, 0.015), RUBBER, spacing=0.02
        )
