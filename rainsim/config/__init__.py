"""Settings: presets, timelines, ground classes, and the files that hold them."""

_PUBLIC = {"Config": "rainsim.config.settings", "preset_names": "rainsim.config.settings"}
__all__ = list(_PUBLIC)


def __getattr__(name):
    # Loaded on first use: the cache key of every kernel takes in the `__init__` of its packages.
    if name in _PUBLIC:
        from importlib import import_module

        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'rainsim.config' has no attribute {name!r}")
