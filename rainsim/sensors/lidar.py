"""A lidar in the rain that the cameras see: beams through the splats, and the very same drops.

Each beam is traced through the splats (`rainsim.sensors.ray_traced`), water mirrors or dims it,
and each drop of the field that is in the beam when the pulse passes may echo louder than what
stands behind. What the rain between takes away is its mean extinction, as in LISA. Actors that move
are where they are as each pulse passes.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from rainsim.rain.moving_surfaces import MovingSurfaces
from rainsim.sensors import lidar_model
from rainsim.sensors.actor_targets import ActorTarget
from rainsim.sensors.lidar_model import PASSED
from rainsim.sensors.near_drops import near_drops
from rainsim.sensors.ray_traced import Tracer
from rainsim.shading.color import LUMA, roughly_linear
from rainsim.shading.surface_point import FLAT
from rainsim.shading.wetting import wet_ratio
from rainsim.water.puddles import WET

SOLID = 0.5  # alpha from which a beam has met a surface
FIRST_SEGMENT = 1.0  # m of a beam that are searched at first
COLOR_DEGREE = 4  # see `roughly_linear`
ON_GROUND = 0.3  # m from the bed: a level surface that is farther is no ground
LEAST_COSINE = 0.05  # that Lambert's law is taken at
LIFT = 0.01  # m above the water, where a mirrored beam begins
FARTHEST = 1e4  # m, for what a mirrored beam never meets
STEPS = 6  # of the search for the time at which the sensor looks at a drop


@dataclass(frozen=True)
class Pose:
    """Where a lidar stands at the begin of a turn, in the ground frame."""

    position: np.ndarray  # m
    rotation: np.ndarray  # ground_from_sensor; x ahead, y left, z up
    velocity: np.ndarray  # m/s


@dataclass(frozen=True)
class Scan:
    """A turn of a lidar, arrays (n, ...) with a row for each beam.

    Distance and target are what comes back where there are no drops.
    """

    point: np.ndarray  # (n, 3), float32, m, sensor frame; 0 where no echo came back
    reflectivity: np.ndarray  # float32, 0 to 1, extinction included, as the sensor reports it
    label: np.ndarray  # uint8, LOST, SCATTERED, KEPT or MIRRORED
    time: np.ndarray  # float32, s, since the turn began
    distance: np.ndarray  # float64, m, of what the beam meets, infinite for nothing
    target: np.ndarray  # float64, its reflectivity, wet as it is
    actor: np.ndarray | None = None  # uint16, as the layer `actor_id`; None without actors


@dataclass(frozen=True)
class Surface:
    """Hits of beams in clear air, arrays (n, ...): distance [m], place, normal, reflectivity.

    `actor` is as in `Scan`.
    """

    distance: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    reflectivity: np.ndarray
    actor: np.ndarray | None = None


class LidarScanner:
    """Scans one scene.

    `albedo` is that of a captured linear colour of 1, see `calibration.albedo_of_white`; colours
    stand for reflectivities at the laser's wavelength, which the capture does not know.
    """

    def __init__(self, scene, terrain, albedo):
        self.frame, self.terrain, self.albedo = scene.ground_frame, terrain, albedo
        # What a surface reflects is its own: colours without their change with the direction.
        base = np.ascontiguousarray(scene.splats.sh[:, :1])
        self._moving, self._tracer = MovingSurfaces(terrain), Tracer(replace(scene.splats, sh=base))
        self._actors = [ActorTarget(actor) for actor in scene.actors]

    def surfaces_at(self, time):
        """Return the `Surfaces` that shelter from the rain at a time [s]."""
        return self._moving.at(time)

    def trace(self, origin, direction, before=0.0, time=0.0):
        """Return the `Surface` that rays meet; `before` [m] is the way to their origins."""
        frame, unit = self.frame, self.frame.meters_per_unit
        way_before = np.full(len(origin), before, np.float64) / unit
        place, toward = frame.to_capture(origin), direction @ frame.rotation
        found = self._tracer.trace(
            place.astype(np.float32), toward.astype(np.float32), way_before,
            segment=FIRST_SEGMENT / unit, stop=PASSED,
        )  # fmt: skip
        met = found.alpha >= SOLID
        distance = np.where(met, found.plane_distance.astype(np.float64) * unit, np.inf)
        actor = np.zeros(len(origin), np.uint16) if self._actors else None
        sent = np.full(len(origin), time, np.float64)
        for number, target in enumerate(self._actors, start=1):
            own = target.meet(place, toward, way_before, sent, FIRST_SEGMENT / unit)
            away = own.distance.astype(np.float64) * unit
            first = (own.alpha >= SOLID) & (away < distance[own.beam])
            beam = own.beam[first]
            met[beam], distance[beam], actor[beam] = True, away[first], number
            found.color[beam], found.alpha[beam] = own.color[first], own.alpha[first]
            found.normal[beam] = own.normal[first]
        way = np.where(met, distance - before, 0.0)
        color = roughly_linear(found.color / np.maximum(found.alpha, 1e-3)[:, None], COLOR_DEGREE)
        normal = found.normal @ frame.rotation.T
        cosine = np.abs(np.einsum("ni,ni->n", normal, direction))
        return Surface(
            distance, origin + way[:, None] * direction, normal,
            np.clip(self.albedo * color @ LUMA, 0, 1) * np.maximum(cosine, LEAST_COSINE), actor,
        )  # fmt: skip

    def scan(self, lidar, pose, time, rng, field=None, state=None, damp=0.0):
        """Return the `Scan` of a turn that begins at `time` [s].

        `rng` makes the noise of ranges alone. `field` has the drops (None: no rain), `state` the
        water on the ground (None: it is dry); `damp` is how wet open ground is, 0 to 1, see
        `wetness.paving_dampness`.
        """
        local, when = lidar.beams()
        direction = local @ pose.rotation.T
        origin = pose.position + when[:, None] * pose.velocity
        target = self.trace(origin, direction, 0.0, time + when)
        alpha = 0.0 if field is None else lidar_model.extinction_of(field.spectrum)
        distance, reflectivity, mirrored, actor = self._behind_water(
            target, direction, time + when, alpha, state, damp
        )
        clear = distance.copy(), reflectivity
        there = np.isfinite(distance)
        bright = np.where(
            there, reflectivity * np.exp(-2 * alpha * np.where(there, distance, 0)), 0
        )
        power = np.where(there, bright / np.where(there, distance, 1) ** 2, 0.0)
        label = np.where(mirrored, lidar_model.MIRRORED, lidar_model.KEPT).astype(np.uint8)
        label[power < lidar.least_power] = lidar_model.LOST
        if field is not None:
            drops = self._drops(lidar, pose, time, field)
            beam, place, diameter = drops_in_beams(lidar, pose, drops, local, when)
            drop = lidar_model.drop_reflectivity(diameter, place, lidar.divergence)
            echo = lidar_model.echo_power(drop, place, alpha)
            # Drops behind what the beam meets are not there for it.
            loud = (place > lidar.near) & (place < target.distance[beam])
            loud &= (echo >= lidar.least_power) & (echo > power[beam])
            for k in np.flatnonzero(loud)[np.argsort(echo[loud], kind="stable")]:  # loudest last
                distance[beam[k]], label[beam[k]], power[beam[k]] = (
                    place[k],
                    lidar_model.SCATTERED,
                    echo[k],
                )
                bright[beam[k]] = echo[k] * place[k] ** 2
        label[(distance < lidar.near) & (label != lidar_model.SCATTERED)] = lidar_model.LOST
        scan = _scan(lidar, local, when, label, distance, bright, power, clear, rng)
        if actor is None:
            return scan
        shown = (label == lidar_model.KEPT) | (label == lidar_model.MIRRORED)
        return replace(scan, actor=np.where(shown, actor, 0).astype(np.uint16))

    def _drops(self, lidar, pose, time, field):
        """Return the drops that may echo loud enough in a turn, as they are in its middle."""
        half = 0.5 / lidar.rate
        moves = (np.linalg.norm(field.velocity, axis=1) + np.linalg.norm(pose.velocity)) * half
        reach = lidar.drop_reach(field.spectrum.edges[1:]) + moves
        middle = pose.position + pose.velocity * half
        return near_drops(field, middle, reach, time + half, self.surfaces_at(time + half))

    def _behind_water(self, target, direction, time, alpha, state, damp):
        """Return distance, reflectivity, whether mirrored and actor of the scene's echoes.

        Wet ground is darker. Where water stands, its bed echoes through it and it mirrors the beam
        to something else; the louder of the two is seen, the mirrored one in the beam's direction.
        """
        distance, reflectivity = target.distance.copy(), target.reflectivity.copy()
        mirrored, actor = np.zeros(len(distance), bool), target.actor
        if state is None:
            return distance, reflectivity, mirrored, actor
        grid, place = self.terrain.grid, target.place
        row, column, inside = grid.cells(place[:, 0], place[:, 1])
        bed = self.terrain.bed[row, column]
        level = np.isfinite(distance) & inside & (target.normal[:, 2] > FLAT)
        ground = level & (np.abs(place[:, 2] - bed) < ON_GROUND)
        if actor is not None:
            ground &= actor == 0
        albedo = np.clip(reflectivity, 0.02, 0.8).astype(np.float32)
        darker = 1 - damp * (1 - wet_ratio(albedo))
        reflectivity = np.where(ground, reflectivity * darker, reflectivity)
        water = ground & (state.depth[row, column] >= WET)
        which = np.flatnonzero(water)
        if not len(which):
            return distance, reflectivity, mirrored, actor
        depths = state.depth[row, column][which].astype(np.float64)
        down = np.maximum(-direction[which, 2], 1e-3)
        share, inner = lidar_model.fresnel_of(down)
        # The bed's diffuse light leaves the water into a solid angle larger by the index squared.
        through = (1 - share) ** 2 * np.exp(-2 * lidar_model.WATER_ABSORPTION * depths / inner)
        reflectivity[which] *= through / lidar_model.REFRACTIVE_INDEX**2
        flipped = direction[which] * (1, 1, -1)
        begin = place[which].copy()
        begin[:, 2] = bed[which] + depths + LIFT
        other = self.trace(begin, flipped, distance[which], time[which])
        ghost = share**2 * other.reflectivity
        far = np.where(np.isfinite(other.distance), other.distance, FARTHEST)
        own = lidar_model.echo_power(reflectivity[which], distance[which], alpha)
        louder = lidar_model.echo_power(ghost, far, alpha) > own
        chosen = which[louder]
        distance[chosen], reflectivity[chosen] = far[louder], ghost[louder]
        mirrored[chosen] = True
        if actor is not None:
            actor = actor.copy()
            actor[chosen] = other.actor[louder]
        return distance, reflectivity, mirrored, actor


def drops_in_beams(lidar, pose, drops, local, when):
    """Return the beam, distance and diameter [m] of each drop in a beam as its pulse passes."""
    period, columns, channels = 1 / lidar.rate, lidar.columns, len(lidar.elevation)
    half = 0.5 * lidar.divergence
    start = drops.position - pose.position - drops.velocity * (0.5 * period)
    motion = drops.velocity - pose.velocity

    def seen(at):
        """Return drops in the sensor frame at times since the turn's begin."""
        return (start + motion * at[:, None]) @ pose.rotation

    at = np.full(len(drops), 0.5 * period)
    for _ in range(STEPS):
        x, y, _ = seen(at).T
        at = (math.pi - np.arctan2(y, x)) / (2 * math.pi) * period
    column = np.floor(at / period * columns).astype(np.int64)
    order = np.argsort(lidar.elevation)
    rising = np.array(lidar.elevation)[order]
    found = [], [], []
    for step in (-1, 0, 1):  # a drop near the sensor may fill several columns
        here = (column + step) % columns
        point = seen(when[here * channels])
        away = np.linalg.norm(point, axis=1)
        up = np.arcsin(np.clip(point[:, 2] / np.maximum(away, 1e-9), -1, 1))
        first = np.searchsorted(rising, up - half)
        last = np.searchsorted(rising, up + half)
        for k in range(int((last - first).max(initial=0))):
            which = np.flatnonzero(first + k < last)
            beam = here[which] * channels + order[first[which] + k]
            axis = np.einsum("ni,ni->n", local[beam], point[which])
            off = np.linalg.norm(np.cross(local[beam], point[which]), axis=1)
            inside = (axis > 0) & (off < math.tan(lidar.divergence) / 2 * axis)
            for part, values in zip(found, (beam, axis, drops.diameter[which]), strict=True):
                part.append(values[inside])
    if not found[0]:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    return tuple(np.concatenate(part) for part in found)


def _scan(lidar, local, when, label, distance, bright, power, clear, rng):
    """Return the `Scan` of echoes, with the noise of their ranges."""
    back = label != lidar_model.LOST
    noise = np.zeros(len(local))
    signal = np.maximum(power / lidar.least_power, 1.0)
    noise[back] = rng.normal(size=back.sum()) * lidar.accuracy / np.sqrt(2 * signal[back])
    noise[label == lidar_model.SCATTERED] = 0.0  # as LISA has it
    found = np.where(back, np.where(back, distance, 0) + noise, 0.0)
    return Scan(
        (local * found[:, None]).astype(np.float32), np.where(back, bright, 0).astype(np.float32),
        label, when.astype(np.float32), *clear,
    )  # fmt: skip


def pose_at(camera, height=None, velocity=(0.0, 0.0, 0.0)):
    """Return the level `Pose` at a camera's place, looking ahead, `height` [m] over z = 0."""
    ahead = camera.forward * (1, 1, 0)
    if np.linalg.norm(ahead) < 1e-6:  # it looks straight down: its picture's upper edge is ahead
        ahead = camera.image_up * (1, 1, 0)
    ahead /= np.linalg.norm(ahead)
    left = np.cross((0.0, 0.0, 1.0), ahead)
    position = camera.position.copy()
    if height is not None:
        position[2] = height
    rotation = np.column_stack([ahead, left, (0.0, 0.0, 1.0)])
    return Pose(position, rotation, np.asarray(velocity, np.float64))
