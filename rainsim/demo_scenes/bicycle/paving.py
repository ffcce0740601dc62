"""The paved path: shape of its bed, flagstones in a broken bond, joints and fallen leaves."""

import numpy as np

from rainsim.demo_scenes.build import OVERLAP, cells, discs, grid, join, lit, unit

NEAR_EDGE, FAR_EDGE = -2.7, 1.0  # m, the path's y range
HALF_LENGTH = 16.0  # m, the path's x range each way
MODULE = 0.24  # m, grid on which the flagstones are laid
KERB = 0.11  # m, width of the row of setts along each edge
JOINT = 0.011  # m, mean width of a joint
JOINT_DEPTH = 0.006  # m
UNEVENNESS = 0.0017  # m, of the bed over about a metre
CROSSFALL = 0.0025  # from the middle to both edges

# Shallow dips where water collects: x, y [m], depth [m], radii [m] along and across, angle [rad]
DIPS = np.array(
    [
        (-0.80, -1.12, 0.0120, 0.58, 0.36, 0.15),  # two that meet before the bicycle and mirror it
        (0.22, -0.98, 0.0105, 0.50, 0.30, -0.25),
        (0.95, -1.75, 0.0110, 0.42, 0.30, -0.5),
        (-2.00, -1.95, 0.0120, 0.48, 0.34, 0.6),
        (-1.90, -0.35, 0.0090, 0.40, 0.26, -0.2),
        (0.00, -2.20, 0.0070, 0.36, 0.22, 0.1),
        (1.85, -0.75, 0.0120, 0.50, 0.30, 0.3),
        (2.70, -1.90, 0.0100, 0.45, 0.32, -0.3),
        (-3.15, -1.10, 0.0110, 0.48, 0.30, 0.1),
        (0.55, 0.25, 0.0060, 0.34, 0.22, 0.0),
        (3.45, -0.30, 0.0120, 0.50, 0.30, 0.5),
        (-3.70, 0.20, 0.0090, 0.42, 0.28, -0.4),
        (5.10, -1.30, 0.0110, 0.55, 0.36, 0.2),
        (-5.30, -1.60, 0.0120, 0.52, 0.36, -0.3),
    ]
)

BUFF = ((0.565, 0.540, 0.495), (0.530, 0.525, 0.505), (0.590, 0.550, 0.480), (0.500, 0.505, 0.505))
GRANITE = ((0.470, 0.475, 0.480), (0.420, 0.425, 0.435))
SAND, MOSS = np.array([0.235, 0.215, 0.185]), np.array([0.225, 0.245, 0.150])


def bed_height(x, y, noise):
    """Height of the path's bed [m] without joints: crown, unevenness and dips."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    height = -CROSSFALL * np.abs(y - (NEAR_EDGE + FAR_EDGE) / 2)
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    height = height + UNEVENNESS * noise(points, 1.1, octaves=3).reshape(x.shape)
    # a warp of the plane: dips with wandering shores instead of ellipses
    x = x + 0.15 * noise(points + 17.0, 0.75, octaves=3).reshape(x.shape)
    y = y + 0.15 * noise(points + 31.0, 0.75, octaves=3).reshape(x.shape)
    for cx, cy, depth, along, across, angle in DIPS:
        u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
        v = (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
        height -= depth * np.exp(-(((u / along) ** 2 + (v / across) ** 2) ** 1.2))
    return height


def bed_normal(x, y, height, noise, reach=0.02):
    """Unit normals of the bed where its `height` is known, ndarray of shape (n, 3)."""
    dx = bed_height(x + reach, y, noise) - height
    dy = bed_height(x, y + reach, noise) - height
    return unit(np.stack([-dx / reach, -dy / reach, np.ones_like(dx)], axis=1))


def flagstones(rng):
    """Lay rectangles of 1 to 3 modules without gaps; rows x0, y0, x1, y1 and kind (1: a sett)."""
    depth = FAR_EDGE - NEAR_EDGE - 2 * KERB
    rows, columns = round(depth / MODULE), round(2 * HALF_LENGTH / MODULE)
    tall, wide = depth / rows, 2 * HALF_LENGTH / columns
    free = np.ones((rows, columns), bool)
    shapes = np.array([(2, 2), (2, 3), (3, 2), (1, 2), (2, 1), (3, 3), (1, 3), (1, 1)])
    stones = []
    for c in range(columns):  # column by column: no joint runs straight across the path
        for r in range(rows):
            if not free[r, c]:
                continue
            for high, long in shapes[
                np.argsort(rng.random(len(shapes)) * (1, 1, 1, 2, 2, 1.5, 2, 9))
            ]:
                block = free[r : r + high, c : c + long]
                if block.shape == (high, long) and block.all():
                    break
            else:
                high = long = 1
            free[r : r + high, c : c + long] = False
            x0, y0 = c * wide - HALF_LENGTH, r * tall + NEAR_EDGE + KERB
            stones.append((x0, y0, x0 + long * wide, y0 + high * tall, 0))
    for y0 in (NEAR_EDGE, FAR_EDGE - KERB):
        ends = np.arange(-HALF_LENGTH, HALF_LENGTH, 0.2) + rng.uniform(-0.02, 0.02)
        stones += [(x, y0, x + 0.2, y0 + KERB, 1) for x in ends]
    return np.array(stones)


def _spacing(stone):
    """Cell size on a stone [m]: coarser away from the bench."""
    x = (stone[0] + stone[2]) / 2
    return 0.0215 if abs(x) < 3.0 else 0.0215 + 0.014 * (abs(x) - 3.0)


def _stone_cells(stones, rng):
    """All cells of all stones: position, size, which stone, and distance to the stone's edge."""
    parts = []
    for s, stone in enumerate(stones):
        inset = rng.uniform(0.6, 1.4, 4) * JOINT / 2
        x0, y0, x1, y1 = stone[:4] + inset * (1, 1, -1, -1)
        spacing = _spacing(stone)
        a, da = cells(x1 - x0, spacing)
        b, db = cells(y1 - y0, spacing)
        a, b = grid(a, b)
        edge = np.minimum(np.minimum(a, x1 - x0 - a), np.minimum(b, y1 - y0 - b))
        parts.append([a + x0, b + y0, *grid(da, db), np.full(a.size, s), edge])
    x, y, sx, sy, which, rim = np.concatenate(parts, axis=1)
    return x, y, sx, sy, which.astype(int), rim


def stones_cloud(stones, noise, rng):
    """Return the tops of the stones."""
    x, y, sx, sy, which, rim = _stone_cells(stones, rng)
    n = len(stones)
    middle = (stones[:, :2] + stones[:, 2:4]) / 2
    tilt, offset = rng.normal(0, 0.0032, (n, 2)), rng.normal(0, 0.0008, n)
    du, dv = x - middle[which, 0], y - middle[which, 1]
    bevel = np.exp(-rim / 0.004)
    bed = bed_height(x, y, noise)
    z = bed + offset[which] + du * tilt[which, 0] + dv * tilt[which, 1]
    points = np.stack([x, y, z - 0.0015 * bevel], axis=1)
    normal = bed_normal(x, y, bed, noise)
    normal[:, :2] -= tilt[which]
    inner = (rim > sx) & (rim > sy)
    size = np.stack([sx, sy], axis=1) * OVERLAP
    size[inner] *= rng.uniform(0.9, 1.12, (inner.sum(), 2))
    points[inner, :2] += rng.normal(0, 0.1, (inner.sum(), 2)) * np.stack([sx, sy], 1)[inner]
    return discs(
        points, normal, _stone_colour(stones, points, which, rim, noise, rng), size,
        opacity=0.97, sheen=0.10,
    )  # fmt: skip


def _stone_colour(stones, points, which, rim, noise, rng):
    """Colour of each stone, mottled, stained across stones, dirtier at its rim and in dips."""
    n = len(stones)
    buff, granite = np.array(BUFF), np.array(GRANITE)
    base = np.where(
        stones[:, 4:] > 0,
        granite[rng.integers(0, len(granite), n)],
        buff[rng.integers(0, len(buff), n)],
    )
    base = base * (1 + rng.normal(0, 0.055, (n, 1))) * (1 + rng.normal(0, 0.008, (n, 3)))
    shifted = points[:, :2] + 3.7 * rng.random((n, 2))[which]  # each stone has its own grain
    mottle = 0.065 * noise(shifted, 0.13, octaves=3) + rng.normal(0, 0.034, len(points))
    stain = noise(points[:, :2] + 11.0, 0.9, octaves=3)
    shade = 1 + mottle - 0.10 * np.clip(stain, 0, None) - 0.16 * np.exp(-rim / 0.012)
    shade -= 0.10 * np.clip(-points[:, 2] / 0.012 - 0.35, 0, 1)  # silt darkens the dips
    colour = base[which] * shade[:, None]
    lichen = np.clip(noise(points[:, :2] - 5.0, 0.35, octaves=3) - 0.75, 0, 0.5)[:, None]
    return colour + lichen * (np.array([0.60, 0.60, 0.53]) - colour)


def joints_cloud(stones, noise, rng):
    """Return the sand and moss in the joints, as strands along the lower and left edges."""
    parts = []
    for axis in (0, 1):
        other = 1 - axis
        step = np.maximum(0.036, np.array([_spacing(s) for s in stones]) * 1.3)
        length = stones[:, 2 + axis] - stones[:, axis]
        count = np.ceil(length / step).astype(int)
        which = np.repeat(np.arange(len(stones)), count)
        k = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        points = np.empty((len(which), 3))
        points[:, axis] = stones[which, axis] + (k + 0.5) * (length / count)[which]
        points[:, other] = stones[which, other] + rng.normal(0, 0.0007, len(which))
        points[:, 2] = bed_height(points[:, 0], points[:, 1], noise) - JOINT_DEPTH
        moss = np.clip(0.5 + 0.9 * noise(points[:, :2], 0.8, octaves=3), 0, 1)[:, None]
        colour = (SAND + moss * (MOSS - SAND)) * rng.uniform(0.75, 1.3, (len(which), 1))
        size = np.stack([(length / count)[which] * 0.7, np.full(len(which), JOINT * 0.62)], axis=1)
        parts.append(discs(points, (0, 0, 1), colour, size, along=np.eye(3)[axis]))
    return join(parts)


def fallen_leaves(noise, rng, count=130):
    """Return leaves lying on the path, most of them near its far edge, three splats each."""
    x = rng.normal(0, 2.4, count)
    y = np.where(
        rng.random(count) < 0.6,
        FAR_EDGE - 0.05 - rng.gamma(1.5, 0.22, count),
        rng.uniform(NEAR_EDGE, FAR_EDGE, count),
    )
    turn, size = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.012, 0.021, count)
    palette = np.array(
        [(0.62, 0.44, 0.12), (0.50, 0.28, 0.10), (0.40, 0.30, 0.14), (0.55, 0.50, 0.18)]
    )
    colour = palette[rng.integers(0, len(palette), count)] * rng.uniform(0.75, 1.1, (count, 1))
    along = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    z = bed_height(x, y, noise) + rng.uniform(0.002, 0.005, count)
    centre = np.stack([x, y, z], axis=1)
    normal = unit(np.stack([*rng.normal(0, 0.16, (2, count)), np.ones(count)], axis=1))
    parts = []
    for shift, width, tint in ((-0.75, 0.42, 0.9), (0.0, 0.62, 1.0), (0.8, 0.36, 1.08)):
        parts.append(
            discs(
                centre + along * (shift * size)[:, None], normal, colour * tint,
                np.stack([size * 0.55, size * width], axis=1), along=along, sheen=0.1,
            )
        )  # fmt: skip
    return join(parts)


def paving_cloud(noise, rng, ground_light):
    """Return the whole path, lit by `ground_light(points)`."""
    stones = flagstones(rng)
    cloud = join(
        [
            stones_cloud(stones, noise, rng),
            joints_cloud(stones, noise, rng),
            fallen_leaves(noise, rng),
        ]
    )
    return lit(cloud, ground_light(cloud.position))
