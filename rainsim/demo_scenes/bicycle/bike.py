"""The bicycle: a town bike with mudguards, swept handlebar, rack and basket.

Built upright in its own frame (x back to front, y to its left, z up, ground at z = 0, rear hub at
x = 0), the front end turned about the steering axis, then leaned and set down by the bench.
"""

import numpy as np

from rainsim.demo_scenes.build import (
    box,
    discs,
    join,
    line,
    lit,
    moved,
    polished,
    tube,
    turn_about,
    unit,
)

WHEEL_RADIUS = 0.345  # m, to the outside of the tyre
TYRE_RADIUS = 0.019  # m
REAR_HUB = np.array([0.0, 0.0, WHEEL_RADIUS])
FRONT_HUB = np.array([1.07, 0.0, WHEEL_RADIUS])
CRANK = np.array([0.44, 0.0, 0.285])
SEAT_CLUSTER = np.array([0.290, 0.0, 0.790])
HEAD_LOW, HEAD_HIGH = np.array([0.925, 0.0, 0.715]), np.array([0.878, 0.0, 0.860])
STEERING = -0.16  # rad, front end turned about the head tube
LEAN = 0.135  # rad, towards the bench
PLACE = np.array([0.42, -0.475])  # m, where the rear tyre stands; the bicycle points to -x

PAINT = np.array([0.585, 0.095, 0.080])
CREAM = np.array([0.80, 0.76, 0.66])
CHROME = np.array([0.56, 0.57, 0.59])
RUBBER = np.array([0.105, 0.103, 0.100])
LEATHER = np.array([0.40, 0.235, 0.125])
WICKER = np.array([(0.60, 0.445, 0.270), (0.50, 0.360, 0.205)])
CIRCLE = np.linspace(0, 2 * np.pi, 8, endpoint=False)
STEEL = np.array([0.36, 0.37, 0.385])


def _from(point, x, y, z):
    """Return `point` shifted by x, y, z [m]."""
    return point + np.array([x, y, z])


def _arc(centre, radius, start, stop, count, y=0.0):
    """Points of a circle in the plane of the bicycle; angles [rad] from forward, upwards."""
    a = np.linspace(start, stop, count)
    return np.stack(
        [centre[0] + radius * np.cos(a), np.full(count, y), centre[2] + radius * np.sin(a)], 1
    )


def _wheel(hub, spokes=28):
    """Return a wheel: tyre, rim, hub and crossed spokes."""
    tyre = _arc(hub, WHEEL_RADIUS - TYRE_RADIUS, 0, 2 * np.pi, 91)
    rim = _arc(hub, WHEEL_RADIUS - 2 * TYRE_RADIUS - 0.006, 0, 2 * np.pi, 91)
    axle = hub + np.array([[0, -0.055, 0], [0, 0.055, 0]])
    parts = [
        tube(tyre, TYRE_RADIUS, RUBBER, piece=0.022, around=10, sheen=0.1),
        tube(rim, 0.0095, CHROME, piece=0.022, around=7, sheen=0.35, squash=1.0),
        tube(axle, 0.021, CHROME, piece=0.02, around=9, sheen=0.3),
    ]
    for k in range(spokes):
        side = 0.028 * (-1) ** k
        at = 2 * np.pi * k / spokes
        cross = 0.75 * (-1) ** (k // 2)  # spokes leave the hub nearly along its flange
        start = hub + np.array([0.021 * np.cos(at + cross), side, 0.021 * np.sin(at + cross)])
        end = _arc(hub, WHEEL_RADIUS - 2 * TYRE_RADIUS - 0.01, at, at, 1)[0]
        parts.append(line([start, end], CHROME * 0.9, 0.0010, piece=0.05, opacity=0.50))
    return join(parts)


def _mudguard(hub, start, stop):
    """Return a curved strip round the wheel, with two stays."""
    radius, count = WHEEL_RADIUS + 0.018, 46
    a = np.linspace(start, stop, count)
    across = np.linspace(-1, 1, 5)
    outward = np.stack([np.cos(a), np.zeros(count), np.sin(a)], 1)
    points = hub + outward[:, None] * (radius - 0.010 * across[None, :, None] ** 2)
    points[..., 1] += across * 0.027
    normal = unit(outward[:, None] + np.array([0, 0.55, 0]) * across[None, :, None])
    along = np.stack([-np.sin(a), np.zeros(count), np.cos(a)], 1)
    piece = radius * (stop - start) / count
    parts = [
        discs(
            points.reshape(-1, 3),
            normal.reshape(-1, 3),
            PAINT,
            np.tile([piece * 0.68, 0.0085], (count * 5, 1)),
            along=np.repeat(along, 5, axis=0),
            sheen=0.4,
        )
    ]
    for side in (-0.032, 0.032):
        end = hub + radius * outward[int(count * 0.72)] + np.array([0, side, 0])
        parts.append(line([hub + np.array([0, 1.6 * side, 0]), end], STEEL, 0.0018, opacity=0.8))
    return join(parts)


def _frame():
    """Return the diamond frame, seat post, saddle, rack and drive train."""
    paint = {"colour": PAINT, "piece": 0.026, "sheen": 0.45}
    parts = [
        tube([CRANK, SEAT_CLUSTER], 0.0150, around=9, **paint),
        tube(
            [_from(SEAT_CLUSTER, 0, 0, -0.025), _from(HEAD_HIGH, 0.004, 0, -0.030)],
            0.0140,
            around=9,
            **paint,
        ),
        tube([CRANK, _from(HEAD_LOW, -0.006, 0, 0.028)], 0.0165, around=9, **paint),
        tube([HEAD_LOW, HEAD_HIGH], 0.0185, around=9, **paint),
        tube(CRANK + np.array([[0, -0.036, 0], [0, 0.036, 0]]), 0.021, around=9, **paint),
    ]
    for side in (-1, 1):
        tail = _from(REAR_HUB, 0, 0.062 * side, 0)
        near = _from(CRANK, -0.03, 0.026 * side, 0)
        parts.append(tube([near, (0.2, 0.045 * side, 0.30), tail], 0.0092, around=7, **paint))
        top = _from(SEAT_CLUSTER, -0.012, 0.018 * side, -0.035)
        parts.append(tube([top, (0.15, 0.042 * side, 0.565), tail], 0.0078, around=7, **paint))
    return join([*parts, _seat(), _rack(), _drive()])


def _seat():
    """Return the seat post and a sprung leather saddle."""
    top = SEAT_CLUSTER + 0.15 * unit(SEAT_CLUSTER - CRANK)
    post = tube([SEAT_CLUSTER, top], 0.0128, CHROME, piece=0.025, around=8, sheen=0.3)
    t = np.linspace(0, 1, 15)  # from the nose to the rear
    spine = top + np.stack([0.145 - 0.27 * t, 0 * t, 0.045 + 0.020 * (t - 0.45) ** 2 * 4], 1)
    half = np.interp(t, [0, 0.08, 0.45, 0.8, 0.95, 1], [0.012, 0.022, 0.032, 0.078, 0.080, 0.055])
    a = np.linspace(-np.pi * 0.62, np.pi * 0.62, 13)
    outward = np.stack([0 * a, np.sin(a), np.cos(a)], 1)
    drop = np.array([1, 1, 0.42])
    points = spine[:, None] + outward[None] * half[:, None, None] * drop
    points[..., 2] += 0.02 - 0.42 * half[:, None]
    normal = np.broadcast_to(outward * [1, 0.42, 1], points.shape)
    size = np.stack(
        np.broadcast_arrays(np.full((15, 1), 0.0130), half[:, None] * 0.21 * np.ones(13)), -1
    )
    shell = discs(
        points.reshape(-1, 3), normal.reshape(-1, 3), LEATHER, size.reshape(-1, 2), sheen=0.25
    )
    rails = [
        line([_from(top, 0.12, 0.02 * s, 0.045), _from(top, 0.02, 0.022 * s, 0.005),
              _from(top, -0.09, 0.04 * s, 0.02)], STEEL, 0.0035)
        for s in (-1, 1)
    ]  # fmt: skip
    return join([post, shell, *rails])


def _rack():
    """Return the rear rack with its stays, and the rear light."""
    parts = []
    for y in (-0.055, 0.0, 0.055):
        parts.append(
            tube([(0.20, y, 0.745), (-0.24, y, 0.735)], 0.0048, STEEL, piece=0.03, around=6)
        )
    for x in (0.15, -0.02, -0.22):
        parts.append(
            tube([(x, -0.055, 0.742), (x, 0.055, 0.742)], 0.0045, STEEL, piece=0.03, around=6)
        )
    for y in (-0.062, 0.062):
        parts.append(tube([(0.0, y, WHEEL_RADIUS), (-0.13, y, 0.735)], 0.0042, STEEL, around=6))
        parts.append(tube([(0.20, y, 0.745), (0.262, y * 0.4, 0.70)], 0.0042, STEEL, around=6))
    parts.append(box((-0.262, 0, 0.70), (0.012, 0.028, 0.022), (0.55, 0.03, 0.03), spacing=0.012))
    return join(parts)


def _drive():
    """Return chain wheel, chain guard, cranks and pedals."""
    right = np.array([0, -0.052, 0])
    ring = _arc(CRANK + right, 0.086, 0, 2 * np.pi, 40, y=-0.052)
    parts = [tube(ring, 0.006, STEEL, piece=0.016, around=6, sheen=0.3)]
    for k in range(5):
        a = 2 * np.pi * k / 5 + 0.3
        end = CRANK + right + 0.082 * np.array([np.cos(a), 0, np.sin(a)])
        parts.append(tube([CRANK + right, end], 0.007, STEEL, piece=0.02, around=6))
    for shift in (0.088, -0.060):  # the chain's two runs
        start = CRANK + _from(right, 0, 0, shift)
        end = REAR_HUB + _from(right, 0, 0, 0.42 * shift)
        parts.append(line([start, end], (0.20, 0.19, 0.185), 0.0045, piece=0.03))
    guard = [
        _from(CRANK, 0.08, -0.058, 0.075),
        _from(CRANK, 0, -0.058, 0.105),
        _from(REAR_HUB, -0.03, -0.058, 0.062),
    ]
    parts.append(tube(guard, 0.013, CREAM, piece=0.03, around=8, sheen=0.3, squash=1.5))
    for side, sign in ((right[1] - 0.012, 1), (0.062, -1)):
        end = CRANK + np.array([0.150 * sign, side, -0.075 * sign])
        parts.append(tube([_from(CRANK, 0, side, 0), end], 0.0085, CHROME, piece=0.025, around=7))
        out = _from(end, 0, np.sign(side) * 0.055, 0)
        parts.append(box(out, (0.042, 0.040, 0.012), RUBBER, spacing=0.016))
    return join(parts)


def _fork():
    """Return the front end before steering: fork, stem, handlebar, lamp and basket."""
    axis = unit(HEAD_HIGH - HEAD_LOW)
    crown = HEAD_LOW - 0.028 * axis
    parts = [tube([crown, HEAD_LOW], 0.0195, CHROME, piece=0.02, around=9, sheen=0.3)]
    for side in (-1, 1):
        y = 0.047 * side
        t = np.linspace(0, 1, 10)[:, None]
        straight = _from(crown, 0, y, 0) + t * (FRONT_HUB - crown)
        blade = straight + [[-1, 0, -0.3]] * (0.05 * np.sin(np.pi * t) * t)
        parts.append(tube(blade, np.linspace(0.0125, 0.008, 10), PAINT, around=8, sheen=0.45))
    top = HEAD_HIGH + 0.085 * axis
    clamp = _from(top, 0.060, 0, 0.012)
    parts += [
        tube([HEAD_HIGH, top], 0.0125, CHROME, piece=0.022, around=8, sheen=0.3),
        tube([top, clamp], 0.0135, CHROME, piece=0.022, around=8, sheen=0.3),
        *_lamp(_from(clamp, 0.075, 0, -0.155)),
    ]
    for side in (-1, 1):
        bar = clamp + np.array(
            [(0, 0, 0), (0.012, 0.07, 0.012), (0.0, 0.15, 0.030), (-0.05, 0.225, 0.030),
             (-0.125, 0.262, 0.012), (-0.165, 0.275, 0.0)]
        ) * [1, side, 1]  # fmt: skip
        parts.append(tube(bar, 0.0112, CHROME, piece=0.02, around=8, sheen=0.3))
        parts.append(tube(bar[[-2, -1]] + [[0.02, 0, 0], [-0.05, 0.012 * side, -0.008]],
                          0.0165, LEATHER, piece=0.02, around=8))  # fmt: skip
        lever = [_from(bar[3], 0.03, 0, -0.015), _from(bar[4], 0.035, 0.012 * side, -0.035)]
        parts.append(line(lever, CHROME, 0.004))
        cable = [
            _from(bar[3], 0.03, 0, -0.015),
            _from(clamp, 0.10, 0.08 * side, -0.02),
            _from(HEAD_HIGH, 0.05, 0, -0.05),
        ]
        parts.append(line(cable, RUBBER, 0.0022))
    return join([*parts, _basket(_from(clamp, 0.19, 0, -0.030))])


def _lamp(back):
    """Return the front lamp, closed at both ends, glass in front."""
    glass = _from(back, 0.055, 0, 0)
    rounds = np.array(
        [(0, 0, 0), *(0.018 * np.stack([0 * CIRCLE, np.cos(CIRCLE), np.sin(CIRCLE)], 1))]
    )
    return [
        tube([back, glass], (0.028, 0.034), CHROME, piece=0.014, around=10),
        discs(back + rounds, (-1, 0, 0), CHROME, 0.010),
        discs(glass + rounds, (1, 0, 0), (0.80, 0.80, 0.74), 0.012),
    ]


def _basket(centre):
    """Return a woven basket, wider at its rim, held before the handlebar."""
    parts = []
    levels = np.linspace(0, 1, 15)
    for k, level in enumerate(levels):
        half = np.array([0.105, 0.150]) * (0.82 + 0.18 * level)
        a = np.linspace(0, 2 * np.pi, 49)
        ring = np.stack([np.cos(a), np.sin(a)], 1)
        ring = np.sign(ring) * np.abs(ring) ** 0.55 * half  # a rounded rectangle
        weave = (
            0.004
            * np.cos(np.arange(49) * np.pi + np.pi * (k % 2))[:, None]
            * unit(np.concatenate([ring, 0 * ring[:, :1]], 1))
        )
        points = centre + np.concatenate([ring, np.full((49, 1), 0.20 * (level - 0.5))], 1) + weave
        rim = k in (0, len(levels) - 1)
        parts.append(
            tube(points, 0.011 if rim else 0.0075, WICKER[k % 2], piece=0.03, around=5, sheen=0.1)
        )
    floor = box(_from(centre, 0, 0, -0.10), (0.082, 0.118, 0.004), WICKER[1], spacing=0.02)
    return join([*parts, floor])


def occluders():
    """Return basket, rack and saddle roughly as boxes for `sky_share`, (m, 7)."""
    x, y = PLACE
    tilt = np.tan(LEAN)
    rough = [  # along the bicycle, height, half sizes, share of the light taken
        (1.16, 0.95, 0.12, 0.15, 0.11, 0.85), (-0.02, 0.74, 0.23, 0.06, 0.01, 0.5),
        (0.22, 0.96, 0.13, 0.07, 0.02, 0.85), (0.60, 0.55, 0.30, 0.015, 0.22, 0.25),
        (0.0, 0.35, 0.30, 0.02, 0.33, 0.35), (1.07, 0.35, 0.30, 0.02, 0.33, 0.35),
    ]  # fmt: skip
    return np.array(
        [
            (x - a - da, y + tilt * z - dy, z - dz, x - a + da, y + tilt * z + dy, z + dz, taken)
            for a, z, da, dy, dz, taken in rough
        ]
    )


def contacts():
    """Where the two tyres stand, ndarray of shape (2, 2) [m]."""
    return PLACE + np.array([[0.0, 0.0], [-FRONT_HUB[0], 0.0]])


def bike_cloud(noise, ground):
    """Return the bicycle standing on `ground(x, y)` [m], lit by an overcast sky."""
    front = join([_wheel(FRONT_HUB), _mudguard(FRONT_HUB, 0.35, 2.75), _fork()])
    steer = turn_about(HEAD_HIGH - HEAD_LOW, STEERING)
    front = moved(front, steer, HEAD_LOW - steer @ HEAD_LOW)
    rear = join([_wheel(REAR_HUB), _mudguard(REAR_HUB, 0.25, 3.45), _frame()])
    upright = join([front, rear])
    half_turn = turn_about((0, 0, 1), np.pi)
    set_down = turn_about((1, 0, 0), -LEAN) @ half_turn
    cloud = moved(upright, set_down, (*PLACE, 0))
    cloud = moved(cloud, np.eye(3), (0, 0, float(np.mean(ground(*contacts().T)))))
    facing = 0.5 + 0.5 * cloud.normal[:, 2]
    low = np.clip(cloud.position[:, 2] / 0.25, 0, 1)  # less sky near the ground
    grime = 1 + 0.10 * noise(cloud.position, 0.12, octaves=2)
    cloud = lit(cloud, (0.20 + 0.90 * facing) * (0.72 + 0.28 * low) * grime)
    return polished(cloud, 0.42)
