"""The water in a camera's picture: found, tilted by ripples, lit; what stays is kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rainsim import optics, paperwater, reflect, ssr
from rainsim.jit import dealt
from rainsim.layered import layered_light, split_depth
from rainsim.meeting import meet_water
from rainsim.mirrorlight import mirror_light
from rainsim.moments import ripple_moments
from rainsim.watersurface import fine_relief, water_surface

MIRROR_SPREAD = 0.06  # m: water at levels farther apart has no mirror in common
MOST_MIRRORS = 3  # levels that auto draws mirrored; what stands at others is marched
LEAST_SHARE = 0.04  # of the water's pixels for which another mirror is drawn
LEVEL_STEP = 2e-3  # m, of a mirror's level: a slowly filling puddle keeps its mirror for a while
LEVEL_STEPS = int(MIRROR_SPREAD / LEVEL_STEP)
WINDOW_STEP = 64  # px, of the part of the picture that is drawn mirrored: whole tiles
WINDOW_SLOPE = 0.08  # tilt of the water up to which a ripple finds its image in that part
REFLECTION_THICKNESS = 0.15  # m
MIRROR_STEPS, MIRROR_THICKNESS = 8, 0.1  # m, see docs/light.md
REFLECTION_STRIDE = 1 / 960  # of the width
REFLECTION_LENGTH = 100.0  # m: facades across a street; the march ends at the edge anyway
WORTH = 0.02  # rms radiance by which two layers change what water mirrors, from which auto has them
MOST_NEAR = 0.5  # of the mirrored picture that near things may cover for that
CHECKED, USUAL_SLOPE = 2000, 0.02  # pixels and rms slope along an axis of water that tell
# Of slopes that neither the picture nor the ripples hold: the sun's disc, whose 0.0046 rad are seen
# in slopes of up to 0.0023, and still water that is never quite still, an rms slope of 0.001.
GLINT_VARIANCE = 0.0023**2 / 4 + 0.001**2


@dataclass(frozen=True)
class View:
    """A wet picture without water and where it was taken from (ground frame).

    Attributes
    ----------
    picture : ndarray of shape (height, width, 3), float32
        Linear light.
    depth : ndarray of shape (height, width), float32 [m]
        Along the view axis; infinite for sky.
    clearance : ndarray of shape (height, width), float32 [m]
        Height above the ground.
    turn : ndarray of shape (3, 3), float32
        ground_from_camera.
    eye : ndarray of shape (3,), float32 [m]
    lens : ndarray of shape (4,), float32 [px]
        fx, fy, cx, cy.
    below : ndarray of shape (height, width, 3), float32
        The picture without what a film on the ground mirrors: what shows through water.
    """

    picture: np.ndarray
    depth: np.ndarray
    clearance: np.ndarray
    turn: np.ndarray
    eye: np.ndarray
    lens: np.ndarray
    below: np.ndarray


class WaterView:
    """Water as one camera after another sees it.

    Parameters
    ----------
    terrain : Terrain
    rings : ndarray of shape (ny, nx), float32
        Amplitude of rings in each cell over that in the open, see `ripples.ring_share`.
    config : RenderConfig
        Names the methods.

    Attributes
    ----------
    pixel, record : ndarray
        The list of the water that the last picture shows, see `optics`.
    light : ndarray of shape (n, 3), float32
        What each record mirrors, before Fresnel's factor.
    source : ndarray of shape (n,), uint8
        Where that was found: a code of `reflect`.
    coverage : ndarray of shape (height, width), float32
        Share of each pixel that is water.
    thickness : float [m]
        How far behind its depth a surface still stops a marched ray.
    stride : float
        Step of the march over the picture's width; at least a pixel.
    mirror_share : float
        Resolution of the mirrored pictures over the picture's.
    mirror_steps : int
        Steps of the march of a bent ray in a mirrored picture.
    mirror_thickness : float [m]
        As `thickness`, there.
    layered : bool, optional
        Whether mirrored pictures have two layers, see `rainsim.layered`; by default `auto` finds
        out whether that is worth it, and the others take one.
    """

    def __init__(self, terrain, rings, config):
        self.terrain, self.rings, self.config = terrain, rings, config
        self.relief = fine_relief(terrain)
        self._mirroring = terrain.mirrors
        self._origin = np.array(terrain.grid.origin, np.float32)
        self._spacing = np.float32(terrain.grid.spacing)
        self.thickness, self.stride = REFLECTION_THICKNESS, REFLECTION_STRIDE
        self.mirror_share, self.mirror_steps = 1.0, MIRROR_STEPS
        self.mirror_thickness = MIRROR_THICKNESS
        self.layered = None
        self._worth = None  # what auto found for `layered`
        self.jumps = True  # of the march, over blocks of nothing near
        self._depth = None  # of the water that the kept surface belongs to
        self.view = None

    def look(self, view):
        """Take over what a camera sees without water."""
        self.view = view
        self._shown = view.picture.copy()  # the picture with water on the listed pixels
        self.pixel = np.empty(0, np.int32)
        self.coverage = None
        self._tall, self._mirrors = None, {}

    def draw(self, state, draw_mirrored, trace, environment, sun, timer):
        """Return the picture with the water of a state on it.

        Parameters
        ----------
        state : SimState
        draw_mirrored : callable
            draw_mirrored(level, window, share, split) returns lens and pictures of the camera
            mirrored at a level [m], of a window (left, top, right, bottom) [px] of its picture, at
            a share of its resolution: as `mirrorlight.mirror_light` takes them, or, if they are
            split at a depth [m], `layered.layered_light`.
        trace : callable
            As `reflect.traced_light` takes it.
        environment : ndarray of shape (rows, columns, 3), float32
        sun : ndarray of shape (6,), float32
        timer : Timer

        Returns
        -------
        ndarray of shape (height, width, 3), float32
            Overwritten by the next call.
        """
        moved = self._depth is None or not np.array_equal(state.depth, self._depth)
        if moved:
            self._depth = state.depth
            self.surface, self.deep = water_surface(
                self.terrain, state.depth, self.relief, self._mirroring
            )
            wet = self.deep > 0
            self._highest = np.float32(self.surface[wet].max()) if wet.any() else None
        timer.mark("water surface")
        before = self.pixel
        if moved or self.coverage is None:
            self._find()
        timer.mark("find water")
        _restore(self.view.picture, before, self._shown)
        if len(self.pixel):
            optics.tilt_water(
                self.record, ripple_moments(state.slopes), np.float32(state.tile_size)
            )
            name = self.config.reflections
            self.light_up(name, draw_mirrored, trace, environment, timer)
            optics.lay_water(
                self.pixel, self.record, self.light, self.view.picture, self.view.below,
                self.view.depth, self.view.turn, self.view.lens, *self.laws(), sun, self._shown,
            )  # fmt: skip
        timer.mark("water")
        return self._shown

    @property
    def place(self):
        """Corner (2,) and spacing [m] of the map, float32."""
        return self._origin, self._spacing

    def laws(self):
        """Return what `optics.lay_water` takes of the laws that the configuration names."""
        c = self.config
        return (
            c.fresnel == "schlick", c.refraction == "shift", c.highlight == "blinn-phong",
            np.float32(GLINT_VARIANCE),
        )  # fmt: skip

    def _find(self):
        """List the pixels that show water."""
        v = self.view
        height, width = v.depth.shape
        self.coverage = np.empty((height, width), np.float32)
        if self._highest is None:  # nothing is wet
            self.coverage[:] = 0
            self._list(np.zeros(height, np.int64), None, None)
            return
        hit, count = np.empty((height, width), np.float32), np.empty(height, np.int64)
        turn = dealt(height)
        where = (
            v.depth, v.turn, v.eye, v.lens, self.surface, self.deep, self._origin, self._spacing
        )  # fmt: skip
        if self.config.water_geometry == "spheres":
            paperwater.meet_spheres(*where, hit, self.coverage, count)
        else:
            hard = self.config.coverage == "hard"
            cover = (paperwater.LEAST_WATER,) * 2 if hard else self.config.water_coverage
            meet_water(
                *where, self._highest, turn, np.array(cover, np.float32), hard,
                hit, self.coverage, count,
            )  # fmt: skip
        self._list(count, hit, turn)

    def _list(self, count, hit, turn):
        n, v = int(count.sum()), self.view
        self.pixel, self.record = np.empty(n, np.int32), np.empty((n, optics.RECORD), np.float32)
        self.light, self.source = np.empty((n, 3), np.float32), np.empty(n, np.uint8)
        if n:
            optics.list_water(
                hit, self.coverage, np.cumsum(count) - count, turn, v.turn, v.eye, v.lens,
                self.deep, self.rings, self._origin, self._spacing, self.pixel, self.record,
            )  # fmt: skip
        self._groups = {}  # how each method shares the pixels out

    def light_up(self, name, draw_mirrored, trace, environment, timer):
        """Fill in the mirrored light of every record by the method `name`; the rest as in `draw`.

        Returns what `reflect.traced_light` does if that is the method.
        """
        v = self.view
        if name == "traced":
            found = reflect.traced_light(
                self.record, v.turn, v.lens, trace, self.light, self.source
            )  # fmt: skip
            timer.mark("reflection")
            return found
        if name not in self._groups:
            self._groups[name] = group_levels(self.record[:, 2], name)
            self._window = self._mirror_window()
        mirrors, rest = self._groups[name]
        kept, self._mirrors = self._mirrors, {}

        def pictures_of(level, layered):
            split = split_depth(float(v.eye[2]) - level) if layered else None
            key = (level, self._window, self.mirror_share, split)
            if key not in kept:
                kept[key] = draw_mirrored(*key)
            self._mirrors[key] = kept[key]
            return kept[key]

        layered = self.layered
        if layered is None and name == "auto" and mirrors and self._worth is None:
            self._worth = self._is_worth(*mirrors[0], pictures_of)
            self._mirrors = {}
        if layered is None:
            layered = name == "auto" and bool(self._worth)
        drawn = [pictures_of(level, layered) for level, _ in mirrors]
        timer.mark("mirror")
        for (level, which), mirror in zip(mirrors, drawn, strict=True):
            self._look_up(mirror, level, which, self.record, self.light, self.source)
        if len(rest):
            self._march(rest, name == "paper", environment)
        timer.mark("reflection")
        return None

    def _look_up(self, mirror, level, which, record, light, source):
        """Fill in the light of the records `which` from a mirrored picture."""
        lens, pictures = mirror
        look = mirror_light if len(pictures) == 3 else layered_light
        look(
            which, record, self.view.turn, self.view.eye, lens, np.float32(level), *pictures,
            self.mirror_steps, np.float32(self.mirror_thickness), light, source,
        )  # fmt: skip

    def _is_worth(self, level, which, pictures_of):
        """Tell whether what water of a level mirrors is worth two layers.

        Judged by some pixels, under usual ripples: what the water does just now does not count.
        Where near things cover most of the picture, the second layer costs most and shows least.
        """
        some = which[:: -(-len(which) // CHECKED)]
        record = self.record[some]
        record[:, 10:15] = 0, 0, USUAL_SLOPE**2, USUAL_SLOPE**2, 0
        lights = np.empty((2, len(some), 3), np.float32)
        source = np.empty(len(some), np.uint8)
        for layered, light in zip((False, True), lights, strict=True):
            mirror = pictures_of(level, layered)
            self._look_up(mirror, level, np.arange(len(some)), record, light, source)
        one, two = np.minimum(lights, 1)
        near = mirror[1][3][..., 3] < 1  # lets less than all through
        return np.sqrt(np.mean((one - two) ** 2)) > WORTH and near.mean() < MOST_NEAR

    def choice(self):
        """Return in words what `auto` took for the last picture; None without water or choice."""
        if self.config.reflections != "auto" or not len(self.pixel):
            return None
        mirrors, rest = self._groups["auto"]
        pictures = "picture" if len(mirrors) == 1 else "pictures"
        share = 1 - len(rest) / len(self.pixel)
        return (
            f"reflections: {len(mirrors)} mirrored {pictures} for {share:.0%} of the water in view"
            + (", in two layers" if self._worth else "")
            + (", a march on the screen for the rest" if len(rest) else "")
        )

    def _march(self, which, paper, environment):
        v = self.view
        if self._tall is None:
            self._tall = np.empty_like(v.depth)
            self._bounds = np.empty(ssr.bounds_of(*v.depth.shape), np.float32)
            reflect.keep_tall(v.depth, v.clearance, self._tall)
            ssr.block_bounds(self._tall, self._bounds)
            if not self.jumps:
                self._bounds[..., 0], self._bounds[..., 1] = 0, np.inf
        thickness = paperwater.EPSILON if paper else self.thickness
        stride = max(1.0, self.stride * v.depth.shape[1])
        settings = np.array([thickness, stride, REFLECTION_LENGTH], np.float32)
        look, depths = reflect.march_light, (self._tall, self._bounds)
        if paper:
            look, depths = paperwater.paper_light, (self._tall,)
        look(
            which, self.record, v.picture, *depths, v.turn, v.eye, v.lens, environment, settings,
            self.light, self.source,
        )  # fmt: skip

    def _mirror_window(self):
        """Return left, top, right and bottom of what water mirrors [px].

        It reaches beyond the picture where ripples look there.
        """
        height, width = self.view.depth.shape
        if not len(self.pixel):
            return 0, 0, width, height
        rows, columns = np.divmod(self.pixel, width)
        across, down = (2 * WINDOW_SLOPE * float(f) for f in self.view.lens[:2])
        step = WINDOW_STEP
        return (
            int((columns.min() - across) // step * step),
            int((rows.min() - down) // step * step),
            int(-(-(columns.max() + 1 + across) // step) * step),
            int(-(-(rows.max() + 1 + down) // step) * step),
        )


def _restore(picture, pixel, shown):
    """Put the picture without water back where the last frame's water was."""
    shown.reshape(-1, 3)[pixel] = picture.reshape(-1, 3)[pixel]


def group_levels(height, name):
    """Share out water pixels between mirrors.

    Parameters
    ----------
    height : ndarray of shape (n,), float32 [m]
        Of the water in each pixel.
    name : str
        A name of reflections: "mirror" takes one mirror for all, "auto" one for each level at
        which much of the water stands, others none.

    Returns
    -------
    mirrors : list of (float [m], ndarray of int64)
        Level of each mirror and the pixels that it serves.
    rest : ndarray of int64
        The other pixels.
    """
    everything = np.arange(len(height))
    if name not in ("mirror", "auto") or not len(height):
        return [], everything
    place = np.floor(height.astype(np.float64) / LEVEL_STEP).astype(np.int64)
    lowest = int(place.min())
    place -= lowest
    left, mirrors = np.ones(len(height), bool), []
    for first, middle in mirror_levels(np.bincount(place), MOST_MIRRORS if name == "auto" else 1):
        mine = left & (place >= first) & (place < first + LEVEL_STEPS)
        level = (lowest + middle + 0.5) * LEVEL_STEP
        mirrors.append((level, everything if name == "mirror" else np.flatnonzero(mine)))
        left &= ~mine
    return mirrors, everything[left] if name == "auto" else everything[:0]


def mirror_levels(count, most):
    """Choose levels at which much of the water stands.

    Parameters
    ----------
    count : ndarray of shape (n,), int64
        Pixels of each step of height.
    most : int

    Yields
    ------
    first, middle : int
        The first of the LEVEL_STEPS steps that a mirror serves, and that of its level.
    """
    count, total = count.copy(), count.sum()
    for _ in range(most):
        if count.sum() < LEAST_SHARE * total:
            break
        sums = np.convolve(count, np.ones(LEVEL_STEPS, np.int64))[LEVEL_STEPS - 1 :]
        first = int(np.argmax(sums))
        inside = count[first : first + LEVEL_STEPS].cumsum()
        if inside[-1] < LEAST_SHARE * total:
            break
        yield first, first + int(np.searchsorted(inside, inside[-1] / 2))
        count[first : first + LEVEL_STEPS] = 0
