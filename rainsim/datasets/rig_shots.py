"""Draws the samples of a rig: each sensor at its own times, in one rain over the same water."""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from rainsim.actors.motion import Motion
from rainsim.datasets import ONE_LENS, RIGGED, SCANNED
from rainsim.datasets.clouds import Clouds
from rainsim.datasets.sample import Cloud, Turn, View
from rainsim.datasets.shots import Shots, by_number
from rainsim.errors import ParameterError
from rainsim.pipeline import simulate
from rainsim.render.actor_labels import box_in_space

NUMBERED = "kitti", *SCANNED  # layouts in which a number is one time of all sensors
KITTI_CAMERAS = 4


@dataclass(frozen=True)
class Clock:
    """Times of a sensor as steps of the rig's water: the first at `start`, each `stride` later."""

    step: Fraction  # s
    start: int
    stride: int

    def states(self, terrain, config):
        """Yield the water's states at the sensor's times; all sensors of a rig have one step."""
        steps = simulate(terrain, config.replace(fps=float(1 / self.step)))
        for state in steps:
            number, off = divmod(state.index - self.start, self.stride)
            if number >= 0 and off == 0:
                yield state.shown_by(number)


def clock_of(sensor, step):
    """Return the `Clock` of a sensor for the step [s] of its rig."""
    return Clock(step, int(sensor.offset / step), int(1 / sensor.rate / step))


def check_rig(rig, layout):
    """Raise ParameterError unless a layout can hold a rig."""
    if layout not in RIGGED:
        raise ParameterError(
            f"layout is {layout}; with --rig it must be one of {', '.join(RIGGED)}; give one"
        )
    if layout in NUMBERED:
        rates = {sensor.rate for sensor in rig.sensors}
        if len(rates) > 1 or len(rig.cameras) > KITTI_CAMERAS:
            found = ", ".join(f"{float(rate):g}" for rate in sorted(rates))
            raise ParameterError(
                f"the rig has {len(rig.cameras)} cameras, and rates of {found}/s; in the layout "
                f"{layout}, which has one number for all sensors, there must be one rate and at "
                f"most {KITTI_CAMERAS} cameras; take nerfstudio or colmap, or change the rig"
            )
    kinds = {sensor.lens is not None and sensor.lens.model == "fisheye" for sensor in rig.cameras}
    if layout == ONE_LENS and len(kinds) > 1:
        raise ParameterError(
            f"the rig has fisheyes and other lenses; {layout} has one camera model for all views; "
            "it must be one; take colmap, or two rigs"
        )


def rig_views(rig, path, fps, layout=None):
    """Return the views and the `Turn`s of a rig that follows a path.

    `path` are cameras in the ground frame, one every 1/`fps` seconds. A camera's pictures follow
    one another, then come the next camera's. In a layout with one number for all sensors each has
    as many as the one with the fewest, so that no number lacks a picture or a cloud.
    """
    seconds = len(path) / Fraction(fps).limit_denominator(1000)
    views, turns = [], []
    fewest = min(sensor.count(seconds) for sensor in rig.sensors)
    for sensor in (*rig.cameras, *rig.lidars):
        for frame in range(fewest if layout in NUMBERED else sensor.count(seconds)):
            time = sensor.time(frame)
            place = rig.place(path, fps, float(time)) @ sensor.vehicle_from_sensor
            name, index = f"{sensor.name}_{frame:06d}", len(views) + len(turns)
            if sensor.is_camera:
                camera = replace(sensor.camera.posed(np.linalg.inv(place)), name=name)
                step = min(int(float(time) * fps + 1e-9), len(path) - 1)
                views.append(View(index, name, camera, sensor.lens, False, sensor, frame,
                                  float(time), step))  # fmt: skip
            else:
                turns.append(Turn(index, name, sensor, frame, float(time), place))
    for sensor in rig.sensors:
        if not sensor.count(seconds):
            raise ParameterError(
                f"the rig's {sensor.name} begins at {float(sensor.offset):g} s, and the path ends "
                f"after {float(seconds):g} s; it must begin before; give more views, or correct "
                "the rig"
            )
    return tuple(views), tuple(turns)


def offset_notes(rig, layout):
    """Return a warning, in a list, if one number of a layout holds sensors of different times."""
    late = sorted(float(sensor.offset) * 1e3 for sensor in rig.sensors)
    if layout not in NUMBERED or late[0] == late[-1]:
        return []
    return [
        f"WARNING: the rig's sensors begin {late[0]:g} to {late[-1]:g} ms after the path's "
        f"cameras; a number of {layout} is that of all, and calib is right for one time alone: "
        "rainsim/NAME.json has each one's own place; give equal offsets, or read that"
    ]


class RigShots:
    """The samples of a rig's cameras and the clouds of its lidars, see `Shots`."""

    def __init__(self, scene, terrain, plan, config, backend="cpu", user_labels=None,
                 partners=False):  # fmt: skip
        self.scene, self.terrain, self.plan, self.config = scene, terrain, plan, config
        step = plan.rig.step()
        self._cameras, self._lidars = [], []
        for sensor in plan.rig.cameras:
            views = [view for view in plan.views if view.mount is sensor]
            own = [replace(view, index=number) for number, view in enumerate(views)]
            shots = Shots(
                scene, terrain, own, config.replace(fps=float(sensor.rate)), True, backend,
                user_labels, sensor.readout, None, partners, None, clock_of(sensor, step),
            )  # fmt: skip
            self._cameras.append((views, shots))
        self.config_of, self.drawn_camera = shots.config_of, shots.drawn_camera
        for sensor in plan.rig.lidars:
            turns = [turn for turn in plan.turns if turn.mount is sensor]
            places = [turn.ground_from_sensor[:3, 3] for turn in turns]
            clouds = Clouds(scene, terrain, places, sensor.lidar, config, user_labels)
            self._lidars.append((turns, clouds, clock_of(sensor, step)))

    def draw(self, rate, indices):
        """Yield a `Sample` or a `Cloud` for each of the plan's parts `indices` at a rate [mm/h]."""
        wanted = set(indices)
        for views, shots in self._cameras:
            mine = [number for number, view in enumerate(views) if view.index in wanted]
            for number, sample in zip(mine, shots.draw(rate, mine), strict=True):
                yield replace(sample, view=views[number])
        for turns, clouds, clock in self._lidars:
            mine = [turn for turn in turns if turn.index in wanted]
            if mine:
                yield from self._clouds(rate, mine, clouds, clock)

    def _clouds(self, rate, turns, clouds, clock):
        config = self.config_of(rate)
        state_of = by_number(clock.states(self.terrain, config))
        for turn in turns:
            place, actors = turn.ground_from_sensor, self._actors(turn)
            yield Cloud(turn, rate, clouds.seen_from(
                place[:3, 3], place[:3, :3], turn.index, config, state_of(turn.frame), actors
            ))  # fmt: skip

    def _actors(self, turn):
        """Return number, class and box of each actor that is there at the time of a turn."""
        found, interval = [], 1 / float(turn.mount.rate)
        for number, actor in enumerate(self.scene.actors, start=1):
            box = box_in_space(Motion(actor, self.scene.ground_frame), turn.time, interval)
            if box is not None:
                found.append({"number": number, "class": actor.kind, "box3d": box})
        return found
