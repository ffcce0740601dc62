"""What a pixel shows of a captured surface: its place, and whether that is the ground.

Where the bed is poorly known, splats of the ground lie before and behind it: then the ray that
shows one shows the bed, where it meets that. Places and normals are in the ground frame.
"""

import math
from typing import NamedTuple

import numpy as np

from rainsim.constants import FAR_AWAY, ONE, SURFACE_ALPHA, ZERO
from rainsim.jit import inlined_function, lean_function
from rainsim.numerics.interpolation import bilinear, is_on_map, map_place, smoothstep
from rainsim.scene.view import column_slope, row_slope
from rainsim.shading.bodies import NO_BODIES
from rainsim.shading.smooth_normals import EACH, SAMPLES, sample, turned

# Cosines to the vertical: below the first a surface counts as upright, from the second on not at
# all, above the third as level.
LEANS, SLOPES, FLAT = (np.float32(v) for v in (0.1, 0.3, 0.7))
# Heights over the bed [m]: up to the first all is ground that is not upright, from the second on
# what slopes is not; up to the third what is level is ground, from the fourth on nothing is.
FOOT, FOOT_END, LOW, HIGH = (np.float32(v) for v in (0.05, 0.1, 0.2, 0.4))
LAYER_END = np.float32(2)  # the same over the thickness of a layer of splats about a poor bed
BELOW_EYE = np.float32(0.8)  # share of the eye's height, at which no ground shows, where that fades
NO_LAYER = np.empty((0, 0), np.float32)  # of a bed that is known
HAZE = np.float32(0.3)  # alpha below which splats seen from above are none of the ground
STEP, STEPS = np.float32(0.15), 40  # m, and how many, in which a ray to the bed looks for walls
WALL_SHARE = np.float32(0.15)  # of the depth by which a wall's plane may differ from it
# Where poor ground's splats and what stands on it mix, pictures tell the two apart: so many layers
# over the bed. Ratios of a place's depth to the depth there, up to which nothing stands and from
# which a thing does; and of the depth shown to that of the thing, up to which both are one and from
# which the thing hangs before the ground, unless it comes down to the first of the heights. By eye:
# depths of such captures are off by half.
OVER = np.float32(1), np.float32(2), np.float32(2.5), np.float32(3)
BEFORE, BEHIND = np.float32(0.4), np.float32(1.2)
SAME, OTHER = np.float32(1.1), np.float32(1.5)
REGION = np.float32(0.015)  # of the focal length: half the radius over which depths are averaged
NOT_POOR = np.float32(-1)  # in place of a share, on ground that is known
TO_BORDER = np.float32(1.01)  # cells before the map's end that interpolation still reaches


class GroundMaps(NamedTuple):
    """The mapped ground: its height and how wet each cell is; read-only."""

    bed: np.ndarray  # (ny, nx) float32 [m]
    wetness: np.ndarray  # (ny, nx, 4) float32, see `Wetness`
    origin: np.ndarray  # (2,) float32 [m], corner of the first cell
    spacing: np.float32  # m
    bodies: np.ndarray = NO_BODIES  # (ny, nx, 3) or (0, 0, 3) uint8, see `bodies.body_map`
    # How far from a poorly known bed the splats lie that show it, float32 [m], (ny, nx), less than
    # two rows where it is known; and the most of it. Negative: things stand there. See `on_bed`.
    layer: np.ndarray = NO_LAYER
    thickest_layer: np.float32 = ZERO


class SurfacePoint(NamedTuple):
    """A place on a captured surface: position [m], unit normal, distance from the eye [m].

    `ground` is how surely poor ground shows there, 0 to 1, or NOT_POOR, see `ground_share`.
    """

    x: np.float32
    y: np.float32
    z: np.float32
    nx: np.float32
    ny: np.float32
    nz: np.float32
    distance: np.float32
    ground: np.float32 = NOT_POOR


@inlined_function
def seen_surface(turn, view, row, column, normal, depth, plane_depth, dry, size, ground, poor=True):
    """Return what a pixel of the capture shows: view direction, depths, cosine and place.

    turn : tuple of 9 float32. Of the camera, see `turn_of`.
    view : View
    row, column : int
    normal : tuple of 3 float32. Unit, camera frame.
    depth, plane_depth : float32 [m]. As splatted.
    dry : wet_pass.DryPicture
    size : tuple of 2 int. Rows and columns of the part of the picture that was drawn.
    ground : GroundMaps
    poor : bool. False: no part of it is poorly known.
    Returns x, y, z : float32. Unit direction of view, ground frame.
        drawn : float32 [m]. Depth of what is drawn.
        cosine : float32. Between the normal and the way back to the eye.
        point : SurfacePoint. Where it is wetted; at the eye if the pixel shows no
            surface.
    """
    a, b, eye = column_slope(view, column), row_slope(view, row), view.eye
    x = turn[0] * a + turn[1] * b + turn[2]
    y = turn[3] * a + turn[4] * b + turn[5]
    z = turn[6] * a + turn[7] * b + turn[8]
    length = math.sqrt(x * x + y * y + z * z)
    inv = ONE / length
    lean_x, lean_y, upness = turned(turn, normal[0], normal[1], normal[2])
    cosine = -(normal[0] * a + normal[1] * b + normal[2]) * inv
    d, e = depth_of_surface(depth, plane_depth, upness)
    e = e if is_surface(dry.alpha[row, column], z) else ZERO
    point = SurfacePoint(
        eye[0] + e * x, eye[1] + e * y, eye[2] + e * z, lean_x, lean_y, upness, e * length, NOT_POOR
    )
    if poor and ground.layer.shape[0] > 1 and e > ZERO:
        u, v = map_place(point.x, point.y, ground.origin, ground.spacing)
        layer = layer_at(ground, u, v)
        above, stands = point.z - bed_at(ground, u, v), (ZERO, FAR_AWAY)
        if layer > ZERO and above < LAYER_END * ground.thickest_layer and z < ZERO:
            sure, thing, around = what_stands(turn, view, row, column, (x, y, z), dry, size, ground)
            layer, stands = max(layer, around), (sure, thing)
        point, d = on_bed(point, e, d, x, y, z, layer, stands, ground)
        cosine = -(point.nx * x + point.ny * y + point.nz * z) * inv
    return x * inv, y * inv, z * inv, d, cosine, point


@lean_function
def closeness(dry, row, column, reach, size):
    """Return one over the depth around a pixel [1/m]; 0 where nothing was captured.

    The mean over a region as wide as the noise of poor ground; pixels within `reach` count.
    """
    total = ZERO
    for k in range(SAMPLES):
        across, down = sample(k, 0)
        u = min(max(column + across * reach, 0), size[1] - 1)
        v = min(max(row + down * reach, 0), size[0] - 1)
        total += ONE / max(dry.depth[v, u], np.float32(1e-6))
    return EACH * total / dry.meters_per_unit


@lean_function
def what_stands(turn, view, row, column, ray, dry, size, ground):
    """Return how surely what the region of a pixel shows stands on poor ground, and its depth [m].

    And the layer there [m]: a streak of haze before open ground is none of the things beside it.

    Splats of the ground are sheets that end with the layer: over them the picture shows what lies
    behind. Of a wall it shows the same depth there. Neither a splat's height nor its normal tells,
    nor the depth of one pixel.

    turn, view, row, column, dry, size, ground : see `seen_surface`
    ray : tuple of 3 float32. Way [m] for a metre of depth.
    """
    eye, reach = view.eye, max(1, int(view.fx * REGION))
    shown = ONE / max(closeness(dry, row, column, reach, size), np.float32(1e-6))
    x, y, z = eye[0] + shown * ray[0], eye[1] + shown * ray[1], eye[2] + shown * ray[2]
    u, v = map_place(x, y, ground.origin, ground.spacing)
    height = z - bed_at(ground, u, v)
    # What seems to lie below the bed lies where the ray meets that.
    near = shown - min(height, ZERO) / ray[2]
    u, v = map_place(eye[0] + near * ray[0], eye[1] + near * ray[1], ground.origin, ground.spacing)
    layer = abs(layer_at(ground, u, v))
    share = ZERO
    for k in range(len(OVER)):
        up = max(OVER[k] * layer - max(height, ZERO), ZERO)
        ahead = max(near + up * turn[8], np.float32(1e-3))
        # The place over the point, in the camera's frame.
        a = (column_slope(view, column) * near + up * turn[6]) / ahead
        b = (row_slope(view, row) * near + up * turn[7]) / ahead
        over = int(view.cy + view.fy * b), int(view.cx + view.fx * a)
        close = ahead * closeness(dry, over[0], over[1], reach, size)
        if k > 0:
            share += close
        elif close > ONE:
            shown = min(shown, near / close)  # the foot of a wall may seem to lie far behind it
    share = max(share / np.float32(len(OVER) - 1), np.float32(1e-3))
    thing = near / share
    sure = smoothstep(BEFORE, BEHIND, share) * (ONE - smoothstep(SAME, OTHER, shown / thing))
    return sure, thing, layer


@inlined_function
def is_surface(alpha, sine):
    """Tell whether splats that cover `alpha` of a pixel are a surface; `sine` is that of the ray.

    Below the horizon nothing is behind them but what was not captured: haze there is no ground.
    """
    return alpha >= (SURFACE_ALPHA if sine >= ZERO else HAZE)


@inlined_function
def depth_of_surface(depth, plane_depth, upness):
    """Return the depth that is drawn, and that of the place that is wetted.

    The plane of the splats is far better on level ground, and can be wild on thin things. Along a
    wall seen at a slant the splats' own depths scatter: there the plane is where the wall is wet.
    """
    drawn = plane_depth if upness > FLAT else depth
    return drawn, plane_depth if abs(plane_depth - drawn) < WALL_SHARE * drawn else drawn


@inlined_function
def heights_over(bed, z, inside, solid):
    """Return what `heights_of` does, of a surface at z [m] over a bed that is known if `inside`."""
    clearance, height = z - bed if inside else FAR_AWAY, z - bed if inside else z
    return clearance if solid else FAR_AWAY, height if solid else FAR_AWAY


@inlined_function
def heights_of(point, solid, ground):
    """Return where a surface is over the ground.

    point : SurfacePoint
    solid : bool. Whether there is a surface at all.
    ground : GroundMaps
    Returns clearance : float32 [m]. Height over the bed; FAR_AWAY without a
        surface, and off the map. Poorly known ground goes on beyond the map as at
        its border.
        height : float32 [m]. The same, but off the map the height over the ground
            plane.
    """
    u, v = map_place(point.x, point.y, ground.origin, ground.spacing)
    inside = ground.thickest_layer > ZERO or is_on_map(u, v, ground.bed)
    bed = bed_at(ground, u, v) if inside & solid else ZERO
    return heights_over(bed, point.z, inside, solid)


@inlined_function
def within(ground, u, v):
    """Return the column and row of the map that are nearest to u, v; 0 for NaN."""
    # In this order NaN gives 0.
    u = min(np.float32(ground.wetness.shape[1]) - TO_BORDER, max(ZERO, u))
    return u, min(np.float32(ground.wetness.shape[0]) - TO_BORDER, max(ZERO, v))


@inlined_function
def ground_share(height, upness, poor):
    """Return how surely a surface at a height [m] over the bed is the ground, 0 to 1.

    What is low is ground unless it is upright; what is somewhat higher is if it is level. A step of
    the cosine `upness` to the vertical would draw the noise of normals as patches. Of ground that
    is poorly known the share `poor` is known, see `SurfacePoint`.
    """
    foot = (ONE - smoothstep(FOOT, FOOT_END, height)) * smoothstep(LEANS, SLOPES, upness)
    low = ONE - smoothstep(LOW, HIGH, height)
    return max(foot, low * smoothstep(LEANS, FLAT, upness)) if poor < ZERO else poor


@inlined_function
def bed_at(ground, u, v):
    """Return the bed's height at column u and row v [m], beyond the map as at its border."""
    return bilinear(ground.bed, max(ZERO, u), max(ZERO, v))  # in this order NaN gives 0


@inlined_function
def layer_at(ground, u, v):
    """Return the thickness of the splats about the bed at column u and row v [m]."""
    if ground.layer.shape[0] < 2:
        return ZERO
    return bilinear(ground.layer, max(ZERO, u), max(ZERO, v))  # in this order NaN gives 0


@inlined_function
def with_share(point, share):
    """Return a `SurfacePoint` that shows poor ground by a share."""
    return SurfacePoint(
        point.x, point.y, point.z, point.nx, point.ny, point.nz, point.distance, share
    )


@inlined_function
def on_bed(point, depth, drawn, x, y, z, layer, stands, ground):
    """Return a surface point, its depth and the drawn depth, moved to the bed if it shows that.

    Splats of poor ground lie before or behind it. The ray that shows one shows the ground where it
    meets the bed, and the ground faces up.

    point : SurfacePoint
    depth, drawn : float32 [m]. Along the view axis: of the point, and of what is
        drawn.
    x, y, z : float32. Way [m] along the ray for a metre of depth; the point is
        `depth` of it from the eye.
    layer : float32 [m]. How far from the bed splats show it there.
    stands : tuple of 2 float32. See `what_stands`.
    ground : GroundMaps. Its bed is poorly known.
    """
    sure, thing = stands
    eye_x, eye_y, eye_z = point.x - depth * x, point.y - depth * y, point.z - depth * z
    # What stands there lies no farther off than where it goes on over the layer.
    near = depth - sure * max(depth - thing, ZERO)
    drawn -= sure * max(drawn - thing, ZERO)
    point = SurfacePoint(
        eye_x + near * x, eye_y + near * y, eye_z + near * z, point.nx, point.ny, point.nz,
        point.distance * (near / depth), point.ground,
    )  # fmt: skip
    depth = near
    u, v = map_place(point.x, point.y, ground.origin, ground.spacing)
    bed = bed_at(ground, u, v)
    share = ZERO
    if layer > ZERO:
        end = min(LAYER_END * layer, eye_z - bed)
        share = ONE - smoothstep(min(layer, BELOW_EYE * end), end, point.z - bed)
        share *= ONE - sure
    turned_up = share
    if point.z < bed:  # nothing lies below the ground, whatever stands there
        share, turned_up = ONE, ONE - sure
    if not (share > ZERO and z < ZERO and eye_z > bed):
        return with_share(point, share if layer > ZERO else NOT_POOR), drawn
    to = (bed - eye_z) / z
    u, v = map_place(eye_x + to * x, eye_y + to * y, ground.origin, ground.spacing)
    to = (bed_at(ground, u, v) - eye_z) / z
    to -= sure * max(to - thing, ZERO)
    step = STEP / max(math.sqrt(x * x + y * y), np.float32(1e-3))
    for n in range(STEPS):
        way = depth + np.float32(n) * step
        if way < to:
            u, v = map_place(eye_x + way * x, eye_y + way * y, ground.origin, ground.spacing)
            if layer_at(ground, u, v) < ZERO:  # what stands there hides the ground behind it
                to, turned_up = way, ZERO
    e = depth + share * (to - depth)
    nx, ny, nz = (ONE - turned_up) * point.nx, (ONE - turned_up) * point.ny, point.nz
    nz += turned_up * (ONE - nz)
    inv = ONE / max(math.sqrt(nx * nx + ny * ny + nz * nz), np.float32(1e-6))
    place = SurfacePoint(
        eye_x + e * x, eye_y + e * y, eye_z + e * z, nx * inv, ny * inv, nz * inv,
        point.distance * (e / depth), turned_up if layer > ZERO else NOT_POOR,
    )  # fmt: skip
    return place, drawn + share * (to - drawn)
