"""Twin of `render.actor_splats`: for each frame the data of actors that moved go to the device.

The host puts the actors, finds the map that drops meet, what actors shelter and what tyres throw,
as for frames of the CPU; the static set stays where it is. The water is that of the CPU's
simulation.
"""

from __future__ import annotations

from rainsim.cuda.particles.spray import Spray
from rainsim.cuda.rain.moving_surfaces import MovingHeights
from rainsim.particles.spray import spray_seen


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
        self.frame, self._placed = frame, None
        host, footprints = frame.host, frame.terrain.footprints
        self.heights = self.spray = None
        self._rings_sent = host.water.rings
        if footprints:
            self.heights = MovingHeights(host.moving.still, footprints, frame.stream)
            self.spray = None if host.config.render.spray == "off" else Spray()

    def update(self, state):
        """List the copies to the device for the next frame; return if its ground has changed."""
        frame, host = self.frame, self.frame.host
        if host.wet_scene.actors.placed != self._placed:
            frame.pending.append(self._send_splats)
        if self.heights is None:
            return False
        if host.water.rings is not self._rings_sent:
            frame.pending.append(self._send_rings)
        frame.pending.append(lambda: self._send_moment(state))
        return host.wet_scene.take_tracks(state.tracks)

    def _send_splats(self):
        frame = self.frame
        frame.rasterizer.send_actors()
        frame.ground_light.send_actors()
        self._placed = frame.wet_scene.actors.placed

    def _send_rings(self):
        rings = self.frame.host.water.rings
        self.frame.send_rings(rings)
        self._rings_sent = rings

    def _send_moment(self, state):
        """Send the map as actors cover it at the time of a state, and its spray."""
        frame, host = self.frame, self.frame.host
        self.heights.send(*host.moving.moment(state.time))
        if frame.rain.impacts is not None:
            frame.rain.impacts.list_again()
        if self.spray is not None:
            exposure = host.now.render.exposure
            seen = spray_seen(state.throws, state.throw_id, host.view, state.time, exposure)
            self.spray.send(*seen, host.view)
