"""The report of a drawn frame, and the clock of its stages."""

import time as clock
from dataclasses import dataclass, field


@dataclass(frozen=True)
class FrameReport:
    """Report of a drawn frame: times, volumes of water, notes, layers, light and facts.

    Attributes
    ----------
    index : int
    time : float [s]
    milliseconds : dict of str to float
        Wall time of each stage.
    ledger : dict
        Water volumes [m3] and their relative residual.
    notes : tuple of str
    aovs : dict of str to ndarray
        The AOVs that were asked for, see `rainsim.render.aov`.
    light : dict
        What `aov.recompose` needs besides: radiances and the brightness.
    facts : dict
        The frame's weather, names of classes, boxes: see `layers.facts_of`.
    exr : ExrFormat or None
        How its layers are written as one OpenEXR file, too.
    parts : dict or None
        The parts of that file with light, where they are not those of the layers.

    Examples
    --------
    >>> picture, report = next(rainsim.render_rain(scene, scene.cameras[:1], config))
    >>> report.index, report.time, "initial" in report.ledger
    (0, 0.0, True)
    """

    index: int
    time: float
    milliseconds: dict
    ledger: dict
    notes: tuple = ()
    aovs: dict = field(default_factory=dict)
    light: dict = field(default_factory=dict)
    facts: dict = field(default_factory=dict)
    exr: object = None
    parts: dict | None = None


class Timer:
    """Wall time of named stages in milliseconds."""

    def __init__(self):
        self.stages = {}
        self._last = clock.perf_counter()

    def mark(self, name):
        """Book the time since the last mark on `name`."""
        now = clock.perf_counter()
        self.stages[name] = self.stages.get(name, 0.0) + (now - self._last) * 1e3
        self._last = now
