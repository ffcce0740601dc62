"""How many threads draw pictures in motion: all, or one fewer, whichever was faster of late.

A browser on the same machine that draws its page without a GPU takes a core or two. A kernel's
threads wait for the slowest of them, so that one thread less may then be faster.
"""

from collections import deque
from statistics import median

KEPT = 5  # pictures of each choice by whose median it is judged
FIRST_TRIES = 3  # pictures of each choice before there is a judgement
TRY_EVERY = 24  # pictures, after which the slower choice is tried again


class ThreadChoice:
    """Chooses how many of `most` threads draw the next picture in motion."""

    def __init__(self, most):
        self._times = {count: deque(maxlen=KEPT) for count in {most, max(most - 1, 1)}}
        self._most, self._since = most, 0

    @property
    def faster(self):
        """The number of threads that was faster of late; all of them while that is not known."""
        if any(len(times) < FIRST_TRIES for times in self._times.values()):
            return self._most
        return min(self._times, key=lambda count: median(self._times[count]))

    def next(self):
        """Return the number of threads for the next picture."""
        fewest = min(self._times, key=lambda count: (len(self._times[count]), -count))
        if len(self._times[fewest]) < FIRST_TRIES:
            return fewest
        self._since += 1
        if self._since < TRY_EVERY:
            return self.faster
        self._since = 0
        return next((count for count in self._times if count != self.faster), self._most)

    def took(self, count, pace):
        """Note the time that a picture took with a number of threads, divided by its size."""
        if count in self._times:
            self._times[count].append(pace)
