"""Fog: the extinction of the drops that are not drawn, too fine to track or too far to show.

A picture splits the drops of each size class at a depth: before it they are drawn, beyond it they
are fog. The smallest drops are fog everywhere. Q = 1: a camera does not see the half of the
extinction that is diffraction.
"""

import numpy as np

from rainsim.shading.composite import FOG_END

FOG_STEPS = 96  # even steps of depth at which the optical depth is tabled
NO_FOG = np.zeros(FOG_STEPS + 3, np.float32)  # the fog table of dry air
NO_FOG[FOG_END] = 1.0


def fog_extinction(field):
    """Return the extinction [1/m] of the drops that are not drawn, before and beyond the split.

    Before it those are the drops too fine to track, beyond it all.
    """
    spectrum = field.spectrum
    return spectrum.fine_extinction, spectrum.fine_extinction + float(spectrum.extinction.sum())


def fog_optical_depth(field, depth, far):
    """Return the optical depth of the drops not drawn up to `depth` [m], when `far` [m] splits.

    `far` is a number or one for each class, as in `streaks.draw_streaks`. The optical depth is that
    straight ahead; elsewhere it is more by one over the cosine of the angle off the axis.
    """
    spectrum = field.spectrum
    beyond = np.maximum(np.asarray(depth)[..., None] - np.asarray(far), 0)
    return spectrum.fine_extinction * depth + (beyond * spectrum.extinction).sum(axis=-1)


def fog_table(field, far):
    """Return the table of the fog that `shading.composite.compose` reads.

    Returns float32 array (FOG_STEPS + 3,). The depth [m] up to which there are
        steps, the extinction [1/m] beyond it, and the optical depth at FOG_STEPS
        + 1 even steps of depth.
    """
    last = float(np.max(far))
    steps = np.linspace(0.0, last, FOG_STEPS + 1)
    _, beyond = fog_extinction(field)
    depths = fog_optical_depth(field, steps, far)
    return np.concatenate([[last, beyond], depths]).astype(np.float32)
