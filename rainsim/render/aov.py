"""Arbitrary output variables (AOVs) of a frame, for compositing and as labels: `--layers`.

Only those AOVs are computed that are asked for by name, by the passes of `rainsim.render.layers`.
`recompose` computes a frame from its AOVs: so it defines what they mean.
"""

from dataclasses import dataclass

import numpy as np

from rainsim.errors import ParameterError
from rainsim.shading import composite

PICTURE, SHARE, INDEX, DATA = "picture", "share", "index", "data"  # kinds, see `Aov`


@dataclass(frozen=True)
class Aov:
    """Description of an arbitrary output variable (AOV).

    kind : str. PICTURE: display-referred, 8-bit PNG. SHARE: 0 to 1, 16-bit PNG.
        INDEX: whole numbers, 16-bit PNG. DATA: float32, OpenEXR with the extra
        `exr`, else .npz.
    unit : str
    what : str
    channels : tuple of str. Their names in a file of DATA, as OpenEXR users
        expect them.
    """

    kind: str
    unit: str
    what: str
    channels: tuple = ("R", "G", "B")


AOVS = {
    "clean": Aov(PICTURE, "", "the dry capture without grading"),
    "depth": Aov(DATA, "m", "along the view axis (z-depth), infinite for sky", ("Z",)),
    "range": Aov(DATA, "m", "distance from the camera's centre, infinite for sky", ("Y",)),
    "height": Aov(
        DATA, "m", "of the surface over the ground, infinite for sky and off the map", ("Y",)
    ),
    "normal": Aov(
        DATA, "", "of the captured surface, in the ground frame; zero for sky", ("X", "Y", "Z")
    ),
    "water_depth": Aov(DATA, "m", "of the water that the pixel shows", ("Y",)),
    "wetness": Aov(SHARE, "", "of surfaces: 0 dry, 1 wet through"),
    "wet": Aov(DATA, "display white", "linear light: graded and wetted, without water"),
    "film": Aov(DATA, "display white", "reflection of the water film on the ground, a part of wet"),
    "coverage": Aov(SHARE, "", "of the pixel that is water"),
    "reflection": Aov(DATA, "display white", "what the water mirrors (the paper's specular)"),
    "reflection_source": Aov(INDEX, "", "0 no water, 1 environment, 2 screen, 3 mirrored pass"),
    "refraction": Aov(DATA, "display white", "what shows through the water, absorption included"),
    "fresnel": Aov(SHARE, "", "of the light that the water mirrors"),
    "highlight": Aov(DATA, "display white", "the sun's glint on the water, as it is added"),
    "transmission": Aov(SHARE, "", "of the air, where drops are too small or far to draw"),
    "rain_alpha": Aov(SHARE, "", "of the light that falling drops replace"),
    "splash_alpha": Aov(SHARE, "", "of the light that splashes replace"),
    "splash_id": Aov(INDEX, "", "of the splash nearest to a splashed pixel, 0 for none"),
    "drop_flow": Aov(
        DATA, "px per frame", "mean motion (right, down) of the drops in a pixel", ("X", "Y")
    ),
    "flow": Aov(
        DATA, "px per frame", "motion (right, down) of the scene to the next frame", ("X", "Y")
    ),
    "flow_mask": Aov(INDEX, "", "0 no flow, 1 seen, 2 occluded, 3 outside the next frame"),
    "class_id": Aov(INDEX, "", "class of ground or water, 255 for all else"),
    "puddle_id": Aov(INDEX, "", "of the puddle that a pixel shows, 0 for none"),
    "actor_id": Aov(INDEX, "", "of the actor that a pixel shows, 0 for none"),
    "beauty": Aov(DATA, "display white", "the frame in linear light, before the tone curve"),
    "clear_air": Aov(PICTURE, "", "the frame without drops, splashes, spray and haze of rain"),
    "dry": Aov(DATA, "display white", "the dry capture without grading, in linear light"),
    "matte": Aov(SHARE, "", "of the pixel that captured splats cover, not the sky behind them"),
    "position": Aov(DATA, "m", "in the ground frame, zero for sky", ("X", "Y", "Z")),
    "glare": Aov(DATA, "display white", "halos of lamps, as they are added"),
    "near_alpha": Aov(SHARE, "", "of the light that drops nearer than 2 m replace"),
    "spray_alpha": Aov(SHARE, "", "of the light that spray of tyres replaces"),
    "rain_depth": Aov(DATA, "m", "of drops, splashes and spray, infinite without any", ("Z",)),
    "near_depth": Aov(DATA, "m", "of drops nearer than 2 m, infinite without any", ("Z",)),
    "streak_depth": Aov(DATA, "m", "of all other drops, infinite without any", ("Z",)),
    "spray_depth": Aov(DATA, "m", "of spray of tyres, infinite without any", ("Z",)),
}
NEEDED = ("wet", "coverage", "reflection", "refraction", "fresnel", "highlight", "transmission",
          "rain_alpha", "splash_alpha")  # fmt: skip


def parse_names(text):
    """Return the AOVs that a text names: all, or names with commas between them.

    Raises ParameterError if a name is not known.
    """
    if text is None:
        return ()
    if text == "all":
        return tuple(AOVS)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in AOVS:
            raise ParameterError(
                f"there is no layer {name!r}; known are all, {', '.join(AOVS)}; correct the name"
            )
    return names


def recompose(aovs, drop, around, air, brightness):
    """Return the frame, uint8, that its AOVs make.

    Parameters
    ----------
    aovs : dict of str to ndarray
        At least those of NEEDED.
    drop : array_like of shape (3,) or (m, n, 3)
        Radiance of drops: everywhere, or at places from edge to edge of the picture, bilinear
        between them.
    around : array_like of shape (3,) or (m, n, 3)
        The same of the sheets of splashes.
    air : array_like of shape (3,)
        Radiance of the air; see `FrameReport.light`.
    brightness : float

    Examples
    --------
    >>> from rainsim.render.aov import NEEDED
    >>> renderer = rainsim.Renderer(scene, terrain, config, scene.cameras[0])
    >>> picture, report = renderer.draw(scene.cameras[0], state, names=NEEDED)
    >>> again = rainsim.recompose(report.aovs, **report.light)
    >>> int(np.abs(again.astype(int) - picture).max()) <= 1
    True
    """
    part = {name: np.asarray(aovs[name], np.float64) for name in NEEDED}
    share, cover = part["fresnel"][..., None], part["coverage"][..., None]
    water = (1 - share) * part["refraction"] + share * part["reflection"] + part["highlight"]
    value = part["wet"] * (1 - cover) + water * cover
    drop, around = (spread_field(field, *part["coverage"].shape) for field in (drop, around))
    past_splashes, past_drops = (
        1 - part[name][..., None] for name in ("splash_alpha", "rain_alpha")
    )
    value = brightness * composite.through_rain(
        value, drop, around, np.asarray(air), part["transmission"][..., None],
        past_splashes, past_drops,
    )  # fmt: skip
    image = np.empty(value.shape, np.uint8)
    composite.encode(value.astype(np.float32).ravel(), image.ravel())
    return image


def spread_field(drop, height, width, rows=slice(None)):
    """Interpolate the radiance of drops from a few places of the picture to its pixels.

    drop : array_like of shape (rows, columns, 3) or (3,). At places from edge to
        edge, see `falling_light`; (3,) is even over the picture.
    height, width : int [px]
    rows : slice. The rows of the picture that are wanted.
    Returns array (rows, width, 3) or (3,), float64
    """
    drop = np.asarray(drop, np.float64)
    if drop.ndim == 1:
        return drop
    v = (np.arange(height)[rows] + 0.5) / height * (drop.shape[0] - 1)
    u = (np.arange(width) + 0.5) / width * (drop.shape[1] - 1)
    j, i = v.astype(int), u.astype(int)
    b, a = (v - j)[:, None, None], (u - i)[None, :, None]
    lines = drop[j] * (1 - b) + drop[j + 1] * b
    return lines[:, i] * (1 - a) + lines[:, i + 1] * a
