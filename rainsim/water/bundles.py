"""Read-only bundles that the kernels of the water schemes take, one subject each.

Kernels read them and write to flat arrays that end in `_out`: numba drops writes through a
NamedTuple's arrays in parallel loops.
"""

from typing import NamedTuple

import numpy as np


class Water(NamedTuple):
    """Depth and velocity with ghost cells.

    h, remainder : array (ny + 4, nx + 4) [m]. Flowing depth, and the part of it
        that the type of `h` cannot hold or that is too thin to flow.
    u, v : array (ny + 4, nx + 5) and (ny + 5, nx + 4) [m/s]. Velocities of the
        west and the south faces.
    """

    h: np.ndarray
    remainder: np.ndarray
    u: np.ndarray
    v: np.ndarray


class Flux(NamedTuple):
    """Volume flux [m2/s] through the west faces (qu) and the south faces (qv), shaped as u, v."""

    qu: np.ndarray
    qv: np.ndarray


class Ground(NamedTuple):
    """The height on which water flows and its roughness, with the ghost cells of `Water`.

    bed : ndarray [m]
    roughness : ndarray [s2 m^(-2/3)]. Square of Manning's n.
    """

    bed: np.ndarray
    roughness: np.ndarray


class StepNumbers(NamedTuple):
    """The numbers of one step, all of the fields' type.

    k, kg : float [s/m], [1/s]. dt / spacing, and gravity times the time of the
        pressure / spacing.
    wave : float [1/m]. Square of the Courant number of a wave over its depth:
        gravity dt^2 / spacing^2.
    gravity : float [m/s2]
    cap : float [m/s]. Speed that no face may exceed.
    rounding : float. Relative rounding under which levels are equal.
    dry : float [m]. Depths below do not flow.
    """

    k: float
    kg: float
    wave: float
    gravity: float
    cap: float
    rounding: float
    dry: float


class FrictionNumbers(NamedTuple):
    """The numbers of friction over one step.

    drag : float [m/s]. gravity * dt.
    laminar : float [m2]. 3 * kinematic viscosity * dt: the drag of a laminar film
        over its depth squared.
    gravity : float [m/s2]
    dry : float [m]. Least depth that friction sees.
    """

    drag: float
    laminar: float
    gravity: float
    dry: float
