"""Captures that were trained from pictures, packed, for `benchmarks day`.

A patio was path-traced on a sunny day from 92 places, as a person would photograph it. From these
pictures two captures were trained: `3dgs` (gsplat 1.5.3, the recipe of Kerbl et al. 2023, 30,000
steps) and `2dgs` (the same program's 2DGS, 12,000 steps). Three test views were traced on a wet
day, too. Harmonics above degree 0 are left out; numbers are rounded (see `STEPS`).
"""

from __future__ import annotations

import numpy as np

from benchmarks import day_data
from benchmarks.day_case import Rain
from rainsim.constants import SH_0
from rainsim.scene.cameras import Camera
from rainsim.scene.ground import estimate_ground_frame
from rainsim.scene.types import Scene, Splats

NAMES, TRUTH = ("3DGS", "2DGS"), "trained_truth"
RAIN = Rain("rain", (), past=0.03)
# Steps of the logarithm of 1 + position [m], of the logarithm of the scale, of the parts of a unit
# quaternion, of opacity and of the display colour, in which splats are kept.
STEPS = {"position": 1 / 7000, "scale": 1 / 12, "rotation": 1 / 127, "opacity": 1 / 255,
         "color": 1 / 256}  # fmt: skip
LEAST_SCALE = 1e-6  # m


def scenes():
    """Yield name, `Scene` and the truth's arrays of each trained capture; the test views first.

    None where their files are not: nothing here makes them again.
    """
    if not (day_data.FOLDER / f"{TRUTH}.npz").is_file():
        return
    truth = day_data.read(TRUTH)
    cameras = [
        Camera(*(int(n) for n in truth["size"]), *lens, pose, str(name))
        for name, lens, pose in zip(truth["names"], truth["lens"], truth["poses"], strict=True)
    ]
    for name in NAMES:
        file = f"trained_{name.lower()}"
        splats = unpack(day_data.read(file))
        frame = estimate_ground_frame(splats, cameras, (0, 0, 1), 1.0)
        # A source tells the program that this is a capture, whose light it has to find out.
        source = day_data.FOLDER / f"{file}.npz"
        yield name, Scene(file, splats, cameras, frame, source, file), truth


def pack(splats):
    """Return arrays of whole numbers for splats without their harmonics above degree 0."""
    position, scale = splats.position, np.log(np.maximum(splats.scale, LEAST_SCALE))
    unit = splats.rotation / np.linalg.norm(splats.rotation, axis=1, keepdims=True)
    values = {
        "position": np.sign(position) * np.log1p(np.abs(position)),
        "scale": scale - np.log(LEAST_SCALE), "rotation": unit, "opacity": splats.opacity,
        "color": splats.sh[:, 0] * SH_0 + 0.5,
    }  # fmt: skip
    kinds = {"position": np.int16, "color": np.int16, "rotation": np.int8}
    return {
        name: np.round(value / STEPS[name]).astype(kinds.get(name, np.uint8)).T
        for name, value in values.items()
    }


def unpack(arrays):
    """Return the `Splats` that `pack` was given, rounded."""
    values = {name: arrays[name].T * np.float32(step) for name, step in STEPS.items()}
    position = np.sign(values["position"]) * np.expm1(np.abs(values["position"]))
    sh = (values["color"] - np.float32(0.5)) / np.float32(SH_0)
    scale = np.exp(values["scale"]) * np.float32(LEAST_SCALE)
    length = np.linalg.norm(values["rotation"], axis=1, keepdims=True)
    return Splats(*(np.ascontiguousarray(a, np.float32) for a in (
        position, values["rotation"] / length, scale, values["opacity"], sh[:, None],
    )))  # fmt: skip
