"""Terrain from splats: the ground and its classes, and the objects that stand on it or overhang."""

_PUBLIC = {
    "bed": ("inpaint", "local_noise"),
    "classify": ("read_mask",),
    "extract": ("extract_terrain",),
    "map_files": ("read_terrain", "write_terrain"),
    "map_size": ("choose_grid",),
    "pictures": ("hillshade",),
    "surface": ("is_surface", "terrain_from_heights", "terrain_from_surface"),
    "table": ("GRASS", "HARD", "OBJECT", "SOIL", "WATER", "class_table"),
    "types": ("GAP_HEIGHT", "INFERRED", "MEASURED", "UNKNOWN", "Grid", "Terrain"),
}
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}
__all__ = sorted(_HOME)


def __getattr__(name):
    # Loaded on first use: the cache key of every kernel takes in the `__init__` of its packages.
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(f"rainsim.terrain.{_HOME[name]}"), name)
    raise AttributeError(f"module 'rainsim.terrain' has no attribute {name!r}")
