"""Settings of the ground's height map and of the water on it."""

from __future__ import annotations

from dataclasses import dataclass

from rainsim.config.declare import LIGHT, WATER, Group, Option, Slider, setting
from rainsim.config.rules import OneOf, finite, not_negative, positive
from rainsim.errors import ParameterError


@dataclass(frozen=True)
class TerrainConfig(Group):
    """The height map below the scene."""

    # fmt: off
    spacing: float | None = setting(
        None, "terrain_spacing_m", "m", "cell size of the height map; without it chosen",
        positive("0.02 is usual", label="terrain spacing", low=1e-3, high=0.5, most="0.5 m"),
        option=Option("spacing", "M", "about 0.02, chosen"))
    extent: float | None = setting(
        None, "terrain_extent_m", "m", "half the width of the height map; without it chosen",
        positive("leave it out to have it chosen", label="terrain extent", low=1e-3, high=1e5),
        option=Option("extent", "M", "chosen from the cameras"))
    ground_map: str = setting(
        "auto", "ground_map", "",
        "whole is one height map for all frames; path, a few legs of fine cells along the "
        "frames' cameras, each with water of its own; auto takes path for several cameras near the "
        "ground that range so far that one map would have cells of more than 2.5 cm",
        OneOf("auto", "whole", "path"),
        option=Option("ground_map", "auto|whole|path", panel="ground_map"))
    # fmt: on

    def check(self):
        """Raise ParameterError if a value breaks its rule."""
        super().check()
        least = 4 * (self.spacing or 0.005)
        if self.extent is not None and self.extent < least:
            raise ParameterError(
                f"terrain extent is {self.extent} m; it must be at least {least:g} m, 4 cells; "
                "make it larger"
            )


@dataclass(frozen=True)
class WaterConfig(Group):
    """Water on the ground."""

    # fmt: off
    scheme: str = setting(
        "auto", "water_scheme", "",
        "how the flow is computed: accurate, of second order; lean, of first order in less than "
        "half the time; paper, as the RainyGS paper does; auto takes accurate on a CPU and lean, "
        "the only one there, on a GPU, and the run says which",
        OneOf("auto", "accurate", "lean", "paper", remedy="auto chooses by itself",
              label="water scheme"),
        option=Option("water_scheme", "NAME"), touches=(WATER,))
    level: float | None = setting(
        None, "water_level_m", "m",
        "level of still water above the low ground (the 5th percentile of its heights); without it "
        "there is no flood",
        finite("give metres, or leave it out for no flood", label="water level", low=-1e3,
               high=1e3),
        option=Option("water_level", "M"), slider=Slider("Flood", "water level", -0.2, 1, 0.01),
        changing=True, touches=(WATER, LIGHT))
    surface_film: float = setting(
        1.0, "surface_film", "", "dirt on the water that damps ripples, 0 clean to 1 full",
        not_negative("0 is clean, 1 street dirt", label="surface film", high=1.0, most="1"),
        touches=(WATER,), kept_for="clean water, on which rings were measured (docs/rain.md)")
    courant: float | None = setting(
        None, "courant", "", "Courant number of the flow, the share of the largest stable time "
        "step; without it the scheme chooses",
        positive("leave it out for the scheme's own", low=1e-3, high=1.0, most="1"),
        touches=(WATER,), kept_for="the remedy that the error of a flow that diverges names")
    # fmt: on
