"""Frames in their turn: what the host makes ready, what the device begins early, what is redone.

A frame has three recorded queues. The first needs no water; the next frame's begins as soon as the
device has drawn this one, before the host has looked whether there was room for all. Beside it lies
the second, the water's surface, which waits for the simulation's step; the device takes that while
it draws the frame before. The third needs both. The picture goes to the host beside the next frame.
"""

from __future__ import annotations

import time as clock
from functools import partial

from rainsim.cuda.graph import Graph
from rainsim.cuda.jit import cuda
from rainsim.render import FrameReport

MOST_TRIES = 8  # of a frame for which there was too little room


class InTurn:
    """The part of `rainsim.cuda.frame.Renderer` that says when what is queued."""

    def _begin_turns(self):
        self._copier, self._shore = cuda.stream(), cuda.stream()
        self._composed, self._copied, self._surfaced = (cuda.event() for _ in range(3))
        self._queue = self._dry = self._last = None
        self._looks, self._seen, self._kept = 0, (None, 0), None
        self._wet, self._surfaces = {}, {}  # recorded, by the page of the simulation they show
        self._next = self._flight = self._done = None
        self._drawn = 0

    def film(self, shots, names=()):
        """Yield what `draw` returns for each (camera, state, camera_end), one after the other.

        While one is drawn, the next is asked for and made ready, and begun on the device.
        """
        before = None
        for shot in shots:
            if names or before is None or self._size != (shot[0].height, shot[0].width):
                if before is not None:
                    self._finish(before)
                    yield self._report()
                    before = None
                if names or self._size is None:
                    yield self.draw(*shot, names)
                    continue
            self.update(*shot)
            early = before is not None and self._may_overlap()
            if early:
                self._begin()
            if before is not None:
                self._finish(before, early)
                told = self._report()
            if not early or self._is_stale():
                self._begin()
            self._go_on()
            if before is not None:
                yield told
            before = self._flight
        if before is not None:
            self._finish(before)
            yield self._report()

    def run(self):
        """Draw what `update` has brought and wait for it."""
        self._begin()
        self._go_on()
        self._finish(self._flight)

    def _may_overlap(self):
        """Return whether the next frame may begin before it is known what the last one lacked."""
        if self._dry is None or self._to_bring or self._is_stale():
            return False
        self._last.wait()  # for what is counted of the frame that is being drawn
        tight = any(splats.overflows() or splats.is_tight() for splats in self._dry_splats())
        return not tight and not self.film_light.lacks()

    def _dry_splats(self):
        """Return the rasterizers of what needs no water."""
        return [self.rasterizer, *self.film_light.rasterizers]

    def _begin(self):
        """Queue what needs no water of the frame that `update` has brought, and its step."""
        self._flight = self._next, clock.perf_counter()
        state = self._next[1]
        for bring in self._to_bring:
            bring()
        self._to_bring = []
        self._launch_dry(self._is_still())
        if (simulation := simulation_of(state)) is not None:
            simulation.begin(state.index)
        self._launch_surface()

    def _is_still(self):
        """Return whether what needs no water is there: a still camera's, of the same look."""
        if self._kept is None or self._is_stale():
            return False
        return self._seen[0] is self._kept[0] and self._seen[1] == self._kept[1]

    def _launch_dry(self, kept=False):
        """Queue what needs no water; if that is `kept` of the frame before, the numbers only."""
        if self._is_stale():
            self._queue, self._dry, self._wet = self._depends_on(), None, {}
        if self._dry is None:
            dry = chain(self._parts()[0])
            dry()  # compiles, and allocates what only then is known
            self.stream.synchronize()
            self._dry = Graph(self.stream, dry)
            self._still = Graph(self.stream, self.numbers.send)
        if self._last is not None:
            self._last.wait()  # what is still to be copied must stay
        self._last = self._still if kept else self._dry
        self._last.launch()
        self._kept = self._seen

    def _launch_surface(self):
        """Queue the surface of the water of the frame that has begun, beside its splatting."""
        state = self._flight[0][1]
        simulation, page = simulation_of(state), getattr(state, "page", 0)
        if simulation is not None:
            simulation.before(self._shore, falls=False)
            self._surface.depth = state.depth
        self._composed.wait(self._shore)  # the frame before looks at the last surface until then
        if page not in self._surfaces:
            self._surface.launch(self._shore)  # compiles
            self._shore.synchronize()
            queue = partial(self._surface.launch, self._shore)
            self._surfaces[page] = Graph(self._shore, queue)
        self._surfaces[page].launch()
        self._surfaced.record(self._shore)

    def _go_on(self):
        """Queue the rest of the frame that has begun, and the copy of its picture."""
        state = self._flight[0][1]
        simulation, page = simulation_of(state), getattr(state, "page", 0)
        if simulation is not None:
            simulation.before(self.stream)
            self._moments = state.moments
            self._surface.depth = state.depth
            if self.splashes is not None:
                self.splashes.depth, self.streaks.drips = state.depth, state.drip_list
        self._copied.wait(self.stream)
        self._surfaced.wait(self.stream)
        if page not in self._wet:
            if not self._wet:
                self._queue_wet()  # compiles
                self.stream.synchronize()
            self._wet[page] = Graph(self.stream, self._queue_wet)
        self._wet[page].launch()
        if simulation is not None:
            simulation.after(self.stream, page)
        self._composed.record(self.stream)
        self._composed.wait(self._copier)
        self._drawn += 1
        self._copy_picture(self._copier)
        self._copied.record(self._copier)

    def _finish(self, flight, early=False):
        """Wait for a frame; draw it again if there was too little room.

        Another frame may have been made ready since, and `early`: begun, which shows that this one
        had no more splats than there was room for.
        """
        shot, state, simulation = flight[0], flight[0][1], simulation_of(flight[0][1])
        ahead, latest = self._next, self._flight
        self._copied.synchronize()
        for _ in range(MOST_TRIES):
            lacking = simulation is not None and simulation.lacked(state.index)
            lacking |= self.mirrors.grow() | self._splashes_lacked()
            if not early:
                full = [splats for splats in self._dry_splats() if splats.overflows()]
                for splats in full:
                    splats.make_room()
                lacking |= bool(full) or self.film_light.grow()
            if not lacking:
                break
            cuda.synchronize()
            self.update(*shot)
            self._flight, early = flight, False
            self._launch_dry()
            self._launch_surface()
            self._go_on()
            self._copied.synchronize()
        for splats in self._dry_splats():
            if not early and splats.is_tight():
                splats.make_room()
        self.mirrors.make_ahead()
        drawn_again = self._next is not ahead
        if drawn_again or self._is_stale():
            self.update(*ahead)
        self._flight, self._done = latest, flight
        if drawn_again and latest is not flight:
            self._launch_dry()
            self._launch_surface()

    def _report(self, names=()):
        """Return the picture and the report of the frame that is finished."""
        (camera, state, _), begin = self._done
        stages = {"frame": (clock.perf_counter() - begin) * 1e3}
        notes, self.notes = (*state.notes, *self.notes), []  # the renderer's are told once
        apart = self._take_apart(names, camera, state) if names else ()
        report = FrameReport(state.index, state.time, stages, state.ledger, notes, *apart)
        return self.image, report

    @property
    def image(self):
        """The picture drawn last, host array (height, width, 3) uint8; the next is another."""
        return self._images[self._drawn % 2]

    def _depends_on(self):
        """Return what the recorded queues depend on: when it changes, record anew."""
        lines = None if self.splashes is None else id(self.splashes.lines)
        film, drips = self.film_light.queue, self._own_drips
        return self._size, self.rasterizer.queue, film, self.mirrors.queue, lines, drips

    def _is_stale(self):
        return self._queue != self._depends_on()


def simulation_of(state):
    """Return the simulation whose water is on the device, or None."""
    return getattr(state, "simulation", None)


def chain(parts):
    """Return a function that calls all of `parts`."""

    def queue():
        for part in parts:
            part()

    return queue
