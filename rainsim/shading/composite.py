"""The finished picture: air, splashes and falling drops before the wet scene, encoded for display.

Colours are linear light, radiance relative to display white. `through_rain` composes one channel
and `tone_curve` encodes it, on both backends and for the AOVs. `compose` does so in vectors: a row
in chunks of CHUNK pixels, each in passes over numbers that stay in cache.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import FAR_AWAY, HALF, ONE, TWO, ZERO
from rainsim.jit import cpu_kernel, device_function, inlined_function, prange, serial_kernel
from rainsim.numerics.approximations import exp_minus
from rainsim.numerics.pixel_batches import CHUNK
from rainsim.scene.view import View, column_slope, row_slope
from rainsim.shading.color import display_from_linear

WHITE = np.float32(255)
# Places in a fog table, see `RainCover`.
FOG_END, FOG_BEYOND, FOG_STEPS_BEGIN = 0, 1, 2

# Rows of a chunk of `compose`: shares of light that air, streaks and splashes let through, radiance
# of drops and of the sheets of splashes, colours.
(CLEAR, PAST_DROPS, PAST_SPLASHES, DROP, SHEET, RED, GREEN, BLUE) = (CHUNK * k for k in range(8))
COMPOSED = 8 * CHUNK


class RainCover(NamedTuple):
    """Opacity of falling drops, splashes and fog before a picture; read-only."""

    rain_alpha: np.ndarray  # (height, width) float32, share of light that falling drops replace
    splash_alpha: np.ndarray  # (height, width) float32, share of light that splashes replace
    # (n + 3,) float32, air with drops that are not drawn one by one: a depth [m], the extinction
    # beyond that depth [1/m], and the optical depth at n + 1 even steps up to it.
    fog: np.ndarray


class RainLight(NamedTuple):
    """Radiance of drops, splashes and air before the scene; read-only."""

    # (m, n, 3) float32, of falling drops at places from edge to edge of the picture, bilinear
    # between them; see `falling_light`.
    drops: np.ndarray
    around: np.ndarray  # the same of the sheets of splashes, half of what they show
    air: np.ndarray  # (3,) float32, of the air


@device_function
def fog_thickness(fog, z):
    """Return the optical depth up to depth z [m] that a fog table holds."""
    steps = fog.shape[0] - 3
    at = min(z / fog[FOG_END], ONE) * np.float32(steps)
    i = min(int(at), steps - 1)
    k = FOG_STEPS_BEGIN + i
    within = fog[k] + (fog[k + 1] - fog[k]) * (at - np.float32(i))
    return within + fog[FOG_BEYOND] * max(z - fog[FOG_END], ZERO)


@inlined_function
def transmittance(fog, depth, a, b):
    """Return the share of light that the air before a pixel lets through.

    `a` and `b` are the tangents of the pixel's ray to the view axis: towards the corners the way
    through the air is longer than the depth [m]. The captured sky is seen through all air already.
    """
    thickness = fog_thickness(fog, min(depth, FAR_AWAY)) * math.sqrt(ONE + b * b + a * a)
    return exp_minus(thickness) if depth < FAR_AWAY else ONE


@device_function
def field_place(pixel, count, places):
    """Return a pixel's real index among `places` spaced evenly over `count` pixels."""
    return (np.float32(pixel) + HALF) * (np.float32(places - 1) / np.float32(count))


@inlined_function
def splash_light(drop, around):
    """Return the radiance of splashes where that of drops is `drop`.

    Half of what a crown shows is taken to come through its rim and its droplets, which bend light
    as drops do, and half from its sheets, of the radiance `around`.
    """
    return HALF * (drop + around)


@inlined_function
def through_rain(value, drop, around, air, clear, past_splashes, past_drops):
    """Return the radiance of one channel behind air, splashes and drops, which add their own.

    value : float32 or ndarray. Radiance of the wet scene.
    drop, around, air : float32 or ndarray. Radiances, see `RainLight`.
    clear, past_splashes, past_drops : float32 or ndarray. Shares of light that
        air, splashes and drops let through.
    """
    value = air + (value - air) * clear
    splash = splash_light(drop, around)
    value = splash + (value - splash) * past_splashes
    return drop + (value - drop) * past_drops


@inlined_function
def tone_curve(value):
    """Return the display-referred value, 0 to 1, of a radiance.

    Linear up to half of white, then a soft shoulder, so that highlights approach white instead of
    being cut off: v becomes 1/2 + (1 - exp(-2 (v - 1/2))) / 2.
    """
    over = max(value - HALF, ZERO)
    value = min(value, HALF) + HALF * (ONE - exp_minus(over * TWO))
    return min(display_from_linear(max(value, ZERO)), ONE)


@inlined_function
def eight_bit(shown):
    """Return the 8-bit number of a display-referred value of 0 to 1."""
    return np.uint8(np.int32(shown * WHITE + HALF))


@cpu_kernel
def compose(picture, depth, drops: RainCover, light: RainLight, view: View, brightness, image_out):
    """Put air, splashes and drops before a picture and encode it for display.

    picture : float32 array (height, width, 3). Radiance.
    depth : float32 array (height, width) [m]
    drops : RainCover
    light : RainLight
    brightness : float32. Factor on the radiance.
    image_out : uint8 array (height, width, 3)
    """
    height, width = depth.shape
    radiance, image = picture.reshape(height, width * 3), image_out.reshape(height, width * 3)
    for row in prange(height):
        compose_row(
            np.int64(row), height, radiance[row], depth[row], drops, light, view, brightness,
            image[row],
        )  # fmt: skip


@device_function
def compose_row(row, height, radiance, depth, drops, light, view, brightness, image_out):
    """Compose one row of pixels; see `compose`."""
    rain_alpha, splash_alpha, fog = drops.rain_alpha, drops.splash_alpha, drops.fog
    field, sheets, air = light.drops, light.around, light.air
    width, places = len(depth), field.shape[1]
    s, line = np.empty(COMPOSED, np.float32), np.empty(places, np.float32)
    v = field_place(row, height, field.shape[0])
    j = int(v)
    below = v - np.float32(j)
    b = row_slope(view, row)
    for left in range(0, width, CHUNK):
        end = min(left + CHUNK, width)
        n = end - left
        find_transmittance(depth[left:end], fog, view, b, left, n, s)
        read_covers(rain_alpha[row, left:end], splash_alpha[row, left:end], n, s)
        read_colors(radiance[3 * left : 3 * end], n, s)
        for c in range(3):
            read_line(field, j, below, c, line)
            spread_line(line, left, width, n, s[DROP : DROP + CHUNK])
            read_line(sheets, j, below, c, line)
            spread_line(line, left, width, n, s[SHEET : SHEET + CHUNK])
            color = s[RED + c * CHUNK : RED + (c + 1) * CHUNK]
            finish(s, color, n, air[c], brightness)
        write_image(n, s, image_out[3 * left : 3 * end])


@inlined_function
def find_transmittance(depth, fog, view, b, left, n, s):
    """Find the transmittance of the air before n pixels of a row: `transmittance` in vectors."""
    square = ONE + b * b
    for i in range(n):
        s[CLEAR + i] = fog_thickness(fog, min(depth[i], FAR_AWAY))
    for i in range(n):
        a = column_slope(view, left + i)
        s[CLEAR + i] = exp_minus(s[CLEAR + i] * math.sqrt(square + a * a))
    for i in range(n):
        s[CLEAR + i] = s[CLEAR + i] if depth[i] < FAR_AWAY else ONE


@inlined_function
def read_covers(rain_alpha, splash_alpha, n, s):
    """Read which share of light drops and splashes let through."""
    for i in range(n):
        s[PAST_DROPS + i] = ONE - rain_alpha[i]
    for i in range(n):
        s[PAST_SPLASHES + i] = ONE - splash_alpha[i]


@inlined_function
def read_colors(radiance, n, s):
    """Read the radiance of n pixels into the scratch rows RED, GREEN and BLUE."""
    for i in range(n):
        s[RED + i], s[GREEN + i] = radiance[3 * i], radiance[3 * i + 1]
        s[BLUE + i] = radiance[3 * i + 2]


@inlined_function
def read_line(field, j, below, c, line_out):
    """Write one channel of a field of radiance at the places across a row, `below` its row j."""
    for k in range(len(line_out)):
        upper, lower = field[j, k, c], field[j + 1, k, c]
        line_out[k] = upper + (lower - upper) * below


@inlined_function
def spread_line(line, left, width, n, radiance_out):
    """Write the radiance for n pixels of a row, interpolated from places across it."""
    places = len(line)
    scale = np.float32(places - 1) / np.float32(width)
    for i in range(n):
        u = (np.float32(left + i) + HALF) * scale
        k = np.uint32(np.int32(u))
        radiance_out[i] = line[k] + (line[k + np.uint32(1)] - line[k]) * (u - np.float32(k))


# Not inlined: LLVM sees that its loop can run in vectors only when it looks at the loop alone.
@serial_kernel
def finish(s, color, n, air, brightness):
    """Put air, splashes and drops before one channel of n pixels and encode it."""
    for i in range(n):
        value = through_rain(
            color[i], s[DROP + i], s[SHEET + i], air, s[CLEAR + i], s[PAST_SPLASHES + i],
            s[PAST_DROPS + i],
        )  # fmt: skip
        color[i] = tone_curve(value * brightness)


@inlined_function
def write_image(n, s, image_out):
    """Write n pixels as 8-bit colours."""
    for i in range(n):
        image_out[3 * i] = eight_bit(s[RED + i])
        image_out[3 * i + 1] = eight_bit(s[GREEN + i])
        image_out[3 * i + 2] = eight_bit(s[BLUE + i])


@cpu_kernel
def find_clear(depth, fog, view: View, clear_out):
    """Write the transmittance, 0 to 1, of the air between the camera and each pixel's surface.

    It is drawn as an AOV.

    depth : float32 array (height, width) [m]
    fog : float32 array (n + 3,). See `RainCover`.
    clear_out : float32 array (height, width)
    """
    height, width = depth.shape
    for row in prange(height):
        b = row_slope(view, row)
        for column in range(width):
            a = column_slope(view, column)
            clear_out[row, column] = transmittance(fog, depth[row, column], a, b)


@cpu_kernel
def encode(radiance, image_out):
    """Encode radiances (n,) float32 for display, to uint8 (n,)."""
    for n in prange(len(radiance)):
        image_out[n] = eight_bit(tone_curve(radiance[n]))
