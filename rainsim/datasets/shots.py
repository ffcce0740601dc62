"""Draws the samples of a data set: one rain after another, camera by camera."""

from dataclasses import replace

import numpy as np

from rainsim.backend import on_backend
from rainsim.config.settings import mm_per_hour
from rainsim.datasets.clouds import Clouds
from rainsim.datasets.sample import REPLACED, Sample, keep_mask
from rainsim.pipeline import FrameSequence, simulate
from rainsim.raster import Rasterizer, prepare
from rainsim.render.shutter import motion_of
from rainsim.sensors.glass import wide_camera
from rainsim.sensors.optics import Warps, behind_glass, warped_facts, warped_layers
from rainsim.sensors.rig import CAMERA_FROM_LIDAR
from rainsim.sensors.rolling import STILL, Motion, draw_rolling
from rainsim.terrain.pond import without_images

LABELS = ("depth", "range", "class_id", "puddle_id", "splash_id", "rain_alpha", "splash_alpha",
          "wetness")  # fmt: skip
FLOWS, ACTORS = ("flow", "flow_mask"), "actor_id"
NEAR = 0.05  # m
CLEAR, CLEAR_AIR = "clean", "clear_air"


def by_number(states):
    """Return a function of a number that returns the first state from the last one on with it."""
    state = None

    def of(number):
        nonlocal state
        while state is None or state.index < number:
            state = next(states)
        return state

    return of


class Shots:
    """The samples of one scene.

    The settings' rain rate is replaced by that of each sample. Views of a `sequence` follow one
    another in time, at the rate of frames of the settings; else all see the same moment, the first.
    A `pane` is glass before the lens, with drops of its own in each rain and view; in a sequence it
    is one pane, which has been rained on for longer from view to view. `readout` [s] of a rolling
    shutter goes from the first row to the last; 0: all rows at once. There is no flow with one.
    With `partners` rainy pictures have `Sample.partners`. With a `lidar`, a key of
    `lidar_model.SENSORS`, samples have `Sample.cloud`. A `rig_shots.Clock` says when the views of a
    rig's camera are. Actors have the share of them that others hide.
    """

    def __init__(self, scene, terrain, views, config, sequence, backend="cpu", user_labels=None,
                 readout=0.0, pane=None, partners=False, lidar=None, clock=None):  # fmt: skip
        self.scene, self.terrain, self.views = scene, terrain, views
        self.config, self.sequence, self.backend = config, sequence, backend
        self.user_labels, self.readout, self.pane = user_labels, readout, pane
        self.partners = partners
        self._clock, self._clouds = clock, None
        if lidar is not None:
            places = [view.camera.position for view in views]
            self._clouds = Clouds(scene, terrain, places, lidar, config, user_labels)
        self._wide = None  # what drops on the glass show: rate, renderer
        self._water = None  # rate, and what returns its states
        self._warps = Warps()
        self.labels = (*LABELS, *((ACTORS,) if scene.actors else ()))

    def draw(self, rate, indices):
        """Yield the `Sample`s of the views `indices` at a rain rate [mm/h]."""
        indices = list(indices)
        if not indices:
            return
        config = self.config_of(rate)
        names = (*self.labels, *(FLOWS if self.sequence and not self.readout else ()),
                 *((CLEAR,) if rate == 0 else (CLEAR, CLEAR_AIR) if self.partners else ()),
                 )  # fmt: skip
        drawn = self._in_sequence if self.sequence else self._at_one_moment
        drawn = self._rolling if self.readout else drawn
        for index, (picture, report) in zip(indices, drawn(config, indices, names), strict=True):
            picture = report.aovs[CLEAR] if rate == 0 else picture
            view, glass, partners = self.views[index], None, {}
            if self.partners and rate > 0:
                partners = {CLEAR_AIR: report.aovs[CLEAR_AIR], "dry": report.aovs[CLEAR]}
            if self.pane is not None and rate > 0:
                if self.partners:
                    partners["no_glass"] = np.array(picture)
                picture, clear_air, glass, count = self._behind_glass(
                    view, picture, partners.get(CLEAR_AIR), rate, config
                )
                if self.partners:
                    partners[CLEAR_AIR] = clear_air
                report = replace(report, facts={**report.facts, "drops_on_glass": count})
            yield self._sample(view, rate, picture, report, glass, partners)

    def config_of(self, rate):
        """Return the settings of a rain rate [mm/h]; for 0 those of a dry day: no water at all."""
        config = self.config.replace(frames=len(self.views) if self.sequence else 1)
        if rate > 0:
            return config.replace(rate=mm_per_hour(rate)).check()
        return config.replace(rate=0.0, past=0.0, level=None).check()

    def drawn_camera(self, view):
        """Return the pinhole camera that is drawn for a view, in the capture frame."""
        camera = self._warps.drawn(view.camera, view.lens)
        return self.scene.ground_frame.camera_in_capture(camera)

    def _at_one_moment(self, config, indices, names):
        state = next(simulate(self.terrain, config))
        cameras = [self.drawn_camera(self.views[index]) for index in indices]
        renderer = self._renderer(config, self.drawn_camera(self.views[0]))
        yield from renderer.film(((camera, state, None) for camera in cameras), names)

    def _renderer(self, config, camera):
        """Return a renderer, whose surroundings are drawn from a camera's place."""
        scene = without_images(self.scene, self.terrain)
        return on_backend(self.backend)[0](scene, self.terrain, config, camera)

    def _in_sequence(self, config, indices, names):
        cameras = [self.drawn_camera(view) for view in self.views]
        water = None if self._clock is None else self._states(config)
        sequence = FrameSequence(
            self.scene, self.terrain, cameras, config, self.backend, names, water
        )
        yield from sequence.frames(indices)

    def _states(self, config):
        """Return a function of a view's number that returns the water's state at its time."""
        if self._clock is None:
            return by_number(simulate(self.terrain, config))
        return by_number(self._clock.states(self.terrain, config))

    def _rolling(self, config, indices, names):
        """Yield pictures and reports of a rolling shutter, see `rainsim.sensors.rolling`."""
        frame = self.scene.ground_frame
        path = [frame.camera_in_ground(self.drawn_camera(view)) for view in self.views]
        renderer = self._renderer(config, frame.camera_in_capture(path[0]))
        state_of = self._states(config)
        for index in indices:
            motion, state = STILL, state_of(index if self.sequence else 0)
            if self.sequence:
                motion = Motion(*motion_of(path, index, config.fps))
            own = self.views[index].camera
            sensor = {"first_row": own.cy - path[index].cy, "height": own.height}
            yield draw_rolling(renderer, path[index], state, motion, self.readout, names, **sensor)

    def _behind_glass(self, view, picture, clear_air, rate, config):
        """Return what `behind_glass` does for a view."""
        frame = self.scene.ground_frame
        camera = frame.camera_in_ground(self.drawn_camera(view))
        wide = frame.camera_in_capture(wide_camera(camera))
        if self._wide is None or self._wide[0] != rate:
            self._wide = rate, self._renderer(config, wide)
        state = self._state_of(view, rate, config)
        seed = 0 if self.sequence else 7919 * view.index  # a pane of its own at one moment
        return behind_glass(self._wide[1], camera, state, self.pane, picture, clear_air, seed)

    def _state_of(self, view, rate, config):
        """Return the water's state at the time of a view; views come in their order."""
        if self._water is None or self._water[0] != rate:
            self._water = rate, self._states(config)
        return self._water[1](view.index if self.sequence else 0)

    def _cloud(self, view, rate, actors):
        """Return points and labels of the lidar's view."""
        config, camera = self.config_of(rate), view.camera
        turn = camera.camera_from_world[:3, :3].T @ CAMERA_FROM_LIDAR
        state = self._state_of(view, rate, config)
        return self._clouds.seen_from(camera.position, turn, view.index, config, state, actors)

    def _with_hidden(self, actors, camera, time):
        """Return the labels of actors with the share of each that others hide, as `hidden`."""
        near, found = NEAR / self.scene.ground_frame.meters_per_unit, []
        for entry in actors:
            actor = self.scene.actors[entry["number"] - 1]
            pose, hidden = actor.track.at(time), None
            if entry["pixels"] and pose is not None:
                alone = Rasterizer(prepare(actor.placed(pose, time)))
                whole = int((alone.draw(camera, near, hit=True).hit >= 0).sum())
                hidden = round(max(0.0, 1 - entry["pixels"] / max(whole, 1)), 4)
            found.append({**entry, "hidden": hidden})
        return found

    def _sample(self, view, rate, picture, report, glass, partners):
        """Return the `Sample` of a frame, warped to its lens."""
        found, warp = report.aovs, self._warps.of(view.camera, view.lens)
        labels, cloud, facts = None, None, report.facts
        actors = facts.get("actors", ())
        if actors:
            shown = self._with_hidden(actors, self.drawn_camera(view), report.time)
            facts = {**facts, "actors": shown}
        if self._clouds is not None:
            cloud = self._cloud(view, rate, actors)
        if self.user_labels is not None:
            labels = self.user_labels.picture(self.drawn_camera(view), found.get(ACTORS))
        flow, mask = found.get("flow"), found.get("flow_mask")
        if warp is not None:
            kinds = () if flow is None else FLOWS
            picture = warp.colors(picture)
            partners = {kind: warp.colors(other) for kind, other in partners.items()}
            found = warped_layers(warp, {name: found[name] for name in (*self.labels, *kinds)})
            flow, mask = found.get("flow"), found.get("flow_mask")
            facts = warped_facts(facts, found)
            labels = None if labels is None else warp.nearest(labels)
            glass = None if glass is None else warp.nearest(glass)
        keep = np.ones(picture.shape[:2], bool)
        if rate > 0:
            keep = keep_mask(found["rain_alpha"], found["splash_alpha"], found["class_id"])
        if glass is not None:
            keep &= glass < REPLACED
        return Sample(
            view, rate, np.array(picture), found["depth"], found["range"], found["class_id"],
            found["puddle_id"], found["splash_id"], keep, flow, mask, labels, glass,
            cloud=cloud, facts=facts, actor_id=found.get(ACTORS), wetness=found["wetness"],
            partners={kind: np.array(other) for kind, other in partners.items()},
        )  # fmt: skip
