"""Skies of the day: overcast, clouded, a panorama's, a captured one completed; and their sun.

All are environment maps, see `environment`.
"""

import functools
import math

import numpy as np
from scipy import ndimage

from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.shading.environment import ROWS, directions, irradiance

ZENITH_RADIANCE = 1.2  # of display white: overcast sky over wet ground at a normal exposure
PLAIN = "overcast", "capture"  # settings of the sky whose map has no land of its own
GROUND_ALBEDO = 0.15  # what the lower half of a plain sky map shows
PANORAMA_ROWS = 512  # of the map of a panorama: it is seen behind the scene, too
# m: over which distant ground goes over into the air before it, and the sine of the elevation below
# which a map is the horizon's. Chosen: the rain's own extinction alone would leave a dark edge.
HAZE, AIR = 60.0, 0.06
CLOUD_DEPTH = 0.3  # of the noise in the logarithm of a clouded sky's radiance; by eye
CLOUD_ROWS = 2 * ROWS  # of a clouded sky's map
# Exponents of x, y and z: on the sphere these span the harmonics to degree 3.
CUBIC = [(i, j, k) for i in range(4) for j in range(4 - i) for k in (0, 1) if i + j + k <= 3]
LEAST_SKY_SEEN = 0.02  # share of the upper half below which a captured sky tells nothing
SEAM = 5.0  # texels of the map, over which a captured sky goes over into the filled one
SUN_BLUR, SUN_PEAK = math.radians(2.5), 4.0
SUN_IRRADIANCE = 25.0  # of display white: full sun over the overcast sky's some 1
SUN_TINT = 1.0, 0.95, 0.88


def overcast(brightness=1.0):
    """Return the map of an overcast sky over dull ground.

    Moon and Spencer 1942: L = Lz (1 + 2 sin(elevation)) / 3 above the horizon, which gives the
    ground the irradiance (7/9) pi Lz. It is grey: all light of the day comes from it, and the
    capture's colours are those that a camera balances to white.
    """
    sine = directions()[..., 2]
    zenith = ZENITH_RADIANCE * brightness
    above = zenith * (1 + 2 * np.maximum(sine, 0)) / 3
    below = GROUND_ALBEDO * zenith * 7 / 9
    # No edge at the horizon: haze mixes the two within some degrees.
    mix = np.clip(sine / 0.05 + 0.5, 0, 1)
    radiance = below + (above - below) * mix
    return np.repeat(radiance[..., None], 3, axis=2).astype(np.float32)


def with_haze(environment, height):
    """Return the map with its ground seen through haze, as on a plain `height` [m] below the eye.

    A capture ends before the horizon. What lies beyond goes over into the horizon's sky, the more
    the farther it is: without that a dark band would stand above the last captured ground.
    """
    sine = directions(*environment.shape[:2])[:, 0, 2]
    air = environment[(sine > AIR / 2) & (sine < 2 * AIR)].mean(axis=0)
    ground = environment[sine < -AIR].mean(axis=0)
    far = height / np.maximum(-sine, 1e-6)
    clear = np.where(sine < 0, np.exp(-far / HAZE), 0)[:, None, None]
    low = np.clip((AIR - sine) / (AIR / 2), 0, 1)[:, None, None]  # of the map's own horizon
    made = environment + low * (air + clear * (ground - air) - environment)
    return np.ascontiguousarray(made, np.float32)


def clouded(environment):
    """Return the map of an even sky with the undersides of clouds drawn into it.

    environment : array (m, n, 3). Map of the even sky.
    Returns float32 array (CLOUD_ROWS, 2 CLOUD_ROWS, 3). Scaled so that level
        ground receives as much green light as before.
    """
    row, column = np.indices((CLOUD_ROWS, 2 * CLOUD_ROWS)) / CLOUD_ROWS
    scale = environment.shape[0]
    where = [row * scale - 0.5, column * environment.shape[1] / 2 - 0.5]
    even = [ndimage.map_coordinates(c, where, order=1, mode="nearest")
            for c in np.moveaxis(environment, 2, 0)]  # fmt: skip
    even = np.stack(even, axis=-1)
    made = even * np.exp(CLOUD_DEPTH * _bellies())[..., None]
    made *= irradiance(environment)[1] / irradiance(made)[1]
    return np.ascontiguousarray(made, dtype=np.float32)


@functools.cache
def _bellies():
    """Return the noise of the undersides of clouds, read-only, about -1 to 1.

    Its shape is (CLOUD_ROWS, 2 CLOUD_ROWS). Smooth noise on a horizontal sheet of cloud is
    projected onto the sky, finer towards the horizon, where it fades as if in haze.
    """
    direction = directions(CLOUD_ROWS, 2 * CLOUD_ROWS)
    height = np.maximum(direction[..., 2], 0)
    sheet = direction[..., :2] / (height[..., None] + 0.25)
    lattice = np.random.Generator(np.random.PCG64(3)).uniform(-1, 1, (64, 64))
    noise = np.zeros(height.shape)
    for octave, (size, amplitude) in enumerate(((1.7, 1.0), (0.8, 0.5), (0.36, 0.25), (0.17, 0.1))):
        at = [sheet[..., k] / size * (1.0, 0.6)[k] + 7.3 * octave for k in range(2)]
        noise += amplitude * ndimage.map_coordinates(lattice, at, order=3, mode="grid-wrap")
    noise *= np.clip(height / 0.25, 0, 1)
    above = height > 0
    noise[above] -= _broad(noise, direction, above)
    noise -= noise.mean(axis=1, keepdims=True)
    noise /= 3 * noise[above].std()
    noise.flags.writeable = False
    return noise


def _broad(noise, direction, above):
    """Return the parts of some noise broader than a fourth of the sky, for each direction above.

    The spherical harmonics to degree 3 that fit it best. A rain cloud covers the whole sky, and its
    mean luminance depends on the elevation alone (CIE S 011): without this wet ground would mirror
    one side of every sky twice as bright as the other.
    """
    x, y, z = direction[above].T
    basis = np.stack([x**i * y**j * z**k for i, j, k in CUBIC], axis=-1)
    some = slice(None, None, 5)  # enough for what is broad
    root = (1 - z[some] ** 2) ** 0.25  # of the area of a texel
    left, right = basis[some] * root[:, None], noise[above][some] * root
    return basis @ np.linalg.lstsq(left, right, rcond=None)[0]


def completed(radiance, known):
    """Return a sky map with unseen directions filled by an overcast sky, and the share known.

    radiance : float32 array (rows, columns, 3)
    known : bool array (rows, columns). Where it is the captured sky. The fill is
        as bright as that, and goes over into it softly.
    """
    plain = overcast()
    above = directions()[..., 2] > 0
    known = known & above
    area = np.cos((0.5 - (np.arange(ROWS) + 0.5) / ROWS) * np.pi)[:, None]
    share = float((area * known).sum() / (area * above).sum())
    if share < LEAST_SKY_SEEN:
        return plain, share
    ratio = np.median(radiance[known] / plain[known], axis=0)
    weight = ndimage.gaussian_filter(known.astype(np.float64), SEAM, mode=("nearest", "wrap"))
    held = np.where(known[..., None], radiance, 0)
    near = ndimage.gaussian_filter(held, (SEAM, SEAM, 0), mode=("nearest", "wrap", "nearest"))
    near = near / np.maximum(weight, 1e-6)[..., None]
    mix = np.clip(2 * weight, 0, 1)[..., None]
    filled = plain * ratio * (1 - mix) + near * mix
    return np.where(known[..., None], radiance, filled).astype(np.float32), share


def brightest(environment):
    """Return azimuth and elevation [rad] of the sun in a sky, or None if nothing stands out.

    The sun is taken to be where the radiance, blurred over SUN_BLUR, exceeds the upper half's
    mean by SUN_PEAK.
    """
    rows, columns = environment.shape[:2]
    light = environment @ LUMINANCE_WEIGHTS
    blur = SUN_BLUR * rows / np.pi
    smooth = ndimage.gaussian_filter(light, blur, mode=("nearest", "wrap"))
    direction = directions(rows, columns)
    upper = direction[..., 2] > 0.02
    area = np.sqrt(1 - direction[..., 2] ** 2)
    mean = float((light * area)[upper].sum() / area[upper].sum())
    smooth = np.where(upper, smooth, 0)
    if smooth.max() < SUN_PEAK * mean:
        return None
    # The centroid of what is nearly as bright, not the texel.
    weight = np.where(smooth > 0.7 * smooth.max(), light * area, 0)
    x, y, z = np.einsum("ij,ijc->c", weight, direction)
    return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


def sun_of(setting, environment):
    """Return the sun that a setting names, and a note on it or None.

    setting : tuple, "sky" or None. Azimuth and elevation [rad]; "sky": the
        brightest place of the map `environment`, if any; None: no sun.
    Returns sun : tuple or None. Azimuth and elevation [rad].
        note : str or None
    """
    if setting != "sky":
        return setting, None
    found = brightest(environment)
    if found is None:
        return None, "nothing in the sky stands out as the sun: none is drawn"
    azimuth, elevation = (math.degrees(angle) for angle in found)
    return found, f"the sun of the sky: azimuth {azimuth:.0f}, elevation {elevation:.0f} degrees"


def sunlight(sun, cloudiness):
    """Return unit direction and irradiance of a sun (azimuth, elevation) [rad], float32 (6,).

    Zero without a sun. The irradiance is relative to display white, weaker as clouds cover the sky.
    """
    if sun is None:
        return np.zeros(6, np.float32)
    azimuth, elevation = sun
    direction = (
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    )
    clear = SUN_IRRADIANCE * (1 - cloudiness)
    return np.array([*direction, *(tint * clear for tint in SUN_TINT)], np.float32)


def from_panorama(panorama, brightness=1.0):
    """Return the map of an equirectangular HDR picture, scaled to the overcast sky's irradiance.

    An HDR panorama has arbitrary units; the captured picture has its own exposure. So the mean
    radiance of the upper half, weighted by the cosine, is set to that of `overcast`.
    """
    high = min(max(panorama.shape[0], ROWS), PANORAMA_ROWS)
    wide = 2 * high
    for axis, least in enumerate((high, wide)):  # a small one is enlarged first
        panorama = np.repeat(panorama, -(-least // panorama.shape[axis]), axis)
    rows = np.linspace(0, panorama.shape[0], high + 1).astype(int)
    columns = np.linspace(0, panorama.shape[1], wide + 1).astype(int)
    total = np.add.reduceat(np.add.reduceat(panorama, rows[:-1], axis=0), columns[:-1], axis=1)
    scaled = total / (np.diff(rows)[:, None] * np.diff(columns))[..., None]
    wanted = irradiance(overcast(brightness))[1]
    present = max(irradiance(scaled)[1], 1e-6)
    return np.ascontiguousarray(scaled * (wanted / present), dtype=np.float32)
