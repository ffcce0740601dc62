"""Readings at clicked points, and results of several points: a length, a plane."""

from dataclasses import dataclass

import numpy as np

from rainsim.errors import GroundError, ParameterError
from rainsim.scene.assumed_ground import levelled_frame
from rainsim.scene.cameras import cropped
from rainsim.scene.folder import in_ground_frame, override_ground_frame
from rainsim.scene.ground import scale_from_length
from rainsim.scene.ground_search import TOO_POOR
from rainsim.scene.painted import PaintedClasses
from rainsim.scene.view import rays
from rainsim.terrain.table import class_table
from rainsim.terrain.types import INFERRED, MEASURED

REACH = 2  # px about a clicked one that are splatted with it
FEW = 0.5  # alpha below which a pixel shows nothing solid
FLATTEST = 1e-3  # of the longest side squared: three points with less area lie on a line
SOURCES = {MEASURED: "measured", INFERRED: "inferred"}


@dataclass(frozen=True)
class ProbeReading:
    """Place, ground, water and class at a clicked point.

    cell : tuple of int, or None. Row and column of the map; None beside it.
    kind : str. Ground class and how the ground is known.
    """

    point: tuple
    capture_point: tuple
    cell: tuple | None
    ground: float
    depth: float
    kind: str

    def lines(self):
        """Return the reading as lines for a person."""
        x, y, z = self.point
        found = [
            f"x, y, z: {x:.3f}, {y:.3f}, {z:.3f} m",
            "capture: " + ", ".join(f"{v:.4f}" for v in self.capture_point),
        ]
        if self.cell is None:
            return [*found, "beside the map"]
        return [
            *found, f"ground at {self.ground:.3f} m, {self.kind}",
            f"water {self.depth * 1e3:.1f} mm",
        ]  # fmt: skip


def point_at(session, view, place, size):
    """Return the point of the capture that a view shows at a place, in the ground frame [m] (3,).

    place : tuple of float. Column and row as shares of the picture's width and
        height, from its upper left corner.
    Raises ParameterError if nothing solid is seen there.
    """
    width, height = size
    u, v = place[0] * width, place[1] * height
    left, top = (int(np.clip(n, 0, most - 1)) - REACH for n, most in ((u, width), (v, height)))
    camera = session.camera_of(view, width, height)
    window = left, top, left + 2 * REACH + 1, top + 2 * REACH + 1
    layers = session.dry(cropped(camera, window))
    depth, alpha = layers.plane_depth[REACH, REACH], layers.alpha[REACH, REACH]
    if not (alpha > FEW and np.isfinite(depth)):
        raise ParameterError("nothing solid is seen there; click on a surface")
    frame = session.scene.ground_frame
    placed = frame.camera_in_ground(camera)
    away = rays(placed, u, v) * float(depth) * frame.meters_per_unit
    return placed.position + away @ placed.camera_from_world[:3, :3]


def read_point(session, point, index):
    """Return the `ProbeReading` of a point of the ground frame [m] with the water of a state."""
    terrain = session.terrain
    capture = tuple(float(v) for v in session.scene.ground_frame.to_capture(point))
    point = tuple(float(v) for v in point)
    if terrain is None:
        return ProbeReading(point, capture, None, float("nan"), 0.0, "")
    row, column, inside = terrain.grid.cells(point[0], point[1])
    if not inside:
        return ProbeReading(point, capture, None, float("nan"), 0.0, "")
    cell = int(row), int(column)
    name = class_table().names[terrain.ground_class[cell]]
    source = SOURCES.get(int(terrain.source[cell]), "unknown")
    depth = float(session.water.state(index).depth[cell])
    return ProbeReading(point, capture, cell, float(terrain.bed[cell]), depth, f"{name}, {source}")


def meters_per_unit_of(scene, a, b, length):
    """Return the scale at which two points of the ground frame are `length` [m] apart."""
    frame = scene.ground_frame
    return scale_from_length(frame.to_capture(np.array(a)), frame.to_capture(np.array(b)), length)


def up_of(scene, points, eye=(0.0, 0.0, 1e6)):
    """Return the unit normal of a plane through three points of the ground frame, upwards.

    eye : array_like of shape (3,) [m]. From where they were seen: that side of
        the plane is the upper one.
    Returns array (3,). In the capture frame.
    Raises ParameterError if the points lie nearly on a line.
    """
    a, b, c = (np.asarray(p, np.float64) for p in points)
    normal = np.cross(b - a, c - a)
    longest = max(np.sum((p - q) ** 2) for p, q in ((a, b), (b, c), (c, a)))
    if not np.linalg.norm(normal) > FLATTEST * longest:
        raise ParameterError(
            "the three points lie on a line; they must span a plane; click three corners"
        )
    normal *= np.sign(normal @ (np.asarray(eye) - a) or 1.0) / np.linalg.norm(normal)
    return scene.ground_frame.rotation.T @ normal


def with_up(scene, up, point):
    """Return the scene with another up, and whether the ground was found again by it.

    Where no ground is found within 20 degrees of level, the level plane through a point is taken.
    """
    try:
        found = override_ground_frame(scene, up=up)
        if not any(note.startswith(TOO_POOR) for note in found.ground_frame.notes):
            return found, True
    except GroundError:
        pass
    frame = scene.ground_frame
    levelled = levelled_frame(frame, up, frame.to_capture(point))
    return in_ground_frame(scene, levelled), False


def painted(mask, terrain, point, radius, code):
    """Return a class mask with a disk painted on it.

    mask : int16 array (ny, nx), or None. Class of each cell, -1 where it is left
        to the program; None: nothing is painted yet.
    code : int. Class, or -1 to leave the disk to the program.
    """
    found = np.full(terrain.grid.shape, -1, np.int16) if mask is None else mask.copy()
    found[terrain.grid.disc(point, radius)] = code
    return found


def painted_classes(mask, grid):
    """Return a class mask of a `Grid` as the `PaintedClasses` that a scene keeps."""
    return PaintedClasses(class_table().names, mask, grid.origin, grid.spacing)


def mask_picture(mask):
    """Return painted classes as the picture that `--class-mask` takes, north at the top."""
    colors = np.vstack([class_table().colors, np.zeros((1, 3), np.uint8)])
    return np.ascontiguousarray(colors[mask][::-1])
