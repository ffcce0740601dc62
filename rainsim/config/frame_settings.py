"""Settings of the frames of a run: how many, how fast, how large."""

from __future__ import annotations

from dataclasses import dataclass

from rainsim.config.declare import LIGHT, WATER, Group, Option, setting
from rainsim.config.rules import positive, whole

MIN_SIDE, MAX_SIDE = 8, 16384  # px
MAX_FRAMES = 99_999  # what the five digits of a frame's file name hold


@dataclass(frozen=True)
class FrameConfig(Group):
    """The frames of a run."""

    # fmt: off
    frames: int = setting(
        24, "frames", "", "number of frames", whole(1, MAX_FRAMES),
        option=Option("frames", None, "the preset's, or the path's length"), touches=())
    fps: float = setting(
        24.0, "fps", "frames/s", "rate of the frames",
        positive("24 is usual", low=0.1, high=9999.0),
        option=Option("fps"), touches=(WATER,))
    width: int | None = setting(  # None: the camera's own
        648, "width", "px", "width of the frames", whole(MIN_SIDE, MAX_SIDE),
        option=Option("width", "PX", "648, or as --height asks", "picture"), touches=())
    height: int | None = setting(
        None, "height", "px", "height of the frames; with a width too the picture is cropped, "
        "without a height it follows from the camera's shape", whole(MIN_SIDE, MAX_SIDE),
        option=Option("height", "PX", "the camera's shape", "picture"), touches=())
    # fmt: on
    frame_range: tuple | None = setting(None, touches=())  # (first, end), end excluded; None: all
    threads: int | None = setting(None, rule=whole(1, 4096), touches=())  # None: all cores
    # What changes in time, see `rainsim.config.timeline`.
    keyframes: tuple = setting((), touches=(WATER, LIGHT))
    # Number of the water's state that each frame shows; (): its own number.
    moments: tuple = setting((), touches=())
