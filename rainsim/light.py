"""Scalar formulas of light and of looking things up, shared by the shading kernels."""

from __future__ import annotations

import math

import numpy as np

from rainsim.jit import device_function, inlined_function

ZERO = np.float32(0)
ONE = np.float32(1)
THREE = np.float32(3)
TWO = np.float32(2)
HALF = np.float32(0.5)

LUMA_R, LUMA_G, LUMA_B = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)  # Rec. 709
BRIGHTEST = np.float32(4)  # display value, 27 times white: more is a flaw of a capture
PI, HALF_PI = np.float32(np.pi), np.float32(np.pi / 2)

# Polynomials, minimax fits of ours: x^1.6, x^(10/3), exp(-x) up to 1.25 and atan(x)/x in x^2.
D0, D1, D2 = np.float32(-0.0180342311), np.float32(0.280658696), np.float32(0.960916507)
D3, D4, D5 = np.float32(-0.3063445), np.float32(0.097504342), np.float32(-0.0147001988)
E0, E1, E2 = np.float32(-0.00304723237), np.float32(0.0311847871), np.float32(-0.154336153)
E3, E4, E5 = np.float32(0.861662725), np.float32(0.29686102), np.float32(-0.0323252575)
F0, F1, F2 = np.float32(0.999999886), np.float32(-0.999992266), np.float32(0.499910354)
F3, F4, F5 = np.float32(-0.166263489), np.float32(0.040776423), np.float32(-0.007285826)
F6 = np.float32(0.000734393271)
A0, A1, A2 = np.float32(0.999996091), np.float32(-0.333017824), np.float32(0.195822437)
A3, A4, A5 = np.float32(-0.121762629), np.float32(0.0580767676), np.float32(-0.0137205868)

REFRACTIVE_INDEX = np.float32(1.333)  # of water against air, visible light
SCHLICK_0 = np.float32(0.0204)  # reflectance at normal incidence


@inlined_function
def pixel_ray(m, lens, row, column):
    """Return the ray (x, y, z) through a pixel's middle, ground frame, 1 along the view axis.

    `m` is ground_from_camera (3, 3), `lens` fx, fy, cx, cy [px].
    """
    a = (np.float32(column) + HALF - lens[2]) / lens[0]
    b = (np.float32(row) + HALF - lens[3]) / lens[1]
    return (
        m[0, 0] * a + m[0, 1] * b + m[0, 2], m[1, 0] * a + m[1, 1] * b + m[1, 2],
        m[2, 0] * a + m[2, 1] * b + m[2, 2],
    )  # fmt: skip


@inlined_function
def linear_from_display(c):
    """Return linear light of a display-referred value (IEC 61966-2-1), within 4e-6 of it.

    By square roots and a polynomial for x^1.6 in x^(1/4): no library call, so that loops over it
    run in vectors. Values above BRIGHTEST count as that.
    """
    x = (min(c, BRIGHTEST) + np.float32(0.055)) * np.float32(1 / 1.055)
    t = math.sqrt(math.sqrt(max(x, ZERO)))
    p = D0 + t * (D1 + t * (D2 + t * (D3 + t * (D4 + t * D5))))
    return c * np.float32(1 / 12.92) if c <= np.float32(0.04045) else x * x * p


@device_function
def display_from_linear(c):
    """Return the display-referred value of linear light up to 1 (IEC 61966-2-1), within 1e-6.

    x^(1/2.4) is a polynomial in x^(1/8).
    """
    t = math.sqrt(math.sqrt(math.sqrt(max(c, ZERO))))
    p = E0 + t * (E1 + t * (E2 + t * (E3 + t * (E4 + t * E5))))
    low = c * np.float32(12.92)
    return low if c <= np.float32(0.0031308) else np.float32(1.055) * p - np.float32(0.055)


@inlined_function
def exp_minus(x):
    """Return exp(-x) for x from 0 on, within 3e-6 of it; 0 from 20 on."""
    t = min(x, np.float32(20)) * np.float32(1 / 16)
    p = F0 + t * (F1 + t * (F2 + t * (F3 + t * (F4 + t * (F5 + t * F6)))))
    p = p * p
    p = p * p
    p = p * p
    return p * p


@inlined_function
def angle(y, x):
    """Return the angle [rad] of the point (x, y) as atan2 does, within 1e-5."""
    ax, ay = abs(x), abs(y)
    t = min(ax, ay) / max(max(ax, ay), np.float32(1e-30))
    s = t * t
    r = t * (A0 + s * (A1 + s * (A2 + s * (A3 + s * (A4 + s * A5)))))
    r = HALF_PI - r if ay > ax else r
    r = PI - r if x < ZERO else r
    return -r if y < ZERO else r


@inlined_function
def luminance(r, g, b):
    """Return the luminance of linear Rec. 709 light."""
    return LUMA_R * r + LUMA_G * g + LUMA_B * b


@device_function
def bilinear(field, u, v):
    """Return `field` (rows, columns) at column u, row v, cell centres at whole numbers; clamped."""
    rows, columns = field.shape
    u = min(max(u, ZERO), np.float32(columns - 1))
    v = min(max(v, ZERO), np.float32(rows - 1))
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    upper = field[j, i] * (ONE - a) + field[j, i + 1] * a
    lower = field[j + 1, i] * (ONE - a) + field[j + 1, i + 1] * a
    return upper * (ONE - b) + lower * b


@inlined_function
def fresnel(cosine):
    """Return the reflectance of smooth water for unpolarised light, exact dielectric."""
    c = min(max(cosine, ZERO), ONE)
    t = math.sqrt(ONE - (ONE - c * c) / (REFRACTIVE_INDEX * REFRACTIVE_INDEX))
    s = (c - REFRACTIVE_INDEX * t) / (c + REFRACTIVE_INDEX * t)
    p = (REFRACTIVE_INDEX * c - t) / (REFRACTIVE_INDEX * c + t)
    return HALF * (s * s + p * p)


@device_function
def schlick(cosine):
    """Return Schlick's approximation (1994): 15 % low at 60 degrees, 14 % high at 80."""
    c = ONE - min(max(cosine, ZERO), ONE)
    return SCHLICK_0 + (ONE - SCHLICK_0) * (c * c) * (c * c) * c


@inlined_function
def smoothstep(low, high, x):
    """Return 0 below `low`, 1 above `high` and a smooth cubic between."""
    s = min(max((x - low) / (high - low), ZERO), ONE)
    return s * s * (THREE - TWO * s)


@device_function
def bilinear_color(picture, u, v):
    """Return the colour of `picture` at image point (u, v), interpolated, clamped to the edge."""
    rows, columns = picture.shape[0], picture.shape[1]
    u = min(max(u - HALF, ZERO), np.float32(columns - 1))
    v = min(max(v - HALF, ZERO), np.float32(rows - 1))
    # Without a sign: negative places would count from the end, which costs a test at each.
    i, j = np.uint32(u), np.uint32(v)
    k = np.uint32(min(np.float32(i) + ONE, np.float32(columns - 1)))
    m = np.uint32(min(np.float32(j) + ONE, np.float32(rows - 1)))
    return four_colors(picture, j, m, i, k, u - np.float32(i), v - np.float32(j))


@device_function
def four_colors(picture, j, m, i, k, a, b):
    """Return the mix of the colours of rows j and m, columns i and k, by shares a and b."""
    upper, lower = ONE - b, b
    w0, w1, w2, w3 = upper * (ONE - a), upper * a, lower * (ONE - a), lower * a
    return (
        picture[j, i, 0] * w0 + picture[j, k, 0] * w1
        + picture[m, i, 0] * w2 + picture[m, k, 0] * w3,
        picture[j, i, 1] * w0 + picture[j, k, 1] * w1
        + picture[m, i, 1] * w2 + picture[m, k, 1] * w3,
        picture[j, i, 2] * w0 + picture[j, k, 2] * w1
        + picture[m, i, 2] * w2 + picture[m, k, 2] * w3,
    )  # fmt: skip
