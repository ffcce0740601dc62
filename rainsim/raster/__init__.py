"""CPU tile splatting: splats and a camera in, colour, alpha, depth and normals out.

The pipeline of Kerbl et al. 2023 (ACM TOG 42(4)), section 6: project every splat to an ellipse,
list the splats of each tile of 16 x 16 pixels, sort each list by depth, blend front to back. Ours
differs in what suits a CPU: splats lie in Morton order in chunks that are left out whole where the
camera does not look and projected 16 at a time where it does (`prepared`, `project`); each tile
sorts its own short list while it is in cache (`tiles`); blocks of 4 x 4 pixels are blended in
vector registers (`blend`, `lanes`).

Rules of the picture (those of gsplat's classic mode): 0.3 px^2 is added to the projected
covariance, contributions under 1/255 are skipped, opacity is capped at 0.999, a splat's depth order
is that of its centre. A block of 4 x 4 pixels stops when each lets less than 1e-4 through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rainsim.errors import require_choice
from rainsim.jit import get_num_threads
from rainsim.raster.blend import blend_tiles
from rainsim.raster.prepared import LANES, PreparedSplats, prepare, select
from rainsim.raster.project import BLOCKS, NO_PLANE, RECORD, TILE, find_chunks, project_chunks
from rainsim.raster.tiles import list_tiles, tile_starts

__all__ = ["Layers", "PreparedSplats", "Rasterizer", "prepare", "rasterize", "select"]


@dataclass(frozen=True)
class Layers:
    """A splatted picture.

    Attributes
    ----------
    color : ndarray of shape (height, width, 3), float32
        Display-referred, over black (multiplied by alpha).
    alpha : ndarray of shape (height, width), float32
    depth : ndarray of shape (height, width), float32 [world units]
        Depth along the camera's z axis: the mean over the splats' centres, weighted as the colour
        is, or the centre of the splat at which half of the light is stopped ("median"); infinite
        where alpha is below 0.02 (or, for the median, never reaches a half).
    plane_depth : ndarray of shape (height, width), float32 [world units]
        Depth at which the pixel's ray meets the blended plane of the splats (PGSR, Chen et al.
        2024, eq. 4): exact on flat surfaces. Equals `depth` where the plane is seen edge-on.
    normal : ndarray of shape (height, width, 3), float32
        Unit, camera frame, towards the camera; zero where there is no depth.
    """

    color: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    plane_depth: np.ndarray
    normal: np.ndarray


class Rasterizer:
    """Draws prepared splats; keeps its working memory from one picture to the next.

    Parameters
    ----------
    prepared : PreparedSplats
    """

    def __init__(self, prepared):
        self.prepared = prepared
        self._record = np.empty((0, RECORD), np.float32)
        self._box = np.empty((0, 4), np.int16)
        self._entry = np.empty(0, np.uint64)

    def draw(self, camera, near, plane=None, depth="expected", compensate=False, degree=None):
        """Return the `Layers` that `camera` sees; the same bytes for any number of threads.

        Parameters
        ----------
        camera : Camera
            Its matrix may also be a rotation with a reflection: a mirrored view.
        near : float [world units]
            Splats whose centres are nearer are left out.
        plane : array_like of shape (4,), optional
            (a, b, c, d): splats whose centres have a x + b y + c z < d are left out.
        depth : {"expected", "median"}
        compensate : bool
            Weaken splats that the low-pass widens, as Mip-Splatting does.
        degree : int, optional
            Highest degree of spherical harmonics used; all by default.
        """
        require_choice("depth", depth, ("expected", "median"))
        height, width = camera.height, camera.width
        across, down = -(-width // TILE), -(-height // TILE)
        view = np.ascontiguousarray(camera.camera_from_world, dtype=np.float32)
        eye = (camera.forward if camera.orthographic else camera.position).astype(np.float32)
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
        size = np.array([width, height], np.float32)
        plane = NO_PLANE if plane is None else np.asarray(plane, np.float32)
        near, flat = np.float32(near), bool(camera.orthographic)
        p = self.prepared
        seen = np.empty(len(p.box), np.bool_)
        find_chunks(p.box, view, lens, size, near, plane, flat, seen)
        chunks = np.flatnonzero(seen)
        self._make_room(len(chunks) * LANES)
        visible = np.zeros(len(chunks), np.int64)
        count = np.zeros((BLOCKS, across * down), np.int64)
        stored = int(np.sqrt(p.sh.shape[1] // (3 * LANES))) - 1
        project_chunks(
            p.geometry, p.sh, chunks, view, eye, lens, size, near, plane, flat, bool(compensate),
            stored if degree is None else min(degree, stored), across,
            self._record, self._box, visible, count,
        )  # fmt: skip
        start = tile_starts(count)
        if start[-1] > len(self._entry):
            self._entry = np.empty(int(start[-1] * 1.1), np.uint64)
        list_tiles(self._record, self._box, visible, across, count, self._entry)
        layers = Layers(
            np.empty((height, width, 3), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width, 3), np.float32),
        )
        threads = get_num_threads()
        turn = np.concatenate([np.arange(first, down, threads) for first in range(threads)])
        blend_tiles(
            self._record, self._entry, start, turn, height, width, lens, flat, depth == "median",
            layers.color.ravel(), layers.alpha.ravel(), layers.depth.ravel(),
            layers.plane_depth.ravel(), layers.normal.ravel(),
        )  # fmt: skip
        return layers

    def _make_room(self, places):
        if places > len(self._record):
            self._record = np.empty((places, RECORD), np.float32)
            self._box = np.empty((places, 4), np.int16)


def rasterize(prepared, camera, near=0.01, **options):
    """Return the `Layers` that `camera` sees of `prepared` splats; see `Rasterizer.draw`."""
    return Rasterizer(prepared).draw(camera, near, **options)
