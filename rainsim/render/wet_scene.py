"""The wet capture without water, as cameras, mirrored cameras and rays see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rainsim.daylight.kept import kept_relight
from rainsim.io import images
from rainsim.numerics.mipmap import coarsened
from rainsim.rain.exposure import rain_exposure
from rainsim.raster import Rasterizer, prepare
from rainsim.reflection.mirror_choice import merged_cells
from rainsim.reflection.planar_mirror import MirrorPicture
from rainsim.reflection.ray_traced import Tracer
from rainsim.reflection.water_pass import WetPicture
from rainsim.render.actor_splats import ActorSplats
from rainsim.render.paged_scene import PagedScene
from rainsim.render.present_splats import PresentSplats
from rainsim.render.wet_ground import blurred_grass
from rainsim.scene.cameras import MIRROR_CLEARANCE, cropped, mirrored_camera, resize_to
from rainsim.scene.view import view_of
from rainsim.shading import environment, sky, wetness
from rainsim.shading.backdrop import Backdrop, sky_distance
from rainsim.shading.bodies import BodyMap
from rainsim.shading.calibration import albedo_of_white, zenith_radiance
from rainsim.shading.color import LUMA, luminance_of, roughly_linear
from rainsim.shading.grading import DULL_EXPOSURE, SHINES, look_of, replaces_sky
from rainsim.shading.skyline import skylines, with_skyline
from rainsim.shading.visibility import badly_placed, views_of_splats, without_shreds
from rainsim.shading.wet_ground_mirror import RESOLUTION, in_level_picture
from rainsim.shading.wet_pass import NO_COVER, DryRays, dry_picture, grade_and_wet, grade_rays
from rainsim.shading.wetting import GroundMaps, SkyMaps
from rainsim.simulation import usual_wind
from rainsim.splatting.detail import SIDES, Detail
from rainsim.splatting.prepared import recolored, turn
from rainsim.surface.kept import kept_surface, splat_normals
from rainsim.water.tyres import NO_TRACKS

FINER = 4  # pixels of the drawn surroundings, across one of the map's faces
ALL = 2.5  # times as wide are small views of all splats, which are drawn too wide in smaller ones
SMALL = 4.0  # px: threshold of pages in metering pictures, which come from all over a capture
NEAR = 0.05  # m: splats nearer than this are not drawn
FIRST_SEGMENT = 0.5  # m of a traced ray that are searched at first
BRIGHT_SKY = 0.15  # mean linear light above which a far pixel shows the captured sky


class WetScene:
    """A capture under the light and the wetness of the settings' present time.

    Parameters
    ----------
    scene : Scene
    terrain : Terrain
    config : Config
    first_camera : Camera
        In the capture frame; the surroundings are drawn from its place unless the settings name
        one.
    rasterizer_of : callable
        rasterizer_of(prepared) returns what draws prepared splats.

    Attributes
    ----------
    scene : Scene
        Without the splats of its sky where another sky is drawn.
    splats, prepared : Splats and PreparedSplats
        Those of `scene` in the present light; of a big capture without actors only `splats`.
    merge : float [px]
        Side of the cells in which frames and mirrored pictures merge splats; 0: they merge none.
    frame : GroundFrame
    near : float [capture units]
    reach : ndarray of shape (ny, nx), float32
        Share of the rain that reaches the ground.
    badly_placed : ndarray of shape (n,), bool
        Splats that mirrored pictures and the surroundings leave out, see `visibility`.
    day, behind, behind_mirrored : ndarray of shape (rows, columns, 3), float32
        The sky of the day, and what is seen of it behind the scene and behind the mirrored scene.
    environment, gloss, coat : ndarray of shape (rows, columns, 3), float32
        The wet capture around the first camera with the sky of the day; the same, see `glossy`.
    look : Look
    off_ground : OffGroundWetness
    ground : ndarray of shape (ny, nx, 4), float32
        See `wetness.ground_wetness`.
    bodies : BodyMap
    paving : float
        How wet open paving is, 0 to 1.
    paged : PagedScene or None
        What draws a big capture in place of `prepared`, which then is its coarse whole.
    actors : ActorSplats or None
        What moves, see `move_actors`.
    tracer : Tracer or None
        Of the scene's splats, once rays were traced.
    notes : list of str
        What there is to say of the set-up.
    """

    def __init__(self, scene, terrain, config, first_camera, rasterizer_of=Rasterizer):
        self.terrain, self.config, self.frame = terrain, config, scene.ground_frame
        self._whole_ground = terrain
        self.sky_distance = sky_distance(scene)
        found = None if scene.source is None else kept_surface(scene)  # generated ones have none
        sky = None if found is None or not found.sky.any() else found.sky
        self.backdrop = Backdrop(scene, self.sky_distance, replaces_sky(config), sky)
        self.scene = self.backdrop.scene
        self.near = NEAR / self.frame.meters_per_unit
        self._rasterizer_of = rasterizer_of
        self.albedo, about_albedo = albedo_of_white(
            terrain, self.scene.splats, config.render.ground_albedo
        )
        relight = kept_relight(scene, config, found, self.albedo)
        self.notes = [note for note in (self.backdrop.note(), relight.note) if note]
        gain = None if relight.gain is None else relight.gain[self.backdrop.kept]
        if gain is not None:
            self.albedo, about_albedo = albedo_of_white(
                terrain, self.scene.splats, config.render.ground_albedo, gain, self.frame
            )
        views = views_of_splats(self.scene)
        diffuse = None if views is None else views.diffuse
        self.badly_placed = badly_placed(self.scene, views)
        if not self.backdrop.count and replaces_sky(config):
            self.scene, told = without_shreds(self.scene, self.badly_placed)
            self.notes += told
        if self.badly_placed.any():
            self.notes.append(
                f"mirrors leave out {self.badly_placed.sum()} splats that hardly any camera saw"
            )
        self.reach = rain_exposure(terrain, usual_wind(config), config.rain.roughness)
        self._grass = blurred_grass(terrain)
        self._relit = gain is not None
        self._present = PresentSplats(self.scene, gain, diffuse, terrain, self.reach, self._grass)
        self._colors = self._present.state(config.at(0.0))
        self.splats = self._present.at(self._colors)
        self.prepared = prepare(self.splats, self.badly_placed)
        self.prepared = replace(self.prepared, compensate=scene.antialiased)
        self.actors = ActorSplats(scene.actors, self.prepared) if scene.actors else None
        if self.actors is not None:
            self.prepared = self.actors.static
        self.paged = None
        if scene.pages is not None:
            leave_out = not self.backdrop.count and replaces_sky(config)
            self.paged = PagedScene(
                self.backdrop, self.sky_distance, gain, diffuse, self.badly_placed, leave_out,
                terrain, self.reach, self._grass, config.render, rasterizer_of,
            )  # fmt: skip
            self.paged.take_colors(self._colors)
        # Captures in chunks have levels of their own; actors are put before the whole static set.
        merges = self.actors is None and self.paged is None
        self.merge, self._detail = config.render.merge if merges else 0.0, None
        if self.merge:
            self._detail = Detail(self.prepared, self._sides)
            self.prepared = self._detail.prepared
        if found is not None and self.paged is None:
            turn(self.drawn, *splat_normals(self.scene, found))
        self.rasterizer = rasterizer_of(self.drawn) if self.paged is None else self.paged.whole
        self._skylines = None
        if not self.backdrop.count or sky is not None:
            seen = found.open if self.backdrop.count else None
            self._skylines = skylines(self.scene, self.prepared, first_camera, self.near, seen)
        self.prepared = self.prepared if self.paged is None or self.actors else None
        self._tracks = NO_TRACKS
        self.bodies = BodyMap(terrain, self.actors)
        self._standing = self._captured = self._captured_merger = self.tracer = None  # on demand
        self.notes.append(about_albedo)
        dull = DULL_EXPOSURE * config.render.daylight
        self.day = day_sky(config.render, zenith_radiance(self.albedo, dull))
        self.look = self.off_ground = self._now = None
        self.set_time(config.at(0.0))
        place = config.render.surroundings
        eye = self.frame.to_ground(first_camera.position if place is None else np.array(place))
        if config.render.sky == "capture":
            self.day = self._captured_sky(eye)
            self._set_skies()
        self.gloss, self.coat = environment.glossy(self.day)  # until the surroundings are drawn
        self.environment = self._surroundings(eye)
        self.gloss, self.coat = environment.glossy(self.environment)

    def set_time(self, now):
        """Take over the settings of a time; return whether cameras see other pictures by them."""
        if now is self._now:  # as all frames have it without keyframes
            return False
        self._now = now
        look, off_ground = self._look_of(now), wetness.off_ground_wetness(now)
        if look == self.look and off_ground == self.off_ground:
            return False
        self.look, self.off_ground = look, off_ground
        self.paving = wetness.paving_dampness(now)
        self._wet_ground(now)
        self._set_skies()
        colors = self._present.state(now)
        if colors != self._colors:
            self._recolor(colors)
        return True

    def _look_of(self, now):
        facts = self.sky_distance, self.backdrop.count > 0, self.albedo, self._relit
        return look_of(now, *facts, len(self.terrain.tops) > 0)

    def leave_ground(self):
        """Drop all that depends on the present part of the ground; `take_ground` must follow."""
        self.reach = self.ground = self._untouched = self._grass = self.bodies = None

    def take_ground(self, ground):
        """Draw another part of the ground, a `WetGround`; the light stays as it was set up."""
        self.terrain, self.reach, self._grass = ground[:3]
        self.ground = self._untouched = ground.wetness()
        self._tracks, self.bodies = NO_TRACKS, BodyMap(self.terrain, self.actors)
        self.look = self._look_of(self._now)

    def _wet_ground(self, now):
        """Find how wet the ground is at the present time."""
        self._untouched = wetness.ground_wetness(self.terrain, self._grass, self.reach, now)
        self.ground = wetness.with_tracks(self._untouched, self._tracks)

    def move_actors(self, time):
        """Take over where the scene's actors are at a time [s]; return whether they have moved.

        Until the first call, and after a time of None, none is there.
        """
        if self.actors is None or not self.actors.set_time(time):
            return False
        self._put_actors()
        self.bodies.move()
        return True

    def take_tracks(self, tracks):
        """Take over where tyres have thinned the film, see `Tyres.tracks`; return if that is new.

        Parameters
        ----------
        tracks : ndarray of shape (ny, nx) or (0, 0), uint8
        """
        if np.array_equal(tracks, self._tracks):
            return False
        self._tracks = tracks
        self.ground = wetness.with_tracks(self._untouched, tracks)
        return True

    def _put_actors(self):
        """Put the actors as they are now before the static set."""
        if self.paged is None:
            self.rasterizer.put_actors(self.actors.merged())
        else:
            self.paged.put_actors(self.actors, self.frame)
        self._standing = self.tracer = None

    def _recolor(self, colors):
        """Take over the colours of the splats of another state, see `PresentSplats`."""
        self._colors, self.splats = colors, self._present.at(colors)
        if self._detail is None and self.prepared is not None:
            self.prepared = recolored(self.prepared, self.splats)
        elif self._detail is not None:
            self._detail.recolor(self.splats)
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
        self._standing = self.tracer = None

    def _set_skies(self):
        """Make the skies behind the scene and behind the mirrored scene, by the present look."""
        plain = self.config.render.sky in sky.PLAIN
        self.behind = self.behind_mirrored = self.backdrop.behind(self.day, self.look, plain)
        if self._skylines:
            whole, mirrored = self._skylines
            self.behind_mirrored = with_skyline(self.behind, mirrored, self.look.exposure)
            self.behind = with_skyline(self.behind, whole, 0.0)

    @property
    def drawn(self):
        """`prepared`, with levels of detail where splats are merged."""
        return self.prepared if self._detail is None else self._detail.drawn

    @property
    def _sides(self):
        """Sides of the cells of the levels of detail [capture units]."""
        return [side / self.frame.meters_per_unit for side in SIDES]

    @property
    def ground_maps(self):
        """The mapped ground as kernels take it."""
        grid = self.terrain.grid
        place = np.array(grid.origin, np.float32), np.float32(grid.spacing)
        return GroundMaps(self.terrain.bed, self.ground, *place, self.bodies.now)

    def dry(self, camera, whole_color=False):
        """Return the `raster.Layers` of the capture that `camera` takes.

        `whole_color`: the colour is that of all splats as captured, those of the sky included.
        """
        layers = self.rasterizer.draw(camera, self.near, detail=self.merge)
        if whole_color and self.paged is not None:
            return replace(layers, color=self.paged.captured.draw(camera, self.near).color)
        if whole_color and self.splats is not self.backdrop.whole.splats:
            options = {"compensate": self.prepared.compensate, "detail": self.merge}
            whole = self._captured_splats().draw(camera, self.near, **options)
            layers = replace(layers, color=whole.color)
        return layers

    def _captured_splats(self):
        """Return the rasterizer of all splats as captured, those of the sky included."""
        if self._captured is None:
            whole = prepare(self.backdrop.whole.splats)
            if self.actors is not None:
                self._captured_merger = self.actors.merger_of(whole)
                whole = self._captured_merger.static
            self._captured = self._rasterizer_of(
                Detail(whole, self._sides).drawn if self.merge else whole
            )
        if self.actors is not None:
            self._captured.put_actors(self.actors.merged(self._captured_merger))
        return self._captured

    def picture(self, camera, timer, cover=NO_COVER):
        """Return the `WetPicture` that `camera` (capture frame) takes.

        `cover` is the `cover_out` of `grade_and_wet`.
        """
        layers = self.rasterizer.draw(camera, self.near, detail=self.merge)
        timer.mark("splat")
        wet = self._wetted(layers, camera, cover)
        timer.mark("grade and wet")
        return wet

    def actor_numbers(self, camera):
        """Return the number of the actor at each pixel of `camera`, see `ActorSplats.numbers`."""
        if self.actors is None:
            return np.zeros((camera.height, camera.width), np.uint16)
        return self.actors.numbers(self.rasterizer.draw(camera, self.near, hit=True).hit)

    def land_light(self, cameras, gloss_apart):
        """Return the mean linear luminance of the land in views, as captured and wet.

        And the share of the views that shows the sky. What wet ground mirrors is left out if the
        wet-ground mirror adds it, `gloss_apart`: here nothing would hide what it mirrors.
        """
        captured, rainy, pixels, sky = 0.0, 0.0, 0, 0
        for layers, wet, _ in self.small_views(cameras, gloss_apart):
            land = np.isfinite(wet.depth) & (layers.alpha > 0.5)
            captured += float(luminance_of(layers.color[land]).sum())
            light = wet.picture[land] @ LUMA
            if self.config.render.daylight < 1:  # by day lamps are a few percent of the light
                light = np.minimum(light, SHINES * self.look.exposure)
            rainy += float(light.sum())
            pixels += int(land.sum())
            sky += int((~land).sum())
        return captured / max(pixels, 1), rainy / max(pixels, 1), sky / max(pixels + sky, 1)

    def small_views(self, cameras, gloss_apart):
        """Yield layers, `WetPicture` and `cover_out` of pictures that the light is set up by."""
        options = {} if self.paged is None else {"threshold": SMALL}
        for camera in cameras:
            if not self.merge and self.paged is None:
                camera = resize_to(camera, round(ALL * camera.width))
            cover = np.empty((camera.height, camera.width) if gloss_apart else (0, 0), np.float32)
            layers = self.rasterizer.draw(camera, self.near, detail=self.merge, **options)
            yield layers, self._wetted(layers, camera, cover), cover

    def level_mirrored(self, level):
        """Return the `WetPicture` of standing things, seen mirrored at the plane of the ground.

        `level` is the level, upright camera (ground frame) that is mirrored.
        """
        if self._standing is None and self.paged is not None:
            self._standing = self.paged.standing
        if self._standing is None:
            place = self._whole_ground, self.frame
            standing = in_level_picture(self.prepared, *place) if self.actors is None else (
                self.actors.standing(*place)
            )  # fmt: skip
            self._standing = self._rasterizer_of(standing)
        _, camera = mirrored_camera(self.frame.camera_in_capture(level), self.frame, 0.0)
        options = {}
        if self.paged is not None:  # the pages of a picture at RESOLUTION, whatever its own is
            finer = max(camera.fx / RESOLUTION, 1.0)
            options = {"threshold": self._standing.detail * finer}
        layers = self._standing.draw(camera, self.near, **options)
        return self._wetted(layers, camera, mirrored=True)

    def mirrored(self, camera, level, window, step=1):
        """Return view and `MirrorPicture` of `camera` mirrored at the water's `level` [m].

        Parameters
        ----------
        camera : Camera
            In the capture frame.
        level : float [m]
        window : tuple of int [px]
            Left, top, right and bottom of the part of its picture.
        step : int
            Pixels of its picture, along either side, for one that is drawn; divides the window.

        Returns
        -------
        view : View
        picture : MirrorPicture
        """
        plane, camera = mirrored_camera(camera, self.frame, level)
        camera = cropped(camera, window)
        camera = camera.resized(camera.width // step, camera.height // step)
        cells = merged_cells(self.merge, step)
        layers = self.rasterizer.draw(camera, self.near, plane, leading=True, detail=cells)
        wet = self._wetted(layers, camera, mirrored=True)
        return wet.view, MirrorPicture(wet.picture, coarsened(wet.picture), wet.depth)

    def traced(self, origin, direction, before, pixel, color_eye=None):
        """Return the graded radiance, alpha and distance [m] of rays through the splats.

        See `ray_traced.traced_light`.
        """
        if self.tracer is None:
            splats = self.splats
            if self.badly_placed.any():
                splats = splats.take(~self.badly_placed)
            self.tracer = Tracer(splats) if self.actors is None else self.actors.tracer(splats)
        unit, turn = self.frame.meters_per_unit, self.frame.rotation
        clear = np.append(self.frame.up, MIRROR_CLEARANCE / unit)
        found = self.tracer.trace(
            self.frame.to_capture(origin), direction @ turn, before / unit, pixel,
            FIRST_SEGMENT / unit, clear, color_eye,
        )  # fmt: skip
        rays = DryRays(
            found.color, found.alpha, found.distance * np.float32(unit),
            found.plane_distance * np.float32(unit),
            np.ascontiguousarray(found.normal @ turn.T, np.float32),
            (origin - before[:, None] * direction).astype(np.float32), direction,
        )  # fmt: skip
        return self._graded(rays), found.alpha, rays.distance

    def _shading(self, mirrored):
        """Return ground, wetness off it, skies and look, as the grading kernels take them."""
        behind = self.behind_mirrored if mirrored else self.behind
        return self.ground_maps, self.off_ground, SkyMaps(self.gloss, self.coat, behind), self.look

    def _wetted(self, layers, camera, cover=NO_COVER, mirrored=False):
        """Return the `WetPicture` of splatted layers, graded and wet."""
        view = view_of(self.frame.camera_in_ground(camera))
        shape = (camera.height, camera.width)
        picture = np.empty((*shape, 3), np.float32)
        depth, clearance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        grade_and_wet(
            dry_picture(layers, self.frame.meters_per_unit, mirrored),
            view, *self._shading(mirrored), picture, depth, clearance, cover,
        )  # fmt: skip
        return WetPicture(picture, depth, clearance, view, picture)

    def _graded(self, rays):
        """Return the radiance at the hits of rays, graded and wet."""
        light = np.empty_like(rays.color)
        grade_rays(rays, *self._shading(True), light)
        return light

    def _captured_sky(self, position):
        """Return the sky that the capture shows from `position` [m], completed and graded."""

        def draw(view):
            dry = self.rasterizer.draw(self.frame.camera_in_capture(view), self.near)
            far = dry.depth * self.frame.meters_per_unit > self.sky_distance
            linear = roughly_linear(dry.color, 4)
            seen = far & (dry.alpha > 0.9) & (linear.mean(axis=-1) > BRIGHT_SKY)
            return np.where(seen[..., None], linear, -1)

        found = environment.probe(draw, position)
        completed, share = sky.completed(found, found[..., 0] >= 0)
        self.notes.append(
            f"the capture shows {share:.0%} of the sky; an overcast one fills the other part"
        )
        return completed * self.look.exposure

    def _surroundings(self, position):
        """Return the wet capture around `position` [m] with the sky of the day, as a map."""
        # Splats finer than a pixel are drawn too wide: drawn larger and reduced they are not.
        options = {} if self.paged is None else {"threshold": FINER * self.rasterizer.detail}

        def draw(view):
            camera = self.frame.camera_in_capture(resize_to(view, FINER * view.width))
            layers = self.rasterizer.draw(
                camera, self.near, leading=True, detail=self.merge, **options
            )
            picture = self._wetted(layers, camera, mirrored=True).picture
            return picture.reshape(view.height, FINER, view.width, FINER, 3).mean(axis=(1, 3))

        return environment.probe(draw, position)


def day_sky(config, zenith):
    """Return the environment map of the sky that a render configuration names.

    `zenith` is the radiance of its zenith if it is overcast; a panorama gets as bright as that.
    """
    level = zenith / sky.ZENITH_RADIANCE
    if config.sky in sky.PLAIN:
        return sky.clouded(sky.overcast(level))
    return sky.from_panorama(images.read_hdr(config.sky), level)
