"""The terrain of a scene from the results of an earlier run, or extracted and kept for the next."""

from rainsim.io import cache
from rainsim.io.allocator import trim
from rainsim.terrain.types import NO_TOPS, Grid, Terrain, Tops

KIND = "terrain"
ARRAYS = ("bed", "top", "underside", "source", "ground_class", "noise", "color")
TOPS = "tops_"  # begins the names of the arrays of `Tops`


def kept_terrain(scene, config, mask=None, tell=None):
    """Return the result of `extract_terrain`, to the byte; the parameters are the same.

    The kept entry is named by the splats' content, the ground frame, the cameras, the drains, the
    painted classes, the settings of the terrain and the mask; see `rainsim.io.cache`.
    """

    def extracted():
        from rainsim.terrain.extract import extract_terrain  # not needed for a kept terrain

        packed = _packed(extract_terrain(scene, config, mask, tell))
        trim()  # half of the memory that surface and ground were found in
        return packed

    return _unpacked(*cache.kept(KIND, extracted, *_inputs(scene, config, mask)))


def entry_name(scene, config, mask=None):
    """Return the name of a terrain's entry, see `rainsim.io.cache.name_of`."""
    return cache.name_of(KIND, *_inputs(scene, config, mask))


def _inputs(scene, config, mask):
    places = scene.splats, scene.ground_frame, scene.cameras, scene.drains
    return *places, scene.painted, config, mask


def _packed(terrain):
    """Return a terrain as the facts and arrays of an entry."""
    grid = terrain.grid
    facts = {
        "shape": list(map(int, grid.shape)), "origin": grid.origin, "spacing": grid.spacing,
        "notes": terrain.notes,
    }  # fmt: skip
    arrays = {name: getattr(terrain, name) for name in ARRAYS}
    if terrain.water.any():
        arrays["water"] = terrain.water
    if terrain.layer.size:
        arrays["layer"] = terrain.layer
    if len(terrain.tops):
        arrays |= {TOPS + name: values for name, values in terrain.tops.arrays().items()}
    return facts, arrays


def _unpacked(facts, arrays):
    """Return the terrain of an entry's facts and arrays."""
    grid = Grid(tuple(facts["shape"]), tuple(facts["origin"]), facts["spacing"])
    tops = {n.removeprefix(TOPS): arrays.pop(n) for n in list(arrays) if n.startswith(TOPS)}
    tops = Tops.from_arrays(tops) if tops else NO_TOPS
    return Terrain(grid, **arrays, notes=tuple(facts["notes"]), tops=tops)
