"""Time of the rain: it plays, stands still, steps or runs in a loop, at true speed or slower."""

from dataclasses import dataclass


@dataclass
class PlayClock:
    """The index of the state that is shown, and when the next one is due.

    No state is left out: where a machine is too slow for the speed that is wanted, time is slower.

    frames : int. Number of states; after the last one follows the first, or the
        clock stops.
    """

    frames: int
    fps: float
    index: int = 0
    speed: float = 1.0
    plays: bool = False
    loops: bool = True
    _due: float = 0.0

    def play(self, now):
        """Let time go on."""
        if self.index + 1 >= self.frames and not self.loops:
            self.index = 0
        self.plays, self._due = self.frames > 1, now + self.interval

    def pause(self):
        """Let time stand still."""
        self.plays = False

    def go_to(self, index):
        """Show a state; return whether it is another one."""
        index = min(max(int(index), 0), self.frames - 1)
        moved, self.index = index != self.index, index
        return moved

    def resize(self, frames, fps):
        """Take over another number of states and states in a second."""
        self.frames, self.fps = frames, fps
        self.index = min(self.index, frames - 1)

    @property
    def interval(self):
        """True seconds from one state to the next."""
        return 1 / (self.fps * self.speed)

    @property
    def time(self):
        """Time of the present state [s of rain]."""
        return self.index / self.fps

    def wait(self, now):
        """Return the seconds until the next state is due; None if time stands still."""
        return max(self._due - now, 0.0) if self.plays else None

    def tick(self, now):
        """Go on to the next state if it is due; return whether it was."""
        if not self.plays or now < self._due:
            return False
        self._due = max(self._due + self.interval, now)  # a late machine does not hurry after
        if self.index + 1 < self.frames:
            self.index += 1
        elif self.loops:
            self.index = 0
        else:
            self.plays = False
        return True
