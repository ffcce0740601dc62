"""The record of a pixel of water: its names, and its row in the list of a picture's water.

The water that a picture shows is a list, one record of RECORD numbers (a cache line) for each
pixel that it covers. Formulas take a `WaterPixel`; the CPU's loops read it from a record, a CUDA
thread makes it of its own numbers.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import ZERO
from rainsim.jit import inlined_function

RECORD = 16
# Columns of a record, in the order of WaterPixel's attributes.
(
    X, Y, Z, VIEW_X, VIEW_Y, VIEW_Z, VIEW_DEPTH, WATER_DEPTH, COVERAGE, RIPPLE_SHARE, SLOPE_X,
    SLOPE_Y, VARIANCE_X, VARIANCE_Y, COVARIANCE, WIDTH,
) = range(RECORD)  # fmt: skip
POINT = slice(X, Z + 1)
SLOPES = slice(SLOPE_X, COVARIANCE + 1)


class WaterPixel(NamedTuple):
    """A pixel of water, float32, ground frame."""

    x: np.float32  # m, where the ray through the pixel's middle meets the surface
    y: np.float32  # m
    z: np.float32  # m
    view_x: np.float32  # unit view direction
    view_y: np.float32
    view_z: np.float32
    view_depth: np.float32  # m, depth of the surface point along the view axis
    water_depth: np.float32  # m
    coverage: np.float32  # share of the pixel that is water
    ripple_share: np.float32  # amplitude of ripples over that on deep water in the open
    slope_x: np.float32  # mean slopes of the surface in the pixel
    slope_y: np.float32
    variance_x: np.float32  # variances and covariance of the slopes in the pixel
    variance_y: np.float32
    covariance: np.float32
    width: np.float32  # m, of the pixel at the surface point, across the view


@inlined_function
def read_record(record, n):
    """Return row n of the list `record` (n, RECORD) as a `WaterPixel`."""
    r = record[n]
    return WaterPixel(
        r[X], r[Y], r[Z], r[VIEW_X], r[VIEW_Y], r[VIEW_Z], r[VIEW_DEPTH], r[WATER_DEPTH],
        r[COVERAGE], r[RIPPLE_SHARE], r[SLOPE_X], r[SLOPE_Y], r[VARIANCE_X], r[VARIANCE_Y],
        r[COVARIANCE], r[WIDTH],
    )  # fmt: skip


@inlined_function
def write_level(water, row_out):
    """Write a `WaterPixel` into a record of RECORD numbers, its slopes and their variances as zero.

    They are written by `write_slopes` when the ripples are known.
    """
    row_out[X], row_out[Y], row_out[Z] = water.x, water.y, water.z
    row_out[VIEW_X], row_out[VIEW_Y], row_out[VIEW_Z] = water.view_x, water.view_y, water.view_z
    row_out[VIEW_DEPTH], row_out[WATER_DEPTH] = water.view_depth, water.water_depth
    row_out[COVERAGE], row_out[RIPPLE_SHARE] = water.coverage, water.ripple_share
    row_out[WIDTH] = water.width
    for k in range(SLOPE_X, WIDTH):
        row_out[k] = ZERO


@inlined_function
def write_slopes(water, row_out):
    """Write the slopes of a `WaterPixel` into its record."""
    row_out[SLOPE_X], row_out[SLOPE_Y] = water.slope_x, water.slope_y
    row_out[VARIANCE_X], row_out[VARIANCE_Y] = water.variance_x, water.variance_y
    row_out[COVARIANCE] = water.covariance


@inlined_function
def with_slopes(water, slope_x, slope_y, variance_x, variance_y, covariance):
    """Return a `WaterPixel` with other slopes."""
    return WaterPixel(
        water.x, water.y, water.z, water.view_x, water.view_y, water.view_z, water.view_depth,
        water.water_depth, water.coverage, water.ripple_share, slope_x, slope_y, variance_x,
        variance_y, covariance, water.width,
    )  # fmt: skip
