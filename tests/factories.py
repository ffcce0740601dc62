"""Bundles of numbers that kernels take, made by name: a new field needs its value here alone."""

import numpy as np

from rainsim.shading.grading import Look
from rainsim.shading.wetness import OffGroundWetness, Wetness


def of_floats(bundle, usual, changes):
    """A bundle whose fields are float32: `changes` by name, the others as `usual` has them."""
    numbers = {name: np.float32(value) for name, value in {**usual, **changes}.items()}
    return bundle(**numbers)


def look(**changes):
    """A `Look` that leaves light as it was captured, with `changes`."""
    usual = {"exposure": 1, "compression": 0, "sky_replaced": 0, "sky_distance": 30,
             "open_sky": 0, "albedo": 1, "tops_end": 0}  # fmt: skip
    return of_floats(Look, usual, changes)


def wetness(**changes):
    """A `Wetness` of hard ground that is wet through and glosses, with `changes`."""
    return of_floats(Wetness, {"lawn": 0, "dampness": 1, "film": 1, "porosity": 0}, changes)


def off_ground(**changes):
    """An `OffGroundWetness` of a film of rain that falls straight down, with `changes`."""
    usual = {"supply": 1, "slant_x": 0, "slant_y": 0, "film_left": 1, "porosity": 0.1}
    return of_floats(OffGroundWetness, usual, changes)
