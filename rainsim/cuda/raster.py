"""Twin of `rainsim.raster`: splats and a camera in, colour, alpha, depth and normals out.

Same rules of the picture and same prepared splats as on the CPU; colours' coefficients are kept in
half precision. The work is laid out as a GPU wants it: one list of all tiles' entries, sorted by
tile and depth in one radix sort (`project`), blended by warps (`blend`). A picture is a fixed
queue of launches that asks the host nothing. The lists have a capacity; how many entries there were
is counted, and a picture with too many is drawn again with more room.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rainsim import raster
from rainsim.cuda.driver import one_fault, prepare
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import SIMULATED, cuda, pinned
from rainsim.cuda.lod.room import DeviceRoom
from rainsim.cuda.small_copies import copy_small
from rainsim.cuda.splatting import blend, project
from rainsim.cuda.splatting.prepared import MOST_NUMBERS, DeviceSplats
from rainsim.cuda.splatting.sort import sorter
from rainsim.errors import require_choice
from rainsim.splatting.prepared import LANES
from rainsim.splatting.project import FRUSTUM_MARGIN, NO_PLANE, TILE

# Entries there is room for, over the number that a picture had. A queue is recorded again when this
# changes, which takes as long as 20 to 100 frames; the sort of 40 % more takes 1 to 2 % of a frame.
ROOM = 1.4
MOST_ROOM = 1.5  # over what there should be, up to which it is left
NEARLY_FULL = 0.985  # share of the room from which on more is made before the next picture
FIRST_ROOM = 4  # entries per splat before anything was counted
THREADS = 256


@dataclass(frozen=True)
class DeviceLayers:
    """The pictures of `rainsim.raster.Layers` on the device, flat arrays."""

    color: object
    alpha: object
    depth: object
    plane_depth: object
    normal: object

    def to_host(self, height, width):
        """Return the pictures as `rainsim.raster.Layers`."""
        shape = (height, width)
        return raster.Layers(
            self.color.copy_to_host().reshape(*shape, 3), self.alpha.copy_to_host().reshape(shape),
            self.depth.copy_to_host().reshape(shape),
            self.plane_depth.copy_to_host().reshape(shape),
            self.normal.copy_to_host().reshape(*shape, 3),
        )  # fmt: skip


def _levels(width, height):
    """Return how many levels of depth a key tells apart beside the tiles of a picture."""
    tiles = -(-width // TILE) * -(-height // TILE)
    return min((1 << 32) // tiles, 1 << 24) - 1


class Workspace:
    """Memory that the rasterizers of one stream share: each is done before the next begins.

    Projected splats, lists and pictures.

    version : int. Changes when arrays that were taken are replaced by new ones.
    """

    def __init__(self):
        self.version = new_version()
        self._arrays, self._room = {}, {}

    @property
    def size(self):
        """Bytes that it takes."""
        return sum(array.nbytes for arrays in self._arrays.values() for array in arrays)

    def _take(self, name, count, kinds):
        """Return arrays with room for `count`, of so many numbers each: `kinds`, (number, type)."""
        if count > self._room.get(name, -1):
            self._room[name], self._arrays[name] = count, ()  # freed before more is asked for
            self._arrays[name] = tuple(cuda.device_array(n * count, kind) for n, kind in kinds)
            self.version = new_version()
        return self._arrays[name]

    def records(self, chunks):
        """Return arrays for the projected splats of so many chunks and for the seen chunks."""
        kinds = (LANES * project.RECORD, np.float32), (1, np.bool_)
        return self._take("records", chunks, kinds)

    def lists(self, count):
        """Return keys, values and the arrays they are sorted into, each of `count` entries."""
        return tuple(array[:count] for array in self._take("lists", count, 4 * [(1, np.uint32)]))

    def memory(self, size):
        """Return at least `size` bytes to sort with."""
        return self._take("memory", size, [(1, np.uint8)])[0]

    def pictures(self, pixels):
        """Return the `DeviceLayers` of a picture."""
        channels = 3, 1, 1, 1, 3
        arrays = self._take("pictures", pixels, [(n, np.float32) for n in channels])
        return DeviceLayers(*(a[: n * pixels] for a, n in zip(arrays, channels, strict=True)))

    def trim(self, count):
        """Give lists and memory back if there is room for more than `count` entries."""
        if self._room.get("lists", 0) > count:
            for name in ("lists", "memory"):
                self._arrays.pop(name, None)
                self._room.pop(name, None)
            self.version = new_version()


class Taken(NamedTuple):
    """What a rasterizer has taken of its `Workspace`, of one of its versions."""

    version: int
    lists: tuple  # keys, values and the arrays they are sorted into
    record: object  # the projected splats
    seen: object  # which chunks are seen
    layers: DeviceLayers
    sort: object  # sort() queues it


class EntryRoom:
    """How many entries the pictures of a rasterizer have, and for how many there is room.

    size : int. Entries that there is room for.
    count : pinned int32 array (1,). Entries of the finished picture.
    """

    def __init__(self):
        self.size, self.count = 0, pinned(1, np.int32)
        self._highest = self._pictures = 0  # entries, and pictures they were counted in
        self._patience = 1  # pictures after which too much room is given back

    @property
    def entries(self):
        """Number of entries of the finished picture."""
        return int(self.count[0])

    def overflows(self):
        """Return whether the finished picture had more entries than there was room for."""
        return self.entries > self.size

    def is_tight(self):
        """Return whether the next picture of a moving camera may find too little room."""
        return self.entries > NEARLY_FULL * self.size

    def count_picture(self):
        """Count the entries of the finished picture; return whether there was far too much room.

        All of the room is sorted. What most entries of several pictures leave unused is given back:
        at first after one picture, then each time after twice as many as before.
        """
        self._highest, self._pictures = max(self._highest, self.entries), self._pictures + 1
        if self._pictures < self._patience:
            return False
        loose = self.size > MOST_ROOM * (ROOM * self._highest + THREADS)
        if not loose:
            self._start_counting()
        return loose

    def _start_counting(self):
        self._highest, self._pictures, self._patience = 0, 0, 2 * self._patience

    def hold(self, count):
        """Choose the room for pictures of so many entries."""
        self.size = int(ROOM * count) + THREADS

    def fit(self, spare=1.0):
        """Choose the room for as many entries as the counted pictures had, times `spare`."""
        self.hold(spare * max(self._highest, self.entries))
        self._start_counting()


class Rasterizer:
    """Draws prepared splats on the GPU; keeps its working memory from one picture to the next.

    prepared : PreparedSplats
    stream : numba.cuda.stream, optional
    plain : bool. Take the kernels without warp instructions: slow, for tests of
        the others.
    workspace : Workspace, optional. That of another rasterizer of the same
        stream.
    first_room : int, optional. Entries to make room for before anything was
        counted.
    leading : bool. Leave out the splats that were prepared to come last.
    aim : callable, optional. aim(now) queues what writes the camera's numbers
        into a device array, at each launch; without it those that `update` takes
        over are sent.
    room : EntryRoom
    recolors : bool. Whether `recolor` and `pose_actors` send what they take over.
    actors : ActorSplats or None. Those of `pose_actors`.
    chosen : int64 array or None. Of a `DeviceRoom` the chunks that are drawn, see
        `choose`.
    """

    def __init__(
        self, prepared, stream=None, plain=False, workspace=None, first_room=None, leading=False,
        aim=None,
    ):  # fmt: skip
        self.splats = prepared
        if not isinstance(prepared, DeviceSplats):
            self.splats = (DeviceSplats if prepared.written is None else DeviceRoom)(prepared)
        self.chosen, self._picked = None, (self.splats.span, self.splats.rank)
        self._take_chunks(leading)
        prepare()
        self.stream = cuda.stream() if stream is None else stream
        self.plain = plain or SIMULATED
        self._camera = FrameUniforms(self.stream, {"now": ((project.CAMERA,), np.float32)})
        self._aim = aim
        self._total = cuda.device_array(1, np.int32)
        self._size = self._asked = self._version = None
        self.room, self._first_room = EntryRoom(), first_room
        self.recolors, self.actors = True, None
        self.workspace = Workspace() if workspace is None else workspace
        self._taken = None

    @cached_property
    def size(self):
        """Width and height of the picture [px], device array of shape (2,), float32."""
        return self._camera["now"][project.NEAR + 1 : project.NEAR + 3]

    @cached_property
    def lens(self):
        """Focal lengths and principal point (fx, fy, cx, cy) [px], device array, float32."""
        return self._camera["now"][project.LENS : project.PLANE]

    @property
    def layers(self):
        """The pictures, `DeviceLayers`; those of the next one of this stream overwrite them."""
        return self._taken.layers

    def recolor(self, prepared):
        """Take over other colours, unless a `DeviceFrame` sends them when the device is idle."""
        if self.recolors:
            self.splats.send_colors(prepared)

    def put_actors(self, merged):
        """Put other actors before the static set, see `DeviceSplats.put_actors`."""
        self.splats.put_actors(merged)

    def pose_actors(self, actors):
        """Put actors where they are, unless a `DeviceFrame` does when the device is idle."""
        self.actors = actors
        if self.recolors:
            self.send_actors()

    def send_actors(self, stream=0):
        """Pose the actors that wait; the device must draw nothing. Without a stream this waits."""
        self.splats.pose_actors(self.actors, stream)

    def choose(self, chunks):
        """Draw some chunks of a `DeviceRoom` from now on; the device must be idle meanwhile."""
        splats = self.splats
        splats.send(chunks)
        span = np.full((splats.chunks, 2), np.inf, np.float32)
        rank = np.zeros(splats.chunks, np.int32)
        span[chunks, 0], rank[chunks] = 0, np.arange(len(chunks))
        if self.chosen is None or len(self._picked[0]) != len(span):
            self._picked, self._taken = (cuda.to_device(span), cuda.to_device(rank)), None
            self._version = new_version()
        else:
            for there, now in zip(self._picked, (span, rank), strict=True):
                there.copy_to_device(now)
        self.chosen = chunks
        self._take_chunks(False)

    @one_fault()
    def draw(
        self, camera, near, plane=None, depth="expected", compensate=False, degree=None,
        background=(0, 0, 0), hit=False, drop_last=False, leading=False, detail=0.0, among=None,
    ):  # fmt: skip
        """Return the `Layers` that `camera` sees, on the host; see `rainsim.raster`."""
        if among is not None:
            self.splats.aim_at(self.splats.host_box[among])
            self.choose(among)
        size = camera.height, camera.width
        self.update(camera, near, plane, depth, compensate, degree, drop_last, detail=detail)
        self._take_chunks(leading)
        while True:
            self.launch()
            self.stream.synchronize()
            if not self.grow():
                break
        layers = self.layers.to_host(*size)
        self.make_ahead()
        if hit:
            self.update(camera, near, plane, "median", compensate, degree, drop_last, detail=detail)
            digits = []
            for divisor in self.splats.divisors():
                self.launch(divisor)
                self.stream.synchronize()
                digits.append(self.layers.depth.copy_to_host().reshape(size))
            layers = replace(layers, hit=self.splats.of_digits(digits))
        self._take_chunks(False)
        if np.any(background):
            clear = (1 - layers.alpha)[..., None]
            layers.color[...] += clear * np.asarray(background, np.float32)
        return layers

    def _take_chunks(self, leading):
        """Choose the chunks to draw: all, or only the `leading` ones."""
        self._chunks = int(self.splats.leading if leading else len(self._picked[0]))

    def update(
        self, camera, near, plane=None, depth="expected", compensate=False, degree=None,
        drop_last=False, room=None, detail=0.0,
    ):  # fmt: skip
        """Take over camera and options of the next pictures; the device only allocates room.

        camera, near, plane, depth, compensate, degree, drop_last, detail. As
            `draw` takes them.
        room : tuple of int [px], optional. Columns and rows of which the camera's
            picture is the upper left part: pictures of changing size are one
            recorded queue.
        """
        s, (width, height) = self.splats, room or (camera.width, camera.height)
        if self._aim is None:
            self._camera.update(now=self.numbers_of(camera, near, plane, room, detail))
        kind = width, height, camera.orthographic, depth, compensate, degree, drop_last
        if kind == self._asked and self._is_taken():
            return
        self._asked = kind
        require_choice("depth", depth, ("expected", "median"))
        self._bands = s.bands if degree is None else min(degree + 1, s.bands)
        tiles = -(-width // TILE) * -(-height // TILE)
        compensate = bool(compensate or s.compensate)
        self._kind = bool(camera.orthographic), compensate, depth == "median", bool(drop_last)
        if self._size != (width, height):
            self._size = width, height
            self._range = cuda.device_array(2 * tiles, np.int32)
            self._taken, self._version = None, new_version()
        if self.room.size == 0:
            first = FIRST_ROOM * s.count if self._first_room is None else self._first_room
            self.room.hold(first + tiles)
            self._taken = None
        self._take()

    def _is_taken(self):
        return self._taken is not None and self._taken.version == self.workspace.version

    def _take(self):
        """Take the workspace's present lists and pictures, unless they are taken already."""
        if self._is_taken():
            return
        space, (width, height) = self.workspace, self._size
        lists, layers = space.lists(self.room.size), space.pictures(width * height)
        records = space.records(self.splats.chunks)
        sort = sorter(lists, self.stream, space)
        self._taken = Taken(space.version, lists, *records, layers, sort)

    def numbers_of(self, camera, near, plane=None, room=None, detail=0.0):
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
            (height - cy + y) / fy,
            *project.depth_scale(near, far, _levels(*(room or (width, height)))),
        )  # fmt: skip
        return numbers

    def launch(self, divisor=None):
        """Queue the picture: copies and kernels only, so that a graph can record it.

        With a `divisor` depths are digits of the splats' numbers, see `project.number_records`.
        """
        self._take()
        s, stream, chunks, taken = self.splats, self.stream, self._chunks, self._taken
        record, seen = taken.record, taken.seen[:chunks]
        span, rank = self._picked
        width, height = self._size
        flat, compensate, median, drop = self._kind
        across = -(-width // TILE)
        now, (key, value, key_sorted, value_sorted) = self._camera["now"], taken.lists
        levels = _levels(width, height)
        if self._aim is None:
            self._camera.send()
        else:
            self._aim(now)
        blocks = max(1, min(-(-max(len(key), chunks) // THREADS), 2048))
        blocks = max(blocks, -(-chunks // THREADS))
        project.start[blocks, THREADS, stream](
            s.box[:chunks], span, s.around, now[: project.EYE].reshape(3, 4),
            now[project.LENS : project.PLANE], self.size, now[project.NEAR : project.LIMITS],
            now[project.PLANE : project.NEAR], flat, seen, key, self._range, self._total,
        )  # fmt: skip
        if chunks:
            lister = project.list_kernel(self.plain)
            lister[chunks, THREADS, stream](
                s.geometry, s.sh, seen, now, flat, compensate, self._bands, s.groups, across,
                levels, record, key, value, self._total,
            )  # fmt: skip
        taken.sort()
        tiles = len(self._range) // 2
        begin, end = self._range[:tiles], self._range[tiles:]
        project.find_ranges[-(-len(key) // THREADS), THREADS, stream](
            self._total, levels, key_sorted, value_sorted, record, rank, begin, end, value
        )
        if divisor is not None:
            places = self.splats.chunks * LANES
            project.number_records[-(-places // THREADS), THREADS, stream](
                places, divisor, MOST_NUMBERS, record
            )
        out = taken.layers
        pictures = out.color, out.alpha, out.depth, out.plane_depth, out.normal
        if self.plain:
            blend.blend_pixel_by_pixel[
                (-(-width // TILE), -(-height // TILE)), (TILE, TILE), stream
            ](value, begin, end, record, now, width, height, flat, median, drop, *pictures)
        else:
            kernel = blend.BLEND_SQUARES[median, drop]
            kernel[tiles, 32 * blend.WARPS, stream](
                value, begin, end, record, now, width, height, flat, across,
                np.float32(1 / across), *pictures,
            )  # fmt: skip
        copy_small(self._total, self.room.count, stream)

    def grow(self, spare=1.0):
        """Make room, times `spare`, if the finished picture lacked any; return whether it did."""
        lacking = self.lacks
        if lacking:
            self._make_room(spare)
        return lacking

    @property
    def lacks(self):
        """Whether the finished picture had too little room."""
        return self.room.overflows()

    def make_ahead(self):
        """Make room where little is left, and free what pictures in turn have left unused.

        Before, this waits for the device, which may still use it.
        """
        if self.room.count_picture() or self.room.is_tight():
            cuda.synchronize()
            self._make_room()

    def is_amiss(self):
        """Count the finished picture; return whether it had too little room or far too much."""
        return self.room.count_picture() or self.room.overflows() or self.room.is_tight()

    def _make_room(self, spare=1.0):
        """Make room for as many entries as the counted pictures had, and some more."""
        before = self.room.size
        self.room.fit(spare)
        self._taken = None
        self._take()
        if self.room.size < before:
            self.workspace.trim(self.room.size)
            self._take()

    @property
    def queue(self):
        """The values a recorded queue of launches depends on: when they change, record again."""
        kind = self._kind, self._bands, self.room.size
        return self._version, *kind, self.workspace.version, self.splats.version


def rasterize(prepared, camera, near=0.01, **options):
    """Return the `Layers` that `camera` sees of `prepared` splats; see `Rasterizer.draw`."""
    return Rasterizer(prepared).draw(camera, near, **options)
