"""Which pixels of the captured pictures show the sky.

The sky is so far away that it has the same colour in one direction from every camera. So its colour
is found as a map over directions, from pixels that may be sky in several cameras, and a pixel above
the horizon shows the sky if it has the map's colour there.
"""

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from rainsim.numerics.blocks import of_each
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.surface.fuse import LEAST_VIEWS, are_agreed, counted

ROWS, COLUMNS = 18, 72  # of the map: 5 degrees of elevation and of azimuth
LOWEST = -0.01  # sine of the elevation from which on a pixel may show the sky
BLUE = 0.8  # blue over the largest channel: likely sky
DARK = 0.1  # linear luminance below which nothing is the sky of a day
EVEN = 0.15  # range of the logarithm of luminance about a pixel of the sky
ABOUT = 5  # px, side of the square in which that is measured
WALL = 0.015, 0.06  # sines of elevations, between which walls go on above and below the horizon
BRIGHTER = 0.7  # quantile of the cameras: things before the sky are darker
STEP = 0.25  # logarithm of a channel between texels of the sky, at most
# Logarithm of a channel by which cameras differ from each other, from which on it is not the sky.
# Captures whose harmonics were cut off (.splat) have .12 where whole ones have .03.
NEAR = 0.16
SAME = 0.35  # logarithm of a channel by which a pixel differs from the map
GREY = 0.8  # logarithm of blue over red, up to which a sky is covered with clouds, over land's
RIVAL = 0.1  # of the largest part of the map, from which on a brighter one is sky
BRIGHT_LAND = 0.05  # of the pixels of a grey sky, that may be brighter
LIKE_LAND = 0.5  # share of what lies below the horizon that may differ so little from the map
AGREED = 0.55  # share of places in the sky, that cameras may agree on, if more so than on land
FARTHEST = 5.0  # times how far cameras stand from their middle, up to which they tell a depth
PLACES = 300  # of either in a picture, on which that is measured
SEEN = 45, 180  # rows and columns of the map of where the sky is seen
LEAST_TEXELS = 6  # that show the sky
LEAST_PIXELS = 30  # of a texel
EQUAL = 0.08  # the same, up to which all pictures have one exposure
ROUNDS, MOST_EXPOSURE = 3, 0.7  # of finding exposures; logarithm of one, at most
TRIES = 3  # parts of the map that are tried
SAME_EXPOSURE = 0.2  # share of the texels that a camera sees, that one exposure must explain
# A region that ends below the edge of the picture is sky if it is a gap between leaves, of so many
# pixels at most, of which one at least is clear sky; panes mirror a part of the sky's light.
GAP, CLEAR = 400, 0.05
RIM = 3  # px beside the sky, that show either
CLOUD = 0.5  # share of the pixels just below a cloud that are sky
PARTLY, COVERED = 0.15, 0.75  # the same behind a roof, and of those just above; of walls 0 to .07


class SkyColors:
    """The colour of the captured sky by direction.

    `color`, (ROWS, COLUMNS, 3), is the logarithm of linear light, row 0 at the horizon; None: no
    camera sees the sky. `exposure`, (views,), is the logarithm by which each view is brighter than
    that: a camera that exposes each picture by itself shows one sky in many shades. The first
    `captured` views are of a capture's own cameras, 0: all are alike.
    """

    def __init__(self, views, captured=0):
        self._land, found = _land_tint(views), _seen(views)
        for _ in range(TRIES):
            known = self._find(len(views), *found)
            doubt = "" if self.color is None else self._doubt(views, captured)
            if doubt != "stands":
                break
            found = [values[~known.ravel()[found[1]]] for values in found]
        if doubt:
            self.color = None

    def _find(self, count, camera, texel, seen):
        """Find colour and exposures from what `_seen` returns; return which texels are sky."""
        self.exposure = np.zeros(count)
        color, spread = _median_map(texel, seen)
        known = _highest_part(color, self._land)
        if _median_of(spread, known) > EQUAL:
            for _ in range(ROUNDS):
                several = known & np.isfinite(spread)
                self.exposure = _exposures(count, camera, texel, seen, color, several)
                color, spread = _median_map(texel, seen - self.exposure[camera, None])
                known = _highest_part(color, self._land)
        self.color = _completed(color, spread, known)
        return known

    def _doubt(self, views, captured):
        """Return why the map tells no sky, "" if it does.

        Fog, or a room of one grey, has its colour below the horizon, too, and walls go on there
        without an edge. And under a grey sky nothing is brighter than the sky: else it is a pale
        wall. "stands": cameras agree on where that is, surer than on the ground.
        """

        def parts(view, exposure):
            direction, light = directions(view)[::2, ::2], view.light[::2, ::2]
            even = _is_even(view.light @ LUMINANCE_WEIGHTS.astype(np.float32))[::2, ::2]
            more = self._more(light, direction, exposure)
            near, high = np.abs(more).max(axis=-1) < SAME, direction[..., 2]
            land, above = high < 2 * LOWEST, high > -LOWEST
            wall = near & above & _goes_below(near & even, high)
            parts = land, near & land, near & above, (more.min(axis=-1) > SAME) & above, wall
            places = [_places(view, direction, part) for part in (land, near & above)]
            return [np.count_nonzero(part) for part in parts], *places

        counts, *places = zip(*of_each(parts, views, self.exposure), strict=True)
        below, alike, sky, brighter, walls = np.sum(counts, axis=0)
        if alike > LIKE_LAND * max(below, 1) or walls > 0.5 * max(sky, 1):
            return "land"
        own = slice(captured or None)
        land, high = (_agreed(np.concatenate(some[own]), views[own]) for some in places)
        if high > max(land, AGREED):
            return "stands"
        return "brighter" if self.is_grey and brighter > BRIGHT_LAND * max(sky, 1) else ""

    @property
    def is_grey(self):
        """Whether the sky, which there is, is covered with clouds."""
        return _is_grey(self.color.reshape(-1, 3), self._land)

    @property
    def balance(self):
        """The colour (3,), float32 of luminance 1, that the pictures show grey things in."""
        tint = np.exp(self._land * (self.color is None or self.is_grey))
        return (tint / (tint @ LUMINANCE_WEIGHTS)).astype(np.float32)

    def _more(self, light, direction, exposure):
        """Return the logarithm by which a view's light exceeds the sky, (..., 3)."""
        return np.log(np.clip(light, 0.01, 1.0)) - np.float32(exposure) - self.at(direction)

    def off(self, light, direction):
        """Return the logarithm by which linear light (..., 3) differs from the sky, (...)."""
        return np.abs(np.log(np.clip(light, 0.01, 1.0)) - self.at(direction)).max(axis=-1)

    def parts(self, views):
        """Return what the pixels of each `DepthView` show, a list of int8 (height, width).

        1: the sky; -1: something else; 0: either. And the masks of pixels in which no surface is
        sought: under a blue sky whatever has its colour: panes mirror it, haze before it shows it.
        """
        if self.color is None:
            parts = [np.full(view.depth.shape, -1, np.int8) for view in views]
            return parts, [part > 0 for part in parts]
        parts, near = zip(*of_each(self._parts, views, self.exposure), strict=True)
        return parts, [part > 0 for part in parts] if self.is_grey else near

    def _parts(self, view, exposure):
        """Return what the pixels of a view show, region by region, and which have the sky's colour.

        A region of the sky has the sky's colour, or is a cloud, and goes on past the edge of the
        picture where it is highest. A pane, a pale roof or a white house ends below that.
        """
        direction = directions(view)
        more, high = self._more(view.light, direction, exposure), direction[..., 2]
        off = np.abs(more).max(axis=-1)
        near = ndimage.median_filter((off < SAME) & (high > LOWEST), 3)
        smooth, count = ndimage.label(_likely(view, direction))  # goes on where the map is a guess
        near |= (ndimage.mean(near, smooth, np.arange(count + 1)) > 0.5)[smooth] & (smooth > 0)
        cloud = ~near & (more.min(axis=-1) > -SAME) & (high > LOWEST)
        sky = near | _clouds(cloud, near, high)
        label, count = ndimage.label(sky)
        number = np.arange(1, count + 1)
        top = np.array(ndimage.maximum_position(high, label, number)).reshape(-1, 2)
        good = ((top == 0) | (top == np.array(high.shape) - 1)).any(axis=1)
        size = np.bincount(label.ravel())[1:]
        gap = (ndimage.minimum(off, label, number) < CLEAR) & (size < GAP)
        good |= gap & (ndimage.mean(off, label, number) < NEAR)
        shown = np.concatenate([[False], good])[label]
        either = (sky | ndimage.binary_dilation(shown, iterations=RIM)) & ~shown
        return np.where(shown, 1, np.where(either, 0, -1)).astype(np.int8), near

    def at(self, direction):
        """Return the logarithm of the sky's colour in directions (..., 3)."""
        row, column = place_on_map(direction, ROWS, COLUMNS)
        wide = np.concatenate([self.color[:, -1:], self.color, self.color[:, :1]], axis=1)
        place = [row - 0.5, (column - 0.5) % COLUMNS + 1]
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


def _places(view, direction, some):
    """Return at most PLACES places [m], (n, 3), that a view shows in some pixels of every second.

    Those with a surface, `direction` away.
    """
    depth = view.depth[::2, ::2]
    which = np.flatnonzero(some & np.isfinite(depth))
    which = which[:: max(1, -(-len(which) // PLACES))]
    ray = direction.reshape(-1, 3)[which]
    return view.eye + ray * (depth.ravel()[which] / (ray @ view.matrix[2, :3]))[:, None]


def _agreed(places, views):
    """Return the share of places (n, 3) that several views see and few look through.

    Cameras side by side tell nothing of what is far.
    """
    eyes = np.array([view.eye for view in views])
    middle = np.median(eyes, axis=0)
    apart = np.median(np.linalg.norm(eyes - middle, axis=1))
    found = counted(np.ascontiguousarray(places, np.float32), np.zeros(len(places), "f4"), views)
    solid = are_agreed(found, LEAST_VIEWS)
    solid &= np.linalg.norm(places - middle, axis=1) < FARTHEST * apart
    return solid.mean() if len(places) else 0.0


def place_on_map(direction, rows, columns):
    """Return row and column, with fractions, of directions (..., 3) on a map of the upper half.

    Row 0 is at the horizon, column 0 at azimuth 0: below the one and right of the other they are
    negative.
    """
    row = np.arcsin(np.clip(direction[..., 2], -1, 1)) / (np.pi / 2) * rows
    return row, np.arctan2(direction[..., 1], direction[..., 0]) / (2 * np.pi) * columns


def seen_sky(views, shown):
    """Return how much of what cameras saw in each direction is sky, float32 (rows, columns).

    In 2 degrees; row 0 is at the horizon, column 0 at azimuth 0. What no camera looked at counts as
    sky. `shown` are masks of the views' pixels of the sky.
    """
    rows, columns = SEEN

    def counted(view, sky):
        direction = directions(view)
        row, column = place_on_map(direction, rows, columns)
        above = row >= 0
        row = np.minimum(row[above].astype(int), rows - 1)
        place = row * columns + np.floor(column[above]).astype(int) % columns
        return [np.bincount(place, some, rows * columns) for some in (None, sky[above])]

    count = np.sum(of_each(counted, views, shown), axis=0)
    share = np.where(count[0] == 0, 1, count[1] / np.maximum(count[0], 1))
    return share.astype(np.float32).reshape(SEEN)


def _likely(view, direction):
    """Return which pixels are even, bright and blue or grey, and above the horizon; not walls."""
    light = view.light @ LUMINANCE_WEIGHTS.astype(np.float32)
    blue = view.light[..., 2] / np.maximum(view.light.max(axis=-1), 1e-3)
    likely, high = _is_even(light) & (light > DARK) & (blue > BLUE), direction[..., 2]
    return likely & ~_goes_below(likely, high) & (high > 0)


def _is_even(light):
    """Return around which pixels the luminance (height, width) hardly changes."""
    log = np.log(np.maximum(light, 0.01))
    return ndimage.maximum_filter(log, ABOUT) - ndimage.minimum_filter(log, ABOUT) < EVEN


def _goes_below(some, high):
    """Return which of some pixels belong to a region that goes on below the horizon: a wall.

    `high` is the sine of the elevation. The sky ends at an edge there.
    """
    label, count = ndimage.label(some & (high > -WALL[1]))
    bands = high < -WALL[0], (high > WALL[0]) & (high < WALL[1])
    low, up = (np.bincount(label.ravel(), band.ravel(), count + 1) for band in bands)
    return ((low > 0.5 * up) & (up > 0))[label] & (label > 0)


def _seen(views):
    """Return camera, texel and logarithm of the colour (3) of what may be sky, of each texel."""

    def seen(n, view):
        direction = directions(view)
        likely = _likely(view, direction)
        row, column = place_on_map(direction[likely], ROWS, COLUMNS)
        row, column = row.astype(np.int64).clip(0, ROWS - 1), np.floor(column).astype(np.int64)
        texel = row * COLUMNS + column % COLUMNS
        color = np.log(np.clip(view.light[likely], 0.01, 1.0))
        order = np.argsort(texel, kind="stable")
        texel, color = texel[order], color[order]
        first = np.flatnonzero(np.diff(texel, prepend=-1))
        ends = zip(first, np.append(first[1:], len(texel)), strict=False)
        return [(n, texel[start], *np.median(color[start:stop], axis=0))
                for start, stop in ends if stop - start >= LEAST_PIXELS]  # fmt: skip

    found = [one for some in of_each(seen, range(len(views)), views) for one in some]
    camera, texel, *color = np.array(found, float).reshape(-1, 5).T
    return camera.astype(int), texel.astype(int), np.stack(color, -1).astype(np.float32)


def _median_map(texel, seen):
    """Return the colours (ROWS, COLUMNS, 3) that cameras saw, and how far these differ."""
    color, spread = np.full((ROWS * COLUMNS, 3), np.nan), np.full(ROWS * COLUMNS, np.nan)
    for n in np.unique(texel):
        own = seen[texel == n]
        # What hides the sky from some cameras is darker.
        bright = np.sum(own, axis=1)
        color[n] = own[np.argsort(bright)[int(BRIGHTER * (len(own) - 1) + 0.5)]]
        if len(own) > 1:
            spread[n] = np.median(np.abs(own - color[n]).max(axis=1))
    return color.reshape(ROWS, COLUMNS, 3), spread.reshape(ROWS, COLUMNS)


def _median_of(spread, known):
    """Return the median of how far cameras differ in known texels, 0 where no two saw any."""
    both = known & np.isfinite(spread)
    return np.median(spread[both]) if both.any() else 0.0


def _exposures(count, camera, texel, seen, color, several):
    """Return the logarithm by which each camera is brighter than the map, where `several` saw it.

    One factor must do for all channels of many texels. Walls that differ from the sky by one factor
    are many, too: of such factors the least is taken. 0 without any.
    """
    exposure = np.zeros(count)
    more = seen - color.reshape(-1, 3)[texel]
    for n in np.unique(camera):
        own = more[(camera == n) & several.ravel()[texel]]
        factor = own.mean(axis=1)
        alike = np.abs(own[:, None] - factor[:, None]).max(axis=-1) < STEP  # of texel, to factor
        good = alike.sum(axis=0) >= max(SAME_EXPOSURE * len(own), LEAST_TEXELS / 2)
        good &= np.abs(factor) < MOST_EXPOSURE
        if good.any():
            least = np.flatnonzero(good)[np.argmin(np.abs(factor[good]))]
            exposure[n] = np.median(factor[alike[:, least]])
    return exposure


def _clouds(cloud, sky, high):
    """Return which regions of bright pixels are clouds: below them is sky again, mostly.

    Or in part, where a roof hides their foot, and above them. A gable before the sky has land below
    it. `high` is the sine of the elevation.
    """
    label, count = ndimage.label(cloud)
    down = np.array([np.median(np.diff(high, axis=axis)) for axis in (0, 1)])
    axis = np.argmax(np.abs(down))

    def open_share(step):  # of the pixels next to each region, a step along the axis
        edge = np.roll(label, -step, axis) != label
        edge.swapaxes(0, axis)[-1 if step > 0 else 0] = False  # what the picture cuts off
        open_ = np.bincount(label[edge & np.roll(sky, -step, axis)], minlength=count + 1)
        return open_ / np.maximum(np.bincount(label[edge], minlength=count + 1), 1)

    step = -int(np.sign(down[axis])) or 1  # to the next pixel below
    below, above = open_share(step), open_share(-step)
    good = (below > CLOUD) | ((below > PARTLY) & (above > COVERED))
    good[0] = False
    return good[label]


def _highest_part(color, land):
    """Return which texels of a map are sky, bool (ROWS, COLUMNS).

    Of the parts of the map that are smooth in themselves the sky is the one that is highest and
    widest; a wall that hides it is another. Where it stands near, what is seen in one direction
    differs from camera to camera. `land`: see `_land_tint`.
    """
    high = (np.arange(ROWS) + 0.5)[:, None] / ROWS * np.pi / 2
    known = np.isfinite(color[..., 0])
    if not known.any():
        return known
    part = _parts(color)
    size = np.broadcast_to(np.sin(high) * np.cos(high), part.shape)
    weight = np.bincount(part[known], size[known])
    light = np.bincount(part[known], size[known] * color[known].mean(axis=-1))
    light /= np.maximum(weight, 1e-9)
    best = np.argmax(weight)
    if _is_grey(color[known & (part == best)], land):  # under a grey sky nothing is brighter
        rivals = (light > light[best] + SAME) & (weight > RIVAL * weight[best])
        best = np.argmax(weight * rivals) if rivals.any() else best
    return known & (part == best)


def _is_grey(color, land):
    """Tell whether logarithms of colours (n, 3) are those of a grey sky."""
    return np.median(color[:, 2] - color[:, 0]) < GREY + land[2] - land[0]


def _land_tint(views):
    """Return the logarithm of the colour (3,) of what lies below the horizon, 0 if not blue.

    A camera that is balanced for lamps shows land blue, and the sky more so.
    """

    def colors(view):
        return view.light[::4, ::4][directions(view)[::4, ::4, 2] < 2 * LOWEST]

    every = np.concatenate([*of_each(colors, views), np.ones((1, 3), np.float32)])
    log = np.log(np.clip(every, 0.01, 1.0))
    tint = np.median(log - log.mean(axis=1, keepdims=True), axis=0)
    return tint if tint[2] > tint[0] else np.zeros(3)


def _completed(color, spread, known):
    """Return a map of the sky without holes, None if too little of it is sky, `known`."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    high, turn = (row + 0.5) / ROWS * np.pi / 2, (column + 0.5) / COLUMNS * 2 * np.pi
    if np.count_nonzero(known) < LEAST_TEXELS or _median_of(spread, known) > NEAR:
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


def _parts(color):
    """Return the number of the smooth part that each texel belongs to."""
    number = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    pairs = []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        other = np.roll(color, -across, axis=1)[down:], np.roll(number, -across, axis=1)[down:]
        alike = np.abs(color[: ROWS - down] - other[0]).max(axis=-1) < STEP
        pairs.append(np.stack([number[: ROWS - down][alike], other[1][alike]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = sparse.coo_matrix((np.ones(len(first)), (first, second)), (number.size, number.size))
    return csgraph.connected_components(graph, directed=False)[1].reshape(ROWS, COLUMNS)
