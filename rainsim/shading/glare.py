"""Glare: the halo that scatter in a lens, or in an eye, puts around lamps.

A point of light is spread by a point spread function. Only what is much brighter than white
scatters enough to be seen, so that the excess over `DAZZLES` of white is spread and the other
light stays as it is.

References
----------
Spencer, Shirley, Zimmerman and Greenberg 1995, "Physically-based glare effects for digital images",
SIGGRAPH, the photopic function of the eye: 0.384 f0 + 0.478 f1 + 0.138 f2 per steradian. No camera
lens was measured; a clean one scatters several times less than the eye.
"""

import math

import numpy as np
from scipy import fft

DAZZLES = 2.0  # of white as it is shown: what is darker has no halo of its own
REACH = 30.0  # degrees: what a lamp scatters farther is not drawn, 1 % of its light
DEGREES = 180 / math.pi


def scattered(angle):
    """Return the share of a point's light per steradian at an angle [degrees] from it.

    Without f0, the sharp image itself, a narrow Gaussian of 0.02 degrees.
    """
    angle = np.asarray(angle, np.float64)
    return 0.478 * 20.91 / (angle + 0.02) ** 3 + 0.138 * 72.37 / (angle + 0.02) ** 2


def spread_kernel(focal, rows, columns):
    """Return the light a pixel scatters into others, (2 rows - 1, 2 columns - 1), 0 in its middle.

    focal : float [px]
    rows, columns : int. Of the picture: the middle of the kernel reaches every
        pixel from any.

    The angle of a distance d is atan(d / focal) and a pixel's solid angle cos^3 / focal^2: exact
    for a lamp in the middle of the picture.
    """
    y, x = np.arange(1 - rows, rows), np.arange(1 - columns, columns)
    angle = np.arctan(np.hypot(y[:, None], x[None]) / focal)
    solid = np.cos(angle) ** 3 / focal**2
    kernel = scattered(angle * DEGREES) * solid
    kernel[angle * DEGREES > REACH] = 0.0
    kernel[rows - 1, columns - 1] = 0.0
    return kernel.astype(np.float32)


class Glare:
    """Adds the halos of lamps to pictures; keeps the spread of a size and lens between frames."""

    def __init__(self):
        self._key = self._spread = None

    def added(self, picture, focal, brightness):
        """Return a picture with the halos of pixels brighter than `DAZZLES` of white.

        picture : float32 array (height, width, 3). Radiance.
        focal : float [px]
        brightness : float. Factor with which radiance is shown: 1 over it is
            white.
        Returns ndarray. The picture itself where nothing dazzles.
        """
        excess = np.maximum(picture - np.float32(DAZZLES / brightness), 0)
        if not excess.any():
            return picture
        height, width = picture.shape[:2]
        shape = [fft.next_fast_len(2 * n - 1, real=True) for n in (height, width)]
        key = height, width, focal
        if key != self._key:
            kernel = np.zeros(shape, np.float32)
            kernel[: 2 * height - 1, : 2 * width - 1] = spread_kernel(focal, height, width)
            kernel = np.roll(kernel, (1 - height, 1 - width), axis=(0, 1))
            self._key, self._spread = key, fft.rfft2(kernel, workers=1)
        picture = picture.copy()
        for c in range(3):
            if excess[..., c].any():
                light = fft.rfft2(excess[..., c], shape, workers=1)
                halo = fft.irfft2(light * self._spread, shape, workers=1)
                picture[..., c] += np.maximum(halo[:height, :width], 0)
        return picture
