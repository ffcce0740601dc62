"""The weather of a frame as plain values, for label files and the card of a data set."""

import math

from rainsim.config.settings import MM_PER_HOUR
from rainsim.particles.fog import fog_extinction
from rainsim.rain.size_distribution import LARGEST, SMALLEST
from rainsim.shading.wetness import paving_dampness

LEAST_CONTRAST = 0.05  # that the meteorological optical range is defined by (WMO-No. 8, 9.1)


def weather_of(now, field=None):
    """Return rain, wind, visibility, light and shutter of a moment as plain JSON values.

    now : Config. Of that time, see `Config.at`.
    field : RainField or None. The drops of that time; None without rain.

    The extinction is what pictures show, Q = 1 (see `rainsim.particles.fog`); the optical range
    follows from it as -ln 0.05 over the extinction, the definition of the World Meteorological
    Organization.
    """
    rain, render = now.rain, now.render
    wind_x, wind_y = rain.wind_velocity
    found = {
        "rain_mm_per_hour": round(rain.rate / MM_PER_HOUR, 6),
        "past_rain_mm": round(rain.past * 1e3, 6),
        "drying_hours": rain.drying / 3600,
        "water_level_m": now.water.level,
        "wind_m_per_s": [round(wind_x, 6), round(wind_y, 6)],
        "gusts": rain.gusts,
        "seed": rain.seed,
        "wetness_of_paving": round(paving_dampness(now), 4),
        "exposure_s": render.exposure,
        "cloudiness": render.cloudiness,
        "sun_degrees": sun_degrees(render.sun),
        "extinction_per_m": 0.0,
        "optical_range_m": None,
        "drops": None,
    }
    if field is not None:
        spectrum = field.spectrum
        _, extinction = fog_extinction(field)
        found["extinction_per_m"] = float(f"{extinction:.5g}")
        if extinction > 0:
            found["optical_range_m"] = round(-math.log(LEAST_CONTRAST) / extinction, 1)
        found["drops"] = {
            "law": spectrum.law.text,
            "radii": spectrum.radii,
            "decay_per_m": float(f"{spectrum.decay:.6g}"),
            "intercept_per_m4": float(f"{spectrum.intercept:.6g}"),
            "tracked_from_m": SMALLEST,
            "tracked_to_m": LARGEST,
        }
    return found


def sun_degrees(sun):
    """Return the sun of the settings for people: azimuth and elevation [degrees], text or None."""
    if sun is None or isinstance(sun, str):
        return sun
    return [round(math.degrees(angle), 4) for angle in sun]
