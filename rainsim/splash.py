"""Splashes: the secondary droplets that impacts throw up, as a function of the impacts alone.

Whether a drop splashes follows published thresholds; its crown's size (see `crowns`) and how
many droplets it throws, how big and how fast they are is set by eye, not validated against
measurement. Splashes are drawn (see `splashview`) and forgotten: their water (a few percent of the
drop's) stays booked where the drop fell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rainsim.errors import ParameterError, require_finite, require_not_negative
from rainsim.jit import device_function, serial_kernel
from rainsim.marks import FAINTEST
from rainsim.random import subkey, uniform_triple

LONGEST_LIFE = 0.12  # s; impacts older than this have no droplets in the air any more
SMALLEST_SPLASH = 0.65e-3  # m; smaller drops at terminal speed splash on nothing
_SHORTEST_LIFE = 0.05  # s
_FEWEST, _MOST = 4, 12  # droplets per splash
_GRAVITY = 9.81  # m/s2
_DENSITY = 998.0  # kg/m3, water at 20 C
_TENSION = 0.0728  # N/m, water against air at 20 C
_VISCOSITY = 1.0e-6  # m2/s, water at 20 C
SMALLEST_ON_FILM = 1.24e-3  # m; smaller drops at terminal speed do not splash on a film
WET_FILM = 2e-4  # m of water on everything that rain has wetted; a guess
_WET = 1e-4  # m; less water than this on the ground counts as a dry rough surface
_WEBER_WET = 400.0  # splash threshold on a film, sqrt(We) = 20
_MUNDO_DRY = 57.7  # splash threshold on a rough dry wall, sqrt(We) Re^(1/4)
_WEBER_STEP = 150.0  # Weber number per further droplet
_SMALLEST_SHARE, _LARGEST_SHARE = 0.06, 0.20  # droplet diameter over drop diameter
_DEPTH_OF_PEAK = 1 / 3  # film depth over diameter at which splashes are largest
_DEPTH_OF_POOL = 3.0  # and from which on they no longer change
_SIZE_DRY, _SIZE_POOL = 0.6, 0.75  # relative to the largest splash
_LEAST_SPREAD, _MOST_SPREAD = 0.5, 1.1  # horizontal over vertical speed: 63 to 42 degrees up
_CARRIED = 0.15  # share of the drop's horizontal velocity that droplets keep
_FULL_TURN = 2 * np.pi
_DROPLET_SPEED = 0.6  # m/s, of a droplet, typically
_BIG = 2.4e-3  # m; only bigger drops have crowns that stand longer than theirs
_FARTHEST = 100.0  # m
_MARGIN = 0.03  # m by which splashes reach into the picture from outside


@dataclass(frozen=True)
class Droplets:
    """Splash droplets in the air at one time.

    Attributes
    ----------
    position : ndarray of shape (n, 3), float64 [m]
    velocity : ndarray of shape (n, 3), float64 [m/s]
    diameter : ndarray of shape (n,), float64 [m]
    id : ndarray of shape (n,), uint64
        The same droplet has the same id in every frame.
    """

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray
    id: np.ndarray

    def __len__(self):
        return len(self.id)


def splashes(impacts, water_depth):
    """Tell which impacts splash.

    Parameters
    ----------
    impacts : Impacts
    water_depth : ndarray of shape (n,) or float [m]
        Water where each drop fell.

    Returns
    -------
    ndarray of shape (n,), bool

    References
    ----------
    On a film sqrt(We) > 20 (Vander Wal, Berger and Mozes 2006, Exp. Fluids 40, 53); on a dry rough
    surface K = sqrt(We) Re^(1/4) > 57.7 (Mundo, Sommerfeld and Tropea 1995, Int. J. Multiphase
    Flow 21, 151). Both with the vertical speed, also on sloping ground and on the sides of objects.
    """
    depth = _depths(impacts, water_depth)
    return splashes_on(depth, impacts.diameter, np.abs(impacts.velocity[:, 2]))


@device_function
def splashes_on(depth, diameter, speed):
    """Tell whether a drop splashes on water of some depth; numbers or arrays, see `splashes`."""
    weber = _DENSITY * speed**2 * diameter / _TENSION
    mundo = np.sqrt(weber) * (speed * diameter / _VISCOSITY) ** 0.25
    on_film = (depth > _WET) & (weber > _WEBER_WET)
    return on_film | (depth <= _WET) & (mundo > _MUNDO_DRY)


@device_function
def droplets_of(diameter, speed):
    """Return how many droplets a splash throws, a float that is to be cut; numbers or arrays."""
    weber = _DENSITY * speed**2 * diameter / _TENSION
    wanted = _FEWEST + (weber - _WEBER_WET) / _WEBER_STEP
    return np.minimum(np.maximum(wanted, float(_FEWEST)), float(_MOST))


def splash_droplets(impacts, water_depth, now, exposure=0.0):
    """List the droplets that are in the air at `now`, or during an exposure from then on.

    Parameters
    ----------
    impacts : Impacts
        Those of the last LONGEST_LIFE seconds, at least the drops from SMALLEST_SPLASH up; older
        and later ones have no effect.
    water_depth : ndarray of shape (n,) or float [m]
        Water where each drop fell, when it fell.
    now : float [s]
    exposure : float [s]
        With an exposure a droplet is given as it is drawn: where it is first seen, its way during
        the exposure over the exposure, and with the diameter of the disc that covers as much for
        all of the exposure as the droplet does while it lives.

    Returns
    -------
    Droplets

    Notes
    -----
    A droplet leaves at the impact's place and time and lives as long as its flight back to that
    height lasts. Size against film depth follows Mutchler and Hansen 1970, Science 169, 1311:
    largest at a film of a third of the diameter, constant from three diameters on; the two levels
    relative to the peak are guesses.
    """
    now = require_finite("now", now)
    exposure = require_not_negative("exposure", exposure, "s")
    depth = _depths(impacts, water_depth)
    age = now - impacts.time
    recent = (age >= -exposure) & (age < LONGEST_LIFE)
    active = np.flatnonzero(recent & splashes(impacts, depth))
    speed = np.abs(impacts.velocity[active, 2])
    count = droplets_of(impacts.diameter[active], speed).astype(np.int64)
    most = int(count.sum())
    state, ids = np.empty((most, 7)), np.empty(most, np.uint64)
    alive = _throw(
        impacts.position[active], impacts.velocity[active],
        impacts.diameter[active] * relative_size(depth[active] / impacts.diameter[active]),
        age[active], exposure, count, impacts.id[active], state, ids,
    )  # fmt: skip
    return Droplets(
        np.ascontiguousarray(state[:alive, :3]),
        np.ascontiguousarray(state[:alive, 3:6]),
        np.ascontiguousarray(state[:alive, 6]),
        ids[:alive].copy(),
    )


@device_function
def least_seen(pixel, exposure):
    """Return the diameter [m] of a droplet in flight that replaces FAINTEST of a pixel's light."""
    way = np.maximum(_DROPLET_SPEED * exposure / pixel, 1.0)  # px
    return pixel * np.sqrt(4 / math.pi * FAINTEST * way)


def footprint(camera, reach):
    """Return the low and high corner (x, y) of what the camera sees up to a depth [m]."""
    corners = np.array([[u, v] for u in (0.0, camera.width) for v in (0.0, camera.height)])
    rays = np.ones((4, 3))
    rays[:, :2] = (corners - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    points = reach * rays @ camera.camera_from_world[:3, :3] + camera.position
    points = np.concatenate([points, camera.position[None]])[:, :2]
    return np.stack([points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN])


@device_function
def relative_size(film):
    """Size of a splash relative to the largest; `film` is depth over drop diameter."""
    rise = np.minimum(film / _DEPTH_OF_PEAK, 1.0)
    fall = (film - _DEPTH_OF_PEAK) / (_DEPTH_OF_POOL - _DEPTH_OF_PEAK)
    fall = np.minimum(np.maximum(fall, 0.0), 1.0)
    return _SIZE_DRY + (1 - _SIZE_DRY) * rise - (1 - _SIZE_POOL) * fall


def _depths(impacts, water_depth):
    depth = np.asarray(water_depth, dtype=np.float64)
    if depth.shape not in ((), (len(impacts),)):
        raise ParameterError(
            f"water_depth has shape {depth.shape}; it must be one number or ({len(impacts)},)"
        )
    return np.broadcast_to(depth, (len(impacts),))


@serial_kernel
def _throw(position, velocity, crown, age, exposure, count, ids, state_out, ids_out):
    """Fill in the droplets that are still in the air; return their number.

    `crown` is the drop's diameter times the splash's relative size. A state is x, y, z, the
    velocity and the diameter.
    """
    alive = 0
    for splash in range(len(age)):
        for n in range(count[splash]):
            seen, x, y, z, vx, vy, vz, diameter, word = droplet(
                ids[splash], n, count[splash], position[splash, 0], position[splash, 1],
                position[splash, 2], velocity[splash, 0], velocity[splash, 1], crown[splash],
                age[splash], exposure,
            )  # fmt: skip
            if not seen:
                continue
            state_out[alive, 0], state_out[alive, 1], state_out[alive, 2] = x, y, z
            state_out[alive, 3], state_out[alive, 4], state_out[alive, 5] = vx, vy, vz
            state_out[alive, 6] = diameter
            ids_out[alive] = word
            alive += 1
    return alive


@device_function
def droplet(key, n, count, x, y, z, drop_vx, drop_vy, crown, age, exposure):
    """Return droplet n of a splash: whether it is seen, place, velocity, diameter and id."""
    word = subkey(key, -1 - n)
    life, speed, size = uniform_triple(word)
    jitter, _, _ = uniform_triple(subkey(word, 0))
    life = _SHORTEST_LIFE + (LONGEST_LIFE - _SHORTEST_LIFE) * life * life
    begin, end = max(age, 0.0), min(age + exposure, life)
    up = 0.5 * _GRAVITY * life  # comes down again when its life ends
    out = up * (_LEAST_SPREAD + (_MOST_SPREAD - _LEAST_SPREAD) * speed)
    angle = _FULL_TURN * (n + jitter) / count
    vx = out * np.cos(angle) + _CARRIED * drop_vx
    vy = out * np.sin(angle) + _CARRIED * drop_vy
    seen, middle = 1.0, begin
    if exposure > 0.0:
        seen, middle = max(end - begin, 0.0) / exposure, 0.5 * (begin + end)
    share = _SMALLEST_SHARE + (_LARGEST_SHARE - _SMALLEST_SHARE) * size * size
    return (
        age < life and end >= begin, x + vx * begin, y + vy * begin,
        z + (up - 0.5 * _GRAVITY * begin) * begin, seen * vx, seen * vy,
        seen * (up - _GRAVITY * middle), share * crown * np.sqrt(seen), word,
    )  # fmt: skip
