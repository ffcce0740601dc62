"""The public names as type checkers see them; at run time they load on first use."""

from rainsim.config.settings import Config as Config
from rainsim.config.settings import mm_per_hour as mm_per_hour
from rainsim.config.settings import preset_names as preset_names
from rainsim.errors import BackendError as BackendError
from rainsim.errors import DivergedError as DivergedError
from rainsim.errors import GroundError as GroundError
from rainsim.errors import InputError as InputError
from rainsim.errors import ParameterError as ParameterError
from rainsim.errors import RainsimError as RainsimError
from rainsim.grid import WaterReport as WaterReport
from rainsim.grid import WaterSolver as WaterSolver
from rainsim.io.images import read_image as read_image
from rainsim.io.images import write_png as write_png
from rainsim.pipeline import extract_terrain as extract_terrain
from rainsim.pipeline import render_rain as render_rain
from rainsim.render.aov import AOVS as AOVS
from rainsim.render.aov import recompose as recompose
from rainsim.render.renderer import Renderer as Renderer
from rainsim.render.report import FrameReport as FrameReport
from rainsim.scene.cameras import load_cameras as load_cameras
from rainsim.scene.cameras import look_at as look_at
from rainsim.scene.cameras import orbit as orbit
from rainsim.scene.cameras import resize_to as resize_to
from rainsim.scene.cameras import write_transforms as write_transforms
from rainsim.scene.library import list_scenes as list_scenes
from rainsim.scene.library import load_scene as load_scene
from rainsim.scene.types import Camera as Camera
from rainsim.scene.types import GroundFrame as GroundFrame
from rainsim.scene.types import Scene as Scene
from rainsim.scene.types import Splats as Splats
from rainsim.simulation import SimState as SimState
from rainsim.simulation import read_state as read_state
from rainsim.simulation import simulate as simulate
from rainsim.simulation import write_state as write_state
from rainsim.surface.offered_views import offered_cameras as offered_cameras
from rainsim.terrain.map_files import read_terrain as read_terrain
from rainsim.terrain.map_files import write_terrain as write_terrain
from rainsim.terrain.types import Grid as Grid
from rainsim.terrain.types import Terrain as Terrain
from rainsim.water.fill_spill_merge import standing_water as standing_water

__version__: str
