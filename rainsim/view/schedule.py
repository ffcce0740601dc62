"""Which picture is drawn next for whom, and at which size.

Each client has a generation: a number that grows with everything that makes its picture out of
date. A small picture is shown even if it is a little late, or a drag would show none; a large one
is given up between two stages as soon as its generation is no longer the client's.
"""

from dataclasses import dataclass, field

LEAST_WIDTH, FULL_WIDTH = 324, 648  # px, unless chosen otherwise
STILL_AFTER = 0.1  # s without a change, then a picture is refined
TARGET = 0.045  # s that a small picture may take: two of them and their way stay below 150 ms
FIXED_PIXELS = 500_000  # a picture costs as much as so many pixels before its first pixel
FIRST_GUESS = 2e-7  # s a pixel, until one was measured
LEAST_HEIGHT = 8  # px
USUAL_ASPECT = 1.5  # width over height
SMALL, SHARP, EXACT = range(3)  # steps in which a picture is refined


@dataclass
class Viewer:
    """One page that looks.

    view : object. Its camera; None until it is known.
    changed : float [s]. When the generation last grew.
    shown : tuple of (int, int, int). Generation, width [px] and step of the
        picture that it was shown last.
    """

    view: object = None
    aspect: float = 1.5
    generation: int = 0
    changed: float = 0.0
    shown: tuple = (-1, 0, -1)
    served: float = 0.0


@dataclass(frozen=True)
class Job:
    """One picture that is to be drawn.

    step : int. SMALL, SHARP (full size, from parts that may be out of date) or
        EXACT.
    simple : bool. Whether reflections are simplified.
    """

    client: object
    generation: int
    view: object
    width: int
    height: int
    step: int
    simple: bool = False


def pace_of(job, seconds):
    """Return the time [s] that a job's picture took, by its pixels and its fixed cost."""
    return seconds / (job.width * job.height + FIXED_PIXELS)


@dataclass
class Schedule:
    """Who is drawn for next; knows the time only from its callers.

    full, least : int [px]. Width of a picture at rest, and the least while
        something moves.
    adapts : bool. Whether pictures are smaller while something moves.
    simplifies : bool. Whether pictures have simple reflections while something
        moves, if the machine is too slow for others of the least width.
    plays : bool. Whether time goes on: then pictures are not refined.
    stale : bool. Whether parts are out of date, so that SHARP and EXACT differ.
    """

    full: int = FULL_WIDTH
    least: int = LEAST_WIDTH
    adapts: bool = True
    simplifies: bool = True
    plays: bool = False
    stale: bool = False
    clients: dict = field(default_factory=dict)
    _pace: float = FIRST_GUESS  # s a pixel
    _simple_pace: float = FIRST_GUESS  # of those with simple reflections

    def add(self, key, now):
        """Add a client to the schedule."""
        self.clients[key] = Viewer(changed=now, served=now)

    def remove(self, key):
        """Forget a client."""
        self.clients.pop(key, None)

    def move(self, key, view, aspect, now):
        """Note the camera of a client; return whether it is another one."""
        client = self.clients.get(key)
        if client is None or (client.view == view and client.aspect == aspect):
            return False
        client.view, client.aspect = view, aspect
        client.generation, client.changed = client.generation + 1, now
        return True

    def change(self, now, key=None):
        """Note that the pictures of all clients, or of one, are out of date."""
        for own, client in self.clients.items():
            if key in (None, own):
                client.generation, client.changed = client.generation + 1, now

    def is_current(self, job):
        """Return whether a job's picture would still be the client's."""
        client = self.clients.get(job.client)
        return client is not None and client.generation == job.generation

    def may_go_on(self, job):
        """Return whether a job that has begun is still worth finishing."""
        return job.client in self.clients and (job.step == SMALL or self.is_current(job))

    @property
    def is_slow(self):
        """Whether pictures that move get simple reflections."""
        pixels = self.least**2 / USUAL_ASPECT + FIXED_PIXELS
        # While time plays mirrored pictures are kept from one picture to the next.
        wanted = self.adapts and self.simplifies and not self.plays
        return wanted and self._pace * pixels > TARGET

    def moving_width(self):
        """Return the width [px] of pictures while something moves, by how long they took."""
        if not self.adapts:
            return self.full
        pixels = TARGET / (self._simple_pace if self.is_slow else self._pace) - FIXED_PIXELS
        width = int(max(pixels * USUAL_ASPECT, 0) ** 0.5) // 8 * 8
        return min(max(width, self.least), self.full)

    def next(self, now):
        """Return the next `Job` and None, or None and the seconds after which to ask again.

        No seconds either: there is nothing to do until something changes.
        """
        ready = {key: c for key, c in self.clients.items() if c.view is not None}
        fresh = [key for key, c in ready.items() if c.shown[0] != c.generation]
        if fresh:
            key = min(fresh, key=lambda k: ready[k].served)
            width = self.moving_width()
            return self._job(key, width, SMALL), None
        waits = []
        for key in sorted(ready, key=lambda k: ready[k].served):
            client = ready[key]
            step = self._step_after(client)
            if step is None:
                continue
            left = client.changed + STILL_AFTER - now
            if left <= 0:
                return self._job(key, self.full, step), None
            waits.append(left)
        return None, min(waits, default=None)

    def _step_after(self, client):
        """Return the step that refines the picture a client was shown; None if there is none."""
        _, width, step = client.shown
        if self.plays or step == EXACT:
            return None
        sharp = width >= self.full
        return SHARP if self.stale and not sharp else EXACT

    def _job(self, key, width, step):
        client = self.clients[key]
        height = max(round(width / client.aspect), LEAST_HEIGHT)
        simple = step == SMALL and self.is_slow
        return Job(key, client.generation, client.view, width, height, step, simple)

    def done(self, job, seconds, now):
        """Note that a job's picture was shown, and how long it took to draw [s]."""
        pace = pace_of(job, seconds)
        name = "_simple_pace" if job.simple else "_pace"
        # A first picture after a change compiles or sets up: it says little of the next.
        before = getattr(self, name)
        setattr(self, name, before + 0.3 * (min(pace, 4 * before) - before))
        client = self.clients.get(job.client)
        if client is not None:
            client.shown = (job.generation, job.width, job.step)
            client.served = now

    def given_up(self, job, now):
        """Note that a job was given up before its picture was finished."""
        client = self.clients.get(job.client)
        if client is not None:
            client.served = now
