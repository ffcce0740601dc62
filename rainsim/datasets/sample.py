"""A sample: what one camera sees in one rain, with all its labels; and their usual encodings."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rainsim.terrain.table import WATER

REPLACED = 1 / 32  # share of a pixel's light from which drops and splashes spoil it
MOST = 2**16 - 1
FAR_MM = MOST / 1000  # m, the farthest that whole millimetres in 16 bits hold
PARTNERS = {
    "clear_air": "without drops, splashes, spray and haze: what falls is gone, wet ground stays",
    "no_glass": "without drops on the glass before the lens",
    "dry": "the dry capture as it was taken",
}
KITTI_DEPTH, KITTI_FLOW, KITTI_ZERO = 256, 64, 2**15  # see `kitti_depth` and `kitti_flow`


@dataclass(frozen=True)
class View:
    """A camera of a data set."""

    index: int  # its place in the data set
    name: str  # fit for a file's name
    camera: object  # ground frame, metres: size, focal lengths, principal point of the picture
    lens: object = None  # None for a pinhole
    held_out: bool = False  # to test or to validate, not to train on
    mount: object = None  # the `Sensor` of a rig that takes it
    frame: int = 0  # of a rig: its place among the pictures of its camera
    time: float = 0.0  # s, of a rig
    step: int = 0  # of a rig: the camera of the path that came last

    @property
    def number(self):
        """Its place among the pictures of its camera."""
        return self.index if self.mount is None else self.frame

    @property
    def moment(self):
        """A number that pictures of one time share; they are held out together."""
        return self.index if self.mount is None else self.step


@dataclass(frozen=True)
class Turn:
    """A turn of a rig's lidar; `index` counts on from the views."""

    index: int
    name: str
    mount: object  # `Sensor`
    frame: int
    time: float  # s
    ground_from_sensor: np.ndarray  # (4, 4), m


@dataclass(frozen=True)
class Cloud:
    """The points of a `Turn`, as a `Sample` is noted and written."""

    view: Turn
    rate: float  # mm/h
    cloud: tuple  # see `rainsim.datasets.clouds.Clouds.seen_from`


@dataclass(frozen=True)
class Sample:
    """A picture with its labels; arrays have the picture's height and width.

    Flow is None if the views do not follow one another in time, the number of the actor that a
    pixel shows if nothing moves through the scene.
    """

    view: View
    rate: float  # mm/h; 0 for the clear picture: the dry capture as it was taken
    picture: np.ndarray  # (height, width, 3), uint8
    depth: np.ndarray  # float32, m, along the view axis; infinite for sky
    range: np.ndarray  # float32, m, from the camera; infinite for sky
    class_id: np.ndarray  # uint16, as the other ids
    puddle_id: np.ndarray
    splash_id: np.ndarray
    keep: np.ndarray  # bool, shows the scene: neither drops, splashes nor water spoil it
    flow: np.ndarray | None = None  # (height, width, 2), float32, px
    flow_mask: np.ndarray | None = None  # uint16
    labels: np.ndarray | None = None  # uint16, the user's own
    glass: np.ndarray | None = None  # float32, share of light that came through drops on it
    wetness: np.ndarray | None = None  # float32, 0 dry to 1 wet through
    facts: dict = field(default_factory=dict)  # see `rainsim.render.layers.facts_of`
    actor_id: np.ndarray | None = None
    partners: dict = field(default_factory=dict)  # pictures by the names of PARTNERS
    cloud: tuple | None = None  # see `rainsim.datasets.clouds.Clouds.seen_from`

    @cached_property
    def flow_picture(self):
        """Its flow as `kitti_flow` has it, known also where the next picture hides it."""
        return kitti_flow(self.flow, self.flow_mask > 0)


@dataclass(frozen=True)
class Plan:
    """What a data set consists of: all that its files besides the samples' say."""

    name: str  # of the scene
    views: tuple
    rates: tuple  # mm/h
    sequence: bool  # whether the views follow one another in time
    points: np.ndarray  # (n, 3), float32, m, places of the scene in the ground frame
    colors: np.ndarray  # (n, 3), uint8, of the points
    names: dict  # classes by id
    partners: tuple = ()  # names in PARTNERS that rainy pictures have
    interval: float = 0.0  # s from view to view of a sequence
    rig: object = None  # `Rig`
    turns: tuple = ()  # of its lidars

    @property
    def parts(self):
        """All that is drawn in a rain: views, and turns of lidars."""
        return (*self.views, *self.turns)

    def is_last(self, view):
        """Whether a view is the last of its camera."""
        return view.number == max(v.number for v in self.views if v.mount is view.mount)


def keep_mask(rain_alpha, splash_alpha, class_id):
    """Return which pixels show the scene, see `Sample`: all arrays of one shape."""
    replaced = 1 - (1 - rain_alpha) * (1 - splash_alpha)
    return (replaced < REPLACED) & (class_id != WATER)


def depth_mm(depth):
    """Return depths in whole millimetres, uint16; 0 where unknown or beyond 65.535 m."""
    known = np.isfinite(depth) & (depth <= FAR_MM)
    return np.rint(np.where(known, depth, 0) * 1000.0).astype(np.uint16)


def kitti_depth(depth):
    """Return depths as KITTI has them: 256 a metre, uint16, 0 where there is none.

    Development kit of KITTI's depth benchmark (Uhrig et al. 2017): depth = value / 256.
    """
    known = np.isfinite(depth) & (depth * KITTI_DEPTH <= MOST)
    values = np.rint(np.where(known, depth, 0) * KITTI_DEPTH)
    return np.where(known, np.maximum(values, 1), 0).astype(np.uint16)


def kitti_flow(flow, valid):
    """Return flow as KITTI has it: (height, width, 3), uint16: 64 u + 2^15, 64 v + 2^15, valid.

    Development kit of KITTI's flow benchmarks 2012 and 2015 (Geiger et al. 2012): u = (first
    channel - 2^15) / 64, valid where the third is 1.
    """
    values = np.rint(np.asarray(flow, np.float64) * KITTI_FLOW + KITTI_ZERO)
    valid = valid & ((values >= 0) & (values <= MOST)).all(axis=-1)
    out = np.zeros((*flow.shape[:2], 3), np.uint16)
    out[..., :2] = np.where(valid[..., None], values, 0)
    out[..., 2] = valid
    return out
