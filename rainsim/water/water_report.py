"""The report of one call of `WaterSolver.advance`."""

from dataclasses import dataclass

from rainsim.ledger import Ledger


@dataclass(frozen=True, slots=True)
class WaterReport:
    """Report of one call of `WaterSolver.advance`.

    Attributes
    ----------
    time : float [s]
        Since the state was set.
    substeps : int
        Steps taken; 0 if nothing moved and nothing was added.
    scheme : str
        Scheme that ran.
    reason : str
        Why this scheme.
    ledger : Ledger
        Volumes [m3] since the state was set; a copy.
    residual : float
        The ledger's residual, relative to the water supplied.
    max_speed : float [m/s]
        Largest face speed at the end.
    min_depth : float [m]
        Smallest depth at the end.

    Examples
    --------
    >>> report = rainsim.WaterSolver(np.zeros((8, 8)), spacing=0.1).advance(1.0, rain=1e-5)
    >>> report.time
    1.0
    """

    time: float
    substeps: int
    scheme: str
    reason: str
    ledger: Ledger
    residual: float
    max_speed: float
    min_depth: float
