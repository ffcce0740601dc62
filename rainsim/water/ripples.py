"""Rings on water: a periodic tile of dispersive, damped capillary-gravity waves.

Shallow water moves every wavelength at one speed; the rings of raindrops are short waves, each with
its own. The tile evolves their spectrum exactly, at one water depth, and gives surface slopes for
shading. It lies over the flow and does not act on it.
"""

import math
from functools import lru_cache

import numpy as np
import scipy.fft

from rainsim.constants import GRAVITY, SURFACE_TENSION, WATER_DENSITY, WATER_VISCOSITY
from rainsim.errors import ParameterError, require_not_negative, require_positive
from rainsim.numerics.random import mix
from rainsim.numerics.windows import widened
from rainsim.rain.size_distribution import drop_volume, terminal_speed

FOOTPRINT = 5e-3  # m; a Gaussian push of this width has its energy peak at 200 rad/m
RING_SHARE = 0.01  # of the reference drop's kinetic energy, on deep water
REFERENCE_DROP = 2.5e-3  # m; between the measured 2.2 and 2.8 mm
# Drops up to and from these diameters [m] push alike: as drops of `_TYPICAL` do, see `footprint`.
_BOUNDS = (1.8e-3, 3.3e-3)
_TYPICAL = (1.3e-3, REFERENCE_DROP, 4.2e-3)
SIZES = len(_TYPICAL)
LAYERS = 2  # of the tile on the water, one turned against the other: each rings for half the drops
BLOCKS_AROUND = 6  # by which rings are followed across the map, see `block_reach`
USUAL_CHORD = 0.5  # m, of a captured patio's puddles: their rings are drawn as the tile has them
_LONGEST_STEP = 1 / 60  # s; impacts of one such step are born together, its end
BESIDE = 1.25  # m around a shelter in which rings lack those of the drops that it keeps off
ROWS = 64  # of a spectrum that are worked on at once
MOST_KEPT = 1 << 19  # cells of a map whose factors of the spectrum are kept


def angular_frequency(wavenumber, depth):
    """Angular frequency [rad/s] of waves of `wavenumber` [rad/m] on water of `depth` [m]."""
    k = np.asarray(wavenumber, dtype=np.float64)
    return np.sqrt((GRAVITY * k + SURFACE_TENSION / WATER_DENSITY * k**3) * np.tanh(k * depth))


def stirring(rate):
    """Return by how much rain of `rate` [mm/h] stirs water: its eddy viscosity over its own.

    The energy that drops bring grows with the rate, but the variance of their rings' elevation only
    with its power 0.53, as Bliven, Sobieski and Craeye fitted to 2.8 mm drops on deep water (1997,
    Int. J. Remote Sensing 18, 221; the constants of their spectrum as commonly quoted, the paper
    was not at hand): dissipation follows the rate of the rain (Lemaire et al. 2002, Int. J. Remote
    Sensing 23, 2345). The two numbers here make the balance of such rings agree from 5 to 200 mm/h.
    """
    return 0.36 * (rate / 10.0) ** 0.8


def damping_rate(wavenumber, depth, film=0.0, stirred=0.0):
    """Decay rate [1/s] of the amplitude of waves of `wavenumber` [rad/m].

    Viscosity in the bulk, 2 nu k^2, and the boundary layer on the bottom,
    k sqrt(nu omega / 2) / sinh(2 k h). A surface film that does not stretch adds
    k sqrt(nu omega) / (2 sqrt 2), the limit that Lamb (Hydrodynamics, 1932, section 351) gives; one
    that stretches in part counts with the share `film` of this term. Rain that stirs the water
    adds to the viscosity in the bulk, see `stirring`.
    """
    k = np.asarray(wavenumber, dtype=np.float64)
    omega = angular_frequency(k, depth)
    steep = np.minimum(2 * k * depth, 700.0)  # sinh beyond that is not a float64
    bottom = np.zeros_like(k)
    np.divide(k * np.sqrt(WATER_VISCOSITY * omega / 2), np.sinh(steep), out=bottom, where=k > 0)
    surface = film * k * np.sqrt(WATER_VISCOSITY * omega) / (2 * math.sqrt(2))
    return 2 * WATER_VISCOSITY * (1 + stirred) * k**2 + bottom + surface


def drop_momentum(diameter):
    """Return the momentum [kg m/s] of a drop of `diameter` [m] at terminal speed."""
    return WATER_DENSITY * drop_volume(diameter) * terminal_speed(diameter)


# kg m/s; the size of a drop is the number of these that its momentum reaches
SIZE_MOMENTA = tuple(float(drop_momentum(diameter)) for diameter in _BOUNDS)


def footprint(diameter):
    """Return the width [m] of the Gaussian push of a drop of `diameter` [m].

    That of the reference drop times the crater that a drop digs over the reference drop's: at its
    deepest a half ball of radius R holds the energy (pi / 4) rho g R^4, a share of the drop's
    (pi / 12) rho D^3 V^2, so that R goes with (D^3 V^2)^(1/4) (Engel 1966, J. Appl. Phys. 37,
    1798). So large drops make long waves: the rings of 1.3, 2.5 and 4.2 mm peak at wavelengths of
    16, 31 and 50 mm.
    """
    dug, reference = (d**3 * terminal_speed(d) ** 2 for d in (diameter, REFERENCE_DROP))
    return FOOTPRINT * float(dug / reference) ** 0.25


class RippleTile:
    """A square of water, periodic in both directions.

    cells : int. Along each side; waves of two cells and longer are carried.
    depth : float [m]. Of the water; it sets the speeds and the damping.
    film : float. 0 for clean water to 1 for water whose surface film does not
        stretch: street dirt.
    rate : float [mm/h]. Of the rain that stirs the water; see `stirring`.
    chord : float [m]. Mean way across the water, see `mean_chord`: its shores
        take the waves that reach them.

    Each drop pushes the water down with a Gaussian of the width `footprint` of its size, one of
    three; the push is proportional to its momentum (Le Mehaute 1988, J. Fluid Mech. 197, 415), with
    a factor chosen such that a ring's energy goes with the momentum squared whatever its width, and
    a drop of REFERENCE_DROP at terminal speed puts RING_SHARE of its kinetic energy into waves
    (IEEE J. Oceanic Eng. 24, 323, 1999: about 1 %, near 0.2 rad/mm, for 2.2 and 2.8 mm). By that
    law a smaller drop puts a smaller share into waves, in proportion to its mass. That was measured
    on deep water: on shallow water the bed takes a part of the push, all but tanh(k depth).
    """

    def __init__(
        self, size=1.0, cells=256, depth=0.01, film=0.0, rate=0.0, chord=math.inf, dtype=np.float64
    ):
        self.size = require_positive("tile size", size, "m")
        self.depth = require_positive("tile depth", depth, "m")
        if isinstance(cells, bool) or int(cells) != cells or cells < 2 or cells % 2:
            raise ParameterError(f"tile cells is {cells!r}; it must be an even number from 2 up")
        self.cells = int(cells)
        self.film = require_not_negative("surface film", film, "", "1 is a film that never gives")
        self._real = np.dtype(dtype)
        self._complex = np.result_type(self._real, np.complex64)
        spacing = self.size / self.cells
        self._kx = 2 * np.pi * scipy.fft.rfftfreq(self.cells, spacing)[None, :]
        self._ky = 2 * np.pi * scipy.fft.fftfreq(self.cells, spacing)[:, None]
        self._k = np.hypot(self._kx, self._ky)
        self._omega = angular_frequency(self._k, self.depth)
        stirred = stirring(require_not_negative("rain rate", rate, "mm/h"))
        self._damping = damping_rate(self._k, self.depth, self.film, stirred)
        # Energy that runs over a chord at the group speed is lost at its end.
        step = 1e-3 * np.maximum(self._k, 1e-3)
        ahead, behind = (angular_frequency(self._k + s, self.depth) for s in (step, 0.0))
        self._damping += (ahead - behind) / step / (2 * chord)
        self._weight = np.full(self._k.shape, 2.0)  # the half plane not stored counts too
        self._weight[:, 0] = self._weight[:, -1] = 1.0
        # eta and the quarter period behind it, spectra in the scaling of rfft2
        self._eta = np.zeros(self._k.shape, self._complex)
        self._lag = np.zeros(self._k.shape, self._complex)
        pushes = [self._push_spectrum(footprint(diameter)) for diameter in _TYPICAL]
        self._push = np.stack(pushes).astype(self._real)
        self._turns = {}

    def advance(self, duration, position=None, momentum=None, age=None):
        """Let the waves run for `duration` and add the rings of the drops that fell meanwhile.

        position : array (n, 2 or more) [m] or None. Where drops fell; wrapped
            into the tile.
        momentum : array (n,) [kg m/s]. Downward.
        age : array (n,) [s] or None. Time since each fall when the step ends, 0
            to `duration`; None for 0. Falls are put together in sub-steps of at
            most 1/60 s.
        """
        duration = require_not_negative("duration", duration, "s")
        steps = max(math.ceil(duration / _LONGEST_STEP - 1e-9), 1)
        if position is None or len(position) == 0:
            self._turn(duration)
            return
        ages = np.zeros(len(position)) if age is None else np.asarray(age, np.float64)
        born = steps - 1 - np.floor(ages / max(duration, 1e-30) * steps).astype(np.int64)
        born, momentum = np.clip(born, 0, steps - 1), np.asarray(momentum)
        sizes = np.searchsorted(SIZE_MOMENTA, momentum, side="right")
        for step in range(steps):
            self._turn(duration / steps)
            for size in range(SIZES):
                now = (born == step) & (sizes == size)
                if now.any():
                    self._lag += self._push[size] * self._deposit(position[now], momentum[now])

    def slopes(self):
        """Return (d eta/dx, d eta/dy), float32 (2, cells, cells); row j, column i is at (i, j)."""
        out = np.empty((2, self.cells, self.cells), np.float32)
        shape = (self.cells, self.cells)
        # odd derivatives of the shortest wave are not defined
        kx = np.where(np.arange(self._kx.size) == self.cells // 2, 0.0, self._kx)
        ky = np.where(np.arange(self.cells)[:, None] == self.cells // 2, 0.0, self._ky)
        kx, ky = (k.astype(self._real) for k in (kx, ky))
        out[0] = scipy.fft.irfft2(1j * kx * self._eta, s=shape)
        out[1] = scipy.fft.irfft2(1j * ky * self._eta, s=shape)
        return out

    @property
    def elevation(self):
        """Surface elevation, ndarray of shape (cells, cells), float64 [m]."""
        return scipy.fft.irfft2(self._eta, s=(self.cells, self.cells))

    def set_elevation(self, elevation):
        """Set the surface to `elevation` (cells, cells) [m], at rest."""
        elevation = np.asarray(elevation, np.float64)
        if elevation.shape != (self.cells, self.cells):
            raise ParameterError(
                f"elevation has shape {elevation.shape}; it must be {(self.cells, self.cells)}"
            )
        self._eta = scipy.fft.rfft2(elevation).astype(self._complex)
        ratio = np.divide(self._damping, self._omega, out=np.zeros_like(self._k), where=self._k > 0)
        # at rest: d eta/dt = omega lag - damping eta = 0
        self._lag = (ratio * self._eta).astype(self._complex)

    def energy(self):
        """Return the waves' kinetic and potential energy [J]."""
        rate = self._omega * self._lag - self._damping * self._eta
        k = np.where(self._k > 0, self._k, 1.0)
        kinetic = np.abs(rate) ** 2 / (k * np.tanh(k * self.depth))
        potential = (GRAVITY + SURFACE_TENSION / WATER_DENSITY * k**2) * np.abs(self._eta) ** 2
        both = self._weight * (kinetic + potential) * (self._k > 0)
        return 0.5 * WATER_DENSITY * self.size**2 * float(both.sum()) / self.cells**4

    def _turn(self, duration):
        """Evolve freely: each wave turns by omega t and shrinks by exp(-damping t), exactly."""
        if duration not in self._turns:
            if len(self._turns) > 8:  # frames have a few durations; do not keep a history
                self._turns.clear()
            shrink = np.exp(-self._damping * duration)
            angle = self._omega * duration
            parts = shrink * np.cos(angle), shrink * np.sin(angle)
            self._turns[duration] = tuple(part.astype(self._real) for part in parts)
        cosine, sine = self._turns[duration]
        eta, lag = self._eta, self._lag
        self._eta, self._lag = cosine * eta + sine * lag, cosine * lag - sine * eta

    def _push_spectrum(self, width):
        """Return the lagging spectrum of one unit of momentum per cell.

        An impulse I over a Gaussian footprint G of a `width` [m] starts the surface moving down at
        d eta/dt = -(I / rho) k tanh(k h) G(k); divided by omega that is the lagging part.
        """
        k, tanh = self._k, np.tanh(self._k * self.depth)
        gauss = np.exp(-0.5 * (k * width) ** 2)
        # deposits are spread linearly over four cells: undo what that takes from short waves
        spread = np.sinc(self._kx * self.size / (2 * np.pi * self.cells)) ** 2
        spread = spread * np.sinc(self._ky * self.size / (2 * np.pi * self.cells)) ** 2
        area = (self.size / self.cells) ** 2
        push = np.zeros_like(k)
        np.divide(-k * tanh * gauss / spread, WATER_DENSITY * area * self._omega, out=push,
                  where=k > 0)  # fmt: skip
        speed = float(terminal_speed(REFERENCE_DROP))
        mass = WATER_DENSITY * drop_volume(REFERENCE_DROP)
        # energy of a unit push in open, deep water: the integral of k^2 exp(-k^2 width^2)
        unit = math.sqrt(math.pi) / (4 * width**3) / (4 * math.pi * WATER_DENSITY)
        wanted = RING_SHARE * 0.5 * mass * speed**2
        return push * math.sqrt(wanted / (unit * (mass * speed) ** 2))

    def _deposit(self, position, momentum):
        """Spread momenta linearly over the nearest cells and return the spectrum."""
        n = self.cells
        x, y = (np.mod(position[:, a] / self.size, 1.0) * n for a in (0, 1))
        i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        right, up = x - i, y - j
        grid = np.zeros(n * n)
        for dj, share_j in ((0, 1 - up), (1, up)):
            for di, share_i in ((0, 1 - right), (1, right)):
                at = (j + dj) % n * n + (i + di) % n
                hit, which = np.unique(at, return_inverse=True)  # few of all cells
                grid[hit] += np.bincount(which, momentum * share_i * share_j)
        return scipy.fft.rfft2(grid.reshape(n, n).astype(self._real))


def mean_chord(depth, spacing, least):
    """Return the mean way [m] across water deeper than `least` [m], infinite without shores.

    Of straight lines in all directions that is pi times the area over the length of its shores
    (Cauchy); a shore of cells is longer than it looks by 4 / pi.
    """
    wet = np.asarray(depth) > least
    shores = sum(np.count_nonzero(np.diff(wet, axis=axis)) for axis in (0, 1))
    return math.inf if shores == 0 else 4.0 * spacing * np.count_nonzero(wet) / shores


def ring_reach(depth, film=0.0, rate=0.0):
    """Return how far rings carry: path lengths [m] of waves, and each one's share of the slopes.

    Of the waves that rain keeps in balance: energy travels at the group speed and fades at twice
    the damping rate.
    """
    k = np.geomspace(20.0, 2.5 / FOOTPRINT, 24)
    omega = angular_frequency(k, depth)
    fading = 2 * damping_rate(k, depth, film, stirring(rate))
    pushed = k**2 * np.tanh(k * depth) * np.exp(-((k * FOOTPRINT) ** 2))
    stiff = WATER_DENSITY * GRAVITY + SURFACE_TENSION * k**2
    weight = k**2 * pushed / (fading * stiff) * k  # per octave
    return np.gradient(omega, k) / fading, weight / weight.sum()


def ring_share(rained, spacing, reach, weight):
    """Return the amplitude of rings over that in the open, ndarray of the shape of `rained`.

    rained : float32 array (ny, nx). Share of the rain that reaches each cell;
        beyond the map it goes on as at its edge.

    Waves that spread evenly from where drops fall and fade with a path length l have the energy of
    a convolution with exp(-r / l) / (2 pi l r), in Fourier space 1 / sqrt(1 + (q l)^2). That the
    land stops them is left out.
    """
    if rained.min() == rained.max():
        return np.sqrt(rained, dtype=np.float32)
    margin = _margin(spacing)
    around = [(margin, _fast(n + 2 * margin) - n - margin) for n in rained.shape]
    padded = np.asarray(rained, np.float32)
    for axis, (n, (before, after)) in enumerate(zip(rained.shape, around, strict=True)):
        padded = padded.take(np.arange(-before, n + after).clip(0, n - 1), axis)
    shape, spectrum = padded.shape, scipy.fft.rfft2(padded)
    del padded  # maps of millions of cells are let go as soon as they may
    energy = _spread(spectrum, shape, spacing, reach, weight)
    energy = energy[tuple(slice(before, -after) for before, after in around)]
    return np.sqrt(np.clip(energy, 0.0, 1.0)).astype(np.float32, copy=False)


def _margin(spacing):
    """Return how many cells around a map keep rings from its other side, for their transform."""
    return max(int(2.0 / spacing), 1)


def _fast(count):
    """Return a size of small factors: there are few, and a transform takes a third of the time."""
    return scipy.fft.next_fast_len(count, real=True)


def _spread(spectrum, shape, spacing, reach, weight):
    """Return the energy of rings (shape) of a share of the rain, by its spectrum, overwritten."""
    lengths, shares = (tuple(a.astype(np.float32)) for a in (reach, weight))
    found = _carried if shape[0] * shape[1] > MOST_KEPT else _kept_carried
    for first in range(0, shape[0], ROWS):
        rows = first, min(first + ROWS, shape[0])
        spectrum[slice(*rows)] *= found(shape, rows, spacing, lengths, shares)
    return scipy.fft.irfft2(spectrum, s=shape, overwrite_x=True)


def _carried(shape, rows, spacing, lengths, shares):
    """Return the factors of rows, first and end, of the spectrum of a shape, see `ring_share`."""
    qy = 2 * np.pi * scipy.fft.fftfreq(shape[0], spacing)[slice(*rows)]
    qx = 2 * np.pi * scipy.fft.rfftfreq(shape[1], spacing)[None]
    square = (qx**2 + qy[:, None] ** 2).astype(np.float32)
    carried = np.zeros_like(square)
    for length, share in zip(lengths, shares, strict=True):
        carried += share / np.sqrt(1 + length**2 * square)
    return carried


# What moves shelters parts of a few shapes, again and again.
_kept_carried = lru_cache(128)(_carried)


def taller_rings(rings, height, sheltered):
    """Return amplitudes of rings whose heights are multiplied by `height`, also under cover.

    rings : float32 array (ny, nx). See `ring_share`.
    sheltered : float. Share of the amplitude that runs in from the open where
        `rings` is 0: a pixel has sheltered + (1 - sheltered) rings.
    """
    if height == 1:
        return rings
    share = np.float32(sheltered)
    return np.float32(height) * rings + np.float32(height - 1) * share / (1 - share)


def block_reach(side, reach, weight):
    """Return how the energy of rings spreads from a block of water to those around, float32.

    Returns float32 array (2 BLOCKS_AROUND + 1, 2 BLOCKS_AROUND + 1). Share of a
        block's energy that each block around gets, over the energy on water with
        a mean chord of USUAL_CHORD, see `RippleTile`. So the sum is more than 1.

    Mean over the places in both blocks of what `ring_share` convolves with. Shores take what runs
    on to them, so only water gives energy; that waves pass narrow land here is wrong by little.
    """
    length, share = (np.asarray(a, np.float64)[:, None, None] for a in (reach, weight))
    places = [(np.arange(n) + 0.5) / n for n in (4, 5)]  # never the same place
    apart = (places[0][:, None] - places[1]).ravel() * side
    steps = np.arange(-BLOCKS_AROUND, BLOCKS_AROUND + 1) * side
    spread = np.empty((len(steps), len(steps)))
    for j, y in enumerate(steps):
        for i, x in enumerate(steps):
            r = np.hypot((y + apart)[:, None], x + apart)
            spread[j, i] = (share * np.exp(-r / length) / (length * r)).sum(axis=0).mean()
    usual = float((share / (1 + length / USUAL_CHORD)).sum())
    return (spread / (spread.sum() * usual)).astype(np.float32)


def sheltered_rings(rings, share, rained, shelters, spacing, reach):
    """Return the amplitude of rings where actors keep off a part of the rain.

    Energy is a sum over the rain, so that what an actor keeps off is taken from what there was.

    rings, share, rained : float32 array (ny, nx). Without the actors: what is
        returned where there is none, `ring_share`, and the share of the rain that
        it follows from.
    shelters : list of (part, share). Parts of the map, two slices, and the share
        of the rain there that an actor lets through.
    Returns float32 array (ny, nx). `rings` itself without actors.
        windows : list of tuple of slice. Rows and columns in which it differs.
    """
    if not shelters:
        return rings, []
    rings, windows, margin = rings.copy(), [], math.ceil(BESIDE / spacing)
    for part, let_through in shelters:
        window, inner = widened(part, margin, rings.shape)
        kept_off = np.zeros([s.stop - s.start for s in window], np.float32)
        np.multiply(rained[part], 1 - let_through, out=kept_off[inner])
        shape = tuple(_fast(n + 2 * margin) for n in let_through.shape)
        lost = _spread(scipy.fft.rfft2(kept_off, s=shape), shape, spacing, *reach)
        lost = lost[tuple(map(slice, kept_off.shape))]
        before = np.maximum(np.square(share[window]), np.float32(1e-12))
        rings[window] *= np.sqrt(np.clip(1 - lost / before, 0, 1))
        windows.append(window)
    return rings, windows


def tile_impacts(impacts, map_area, size, time):
    """Choose the impacts that a tile receives so that its LAYERS together have the map's rate.

    All drops of the map fall on it modulo the tile, which would be too many: each is kept with
    probability tile area over map area, over LAYERS, by its id.

    impacts : Impacts. Those on water or ground, of one step.
    Returns position : float64 array (m, 2) [m]
        momentum : float64 array (m,) [kg m/s]
        age : float64 array (m,) [s]
    """
    share = size**2 / require_positive("map area", map_area, "m2") / LAYERS
    chance = (mix(impacts.id) >> np.uint64(11)) * 2.0**-53
    kept = impacts.take(chance < share)
    momentum = -WATER_DENSITY * kept.volume * kept.velocity[:, 2]
    return kept.position[:, :2], momentum, time - kept.time
