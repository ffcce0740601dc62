"""Where an actor's tyres touch the road: as its description says, or derived from a car's box.

A box has no wheels in it. Those of a car are put at fixed shares of its box, which are those of a
common hatchback and saloon within some centimetres; a description can name them exactly.
"""

import numpy as np

from rainsim.errors import ParameterError

WHEELED = frozenset({"car", "vehicle", "van", "truck", "bus", "taxi", "suv", "pickup"})
NO_WHEELS = np.zeros((0, 5))
MOST_WHEELS = 64
# Of a car without wheels of its own, as shares of its box; x is ahead, z is up.
BASE = 0.30  # of the length: each axle's distance from the middle
TYRE_WIDTH, TYRE_RADIUS = 0.113, 0.215  # of the box's width and height
# What is no road vehicle: a lorry with trailer is 25 m long and 4.3 m high, a toy is no car.
LENGTHS, WIDTHS, HEIGHTS = (1.0, 30.0), (0.5, 5.0), (0.5, 6.0)  # m
REMEDY = 'correct its box or the scale, give it wheels or `wheels: []`, or set spray = "off"'


def wheels_of(actor, unit):
    """Return the tyres of an actor in metres.

    unit : float [m / capture unit]
    Returns float64 array (n, 5) [m]. x, y, z of the middle of each contact patch
        in the actor frame, the tyre's width and its radius. Without wheels of its
        own an actor of a class in `WHEELED` has four.
    Raises ParameterError if the box from which wheels are derived is not that of
        a road vehicle.
    """
    if actor.wheels is not None:
        return np.asarray(actor.wheels, np.float64).reshape(-1, 5) * unit
    if actor.kind.lower() not in WHEELED:
        return NO_WHEELS
    centre, size = actor.box * unit
    limits = zip(("long", "wide", "high"), size, (LENGTHS, WIDTHS, HEIGHTS), strict=True)
    for word, length, (low, high) in limits:
        if not low <= length <= high:
            raise ParameterError(
                f"actor {actor.id} of class {actor.kind} is {length:.3g} m {word}; a road vehicle "
                f"must be from {low:g} to {high:g} m {word}; {REMEDY}"
            )
    width, radius = TYRE_WIDTH * size[1], TYRE_RADIUS * size[2]
    x, y = BASE * size[0], 0.5 * (size[1] - width)
    low = centre[2] - 0.5 * size[2]
    return np.array([
        (centre[0] + a * x, centre[1] + b * y, low, width, radius) for a in (1, -1) for b in (1, -1)
    ])  # fmt: skip
