"""Twin of `render.actor_splats`: for each frame the data of actors that moved go to the device.

The host puts the actors, finds the map that drops meet, what actors shelter and what tyres throw,
as for frames of the CPU; the static set stays where it is.
"""

from __future__ import annotations

from rainsim.cuda.particles.spray import Spray
from rainsim.cuda.rain.moving_surfaces import MovingHeights
from rainsim.particles.spray import flocks_seen
from rainsim.rain.throws import KnownParcels


class MovingActors:
    """The actors in the scene of a `DeviceFrame`.

    Parameters
    ----------
    frame : DeviceFrame

    Attributes
    ----------
    heights : MovingHeights or None
        None where no actor keeps the rain off.
    spray : Spray or None
        None where no tyre can throw anything.
    """

    def __init__(self, frame):
        self._frame, conductor = frame, frame.conductor
        self._parcels = KnownParcels()
        footprints = conductor.ground.terrain.footprints
        self.heights = self.spray = None
        if footprints:
            self.heights = MovingHeights(conductor.ground.moving.still, footprints, frame.stream)
            self.spray = None if conductor.config.render.spray == "off" else Spray()

    def update(self, state):
        """List the copies to the device for the next frame."""
        if self.heights is not None:
            self._frame.pending.append(lambda: self._send_moment(state))

    def _send_moment(self, state):
        """Send the map as actors cover it at the time of a state, and its spray."""
        frame, conductor = self._frame, self._frame.conductor
        self.heights.send(*conductor.ground.moving.moment(state.time))
        if frame.passes.rain.impacts is not None:
            frame.passes.rain.impacts.list_again()
        if self.spray is not None:
            exposure = conductor.now.render.exposure
            seen = flocks_seen(
                state.throws, state.throw_id, conductor.ground_camera, state.time, exposure,
                self._parcels.of,
            )  # fmt: skip
            self.spray.send(*seen, conductor.ground_camera)
        # The next frame's, if it follows, while the device draws this one.
        fps = conductor.config.fps
        conductor.look_ahead((round(state.time * fps) + 1) / fps)
