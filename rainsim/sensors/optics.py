"""What a camera has besides its pose: a lens, glass before it, a shutter that takes its time.

`Optics` says which, `Taking` draws a sequence's frames so. Splats are drawn by pinhole cameras,
sharp and at once: the shutter is the mean of several such pictures, glass and lens change that.
"""

from dataclasses import dataclass, replace

import numpy as np

from rainsim.actors.motion import moves_between
from rainsim.config.rules import require_whole
from rainsim.errors import ParameterError
from rainsim.io.exr import half_or_float
from rainsim.numerics import srgb
from rainsim.render.aov import AOVS, PICTURE, SHARE
from rainsim.render.exr_frame import light_parts_of
from rainsim.render.labels import boxes_of
from rainsim.render.shutter import motion_of
from rainsim.scene.view import slopes
from rainsim.sensors.glass import Pane, caps_on, pane_window, through_glass, wide_camera
from rainsim.sensors.lens import Lens, lens_warp
from rainsim.sensors.rolling import Motion, boxed, check_readout, check_rows, draw_rolling
from rainsim.shading.composite import encode

MOST_SAMPLES = 256
LIGHT, FLOWS = "display white", ("flow", "flow_mask", "drop_flow")
KEYS = {  # in a transforms.json
    "opencv": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4"),
    "division": ("k",), "eucm": ("alpha", "beta"),
}  # fmt: skip


@dataclass(frozen=True)
class Optics:
    """Lens, glass and shutter of the cameras of a sequence.

    Attributes
    ----------
    lens : Lens or None
        None is a pinhole.
    pane : Pane or None
        Glass with drops before it; in frames alone, not in layers.
    readout : float [s]
        Of a rolling shutter from the first row to the last; 0: all rows at once.
    samples : int
        Pictures over the exposure whose mean a frame is, where the camera or anything else moves;
        1: the scene is drawn sharp, as the shutter opens, and the rain alone is blurred.

    Raises
    ------
    ParameterError
        If a number breaks its rule.

    Examples
    --------
    >>> lens = rainsim.Lens("opencv", (-0.1, 0.01, 0.0, 0.0))
    >>> optics = rainsim.Optics(lens, rainsim.Pane(age=20.0, speed=10.0), samples=2)
    >>> path = scene.cameras[:1]
    >>> next(rainsim.render_rain(scene, path, config, optics=optics))[0].shape
    (48, 64, 3)
    """

    lens: Lens | None = None
    pane: Pane | None = None
    readout: float = 0.0
    samples: int = 1

    def __post_init__(self):
        require_whole("number of shutter samples", self.samples, 1, MOST_SAMPLES)
        check_readout(self.readout)

    @property
    def facts(self):
        """What frames depend on, as plain JSON values; the lens as a transforms.json has it."""
        pane = self.pane and {"age_s": self.pane.age, "speed_m_per_s": self.pane.speed,
                              "wiper_s": self.pane.wiper}  # fmt: skip
        return {"lens": lens_keys(self.lens), "glass": pane, "rolling_s": self.readout,
                "shutter_samples": self.samples}  # fmt: skip

    def check(self, backend, names, exr, config):
        """Raise ParameterError if the backend, some layer or an OpenEXR file cannot be had."""
        if backend == "cuda":
            check_rows(self.readout, config)
        if self.readout and exr is not None:
            raise ParameterError(
                "--rolling has no OpenEXR files: its rows have light and motion of their own; "
                "leave out --exr or --rolling"
            )
        flows = [name for name in names if name in FLOWS]
        if self.readout and flows:
            raise ParameterError(
                f"--rolling has no layer {flows[0]}: its rows are of different times; leave it out "
                "of --layers"
            )

    def drawn(self, camera):
        """Return the pinhole camera that is drawn for a camera; ParameterError if none can be."""
        if self.lens is not None:
            camera = lens_warp(camera, self.lens).wide
        if self.pane is not None:
            pane_window(camera, self.pane)
        return camera

    def taking(self, cameras, scene, config, names, backend="cpu", exr=None):
        """Return the `Taking` of a sequence; its arguments without the optics."""
        return Taking(self, cameras, scene, config, names, backend, exr)


def lens_keys(lens):
    """Return model and coefficients of a `Lens` by their keys in a transforms.json; None: {}."""
    if lens is None:
        return {}
    named = dict(zip(KEYS[lens.model], lens.values, strict=False))
    model = "OPENCV_FISHEYE" if lens.model == "fisheye" else lens.model.upper()
    return {"camera_model": model, **named}


class Warps:
    """The `LensWarp`s of cameras, kept for cameras of one size and lens."""

    def __init__(self):
        self._kept = {}

    def of(self, camera, lens):
        """Return the warp of a camera with a lens, None for a pinhole."""
        if lens is None:
            return None
        size = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, lens
        if size not in self._kept:
            self._kept[size] = lens_warp(camera, lens)
        return self._kept[size]

    def drawn(self, camera, lens):
        """Return the pinhole camera that is drawn for a camera."""
        warp = self.of(camera, lens)
        if warp is None:
            return camera
        return replace(warp.wide, camera_from_world=camera.camera_from_world)


class Taking:
    """The frames of a sequence as its optics take them.

    cameras : sequence of Camera. As `FrameSequence` takes them.
    """

    def __init__(self, optics, cameras, scene, config, names, backend="cpu", exr=None):
        self.optics, self._cameras, self._names = optics, list(cameras), tuple(names)
        self._exr, self._config, self._actors = exr, config, scene.actors
        optics.check(backend, names, exr, config)
        self._warps, seen = Warps(), {}
        for camera in self._cameras:  # of each kind one is tried
            own = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
            seen.setdefault(own, camera)
        for camera in seen.values():
            optics.drawn(camera)
        self.drawn = [self._warps.drawn(camera, optics.lens) for camera in self._cameras]
        self._path = [scene.ground_frame.camera_in_ground(camera) for camera in self.drawn]

    def film(self, renderer, shots):
        """Yield picture and report for each (camera, state, camera_end), as `Renderer.film` does.

        The pictures' cameras are those that `drawn` has.
        """
        for camera, state, camera_end in shots:
            index = 0 if len(self._path) == 1 else state.index
            motion = Motion(*motion_of(self._path, index, self._config.fps))
            exposure = self._config.at(state.time).render.exposure
            moves = not motion.is_still or moves_between(
                self._actors, state.time, state.time + exposure
            )
            shot = renderer, camera, self._path[index], state, camera_end, motion
            if self.optics.samples > 1 and moves:
                picture, report = self._sampled(exposure, *shot)
            else:
                picture, report = self._picture(*shot, self._names)
                if self._exr is not None:
                    report = replace(report, parts=light_parts_of(report, self._exr.colorspace))
            if self.optics.pane is not None:
                pane, here = self.optics.pane, self._path[index]
                picture, _, _, count = behind_glass(renderer, here, state, pane, picture)
                report = replace(report, facts={**report.facts, "drops_on_glass": count})
            warp = self._warps.of(self._cameras[index], self.optics.lens)
            yield (picture, report) if warp is None else warped_frame(warp, picture, report)

    def _picture(self, renderer, camera, here, state, camera_end, motion, names):
        """Return one picture and its report."""
        if not self.optics.readout:
            return renderer.draw(camera, state, camera_end, names)
        own = self._cameras[0 if len(self._path) == 1 else state.index]
        sensor = {"first_row": own.cy - here.cy, "height": own.height}
        return draw_rolling(renderer, here, state, motion, self.optics.readout, names, **sensor)

    def _sampled(self, exposure, renderer, camera, here, state, camera_end, motion):
        """Return the mean over the exposure [s], in linear light, and the report of its middle.

        The scene of each picture is that of the middle of its share of the exposure. Its rain is
        drawn over a share of the exposure, too, from there to the next picture's: streaks of all of
        them in a row are as long as one over the whole, and nothing is blurred twice.
        """
        count, conductor = self.optics.samples, renderer.conductor
        whole, share = conductor.config, exposure / self.optics.samples
        frame = conductor.wet_scene.frame
        light = [name for name in self._names if is_mean(name)]
        light = tuple(dict.fromkeys(("beauty", *light)))
        total, stages, parts = {}, {}, None

        def add(key, values):
            total[key] = total.get(key, 0.0) + values.astype(np.float64)

        def take(after, names):
            begin, end = motion.at(here, after), None
            if not motion.is_still:
                end = motion.at(here, after + share)
            at = state.shown_at(state.time + after)
            placed = camera if begin is here else frame.camera_in_capture(begin)
            found = self._picture(renderer, placed, begin, at, end, motion, names)
            for stage, time in found[1].milliseconds.items():
                stages[stage] = stages.get(stage, 0.0) + time
            return found[1]

        conductor.take_settings(whole.replace(exposure=share, reach_exposure=exposure))
        try:
            for k in range(count):
                report = take((k + 0.5) * share, light)
                if self._exr is not None:
                    parts = light_parts_of(report, self._exr.colorspace)
                    for part, channels in parts.items():
                        for name, values in channels.items():
                            add((part, name), values)
                for name in light:
                    add(name, linear_of(name, report.aovs[name]))
            if not all(is_mean(name) for name in self._names):  # others are of one time
                report = take(exposure / 2, self._names)
        finally:
            conductor.take_settings(whole)
        means = {key: values * (1 / count) for key, values in total.items()}
        picture = np.empty(means["beauty"].shape, np.uint8)
        encode(means["beauty"].astype(np.float32).ravel(), picture.ravel())
        aovs = {name: report.aovs[name] for name in self._names if name not in means}
        aovs |= {name: stored(name, means[name]) for name in self._names if name in means}
        facts = dict(report.facts)
        if "weather" in facts:
            facts["weather"] = {**facts["weather"], "exposure_s": exposure}
        parts = parts and {
            part: {name: half_or_float(means[part, name]) for name in channels}
            for part, channels in parts.items()
        }
        return picture, replace(
            report, time=state.time, milliseconds=stages, facts=facts, parts=parts,
            aovs={name: aovs[name] for name in self._names},
        )  # fmt: skip


def is_mean(name):
    """Tell whether a layer holds light or a share of it, of which a mean over time makes sense."""
    return AOVS[name].kind in (PICTURE, SHARE) or AOVS[name].unit == LIGHT


def linear_of(name, values):
    """Return a layer in linear light, or as it is."""
    return srgb.linear(values / 255) if AOVS[name].kind == PICTURE else values


def stored(name, values):
    """Return the mean of `linear_of` as the layer holds it."""
    if AOVS[name].kind == PICTURE:
        return np.rint(np.clip(srgb.display(values), 0, 1) * 255).astype(np.uint8)
    return values.astype(np.float32)


def behind_glass(renderer, camera, state, pane, picture, clear_air=None, seed=0):
    """Return pinhole pictures behind the wet glass, the share of drops, and their number.

    The drops are in the pinhole pictures, so that a lens distorts them as all else. `camera` is in
    the ground frame, `pane` as it was at time 0, `seed` is added to that of the rain; the second
    picture, in clear air, may be None.
    """
    conductor = renderer.conductor
    wide = conductor.wet_scene.frame.camera_in_capture(wide_camera(camera))
    names = ("drawn_depth",) if clear_air is None else ("drawn_depth", "clear_air")
    picture = np.array(picture)
    seen, report = renderer.draw(wide, state, None, names)
    seen, depth, config = np.array(seen), report.aovs["drawn_depth"], conductor.config
    end = state.time + config.at(state.time).render.exposure
    field = conductor.weather.field(state.time, end)
    if field is None:
        return picture, clear_air, np.zeros(picture.shape[:2], np.float32), 0
    pane = replace(pane, age=pane.age + state.time)
    caps = caps_on(field, pane, camera, config.rain.seed + seed)
    picture, share = through_glass(picture, camera, caps, pane, seen, depth)
    if clear_air is not None:
        beyond = np.array(report.aovs["clear_air"])
        clear_air, _ = through_glass(clear_air, camera, caps, pane, beyond, depth)
    return picture, clear_air, share, len(caps.radius)


# --- lenses ---------------------------------------------------------------------------------------


def warped_frame(warp, picture, report):
    """Return picture and report as a lens shows them."""
    aovs = warped_layers(warp, report.aovs)
    parts = report.parts and {
        part: {name: half_or_float(warp.light(values[..., None].astype(np.float32))[..., 0])
               for name, values in channels.items()}
        for part, channels in report.parts.items()
    }  # fmt: skip
    facts = warped_facts(report.facts, aovs)
    return warp.colors(picture), replace(report, aovs=aovs, parts=parts, facts=facts)


def warped_layers(warp, layers):
    """Return layers as a lens shows them: light interpolated, all else of the nearest pixel.

    Range is of the pixel's own ray; the nearest pixel's differs by up to half a pixel's angle.
    """
    found = {}
    for name, values in layers.items():
        if AOVS[name].kind == PICTURE:
            found[name] = warp.colors(values)
        elif AOVS[name].unit == LIGHT:
            found[name] = warp.light(values).astype(np.float32)
        else:
            found[name] = warp.nearest(values)
    if "range" in layers and "depth" in layers:
        x, y = slopes(warp.wide, warp.u, warp.v)
        found["range"] = (found["depth"] * np.sqrt(1 + x * x + y * y)).astype(np.float32)
    if "flow" in layers and "flow_mask" in layers:
        found["flow"], found["flow_mask"] = warp.flow(layers["flow"], layers["flow_mask"])
    return found


def warped_facts(facts, found):
    """Return a frame's facts with the boxes of the warped layers `found`."""
    facts = facts | boxed(found, [facts])
    if "actor_id" in found:
        seen = {box["id"]: box for box in boxes_of(found["actor_id"])}
        facts["actors"] = [
            {**actor, "box2d": None, "box2d_seen": None, "pixels": 0}
            | ({"box2d_seen": mine["box"], "pixels": mine["pixels"]} if mine else {})
            for actor in facts.get("actors", ())
            for mine in (seen.get(actor["number"]),)
        ]
    return facts
