"""From the captured light to that of a dull day: formulas of grading, and the test for sky.

Colours are linear light, radiance relative to display white, unless a name says otherwise.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF, ONE, ZERO
from rainsim.jit import inlined_function
from rainsim.numerics.interpolation import smoothstep
from rainsim.shading.color import LUMA, linear_from_display, luminance
from rainsim.shading.fresnel import LAWS

DULL_EXPOSURE = 0.7  # factor on captured light under an overcast sky, before the meter
TOPS_END = 1.6  # m over the ground: `terrain.tops` finds tops up to 1.5 m, which may be warped
SHINES = np.float32(1.5)  # linear luminance that only lamps reach in a capture
COMPRESSED = np.float32(0.25)  # of white, above which highlights are compressed
SKY_DARK, SKY_BRIGHT = np.float32(0.10), np.float32(0.22)  # linear luminance: no sky, all sky
SKY_DULL, SKY_BLUE = np.float32(0.6), np.float32(0.85)  # blue over the largest channel: as above
# Alpha that hides all: the sky before which a surface was trained shows through it a little; and
# next to none.
OPAQUE, LEAST_COVER = np.float32(0.8), np.float32(1e-3)
CROWN = np.float32(0.04)  # sine of the elevation from which on leaves are seen before the sky


class Look(NamedTuple):
    """How the light of the day differs from the captured light; each a float32."""

    exposure: np.float32  # factor on captured light
    compression: np.float32  # of highlights, see `graded`; 0: none
    sky_replaced: np.float32  # share of the captured sky that the day's sky replaces, 0 to 1
    open_sky: np.float32  # 1: the splats of the captured sky are left out, see `backdrop`; 0: drawn
    albedo: np.float32  # that a captured linear colour of 1 stands for, see `calibration`
    # m over the ground, up to which level things are tops, on whose water the gloss lies; 0: none.
    tops_end: np.float32
    wetness: np.float32 = ONE  # factor on darkening and gloss, 0 to 2; 1: as measured
    law: np.float32 = ZERO  # of reflectance, a number of `fresnel.LAWS`


def look_of(config, sky_is_left_out, albedo, relit=False, tops=False):
    """Return the `Look` of the settings of one time.

    config : Config. Its `cloudiness`, 0 to 1, makes light dull; the numbers are
        chosen by eye.
    sky_is_left_out : bool. Whether the splats of the captured sky are left out of
        the scene.
    albedo : float. That a captured linear colour of 1 stands for.
    relit : bool. Whether the captured sun is divided out: then there are no
        sunlit patches to compress.
    tops : bool. Whether tops are drawn as water.
    """
    c = config.render.cloudiness
    replaced = 0.0 if config.render.sky == "capture" else c
    dimmed, compressed = 1 - (1 - DULL_EXPOSURE) * c, 0.0 if relit else 1.2 * c
    dimmed *= config.render.daylight
    tops_end = TOPS_END if tops else 0.0
    numbers = (
        dimmed, compressed, replaced, sky_is_left_out, albedo, tops_end, config.render.wetness,
        LAWS[config.render.fresnel],
    )  # fmt: skip
    return Look(*(np.float32(n) for n in numbers))


def replaces_sky(config):
    """Tell whether the sky of the day replaces the captured sky at any time."""
    looks = (look_of(config.at(time), False, 1.0) for time in config.key_times())
    return any(look.sky_replaced > 0 for look in looks)


@inlined_function
def graded(r, g, b, look):
    """Return captured linear colour as it looks under a dull sky: darker and flatter.

    Compression divides what exceeds COMPRESSED of white: sunlit patches. What is brighter than
    SHINES is a lamp, which the day does not light: its excess over SHINES stays as it is.
    """
    y = luminance(r, g, b)
    own = max(ONE - SHINES / max(y, SHINES), ZERO)  # share of light that a lamp sends out itself
    y *= ONE - own
    excess = max(y * look.exposure - COMPRESSED, ZERO)
    gain = look.exposure / (ONE + excess * look.compression)
    kept = (ONE - own) * gain + own
    return r * kept, g * kept, b * kept


@inlined_function
def covered_share(alpha, leaf, sine):
    """Return the share of a pixel in which a surface of this alpha hides the sky behind.

    At edges it is alpha, up to HALF; what hides nearly all hides all. Between the leaves of a crown
    the sky is seen, between those of a hedge are more leaves.

    leaf : float32. How surely it is leaves, 0 to 1.
    sine : float32. Of the elevation that it is seen at.
    """
    whole = min(max(alpha, HALF + (alpha - HALF) / (OPAQUE / HALF - ONE)), ONE)
    return whole + leaf * smoothstep(ZERO, CROWN, sine) * (alpha - whole)


@inlined_function
def undiluted(r, g, b, alpha):
    """Return the linear colour of a surface that covers a share `alpha` of a pixel.

    (r, g, b) is its display-referred colour over black, as the rasterizer blends it.
    """
    inv = ONE / max(alpha, LEAST_COVER)
    return (
        linear_from_display(max(r, ZERO) * inv),
        linear_from_display(max(g, ZERO) * inv),
        linear_from_display(max(b, ZERO) * inv),
    )


@inlined_function
def surface_color(r, g, b, alpha, look):
    """Return the linear colour of a captured surface; other parameters are those of `undiluted`."""
    return undiluted(r, g, b, alpha if look.open_sky > ZERO else ONE)


def is_like_sky(color):
    """Tell which far captured linear colours (n, 3) above the horizon are sky.

    Bright and not green counts as sky: a guess, since a capture does not say what is sky.
    """

    def share(values, low, high):
        s = np.clip((values - low) / (high - low), 0, 1)
        return s * s * (3 - 2 * s)

    blue = color[:, 2] / np.maximum(color[:, :2].max(axis=1), 1e-3)
    return share(color @ LUMA, SKY_DARK, SKY_BRIGHT) * share(blue, SKY_DULL, SKY_BLUE) > 0.5
