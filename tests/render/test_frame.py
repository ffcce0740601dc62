"""A frame as a list of passes: what runs, what runs again, and what each backend computes."""

import functools

import numpy as np
import pytest

from made_frames import passes_without
from rainsim.render import layers
from rainsim.render.aov import AOVS
from rainsim.render.frame import INPUTS, PASSES, TRANSIENT, Frame, Pass, is_same, passes_to
from rainsim.render.passes import Passes

MADE = (
    Pass("draw", ("camera",), ("layers",)),
    Pass("wet", ("layers", "look"), ("picture", "depth")),
    Pass("flow", ("water",), ("surface",)),
    Pass("lay", ("picture", "surface"), ("image",)),
    Pass("count", ("layers",), ("number",)),
)


class Made:
    """Work that notes what ran."""

    def __init__(self):
        self.ran = []
        self.work = {
            "draw": self._noted("draw", lambda camera: camera + 1),
            "wet": self._noted("wet", lambda layers, look: (layers * look, layers)),
            "flow": self._noted("flow", lambda water: water.sum()),
            "lay": self._noted("lay", lambda picture, surface: picture + surface),
            "count": self._noted("count", lambda layers: layers),
        }
        self.frame = Frame(MADE)

    def _noted(self, name, compute):
        @functools.wraps(compute)
        def work(*values):
            self.ran.append(name)
            return compute(*values)

        return work

    def image(self, *names, camera=1, look=2, water=(0.0, 3.0)):
        self.ran.clear()
        for name, value in (("camera", camera), ("look", look), ("water", np.array(water))):
            self.frame.put(name, value)
        self.frame.make(names or ("image",), self.work)
        return self.frame[names[0] if names else "image"]


def test_only_what_reads_a_change_runs_again():
    made = Made()
    assert made.image() == 7 and made.ran == ["draw", "wet", "flow", "lay"]
    assert made.image() == 7 and made.ran == []
    assert made.image(water=(0.0, 4.0)) == 8 and made.ran == ["flow", "lay"]
    assert made.image(water=(0.0, 4.0), camera=2) == 10 and made.ran == ["draw", "wet", "lay"]
    # What was dropped is drawn again for who reads it, and nothing else for that.
    assert made.image(water=(0.0, 4.0), camera=2, look=3) == 13
    assert made.ran == ["draw", "wet", "lay"]
    assert "layers" in TRANSIENT and "layers" not in made.frame
    assert made.image("number", water=(0.0, 4.0), camera=2, look=3) == 3
    assert made.ran == ["draw", "count"]
    assert made.image(water=(0.0, 4.0), camera=2, look=3) == 13 and made.ran == []


def test_what_is_put_stands_for_its_pass():
    """As the buffers of a picture that a GPU has drawn do."""
    made = Made()
    made.image()
    made.ran.clear()
    made.frame.put("look", 5)
    made.frame.put("picture", 40)
    made.frame.make(("image",), made.work)
    assert made.frame["image"] == 43 and made.ran == ["lay"]


def test_an_error_leaves_what_was_finished():
    made = Made()

    def stop(name):
        if name == "wet":
            raise KeyboardInterrupt

    made.frame.put("camera", 1), made.frame.put("look", 2), made.frame.put("water", np.ones(2))
    with pytest.raises(KeyboardInterrupt):
        made.frame.make(("image",), made.work, stop)
    assert made.ran == ["draw", "wet"]
    made.ran.clear()
    made.frame.make(("image",), made.work)
    assert made.ran == ["flow", "lay"] and made.frame["image"] == 6


def test_a_pass_that_raises_runs_again():
    made = Made()
    made.image()
    flow, made.work["flow"] = made.work["flow"], lambda water: 1 / 0
    with pytest.raises(ZeroDivisionError):
        made.image(water=(0.0, 4.0))
    made.work["flow"] = flow
    assert made.image(water=(0.0, 4.0)) == 8 and made.ran == ["flow", "lay"]


def test_a_mark_tells_of_changes_of_an_object_that_lives_on():
    frame, thing = Frame(MADE), [1]
    frame.put("camera", thing, mark=1)
    ran = []
    work = {"draw": lambda camera: ran.append(camera[0])}
    for mark in (1, 1, 2):
        frame.put("camera", thing, mark)
        frame.make(("layers",), work)
    assert len(ran) == 2


def test_values_are_compared_by_what_they_hold():
    a = np.arange(3.0)
    assert is_same(a, a.copy()) and not is_same(a, a + 1) and not is_same(a, a.astype(np.float32))
    assert is_same((a, 1.0), (a.copy(), 1.0)) and not is_same((a, 1.0), (a, 1.0, 2))
    assert is_same(None, None) and not is_same(None, 0) and not is_same([1], [1])


def inputs_of(names, passes=PASSES):
    """The inputs on which buffers depend."""
    read = {name for each in passes_to(names, passes) for name in each.reads}
    return (read | set(names)) - {name for each in passes for name in each.writes}


def test_every_name_that_is_read_is_an_input_or_is_written_before():
    known = set(INPUTS)
    for each in (*PASSES, *layers.LAYER_PASSES):
        unknown = set(each.reads) - known
        assert not unknown, (
            f"{each.name} reads {unknown}: move it below what writes that, or add it to INPUTS"
        )
        assert known.isdisjoint(each.writes), each.name
        known.update(each.writes)
    assert inputs_of(("image", *AOVS), (*PASSES, *layers.LAYER_PASSES)) == set(INPUTS)
    assert set(AOVS) <= known


def test_the_cpu_knows_each_pass_but_those_it_computes_with_others():
    assert passes_without(Passes().work) == {
        "splat level",
        "light on wet ground",
        "find tall",
        "list drops",
    }


def test_a_layer_asks_for_no_more_than_it_shows():
    """The water's surface does not depend on the camera, the depth not on the water."""
    assert inputs_of(("surface",)) == {"water", "rings", "ground"}
    assert not inputs_of(("depth",)) & {"water", "ripples", "field", "time"}
    assert "mirror" not in {each.name for each in passes_to(("rain_alpha",))}
