"""Description of a made-up garden for the bench of days: shapes, cameras, sun, rain."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rainsim.scene.cameras import look_at

WIDTH, HEIGHT, FOCAL = 648, 420, 520.0  # px
TINT = np.array([0.95, 1.0, 1.06])  # of the overcast sky; pictures are white-balanced for it
COATS = {  # root mean square slope of the water on a part, along one axis
    "paving": 0.2, "bed": 0.2, "tabletop": 0.1, "table": 0.25, "box": 0.25, "wall": 0.25,
    "lawn": 0.5, "leaf": 0.15,
}  # fmt: skip
SKIN = frozenset({"lawn", "leaf"})  # parts that water covers but does not soak


@dataclass(frozen=True)
class Sun:
    """The sun of a captured day."""

    azimuth: tuple  # horizontal direction to the sun, (x, y) of any length
    elevation: float  # degrees
    turbidity: float  # of Hosek and Wilkie's sky

    @property
    def direction(self):
        """Unit vector to the sun."""
        level = np.array([*self.azimuth, 0.0])
        angle = np.radians(self.elevation)
        return level / np.linalg.norm(level) * np.cos(angle) + [0, 0, np.sin(angle)]


@dataclass(frozen=True)
class Rain:
    """A rainy day of a garden."""

    name: str
    coated: tuple  # parts with a coat of water, see `COATS`; lawn and leaves darken in any rain
    past: float  # m, what has fallen
    wind: tuple = (0.0, 0.0)  # speed [m/s] and the way it goes [rad]
    views: tuple = (0, 1, 2)  # numbers of the cameras whose pictures were traced
    slopes: float = 1.0  # factor of the slopes in `COATS`
    skin: float = 0.85  # albedo of lawn and leaves wet over dry; chosen, not measured
    gloss: bool = False  # whether pictures without what the water mirrors were traced too


@dataclass(frozen=True)
class Case:
    """A garden with its days.

    The first of the rains is compared in full. Of the others those with its rain and wind say how
    far the result moves with what the truth chose.
    """

    name: str
    build: object  # returns `Shapes` and `Paving`
    cameras: object  # returns the capture's cameras in the ground frame; the first are compared
    sun: Sun
    rains: tuple = field(default=())


def aimed(pairs):
    """Return level cameras of the bench's size for pairs of eye and target [m]."""
    fov = np.degrees(2 * np.arctan(WIDTH / 2 / FOCAL))
    return tuple(
        look_at(eye, target, (0, 0, 1), fov, WIDTH, HEIGHT, f"c{k:02d}")
        for k, (eye, target) in enumerate(pairs)
    )
