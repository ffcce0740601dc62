"""Which of a capture's cameras to draw where none is asked for: the one that shows most water.

Rain shows on water more than on anything else, and water seen steeply mirrors a thirtieth of the
light. The map says where water will stand and what stands before it; no picture is drawn.
"""

import numpy as np

from rainsim.scene.view import image_point
from rainsim.shading.fresnel import fresnel
from rainsim.terrain.types import UNKNOWN
from rainsim.water.puddles import WET, puddles_of

RAIN = 8e-3  # m: a shower's puddles, whatever it rains, so that all weathers show one view
PLACES = 384  # of water that are looked at
STEPS = 32  # of a line of sight at which the map is asked what stands there
CLEARANCE = 0.03  # m that a line of sight may dip into the map: its noise
NEAREST = 0.3  # m along the view axis; what is nearer fills the picture's foot, whatever it is
_COSINES = np.linspace(0.0, 1.0, 257)
_REFLECTANCE = np.array([fresnel(np.float32(c)) for c in _COSINES], np.float64)


def view_of_water(scene, terrain):
    """Return the camera of a scene in whose picture puddles would mirror most light.

    scene : Scene. With at least one camera.
    Returns Camera. In the capture frame; the scene's first if no camera shows
        water.
    """
    puddles = puddles_of(terrain)
    puddles.rain(RAIN)
    places, area = places_of_water(terrain, puddles.depth)
    if not len(places):
        return scene.cameras[0]
    path = (scene.ground_frame.camera_in_ground(camera) for camera in scene.cameras)
    shares = [mirrored_share(camera, places, area, terrain) for camera in path]
    return scene.cameras[int(np.argmax(shares))]


def places_of_water(terrain, depth):
    """Return places on water (n, 3) [m], ground frame, and the area [m2] that each stands for.

    `depth` (ny, nx) [m] is that of the water; where no camera saw the ground it does not count.
    """
    found = np.flatnonzero((depth >= WET) & (terrain.source != UNKNOWN))
    count = min(PLACES, len(found))
    if not count:
        return np.zeros((0, 3)), 0.0
    chosen = found[(2 * np.arange(count) + 1) * len(found) // (2 * count)]
    row, column = np.divmod(chosen, depth.shape[1])
    x, y = terrain.grid.centres()
    z = terrain.bed[row, column] + depth[row, column]
    return np.column_stack([x[column], y[row], z]), terrain.grid.cell_area * len(found) / count


def mirrored_share(camera, places, area, terrain):
    """Return the share of a picture's light that water mirrors: picture areas times reflectances.

    camera : Camera. In the ground frame.
    places : float64 array (n, 3) [m]
    area : float [m2]. That each of the `places` stands for, level.
    """
    offset = places - camera.position
    right, down, ahead = camera.camera_from_world[:3, :3] @ offset.T
    above = -offset[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = image_point(camera, right, down, ahead)
    seen = (ahead > NEAREST) & (above > 0)
    seen &= (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    offset, ahead, above = offset[seen], ahead[seen], above[seen]
    # A level area A at depth z, by h below the eye, covers f^2 A h / z^3 of the picture.
    covered = camera.fx * camera.fy * area * above / ahead**3
    reflected = np.interp(above / np.linalg.norm(offset, axis=1), _COSINES, _REFLECTANCE)
    shown = covered * reflected * ~_hidden(places[seen], camera.position, terrain)
    return float(shown.sum()) / (camera.width * camera.height)


def _hidden(places, eye, terrain):
    """Tell for each of the places (n, 3) whether the map has something before it."""
    along = ((np.arange(STEPS) + 0.5) / STEPS) ** 2  # closer steps where the line of sight is low
    x, y, z = (places[:, a, None] + along * (eye[a] - places[:, a, None]) for a in range(3))
    row, column, inside = terrain.grid.cells(x, y)
    within = z < terrain.top[row, column] - CLEARANCE
    within &= z > terrain.underside[row, column]  # below it one looks through
    return (inside & within).any(axis=1)
