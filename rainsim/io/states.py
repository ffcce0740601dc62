"""States of the water as files: those of a frame (`SimState`), and those of a `WaterSolver`."""

import hashlib
import json
from dataclasses import dataclass, field, replace

import numpy as np

from rainsim.errors import InputError
from rainsim.io.arrays import TEXT, Field, read_arrays, write_arrays
from rainsim.io.files import json_number, parsed_json
from rainsim.ledger import SUPPLY, WHEREABOUTS

# in m, s and m/s; the wind is that at half the height of the fall
DRIP_COLUMNS = ("x", "y", "top", "bottom", "diameter", "begin", "end", "wind_x", "wind_y")
NO_DRIPS = np.zeros((0, len(DRIP_COLUMNS)))
NO_IDS = np.zeros(0, np.uint64)


@dataclass(frozen=True)
class SimState:
    """Water at one frame's time.

    Attributes
    ----------
    index : int
        Of the frame.
    time : float [s]
    depth : ndarray of shape (ny, nx), float32 [m]
    velocity : ndarray of shape (2, ny, nx), float32 [m/s]
        u, v at cell centres.
    slopes : ndarray of shape (2, n, n), float32
        Ripple slopes d eta/dx and d eta/dy on a periodic tile of `tile_size`.
    tile_size : float [m]
    ledger : dict
        Volumes in m3, see `rainsim.ledger`.
    notes : tuple of str
    drips : ndarray of shape (m, 9), float64
        Drops from edges that are in the air or have just landed, see `DRIP_COLUMNS`.
    drip_id : ndarray of shape (m,), uint64
    top_water : ndarray of shape (n,), float64 [m3]
        On each of the terrain's tops, see `water.top_water`.
    """

    index: int
    time: float
    depth: np.ndarray
    velocity: np.ndarray
    slopes: np.ndarray
    tile_size: float
    ledger: dict
    notes: tuple = ()
    drips: np.ndarray = field(default_factory=NO_DRIPS.copy)
    drip_id: np.ndarray = field(default_factory=NO_IDS.copy)
    top_water: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def shown_by(self, index):
        """Return this state as the one that the frame `index` shows."""
        return replace(self, index=index)

    def shown_at(self, time):
        """Return this state as what a camera sees at a time [s] of the frame: drops move on."""
        return replace(self, time=time)


VERSION = 2  # version 1 lists the drops that fell, too
STATE, STATE_REMEDY = "water state", "`rainsim simulate` writes it; simulate again"
LONGEST = 1e9  # s, of times in a file
FRAME_RATES, ROUNDED = (0.1, 9999.0), 1 + 1e-9  # frames/s, as of the setting fps
LONGEST_FALL, LARGEST_DROP = 500.0, 0.05  # s, m: of drips
_FIELDS = {
    "depth": Field("float32", ("ny", "nx"), 0, 1e5),
    "velocity": Field("float32", (2, "ny", "nx"), -1e4, 1e4),
    "slopes": Field("float32", (2, "tile cells", "tile cells"), -1e4, 1e4),
    "drips": Field("float64", ("drips", len(DRIP_COLUMNS)), -LONGEST, LONGEST),
    "drip_id": Field("uint64", ("drips",), 0, 2**64 - 1),
    "top_water": Field("float64", ("tops",), 0, 1e9),
}
_OTHERS = {
    "index": Field("int64", (), 0, 99_999),
    "time": Field("float64", (), 0, LONGEST),
    "tile_size": Field("float64", (), 0.01, 100),
    "ledger": Field(TEXT),
    "notes": Field(TEXT),
    "ground": Field(TEXT, needed=False),  # digest of the bed; not in the files of old versions
}


def write_state(path, state, terrain=None):
    """Write the `SimState` `state` to `path` as an uncompressed .npz.

    With `terrain`, the `Terrain` that the water is on, `read_state` refuses it on any other.
    """
    others = {
        "index": np.int64(state.index), "time": np.float64(state.time),
        "tile_size": np.float64(state.tile_size), "ledger": json.dumps(state.ledger),
        "notes": json.dumps(state.notes),
    }  # fmt: skip
    if terrain is not None:
        others["ground"] = digest(terrain.bed)
    write_arrays(path, VERSION, {n: getattr(state, n) for n in _FIELDS} | others)


def read_state(path, terrain=None):
    """Return the `SimState` that `write_state` wrote, all of it checked.

    Parameters
    ----------
    path : path-like
    terrain : Terrain, optional
        If given the state must be one of water on it.

    Examples
    --------
    >>> rainsim.write_state("00000.npz", state)
    >>> bool((rainsim.read_state("00000.npz", terrain).depth == state.depth).all())
    True
    """
    found = read_arrays(path, STATE, _FIELDS | _OTHERS, VERSION, STATE_REMEDY)
    facts = {"ledger": parsed_json(found["ledger"]), "notes": parsed_json(found["notes"])}
    tops = 0 if terrain is None else len(terrain.tops)
    index, time = int(found["index"]), float(found["time"])
    ground = None if terrain is None else digest(terrain.bed)
    for wrong, text in (
        (not _are_volumes(facts["ledger"]), "its ledger is not that of rainsim"),
        (not _is_frame(index, time), f"its frame {index} is at {time:g} s; frame 0 must be at 0 s "
         f"and others at {FRAME_RATES[0]:g} to {FRAME_RATES[1]:g} frames/s"),
        (not _are_texts(facts["notes"]), "its notes are not a list of texts"),
        (found["slopes"].shape[1] < 2, "its tile of ripples has no cells"),
        (not _fall(found["drips"]), "its drips do not fall"),
        (terrain is not None and found["depth"].shape != terrain.grid.shape,
         "it is not of this height map, whose shape is another"),
        (terrain is not None and len(found["top_water"]) not in (0, tops),
         "it is not of this height map, which has other tops"),
        (terrain is not None and found.get("ground", ground) != ground,
         "it is not of this height map, whose ground is another"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"{path} is no {STATE} of rainsim ({text}); {STATE_REMEDY}")
    return SimState(
        index=index, time=time, tile_size=float(found["tile_size"]),
        ledger=facts["ledger"], notes=tuple(facts["notes"]),
        **{n: found[n] for n in _FIELDS},
    )  # fmt: skip


def _are_volumes(ledger):
    """Whether a value read from JSON is an account of volumes."""
    names = (*SUPPLY, *WHEREABOUTS)
    return isinstance(ledger, dict) and all(json_number(ledger.get(n)) is not None for n in names)


def _is_frame(index, time):
    """Whether a time [s] is that of a frame at a rate that settings can have."""
    low, high = FRAME_RATES
    if index == 0:
        return time == 0
    return low * time <= index * ROUNDED and index <= high * time * ROUNDED


def _are_texts(notes):
    return isinstance(notes, list) and all(isinstance(note, str) for note in notes)


def _fall(drips):
    """Whether the rows of drips have a size and fall for a while."""
    diameter, begin, end = drips[:, 4], drips[:, 5], drips[:, 6]
    fits = (diameter > 0) & (diameter <= LARGEST_DROP)
    return bool((fits & (end >= begin) & (end - begin <= LONGEST_FALL)).all())


# --- of a solver ----------------------------------------------------------------------------------

SOLVER = "state of the water solver"
SOLVER_REMEDY = "write it with WaterSolver.save; `rainsim flow` does so without --resume"
SOLVER_VERSION = 3  # version 1 cannot go on, 2 does not say its level and Courant number


def digest(*arrays):
    """Return the SHA-256 of the bytes of arrays, 64 hexadecimal digits."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def write_solver(path, made_of, arrays):
    """Write the state of a solver: arrays by name, and a text that says what it was made of."""
    write_arrays(path, SOLVER_VERSION, {**arrays, "made_of": np.array(made_of)})


def read_solver(path, made_of, wanted):
    """Return `write_solver`'s arrays, as `wanted` has them; InputError if made differently."""

    def read(fields):
        versions = SOLVER_VERSION, SOLVER_REMEDY, SOLVER_VERSION
        return read_arrays(path, SOLVER, fields, *versions)

    if read({"made_of": Field(TEXT)})["made_of"] != made_of:
        raise InputError(
            f"{path} is the state of a solver that was made differently; make this one with the "
            "same bed, scheme, type and conditions"
        )
    return read({
        name: Field(TEXT) if array.dtype.kind == "U" else Field(array.dtype.name, array.shape)
        for name, array in wanted.items()
    })  # fmt: skip
