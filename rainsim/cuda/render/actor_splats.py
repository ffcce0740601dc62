"""Twin of `render.actor_splats`: for each frame the data of actors that moved go to the device.

The host puts the actors, finds the map that drops meet, what actors shelter and what tyres throw,
as for frames of the CPU; the static set stays where it is.
"""

from __future__ import annotations

from rainsim.cuda.particles.spray import Spray
from rainsim.cuda.rain.moving_surfaces import MovingHeights
from rainsim.particles.spray import spray_seen
from rainsim.rain.moving_surfaces import FRAMES_AHEAD


class MovingActors:
    """The actors in the scene of a `DeviceFrame`.

    frame : DeviceFrame
    heights : MovingHeights or None. None where no actor keeps the rain off.
    spray : Spray or None. None where no tyre can throw anything.
    """

    def __init__(self, frame):
        self._frame, conductor = frame, frame.conductor
        footprints = conductor.ground.terrain.footprints
        self.heights = self.spray = None
        if footprints:
            self.heights = MovingHeights(conductor.ground.moving.still, footprints, frame.stream)
            self.spray = Spray(frame.stream) if conductor.cars else None

    def update(self, state):
        """List the copies to the device for the next frame."""
        if self.heights is None:
            return
        frame, conductor = self._frame, self._frame.conductor
        surfaces, spray = conductor.ground.moving.at(state.time), None
        if self.spray is not None:
            # Found while the device draws the frame before.
            exposure, camera = conductor.now.render.exposure, conductor.ground_camera
            rolls = conductor.frame["rolls"]
            spray = *spray_seen(rolls, camera, state.time, exposure), camera
        frame.pending.append(lambda: self._send_moment(surfaces, spray))
        # Those that follow, if they do, while the device draws these.
        fps = conductor.config.fps
        number = round(state.time * fps)
        times = [(number + n) / fps for n in range(-1, 1 + FRAMES_AHEAD)]
        conductor.look_ahead(times[2:], times[:2])  # a frame may be drawn again

    def _send_moment(self, surfaces, spray):
        """Send the map as actors cover it, see `MovingSurfaces.moment`, and the spray."""
        self.heights.send(surfaces)
        if (impacts := self._frame.passes.rain.impacts) is not None:
            impacts.list_again()
        if spray is not None:
            self.spray.send(*spray)
