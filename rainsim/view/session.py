"""One scene in the rain that is looked at: its parts, made again when a setting needs it.

All methods but `set_config` belong to the thread that draws.
"""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.actors.footprint import with_footprints
from rainsim.backend import free_device_memory, on_backend
from rainsim.config.declare import BASES, LIGHT, TERRAIN, WATER
from rainsim.config.tables import SETTINGS
from rainsim.errors import GroundError, ParameterError, shown
from rainsim.io.files import number_array
from rainsim.lod.paged import rasterizer_of_scene
from rainsim.pipeline import extract_terrain
from rainsim.render.drawn_capture import NEAR
from rainsim.render.leaving import leaving_of
from rainsim.render.memory import require_memory, require_memory_of_picture
from rainsim.render.report import Timer
from rainsim.scene.camera_path import camera_path_data, path_cameras
from rainsim.scene.camera_rule import RIGID_TOLERANCE
from rainsim.scene.cameras import resize_to
from rainsim.terrain.classify import painted_mask
from rainsim.terrain.pond import without_images
from rainsim.view.water_states import SharedWater

MIRRORS = ("auto", "mirror")  # reflections that draw the capture again


@dataclass(frozen=True)
class Viewpoint:
    """Where a page's camera is, in the ground frame.

    position : tuple of float [m]
    turn : tuple of float. Unit quaternion, w first: the camera's own axes (x
        right, y down, z forward) to the ground.
    fov : float [rad]. Angle of the picture's height.
    """

    position: tuple
    turn: tuple
    fov: float

    def __post_init__(self):
        """Raise ParameterError unless these are a place, a turn and an angle: pages send them."""
        position, turn = number_array(self.position, (3,)), number_array(self.turn, (4,))
        is_turn = turn is not None and abs(np.linalg.norm(turn) - 1) < RIGID_TOLERANCE
        if position is None or not is_turn or not 0 < self.fov < math.pi:  # false for NaN
            raise ParameterError(
                f"the view is {shown((self.position, self.turn, self.fov))}; it must be a place, a "
                "unit quaternion and an angle below 180 degrees; move the camera"
            )

    @property
    def rotation(self):
        """Rotation to the ground frame from the camera frame, ndarray of shape (3, 3)."""
        return Rotation.from_quat(self.turn, scalar_first=True).as_matrix()


def out_of_date(before, after):
    """Return the parts that a change from one `Config` to another makes out of date, a set."""
    return {
        part for name, one in SETTINGS.items() if before.value(name) != after.value(name)
        for part in one.touches
    }  # fmt: skip


class OutOfDateError(Exception):
    """A picture is given up, since another one is wanted by now."""


class CheckedTimer(Timer):
    """A clock of stages that calls `check` between them, which may raise."""

    def __init__(self, check):
        super().__init__()
        self._check = check

    def mark(self, name):
        """Book the time of a stage; ask whether to go on."""
        super().mark(name)
        self._check()


class Session:
    """A scene, its terrain, its water and its renderer, shared by all pages.

    config : Config. `surroundings` must be set: a picture does not depend on who
        looked first.
    backend : {"cpu", "cuda"}
    mask : int array (ny, nx), optional. Painted classes, see
        `pipeline.extract_terrain`.
    cameras : sequence of Camera, optional. In the capture frame: those offered
        for a capture that has none.
    config : Config. What is wanted; the parts follow with `make`.
    cameras : tuple of Camera. The scene's, or those offered.
    no_ground : GroundError or None. Why the scene has no terrain. Then the
        capture alone is drawn.
    stale : set of str. Of `BASES`: the parts to be made again.
    """

    def __init__(
        self, scene, config, backend="cpu", mask=None, progress=None, say=None, cameras=(),
        water=None,
    ):  # fmt: skip
        self.scene, self.config, self.backend, self.mask = scene, config, backend, mask
        self.water_mask = water
        self.cameras, self.no_ground, self._bare = tuple(scene.cameras or cameras), None, None
        self.stale, self._drawn_with = set(BASES), config
        self._progress, self._say = progress or (lambda stage, done, total: None), say
        self._make_renderer, simulate = on_backend(backend)
        # The states of a GPU's simulation share its memory: only the last one is whole.
        self.water = SharedWater(simulate, *(() if backend == "cpu" else (0,)))
        self.terrain = self.renderer = self._drawn_scene = None
        self._camera = None  # of the last picture, with what it was made from
        self._leaving = None  # of the scene, once it was asked for; False: nothing is known
        self._kept = (None, None, None)  # key, terrain and what was computed for them, last asked

    def set_config(self, config):
        """Take over other settings; `make` then makes again the parts that they change."""
        self.stale |= out_of_date(self.config, config)
        self.config = config

    def set_scene(self, scene, mask=None):
        """Take another ground frame or painted classes; poured water stays if the frame does."""
        if scene.ground_frame is not self.scene.ground_frame:
            self.water_mask = None
        self.scene, self.mask, self._camera = scene, mask, None
        self.stale |= set(BASES)

    def set_water_mask(self, mask):
        """Put other water on the ground, a `WaterMask` or None: all parts are out of date."""
        self.water_mask, self._camera = mask, None
        self.stale |= set(BASES)

    @property
    def class_mask(self):
        """The painted classes as a class mask of the terrain; None where nothing is painted."""
        if self.mask is not None or self.scene.painted is None:
            return self.mask
        return painted_mask(self.scene.painted, self.terrain.grid)

    # --- parts ------------------------------------------------------------------------------------

    def make(self, check=lambda: None):
        """Make all parts that are out of date; what check() raises between two ends the work."""
        for part, make in (
            (TERRAIN, partial(self._make_terrain, check)), (WATER, self._make_water),
            (LIGHT, self._make_light),
        ):  # fmt: skip
            if part in self.stale:
                check()
                make()
                self.stale.discard(part)

    def make_ground(self):
        """Make the terrain alone, for a camera to be chosen by it."""
        self._make_terrain(lambda: None)
        self.stale.discard(TERRAIN)

    def _make_terrain(self, check):
        def progress(stage, done, total):
            check()
            self._progress(stage, done, total)

        try:
            terrain = extract_terrain(
                self.scene, self.config, self.mask, progress, self._say, self.water_mask
            )
        except GroundError as error:
            self.terrain, self.renderer, self.no_ground = None, None, error
            raise
        self.terrain, self.renderer = terrain, None
        self.no_ground, self._bare = None, None
        self._drawn_scene = without_images(self.scene, terrain)

    def _make_water(self):
        self.water.restart(with_footprints(self.terrain, self.scene), self.config)

    def _make_light(self):
        """Make the renderer with all its light."""
        camera, config = resize_to(self.cameras[0], self.config.width), self.config
        free = free_device_memory(self.backend)
        require_memory(self.scene, camera, self.terrain.bed.size, 0, free)
        self._progress("light", 0, 1)
        self.renderer = None  # its memory goes first
        self.renderer = self._make_renderer(self._drawn_scene, self.terrain, config, camera)
        self._camera, self._drawn_with = None, config

    def _follow(self):
        """Let the renderer draw with settings that it was not made for."""
        config = self.config
        if self._drawn_with == config:
            return
        if self.backend == "cpu":
            self.renderer.conductor.take_settings(config)
            self._camera, self._drawn_with = None, config
        elif not self.stale:  # the device has copies of the settings
            self._make_light()

    @property
    def is_ready(self):
        """Whether there is anything to draw with."""
        return self.renderer is not None

    # --- pictures ---------------------------------------------------------------------------------

    def camera_of(self, view, width, height):
        """Return the Camera of a view, in the capture frame, to the bit as `--path` reads it."""
        data = camera_path_data([(self.pose_of(view), view.fov)], width, height, self.config.fps)
        return path_cameras(data, "the view")[0]

    def pose_of(self, view):
        """Return capture_from_camera of a view, ndarray of shape (4, 4), with OpenCV axes."""
        frame, matrix = self.scene.ground_frame, np.eye(4)
        matrix[:3, :3] = frame.rotation.T @ view.rotation
        matrix[:3, 3] = frame.to_capture(np.array(view.position))
        return matrix

    def viewpoint_of(self, camera):
        """Return the Viewpoint nearest to a camera: square pixels, its axis in the middle."""
        placed = self.scene.ground_frame.camera_in_ground(camera)
        x, y, z, w = Rotation.from_matrix(placed.camera_from_world[:3, :3].T).as_quat()
        fov = 2 * math.atan(camera.height / 2 / camera.fy)
        turn = tuple(float(v) for v in (w, x, y, z))
        return Viewpoint(tuple(float(v) for v in placed.position), turn, fov)

    def draw(self, view, width, height, index, names=(), check=lambda: None, simple=False):
        """Return the picture of a view and its report, as the parts and settings are now.

        check : callable. Called between stages; what it raises ends the drawing.
        simple : bool. Find reflections on the screen and in the surroundings
            alone: no mirrored pictures.
        Returns picture : uint8 array (height, width, 3)
            report : FrameReport
        """
        self._follow()
        key = view, width, height, simple
        if self._camera is None or self._camera[0] != key:
            camera = self.camera_of(view, width, height)
            require_memory_of_picture(camera, free_device_memory(self.backend))
            self._camera = key, camera
            self._simplify(simple)
        camera = self._camera[1]
        try:
            state = self.water.state(index, check)
            if self.backend != "cpu":
                picture, report = self.renderer.draw(camera, state, None, names)
                return picture.copy(), report
            return self.renderer.draw(camera, state, None, names, CheckedTimer(check))
        except BaseException:
            self._camera = None  # what was kept for it is only partly drawn
            raise

    def dry(self, camera):
        """Return the `raster.Layers` of the capture that a Camera of the capture frame takes."""
        if self.is_ready:
            return self.renderer.conductor.wet_scene.capture.layers(camera)
        if self._bare is None:
            self._bare = rasterizer_of_scene(self.scene, self.config.render)
        return self._bare.draw(camera, NEAR / self.scene.ground_frame.meters_per_unit)

    def draw_bare(self, view, width, height):
        """Return the capture without rain as a view shows it, and its depth [m]."""
        camera = self.camera_of(view, width, height)
        require_memory_of_picture(camera)
        layers = self.dry(camera)
        picture = np.rint(np.clip(layers.color, 0, 1) * 255).astype(np.uint8)
        return picture, layers.depth * np.float32(self.scene.ground_frame.meters_per_unit)

    def out_of_place(self, view):
        """Return where a view's eye should not be, below the ground or far off its map, or ""."""
        if self.terrain is None:
            return ""
        x, y, z = view.position
        grid = self.terrain.grid
        row, column, inside = grid.cells(np.array([x]), np.array([y]))
        if not inside[0]:  # the capture's own cameras may stand beside a small map
            size = grid.spacing * np.array(grid.shape[::-1])
            off = np.abs(np.array([x, y]) - grid.origin - size / 2) / size
            return "far from the ground that was captured" if off.max() > 2 else ""
        sunk = float(self.terrain.bed[row[0], column[0]] - z)
        return f"{sunk:.2f} m below the ground" if sunk > 0 else ""

    def badly_seen(self, view, width, height):
        """Return the share of a view that the capture's cameras hardly saw; None if unknown."""
        if not self.is_ready or not self.scene.cameras:
            return None
        if self._leaving is None:
            self._leaving = leaving_of(self.renderer.conductor.wet_scene) or False
        return self._leaving.share(self.camera_of(view, width, height)) if self._leaving else None

    def _simplify(self, simple):
        """Let the renderer leave out mirrored pictures, or draw as the settings ask."""
        if self.backend == "cpu":
            look = self._drawn_with.render
            if simple and look.reflections in MIRRORS:
                look = replace(look, reflections="ssr", film="environment")
            self.renderer.conductor.take_methods(look)

    def kept(self, key, compute):
        """Return the result of compute() for a key and the terrain, computed when either is new."""
        if self._kept[0] != key or self._kept[1] is not self.terrain:
            self._kept = key, self.terrain, compute()
        return self._kept[2]
