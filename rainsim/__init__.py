"""Physically right, good-looking rain in captured 3D Gaussian Splatting scenes."""

__version__ = "0.1.0"

_PUBLIC = {
    "render_rain": "rainsim.pipeline",
    "Config": "rainsim.config.settings",
    "load_scene": "rainsim.scene.library",
    "Scene": "rainsim.scene.types",
    "Splats": "rainsim.scene.types",
    "Camera": "rainsim.scene.types",
    "GroundFrame": "rainsim.scene.types",
    "WaterSolver": "rainsim.grid",
}
__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name):
    # Public names load on first use, so that `rainsim --help` never imports numba.
    if name in _PUBLIC:
        from importlib import import_module

        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'rainsim' has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
