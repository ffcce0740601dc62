"""Terrain from splats: the ground, what stands on it or hangs over it, and what it is made of."""

from rainsim.terrain.bed import inpaint, local_noise
from rainsim.terrain.choose import choose_grid
from rainsim.terrain.classify import read_mask
from rainsim.terrain.extract import extract_terrain
from rainsim.terrain.files import hillshade, read_terrain, write_terrain
from rainsim.terrain.surface import is_surface, terrain_from_heights, terrain_from_surface
from rainsim.terrain.table import GRASS, HARD, OBJECT, SOIL, WATER, class_table
from rainsim.terrain.types import GAP_HEIGHT, INFERRED, MEASURED, UNKNOWN, Grid, Terrain

__all__ = [
    "GAP_HEIGHT",
    "GRASS",
    "HARD",
    "INFERRED",
    "MEASURED",
    "OBJECT",
    "SOIL",
    "UNKNOWN",
    "WATER",
    "Grid",
    "Terrain",
    "choose_grid",
    "class_table",
    "extract_terrain",
    "hillshade",
    "inpaint",
    "is_surface",
    "local_noise",
    "read_mask",
    "read_terrain",
    "terrain_from_heights",
    "terrain_from_surface",
    "write_terrain",
]
