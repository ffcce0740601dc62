"""How wet things are: films fill while it rains, pores after them, and dry in the other order.

Open level ground is wet through when the rain of the past has filled the film that its class holds
(`storage` in classes.toml), or while rain enough falls. After the rain, evaporation takes the film
first, which ends the gloss, and then what the pores of the surface hold, which ends the darkening.
"""

from __future__ import annotations

import numpy as np

from rainsim.spectrum import terminal_speed

WET_RATE = 2.0 / 3.6e6  # m/s of rain that keeps level ground wet whatever fell before
LEAST_FILM = 0.2e-3  # m; ground of no storage is wet through with so much
OTHER_FILM, OTHER_POROSITY = 0.3e-3, 0.10  # m, of walls and things, whose class nobody knows
PORE_DEPTH = 0.010  # m of ground whose pores show their water as darkening; a guess
# Evaporation from wet ground [m/s], dull and clear: 0.1 and 0.6 mm/h, a wet day's and the noon
# value of Penman's open water in a temperate summer (Shuttleworth 1993, Handbook of Hydrology 4).
DULL_EVAPORATION, CLEAR_EVAPORATION = 0.1e-3 / 3600, 0.6e-3 / 3600
SPRAY = 0.15  # share of the rain that splashes and drift bring to sheltered ground
USUAL_DROP = 1.5e-3  # m, whose slant tells how much rain a wall catches


def evaporation_rate(config):
    """Return the rate [m/s] at which wet ground dries under the sky of the settings."""
    cloudiness = config.render.cloudiness
    return CLEAR_EVAPORATION + (DULL_EVAPORATION - CLEAR_EVAPORATION) * cloudiness


def dampness(config, film, porosity, reach=1.0):
    """Return how wet a level surface looks, 0 dry to 1 wet through.

    Parameters
    ----------
    config : Config
        Of one time.
    film : float or ndarray [m]
        Water that the surface holds as a film.
    porosity : float or ndarray
    reach : float or ndarray
        Share of the rain that reaches it.
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
    """Return the share of the film that evaporation has left: 1 while it rains."""
    lost = evaporation_rate(config) * config.rain.drying
    return np.clip(1 - lost / np.maximum(film, LEAST_FILM), 0, 1)


def ground_maps(terrain, grass, reach, config):
    """Return lawn, rain, dampness, gloss and porosity of each ground cell, (ny, nx, 5) float32.

    Parameters
    ----------
    terrain : Terrain
    grass : ndarray of shape (ny, nx), float32
        Share of grass.
    reach : ndarray of shape (ny, nx), float32
        Share of the rain that reaches the ground.
    config : Config
        Of one time.
    """
    film, porosity = terrain.by_class("storage"), terrain.by_class("porosity")
    damp = dampness(config, film, porosity, reach) * (config.render.wetting != "none")
    gloss = damp * film_left(config, film) * (1 - 0.5 * porosity)
    maps = np.stack([grass, reach, damp, gloss, porosity], axis=-1)
    return np.ascontiguousarray(maps, dtype=np.float32)


def others(config):
    """Return what wets that which is no mapped ground, float32 (5,).

    Films of rain that a level surface has got (more than 1 is plenty), the slant of the rain
    (metres sideways per metre of fall, x and y), share of the film left, and porosity.
    """
    supply = config.rain.past / OTHER_FILM + config.rain.rate / WET_RATE
    lost = evaporation_rate(config) * config.rain.drying
    pores = OTHER_POROSITY * PORE_DEPTH
    supply *= float(np.clip(1 - max(lost - OTHER_FILM, 0.0) / pores, 0, 1))
    if config.render.wetting == "none":
        supply = 0.0
    x, y = config.rain.wind_velocity
    fall = float(terminal_speed(USUAL_DROP))
    left = float(film_left(config, OTHER_FILM))
    return np.array([supply, x / fall, y / fall, left, OTHER_POROSITY], np.float32)


def overall(config):
    """Return how wet open paving is, 0 to 1."""
    return float(dampness(config, OTHER_FILM, OTHER_POROSITY))
