"""The public names by subject; `rainsim/__init__.py` reads this file and loads them on first use.

Type checkers read it, too. Deprecation rules hold for these names.
"""

# ruff: noqa: I001

__version__: str

# Scenes
from rainsim.scene.library import load_scene as load_scene
from rainsim.scene.library import list_scenes as list_scenes
from rainsim.scene.types import Scene as Scene
from rainsim.scene.types import Splats as Splats
from rainsim.scene.types import GroundFrame as GroundFrame

# Cameras
from rainsim.scene.types import Camera as Camera
from rainsim.scene.cameras import look_at as look_at
from rainsim.scene.cameras import orbit as orbit
from rainsim.surface.offered_views import offered_cameras as offered_cameras
from rainsim.scene.cameras import resize_to as resize_to
from rainsim.scene.cameras import load_cameras as load_cameras
from rainsim.scene.cameras import write_transforms as write_transforms

# Settings
from rainsim.config.settings import Config as Config
from rainsim.config.settings import preset_names as preset_names
from rainsim.config.settings import mm_per_hour as mm_per_hour

# From capture to frames
from rainsim.pipeline import render_rain as render_rain
from rainsim.pipeline import extract_terrain as extract_terrain
from rainsim.simulation import simulate as simulate
from rainsim.render.renderer import Renderer as Renderer
from rainsim.sensors.optics import Optics as Optics
from rainsim.sensors.lens import Lens as Lens
from rainsim.sensors.glass import Pane as Pane
from rainsim.render.report import FrameReport as FrameReport

# Ground and water
from rainsim.terrain.types import Terrain as Terrain
from rainsim.terrain.types import Grid as Grid
from rainsim.terrain.map_files import read_terrain as read_terrain
from rainsim.terrain.map_files import write_terrain as write_terrain
from rainsim.io.states import SimState as SimState
from rainsim.io.states import read_state as read_state
from rainsim.io.states import write_state as write_state
from rainsim.grid import WaterSolver as WaterSolver
from rainsim.cuda.grid import GpuWaterSolver as GpuWaterSolver
from rainsim.water.water_report import WaterReport as WaterReport
from rainsim.water.conditions import Stage as Stage
from rainsim.water.conditions import Discharge as Discharge
from rainsim.water.conditions import Rating as Rating
from rainsim.water.series import Series as Series
from rainsim.water.series import read_series as read_series
from rainsim.water.gauges import Gauges as Gauges
from rainsim.water.fill_spill_merge import standing_water as standing_water

# Pictures
from rainsim.render.aov import AOVS as AOVS
from rainsim.render.aov import recompose as recompose
from rainsim.io.images import read_image as read_image
from rainsim.io.images import write_png as write_png

# Errors
from rainsim.errors import RainsimError as RainsimError
from rainsim.errors import ParameterError as ParameterError
from rainsim.errors import InputError as InputError
from rainsim.errors import GroundError as GroundError
from rainsim.errors import BackendError as BackendError
from rainsim.errors import DivergedError as DivergedError
