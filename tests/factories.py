"""Bundles of numbers that kernels take, and splats, by name: a new field has its value here."""

import numpy as np

from rainsim.constants import SH_0
from rainsim.scene.types import Splats
from rainsim.shading.grading import Look
from rainsim.shading.wetness import OffGroundWetness, Wetness


def splats(position, rotation=(1, 0, 0, 0), scale=0.1, opacity=0.95, sh=None, color=0.5):
    """Splats in float32 at places (n, 3); each value is one for all or one per splat.

    `color` is that of degree 0 where no harmonics are given.
    """
    n = len(position)
    if sh is None:
        sh = (np.broadcast_to(np.asarray(color, float), (n, 3))[:, None] - 0.5) / SH_0

    def of_shape(value, *shape):
        return np.array(np.broadcast_to(value, (n, *shape)), np.float32, order="C")

    return Splats(
        np.array(position, np.float32, order="C"), of_shape(rotation, 4), of_shape(scale, 3),
        of_shape(opacity), np.array(sh, np.float32, order="C"),
    )  # fmt: skip


def of_floats(bundle, usual, changes):
    """A bundle whose fields are float32: `changes` by name, the others as `usual` has them."""
    numbers = {name: np.float32(value) for name, value in {**usual, **changes}.items()}
    return bundle(**numbers)


def look(**changes):
    """A `Look` that leaves light as it was captured, with `changes`."""
    usual = {"exposure": 1, "compression": 0, "sky_replaced": 0, "open_sky": 0,
             "albedo": 1, "tops_end": 0}  # fmt: skip
    return of_floats(Look, usual, changes)


def wetness(**changes):
    """A `Wetness` of hard ground that is wet through and glosses, with `changes`."""
    return of_floats(Wetness, {"lawn": 0, "dampness": 1, "film": 1, "porosity": 0}, changes)


def off_ground(**changes):
    """An `OffGroundWetness` of a film of rain that falls straight down, with `changes`."""
    usual = {"supply": 1, "slant_x": 0, "slant_y": 0, "film_left": 1, "porosity": 0.1}
    return of_floats(OffGroundWetness, usual, changes)
