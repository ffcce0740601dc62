"""The water in a camera's picture: found, tilted by ripples and lit; unchanged parts are kept.

A planar mirror is drawn for each level at which much of the water stands, see `mirror_choice`;
water at other levels is marched on the screen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rainsim import ssr
from rainsim.jit import interleaved
from rainsim.reflection import paper, ray_traced, screen_space, water_record, water_shading
from rainsim.reflection.mirror_choice import MIRROR_SPREAD, group_levels, mirror_step
from rainsim.reflection.mirror_pass import mirror_light
from rainsim.reflection.puddle_rings import puddle_rings
from rainsim.reflection.ray_water import COVERING_DEPTHS, meet_water
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.reflection.water_shading import Background, Optics, Ripples
from rainsim.reflection.water_surface import BLOCK, WaterMap, fine_relief, water_surface
from rainsim.reflection.wet_tops import ROWS, list_tops, meet_tops, top_maps, top_numbers
from rainsim.scene.view import View
from rainsim.shading import fresnel
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import ESCAPE
from rainsim.water.ripples import block_reach
from rainsim.water.top_water import TopWater, sheet_depth

WINDOW_STEP = 64  # px, of the part of the picture that is drawn mirrored: whole tiles
WINDOW_SLOPE = 0.08  # tilt of the water up to which a ripple finds its image in that part
REFLECTION_THICKNESS = 0.15  # m: how far behind its depth a surface still stops a marched ray
REFLECTION_STRIDE = 1 / 960  # of the width, a step of the march; at least a pixel
REFLECTION_LENGTH = 100.0  # m: facades across a street; the march ends at the edge anyway
# Of slopes that neither the picture nor the ripples hold: the sun's disc, whose 0.0046 rad are seen
# in slopes of up to 0.0023, and still water that is never quite still, an rms slope of 0.001.
GLINT_VARIANCE = 0.0023**2 / 4 + 0.001**2


@dataclass(frozen=True)
class WetPicture:
    """A wet picture without water, its depth and clearance, and the view it was taken from.

    Attributes
    ----------
    picture : ndarray of shape (height, width, 3), float32
        Linear light.
    depth : ndarray of shape (height, width), float32 [m]
        Along the view axis; infinite for sky.
    clearance : ndarray of shape (height, width), float32 [m]
        Height above the ground.
    view : View
        Pose in the ground frame.
    below : ndarray of shape (height, width, 3), float32
        The picture without what a water film on the ground mirrors: what shows through water.
    """

    picture: np.ndarray
    depth: np.ndarray
    clearance: np.ndarray
    view: View
    below: np.ndarray

    @property
    def background(self):
        """The picture's arrays for kernels, see `water_shading.Background`."""
        return Background(self.picture, self.below, self.depth)


class Shower(NamedTuple):
    """The rain on the tops at the time of a frame, and the surroundings that they mirror.

    Attributes
    ----------
    wetness : OffGroundWetness
    rate : float [m/s]
        Of the rain.
    gloss : ndarray of shape (rows, columns, 3), float32
        The blurred surroundings, which sloping tops mirror.
    surface_film : float
        How far a film of dirt calms the rings, 0 to 1.
    """

    wetness: OffGroundWetness
    rate: float
    gloss: np.ndarray
    surface_film: float = 0.0


class WaterPass:
    """Draws the water on the wet pictures of one camera after another.

    For each camera call `look` before `draw`; `light_up`, `terms` and `choice` speak of the water
    of the last `draw`.

    Parameters
    ----------
    terrain : Terrain
    rings : ndarray of shape (ny, nx), float32
        Amplitude of rings in each cell over that in the open, see `ripples.ring_share`.
    ring_reach : tuple of ndarray
        Reach and weight of rings, see `ripples.ring_reach`.
    config : RenderConfig
        Names the methods.

    Attributes
    ----------
    wet : WetPicture
        Of the camera.
    pixel, record : ndarray
        The list of the water that the last picture shows, see `water_record`.
    light : ndarray of shape (n, 3), float32
        What each record mirrors, before it is multiplied by the reflectance.
    source : ndarray of shape (n,), uint8
        Where that light was found: a code of `mirrored_rays`.
    coverage : ndarray of shape (height, width), float32
        Share of each pixel that is water.
    block_reach : ndarray
        See `ripples.block_reach`, of blocks of the map's cells.
    thickness : float [m]
        REFLECTION_THICKNESS, or another that is to be tried.
    stride : float
        REFLECTION_STRIDE, or another that is to be tried.
    """

    def __init__(self, terrain, rings, ring_reach, config):
        self.terrain, self.rings, self.config = terrain, rings, config
        self.block_reach = block_reach(BLOCK * terrain.grid.spacing, *ring_reach)
        self.relief, self._films = fine_relief(terrain), terrain.mirrors
        self._origin = np.array(terrain.grid.origin, np.float32)
        self._spacing = np.float32(terrain.grid.spacing)
        self.thickness, self.stride = REFLECTION_THICKNESS, REFLECTION_STRIDE
        self.top_water = TopWater(terrain)
        self.tops = top_maps(terrain, self.top_water)
        self._rain = self._gloss = None  # that the kept list belongs to; what slopes mirrors
        self._depth = None  # of the water that the kept surface belongs to
        self.wet = None

    def look(self, wet):
        """Take over a camera's picture without water, a `WetPicture`; forget the last camera's."""
        self.wet = wet
        self._shown = wet.picture.copy()  # the picture with water on the listed pixels
        self.pixel = np.empty(0, np.int32)
        self.coverage = None
        self.forget_reflections()

    def take_rings(self, rings):
        """Take over other amplitudes of rings (ny, nx), float32, for the water from now on."""
        if rings is not self.rings:
            self.rings, self._depth = rings, None

    def forget_reflections(self):
        """Forget the mirrored pictures and the depth that is marched; the next frame makes them."""
        self._blocks, self._mirrors = None, {}

    def draw(self, state, shower, draw_mirrored, trace, environment, sun, timer):
        """Return the picture with the water of a state on it.

        Parameters
        ----------
        state : SimState
        shower : Shower
            What wets the tops.
        draw_mirrored : callable
            draw_mirrored(level, window, step) returns the View and the
            `planar_mirror.MirrorPicture` of the camera mirrored at a level [m], of a window (left,
            top, right, bottom) [px] of its picture, each side 1 / step as many pixels.
        trace : callable
            As `ray_traced.traced_light` takes it.
        environment : ndarray of shape (rows, columns, 3), float32
        sun : ndarray of shape (6,), float32
            See `water_shading.Optics`.
        timer : Timer

        Returns
        -------
        ndarray of shape (height, width, 3), float32
            Overwritten by the next call.
        """
        moved = self._depth is None or not np.array_equal(state.depth, self._depth)
        if moved:
            self._update_surface(state.depth)
        moved |= self._update_tops(state.top_water, shower)
        self._gloss = shower.gloss
        self._step = mirror_step(self.config.mirror_size, shower, self.wet.view.lens)
        timer.mark("water surface")
        before = self.pixel
        if moved or self.coverage is None:
            self._find()
        timer.mark("find water")
        _restore(self.wet.picture, before, self._shown)
        if len(self.pixel):
            ripples = Ripples(ripple_moments(state.slopes), np.float32(state.tile_size))
            water_shading.tilt_water(ripples, self.tops, self.record)
            self.light_up(self.config.reflections, draw_mirrored, trace, environment, timer)
            self._lay(self.optics(sun))
        timer.mark("water")
        return self._shown

    @property
    def place(self):
        """Corner (2,) and spacing [m] of the map, float32."""
        return self._origin, self._spacing

    def optics(self, sun):
        """Return the `Optics` of the laws that the configuration names and a sun (6,)."""
        law = fresnel.LAWS[self.config.fresnel]
        gain = np.float32(1) if self.config.wetting == "none" else 1 / (1 - ESCAPE)
        return Optics(law, np.float32(GLINT_VARIANCE), sun, np.float32(gain))

    def terms(self, sun):
        """Return the terms that the water of the last picture is put together from.

        Returns
        -------
        through : ndarray of shape (n, 3), float32
            Radiance from below, before it is multiplied by 1 - reflectance.
        share : ndarray of shape (n,), float32
            Reflectance.
        glint : ndarray of shape (n, 3), float32
            The sun's glint as it is added.
        """
        n = len(self.pixel)
        through, glint = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        share = np.empty(n, np.float32)
        if n:
            given = self.pixel, self.record, self.wet.background, self.wet.view, self.optics(sun)
            laws = self._paper_laws()
            if any(laws):
                paper.separate_paper_water(*given, laws, through, share, glint)
            else:
                water_shading.separate_water(*given, through, share, glint)
        return through, share, glint

    def _lay(self, optics):
        """Write the water into the picture."""
        given = self.pixel, self.record, self.light, self.wet.background, self.wet.view, optics
        laws = self._paper_laws()
        if any(laws):
            paper.lay_paper_water(*given, laws, self._shown)
        else:
            water_shading.lay_water(*given, self._shown)

    def _paper_laws(self):
        return paper.PaperLaws(
            self.config.refraction == "shift", self.config.highlight == "blinn-phong"
        )

    def _update_surface(self, depth):
        """Make the drawn surface of the water of a depth (ny, nx) [m]."""
        self._depth = depth
        surface, drawn_depth = water_surface(self.terrain, depth, self.relief, self._films)
        shores = puddle_rings(depth, self._films, self.block_reach)
        self._map = WaterMap(surface, drawn_depth, self.rings, self._origin, self._spacing, shores)
        wet = drawn_depth > 0
        self._highest = np.float32(surface[wet].max()) if wet.any() else None

    def _update_tops(self, volume, shower):
        """Take over the water on tops (n,) [m3] and the rain; return whether either changed."""
        if not len(self.tops.form):
            return False
        water = top_numbers(self.top_water, volume, sheet_depth(shower.rate))
        same = shower.wetness == self._rain and np.array_equal(water, self.tops.water)
        self.tops, self._rain = self.tops._replace(water=water), shower.wetness
        return not same

    def _find(self):
        """List the pixels that show water."""
        height, width = self.wet.depth.shape
        hit, count = np.empty((height, width), np.float32), np.zeros(height, np.int64)
        self.coverage = np.zeros((height, width), np.float32)
        if self._highest is not None:
            self._find_on_ground(hit, count)
        if len(self.tops.form):
            meet_tops(
                self.wet.depth, self.wet.view, self.tops, self._rain, interleaved(height), hit,
                self.coverage, count,
            )  # fmt: skip
        self._list(count, hit)

    def _find_on_ground(self, hit, count):
        """Find the pixels that show water on the ground; writes to `hit`, `count` and coverage."""
        height = len(count)
        given, found = (self.wet.depth, self.wet.view, self._map), (hit, self.coverage, count)
        if self.config.water_geometry == "spheres":
            paper.meet_spheres(*given, *found)
        elif self.config.coverage == "hard":
            paper.meet_hard(*given, self._highest, *found)
        else:
            meet_water(*given, self._highest, interleaved(height), COVERING_DEPTHS, *found)

    def _list(self, count, hit):
        """List the water: a record for each of the `count` pixels of each row, set on `self`.

        Slopes and light are filled in later.
        """
        n = int(count.sum())
        self.pixel = np.empty(n, np.int32)
        self.record = np.empty((n, water_record.RECORD), np.float32)
        self.light, self.source = np.empty((n, 3), np.float32), np.empty(n, np.uint8)
        if n:
            water_shading.list_water(
                hit, self.coverage, np.cumsum(count) - count, interleaved(len(count)),
                self.wet.view, self._map, self.tops, self.pixel, self.record,
            )  # fmt: skip
        self._top = np.full(n, -1, np.int16)  # that each record lies on
        if len(self.tops.form):
            list_tops(self.tops, self.record, self._top)
        self._groups = {}  # how each method shares the pixels out

    def light_up(self, name, draw_mirrored, trace, environment, timer):
        """Fill in the mirrored light of every record by the method `name`; arguments as in `draw`.

        Returns what `ray_traced.traced_light` returns if that is the method.
        """
        if name == "traced":
            found = ray_traced.traced_light(
                self.record, self.wet.view, trace, self.light, self.source
            )
            timer.mark("reflection")
            return found
        if name not in self._groups:
            mirrors, *others = self._group(name)
            mirrors = [((level, self._mirror_window(which)), which) for level, which in mirrors]
            self._groups[name] = mirrors, *others
        mirrors, others, surrounded = self._groups[name]
        kept = self._mirrors
        self._mirrors = {
            (*place, self._step): kept.get((*place, self._step))
            or draw_mirrored(*place, self._step)
            for place, _ in mirrors
        }
        timer.mark("mirror")
        for place, which in mirrors:
            view, mirror = self._mirrors[*place, self._step]
            mirror_light(which, self.record, view, mirror, self.light, self.source)
        if len(others):
            self._march(others, name == "paper", environment)
        if len(surrounded):
            screen_space.environment_light(
                surrounded, self.record, self._gloss, self.light, self.source
            )
        timer.mark("reflection")
        return None

    def _group(self, name):
        """Share the records out as `group_levels`; and those that mirror the surroundings alone.

        These lie on tops that slope, or that are not at the level of the only mirror.
        """
        height = self.record[:, water_record.Z]
        if not len(self.tops.form):
            return *group_levels(height, name), np.zeros(0, np.int64)
        level = self.tops.form[:, ROWS] > 0
        level = np.flatnonzero((self._top < 0) | level[self._top])
        mirrors, others = group_levels(height[level], name)
        mirrors = [(z, level[which]) for z, which in mirrors]
        if name == "mirror":  # one for all: but not for tops at other levels
            mirrors = [
                (z, which[(self._top[which] < 0) | (abs(height[which] - z) < MIRROR_SPREAD)])
                for z, which in mirrors
            ]
        others = level[others]
        left = np.ones(len(height), np.bool_)
        for which in (others, *(which for _, which in mirrors)):
            left[which] = False
        return mirrors, others, np.flatnonzero(left)

    def choice(self):
        """Return in words the choice of `auto` for the last picture; None if it chose nothing."""
        if self.config.reflections != "auto" or not len(self.pixel):
            return None
        mirrors, others, surrounded = self._groups["auto"]
        pictures = "picture" if len(mirrors) == 1 else "pictures"
        share = 1 - (len(others) + len(surrounded)) / len(self.pixel)
        tops = np.count_nonzero(self._top >= 0)
        notes = [
            f"reflections: {len(mirrors)} mirrored {pictures} for {share:.0%} of the water in view"
            + (", a march on the screen for other levels" if len(others) else "")
        ]
        if tops:
            share = tops / self.coverage.size
            notes.append(f"tops above the ground are {share:.1%} of the picture")
        if len(surrounded):
            notes.append(f"{len(surrounded) / tops:.0%} of them slope and mirror the surroundings")
        return "; ".join(notes)

    def _march(self, which, is_paper, environment):
        """Fill in the light of the records `which` by marching the picture's own depth."""
        wet = self.wet
        if self._blocks is None:
            tall = np.empty_like(wet.depth)
            bounds = np.empty(ssr.bounds_of(*wet.depth.shape), np.float32)
            screen_space.keep_tall(wet.depth, wet.clearance, tall)
            ssr.block_bounds(tall, bounds)
            self._blocks = ssr.DepthBlocks(tall, bounds)
        stride = max(1.0, self.stride * wet.depth.shape[1])
        thickness = paper.EPSILON if is_paper else self.thickness
        settings = ssr.MarchSettings(
            *(np.float32(n) for n in (thickness, stride, REFLECTION_LENGTH))
        )
        march, depth = screen_space.march_light, self._blocks
        if is_paper:
            march, depth = paper.paper_light, self._blocks.depth
        march(
            which, self.record, wet.picture, depth, wet.view, environment, settings, self.light,
            self.source,
        )  # fmt: skip

    def _mirror_window(self, which):
        """Return left, top, right and bottom [px] of the window that the records `which` mirror.

        It reaches beyond the picture where ripples look there.
        """
        height, width = self.wet.depth.shape
        if not len(which):
            return 0, 0, width, height
        rows, columns = np.divmod(self.pixel[which], width)
        across, down = (2 * WINDOW_SLOPE * float(f) for f in self.wet.view.lens[:2])
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
