"""Splashes: the secondary droplets that impacts throw up, as a function of the impacts alone.

First depth: whether a drop splashes follows published thresholds; how many droplets it throws, how
big and how fast they are is a plausible crown, not validated against measurement. The droplets are
drawn and forgotten: their water (a few percent of the drop's) stays booked where the drop fell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rainsim.errors import ParameterError, require_finite
from rainsim.jit import serial_kernel
from rainsim.random import subkey, uniform_triple
from rainsim.streaks import draw_droplets

__all__ = [
    "LONGEST_LIFE",
    "SMALLEST_SPLASH",
    "Droplets",
    "draw_droplets",
    "splash_droplets",
    "splashes",
]

LONGEST_LIFE = 0.12  # s; impacts older than this have no droplets in the air any more
SMALLEST_SPLASH = 0.65e-3  # m; smaller drops at terminal speed splash on nothing
_SHORTEST_LIFE = 0.05  # s
_FEWEST, _MOST = 4, 12  # droplets per splash
_GRAVITY = 9.81  # m/s2
_DENSITY = 998.0  # kg/m3, water at 20 C
_TENSION = 0.0728  # N/m, water against air at 20 C
_VISCOSITY = 1.0e-6  # m2/s, water at 20 C
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
    speed = np.abs(impacts.velocity[:, 2])
    weber = _DENSITY * speed**2 * impacts.diameter / _TENSION
    reynolds = speed * impacts.diameter / _VISCOSITY
    return np.where(depth > _WET, weber > _WEBER_WET, np.sqrt(weber) * reynolds**0.25 > _MUNDO_DRY)


def splash_droplets(impacts, water_depth, now):
    """List the droplets that are in the air at `now`.

    Parameters
    ----------
    impacts : Impacts
        Those of the last LONGEST_LIFE seconds, at least the drops from SMALLEST_SPLASH up; older
        and later ones have no effect.
    water_depth : ndarray of shape (n,) or float [m]
        Water where each drop fell, when it fell.
    now : float [s]

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
    depth = _depths(impacts, water_depth)
    age = now - impacts.time
    active = np.flatnonzero(splashes(impacts, depth) & (age >= 0) & (age < LONGEST_LIFE))
    speed = np.abs(impacts.velocity[active, 2])
    weber = _DENSITY * speed**2 * impacts.diameter[active] / _TENSION
    count = np.clip(_FEWEST + (weber - _WEBER_WET) / _WEBER_STEP, _FEWEST, _MOST).astype(np.int64)
    most = int(count.sum())
    state, ids = np.empty((most, 7)), np.empty(most, np.uint64)
    alive = _throw(
        impacts.position[active], impacts.velocity[active],
        impacts.diameter[active] * _relative_size(depth[active] / impacts.diameter[active]),
        age[active], count, impacts.id[active], state, ids,
    )  # fmt: skip
    return Droplets(
        np.ascontiguousarray(state[:alive, :3]),
        np.ascontiguousarray(state[:alive, 3:6]),
        np.ascontiguousarray(state[:alive, 6]),
        ids[:alive].copy(),
    )


def _relative_size(film):
    """Size of a splash relative to the largest; `film` is depth over drop diameter."""
    return np.interp(film, [0.0, _DEPTH_OF_PEAK, _DEPTH_OF_POOL], [_SIZE_DRY, 1.0, _SIZE_POOL])


def _depths(impacts, water_depth):
    depth = np.asarray(water_depth, dtype=np.float64)
    if depth.shape not in ((), (len(impacts),)):
        raise ParameterError(
            f"water_depth has shape {depth.shape}; it must be one number or ({len(impacts)},)"
        )
    return np.broadcast_to(depth, (len(impacts),))


@serial_kernel
def _throw(position, velocity, crown, age, count, ids, state_out, ids_out):
    """Fill in the droplets that are still in the air; return their number.

    `crown` is the drop's diameter times the splash's relative size. A state is x, y, z, the
    velocity and the diameter.
    """
    alive = 0
    for splash in range(len(age)):
        for n in range(count[splash]):
            word = subkey(ids[splash], -1 - n)
            life, speed, size = uniform_triple(word)
            jitter, _, _ = uniform_triple(subkey(word, 0))
            life = _SHORTEST_LIFE + (LONGEST_LIFE - _SHORTEST_LIFE) * life * life
            if age[splash] >= life:
                continue
            up = 0.5 * _GRAVITY * life  # comes down again when its life ends
            out = up * (_LEAST_SPREAD + (_MOST_SPREAD - _LEAST_SPREAD) * speed)
            angle = _FULL_TURN * (n + jitter) / count[splash]
            vx = out * np.cos(angle) + _CARRIED * velocity[splash, 0]
            vy = out * np.sin(angle) + _CARRIED * velocity[splash, 1]
            time = age[splash]
            state_out[alive, 0] = position[splash, 0] + vx * time
            state_out[alive, 1] = position[splash, 1] + vy * time
            state_out[alive, 2] = position[splash, 2] + (up - 0.5 * _GRAVITY * time) * time
            state_out[alive, 3], state_out[alive, 4] = vx, vy
            state_out[alive, 5] = up - _GRAVITY * time
            share = _SMALLEST_SHARE + (_LARGEST_SHARE - _SMALLEST_SHARE) * size * size
            state_out[alive, 6] = share * crown[splash]
            ids_out[alive] = word
            alive += 1
    return alive
