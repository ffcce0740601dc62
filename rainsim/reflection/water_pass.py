"""The water in a camera's picture: found, tilted by ripples, lit by what it mirrors, and laid.

Each function here is a step of a frame (`rainsim.render.frame` names them in order). `WaterTables`
is what they need of a ground, `SeenWater` the water that one picture shows.

A planar mirror is drawn for each level at which much of the water stands, see `mirror_choice`;
water at other levels is marched on the screen.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from rainsim import ssr
from rainsim.jit import interleaved
from rainsim.reflection import paper, screen_space, water_record, water_shading
from rainsim.reflection.mirror_choice import MIRROR_SPREAD, group_levels
from rainsim.reflection.mirror_pass import mirror_light
from rainsim.reflection.puddle_rings import puddle_rings
from rainsim.reflection.ray_water import COVERING_DEPTHS, meet_water
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.reflection.water_shading import Background, Optics, Ripples
from rainsim.reflection.water_surface import BLOCK, WaterMap, fine_relief, water_surface
from rainsim.reflection.wet_tops import ROWS, list_tops, meet_tops, top_maps, top_numbers
from rainsim.scene.view import View
from rainsim.shading import fresnel
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

    picture : float32 array (height, width, 3). Linear light.
    depth : float32 array (height, width) [m]. Along the view axis; infinite for
        sky.
    clearance : float32 array (height, width) [m]. Height above the ground.
    view : View. Pose in the ground frame.
    below : float32 array (height, width, 3). The picture without what a water
        film on the ground mirrors: what shows through water.
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


class WaterTables:
    """What pictures of the water need of a ground, whatever the camera and the time.

    ring_reach : tuple of ndarray. Reach and weight of rings, see
        `ripples.ring_reach`.
    block_reach : ndarray. See `ripples.block_reach`, of blocks of the map's
        cells.
    relief : float32 array (ny, nx) [m]. See `water_surface.fine_relief`.
    mirrors : bool array (ny, nx). Of the terrain, looked up once.
    top_water : TopWater
    tops : TopMaps. Dry.
    """

    def __init__(self, terrain, ring_reach):
        self.terrain = terrain
        self.block_reach = block_reach(BLOCK * terrain.grid.spacing, *ring_reach)
        self.relief, self.top_water = fine_relief(terrain), TopWater(terrain)
        self.mirrors = terrain.mirrors
        self.tops = top_maps(terrain, self.top_water)

    @property
    def place(self):
        """Corner (2,) and spacing [m] of the map, float32."""
        grid = self.terrain.grid
        return np.array(grid.origin, np.float32), np.float32(grid.spacing)

    def tops_with(self, volume, rate):
        """Return the `TopMaps` with a volume (n,) [m3] on each top, in rain of a rate [m/s]."""
        return self.tops._replace(water=top_numbers(self.top_water, volume, sheet_depth(rate)))


class DrawnWater(NamedTuple):
    """The water's surface as it is drawn.

    map : WaterMap
    highest : float32 [m] or None. Of the surface where there is water; None if
        there is none.
    """

    map: WaterMap
    highest: object


@dataclass(eq=False)
class SeenWater:
    """The water that a picture shows, a record for each of its pixels.

    pixel : int32 array (n,). In the flattened picture.
    record : float32 array (n, RECORD). See `water_record`.
    top : int16 array (n,). That each record lies on, -1 for the ground.
    coverage : float32 array (height, width). Share of each pixel that is water.
    light : float32 array (n, 3). What each record mirrors, before it is
        multiplied by the reflectance.
    source : uint8 array (n,). Where that light was found: a code of
        `mirrored_rays`.
    groups : dict of str to tuple. How each method of reflection shares the
        records out, see `shared_out`.
    """

    pixel: np.ndarray
    record: np.ndarray
    top: np.ndarray
    coverage: np.ndarray
    light: np.ndarray
    source: np.ndarray
    groups: dict = field(default_factory=dict)

    def __len__(self):
        return len(self.pixel)


def march_settings(width, is_paper=False):
    """Return the `ssr.MarchSettings` of a picture of a width [px]."""
    thickness = paper.EPSILON if is_paper else REFLECTION_THICKNESS
    numbers = thickness, max(1.0, REFLECTION_STRIDE * width), REFLECTION_LENGTH
    return ssr.MarchSettings(*map(np.float32, numbers))


def draw_surface(tables, depth, rings):
    """Return the `DrawnWater` of a depth of water and amplitudes of rings, (ny, nx) each."""
    terrain = tables.terrain
    surface, drawn_depth, highest = water_surface(terrain, depth, tables.relief, tables.mirrors)
    shores = puddle_rings(depth, tables.mirrors, tables.block_reach)
    return DrawnWater(WaterMap(surface, drawn_depth, rings, *tables.place, shores), highest)


def find_water(config, depth, view, drawn, tops, off_ground):
    """Return the `SeenWater` of a picture; slopes and light are filled in later.

    config : RenderConfig. Names the methods.
    depth : float32 array (height, width) [m]. Of the picture without water.
    drawn : DrawnWater
    tops : TopMaps
    off_ground : OffGroundWetness. What wets the tops.
    """
    height = len(depth)
    hit, count = np.empty(depth.shape, np.float32), np.zeros(height, np.int64)
    coverage = np.zeros(depth.shape, np.float32)
    given, found = (depth, view, drawn.map), (hit, coverage, count)
    if drawn.highest is None:
        pass
    elif config.water_geometry == "spheres":
        paper.meet_spheres(*given, *found)
    elif config.coverage == "hard":
        paper.meet_hard(*given, drawn.highest, *found)
    else:
        meet_water(*given, drawn.highest, interleaved(height), COVERING_DEPTHS, *found)
    if len(tops.form):
        meet_tops(depth, view, tops, off_ground, interleaved(height), hit, coverage, count)
    return _listed(view, drawn.map, tops, hit, coverage, count)


def _listed(view, water, tops, hit, coverage, count):
    """Return the `SeenWater` of the `count` pixels of each row that `hit` [m] tells."""
    n = int(count.sum())
    seen = SeenWater(
        np.empty(n, np.int32), np.empty((n, water_record.RECORD), np.float32),
        np.full(n, -1, np.int16), coverage, np.empty((n, 3), np.float32), np.empty(n, np.uint8),
    )  # fmt: skip
    if n:
        water_shading.list_water(
            hit, coverage, np.cumsum(count) - count, interleaved(len(count)), view, water, tops,
            seen.pixel, seen.record,
        )  # fmt: skip
    if len(tops.form):
        list_tops(tops, seen.record, seen.top)
    return seen


def shared_out(seen, name, tops, view):
    """Return how a method shares the records out: to mirrors, the march, and the surroundings.

    seen : SeenWater
    name : str. Of reflections.
    tops : TopMaps
    Returns mirrors : list of (place, which). A place is the level [m] of a mirror
        and the window of its picture, see `mirror_window`.
        others : int64 array. Records that are marched.
        surrounded : int64 array. Records that mirror the surroundings alone: on
            tops that slope, or that are not at the level of the only mirror.
    """
    if name not in seen.groups:
        mirrors, *others = _grouped(seen, name, tops)
        shape = seen.coverage.shape
        mirrors = [
            ((z, mirror_window(seen.pixel[which], shape, view.lens)), which) for z, which in mirrors
        ]
        seen.groups[name] = mirrors, *others
    return seen.groups[name]


def _grouped(seen, name, tops):
    height = seen.record[:, water_record.Z]
    if not len(tops.form):
        return *group_levels(height, name), np.zeros(0, np.int64)
    level = tops.form[:, ROWS] > 0
    level = np.flatnonzero((seen.top < 0) | level[seen.top])
    mirrors, others = group_levels(height[level], name)
    mirrors = [(z, level[which]) for z, which in mirrors]
    if name == "mirror":  # one for all: but not for tops at other levels
        mirrors = [
            (z, which[(seen.top[which] < 0) | (abs(height[which] - z) < MIRROR_SPREAD)])
            for z, which in mirrors
        ]
    others = level[others]
    left = np.ones(len(height), np.bool_)
    for which in (others, *(which for _, which in mirrors)):
        left[which] = False
    return mirrors, others, np.flatnonzero(left)


def mirror_window(pixel, shape, lens):
    """Return left, top, right and bottom [px] of the window that some pixels of water mirror.

    It reaches beyond the picture where ripples look there.

    pixel : int array (n,). In the flattened picture.
    shape : tuple of int. Height and width of the picture [px].
    lens : array_like of shape (4,) [px]
    """
    height, width = shape
    if not len(pixel):
        return 0, 0, width, height
    rows, columns = np.divmod(pixel, width)
    across, down = (2 * WINDOW_SLOPE * float(f) for f in lens[:2])
    step = WINDOW_STEP
    return (
        int((columns.min() - across) // step * step),
        int((rows.min() - down) // step * step),
        int(-(-(columns.max() + 1 + across) // step) * step),
        int(-(-(rows.max() + 1 + down) // step) * step),
    )


def tilt(seen, slopes, size, tops):
    """Fill in the slopes of every record by those of a tile of ripples and its size [m]."""
    if len(seen):
        ripples = Ripples(ripple_moments(slopes), np.float32(size))
        water_shading.tilt_water(ripples, tops, seen.record)


def light_up(seen, name, wet, tops, mirrors, surroundings, tall=None):
    """Fill in the mirrored light of every record.

    seen : SeenWater
    name : str. Of reflections.
    wet : WetPicture
    tops : TopMaps
    mirrors : callable. mirrors(place) returns the View and the
        `planar_mirror.MirrorPicture` of a mirror, for each place of `shared_out`.
    surroundings : tuple of float32 array (rows, columns, 3). The environment that
        marched rays end in, and the blurred one that sloping tops mirror.
    tall : callable, optional. tall() returns the `ssr.DepthBlocks` to march;
        without it they are made.
    """
    places, others, surrounded = shared_out(seen, name, tops, wet.view)
    for place, which in places:
        view, mirror = mirrors(place)
        mirror_light(which, seen.record, view, mirror, seen.light, seen.source)
    if len(others):
        is_paper = name == "paper"
        blocks = depth_blocks(wet) if tall is None else tall()
        settings = march_settings(wet.depth.shape[1], is_paper)
        go, depth = screen_space.march_light, blocks
        if is_paper:
            go, depth = paper.paper_light, blocks.depth
        go(
            others, seen.record, wet.picture, depth, wet.view, surroundings[0], settings,
            seen.light, seen.source,
        )  # fmt: skip
    if len(surrounded):
        screen_space.environment_light(
            surrounded, seen.record, surroundings[1], seen.light, seen.source
        )


def depth_blocks(wet):
    """Return the `ssr.DepthBlocks` of what stands on the ground of a `WetPicture`."""
    tall = np.empty_like(wet.depth)
    bounds = np.empty(ssr.bounds_of(*wet.depth.shape), np.float32)
    screen_space.keep_tall(wet.depth, wet.clearance, tall)
    ssr.block_bounds(tall, bounds)
    return ssr.DepthBlocks(tall, bounds)


def optics_of(config, sun):
    """Return the `Optics` of the laws that a RenderConfig names and a sun (6,)."""
    law = fresnel.LAWS[config.fresnel]
    gain = np.float32(1) if config.wetting == "none" else 1 / (1 - ESCAPE)
    return Optics(law, np.float32(GLINT_VARIANCE), sun, np.float32(gain))


def terms(seen, config, wet, sun):
    """Return the terms that the water of a picture is put together from.

    Returns through : float32 array (n, 3). Radiance from below, before it is
        multiplied by 1 - reflectance.
        share : float32 array (n,). Reflectance.
        glint : float32 array (n, 3). The sun's glint as it is added.
    """
    n = len(seen)
    through, glint = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    share = np.empty(n, np.float32)
    if n:
        given = seen.pixel, seen.record, wet.background, wet.view, optics_of(config, sun)
        laws = _paper_laws(config)
        if any(laws):
            paper.separate_paper_water(*given, laws, through, share, glint)
        else:
            water_shading.separate_water(*given, through, share, glint)
    return through, share, glint


def lay(seen, config, wet, sun, shown_out):
    """Write the water into a picture, which holds the one without water."""
    if not len(seen):
        return
    optics = optics_of(config, sun)
    given = seen.pixel, seen.record, seen.light, wet.background, wet.view, optics
    laws = _paper_laws(config)
    if any(laws):
        paper.lay_paper_water(*given, laws, shown_out)
    else:
        water_shading.lay_water(*given, shown_out)


def _paper_laws(config):
    return paper.PaperLaws(config.refraction == "shift", config.highlight == "blinn-phong")


def choice_of(seen):
    """Return in words the choice of `auto` for a picture; None where it chose nothing."""
    if "auto" not in seen.groups or not len(seen):
        return None
    mirrors, others, surrounded = seen.groups["auto"]
    pictures = "picture" if len(mirrors) == 1 else "pictures"
    share = 1 - (len(others) + len(surrounded)) / len(seen)
    tops = np.count_nonzero(seen.top >= 0)
    notes = [
        f"reflections: {len(mirrors)} mirrored {pictures} for {share:.0%} of the water in view"
        + (", a march on the screen for other levels" if len(others) else "")
    ]
    if tops:
        share = tops / seen.coverage.size
        notes.append(f"tops above the ground are {share:.1%} of the picture")
    if len(surrounded):
        notes.append(f"{len(surrounded) / tops:.0%} of them slope and mirror the surroundings")
    return "; ".join(notes)
