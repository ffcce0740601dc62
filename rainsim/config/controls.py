"""What a person turns: the settings with their options, units, labels and usual ranges.

One table for the command line, which takes units from it, and for the page of `rainsim view`.
"""

from __future__ import annotations

from dataclasses import dataclass

from rainsim.config.preset_files import HUMAN_KEYS

# Option of the command line, without its dashes: the preset keys that it sets, in its units.
OPTION_KEYS = {
    "rain": ("rain_mm_per_hour",),
    "past_rain": ("past_rain_mm",),
    "drying": ("drying_hours",),
    "puddles": ("puddles",),
    "wind": ("wind_speed_m_per_s", "wind_direction_degrees"),
    "water_level": ("water_level_m",),
    "water_scheme": ("water_scheme",),
    "seed": ("seed",),
    "frames": ("frames",),
    "fps": ("fps",),
    "exposure": ("exposure_ms",),
    "sky": ("sky",),
    "sun": ("sun_azimuth_degrees", "sun_elevation_degrees"),
    "cloudiness": ("cloudiness",),
    "relight": ("relight",),
    "reflections": ("reflections",),
    "brightness": ("brightness",),
    "metering": ("metering",),
    "exposure_bias": ("exposure_bias_ev",),
    "wetness": ("wetness",),
    "ripples": ("ripples",),
    "ground_albedo": ("ground_albedo",),
    "merge": ("merge_px",),
    "detail": ("detail_px",),
    "memory": ("memory_gb",),
    "width": ("width",),
    "height": ("height",),
    "spacing": ("terrain_spacing_m",),
    "extent": ("terrain_extent_m",),
    "ground_map": ("ground_map",),
}
SUN_WORDS = {"none": None, "sky": "sky"}  # of --sun, in place of angles


@dataclass(frozen=True)
class Slider:
    """A number that is turned on the page, in the units of its preset key.

    Attributes
    ----------
    key : str
        Of `HUMAN_KEYS`.
    group : str
        Folder of the page.
    label : str
        With the unit.
    low, high : float
        The usual range, within what the rule of the setting allows.
    step : float
    """

    key: str
    group: str
    label: str
    low: float
    high: float
    step: float


SLIDERS = (
    Slider("rain_mm_per_hour", "Rain", "rain [mm/h]", 0, 150, 0.5),
    Slider("past_rain_mm", "Rain", "past rain [mm]", 0, 50, 0.5),
    Slider("drying_hours", "Rain", "drying [h]", 0, 24, 0.25),
    Slider("puddles", "Rain", "puddles", 0, 2, 0.05),
    Slider("wetness", "Rain", "wetness", 0, 2, 0.05),
    Slider("ripples", "Rain", "ripples", 0, 2, 0.05),
    Slider("wind_speed_m_per_s", "Rain", "wind [m/s]", 0, 20, 0.5),
    Slider("wind_direction_degrees", "Rain", "wind direction [deg]", -180, 180, 5),
    Slider("gusts", "Rain", "gusts", 0, 0.5, 0.05),
    Slider("water_level_m", "Flood", "water level [m]", -0.2, 1, 0.01),
    Slider("cloudiness", "Light", "cloudiness", 0, 1, 0.05),
    Slider("sun_azimuth_degrees", "Light", "sun azimuth [deg]", -180, 180, 5),
    Slider("sun_elevation_degrees", "Light", "sun elevation [deg]", 0, 90, 1),
    Slider("brightness", "Light", "brightness", 0.25, 4, 0.05),
    Slider("exposure_bias_ev", "Light", "exposure bias [EV]", -2, 2, 0.1),
    Slider("exposure_ms", "Camera", "shutter [ms]", 0.5, 40, 0.5),
    Slider("aperture_mm", "Camera", "aperture [mm]", 0, 30, 0.5),
    Slider("focus_m", "Camera", "focus [m]", 0.2, 20, 0.1),
)


def si_value(key, number):
    """Return the SI value of one preset key's number."""
    unit = HUMAN_KEYS[key][1]
    return number if unit is None else number * unit
