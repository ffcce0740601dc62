"""Draws a big capture: for each picture the chunks that its camera needs, put one after the other.

A leaf at a level is prepared once and kept as long as memory allows. The pages of a picture stand
in the order of the index, whatever was read first, so that a picture has the same bytes every time.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from rainsim.lod.choose import chosen_levels
from rainsim.raster import Rasterizer
from rainsim.scene.actors import padded
from rainsim.scene.formats.streamed import NONE
from rainsim.scene.pages import ALWAYS, levels_at
from rainsim.splatting.prepared import (
    COARSE,
    GEOMETRY,
    LANES,
    NOBODY,
    PreparedSplats,
    prepare,
)

ARRAYS = ("geometry", "sh", "fine", "step", "box")
GROWTH = 1.5  # times what a picture's pages need, of the memory that is set aside for them
MIRRORED = 2.0  # times the threshold in pictures that water and the surroundings mirror


@dataclass(frozen=True)
class Page:
    """The prepared splats of a leaf at a level; `last` those that mirrors leave out, or None."""

    first: PreparedSplats
    last: PreparedSplats | None = None

    @property
    def bytes(self):
        """What it takes."""
        parts = [self.first] if self.last is None else [self.first, self.last]
        return sum(getattr(p, name).nbytes for p in parts for name in (*ARRAYS, "order"))


class Room:
    """Memory for what a picture is drawn of, kept: to take it costs as much time as to fill it.

    Attributes
    ----------
    holds : object
        Whose pages were put there last.
    """

    def __init__(self):
        self.holds, self._arrays = None, {}

    def put(self, name, parts):
        """Return arrays with rows of one shape as one array, in the memory of that name."""
        rows, shape = sum(len(part) for part in parts), parts[0].shape[1:]
        size = rows * math.prod(shape)
        if name not in self._arrays or len(self._arrays[name]) < size:
            self._arrays[name] = np.empty(int(GROWTH * size), parts[0].dtype)
        return np.concatenate(parts, out=self._arrays[name][:size].reshape(rows, *shape))


class PagedRasterizer:
    """Draws what a camera needs of a big capture, with the methods of a `Rasterizer`.

    Parameters
    ----------
    pages : Pages
    prepare : callable
        prepare(splats) returns the `Page` of the `Splats` of a run.
    detail : float [px]
        Cells that a level was merged to are at most as wide in the picture.
    coefficients : int
        Of a channel's harmonics, as `prepare` makes them.
    rasterizer_of : callable
        rasterizer_of(prepared) returns what draws prepared splats.
    coarser : float
        Factor on `detail` for all pictures.
    compensate : bool
        See `PreparedSplats`.
    room : Room, optional
        Where the pages of a picture are put one after the other, shared by those who draw in turns.

    Attributes
    ----------
    used : dict
        Of the last picture: `splats`, `pages` and `detail` [px].
    """

    _numbers = itertools.count()

    def __init__(
        self, pages, prepare, detail, coefficients, rasterizer_of=Rasterizer, coarser=1.0,
        compensate=False, room=None,
    ):  # fmt: skip
        self.pages, self._prepare, self._coefficients = pages, prepare, coefficients
        self._detail, self._rasterizer_of = detail * coarser, rasterizer_of
        self._compensate = compensate
        self._number = next(self._numbers)  # apart from other rasterizers of these pages
        self._front, self._drawn, self._rasterizer = None, None, None
        self._room = Room() if room is None else room
        self.used = {}

    def recolor(self, front=None):
        """Draw prepared splats before the pages from now on, those of nodes; None: no such splats.

        Parameters
        ----------
        front : PreparedSplats, optional
            Their numbers in `order` are 0 or more.
        """
        self._front, self._drawn = front, None

    def take_colors(self):
        """Prepare all pages again from now on: their colours are others."""
        self._number, self._drawn = next(self._numbers), None

    def draw(self, camera, near, plane=None, leading=False, threshold=None, **options):
        """Return the `Layers` that `camera` sees; the parameters are those of `Rasterizer.draw`.

        `threshold` [px] takes the place of `detail` for this picture.
        """
        wanted = self.wanted(camera, near, plane, leading, threshold)
        self._assemble(wanted, leading)
        return self._rasterizer.draw(camera, near, plane, **options)

    def wanted(self, camera, near, plane=None, leading=False, threshold=None):
        """Return the runs that a camera needs, as (leaf, level) in the order of the index."""
        wanted, self.used = self._choose(camera, near, plane, leading, threshold)
        return wanted

    def _choose(self, camera, near, plane=None, leading=False, threshold=None):
        """Return the runs that a camera needs, and what `used` says of them."""
        tree = self.pages.tree
        detail = self._detail if threshold is None else threshold
        detail *= MIRRORED if leading else 1.0
        levels, detail = chosen_levels(tree, camera, near, detail, self._most, plane)
        wanted = [(int(n), int(levels[n])) for n in np.flatnonzero(levels != NONE)]
        splats = sum(int(tree.count[n, k]) for n, k in wanted)
        used = {"splats": splats, "pages": len(wanted), "detail": detail}
        return ([(ALWAYS, 0), *wanted] if self.pages.always else wanted), used

    def read_ahead(self, camera, near):
        """Begin to read what a camera needs, on another thread."""
        kept = self.pages.kept
        wanted = self._choose(camera, near)[0]
        self.pages.read_ahead([key for key in wanted if not kept.has((self._number, *key))])

    @property
    def _most(self):
        """Splats of a picture that fit into the memory."""
        fine = max(self._coefficients - COARSE, 0)
        each = 4 * GEOMETRY + 12 * (self._coefficients - fine) + 6 * fine
        return max(int(self.pages.picture_memory / each), LANES)

    def _assemble(self, wanted, leading):
        key = tuple(wanted), leading
        if key == self._drawn and self._room.holds is self:
            return
        pages = [self._page(*place) for place in wanted]
        parts = [page.first for page in pages]
        if not leading:
            parts += [page.last for page in pages if page.last is not None]
        if not parts and self._front is None:  # nothing of the capture is in the picture
            level = int(levels_at(self.pages.tree, self.pages.tree.levels - 1)[0])
            parts = [self._prepare(self.pages.splats(0, level).take(slice(0))).first]
        joined = together(parts, self._front, self._room)
        self._room.holds = self
        joined = replace(joined, compensate=self._compensate)
        if self._rasterizer is None:
            self._rasterizer = self._rasterizer_of(joined)
        else:
            self._rasterizer.recolor(joined)
        self._drawn = key

    def _page(self, leaf, level):
        key = self._number, leaf, level
        page = self.pages.kept.get(key)
        if page is None:
            page = self._prepare(self.pages.splats(leaf, level))
            self.pages.kept.put(key, page, page.bytes)
            self.pages.kept.drop((leaf, level))  # seldom needed again as it was read
        return page


def rasterizer_of_scene(scene, render, rasterizer_of=Rasterizer):
    """Return what draws a scene's splats as captured, from its chunks if it is in chunks.

    Parameters
    ----------
    scene : Scene
    render : RenderConfig
        Its `detail` and `memory` hold for a scene in chunks.
    rasterizer_of : callable
    """
    if scene.pages is None:
        return rasterizer_of(replace(prepare(scene.splats), compensate=scene.antialiased))
    scene.pages.limit(render.memory)
    most = scene.splats.sh.shape[1]

    def page(splats):
        return Page(prepare(replace(splats, sh=padded(splats.sh, most))))

    return PagedRasterizer(
        scene.pages, page, render.detail, most, rasterizer_of, compensate=scene.antialiased
    )


def together(parts, front=None, room=None):
    """Return several `PreparedSplats` as one, which names no scene's splats but those of `front`.

    Parameters
    ----------
    parts : sequence of PreparedSplats
        At least one, harmonics of the same degree.
    front : PreparedSplats, optional
        That comes before the others.
    room : Room, optional
        What the result is put into: what it held before is lost.
    """
    every = [*([] if front is None else [front]), *parts]
    every = [part for part in every if len(part.box)] or every[:1]  # empty ones know no degree
    room = Room() if room is None else room
    arrays = {name: room.put(name, [getattr(p, name) for p in every]) for name in ARRAYS}
    order = np.full(len(arrays["box"]) * LANES, NOBODY, np.int32)
    if front is not None:
        order[: len(front.order)] = front.order
    return replace(every[0], **arrays, order=order, leading=None)
