"""The terrain of a scene from the results of an earlier run, or extracted and kept for the next."""

from rainsim.io import cache
from rainsim.io.allocator import trim
from rainsim.terrain.types import Terrain

KIND = "terrain"


def kept_terrain(scene, config, mask=None, tell=None):
    """Return the result of `extract_terrain`, to the byte; the parameters are the same.

    The kept entry is named by the splats' content, the ground frame, the cameras, the drains, the
    painted classes, the settings of the terrain and the mask; see `rainsim.io.cache`.
    """

    def extracted():
        from rainsim.terrain.extract import extract_terrain  # not needed for a kept terrain

        arrays = extract_terrain(scene, config, mask, tell).arrays()
        trim()  # half of the memory that surface and ground were found in
        return arrays

    found = cache.kept_arrays(KIND, extracted, *inputs_of(scene, config, mask))
    return Terrain.from_arrays(found)


def inputs_of(scene, config, mask=None):
    """Return all that a terrain depends on, see `rainsim.io.cache.name_of`."""
    places = scene.splats, scene.ground_frame, scene.cameras, scene.drains
    return *places, scene.painted, config, mask
