"""Rain drawn flat on a picture, as 2D overlays do: a baseline for rain that has a place in space.

Overlays add streaks to each picture on its own. Here they get every advantage: the very streaks of
the same view, as many, as long, as bright, only at random places. `partners` then measures what is
lost: whether two views of one moment show the same rain.
"""

import numpy as np
from scipy import ndimage

from rainsim.errors import ParameterError

SEEN = 1 / 32  # alpha from which a pixel belongs to a streak
SMALLEST, LARGEST = 12, 4000  # px of a streak: less is noise, more is several in one
APART = 0.35  # of a streak's summed alpha by which its partner may differ
BLUR = 1.0  # px along the row: a streak lies between other pixels in the other picture
EVERY_WAY = np.ones((3, 3), int)


def streaks_in(alpha):
    """Return the streaks of a picture: the box (row slice, column slice) of each and its pixels.

    `alpha`, (height, width), is the share of light that drops replace.
    """
    label, _ = ndimage.label(alpha > SEEN, EVERY_WAY)
    size = np.bincount(label.ravel())
    return [(box, label[box] == k) for k, box in enumerate(ndimage.find_objects(label), 1)
            if SMALLEST <= size[k] <= LARGEST]  # fmt: skip


def flat_rain(alpha, seed):
    """Return the alpha of the same streaks at random places, (height, width), float32."""
    rng, out = np.random.default_rng(seed), np.zeros(alpha.shape, np.float32)
    height, width = alpha.shape
    for box, own in streaks_in(alpha):
        patch = np.where(own, alpha[box], 0)
        row = rng.integers(0, height - patch.shape[0] + 1)
        column = rng.integers(0, width - patch.shape[1] + 1)
        place = np.s_[row : row + patch.shape[0], column : column + patch.shape[1]]
        out[place] = 1 - (1 - out[place]) * (1 - patch)
    return out


def partners(left, right, most):
    """Return the share of a picture's streaks that the picture beside it shows too, and a number.

    Left and right are the alpha of two parallel cameras side by side at one moment: what the left
    one sees at a column the right one sees up to `most` columns farther left, in the same row. The
    number is that of the streaks that count: those of the left picture that lie wholly in the right
    one's view.
    """
    if left.shape != right.shape or most < 1:
        raise ParameterError(
            f"pictures are {left.shape} and {right.shape} and the disparity is up to {most} px; "
            "the pictures must be equal in size and the disparity 1 or more"
        )
    found = count = 0
    left, right = (ndimage.gaussian_filter1d(a.astype(np.float64), BLUR, axis=1)
                   for a in (left, right))  # fmt: skip
    for (rows, columns), own in streaks_in(left):
        if columns.start < most:
            continue
        patch = left[rows, columns]
        strip = right[rows, columns.start - most : columns.stop]
        windows = np.lib.stride_tricks.sliding_window_view(strip, patch.shape)[0]
        # Where it has light of its own: other streaks may pass beside it.
        off = np.abs(windows[:, own] - patch[own]).sum(axis=1)
        count += 1
        found += bool(off.min() < APART * patch[own].sum())
    return (found / count if count else 0.0), count
