"""The water solver's arguments: checked at the border and turned into maps."""

import numpy as np

from rainsim.errors import ParameterError, require_choice, require_not_negative, require_positive

BOUNDARIES = ("wall", "open")
EDGES = ("west", "east", "south", "north")
LEAST_COURANT = 1e-3  # below, a second of simulated time takes hours
MOST_MANNING = 100.0  # s m^(-1/3); a dense wood has 0.2
MOST_VALUE = 1e12  # of any map; squares beyond overflow float32


def require_drains(drains, shape):
    """Return rows, columns and rates [m3/s] of drains given as (row, column, rate), or raise.

    Each cell is named once: drains of one cell are added up.
    """
    try:
        table = np.asarray([] if drains is None else drains, np.float64).reshape(-1, 3)
    except ValueError:
        raise ParameterError(
            "drains must be a list of (row, column, rate in m3/s), three numbers each"
        ) from None
    for row, column, rate in table:
        inside = 0 <= row < shape[0] and 0 <= column < shape[1]
        if not inside or row != int(row) or column != int(column):
            raise ParameterError(
                f"drain ({row:g}, {column:g}) is not a cell of the map; rows go from 0 to "
                f"{shape[0] - 1}, columns from 0 to {shape[1] - 1}"
            )
        require_not_negative("drain rate", float(rate), "m3/s")
    cells = table[:, 0].astype(np.int64) * shape[1] + table[:, 1].astype(np.int64)
    cells, which = np.unique(cells, return_inverse=True)
    rates = np.bincount(which, table[:, 2], len(cells))
    return cells // shape[1], cells % shape[1], rates


def refuse_viscosity(viscosity):
    """Raise ParameterError unless the kinematic viscosity [m2/s] is 0, as "paper" needs it."""
    if viscosity:
        raise ParameterError(
            f'kinematic_viscosity is {viscosity}, which scheme "paper" does not have; use '
            '"accurate"'
        )


def require_bed(bed, least=2):
    """Return `bed` as a float64 map of `least` cells a side or more, or raise ParameterError."""
    bed = np.asarray(bed, np.float64)
    if bed.ndim != 2 or min(bed.shape) < least:
        raise ParameterError(
            f"bed has shape {bed.shape}; it must be a map of at least {least} by {least} cells"
        )
    holes = int(np.count_nonzero(~np.isfinite(bed)))
    if holes:
        j, i = np.argwhere(~np.isfinite(bed))[0]
        raise ParameterError(
            f"bed is {bed[j, i]} at row {j}, column {i} ({holes} such cells); heights must be "
            "finite; `rainsim flow` takes cells without a height for walls"
        )
    return bed


def require_courant(courant, most):
    """Return `courant` (None stays None), or raise ParameterError if it is above `most`."""
    if courant is None:
        return None
    if not LEAST_COURANT <= require_positive("courant", courant) <= most:
        raise ParameterError(
            f"courant is {courant!r}; it must be from {LEAST_COURANT} to {most}; above, waves grow "
            "or a cell gives more water than it holds; below, a run does not end"
        )
    return float(courant)


def require_dtype(dtype):
    """Return the type of the fields, or raise ParameterError."""
    dtype = np.dtype(dtype)
    if dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise ParameterError(f"dtype is {dtype}; it must be float32 or float64")
    return dtype.type


def open_edges(boundary):
    """Return {edge: whether it is open} from one name or a dict of names."""
    if not isinstance(boundary, dict):
        boundary = dict.fromkeys(EDGES, boundary)
    for edge, kind in boundary.items():
        require_choice("boundary edge", edge, EDGES)
        require_choice(f"boundary {edge}", kind, BOUNDARIES)
    return {edge: boundary.get(edge, "wall") == "open" for edge in EDGES}


def field(name, value, shape, signed=False, most=MOST_VALUE):
    """Return `value` as a float64 map, or raise ParameterError that names its fault."""
    value = np.asarray(value, np.float64)
    if value.shape not in ((), shape):
        raise ParameterError(
            f"{name} has shape {value.shape}; it must be a number or of the bed's shape {shape}"
        )
    bad = ~(np.abs(value) <= most) if signed else ~((value >= 0) & (value <= most))
    if bad.any():
        rule = f"from {-most:g} to {most:g}" if signed else f"from 0 to {most:g}"
        raise ParameterError(f"{name} is {value[bad].flat[0]}; it must be {rule} everywhere")
    return np.broadcast_to(value, shape)


def require_drops(rows, columns, volumes, shape):
    """Raise ParameterError unless the arrays name cells of the map and volumes."""
    if not rows.shape == columns.shape == volumes.shape or rows.ndim != 1:
        raise ParameterError(
            f"rows, columns and volumes have shapes {rows.shape}, {columns.shape} and "
            f"{volumes.shape}; they must be one-dimensional and of one length"
        )
    for name, cells, size in (("rows", rows, shape[0]), ("columns", columns, shape[1])):
        if len(cells) and (cells.dtype.kind not in "iu" or cells.min() < 0 or cells.max() >= size):
            raise ParameterError(f"{name} must be whole numbers from 0 to {size - 1}")
    if not (np.isfinite(volumes) & (volumes >= 0)).all():
        bad = volumes[~(np.isfinite(volumes) & (volumes >= 0))][0]
        raise ParameterError(f"volumes hold {bad} m3; a drop's volume must be finite, not negative")


def mean_at_faces(values, h, bed, dry, axis):
    """Return the mean of the wet neighbours of each inner face along `axis`; 0 at closed faces.

    dry : float [m]. A face to a dry cell is closed unless the water stands that
        far above the cell's bed.
    """
    before, after = [slice(None)] * 2, [slice(None)] * 2
    before[axis], after[axis] = slice(None, -1), slice(1, None)
    before, after = tuple(before), tuple(after)
    if not np.any(values):  # at rest, as at the start: on large maps what follows takes seconds
        return np.zeros(h[before].shape)
    wet = (h > 0).astype(np.float64)
    count = wet[before] + wet[after]
    mean = (wet[before] * values[before] + wet[after] * values[after]) / np.maximum(count, 1)
    level = bed + h
    walled = (h[before] <= 0) & (bed[before] + dry >= level[after])
    walled |= (h[after] <= 0) & (bed[after] + dry >= level[before])
    return np.where(walled, 0.0, mean)
