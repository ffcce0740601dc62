"""Draws a big capture: for each picture the chunks that its camera needs.

A leaf at a level is prepared once and kept as long as memory allows. A picture takes the chunks of
its pages in the order of the index, whatever was read first and wherever they lie, so that it has
the same bytes every time.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from rainsim.lod.levels import chosen_levels
from rainsim.lod.room import ARRAYS, NO_CHUNKS, Stored, room_for
from rainsim.raster import Rasterizer
from rainsim.scene.formats.streamed import NONE
from rainsim.scene.harmonics import padded
from rainsim.scene.pages import ALWAYS
from rainsim.splatting.prepared import COARSE, GEOMETRY, LANES, NOBODY, PreparedSplats, prepare

BESIDE = 8  # runs that are read while those before them are prepared
MIRRORED = 3.0  # times the threshold in pictures that water and the surroundings mirror


@dataclass(frozen=True)
class Page:
    """The prepared splats of a leaf at a level; `last` those that mirrors leave out, or None.

    The numbers of their splats are not kept: those of other pages are the same.
    """

    first: PreparedSplats
    last: PreparedSplats | None = None

    @property
    def bytes(self):
        """The memory it takes [bytes]."""
        parts = [self.first] if self.last is None else [self.first, self.last]
        return sum(getattr(p, name).nbytes for p in parts for name in (*ARRAYS, "order"))


class Held:
    """The pages that a picture is drawn of, which stay in their room until others are taken.

    chunks : int64 array or None. Places of their chunks in the order in which the
        picture takes them; another array whenever they change.
    """

    def __init__(self):
        self.chunks, self.pages, self.key = None, [], None


class PagedRasterizer:
    """Draws the parts of a big capture that a camera needs, with the methods of a `Rasterizer`.

    detail : float [px]. Cells that a level was merged to are at most as wide in
        the picture.
    coefficients : int. Of a channel's harmonics, as `prepare` makes them.
    coarser : float. Factor on `detail` for all pictures.
    room : ChunkRoom, optional. Where pages lie, shared by those whose harmonics
        have the same degree.
    numbers_of : callable, optional. numbers_of(leaf, level, splats) returns what
        hits name the splats of a run, int32; without it they have no name.
        `prepare` must keep all splats then.
    detail : float [px]. Times `coarser`.
    used : dict. Of the last picture: `splats`, `pages` and `detail` [px].
    """

    _numbers = itertools.count()

    def __init__(
        self, pages, prepare, detail, coefficients, rasterizer_of=Rasterizer, coarser=1.0,
        compensate=False, room=None, numbers_of=None,
    ):  # fmt: skip
        self.pages, self._prepare, self._coefficients = pages, prepare, coefficients
        self.detail, self._rasterizer_of = detail * coarser, rasterizer_of
        self._compensate, self._numbers_of = compensate, numbers_of
        self._number = next(self._numbers)  # apart from other rasterizers of these pages
        self._front, self._fronts, self._held, self._rasterizer = None, 0, Held(), None
        self.room = room_for(pages) if room is None else room
        self.used = {}

    def recolor(self, front=None):
        """Draw the splats `front`, those of actors, before the pages from now on; None: no splats.

        Their numbers in `order` are 0 or more.
        """
        self._front, self._fronts = None, self._fronts + 1  # whose places are free now
        if front is not None:
            self._front = Stored(self.room, front)

    def take_colors(self):
        """Prepare all pages again from now on: their colours are others."""
        self._number = next(self._numbers)

    def draw(self, camera, near, plane=None, leading=False, threshold=None, **options):
        """Return the `Layers` that `camera` sees; `threshold` [px] is for `detail`."""
        self.hold(self._held, camera, near, plane, leading, threshold)
        prepared = self.prepared
        if self._rasterizer is None:
            self._rasterizer = self._rasterizer_of(prepared)
        self._rasterizer.recolor(prepared)  # it may draw for others as well
        return self._rasterizer.draw(camera, near, plane, among=self._held.chunks, **options)

    @property
    def prepared(self):
        """All places of the room as `PreparedSplats`."""
        return replace(self.room.prepared, compensate=self._compensate)

    def wanted(self, camera, near, plane=None, leading=False, threshold=None):
        """Return the runs that a camera needs, as (leaf, level) in the order of the index."""
        wanted, self.used = self._choose(camera, near, plane, leading, threshold)
        return wanted

    def _choose(self, camera, near, plane=None, leading=False, threshold=None):
        """Return the runs that a camera needs, and the numbers of splats and pages for `used`."""
        tree = self.pages.tree
        detail = self.detail if threshold is None else threshold
        detail *= MIRRORED if leading else 1.0
        levels, detail = chosen_levels(tree, camera, near, detail, self._most, plane)
        seen = np.flatnonzero(levels != NONE)
        wanted = list(zip(seen.tolist(), levels[seen].tolist(), strict=True))
        splats = int(tree.count[seen, levels[seen]].sum())
        used = {"splats": splats, "pages": len(wanted), "detail": detail}
        return ([(ALWAYS, 0), *wanted] if self.pages.always else wanted), used

    def load(self, camera, near):
        """Load now the pages that a picture of a camera is drawn of."""
        self.hold(self._held, camera, near)

    def hold(self, held, camera, near, plane=None, leading=False, threshold=None):
        """Let `held` hold the pages of a picture; the other parameters are those of `draw`."""
        self._take(held, self.wanted(camera, near, plane, leading, threshold), leading)

    def read_ahead(self, camera, near):
        """Begin to read the runs that a camera needs, on another thread."""
        kept = self.pages.kept
        wanted = self._choose(camera, near)[0]
        self.pages.read_ahead([key for key in wanted if not kept.has((self._number, *key))])

    @property
    def _most(self):
        """Splats of a picture that fit into the memory."""
        fine = max(self._coefficients - COARSE, 0)
        each = 4 * GEOMETRY + 12 * (self._coefficients - fine) + 6 * fine
        return max(int(self.pages.picture_memory / each), LANES)

    def _take(self, held, wanted, leading):
        """Let `held` hold the pages of a picture, and list their chunks."""
        key = self._number, self._fronts, tuple(wanted), leading
        if key == held.key:
            return
        keys = [(self._number, leaf, level) for leaf, level in wanted]
        pages = self.pages.kept.get_all(keys)
        # Places of the last picture's other pages are free for those that are made now.
        held.key, held.pages = None, [page for page in pages if page is not None]
        missing = [n for n, page in enumerate(pages) if page is None]
        for k, n in enumerate(missing):
            self.pages.read_ahead([wanted[m] for m in missing[k + 1 : k + 1 + BESIDE]])
            pages[n] = self._made(keys[n])
        parts = [NO_CHUNKS] if self._front is None else [self._front.first]
        parts += [page.first for page in pages]
        if not leading:
            parts += [page.last for page in pages]
        held.pages, held.chunks, held.key = pages, np.concatenate(parts), key

    def _made(self, key):
        """Return the page of a key (own number, leaf, level), made now."""
        splats = self.pages.splats(*key[1:])
        made = self._prepare(splats)
        numbers = np.full(len(splats), NOBODY, np.int32)
        if self._numbers_of is not None:
            numbers = self._numbers_of(*key[1:], splats)
        page = Stored(self.room, _numbered(made.first, numbers), _numbered(made.last, numbers))
        self.pages.kept.put(key, page, made.bytes)
        self.pages.read.drop(key[1:])  # seldom needed again as it was read
        return page


def rasterizer_of_scene(scene, render, rasterizer_of=Rasterizer, numbers_of=None):
    """Return the rasterizer of a scene's splats as captured, paged if the scene is in chunks.

    `detail` and `memory` of `render` hold for a scene in chunks; there `numbers_of` gives what hits
    name the splats, see `PagedRasterizer`.
    """
    if scene.pages is None:
        return rasterizer_of(replace(prepare(scene.splats), compensate=scene.antialiased))
    scene.pages.limit(render.memory)
    most = scene.splats.sh.shape[1]

    def page(splats):
        return Page(prepare(replace(splats, sh=padded(splats.sh, most))))

    return PagedRasterizer(
        scene.pages, page, render.detail, most, rasterizer_of, compensate=scene.antialiased,
        numbers_of=numbers_of,
    )  # fmt: skip


def _numbered(prepared, numbers):
    """Return prepared splats of a run with other numbers; None stays None."""
    return None if prepared is None else replace(prepared, order=numbers[prepared.order])
