"""The park bench: wooden slats on two cast-iron ends."""

import numpy as np

from rainsim.demo_scenes import build

CENTRE = np.array([0.35, 0.20, 0.0])  # m, middle of the bench on the ground; it faces -y
LENGTH = 1.70  # m
SEAT_HEIGHT = 0.44  # m
TEAK = np.array([(0.560, 0.385, 0.235), (0.515, 0.350, 0.215), (0.600, 0.425, 0.270)])
IRON = np.array([0.085, 0.105, 0.095])
ENDS, FEET = (-0.73, 0.73), (-0.26, 0.275)  # m, x of the iron ends and y of their feet
BACK_LEAN = 0.24  # rad, of the backrest behind the upright

# Boxes that hide the sky from the paving and from the bench itself, relative to CENTRE:
# low corner, high corner [m], share of the light taken
OCCLUDERS = np.array(
    [
        (-0.85, -0.27, 0.415, 0.85, 0.20, 0.455, 0.86),  # seat
        (-0.85, 0.19, 0.52, 0.85, 0.26, 0.70, 0.80),  # lower backrest
        (-0.85, 0.25, 0.70, 0.85, 0.34, 0.90, 0.80),  # upper backrest
        (-0.76, -0.27, 0.0, -0.70, 0.25, 0.42, 0.45),  # ends
        (0.70, -0.27, 0.0, 0.76, 0.25, 0.42, 0.45),
    ]
)


def occluders():
    """Return the bench as boxes for `sky_share`, ndarray of shape (m, 7)."""
    boxes = OCCLUDERS.copy()
    boxes[:, :3] += CENTRE
    boxes[:, 3:6] += CENTRE
    return boxes


def feet():
    """Where the bench stands, ndarray of shape (4, 2) [m]."""
    return CENTRE[:2] + np.array([(x, y) for x in ENDS for y in FEET])


def _slat(centre, half, tone, noise, axes=None):
    """Return one slat along x with grain along its length."""
    cloud = build.box(
        centre, half, tone, spacing=0.0155, along=0, stretch=3.0, axes=axes, sheen=0.12
    )
    shift = np.array([0.0, 3.1, 5.7]) * (centre[1] + 2 * centre[2])  # another plank, another grain
    grain = noise(cloud.position + shift, (0.55, 0.022, 0.022), octaves=3)
    patch = noise(cloud.position + 2 * shift, 0.4, octaves=2)
    return build.replace_colour(cloud, cloud.colour * (1 + 0.11 * grain + 0.07 * patch)[:, None])


def _slats(noise, rng):
    """Return the seat's and the backrest's slats."""
    parts = []
    for k, y in enumerate(np.linspace(-0.235, 0.165, 6)):
        drop = 0.016 * np.sin(np.pi * (k + 0.2) / 5.4)  # the seat is dished
        parts.append(
            _slat((0, y, SEAT_HEIGHT - drop), (LENGTH / 2, 0.032, 0.015), _tone(rng), noise)
        )
    lean = build.turn_about((1, 0, 0), -BACK_LEAN).T
    for k in range(4):
        rise = 0.13 + 0.094 * k
        centre = np.array([0, 0.205, SEAT_HEIGHT]) + rise * lean[2]
        parts.append(_slat(centre, (LENGTH / 2, 0.014, 0.037), _tone(rng), noise, axes=lean))
    return parts


def _tone(rng):
    return TEAK[rng.integers(0, len(TEAK))] * rng.uniform(0.92, 1.06)


def _end(x):
    """Return one cast-iron end: legs with feet, seat rail, back post and scrolled armrest."""

    def at(points):
        return [(x, y, z) for y, z in points]

    t = np.linspace(0, 1, 12)
    front = np.stack([-0.225 - 0.05 * np.sin(np.pi * t) * (1 - t) - 0.03 * (1 - t), 0.42 * t], 1)
    rear = np.stack([0.19 + 0.09 * (1 - t) ** 2, 0.43 * t], 1)
    post = np.stack([0.19 + 0.50 * t * np.sin(BACK_LEAN), 0.43 + 0.49 * t], 1)
    arm = np.stack([-0.27 + 0.53 * t, 0.645 + 0.025 * np.sin(np.pi * t)], 1)
    turn = np.linspace(0, 1.6 * np.pi, 14)
    scroll = np.stack(
        [-0.27 - 0.035 * np.sin(turn), 0.61 + (0.035 - 0.004 * turn) * np.cos(turn)], 1
    )
    prop = np.stack([-0.225 + 0.02 * np.sin(np.pi * t), 0.43 + 0.2 * t], 1)
    brace = np.stack([-0.20 + 0.37 * t, 0.16 + 0.10 * np.sin(np.pi * t)], 1)
    rail = [(-0.26, 0.418), (0.0, 0.402), (0.22, 0.418)]
    shapes = [
        (front, 0.019), (rear, 0.019), (post, 0.018), (arm, 0.021), (scroll, 0.012),
        (prop, 0.014), (brace, 0.012), (rail, 0.016),
    ]  # fmt: skip
    parts = [build.tube(at(p), r, IRON, piece=0.03, around=7, sheen=0.35) for p, r in shapes]
    for y in FEET:
        parts.append(build.box((x, y, 0.010), (0.032, 0.05, 0.010), IRON, spacing=0.02, stretch=1))
    return parts


def bench_cloud(noise, rng):
    """Return the bench, lit by the part of the sky that it does not hide from itself."""
    parts = _slats(noise, rng)
    for x in ENDS:
        parts += _end(x)
    cloud = build.join(parts)
    cloud = build.replace_colour(cloud, cloud.colour, cloud.position + CENTRE)
    above = cloud.position + 0.02 * cloud.normal + (0, 0, 0.004)
    share = build.sky_share(above.astype(np.float32), occluders(), build.sky_directions(40))
    facing = 0.5 + 0.5 * cloud.normal[:, 2]
    return build.lit(cloud, (0.16 + 0.84 * share) * (0.30 + 0.70 * facing))
