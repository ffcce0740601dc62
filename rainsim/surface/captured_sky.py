"""Which pixels of the captured pictures show the sky.

The sky is so far away that it has the same colour in one direction from every camera. So its colour
is found as a map over directions, from pixels that may be sky in several cameras, and a pixel above
the horizon shows the sky if it has the map's colour there.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from rainsim.numerics.srgb import LUMINANCE_WEIGHTS

ROWS, COLUMNS = 18, 72  # of the map: 5 degrees of elevation and of azimuth
LOWEST = -0.01  # sine of the elevation from which on a pixel may show the sky
DULL, BLUE = 0.6, 0.8  # blue over the largest channel: no sky, likely sky
DARK = 0.1  # linear luminance below which nothing is the sky of a day
EVEN = 0.15  # range of the logarithm of luminance about a pixel of the sky
ABOUT = 5  # px, side of the square in which that is measured
BRIGHTER = 0.7  # quantile of the cameras: things before the sky are darker
STEP = 0.25  # logarithm of a channel between texels of the sky, at most
# Logarithm of a channel by which cameras differ from each other, from which on it is not the sky.
# Captures whose harmonics were cut off (.splat) have .12 where whole ones have .03.
NEAR = 0.16
SAME = 0.35  # logarithm of a channel by which a pixel differs from the map
LIKE_LAND = 0.5  # share of what lies below the horizon that may differ so little from the map
SEEN = 45, 180  # rows and columns of the map of where the sky is seen
LEAST_SEEN = 0.02  # share of the pixels that look in a direction, that show the sky
LEAST_TEXELS = 6  # that show the sky
LEAST_PIXELS = 30  # of a texel


class SkyColors:
    """The colour of the captured sky by direction.

    `color`, (ROWS, COLUMNS, 3), is the logarithm of linear light, row 0 at the horizon; None: no
    camera sees the sky.
    """

    def __init__(self, views):
        found = [[] for _ in range(ROWS * COLUMNS)]  # of each texel: a colour for each camera
        for view in views:
            direction = directions(view)
            likely = _likely(view, direction)
            texel = _texels(direction)[likely]
            color = np.log(np.clip(view.light[likely], 0.01, 1.0))
            order = np.argsort(texel, kind="stable")
            texel, color = texel[order], color[order]
            first = np.flatnonzero(np.diff(texel, prepend=-1))
            for start, stop in zip(first, np.append(first[1:], len(texel)), strict=False):
                if stop - start >= LEAST_PIXELS:
                    found[texel[start]].append(np.median(color[start:stop], axis=0))
        color, spread = np.full((ROWS * COLUMNS, 3), np.nan), np.full(ROWS * COLUMNS, np.nan)
        for n, seen in enumerate(found):
            if seen:
                # What hides the sky from some cameras is darker.
                bright = np.sum(seen, axis=1)
                color[n] = seen[np.argsort(bright)[int(BRIGHTER * (len(seen) - 1) + 0.5)]]
                away = np.abs(np.array(seen) - color[n]).max(axis=1)
                spread[n] = np.median(away) if len(seen) > 1 else np.nan
        shape = ROWS, COLUMNS
        self.color = _completed(color.reshape(*shape, 3), spread.reshape(shape))
        if self.color is not None and self._like_land(views) > LIKE_LAND:
            self.color = None  # fog, or a room of one grey: no colour tells the sky from a wall

    def _like_land(self, views):
        """Return the share of the pixels below the horizon that have the map's colour."""
        alike = below = 0
        for view in views:
            direction = directions(view)
            low = direction[..., 2] < 2 * LOWEST
            below += np.count_nonzero(low)
            alike += np.count_nonzero(self.off(view.light, direction)[low] < SAME)
        return alike / max(below, 1)

    def off(self, light, direction):
        """Return the logarithm by which linear light (..., 3) differs from the sky, (...)."""
        return np.abs(np.log(np.clip(light, 0.01, 1.0)) - self.at(direction)).max(axis=-1)

    def shown(self, view):
        """Return which pixels of a `DepthView` show the sky, bool (height, width)."""
        if self.color is None:
            return np.zeros(view.depth.shape, bool)
        direction = directions(view)
        near = (self.off(view.light, direction) < SAME) & (direction[..., 2] > LOWEST)
        return ndimage.median_filter(near, 3)

    def at(self, direction):
        """Return the logarithm of the sky's colour in directions (..., 3)."""
        row = np.arcsin(np.clip(direction[..., 2], 0, 1)) / (np.pi / 2) * ROWS - 0.5
        column = np.arctan2(direction[..., 1], direction[..., 0]) / (2 * np.pi) * COLUMNS - 0.5
        wide = np.concatenate([self.color[:, -1:], self.color, self.color[:, :1]], axis=1)
        place = [row, column % COLUMNS + 1]
        channels = [
            ndimage.map_coordinates(wide[..., c], place, order=1, mode="nearest") for c in range(3)
        ]
        return np.stack(channels, axis=-1)


def directions(view):
    """Return the unit direction of each pixel of a `DepthView` in the ground frame."""
    height, width = view.depth.shape
    fx, fy, cx, cy = view.lens
    x = (np.arange(width, dtype=np.float32) + 0.5 - cx) / fx
    y = (np.arange(height, dtype=np.float32) + 0.5 - cy) / fy
    ray = np.empty((height, width, 3), np.float32)
    ray[..., 0], ray[..., 1], ray[..., 2] = x, y[:, None], 1
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    return ray @ view.matrix[:, :3]


def seen_sky(views, shown):
    """Return in which directions cameras saw the sky, bool (rows, columns) of 2 degrees.

    Row 0 is at the horizon, column 0 at azimuth 0. What no camera looked at counts as sky. `shown`
    are masks of the views' pixels of the sky.
    """
    rows, columns = SEEN
    count = np.zeros((2, rows * columns))
    for view, sky in zip(views, shown, strict=True):
        direction = directions(view)
        row = np.arcsin(np.clip(direction[..., 2], -1, 1)) / (np.pi / 2) * rows
        column = np.arctan2(direction[..., 1], direction[..., 0]) / (2 * np.pi) * columns
        above = row >= 0
        row = np.minimum(row[above].astype(int), rows - 1)
        place = row * columns + np.floor(column[above]).astype(int) % columns
        count[0] += np.bincount(place, minlength=rows * columns)
        count[1] += np.bincount(place, sky[above], minlength=rows * columns)
    return ((count[0] == 0) | (count[1] > LEAST_SEEN * count[0])).reshape(SEEN)


def _likely(view, direction):
    """Return which pixels are even, bright and blue or grey, and above the horizon."""
    light = view.light @ LUMINANCE_WEIGHTS.astype(np.float32)
    blue = view.light[..., 2] / np.maximum(view.light.max(axis=-1), 1e-3)
    log = np.log(np.maximum(light, 0.01))
    even = ndimage.maximum_filter(log, ABOUT) - ndimage.minimum_filter(log, ABOUT) < EVEN
    return even & (light > DARK) & (blue > BLUE) & (direction[..., 2] > 0)


def _texels(direction):
    row = np.arcsin(np.clip(direction[..., 2], 0, 1)) / (np.pi / 2) * ROWS
    column = np.arctan2(direction[..., 1], direction[..., 0]) / (2 * np.pi) * COLUMNS
    row, column = row.astype(np.int64).clip(0, ROWS - 1), np.floor(column).astype(np.int64)
    return row * COLUMNS + column % COLUMNS


def _completed(color, spread):
    """Return a map of the sky without holes, None if too little of it is sky.

    Of the parts of the map that are smooth in themselves the sky is the one that is highest and
    widest; a wall that hides it is another. Where it stands near, what is seen in one direction
    differs from camera to camera.
    """
    row, column = np.mgrid[:ROWS, :COLUMNS]
    high, turn = (row + 0.5) / ROWS * np.pi / 2, (column + 0.5) / COLUMNS * 2 * np.pi
    known = np.isfinite(color[..., 0])
    part = _parts(color, known)
    if part is None:
        return None
    weight = np.bincount(part[known], (np.sin(high) * np.cos(high))[known])
    known &= part == np.argmax(weight)
    told = known & np.isfinite(spread)
    if np.count_nonzero(known) < LEAST_TEXELS:
        return None
    if told.any() and np.median(spread[told]) > NEAR:
        return None
    x, y, z = np.cos(high) * np.cos(turn), np.cos(high) * np.sin(turn), np.sin(high)
    terms = np.stack([np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x - y * y, z * z], -1)
    hold = np.diag([0, *[0.5] * 3, *[1.0] * 5])  # few texels say little of the shape
    a = terms[known]
    smooth = terms @ np.linalg.solve(a.T @ a + hold, a.T @ color[known])
    where = np.where(known[..., None], color - smooth, 0)
    mode = ("nearest", "wrap")
    spread = np.stack([ndimage.gaussian_filter(where[..., c], 1, mode=mode) for c in range(3)], -1)
    near = ndimage.gaussian_filter(known.astype(float), 1, mode=mode)[..., None]
    return smooth + spread / (near + 0.05)


def _parts(color, known):
    """Return the number of the smooth part that each texel belongs to; None without texels."""
    if not known.any():
        return None
    number = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    pairs = []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        other = np.roll(color, -across, axis=1)[down:], np.roll(number, -across, axis=1)[down:]
        alike = np.abs(color[: ROWS - down] - other[0]).max(axis=-1) < STEP
        pairs.append(np.stack([number[: ROWS - down][alike], other[1][alike]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = sparse.coo_matrix((np.ones(len(first)), (first, second)), (number.size, number.size))
    return csgraph.connected_components(graph, directed=False)[1].reshape(ROWS, COLUMNS)
