"""The splats of a capture as cameras and mirrored cameras see them, dry."""

from dataclasses import replace

import numpy as np

from rainsim.raster import prepare
from rainsim.reflection.mirror_choice import merged_cells
from rainsim.render.actor_splats import ActorSplats
from rainsim.scene.cameras import cropped, mirrored_camera, resize_to
from rainsim.shading.wet_ground_mirror import RESOLUTION, in_level_picture
from rainsim.splatting.detail import SIDES, Detail
from rainsim.splatting.prepared import recolored, turn

FINER = 4  # pixels of the drawn surroundings, across one of the map's faces
ALL = 2.5  # times as wide are small views of all splats, which are drawn too wide in smaller ones
SMALL = 4.0  # px: threshold of pages in metering pictures, which come from all over a capture
NEAR = 0.05  # m: splats nearer than this are not drawn


class DrawnCapture:
    """A capture in the colours of the present time, with what moves where it is now.

    backdrop : Backdrop. Its scene is drawn.
    present : PresentSplats
    colors : tuple. State of `present` at the start.
    badly_placed : bool array (n,). Splats that mirrored pictures and the
        surroundings leave out, see `visibility`.
    merge : float [px]. Side of the cells in which pictures merge splats, where
        they can; 0: they merge none.
    terrain : Terrain. Whole, by which splats stand on the ground.
    paged : PagedScene or None. What draws a big capture.
    rasterizer_of : callable. rasterizer_of(prepared) returns what draws prepared
        splats.
    normals : tuple, optional. See `surface.kept_surface.splat_normals`.
    prepared : PreparedSplats or None. The scene's in the present light; None of a
        big capture without actors.
    merge : float [px]. Side of the cells in which frames and mirrored pictures do
        merge splats.
    near : float [capture units]
    rasterizer : Rasterizer or PagedRasterizer
    actors : ActorSplats or None. What moves, see `move_actors`.
    changes : int. Counts whatever makes pictures of the same camera differ.
    """

    def __init__(
        self, backdrop, present, colors, badly_placed, merge, terrain, paged, rasterizer_of,
        normals=None,
    ):  # fmt: skip
        scene, self._whole = backdrop.scene, backdrop.whole
        self.frame = scene.ground_frame
        self.near = NEAR / self.frame.meters_per_unit
        self._present, self._colors, self._terrain = present, colors, terrain
        self.badly_placed, self.paged, self._rasterizer_of = badly_placed, paged, rasterizer_of
        splats = present.at(colors)
        self._is_as_captured = splats is self._whole.splats
        self.prepared = replace(prepare(splats, badly_placed), compensate=scene.antialiased)
        del splats  # before levels are made of them
        self.actors = ActorSplats(scene.actors, self.prepared) if scene.actors else None
        if self.actors is not None:
            self.prepared = self.actors.static
        if paged is not None:
            paged.take_colors(colors)
        # Captures in chunks have levels of their own; actors are put before the whole static set.
        self.merge, self._detail = merge if self.actors is None and paged is None else 0.0, None
        if self.merge:
            self._detail = Detail(self.prepared, self._sides)
            self.prepared = self._detail.prepared
        if normals is not None and paged is None:
            turn(self.drawn, *normals)
        self.rasterizer = rasterizer_of(self.drawn) if paged is None else paged.whole
        self._standing = self._captured = self._captured_merger = None  # on demand
        self._stands = None  # the change for which the standing actors were put
        self.changes = 0

    def forget_whole(self):
        """Drop the prepared splats of a big capture, of which pages are drawn."""
        if self.paged is not None and self.actors is None:
            self.prepared = None

    # ---- what changes

    def take_time(self, now):
        """Take over the colours of the settings of a time."""
        colors = self._present.state(now)
        if colors == self._colors:
            return
        self._colors, splats = colors, self._present.at(colors)
        self._is_as_captured = splats is self._whole.splats
        if self._detail is None and self.prepared is not None:
            self.prepared = recolored(self.prepared, splats)
        elif self._detail is not None:
            self._detail.recolor(splats)
            self.prepared = self._detail.prepared
        if self.paged is not None:
            self.paged.take_colors(colors)
        if self.actors is not None:
            self.actors.recolor(self.prepared)
            self.prepared = self.actors.static
        if self.paged is None:
            self.rasterizer.recolor(self.drawn)
        if self.actors is not None:
            self._put_actors()
        self._standing, self.changes = None, self.changes + 1

    def move_actors(self, time):
        """Take over where the scene's actors are at a time [s]; return whether they have moved.

        Until the first call, and after a time of None, none is there.
        """
        if self.actors is None or not self.actors.set_time(time):
            return False
        self._put_actors()
        self.changes += 1
        return True

    def _put_actors(self):
        """Put the actors as they are now before the static set."""
        if self.paged is None:
            self.rasterizer.pose_actors(self.actors)
        else:
            self.paged.put_actors(self.actors, self.frame)

    # ---- what is drawn

    @property
    def splats(self):
        """`Splats` of the scene in the present light, made each time that they are asked for."""
        return self._present.at(self._colors)

    @property
    def drawn(self):
        """`prepared`, with levels of detail where splats are merged."""
        return self.prepared if self._detail is None else self._detail.drawn

    @property
    def _sides(self):
        """Sides of the cells of the levels of detail [capture units]."""
        return [side / self.frame.meters_per_unit for side in SIDES]

    def layers(self, camera, **options):
        """Return the `raster.Layers` that a camera of the capture frame takes."""
        return self.rasterizer.draw(camera, self.near, detail=self.merge, **options)

    def captured_color(self, camera, layers):
        """Return the colour of all splats as captured, or that of `layers` where it is the same."""
        if self.paged is not None:
            return self.paged.captured.draw(camera, self.near).color
        if self._is_as_captured:
            return layers.color
        options = {"compensate": self.prepared.compensate, "detail": self.merge}
        return self._captured_splats().draw(camera, self.near, **options).color

    def _captured_splats(self):
        """Return the rasterizer of all splats as captured, those of the sky included."""
        if self._captured is None:
            whole = prepare(self._whole.splats)
            if self.actors is not None:
                self._captured_merger = self.actors.merger_of(whole)
                whole = self._captured_merger.static
            self._captured = self._rasterizer_of(
                Detail(whole, self._sides).drawn if self.merge else whole
            )
        if self.actors is not None:
            self._captured.put_actors(self.actors.merged(self._captured_merger))
        return self._captured

    def actor_numbers(self, camera):
        """Return the number of the actor at each pixel of `camera`, see `ActorSplats.numbers`."""
        if self.actors is None:
            return np.zeros((camera.height, camera.width), np.uint16)
        return self.actors.numbers(self.rasterizer.draw(camera, self.near, hit=True).hit)

    def small_layers(self, cameras):
        """Yield camera and layers of small pictures, by which the light is set up."""
        options = {} if self.paged is None else {"threshold": SMALL}
        for camera in cameras:
            if not self.merge and self.paged is None:
                camera = resize_to(camera, round(ALL * camera.width))
            yield camera, self.layers(camera, **options)

    def surrounding_layers(self, view):
        """Return camera and layers of a face of the surroundings, a camera of the ground frame."""
        # Splats finer than a pixel are drawn too wide: drawn larger and reduced they are not.
        options = {} if self.paged is None else {"threshold": FINER * self.rasterizer.detail}
        camera = self.frame.camera_in_capture(resize_to(view, FINER * view.width))
        return camera, self.layers(camera, leading=True, **options)

    def level_layers(self, level, **options):
        """Return camera and layers of standing things, mirrored at the plane of the ground.

        `level` is the level, upright camera (ground frame) that is mirrored.
        """
        if self._standing is None and self.paged is not None:
            self._standing = self.paged.standing
        if self._standing is None:
            place = self._terrain, self.frame
            if self.actors is None:
                standing = in_level_picture(self.prepared, *place)
            else:
                standing = self.actors.standing_static(*place)
            self._standing, self._stands = self._rasterizer_of(standing), None
        if self.paged is None and self.actors is not None and self._stands != self.changes:
            self._standing.pose_actors(self.actors, (self._terrain, self.frame))
            self._stands = self.changes
        _, camera = mirrored_camera(self.frame.camera_in_capture(level), self.frame, 0.0)
        if self.paged is not None:
            options["threshold"] = self.paged.standing.detail * max(camera.fx / RESOLUTION, 1.0)
        return camera, self._standing.draw(camera, self.near, **options)

    def mirrored_layers(self, camera, level, window, step=1, **options):
        """Return camera and layers of a camera mirrored at a level, see `WetScene.mirrored`."""
        plane, camera = mirrored_camera(camera, self.frame, level)
        camera = cropped(camera, window)
        camera = camera.resized(camera.width // step, camera.height // step)
        cells = merged_cells(self.merge, step)
        options = {"leading": True, "detail": cells, **options}
        return camera, self.rasterizer.draw(camera, self.near, plane, **options)
