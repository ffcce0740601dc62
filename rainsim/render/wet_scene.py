"""The wet capture without water, as cameras, mirrored cameras and rays see it."""

from typing import NamedTuple

import numpy as np

from rainsim.daylight.kept_light import kept_relight
from rainsim.io.allocator import trim
from rainsim.numerics.blocks import beside
from rainsim.numerics.mipmap import coarsened
from rainsim.rain.exposure import rain_exposure
from rainsim.raster import Rasterizer, prepare
from rainsim.reflection.planar_mirror import MirrorPicture
from rainsim.reflection.water_pass import WetPicture
from rainsim.render.drawn_capture import FINER, DrawnCapture
from rainsim.render.paged_scene import PagedScene
from rainsim.render.present_splats import PresentSplats
from rainsim.render.scene_sky import SceneSky, day_sky
from rainsim.render.wet_ground import WetGround
from rainsim.scene.view import view_of
from rainsim.shading import environment, sky, wetness
from rainsim.shading.backdrop import Backdrop, sky_of
from rainsim.shading.calibration import albedo_of_white, zenith_radiance
from rainsim.shading.color import LUMA, luminance_of, roughly_linear
from rainsim.shading.grading import DULL_EXPOSURE, SHINES, Look, look_of, replaces_sky
from rainsim.shading.skyline import skylines
from rainsim.shading.surface_depth import find_surface_depth
from rainsim.shading.surface_point import GroundMaps
from rainsim.shading.visibility import badly_placed, views_of_splats
from rainsim.shading.wet_pass import NO_COVER, dry_picture, grade_and_wet
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import SkyMaps
from rainsim.simulation import usual_wind
from rainsim.surface.kept_surface import kept_normals, kept_surface
from rainsim.terrain.assumed_bed import open_sheets

BRIGHT_SKY = 0.15  # mean linear light above which splats of the sky show it


class Shading(NamedTuple):
    """How light and wet a scene is at one time, as the grading kernels take it."""

    ground: GroundMaps
    off_ground: OffGroundWetness
    sky: SkyMaps
    mirrored_sky: SkyMaps  # behind the mirrored scene
    look: Look
    paving: float  # how wet open paving is, 0 to 1


class WetScene:
    """A capture under the light and the wetness of the settings' present time.

    scene, terrain, config, first_camera, rasterizer_of. As
        `rainsim.render.conductor.Conductor` takes them.
    scene : Scene. Without the splats of its sky where another sky is drawn.
    capture : DrawnCapture
    ground : WetGround
    sky : SceneSky
    frame : GroundFrame
    shading : Shading. Another one whenever anything in it changes.
    notes : list of str. What there is to say of the set-up.
    """

    def __init__(self, scene, terrain, config, first_camera, rasterizer_of=Rasterizer):
        self.config, self.frame = config, scene.ground_frame
        found = None if scene.source is None else kept_surface(scene)  # generated ones have none
        own_sky = sky_of(scene, found)
        unveiled = None if found is None else found.unveiled
        backdrop = Backdrop(scene, own_sky, replaces_sky(config), unveiled)
        self.scene = backdrop.scene
        views, normals = beside(views_of_splats, self.scene), None
        if found is not None and scene.pages is None:
            normals = beside(kept_normals, scene, found, own_sky)
        self._albedo, about_albedo = albedo_of_white(
            terrain, self.scene, config.render.ground_albedo
        )
        relight = kept_relight(scene, config, found, self._albedo)
        self.notes = [note for note in (backdrop.note(), relight.note) if note]
        gain = None if relight.gain is None else relight.gain[backdrop.kept]
        if gain is not None:
            self._albedo, about_albedo = albedo_of_white(
                terrain, self.scene, config.render.ground_albedo, gain
            )
        dull = DULL_EXPOSURE * config.render.daylight
        day = beside(day_sky, config.render, zenith_radiance(self._albedo, dull))
        views = views()
        diffuse = None if views is None else views.diffuse
        bad = badly_placed(self.scene, views)
        # Sheets that show poor ground would hide from water what stands behind them.
        bad = bad | open_sheets(terrain, self.frame.to_ground(self.scene.splats.position))
        if bad.any():
            self.notes.append(
                f"mirrors leave out {bad.sum()} splats that few saw or that show poor ground"
            )
        reach = rain_exposure(terrain, usual_wind(config), config.rain.roughness)
        self.ground = WetGround(terrain, reach)
        self._relit, self._sky_is_left_out = gain is not None, backdrop.count > 0
        if relight.ground is not None:  # sunlit walls are left, so that `_relit` is not true
            gain = relight.ground[backdrop.kept]
        where = terrain, reach, self.ground.grass
        present = PresentSplats(self.scene, gain, diffuse, *where, self.ground.standing)
        paged = None
        if scene.pages is not None:
            paged = PagedScene(backdrop, gain, diffuse, bad, *where, config.render, rasterizer_of)
        if normals is not None:
            normals = [a[backdrop.kept] for a in normals()]
        trim()  # what the light was found in
        self.capture = DrawnCapture(
            backdrop, present, present.state(config.at(0.0)), bad, config.render.merge,
            terrain, paged, rasterizer_of, normals,
        )  # fmt: skip
        lines = None
        if not backdrop.count or (found is not None and found.sky.any()):
            seen = found.open if backdrop.count else None
            lines = skylines(
                self.scene, self.capture.prepared, first_camera, self.capture.near, seen
            )
        self.capture.forget_whole()
        self.ground.stand(self.capture.actors)
        self.notes.append(about_albedo)
        day = day()
        if found is not None:
            day *= found.balance
        self.sky = SceneSky(backdrop, lines, config.render.sky in sky.PLAIN, day)
        self.shading, self._shades, self._now = None, 0, None
        self.set_time(config.at(0.0))
        place = config.render.surroundings
        eye = self.frame.to_ground(first_camera.position if place is None else np.array(place))
        if config.render.sky == "capture":
            self.sky.take_day(self._captured_sky(scene, own_sky, eye), self.shading.look)
            self._shade()
        self.sky.take_surroundings(self._surroundings(eye))
        self._shade()

    # ---- what changes

    def set_time(self, now):
        """Take over the settings of a time."""
        if now is self._now:  # as all frames have it without keyframes
            return
        self._now = now
        facts = self._sky_is_left_out, self._albedo, self._relit
        look = look_of(now, *facts, len(self.ground.terrain.tops) > 0)
        off_ground = wetness.off_ground_wetness(now)
        if self.shading and look == self.shading.look and off_ground == self.shading.off_ground:
            return
        self.ground.wet(now)
        self.sky.take_look(look)
        self._shade(look, off_ground, wetness.paving_dampness(now))
        self.capture.take_time(now)

    def _shade(self, look=None, off_ground=None, paving=None):
        """Make `shading` again, with the look there is unless another is given."""
        if look is None:
            now = self.shading
            look, off_ground, paving = now.look, now.off_ground, now.paving
        self.shading = Shading(
            self.ground.maps, off_ground, self.sky.maps(), self.sky.maps(True), look, paving
        )
        self._shades += 1

    @property
    def changes(self):
        """Numbers that change with whatever makes pictures of the same camera differ."""
        return self.capture.changes, self._shades

    def take_ground(self, ground):
        """Draw a `WetGround` or None from the next `set_time` on; the light stays as it is."""
        self.ground, self.shading, self._now = ground, None, None
        if ground is not None:
            ground.stand(self.capture.actors)

    def move_actors(self, time):
        """Take over where the scene's actors are at a time [s].

        Until the first call, and after a time of None, none is there.
        """
        if self.capture.move_actors(time):
            self.ground.bodies.move()
            self._shade()

    def take_tracks(self, tracks):
        """Take over where tyres have thinned the film, see `WetGround`."""
        if self.ground.take_tracks(tracks):
            self._shade()

    # ---- pictures

    def surface_depth(self, camera):
        """Return the depth of surfaces that `camera` (capture frame) sees, float32 [m]."""
        return self.depth_of(self.capture.layers(camera), self.view_of(camera))

    def depth_of(self, layers, view):
        """Return the depth of surfaces in splatted layers, see `find_surface_depth`."""
        depth = np.empty(layers.alpha.shape, np.float32)
        find_surface_depth(self.dry(layers), view, self.ground.maps, depth)
        return depth

    def dry(self, layers, mirrored=False):
        """Return the `DryPicture` of splatted layers."""
        layer = self.ground.thickest_layer
        return dry_picture(layers, self.frame.meters_per_unit, mirrored, layer)

    def picture(self, camera, cover=NO_COVER):
        """Return the `WetPicture` that `camera` (capture frame) takes.

        `cover` is the `cover_out` of `grade_and_wet`.
        """
        return self.wetted(self.capture.layers(camera), self.view_of(camera), cover)

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
                light = np.minimum(light, SHINES * self.shading.look.exposure)
            rainy += float(light.sum())
            pixels += int(land.sum())
            sky += int((~land).sum())
        return captured / max(pixels, 1), rainy / max(pixels, 1), sky / max(pixels + sky, 1)

    def small_views(self, cameras, gloss_apart):
        """Yield layers, `WetPicture` and `cover_out` of pictures that the light is set up by."""
        for camera, layers in self.capture.small_layers(cameras):
            cover = np.empty((camera.height, camera.width) if gloss_apart else (0, 0), np.float32)
            yield layers, self.wetted(layers, self.view_of(camera), cover), cover

    def level_mirrored(self, level):
        """Return the `WetPicture` of standing things, seen mirrored at the plane of the ground.

        `level` is the level, upright camera (ground frame) that is mirrored.
        """
        camera, layers = self.capture.level_layers(level)
        return self.wetted(layers, self.view_of(camera), mirrored=True)

    def mirrored(self, camera, level, window, step=1):
        """Return view and `MirrorPicture` of `camera` mirrored at the water's `level` [m].

        camera : Camera. In the capture frame.
        level : float [m]
        window : tuple of int [px]. Left, top, right and bottom of the part of its
            picture.
        step : int. Pixels of its picture, along either side, for one that is
            drawn; divides the window.
        Returns view : View
            picture : MirrorPicture
        """
        camera, layers = self.capture.mirrored_layers(camera, level, window, step)
        wet = self.wetted(layers, self.view_of(camera), mirrored=True)
        return wet.view, MirrorPicture(wet.picture, coarsened(wet.picture), wet.depth)

    def view_of(self, camera):
        """Return the `View` of a camera of the capture frame."""
        return view_of(self.frame.camera_in_ground(camera))

    def wetted(self, layers, view, cover=NO_COVER, mirrored=False):
        """Return the `WetPicture` of splatted layers of a camera with this `View`, graded and wet.

        `cover` is the `cover_out` of `grade_and_wet`.
        """
        now, shape = self.shading, layers.alpha.shape
        picture = np.empty((*shape, 3), np.float32)
        depth, clearance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        grade_and_wet(
            self.dry(layers, mirrored), view, now.ground, now.off_ground,
            now.mirrored_sky if mirrored else now.sky, now.look, picture, depth, clearance, cover,
        )  # fmt: skip
        return WetPicture(picture, depth, clearance, view, picture)

    def _captured_sky(self, scene, own, position):
        """Return the sky that splats `own` show from `position` [m], completed and graded."""
        drawn = Rasterizer(prepare(scene.splats.take(own)))

        def draw(view):
            camera = self.frame.camera_in_capture(view)
            dry = drawn.draw(camera, self.capture.near)
            linear = roughly_linear(dry.color, 4)
            seen = (dry.alpha > 0.9) & (linear.mean(axis=-1) > BRIGHT_SKY)
            return np.where(seen[..., None], linear, -1)

        found = environment.probe(draw, position)
        completed, share = sky.completed(found, found[..., 0] >= 0)
        self.notes.append(
            f"the capture shows {share:.0%} of the sky; an overcast one fills the other part"
        )
        return completed * self.shading.look.exposure

    def _surroundings(self, position):
        """Return the wet capture around `position` [m] with the sky of the day, as a map."""

        def draw(view):
            camera, layers = self.capture.surrounding_layers(view)
            picture = self.wetted(layers, self.view_of(camera), mirrored=True).picture
            return picture.reshape(view.height, FINER, view.width, FINER, 3).mean(axis=(1, 3))

        return environment.probe(draw, position)
