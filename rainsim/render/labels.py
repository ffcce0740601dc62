"""Labels of a frame for learning: range, optical flow of the scene, classes, puddles, boxes.

All of them follow from the depth of the picture, the poses of two cameras, the height map and the
simulated water, so that they are as exact as those. `rainsim.render.aov` lists them with the other
AOVs of a frame.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.numerics.blocks import stable_order
from rainsim.reflection import water_record
from rainsim.scene.view import pixel_rays, rays
from rainsim.shading.surface_point import FLAT
from rainsim.terrain.table import OBJECT, WATER, class_table
from rainsim.water.puddles import WET

# Values of the AOV flow_mask.
NO_FLOW, SEEN, OCCLUDED, OUTSIDE = range(4)
SAME_SURFACE = 0.02  # of the depth by which the next frame's depth may differ on one surface
OTHER_CLASS = 255  # id of what is neither ground nor water; loaders ignore it by custom
GROUND_REACH = 0.1  # m over or under the bed: what is farther from it is no ground
MOST_WATER = 0.5  # share of the pixel from which on it counts as water
ON_TOP = 0.15  # m over the bed from which water stands on a thing
MOST_ID = 2**16 - 1


def range_of(depth, camera):
    """Return the distance from the camera's centre [m] of a picture's z-depth [m], float32."""
    return (depth * np.linalg.norm(pixel_rays(camera), axis=-1)).astype(np.float32)


def flow_of(depth, camera, after, depth_after, number=None, moves=None):
    """Return where the surfaces of a picture are in the next one, and which of them it shows.

    depth : float32 array (height, width) [m]. Along the view axis, infinite for
        sky, which moves by the camera's turn alone.
    camera, after : Camera. Of the picture and of the next one, in one frame in
        metres.
    depth_after : float32 array (height, width) [m]
    number : int array (height, width), optional. Of the actor that each pixel
        shows.
    moves : dict of int to array (4, 4), optional. How the actors move in that
        frame, see `actor_labels.moves_of`.
    Returns flow : float32 array (height, width, 2) [px]. To the right and down;
        zero where the surface gets behind the camera.
        mask : uint16 array (height, width). NO_FLOW: behind the next camera.
            SEEN: the next picture shows the same surface there. OCCLUDED: it
            shows another one. OUTSIDE: the place lies outside the next picture.
    """
    number = np.zeros(depth.shape, np.uint16) if number is None else number.astype(np.uint16)
    begin = np.linalg.inv(camera.camera_from_world)
    steps = np.empty((int(number.max(initial=0)) + 1, 4, 4))
    steps[:] = after.camera_from_world @ begin
    for actor, move in (moves or {}).items():
        if actor < len(steps):
            steps[actor] = after.camera_from_world @ move @ begin
    lens, lens_after = (
        np.array([c.fx, c.fy, c.cx, c.cy], np.float64) for c in (camera, after)
    )  # fmt: skip
    flow = np.empty((*depth.shape, 2), np.float32)
    mask = np.empty(depth.shape, np.uint16)
    _find_flow(
        *(np.ascontiguousarray(d, np.float32) for d in (depth, depth_after)), number, steps,
        lens, lens_after, flow, mask,
    )  # fmt: skip
    return flow, mask


@cpu_kernel
def _find_flow(depth, depth_after, number, steps, lens, lens_after, flow_out, mask_out):
    """Write flow and mask; `steps` take camera points to the next camera, by the actor's number."""
    rows, columns = depth_after.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for row in prange(depth.shape[0]):
        b = (row + 0.5 - cy) / fy
        for column in range(depth.shape[1]):
            a = (column + 0.5 - cx) / fx
            here = np.float64(depth[row, column])
            # Over the depth: a point at infinity has no shift.
            far = not here < np.inf
            step, nearness = steps[0 if far else number[row, column]], 0.0 if far else 1 / here
            x = step[0, 0] * a + step[0, 1] * b + step[0, 2] + nearness * step[0, 3]
            y = step[1, 0] * a + step[1, 1] * b + step[1, 2] + nearness * step[1, 3]
            z = step[2, 0] * a + step[2, 1] * b + step[2, 2] + nearness * step[2, 3]
            if not z > 1e-6:
                flow_out[row, column, 0], flow_out[row, column, 1] = 0, 0
                mask_out[row, column] = NO_FLOW
                continue
            u, v = lens_after[0] * x / z + lens_after[2], lens_after[1] * y / z + lens_after[3]
            flow_out[row, column, 0] = u - a * fx - cx
            flow_out[row, column, 1] = v - b * fy - cy
            if not (u >= 0 and u < columns and v >= 0 and v < rows):
                mask_out[row, column] = OUTSIDE
                continue
            same = _is_shown(np.inf if far else z * here, depth_after, u, v)
            mask_out[row, column] = SEEN if same else OCCLUDED


@device_function
def _is_shown(expected, depth, u, v):
    """Tell whether a picture shows the expected depth at an image point.

    Of planes the inverse of the depth is linear over the picture, so that it is interpolated; along
    edges the pixel that holds the point decides.
    """
    rows, columns = depth.shape
    nearest = np.float64(depth[np.int64(v), np.int64(u)])
    if not expected < np.inf:
        return not nearest < np.inf
    if abs(nearest - expected) < SAME_SURFACE * expected:
        return True
    column, row = min(max(u - 0.5, 0.0), columns - 1.0), min(max(v - 0.5, 0.0), rows - 1.0)
    i, j = min(np.int64(column), columns - 2), min(np.int64(row), rows - 2)
    a, b = column - i, row - j
    top = (1 - a) / np.float64(depth[j, i]) + a / np.float64(depth[j, i + 1])
    bottom = (1 - a) / np.float64(depth[j + 1, i]) + a / np.float64(depth[j + 1, i + 1])
    between = 1 / (top * (1 - b) + bottom * b)
    return abs(between - expected) < SAME_SURFACE * expected


def without_flow(report):
    """Return a `FrameReport` whose flow is none: the camera was cut to another place."""
    aovs = dict(report.aovs)
    for name in ("flow", "flow_mask"):
        if name in aovs:
            aovs[name] = np.zeros_like(aovs[name])
    return replace(report, aovs=aovs)


# --- ground and water -----------------------------------------------------------------------------


def class_names():
    """Return the names of the AOV class_id by id, a dict with text keys for JSON."""
    names = {str(code): name for code, name in enumerate(class_table().names) if code != OBJECT}
    return {**names, str(OTHER_CLASS): "other"}


def class_ids(view, depth, clearance, upright, terrain, water):
    """Return the class of the ground or the water that each pixel shows.

    depth, clearance : float32 array (height, width) [m]. Along the view axis, and
        over the height map.
    upright : float array (height, width). The surface's normal upwards in the
        ground frame.
    water : int array (n,). Pixels that show water, row by row.
    Returns uint16 array (height, width). Codes of rainsim/config/classes.toml,
        OTHER_CLASS for all that is neither.
    """
    ids = np.full(depth.shape, OTHER_CLASS, np.uint16)
    flat = ids.ravel()
    level = np.flatnonzero((np.abs(clearance) < GROUND_REACH) & (upright > FLAT))
    v, u = np.divmod(level, depth.shape[1])
    ahead = rays(view, u + 0.5, v + 0.5) @ view.ground_from_camera[:2].T
    x, y = (view.eye[:2] + depth.ravel()[level, None] * ahead).T
    row, column, inside = terrain.grid.cells(x, y)
    code = terrain.ground_class[row, column]
    ground = inside & (code != OBJECT)
    flat[level[ground]] = code[ground]
    flat[water] = WATER
    return ids


def shown_water(record):
    """Tell which records of a picture's water (n, RECORD) are water deep enough for a puddle."""
    deep = record[:, water_record.WATER_DEPTH] >= WET
    return deep & (record[:, water_record.COVERAGE] >= MOST_WATER)


def puddle_map(terrain, depth):
    """Return the puddle in each cell of the height map, and the puddles by id.

    A puddle's id comes from its lowest cell, so that it stays while the puddle grows and shrinks;
    two that flow together have the id of the lower one. In one map all ids differ.

    depth : array (ny, nx) [m]
    Returns ids : uint16 array (ny, nx). 0 where there is no puddle.
        puddles : dict of int to dict. area_m2, volume_m3 and greatest depth_m by
            id.
    """
    label, count = ndimage.label(depth >= WET, np.ones((3, 3), int))
    number = np.zeros(count + 1, np.uint16)
    if count == 0:
        return number[label], {}
    wet = np.flatnonzero(label)
    label, deep = label.ravel(), depth.ravel()[wet]
    mine = label[wet] - 1
    cells = np.bincount(mine, minlength=count)
    volume = np.bincount(mine, deep, count) * terrain.grid.cell_area
    order = stable_order(mine)
    first = np.cumsum(cells) - cells
    deepest = np.maximum.reduceat(deep[order], first)
    bed = terrain.bed.ravel()[wet[order]]
    low = order[bed == np.repeat(np.minimum.reduceat(bed, first), cells)]
    lowest = wet[low[np.searchsorted(mine[low], np.arange(count))]]
    label = label.reshape(depth.shape)
    used = set()
    for k in np.argsort(-cells, kind="stable"):  # the largest first: small ones give way
        wanted = int(lowest[k]) % MOST_ID + 1
        while wanted in used:
            wanted = wanted % MOST_ID + 1
        used.add(wanted)
        number[k + 1] = wanted
    puddles = {
        int(number[k + 1]): {
            "area_m2": round(float(cells[k] * terrain.grid.cell_area), 5),
            "volume_m3": float(f"{volume[k]:.4g}"), "depth_m": round(float(deepest[k]), 5),
        }
        for k in range(count)
    }  # fmt: skip
    return number[label], puddles


def puddle_ids(pixel, record, shape, terrain, ids):
    """Return the puddle that each pixel shows, ndarray of `shape`, uint16, 0 for none.

    pixel : int array (n,). Of each record, row by row.
    record : float32 array (n, RECORD)
    shape : (int, int)
    ids : uint16 array (ny, nx). See `puddle_map`.
    """
    found = np.zeros(shape, np.uint16)
    kept = shown_water(record)
    x, y, z = record[kept, water_record.POINT].T
    row, column, inside = terrain.grid.cells(x, y)
    # Water on a table stands above the puddle below it.
    low = z - record[kept, water_record.WATER_DEPTH] < terrain.bed[row, column] + ON_TOP
    found.ravel()[pixel[kept]] = np.where(inside & low, ids[row, column], 0)
    return found


def boxes_of(ids):
    """Return the box of each instance of an index picture.

    ids : uint16 array (height, width). 0 for none.
    Returns list of dict. id, box (left, top, right, bottom) [px], right and
        bottom not included, and pixels.
    """
    place = np.flatnonzero(ids)
    if not len(place):
        return []
    number = ids.ravel()[place]
    order = stable_order(number)
    number, (row, column) = number[order], np.divmod(place[order], ids.shape[1])
    first = np.flatnonzero(np.diff(number, prepend=0))
    after = np.append(first[1:], len(place))
    left, right = np.minimum.reduceat(column, first), np.maximum.reduceat(column, first) + 1
    top, bottom = row[first], row[after - 1] + 1  # rows ascend within each number
    values = number[first], left, top, right, bottom, after - first
    return [
        {"id": n, "box": box, "pixels": pixels}
        for n, *box, pixels in zip(*(v.tolist() for v in values), strict=True)
    ]
