"""Reflections in the water film on wet ground: lights, facades and sky as long streaks.

A wet rough surface is a mirror whose facets tilt: their slopes have a Gaussian density, whose rms
along one axis stands in the class table. A tilt t in the plane of view turns the mirrored ray by
2 t in elevation, a tilt across it by 2 t sin(g) only, where g is the angle at which the ground is
seen: hence streaks. Facets that face the viewer look larger, which lifts the lobe where g is small.
The lobe is cut into SAMPLES parts; each is one look-up, as wide as the part.

All look-ups are in one small picture: the camera mirrored at the ground plane, but level and
upright, so that verticals are columns and a part of the lobe is a piece of a column. The ground is
left out of that picture, for it would hide from below what stands on it; the look-up corrects for
the height and slope of the ground under each pixel. Nothing mirrored is sharp: all of it is coarse.
"""

import functools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rainsim import jit
from rainsim.constants import HALF, ONE, TWO, ZERO
from rainsim.jit import prange
from rainsim.numerics.interpolation import four_colors
from rainsim.numerics.ripmap import LEVELS, ripmap, sample_ripmap
from rainsim.raster import select
from rainsim.scene.types import Camera, pose_at
from rainsim.scene.view import View, rays
from rainsim.shading import lamp_images
from rainsim.shading.environment import sample_environment
from rainsim.shading.fresnel import LAWS
from rainsim.shading.ground_slopes import GroundSlopes, block_ray, ground_met, ground_slopes
from rainsim.shading.lamp_images import lamps_seen
from rainsim.shading.microfacet import LEAST_DIP, LOBE, SAMPLES, ground_reflectance, lobe_part
from rainsim.splatting.detail import merge_fine

THIRD = np.float32(1 / 3)
RESOLUTION = 160.0  # px per unit of tangent, of the level picture
FIELD_STEP = 80.0  # blocks per unit of tangent, of the field of mirrored light
MOST_ASIDE, MOST_UP = 1.3, 1.2  # tangents that the level picture reaches to
MARGIN, ABOVE = 0.12, 0.02  # tangents that it shows beside the camera's view and over the horizon
_SIDE = np.linspace(0, 1, 33)
# Places along a picture's edges, across and down, in shares of its sides.
_EDGES = (
    np.concatenate([_SIDE, _SIDE, 0 * _SIDE, 0 * _SIDE + 1]),
    np.concatenate([0 * _SIDE, 0 * _SIDE + 1, _SIDE, _SIDE]),
)
LEAST_AHEAD = 1e-9  # of rays that are scaled to 1 along the view axis
FINE = 0.04  # m, side of cells in which finer splats are one: a pixel at 6 m
STANDING = 0.04  # m above the ground of the map: splats that are lower are ground
STANDING_OUTSIDE = 0.15  # m above the ground plane, off the map
FAR = np.float32(200.0)  # m, stands for the sky's distance
STEPS = 3  # of the search for the end of a mirrored ray
NEAR_RAY = np.float32(0.2)  # cosine to the axis of the level picture at which rays are held
COARSE = 8  # px, distance of the pixels that `mean_share` takes
USUAL_SLOPE = np.float32(0.2)  # rms slope of the film, for an estimate of its share of the light
STEEPEST_DIP, SHARES = 20.0, 48  # tangent at which the estimate's table ends, its entries
EDGE = np.float32(6.0)  # px, over which the level picture fades into the environment
WORTH = 0.006  # mean share of the light in view from which `auto` draws the level picture


class LevelPicture(NamedTuple):
    """Things that stand on the ground, as the level mirrored camera sees them; read-only."""

    atlas: np.ndarray  # (2 height, 2 width, 3) float32, see `ripmap`
    depth: np.ndarray  # (height, width) float32 [m], infinite for the sky; empty: nothing is drawn
    lens: np.ndarray  # (4,) float32 [px]: fx, fy, cx, cy
    forward: np.ndarray  # (2,) float32, unit: where the axis points to on the ground


NO_LEVEL_PICTURE = LevelPicture(
    np.zeros((0, 0, 3), np.float32), np.zeros((0, 0), np.float32), np.ones(4, np.float32),
    np.array([1, 0], np.float32),
)  # fmt: skip


def standing(prepared, terrain, frame):
    """Return the leading splats of things that stand on the ground, with harmonics to degree 1."""
    place = frame.to_ground(prepared.position.astype(np.float64))
    with np.errstate(invalid="ignore"):  # what is no number lies nowhere
        row, column, inside = terrain.grid.cells(place[:, 0], place[:, 1])
    least = np.where(inside, terrain.bed[row, column] + STANDING, STANDING_OUTSIDE)
    return select(_coarse(prepared), (place[:, 2] > least) & prepared.is_leading)


def _coarse(prepared):
    """Return prepared splats with harmonics to degree 1."""
    return replace(prepared, fine=prepared.fine[:, :0], step=prepared.step[:, :0])


def as_in_level_picture(prepared, frame):
    """Return splats as `in_level_picture` does, those that do not stand on the ground as well."""
    return merge_fine(_coarse(prepared), FINE / frame.meters_per_unit)


def in_level_picture(prepared, terrain, frame):
    """Return the splats of the level picture: of standing things, no finer than needed."""
    return merge_fine(standing(prepared, terrain, frame), FINE / frame.meters_per_unit)


def level_camera(view):
    """Return the level, upright camera (ground frame) that sees the reflections in wet ground.

    view : Camera. In the ground frame. The level one has at most RESOLUTION
        pixels per unit of tangent.
    """
    turn = view.camera_from_world[:3, :3]
    e, n, _ = turn[2].tolist()
    if math.hypot(e, n) < 1e-3:  # straight down: any direction
        e, n, _ = (-turn[1]).tolist()
    e, n = e / math.hypot(e, n), n / math.hypot(e, n)
    axes = np.array([(n, -e, 0.0), (0.0, 0.0, -1.0), (e, n, 0.0)])
    right, down, ahead = axes @ turn.T @ _edge_rays(view)
    # Rays that run backward lie beyond all tangents.
    tangent = (right / np.maximum(ahead, LEAST_AHEAD))[down > 0]
    least, largest = (tangent.min(), tangent.max()) if len(tangent) else (0.0, 0.0)
    left, rightmost = (
        min(max(float(t), -MOST_ASIDE), MOST_ASIDE) for t in (least - MARGIN, largest + MARGIN)
    )
    scale = min(RESOLUTION, view.fx)
    width, height = math.ceil((rightmost - left) * scale), math.ceil((ABOVE + MOST_UP) * scale)
    pose = pose_at(axes, view.position)
    return Camera(width, height, scale, scale, -left * scale, ABOVE * scale, pose)


def _edge_rays(camera):
    """Return the `rays` through places along a picture's edges, (3, n)."""
    return rays(camera, _EDGES[0] * camera.width, _EDGES[1] * camera.height).T


@jit.cpu_kernel
def mirrored_field(
    view: View, step, wanted, ground: GroundSlopes, lobe, level: LevelPicture, environment,
    field_out,
):  # fmt: skip
    """Write the light that a full water film on the ground mirrors to each block of pixels.

    Every block counts as ground, whatever stands before it: so the field is smooth.

    step : int [px]. Side of the blocks.
    wanted : bool array (rows, columns). Blocks that show wet ground, or have a
        neighbour that does.
    ground : GroundSlopes
    lobe : ndarray. LOBE.
    level : LevelPicture
    environment : float32 array (m, 2 m, 3). Mirrored where that picture ends.
    field_out : float32 array (rows, columns, 3). Radiance; zero where not wanted.
    """
    rows, columns = wanted.shape
    taken = jit.none_taken()
    for _ in prange(jit.TAKERS):
        j = jit.take_next(taken)
        while j < rows:
            for i in range(columns):
                field_out[j, i, 0], field_out[j, i, 1], field_out[j, i, 2] = ZERO, ZERO, ZERO
                if wanted[j, i]:
                    x, y, z = block_ray(view, step, j, i)
                    r, g, b = mirrored_light(x, y, z, view.eye, ground, lobe, level, environment)
                    field_out[j, i, 0], field_out[j, i, 1], field_out[j, i, 2] = r, g, b
            j = jit.take_next(taken)


@jit.inlined_function
def mirrored_light(x, y, z, eye, ground, lobe, level, environment):
    """Return the radiance that a water film on the ground mirrors to the eye.

    x, y, z : float32. Direction of view.
    eye : float32 array (3,) [m]
    ground, lobe, level, environment. As `mirrored_field` takes them.
    """
    lens, forward, depth, atlas = level.lens, level.forward, level.depth, level.atlas
    ux, uy, dip, span, here, gx, gy, slope = ground_met(x, y, z, eye, ground)
    tilt = gx * ux + gy * uy
    cross = gy * ux - gx * uy
    # In the level picture verticals are columns.
    ahead = ux * forward[0] + uy * forward[1]
    if ahead < NEAR_RAY:
        ahead = NEAR_RAY
    aside = ux * forward[1] - uy * forward[0]
    column = lens[0] * aside / ahead + lens[2]
    drop = eye[2] + here  # of the virtual image of the ground here below the eye
    rows, columns = depth.shape
    height, width = np.float32(rows), np.float32(columns)
    r, gr, b = ZERO, ZERO, ZERO
    way = ZERO  # level length of the mirrored ray [m]: one part's is a good guess for the next
    for k in range(SAMPLES):
        rise, weight, facet, wide = lobe_part(lobe, k, dip, tilt, slope, ground.law)
        if weight <= ZERO:
            continue
        # Facets that lean across turn the ray aside, and so does the slope of the ground.
        sideways = TWO * facet * math.sqrt(ONE + rise * rise)
        for _ in range(STEPS if rows > 0 else 0):
            reach = ONE / ((span + way) * ahead)
            c = column + cross * sideways * way / (span + way) / (ahead * ahead) * lens[0]
            row = lens[1] * (drop + way * rise) * reach + lens[3]
            p = min(max(int(c), 0), columns - 1)
            q = min(max(int(row), 0), rows - 1)
            way = max(min(depth[q, p], FAR) / ahead - span, ZERO)
        bent = way / (span + way)
        c = column + cross * sideways * bent / (ahead * ahead) * lens[0]
        row = lens[1] * (drop + way * rise) / ((span + way) * ahead) + lens[3]
        # Widths in pixels. A texel of a mip level, interpolated, has a standard deviation of half
        # its width: as a part of the lobe that is 1.7 texels tall, and as `broad` of two texels.
        tall = lens[1] * bent / ahead * wide * (ONE + rise * rise)
        broad = TWO * lens[0] * bent / (ahead * ahead) * slope * sideways
        high = min(int(math.log2(max(tall, ONE))), LEVELS - 1)
        lower = min(int(math.log2(max(broad, ONE))), LEVELS - 2)
        broad /= np.float32(1 << lower)
        f = min(max((broad * broad - ONE) * THIRD, ZERO), ONE)  # of the variance
        out = max(max(-c, c - width), max(row - height, ZERO)) / EDGE
        found = ONE - min(max(out, ZERO), ONE) if rows > 0 else ZERO
        if found > ZERO:
            p0, p1, p2 = sample_ripmap(atlas, c, row, lower, high)
            q0, q1, q2 = sample_ripmap(atlas, c, row, lower + 1, high)
            found *= weight
            r += found * (p0 + (q0 - p0) * f)
            gr += found * (p1 + (q1 - p1) * f)
            b += found * (p2 + (q2 - p2) * f)
        if found < weight:
            e0, e1, e2 = sample_environment(environment, ux, uy, rise)
            found = weight - found
            r, gr, b = r + found * e0, gr + found * e1, b + found * e2
    return r, gr, b


@jit.cpu_kernel
def add_reflection(bare, cover, field, step, picture_out):
    """Add the light that wet ground mirrors to a picture without it.

    bare : float32 array (height, width, 3)
    cover : float32 array (height, width). Share of a full water film in each
        pixel.
    field : float32 array (rows, columns, 3). As `mirrored_field` makes it, of
        blocks of `step` pixels.
    picture_out : float32 array (height, width, 3)
    """
    height, width = cover.shape
    scale = ONE / np.float32(step)
    taken = jit.none_taken()
    for _ in prange(jit.TAKERS):
        row = jit.take_next(taken)
        while row < height:
            for column in range(width):
                share = cover[row, column]
                for c in range(3):
                    picture_out[row, column, c] = bare[row, column, c]
                if share > ZERO:
                    r, g, b = field_at(field, scale, row, column)
                    picture_out[row, column, 0] += share * r
                    picture_out[row, column, 1] += share * g
                    picture_out[row, column, 2] += share * b
            row = jit.take_next(taken)


@jit.inlined_function
def field_at(field, scale, row, column):
    """Return the light of a field at a pixel, interpolated; `scale` is one over its step."""
    rows, columns = field.shape[0], field.shape[1]
    v = min(max((np.float32(row) + HALF) * scale - HALF, ZERO), np.float32(rows - 1))
    u = min(max((np.float32(column) + HALF) * scale - HALF, ZERO), np.float32(columns - 1))
    j, i = max(min(int(v), rows - 2), 0), max(min(int(u), columns - 2), 0)
    k, n = min(j + 1, rows - 1), min(i + 1, columns - 1)
    return four_colors(field, j, k, i, n, u - np.float32(i), v - np.float32(j))


class WetGroundMirror:
    """Adds the light that wet ground mirrors to the pictures of one camera after another.

    config : RenderConfig. Its `film` and `reflections` name the method.
    drawn : bool. Whether the level picture is drawn; without it ground mirrors
        the environment only.
    shared_camera : Camera or None. See `share_level`.
    """

    def __init__(self, terrain, config):
        self.terrain, self.config = terrain, config
        self.drawn = config.film == "mirror"
        self._level, self.shared_camera = _level_picture, None

    def share_level(self, camera):
        """Draw one level picture, a camera's (ground frame), for all; None: each has its own."""
        self.shared_camera = camera
        common = camera and functools.cache(functools.partial(_level_picture, camera))
        self._level = (lambda _, draw_mirrored: common(draw_mirrored)) if common else _level_picture

    def over(self, terrain):
        """Return the mirror of another terrain, with the choice made for this one."""
        other = WetGroundMirror(terrain, self.config)
        other.drawn = self.drawn
        return other

    @property
    def apart(self):
        """Whether the level picture may be drawn, so that the film's cover must be known."""
        named = self.config.film != "environment"
        return named and self.config.reflections in ("auto", "mirror")

    def add_to(self, wet, cover, camera, draw_mirrored, environment):
        """Return a wet picture with the reflections in its wet ground.

        wet : WetPicture. Without them.
        cover : float32 array (height, width). Share of a full water film in each
            pixel.
        camera : Camera. Of the picture, in the ground frame.
        draw_mirrored : callable. draw_mirrored(camera) returns the `WetPicture`
            of what stands on the ground, as a ground-frame camera mirrored at the
            ground plane takes it.
        environment : float32 array (m, 2 m, 3). Mirrored where that picture ends.
        """
        if not cover.any():
            return wet
        field, step = self.field(wet.view, cover, camera, draw_mirrored, environment)
        picture = np.empty_like(wet.picture)
        add_reflection(wet.picture, cover, field, step, picture)
        return replace(wet, picture=picture, below=wet.picture)

    def choose(self, shares):
        """Decide whether wet ground mirrors enough light for a level picture; return a note.

        shares : iterable of float. Of the light in some views that wet ground
            mirrors; read until one is worth it.
        """
        most = 0.0
        for share in shares:
            most = max(most, share)
            if most > WORTH:
                break
        self.drawn = most > WORTH
        what = "a mirrored picture" if self.drawn else "the surroundings only"
        return f"film on wet ground: mirrors {what}, {most:.1%} of the light in a view"

    def field(self, view, cover, camera, draw_mirrored, environment):
        """Return the field of light that a full film mirrors, and the step of its blocks [px].

        `view` is that of `camera`; the other parameters are those of `add_to`.
        """
        step = max(1, round(camera.fx / FIELD_STEP))
        wanted = np.empty([-(-n // step) for n in cover.shape], bool)
        wet_blocks(cover, step, wanted)
        level, lamps = NO_LEVEL_PICTURE, ()
        if self.drawn:
            level, lamps = self._level(camera, draw_mirrored)
        field = np.empty((*wanted.shape, 3), np.float32)
        mirrored_field(view, step, wanted, self.ground, LOBE, level, environment, field)
        if len(lamps):
            shown = lamp_images.LampView(lamps, level.depth, level.lens, level.forward)
            lamp_images.add_lamps(view, step, wanted, self.ground, shown, field)
        return field, step

    @property
    def ground(self):
        """The terrain's `GroundSlopes`, whose film mirrors by the law that the settings name."""
        return self._slopes._replace(law=LAWS[self.config.fresnel])

    @functools.cached_property
    def _slopes(self):
        return ground_slopes(self.terrain)


def _level_picture(camera, draw_mirrored):
    """Return the `LevelPicture` of a camera, and its lamps."""
    upright = level_camera(camera)
    seen, lamps = lamps_seen(upright, draw_mirrored)
    picture = lamp_images.without_lamps(seen.picture) if len(lamps) else seen.picture
    level = LevelPicture(
        ripmap(picture, round(upright.cy)), seen.depth, seen.view.lens,
        upright.forward[:2].astype(np.float32),
    )  # fmt: skip
    return level, lamps


@jit.cpu_kernel
def wet_blocks(cover, step, wanted_out):
    """Find the blocks of `step` pixels that show wet ground or have a neighbour that does.

    cover : float32 array (height, width)
    wanted_out : bool array (rows, columns)
    """
    (height, width), (rows, columns) = cover.shape, wanted_out.shape
    for j in prange(rows):
        line = wanted_out[j]
        top = np.int64(j) * step
        first, end = max(top - step, 0), min(top + 2 * step, height)
        for i in range(columns):
            line[i] = has_cover(cover, first, end, i * step, min(i * step + step, width))
        before = False
        for i in range(columns):
            here = line[i]
            after = i + 1 < columns and line[i + 1]
            line[i] = before or here or after
            before = here


@jit.inlined_function
def has_cover(cover, first, end, left, right):
    """Return whether a part of a picture, rows `first` to `end`, shows wet ground."""
    for row in range(first, end):
        for column in range(left, right):
            if cover[row, column] > ZERO:
                return True
    return False


def mean_share(view, cover):
    """Return the mean share of the light in view that wet ground mirrors, by every eighth pixel."""
    some = cover[::COARSE, ::COARSE]
    row, column = np.nonzero(some)
    ray = rays(view, COARSE * column + 0.5, COARSE * row + 0.5) @ view.ground_from_camera.T
    dip = np.clip(-ray[:, 2] / np.hypot(ray[:, 0], ray[:, 1]), LEAST_DIP, STEEPEST_DIP)
    share = np.interp(np.log(dip), *usual_shares())
    return float(some[row, column] @ share) / some.size


@functools.cache
def usual_shares():
    """Return logarithms of SHARES tangents and the reflectance of usual wet ground seen at these.

    USUAL_SLOPE is the rms slope of its film.
    """
    tangent = np.geomspace(LEAST_DIP, STEEPEST_DIP, SHARES).astype(np.float32)
    share = np.empty_like(tangent)
    ground_reflectance(LOBE, tangent, USUAL_SLOPE, share)
    return np.log(tangent), share
