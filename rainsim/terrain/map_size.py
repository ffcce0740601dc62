"""Which map a scene asks for: its extent and the size of its cells, and why."""

import math

import numpy as np

from rainsim.errors import ParameterError
from rainsim.lod.held_parts import finest_near
from rainsim.scene.view import rays
from rainsim.terrain.slab import FAINT, SLAB
from rainsim.terrain.types import Grid

DEFAULT_HALF_WIDTH = 4.0  # m, of the map, unless the cameras roam farther
CAMERA_REACH = 1.5  # half widths of the map per camera's distance from its centre
STREET_MARGIN = 6.0  # m beyond cameras that roam farther than that is
STREET_AHEAD = 14.0  # m of ground before such cameras: there a pixel still shows a puddle
MOST_CELLS = 24_000_000  # of a map: some 2 GB while it is made
# Of a map whose cell size is chosen: half as wide cells take three times as long, and of what is
# so wide, cameras show the most part from far away.
AUTO_CELLS = 2_000_000
USUAL_SPACING, LARGEST_SPACING = 0.02, 0.5  # m; a puddle's edge needs cells well below its width
LEAST_ACROSS = 128  # cells, of a small map
ROUND_STEPS = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
LEAST_SPLATS = 100  # on the ground, to tell how far it reaches
EMPTY_MARGIN = 0.5  # m of map beyond the last splats on the ground
GROUND_SLOPE = 0.1  # rise of the ground from the middle outwards within which splats lie on it
GAP_CELL = 0.25  # m


def choose_grid(scene, config, cells=AUTO_CELLS):
    """Return the `Grid` that a scene asks for, and notes that say why.

    The map reaches as far as the cameras' surroundings, but not beyond the splats on the ground,
    without cameras as far as those lie. A cell is 2 cm, finer on small maps, but not smaller than a
    pixel of the cameras on the ground or half the gap between splats, which show no more, and large
    enough for the whole map to have so many `cells`.
    """
    ground = _on_plane(scene)
    low, high, why = _surroundings(scene)
    if len(ground) >= LEAST_SPLATS:
        first, last = np.percentile(ground, (4, 96) if low is None else (0.5, 99.5), axis=0)
        if low is None:
            rim = 0.04 * (last - first)
            low, high, why = first - rim, last + rim, "as far as splats lie on the ground"
        elif (np.maximum(low, first) < np.minimum(high, last)).all():
            cut = np.maximum(low, first - EMPTY_MARGIN), np.minimum(high, last + EMPTY_MARGIN)
            if (cut[1] - cut[0]).prod() < 0.8 * (high - low).prod():
                (low, high), why = cut, "as far as splats lie on the ground"
    if low is None:
        low, high, why = *np.array([[-1.0], [1.0]]) * np.full(2, DEFAULT_HALF_WIDTH), "the default"
    centre, half = (low + high) / 2, (high - low) / 2
    if config.extent is not None:
        half, why = np.full(2, config.extent), "given"
    footprint = _pixel_footprint(scene)
    spacing, because = config.spacing, "given"
    if spacing is None:
        gap = _gap(_fine(scene, ground, centre))
        spacing, because = choose_spacing(half, gap, footprint, cells)
    if 4 * half.prod() / spacing**2 > MOST_CELLS:
        if config.extent is not None:
            raise ParameterError(
                f"a map of {2 * half[0]:g} m at {spacing:g} m has "
                f"{4 * half.prod() / spacing**2:.0f} cells; at most {MOST_CELLS} fit the memory; "
                "give a larger --spacing or a smaller --extent"
            )
        half = half / math.sqrt(4 * half.prod() / spacing**2 / MOST_CELLS)
        why += f", cut to {MOST_CELLS} cells"
    nx, ny = (max(8, round(2 * h / spacing)) for h in half)
    corner = centre - np.array([nx, ny]) * spacing / 2
    grid = Grid((ny, nx), (float(corner[0]), float(corner[1])), spacing)
    note = (
        f"map of {grid.size[0]:.4g} x {grid.size[1]:.4g} m ({why}), {nx} x {ny} cells of "
        f"{spacing:g} m ({because})"
    )
    if footprint is not None:
        note += f"; a pixel of the cameras covers {footprint * 1e3:.2g} mm"
    return grid, (note,)


def _surroundings(scene):
    """Return low and high corner (2,) [m] of the area about the cameras, and why; None if none."""
    if not scene.cameras:
        return None, None, ""
    views = [scene.ground_frame.camera_in_ground(camera) for camera in scene.cameras]
    foot = np.array([view.position[:2] for view in views])
    centre = foot.mean(axis=0)
    radius = np.percentile(np.linalg.norm(foot - centre, axis=1), 90)
    half, why = np.full(2, DEFAULT_HALF_WIDTH), "the default"
    if CAMERA_REACH * radius > DEFAULT_HALF_WIDTH:
        # Cameras that go around something look inwards and need no ground behind it.
        ahead = np.array([view.forward[:2] for view in views])
        outwards = (ahead * (foot - centre)).sum(axis=1) > 0
        seen = np.concatenate([foot, foot[outwards] + STREET_AHEAD * ahead[outwards]])
        low, high = np.percentile(seen, (2, 98), axis=0)
        centre, half = (low + high) / 2, (high - low) / 2
        half = half + np.minimum(STREET_MARGIN, (CAMERA_REACH - 1) * radius)
        half, why = np.maximum(half, DEFAULT_HALF_WIDTH), "the cameras' reach"
    return centre - half, centre + half, why


def _on_plane(scene):
    """Return x, y (n, 2) [m] of solid splats on ground that may slope away from the middle."""
    with np.errstate(invalid="ignore", over="ignore"):
        position = scene.ground_frame.to_ground(scene.splats.position)
        reach = SLAB + GROUND_SLOPE * np.linalg.norm(position[:, :2], axis=1)
        near = (np.abs(position[:, 2]) < reach) & (scene.splats.opacity > FAINT)
    return position[near, :2]


def _fine(scene, ground, centre):
    """Return places as `_on_plane`, of a big capture those of its finest splats near the middle."""
    return ground if scene.pages is None else _on_plane(finest_near(scene, centre))


def _gap(ground):
    """Return the usual distance between splats on the ground [m], where most of them lie."""
    if len(ground) < LEAST_SPLATS:
        return 0.0
    cell = np.floor(ground / GAP_CELL).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_counts=True)
    return GAP_CELL / math.sqrt(np.median(np.repeat(number, number)))


def choose_spacing(half, gap=0.0, footprint=None, cells=AUTO_CELLS):
    """Return the cell size [m] for a map of `half` widths and why."""
    choices = [
        (min(USUAL_SPACING, 2 * half.min() / LEAST_ACROSS), "as usual"),
        (gap / 2, f"splats lie {gap * 100:.2g} cm apart"),
        (footprint or 0.0, "the cameras' pixels"),
        (math.sqrt(4 * half.prod() / cells), "the map is wide"),
    ]
    if choices[0][0] < USUAL_SPACING:
        choices[0] = (choices[0][0], "the map is small")
    spacing, why = max(choices)
    scale = 10.0 ** math.floor(math.log10(spacing))
    # Rounded down, which leaves a map at most twice as many cells.
    spacing = round(max(step for step in ROUND_STEPS if step * scale <= spacing * 1.001) * scale, 9)
    return min(spacing, LARGEST_SPACING), why


def _pixel_footprint(scene):
    """Return the median width [m] of a pixel on the ground in the lower half of pictures, or None.

    A low camera looks at the horizon, but what it shows of the ground is nearer.
    """
    sizes = []
    for camera in scene.cameras:
        view = scene.ground_frame.camera_in_ground(camera)
        ray = rays(view, view.cx, 0.75 * view.height) @ view.camera_from_world[:3, :3]
        if view.position[2] > 0 and ray[2] < -0.05 and not camera.orthographic:
            sizes.append(view.position[2] / -ray[2] / view.fx)
    return float(np.median(sizes)) if sizes else None
