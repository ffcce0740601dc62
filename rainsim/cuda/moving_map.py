"""Maps on a device of which the windows are sent that moving things change."""

from rainsim.cuda.driver import send


class MovingMap:
    """A map on a device that follows one of the host, over which things move.

    there : device array of shape (ny, nx, ...). Written to by `send`.
    still : object. What `there` has been filled from, see `send`; None: all is to
        be sent.
    """

    def __init__(self, there, still=None):
        self._there, self._windows, self.still = there, [], still

    def send(self, values, windows, still=None):
        """Send what differs from the map that is there.

        still : object. What stands for that map: if it is another one than
            before, all is sent.
        """
        parts = joined(self._windows, windows)
        if still is not self.still:
            rows, columns = values.shape[:2]
            parts = [(slice(0, rows), slice(0, columns))]
        for part in parts:
            send(self._there, values[part], part)
        self.still, self._windows = still, windows


def joined(*lists):
    """Return windows, no two of which overlap, that cover those of some lists.

    A window is a tuple of two slices, rows and columns. Those that overlap become one.
    """
    found = []
    for window in (window for each in lists for window in each):
        while (other := next((o for o in found if _overlap(o, window)), None)) is not None:
            found.remove(other)
            window = tuple(
                slice(min(a.start, b.start), max(a.stop, b.stop))
                for a, b in zip(other, window, strict=True)
            )
        found.append(window)
    return found


def _overlap(one, other):
    return all(a.start < b.stop and b.start < a.stop for a, b in zip(one, other, strict=True))
