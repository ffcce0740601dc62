"""The account of water volumes: all water that came in is booked as standing or gone somewhere.

initial + rain + inflow = ground + film + airborne + obstacles + infiltrated + drained + outflow
"""

from dataclasses import dataclass

SUPPLY = ("initial", "rain", "inflow")
WHEREABOUTS = (
    "ground", "film", "airborne", "obstacles", "infiltrated", "drained", "outflow",
)  # fmt: skip


@dataclass
class Ledger:
    """Water volumes [m3] in float64, by where the water came from and where it is.

    initial : float. Water that lay on the map when the account was opened.
    rain : float. Rain since then, as a rate or as drops; with airborne water
        every drop that was released.
    inflow : float. Water that came from outside the map: through a `Stage` or a
        `Discharge`, and where keyframes raise the water level.
    ground : float. Water on the ground that can flow, with the traces too thin to
        flow.
    film : float. Water held back by the storage of the cells.
    airborne : float. Drops in the air.
    obstacles : float. Drops that hit an occluder.
    infiltrated, drained, outflow : float. Water that left through the ground,
        drains and open edges.
    """

    initial: float = 0.0
    rain: float = 0.0
    inflow: float = 0.0
    ground: float = 0.0
    film: float = 0.0
    airborne: float = 0.0
    obstacles: float = 0.0
    infiltrated: float = 0.0
    drained: float = 0.0
    outflow: float = 0.0

    @property
    def supplied(self) -> float:
        """Volume that was there or came in [m3]."""
        return sum(getattr(self, name) for name in SUPPLY)

    @property
    def accounted(self) -> float:
        """Volume that is booked as standing or gone [m3]."""
        return sum(getattr(self, name) for name in WHEREABOUTS)

    @property
    def residual(self) -> float:
        """Share of the supplied volume that is missing (positive) or too much (negative)."""
        supplied, accounted = self.supplied, self.accounted
        return -accounted if supplied == 0.0 else (supplied - accounted) / supplied

    def as_dict(self) -> dict:
        """Return all volumes [m3] and the residual (a share) by name."""
        return {**vars(self), "residual": self.residual}
