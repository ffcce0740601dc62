"""The owner of depth and velocity on a CUDA device: twin of `rainsim.water.conserving_flow`.

It decides about a step as `LeanFlow` does, whose code it shares; what is done to all cells is done
by the kernels of `rainsim.cuda.water.flow`, after each of which the host reads what it found.
"""

import contextlib
import math

import numpy as np

from rainsim.cuda.driver import fetch
from rainsim.cuda.jit import cuda
from rainsim.cuda.water import flow as lean
from rainsim.water.bundles import FrictionNumbers, Ground
from rainsim.water.conserving import PAD
from rainsim.water.conserving_flow import LeanFlow


class DeviceLeanFlow(LeanFlow):
    """The flow of "lean" whose fields lie on a CUDA device.

    parity : int. Which copy of the fields is the present one.
    has_changed : bool. Whether a launch has moved water since somebody set it to
        False.
    """

    def __init__(self, flow):
        rough = None if flow.roughness is None else flow.roughness[flow.inner]
        self._is_ahead = self.is_by_strip = False
        super().__init__(
            flow.bed[flow.inner], flow._spacing, flow._gravity, flow.is_open, rough, flow.dry,
            flow.viscosity,
        )  # fmt: skip
        self.layout = lean.layout_of(self.bed.shape, self.edge_is_open, rough is not None)
        rough = np.zeros_like(self.bed) if rough is None else self.roughness
        self._ground = Ground(self.sent(self.bed), self.sent(rough))
        self.strip, self.has_changed, self.parity = None, True, 0
        self._blocks = lean.blocks_of_columns(self.layout)
        self._squares = lean.blocks_of_cells(self.layout)
        self._found, self._maxima = (
            cuda.to_device(np.zeros((rows, x * y)))
            for rows, (x, y) in ((3, self._blocks), (4, self._squares))
        )

    # -- between host and device -------------------------------------------------------------------

    def framed(self, field):
        """Return a map as the device has it, (ny + 1, pitch), float32."""
        framed = np.zeros((self.layout.ny + 1, self.layout.pitch), np.float32)
        framed[: field.shape[0], lean.LEAD : lean.LEAD + field.shape[1]] = field
        return framed

    def sent(self, field):
        """Return a map on the device, flat."""
        return cuda.to_device(self.framed(field).reshape(-1))

    def bring(self, flat, field_out):
        """Copy a map in the device's layout, flat, to one of the host, without its ghosts."""
        rows, columns = field_out.shape
        framed = flat.reshape(-1, self.layout.pitch)[:rows, lean.LEAD : lean.LEAD + columns]
        field_out[:] = 0  # the device does not keep all ghosts
        field_out[self.inner] = framed[self.inner]

    def places(self, rows, columns):
        """Return the places of cells in the device's maps, ndarray of int64."""
        rows, columns = np.asarray(rows, np.int64), np.asarray(columns, np.int64)
        return (rows + PAD) * self.layout.pitch + columns + PAD + lean.LEAD

    def present(self, which):
        """Return a field of the present copy, a flat view: 0 for depth, then both velocities."""
        size = len(self.remainder)
        first = (3 * self.parity + which) * size
        return self.fields[first : first + size]

    @property
    def water(self):
        """The water on the host; in a step with conditions only that along them is the present."""
        if self._is_ahead and not self.is_by_strip:
            if self.strip is not None:
                self.strip.send()
            self._is_ahead = False
            now, spare = self._host, self._spare
            copies = self.fields.copy_to_host().reshape(2, 3, -1)
            for n, (h, _, u, v) in ((self.parity, now), (1 - self.parity, spare)):
                for flat, field in zip(copies[n], (h, u, v), strict=True):
                    self.bring(flat, field)
            self.bring(self.remainder.copy_to_host(), now.remainder)
            self._fill_ghosts()
        return self._host

    @water.setter
    def water(self, water):
        """Take other arrays of the host."""
        self._host = water

    @contextlib.contextmanager
    def by_strip(self):
        """Let `water` be that along the conditions meanwhile, which costs no copy of all."""
        before, self.is_by_strip = self.is_by_strip, self.strip is not None
        try:
            yield
        finally:
            self.is_by_strip = before

    def restore(self, arrays):
        """Take over the arrays that `saved` returned."""
        super().restore(arrays)
        now, spare = self._host, self._spare
        fields = [self.framed(a) for copy in (now, spare) for a in (copy.h, copy.u, copy.v)]
        self.fields = cuda.to_device(np.stack(fields).reshape(-1))
        self.remainder = self.sent(now.remainder)
        self.parity, self.has_changed = 0, True

    @contextlib.contextmanager
    def launching(self):
        """Send what conditions have changed before a launch, and read what it did there after."""
        if self.strip is not None:
            self.strip.send()
        yield
        self._is_ahead = True
        if self.strip is not None:
            self.strip.receive()

    # -- step --------------------------------------------------------------------------------------

    def refresh(self):
        """Measure the speeds that limit step and cap from depths and velocities."""
        peaks = self._measure()
        self.water_speed = float(peaks[lean.SWIFT])
        drop = max(peaks[lean.DEEPEST], peaks[lean.FALL])
        self.wave_speed = self.water_speed + math.sqrt(self._gravity * drop)
        self._raise_cap(peaks)

    def _measure(self):
        if self.strip is not None:
            self.strip.send()
        lean.measure[self._squares, (lean.SIDE, lean.HEIGHT)](
            self.fields, self._ground.bed, self.layout, self.parity, np.float32(self.lowest_bed),
            self._maxima,
        )  # fmt: skip
        return fetch(self._maxima).max(axis=1)

    def _raise_cap(self, peaks=None):
        peaks = self._measure() if peaks is None else peaks
        deepest = float(peaks[lean.DEEPEST])
        if deepest > 0.0:
            self._raise_cap_to(deepest, self.lowest_bed + float(peaks[lean.HIGHEST]))
            self.cap = max(self.cap, self.water_speed if self._steps == 0 else 0.0)

    def note_sources(self, everywhere):
        """Take note that sources have changed depths."""
        if not self.moves:
            self._raise_cap()  # that of dry ground would hold what fell on it

    def _move(self, dt):
        self._step(dt, dt)
        return [self._out]

    def _step(self, dt, pressure_time):
        dtype = np.float32
        friction = FrictionNumbers(
            dtype(self._gravity * pressure_time), dtype(3 * self.viscosity * pressure_time),
            dtype(self._gravity), self.dry,
        )  # fmt: skip
        with self.launching():
            lean.step[self._blocks, lean.THREADS](
                self._ground, self.layout, self.numbers(dt, pressure_time, self.cap), friction,
                self.parity, self.fields, self._found,
            )  # fmt: skip
            speeds = 0.0, 0.0
            if self.strip is not None:  # what comes in passes faces that the device leaves out
                speeds = self.strip.speeds(dt, pressure_time)
            self.parity, self.has_changed = 1 - self.parity, True
            far, fast, self._out = fetch(self._found)
            self.wave_speed = max(float(far.max()), speeds[0])
            self.water_speed = max(float(fast.max()), speeds[1])
