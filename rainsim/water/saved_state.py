"""The whole state of a `WaterSolver` as a file, so that a run can stop and go on."""

from __future__ import annotations

import hashlib
import json

import numpy as np

from rainsim.errors import InputError
from rainsim.io.arrays import TEXT, Field, read_arrays, write_arrays
from rainsim.ledger import Ledger

VERSION = 1
KIND = "state of the water solver"
REMEDY = "write it with WaterSolver.save"
TIMES = "time", "_unbooked_time", "_advances", "_has_deposits", "settled", "courant"


def _made_of(solver):
    """Return what the solver was made of: it must be the same where the state is read."""
    flow = solver.flow
    ground = (solver.storage, solver.infiltration, *solver.drains)
    rough = flow.roughness
    kept = {
        "scheme": solver._asked_scheme, "spacing": solver.spacing, "gravity": solver.gravity,
        "type": np.dtype(solver._type).name,
        "ground": _digest(flow.bed, *ground, *(() if rough is None else (rough,))),
        "conditions": [[type(c).__name__, c.edge, len(c.rows)] for c in solver.conditions],
    }  # fmt: skip
    return json.dumps(kept, sort_keys=True)


def _digest(*arrays):
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def write_solver(solver, path):
    """Write the state of a `WaterSolver`."""
    account = solver.ledger.as_dict()
    account.pop("residual")
    write_arrays(path, VERSION, {
        **solver.flow.saved(), "film": solver.film,
        "times": np.array([float(getattr(solver, name)) for name in TIMES]),
        "volumes": np.array([[c.volume, c.flow] for c in solver.conditions]).reshape(-1, 2),
        "account": np.array(list(account.values())),
        "choice": np.array(json.dumps([solver.scheme, solver.reason])),
        "made_of": np.array(_made_of(solver)),
    })  # fmt: skip


def read_solver(solver, path):
    """Take over a state that `write_solver` wrote.

    Raises
    ------
    InputError
        If the file is no such state, or one of a solver that was made differently.
    """
    wanted = {**solver.flow.saved(), "film": solver.film}
    names = list(solver.ledger.as_dict())[:-1]
    fields = {name: Field(array.dtype.name, array.shape) for name, array in wanted.items()}
    fields = {"made_of": Field(TEXT), "choice": Field(TEXT), **fields}
    fields["times"] = Field("float64", (len(TIMES),))
    fields["account"] = Field("float64", (len(names),))
    fields["volumes"] = Field("float64", (len(solver.conditions), 2))
    made_of = read_arrays(path, KIND, {"made_of": Field(TEXT)}, VERSION, REMEDY)["made_of"]
    if made_of != _made_of(solver):
        raise InputError(
            f"{path} is the state of a solver that was made differently; make this one with the "
            "same bed, scheme, type and conditions"
        )
    arrays = read_arrays(path, KIND, fields, VERSION, REMEDY)
    solver.flow.restore(arrays)
    solver.film[:] = arrays["film"]
    for name, number in zip(TIMES, arrays["times"].tolist(), strict=True):
        kind = {"_advances": int, "_has_deposits": bool, "settled": bool}.get(name, float)
        setattr(solver, name, kind(number))
    for condition, numbers in zip(solver.conditions, arrays["volumes"].tolist(), strict=True):
        condition.volume, condition.flow = numbers
    solver.scheme, solver.reason = json.loads(arrays["choice"])
    solver._ledger = Ledger(**dict(zip(names, arrays["account"].tolist(), strict=True)))
    solver._book_standing_water()
