"""One multipart OpenEXR file a frame, in linear light, as compositors take it: `--exr`.

`parts_of` makes the parts from a frame's layers. All light is multiplied by the frame's brightness
and is in the file's colour space, so that the parts add up to the beauty without other numbers.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass

import numpy as np

from rainsim import __version__
from rainsim.errors import ParameterError
from rainsim.io.exr import half, half_or_float, write_parts
from rainsim.numerics.color_spaces import SPACES, from_rec709
from rainsim.render.aov import spread_field
from rainsim.shading.composite import splash_light

FOLDER = "exr"
USUAL_NAME = "rain.%04d.exr"
NUMBER = re.compile(r"%0?\d?d")
NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*\.exr")
LIGHT = {  # part: layer
    "dry": "dry", "film": "film", "reflection": "reflection", "refraction": "refraction",
    "highlight": "highlight", "glare": "glare",
}  # fmt: skip
SHARES = ("coverage", "fresnel", "transmission", "wetness", "matte")
DEPTHS = {"rain": "rain_depth", "near": "near_depth", "streaks": "streak_depth",
          "spray": "spray_depth"}  # fmt: skip
IDS = {"actor": "actor_id", "puddle": "puddle_id", "class": "class_id", "splash": "splash_id"}
LAYERS = (
    "beauty", "wet", "rain_alpha", "near_alpha", "spray_alpha", "splash_alpha",
    *DEPTHS.values(), "depth", "position", "normal", "flow", "flow_mask", "water_depth",
    *LIGHT.values(), *SHARES, *IDS.values(),
)  # fmt: skip
PARTS = (  # in their order in the file; viewers show the first
    "beauty", "rain", "near", "streaks", "spray", "splashes", "air", "depth", "position", "normal",
    "motion", "wet", *LIGHT, *SHARES, "water_depth", "ids",
)  # fmt: skip
LEAST_PAST = 1e-6  # share of light that near drops and spray let through: behind less nothing shows


@dataclass(frozen=True)
class ExrFormat:
    """How frames are written as OpenEXR files.

    Attributes
    ----------
    fps : float [1/s]
    name : str
        Of the files, with the place of the frame's number as C's printf has it: %04d.
    start : int
        Number of the first frame.
    colorspace : str
        Of `SPACES`.
    layers : tuple of str
        Those that are written as files of their own beside it.

    Raises
    ------
    ParameterError
        If the name or the number cannot be that of a file.
    """

    fps: float
    name: str = USUAL_NAME
    start: int = 0
    colorspace: str = "rec709"
    layers: tuple = ()

    def __post_init__(self):
        if self.name.count("%") != 1 or not NUMBER.search(self.name):
            raise ParameterError(
                f"--exr-name {self.name} must hold the frame's number once, as %04d or %d; give "
                f"one such as {USUAL_NAME}"
            )
        if not NAME.fullmatch(self.path(0).removeprefix(FOLDER + "/")):
            raise ParameterError(
                f"--exr-name {self.name} must be letters, digits and . _ - without a folder and "
                f"end in .exr; give one such as {USUAL_NAME}"
            )

    def path(self, index):
        """Return the name of a frame's file, relative to the output folder."""
        return f"{FOLDER}/{self.name % (self.start + index)}"

    @property
    def content(self):
        """What the files depend on, as plain JSON values."""
        return {"name": self.name, "start": self.start, "colorspace": self.colorspace}


def write_exr(folder, report):
    """Write the OpenEXR file of a frame with the layers LAYERS; return its name.

    Parameters
    ----------
    folder : Path
    report : FrameReport
    """
    exr = report.exr
    space, name = SPACES[exr.colorspace], exr.path(report.index)
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    brightness = report.light["brightness"]
    header = {
        "software": f"rainsim {__version__}",
        "imageCounter": exr.start + report.index,
        "expTime": float(report.facts["weather"]["exposure_s"]),
        "rainsim:time_s": float(report.time),
        "rainsim:brightness": float(brightness),
        "rainsim:exposure_ev": math.log2(brightness) if brightness > 0 else -math.inf,
        "rainsim:facts": json.dumps({"light": report.light, **report.facts}),
    }
    data = {"colorInteropID": "data"}
    colors = {
        "chromaticities": space.chromaticities, "oiio:ColorSpace": space.name,
        "colorInteropID": space.identifier,
    }  # fmt: skip
    parts = [
        (part, channels, colors if "R" in channels else data)
        for part, channels in parts_of(report, exr.colorspace).items()
    ]
    write_parts(folder / name, parts, header, exr.fps)
    return name


def parts_of(report, colorspace="rec709"):
    """Return the parts of a frame's file: for each its channels by name, float16 or float32.

    Parameters
    ----------
    report : FrameReport
        With the layers LAYERS.
    colorspace : str
        Of `SPACES`.
    """
    layers = report.aovs
    right, down = np.moveaxis(layers["flow"], -1, 0)
    ids = {name: layers[layer].astype(np.float32) for name, layer in IDS.items()}
    data = {
        "splashes": {"Z": np.where(layers["splash_alpha"] > 0, layers["depth"], np.inf)},
        **{part: {"Z": layers[layer]} for part, layer in DEPTHS.items()},
        "depth": {"Z": layers["depth"]},
        "position": _channels("XYZ", layers["position"]),
        "normal": _channels("XYZ", half(layers["normal"])),
        "motion": {"u": half(right), "v": half(-down)},
        "water_depth": {"Y": half(layers["water_depth"])},
        "ids": {**ids, "motion": layers["flow_mask"].astype(np.float32)},
    }
    light = light_parts_of(report, colorspace) if report.parts is None else report.parts
    return {name: {**light.get(name, {}), **data.get(name, {})} for name in PARTS}


def light_parts_of(report, colorspace):
    """Return those of `parts_of` that hold light, and shares of it, without their depth."""
    layers = report.aovs
    matrix = from_rec709(SPACES[colorspace]) * report.light["brightness"]

    def light(values):
        return _channels("RGB", half_or_float(np.asarray(values, np.float64) @ matrix.T))

    opaque = np.ones(layers["beauty"].shape[:2], np.float16)
    # The layer has its brightness already.
    seen = layers["beauty"] / np.float64(report.light["brightness"] or 1)
    parts = {"beauty": {**light(seen), "A": opaque}}
    for part, (radiance, alpha) in _elements(report).items():
        parts[part] = {**light(radiance), "A": half(alpha)}
    parts["wet"] = light(layers["wet"].astype(np.float64) - layers["film"])
    parts |= {part: light(layers[layer]) for part, layer in LIGHT.items()}
    return parts | {name: {"Y": half(layers[name])} for name in SHARES}


def _channels(names, values):
    return {name: values[..., k] for k, name in enumerate(names)}


def _elements(report):
    """Return radiance, multiplied by alpha, and alpha of what stands before the wet scene.

    By part: the rain whole, and what it is made of from the front to the back.
    """
    layers, shape = report.aovs, report.aovs["beauty"].shape[:2]
    past = {
        name: 1 - layers[f"{name}_alpha"].astype(np.float64)
        for name in ("rain", "near", "spray", "splash")
    }
    before = past["near"] * past["spray"]
    streaks = np.where(before > LEAST_PAST, past["rain"] / np.maximum(before, LEAST_PAST), 1)
    drops, sheets = (spread_field(report.light[name], *shape) for name in ("drop", "around"))
    air = np.asarray(report.light["air"], np.float64)
    radiance = {
        "near": drops, "streaks": drops, "spray": drops, "splashes": splash_light(drops, sheets),
        "air": air,
    }  # fmt: skip
    alphas = {
        "near": 1 - past["near"], "streaks": np.clip(1 - streaks, 0, 1),
        "spray": 1 - past["spray"], "splashes": 1 - past["splash"],
        "air": 1 - layers["transmission"].astype(np.float64),
    }  # fmt: skip
    apart = {part: (radiance[part] * a[..., None], a) for part, a in alphas.items()}
    whole, through = np.zeros((*shape, 3)), np.ones(shape)
    for light, alpha in apart.values():
        whole, through = whole + through[..., None] * light, through * (1 - alpha)
    return {"rain": (whole, 1 - through), **apart}
