"""Twin of `render.nodes`: for each frame only the data of moved nodes are sent to the device.

The host puts the nodes, finds the map that drops meet, what bodies shelter and what tyres throw, as
for frames of the CPU; the static set stays where it is. The water is that of the CPU's simulation.
"""

from __future__ import annotations

from rainsim.cuda.particles.spray import Spray
from rainsim.cuda.rain.moving_surfaces import MovingHeights
from rainsim.particles.spray import spray_seen


class MovingNodes:
    """The moving nodes in the scene of a `DeviceFrame`.

    Parameters
    ----------
    frame : DeviceFrame

    Attributes
    ----------
    heights : MovingHeights or None
        None where no body keeps the rain off that moves.
    spray : Spray or None
        None where no tyre can throw anything.
    """

    def __init__(self, frame):
        self._frame, conductor = frame, frame.conductor
        movers = conductor.ground.terrain.movers
        self.heights = self.spray = None
        if movers:
            self.heights = MovingHeights(conductor.ground.moving.still, movers, frame.stream)
            self.spray = None if conductor.config.render.spray == "off" else Spray()

    def update(self, state):
        """List the copies to the device for the next frame."""
        if self.heights is not None:
            self._frame.pending.append(lambda: self._send_moment(state))

    def _send_moment(self, state):
        """Send the map as bodies cover it at the time of a state, and its spray."""
        frame, conductor = self._frame, self._frame.conductor
        self.heights.send(*conductor.ground.moving.moment(state.time))
        if frame.passes.rain.impacts is not None:
            frame.passes.rain.impacts.list_again()
        if self.spray is not None:
            exposure = conductor.now.render.exposure
            seen = spray_seen(state.throws, state.throw_id, conductor.view, state.time, exposure)
            self.spray.send(*seen, conductor.view)
