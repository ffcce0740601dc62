"""The surface and the sky of a capture, found once from its own cameras, and kept."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rainsim.constants import SH_0
from rainsim.io import cache
from rainsim.jit import get_num_threads
from rainsim.numerics.blocks import beside, in_blocks
from rainsim.numerics.places import group_means, groups_of
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, linear
from rainsim.raster import Rasterizer, prepare
from rainsim.splatting.prepared import morton_order
from rainsim.surface.captured_sky import SAME, SkyColors, seen_sky
from rainsim.surface.fuse import (
    LEAST_VIEWS,
    MANY,
    MOST_THROUGH,
    CaptureSurface,
    counted,
    fused,
    to_planes,
)
from rainsim.surface.ground_picture import ground_picture
from rainsim.surface.ground_shade import GroundShade, ground_shade
from rainsim.surface.unveiled import EVERY, MOST_PICTURES, Unveiled, unveiled
from rainsim.surface.views import NEAR, cameras_of, depth_views, leave_out_sky, window_of
from rainsim.surface.wall_parts import is_leaf, laid_on_walls

KIND = "surface"
FEWEST = 100  # splats
STEPS = 4  # of some seconds, in which a surface is found
# Shares of the light that a splat gives to pictures, that goes to the sky: of one that is sky, and
# of one that is sky if it is as bright or alone and about as blue.
MOSTLY, LIKELY = 0.5, 0.3
# What lies in pixels of the sky, times what a splat gives to others; at most this share of it is
# seen where the sky hides it, so that it would come to light without. Or so many cameras have it
# hidden by the sky, for each to which it gives light elsewhere: it hangs before one camera.
HIDDEN, VEILED, OFTENER, LEAST = 0.7, 0.5, 3, 3
SPECK = 0.5  # px, of light from which on a camera sees a splat
BELOW = -0.1  # sine of the elevation from the middle: lower is what the sky hides nowhere
BRIGHT, ABOUT_SKY = 0.75, 1.8  # of the sky's luminance; logarithm of a channel off its colour
ALONE = 4.0  # voxels from any surface, beyond which a splat belongs to none
STOPS, LARGEST = 0.3, 0.3  # share of light that a solid splat stops; its deviation [m], at most
FACING, REACH = 6, 0.25  # places that a splat's normal is taken of; m away, from which it is less
AHEAD = 0.9  # cosine to a plane's normal from which on what is off it is before it
CELL, WIDE = 0.4, 1.0  # m, of places that are taken together, and about that make a layer
BESIDE = 4  # layers that a splat's normal is taken of
LEANING, PITCHED = 0.2, 0.5  # parts of normals upwards, between which walls become roofs
LOST = 0.5  # m from every place, beyond which a splat shows no surface


class Found(NamedTuple):
    """What the cameras of a capture show.

    Of the splats that stop light `solid` has the place [m], the covariance [m2] as xx, xy, xz, yy,
    yz, zz, and the square of the deviations within which they stop STOPS.
    """

    surface: CaptureSurface
    sky: np.ndarray  # (n,), bool, splats that are sky
    aloft: np.ndarray  # (n,), bool, that light it more than land, or are alone and have its colour
    middle: np.ndarray  # (3,), float32, m, of what the cameras look at, in the ground frame
    solid: np.ndarray  # (m, 10), float32
    open: np.ndarray  # (rows, columns), float32, see `captured_sky.seen_sky`
    balance: np.ndarray  # (3,), float32, see `captured_sky.SkyColors`
    half: float  # m, from the middle, how far they look
    shade: GroundShade | None = None  # on the ground; None: none is sure
    unveiled: Unveiled | None = None  # by leaving out the sky


PARTS = {"surface": CaptureSurface, "shade": GroundShade, "unveiled": Unveiled}  # of a `Found`
_last = [None, None]  # name of the result that was asked for last, and the result


def kept_surface(scene, step=lambda: None):
    """Return what the cameras of a scene show, as `Found`, from an earlier run if there was one.

    None if there are fewer splats than FEWEST. `step()` is called up to STEPS times.
    """
    if len(scene.splats) < FEWEST:
        return None
    name = cache.name_of(KIND, scene.splats, scene.ground_frame, scene.cameras)
    if _last[0] != name:
        kept = cache.read(KIND, name)
        if kept is None:
            kept = _packed(find_surface(scene, step))
            cache.write(KIND, name, *kept)
        _last[:] = name, _unpacked(*kept)
    return _last[1]


def _packed(found):
    """Return a `Found` as the facts and arrays of an entry; names of parts stand before theirs."""
    values = found._asdict()
    for name in PARTS:
        part = values.pop(name)
        values |= {} if part is None else {f"{name} {k}": v for k, v in part._asdict().items()}
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    return {name: value for name, value in values.items() if name not in arrays}, arrays


def _unpacked(facts, arrays):
    """Return the `Found` of an entry."""
    values = facts | arrays
    for name, kind in PARTS.items():
        fields = {key: f"{name} {key}" for key in kind._fields}
        there = fields[kind._fields[0]] in values
        part = kind(**{k: values.pop(n) for k, n in fields.items()}) if there else None
        values[name] = part
    return Found(**values)


def find_surface(scene, step=lambda: None):
    """Return what the cameras of a scene show, as `Found`; `step()` is called STEPS times."""
    frame, splats = scene.ground_frame, scene.splats
    with np.errstate(all="ignore"):
        position = frame.to_ground(splats.position).astype(np.float32)
        good = np.isfinite(position).all(axis=1) & np.isfinite(splats.sh[:, 0]).all(axis=1)
        good &= np.isfinite(splats.scale).all(axis=1) & (np.abs(splats.rotation).max(axis=1) > 0)
    placed = [frame.camera_in_ground(camera) for camera in scene.cameras]
    middle, half = window_of(position[good], placed)
    cameras = cameras_of(scene, middle, half)
    rasterizer = Rasterizer(prepare(splats))
    views = depth_views(scene, cameras, rasterizer)
    step()
    colors = SkyColors(views, len(scene.cameras))
    parts, no_surface = colors.parts(views)
    leave_out_sky(views, no_surface)
    step()
    surface = beside(fused, views, middle, half)
    pictures = list(zip(views, cameras, parts, strict=True))
    every, weighed = -(-len(pictures) // MOST_PICTURES), None
    if colors.color is not None:
        weighed = _weighed(scene, rasterizer, pictures, every)
    surface = surface()
    step()
    near = _nearest(surface.position, position, good)
    sky = np.zeros(len(position), bool)
    casters, aloft, bared = good, np.full(len(position), not scene.cameras), None
    if weighed is not None:
        *weighed, seen = weighed
        # Away from every place of the surface.
        alone = near[0] > ALONE * np.append(surface.size, 1)[near[1]]
        sky, aloft = _sky_splats(scene, views, colors, position, alone, middle, *weighed)
        sky &= good
        if sky.any():
            bare, bared = unveiled(scene, sky, seen, pictures[::every])
            sky |= bare & good
        casters = good & ~(sky & alone)  # what looks like sky on a thing throws the thing's shade
    step()
    solid = _solid(position, near, splats, casters, views, frame, surface)
    picture = ground_picture(views)
    shade = None if picture is None else ground_shade(picture)
    seen = seen_sky(views, [part > 0 for part in parts])
    return Found(
        surface, sky, aloft, middle, solid, seen, colors.balance, half, shade, bared
    )  # fmt: skip


def _solid(position, near, splats, good, views, frame, surface):
    """Return the splats that stop light, (m, 10) float32, see `Found`.

    Cameras agree that something is where a splat is, or all of them have something before it: it is
    the other side of a thing, or the inside of a crown. Nothing speaks against one that no camera
    looks at.
    """
    which = np.flatnonzero(good & (splats.opacity > 1.02 * STOPS))
    size = splats.scale[which] * np.float32(frame.meters_per_unit)
    deviation = np.sort(size, axis=1)[:, 1]
    seen, through, hidden = counted(position[which], 0 * deviation, views).T.astype(np.int64)
    least = LEAST_VIEWS if len(views) >= MANY else 1
    solid = (seen + hidden >= least) & (through <= MOST_THROUGH * seen)
    solid |= seen + hidden + through == 0
    solid &= deviation < LARGEST
    flat = surface.flat > 0.5
    if flat.any():  # what lies in a plane is the surface's: splats before it would hide it
        away, place = _nearest(surface.position[flat], position[which])
        solid &= away > ALONE * surface.size[flat][place]
        # So is haze before it, to which the plane is the nearest that there is.
        away, place = (values[which] for values in near)
        ahead = np.sum((position[which] - surface.position[place]) * surface.normal[place], axis=1)
        solid &= ~flat[place] | (away > LOST) | (ahead < AHEAD * away)
    which, size = which[solid], size[solid]
    turn = Rotation.from_quat(splats.rotation[which][:, [1, 2, 3, 0]]).as_matrix()
    axes = np.matmul(frame.rotation, turn) * size[:, None, :]
    full = np.matmul(axes, axes.transpose(0, 2, 1))
    packed = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    reach = 2 * np.log(splats.opacity[which] / STOPS)
    return np.column_stack([position[which], packed, reach]).astype(np.float32)


def _nearest(places, position, good=None):
    """Return how far the nearest of `places` is from each position [m], and which it is.

    Infinity and 0 without places, and where `good` is false.
    """
    away, place = np.full(len(position), np.inf), np.zeros(len(position), np.int64)
    if len(places):
        which = np.arange(len(position)) if good is None else np.flatnonzero(good)
        which = which[morton_order(position[which])]  # neighbours read the same part of the tree
        tree = cKDTree(places, compact_nodes=False, balanced_tree=False)
        away[which], place[which] = tree.query(position[which], workers=get_num_threads())
    return away, place


def kept_normals(scene, found, sky):
    """Return what `splat_normals` does, from an earlier run if there was one."""

    def made():
        return dict(zip(("normal", "share"), splat_normals(scene, found, sky), strict=True))

    place = scene.splats, scene.ground_frame, scene.cameras
    arrays = cache.kept_arrays("normals", made, *place, sky)
    return arrays["normal"], arrays["share"]


def _unit(vectors):
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-6))


def splat_normals(scene, found, sky):
    """Return normals of the surface at a scene's splats (n, 3), and how sure they are (n,).

    In the capture frame, float32. What a picture shows of a wall then faces one way, however its
    splats lie. Splats of the sky, (n,) bool, face down: rain does not wet them.
    """
    surface, frame = laid_on_walls(found.surface), scene.ground_frame
    normal, share = np.zeros((len(scene.splats), 3), np.float32), np.zeros(len(scene.splats), "f4")
    count = min(FACING, len(surface.position))
    if not count:
        return normal, share
    with np.errstate(all="ignore"):
        position = frame.to_ground(scene.splats.position).astype(np.float32)
    good = np.flatnonzero(np.isfinite(position).all(axis=1))
    good = good[morton_order(position[good])]  # neighbours read the same part of the tree
    tree = cKDTree(surface.position, compact_nodes=False, balanced_tree=False)
    nodes, layer = _layers(surface)
    nodes = cKDTree(nodes)

    def work(part):
        which = good[part]
        away, near = tree.query(position[which], k=range(1, count + 1))
        size = surface.size[near[:, 0]]
        weight = np.exp(-0.5 * ((away - away[:, :1]) / size[:, None]) ** 2) * surface.flat[near]
        total = np.einsum("ij,ijk->ik", weight, surface.normal[near])
        length = np.linalg.norm(total, axis=1)
        # Places that face different ways tell less. Haze far from every place lies as it happens
        # to: one splat would be wet beside a dry one. It faces the cameras, upright.
        sure = length / np.maximum(weight.sum(axis=1), 1e-6) * weight.sum(axis=1) / count
        lost = np.clip(away[:, :1] / REACH - 1, 0, 1)
        near = np.clip(2 * sure[:, None], 0, 1) * (1 - lost)
        inwards = (found.middle - position[which]) * np.float32([1, 1, 0])
        mean, known = near * _unit(total) + lost * _unit(inwards), (near + lost)[:, 0]
        least = np.flatnonzero(known < 1)
        away, at = nodes.query(position[which[least]], k=range(1, 1 + min(BESIDE, len(layer))))
        weight = np.exp(-2 * (away / CELL) ** 2) + 1e-6
        weight /= weight.sum(axis=1, keepdims=True)
        wall = np.einsum("ij,ijk->ik", weight, layer[at])
        mean[least] += (1 - known[least, None]) * wall
        known[least] += (1 - known[least]) * np.linalg.norm(wall, axis=1)
        normal[which], share[which] = _unit(mean), known

    in_blocks(work, len(good), 1 << 12)
    normal[sky], share[sky] = (0, 0, -1), 1
    return np.ascontiguousarray(normal @ frame.rotation.astype(np.float32)), share


def _layers(surface):
    """Return cells of a surface, (m, 3) [m], and the normals of the layers there, 0 without one.

    Where few pictures show a wall its places scatter, so that those about a splat lie in no plane.
    Those of a wider neighbourhood do. Leaves face as they happen to; what hardly leans is upright.
    """
    cell = groups_of(np.floor(surface.position / CELL).astype(np.int64), 0)
    values = np.column_stack([surface.position, surface.normal, surface.light])
    node, towards, light = np.split(group_means(cell, values), 3, axis=1)
    _, layer, normal = to_planes(node, np.bincount(cell).astype(float), CELL, WIDE)
    normal *= np.where(np.einsum("ij,ij->i", normal, towards) < 0, -1, 1)[:, None]
    normal[:, 2] *= np.clip((np.abs(normal[:, 2]) - LEANING) / (PITCHED - LEANING), 0, 1)
    return node, _unit(normal) * (layer & ~is_leaf(light))[:, None]


def _weighed(scene, rasterizer, pictures, every):
    """Return the light of splats in parts of pictures, see `Rasterizer.weigh`, array (n, 4) [px].

    And how many cameras see each on something else than the sky, and how many it hides it from;
    and the light (n,) [px] that each gives to `every` so many pictures.
    """
    count = len(scene.splats)
    light, asked, cameras = np.zeros((count, 4)), np.zeros(count), np.zeros((2, count), np.int16)
    lit, veiled = cameras
    for n, (view, camera, part) in enumerate(pictures):
        height, width = view.depth.shape
        camera = camera.resized(width, height)
        one = rasterizer.weigh(camera, NEAR / scene.ground_frame.meters_per_unit, part, EVERY)

        def add(some, n=n, one=one):
            on_land, on_sky, on_rim, before = one[some].T
            light[some] += one[some]
            lit[some] += on_land + on_rim > SPECK
            veiled[some] += (before > SPECK) & (on_sky < VEILED * before)
            if n % every == 0:
                asked[some] += on_land + on_sky + on_rim

        in_blocks(add, count)
    return light, lit, veiled, asked


def _sky_splats(scene, views, colors, position, alone, middle, light, lit, veiled):
    """Return which splats are sky, bool (n,), and which may be: `aloft` of `Found`.

    The light that a splat gives to pixels that show the sky, and to those that show something else,
    tells it, see `_weighed`. Its own colour tells little: splats of a trained sky lie before one
    another, and some are white, some yellow and some dark, so that together they are blue. What is
    darker than the sky and narrower than a pixel may be a twig that hardly darkens the pixel.
    Pixels beside the sky show either: they count against a splat, but not against one as bright as
    the sky. What the sky hides in the pictures, of any colour, would come to light once the sky is
    left out: needles.
    """
    frame = scene.ground_frame
    land, sky, rim, before_sky = light.T
    seen = land + sky + rim
    with np.errstate(invalid="ignore"):  # 0 / 0 of those that no camera sees, and absurd splats
        direction = _unit(position - middle)
        color = linear(scene.splats.sh[:, 0] * np.float32(SH_0) + np.float32(0.5))
        behind = np.exp(colors.at(direction)) @ LUMINANCE_WEIGHTS
        bright = color @ LUMINANCE_WEIGHTS > BRIGHT * behind
        off = colors.off(color, direction)
        across = np.sort(scene.splats.scale, axis=1)[:, 1] * np.float32(frame.meters_per_unit)
        wide = across * views[0].lens[0] > np.linalg.norm(position - middle, axis=1)
        alike = alone & (off < ABOUT_SKY)
        found = (sky / seen > MOSTLY) & (bright | alike | wide)
        likely = (sky / (land + sky) > LIKELY) & (bright | alike)
    high = direction[:, 2]
    # What more cameras see than have hidden is a thing, such as a pale roof.
    hidden = (before_sky > HIDDEN * (land + rim)) & (veiled >= lit)
    needle = (before_sky > 4 * SPECK) | ((veiled > 0) & (lit == 0))
    needle &= hidden & (sky < VEILED * before_sky)
    needle |= (veiled > OFTENER * lit) & (veiled >= LEAST)
    hidden &= alike | wide | (off < SAME)
    unseen = (before_sky + seen == 0) & alone & (off < SAME)
    aloft = ((land <= sky) & (before_sky > 0)) | (alone & (off < SAME))
    found |= ((likely | hidden | unseen) & (high > 0)) | (needle & (high > BELOW))
    return found, aloft
