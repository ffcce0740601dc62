"""Cameras of `benchmarks frame` and its comparison of pictures, alike on both backends."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from rainsim.config.tables import CHOICES
from rainsim.scene.cameras import orbit

PRESET = "moderate"
ORBIT = 240  # cameras of a full circle: a slow walk
TRUTH_SCALE = 2
TRUTH_WIDTH = 700  # px, up to which all levels are measured: the truth's traced rays take long
# What each level changes of the preset, and the share of the width that it is drawn at.
LEVELS = {
    "as set": ({}, 1.0),
    "half size": ({}, 0.5),
    "map 4 cm": ({"spacing": 2.0}, 1.0),
    "rain to 3 m": ({"streak_far": 3.0}, 1.0),
    "all splats": ({"merge": 0.0}, 1.0),
    "merge 2 px": ({"merge": 2.0}, 1.0),
    "merge 8 px": ({"merge": 8.0}, 1.0),
    "full mirrors": ({"mirror_size": "full"}, 1.0),
    **{name: ({"reflections": name}, 1.0) for name in CHOICES["reflections"] if name != "auto"},
}
TRUTH = {"merge": 0.0, "streak_far": 16.0}  # and what water mirrors is traced


def cameras_of(scene, motion, count):
    """Return the cameras: one for all frames, a slow orbit, or the drive that a scene has."""
    if motion == "still":
        return [scene.cameras[0]] * (count - 1) + [scene.cameras[1]]
    away = np.linalg.norm(scene.cameras[1].position - scene.cameras[0].position)
    if away * scene.ground_frame.meters_per_unit < 0.5 and len(scene.cameras) >= count:
        return list(scene.cameras[:count])
    return orbit(scene.ground_frame, scene.cameras, count=ORBIT)[:count]


def shrunk(picture):
    """Return an 8-bit picture averaged over blocks of TRUTH_SCALE px, as float32 from 0 to 1.

    The mean is taken in linear light, as a sensor does, and encoded for display again.
    """
    height, width = (n // TRUTH_SCALE * TRUTH_SCALE for n in picture.shape[:2])
    linear = (picture[:height, :width] / np.float32(255)) ** np.float32(2.2)
    shape = (height // TRUTH_SCALE, TRUTH_SCALE, width // TRUTH_SCALE, TRUTH_SCALE, 3)
    return linear.reshape(shape).mean(axis=(1, 3)) ** np.float32(1 / 2.2)


def error_of(picture, truth):
    """Return the root mean square error of an 8-bit picture, white being 1.

    It is enlarged to the truth's size if smaller; the truth is as `shrunk` returns it.
    """
    picture = picture / np.float32(255)
    if picture.shape != truth.shape:
        zoom = [a / b for a, b in zip(truth.shape, picture.shape, strict=True)]
        picture = ndimage.zoom(picture, zoom, order=1, grid_mode=True, mode="nearest")
    return float(np.sqrt(np.mean((picture - truth) ** 2)))
