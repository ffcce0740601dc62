"""Twin of `shading.wet_ground_mirror` and `numerics.ripmap`: reflections in wet ground.

The level picture and the field of mirrored light need nothing of the picture itself: they are drawn
on a stream beside it, and added to it once it is graded. Every block of the field is computed, wet
or not.
"""

from __future__ import annotations

import math

import numpy as np

from rainsim.constants import ONE, ZERO
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.graph import new_version
from rainsim.cuda.jit import cuda, cuda_device, cuda_kernel
from rainsim.cuda.lod.paged import ChunkPicture
from rainsim.cuda.raster import Rasterizer
from rainsim.cuda.shading.lamp_images import Lamps, shines
from rainsim.cuda.shading.wet_pass import BLOCK, blocks, grade_layers, pixel_grid
from rainsim.cuda.splatting.merged import PosedActors
from rainsim.cuda.splatting.prepared import DeviceSplats
from rainsim.numerics.ripmap import LEVELS
from rainsim.scene.cameras import mirror_at
from rainsim.scene.view import view_from
from rainsim.shading.microfacet import LOBE
from rainsim.shading.wet_ground_mirror import (
    ABOVE,
    FIELD_STEP,
    MOST_ASIDE,
    MOST_UP,
    STANDING,
    STANDING_OUTSIDE,
    GroundSlopes,
    LevelPicture,
    as_in_level_picture,
    block_ray,
    field_at,
    in_level_picture,
    level_camera,
    mirrored_light,
)
from rainsim.splatting.prepared import prepare

UPSIDE_DOWN = np.array([1.0, 1.0, -1.0])
COARSEST = 1 << (LEVELS - 1)


@cuda_kernel
def halve_widths(picture, size, horizon, atlas_out):
    """Fill the upper half of a ripmap: all widths of the rows; see `ripmap`.

    size : ndarray of shape (2,), float32
        Columns and rows of the picture that are drawn; beyond them the border's values go on.
    """
    column, row = cuda.grid(2)
    height, width = atlas_out.shape[0] // 2, atlas_out.shape[1] // 2
    if row >= height or column >= 2 * width:
        return
    level, start = level_of(column, width)
    if level == LEVELS:
        return
    columns, rows = int(size[0]), int(size[1])
    j, i = min(max(row, horizon), rows - 1), (column - start) << level
    r, g, b = ZERO, ZERO, ZERO
    for k in range(i, i + (1 << level)):
        at = min(k, columns - 1)
        r, g, b = r + picture[j, at, 0], g + picture[j, at, 1], b + picture[j, at, 2]
    share = ONE / np.float32(1 << level)
    atlas_out[row, column, 0] = r * share
    atlas_out[row, column, 1] = g * share
    atlas_out[row, column, 2] = b * share


@cuda_kernel
def halve_heights(atlas):
    """Fill the lower half of a ripmap from its upper one."""
    column, row = cuda.grid(2)
    height = atlas.shape[0] // 2
    row += height
    if row >= 2 * height or column >= atlas.shape[1]:
        return
    level, start = level_of(row, height)
    if level == LEVELS or level_of(column, atlas.shape[1] // 2)[0] == LEVELS:
        return
    j = (row - start) << level
    r, g, b = ZERO, ZERO, ZERO
    for k in range(j, j + (1 << level)):
        r, g, b = r + atlas[k, column, 0], g + atlas[k, column, 1], b + atlas[k, column, 2]
    share = ONE / np.float32(1 << level)
    atlas[row, column, 0] = r * share
    atlas[row, column, 1] = g * share
    atlas[row, column, 2] = b * share


@cuda_device
def level_of(place, side):
    """Return the level of a ripmap's column or row and where that begins; LEVELS: none."""
    level, start = 0, 0
    while level < LEVELS and place >= start + (side >> level):
        start += side >> level
        level += 1
    return level, start


@cuda_kernel
def mirrored_field(camera, step, ground, lobe, level, level_size, environment, field_out):
    """Write the light that wet ground mirrors to each block of pixels; see the CPU's kernel.

    level_size : device array of shape (2,), float32
        Columns and rows of the level picture, whose arrays may be larger; zero: there is none.
    """
    i, j = cuda.grid(2)
    if j >= field_out.shape[0] or i >= field_out.shape[1]:
        return
    view = view_from(camera)
    x, y, z = block_ray(view, step, j, i)
    depth = level.depth[: int(level_size[1]), : int(level_size[0])]
    drawn = LevelPicture(level.atlas, depth, level.lens, level.forward)
    red, green, blue = mirrored_light(x, y, z, view.eye, ground, lobe, drawn, environment)
    field_out[j, i, 0], field_out[j, i, 1], field_out[j, i, 2] = red, green, blue


@cuda_kernel
def add_reflection(bare, cover, field, step, picture_out):
    """Add the light that wet ground mirrors to a picture without it; see the CPU's kernel."""
    column, row = cuda.grid(2)
    height, width = cover.shape
    if row >= height or column >= width:
        return
    share = cover[row, column]
    red, green, blue = bare[row, column, 0], bare[row, column, 1], bare[row, column, 2]
    if share > ZERO:
        r, g, b = field_at(field, ONE / np.float32(step), row, column)
        red, green, blue = red + share * r, green + share * g, blue + share * b
    picture_out[row, column, 0] = red
    picture_out[row, column, 1] = green
    picture_out[row, column, 2] = blue


class LevelView:
    """The level picture of the frames of a device: what stands on the ground, mirrored.

    frame : DeviceFrame
    stream : numba.cuda.stream. That it is splatted on.
    drawn : bool. Whether it is; else it stands for one that shows nothing.
    size : float32 device array (2,). Columns and rows that are drawn; the arrays
        may be larger.
    lamps : Lamps or None. None: the scene has none.
    chunks : ChunkPicture or None. What is drawn of a capture in chunks.
    """

    def __init__(self, frame, stream, drawn):
        self._frame, self._rasterizer, self.lamps, self.chunks = frame, None, None, None
        self.size = cuda.to_device(np.zeros(2, np.float32))
        self._lens = cuda.to_device(np.ones(4, np.float32))
        self._uniforms = FrameUniforms(stream, {
            "turn": ((3, 3), np.float32), "eye": ((3,), np.float32), "forward": ((2,), np.float32),
        })  # fmt: skip
        self._room, self._horizon, self._posed = None, 0, None
        _, self._flip = mirror_at(frame.conductor.wet_scene.frame, 0.0)
        self._allocate(1, 1)
        if drawn:
            paged = frame.conductor.wet_scene.capture.paged
            if paged is None:
                splats = DeviceSplats(self._splats(), frame.rasterizer.splats.room)
            else:
                splats = frame.rasterizer.splats
                self.chunks = ChunkPicture(paged.standing, splats, lambda: self.rasterizers)
            self._rasterizer = Rasterizer(splats, stream, first_room=splats.count)
            if shines(frame.conductor.wet_scene.scene):
                self.lamps = Lamps(splats, stream)

    @property
    def rasterizers(self):
        """That of the splats that stand on the ground, and that of the lamps' finer picture."""
        if self._rasterizer is None:
            return []
        fine = None if self.lamps is None else self.lamps.fine
        return [self._rasterizer] if fine is None else [self._rasterizer, fine.rasterizer]

    def _allocate(self, width, height):
        """Allocate the picture of at most this size, and its ripmap."""
        f4 = np.float32
        self._picture = cuda.device_array((height, width, 3), f4)
        self._depth, self._clearance = (cuda.device_array((height, width), f4) for _ in range(2))
        high, wide = (-(-side // COARSEST) * 2 * COARSEST for side in (height, width))
        self._atlas = cuda.device_array((high, wide, 3), f4)
        self._version = new_version()

    def _splats(self):
        conductor = self._frame.conductor
        scene, terrain = conductor.wet_scene, conductor.ground.terrain
        return in_level_picture(scene.capture.prepared, terrain, scene.frame)

    def send_colors(self):
        """Send the colours of the splats again, which are the scene's that stand on the ground."""
        if self._rasterizer is not None:
            self._rasterizer.splats.send_colors(self._splats())

    def send_actors(self):
        """Send the actors of the present time; the device must draw nothing meanwhile."""
        conductor = self._frame.conductor
        scene, terrain = conductor.wet_scene, conductor.ground.terrain
        actors = scene.capture.actors
        if self._rasterizer is None:
            return
        if not actors.rigid:
            self._rasterizer.splats.put_actors(actors.standing(terrain, scene.frame))
            return
        if self._posed is None:
            self._posed = self._posed_actors(self._rasterizer.splats, actors.actors, scene.frame)
        stream = self._frame.stream
        self._posed.put(actors.poses, stream)
        self._posed.hide(
            self._upright, self._frame["bed"], self._frame.place, np.float32(STANDING),
            np.float32(STANDING_OUTSIDE), stream,
        )  # fmt: skip

    def _posed_actors(self, splats, actors, frame):
        turn = frame.rotation * frame.meters_per_unit
        self._upright = cuda.to_device(
            np.concatenate([turn.ravel(), frame.translation]).astype(np.float32)
        )
        parts = [as_in_level_picture(prepare(actor.splats), frame) for actor in actors]
        return PosedActors(splats, parts, [actor.turning for actor in actors])

    @property
    def versions(self):
        """Of the arrays and of the list of lamps, see `cuda.graph.new_version`, a tuple."""
        return self._version, 0 if self.lamps is None else self.lamps.version

    def update(self, camera_in_ground):
        """Take over the camera of the next picture, in the ground's frame."""
        scene, level = self._frame.conductor.wet_scene, level_camera(camera_in_ground)
        mirrored = self._mirrored(level)
        self._horizon = round(level.cy)
        room = math.ceil(2 * MOST_ASIDE * level.fx), math.ceil((ABOVE + MOST_UP) * level.fx)
        if room != self._room:
            self._room = room
            self._allocate(*room)
        near, own = scene.capture.near, self._rasterizer
        if self.chunks is not None:
            finer = scene.capture.standing_threshold(mirrored)
            self.chunks.choose(self._frame.pending, mirrored, near, threshold=finer)
        own.update(mirrored, near, room=room)
        self.size, self._lens = own.size, own.lens
        if self.lamps is not None:
            self.lamps.room_for(level, *room)
            if self.lamps.fine is not None:
                fine, room = self.lamps.fine_camera(level)
                self.lamps.fine.rasterizer.update(self._mirrored(fine), near, room=room)
                self._fine_horizon = round(fine.cy)
        # The mirrored camera in the ground's frame: z points the other way.
        self._uniforms.update(
            turn=level.camera_from_world[:3, :3].T * UPSIDE_DOWN[:, None],
            eye=level.position * UPSIDE_DOWN, forward=level.camera_from_world[2, :2],
        )  # fmt: skip

    def _mirrored(self, level):
        """Return the camera of the capture's frame mirrored at the ground plane."""
        frame = self._frame.conductor.wet_scene.frame
        camera = frame.camera_in_capture(level)
        return camera.posed(camera.camera_from_world @ self._flip)

    def draw(self, stream):
        """Queue the grading of the picture, whose splats are drawn, and its ripmap."""
        if self._rasterizer is None:
            return
        self._uniforms.send(stream)
        pictures = self._picture, self._depth, self._clearance
        self._grade(self._rasterizer, *pictures, stream)
        if self.lamps is not None:
            self._search(stream)
            self.lamps.dim(self._picture, stream)
        high, wide, _ = self._atlas.shape
        grid = blocks(high // 2, wide), BLOCK, stream
        halve_widths[grid](self._picture, self.size, self._horizon, self._atlas)
        halve_heights[grid](self._atlas)

    def _grade(self, rasterizer, picture, depth, clearance, stream):
        turn, eye = self._uniforms["turn"], self._uniforms["eye"]
        grade_layers(self._frame, rasterizer, depth.shape, turn, eye, picture, depth, clearance,
                     depth[:0], stream)  # fmt: skip

    def _search(self, stream):
        """Queue the search for lamps in the graded picture and, where it is drawn, in the finer."""
        eye, forward, lamps = self._uniforms["eye"], self._uniforms["forward"], self.lamps
        seen, camera = (self._picture, self._depth), (self._lens, eye, forward)
        lamps.search(seen, self.size, self._horizon, camera, stream)
        if (fine := lamps.fine) is not None:
            self._grade(fine.rasterizer, fine.picture, fine.depth, fine.clearance, stream)
            lamps.search_fine(self._fine_horizon, eye, forward, stream)

    @property
    def arrays(self):
        """The picture as kernels take it, a `LevelPicture`."""
        return LevelPicture(self._atlas, self._depth, self._lens, self._uniforms["forward"])


class WetGroundLight:
    """The light that wet ground mirrors in the frames of a device.

    frame : DeviceFrame. The film of its conductor's ground says whether the level
        picture is drawn.
    stream : numba.cuda.stream. That the level picture and the field are drawn on.
    level : LevelView or None. None: the film's cover is not found, nor its
        reflection added.
    """

    def __init__(self, frame):
        self._frame, film = frame, frame.conductor.ground.film
        self.stream, self.level = cuda.stream(), None
        self._field, self._made_for = None, ()
        if film.apart:
            slopes, corner, *place = film.ground
            self._ground = GroundSlopes(cuda.to_device(slopes), cuda.to_device(corner), *place)
            self._lobe = cuda.to_device(LOBE)
            self.level = LevelView(frame, self.stream, film.drawn)

    @property
    def rasterizers(self):
        """Those of the level picture, if it is drawn, a list."""
        return [] if self.level is None else self.level.rasterizers

    @property
    def lamps(self):
        """What finds the lamps in it, a list of one `Lamps` or none."""
        return [] if self.level is None or self.level.lamps is None else [self.level.lamps]

    @property
    def chunks(self):
        """Those of the level picture, see `LevelView`."""
        return None if self.level is None else self.level.chunks

    def update(self, camera, camera_in_ground):
        """Take over the camera of the next picture, in the capture's and in the ground's frame."""
        if self.level is None:
            return
        self._step = max(1, round(camera.fx / FIELD_STEP))
        if self._made_for[:-1] != (self._step, self._frame.size):
            self._made_for = self._step, self._frame.size, new_version()
            shape = (-(-n // self._step) for n in self._frame.size)
            self._field = cuda.device_array((*shape, 3), np.float32)
        if self.rasterizers:
            self.level.update(camera_in_ground)

    @property
    def queue(self):
        """The values that a recorded queue depends on."""
        if self.level is None:
            return ()
        queues = (rasterizer.queue for rasterizer in self.rasterizers)
        return *self._made_for, *self.level.versions, *queues

    def splat(self, stream):
        """Queue the splatting of the level picture on `stream`, which is this one's own."""
        for rasterizer in self.rasterizers:
            rasterizer.launch()

    def draw(self, stream):
        """Queue the graded level picture, whose splats are drawn, and the field of light."""
        self.level.draw(stream)
        mirrored_field[blocks(*self._field.shape[:2]), BLOCK, stream](
            self._frame.view, self._step, self._ground, self._lobe, self.level.arrays,
            self.level.size, self._frame["gloss"], self._field,
        )  # fmt: skip
        if self.level.lamps is not None:
            seen = self.level.arrays, self.level.size, self._field
            self.level.lamps.add(self._frame.view, self._step, self._ground, *seen, stream)

    def add(self, stream):
        """Queue the sum of the graded picture and the light that its wet ground mirrors."""
        frame = self._frame
        add_reflection[pixel_grid(frame.size, stream)](
            frame["below"], frame["cover"], self._field, self._step, frame["picture"]
        )
