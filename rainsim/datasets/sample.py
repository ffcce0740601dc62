"""A sample: what one camera sees in one rain, with all its labels; and their usual encodings."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rainsim.render.labels import SEEN
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
    """A camera of a data set.

    Attributes
    ----------
    index : int
        Its place in the data set.
    name : str
        Fit for a file's name.
    camera : Camera
        In the ground frame, in metres: the size, focal lengths and principal point of the picture.
    lens : Lens or None
        None for a pinhole.
    held_out : bool
        Whether it is to test or to validate, not to train on.
    """

    index: int
    name: str
    camera: object
    lens: object = None
    held_out: bool = False


@dataclass(frozen=True)
class Sample:
    """A picture with its labels; arrays have the picture's height and width.

    Attributes
    ----------
    view : View
    rate : float [mm/h]
        0 for the clear picture: the dry capture as it was taken.
    picture : ndarray of shape (height, width, 3), uint8
    depth, range : ndarray, float32 [m]
        Along the view axis, and from the camera; infinite for sky.
    class_id, puddle_id, splash_id : ndarray, uint16
    keep : ndarray, bool
        Whether the pixel shows the scene: neither drops, splashes nor water spoil it.
    flow : ndarray of shape (height, width, 2), float32 [px], or None
        None if the views do not follow one another in time.
    flow_mask : ndarray, uint16, or None
    labels : ndarray, uint16, or None
        The user's own.
    glass : ndarray, float32, or None
        Share of the pixel's light that came through drops on the glass before the lens.
    facts : dict
        Weather, puddles, splashes and actors of the picture, see `rainsim.render.layers.facts_of`.
    actor_id : ndarray, uint16, or None
        Number of the actor that the pixel shows; None if nothing moves through the scene.
    partners : dict of str to ndarray of shape (height, width, 3), uint8
        The same picture without a part of the rain, by the names of PARTNERS.
    cloud : tuple of ndarray, or None
        Points of a lidar and their labels, see `rainsim.datasets.clouds.Clouds.cloud`.
    """

    view: View
    rate: float
    picture: np.ndarray
    depth: np.ndarray
    range: np.ndarray
    class_id: np.ndarray
    puddle_id: np.ndarray
    splash_id: np.ndarray
    keep: np.ndarray
    flow: np.ndarray | None = None
    flow_mask: np.ndarray | None = None
    labels: np.ndarray | None = None
    glass: np.ndarray | None = None
    facts: dict = field(default_factory=dict)
    actor_id: np.ndarray | None = None
    partners: dict = field(default_factory=dict)
    cloud: tuple | None = None


@dataclass(frozen=True)
class Plan:
    """What a data set consists of: all that its files besides the samples' say.

    Attributes
    ----------
    name : str
        Of the scene.
    views : tuple of View
    rates : tuple of float [mm/h]
    sequence : bool
        Whether the views follow one another in time.
    points : ndarray of shape (n, 3), float32 [m]
        Places of the scene in the ground frame, and their colours (n, 3), uint8.
    colors : ndarray
    names : dict of str to str
        Classes by id.
    partners : tuple of str
        Names in PARTNERS that rainy pictures have.
    """

    name: str
    views: tuple
    rates: tuple
    sequence: bool
    points: np.ndarray
    colors: np.ndarray
    names: dict
    partners: tuple = ()


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

    References
    ----------
    Development kit of KITTI's depth benchmark (Uhrig et al. 2017): depth = value / 256.
    """
    known = np.isfinite(depth) & (depth * KITTI_DEPTH <= MOST)
    values = np.rint(np.where(known, depth, 0) * KITTI_DEPTH)
    return np.where(known, np.maximum(values, 1), 0).astype(np.uint16)


def kitti_flow(flow, valid):
    """Return flow as KITTI has it: (height, width, 3), uint16: 64 u + 2^15, 64 v + 2^15, valid.

    References
    ----------
    Development kit of KITTI's flow benchmarks 2012 and 2015 (Geiger et al. 2012): u = (first
    channel - 2^15) / 64, valid where the third is 1.
    """
    values = np.rint(np.asarray(flow, np.float64) * KITTI_FLOW + KITTI_ZERO)
    valid = valid & ((values >= 0) & (values <= MOST)).all(axis=-1)
    out = np.zeros((*flow.shape[:2], 3), np.uint16)
    out[..., :2] = np.where(valid[..., None], values, 0)
    out[..., 2] = valid
    return out


def flow_known(sample, hidden_too):
    """Return where a sample's flow counts: what the next frame shows, or also what it hides."""
    return sample.flow_mask > 0 if hidden_too else sample.flow_mask == SEEN
