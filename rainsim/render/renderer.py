"""Rainy frames: a capture, its terrain and the water's state in, pictures for display out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rainsim.actors.footprint import with_footprints
from rainsim.particles import drop_radiance, paper
from rainsim.particles.splash import WET_FILM
from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.raster import Rasterizer
from rainsim.reflection.water_pass import Shower, WaterPass
from rainsim.reflection.water_shading import SHELTERED_SHARE
from rainsim.render import aov
from rainsim.render.actor_labels import ActorsSeen
from rainsim.render.rain_pass import RainPass
from rainsim.render.report import FrameReport, Timer
from rainsim.render.shutter import next_camera
from rainsim.render.weather import weather_of
from rainsim.render.wet_ground import WetGround, wet_ground_of
from rainsim.render.wet_scene import WetScene
from rainsim.shading import environment, sky
from rainsim.shading.calibration import (
    exposure_bias,
    fixed_camera,
    metered,
    metering_views,
)
from rainsim.shading.composite import RainLight, compose
from rainsim.shading.glare import Glare
from rainsim.shading.wet_ground_mirror import WetGroundMirror, mean_share
from rainsim.simulation import tops_drawn, usual_wind
from rainsim.water.ripples import ring_reach, ring_share, sheltered_rings, taller_rings

RING_DEPTH = 5e-3  # m of water on which rings travel in under cover


class ReadyGround(NamedTuple):
    """A part of the ground as `Renderer.take_ground` takes it."""

    wet: WetGround
    moving: MovingSurfaces
    rings: np.ndarray
    water: WaterPass


class Renderer:
    """Draws frames of one scene, terrain and configuration.

    What a still camera sees without water is drawn once.

    Parameters
    ----------
    scene : Scene
    terrain : Terrain
    config : Config
    first_camera : Camera
        In the capture frame; the surroundings are drawn from its place, and a capture without
        cameras is metered by it, see `fixed_camera`.
    rasterizer_of : callable
        rasterizer_of(prepared) returns what draws prepared splats.
    wet_scene : WetScene, optional
        Of another renderer, whose settings differ in nothing that a `WetScene` depends on.

    Attributes
    ----------
    wet_scene : WetScene
    rain : RainPass
    water : WaterPass
    wet_ground : WetGroundMirror
    rings : ndarray of shape (ny, nx), float32
        See `ring_share`.
    brightness : float
        Factor on the finished picture: that of the settings times the meter's.
    air_light, everywhere : ndarray of shape (3,), float32
        Radiance of distant air, and the mean of the surroundings.
    view, view_end : Camera
        Of the last frame as its shutter opens and closes, in the ground frame; None at the end:
        the camera stands still.
    wet : WetPicture
        Of the last frame.

    Examples
    --------
    >>> renderer = rainsim.Renderer(scene, terrain, config, scene.cameras[0])
    >>> picture, report = renderer.draw(scene.cameras[0], state, names=("depth",))
    >>> picture.shape, report.aovs["depth"].shape
    ((48, 64, 3), (48, 64))
    """

    def __init__(
        self, scene, terrain, config, first_camera, rasterizer_of=Rasterizer, wet_scene=None
    ):
        terrain = with_footprints(tops_drawn(terrain, config), scene)
        self.terrain, self.config = terrain, config
        first_camera = fixed_camera(scene, terrain, config) or first_camera
        if wet_scene is None:
            wet_scene = WetScene(scene, terrain, config, first_camera, rasterizer_of)
        self.wet_scene = wet_scene
        wet_scene.move_actors(None)  # the light of a run depends on no frame
        self.moving = MovingSurfaces(terrain, usual_wind(config), config.rain.roughness)
        self.rain = RainPass(self.moving.still, config)
        self._ring_reach = ring_reach(
            RING_DEPTH, config.water.surface_film, self.rain.weather.mean_rate
        )
        self.rings = self._rings_on(terrain, self.wet_scene.reach)
        self.water = WaterPass(terrain, self.rings, self._ring_reach, config.render)
        self.wet_ground = WetGroundMirror(terrain, config.render)
        self.sun, note = sky.sun_of(config.render.sun, self.wet_scene.day)
        self.notes = [*self.wet_scene.notes, *([note] if note else [])]
        self.air_light = environment.horizon_radiance(self.wet_scene.day)
        self.everywhere = drop_radiance.mean_radiance(self.wet_scene.gloss)
        self.now, self.brightness = config.at(0.0), 1.0
        self._metered = self._meter(first_camera)
        self._choose_film(first_camera)
        self._camera = None  # that the kept picture belongs to
        self._glare = Glare()
        self.view_end = None
        self._choice_is_noted = False  # of the reflections

    def draw(self, camera, state, camera_end=None, names=(), timer=None):
        """Return the picture (height, width, 3) uint8 that a camera takes, and its report.

        Parameters
        ----------
        camera : Camera
            In the capture frame.
        state : SimState
        camera_end : Camera or None
            As the shutter closes, in the ground frame; None: the camera stands still. Only rain
            shows the motion: the capture stays sharp.
        names : sequence of str
            AOVs that the report is to hold, of `aov.AOVS`.
        timer : Timer, optional
            Its `mark` is called between the stages. If it raises, the picture is given up; the
            next call must be for another Camera.
        """
        timer = timer or Timer()
        changed = self.wet_scene.take_tracks(state.tracks)
        if self.set_time(state.time) or changed or camera is not self._camera:
            self._see(camera, timer)
        self.view_end = camera_end
        render, scene = self.now.render, self.wet_scene
        picture = self.water.draw(
            state, self.shower, self.mirrored, scene.traced, scene.environment, self.sunlight,
            timer,
        )  # fmt: skip
        cover = self.rain.draw(
            self.view, camera_end, state, render, scene.paving, self.wet.depth, timer
        )
        light = RainLight(*self.drop_light, self.air_light)
        if render.streaks == "paper":
            radiance = paper.line_radiance(picture)
            drops = drop_radiance.even(radiance)
            light = RainLight(drops, drops, self.air_light)
        if render.glare != "off":
            picture = self._glare.added(picture, camera.fx, self.brightness)
            timer.mark("glare")
        image = np.empty((camera.height, camera.width, 3), np.uint8)
        brightness = np.float32(self.brightness)
        compose(picture, self.wet.depth, cover, light, self.wet.view, brightness, image)
        timer.mark("compose")
        if not self._choice_is_noted and (choice := self.water.choice()):
            self._choice_is_noted = True
            self.notes.append(choice)
        notes, self.notes = (*state.notes, *self.notes), []
        apart = ()
        if names:
            apart = self.aovs(names, state, self.wet, cover, light)
            timer.mark("layers")
        report = FrameReport(state.index, state.time, timer.stages, state.ledger, notes, *apart)
        return image, report

    def take_settings(self, config):
        """Draw with other settings from now on, but with the light that was set up for the first.

        Exact for what is read for each frame: brightness, exposure, streaks, splashes and the lens;
        else an approximation, until a renderer with these settings is made.
        """
        self.config, self._camera = config, None
        self.rain = RainPass(self.moving.still, config)

    def leave_ground(self):
        """Drop all that depends on the present part of the ground; `take_ground` must follow."""
        self._camera = self.water = self.rings = None
        self.wet_ground = self.wet_ground.over(None)
        self.wet_scene.leave_ground()

    def ready_ground(self, terrain, reach, now):
        """Return the `ReadyGround` that `take_ground` takes; nothing of the renderer changes.

        Parameters
        ----------
        terrain : Terrain
            A window of the ground of this renderer's scene, its actors on it.
        reach : ndarray of shape (ny, nx), float32
            Share of the rain that reaches the ground.
        now : Config
            Of the time from which on it is drawn.
        """
        config = self.config
        terrain = tops_drawn(terrain, config)
        moving = MovingSurfaces(terrain, usual_wind(config), config.rain.roughness)
        rings = self._rings_on(terrain, reach)
        water = WaterPass(terrain, rings, self._ring_reach, config.render)
        return ReadyGround(wet_ground_of(terrain, reach, now), moving, rings, water)

    def _rings_on(self, terrain, reach):
        """Return the amplitude of rings on each cell over that in the open, (ny, nx)."""
        rings = ring_share(reach, terrain.grid.spacing, *self._ring_reach)
        return taller_rings(rings, self.config.render.ripples, SHELTERED_SHARE)

    def take_ground(self, ready):
        """Draw the water of another part of the ground from now on; the light stays as it is.

        `ready` is what `ready_ground` returned.
        """
        self._camera, self.terrain = None, ready.wet.terrain
        self.wet_scene.take_ground(ready.wet)
        self.moving, self.rings, self.water = ready.moving, ready.rings, ready.water
        self.rain = RainPass(self.moving.still, self.config)
        self.wet_ground = self.wet_ground.over(self.terrain)

    def read_ahead(self, camera):
        """Begin to read the chunks that a camera of the capture frame needs, if there are any."""
        if self.wet_scene.paged is not None:
            self.wet_scene.paged.read_ahead(camera, self.wet_scene.near)

    def hold(self, camera):
        """Read now the chunks that a camera of the capture frame needs, if there are any."""
        if self.wet_scene.paged is not None:
            self.wet_scene.paged.whole.hold(camera, self.wet_scene.near)

    def film(self, shots, names=()):
        """Yield the result of `draw` for each (camera, state, camera_end), one after the other."""
        for camera, state, camera_end in shots:
            yield self.draw(camera, state, camera_end, names)

    def set_time(self, time):
        """Take over the settings of a time [s]; return whether they change the dry picture."""
        self.now = self.config.at(time)
        self.brightness = self.now.render.brightness * math.exp(np.interp(time, *self._metered))
        self.brightness *= 2 ** exposure_bias(self.now)
        changed = self.wet_scene.set_time(self.now)
        return self._move_actors(time) or changed

    def _move_actors(self, time):
        """Take over the actors' places at a time [s] and their shelter; return if actors moved."""
        moved = self.wet_scene.move_actors(time)
        if self.terrain.footprints:
            self.rain.surfaces, shelters = self.moving.moment(time)
            self.water.take_rings(
                sheltered_rings(
                    self.rings, self.wet_scene.reach, shelters, self.terrain.grid.spacing,
                    self._ring_reach,
                )
            )  # fmt: skip
        return moved

    def _meter(self, first_camera):
        """Return the key times and the logarithms of the factors that a camera's meter chooses."""
        times = self.config.key_times()
        factors = np.ones(len(times))
        views = metering_views(self.wet_scene.scene.cameras, first_camera)
        for k, time in enumerate(times):
            now = self.config.at(time).replace(wetness=1.0)  # else it would take that back
            if now.render.metering == "auto":
                self.wet_scene.set_time(now)
                light = self.wet_scene.land_light(views, self.wet_ground.apart)
                zenith = float(self.wet_scene.day[0].mean())
                factors[k] = metered(*light, zenith, now.render.cloudiness)
        self.wet_scene.set_time(self.config.at(0.0))
        if (factors != 1).any():
            bias = exposure_bias(self.config.at(0.0))
            about = f", and {bias:+.2g} EV as it is wet" if bias else ""
            self.notes.append(f"exposure: the meter takes the light {factors[0]:.2f} times{about}")
        return times, np.log(factors)

    def _choose_film(self, first_camera):
        """Let `auto` choose the reflections of wet ground, by the capture's views at all key times.

        No frame decides, so all frames of a run agree on it, whichever of them are drawn here.
        """
        if not (self.wet_ground.apart and self.config.render.film == "auto"):
            return

        def shares():
            views = metering_views(self.wet_scene.scene.cameras, first_camera)
            for time in self.config.key_times():
                self.wet_scene.set_time(self.config.at(time))
                for _, wet, cover in self.wet_scene.small_views(views, True):
                    yield mean_share(wet.view, cover)

        self.notes.append(self.wet_ground.choose(shares()))
        self.wet_scene.set_time(self.config.at(0.0))

    @property
    def sunlight(self):
        """The sun of the present time as kernels take it, see `sky.sunlight`."""
        return sky.sunlight(self.sun, self.now.render.cloudiness)

    @property
    def shower(self):
        """The `Shower` of the present time."""
        return Shower(
            self.wet_scene.off_ground, self.now.rain.rate, self.wet_scene.gloss,
            self.now.water.surface_film,
        )  # fmt: skip

    def falling_light(self, wet):
        """Return the light of drops and splashes before a `WetPicture`, see `drop_radiance`."""
        view = wet.view
        return drop_radiance.falling_light(
            self.wet_scene.gloss, self.everywhere, view.ground_from_camera, view.lens, wet.picture,
            wet.depth,
        )  # fmt: skip

    def mirrored(self, *place):
        """Return the mirrored picture of the last frame's camera, see `WetScene.mirrored`."""
        return self.wet_scene.mirrored(self._camera, *place)

    def aovs(self, names, state, wet, cover, light):
        """Return the named AOVs of the frame drawn last, the light that recomposes it, and facts.

        Parameters
        ----------
        names : sequence of str
        state : SimState
        wet : WetPicture
        cover : RainCover
        light : RainLight
        """
        render, scene = self.now.render, self.wet_scene
        dry = None
        if not aov.DRY.isdisjoint(names):
            dry = scene.dry(self._camera, "clean" in names)
        field = self.rain.field(state.time, render.exposure)
        parts = aov.FrameParts(
            dry=dry, wet=wet, water=self.water, sun=self.sunlight,
            field=field, surfaces=self.rain.surfaces,
            camera=self.view, state=state, exposure=render.exposure,
            interval=self.config.frame_interval, film=WET_FILM * scene.paving,
            ground=scene.ground_maps, off_ground=scene.off_ground, look=scene.look,
            unit=scene.frame.meters_per_unit, cover=cover,
            far=render.streak_far, terrain=self.terrain, actors=self._actors_seen(names),
            **self._after(names),
        )  # fmt: skip
        radiances = {
            "drop": light.drops.tolist(), "around": light.around.tolist(),
            "air": light.air.tolist(), "brightness": float(self.brightness),
        }  # fmt: skip
        aovs = aov.collect(names, parts)
        return aovs, radiances, aov.facts_of(aovs, parts, weather_of(self.now, field))

    def _after(self, names):
        """Return the next frame's camera and its picture, as `FrameParts` takes them."""
        render, scene = self.now.render, self.wet_scene
        actors, after = scene.actors, None
        if self.view_end is not None:
            share = render.exposure / self.config.frame_interval
            after = next_camera(self.view, self.view_end, share)
        elif actors is not None:
            after = self.view
        if after is None or aov.FLOW.isdisjoint(names):
            return {"after": after}
        now = None if actors is None else actors.time
        if actors is not None:
            scene.move_actors(now + self.config.frame_interval)
        seen = scene.picture(scene.frame.camera_in_capture(after), Timer())
        if actors is not None:
            scene.move_actors(now)
        return {"after": after, "depth_after": seen.depth}

    def _actors_seen(self, names):
        """Return the `ActorsSeen` of the frame; None without actors or without names that ask."""
        scene = self.wet_scene
        if scene.actors is None or aov.ACTORS.isdisjoint(names):
            return None
        actors = scene.actors
        return ActorsSeen(
            actors.actors, actors.time, self.config.frame_interval, scene.frame,
            scene.actor_numbers(self._camera),
        )  # fmt: skip

    def take_camera(self, camera):
        """Take over the camera of a frame, in the capture frame."""
        self._camera, self.view = camera, self.wet_scene.frame.camera_in_ground(camera)

    def _see(self, camera, timer):
        """Draw the picture of a new camera without water."""
        self.take_camera(camera)
        shape = (camera.height, camera.width) if self.wet_ground.apart else (0, 0)
        cover = np.empty(shape, np.float32)
        wet = self.wet_scene.picture(camera, timer, cover)
        self.wet = self.wet_ground.add_to(
            wet, cover, self.view, self.wet_scene.level_mirrored, self.wet_scene.gloss
        )
        timer.mark("film")
        self.water.look(self.wet)
        self.drop_light = self.falling_light(self.wet)
