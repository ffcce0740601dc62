"""What a frame shows: scene, weather, camera and water of its time, the inputs of its passes.

Both backends have a `Conductor` and draw with the `Frame` that it fills.
"""

import math
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from rainsim.actors.footprint import with_footprints
from rainsim.drops import Weather
from rainsim.jit import may_run_beside
from rainsim.numerics.blocks import beside
from rainsim.particles import drop_radiance
from rainsim.particles.splash import LONGEST_LIFE
from rainsim.rain.exposure import rain_exposure
from rainsim.rain.moving_surfaces import MovingSurfaces, begun
from rainsim.rain.tyres import cars_of, rolled
from rainsim.raster import Rasterizer
from rainsim.reflection.mirror_choice import mirror_step
from rainsim.reflection.water_pass import WaterTables
from rainsim.reflection.water_shading import SHELTERED_SHARE
from rainsim.render.frame import PASSES, Frame, Pass
from rainsim.render.layers import LAYER_PASSES
from rainsim.render.wet_ground import WetGround
from rainsim.render.wet_scene import WetScene
from rainsim.scene.view import view_of
from rainsim.shading import calibration, environment, sky
from rainsim.shading.calibration import metered
from rainsim.shading.wet_ground_mirror import WetGroundMirror, mean_share
from rainsim.simulation import tops_drawn, usual_wind
from rainsim.water.ripples import ring_reach, ring_share, sheltered_rings, taller_rings
from rainsim.water.tracks import NO_TRACKS, tracks_of

# What is chosen before the first frame, and again when settings that it reads have changed.
SET_UP = (
    Pass("tables", ("terrain", "rings", "wind"), ("laid",)),
    Pass("meter", ("metering", "film"), ("metered",)),
    Pass("choose film", ("film",), ("chosen",)),
)
RING_DEPTH = 5e-3  # m of water on which rings travel in under cover


class GroundTables(NamedTuple):
    """The map of the ground that carries the water, as passes take it.

    terrain : Terrain
    moving : MovingSurfaces
    ring_share, rings : float32 array (ny, nx). See the function and, of it,
        `taller_rings`; what moves shelters some of them.
    water : WaterTables
    film : WetGroundMirror
    """

    terrain: object
    moving: MovingSurfaces
    ring_share: np.ndarray
    rings: np.ndarray
    water: WaterTables
    film: WetGroundMirror


class Conductor:
    """Puts the inputs of one frame after another, of one scene, terrain and configuration.

    scene, terrain, config, first_camera. As `rainsim.render.renderer.Renderer`
        takes them.
    rasterizer_of : callable. rasterizer_of(prepared) returns what draws prepared
        splats.
    frame : Frame
    wet_scene : WetScene
    ground : GroundTables
    methods : RenderConfig. Names how water and film are drawn.
    weather : Weather
    now : Config. Of the present time.
    camera, ground_camera : Camera or None. Of the last frame, in the capture
        frame and in the ground frame.
    view : View or None. Of the ground camera, as kernels take it.
    sheltered : list of tuple of slice. Windows of the map in which actors keep
        rings off in the last frame.
    cars : list of Motion. What has tyres that throw water.
    brightness : float. Factor on the finished picture: that of the settings times
        the meter's.
    notes : list of str. That no report has held yet.
    """

    def __init__(self, scene, terrain, config, first_camera, rasterizer_of=Rasterizer):
        self.frame, self._set_up = Frame((*PASSES, *LAYER_PASSES)), Frame(SET_UP)
        self._coming, self._coming_on = {}, None
        self._common_rings, self.sheltered = None, []
        self._ringed = None, None  # shelters, and the rings that were last found for them
        terrain = with_footprints(tops_drawn(terrain, config), scene)
        self.cars = cars_of(terrain.footprints, config.render)
        self._first_camera = calibration.fixed_camera(scene, terrain, config) or first_camera
        film = WetGroundMirror(terrain, config.render)
        slopes = beside(lambda: film.ground if film.apart else None)
        self.wet_scene = WetScene(scene, terrain, config, self._first_camera, rasterizer_of)
        slopes()  # the film keeps them
        light = self.wet_scene.sky
        self._sun, note = sky.sun_of(config.render.sun, light.day)
        self.notes = [*self.wet_scene.notes, *([note] if note else [])]
        self._air = environment.horizon_radiance(light.day)
        self._everywhere = drop_radiance.mean_radiance(light.gloss)
        self.now, self.brightness = config.at(0.0), 1.0
        self._lit_for = self._sunlight = None  # the settings that brightness and sunlight are of
        self.ground = GroundTables(terrain, None, None, None, None, film)
        self.take_settings(config)
        self.camera = self.ground_camera = self.view = None

    # ---- a frame

    def take(self, camera, state, camera_end=None):
        """Put the inputs of the next frame.

        camera : Camera. In the capture frame.
        state : SimState or DeviceState
        camera_end : Camera or None. As the shutter closes, in the ground frame;
            None: the camera stands still. Only rain shows the motion: the capture
            stays sharp.
        """
        put, scene = self.frame.put, self.wet_scene
        self.set_time(state.time)
        if camera is not self.camera:
            self.camera, self.ground_camera = camera, scene.frame.camera_in_ground(camera)
            self.view = view_of(self.ground_camera)
        now, render = self.now, self.now.render
        put("camera", self.camera)
        put("ground_camera", self.ground_camera)
        put("ground_camera_end", camera_end)
        put("view", self.view)
        put("capture", scene.capture, scene.capture.changes)
        put("scene", scene, scene.changes)
        put("ground", self.ground)
        put("methods", self.methods)
        put("film_apart", self.ground.film.apart)
        put("render", render)
        put("time", state.time)
        put("interval", self.config.frame_interval)
        surfaces, rings, self.sheltered = self._moment(state.time)
        put("surfaces", surfaces)
        put("rings", rings, compare=False)
        put("tops", self.ground.water.tops_with(state.top_water, now.rain.rate))
        rain = now.rain.rate, now.water.surface_film
        lens = self.ground_camera.fx, self.ground_camera.fy
        put("mirror_step", mirror_step(self.methods.mirror_size, *rain, lens))
        put("field", self.field(state.time))
        put("paving", scene.shading.paving)
        put("sun", self._sunlight)
        put("everywhere", self._everywhere)
        put("air", self._air)
        put("brightness", self.brightness)

    def take_water(self, state):
        """Put the water and the drops of the next frame's state, where the host has them."""
        put = self.frame.put
        put("water", state.depth)
        put("ripples", (state.slopes, state.tile_size))
        put("drips", (state.drips, state.drip_id))

    def roll(self, time, depth):
        """Put where tyres have rolled until a time [s] over water of a depth [m]; before `take`."""
        rolls, tracks = None, NO_TRACKS
        if self.cars:
            self.set_time(time)
            terrain, film = self.ground.terrain, self.wet_scene.ground.full_film
            rolls = rolled(self.cars, terrain, depth, film, time, self.weather, self.now.rain)
            tracks = tracks_of(rolls, terrain, depth, time, self.now.rain.rate)
        self.frame.put("rolls", rolls)
        self.wet_scene.take_tracks(tracks)

    def field(self, time):
        """Return the drops whose streaks or splashes a frame shows, a RainField; None: no rain."""
        return self.weather.field(time - LONGEST_LIFE, time + self.now.render.exposure)

    def _moment(self, time):
        """Return what drops land on at a time [s], and the amplitude of rings on each cell.

        And the windows of the map in which actors keep rings off.
        """
        ground = self.ground
        if not ground.terrain.footprints:
            return ground.moving.still, ground.rings, []
        surfaces, shelters = ground.moving.moment(time)
        if self._common_rings is not None:
            return surfaces, *self._common_rings
        if self._coming_on is ground and time in self._coming:
            return surfaces, *self._coming[time].result()
        return surfaces, *self._rings(ground, shelters)

    @contextmanager
    def bands_of(self, camera, time):
        """Draw within the block bands of one picture, of a camera of the ground frame.

        Where rings run and what wet ground mirrors is the same for all, as at a time [s].
        """
        self._common_rings = self._moment(time)[1:]
        self.ground.film.share_level(camera)
        try:
            yield
        finally:
            self._common_rings = None
            self.ground.film.share_level(None)

    def _rings(self, ground, shelters):
        """Return what `sheltered_rings` does for a part of the ground with shelters."""
        before, found = self._ringed
        if shelters is not before:
            found = sheltered_rings(
                ground.rings, ground.ring_share, self.wet_scene.ground.reach, shelters,
                ground.terrain.grid.spacing, self._ring_reach,
            )  # fmt: skip
            self._ringed = shelters, found
        return found

    def look_ahead(self, times, kept=()):
        """Begin to find where things are at some times [s], and their rings, on other threads.

        What was found for the times in `kept` stays.
        """
        if not may_run_beside():
            return
        ground, known = self.ground, self._coming if self._coming_on is self.ground else {}
        moments = dict(zip(times, ground.moving.look_ahead(times, kept), strict=True))
        self._coming = begun(
            known, times, kept, lambda time: self._rings(ground, moments[time].result()[1])
        )
        self._coming_on = ground

    def set_time(self, time):
        """Take over the settings and the places of what moves of a time [s]."""
        now = self.now = self.config.at(time)
        if now is not self._lit_for:  # without keyframes all frames have the same
            metered = math.exp(np.interp(time, *self._set_up["metered"]))
            self.brightness = now.render.brightness * metered * 2 ** calibration.exposure_bias(now)
            self._sunlight = sky.sunlight(self._sun, now.render.cloudiness)
            self._lit_for = now
        self.wet_scene.set_time(now)
        self.wet_scene.move_actors(time)

    def take_settings(self, config):
        """Draw with other settings from now on, but with the light that was set up for the first.

        Exact but for settings that touch ground, water or light, see `config.declare.Setting`:
        until a renderer with those is made, pictures are an approximation.
        """
        self.config, self.weather, self._lit_for = config, Weather(config), None
        self.cars = cars_of(self.ground.terrain.footprints, config.render)
        self.take_methods(config.render)
        put, rain, render = self._set_up.put, self.weather.mean_rate, config.render
        put("terrain", self.ground.terrain)
        put("rings", (config.water.surface_film, rain, render.ripples))
        put("wind", (usual_wind(config), config.rain.roughness))
        put("metering", tuple(config.at(time).render.metering for time in config.key_times()))
        put("film", (render.film, self.ground.film.apart))
        self._set_up.make(("laid", "metered", "chosen"), {
            "tables": self._lay_tables, "meter": self._meter, "choose film": self._choose_film,
        })  # fmt: skip

    def take_methods(self, render):
        """Draw water and film by the methods that a RenderConfig names, from now on."""
        self.methods = self.ground.film.config = render

    # ---- maps of the ground

    def _lay_tables(self, terrain, rings):
        self._ring_reach = ring_reach(RING_DEPTH, *rings[:2])
        self.ground = self._tables(terrain, self.wet_scene.ground.reach, self.ground.film)

    def _tables(self, terrain, reach, film):
        config = self.config
        moving = MovingSurfaces(terrain, usual_wind(config), config.rain.roughness)
        share = ring_share(reach, terrain.grid.spacing, *self._ring_reach)
        rings = taller_rings(share, config.render.ripples, SHELTERED_SHARE)
        water = WaterTables(terrain, self._ring_reach)
        return GroundTables(terrain, moving, share, rings, water, film)

    def take_ground(self, make, time):
        """Draw another map of the ground from a time [s] on; the light stays as it was set up.

        make() returns its `Terrain`, the scene's actors on it, which is returned; it is called when
        nothing of the map before is held.
        """
        film = self.ground.film.over(None)
        self.ground = GroundTables(None, None, None, None, None, film)
        self.camera, self.frame = None, Frame((*PASSES, *LAYER_PASSES))
        self._coming, self._coming_on, self._ringed = {}, None, (None, None)
        self._set_up.put("terrain", None)
        self.wet_scene.take_ground(None)
        terrain = tops_drawn(make(), self.config)
        reach = rain_exposure(terrain, usual_wind(self.config), self.config.rain.roughness)
        self.wet_scene.take_ground(WetGround(terrain, reach))
        self.wet_scene.set_time(self.config.at(time))
        self.ground = self._tables(terrain, reach, film.over(terrain))
        return terrain

    # ---- choices before the first frame

    def _views(self):
        """Return the cameras of views by which the light of a run is chosen; no frame decides."""
        self.wet_scene.move_actors(None)
        self.wet_scene.take_tracks(NO_TRACKS)
        return calibration.metering_views(self.wet_scene.scene.cameras, self._first_camera)

    def _meter(self):
        """Return the key times and the logarithms of the factors that a camera's meter chooses."""
        times = self.config.key_times()
        factors = np.ones(len(times))
        views = self._views()
        for k, time in enumerate(times):
            now = self.config.at(time).replace(wetness=1.0)  # else it would take that back
            if now.render.metering == "auto":
                self.wet_scene.set_time(now)
                light = self.wet_scene.land_light(views, self.ground.film.apart)
                zenith = float(self.wet_scene.sky.day[0].mean())
                factors[k] = metered(*light, zenith, now.render.cloudiness)
        self.wet_scene.set_time(self.config.at(0.0))
        if (factors != 1).any():
            bias = calibration.exposure_bias(self.config.at(0.0))
            about = f", and {bias:+.2g} EV as it is wet" if bias else ""
            self.notes.append(f"exposure: the meter takes the light {factors[0]:.2f} times{about}")
        return times, np.log(factors)

    def _choose_film(self):
        """Let `auto` choose the reflections of wet ground, by the capture's views at all key times.

        All frames of a run agree on it, whichever of them are drawn here.
        """
        film = self.ground.film
        film.drawn = self.config.render.film == "mirror"
        if not (film.apart and self.config.render.film == "auto"):
            return

        def shares():
            views = self._views()
            for time in self.config.key_times():
                self.wet_scene.set_time(self.config.at(time))
                for _, wet, cover in self.wet_scene.small_views(views, True):
                    yield mean_share(wet.view, cover)

        self.notes.append(film.choose(shares()))
        self.wet_scene.set_time(self.config.at(0.0))

    # ---- captures in chunks

    def read_ahead(self, camera):
        """Begin to read the chunks that a camera of the capture frame needs, if there are any."""
        capture = self.wet_scene.capture
        if capture.paged is not None:
            capture.paged.read_ahead(camera, capture.near)
