"""Reflections in water by a march through the picture's own depth (screen-space reflection).

The ray of level water is marched (`rainsim.ssr`); the rays that ripples bend end as far away as it
does, where the picture shows that point: marching each bent ray gives noise. Where the picture
shows nothing of what is mirrored, the environment map is.
"""

import numpy as np

from rainsim.constants import FAR_AWAY, HALF, ONE, ZERO
from rainsim.jit import cpu_kernel, inlined_function, lean_function, prange
from rainsim.numerics.interpolation import bilinear_color
from rainsim.reflection.facets import light_weight, slope_samples
from rainsim.reflection.mirrored_rays import ENVIRONMENT, SCREEN, sample_ray
from rainsim.reflection.water_record import read_record
from rainsim.reflection.water_shading import NEAREST
from rainsim.scene.view import View, in_camera
from rainsim.shading.environment import sample_environment
from rainsim.ssr import DepthBlocks, MarchSettings, edge_fade, march

NOT_GROUND = np.float32(0.03)  # m over the bed: what stands higher can be reflected
EDGE_SHARE = np.float32(0.06)  # of the picture, over which reflections fade to the surroundings
HIDDEN_SHARE = np.float32(0.3)  # of a ray's length, by which its end may lie behind what is seen


@inlined_function
def level_hit(view, blocks, settings, water):
    """Return how far the mirrored ray of level water goes until it meets something [m].

    Negative if it meets nothing that the picture shows.
    """
    return march(
        blocks, view, surface_in_camera(view, water),
        in_camera(view, water.view_x, water.view_y, -water.view_z), settings,
    )  # fmt: skip


@inlined_function
def surface_in_camera(view, water):
    """Return a pixel's surface point in the camera frame [m]."""
    eye = view.eye
    x, y, _ = in_camera(view, water.x - eye[0], water.y - eye[1], water.z - eye[2])
    return x, y, water.view_depth


@inlined_function
def screen_light(view, picture, depth, environment, thickness, water, distance):
    """Return the radiance (r, g, b) that a pixel of water mirrors, and the picture's share of it.

    picture : float32 array (height, width, 3)
    depth : float32 array (height, width) [m]. Of what can be mirrored, see
        `keep_tall`.
    environment : float32 array (rows, columns, 3)
    thickness : float32 [m]. How far behind its depth a surface still stops a ray.
    water : WaterPixel
    distance : float32 [m]. As `level_hit` returns it.
    """
    start = surface_in_camera(view, water)
    samples, a, b, c = slope_samples(water)
    red, green, blue, seen, total = ZERO, ZERO, ZERO, ZERO, ZERO
    for sample in range(samples):
        rx, ry, rz = sample_ray(water, a, b, c, sample)
        u, v, share = on_screen(view, depth, start, water, rx, ry, rz, distance, thickness)
        weight = light_weight(water, a, b, c, sample)
        total += weight
        seen += weight * share
        if share < ONE:
            c0, c1, c2 = sample_environment(environment, rx, ry, rz)
            open_ = weight * (ONE - share)
            red, green, blue = red + open_ * c0, green + open_ * c1, blue + open_ * c2
        if share > ZERO:
            c0, c1, c2 = bilinear_color(picture, u, v)
            share *= weight
            red, green, blue = red + share * c0, green + share * c1, blue + share * c2
    gain = ONE / total
    return red * gain, green * gain, blue * gain, seen * gain


@inlined_function
def surrounding_light(environment, water):
    """Return the radiance (r, g, b) that a pixel of water mirrors of an environment map."""
    samples, a, b, c = slope_samples(water)
    red, green, blue, total = ZERO, ZERO, ZERO, ZERO
    for sample in range(samples):
        rx, ry, rz = sample_ray(water, a, b, c, sample)
        c0, c1, c2 = sample_environment(environment, rx, ry, rz)
        weight = light_weight(water, a, b, c, sample)
        total += weight
        red, green, blue = red + weight * c0, green + weight * c1, blue + weight * c2
    gain = ONE / total
    return red * gain, green * gain, blue * gain


@inlined_function
def on_screen(view, depth, start, water, rx, ry, rz, distance, thickness):
    """Return where the picture shows the hit of a mirrored ray, and the share to take from there.

    The end is that of the bent ray r at the distance of level water's hit or, if the picture does
    not show it, that of level water's own ray.
    """
    if not distance > ZERO:
        return ZERO, ZERO, ZERO
    u, v, share = end_seen_at(view, depth, start, rx, ry, rz, distance, thickness)
    if share <= ZERO:
        u, v, share = end_seen_at(
            view, depth, start, water.view_x, water.view_y, -water.view_z, distance, thickness
        )
    return u, v, share


@lean_function
def end_seen_at(view, depth, start, rx, ry, rz, distance, thickness):
    """Return where the end of a ray of length `distance` shows, and how far to trust it.

    The ray starts at camera point `start` and goes along the ground-frame direction r. Trust is 0
    if something in front hides the end, and falls to 0 at the picture's edge.
    """
    dx, dy, dz = in_camera(view, rx, ry, rz)
    ex, ey, ez = start[0] + distance * dx, start[1] + distance * dy, start[2] + distance * dz
    if ez < NEAREST:
        return ZERO, ZERO, ZERO
    h, w = np.float32(depth.shape[0]), np.float32(depth.shape[1])
    u, v = view.fx * ex / ez + view.cx, view.fy * ey / ez + view.cy
    if not (u >= ZERO and v >= ZERO and u < w and v < h):
        return ZERO, ZERO, ZERO
    surface = depth[int(v), int(u)]
    if ez - surface > thickness + distance * HIDDEN_SHARE:
        return ZERO, ZERO, ZERO
    if not surface < FAR_AWAY:
        return ZERO, ZERO, ZERO
    return u, v, edge_fade(u, v, w, h, EDGE_SHARE)


@cpu_kernel
def march_light(
    which, record, picture, blocks: DepthBlocks, view: View, environment, settings: MarchSettings,
    light_out, source_out,
):  # fmt: skip
    """Find the mirrored light of listed water by a march through the picture's own depth.

    which : int64 array (k,). Records that are marched.
    record : float32 array (n, RECORD)
    picture : float32 array (height, width, 3)
    blocks : DepthBlocks. Of the depth that `keep_tall` keeps.
    environment : float32 array (rows, columns, 3). Mirrored where the picture
        shows nothing.
    settings : MarchSettings
    light_out : float32 array (n, 3). Radiance that comes to the surface, before
        it is multiplied by the reflectance.
    source_out : uint8 array (n,). SCREEN or ENVIRONMENT.
    """
    for k in prange(len(which)):
        n = which[k]
        water = read_record(record, n)
        distance = level_hit(view, blocks, settings, water)
        r, g, b, seen = screen_light(
            view, picture, blocks.depth, environment, settings.thickness, water, distance
        )
        light_out[n, 0], light_out[n, 1], light_out[n, 2] = r, g, b
        source_out[n] = SCREEN if seen > HALF else ENVIRONMENT


@cpu_kernel
def environment_light(which, record, environment, light_out, source_out):
    """Find the light that listed water mirrors of the surroundings alone; see `march_light`."""
    for k in prange(len(which)):
        n = which[k]
        r, g, b = surrounding_light(environment, read_record(record, n))
        light_out[n, 0], light_out[n, 1], light_out[n, 2] = r, g, b
        source_out[n] = ENVIRONMENT


@cpu_kernel
def keep_tall(depth, clearance, tall_out):
    """Keep the depth of all but the ground, which level water on it cannot mirror.

    depth, clearance : float32 array (height, width) [m]. Depth along the view
        axis, height above the ground.
    tall_out : float32 array (height, width) [m]. The depth; infinite for the
        ground.
    """
    height, width = depth.shape
    for row in prange(height):
        for column in range(width):
            low = clearance[row, column] < NOT_GROUND
            tall_out[row, column] = np.float32(np.inf) if low else depth[row, column]
