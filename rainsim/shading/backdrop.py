"""The sky behind the scene: the splats of the captured sky left out, the sky of the day drawn.

A captured sky is made of splats: far, high and bright. The edges of leaves and roofs before it are
blended with it, and a new sky over such a picture leaves a pale fringe and hard steps. So the
splats of the sky are left out, and the sky of the day is drawn where the other splats leave a pixel
open. While clouds cover a part of the sky, the captured sky shows too: drawn once, as a panorama.
"""

import dataclasses

import numpy as np
from scipy.ndimage import median_filter, zoom
from scipy.spatial import cKDTree

from rainsim import constants
from rainsim.constants import HALF, ONE
from rainsim.jit import cpu_kernel, prange
from rainsim.numerics.srgb import linear
from rainsim.raster import Rasterizer, prepare
from rainsim.shading import environment, sky
from rainsim.shading.grading import Look, graded, is_like_sky, undiluted

SH_0 = np.float32(constants.SH_0)
LOWEST = np.float32(-0.06)  # sine of the elevation: a sky's splats are broad, and reach below 0
SKY_SHARE, NEAREST_SKY = 0.7, 30.0  # of the capture's reach [m] where its sky may begin
LOW_EYE = 1.5  # m above the ground, at least, of whom distant ground is drawn for
CLOUD = 5  # texels of the captured sky, 7 degrees: what is narrower than half of it is no cloud


def sky_of(scene, found=None):
    """Return which splats of a scene are its sky, ndarray of shape (n,), bool.

    Those that its cameras show as sky, and of all that is far, high and bright what gives them no
    more light of land than of sky: a far white wall stays. Where no camera can tell, all of it.

    found : surface.kept_surface.Found, optional. What the cameras show; None for
        a built-in scene.
    """
    frame = scene.ground_frame
    if scene.cameras:
        eye = _eye_of(scene)
    elif found is not None:
        eye = frame.to_capture(found.middle.astype(np.float64))
    else:
        return np.zeros(len(scene.splats), np.bool_)
    far = far_sky(scene.splats, frame, eye, _sky_distance(scene))
    return far if found is None else found.sky | (far & found.aloft)


def _eye_of(scene):
    return np.mean([camera.position for camera in scene.cameras], axis=0)


def _sky_distance(scene):
    """Return the distance [m] beyond which splats may be sky; most of a capture is nearer."""
    if not scene.cameras:
        return NEAREST_SKY
    away = np.linalg.norm(scene.splats.position - _eye_of(scene), axis=1)
    reach = float(np.percentile(away * scene.ground_frame.meters_per_unit, 99.5))
    return max(NEAREST_SKY, SKY_SHARE * reach)


class Backdrop:
    """The captured sky behind a scene: its splats, left out of the scene, and its panorama.

    own : bool array (n,). Which splats are its sky, see `sky_of`.
    wanted : bool. Whether another sky is to be seen at any time; if not, nothing
        is taken out.
    unveiled : surface.unveiled.Unveiled, optional. What its sky hides.
    scene : Scene. Without the splats of its sky; the given scene if they cover
        too little of the sky.
    count : int. Splats left out.
    kept : bool array (n,), or slice. Which splats of the given scene `scene` has.
    """

    def __init__(self, scene, own, wanted, unveiled=None):
        self.whole, self.scene, self.count, self.kept = scene, scene, 0, slice(None)
        self._seen, self._height = None, LOW_EYE  # the panorama, once it is drawn
        self._own, self._tree = own, None
        eye = np.mean(scene.splats.position, axis=0)
        if scene.cameras:
            eye = _eye_of(scene)
            self._height = max(float(scene.ground_frame.to_ground(eye)[2]), LOW_EYE)
        if wanted and covered(scene.splats, eye, own) >= sky.LEAST_SKY_SEEN:
            self.count, self._eye = int(own.sum()), eye
            self._sky, self.kept = scene.splats.take(own), ~own
            left = scene.splats if unveiled is None else unveiled.of(scene.splats)
            self.scene = dataclasses.replace(scene, splats=left.take(~own))

    def is_sky(self, position):
        """Return which splats at positions (m, 3), of another level of detail, are left out.

        Those whose nearest splat of the scene is.
        """
        if not self.count:
            return np.zeros(len(position), np.bool_)
        if self._tree is None:
            self._tree = cKDTree(self.whole.splats.position)
        return self._own[self._tree.query(position)[1]]

    def note(self):
        """Return a note on the splats that the sky of the day replaces, None if there are none."""
        if not self.count:
            return None
        return f"sky: that of the day is drawn behind the scene, for {self.count} splats of its own"

    def behind(self, day, look, plain=True):
        """Return the sky that is seen behind the scene, a map of the shape of `day`.

        day : float32 array (rows, columns, 3). The sky that replaces the captured
            one.
        look : Look. Its `sky_replaced` says how much of the captured sky is
            replaced.
        plain : bool. Whether the day has no land of its own, as a panorama has.
        """
        day = sky.with_haze(day, self._height) if plain else day
        if not self.count or look.sky_replaced >= 1:
            return day
        blended = np.empty_like(day)
        _blend_skies(self._panorama(day.shape[0]), day, look, blended)
        return blended

    def _panorama(self, rows):
        """Return colour over black (display-referred) and alpha of the captured sky, as a map."""
        if self._seen is None or len(self._seen) != rows:
            frame, drawn = self.whole.ground_frame, Rasterizer(prepare(self._sky))

            def draw(view):
                shown = drawn.draw(frame.camera_in_capture(view), 0.0)
                return np.concatenate([shown.color, shown.alpha[..., None]], axis=-1)

            seen = environment.probe(draw, frame.to_ground(self._eye))
            # Seen from elsewhere than its cameras, a trained sky has needles and streaks.
            medians = [median_filter(channel, CLOUD, mode="nearest") for channel in seen.T]
            finer = [
                zoom(median, rows / len(seen), order=1, mode="nearest", grid_mode=True)
                for median in medians
            ]
            self._seen = np.ascontiguousarray(np.stack(finer).T)
        return self._seen


def far_sky(splats, frame, eye, distance):
    """Return which splats are far, high and bright as a sky is, ndarray of shape (n,), bool.

    frame : GroundFrame
    eye : array (3,) [capture units]. From where the sky is seen.
    distance : float [m]. Least distance of the sky.
    """
    way = (splats.position - eye.astype(np.float32)) * np.float32(frame.meters_per_unit)
    far = np.sqrt((way * way).sum(axis=1))
    found = (far > distance) & (way @ frame.up.astype(np.float32) > LOWEST * far)
    found[found] = is_like_sky(linear(splats.sh[found, 0] * SH_0 + HALF))
    return found


def covered(splats, eye, which):
    """Return the share of the upper half of the view from `eye` that some splats cover, at most."""
    scale = np.sort(splats.scale[which].astype(np.float64), axis=1)
    square = ((splats.position[which] - eye) ** 2).sum(axis=1)
    return float((splats.opacity[which] * scale[:, 1] * scale[:, 2] / square).sum())


@cpu_kernel
def _blend_skies(captured, day, look: Look, sky_out):
    """Blend the graded captured sky with the day's, by the share that `look` replaces.

    captured : ndarray of shape (rows, columns, 4), float32
        Colour over black, display-referred, and alpha.
    """
    rows, columns = day.shape[0], day.shape[1]
    for row in prange(rows):
        for column in range(columns):
            alpha = captured[row, column, 3]
            r, g, b = undiluted(
                captured[row, column, 0], captured[row, column, 1], captured[row, column, 2], alpha
            )
            r, g, b = graded(r, g, b, look)
            share = alpha * (ONE - look.sky_replaced)
            open_ = ONE - share
            sky_out[row, column, 0] = share * r + open_ * day[row, column, 0]
            sky_out[row, column, 1] = share * g + open_ * day[row, column, 1]
            sky_out[row, column, 2] = share * b + open_ * day[row, column, 2]
