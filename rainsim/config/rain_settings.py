"""Settings of the rain: what falls, and what has fallen before the first frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rainsim.config.declare import LIGHT, WATER, Group, Key, Option, Slider, setting
from rainsim.config.rules import MM_PER_HOUR, OneOf, finite, not_negative, pair, whole
from rainsim.errors import ParameterError, require_finite, require_not_negative

MAX_RATE = 1000.0  # mm/h: the heaviest minutes ever measured stay below 2500, an hour below 400
MAX_WIND = 60.0  # m/s: beyond hurricane strength drops no longer fall as modelled
MAX_SEED = 2**32 - 1
TURNS = 1e4  # rad, of a direction; float32 no longer keeps more turns to a degree


def check_wind(name, value, unit):
    """Raise ParameterError unless `value` is a speed [m/s] and a direction [rad]."""
    speed, direction = pair(name, value, "a speed and a direction")
    require_not_negative("wind speed", speed, "m/s", "turn the direction instead")
    if speed > MAX_WIND:
        raise ParameterError(f"wind speed is {speed} m/s; it must be at most {MAX_WIND:g} m/s")
    require_finite("wind direction", direction)
    finite(low=-TURNS, high=TURNS)(name, direction, unit)


@dataclass(frozen=True)
class RainConfig(Group):
    """What falls, and what has fallen before the first frame."""

    # fmt: off
    rate: float = setting(
        10.0 * MM_PER_HOUR, "rain_mm_per_hour", "mm/h",
        "rain rate, as a gauge on level ground collects it",
        not_negative("0 is no rain, 50 a downpour", label="rain", high=MAX_RATE,
                     most=f"{MAX_RATE:g}; 50 is a downpour"),
        option=Option("rain", "MM/H"), slider=Slider("Rain", "rain", 0, 150, 0.5),
        changing=True, touches=(WATER, LIGHT))
    past: float = setting(
        3e-3, "past_rain_mm", "mm",
        "rain that fell before the first frame and stands at rest in puddles",
        not_negative("0 leaves no puddles", label="past rain", high=1000.0,
                     most="1000; for a flood give a water level"),  # above most records of a day
        option=Option("past_rain", "MM"), slider=Slider("Rain", "past rain", 0, 50, 0.5),
        changing=True, touches=(WATER, LIGHT))
    drying: float = setting(
        0.0, "drying_hours", "h",
        "time since the past rain ended: first the gloss dries, then the darkening; puddles shrink",
        not_negative("0 is still wet from the rain", high=1e4),
        option=Option("drying", "HOURS"), slider=Slider("Rain", "drying", 0, 24, 0.25),
        changing=True, touches=(WATER, LIGHT))
    puddles: float = setting(
        1.0, "puddles", "", "factor on the past rain that stands in the ground's dips, 0 to 2",
        not_negative("1 is as it rained, 0 leaves none", high=2.0),
        option=Option("puddles", "0..2"), slider=Slider("Rain", "puddles", 0, 2, 0.05),
        touches=(WATER,))
    wind: tuple = setting(  # the way goes from x towards y
        (0.0, 0.0), rule=check_wind, keys=(
            Key("wind_speed_m_per_s", "m/s", "wind at a height of 10 m",
                Slider("Rain", "wind", 0, 20, 0.5), 0.0),
            Key("wind_direction_degrees", "degrees", "the way the air goes, from the first "
                "camera's view, counter-clockwise seen from above",
                Slider("Rain", "wind direction", -180, 180, 5), 0.0),
        ),
        option=Option("wind", "SPEED,DIRECTION", help=
                      "wind in m/s at 10 m height, and the direction in which the air moves, in "
                      "degrees from the first camera's view, counter-clockwise seen from above"),
        changing=True, touches=(WATER, LIGHT))
    roughness: float = setting(
        0.03, "wind_roughness_m", "m",
        "roughness length of the land around; 0.03 is grass, 0 one wind at all heights",
        not_negative("0.03 is grass", label="roughness length", high=2.0,
                     most="2 m, that of a city centre"),  # Davenport's roughest class
        touches=(WATER, LIGHT), kept_for="land that is no grass slows the wind (docs/rain.md)")
    gusts: float = setting(
        0.0, "gusts", "", "standard deviation of the wind's speed over its mean, 0 to 0.5",
        not_negative("0.3 is a gusty wind", high=0.5, most="0.5"),  # beyond, the wind turns around
        slider=Slider("Rain", "gusts", 0, 0.5, 0.05), touches=(WATER,))
    drips: bool = setting(
        True, "drips", "", "whether rain on objects drips from their edges", OneOf(True, False),
        touches=(WATER,), kept_for="water that stays on its object (docs/rain.md)")
    drop_radii: str = setting(
        "measured", "drop_radii", "", "sizes of drops: measured is Marshall and Palmer's "
        "distribution, paper one exponential for all rates",
        OneOf("measured", "paper"), touches=(WATER,), paper="paper")
    seed: int = setting(
        0, "seed", "", "number of the random drops; another number gives other drops",
        whole(0, MAX_SEED), option=Option("seed"), touches=(WATER,))
    # fmt: on

    @property
    def wind_velocity(self):
        """Horizontal wind at 10 m (x, y) in the ground frame [m/s]."""
        speed, direction = self.wind
        return speed * math.cos(direction), speed * math.sin(direction)
