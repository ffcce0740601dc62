"""Linear colour spaces: primaries, white, and the matrices from linear Rec. 709.

References
----------
ITU-R BT.709-6 (2015), table 1. Academy of Motion Picture Arts and Sciences, S-2014-004 (ACEScg: the
primaries AP1, white 0.32168, 0.33767). White is adapted by the Bradford transform (Lam 1985), as
OpenColorIO's configurations of ACES do.
"""

from typing import NamedTuple

import numpy as np

BRADFORD = np.array([
    [0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296],
])  # fmt: skip


class ColorSpace(NamedTuple):
    """A linear, scene-referred colour space."""

    name: str  # as it is known to OpenColorIO and OpenImageIO
    identifier: str  # that of the Color Interop Forum
    chromaticities: tuple  # x and y of red, green, blue and white (CIE 1931)


SPACES = {
    "rec709": ColorSpace(
        "lin_rec709", "lin_rec709_scene", (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    ),
    "acescg": ColorSpace(
        "ACEScg", "lin_ap1_scene",
        (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    ),
}  # fmt: skip


def xyz_from(space):
    """Return the matrix (3, 3) from a `ColorSpace` to CIE XYZ, its white at Y = 1."""
    x, y = np.reshape(space.chromaticities, (4, 2)).T
    xyz = np.array([x / y, np.ones(4), (1 - x - y) / y])
    return xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3])


def from_rec709(space):
    """Return the matrix (3, 3) from linear Rec. 709 to a `ColorSpace`, white to white."""
    own, other = xyz_from(SPACES["rec709"]), xyz_from(space)
    white, new_white = BRADFORD @ own.sum(axis=1), BRADFORD @ other.sum(axis=1)
    adapted = np.linalg.solve(BRADFORD, (new_white / white)[:, None] * BRADFORD)
    return np.linalg.solve(other, adapted @ own)


REC709 = SPACES["rec709"].chromaticities


def to_rec709(chromaticities):
    """Return the matrix (3, 3) to linear Rec. 709 from a space of some chromaticities, as a tuple.

    That is x and y of red, green, blue and white, as `ColorSpace` and OpenEXR's headers have them.
    """
    return np.linalg.inv(from_rec709(ColorSpace("", "", chromaticities)))
