"""A frame as a list of passes: what each reads, what it writes, and when it runs again. Start here.

`PASSES` names the passes of a picture in the order in which they run on either backend. A pass
reads inputs and buffers and writes buffers. An input is a value that
`rainsim.render.conductor.Conductor` puts for each frame: the camera, the water, the scene in the
light of the moment. A buffer is what a pass writes, an array or a bundle of arrays of one picture.
A `Frame` holds both by name. It knows which of them are newer than what was made of them, so it
runs no pass twice for the same: of a still camera the picture without water is drawn once, still
water is found once.

What a pass computes stands with its backend: `rainsim.render.passes` for the CPU,
`rainsim.cuda.render.passes` for the GPU. Neither holds an order of its own. A layer (AOV) is a
buffer, too: `rainsim.render.layers` has the passes that write layers, which run after these.
"""

import inspect
import operator
from typing import NamedTuple

import numpy as np

INPUTS = {
    "camera": "Camera of the picture, in the capture frame",
    "ground_camera": "the same in the ground frame",
    "ground_camera_end": "as the shutter closes, in the ground frame; None: it stands still",
    "view": "View of the ground camera, as kernels take it",
    "capture": "DrawnCapture: the splats in their present colours, what moves where it is now",
    "scene": "WetScene: how light and wet everything is now",
    "ground": "GroundTables: the ground that carries the water",
    "methods": "RenderConfig that names how water is drawn",
    "film_apart": "whether what wet ground mirrors is added to the picture, see `WetGroundMirror`",
    "render": "RenderConfig of the present time: shutter, lens, streaks",
    "time": "of the frame [s]",
    "interval": "from frame to frame [s]",
    "water": "depth of the water on the ground, (ny, nx) [m]",
    "rings": "amplitude of rings on each cell over that in the open, (ny, nx)",
    "ripples": "slopes of the tile of ripples and its size [m]",
    "tops": "TopMaps: tables and benches, and the water that stands on them",
    "mirror_step": "pixels of the picture for one of its mirrored pictures, see `mirror_step`",
    "field": "RainField of the drops that are seen; None: no rain",
    "surfaces": "Surfaces: what drops land on",
    "drips": "drips in the air and their numbers",
    "rolls": "where tyres have rolled over water, or None",
    "paving": "how wet open paving is, 0 to 1",
    "sun": "direction and radiance of the sun, see `sky.sunlight`",
    "everywhere": "mean radiance of the surroundings, (3,)",
    "air": "radiance of distant air, (3,)",
    "brightness": "factor on the finished picture",
}


class Pass(NamedTuple):
    """A part of a frame's work.

    name : str. By which a backend knows what to compute, and by which times are
        reported.
    reads : tuple of str. Inputs, and buffers that earlier passes write. A
        backend's function takes those of them that its parameters are named for.
    writes : tuple of str. Buffers. The function returns them in this order.
    """

    name: str
    reads: tuple
    writes: tuple


PASSES = (
    # The capture, graded and wet, with what wet ground mirrors.
    Pass("splat level", ("camera", "capture"), ("level_layers",)),
    Pass("light on wet ground", ("level_layers", "scene", "ground_camera"),
         ("field_on_ground",)),
    Pass("splat", ("camera", "capture"), ("layers",)),
    Pass("grade and wet", ("layers", "view", "scene", "film_apart"),
         ("below", "depth", "clearance", "cover")),
    Pass("film", ("below", "depth", "clearance", "cover", "view", "ground_camera", "scene",
                  "ground", "field_on_ground"), ("picture",)),
    # The water, and what falls before it.
    Pass("water surface", ("water", "rings", "ground"), ("surface",)),
    Pass("find tall", ("depth", "clearance"), ("tall",)),
    Pass("light of drops", ("picture", "depth", "view", "scene", "everywhere"),
         ("drop_light",)),
    Pass("list drops", ("ground_camera", "ground_camera_end", "time", "render", "field"),
         ("drops",)),
    Pass("streaks", ("drops", "depth", "ground_camera", "ground_camera_end", "time", "render",
                     "field", "surfaces", "drips", "rolls"), ("rain_alpha", "fog")),
    Pass("splashes", ("drops", "rain_alpha", "depth", "ground_camera",
                      "ground_camera_end", "time", "interval", "render", "field", "surfaces",
                      "drips", "water", "paving"),
         ("splash_alpha",)),
    Pass("find water", ("depth", "view", "surface", "tops", "scene", "methods"), ("seen",)),
    Pass("mirror", ("seen", "tops", "camera", "view", "scene", "methods", "mirror_step"),
         ("mirrors",)),
    Pass("reflection", ("seen", "mirrors", "ripples", "tops", "picture", "depth", "clearance",
                        "tall", "view", "scene", "methods"), ("reflected",)),
    Pass("water", ("seen", "reflected", "picture", "below", "depth", "view", "sun",
                   "methods"), ("shown",)),
    Pass("light of the rain", ("drop_light", "air", "shown", "render"), ("rain_light",)),
    Pass("glare", ("shown", "ground_camera", "brightness", "render"), ("dazzling",)),
    Pass("compose", ("dazzling", "depth", "rain_alpha", "splash_alpha", "fog", "rain_light",
                     "view", "brightness"), ("image",)),
)  # fmt: skip
TRANSIENT = frozenset({"layers", "level_layers"})  # dropped with the picture: 36 bytes a pixel


class Frame:
    """The inputs and buffers of one picture after another, by name.

    passes : sequence of Pass. In the order in which they may run.
    """

    def __init__(self, passes=PASSES):
        self._passes = tuple(passes)
        self._writer = {name: each.name for each in self._passes for name in each.writes}
        self._values, self._marks = {}, {}
        self._written, self._done = {}, {}  # number of the change that wrote a name, ran a pass
        self._given = set()  # buffers that were put
        self._changes = 0

    def __getitem__(self, name):
        return self._values[name]

    def __contains__(self, name):
        return name in self._values

    def put(self, name, value, mark=None, compare=True):
        """Take over a value; nothing that reads it is run again if it is the same as before.

        name : str. An input, or a buffer, which then no pass is run for.
        value : object
        mark : object, optional. Changes when the value does, where that is an
            object that lives on and changes.
        compare : bool. Whether another object that is equal counts as the same.
        """
        alike = is_same if compare else operator.is_
        same = name in self._values and alike(value, self._values[name])
        if not same or not is_same(mark, self._marks.get(name)):
            self._store(name, value)
        self._marks[name] = mark
        if name in self._writer:
            self._given.add(name)

    def call(self, compute, **others):
        """Return what a pass's function computes, with some values replaced by `others`."""
        values = self._values | others
        return compute(*(values[name] for name in parameters_of(compute)))

    def make(self, names, work, mark=lambda name: None):
        """Run the passes on which buffers depend, as far as what they read has changed.

        names : iterable of str. Of the buffers.
        work : dict of str to callable. What each pass computes: its parameters
            are named for values of `reads`; it returns those of `writes`. A pass
            that has no entry writes None.
        mark : callable, optional. mark(name) is called after each pass; what it
            raises ends the work. What was finished until then stays.
        """
        for each, is_stale in self.due(names):
            compute, read = work.get(each.name), self._changes
            if compute is None:
                values = (None,) * len(each.writes)
            else:
                values = self.call(compute)
                values = values if len(each.writes) > 1 else (values,)
            self._done[each.name] = read  # not before: a pass that raised must run again
            for name, value in zip(each.writes, values, strict=True):
                if is_stale:
                    self._store(name, value)
                else:
                    self._values[name] = value  # as it was before it was dropped
            if compute is not None:
                mark(each.name)
        for name in TRANSIENT:
            self._values.pop(name, None)

    def due(self, names):
        """Return the passes that buffers depend on and that must run, in their order.

        Returns list of (Pass, bool). Whether something has changed; if not, only
            what was dropped is made again.
        """
        asked = passes_to(names, self._passes, self._given)
        due, newer = set(), set()
        for each in asked:
            done = self._done.get(each.name, -1)
            if not newer.isdisjoint(each.reads) or any(
                self._written.get(name, done + 1) > done for name in each.reads
            ):
                due.add(each.name)
                newer.update(each.writes)
        stale = set(due)
        for each in reversed(asked):
            if each.name in due:
                gone = [name for name in each.reads if name not in self._values]
                due.update(self._writer[name] for name in gone if name in self._writer)
        return [(each, each.name in stale) for each in asked if each.name in due]

    def _store(self, name, value):
        self._changes += 1
        self._values[name], self._written[name] = value, self._changes


def parameters_of(compute):
    """Return the names of the parameters of a pass's function, without `self`."""
    code = inspect.unwrap(compute).__code__
    return [name for name in code.co_varnames[: code.co_argcount] if name != "self"]


def passes_to(names, passes=PASSES, given=frozenset()):
    """Return the passes on which buffers depend, in their order, where some are `given`."""
    wanted, found = set(names) - given, []
    for each in reversed(passes):
        if not wanted.isdisjoint(each.writes):
            found.append(each)
            wanted.update(set(each.reads) - given)
    return found[::-1]


def is_same(value, other):
    """Tell whether two inputs are equal: by identity, numbers and arrays by what they hold."""
    if value is other:
        return True
    if type(value) is not type(other):
        return False
    if isinstance(value, np.ndarray):
        return value.dtype == other.dtype and np.array_equal(value, other)
    if isinstance(value, tuple):
        return len(value) == len(other) and all(map(is_same, value, other))
    return isinstance(value, (int, float, str, np.generic)) and value == other
