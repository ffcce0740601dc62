"""Rigs: cameras and lidars on one vehicle, each at its place and its own times; a TOML file.

The vehicle's frame has x ahead, y left and z up, in metres. A path of cameras says where it drives.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.config.preset_files import nearest, parsed_toml
from rainsim.errors import InputError, ParameterError, shown
from rainsim.io.files import json_number, read_text
from rainsim.render.shutter import motion_to_next, moved
from rainsim.scene.camera_entry import Entry
from rainsim.scene.types import Camera
from rainsim.sensors.lens_files import lens_named
from rainsim.sensors.lidar import pose_at
from rainsim.sensors.lidar_model import SENSORS
from rainsim.sensors.rolling import check_readout

# The axes of a camera, x right, y down, z ahead, from those of a vehicle or a lidar.
CAMERA_FROM_LIDAR = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], float)
MOST_BYTES, MOST_SENSORS, MOST_SIDE = 1 << 16, 32, 16384
MOST_RATE = 1000.0  # 1/s, of pictures and of the steps that all times lie on
COMMON = "name", "at", "look", "rate", "offset"
KEYS = {
    "camera": (*COMMON, "width", "height", "fov", "focal", "center", "lens", "rolling"),
    "lidar": (*COMMON, "sensor"),
}
PLACED = "path_camera", "level"  # keys of the table [vehicle]
USUAL = {"look": [0, 0, 0], "offset": 0, "rolling": 0, "sensor": "hdl64", "level": True,
         "path_camera": [0, 0, 0]}  # fmt: skip


@dataclass(frozen=True)
class Sensor:
    """A sensor of a rig; a camera if `camera` is given, else a lidar."""

    name: str
    vehicle_from_sensor: np.ndarray  # (4, 4), m; axes of a camera, or x ahead, y left, z up
    rate: Fraction  # 1/s, pictures or turns
    offset: Fraction  # s, of the first after the path's first camera
    camera: Camera | None = None  # size, focal lengths and principal point
    lens: object = None
    readout: float = 0.0  # s, of a rolling shutter
    lidar: str | None = None  # a key of `lidar_model.SENSORS`

    @property
    def is_camera(self):
        """Whether the sensor is a camera."""
        return self.camera is not None

    def time(self, number):
        """Return the time [s] of a picture or a turn, a Fraction."""
        return self.offset + number / self.rate

    def count(self, seconds):
        """Return the number of pictures or turns that begin within a path's time, a Fraction."""
        return max(0, math.ceil((seconds - self.offset) * self.rate))

    def facts(self):
        """Return the sensor as plain values, for files of calibration."""
        facts = {
            "name": self.name, "kind": "camera" if self.is_camera else "lidar",
            "vehicle_from_sensor": self.vehicle_from_sensor.tolist(),
            "rate_hz": float(self.rate), "offset_s": float(self.offset),
        }  # fmt: skip
        if not self.is_camera:
            return {**facts, "sensor": self.lidar}
        own = {
            key: getattr(self.camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")
        }
        lens = self.lens and {"model": self.lens.model, "values": list(self.lens.values)}
        return {**facts, **own, "lens": lens, "rolling_s": self.readout}


@dataclass(frozen=True)
class Rig:
    """Sensors on a vehicle; `path_camera` [m] is where on it the path's camera sits.

    A `level` vehicle takes from the path's camera its place and the direction it looks in alone.
    """

    sensors: tuple
    path_camera: tuple = (0.0, 0.0, 0.0)
    level: bool = True

    @property
    def cameras(self):
        """The cameras in the file's order, a tuple of Sensor."""
        return tuple(sensor for sensor in self.sensors if sensor.is_camera)

    @property
    def lidars(self):
        """The lidars in the file's order, a tuple of Sensor."""
        return tuple(sensor for sensor in self.sensors if not sensor.is_camera)

    def step(self):
        """Return the longest step [s], a Fraction, on which all times of all sensors lie."""
        parts = [part for s in self.sensors for part in (s.offset, 1 / s.rate) if part]
        low = math.lcm(*(part.denominator for part in parts))
        step = Fraction(math.gcd(*(int(part * low) for part in parts)), low)
        if step * Fraction(MOST_RATE) < 1:
            raise ParameterError(
                f"the rig's times have a common step of {float(step) * 1e3:.3g} ms; it must be "
                "1 ms or more; give rates and offsets that fit one another, such as 10 and 20"
            )
        return step

    def place(self, path, fps, time):
        """Return ground_from_vehicle (4, 4) [m] at a time [s].

        `path` are cameras in the ground frame, one every 1/`fps` seconds; beyond the last the
        vehicle goes on as it came.
        """
        index = min(int(time * fps), len(path) - 1)
        move, turn = motion_to_next(path, index)
        share = float(time * fps - index)
        camera = moved(path[index], share * move, share * turn)
        matrix = np.eye(4)
        turned = camera.camera_from_world[:3, :3].T @ CAMERA_FROM_LIDAR
        matrix[:3, :3] = pose_at(camera).rotation if self.level else turned
        matrix[:3, 3] = camera.position - matrix[:3, :3] @ self.path_camera
        return matrix

    def facts(self):
        """Return the rig as plain values."""
        return {
            "vehicle": "x ahead, y left, z up, metres", "path_camera": list(self.path_camera),
            "level": self.level, "sensors": [sensor.facts() for sensor in self.sensors],
        }  # fmt: skip


def read_rig(path, fps):
    """Return the `Rig` of a TOML file; sensors without a rate have the path's `fps` [1/s]."""
    path = Path(path)
    data = parsed_toml(read_text(path, "a rig", MOST_BYTES), str(path))
    for key in data:
        if key not in (*KEYS, "vehicle"):
            known = nearest(key, [*KEYS, "vehicle"])
            raise InputError(f"{path} has a table {shown(key)}; no rig has one; {known}")
    sensors, usual = [], {**USUAL, "rate": fps}
    for kind in KEYS:
        tables = data.get(kind, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise InputError(f"{path}: {kind} must be tables, each under a line [[{kind}]]")
        sensors += [_Table(path, kind, n, table, usual).sensor() for n, table in enumerate(tables)]
    names = sorted(sensor.name for sensor in sensors)
    twice = [a for a, b in pairwise(names) if a == b]
    if twice or not 0 < len(sensors) <= MOST_SENSORS or not any(s.is_camera for s in sensors):
        fault = f"two sensors named {twice[0]}" if twice else f"{len(sensors)} sensors"
        raise InputError(
            f"{path} has {fault}; there must be 1 to {MOST_SENSORS}, one of them a camera, each "
            "with a name of its own; correct the file"
        )
    vehicle = _Table(path, "vehicle", 0, data.get("vehicle", {}), USUAL, PLACED)
    if not isinstance(vehicle.get("level"), bool):
        raise vehicle.error("level", "true or false")
    place = vehicle.array("path_camera", (3,)).tolist()
    rig = Rig(tuple(sensors), tuple(place), vehicle.get("level"))
    rig.step()  # raises
    return rig


class _Table(Entry):
    """A table of a rig's file, with errors that name it; `usual` has values of lacking keys."""

    def __init__(self, path, kind, number, values, usual, keys=None):
        super().__init__(path, f"{kind} {number}", values, usual)
        self.path, self.kind, keys = path, kind, keys or KEYS[kind]
        for key in values:
            if key not in keys:
                raise InputError(f"{self.label} has a key {shown(key)}; {nearest(key, keys)}")

    def number(self, key, low, high):
        """Return a number from `low` to `high`."""
        value = json_number(self.get(key))
        if value is None or not low <= value <= high:
            raise self.error(key, f"a number from {low:g} to {high:g}")
        return value

    def sensor(self):
        """Return the `Sensor` that the table describes."""
        name = self.get("name")
        if not isinstance(name, str) or not name.isascii() or not name.isidentifier():
            raise self.error("name", "a word of letters, digits and _")
        matrix = np.eye(4)
        # Yaw to the left, pitch up, roll clockwise as the sensor looks.
        yaw, pitch, roll = self.array("look", (3,))
        turn = Rotation.from_euler("ZYX", (yaw, -pitch, roll), degrees=True).as_matrix()
        matrix[:3, 3] = self.array("at", (3,))
        rate = Fraction(self.number("rate", 0.1, MOST_RATE)).limit_denominator(1000)
        offset = Fraction(self.number("offset", 0, 1e4)).limit_denominator(1000) / 1000  # ms
        if self.kind == "lidar":
            matrix[:3, :3] = turn
            if self.get("sensor") not in SENSORS:
                raise self.error("sensor", "one of " + ", ".join(SENSORS))
            return Sensor(name, matrix, rate, offset, lidar=self.get("sensor"))
        matrix[:3, :3] = turn @ CAMERA_FROM_LIDAR.T
        readout = self.number("rolling", 0, 1e4) * 1e-3
        check_readout(readout)
        return Sensor(name, matrix, rate, offset, self._camera(), self._lens(), readout)

    def _camera(self):
        width, height = (int(self.number(key, 1, MOST_SIDE)) for key in ("width", "height"))
        if ("fov" in self.values) == ("focal" in self.values):
            raise self.error("fov", "given, or focal, and not both: degrees across, or [fx, fy] px")
        if "fov" in self.values:
            fx = fy = width / 2 / math.tan(math.radians(self.number("fov", 1, 170)) / 2)
        else:
            fx, fy = self.array("focal", (2,)).tolist()
            if min(fx, fy) <= 0:
                raise self.error("focal", "two numbers above 0")
        centered = "center" not in self.values
        center = (width / 2, height / 2) if centered else self.array("center", (2,)).tolist()
        return Camera(width, height, fx, fy, *center, np.eye(4))

    def _lens(self):
        text = self.get("lens")
        if text is None:
            return None
        if not isinstance(text, str):
            raise self.error("lens", "a text such as opencv:k1,k2,p1,p2")
        beside = self.path.parent / text
        return lens_named(str(beside) if ":" not in text and beside.exists() else text)
