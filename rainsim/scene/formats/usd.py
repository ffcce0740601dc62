"""Splats of USD stages: the prims ParticleField3DGaussianSplat, placed as the stage has them.

They come in the stage's world, in metres with z up, as its cameras do. Names and types are those of
the schema in OpenUSD 26.03 (UsdVol); splats without one of the attributes are refused, though the
schema has a value for each.
"""

import numpy as np

from rainsim.errors import InputError
from rainsim.scene.activate import activate, require_believable
from rainsim.scene.formats import LEVEL, USD_SUFFIXES
from rainsim.scene.formats.gltf import decomposed, placed
from rainsim.scene.harmonics import turned
from rainsim.scene.shot_camera import Z_UP
from rainsim.scene.splat_sets import joined
from rainsim.scene.usd_cameras import require_usd, world_of
from rainsim.scene.usd_guard import apart, opened, require_tame, require_types

TYPE = "ParticleField3DGaussianSplat"
# Of each attribute the classes of its values; those of half precision have a name that ends in h.
ARRAYS = {
    "positions": ("Vec3fArray", "Vec3hArray"),
    "orientations": ("QuatfArray", "QuathArray"),
    "scales": ("Vec3fArray", "Vec3hArray"),
    "opacities": ("FloatArray", "HalfArray"),
    "radiance:sphericalHarmonicsCoefficients": ("Vec3fArray", "Vec3hArray"),
}
DEGREE = "radiance:sphericalHarmonicsDegree"
HIGHEST = 3


def read_usd_splats(path):
    """Return the Splats of a USD stage, which are usable, and notes."""
    if path.suffix.lower() not in USD_SUFFIXES:
        raise InputError(
            f"{path} is USD; its name must end in {', '.join(USD_SUFFIXES)}; rename it"
        )
    require_usd(f"{path} is USD; reading it")
    return apart(_read_stage, path)


def _read_stage(path):
    with opened(path) as (stage, size):
        world = world_of(stage, path)
        prims = _prims(stage)
        if not prims:
            raise InputError(
                f"{path} is a USD stage without splats; it must have a prim {TYPE}; export the "
                "capture so, or as PLY, SPZ or SOG"
            )
        arrays = [_arrays(path, prim) for prim in prims]
        # Each of the five values takes a byte at least, unless prims are instances.
        total = len(ARRAYS) * sum(len(each["positions"]) for each in arrays)
        require_believable(path, total, size)
        notes = _notes(stage, prims)
        places = [_place(path, prim, world) for prim in prims]
        parts = [_read(path, *part) for part in zip(prims, arrays, places, strict=True)]
    read, good = zip(*parts, strict=True)
    return joined(read), np.concatenate(good), notes


def files_of(path):
    """Return the files of the stage at `path`."""
    require_usd(f"{path} is USD; reading it")
    return apart(_files_of, path)


def _files_of(path):
    return require_tame(path)[1]


def _prims(stage):
    """Return the prims of splats that are to be seen."""
    from pxr import Usd, UsdGeom

    return [
        prim
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        if prim.GetTypeName() == TYPE
        and UsdGeom.Imageable(prim).ComputeVisibility() != UsdGeom.Tokens.invisible
    ]


def _notes(stage, prims):
    from pxr import UsdGeom

    notes = []
    if UsdGeom.StageHasAuthoredMetersPerUnit(stage) and stage.HasAuthoredMetadata("upAxis"):
        notes.append(LEVEL)
    if any(prim.GetAttribute(name).ValueMightBeTimeVarying() for prim in prims for name in ARRAYS):
        notes.append("splats of the USD stage change over time; their first moment is taken")
    if any(prim.GetAttribute("projectionModeHint").Get() == "tangential" for prim in prims):
        notes.append("USD asks for projection tangential; drawn as perspective")
    return notes


def _place(path, prim, world):
    """Return the matrix (3, 4) that takes a prim's own numbers to metres with z up."""
    from pxr import Usd, UsdGeom

    require_types(path, prim)
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    matrix = np.array(cache.GetLocalToWorldTransform(prim)).T
    if not np.isfinite(matrix).all() or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise _wrong(path, prim, "its place is no finite matrix that turns, moves and scales")
    return world.meters * Z_UP[world.up] @ matrix[:3]


def _arrays(path, prim):
    """Return the values of a prim's attributes, checked; harmonics are (splats, k, 3)."""
    from pxr import Usd

    found = {}
    for name, classes in ARRAYS.items():
        values = (prim.GetAttribute(own).Get(Usd.TimeCode.EarliestTime())
                  for own in (name, f"{name}h") if prim.HasAttribute(own))  # fmt: skip
        value = next((value for value in values if value is not None), None)
        if value is None:
            raise _wrong(path, prim, f"{name} has no value; all of {TYPE} must have some")
        if type(value).__name__ not in classes:
            raise _wrong(path, prim, f"{name} is a {type(value).__name__}; it must be {classes[0]}")
        found[name] = value
    degree = prim.GetAttribute(DEGREE).Get()
    if not isinstance(degree, int) or not 0 <= degree <= HIGHEST:
        raise _wrong(path, prim, f"{DEGREE} is {degree!r}; it must be 0 to {HIGHEST}")
    count, name = len(found["positions"]), list(ARRAYS)[-1]
    wanted = dict.fromkeys(ARRAYS, count) | {name: count * (degree + 1) ** 2}
    for name, number in wanted.items():
        if len(found[name]) != number:
            raise _wrong(path, prim, f"{name} has {len(found[name])} values; it must be {number}")
    found = {name: np.array(value, np.float32) for name, value in found.items()}
    found[name] = found[name].reshape(count, (degree + 1) ** 2, 3)
    return found


def _read(path, prim, arrays, place):
    """Return the Splats of a prim in the stage's world, and which are usable."""
    rotation, scales = decomposed(place[:, :3], lambda text: _wrong(path, prim, text))
    position, turn, scale, opacity, sh = arrays.values()
    sh = turned(sh, rotation)
    with np.errstate(all="ignore"):  # what is not usable is counted afterwards
        position = position @ place[:, :3].T + place[:, 3]
        turn, scale = placed(np.roll(turn, 1, axis=1), scale, rotation, scales)  # w first
        opacity = opacity.astype(np.float64)
        return activate(
            position.astype(np.float32), np.log(scale), turn,
            np.log(opacity) - np.log1p(-opacity), sh[:, 0], sh[:, 1:] if sh.shape[1] > 1 else None,
        )  # fmt: skip


def _wrong(path, prim, text):
    return InputError(f"{path} {prim.GetPath()}: {text}; correct it, or export it again")
