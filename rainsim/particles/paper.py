"""The rain of the paper (RainyGS), for comparison: lines of spheres and one Gaussian a splash.

What its text leaves open is chosen here, and said: how many drops, how long a line, what "adjusted
to the base image's normalised brightness" means, and two of the three axes of a splash.
"""

import numpy as np

from rainsim.drops import impacts
from rainsim.numerics.random import mix, uniform
from rainsim.particles.line_raster import NEAR
from rainsim.particles.shutter_view import footprint
from rainsim.particles.splash_pass import FARTHEST, MARGIN
from rainsim.particles.streaks import draw_streaks
from rainsim.rain.size_distribution import drop_volume
from rainsim.scene.view import corner_rays

SPHERE_RADIUS = 6e-3  # m; the supplement's, in the unknown units of its scenes
LINE_LENGTH = 0.15  # m; not given
APART = 0.5  # radii between spheres: "densely aligned"
GREY = 200 / 255  # of display white: "near-white RGB of [200, 200, 200]"
DRAWN_SHARE = 1 / 100  # of the drops: with all of them, 12 mm wide, one would see metres far
SPLASH_LENGTH = 2.0  # longest axis of a splash over the other two; not given


def draw_lines(field, surfaces, camera, time, far, depth, alpha_out):
    """Draw drops as lines of opaque spheres, whatever their size and the exposure.

    depth : float32 array (height, width) [m]
    alpha_out : float32 array (height, width). Overwritten.

    A drop is there unless its own place lies below the map's occluder top or ground: the paper
    tests points, so nothing falls under cover, however slanted the rain.
    """
    rays = np.concatenate([corner_rays(camera), np.zeros((1, 3))])
    view = far * rays @ camera.camera_from_world[:3, :3] + camera.position
    reach = np.full(3, LINE_LENGTH)
    drops = field.drops_in_box(time, view.min(axis=0) - reach, view.max(axis=0) + reach)
    chosen = uniform(mix(drops.id)) < DRAWN_SHARE
    place = drops.position[chosen]
    column, row = np.floor((place[:, :2] - surfaces.origin) / surfaces.spacing).astype(int).T
    ny, nx = surfaces.shape
    on_map = (column >= 0) & (row >= 0) & (column < nx) & (row < ny)
    top = np.where(on_map, surfaces.top[row.clip(0, ny - 1), column.clip(0, nx - 1)], -np.inf)
    above = place[:, 2] > top
    place, velocity = place[above], drops.velocity[chosen][above]
    along = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    steps = np.arange(0.0, LINE_LENGTH, APART * SPHERE_RADIUS)
    spheres = (place[:, None] - along[:, None] * steps[:, None]).reshape(-1, 3)
    size = np.full(len(spheres), 2 * SPHERE_RADIUS)
    lines = np.column_stack([spheres, np.zeros_like(spheres), size])
    draw_streaks(field, None, camera, time, 1.0, depth, NEAR, alpha_out, more=lines)


def draw_gaussians(field, surfaces, camera, start, stop, depth, alpha_out):
    """Draw each drop that fell from `start` to `stop` [s] as one Gaussian where it fell.

    start, stop : float [s]. One frame: the paper's splash is there in the frame
        in which its drop vanishes.

    The covariance has det Sigma = V^2, so the standard deviations' product is the drop's volume
    V; the longest lies along v - (v . n) n with n = z, the others are equal here. Vertical rain
    has no such direction: there it lies along x. Drawn as a disc of the Gaussian's summed opacity,
    2 pi times two standard deviations, spread along the longest.
    """
    found = impacts(field, surfaces, start, stop, within=footprint(camera, FARTHEST, MARGIN))
    longest, middle = gaussian_axes(found.diameter)
    flat = np.array(found.velocity)
    flat[:, 2] = 0
    speed = np.linalg.norm(flat, axis=1)
    flat[speed == 0] = (1.0, 0.0, 0.0)
    axis = flat / np.maximum(np.linalg.norm(flat, axis=1), 1e-12)[:, None]
    # A disc that moves by sqrt(12 (s1^2 - s2^2)) has the Gaussian's spread along the axis.
    way = axis * np.sqrt(12 * (longest**2 - middle**2))[:, None]
    disc = np.sqrt(8 * longest * middle)  # (pi/4) d^2 = 2 pi s1 s2
    lines = np.column_stack([found.position - way / 2, way, disc])
    draw_streaks(field, None, camera, start, 1.0, depth, NEAR, alpha_out, more=lines)


def gaussian_axes(diameter):
    """Return the standard deviations (longest, each of the others) [m] of a drop's splash."""
    middle = (drop_volume(diameter) / SPLASH_LENGTH) ** (1 / 3)
    return SPLASH_LENGTH * middle, middle


def line_radiance(picture):
    """Return the linear radiance (3,) of lines and splashes over a picture in linear light.

    "Adjusted according to the base image's normalized brightness", which the paper does not
    define: here RGB 200 times the mean display brightness over one half, at most 1.
    """
    brightness = float(np.mean(np.clip(picture, 0.0, 1.0), dtype=np.float64))
    shown = brightness ** (1 / 2.2)  # display value of the mean light
    grey = (GREY * min(shown / 0.5, 1.0)) ** 2.2
    return np.full(3, grey, np.float32)
