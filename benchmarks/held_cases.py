"""Channels between a given discharge and a given level: cases of `benchmarks hydraulics`.

What enters at the west edge is a `Discharge`, the level at the east edge a `Stage`, as SWASHES has
it (Delestre et al. 2013; MacDonald et al. 1997). Numbers are from memory; each solution is exact
for them.
"""

from __future__ import annotations

import numpy as np

from benchmarks.cases import Case
from benchmarks.hydraulic_cases import (
    BUMP_FLOW,
    BUMP_LENGTH,
    BUMP_STAGE,
    CHANNEL,
    CHANNEL_FLOW,
    ROWS,
    bed_of,
    bump_depth,
    critical_depth,
    depth_of_head,
    first_bump,
    head,
    steady_slope,
)
from rainsim.water.conditions import Discharge, Stage

TRANQUIL_FLOW, TRANQUIL_STAGE = 4.42, 2.0  # m2/s, m: SWASHES' bump without a jump
TRANQUIL_MANNING = 0.033  # s m^(-1/3)


def _held(name, cells, length, duration, flow, bed_of, exact_of, start_of, manning=0.0):
    """Return a channel of `flow` [m2/s] whose last cell has the level of the exact solution.

    `bed_of`, `exact_of` and `start_of` (x) [m] are bed, exact depth and depth at the start; where
    `start_of` is None the flow begins as the exact one.
    """
    spacing = length / cells
    x = np.tile((np.arange(cells) + 0.5) * spacing, (ROWS, 1))
    bed, exact = np.tile(bed_of(x[0]), (ROWS, 1)), np.tile(exact_of(x[0]), (ROWS, 1))
    depth = exact if start_of is None else np.tile(start_of(x[0]), (ROWS, 1))
    level = bed[0, -1] + exact[0, -1]
    extra = {
        "conditions": lambda: [Discharge("west", flow * ROWS * spacing), Stage("east", level)],
        "u": None if start_of else flow / exact,
    }
    return Case(
        name, cells, x, bed, depth, spacing, duration, exact, manning=manning, extra=extra,
    )  # fmt: skip


def bump_jump(cells):
    """0.18 m2/s over SWASHES' bump become fast and jump back to the level held at the outlet."""
    return _held(
        "bump, jump", cells, BUMP_LENGTH, 300.0, BUMP_FLOW, first_bump, bump_depth,
        lambda x: BUMP_STAGE - first_bump(x),
    )  # fmt: skip


def tranquil_bump_depth(x):
    """Return the steady depth [m] of SWASHES' tranquil flow over the bump at places `x` [m]."""
    energy = head(TRANQUIL_STAGE, TRANQUIL_FLOW)
    return np.array([depth_of_head(energy - b, TRANQUIL_FLOW, False) for b in first_bump(x)])


def bump_tranquil(cells):
    """4.42 m2/s over the bump, 2 m deep at the outlet, from the steady flow itself.

    Nothing but the scheme damps waves between the two edges, so another start would not settle.
    """
    return _held(
        "bump, tranquil", cells, BUMP_LENGTH, 100.0, TRANQUIL_FLOW, first_bump,
        tranquil_bump_depth, None,
    )  # fmt: skip


def tranquil_channel_depth(x):
    """Return MacDonald's depth [m] of a channel that is tranquil all along, and its slope."""
    critical, s = critical_depth(CHANNEL_FLOW), x / CHANNEL - 0.5
    swell = 0.5 * np.exp(-16 * s**2)
    return critical * (1 + swell), -32 * s * critical * swell / CHANNEL


def tranquil_channel_slope(x):
    """Return the bed's slope on which the flow of `tranquil_channel_depth` is steady."""
    return steady_slope(tranquil_channel_depth(x), CHANNEL_FLOW, TRANQUIL_MANNING)


def macdonald_tranquil(cells):
    """2 m2/s in MacDonald's channel of 1 km, tranquil all along, from its level at rest."""
    return _held(
        "macdonald, tranquil", cells, CHANNEL, 3000.0, CHANNEL_FLOW,
        bed_of(tranquil_channel_slope), lambda x: tranquil_channel_depth(x)[0],
        lambda x: 0 * x + critical_depth(CHANNEL_FLOW), TRANQUIL_MANNING,
    )  # fmt: skip
