"""Types of terrains: the grid, the flat tops, and the terrain with its heights and classes."""

from dataclasses import dataclass, field, fields

import numpy as np

from rainsim.terrain.table import GRASS, HARD, class_table

UNKNOWN, INFERRED, MEASURED = 0, 1, 2  # values of Terrain.source
SAMPLE = 2_000_000  # cells, about, of a large map that a median is taken of
GAP_HEIGHT = 0.15  # m between ground and underside that rain can be blown into


MAPS = "bed", "top", "underside", "source", "ground_class", "noise", "color"
SOME = "water", "standing", "poured", "layer"  # maps that not all terrains have
TOPS = "tops_"  # begins the names of the arrays of `Tops` in files


@dataclass(frozen=True)
class Grid:
    """A raster on the ground: cell (j, i) spans spacing x spacing m, row 0 in the south (least y).

    Attributes
    ----------
    shape : tuple of int
        (ny, nx).
    origin : tuple of float [m]
        x, y of the outer corner of cell (0, 0) in the ground frame.
    spacing : float [m]

    Examples
    --------
    >>> grid = rainsim.Grid((2, 3), (0.0, 0.0), 0.5)
    >>> grid.size, grid.cell_area
    ((1.5, 1.0), 0.25)
    """

    shape: tuple
    origin: tuple
    spacing: float

    @property
    def cell_area(self):
        """Area of a cell [m2]."""
        return self.spacing**2

    @property
    def size(self):
        """Width (x) and depth (y) of the map [m]."""
        return self.shape[1] * self.spacing, self.shape[0] * self.spacing

    def centres(self):
        """Return x (nx,) and y (ny,) of the cells' centres [m]."""
        ny, nx = self.shape
        x = self.origin[0] + (np.arange(nx) + 0.5) * self.spacing
        return x, self.origin[1] + (np.arange(ny) + 0.5) * self.spacing

    def disc(self, point, radius):
        """Return which cells lie within `radius` [m] of a point (x, y) [m], bool (ny, nx)."""
        x, y = self.centres()
        return (x[None, :] - point[0]) ** 2 + (y[:, None] - point[1]) ** 2 <= radius**2

    def cells(self, x, y):
        """Return rows, columns of the cells that hold points, clipped to the map, and a mask."""
        column = np.floor((np.asarray(x) - self.origin[0]) / self.spacing).astype(np.int64)
        row = np.floor((np.asarray(y) - self.origin[1]) / self.spacing).astype(np.int64)
        ny, nx = self.shape
        inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
        return np.clip(row, 0, ny - 1), np.clip(column, 0, nx - 1), inside


@dataclass(frozen=True)
class Tops:
    """Flat tops above the ground: tables, benches, roofs.

    A top's surface is a plane, s0 + s1 X + s2 Y, with X, Y the distance from its centre. A level
    one has a patch of finer cells besides, on which its relief is known; the patches lie one above
    the other in one array, with dry cells around each. Without tops the index has shape (0, 0).
    """

    index: np.ndarray  # (ny, nx), int16, the top over each cell and a margin, -1: none
    surface: np.ndarray  # (n, 3), float64, s0 [m], s1, s2
    centre: np.ndarray  # (n, 2), float64, m
    area: np.ndarray  # (n,), float64, m2
    patch: np.ndarray  # (n, 3), int64: first row in the arrays, rows, columns; no rows if not level
    corner: np.ndarray  # (n, 2), float64, m, x and y of the patch's south-western corner
    spacing: float  # m, of the patches' cells
    relief: np.ndarray  # (rows, columns), float32, m, over the surface
    holds: np.ndarray  # (rows, columns), bool: water can stand: no gaps between planks, no edge

    def __len__(self):
        return len(self.surface)

    def arrays(self):
        """Return the attributes as arrays by name, for files; see `from_arrays`."""
        return {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays):
        """Return the tops that `arrays` gave."""
        return cls(**{**arrays, "spacing": np.asarray(arrays["spacing"]).item()})

    @property
    def level(self):
        """Mask of the tops on which water stands, (n,) bool."""
        return self.patch[:, 1] > 0

    def cells_of(self, k):
        """Return the part of the patches' arrays that holds the patch of top k, two slices."""
        first, rows, columns = self.patch[k]
        return slice(first, first + rows), slice(0, columns)


NO_TOPS = Tops(
    np.zeros((0, 0), np.int16), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0),
    np.zeros((0, 3), np.int64), np.zeros((0, 2)), 1.0, np.zeros((1, 1), np.float32),
    np.zeros((1, 1), bool),
)  # fmt: skip


NO_LAYER = np.zeros((0, 0), np.float32)  # of ground whose height the splats tell


@dataclass(frozen=True)
class Terrain:
    """Ground, cover and classes on a `Grid`.

    Attributes
    ----------
    grid : Grid
    bed : ndarray of shape (ny, nx), float32 [m]
        Height of the ground, smoothed at the scale of its noise; under grass the soil.
    top : ndarray of shape (ny, nx), float32 [m]
        Highest surface; equals `bed` where nothing stands.
    underside : ndarray of shape (ny, nx), float32 [m]
        Lower side of what hangs over the ground; equals `bed` where it stands on it.
    source : ndarray of shape (ny, nx), uint8
        MEASURED, INFERRED (inpainted under an object, or assumed under painted water) or UNKNOWN
        (nothing saw it).
    ground_class : ndarray of shape (ny, nx), uint8
        Codes of rainsim/config/classes.toml; unknown ground counts as grass (as object where
        something
        stands on it): it takes up water and never mirrors.
    noise : ndarray of shape (ny, nx), float32 [m]
        Standard deviation of the measured ground about its trend.
    color : ndarray of shape (ny, nx, 3), float32
        Display-referred colour of the ground from above.
    notes : tuple of str
    water : ndarray of shape (ny, nx), float32 [m]
        Depth of the water that the user painted, over an assumed bed; 0 elsewhere.
    standing, poured : ndarray of shape (ny, nx), float32 [m], or None
        Depth of the water that the user put on the ground: in dents of it, and where it runs off;
        see `rainsim.terrain.poured`.
    tops : Tops
        What lies flat above the ground, see `rainsim.terrain.tops`.
    footprints : tuple of rainsim.actors.footprint.Footprint
        Of the actors that move over the map; not written to files.
    layer : ndarray of shape (ny, nx) or (0, 0), float32 [m]
        How far from the bed the splats lie that show the ground, where they tell its height too
        poorly: the bed is then assumed, see `rainsim.terrain.assumed_bed`. Negative where things
        stand on it, empty if it is known.

    Examples
    --------
    >>> terrain = rainsim.extract_terrain(scene, config)
    >>> terrain.by_class("manning").shape == terrain.bed.shape
    True
    """

    grid: Grid
    bed: np.ndarray
    top: np.ndarray
    underside: np.ndarray
    source: np.ndarray
    ground_class: np.ndarray
    noise: np.ndarray
    color: np.ndarray
    notes: tuple = ()
    water: np.ndarray | None = None
    standing: np.ndarray | None = None
    poured: np.ndarray | None = None
    tops: Tops = NO_TOPS
    footprints: tuple = ()
    layer: np.ndarray = field(default_factory=lambda: NO_LAYER)

    def __post_init__(self):
        """Fill in a map of zeros if no water was painted."""
        if self.water is None:
            object.__setattr__(self, "water", np.zeros(self.grid.shape, np.float32))

    def arrays(self):
        """Return the terrain as arrays by name, for files; see `from_arrays`."""
        found = {name: getattr(self, name) for name in MAPS}
        found |= {name: values for name in SOME if np.any(values := getattr(self, name))}
        found |= {TOPS + name: values for name, values in self.tops.arrays().items()}
        return found | {
            "origin": np.array(self.grid.origin, np.float64),
            "spacing": np.float64(self.grid.spacing),
            "notes": np.array(self.notes, dtype=np.str_),
        }

    @classmethod
    def from_arrays(cls, arrays):
        """Return the terrain that `arrays` gave, without footprints."""
        grid = Grid(
            arrays["bed"].shape,
            tuple(arrays["origin"].tolist()),
            np.asarray(arrays["spacing"]).item(),
        )
        maps = {name: arrays[name] for name in (*MAPS, *SOME) if name in arrays}
        tops = {n.removeprefix(TOPS): a for n, a in arrays.items() if n.startswith(TOPS)}
        tops = Tops.from_arrays(tops) if tops else NO_TOPS
        return cls(grid, **maps, notes=tuple(np.asarray(arrays["notes"]).tolist()), tops=tops)

    @property
    def cells(self):
        """Number of cells."""
        return self.bed.size

    @property
    def covered(self):
        """Mask of the ground cells that something hangs over."""
        return self.underside > self.bed + GAP_HEIGHT

    @property
    def soaks(self):
        """Mask of the cells that take up whatever rain of the past reaches them."""
        return self.by_class("soaks")

    @property
    def mirrors(self):
        """Mask of the cells on which a film of water can be seen as a surface."""
        return self.by_class("mirrors")

    @property
    def grassy(self):
        """Mask of the cells where plants stand between the rain and the ground."""
        return self.ground_class == GRASS

    @property
    def sealed(self):
        """Mask of the paving."""
        return self.ground_class == HARD

    def by_class(self, name, part=()):
        """Return a number of each cell's ground class, ndarray of shape (ny, nx).

        `name` is a key of `ClassTable.columns`, which lists the units. `part`, if given, are rows
        and columns, two slices.
        """
        return class_table().column(name)[self.ground_class[part]]

    @property
    def hard_noise(self):
        """Median noise [m] of the measured paving in the map's middle half; 0 if there is none.

        Far from the middle few cameras saw the ground and its noise is that of the capture's rim.
        """
        every = slice(None, None, max(1, round((self.noise.size / SAMPLE) ** 0.5)))
        classes, source, noise = (
            a[every, every] for a in (self.ground_class, self.source, self.noise)
        )
        measured = (classes == HARD) & (source == MEASURED)
        ny, nx = measured.shape
        middle = np.zeros_like(measured)
        middle[ny // 4 : ny - ny // 4, nx // 4 : nx - nx // 4] = True
        if (measured & middle).any():
            measured &= middle
        values = noise[measured]
        return float(np.median(values)) if values.size else 0.0
