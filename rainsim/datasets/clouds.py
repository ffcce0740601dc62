"""Clouds of a lidar at the camera, as KITTI's benchmarks have them, with SemanticKITTI's classes.

All pulses are sent at the time of the picture: KITTI's clouds are corrected for the motion within a
turn, and so boxes, picture and points belong together.
"""

from dataclasses import replace

import numpy as np

from rainsim.datasets import kinds
from rainsim.drops import Weather
from rainsim.lod.held_parts import scene_in_reach
from rainsim.render.labels import GROUND_REACH, OTHER_CLASS
from rainsim.sensors.lidar import LidarScanner, Pose
from rainsim.sensors.lidar_model import KEPT, LOST, SENSORS
from rainsim.shading.calibration import albedo_of_white
from rainsim.shading.wetness import paving_dampness

AT_ONCE = 1e6  # turns/s: all pulses within a microsecond
MOVES = 0.5  # m/s, from which on an actor's class is the moving one
NODE = 1 << 16  # the upper half of a label is the number of the instance


class Clouds:
    """The clouds of one scene's views.

    user_labels : UserLabels, optional. Points on what stands have its ids, where
        it has any.
    """

    def __init__(self, scene, terrain, places, sensor, config, user_labels=None):
        self.user_labels = user_labels
        self.terrain, self.lidar = terrain, replace(SENSORS[sensor], rate=AT_ONCE)
        albedo, _ = albedo_of_white(terrain, scene, config.render.ground_albedo)
        near = scene_in_reach(scene, places, self.lidar.far, self.lidar.divergence)
        self._scanner, self._seed = LidarScanner(near, terrain, albedo), config.rain.seed

    def seen_from(self, position, turn, number, config, state, actors):
        """Return the points and their labels of a lidar at a position [m].

        turn : float64 array (3, 3). Its axes, x ahead, y left, z up.
        actors : sequence of dict. See
            `rainsim.render.actor_labels.facts_of_actors`.
        Returns points : float32 array (n, 4). In its axes [m], and reflectivity.
            labels : uint32 array (n,). SemanticKITTI's class, and in the upper
                half the number of the actor.
        """
        now, pose = config.at(state.time), Pose(position, turn, np.zeros(3))
        field = Weather(config).field(state.time, state.time + now.render.exposure)
        damp, rate = (0.0, 0) if field is None else (paving_dampness(now), field.spectrum.rate)
        rng = np.random.default_rng([self._seed, number, round(rate * 3.6e12)])
        scan = self._scanner.scan(self.lidar, pose, state.time, rng, field, state, damp)
        back = scan.label != LOST
        points = np.column_stack([scan.point, scan.reflectivity])[back].astype("<f4")
        place = pose.position + scan.point[back].astype(np.float64) @ turn.T
        labels = self._ground_class(place)
        if self.user_labels is not None:
            own = self.user_labels.of_points(place)
            labels = np.where(own != OTHER_CLASS, semantic_label(own), labels)
        labels[scan.label[back] != KEPT] = kinds.OUTLIER
        if scan.actor is not None:
            number = scan.actor[back].astype("<u4")
            for actor in actors:
                kind = kinds.kind_of(actor["class"])
                moves = np.linalg.norm(actor["box3d"]["velocity"]) > MOVES
                shown = (number == actor["number"]) & (scan.label[back] == KEPT)
                labels[shown] = kind.moving if moves else kind.semantic
            labels[number > 0] += NODE * number[number > 0]
        return points, labels

    def _ground_class(self, place):
        """Return the class of the ground that points (n, 3) [m] lie on, 0 for none, uint32."""
        terrain = self.terrain
        row, column, inside = terrain.grid.cells(place[:, 0], place[:, 1])
        near = inside & (np.abs(place[:, 2] - terrain.bed[row, column]) < GROUND_REACH)
        classes = kinds.SEMANTIC_TABLE[terrain.ground_class[row, column]]
        return np.where(near, classes, 0).astype("<u4")


def semantic_label(own):
    """Return SemanticKITTI's labels of the user's ids: class below, instance above, uint32."""
    own = own.astype("<u4")
    return np.where(
        own < kinds.PER_CLASS, own, kinds.class_of(own) + NODE * (own % kinds.PER_CLASS)
    ).astype("<u4")
