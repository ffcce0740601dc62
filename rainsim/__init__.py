"""Physically right, good-looking rain in captured 3D Gaussian Splatting scenes."""

__version__ = "1.0.0"

# The public names by subject, each with the module that has it. Deprecation rules hold for these.
_MODULES = {
    "Scenes": {
        "load_scene": "rainsim.scene.library",
        "list_scenes": "rainsim.scene.library",
        "Scene": "rainsim.scene.types",
        "Splats": "rainsim.scene.types",
        "GroundFrame": "rainsim.scene.types",
    },
    "Cameras": {
        "Camera": "rainsim.scene.types",
        "look_at": "rainsim.scene.cameras",
        "orbit": "rainsim.scene.cameras",
        "offered_cameras": "rainsim.surface.offered_views",
        "resize_to": "rainsim.scene.cameras",
        "load_cameras": "rainsim.scene.cameras",
        "write_transforms": "rainsim.scene.cameras",
    },
    "Settings": {
        "Config": "rainsim.config.settings",
        "preset_names": "rainsim.config.settings",
        "mm_per_hour": "rainsim.config.settings",
    },
    "From capture to frames": {
        "render_rain": "rainsim.pipeline",
        "extract_terrain": "rainsim.pipeline",
        "simulate": "rainsim.simulation",
        "Renderer": "rainsim.render.renderer",
        "Optics": "rainsim.sensors.optics",
        "Lens": "rainsim.sensors.lens",
        "Pane": "rainsim.sensors.glass",
        "FrameReport": "rainsim.render.report",
    },
    "Ground and water": {
        "Terrain": "rainsim.terrain.types",
        "Grid": "rainsim.terrain.types",
        "read_terrain": "rainsim.terrain.map_files",
        "write_terrain": "rainsim.terrain.map_files",
        "SimState": "rainsim.io.states",
        "read_state": "rainsim.io.states",
        "write_state": "rainsim.io.states",
        "WaterSolver": "rainsim.grid",
        "GpuWaterSolver": "rainsim.cuda.grid",
        "WaterReport": "rainsim.water.water_report",
        "Stage": "rainsim.water.conditions",
        "Discharge": "rainsim.water.conditions",
        "Rating": "rainsim.water.conditions",
        "Series": "rainsim.water.series",
        "read_series": "rainsim.water.series",
        "Gauges": "rainsim.water.gauges",
        "standing_water": "rainsim.water.fill_spill_merge",
    },
    "Pictures": {
        "AOVS": "rainsim.render.aov",
        "recompose": "rainsim.render.aov",
        "read_image": "rainsim.io.images",
        "write_png": "rainsim.io.images",
    },
    "Errors": {
        "RainsimError": "rainsim.errors",
        "ParameterError": "rainsim.errors",
        "InputError": "rainsim.errors",
        "GroundError": "rainsim.errors",
        "BackendError": "rainsim.errors",
        "DivergedError": "rainsim.errors",
    },
}
_PUBLIC = {name: where for names in _MODULES.values() for name, where in names.items()}
__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name):
    # Public names load on first use, so that `rainsim --help` never imports numba.
    if name in _PUBLIC:
        from importlib import import_module

        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'rainsim' has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
