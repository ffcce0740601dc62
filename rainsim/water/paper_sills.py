"""Last cells at the open edges of "paper" that are higher than their neighbours.

What `rainsim.water.conserving` does in `fill_edge_flux` and `speed_out`, for the few cells that
need it.
"""

import numpy as np

# edge: sign of the outward direction, whether columns are counted, the last one
SIDES = {"west": (-1, True, 0), "east": (1, True, -1), "south": (-1, False, 0),
         "north": (1, False, -1)}  # fmt: skip


def find_sills(bed, is_open):
    """Return a `Sill` for each open edge that has higher last cells."""
    sills = [Sill(bed, *side) for edge, side in SIDES.items() if is_open[edge]]
    return [sill for sill in sills if len(sill.cells)]


class Sill:
    """The higher last cells of one open edge.

    last : {0, -1}. Its number, and that of the edge's faces.
    """

    def __init__(self, bed, sign, is_column, last):
        self._sign, self._is_column, self._last = sign, is_column, last
        self._inward = 1 if last == 0 else -1
        bed = self._lines(bed)
        step = bed[last] - bed[last + self._inward]
        self.cells = np.flatnonzero(step > 0)
        self._step = step[self.cells].astype(np.float64)
        self._speed = self._gain = np.zeros(len(self.cells), bed.dtype)

    def _lines(self, field):
        return field.T if self._is_column else field

    def _outward(self, u, v, inward):
        """Outward velocity [m/s] of the faces that many cells inside the edge."""
        w = u.T if self._is_column else v
        return self._sign * w[self._last + inward * self._inward, self.cells]

    def note(self, u, v):
        """Keep the velocity just inside, and by how much it exceeds that of the next face."""
        self._speed = np.maximum(self._outward(u, v, 1), 0)
        self._gain = np.maximum(self._outward(u, v, 1) - self._outward(u, v, 2), 0)

    def speed_up(self, u_out, v_out):
        """Let the water that leaves go on gaining speed, see `conserving.speed_out`."""
        leaves = np.maximum(self._outward(u_out, v_out, 1), 0)
        w_out = u_out.T if self._is_column else v_out
        w_out[self._last, self.cells] = self._sign * (leaves + np.minimum(self._gain, leaves))

    def give_back(self, k, h, h_out, remainder_out, dry):
        """Take what flowed in from below the step back to the neighbours; k is step / spacing."""
        last, before = self._last, self._last + self._inward
        deep = self._lines(h)[before, self.cells].astype(np.float64)
        excess = k * self._speed * np.minimum(deep, self._step)
        for line, change in ((last, -excess), (before, excess)):
            here = line, self.cells
            depth, extra = self._lines(h_out), self._lines(remainder_out)
            total = depth[here].astype(np.float64) + extra[here] + change
            depth[here] = np.where(total >= dry, total, 0.0)
            extra[here] = total - depth[here]
