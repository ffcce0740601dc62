"""Hits of the last moments on a CUDA device, interval by interval.

A frame shows the splashes of a quarter of a second. Listing the hits of an interval costs more than
drawing their splashes, so each interval is listed once and kept.
"""

import math

from rainsim.cuda.drops import Impacts, room_for
from rainsim.particles.splash import LONGEST_LIFE


class RecentImpacts(Impacts):
    """The impacts of the last moments, a list for each interval that a frame shows.

    rate : float [Hz]. Interval n is from n to n + 1 over this.
    ahead : int. Intervals after a frame's time that its exposure sees.
    """

    def __init__(self, weather, surfaces, rate, ahead):
        self._weather, self._rate, self._ahead = weather, rate, ahead
        field = weather.field(0.0, 1 / rate)
        slots = math.ceil(LONGEST_LIFE * rate) + ahead
        self._newest, self._listed = None, []  # the number of each list's interval
        super().__init__(field, surfaces, room_for(field, surfaces, 1 / rate), slots)

    def update(self, frame):
        """List the intervals that the frame of this number shows and that are not listed yet."""
        self._newest, slots = frame + self._ahead - 1, len(self._listed)
        while True:
            for number in range(self._newest - slots + 1, self._newest + 1):
                slot = number % slots
                if self._listed[slot] != number:
                    times = number / self._rate, (number + 1) / self._rate
                    self._queue(self._weather.field(*times), *times, slot=slot)
                    self._listed[slot] = number
            lacking = self.lacking()
            if lacking == 0:
                return
            self.make_room(self.room + 2 * lacking)

    def make_room(self, room):
        """Take other lists, see `Impacts.make_room`; all is to be listed again."""
        super().make_room(room)
        self.forget()

    def forget(self):
        """Let `update` list all intervals again."""
        self._listed = [None] * len(self.lists.found)
