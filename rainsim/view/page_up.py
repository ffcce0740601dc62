"""A disc with a pole that is turned by a drag until it lies on level ground: that is up."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

NODE = "/up"
SHARE = 0.15  # of the distance to it: the disc's radius, so that it is as large from anywhere
SIDES = 48  # of the disc's rim
COLOR = (240, 228, 66)


class UpDisc:
    """The disc in the scene; there is none until `put` is called.

    scene : viser.SceneApi
    turned : callable. turned() is called when a drag has turned the disc.
    """

    def __init__(self, scene, turned):
        self._scene, self._turned = scene, turned
        self._nodes, self.point = [], None

    def put(self, point, distance):
        """Put the disc at a point of the ground frame [m], seen from a distance [m]; it is level.

        point : sequence of float [m]
        distance : float [m]
        """
        self.remove()
        self.point, radius = tuple(point), max(SHARE * distance, 1e-3)
        rings = self._scene.add_transform_controls(
            NODE, scale=1.5 * radius, disable_axes=True, disable_sliders=True, depth_test=False,
            position=self.point,
        )  # fmt: skip
        angle = 2 * math.pi * np.arange(SIDES + 1) / SIDES
        rim = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(SIDES + 1)])
        spokes = np.stack([np.zeros((4, 3)), rim[: -1 : SIDES // 4]], axis=1)
        pole = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.5 * radius]]])
        lines = np.concatenate([np.stack([rim[:-1], rim[1:]], axis=1), spokes, pole])
        drawn = self._scene.add_line_segments(
            f"{NODE}/disc", lines.astype(np.float32), COLOR, line_width=3.0
        )
        self._nodes = [drawn, rings]
        rings.on_update(lambda _: self._turned())

    @property
    def up(self):
        """The pole's direction in the ground frame, ndarray of shape (3,)."""
        return Rotation.from_quat(self._nodes[-1].wxyz, scalar_first=True).as_matrix()[:, 2]

    @property
    def lean(self):
        """Angle of the pole to the present up [degrees]."""
        x, y, z = self.up
        return math.degrees(math.atan2(math.hypot(x, y), z))

    def remove(self):
        """Take the disc out of the scene."""
        for node in self._nodes:
            node.remove()
        self._nodes, self.point = [], None
