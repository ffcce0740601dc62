"""Rain on terrain over time: standing water at the start, then drops, flow and ripples.

`simulate` yields the state at each frame's time. A state holds all that a picture needs besides
the capture, the terrain and the seed: the drops in the air follow from the seed alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from rainsim.drops import GROUND, RainField, Surfaces, impacts
from rainsim.errors import InputError
from rainsim.grid import WaterSolver
from rainsim.jit import cpu_kernel, prange
from rainsim.ripples import RippleTile, tile_impacts
from rainsim.spectrum import RainSpectrum, terminal_speed
from rainsim.standing import standing_water
from rainsim.terrain import GRASS, HARD, UNKNOWN

HARD_STORAGE = 0.3e-3  # m: what lies in the pores of paving below the cell size and does not flow
GRASS_STORAGE = 2.0e-3  # m (physics of lawns: 2.5 to 5 mm, some of it taken up before)
GRASS_INFILTRATION = 3e-5  # m/s (108 mm/h): sandy loam under a lawn at the start of a rain
MANNING_HARD, MANNING_GRASS = 0.014, 0.25  # asphalt and short grass, SWMM reference manual
NOISE_FACTOR = 2.0  # depressions shallower than this times the bed's noise hold no water
RIPPLE_DEPTHS = (2e-3, 0.1)  # m: films thinner carry no rings, deeper water is deep to them
RIPPLE_WARM_UP = 1.3  # s of rain before the first frame that rings on the water come from
RIPPLE_STEP = 1 / 30  # s, longest step of the ripple layer
SHELTER_BLUR = 0.05  # m: gusts and drops of other sizes soften the edge of a dry patch
SHELTER_DIAMETERS = (1e-3, 2e-3, 3.5e-3)  # m, drops whose paths tell what is sheltered


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
    impact_position : ndarray of shape (k, 3), float32 [m]
        Where drops hit between the frame before and this one.
    impact_diameter : ndarray of shape (k,), float32 [m]
    impact_kind : ndarray of shape (k,), uint8
        `drops.GROUND` (or the water on it) or `drops.OBSTACLE`.
    ledger : dict
        Volumes in m3, see `rainsim.ledger`.
    notes : tuple of str
    """

    index: int
    time: float
    depth: np.ndarray
    velocity: np.ndarray
    slopes: np.ndarray
    tile_size: float
    impact_position: np.ndarray
    impact_diameter: np.ndarray
    impact_kind: np.ndarray
    ledger: dict
    notes: tuple = ()


def surfaces_of(terrain):
    """Return the `Surfaces` that drops can hit on a terrain."""
    return Surfaces(
        spacing=terrain.grid.spacing, origin=terrain.grid.origin, ground=terrain.bed,
        top=terrain.top, underside=terrain.underside,
    )  # fmt: skip


def rain_field(config):
    """Return the `RainField` of a configuration, or None if it does not rain."""
    if config.rain.rate <= 0:
        return None
    speed, direction = config.rain.wind
    wind = (speed * math.cos(direction), speed * math.sin(direction))
    return RainField(RainSpectrum(config.rain.rate * 3.6e6), wind=wind, seed=config.rain.seed)


def rain_exposure(terrain, wind):
    """Return the share of the rain that reaches each ground cell, float32 (ny, nx).

    `wind` is (speed [m/s], direction [rad]). The paths of drops of three sizes are followed
    upwards; the result is blurred, for a hard edge of a dry patch is not seen in nature.
    """
    total = np.zeros(terrain.grid.shape, np.float32)
    speed, direction = wind
    ceiling = np.float32(terrain.top.max())
    for diameter in SHELTER_DIAMETERS:
        slope = speed / float(terminal_speed(diameter))  # m sideways per m of fall
        open_out = np.full(terrain.grid.shape, np.nan, np.float32)
        _follow_up(
            terrain.bed, terrain.top, terrain.underside, np.float32(terrain.grid.spacing),
            np.float32(-slope * math.cos(direction)), np.float32(-slope * math.sin(direction)),
            ceiling, open_out,
        )  # fmt: skip
        total += open_out
    blur = SHELTER_BLUR / terrain.grid.spacing
    return ndimage.gaussian_filter(total / len(SHELTER_DIAMETERS), blur).astype(np.float32)


@cpu_kernel
def _follow_up(bed, top, underside, spacing, dx, dy, ceiling, open_out):
    """Mark the ground cells from which the way up along (dx, dy, 1) is free."""
    ny, nx = bed.shape
    one, zero, half = np.float32(1), np.float32(0), np.float32(0.5)
    step = spacing / max(abs(dx), max(abs(dy), half))  # at most a cell sideways, two cells up
    for j in prange(ny):
        for i in range(nx):
            z = bed[j, i]
            x, y = np.float32(i), np.float32(j)
            free = one
            while z < ceiling:
                k, m = int(x + half), int(y + half)
                if k < 0 or m < 0 or k >= nx or m >= ny:
                    break
                if top[m, k] > bed[m, k] and z >= underside[m, k] and z <= top[m, k]:
                    free = zero
                    break
                z += step
                x += dx * step / spacing
                y += dy * step / spacing
            open_out[j, i] = free


def initial_water(terrain, config, exposure):
    """Return the depth [m] (ny, nx) at the start, and notes: a given level or past rain at rest."""
    bed = terrain.bed.astype(np.float64)
    if config.water.level is not None:
        level = np.percentile(bed, 5) + config.water.level
        depth = np.maximum(level - bed, 0)
        return depth, (f"still water at {config.water.level:g} m above the low ground",)
    noise = terrain.noise[(terrain.ground_class == HARD) & (terrain.source != UNKNOWN)]
    shallow = NOISE_FACTOR * float(np.median(noise)) if noise.size else 0.0
    # Smoothing has taken most of the noise out of the bed: what counts is the rest of it.
    cells = 4 * math.pi * (2 * 0.04 / terrain.grid.spacing) ** 2 / 4
    shallow /= math.sqrt(max(cells, 1.0))
    standing = standing_water(
        bed, config.rain.past * exposure.astype(np.float64), terrain.grid.spacing,
        permeable=terrain.ground_class == GRASS, minimum_depth=shallow,
    )  # fmt: skip
    depth = standing[0]
    hard = max(np.count_nonzero(terrain.ground_class == HARD), 1)
    wet = np.count_nonzero((depth > 1e-3) & (terrain.ground_class == HARD)) / hard
    return depth, (
        f"{config.rain.past * 1e3:g} mm of past rain stand at rest; {wet:.0%} of the hard ground "
        "under more than 1 mm",
    )


def puddle_depth(depth):
    """Return the depth [m] that rings run on: the median of what is deep enough to carry them."""
    deep = depth[depth > RIPPLE_DEPTHS[0]]
    return float(np.clip(np.median(deep) if deep.size else 0.0, *RIPPLE_DEPTHS))


def water_solver(terrain, config):
    """Return the `WaterSolver` of a terrain, friction and infiltration by class."""
    grass = terrain.ground_class == GRASS
    still = config.water.level is not None
    # A flood stands because the land around is flooded too; rain runs off an open map.
    return WaterSolver(
        terrain.bed, terrain.grid.spacing, scheme=config.water.scheme,
        boundary="wall" if still else "open",
        manning=np.where(grass, MANNING_GRASS, MANNING_HARD).astype(np.float32),
        storage=np.where(grass, GRASS_STORAGE, HARD_STORAGE).astype(np.float32),
        infiltration=None if still else np.where(grass, GRASS_INFILTRATION, 0).astype(np.float32),
        courant=config.water.courant,
    )  # fmt: skip


def simulate(terrain, config, progress=None):
    """Yield the `SimState` at the time of each frame, from frame 0 on, without end.

    Parameters
    ----------
    terrain : Terrain
    config : Config
    progress : callable, optional
        progress(stage, done, total), told before the slow first state.
    """
    field = rain_field(config)
    surfaces = surfaces_of(terrain)
    exposure = rain_exposure(terrain, config.rain.wind)
    depth, notes = initial_water(terrain, config, exposure)
    solver = water_solver(terrain, config)
    solver.set_state(depth)
    ripples = RippleTile(depth=puddle_depth(depth))
    open_area = float(exposure.sum()) * terrain.grid.cell_area
    if field is not None:
        _warm_up(ripples, field, surfaces, open_area)
    obstacles = 0.0
    index, hits, report = 0, None, None
    while True:
        time = index / config.fps
        if index > 0:
            before = (index - 1) / config.fps
            hits = None
            if field is not None:
                hits = impacts(field, surfaces, before, time)
                landed = hits.take(hits.kind == GROUND)
                solver.deposit(landed.row, landed.column, landed.volume)
                obstacles += float(hits.volume[hits.kind != GROUND].sum())
                ripples.advance(time - before, *tile_impacts(landed, open_area, ripples.size, time))
            fine = 0.0 if field is None else field.spectrum.fine_rate * exposure
            report = solver.advance(time - before, rain=fine)
        u, v = solver.velocity
        yield SimState(
            index, time, np.array(solver.depth, np.float32),
            np.stack([u, v]).astype(np.float32), ripples.slopes(), ripples.size,
            _of(hits, "position", (0, 3)), _of(hits, "diameter", (0,)),
            _of(hits, "kind", (0,), np.uint8), _ledger(report, solver, obstacles),
            notes if index == 0 else (),
        )  # fmt: skip
        index += 1


def _of(hits, name, shape, dtype=np.float32):
    return np.zeros(shape, dtype) if hits is None else np.asarray(getattr(hits, name), dtype)


def _ledger(report, solver, obstacles):
    """Return the solver's ledger with what fell on obstacles added to both of its sides."""
    ledger = (solver.ledger if report is None else report.ledger).as_dict()
    ledger["rain"] += obstacles
    ledger["obstacles"] += obstacles
    return ledger


def _warm_up(ripples, field, surfaces, open_area):
    """Let rings of the rain before the first frame spread on the tile."""
    steps = round(RIPPLE_WARM_UP / RIPPLE_STEP)
    for n in range(-steps, 0):
        end = (n + 1) * RIPPLE_STEP
        hits = impacts(field, surfaces, n * RIPPLE_STEP, end)
        landed = hits.take(hits.kind == GROUND)
        ripples.advance(RIPPLE_STEP, *tile_impacts(landed, open_area, ripples.size, end))


_FIELDS = ("depth", "velocity", "slopes", "impact_position", "impact_diameter", "impact_kind")


def write_state(path, state):
    """Write a `SimState` as an uncompressed .npz."""
    import json

    from rainsim import image

    image.write_npz(
        path, **{name: getattr(state, name) for name in _FIELDS}, index=state.index,
        time=state.time, tile_size=state.tile_size, ledger=json.dumps(state.ledger),
        notes=json.dumps(state.notes),
    )  # fmt: skip


def read_state(path):
    """Return the `SimState` that `write_state` wrote."""
    import json

    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {name: data[name] for name in _FIELDS}
            return SimState(
                index=int(data["index"]), time=float(data["time"]),
                tile_size=float(data["tile_size"]), ledger=json.loads(str(data["ledger"])),
                notes=tuple(json.loads(str(data["notes"]))), **arrays,
            )  # fmt: skip
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; `rainsim simulate` writes it") from None
    except (KeyError, ValueError, OSError, EOFError) as error:
        raise InputError(f"{path} is no water state of rainsim ({error}); write it anew") from error
