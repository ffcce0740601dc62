"""The order in which frames are queued: work of the host, overlap of frames, recorded queues.

A frame has four recorded queues. The first splats; where there is memory for it, that of the next
frame lies beside the water of this one. The second grades what was splatted. Beside it lies the
third, the water's surface, which waits for the simulation's step; the device takes that step while
it draws the frame before. The fourth needs both.

The host launches the first three of the next frame as soon as the device has graded this one, and
the fourth as soon as it knows that this one had room for all, which is before it is composed. Then
it prepares the frame after the next, while the picture of this one goes to the host.
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from functools import partial

import numpy as np

from rainsim.cuda.driver import Event
from rainsim.cuda.graph import Graph, chain
from rainsim.cuda.jit import cuda, pinned
from rainsim.cuda.render.device_frame import simulation_of
from rainsim.render.frame import DRY, SPLAT, SURFACE, WET

MOST_TRIES = 8  # of a frame for which there was too little room


@dataclass(eq=False)
class Flight:
    """A frame that is on its way.

    shot : tuple. Camera, state and the camera as the shutter closes.
    look : tuple. See `DeviceFrame`.
    begin : float [s]. When its queue began.
    picture : HostPicture or None. That it is copied to; None: not yet.
    """

    shot: tuple
    look: tuple
    begin: float = 0.0
    picture: HostPicture | None = None

    @property
    def state(self):
        """The simulation's state that the frame shows."""
        return self.shot[1]


class Recordings:
    """The recorded queues of the frames of a device, as long as nothing changes that they hold.

    frame : DeviceFrame
    shore : numba.cuda.stream. That the water's surface is found on.
    splats, dry, still : Graph or None. What is splatted, what else needs no
        water, and that of a still camera: the uniforms alone.
    """

    def __init__(self, frame, shore):
        self._frame, self._shore = frame, shore
        self._recorded_for = {}  # by part, DRY and WET: what its queues depended on
        self.splats = self.dry = self.still = None
        self._wet, self._surfaces = {}, {}  # by the page of the simulation they show

    def _fits(self, part):
        return self._recorded_for.get(part) == self._frame.dependencies(part)

    @property
    def is_stale(self):
        """Whether the queues that need no water no longer fit."""
        return not self._fits(DRY)

    def leave_water(self):
        """Drop the queues that show the water of a simulation."""
        self._recorded_for.pop(WET, None)
        self._surfaces = {}

    def renew(self):
        """Record again what needs no water and no longer fits."""
        if not self.is_stale:
            return
        frame, queue = self._frame, self._frame.passes.lanes.queue
        splat = partial(queue, SPLAT, frame.ahead)
        graded = chain([frame.uniforms.send, partial(queue, DRY, frame.stream)])
        self._prepare(DRY, (splat, frame.ahead), (graded, frame.stream))
        self.splats = Graph(frame.ahead, splat)
        self.dry = Graph(frame.stream, graded)
        self.still = Graph(frame.stream, frame.uniforms.send)

    def _prepare(self, part, *queues):
        """Say what a part's queues depend on; run them if they have kernels that may be new.

        Those are compiled then, and what only they know of is allocated.
        """
        before, now = self._recorded_for.get(part, ()), self._frame.dependencies(part)
        if len(before) != len(now):  # more than before: another mirror, the first splashes
            self._frame.stream.synchronize()
            for queue, stream in queues:
                queue()
                stream.synchronize()
        self._recorded_for[part] = now

    def surface(self, page):
        """Return the queue of the water's surface, of a page of the simulation."""
        if page not in self._surfaces:
            queue = partial(self._frame.passes.lanes.queue, SURFACE, self._shore)
            queue()  # compiles
            self._shore.synchronize()
            self._surfaces[page] = Graph(self._shore, queue)
        return self._surfaces[page]

    def wet(self, page):
        """Return the queue of all else, of a page of the simulation."""
        stream = self._frame.stream
        queue = partial(self._frame.passes.lanes.queue, WET, stream)
        if not self._fits(WET):
            self._wet = {}
            self._prepare(WET, (queue, stream))
        if page not in self._wet:
            self._wet[page] = Graph(stream, queue)
        return self._wet[page]


class HostPicture:
    """A picture on the host that one of the device is copied to.

    values : uint8 array (height, width, 3)
    copied : Event. Of the last copy.
    """

    def __init__(self):
        self.values, self.copied = np.zeros((0, 0, 3), np.uint8), Event()


class HostPictures:
    """Two pictures on the host, which those of the device are copied to in turn."""

    def __init__(self):
        self._stream, self._each = cuda.stream(), (HostPicture(), HostPicture())
        self._count = 0

    def room_for(self, size):
        """Allocate pictures of another size, (height, width) [px]."""
        shape = (*size, 3)
        for picture in self._each:
            if picture.values.shape != shape:
                picture.values = pinned(shape, np.uint8)

    @property
    def last(self):
        """The picture copied last, a `HostPicture`."""
        return self._each[self._count % 2]

    def copy(self, frame, composed):
        """Queue the copy of a `DeviceFrame`'s picture, once it is `composed`, an Event.

        Return the `HostPicture`, which the next copy but one overwrites.
        """
        composed.wait(self._stream)
        self._count += 1
        frame.copy_image(self.last.values, self._stream)
        self.last.copied.record(self._stream)
        return self.last


class FrameQueue:
    """Queues frames on the device and finishes them on the host.

    frame : DeviceFrame
    pictures : HostPictures
    done : Flight or None. The frame whose picture is on the host.
    """

    def __init__(self, frame):
        self.frame, self.stream = frame, frame.stream
        self._shore, self.pictures = cuda.stream(), HostPictures()
        self._recorded = Recordings(frame, self._shore)
        self._sent, self._composed, self._surfaced, self._splatted, self._graded = (
            Event() for _ in range(5)
        )
        self._simulation = None  # whose water they show, on the device
        self._next = self._flight = self.done = None
        self._kept = None  # the flight whose picture without water is on the device
        self._last = None  # of the recorded queues, the one that brought that

    def _fits(self, shot):
        """Return whether a shot has size and simulation of the frames before, and follows them."""
        camera, state, _ = shot
        size = camera.height, camera.width
        simulation = simulation_of(state)
        if self.frame.size != size or simulation is not self._simulation:
            return False
        return simulation is None or simulation.follows(state.step)

    def draw(self, shot):
        """Draw a shot (camera, state, camera_end) and wait for it."""
        self.pictures.last.copied.synchronize()  # a sequence may have been left in the middle
        self._update(shot)
        self._begin()
        self._go_on()
        self._check(self._flight)
        self._show(self._flight)

    def draw_each(self, shots, report):
        """Yield `report()` after each shot; two that follow are begun before one is waited for.

        A frame's queue is whole as soon as it is known that the one before had room for all, which
        is before that is composed. Then the next shot is asked for and prepared.

        shots : iterable. Of (camera, state, camera_end).
        report : callable. Called as soon as the picture of a shot is on the host.
        """
        checked = flying = None  # frames: one whose picture is not yet shown, and the one after
        self.pictures.last.copied.synchronize()
        for shot in shots:
            if flying is not None and not self._fits(shot):
                yield from self._land(checked, flying, report)
                checked = flying = None
            if self.frame.size is None:
                self.draw(shot)
                yield report()
                continue
            simulation = simulation_of(shot[1])
            if simulation is not None and simulation.is_idle:
                simulation.begin(shot[1].step)  # the host prepares the frame meanwhile
            self._update(shot)
            if checked is not None:
                self._show(checked)
                yield report()
            early = flying is not None and self._may_overlap()
            if early:
                self._begin()
            if flying is not None:
                self._check(flying, early)
                if not early:
                    flying.picture.copied.synchronize()  # what is sent is not read meanwhile
            if not early or self._recorded.is_stale:
                self._begin()
            self._go_on()
            checked, flying = flying, self._flight
            self._keep_state(True)
        if flying is not None:
            yield from self._land(checked, flying, report)

    def _land(self, checked, flying, report):
        """Yield `report()` after the frames that are still on their way."""
        if checked is not None:
            self._show(checked)
            yield report()
        self._check(flying)
        self._show(flying)
        self._keep_state(False)
        yield report()

    def _show(self, flight):
        """Wait for the picture of a checked frame."""
        flight.picture.copied.synchronize()
        self.done = flight

    def _keep_state(self, is_shown):
        """Tell the simulation whether it must keep the state of the frame before."""
        if self._simulation is not None:
            self._simulation.is_shown = is_shown

    def _update(self, shot):
        """Prepare the next frame; the device may still be drawing the one before, if that fits."""
        if (simulation := simulation_of(shot[1])) is not self._simulation:
            self._simulation = simulation
            self._recorded.leave_water()
            self.frame.leave_water()
        self.frame.update(*shot)
        self._next = Flight(shot, self.frame.look)
        self.pictures.room_for(self.frame.size)

    def _may_overlap(self):
        """Return whether the next frame may begin before the last is checked for lack of room."""
        if self._recorded.dry is None or self.frame.pending or self._recorded.is_stale:
            return False
        self._last.wait()  # for the counts of the frame that is being drawn
        return not any([splats.is_amiss() for splats in self.frame.passes.dry_rasterizers()])

    def _begin(self):
        """Queue the next frame's launches that need no water, and the step of its simulation."""
        self._flight = Flight(self._next.shot, self._next.look, clock.perf_counter())
        state = self._flight.state
        for send in self.frame.pending:
            send()
        if self.frame.pending:
            self._sent.record(self.stream)
            for stream in (self.frame.ahead, self._shore):  # others wait for one of the three
                self._sent.wait(stream)
        self.frame.pending = []
        self._launch_dry(self._is_still())
        if (simulation := simulation_of(state)) is not None:
            simulation.begin(state.step)
        self._launch_surface()

    def _is_still(self):
        """Return whether the picture without water is there: a still camera's, of the same look."""
        kept, new = self._kept, self._flight
        if kept is None or kept.shot[0] is not new.shot[0] or kept.look != new.look:
            return False
        return not self._recorded.is_stale

    def _launch_dry(self, still=False):
        """Queue the launches that need no water, of a `still` camera the uniforms only."""
        self._recorded.renew()
        frame, ahead = self.frame, self.frame.ahead
        if self._last is not None:
            self._last.wait()  # its pinned arrays may still be read
        self._last = self._recorded.still if still else self._recorded.dry
        if not still:
            self._graded.wait(ahead)  # the frame before is made of what is splatted until then
            if not frame.passes.mirrors.apart:
                self._composed.wait(ahead)
            self._recorded.splats.launch()
            self._splatted.record(ahead)
            self._splatted.wait(self.stream)
        self._last.launch()
        self._graded.record(self.stream)
        self._kept = self._flight

    def _launch_surface(self):
        """Queue the surface of the water of the frame that has begun, beside its splatting."""
        state, passes = self._flight.state, self.frame.passes
        simulation, page = simulation_of(state), getattr(state, "page", 0)
        if simulation is not None:
            simulation.before(self._shore, falls=False)
            passes.surface.depth = state.depth
        self._composed.wait(self._shore)  # the frame before reads the last surface until then
        self._recorded.surface(page).launch()
        self._surfaced.record(self._shore)

    def _go_on(self):
        """Launch the stages of the begun frame that need water, and the copy of its picture."""
        state = self._flight.state
        simulation, page = simulation_of(state), getattr(state, "page", 0)
        if simulation is not None:
            simulation.before(self.stream)
            self.frame.take_water(state)
        self.pictures.last.copied.wait(self.stream)
        self._surfaced.wait(self.stream)
        self._recorded.wet(page).launch()
        if simulation is not None:
            simulation.after(self.stream, page)
        self._composed.record(self.stream)
        self._flight.picture = self.pictures.copy(self.frame, self._composed)

    def _check(self, flight, early=False):
        """Draw a frame again, and wait for it, if there was too little room.

        Another frame may have been prepared since, and `early`: begun, which shows that this frame
        had no more splats than there was room for.
        """
        frame, passes, simulation = self.frame, self.frame.passes, simulation_of(flight.state)
        ahead, latest = self._next, self._flight
        dry = [] if early else passes.dry_rasterizers()
        passes.wait_for_counts()
        for _ in range(MOST_TRIES):
            late = simulation is not None and simulation.lacked(flight.state.step)
            if not (late or passes.lacks or any(splats.lacks for splats in dry)):
                break
            cuda.synchronize()
            passes.grow()
            for splats in dry:
                splats.grow()
            self._update(flight.shot)
            frame.send_chunks()
            self._flight, early, dry = flight, False, passes.dry_rasterizers()
            self._launch_dry()
            self._launch_surface()
            self._go_on()
            flight.picture.copied.synchronize()
        for splats in dry:
            splats.make_ahead()
        passes.mirrors.make_ahead()
        drawn_again = self._next is not ahead
        if drawn_again or self._recorded.is_stale:
            self._update(ahead.shot)
        self._flight = latest
        if drawn_again and latest is not flight:
            self._launch_dry()
            self._launch_surface()
