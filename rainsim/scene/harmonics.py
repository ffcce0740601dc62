"""Real spherical harmonics of splats as matrices: their values, and how they turn with an actor."""

from functools import lru_cache

import numpy as np

from rainsim.constants import SH_0, SH_1, SH_2, SH_3

BANDS = (slice(0, 1), slice(1, 4), slice(4, 9), slice(9, 16))  # coefficients of each degree
DIRECTIONS = 64  # at which a turned degree is compared with the basis; 7 would do


def basis(directions):
    """Return the 16 functions of degree 0 to 3 at unit directions.

    The order and the signs are those of the original 3DGS code (Kerbl et al. 2023).

    directions : array (n, 3)
    Returns float64 array (n, 16)
    """
    x, y, z = np.asarray(directions, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    a, b, c = SH_2
    d, e, f, g, h = SH_3
    return np.stack(
        [
            np.full_like(x, SH_0), -SH_1 * y, SH_1 * z, -SH_1 * x,
            a * x * y, -a * y * z, b * (2 * zz - xx - yy), -a * x * z, c * (xx - yy),
            -d * y * (3 * xx - yy), e * x * y * z, -f * y * (4 * zz - xx - yy),
            g * z * (2 * zz - 3 * xx - 3 * yy), -f * x * (4 * zz - xx - yy), h * z * (xx - yy),
            -d * x * (xx - 3 * yy),
        ],
        axis=1,
    )  # fmt: skip


def turned(sh, rotation):
    """Return harmonics after a rotation of the splats that they belong to.

    The colour seen along R d afterwards is that seen along d before. A rotation mixes the functions
    of one degree among themselves; the mixing matrix is found from the functions' values at a fixed
    set of directions, by least squares, which is exact to rounding.

    Returns float32 array (n, k, 3)
    """
    out = sh.copy()
    if sh.shape[1] == 1:
        return out
    found = mixings(rotation, round(sh.shape[1] ** 0.5))
    for band, mixing in zip(BANDS[1:], found[1:], strict=False):
        out[:, band] = np.einsum("ij,njc->nic", mixing, sh[:, band])
    return out


def mixings(rotation, degrees):
    """Return the matrices by which a rotation mixes the functions of so many degrees, float32.

    For reading: those of the last rotations are kept, for actors that are drawn more than once.
    """
    return _mixings(np.asarray(rotation, np.float64).tobytes(), degrees)


@lru_cache(64)
def _mixings(rotation, degrees):
    directions = _even_directions()
    after = basis(directions)
    before = basis(directions @ np.frombuffer(rotation).reshape(3, 3))
    found = [np.linalg.lstsq(after[:, band], before[:, band], rcond=None)[0]
             for band in BANDS[1:degrees]]  # fmt: skip
    return [np.eye(1, dtype=np.float32), *(each.astype(np.float32) for each in found)]


def padded(sh, coefficients):
    """Return harmonics of at least as many coefficients, those that were missing zero."""
    missing = coefficients - sh.shape[1]
    return sh if missing <= 0 else np.pad(sh, ((0, 0), (0, missing), (0, 0)))


def _even_directions():
    """Return unit directions spread evenly over the sphere, (DIRECTIONS, 3)."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1 - 2 * k / DIRECTIONS, k * np.pi * (3 - 5**0.5)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
