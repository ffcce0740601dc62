"""Filters of scipy.ndimage for maps, on several threads and equal to scipy's to the byte.

A separable filter goes along one axis at a time: each pass is split across the other axis, where
the lines do not know of each other.
"""

import numpy as np
from scipy import ndimage

from rainsim.jit import get_num_threads
from rainsim.numerics.blocks import in_blocks

LEAST_CELLS = 1 << 18  # of a map that is split


def gaussian_filter(values, sigma):
    """Return `values` (ny, nx) blurred by a Gaussian of `sigma` cells, see scipy.ndimage."""
    return _along_both(ndimage.gaussian_filter1d, values, sigma)


def uniform_filter(values, size):
    """Return the means of `values` (ny, nx) over squares of `size` cells, see scipy.ndimage."""
    return _along_both(ndimage.uniform_filter1d, values, size)


def minimum_filter(values, size):
    """Return the minima of `values` (ny, nx) over squares of `size` cells, see scipy.ndimage."""
    return _along_both(ndimage.minimum_filter1d, values, size)


def maximum_filter(values, size, origin=0):
    """Return the maxima of `values` (ny, nx) over squares of `size` cells, see scipy.ndimage."""
    return _along_both(ndimage.maximum_filter1d, values, size, origin=origin)


def grey_opening(values, size):
    """Return the minima of `values` (ny, nx) over squares of `size` cells, then their maxima."""
    # A square of even size has no middle cell: the dilation is shifted back.
    return maximum_filter(minimum_filter(values, size), size, origin=0 if size % 2 else -1)


def median_filter(values):
    """Return the median of `values` (ny, nx) over squares of 3 x 3 cells, see scipy.ndimage."""
    if values.size < LEAST_CELLS:
        return ndimage.median_filter(values, 3)
    out = np.empty_like(values)

    def work(part):
        start, stop = max(part.start - 1, 0), min(part.stop + 1, len(values))
        found = ndimage.median_filter(values[start:stop], 3)
        out[part] = found[part.start - start : part.stop - start]

    in_blocks(work, len(values), _share(len(values)))
    return out


def distance(mask, most):
    """Return how far off [cells] the nearest cell is at which `mask` (ny, nx) is false, float64.

    Exact up to `most`; what is farther is farther than that here, too.
    """
    out, reach = np.empty(mask.shape), int(most) + 1

    def work(part):
        start = max(part.start - reach, 0)
        near = mask[start : part.stop + reach]
        away = np.inf if near.all() else ndimage.distance_transform_edt(near)
        out[part] = np.broadcast_to(away, near.shape)[part.start - start :][: len(out[part])]

    in_blocks(work, len(mask), _share(len(mask)))
    return out


def _along_both(filter_1d, values, width, **options):
    out = np.empty(values.shape, values.dtype)
    if values.size < LEAST_CELLS:
        filter_1d(values, width, axis=0, output=out, **options)
        filter_1d(out, width, axis=1, output=out, **options)
        return out

    def down(part):
        filter_1d(values[:, part], width, axis=0, output=out[:, part], **options)

    def across(part):
        filter_1d(out[part], width, axis=1, output=out[part], **options)

    in_blocks(down, values.shape[1], _share(values.shape[1]))
    in_blocks(across, values.shape[0], _share(values.shape[0]))
    return out


def _share(count):
    return max(1, -(-count // get_num_threads()))
