"""Layouts of streets: the places of ends, drains, dips, cars, lamps, and side streets.

The built-in street has one `Layout` that was made by hand (`road.LAYOUT`); a street of a given
length has one that `long_layout` draws by a seed.
"""

from dataclasses import dataclass, replace

import numpy as np

SIDE_KERB, SIDE_FACADE = 2.9, 5.0  # m from a side street's middle: its kerb begins, houses stand
CORNER = 2.0  # m, radius of the kerb at a corner
SIDE_REACH = 46.0  # m from the middle of the street to the end of a side street
BEFORE, AFTER = -20.0, 34.0  # m of street behind the first place of a drive, and past the last
FIRST_SIDE, SIDE_STEP = 52.0, 96.0  # m to the first side street, and from one to the next
ZEBRA = (-9.6, -6.4)  # m from the middle of a side street, of the zebra crossing before it
AT_CORNER = 7.0  # m from the middle of a side street to the drains at its corners
DRAIN_STEP = 18.0  # m from a drain to the next
BESIDE = 3.27  # m from the middle of the street to the middle of a drain
SLOT = 5.9  # m of kerb that a parked car takes
LAMP_STEP = 19.0  # m, from a lamp to the next on the other side
CLEAR = 12.0  # m from the middle of a side street within which no car parks
CAMBER = 0.072  # m: 2.5 % from the crown to the gutter
FINE, LONG = 1.08, 1.5  # factors on the cells of the ground, and on their length along the street
STONES = 900  # single stones of the asphalt per metre
MARGIN = 14.0  # m from a piece of street up to which drains and dips have to do with it


@dataclass(frozen=True, slots=True)
class Layout:
    """The layout of a street: places by x along and y across it, from its middle [m].

    Between the places `near` the ground is as fine as `cell` says, and single stones and joints are
    seen.
    """

    ends: tuple  # first and last x
    drains: np.ndarray  # (n, 2), x and y
    dips: np.ndarray  # (n, 6), settlements: x, y, depth, half length, half width, angle [rad]
    patches: tuple = ()  # of (x0, x1, y0, y1, tone), mended asphalt
    crossings: tuple = ()  # of (x0, x1), zebra crossings
    bays: tuple = ()  # of (x0, x1), where parking bays are marked
    covers: tuple = ()  # of (x, y), manholes
    cracks: tuple = ()  # of (x, y, direction [rad], length), sealed
    near: tuple = (2.0, 21.0)  # x
    cell: tuple = (0.0052, 0.03)  # growth of cells per metre ahead of `near` and behind it
    fine: float = 1.0  # factor on the ground's cells
    long: float = 1.0  # factor on their length along the street
    stones: int = 0  # number of single stones
    camber: float = 0.058  # that the road falls to the gutter
    sides: tuple = ()  # x of the middles of side streets

    def piece(self, first, last):
        """Return the layout of the street from x = `first` to `last`, with all that acts there.

        Drains and dips near the piece shape its ground; what is drawn once, such as a cover, is
        only in the piece that holds its x.
        """
        drains, dips = (
            values[(values[:, 0] > first - MARGIN) & (values[:, 0] < last + MARGIN)]
            for values in (self.drains, self.dips)
        )
        inside = {
            name: tuple(v for v in getattr(self, name) if first <= v[0] < last)
            for name in ("covers", "cracks")
        }
        return replace(
            self, ends=(first, last), drains=drains, dips=dips, near=(first, last),
            stones=round(self.stones * (last - first) / (self.ends[1] - self.ends[0])), **inside,
        )  # fmt: skip

    @staticmethod
    def between(ends, sides, reach):
        """Yield the first and last x of the street's stretches `reach` [m] off its side streets."""
        cuts = ends[0], *(x + sign * reach for x in sides for sign in (-1, 1)), ends[1]
        yield from zip(cuts[::2], cuts[1::2], strict=True)

    def beside_side_street(self, x, reach):
        """Return whether places x are within `reach` [m] of the middle of a side street."""
        away = np.abs(np.asarray(x)[..., None] - np.array(self.sides))
        return (away < reach).any(axis=-1)


@dataclass(frozen=True, slots=True)
class Standing:
    """The things that stand on the ground of a street."""

    cars: tuple  # rows as `cars.PARKED`
    lamps: tuple  # of (x, side)
    bollards: tuple  # of (x, side)
    trees: tuple  # of (x, side, height, half width), m

    def piece(self, first, last):
        """Return the things that stand between x = `first` and `last`."""
        return Standing(*(
            tuple(row for row in getattr(self, name) if first <= row[0] < last)
            for name in self.__slots__
        ))  # fmt: skip


def long_layout(length, seed, shapes):
    """Return the `Layout` and the `Standing` of a street of a length [m] with cars of `shapes`."""
    rng = np.random.Generator(np.random.PCG64((seed, 11)))
    ends = (BEFORE, float(length))
    sides = tuple(np.arange(FIRST_SIDE, length - 30.0, SIDE_STEP))
    layout = Layout(
        ends=ends, drains=np.empty((0, 2)), dips=_dips(ends, rng), sides=sides, cell=(0.0, 0.0),
        fine=FINE, long=LONG,
        camber=CAMBER, stones=round(STONES * (ends[1] - ends[0])),
    )  # fmt: skip
    crossings = tuple((x + ZEBRA[0], x + ZEBRA[1]) for x in sides)
    crossings += ((14.0, 17.2),) if length < FIRST_SIDE + 30 else ()
    layout = replace(layout, drains=_drains(layout), crossings=crossings)
    places = np.arange(ends[0], ends[1], 9.0)
    patches = tuple(
        (x, x + rng.uniform(1.5, 7), y, y + rng.uniform(0.5, 1.6), rng.uniform(0.82, 0.92))
        for x, y in zip(places, rng.uniform(-2.2, 0.9, len(places)), strict=True)
        if rng.random() < 0.45
    )
    covers = tuple((x + 4.0, y) for x, y in zip(places[::2], rng.uniform(-0.6, 0.6, len(places)),
                                                strict=False))  # fmt: skip
    cracks = tuple(
        (x + rng.uniform(0, 4), rng.uniform(-2, 2), rng.uniform(-np.pi, np.pi),
         rng.uniform(1.6, 4.2))
        for x in np.arange(ends[0] + 2, ends[1] - 4, 4.5) if rng.random() < 0.8
    )  # fmt: skip
    bays = tuple(layout.between(ends, sides, CLEAR))
    layout = replace(layout, patches=patches, covers=covers, cracks=cracks, bays=bays)
    return layout, _standing(layout, rng, shapes)


def _dips(ends, rng):
    """Return settlements of the road: in the tracks of tyres and before the gutters."""
    x = np.arange(ends[0], ends[1], 1.5) + rng.uniform(-0.9, 0.9, len(np.arange(*ends, 1.5)))
    n = len(x)
    middle = rng.random(n) < 0.7
    side = np.where(rng.random(n) < 0.5, -1, 1)
    y = side * np.where(middle, rng.uniform(0.2, 1.0, n), rng.uniform(2.2, 3.05, n))
    depth = np.where(middle, rng.uniform(0.022, 0.042, n), rng.uniform(0.014, 0.022, n))
    along = rng.uniform(1.0, 2.5, n)
    across = np.where(middle, rng.uniform(0.45, 0.95, n), rng.uniform(0.3, 0.4, n))
    return np.column_stack([x, y, depth, along, across, rng.uniform(-0.12, 0.12, n)])


def _drains(layout):
    """Return places of drains: one every 18 m of gutter, and at the corners of side streets."""
    first, last = layout.ends
    rows = []
    for side, shift in ((-1, 0.0), (1, 0.5 * DRAIN_STEP)):
        for x in np.arange(first + 3 + shift, last, DRAIN_STEP):
            if not layout.beside_side_street(x, AT_CORNER + 4.0):
                rows.append((x, side * BESIDE))
        rows += [(x + s * AT_CORNER, side * BESIDE) for x in layout.sides for s in (-1, 1)]
    return np.array(sorted(rows))


def _standing(layout, rng, shapes):
    """Draw at random the things that stand along a street."""
    first, last = layout.ends
    cars, trees, bollards = [], [], []
    for side in (-1, 1):
        for x in np.arange(first + 3, last - 4, SLOT):
            at, taken = x + rng.uniform(-0.45, 0.45), rng.random() < 0.62
            shape = shapes[int(rng.choice(3, p=(0.45, 0.35, 0.2)))]
            paint, lit = _paint(rng), rng.random() < 0.25
            on_crossing = any(a - 4.5 < at < b + 4.5 for a, b in layout.crossings)
            if taken and not on_crossing and not layout.beside_side_street(at, CLEAR + 1.5):
                cars.append((at, side, -side, shape, paint, lit))
        for x in np.arange(first + 9 + 4 * side, last, 17.0):
            x = x + rng.uniform(-1.5, 1.5)
            size = rng.uniform(0.92, 1.08)
            if rng.random() < 0.55 and not layout.beside_side_street(x, 8.5):
                trees.append((x, side, 4.8 * size, 1.4 * size))
        for x in layout.sides:
            bollards += [(x + s * d, side) for s in (-1, 1) for d in (5.6, 6.9)]
    lamps = [
        (x, 1 - 2 * (k % 2))
        for k, x in enumerate(np.arange(first + 6.2, last, LAMP_STEP))
        if not layout.beside_side_street(x, 5.6)
    ]
    trees = [t for t in trees if all(t[1] != s or abs(t[0] - x) > 2.5 for x, s in lamps)]
    return Standing(tuple(sorted(cars, key=lambda c: c[0])), tuple(lamps), tuple(sorted(bollards)),
                    tuple(sorted(trees)))  # fmt: skip


def _paint(rng):
    """Return the colour of a car: most are grey, white or black."""
    if rng.random() < 0.62:
        return tuple(np.array([1.0, 1.0, 1.01]) * rng.choice((0.10, 0.17, 0.27, 0.40, 0.55, 0.63)))
    base = np.array([(0.36, 0.05, 0.05), (0.09, 0.17, 0.34), (0.08, 0.16, 0.12),
                     (0.44, 0.39, 0.29), (0.16, 0.22, 0.30)])[int(rng.integers(0, 5))]  # fmt: skip
    return tuple(base * rng.uniform(0.8, 1.25))
