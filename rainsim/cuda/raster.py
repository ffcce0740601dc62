"""Twin of `rainsim.raster`: splats and a camera in, colour, alpha, depth and normals out.

Same rules of the picture and same prepared splats as on the CPU; colours' coefficients are kept in
half precision. The work is laid out as a GPU wants it: one list of all tiles' entries, sorted by
tile and depth in one radix sort (`project`), blended by warps (`blend`). The host reads how many
entries there are, makes room where they lacked it, and lists them again.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rainsim import raster
from rainsim.cuda.driver import fetch, one_fault, prepare, send
from rainsim.cuda.jit import SIMULATED, cuda
from rainsim.cuda.lod.room import DeviceRoom
from rainsim.cuda.splatting import blend, project
from rainsim.cuda.splatting.prepared import MOST_NUMBERS, DeviceSplats
from rainsim.cuda.splatting.sort import sort_pairs
from rainsim.errors import require_choice
from rainsim.splatting.prepared import LANES
from rainsim.splatting.project import FRUSTUM_MARGIN, NO_PLANE, TILE

ROOM = 1.3  # entries that there is room for, over the number of a picture that lacked it
SIZES = 8  # of pictures whose views are kept
THREADS = 256


@dataclass(frozen=True)
class DeviceLayers:
    """The pictures of `rainsim.raster.Layers` on the device, of the same shapes."""

    color: object
    alpha: object
    depth: object
    plane_depth: object
    normal: object

    def to_host(self):
        """Return the pictures as `rainsim.raster.Layers`."""
        arrays = self.color, self.alpha, self.depth, self.plane_depth, self.normal
        return raster.Layers(*(array.copy_to_host() for array in arrays))


def _levels(width, height):
    """Return how many levels of depth a key tells apart beside the tiles of a picture."""
    tiles = -(-width // TILE) * -(-height // TILE)
    return min((1 << 32) // tiles, 1 << 24) - 1


class Workspace:
    """Memory that rasterizers share: each picture is queued before the next begins."""

    def __init__(self):
        self._taken = {}

    def take(self, name, count, *kinds):
        """Return arrays with room for `count`, of so many numbers each: (number, type)."""
        room, arrays = self._taken.get(name, (-1, ()))
        if count > room:
            arrays = self._taken[name] = ()  # freed before more is asked for
            arrays = tuple(cuda.device_array(max(n * count, 1), kind) for n, kind in kinds)
            self._taken[name] = count, arrays
        return arrays


class Rasterizer:
    """Draws prepared splats on the GPU; keeps its working memory from one picture to the next.

    plain : bool. Take the kernels without warp instructions: slow, for tests of
        the others.
    workspace : Workspace, optional. Shared with others.
    chosen : int64 array or None. Of a `DeviceRoom` the chunks that are drawn, see
        `choose`.
    """

    def __init__(self, prepared, plain=False, workspace=None):
        prepare()
        self.splats = prepared
        if not isinstance(prepared, DeviceSplats):
            self.splats = (DeviceSplats if prepared.written is None else DeviceRoom)(prepared)
        self.chosen, self._picked = None, None
        self.plain = plain or SIMULATED
        self._now = cuda.device_array(project.CAMERA, np.float32)
        self._total = cuda.device_array(1, np.int32)
        self.entries, self._room = 0, self.splats.count
        self.workspace = Workspace() if workspace is None else workspace
        self._own, self._layers = Workspace(), {}  # pictures, and their views by size

    @cached_property
    def size(self):
        """Width and height of the picture [px], device array of shape (2,), float32."""
        return self._now[project.NEAR + 1 : project.NEAR + 3]

    @cached_property
    def lens(self):
        """Focal lengths and principal point (fx, fy, cx, cy) [px], device array, float32."""
        return self._now[project.LENS : project.PLANE]

    @cached_property
    def _parts(self):
        """Return pose, depths, and plane among the numbers of the camera, device arrays."""
        now = self._now
        pose = now[: project.EYE].reshape(3, 4)
        return pose, now[project.NEAR : project.LIMITS], now[project.PLANE : project.NEAR]

    def recolor(self, prepared):
        """Take over other colours, see `DeviceSplats.send_colors`."""
        self.splats.send_colors(prepared)

    def put_actors(self, merged):
        """Put other actors before the static set, see `DeviceSplats.put_actors`."""
        self.splats.put_actors(merged)

    def pose_actors(self, actors, level=None):
        """Put actors where they are; the parameters are those of the CPU's."""
        self.splats.pose_actors(actors, level)

    def choose(self, chunks):
        """Draw some chunks of a `DeviceRoom` from now on."""
        splats = self.splats
        splats.send(chunks)
        if self.chosen is chunks and len(self._picked[0]) == splats.chunks:
            return
        span = np.full((splats.chunks, 2), np.inf, np.float32)
        rank = np.zeros(splats.chunks, np.int32)
        span[chunks, 0], rank[chunks] = 0, np.arange(len(chunks))
        self._picked, self.chosen = (cuda.to_device(span), cuda.to_device(rank)), chunks

    @one_fault()
    def draw(
        self, camera, near, plane=None, depth="expected", compensate=False, degree=None,
        background=(0, 0, 0), hit=False, drop_last=False, leading=False, detail=0.0, among=None,
        on_device=False,
    ):  # fmt: skip
        """Return the `Layers` that `camera` sees, on the host; see `rainsim.raster`.

        Or, `on_device`, its `DeviceLayers`, which the next picture overwrites; `background` and
        `hit` are not for those.
        """
        if among is not None:
            self.splats.aim_at(self.splats.host_box[among])
            self.choose(among)
        require_choice("depth", depth, ("expected", "median"))
        how = compensate, degree, drop_last, leading, detail
        layers = self._picture(camera, near, plane, depth, *how)
        if on_device:
            return layers
        layers = layers.to_host()
        if hit:
            digits = [
                self._picture(camera, near, plane, "median", *how, divisor).depth.copy_to_host()
                for divisor in self.splats.divisors()
            ]
            layers = replace(layers, hit=self.splats.of_digits(digits))
        if np.any(background):
            clear = (1 - layers.alpha)[..., None]
            layers.color[...] += clear * np.asarray(background, np.float32)
        return layers

    def _picture(
        self, camera, near, plane, depth, compensate, degree, drop_last, leading, detail,
        divisor=None,
    ):  # fmt: skip
        """Queue a picture and return its `DeviceLayers`.

        With a `divisor` depths are digits of the splats' numbers, see `project.number_records`.
        """
        s, (width, height) = self.splats, (camera.width, camera.height)
        send(self._now, self._numbers_of(camera, near, plane, detail))
        flat, bands = bool(camera.orthographic), s.bands if degree is None else degree + 1
        bands, compensate = min(bands, s.bands), bool(compensate or s.compensate)
        ranges = self._list(width, height, flat, compensate, bands, leading)
        record, _ = self._records()
        if divisor is not None:
            places = s.chunks * LANES
            project.number_records[-(-places // THREADS), THREADS](
                places, divisor, MOST_NUMBERS, record
            )
        layers, flat_layers = self._pictures(width, height)
        across, down = -(-width // TILE), -(-height // TILE)
        how, now = (flat, depth == "median", bool(drop_last)), self._now
        value = self._lists()[1]
        if self.plain:
            blend.blend_pixel_by_pixel[(across, down), (TILE, TILE)](
                value, *ranges, record, now, width, height, *how, *flat_layers
            )
        else:
            blend.BLEND_SQUARES[how[1:]][across * down, 32 * blend.WARPS](
                value, *ranges, record, now, width, height, flat, across, np.float32(1 / across),
                *flat_layers,
            )  # fmt: skip
        return layers

    def _records(self):
        """Return the projected splats and which chunks are seen, device arrays."""
        kinds = (LANES * project.RECORD, np.float32), (1, np.bool_)
        return self.workspace.take("records", self.splats.chunks, *kinds)

    def _lists(self):
        """Return keys and values and the arrays they are sorted into."""
        return self.workspace.take("lists", self._room, *(4 * [(1, np.uint32)]))

    def _list(self, width, height, flat, compensate, bands, leading):
        """Queue the sorted entries of a picture; return where each tile's begin and end."""
        s, now, (record, seen) = self.splats, self._now, self._records()
        span, rank = self._picked or (s.span, s.rank)
        chunks = int(s.leading if leading else len(span))
        across, levels = -(-width // TILE), _levels(width, height)
        tiles = across * -(-height // TILE)
        begin, end = self._own.take("ranges", tiles, (1, np.int32), (1, np.int32))
        pose, near, plane = self._parts
        blocks = -(-max(len(begin), chunks) // THREADS)
        lister = project.list_kernel(self.plain)
        while True:
            key, value, key_sorted, value_sorted = self._lists()
            project.start[blocks, THREADS](
                chunks, s.box, span, s.around, pose, self.lens, self.size, near, plane, flat, seen,
                begin, end, self._total,
            )  # fmt: skip
            if chunks:
                lister[chunks, THREADS](
                    s.geometry, s.sh, seen, now, flat, compensate, bands, s.groups, across,
                    levels, record, key, value, self._total,
                )  # fmt: skip
            self.entries = int(fetch(self._total)[0])
            if self.entries <= len(key):
                break
            self._room = int(ROOM * self.entries) + THREADS
        if self.entries:
            sort_pairs(key, value, key_sorted, value_sorted, self.entries, self.workspace)
            project.find_ranges[-(-self.entries // THREADS), THREADS](
                self.entries, levels, key_sorted, value_sorted, record, rank, begin, end, value
            )
        return begin, end

    def _pictures(self, width, height):
        """Return the `DeviceLayers` of a size [px] and their flat arrays, which may be longer."""
        channels, pixels = (3, 1, 1, 1, 3), width * height
        arrays = self._own.take("pictures", pixels, *((n, np.float32) for n in channels))
        if self._layers.get("of") is not arrays or len(self._layers) > SIZES:
            self._layers = {"of": arrays}
        if (width, height) not in self._layers:
            shapes = ((height, width, 3) if n == 3 else (height, width) for n in channels)
            self._layers[width, height] = DeviceLayers(*(
                array[: n * pixels].reshape(shape)
                for array, n, shape in zip(arrays, channels, shapes, strict=True)
            ))  # fmt: skip
        return self._layers[width, height], arrays

    def _numbers_of(self, camera, near, plane, detail):
        """Return the numbers that the kernels read of a camera, float64; see `project`."""
        numbers = np.zeros(project.CAMERA)
        width, height = camera.width, camera.height
        numbers[project.VIEW : project.EYE] = camera.camera_from_world[:3].ravel()
        exact = camera.camera_from_world[2]
        numbers[project.REST : project.REST + 4] = exact - exact.astype(np.float32)
        eye = camera.forward if camera.orthographic else camera.position
        numbers[project.EYE : project.EYE + 3] = eye
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        numbers[project.PLANE : project.PLANE + 4] = NO_PLANE if plane is None else plane
        x, y = FRUSTUM_MARGIN * width, FRUSTUM_MARGIN * height
        numbers[project.LENS : project.LENS + 4] = fx, fy, cx, cy
        ahead = float(exact[:3] @ self.splats.centre + exact[3])
        far = max(ahead + self.splats.reach, 2 * near)
        numbers[project.NEAR : project.SCALE + 5] = (
            near, width, height, detail, (-cx - x) / fx, (width - cx + x) / fx, (-cy - y) / fy,
            (height - cy + y) / fy, *project.depth_scale(near, far, _levels(width, height)),
        )  # fmt: skip
        return numbers


def rasterize(prepared, camera, near=0.01, **options):
    """Return the `Layers` that `camera` sees of `prepared` splats; see `Rasterizer.draw`."""
    return Rasterizer(prepared).draw(camera, near, **options)
