"""One camera's values in a JSON file, checked one by one, and the pose that they make."""

import numpy as np

from rainsim.errors import InputError, shown
from rainsim.io.files import json_number, number_array
from rainsim.scene.camera_rule import MAX_SIDE, RIGID_TOLERANCE, require_camera
from rainsim.scene.types import Camera

FLIP = np.array([1.0, -1.0, -1.0])  # OpenGL camera axes (y up, z back) to ours, and back


class Entry:
    """One camera's values in a file, or others, and those that all entries of the file share."""

    remedy = "correct the file"

    def __init__(self, path, label, values, shared=None):
        self.label = f"{path} {label}"
        if not isinstance(values, dict):
            raise InputError(f"{self.label} is not an object with named values; write it again")
        self.values, self.shared = values, shared or {}

    def get(self, key):
        """Return a value, of all cameras if this one has none; None without."""
        return self.values.get(key, self.shared.get(key))

    def number(self, key, above, below):
        """Return a number strictly between two ends, or raise InputError."""
        value = json_number(self.get(key))
        if value is None or not above < value < below:
            raise self.error(key, f"a number above {above:g} and below {below:g}")
        return value

    def side(self, key):
        """Return a number of pixels, or raise InputError."""
        value = self.number(key, 0, MAX_SIDE + 1)
        if value != int(value):
            raise self.error(key, "a whole number of pixels")
        return int(value)

    def array(self, key, shape):
        """Return numbers of a shape as float64, or raise InputError."""
        value = number_array(self.get(key), shape)
        if value is None:
            raise self.error(key, f"finite numbers of shape {' x '.join(map(str, shape))}")
        return value

    def rotation(self, key, matrix):
        """Return `matrix` if it is a rotation, or the nearest rotation if it is off by rounding."""
        away = np.abs(matrix @ matrix.T - np.eye(3)).max()
        if away > RIGID_TOLERANCE or np.linalg.det(matrix) < 0:
            raise self.error(key, "a rotation without scale or mirroring")
        if away > 1e-12:  # more than float64 rounding: clean it up
            u, _, v = np.linalg.svd(matrix)
            return u @ v
        return matrix

    def camera(self, size, lens, pose, name):
        """Return the `Camera` of a size, a lens (fx, fy, cx, cy) and a pose, checked."""
        return require_camera(Camera(*size, *lens, pose, name), self.label)

    def error(self, key, rule):
        """Return the InputError for a value that breaks a rule."""
        value = "missing" if self.get(key) is None else shown(self.get(key))
        return InputError(f"{self.label}: {key} is {value}; it must be {rule}; {self.remedy}")
