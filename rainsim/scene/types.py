"""The data that a capture consists of: splats, cameras and the ground frame.

Frames
------
capture frame : the frame and units of the trained capture, arbitrary. Splats and cameras live here.
ground frame : metres, right-handed, z up, ground near z = 0, x along the first camera's view
    direction on the ground.
camera frame : x right, y down, z forward. The centre of pixel (row, column) is at image point
    (column + 0.5, row + 0.5).
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rainsim.errors import ParameterError
from rainsim.numerics.blocks import in_blocks
from rainsim.scene.painted import PaintedClasses

SCALES = 1e-6, 1e6  # m per capture unit, least and greatest
FARTHEST = 1e9  # m to the ground's origin


@dataclass(frozen=True, slots=True)
class Splats:
    """Activated 3D Gaussian splats in the capture frame; arrays are C-contiguous float32.

    Attributes
    ----------
    position : ndarray of shape (n, 3), float32 [capture units]
    rotation : ndarray of shape (n, 4), float32
        Unit quaternions, w first: the splat's own axes to the capture frame.
    scale : ndarray of shape (n, 3), float32 [capture units]
        Standard deviations along the splat's own axes (linear, not logarithms).
    opacity : ndarray of shape (n,), float32
        In [0, 1].
    sh : ndarray of shape (n, k, 3), float32
        Spherical harmonics of display-referred colour, k = (degree + 1)^2 for degree 0 to 3, in
        the basis and with the +0.5 offset of the original 3DGS code, for directions from the
        camera to the splat in the capture frame.

    Examples
    --------
    >>> few = scene.splats.take(slice(0, 10))
    >>> len(few), few.position.shape
    (10, (10, 3))
    """

    position: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    sh: np.ndarray

    def __len__(self):
        return len(self.position)

    def take(self, which):
        """Return the splats that the slice, index or mask array `which` selects."""
        arrays = (self.position, self.rotation, self.scale, self.opacity, self.sh)
        index = np.arange(len(self))[which]
        return Splats(*(np.take(a, index, axis=0) for a in arrays))


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole or orthographic camera.

    Attributes
    ----------
    width, height : int [px]
    fx, fy : float
        Focal lengths [px]; for an orthographic camera pixels per unit of length.
    cx, cy : float [px]
        Principal point; the image spans 0..width, 0..height.
    camera_from_world : ndarray of shape (4, 4), float64
        Rigid; world is the capture frame unless said otherwise.
    name : str
    orthographic : bool

    Examples
    --------
    >>> camera = scene.cameras[0]
    >>> small = camera.resized(32, 24)
    >>> small.width, small.fx == camera.fx / 2
    (32, True)
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_from_world: np.ndarray
    name: str = ""
    orthographic: bool = False

    @property
    def position(self):
        """Camera centre in world coordinates, ndarray of shape (3,), float64."""
        rotation = self.camera_from_world[:3, :3]
        return -rotation.T @ self.camera_from_world[:3, 3]

    @property
    def forward(self):
        """Unit view direction in world coordinates."""
        return self.camera_from_world[2, :3].copy()

    @property
    def image_up(self):
        """Unit direction of image-up in world coordinates."""
        return -self.camera_from_world[1, :3]

    def posed(self, camera_from_world):
        """Return the camera with another pose, a matrix (4, 4)."""
        return replace(self, camera_from_world=camera_from_world)

    def resized(self, width, height):
        """Return the camera with the picture scaled to `width` x `height` px.

        Each focal length scales with its own side and the principal point with it.
        """
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height,
            fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy,
        )  # fmt: skip


def pose_at(rotation, position):
    """Return camera_from_world of the camera at `position` whose axes are the rows `rotation`."""
    matrix = np.zeros((4, 4))  # in a third of the time that `np.eye` takes
    matrix[:3, :3], matrix[:3, 3], matrix[3, 3] = rotation, -rotation @ position, 1.0
    return matrix


@dataclass(frozen=True, slots=True)
class GroundFrame:
    """The similarity that takes the capture frame to the ground frame, and how it was found.

    p_ground = meters_per_unit * rotation @ p_capture + translation

    Attributes
    ----------
    rotation : ndarray of shape (3, 3), float64
        ground_from_capture; rows are the ground frame's axes in the capture frame.
    meters_per_unit : float [m / capture unit]
    translation : ndarray of shape (3,), float64 [m]
    confidence : float
        0 to 1: how well the ground plane is supported (1 if given by the user).
    notes : tuple of str
        One line each: how up, plane and scale were found and what is assumed.
    scale_assumed : bool
        True if the scale rests on an assumed camera height.

    Examples
    --------
    >>> frame = rainsim.GroundFrame(np.eye(3), 0.5, np.zeros(3))
    >>> frame.to_ground([2.0, 0.0, 4.0]).tolist()
    [1.0, 0.0, 2.0]
    """

    rotation: np.ndarray
    meters_per_unit: float
    translation: np.ndarray
    confidence: float = 1.0
    notes: tuple = ()
    scale_assumed: bool = False

    def __post_init__(self):
        """Raise ParameterError unless scale and origin are such that metres can be computed."""
        low, high = SCALES
        if not low <= self.meters_per_unit <= high:  # false for NaN
            raise ParameterError(
                f"the scale is {self.meters_per_unit:g} m per capture unit; it must lie from "
                f"{low:g} to {high:g}; give another --meters-per-unit, --camera-height or length"
            )
        if not (np.abs(self.translation) < FARTHEST).all():
            raise ParameterError(
                f"the ground's origin is {np.abs(self.translation).max():g} m away; it must be "
                f"within {FARTHEST:g} m; check scale and capture"
            )

    def to_ground(self, points):
        """Take points of shape (..., 3) from the capture frame to the ground frame [m]."""
        points = np.asarray(points)
        if points.ndim != 2:
            return points @ self.rotation.T * self.meters_per_unit + self.translation
        found = np.empty(points.shape)

        def work(part):
            out = np.matmul(points[part], self.rotation.T, out=found[part])
            out *= self.meters_per_unit
            out += self.translation

        in_blocks(work, len(points))
        return found

    def to_capture(self, points):
        """Take points of shape (..., 3) from the ground frame [m] to the capture frame."""
        return (np.asarray(points) - self.translation) / self.meters_per_unit @ self.rotation

    @property
    def up(self):
        """Unit up vector in the capture frame."""
        return self.rotation[2].copy()

    def camera_in_ground(self, camera):
        """Return the capture-frame `camera` as a rigid camera of the ground frame, in metres.

        Pixels see the same rays; depths are multiplied by `meters_per_unit`.
        """
        rotation = camera.camera_from_world[:3, :3] @ self.rotation.T
        return _with_pose(camera, rotation, self.to_ground(camera.position), self.meters_per_unit)

    def camera_in_capture(self, camera):
        """Return the ground-frame `camera` (metres) as a rigid camera of the capture frame."""
        rotation = camera.camera_from_world[:3, :3] @ self.rotation
        return _with_pose(
            camera, rotation, self.to_capture(camera.position), 1 / self.meters_per_unit
        )


def _with_pose(camera, rotation, position, scale):
    matrix = pose_at(rotation, position)
    if not camera.orthographic:
        return camera.posed(matrix)
    zoom = 1 / scale  # pixels per unit of length
    return replace(camera, camera_from_world=matrix, fx=camera.fx * zoom, fy=camera.fy * zoom)


@dataclass(frozen=True, slots=True)
class Scene:
    """A capture ready for rain.

    Attributes
    ----------
    name : str
    splats : Splats
    cameras : tuple of Camera
        The capture's own cameras in the capture frame; may be empty.
    ground_frame : GroundFrame
    source : Path or None
        The file or folder it was read from; None for a built-in scene.
    source_hash : str
        SHA-256 of the splat file (of the generated arrays for a built-in scene).
    notes : tuple of str
        What the reader counted, dropped or assumed, one line each.
    drains : tuple of (x, y, z) [capture units]
        Middles of gratings that take the water of a street.
    actors : tuple of rainsim.actors.actor.Actor
        What moves through the scene; their splats are not among `splats`.
    painted : rainsim.scene.painted.PaintedClasses or None
        Classes of the ground that a user painted in this ground frame.
    pages : rainsim.scene.pages.Pages or None
        Of a big capture: its chunks, from which cameras are drawn. `splats` are then a coarse level
        of the whole, by which the scene is known.
    antialiased : bool
        Whether the splats were trained to be weakened where a pixel widens them; they are drawn so.
    captured_sun : tuple of 3 floats or None
        Unit vector to the sun in the capture frame, as place and time of photographs have it.
    photographs : tuple of (Path or None)
        Of the cameras, in their order; empty if there are none.
    origin : tuple of 3 floats [capture units]
        Whole numbers that were taken off splats and cameras in large coordinates.

    Examples
    --------
    >>> scene.splats.position.shape[1], scene.cameras[0].width
    (3, 64)
    """

    name: str
    splats: Splats
    cameras: tuple
    ground_frame: GroundFrame
    source: Path | None = None
    source_hash: str = ""
    notes: tuple = field(default=())
    drains: tuple = ()
    actors: tuple = ()
    painted: PaintedClasses | None = None
    pages: object = None
    antialiased: bool = False
    captured_sun: tuple | None = None
    photographs: tuple = ()
    origin: tuple = (0.0, 0.0, 0.0)

    @property
    def painted_hash(self):
        """SHA-256 of the painted classes, None without any."""
        return None if self.painted is None else self.painted.sha256

    @property
    def count(self):
        """Number of the capture's splats, those in chunks included."""
        return len(self.splats) if self.pages is None else self.pages.count
