"""Where the sky of the day shows through a capture that holds no sky of its own.

Many captures leave the sky out, so that what covers it least is open: there the sky of the day is
drawn. But dark things were trained over black and are open too: panes, eaves, doorways. Their place
distinguishes them: the sky is what is connected with the zenith, and gaps in a crown high above.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.io import cache
from rainsim.raster import Rasterizer
from rainsim.shading.color import roughly_linear
from rainsim.shading.environment import COLUMNS, ROWS, directions, probe
from rainsim.surface.captured_sky import place_on_map

SOLID = 0.5  # alpha from which a direction is covered
CLEAR = 0.1  # alpha below which a gap is surely open
HIGH_GAP = math.sin(math.radians(35))  # sine of the elevation above which gaps show the sky
PROBES = 4  # places of cameras beside the middle that the capture is seen from
PARALLAX = math.radians(2.5)  # by which the skyline moves from one camera to another
BEHIND = 2  # texels by which the sky goes on behind what hides it from one place
SOFT = 1.0  # texels over which the sky goes over into what hides it
# Share of what cameras saw in a direction, from which on the sky is open there; and in mirrored
# pictures, whose low things have holes, which are no sky.
LEAST_SEEN, MOSTLY_SEEN = 0.02, 0.3
FILL = math.radians(6)  # over which the colours of what hides the sky are spread


class Skyline(NamedTuple):
    """The sky and the land in directions that no splat covers; maps as in `environment`."""

    open: np.ndarray  # (rows, columns) float32: share of the day's sky, 0 to 1
    land: np.ndarray  # (rows, columns, 3) float32: linear captured light of what hides the sky


def skylines(scene, prepared, first_camera, near, seen=None):
    """Return the `Skyline` of all splats of a scene, and that without those prepared to come last.

    Kept for the next run.

    prepared : PreparedSplats. Of its splats.
    first_camera : Camera. Of the frames, in the capture frame: from there it is
        seen if the scene has no cameras.
    near : float [capture units]
    seen : float32 array (rows, columns), optional. How much cameras saw of the
        sky, see `surface.captured_sky.seen_sky`: there alone it is open.
    """
    places = places_of(scene, first_camera)
    if seen is not None:
        places = places[:1]  # the land alone is drawn
    parts = (False,) if prepared.leading is None else (False, True)

    def draw():
        rasterizer, found = Rasterizer(prepared), {}
        for part in parts:

            def seen(view, part=part):
                camera = scene.ground_frame.camera_in_capture(view)
                layers = rasterizer.draw(camera, near, leading=part)
                return np.concatenate([layers.color, layers.alpha[..., None]], axis=-1)

            open_, land = seen_from(seen, places)
            found |= {f"open {int(part)}": open_, f"land {int(part)}": land}
        return found

    # Named by what is drawn: its colours are those of the run's weather.
    found = cache.kept_arrays("skyline", draw, prepared, scene.ground_frame, places, near)
    both = [Skyline(found[f"open {int(part)}"], found[f"land {int(part)}"]) for part in parts]
    if seen is not None:
        both = opened(both[0], seen > LEAST_SEEN), opened(both[-1], seen > MOSTLY_SEEN)
    return both[0], both[-1]


def opened(skyline, seen):
    """Return a skyline that is open where the capture's cameras saw the sky, and nowhere else.

    Another place would not do: past a building's end it looks into what was never captured, where
    from here a dark doorway is half open.

    seen : bool array (rows, columns). Below the horizon it is open where it was,
        if the horizon is.
    """
    rows, columns = seen.shape
    direction = directions(*skyline.open.shape)
    row, column = place_on_map(direction, rows, columns)
    there = seen[np.clip(row.astype(int), 0, rows - 1), np.floor(column).astype(int) % columns]
    there = ndimage.maximum_filter(there, 2 * BEHIND + 1, mode=("nearest", "wrap"))
    share = ndimage.gaussian_filter(there.astype(np.float32), SOFT, mode=("nearest", "wrap"))
    return skyline._replace(open=np.where(row < 0, np.minimum(share, skyline.open), share))


def seen_from(draw, places):
    """Return the `Skyline` of a capture.

    draw : callable. draw(camera) returns the picture (height, width, 4) that a
        ground-frame camera takes: colour over black (display-referred) and alpha.
    places : array (n, 3) [m]. From where it is seen, the first in the middle.
        What is open from one of them counts as open, for the frames' cameras
        stand elsewhere.
    """
    (open_, thin), land = np.zeros((2, ROWS, COLUMNS), np.bool_), None
    for place in places:
        seen = probe(draw, place)
        open_ |= open_sky(seen[..., 3])
        thin |= seen[..., 3] < SOLID
        land = spread_colors(seen) if land is None else land
    reach = round(PARALLAX * ROWS / math.pi)
    # What is solid from everywhere is no sky: eaves and gutters are dark and half covered besides.
    wide = ndimage.maximum_filter(open_, 2 * reach + 1, mode=("nearest", "wrap")) & (open_ | thin)
    if len(places) == 1:
        # No other place sees past an outline, yet the sky goes on behind it: dark land that is
        # interpolated between the map's texels would glow about trees before the sky.
        wide = ndimage.maximum_filter(wide, 2 * BEHIND + 1, mode=("nearest", "wrap"))
    share = ndimage.gaussian_filter(wide.astype(np.float32), SOFT, mode=("nearest", "wrap"))
    return Skyline(share, land)


def open_sky(alpha):
    """Return which texels of a map of alpha show the sky, ndarray of bool.

    Those that are connected with the zenith through texels less than half covered, and clear gaps
    high above.
    """
    direction = directions(*alpha.shape)
    thin = alpha < SOLID
    twice = np.concatenate([thin, thin], axis=1)  # columns meet at the map's edge
    label, _ = ndimage.label(twice)
    top = np.unique(label[0][twice[0]])
    joined = np.isin(label, top) & twice
    columns = alpha.shape[1]
    sky = joined[:, :columns] | joined[:, columns:]
    return sky | ((alpha < CLEAR) & (direction[..., 2] > HIGH_GAP))


def spread_colors(seen):
    """Return the linear colours of a probe, spread over its open directions."""
    rows = seen.shape[0]
    alpha = seen[..., 3:]
    color = roughly_linear(seen[..., :3] / np.maximum(alpha, 1e-3), 4) * alpha
    total, weight = np.zeros_like(color), np.zeros_like(alpha)
    for wider in (1, 3, 9):  # the nearest colours count most
        sigma = wider * FILL * rows / math.pi
        mode = ("nearest", "wrap", "nearest")
        share = 1e-3 ** (wider - 1)
        total += share * ndimage.gaussian_filter(color, (sigma, sigma, 0), mode=mode)
        weight += share * ndimage.gaussian_filter(alpha, (sigma, sigma, 0), mode=mode)
    return np.ascontiguousarray(total / np.maximum(weight, 1e-30), np.float32)


def places_of(scene, first_camera):
    """Return the places from which a scene's surroundings are drawn, (n, 3) [m], ground frame.

    The first is the mean of its cameras' places, the others are up to PROBES cameras, each as far
    as possible from those before. Without cameras it is the place of `first_camera` alone, which is
    in the capture frame.
    """
    frame = scene.ground_frame
    if not scene.cameras:
        return frame.to_ground(first_camera.position)[None]
    eyes = frame.to_ground(np.array([camera.position for camera in scene.cameras]))
    middle = eyes.mean(axis=0)
    chosen = [middle]
    for _ in range(min(PROBES, len(eyes))):  # each the farthest from those that are chosen
        away = [np.linalg.norm(eyes - place, axis=1) for place in chosen]
        chosen.append(eyes[np.argmin(-np.min(away, axis=0))])
    return np.array(chosen)


def with_skyline(day, skyline, exposure):
    """Return the sky of the day, a map, where a skyline shows it, and below it the land's light.

    `exposure` is the factor on captured light. The map's rows may be more than the skyline's.
    """
    times = day.shape[0] // skyline.open.shape[0]
    open_ = np.kron(skyline.open, np.ones((times, times), np.float32))[..., None]
    if times > 1:
        mode = ("nearest", "wrap", "nearest")
        open_ = ndimage.uniform_filter(open_, (times, times, 1), mode=mode)
    land = np.kron(skyline.land, np.ones((times, times, 1), np.float32)) * np.float32(exposure)
    return np.ascontiguousarray(land + open_ * (day - land), np.float32)
