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

from dataclasses import dataclass, replace

import numpy as np

from rainsim.errors import ParameterError, require_choice
from rainsim.jit import get_num_threads
from rainsim.scene.view import lens_array
from rainsim.splatting import project
from rainsim.splatting.blend import blend_tiles
from rainsim.splatting.level_choice import choose_levels
from rainsim.splatting.prepared import LANES, PreparedSplats, prepare, select
from rainsim.splatting.tiles import RECORD_BITS, list_tiles, tile_starts
from rainsim.splatting.weigh import add_weights, weigh_tiles

__all__ = ["Layers", "PreparedSplats", "Rasterizer", "prepare", "rasterize", "select"]


@dataclass(frozen=True)
class Layers:
    """A splatted picture.

    color : float32 array (height, width, 3). Display-referred, over black
        (multiplied by alpha) or the background asked for.
    alpha : float32 array (height, width)
    depth : float32 array (height, width) [world units]. Depth along the camera's
        z axis: the mean over the splats' centres, weighted as the colour is, or
        the centre of the splat at which half of the light is stopped ("median");
        infinite where alpha is below 0.02 (or, for the median, never reaches a
        half).
    plane_depth : float32 array (height, width) [world units]. Depth at which the
        pixel's ray meets the blended plane of the splats (PGSR, Chen et al. 2024,
        eq. 4): exact on flat surfaces. Equals `depth` where the plane is seen
        edge-on.
    normal : float32 array (height, width, 3). Unit, camera frame, towards the
        camera; zero where there is no depth.
    hit : int32 array (height, width), or None. If asked for: index, in the scene
        that was prepared, of the splat at which half of the light is stopped; -1
        where alpha never reaches a half.
    """

    color: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    plane_depth: np.ndarray
    normal: np.ndarray
    hit: np.ndarray | None = None


class Rasterizer:
    """Draws prepared splats; keeps its working memory from one picture to the next.

    prepared : PreparedSplats
    """

    def __init__(self, prepared):
        self.prepared = prepared
        self._record = np.empty((0, project.RECORD), np.float32)
        self._depth = np.empty(0, np.float64)
        self._box = np.empty((0, 4), np.int16)
        self._lane = np.empty(0, np.uint8)
        self._entry = np.empty(0, np.uint64)

    def recolor(self, prepared):
        """Take over `prepared`: the same splats in other colours, see `prepared.recolored`."""
        self.prepared = prepared

    def put_actors(self, merged):
        """Take over the same splats with other actors before them, see `merged.Merger`."""
        self.prepared = merged

    def pose_actors(self, actors, level=None):
        """Put the actors of an `ActorSplats` before the static set, where they are now.

        `level` is terrain and ground frame where that is the set of the level picture.
        """
        self.put_actors(actors.merged() if level is None else actors.standing(*level))

    def draw(
        self, camera, near, plane=None, depth="expected", compensate=False, degree=None,
        background=(0, 0, 0), hit=False, drop_last=False, leading=False, detail=0.0,
        among=None,
    ):  # fmt: skip
        """Return the `Layers` that `camera` sees; the same bytes for any number of threads.

        camera : Camera. Its matrix may also be a rotation with a reflection: a
            mirrored view.
        near : float [world units]. Splats whose centres are nearer are left out.
        plane : array_like of shape (4,), optional. (a, b, c, d): splats whose
            centres have a x + b y + c z < d are left out.
        depth : {"expected", "median"}
        compensate : bool. Weaken splats that the low-pass widens, as
            Mip-Splatting does; always done where the prepared splats ask for it.
        degree : int, optional. Highest degree of spherical harmonics used; all by
            default.
        background : array_like of shape (3,). Display-referred colour behind all
            splats.
        hit : bool. Also tell each pixel's splat; costs nothing if `depth` is
            "median", else one more blending.
        drop_last : bool. Leave out, as gsplat and the original code do, the splat
            that would bring a pixel's transmittance under 1e-4, and all behind
            it, however bright.
        leading : bool. Leave out the splats that were prepared to come last.
        detail : float [px]. Where the prepared splats have levels of detail
            (`splatting.detail`): splats are merged in cells that take at most so
            much of the picture; 0: all are drawn as they are.
        among : int64 array, optional. Chunks of which the picture is drawn, in
            the order that splats of one depth are taken in; without it all.
            Neither `leading` nor `detail` choose among them.
        """
        require_choice("depth", depth, ("expected", "median"))
        background = np.asarray(background, np.float32)
        compensate = bool(compensate or self.prepared.compensate)
        chunks, start = self._list(camera, near, plane, compensate, degree, leading, detail, among)
        halfway = depth == "median"
        layers, half = self._blend(camera, start, background, halfway, bool(drop_last))
        if hit:
            half = half if halfway else self._blend(
                camera, start, background, True, bool(drop_last)
            )[1]  # fmt: skip
            layers = replace(layers, hit=self._splats(half, chunks).reshape(half.shape))
        return layers

    def weigh(self, camera, near, part, step=1):
        """Return how much light each splat gives to parts of a picture.

        near : float [world units]
        part : int8 array (height, width). -1 for the pixels of the first part, 1
            for the second, 0 for the third.
        step : int [px]. Every step-th pixel of every step-th row is asked, and
            stands for those around it.
        Returns array (n, 4) [px]. For each splat of the scene that was prepared
            the sum over each part's pixels of its opacity there times the
            transmittance of the splats before it. Last, the sum of its opacity
            over the second part, as if no splat stood before it.
        """
        chunks, start = self._list(camera, near, None, self.prepared.compensate, None)
        weight = np.empty((start[-1], 4), np.float32)
        weigh_tiles(self._record, self._entry, start, camera.width, part, step, weight)
        light = np.empty((len(self.prepared.order), 4))
        add_weights(
            self._entry, chunks, self._lane, self.prepared.order, weight, step * step,
            get_num_threads(), light,
        )  # fmt: skip
        return light

    def _blend(self, camera, start, background, halfway, drop_last):
        """Return the `Layers` of the listed splats and, if asked for, each pixel's halfway one."""
        height, width = camera.height, camera.width
        layers = Layers(
            np.empty((height, width, 3), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width), np.float32),
            np.empty((height, width, 3), np.float32),
        )
        half = np.empty((height, width) if halfway else (0, width), np.uint32)
        blend_tiles(
            self._record, self._entry, start, height, width, lens_array(camera),
            bool(camera.orthographic), background, halfway, drop_last,
            layers.color.ravel(), layers.alpha.ravel(), layers.depth.ravel(),
            layers.plane_depth.ravel(), layers.normal.ravel(), half.ravel(),
        )  # fmt: skip
        return layers, half

    def _list(
        self, camera, near, plane, compensate, degree, leading=False, detail=0.0, among=None
    ):  # fmt: skip
        """Project the visible splats and list them by tile.

        Returns the indices of the chunks in sight and, for each tile, the start of its list.
        """
        across, down = -(-camera.width // project.TILE), -(-camera.height // project.TILE)
        view = np.ascontiguousarray(camera.camera_from_world, dtype=np.float32)
        deep = np.ascontiguousarray(camera.camera_from_world[2], dtype=np.float64)
        eye = (camera.forward if camera.orthographic else camera.position).astype(np.float32)
        frustum = project.Frustum(
            view, lens_array(camera), np.array([camera.width, camera.height], np.float32),
            np.float32(near), project.NO_PLANE if plane is None else np.asarray(plane, np.float32),
            bool(camera.orthographic),
        )  # fmt: skip
        p = self.prepared
        box = p.box if among is None else p.box[among]
        seen = np.empty(len(box), np.bool_)
        project.find_chunks(box, frustum, seen)
        if among is None:
            if leading and p.leading is not None:
                seen[p.leading :] = False
            if p.span is not None:
                choose_levels(p.span, p.reach, frustum, np.float32(detail), seen)
        chunks = np.flatnonzero(seen) if among is None else among[seen]
        self._make_room(len(chunks) * LANES)
        visible = np.zeros(len(chunks), np.int64)
        count = np.zeros((project.BLOCKS, across * down), np.int64)
        project.project_chunks(
            project.SplatChunks(p.geometry, p.sh, p.fine, p.step), chunks, frustum, deep, eye,
            compensate, p.degree if degree is None else min(degree, p.degree), across,
            self._record, self._depth, self._box, self._lane, visible, count,
        )  # fmt: skip
        start = tile_starts(count)
        if start[-1] > len(self._entry):
            self._entry = np.empty(int(start[-1] * 1.1), np.uint64)
        list_tiles(self._depth, self._box, visible, across, count, self._entry)
        return chunks, start

    def _splats(self, half, chunks):
        """Return the scene's splats behind records that `blend_tiles` wrote, -1 for none."""
        half = half.ravel()
        hit = np.full(len(half), -1, np.int32)
        pixels = np.flatnonzero(half)
        record = half[pixels].astype(np.int64) - 1
        hit[pixels] = self.prepared.order[chunks[record // LANES] * LANES + self._lane[record]]
        return hit

    def _make_room(self, places):
        if places > 1 << RECORD_BITS:
            raise ParameterError(
                f"{places} splats are in sight; they must be {1 << RECORD_BITS} at most; "
                "take a part of the scene"
            )
        if places > len(self._record):
            self._record = np.empty((places, project.RECORD), np.float32)
            self._depth = np.empty(places, np.float64)
            self._box = np.empty((places, 4), np.int16)
            self._lane = np.empty(places, np.uint8)


def rasterize(prepared, camera, near=0.01, **options):
    """Return the `Layers` that `camera` sees of `prepared` splats; see `Rasterizer.draw`."""
    return Rasterizer(prepared).draw(camera, near, **options)
