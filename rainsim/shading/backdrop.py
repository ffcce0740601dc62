"""The sky behind all: the capture's own taken out of the splats, that of the day drawn instead.

A captured sky is splats, too: far, high and bright. Where leaves and roofs stand before it their
edges are mixed with it; a sky that is laid over such a picture leaves a pale fringe and hard steps.
So those splats are left out, and the sky is drawn behind what the others leave open. What still
shows of the captured sky, while clouds cover only a part of it, is drawn once, as a panorama.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from rainsim import sky
from rainsim.jit import cpu_kernel, prange, serial_kernel
from rainsim.light import linear_from_display
from rainsim.raster import Rasterizer, prepare
from rainsim.shade import HALF, ONE, ZERO, graded, sky_share

HARMONIC = np.float32(0.28209479177387814)  # of degree 0
LOWEST = np.float32(-0.06)  # sine of the elevation: a sky's splats are broad, and reach below 0
SKY_SHARE, NEAREST_SKY = 0.7, 30.0  # of the capture's reach [m] where its sky may begin
SURE = np.float32(0.5)  # sky_share from which a splat is sky


def sky_distance(scene):
    """Return the distance [m] beyond which what a capture shows may be sky: most is nearer."""
    if not scene.cameras:
        return NEAREST_SKY
    eye = np.mean([camera.position for camera in scene.cameras], axis=0)
    away = np.linalg.norm(scene.splats.position - eye, axis=1) * scene.ground_frame.meters_per_unit
    return max(NEAREST_SKY, SKY_SHARE * float(np.percentile(away, 99.5)))


class Backdrop:
    """What lies behind the splats of a scene.

    Parameters
    ----------
    scene : Scene
    distance : float [m]
        Beyond which what is bright may be sky.
    wanted : bool
        Whether another sky is to be seen at any time; if not, nothing is taken out.

    Attributes
    ----------
    scene : Scene
        Without the splats of its sky; the same scene if it has too few to tell.
    count : int
        Splats left out.
    """

    def __init__(self, scene, distance, wanted):
        self.whole, self.scene, self.count = scene, scene, 0
        if not wanted or not scene.cameras:
            return
        eye = np.mean([camera.position for camera in scene.cameras], axis=0)
        found = sky_splats(scene.splats, scene.ground_frame, eye, distance)
        if covered(scene.splats, eye, found) >= sky.LEAST_SKY_SEEN:
            self.count, self._eye = int(found.sum()), eye
            self._sky = scene.splats.take(found)
            self.scene = dataclasses.replace(scene, splats=scene.splats.take(~found))

    def note(self):
        """Return in words what was done; None if nothing was."""
        if not self.count:
            return None
        return f"sky: that of the day is drawn behind the scene, for {self.count} splats of its own"

    def mixed(self, day, look):
        """Return the sky that is seen behind the scene, a map of the shape of `day`.

        Parameters
        ----------
        day : ndarray of shape (rows, columns, 3), float32
            The sky that takes the place of the captured one.
        look : ndarray of shape (6,), float32
            See `shade.grade_and_wet`; what it does not replace is the captured sky.
        """
        if not self.count or look[3] >= 1:
            return day
        made = np.empty_like(day)
        _mix(self._panorama(day.shape[0]), day, look, made)
        return made

    def _panorama(self, rows):
        """Return colour over black (display-referred) and alpha of the captured sky, as a map."""
        if getattr(self, "_seen", None) is None or len(self._seen) != rows:
            frame, drawn = self.whole.ground_frame, Rasterizer(prepare(self._sky))

            def draw(view):
                shown = drawn.draw(frame.camera_in_capture(view), 0.0)
                return np.concatenate([shown.color, shown.alpha[..., None]], axis=-1)

            self._seen = sky.probe(draw, frame.to_ground(self._eye), rows, 2 * rows)
        return self._seen


def sky_splats(splats, frame, eye, distance):
    """Return which splats are far, high and bright as a sky is, ndarray of shape (n,), bool.

    Parameters
    ----------
    splats : Splats
    frame : GroundFrame
    eye : ndarray of shape (3,) [capture units]
        From where it is seen.
    distance : float [m]
        That it is away at least.
    """
    found = np.zeros(len(splats), np.bool_)
    away = (splats.position - eye.astype(np.float32)) * np.float32(frame.meters_per_unit)
    _find(away, frame.up.astype(np.float32), splats.sh[:, 0], np.float32(distance), found)
    return found


def covered(splats, eye, which):
    """Return the share of the upper half of the view from `eye` that some splats cover, at most."""
    scale = np.sort(splats.scale[which].astype(np.float64), axis=1)
    square = ((splats.position[which] - eye) ** 2).sum(axis=1)
    return float((splats.opacity[which] * scale[:, 1] * scale[:, 2] / square).sum())


@serial_kernel
def _find(away, up, color, distance, found_out):
    """Tell for each splat whether it is sky; `color` (n, 3) is that of its harmonic of degree 0."""
    for n in range(len(away)):
        x, y, z = away[n, 0], away[n, 1], away[n, 2]
        far = np.sqrt(x * x + y * y + z * z)
        high = x * up[0] + y * up[1] + z * up[2]
        if far > distance and high > LOWEST * far:
            r = linear_from_display(max(color[n, 0] * HARMONIC + HALF, ZERO))
            g = linear_from_display(max(color[n, 1] * HARMONIC + HALF, ZERO))
            b = linear_from_display(max(color[n, 2] * HARMONIC + HALF, ZERO))
            found_out[n] = sky_share(r, g, b) > SURE


@cpu_kernel
def _mix(seen, day, look, sky_out):
    """Lay the graded captured sky, so much of it as `look` does not replace, over that of the day.

    seen : ndarray of shape (rows, columns, 4), float32
        Colour over black, display-referred, and alpha.
    """
    rows, columns = day.shape[0], day.shape[1]
    for row in prange(rows):
        for column in range(columns):
            over = seen[row, column, 3]
            inv = ONE / max(over, np.float32(1e-3))
            r, g, b = graded(
                linear_from_display(max(seen[row, column, 0], ZERO) * inv),
                linear_from_display(max(seen[row, column, 1], ZERO) * inv),
                linear_from_display(max(seen[row, column, 2], ZERO) * inv),
                look[0], look[1], look[2],
            )  # fmt: skip
            share = over * (ONE - look[3])
            rest = ONE - share
            sky_out[row, column, 0] = share * r + rest * day[row, column, 0]
            sky_out[row, column, 1] = share * g + rest * day[row, column, 1]
            sky_out[row, column, 2] = share * b + rest * day[row, column, 2]
