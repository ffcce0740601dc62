"""Rainy frames: a capture, its terrain and the water's state in, pictures for display out."""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from rainsim import droplight, layers, paperrain, shade, sky, wetness
from rainsim.backdrop import NEAREST_SKY, Backdrop, sky_distance
from rainsim.drips import drip_impacts, drips_seen
from rainsim.errors import ParameterError
from rainsim.film import WetGround, in_level_picture
from rainsim.grade import grade_and_wet
from rainsim.layered import grader, layered
from rainsim.motion import shutter_end
from rainsim.pyramid import coarsened
from rainsim.raster import Rasterizer, prepare
from rainsim.ripples import ring_reach, ring_share
from rainsim.scene.cameras import MIRROR_CLEARANCE, cropped, mirrored_camera
from rainsim.simulation import rain_exposure, surfaces_of, usual_wind
from rainsim.splash import LONGEST_LIFE, WET_FILM
from rainsim.splashview import draw_splashes
from rainsim.streaks import NO_FOG, draw_streaks, fog_table, streak_reach
from rainsim.terrain.pond import without_images
from rainsim.traced import Tracer
from rainsim.waterview import View, WaterView
from rainsim.weather import Weather

NEAR = 0.05  # m: splats nearer than this are not drawn
FIRST_SEGMENT = 0.5  # m of a traced ray that are searched at first
NO_FILM = np.empty((0, 0), np.float32)  # it glosses as all else does
RING_DEPTH = 5e-3  # m of water on which rings travel in under cover
SUN_IRRADIANCE = 25.0  # of display white: full sun over the overcast sky's some 1


@dataclass(frozen=True)
class FrameReport:
    """What was done for a frame.

    Attributes
    ----------
    index : int
    time : float [s]
    milliseconds : dict of str to float
        Wall time of each stage.
    ledger : dict
        Water volumes [m3] and their relative residual.
    notes : tuple of str
    layers : dict of str to ndarray
        What was asked for, see `rainsim.layers`.
    light : dict
        What `layers.recompose` needs besides: radiances and the brightness.
    """

    index: int
    time: float
    milliseconds: dict
    ledger: dict
    notes: tuple = ()
    layers: dict = field(default_factory=dict)
    light: dict = field(default_factory=dict)


class Renderer:
    """Draws frames of one scene, terrain and configuration; draws a still camera's capture once."""

    def __init__(self, scene, terrain, config, first_camera):
        self.terrain, self.config = terrain, config
        self.frame = scene.ground_frame
        self.sky_distance = sky_distance(scene)
        self.backdrop = Backdrop(scene, self.sky_distance, replaces_sky(config))
        self.scene = scene = self.backdrop.scene
        self.near = NEAR / self.frame.meters_per_unit
        self.rasterizer = self._rasterizer_of(prepare(scene.splats))
        self.surfaces = surfaces_of(terrain)
        self.weather = Weather(config)
        self.exposure = rain_exposure(terrain, usual_wind(config), config.rain.roughness)
        self.grass = ndimage.gaussian_filter(terrain.grassy.astype(np.float32), 1)
        self.look = self.others = None
        self.day = day_sky(config.render)
        self._set_time(0.0)
        reach = ring_reach(RING_DEPTH, config.water.surface_film, self.weather.mean_rate)
        self.rings = ring_share(self.exposure, terrain.grid.spacing, *reach)
        self.water = WaterView(terrain, self.rings, config.render)
        self.notes = [self.backdrop.note()] if self.backdrop.count else []
        eye = self.frame.to_ground(first_camera.position)
        if config.render.sky == "capture":
            self.day = self.behind = self._captured_sky(eye)
        self.sun = self._find_sun()
        self.air_light = sky.horizon_radiance(self.day)
        self.gloss = sky.blurred(self.day)  # until the surroundings are drawn
        self.environment = self._surroundings(eye)
        self.gloss = sky.blurred(self.environment)
        self.everywhere = droplight.mean_radiance(self.gloss)
        self.wet_ground = WetGround(terrain, config.render)
        self._camera = None  # that the kept layers belong to
        self._standing = None  # splats that stand on the ground, when they are first asked for
        self._tracer = None  # made when it is first asked for
        self._told = False  # how reflections are made

    @staticmethod
    def _rasterizer_of(prepared):
        return Rasterizer(prepared)

    def draw(self, camera, state, camera_end=None, names=()):
        """Return the picture (height, width, 3) uint8 that `camera` (capture frame) takes.

        `camera_end` is where it is when the shutter closes, in the ground frame; None: it is still.
        Only rain shows the motion: what was captured stays sharp. `names` are the layers that the
        report is to hold.
        """
        timer = Timer()
        if self._set_time(state.time) or camera is not self._camera:
            self._see(camera, timer)
        picture = self.water.draw(
            state, self._mirrored, self._traced, self.environment, self._sun, timer
        )
        rain_alpha, splash_alpha = self._drops(camera, state, timer, camera_end)
        image = np.empty((camera.height, camera.width, 3), np.uint8)
        fog = self._fog()
        drop, around = self.drop_light, self.everywhere
        if self.now.render.streaks == "paper":
            around = paperrain.line_radiance(picture)
            drop = droplight.even(around)
        shade.compose(
            picture, self.wet.depth, rain_alpha, splash_alpha, drop, around, self.air_light,
            fog, self.wet.lens, np.float32(self.now.render.brightness), image,
        )  # fmt: skip
        timer.mark("compose")
        if not self._told and (choice := self.water.choice()):
            self._told = True
            self.notes.append(choice)
        notes, self.notes = self.notes, []  # told once
        found, light = {}, {}
        if names:
            found = layers.collect(names, self._shot(names, state, rain_alpha, splash_alpha, fog))
            light = {"drop": drop.tolist(), "around": around.tolist()}
            light["air"] = self.air_light.tolist()
            light["brightness"] = float(self.now.render.brightness)
            timer.mark("layers")
        return image, FrameReport(
            state.index,
            state.time,
            timer.stages,
            state.ledger,
            (*state.notes, *notes),
            found,
            light,
        )

    def film(self, shots, names=()):
        """Yield what `draw` returns for each (camera, state, camera_end), one after the other."""
        for camera, state, camera_end in shots:
            yield self.draw(camera, state, camera_end, names)

    def _shot(self, names, state, rain_alpha, splash_alpha, fog):
        """Return what the frame just drawn was put together from."""
        dry = None
        if not {"clean", "normal", "wetness"}.isdisjoint(names):
            dry = self.rasterizer.draw(self._camera, self.near)
        if "clean" in names and self.backdrop.count:
            whole = self._rasterizer_of(prepare(self.backdrop.whole.splats))
            dry = replace(dry, color=whole.draw(self._camera, self.near).color)
        return layers.Shot(
            layers=dry, view=self.wet, water=self.water, environment=self.environment,
            sun=self._sun, field=self.field, surfaces=self.surfaces, camera=self.view, state=state,
            exposure=self.now.render.exposure, interval=self.config.frame_interval,
            film=WET_FILM * self.wetness, ground=self.ground, others=self.others,
            rain=rain_alpha, splash=splash_alpha, fog=fog, far=self.now.render.streak_far,
        )  # fmt: skip

    def _set_time(self, time):
        """Take over the settings of a time; return whether the dry picture's look has changed."""
        self.now = self.config.at(time)
        new_look, new_others = look(self.now), wetness.others(self.now)
        new_look[4:] = self.sky_distance, self.backdrop.count > 0
        if np.array_equal(new_look, self.look) and np.array_equal(new_others, self.others):
            return False
        self.look, self.others = new_look, new_others
        self.wetness = wetness.overall(self.now)
        self.ground = wetness.ground_maps(self.terrain, self.grass, self.exposure, self.now)
        self.behind = self.backdrop.mixed(self.day, self.look)
        return True

    def _see(self, camera, timer):
        """Splat the capture for a new camera, grade and wet it."""
        self.view = self.frame.camera_in_ground(camera)
        shape = (camera.height, camera.width) if self.wet_ground.apart else (0, 0)
        cover = np.empty(shape, np.float32)
        self.wet = self.wet_ground.lay(
            self._wet_picture(camera, None, timer, cover), cover, self.view, self._level_mirrored,
            self.gloss, self.notes,
        )  # fmt: skip
        timer.mark("film")
        self.water.look(self.wet)
        self.drop_light = self._drop_field(self.wet.turn, self.wet.lens, camera)
        self._camera = camera

    def _drop_field(self, turn, lens, camera):
        """Return the radiance of drops over a camera's picture."""
        return droplight.drop_field(
            self.gloss, self.everywhere, turn, lens, camera.width, camera.height
        )

    def _wet_picture(self, camera, plane, timer, film=NO_FILM, rasterizer=None):
        """Return the `View` of the wet capture that `camera` takes, cut at a plane or whole.

        `film`: see `grade.grade_and_wet`; `rasterizer`: of a part of the splats.
        """
        dry = (rasterizer or self.rasterizer).draw(camera, self.near, plane)
        timer.mark("splat" if plane is None else "mirror")
        view = self._wetted(dry, camera, film)
        timer.mark("grade and wet" if plane is None else "mirror")
        return view

    def _wetted(self, dry, camera, film=NO_FILM):
        """Return the `View` of splatted layers, graded and wet."""
        turn, eye = pose(self.frame.camera_in_ground(camera))
        lens = lens_of(camera)
        shape = (camera.height, camera.width)
        picture = np.empty((*shape, 3), np.float32)
        depth, clearance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        grade_and_wet(
            dry.color, dry.alpha, dry.depth, dry.plane_depth, dry.normal,
            np.float32(self.frame.meters_per_unit), turn, eye, lens, *self._shading, picture,
            depth, clearance, film,
        )  # fmt: skip
        return View(picture, depth, clearance, turn, eye, lens, picture)

    @property
    def _shading(self):
        """What the grading kernels take of terrain, light and look."""
        return (
            self.terrain.bed, self.ground, self._origin, self._spacing, self.gloss, self.behind,
            self.look, self.others,
        )  # fmt: skip

    def _level_mirrored(self, level):
        """Return the `View` of what stands on the ground, `level` (ground frame) mirrored there."""
        if self._standing is None:
            self._standing = self._rasterizer_of(
                in_level_picture(self.rasterizer.prepared, self.terrain, self.frame)
            )
        _, camera = mirrored_camera(self.frame.camera_in_capture(level), self.frame, 0.0)
        return self._wet_picture(camera, None, Timer(), NO_FILM, self._standing)

    def _mirrored(self, level, window, share, split=None):
        """Return what stands above the water as the camera mirrored at `level` [m] sees it.

        The lens of a `window` (left, top, right, bottom) of its picture, at a `share` of its
        resolution, and the picture as `mirrorlight.mirror_light` takes it, or, if it is to be split
        at a depth [m], as `layered.layered_light` does.
        """
        plane, camera = mirrored_camera(self._camera, self.frame, level)
        camera = cropped(camera, window)
        if share != 1:
            camera = camera.resized(round(camera.width * share), round(camera.height * share))
        if split is None:
            view = self._wet_picture(camera, plane, Timer())
            return view.lens, (view.picture, coarsened(view.picture), view.depth)
        unit = np.float32(self.frame.meters_per_unit)
        near, far = self.rasterizer.draw_apart(camera, self.near, split / unit, plane)
        view = self._wetted(far, camera)
        grade = grader(view.eye, unit, self._shading)
        return view.lens, layered(near, far, view, unit, self.look[5], grade)

    def _traced(self, origin, direction, before, pixel, color_eye=None):
        """Return the graded radiance, alpha and distance of rays, see `reflect.traced_light`."""
        if self._tracer is None:
            self._tracer = Tracer(self.scene.splats)
        unit, turn = self.frame.meters_per_unit, self.frame.rotation
        clear = np.append(self.frame.up, MIRROR_CLEARANCE / unit)
        found = self._tracer.trace(
            self.frame.to_capture(origin), direction @ turn, before / unit, pixel,
            FIRST_SEGMENT / unit, clear, color_eye,
        )  # fmt: skip
        light = np.empty_like(found.color)
        shade.grade_rays(
            found.color, found.alpha, found.distance * np.float32(unit),
            found.plane_distance * np.float32(unit),
            np.ascontiguousarray(found.normal @ turn.T, np.float32),
            (origin - before[:, None] * direction).astype(np.float32), direction,
            *self._shading, light,
        )  # fmt: skip
        return light, found.alpha, found.distance * np.float32(unit)

    def _drops(self, camera, state, timer, camera_end):
        """Return the alpha of streaks and of splash droplets."""
        rain = np.zeros((camera.height, camera.width), np.float32)
        splash = np.zeros_like(rain)
        config = self.now.render
        self.field = self.weather.field(state.time - LONGEST_LIFE, state.time + config.exposure)
        if self.field is None:
            return rain, splash
        where, lens = (self.field, self.surfaces, self.view), (camera_end, *self._focus)
        self.reach = streak_reach(self.field, self.view, config.exposure, config.streak_far)
        if config.streaks == "paper":
            paperrain.draw_lines(*where, state.time, config.streak_far, self.wet.depth, rain)
        else:
            draw_streaks(
                *where, state.time, config.exposure, self.wet.depth, self.reach, rain, *lens,
                more=drips_seen(state.drips, state.time, config.exposure),
            )  # fmt: skip
        timer.mark("streaks")
        if config.splashes == "paper":
            start = state.time - self.config.frame_interval
            paperrain.draw_gaussians(*where, start, state.time, self.wet.depth, splash)
        else:
            draw_splashes(
                *where, state.time, config.exposure, state.depth,
                WET_FILM * self.wetness, self.wet.depth, splash, *lens,
                more=drip_impacts(
                    state.drips, state.drip_id, self.surfaces, state.time - LONGEST_LIFE,
                    state.time + config.exposure,
                ),
            )  # fmt: skip
        timer.mark("splashes")
        return rain, splash

    def _fog(self):
        """Return the fog of drops that are not drawn; the paper has none."""
        if self.field is None or self.now.render.streaks == "paper":
            return NO_FOG
        return fog_table(self.field, self.reach)

    @property
    def _focus(self):
        return self.now.render.aperture, self.now.render.focus

    @property
    def _origin(self):
        return np.array(self.terrain.grid.origin, np.float32)

    @property
    def _spacing(self):
        return np.float32(self.terrain.grid.spacing)

    @property
    def _sun(self):
        if self.sun is None:
            return np.zeros(6, np.float32)
        azimuth, elevation = self.sun
        direction = (
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        )
        clear = SUN_IRRADIANCE * (1 - self.now.render.cloudiness)
        return np.array([*direction, clear, 0.95 * clear, 0.88 * clear], np.float32)

    def _find_sun(self):
        """Return the sun that is given, or that the sky has, or None."""
        sun = self.config.render.sun
        if sun != "sky":
            return sun
        found = sky.brightest(self.day)
        told = "nothing in the sky stands out as the sun: none is drawn"
        if found is not None:
            azimuth, elevation = (math.degrees(angle) for angle in found)
            told = f"the sun of the sky: azimuth {azimuth:.0f}, elevation {elevation:.0f} degrees"
        self.notes.append(told)
        return found

    def _captured_sky(self, position):
        """Return the sky that the capture shows from `position` [m], completed."""

        def draw(view):
            dry = self.rasterizer.draw(self.frame.camera_in_capture(view), self.near)
            far = dry.depth * self.frame.meters_per_unit > self.sky_distance
            linear = np.clip(dry.color, 0, 4) ** np.float32(2.2)
            seen = far & (dry.alpha > 0.9) & (linear.mean(axis=-1) > 0.15)
            return np.where(seen[..., None], linear, -1)

        found = sky.probe(draw, position)
        made, share = sky.completed(found, found[..., 0] >= 0)
        self.notes.append(
            f"the capture shows {share:.0%} of the sky; an overcast one stands for the rest"
        )
        return made * self.look[0]  # graded as the rest is

    def _surroundings(self, position):
        """Return the wet capture around `position` [m] with the sky of the day, as a map."""

        def draw(view):
            return self._wet_picture(self.frame.camera_in_capture(view), None, Timer()).picture

        return sky.probe(draw, position)


def pose(view):
    """Return ground_from_camera (3, 3) and the eye [m] of a ground-frame camera, float32."""
    turn = np.ascontiguousarray(view.camera_from_world[:3, :3].T, dtype=np.float32)
    return turn, view.position.astype(np.float32)


def lens_of(camera):
    """Return fx, fy, cx, cy [px], float32."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)


def day_sky(config):
    """Return the environment map of the sky that a render configuration names."""
    if config.sky in ("overcast", "capture"):
        return sky.clouded(sky.overcast())
    from rainsim import image

    return sky.from_panorama(image.read_hdr(config.sky))


def look(config):
    """Return the six numbers of a look that `grade.grade_and_wet` takes, for any scene.

    Those are exposure, desaturation, compression, share of replaced sky, its distance [m] and
    whether the scene's own sky is left out.
    """
    c = config.render.cloudiness
    replaced = 0.0 if config.render.sky == "capture" else c
    return np.array([1 - 0.3 * c, 0.2 * c, 1.2 * c, replaced, NEAREST_SKY, 0], np.float32)


def replaces_sky(config):
    """Tell whether the capture's sky gives way to another at any time."""
    return any(look(config.at(time))[3] > 0 for time in config.key_times())


class Timer:
    """Wall time of named stages in milliseconds."""

    def __init__(self):
        self.stages = {}
        self._last = clock.perf_counter()

    def mark(self, name):
        """Book the time since the last mark on `name`."""
        now = clock.perf_counter()
        self.stages[name] = self.stages.get(name, 0.0) + (now - self._last) * 1e3
        self._last = now


def render(scene, terrain, states, cameras, config, names=(), backend="cpu"):
    """Yield (picture, FrameReport) for each state and its camera.

    Parameters
    ----------
    scene : Scene
    terrain : Terrain
    states : iterable of SimState
        In the order of their frames.
    cameras : sequence of Camera
        One per frame of the whole sequence (the state's index picks), or one for all.
    config : Config
    names : sequence of str
        Layers that the reports are to hold, see `rainsim.layers`.
    backend : {"cpu", "cuda"}
        What draws. Pictures of "cuda" are overwritten by the next one.

    Yields
    ------
    picture : ndarray of shape (height, width, 3), uint8
    report : FrameReport
    """
    from rainsim.backends import on_backend  # which imports this module

    if not cameras:
        raise ParameterError("no camera was given; a frame needs one")
    scene = without_images(scene, terrain)
    renderer = on_backend(backend)[0](scene, terrain, config, cameras[0])
    path = [scene.ground_frame.camera_in_ground(camera) for camera in cameras]

    def shots():
        for state in states:
            camera = cameras[0] if len(cameras) == 1 else cameras[state.index]
            exposure = config.at(state.time).render.exposure
            yield camera, state, shutter_end(path, state.index, exposure, config.fps)

    yield from renderer.film(shots(), names)
