"""From the dry picture to the rainy one: formulas of grading and wetting; air and display.

Everything is linear light, radiance relative to display white. `grade` lays the formulas over a
picture once per camera, `compose` runs once per frame.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.chunks import CHUNK
from rainsim.jit import cpu_kernel, device_function, inlined_function, prange, serial_kernel
from rainsim.light import (
    bilinear,
    display_from_linear,
    exp_minus,
    fresnel,
    linear_from_display,
    luminance,
    smoothstep,
)
from rainsim.sky import sample_environment
from rainsim.walls import damp_off_ground

ZERO = np.float32(0)
ONE = np.float32(1)
TWO = np.float32(2)
FOUR = np.float32(4)
HALF = np.float32(0.5)


# Wetting: ratio of wet to dry albedo, Lekner and Dorf 1988 after Angstrom, see `wet_ratio`.
ESCAPE = np.float32(0.066)  # diffuse light reflected by the film from outside
TRAPPED = np.float32(0.4746)  # light reflected back by the film from inside
ALBEDO_PER_COLOR = np.float32(0.85)  # sunlit captured colour to albedo: a guess, light is baked in

GLOSS = np.float32(0.3)  # of a smooth mirror: what a film on rough stone reflects; by eye
GLOSS_LIFT = np.float32(0.3)  # sine by which its lobe is lifted above the mirror direction
FAR_AWAY = np.float32(1e4)  # m, stands for the depth of the sky
FILLING = np.float32(1.55)  # of the similarity: its asymmetry goes from some 0.64 to 0.85
WALL_SHARE = np.float32(0.15)  # of the depth by which a wall's plane may differ from it
SHINES = np.float32(1.5)  # linear luminance that nothing has in a capture but what shines
SKY_DARK, SKY_BRIGHT = np.float32(0.10), np.float32(0.22)  # linear luminance: no sky, all sky
EDGE_COSINE = np.float32(0.25)  # of the view to a thing's surface, below which it glosses less
FLAT = np.float32(0.7)  # cosine to the vertical above which a surface counts as level ground
TO_BORDER = np.float32(1.01)  # cells before the map's end that interpolation still reaches
LEAST_SKY = np.float32(0.002)  # share of sky that does not change an 8-bit picture
OPAQUE, LEAST_COVER = np.float32(0.99), np.float32(1e-3)  # alpha that hides all, and next to none
LEAST_ALPHA = np.float32(0.1)  # what covers less of a pixel has no depth
ON_GROUND = np.float32(0.3)  # m over the bed: what stands higher is no ground
OPEN_LOW, OPEN_HIGH = np.float32(-0.12), np.float32(-0.06)  # from which an open sky shows
SKY_SINE = np.float32(0.03)  # sine of the elevation above which there may be sky

# Rows of a chunk of `compose`: what air, streaks and splashes let through, light of drops, colours.
(CLEAR, RAIN, SPLASH, DROP, RED, GREEN, BLUE) = (CHUNK * k for k in range(7))
COMPOSED = 7 * CHUNK


@inlined_function
def wet_ratio(albedo):
    """Return the albedo of a rough surface under a film of water over its dry albedo.

    (1 - R_e) (1 - p) / (1 - p a), Lekner and Dorf 1988 (Appl. Opt. 27), the
    surface itself unchanged.
    """
    return (ONE - ESCAPE) * (ONE - TRAPPED) / (ONE - TRAPPED * albedo)


@inlined_function
def graded(r, g, b, exposure, desaturation, compression):
    """Return captured linear colour as it looks under a dull sky: darker, greyer, flatter.

    `compression` pulls down what lies above a quarter of white: sunlit patches. What is brighter
    than SHINES is a lamp and not lit by the day: so much of it as exceeds that is left as it is.
    """
    y = luminance(r, g, b)
    own = max(ONE - SHINES / max(y, SHINES), ZERO)  # share of its light
    y *= ONE - own
    gain = exposure / (ONE + max(y * exposure - np.float32(0.25), ZERO) * compression)
    keep, lit = (ONE - desaturation) * gain, y * desaturation * gain
    kept = (ONE - own) * keep + own
    return lit + r * kept, lit + g * kept, lit + b * kept


@device_function
def film_cover(ground, origin, spacing, x, y, clearance, upness, lawn, film):
    """Return the share of a full film on the ground at (x, y), as `wet_state` tells of it."""
    if not clearance < FAR_AWAY:  # off the map: as at its border
        u, v = (x - origin[0]) / spacing - HALF, (y - origin[1]) / spacing - HALF
        u = min(max(u, ZERO), np.float32(ground.shape[1]) - TO_BORDER)
        v = min(max(v, ZERO), np.float32(ground.shape[0]) - TO_BORDER)
        lawn, _, film, _ = on_ground(ground, u, v)
    return film * (TWO * upness - ONE) * (ONE - lawn)


@cpu_kernel
def grade_rays(
    color, alpha, distance, plane_distance, normal, eye, direction,
    bed, ground, origin, spacing, environment, day_sky, look, others, light_out,
):  # fmt: skip
    """Grade and wet what rays have met, as `grade` does a picture.

    Parameters
    ----------
    color, alpha
        As `traced.Traced` has them.
    distance, plane_distance : ndarray of shape (n,), float32 [m]
        Along each ray from its `eye` (n, 3) [m] in its unit `direction` (n, 3), ground frame.
    normal : ndarray of shape (n, 3), float32
        Ground frame.
    light_out : ndarray of shape (n, 3), float32
        Linear radiance.
    """
    for n in prange(len(alpha)):
        x, y, z = direction[n, 0], direction[n, 1], direction[n, 2]
        upness = normal[n, 2]
        d = plane_distance[n] if upness > FLAT else distance[n]
        _, height_here, lawn, damp, film, pores = wet_state(
            bed, ground, origin, spacing, others, alpha[n] >= LEAST_ALPHA,
            eye[n, 0] + d * x, eye[n, 1] + d * y, eye[n, 2] + d * z,
            normal[n, 0], normal[n, 1], upness, d,
        )  # fmt: skip
        r, g, b = undiluted(
            color[n, 0], color[n, 1], color[n, 2],
            alpha[n] if is_edge(alpha[n], look[5]) else ONE,
        )  # fmt: skip
        r, g, b, gloss, through = rainy(
            r, g, b, alpha[n], d, z,
            -(x * normal[n, 0] + y * normal[n, 1] + z * upness), upness, height_here,
            lawn, damp, film, pores, look[0], look[1], look[2], look[3], look[4], look[5],
        )  # fmt: skip
        if gloss > ZERO:
            e0, e1, e2 = glossed(environment, x, y, z)
            r, g, b = r + gloss * e0, g + gloss * e1, b + gloss * e2
        if through > LEAST_SKY:
            e0, e1, e2 = sample_environment(day_sky, x, y, z)
            r, g, b = r + through * e0, g + through * e1, b + through * e2
        light_out[n, 0], light_out[n, 1], light_out[n, 2] = r, g, b


@inlined_function
def wet_state(bed, ground, origin, spacing, others, solid, x, y, z, nx, ny, nz, far):
    """Return how wet a surface with the unit normal n at (x, y, z) is, seen from `far` [m].

    Its height over the bed [m] (FAR_AWAY off the map), its height [m] over the bed or off the map
    over the ground plane, and its lawn, dampness, film and porosity.
    """
    rows, columns = bed.shape
    u, v = (x - origin[0]) / spacing - HALF, (y - origin[1]) / spacing - HALF
    inside = u > ZERO and v > ZERO
    inside = inside and u < np.float32(columns - 1) and v < np.float32(rows - 1)
    if not solid:
        return FAR_AWAY, FAR_AWAY, ZERO, ZERO, ZERO, ZERO
    clearance = z - bilinear(bed, u, v) if inside else FAR_AWAY
    height = clearance if inside else z
    if clearance < ON_GROUND and nz > FLAT:
        lawn, damp, film, pores = on_ground(ground, u, v)
        return clearance, height, lawn, damp, film, pores
    damp = damp_off_ground(others, nx, ny, nz, x, y, z, height, far)
    return clearance, height, ZERO, damp, film_off_ground(others, damp, height), others[4]


@inlined_function
def film_off_ground(others, damp, height):
    """Return the film of a surface of some dampness that is no ground, at a height [m]."""
    return damp * others[3] * (ONE if height < ON_GROUND else HALF)


@inlined_function
def rainy(
    r, g, b, over, far, z, cosine, upness, height, lawn, damp, film, pores,
    exposure, desaturation, compression, sky_replaced, sky_distance, open_sky,
):  # fmt: skip
    """Return the colour in the rain of what was captured, and the shares of gloss and of sky in it.

    `far` is its distance [m], z the sine of the elevation that it is seen at, `over` its alpha,
    `cosine` the one between its normal and the way back; the rest is as `wet_state` and
    `grade.grade_and_wet` have it. The colour of what `is_edge` is given as if it covered all.
    """
    sky, gloss = ZERO, ZERO
    if far > sky_distance and z > SKY_SINE:
        sky = sky_share(r, g, b)
        damp *= ONE - sky
        sky *= sky_replaced
    r, g, b = graded(r, g, b, exposure, desaturation, compression)
    if damp > ZERO:
        r, g, b = wetted(r, g, b, exposure, damp, pores, lawn)
        gloss = film * max(TWO * upness - ONE, ZERO) * (ONE - lawn) * GLOSS
        if gloss > ZERO:
            gloss *= fresnel(max(cosine, np.float32(0.02)))
            if height > ON_GROUND:  # blended normals of edges look grazed; they are not
                gloss *= smoothstep(ZERO, EDGE_COSINE, cosine)
    # The sky of the day stands in for the captured sky and for what no splat covers. Many
    # captures leave dark places half open: those are not sky.
    through, keep = over * sky, ONE - sky
    if open_sky > ZERO:
        keep *= over if is_edge(over, open_sky) else ONE
        through += (ONE - over) * smoothstep(OPEN_LOW, OPEN_HIGH, z)
    elif z > ZERO:
        through += (ONE - over) * smoothstep(np.float32(0.4), np.float32(0.9), ONE - over)
    return r * keep, g * keep, b * keep, gloss * keep, through


@inlined_function
def is_edge(over, open_sky):
    """Tell whether a sky behind shows past what covers a share `over` of a pixel."""
    return open_sky > ZERO and over < OPAQUE


@inlined_function
def undiluted(r, g, b, over):
    """Return the linear colour of what covers a share `over`, shown as (r, g, b) over black."""
    inv = ONE / max(over, LEAST_COVER)
    return (
        linear_from_display(max(r, ZERO) * inv),
        linear_from_display(max(g, ZERO) * inv),
        linear_from_display(max(b, ZERO) * inv),
    )


@cpu_kernel
def dampness(
    depth, clearance, normal, ground_from_camera, eye, lens, ground, origin, spacing, others,
    damp_out,
):  # fmt: skip
    """Write how wet what a picture shows is, 0 to 1; zero for the sky. For layers.

    Parameters are those of `grade.grade_and_wet`; depth [m] and clearance [m] as it left them.
    """
    height, width = depth.shape
    m = ground_from_camera
    for row in prange(height):
        b = (np.float32(row) + HALF - lens[3]) / lens[1]
        for column in range(width):
            a = (np.float32(column) + HALF - lens[2]) / lens[0]
            d = depth[row, column]
            damp_out[row, column] = ZERO
            if not d < FAR_AWAY:
                continue
            x, y = eye[0] + d * _row(m, 0, a, b, ONE), eye[1] + d * _row(m, 1, a, b, ONE)
            n0, n1, n2 = normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]
            upness = _row(m, 2, n0, n1, n2)
            if clearance[row, column] < ON_GROUND and upness > FLAT:
                u, v = (x - origin[0]) / spacing - HALF, (y - origin[1]) / spacing - HALF
                damp_out[row, column] = on_ground(ground, u, v)[1]
            else:
                z, above = eye[2] + d * _row(m, 2, a, b, ONE), clearance[row, column]
                damp_out[row, column] = damp_off_ground(
                    others, _row(m, 0, n0, n1, n2), _row(m, 1, n0, n1, n2), upness, x, y, z,
                    above if above < FAR_AWAY else z, d,
                )  # fmt: skip


@device_function
def glossed(environment, x, y, z):
    """Return what a wet rough surface seen along the unit direction (x, y, z) mirrors, blurred.

    That is mostly what lies above the mirror direction.
    """
    return sample_environment(environment, x, y, abs(z) + GLOSS_LIFT)


@inlined_function
def sky_share(r, g, b):
    """Return how surely a far captured linear colour above the horizon is sky: bright, not green.

    A guess: a capture does not say what is sky.
    """
    bright = smoothstep(SKY_DARK, SKY_BRIGHT, luminance(r, g, b))
    top = max(max(r, g), np.float32(1e-3))
    return bright * smoothstep(np.float32(0.6), np.float32(0.85), b / top)


@inlined_function
def _row(matrix, i, x, y, z):
    return matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2] * z


@device_function
def on_ground(ground, u, v):
    """Return lawn, dampness, gloss and porosity of the ground at column u and row v."""
    i, j = int(u), int(v)
    a, b = u - np.float32(i), v - np.float32(j)
    w0, w1, w2, w3 = (ONE - a) * (ONE - b), a * (ONE - b), (ONE - a) * b, a * b
    p, q, s, t = ground[j, i], ground[j, i + 1], ground[j + 1, i], ground[j + 1, i + 1]
    return (
        p[0] * w0 + q[0] * w1 + s[0] * w2 + t[0] * w3,
        p[2] * w0 + q[2] * w1 + s[2] * w2 + t[2] * w3,
        p[3] * w0 + q[3] * w1 + s[3] * w2 + t[3] * w3,
        p[4] * w0 + q[4] * w1 + s[4] * w2 + t[4] * w3,
    )


@inlined_function
def filled_ratio(albedo):
    """Return the albedo of a porous surface whose pores are full of water over its dry albedo.

    In water grains scatter less sideways, so that light goes deeper and less comes back (Twomey,
    Bohren and Mergenthaler 1986, Appl. Opt. 25). Here by the albedo of a deep layer,
    (1 - s)(1 - 0.139 s) / (1 + 1.17 s) with the similarity s (van de Hulst 1980, table 12.1), and s
    larger by FILLING when the pores are full.
    """
    a = np.float32(0.139)
    b = np.float32(1.139) + np.float32(1.17) * albedo
    s = (b - math.sqrt(b * b - FOUR * a * (ONE - albedo))) / (TWO * a)
    s = min(s * FILLING, ONE)
    return (ONE - s) * (ONE - a * s) / (ONE + np.float32(1.17) * s) / albedo


@inlined_function
def wetted(r, g, b, exposure, damp, pores, lawn):
    """Return the graded colour of a surface that is damp, 0 to 1.

    Darkened by the wet/dry albedo ratio with the albedo guessed from the colour: that of a film,
    and for the share `pores` that of filled pores; little on leaves, which shed water and shine;
    and more saturated.
    """
    top = max(max(r, g), b)
    green = min(max((TWO * g - r - b) / max(top, np.float32(1e-3)) * TWO, ZERO), ONE)
    amount = damp * (ONE - np.float32(0.55) * max(green, lawn))
    y = luminance(r, g, b)
    albedo = min(max(y / exposure * ALBEDO_PER_COLOR, np.float32(0.02)), np.float32(0.8))
    ratio = wet_ratio(albedo)
    ratio += pores * (min(filled_ratio(albedo), ratio) - ratio)
    darker = ONE - amount * (ONE - ratio)
    richer = ONE + np.float32(0.25) * amount
    return (
        max(y + (r - y) * richer, ZERO) * darker,
        max(y + (g - y) * richer, ZERO) * darker,
        max(y + (b - y) * richer, ZERO) * darker,
    )


@device_function
def fog_thickness(fog, z):
    """Return the optical depth up to depth z [m] that a fog table holds."""
    steps = fog.shape[0] - 3
    at = min(z / fog[0], ONE) * np.float32(steps)
    i = min(int(at), steps - 1)
    within = fog[2 + i] + (fog[3 + i] - fog[2 + i]) * (at - np.float32(i))
    return within + fog[1] * max(z - fog[0], ZERO)


@device_function
def field_place(pixel, count, places):
    """Return where between `places` from edge to edge of `count` pixels the pixel's middle is."""
    return (np.float32(pixel) + HALF) * (np.float32(places - 1) / np.float32(count))


@inlined_function
def splash_light(drop, around):
    """Return the radiance of splashes where that of drops is `drop`.

    Half of what a crown shows is taken to come through its rim and its droplets, which are bent as
    drops are, and half off its sheets, which stand all ways and mirror what is all `around`.
    """
    return HALF * (drop + around)


@cpu_kernel
def compose(
    picture, depth, rain_alpha, splash_alpha, drop_radiance, around, air_radiance, fog, lens,
    brightness, image_out,
):  # fmt: skip
    """Put fog, streaks and splashes before the picture and encode it for display.

    Parameters
    ----------
    rain_alpha, splash_alpha : ndarray of shape (height, width), float32
    drop_radiance : ndarray of shape (m, n, 3), float32
        At places from edge to edge of the picture, see `droplight.drop_field`.
    around : ndarray of shape (3,), float32
        Mean radiance of everything: half of what splashes show, see `splash_light`.
    air_radiance : ndarray of shape (3,), float32
    fog : ndarray of shape (n + 3,), float32
        Of drops that are not drawn, see `streaks.fog_table`: a depth [m], the extinction beyond it
        [1/m] and the optical depth at n + 1 even steps up to it.
    lens : ndarray of shape (4,), float32
        fx, fy, cx, cy [px]; towards the corners the way through the air is longer than the depth.
    image_out : ndarray of shape (height, width, 3), uint8
    """
    height, width = depth.shape
    light, image = picture.reshape(height, width * 3), image_out.reshape(height, width * 3)
    places = drop_radiance.shape[1]
    for row in prange(height):
        s, line = np.empty(COMPOSED, np.float32), np.empty(places, np.float32)
        v = field_place(row, height, drop_radiance.shape[0])
        j = int(v)
        below = v - np.float32(j)
        b = (np.float32(row) + HALF - lens[3]) / lens[1]
        for left in range(0, width, CHUNK):
            end = min(left + CHUNK, width)
            n = end - left
            look_through(depth[row, left:end], fog, lens, b, left, n, s)
            take_covers(rain_alpha[row, left:end], splash_alpha[row, left:end], n, s)
            take_colors(light[row, 3 * left : 3 * end], n, s)
            for c in range(3):
                for k in range(places):
                    upper, lower = drop_radiance[j, k, c], drop_radiance[j + 1, k, c]
                    line[k] = upper + (lower - upper) * below
                light_drops(line, left, width, n, s)
                color = s[RED + c * CHUNK : RED + (c + 1) * CHUNK]
                mix(s, color, n, air_radiance[c], around[c], brightness)
            give_colors(n, s, image[row, 3 * left : 3 * end])


@inlined_function
def look_through(depth, fog, lens, b, left, n, s):
    """Find how clear the air before n pixels of a row at height b is."""
    f, c, square = lens[0], lens[2], ONE + b * b
    for i in range(n):
        s[CLEAR + i] = fog_thickness(fog, min(depth[i], FAR_AWAY))
    for i in range(n):
        a = (np.float32(left + i) + HALF - c) / f
        s[CLEAR + i] = exp_minus(s[CLEAR + i] * math.sqrt(square + a * a))
    for i in range(n):  # the sky is seen through all the air already
        s[CLEAR + i] = s[CLEAR + i] if depth[i] < FAR_AWAY else ONE


@inlined_function
def take_covers(rain, splash, n, s):
    """Take over what streaks and splashes leave open."""
    for i in range(n):
        s[RAIN + i] = ONE - rain[i]
    for i in range(n):
        s[SPLASH + i] = ONE - splash[i]


@inlined_function
def take_colors(light, n, s):
    """Take over the light of n pixels."""
    for i in range(n):
        s[RED + i], s[GREEN + i], s[BLUE + i] = light[3 * i], light[3 * i + 1], light[3 * i + 2]


@inlined_function
def light_drops(line, left, width, n, s):
    """Interpolate the light of drops between the places of a line."""
    places = len(line)
    scale = np.float32(places - 1) / np.float32(width)
    for i in range(n):
        u = (np.float32(left + i) + HALF) * scale
        k = np.uint32(np.int32(u))
        s[DROP + i] = line[k] + (line[k + np.uint32(1)] - line[k]) * (u - np.float32(k))


@serial_kernel
def mix(s, color, n, air, around, brightness):
    """Put air, splashes and streaks before a colour and encode it, 0 to 1."""
    for i in range(n):
        drop = s[DROP + i]
        value = air + (color[i] - air) * s[CLEAR + i]
        thrown = splash_light(drop, around)
        value = thrown + (value - thrown) * s[SPLASH + i]
        value = (drop + (value - drop) * s[RAIN + i]) * brightness
        # A soft shoulder: highlights end at white instead of being cut off.
        over = max(value - HALF, ZERO)
        value = min(value, HALF) + HALF * (ONE - exp_minus(over * TWO))
        color[i] = min(display_from_linear(max(value, ZERO)), ONE)


@inlined_function
def give_colors(n, s, image_out):
    """Write n pixels of 8 bit."""
    white = np.float32(255)
    for i in range(n):
        image_out[3 * i] = np.uint8(np.int32(s[RED + i] * white + HALF))
        image_out[3 * i + 1] = np.uint8(np.int32(s[GREEN + i] * white + HALF))
        image_out[3 * i + 2] = np.uint8(np.int32(s[BLUE + i] * white + HALF))
