"""Lamps in the level picture of wet ground: what is brighter than BRIGHT becomes a few sources.

Bright pixels that touch are one source, but no source reaches over a square of TILE x TILE pixels.
The bright pixels of a square are the bits of one number, row by row. Both backends call these
functions; in `find_lamps` one thread takes all squares.
"""

import math

import numpy as np

from rainsim.constants import SH_0
from rainsim.jit import device_function, inlined_function, serial_kernel
from rainsim.numerics.srgb import linear

BRIGHT = 3.0  # radiance from which on light is a lamp's, in units of the capture's white
TILE = 8  # px: 64 pixels are the bits of a number
MOST_IN_TILE = TILE * TILE // 4  # sources of which no two touch
NUMBERS = 8  # of a lamp, see `lamp_images.LampView`
_ONE, _ROW, _NONE = np.uint64(1), np.uint64(TILE), np.uint64(0)
_NOT_FIRST = np.uint64(0xFEFEFEFEFEFEFEFE)  # pixels that have one to the left in their square
_NOT_LAST = np.uint64(0x7F7F7F7F7F7F7F7F)


def lamps_in(picture, depth, camera):
    """Return the lamps of a level picture as in `LampView`, and the light that they have of all.

    picture : float32 array (height, width, 3). Of the level camera mirrored at
        the ground plane.
    depth : float32 array (height, width) [m]
    camera : Camera. As `level_camera` returns it.
    """
    horizon = round(camera.cy)
    if not picture[horizon:].size or picture[horizon:].max() <= BRIGHT:
        return np.empty((0, NUMBERS), np.float32), 0.0
    lamps = np.empty((room_for(*depth.shape), NUMBERS), np.float32)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    eye, forward = camera.position * (1, 1, -1), camera.forward[:2]
    sums = np.empty(3)
    find_lamps(
        picture, depth, horizon, lens, eye.astype(np.float32), forward.astype(np.float32), lamps,
        sums,
    )  # fmt: skip
    count, excess, total = sums
    return lamps[: int(count)].copy(), excess / total if count else 0.0


def may_shine(splats):
    """Return whether any of splats is as bright as a lamp, seen from all sides alike."""
    shown = splats.sh[:, 0].max(initial=-np.inf)
    return bool(linear(0.5 + SH_0 * np.float64(shown)) > BRIGHT)


def room_for(height, width):
    """Return how many lamps a picture of a size [px] may have at most."""
    return -(-height // TILE) * -(-width // TILE) * MOST_IN_TILE


@serial_kernel
def find_lamps(picture, depth, horizon, lens, eye, forward, lamps_out, sums_out):
    """Find the lamps of a level picture, square by square.

    picture : float32 array (height, width, 3)
    depth : float32 array (height, width) [m]
    horizon : int. First row that counts.
    lens : float32 array (4,) [px]
    eye : float32 array (3,) [m]. Of the mirrored camera.
    forward : float32 array (2,). Unit: where the axis points to on the ground.
    lamps_out : float32 array (`room_for`, NUMBERS)
    sums_out : float64 array (3,). Number of lamps, their light and that of all
        pixels.
    """
    height, width = depth.shape
    across = (width + TILE - 1) // TILE
    count, excess, total = 0, 0.0, 0.0
    for n in range(horizon // TILE * across, (height + TILE - 1) // TILE * across):
        top, left = n // across * TILE, n % across * TILE
        bright, own, every = bright_pixels(picture, depth, top, left, horizon, height, width)
        excess += own
        total += every
        while bright != _NONE:
            part = first_part(bright)
            bright &= ~part
            write_lamp(part, picture, depth, top, left, lens, eye, forward, lamps_out, count)
            count += 1
    sums_out[0], sums_out[1], sums_out[2] = count, excess, total


@device_function
def bright_pixels(picture, depth, top, left, horizon, height, width):
    """Return the bright pixels of a square, their light above BRIGHT and that of all its pixels."""
    found, excess, total = np.uint64(0), 0.0, 0.0
    for k in range(TILE * TILE):
        row, column = top + k // TILE, left + k % TILE
        if row < horizon or row >= height or column >= width:
            continue
        r, g, b = picture[row, column, 0], picture[row, column, 1], picture[row, column, 2]
        light = np.float64(r) + np.float64(g) + np.float64(b)
        total += light
        brightest = max(r, max(g, b))
        if brightest > BRIGHT and math.isfinite(depth[row, column]):
            found |= _ONE << np.uint64(k)
            excess += light * (1.0 - BRIGHT / np.float64(brightest))
    return found, excess, total


@device_function
def first_part(bright):
    """Return the pixels that are connected with the first one of those of a square."""
    part = bright & (~bright + _ONE)
    while True:
        wide = part | ((part & _NOT_LAST) << _ONE) | ((part & _NOT_FIRST) >> _ONE)
        wide = (wide | (wide << _ROW) | (wide >> _ROW)) & bright
        if wide == part:
            return part
        part = wide


@inlined_function
def source(k, picture, depth, top, left, lens, eye, forward):
    """Return place [m], distance along the axis [m] and flux by channel [m2] of a bright pixel."""
    row, column = top + k // TILE, left + k % TILE
    far = np.float64(depth[row, column])
    a = (column + 0.5 - np.float64(lens[2])) / np.float64(lens[0])
    b = (row + 0.5 - np.float64(lens[3])) / np.float64(lens[1])
    x = np.float64(eye[0]) + far * (np.float64(forward[0]) + a * np.float64(forward[1]))
    y = np.float64(eye[1]) + far * (np.float64(forward[1]) - a * np.float64(forward[0]))
    z = np.float64(eye[2]) + far * b
    area = far * far / (np.float64(lens[0]) * np.float64(lens[1])) / math.sqrt(1.0 + a * a + b * b)
    r, g, b = (
        np.float64(picture[row, column, 0]), np.float64(picture[row, column, 1]),
        np.float64(picture[row, column, 2]),
    )  # fmt: skip
    share = area * (1.0 - BRIGHT / max(r, max(g, b)))
    return x, y, z, far, share * r, share * g, share * b


@device_function
def write_lamp(part, picture, depth, top, left, lens, eye, forward, lamps_out, n):
    """Write what some pixels of a square are together, row `n` of the lamps."""
    red, green, blue, x, y, z = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(TILE * TILE):
        if (part >> np.uint64(k)) & _ONE:
            px, py, pz, _, r, g, b = source(k, picture, depth, top, left, lens, eye, forward)
            red, green, blue = red + r, green + g, blue + b
            x, y, z = x + (r + g + b) * px, y + (r + g + b) * py, z + (r + g + b) * pz
    weight = red + green + blue
    x, y, z = x / weight, y / weight, z / weight
    across, up = 0.0, 0.0
    for k in range(TILE * TILE):
        if (part >> np.uint64(k)) & _ONE:
            px, py, pz, far, r, g, b = source(k, picture, depth, top, left, lens, eye, forward)
            aside = (px - x) * np.float64(forward[1]) - (py - y) * np.float64(forward[0])
            pixel = far / np.float64(lens[0])
            blur = pixel * pixel / 12.0
            across += (r + g + b) * (aside * aside + blur)
            up += (r + g + b) * ((pz - z) * (pz - z) + blur)
    lamps_out[n, 0], lamps_out[n, 1], lamps_out[n, 2] = x, y, z
    lamps_out[n, 3], lamps_out[n, 4], lamps_out[n, 5] = red, green, blue
    lamps_out[n, 6], lamps_out[n, 7] = across / weight, up / weight
