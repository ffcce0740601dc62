"""How water changes the look of a captured surface: formulas of darkening and gloss, and one pixel.

`wet_pixel` puts the formulas together for one point: CUDA threads and traced rays call it. Its twin
is `wet_pass.grade_row`, which calls the same formulas in the same order for a chunk of pixels: who
changes the order, or adds a step, changes both. `tests/shading/test_grade.py` fails when the two
differ. Colours are linear light, radiance relative to display white; places and normals are in the
ground frame.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import FAR_AWAY, FOUR, HALF, ONE, TWO, ZERO
from rainsim.jit import inlined_function
from rainsim.numerics.interpolation import map_place, smoothstep
from rainsim.shading.bodies import body_share
from rainsim.shading.color import luminance
from rainsim.shading.environment import sample_environment
from rainsim.shading.fresnel import reflectance
from rainsim.shading.grading import covered_share, graded, surface_color
from rainsim.shading.surface_point import (
    LEANS,
    NOT_POOR,
    SLOPES,
    SurfacePoint,
    ground_share,
    heights_of,
    is_surface,
    within,
)
from rainsim.shading.walls import damp_leaf, damp_off_ground
from rainsim.shading.wetness import Wetness, wetness_in

# Darkening: ratio of wet to dry albedo, Lekner and Dorf 1988 after Angstrom, see `wet_ratio`.
ESCAPE = np.float32(0.066)  # diffuse light that the water film reflects from outside
TRAPPED = np.float32(0.4746)  # diffuse light that the water film reflects back from inside
FILLING = np.float32(1.55)  # of the similarity: its asymmetry goes from some 0.64 to 0.85
LEAST_LEFT = np.float32(0.1)  # of the light: no factor on the darkening takes more away
LEAST_ALBEDO, MOST_ALBEDO = np.float32(0.02), np.float32(0.8)
DARK = np.float32(0.02)  # albedo below which a surface lies in deep shadow; by eye
# Shares of the darkening that leaves and lawns do without, for they shed water. Measured in visible
# light, turf wet with rain reflects 4 to 16 % more than dry, its gloss included (Madeira, Gillespie
# and Duke 2001, Agric. For. Meteorol. 107, 117). A lawn, which gets no gloss here, keeps some 0.93
# of its light; leaves keep some 0.88, and a sixth of their light is gloss besides.
LEAF_SHED, LAWN_SHED = np.float32(0.8), np.float32(0.9)
COATED = np.float32(0.7)  # the same of smooth things: paint and glazes have a coat when dry; by eye
GREENISH, GREEN = np.float32(0.2), np.float32(0.6)  # of yellow walls, and of leaves: what glosses
LEAFY = np.float32(0.35)  # mean cosine of leaves to the vertical, where normals are noise
LEAF_ALBEDO = np.float32(0.1)  # of leaves in the open, as of grass in classes.toml

GLOSS = np.float32(0.3)  # of a smooth mirror: what a water film on rough stone reflects; by eye
GLOSS_LIFT = np.float32(0.3)  # sine by which its lobe is lifted above the mirror direction
EDGE_COSINE = np.float32(0.25)  # of the view to a thing's surface, below which it glosses less
# Porosity, over one, below which the water that covers a thing mirrors as a smooth coat.
SMOOTH = np.float32(10)
COAT_GRAZING, COAT_EDGE = np.float32(0.08), np.float32(0.12)  # as GRAZING and EDGE_COSINE
SHADOWED = np.float32(0.6)  # m over the ground, below which a thing mirrors its shadow; by eye
MIRROR = TWO  # in place of a share of leaves: a coat of water on a smooth thing
TALLER = np.float32(3)  # m over the ground, above which there are no bodies
GRAZING = np.float32(0.02)  # least cosine that Fresnel's factor is taken at
# The same of leaves: one on edge fills no pixel, and the normal there is that of others. By eye.
LEAF_GRAZING = np.float32(0.5)
# Length of the mean of noisy normals, and of fair ones.
UNLIKE, ALIKE = np.float32(0.4), np.float32(0.8)
OPEN_LOW, OPEN_HIGH = np.float32(-0.12), np.float32(-0.06)  # sines from which an open sky shows
HOLE, GAP = np.float32(0.2), np.float32(0.6)  # of a pixel left open: a flaw, and the sky
LEAST_SKY = np.float32(0.002)  # share of sky that does not change an 8-bit picture


class SkyMaps(NamedTuple):
    """Environment maps in the ground frame, (rows, columns, 3) float32; read-only."""

    gloss: np.ndarray  # the surroundings, blurred as wet rough surfaces mirror them
    coat: np.ndarray  # the surroundings, blurred as a coat of water on a smooth thing mirrors them
    behind: np.ndarray  # the sky that is seen behind the scene


@inlined_function
def wet_ratio(albedo):
    """Return the albedo of a rough surface under a water film over its dry albedo.

    (1 - R_e) (1 - p) / (1 - p a) with the albedo a of the surface itself unchanged, Lekner and
    Dorf 1988 (Appl. Opt. 27): R_e is ESCAPE, p is TRAPPED.
    """
    return (ONE - ESCAPE) * (ONE - TRAPPED) / (ONE - TRAPPED * albedo)


@inlined_function
def filled_ratio(albedo):
    """Return the albedo of a porous surface whose pores are full of water over its dry albedo.

    Grains scatter less sideways in water than in air, so that light goes deeper and less comes back
    (Twomey, Bohren and Mergenthaler 1986, Appl. Opt. 25). By the albedo of a deep layer,
    (1 - s)(1 - 0.139 s) / (1 + 1.17 s) with the similarity s (van de Hulst 1980, table 12.1), and s
    larger by FILLING when the pores are full.
    """
    a = np.float32(0.139)
    b = np.float32(1.139) + np.float32(1.17) * albedo
    s = (b - math.sqrt(b * b - FOUR * a * (ONE - albedo))) / (TWO * a)
    s = min(s * FILLING, ONE)
    return (ONE - s) * (ONE - a * s) / (ONE + np.float32(1.17) * s) / albedo


@inlined_function
def greenness(r, g, b):
    """Return how surely a graded colour is that of leaves, 0 to 1."""
    top = max(max(r, g), b)
    return min(max((TWO * g - r - b) / max(top, np.float32(1e-3)) * TWO, ZERO), ONE)


@inlined_function
def leaf_share(r, g, b):
    """Return how surely a thing of a colour is leaves, 0 to 1."""
    return smoothstep(GREENISH, GREEN, greenness(r, g, b))


@inlined_function
def open_share(y, look):
    """Return which share of the sky a leaf of graded luminance y sees, 0 to 1.

    What reaches it stands to the light in the open as its colour stands to that of open leaves:
    leaves deep in a hedge are dark, and mirror other leaves.
    """
    return min(y / look.exposure * look.albedo / LEAF_ALBEDO, ONE)


@inlined_function
def lit_share(r, g, b, look):
    """Return which share of the surroundings a film on a captured linear colour mirrors, 0 to 1.

    What is darker than DARK is so for what stands over it: under a car, at the foot of a hedge. A
    film there mirrors that, which the capture seldom has, and no sky.
    """
    return smoothstep(ZERO, DARK, luminance(r, g, b) * look.albedo)


@inlined_function
def wetted(r, g, b, coat, wet, look):
    """Return the graded colour of a wet surface.

    Each channel is darker by the ratio of wet to dry albedo, see `wet_channel`: colours get
    somewhat more saturated. Leaves and lawns darken less, for they shed water, and so do smooth
    things, of which a share is `coat`: most of them are painted or glazed, and look dry as they
    would under water.
    """
    green = greenness(r, g, b)
    amount = wet.dampness * (ONE - max(max(LEAF_SHED * green, LAWN_SHED * wet.lawn), COATED * coat))
    amount *= look.wetness
    return (
        wet_channel(r, amount, wet.porosity, look), wet_channel(g, amount, wet.porosity, look),
        wet_channel(b, amount, wet.porosity, look),
    )  # fmt: skip


@inlined_function
def wet_channel(value, amount, porosity, look):
    """Return a graded channel of a surface of which an amount is wet.

    The albedo is guessed from the value: the ratio under a water film is mixed by the porosity with
    that of filled pores.
    """
    albedo = min(max(value / look.exposure * look.albedo, LEAST_ALBEDO), MOST_ALBEDO)
    ratio = wet_ratio(albedo)
    ratio += porosity * (min(filled_ratio(albedo), ratio) - ratio)
    return max(value, ZERO) * max(ONE - amount * (ONE - ratio), LEAST_LEFT)


@inlined_function
def on_ground(ground, u, v):
    """Return the `Wetness` of the ground at column u and row v, which lie within the map."""
    i, j = int(u), int(v)
    return wetness_in(ground.wetness, j, i, j + 1, i + 1, u - np.float32(i), v - np.float32(j))


@inlined_function
def off_ground(rain, damp, body, leaf, lit):
    """Return the `Wetness` of a surface that is no ground; smooth bodies have no pores.

    A share `leaf` is leaves: their film lies where they face up, and mirrors there.
    """
    even = damp + leaf * (damp_leaf(rain) - damp)
    return Wetness(ZERO, even, damp * rain.film_left * lit, rain.porosity * (ONE - body))


@inlined_function
def body_of(point, clearance, ground):
    """Return how surely a point off the ground is on a smooth body, 0 to 1."""
    if ground.bodies.shape[0] < 2 or not clearance < TALLER:
        return ZERO
    u, v = map_place(point.x, point.y, ground.origin, ground.spacing)
    u, v = within(ground, u, v)
    return body_share(ground.bodies, u, v, clearance, point.nz)


@inlined_function
def wetted_normal(r, g, b, height, point, around, layer):
    """Return the normal by which a surface gets wet and mirrors; see `smooth_normals`.

    r, g, b : float32. Captured linear colour: leaves keep their own normals.
    height : float32 [m]. Over the ground.
    point : SurfacePoint. With the pixel's own normal.
    around : tuple of 3 float32. Mean of its neighbourhood, the shorter the more
        normals differ there.
    layer : float32 [m]. Thickness of the splats about a bed that is poorly known,
        0 elsewhere.
    """
    x, y, z = around
    square = x * x + y * y + z * z
    length = math.sqrt(max(square, np.float32(1e-12)))
    inv = ONE / length
    x, y, z = x * inv, y * inv, z * inv
    leaf = leaf_share(r, g, b)
    if layer > ZERO:
        # Normals are noise there: a wall is upright, leaves face any way.
        sure = smoothstep(UNLIKE, ALIKE, length)
        z, leaf = sure * z + (ONE - sure) * leaf * LEAFY, ZERO
    # Of ground an upright normal is noise where those around it are level.
    own = smoothstep(LEANS, SLOPES, point.nz)
    leaf = max(leaf, own * ground_share(height, max(point.nz, z), NOT_POOR))
    leaf = leaf if square > np.float32(1e-6) else ONE
    x, y, z = x + leaf * (point.nx - x), y + leaf * (point.ny - y), z + leaf * (point.nz - z)
    inv = ONE / max(math.sqrt(x * x + y * y + z * z), np.float32(1e-6))
    return x * inv, y * inv, z * inv


@inlined_function
def with_normal(point, normal):
    """Return a `SurfacePoint` with another normal."""
    return SurfacePoint(
        point.x, point.y, point.z, normal[0], normal[1], normal[2], point.distance,
        point.ground,
    )  # fmt: skip


@inlined_function
def wet_state(point, clearance, height, level, leaf, lit, ground, rain):
    """Return how wet a surface is that is ground by a share `level`, else leaves by `leaf`.

    The heights are those of `heights_of`, `lit` is that of `lit_share`.
    """
    if not height < FAR_AWAY:
        return Wetness(ZERO, ZERO, ZERO, ZERO)
    mapped = level if clearance < FAR_AWAY else ZERO
    off = Wetness(ZERO, ZERO, ZERO, ZERO)
    if mapped < ONE:
        body = body_of(point, clearance, ground)
        # A dark pane mirrors the sky; where heights are noise it may be the shadow under a car.
        shown = max(lit, body) if ground.thickest_layer == ZERO else lit
        off = off_ground(rain, damp_off_ground(rain, point, height, body), body, leaf, shown)
    if mapped == ZERO:
        return off
    u, v = map_place(point.x, point.y, ground.origin, ground.spacing)
    u, v = within(ground, u, v)
    on, rest = on_ground(ground, u, v), ONE - mapped
    return Wetness(
        mapped * on.lawn + rest * off.lawn, mapped * on.dampness + rest * off.dampness,
        mapped * on.film * lit + rest * off.film, mapped * on.porosity + rest * off.porosity,
    )  # fmt: skip


@inlined_function
def mirror_cover(point, clearance, level, wet, ground, look):
    """Return the share of a full water film at a point, times `look.wetness`.

    A share `level` of it is ground, `clearance` is that of `heights_of`, `wet` that of `wet_state`.
    Off the map the film is that at the border.
    """
    lawn, film = wet.lawn, wet.film
    if not clearance < FAR_AWAY:
        u, v = map_place(point.x, point.y, ground.origin, ground.spacing)
        u, v = within(ground, u, v)
        border = on_ground(ground, u, v)
        lawn, film = border.lawn, border.film
    return level * look.wetness * film * max(TWO * point.nz - ONE, ZERO) * (ONE - lawn)


@inlined_function
def rainy_color(r, g, b, alpha, sine, cosine, upness, height, level, wet, look):
    """Return a captured surface's colour in the rain, and the shares of gloss and of sky.

    Level surfaces gloss as rough stone does. A leaf is a mirror of its own: its facet reflects by
    Fresnel's factor, as far as its surroundings are open. So does the coat of water on a smooth
    thing; what it mirrors does not reach what is below, so that in white surroundings nothing is
    brighter than white.

    r, g, b : float32. Captured linear colour, see `undiluted`.
    alpha : float32. Share of the pixel that the surface covers.
    sine : float32. Of the elevation that the surface is seen at.
    cosine : float32. Between its normal and the way back to the eye.
    upness : float32. Cosine between its normal and the vertical.
    height : float32 [m]. Over the ground.
    level : float32. How surely it is the ground, see `ground_share`.
    wet : Wetness
    Returns r, g, b : float32. Radiance that the surface adds to the pixel,
        without gloss.
        gloss, through : float32. Weights of the mirrored surroundings and of the
            sky behind.
        smooth : float32. How far the gloss is that of a leaf, 0 to 1, or MIRROR,
            see `glossed`.
    """
    gloss, smooth = ZERO, ZERO
    r, g, b = graded(r, g, b, look)
    thing = ONE - level
    leaf = thing * leaf_share(r, g, b)
    if wet.dampness > ZERO:
        coat = (thing - leaf) * max(ONE - SMOOTH * wet.porosity, ZERO)
        smooth = MIRROR if coat > leaf else leaf
        gloss = (ONE - leaf - coat) * max(TWO * upness - ONE, ZERO) * (ONE - wet.lawn) * GLOSS
        gloss *= level + thing * (HALF if height > look.tops_end else ZERO)  # broken; by eye
        # What is low mirrors the road below the thing itself, which is dark.
        coat_gloss = coat * smoothstep(ZERO, SHADOWED, height)
        film = wet.film * look.wetness
        covered = min(film, ONE) * coat_gloss  # a coat mirrors no more than all that it can
        gloss = film * (gloss + leaf * open_share(luminance(r, g, b), look)) + covered
        r, g, b = wetted(r, g, b, coat, wet, look)
        if gloss > ZERO:
            least = GRAZING + leaf * (LEAF_GRAZING - GRAZING) + coat * (COAT_GRAZING - GRAZING)
            share = reflectance(look.law, max(cosine, least))
            # Blended normals at the edges of things look grazed, which they are not.
            edge = smoothstep(ZERO, EDGE_COSINE + coat * (COAT_EDGE - EDGE_COSINE), cosine)
            share *= level + thing * edge
            gloss *= share
            out = ONE - covered * share  # what the coat lets out to the eye
            r, g, b = r * out, g * out, b * out
    # The sky of the day fills what no splat covers. Many captures leave dark places half open:
    # those are not sky. Below the horizon, where a capture ends before it, the map has dull ground
    # in haze; `skyline` says in which directions it is open.
    keep = ONE
    if look.open_sky > ZERO:
        keep = covered_share(alpha, leaf, sine)
        through = (ONE - keep) * smoothstep(OPEN_LOW, OPEN_HIGH, sine)
    else:
        through = (ONE - alpha) * smoothstep(HOLE, GAP, ONE - alpha)
    return r * keep, g * keep, b * keep, gloss * keep, through, smooth


@inlined_function
def glossed(x, y, z, cosine, nx, ny, nz, smooth):
    """Return a direction, of any length, that a wet surface seen along (x, y, z) mirrors.

    Level rough surfaces mostly mirror what lies above the mirror direction. A share `smooth` is
    that of a leaf, or MIRROR that of a smooth thing, which mirrors by its own unit normal
    (nx, ny, nz); `cosine` is between that and the way back.
    """
    up, smooth = abs(z) + GLOSS_LIFT, min(smooth, ONE)
    turn = TWO * cosine * smooth
    return x + turn * nx, y + turn * ny, up + smooth * (z - up) + turn * nz


@inlined_function
def wet_surface(color, alpha, sine, point, around, ground, rain, look):
    """Return what a captured surface is before the light of the day: colour, place and wetness.

    color, alpha, point, around, ground, rain : see `wet_pixel`
    sine : float32. Of the elevation of the view.
    Returns r, g, b : float32. Captured linear colour.
        point : SurfacePoint. With the normal by which it gets wet.
        clearance, height : float32 [m]. See `heights_of`.
        level : float32. How surely it is the ground.
        wet : Wetness
    """
    clearance, height = heights_of(point, is_surface(alpha, sine), ground)
    r, g, b = surface_color(color[0], color[1], color[2], alpha, look)
    normal = wetted_normal(r, g, b, height, point, around, ground.thickest_layer)
    point = with_normal(point, normal)
    level = ground_share(height, point.nz, point.ground)
    leaf, lit = leaf_share(r, g, b), lit_share(r, g, b, look)
    wet = wet_state(point, clearance, height, level, leaf, lit, ground, rain)
    return r, g, b, point, clearance, height, level, wet


@inlined_function
def wet_pixel(color, alpha, ray, point, around, ground, rain, sky, look, mirror_apart):
    """Return the radiance of a captured point in the rain: all formulas put together.

    color : tuple of 3 float32. Display-referred, over black.
    alpha : float32
    ray : tuple of 3 float32. Unit direction of view.
    point : SurfacePoint. Where it is wetted.
    around : tuple of 3 float32. Unit normal of the neighbourhood, see
        `smooth_normals`; or the point's own.
    ground : GroundMaps
    rain : OffGroundWetness
    sky : SkyMaps
    mirror_apart : bool. Whether level ground's reflection is left out, since the
        wet-ground mirror adds it.
    Returns r, g, b : float32. Radiance.
        clearance : float32 [m]. See `heights_of`.
        cover : float32. Share of a full water film, for the wet-ground mirror; 0
            unless `mirror_apart`.
    """
    x, y, z = ray
    r, g, b, point, clearance, height, level, wet = wet_surface(
        color, alpha, z, point, around, ground, rain, look
    )
    cosine = -(x * point.nx + y * point.ny + z * point.nz)
    r, g, b, gloss, through, smooth = rainy_color(
        r, g, b, alpha, z, cosine, point.nz, height, level, wet, look
    )
    cover = ZERO
    if mirror_apart and level > ZERO:
        cover = covered_share(alpha, ZERO, ZERO)
        cover *= mirror_cover(point, clearance, level, wet, ground, look)
        gloss *= ONE - level
    if gloss > ZERO:
        u, v, w = glossed(x, y, z, cosine, point.nx, point.ny, point.nz, smooth)
        e0, e1, e2 = sample_environment(sky.coat if smooth > ONE else sky.gloss, u, v, w)
        r, g, b = r + gloss * e0, g + gloss * e1, b + gloss * e2
    if through > LEAST_SKY:
        e0, e1, e2 = sample_environment(sky.behind, x, y, z)
        r, g, b = r + through * e0, g + through * e1, b + through * e2
    return r, g, b, clearance, cover
