"""Water that a capture itself shows: ponds, canals, puddles and wet mirrors, told by their marks.

What cameras saw in water is a mirror image. Training explains it by splats below the ground, where
the images of things seem to be, behind a hole in the surface; or by a surface whose colour changes
with the view. Neither alone is water: pits are holes too, and the colours of all trained ground
change with the view. So a place where the ground is seen through, or where its colour changes far
more than elsewhere, is only a candidate. It is water if what the cameras see in it moves as the
mirror image of the surroundings does: their own splats, mirrored at its level, predict it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.morphology import remove_small_holes

from rainsim import raster
from rainsim.light import REFRACTIVE_INDEX
from rainsim.scene.cameras import mirrored_camera

CELL = 0.1  # m, about, on which candidates are looked for
DEEP = 0.24  # m below the ground: there no dry ground has splats, for no camera saw them
LEAST_BELOW = 0.3  # m2 of splats so deep that make a look worth while
EYES, LEVEL_EYES = 12, 4  # cameras that look for candidates, and for the level of one
WIDTH = 240  # px of their pictures
LEAST_THROUGH = 0.3  # share of the light that comes from below the ground
CHANGING = 2.0  # times the view dependence of the map's other ground
LEAST_CHANGE = 0.1  # of degree 0, by the harmonics above it
LEAST_AREA, SMALLEST_ISLAND = 0.2, 0.05  # m2
MOST_PLACES = 8  # that are looked at, the largest
LEAST_RIM = 0.4  # share of what lies about the place that must be ground
# Correlation with the mirror image, over so many pairs of a cell and a view. Of 97 blocks of 1.5 m
# of dry ground in four captures the most alike reaches 0.19, pits 0.21, ponds 0.32 to 0.5.
LEAST_LIKENESS, LEAST_PAIRS = 0.25, 400
LEAST_SHARE = 0.2  # of the light that water would mirror; the harmonics of a capture smooth it
DETAIL = 6.0  # px: gloss mirrors what is wider, of the sky and of walls, as dry paving has it
RIM = 0.3  # m about a place in which its rim is looked for
LOWEST = 0.6  # m below the rim that the level is looked for
STEPS = (0.075, 0.025, 0.01)  # m between levels tried, coarse to fine
TILTED = 0.5  # degrees that a measured water surface may lean
ROUGH = 0.012  # m by which it may leave a plane
MEASURED_SHARE = 0.3  # of a place that must show a surface for it to be judged
FLUSH = 0.03  # m below the rim: less, and heights do not tell the outline
HIDDEN = 0.025  # m of water that the splats of its bank reach over
GAMMA = 2.2


@dataclass(frozen=True)
class Body:
    """Water that was told from its marks.

    Attributes
    ----------
    cells : tuple of slice
        Rows and columns of the map about it.
    mask : ndarray, bool
        Its cells among those.
    level : float [m]
    confidence : float
        0 to 1.
    reasons : str
    color : ndarray of shape (3,), float64
        Linear, of the water without its reflections.
    """

    cells: tuple
    mask: np.ndarray
    level: float
    confidence: float
    reasons: str
    color: np.ndarray


@dataclass(frozen=True)
class Look:
    """What a camera sees of the ground: the picture, where its rays meet it, and what is beyond.

    Attributes
    ----------
    camera : Camera
        In the capture frame.
    view : Camera
        The same in the ground frame.
    color : ndarray of shape (height, width, 3), float32
        Linear.
    through : ndarray of shape (height, width), float32
        Share of the light that comes from below the ground.
    stop : ndarray of shape (height, width), float32 [m]
        Depth along the view axis from which something above the ground hides what is behind.
    """

    camera: object
    view: object
    color: np.ndarray
    through: np.ndarray
    stop: np.ndarray

    def _rays(self):
        """Return the rays (height, width, 3) of the pixels, in the ground frame."""
        v = self.view
        u = (np.arange(v.width) + 0.5 - v.cx) / v.fx
        w = (np.arange(v.height) + 0.5 - v.cy) / v.fy
        ray = np.stack([*np.meshgrid(u, w), np.ones(self.stop.shape)], axis=-1)
        return ray @ v.camera_from_world[:3, :3]

    @property
    def mirrored_share(self):
        """Share of the light that level water mirrors to each pixel, by Fresnel's equations."""
        ray = self._rays()
        cosine = np.clip(-ray[..., 2] / np.linalg.norm(ray, axis=-1), 0.02, 1)
        return fresnel(cosine)

    def meet(self, level):
        """Return x, y [m] and depth along the axis of where rays meet a level; NaN if never.

        `level` is a height [m] or a function of x, y.
        """
        ray, eye = self._rays(), self.view.position
        down = np.where(ray[..., 2] < -0.02, ray[..., 2], np.nan)
        t = (level if np.isscalar(level) else 0.0) - eye[2]
        t = t / down
        for _ in range(0 if np.isscalar(level) else 4):
            x, y = eye[0] + t * ray[..., 0], eye[1] + t * ray[..., 1]
            t = (level(np.nan_to_num(x), np.nan_to_num(y)) - eye[2]) / down
        return eye[0] + t * ray[..., 0], eye[1] + t * ray[..., 1], t


def fresnel(cosine):
    """Return the share of unpolarised light that water mirrors at an angle of incidence."""
    inside = np.sqrt(1 - (1 - cosine**2) / REFRACTIVE_INDEX**2)
    across = (cosine - REFRACTIVE_INDEX * inside) / (cosine + REFRACTIVE_INDEX * inside)
    along = (REFRACTIVE_INDEX * cosine - inside) / (REFRACTIVE_INDEX * cosine + inside)
    return ((across**2 + along**2) / 2).astype(np.float32)


class Watcher:
    """Looks at a capture from some of its cameras, as it is and mirrored."""

    def __init__(self, scene, floor):
        self.frame = scene.ground_frame
        self.near = 0.05 / self.frame.meters_per_unit
        self.rasterizer = raster.Rasterizer(raster.prepare(scene.splats))
        self.plane = self._plane(floor)

    def _plane(self, height):
        """Return the plane that cuts away what lies below a height [m]."""
        up = self.frame.up
        return np.append(up, (height - self.frame.translation[2]) / self.frame.meters_per_unit)

    def look(self, camera):
        """Return the `Look` of a capture's camera."""
        height = max(1, round(camera.height * WIDTH / camera.width))
        camera = camera.resized(WIDTH, height)
        full = self.rasterizer.draw(camera, self.near)
        above = self.rasterizer.draw(camera, self.near, self.plane, depth="median", degree=0)
        scale = self.frame.meters_per_unit
        return Look(
            camera, self.frame.camera_in_ground(camera), _linear(full.color, full.alpha),
            np.where(full.alpha > 0.5, full.alpha - above.alpha, 0), above.depth * scale,
        )  # fmt: skip

    def mirrored(self, look, level):
        """Return the fine detail that level water would mirror to a camera, linear; NaN unknown."""
        plane, camera = mirrored_camera(look.camera, self.frame, level)
        seen = self.rasterizer.draw(camera, self.near, plane)
        picture = _linear(seen.color, seen.alpha)
        known = np.isfinite(picture)
        near = ndimage.gaussian_filter(known.astype(np.float32), (DETAIL, DETAIL, 0))
        wide = ndimage.gaussian_filter(np.where(known, picture, 0), (DETAIL, DETAIL, 0))
        return (picture - wide / np.maximum(near, 1e-3)) * look.mirrored_share[..., None]


def _linear(color, alpha):
    """Return the linear colour of a picture, NaN where it shows nothing solid."""
    shown = np.clip(color / np.maximum(alpha, 0.5)[..., None], 0, 1) ** np.float32(GAMMA)
    return np.where((alpha > 0.5)[..., None], shown, np.nan)


def find_water(scene, cloud, grid, height, known, covered):
    """Return the bodies of water that a capture shows, and notes.

    Parameters
    ----------
    scene : Scene
    cloud : object
        The splats over the map: position (n, 3), above (n,) the ground and floor [m], cover (n,)
        [m2], near_bed (n,), change with the view of those, and the function level(x, y) [m].
    grid : Grid
    height : ndarray of shape (ny, nx), float32 [m]
        Of the ground from above.
    known : ndarray of shape (ny, nx), bool
    covered : ndarray of shape (ny, nx), bool
        Below something: there colours are dark, and change far in shares of themselves.

    Returns
    -------
    list of Body, tuple of str
    """
    step = max(1, round(CELL / grid.spacing))
    cell_area = (step * grid.spacing) ** 2
    changing = ndimage.binary_opening(_changing(cloud, grid, step))
    changing = _level_places(changing, height, known & ~covered, grid, step)
    below = float(cloud.cover[cloud.above < -DEEP].sum())
    if below < LEAST_BELOW and changing.sum() * cell_area < LEAST_AREA:
        return [], ()
    if not scene.cameras:
        if below < LEAST_BELOW:
            return [], ()
        return [], (
            f"{below:.1f} m2 of splats lie below the ground; they may be mirror images in water, "
            "which cannot be told without cameras: paint it with --class-mask",
        )
    watcher = Watcher(scene, cloud.floor)
    looks = [watcher.look(camera) for camera in spread_out(scene.cameras, EYES)]
    through = _through(looks, cloud.level, grid, step)
    candidates = ndimage.binary_opening(through > LEAST_THROUGH) | changing
    labels, _ = ndimage.label(candidates)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    bodies, refused = [], 0
    for n in np.argsort(sizes)[::-1][:MOST_PLACES]:
        if sizes[n] * cell_area < LEAST_AREA:
            break
        body = _examine(watcher, looks, labels == n, through, grid, step, height, known)
        if body is None:
            refused += 1
        else:
            bodies.append(body)
    notes = [f"captured water at {b.level:.2f} m: confidence {b.confidence:.2f} ({b.reasons})"
             for b in bodies]  # fmt: skip
    if refused:
        notes.append(f"{refused} other places looked at for captured water: they mirror nothing")
    return bodies, tuple(notes)


def spread_out(cameras, number):
    """Return up to `number` cameras that stand apart from each other."""
    eyes = np.array([camera.position for camera in cameras])
    chosen = [0]
    away = np.linalg.norm(eyes - eyes[0], axis=1)
    while len(chosen) < min(number, len(cameras)):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(eyes - eyes[chosen[-1]], axis=1))
    return [cameras[n] for n in chosen]


def _coarse(grid, step):
    """Return rows and columns of blocks of `step` cells."""
    return -(-grid.shape[0] // step), -(-grid.shape[1] // step)


def _changing(cloud, grid, step):
    """Return the coarse cells whose colour changes with the view far more than elsewhere."""
    rows, columns = _coarse(grid, step)
    row, column, inside = grid.cells(cloud.position[:, 0], cloud.position[:, 1])
    inside = inside[cloud.near_bed]
    place = (row // step * columns + column // step)[cloud.near_bed][inside]
    cover = cloud.cover[cloud.near_bed][inside]
    weight = np.bincount(place, cover, rows * columns).reshape(rows, columns)
    total = np.bincount(place, cover * cloud.change[inside], rows * columns)
    change = ndimage.uniform_filter(total.reshape(rows, columns), 3)
    change /= np.maximum(ndimage.uniform_filter(weight, 3), 1e-9)
    solid = weight > 0.3 * (step * grid.spacing) ** 2
    usual = np.median(change[solid]) if solid.any() else 0.0
    return solid & (change > max(CHANGING * usual, LEAST_CHANGE))


def _through(looks, level, grid, step):
    """Return the share of light from below the ground in each coarse cell."""
    rows, columns = _coarse(grid, step)
    total, number = np.zeros(rows * columns), np.zeros(rows * columns)
    for look in looks:
        x, y, t = look.meet(level)
        row, column, inside = grid.cells(np.nan_to_num(x, nan=1e9), np.nan_to_num(y, nan=1e9))
        inside &= ~(look.stop < 0.97 * t - 0.05)
        place = (row // step * columns + column // step)[inside]
        total += np.bincount(place, look.through[inside], rows * columns)
        number += np.bincount(place, minlength=rows * columns)
    return (total / np.maximum(number, 1)).reshape(rows, columns)


def _examine(watcher, looks, rough, through, grid, step, height, known):
    """Return the `Body` of a candidate, a mask of coarse cells, or None if it is none."""
    margin = -(-RIM // (step * grid.spacing)) + 1
    box = ndimage.find_objects(rough.astype(np.uint8))[0]
    box = tuple(slice(max(s.start - int(margin), 0), s.stop + int(margin)) for s in box)
    cells = tuple(slice(s.start * step, min(s.stop * step, n))
                  for s, n in zip(box, grid.shape, strict=True))  # fmt: skip
    height, known = height[cells], known[cells]
    fine = np.kron(rough[box], np.ones((step, step), bool))[: height.shape[0], : height.shape[1]]
    around = ndimage.distance_transform_edt(~fine) * grid.spacing
    ring = (around > step * grid.spacing) & (around < RIM)
    if np.mean(known[ring]) < LEAST_RIM if ring.any() else True:
        return None
    rim = float(np.percentile(height[ring & known], 20))
    seen_through = float(through[rough].mean())
    inner = fine & (ndimage.distance_transform_edt(fine) * grid.spacing > step * grid.spacing)
    flat, lean, rest = _plane_of(height, known & inner, inner, grid.spacing)
    if flat is not None and flat > rim + 2 * ROUGH:
        return None
    if flat is None and seen_through < LEAST_THROUGH:
        return None
    level = _find_level(watcher, looks, rough, rim, grid, step) if flat is None else flat
    like, share, color, pairs = likeness(watcher, looks, rough, level, grid, step)
    if like < LEAST_LIKENESS or pairs < LEAST_PAIRS or share < LEAST_SHARE:
        return None
    mask = _outline(fine, around, level, rim, height, known, grid)
    reasons = [f"what {pairs} looks see in {mask.sum() * grid.cell_area:.1f} m2 moves as the "
               f"mirror image does, correlation {like:.2f}"]  # fmt: skip
    doubt = (1 - like) ** 2
    if seen_through > LEAST_THROUGH:
        reasons.append(f"{seen_through:.0%} of the light comes from below the ground")
        doubt *= 1 - 0.7 * seen_through
    else:
        reasons.append("its colour changes with the view far more than other ground's")
        doubt *= 0.7
    if flat is not None:
        reasons.append(f"its surface is level within {lean:.1f} degrees and {rest * 1e3:.0f} mm")
        doubt *= 0.6
    return Body(cells, mask, level, 1 - doubt, "; ".join(reasons), color)


def _plane_of(height, shown, inner, spacing):
    """Return level [m], lean [degrees] and rest [m] of what shows of a level smooth surface.

    The level is None if little shows, or what does is not level: leaves, stones, a bank.
    """
    if shown.sum() < max(20, MEASURED_SHARE * inner.sum()):
        return None, 0.0, 0.0
    row, column = np.nonzero(shown)
    z = height[shown].astype(np.float64)
    middle = np.median(z)
    near = np.abs(z - middle) < 4 * ROUGH
    terms = np.stack([np.ones(near.sum()), row[near] * spacing, column[near] * spacing], axis=1)
    found, *_ = np.linalg.lstsq(terms, z[near], rcond=None)
    rest = z[near] - terms @ found
    spread = 1.4826 * np.median(np.abs(rest)) if near.mean() > 0.6 else np.inf
    lean = np.degrees(np.hypot(*found[1:]))
    if lean > TILTED or spread > ROUGH:
        return None, 0.0, 0.0
    return float(middle), float(lean), float(spread)


def _level_places(places, height, known, grid, step):
    """Return the places (a mask of coarse cells) that show a level smooth surface."""
    labels, _ = ndimage.label(places)
    kept = np.zeros_like(places)
    for n, part in enumerate(ndimage.find_objects(labels), 1):
        here = labels[part] == n
        if here.sum() * (step * grid.spacing) ** 2 < LEAST_AREA:
            continue
        cells = tuple(slice(s.start * step, s.stop * step) for s in part)
        shown = known[cells]
        fine = np.kron(here, np.ones((step, step), bool))[: shown.shape[0], : shown.shape[1]]
        if _plane_of(height[cells], shown & fine, fine, grid.spacing)[0] is not None:
            kept[part] |= here
    return kept


def _find_level(watcher, looks, rough, rim, grid, step):
    """Return the level [m] at which the mirror image is most alike."""
    seen = [np.count_nonzero(_inside(look, rough, rim, grid, step)[0]) for look in looks]
    best = [looks[n] for n in np.argsort(seen)[::-1][:LEVEL_EYES]]
    tried = rim + 0.02 - np.arange(0, LOWEST, STEPS[0])
    for finer in (*STEPS[1:], None):
        level = max(tried, key=lambda z: likeness(watcher, best, rough, z, grid, step)[0])
        if finer is not None:
            tried = level + finer * np.arange(-2, 3)
    return float(level)


def _outline(fine, around, level, rim, height, known, grid):
    """Return the cells of the water, told by its bank where that is high enough to tell."""
    if rim - level > FLUSH:
        mask = (around < 1.5 * CELL) & (~known | (height < level + FLUSH / 2))
        labels, _ = ndimage.label(mask)
        mask = np.isin(labels, np.unique(labels[fine & mask]))
    else:
        mask = ndimage.gaussian_filter(fine.astype(np.float32), 0.5 * CELL / grid.spacing) > 0.5
    mask = remove_small_holes(mask, max_size=int(SMALLEST_ISLAND / grid.cell_area))
    return ndimage.distance_transform_edt(~mask) * grid.spacing < HIDDEN


def _inside(look, rough, level, grid, step):
    """Return the pixels of a look that show a candidate at a level, and their coarse cells."""
    x, y, t = look.meet(level)
    row, column, inside = grid.cells(np.nan_to_num(x, nan=1e9), np.nan_to_num(y, nan=1e9))
    inside &= rough[row // step, column // step] & ~(look.stop < 0.97 * t - 0.05)
    return inside, row // step * rough.shape[1] + column // step


def likeness(watcher, looks, rough, level, grid, step):
    """Return how alike a place and the mirror image at a level are, over several cameras.

    Of what each coarse cell shows only the changes from view to view count: the ground's own
    pattern does not. Of the mirror image only fine detail counts, weighted as water mirrors it.

    Returns
    -------
    correlation, share : float
        The share of what water would mirror that is seen.
    color : ndarray of shape (3,)
        The darkest quarter of what is seen, linear: the water, where little is mirrored.
    number : int
        Of pairs of a cell and a view.
    """
    pair, shown, mirrored = [], [], []
    for n, look in enumerate(looks):
        inside, cell = _inside(look, rough, level, grid, step)
        if not inside.any():
            continue
        image = watcher.mirrored(look, level)
        inside &= np.isfinite(image[..., 0]) & np.isfinite(look.color[..., 0])
        pair.append(cell[inside] * len(looks) + n)
        shown.append(look.color[inside])
        mirrored.append(image[inside])
    if not sum(map(len, pair)):
        return 0.0, 0.0, np.zeros(3), 0
    pair, place = np.unique(np.concatenate(pair), return_inverse=True)
    weight = np.bincount(place).astype(np.float64)
    shown, mirrored = (_means(np.concatenate(a), place, 1.0) for a in (shown, mirrored))
    _, cell = np.unique(pair // len(looks), return_inverse=True)
    c, m = (a - _means(a, cell, weight)[cell] for a in (shown, mirrored))
    power = (weight[:, None] * m * m).sum()
    product = (weight[:, None] * c * m).sum()
    correlation = product / max(np.sqrt(power * (weight[:, None] * c * c).sum()), 1e-12)
    share = product / max(power, 1e-12)
    color = np.clip(np.percentile(shown, 25, axis=0), 0, 1)
    return float(correlation), float(share), color, len(pair)


def _means(values, group, weight):
    """Return the weighted means (k, 3) of the values (n, 3) in each of k groups."""
    weight = np.broadcast_to(weight, group.shape)
    total = np.bincount(group, weight)
    return np.stack([np.bincount(group, v * weight) / total for v in values.T], axis=1)
