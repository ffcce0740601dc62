"""How wet things are: water films fill first and dry first, then the pores of the ground.

Open level ground is wet through when the rain of the past has filled the water film that its class
holds (`storage` in classes.toml), or while it rains at WET_RATE. After the rain, evaporation takes
the film first, which ends the gloss, and then the water in the pores, which ends the darkening.
"""

from typing import NamedTuple

import numpy as np

from rainsim.constants import ONE
from rainsim.jit import inlined_function
from rainsim.rain.size_distribution import terminal_speed

WET_RATE = 2.0 / 3.6e6  # m/s of rain that keeps level ground wet whatever fell before
LEAST_FILM = 0.2e-3  # m, storage of ground whose class stores less
OTHER_FILM, OTHER_POROSITY = 0.3e-3, 0.2  # m; of walls and things: brick has 0.2 to 0.35
PORE_DEPTH = 0.010  # m of ground whose pores show their water as darkening; a guess
# Evaporation from wet ground [m/s], dull and clear: 0.1 and 0.6 mm/h, a wet day's and the noon
# value of Penman's open water in a temperate summer (Shuttleworth 1993, Handbook of Hydrology 4).
DULL_EVAPORATION, CLEAR_EVAPORATION = 0.1e-3 / 3600, 0.6e-3 / 3600
SPRAY = 0.15  # share of the rain that splashes and drift bring to sheltered ground
USUAL_DROP = 1.5e-3  # m, whose slant decides how much rain a wall catches
ROWS = 128  # of a map that are worked on at once


class Wetness(NamedTuple):
    """How wet a surface is; channels of the ground's map and rows of a chunk have this order."""

    lawn: np.float32  # share of grass, 0 to 1
    dampness: np.float32  # 0 dry to 1 wet through
    film: np.float32  # share of a full water film that glosses, 0 to 1
    porosity: np.float32  # 0 to 1


@inlined_function
def wetness_in(maps, j, i, k, m, a, b):
    """Return the `Wetness` between rows j and k, columns i and m of a map, by shares b and a."""
    w0, w1, w2, w3 = (ONE - a) * (ONE - b), a * (ONE - b), (ONE - a) * b, a * b
    return Wetness(
        maps[j, i, 0] * w0 + maps[j, m, 0] * w1 + maps[k, i, 0] * w2 + maps[k, m, 0] * w3,
        maps[j, i, 1] * w0 + maps[j, m, 1] * w1 + maps[k, i, 1] * w2 + maps[k, m, 1] * w3,
        maps[j, i, 2] * w0 + maps[j, m, 2] * w1 + maps[k, i, 2] * w2 + maps[k, m, 2] * w3,
        maps[j, i, 3] * w0 + maps[j, m, 3] * w1 + maps[k, i, 3] * w2 + maps[k, m, 3] * w3,
    )


@inlined_function
def store_wetness(wet, s, at, step):
    """Write a `Wetness` to every `step`-th number of `s` from `at` on."""
    s[at], s[at + step] = wet.lawn, wet.dampness
    s[at + 2 * step], s[at + 3 * step] = wet.film, wet.porosity


@inlined_function
def stored_wetness(s, at, step):
    """Return the `Wetness` that `store_wetness` wrote."""
    return Wetness(s[at], s[at + step], s[at + 2 * step], s[at + 3 * step])


class OffGroundWetness(NamedTuple):
    """Wetness of walls and things, which are on no map; see `damp_off_ground`. Each a float32."""

    supply: np.float32  # rain that a level surface has got, in full films of it
    slant_x: np.float32  # m that the rain goes sideways per m of fall
    slant_y: np.float32
    film_left: np.float32  # share of the film that evaporation has left
    porosity: np.float32


def evaporation_rate(config):
    """Return the rate [m/s] at which wet ground dries under the sky of the settings."""
    cloudiness = config.render.cloudiness
    return CLEAR_EVAPORATION + (DULL_EVAPORATION - CLEAR_EVAPORATION) * cloudiness


def dampness(config, film, porosity, reach=1.0):
    """Return how wet a level surface looks, 0 dry to 1 wet through.

    config : Config. Of one time.
    film : float or ndarray [m]. Depth of the water film that the surface holds.
    porosity : float or ndarray
    reach : float or ndarray. Share of the rain that reaches it.
    """
    film = np.maximum(film, LEAST_FILM)
    reach = SPRAY + (1 - SPRAY) * np.asarray(reach)
    rain = config.rain
    wet = np.minimum(1.0, (rain.past / film + rain.rate / WET_RATE) * reach)
    if config.water.level is not None:
        wet = np.maximum(wet, 1.0)
    lost = evaporation_rate(config) * rain.drying
    held = np.minimum(film, rain.past * reach)
    pores = np.maximum(np.asarray(porosity) * PORE_DEPTH, 1e-6)
    return wet * np.clip(1 - np.maximum(lost - held, 0) / pores, 0, 1)


def film_left(config, film):
    """Return the share of a water film [m] that evaporation has left; 1 while it rains."""
    lost = evaporation_rate(config) * config.rain.drying
    return np.clip(1 - lost / np.maximum(film, LEAST_FILM), 0, 1)


def ground_wetness(terrain, grass, reach, config):
    """Return how wet each ground cell is, (ny, nx, 4) float32: the fields of `Wetness`.

    grass : float32 array (ny, nx). Share of grass.
    reach : float32 array (ny, nx). Share of the rain that reaches the ground.
    config : Config. Of one time.
    """
    found = np.empty((*reach.shape, len(Wetness._fields)), np.float32)
    for first in range(0, len(reach), ROWS):  # by parts, for memory
        part = slice(first, first + ROWS)
        film, porosity = (terrain.by_class(name, part) for name in ("storage", "porosity"))
        damp = dampness(config, film, porosity, reach[part]) * (config.render.wetting != "none")
        gloss = damp * film_left(config, film) * (1 - 0.5 * porosity)
        wet = Wetness(lawn=grass[part], dampness=damp, film=gloss, porosity=porosity)
        for n, values in enumerate(wet):
            found[part, :, n] = values
    return found


def thin_film(ground_out, tracks):
    """Thin the film of ground cells where tyres have passed, in place; the pores stay wet.

    ground_out : float32 array (ny, nx, 4). See `ground_wetness`.
    tracks : uint8 array (ny, nx). How full the film is, of 255.
    Returns slice. Rows that have changed; tyres touch few rows of a map.
    """
    thinned = np.flatnonzero(tracks.min(axis=1) < 255)
    rows = slice(thinned[0], thinned[-1] + 1) if thinned.size else slice(0, 0)
    film = ground_out[rows, :, Wetness._fields.index("film")]
    film *= tracks[rows].astype(np.float32) / np.float32(255)
    return rows


def off_ground_wetness(config):
    """Return the `OffGroundWetness` of the settings of one time."""
    supply = config.rain.past / OTHER_FILM + config.rain.rate / WET_RATE
    lost = evaporation_rate(config) * config.rain.drying
    pores = OTHER_POROSITY * PORE_DEPTH
    supply *= float(np.clip(1 - max(lost - OTHER_FILM, 0.0) / pores, 0, 1))
    if config.render.wetting == "none":
        supply = 0.0
    x, y = config.rain.wind_velocity
    fall = float(terminal_speed(USUAL_DROP))
    left = float(film_left(config, OTHER_FILM))
    numbers = supply, x / fall, y / fall, left, OTHER_POROSITY
    return OffGroundWetness(*(np.float32(n) for n in numbers))


def paving_dampness(config):
    """Return how wet open paving is, 0 to 1."""
    return float(dampness(config, OTHER_FILM, OTHER_POROSITY))
