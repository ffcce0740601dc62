"""Frames that follow from their number, in place of a `FrameSequence`, and what may befall them."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from rainsim.config.settings import Config
from rainsim.render.frame import PASSES, parameters_of
from rainsim.render.layers import LAYER_PASSES
from rainsim.render.report import FrameReport
from scenes import tiny_scene


class MadeUpFrames:
    """Draws pictures of 64 x 48 px; each takes `pause` [s].

    `fault` happens when the frame `at` is drawn: always, or if `once` names a file the first time.
    """

    def __init__(self, frames=12, pause=0.0, at=None, fault="interrupt", once=None):
        self.config = Config().replace(frames=frames)
        self.scene, self.states, self.backend = tiny_scene(), None, "cpu"
        self.cameras = self.scene.cameras[:1]
        self.next, self.drawn, self._pause = 0, [], pause
        self.setups = 0  # how often the set-up was computed ahead
        self._at, self._fault, self._once = at, fault, once

    def keep_setup(self):
        self.setups += 1

    def frames(self, indices, tell=None):
        for index in indices:
            side = self._befall(index)
            time.sleep(self._pause)
            self.drawn.append(index)
            self.next = index + 1
            rng = np.random.default_rng(index)
            picture = rng.integers(0, 255, (side, 64, 3), dtype=np.uint8)
            layers = {"depth": np.full((48, 64), index, np.float32)}
            facts = index, index / 24, {"all": 1.0}, {"rain": index}
            yield picture, FrameReport(*facts, ("a note",), layers)

    def _befall(self, index):
        if index == self._at and self._is_first():
            if self._fault == "interrupt":
                raise KeyboardInterrupt
            if self._fault == "error":
                raise OSError("the disk of the worker is full")
            if self._fault == "die":
                os.kill(os.getpid(), signal.SIGKILL)
            if self._fault == "hang":
                time.sleep(1000)
            return 16  # a picture of another size
        return 48

    def _is_first(self):
        if self._once is None:
            return True
        try:
            Path(self._once).touch(exist_ok=False)
        except FileExistsError:
            return False
        return True


def passes_without(work):
    """Return the passes that a backend does not compute; the others read what they say."""
    reads = {each.name: set(each.reads) for each in (*PASSES, *LAYER_PASSES)}
    for name, compute in work.items():
        more = set(parameters_of(compute)) - reads[name]
        assert not more, f"add {more} to what the pass {name!r} reads (rainsim/render/frame.py)"
    return set(reads) - set(work)
