"""One multipart OpenEXR file a frame, in linear light, as compositors take it: `--exr`.

`parts_of` makes the parts from a frame's layers. All light is multiplied by the frame's brightness
and is in the file's colour space, so that the parts add up to the beauty without other numbers.
"""

import json
import math
import re
from dataclasses import dataclass

import numpy as np

from rainsim import __version__
from rainsim.errors import ParameterError
from rainsim.io.exr import fits_half, half, write_parts
from rainsim.numerics.blocks import ROWS, in_blocks
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
ELEMENTS = ("near", "streaks", "spray", "splashes", "air")  # of the rain, front to back
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
    "beauty", "rain", *ELEMENTS, "depth", "position", "normal",
    "motion", "wet", *LIGHT, *SHARES, "water_depth", "ids",
)  # fmt: skip
LEAST_PAST = 1e-6  # share of light that near drops and spray let through: behind less nothing shows


@dataclass(frozen=True)
class ExrFormat:
    """How frames are written as OpenEXR files.

    fps : float [1/s]
    name : str. Of the files, with the place of the frame's number as C's printf
        has it: %04d.
    start : int. Number of the first frame.
    colorspace : str. Of `SPACES`.
    layers : tuple of str. Those that are written as files of their own beside it.
    Raises ParameterError if the name or the number cannot be that of a file.
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

    report : FrameReport. With the layers LAYERS.
    colorspace : str. Of `SPACES`.
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
    """Return those of `parts_of` that hold light, and shares of it, without their depth.

    Bands of rows are computed by themselves: the double precision of whole 4K frames is gigabytes.
    """
    matrix = from_rec709(SPACES[colorspace]) * report.light["brightness"]
    parts, bright = _filled(report, matrix, np.float16)
    if bright:  # lamps are rare
        for part, channels in _filled(report, matrix, np.float32, bright)[0].items():
            parts[part] |= channels
    return parts | {name: {"Y": half(report.aovs[name])} for name in SHARES}


def _filled(report, matrix, kind, only=None):
    """Return planes of the parts with light by part and channel, and the parts too bright for half.

    With `only`, the channels R, G and B of these parts alone.
    """
    height, width = report.aovs["beauty"].shape[:2]
    parts, bright = {}, set()
    for part in ("beauty", "rain", *ELEMENTS, "wet", *LIGHT):
        if only is None or part in only:
            names = "RGBA" if only is None and part not in ("wet", *LIGHT) else "RGB"
            parts[part] = {name: np.empty((height, width), kind) for name in names}

    def fill(rows):
        for part, (light, alpha) in _light_of(report, rows).items():
            if part not in parts:
                continue
            light = np.asarray(light, np.float64) @ matrix.T
            if not fits_half(light):
                bright.add(part)
            for name, values in _channels("RGB", light).items():
                parts[part][name][rows] = half(values) if kind == np.float16 else values
            if "A" in parts[part]:
                parts[part]["A"][rows] = half(alpha)

    in_blocks(fill, height, max(ROWS // width, 1))
    return parts, bright


def _light_of(report, rows):
    """Return light and alpha, None without one, of rows of each part that has light."""
    layers = {name: values[rows] for name, values in report.aovs.items()}
    seen = layers["beauty"] / np.float64(report.light["brightness"] or 1)  # the layer has it
    wet = layers["wet"].astype(np.float64) - layers["film"]
    return {
        "beauty": (seen, 1), **_elements(report, rows), "wet": (wet, None),
        **{part: (layers[layer], None) for part, layer in LIGHT.items()},
    }  # fmt: skip


def _channels(names, values):
    return {name: values[..., k] for k, name in enumerate(names)}


def _elements(report, rows):
    """Return radiance, multiplied by alpha, and alpha of what stands before rows of the wet scene.

    By part: the rain whole, and what it is made of from the front to the back.
    """
    layers, shape = report.aovs, report.aovs["beauty"].shape[:2]
    past = {
        name: 1 - layers[f"{name}_alpha"][rows].astype(np.float64)
        for name in ("rain", "near", "spray", "splash")
    }
    before = past["near"] * past["spray"]
    streaks = np.where(before > LEAST_PAST, past["rain"] / np.maximum(before, LEAST_PAST), 1)
    drops, sheets = (spread_field(report.light[name], *shape, rows) for name in ("drop", "around"))
    air = np.asarray(report.light["air"], np.float64)
    radiance = {
        "near": drops, "streaks": drops, "spray": drops, "splashes": splash_light(drops, sheets),
        "air": air,
    }  # fmt: skip
    alphas = {
        "near": 1 - past["near"], "streaks": np.clip(1 - streaks, 0, 1),
        "spray": 1 - past["spray"], "splashes": 1 - past["splash"],
        "air": 1 - layers["transmission"][rows].astype(np.float64),
    }  # fmt: skip
    apart = {part: (radiance[part] * a[..., None], a) for part, a in alphas.items()}
    whole, through = 0.0, np.ones(past["rain"].shape)
    for light, alpha in apart.values():
        whole, through = whole + through[..., None] * light, through * (1 - alpha)
    return {"rain": (whole, 1 - through), **apart}
