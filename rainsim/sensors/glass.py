"""Drops on the glass before a lens: a windshield or the window of a housing.

Drops arrive by their flux on the moving pane, spread to spherical caps, flow together, run off when
they are too heavy and are wiped away. A ray through a cap is refracted where it enters the water
and where it leaves, and looks up a wide picture of the rainy scene; the caps are far out of focus.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve

from rainsim.errors import ParameterError, require_not_negative, require_positive
from rainsim.rain.size_distribution import drop_volume
from rainsim.scene.view import corner_rays, image_point, pixel_rays

INDEX = 1.333  # of water
TENSION, WEIGHT = 0.0728, 9810.0  # N/m, N/m3 of water at 20 degrees
# Furmidge 1962: a drop stays while WEIGHT V sin(slope) < HOLD TENSION width; HOLD is the difference
# of the receding and the advancing angle's cosines: 0.2 to 0.5 on clean to dirty glass.
HOLD = 0.3
WIDE = math.radians(72)  # off the axis that the wide picture reaches
WIDE_SIDE = 640  # px of it
PARALLAX_STEPS = 2
SPAN = 0.5  # s whose drops share a random generator
MARGIN = 0.01  # m of pane around what the picture shows


@dataclass(frozen=True)
class Pane:
    """A pane of glass before a lens, on which it rains.

    Attributes
    ----------
    distance : float [m]
        From the camera along its axis.
    tilt : float [rad]
        Of the upper edge towards the camera's back; without it the pane is across the axis.
    contact_angle : float [rad]
        Of water on it.
    speed : float [m/s]
        Of the camera along its level view direction.
    age : float [s]
        For how long it has rained on the pane.
    wiper : float [s] or None
        Between strokes that clear it, the last one `age` modulo `wiper` ago; None: no wiper.
    aperture : float [m]
        Of the lens; 0 for a pinhole.
    focus : float [m]
        Distance of what is in focus.

    Examples
    --------
    >>> rainsim.Pane(age=20.0, wiper=6.0).wet_for
    2.0
    """

    distance: float = 0.08
    tilt: float = math.radians(30)
    contact_angle: float = math.radians(50)
    speed: float = 0.0
    age: float = 10.0
    wiper: float | None = None
    aperture: float = 2e-3
    focus: float = 10.0

    def __post_init__(self):
        """Raise ParameterError if a value breaks its rule."""
        require_positive("glass distance", self.distance, "m")
        require_not_negative("glass age", self.age, "s")
        require_not_negative("glass aperture", self.aperture, "m")
        require_positive("glass focus", self.focus, "m")
        if not 0 < self.contact_angle <= math.pi / 2:
            raise ParameterError(
                f"glass contact angle is {math.degrees(self.contact_angle):g} degrees; it must be "
                "above 0 and at most 90: caps that bulge over their rim are not drawn"
            )
        if not abs(self.tilt) < math.radians(80):
            raise ParameterError(
                f"glass tilt is {math.degrees(self.tilt):g} degrees; it must be less than 80"
            )
        if self.wiper is not None:
            require_positive("glass wiper", self.wiper, "s")

    @property
    def wet_for(self):
        """Time since the pane was last clear [s]."""
        return self.age if self.wiper is None else self.age % self.wiper

    def axes(self):
        """Return right, down along the pane and its outward normal, rows, camera frame."""
        c, s = math.cos(self.tilt), math.sin(self.tilt)
        return np.array([[1.0, 0, 0], [0, c, s], [0, -s, c]])


@dataclass(frozen=True)
class Caps:
    """Drops on a pane."""

    place: np.ndarray  # (n, 2), float64, m, right and down from where the axis meets the pane
    radius: np.ndarray  # (n,), float64, m, of the wetted disc
    arrived: int  # drops that hit the pane


def cap_volume(radius, angle):
    """Return the volume [m3] of a spherical cap by its disc's radius [m] and contact angle."""
    c = math.cos(angle)
    return math.pi / 3 * (2 - 3 * c + c**3) / math.sin(angle) ** 3 * np.asarray(radius) ** 3


def cap_radius(volume, angle):
    """Return the radius [m] of the wetted disc of a cap by its volume [m3]."""
    return np.cbrt(np.asarray(volume) / cap_volume(1.0, angle))


def pane_flux(field, pane, camera):
    """Return how many drops of each class hit a pane before a camera, (CLASSES,) [1/(m2 s)]."""
    normal = pane.axes()[2] @ camera.camera_from_world[:3, :3]
    ahead = camera.forward * (1, 1, 0)
    ahead = ahead / max(np.linalg.norm(ahead), 1e-9)
    towards = -(field.velocity - pane.speed * ahead) @ normal
    return field.spectrum.density * np.maximum(towards, 0.0)


def pane_window(camera, pane):
    """Return low and high corner, (2, 2) [m], of the pane in a camera's view, with a margin."""
    place = on_pane(corner_rays(camera), pane)[0]
    if not np.isfinite(place).all():
        raise ParameterError(
            f"the glass is tilted by {math.degrees(pane.tilt):g} degrees and the picture sees past "
            "it; it must fill the picture; give less tilt or a longer focal length"
        )
    return np.stack([place.min(axis=0) - MARGIN, place.max(axis=0) + MARGIN])


def on_pane(rays, pane):
    """Return where rays (n, 3) meet a pane, (n, 2) [m] along it, and the points (n, 3) [m]."""
    axes = pane.axes()
    with np.errstate(divide="ignore", invalid="ignore"):
        way = pane.distance * axes[2, 2] / (rays @ axes[2])
    point = np.where(way > 0, way, np.nan)[:, None] * rays
    return (point - (0, 0, pane.distance)) @ axes[:2].T, point


def caps_on(field, pane, camera, seed):
    """Return the `Caps` on the pane before a camera, in the ground frame.

    The drops of a seed arrive at their own times: an older pane has those of a younger one, less
    what has flowed together, run off or been wiped since.
    """
    low, high = pane_window(camera, pane)
    flux, size = pane_flux(field, pane, camera), high - low
    # Candidates of a rain that meets the pane head on are thinned to the flux, so that a camera
    # which turns a little keeps its drops.
    speed = np.linalg.norm(field.velocity, axis=1) + pane.speed
    most, begin = field.spectrum.density * speed, pane.age - pane.wet_for
    share = np.divide(flux, most, out=np.zeros_like(flux), where=most > 0)
    arrivals = [np.empty((0, 4))]  # time, x, y, diameter
    for span in range(math.floor(begin / SPAN), math.ceil(pane.age / SPAN)):
        rng = np.random.default_rng([seed, 0x61A55, span])
        counts = rng.poisson(most * size.prod() * SPAN)
        kind = np.repeat(np.arange(len(counts)), counts)
        kept, *random = rng.random((5, len(kind)))
        kept = kept < share[kind]
        time = (span + random[0]) * SPAN
        kept &= (time >= begin) & (time < pane.age)
        across, down = low[:, None] + np.stack(random[1:3]) * size[:, None]
        diameter = field.spectrum.diameters(kind, random[3])
        arrivals.append(np.column_stack([time, across, down, diameter])[kept])
    time, across, down, diameter = np.concatenate(arrivals).T
    order = np.argsort(time, kind="stable")
    place = np.column_stack([across, down])[order]
    normal = pane.axes()[2] @ camera.camera_from_world[:3, :3]
    slope = math.sqrt(max(1 - normal[2] ** 2, 0.0))  # sine of the pane's slope
    return _settled(place, drop_volume(diameter[order]), pane, slope)


def _settled(place, volume, pane, slope):
    """Return the `Caps` after drops have arrived one by one, flowed together and run off."""
    angle = pane.contact_angle
    there = np.empty((4, 0))  # x, y, volume and radius of the drops that are there now
    for at, amount in zip(place, volume, strict=True):
        at = at.copy()
        while True:  # what touches it flows together with it
            own = float(cap_radius(amount, angle))
            x, y, held, radius = there
            touch = np.hypot(x - at[0], y - at[1]) < radius + own
            if not touch.any():
                break
            total = amount + held[touch].sum()
            at[0] = (at[0] * amount + (x[touch] * held[touch]).sum()) / total
            at[1] = (at[1] * amount + (y[touch] * held[touch]).sum()) / total
            amount, there = total, there[:, ~touch]
        if WEIGHT * amount * slope < HOLD * TENSION * 2 * own:
            there = np.append(there, [[at[0]], [at[1]], [amount], [own]], axis=1)
        else:  # it runs off and takes along what is below
            there = there[:, (np.abs(x - at[0]) >= own + radius) | (y <= at[1])]
    return Caps(np.ascontiguousarray(there[:2].T), there[3], len(place))


def refracted(rays, point, place, centre, radius, pane):
    """Return where rays through caps go on, camera frame.

    The glass is thin and bends nothing; water begins at the pane's outer side and ends at the cap's
    sphere.

    place : array (n, 2) [m]. The same along the pane.
    Returns out : array (n, 3). Unit directions; NaN where all light is reflected
        back into the water.
        leave : array (n, 3) [m]. Where they leave the water.
        share : array (n,). Of the light that gets through the water's outer side.
    """
    axes = pane.axes()
    local = rays @ axes.T  # right, down, out
    water = local / INDEX
    water[:, 2] = np.sqrt(np.maximum(1 - water[:, 0] ** 2 - water[:, 1] ** 2, 0))
    ball = radius / math.sin(pane.contact_angle)
    high = np.broadcast_to(ball * math.cos(pane.contact_angle), len(place))
    start = np.column_stack([place - centre, high])  # from the ball's centre
    b = np.einsum("ni,ni->n", start, water)
    way = -b + np.sqrt(np.maximum(b * b - np.einsum("ni,ni->n", start, start) + ball**2, 0))
    leave = start + way[:, None] * water
    normal = leave / np.reshape(ball, (-1, 1))
    cosine = np.einsum("ni,ni->n", normal, water)
    root = 1 - INDEX**2 * (1 - cosine**2)
    out_cosine = np.sqrt(np.maximum(root, 0))
    out = INDEX * water + (out_cosine - INDEX * cosine)[:, None] * normal
    s = (INDEX * cosine - out_cosine) / np.maximum(INDEX * cosine + out_cosine, 1e-12)
    p = (INDEX * out_cosine - cosine) / np.maximum(INDEX * out_cosine + cosine, 1e-12)
    out[(root <= 0) | (out[:, 2] <= 0)] = np.nan
    return out @ axes, point + way[:, None] * (water @ axes), 1 - 0.5 * (s * s + p * p)


def wide_camera(camera):
    """Return the pinhole camera at a camera's place whose picture drops look up."""
    focal = WIDE_SIDE / 2 / math.tan(WIDE)
    return replace(camera, width=WIDE_SIDE, height=WIDE_SIDE, fx=focal, fy=focal,
                   cx=WIDE_SIDE / 2, cy=WIDE_SIDE / 2)  # fmt: skip


def through_glass(picture, camera, caps, pane, wide, wide_depth):
    """Return the picture seen through the wet pane, and the share of each pixel that drops fill.

    `picture` is the one without the pane, (height, width, 3), uint8; `wide` and `wide_depth` [m]
    are colours and depth of `wide_camera`. The share is of shape (height, width), float32.
    """
    rays = pixel_rays(camera).reshape(-1, 3)
    place, point = on_pane(rays, pane)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    light, share = np.zeros((len(rays), 3)), np.zeros(len(rays))
    linear = (wide / 255.0) ** 2.2
    view = wide_camera(camera)
    inside, cap = pixels_behind(caps, place, camera, pane)
    if len(inside):
        out, leave, through = refracted(
            rays[inside], point[inside], place[inside], caps.place[cap], caps.radius[cap], pane
        )
        light[inside] = looked_up(out, leave, linear, wide_depth, view) * through[:, None]
        share[inside] = 1.0
    shape = camera.height, camera.width
    share, light = share.reshape(shape), light.reshape(*shape, 3) * share.reshape(*shape, 1)
    blur = pane.aperture * camera.fx * abs(1 / pane.distance - 1 / pane.focus)  # px, diameter
    if blur > 1:
        kernel = _disc(blur)
        share = np.clip(fftconvolve(share, kernel, mode="same"), 0, 1)
        light = np.stack([fftconvolve(light[..., k], kernel, mode="same") for k in range(3)], -1)
    seen = (picture / 255.0) ** 2.2 * (1 - share[..., None]) + np.maximum(light, 0)
    return np.rint(np.clip(seen, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8), share.astype("f4")


def pixels_behind(caps, place, camera, pane):
    """Return the pixels behind caps and the cap of each, two ndarrays of the same length.

    Only pixels in the box of a cap are looked at. `place` is where their rays meet the pane, (n, 2)
    [m], row by row.
    """
    size = np.array([camera.width, camera.height])
    corners = caps.place[:, None] + caps.radius[:, None, None] * np.array(
        [[-1, -1], [-1, 1], [1, -1], [1, 1]]
    )  # of the square around each disc
    x, y, ahead = np.moveaxis(corners @ pane.axes()[:2] + (0, 0, pane.distance), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack(image_point(camera, x, y, ahead), axis=-1)
    first = np.clip(np.floor(ends.min(axis=1)) - 1, 0, size)
    last = np.clip(np.ceil(ends.max(axis=1)) + 1, 0, size)
    whole = (ahead <= 0).any(axis=1)  # the square reaches past the camera
    first[whole], last[whole] = 0, size
    place, found = place.reshape(camera.height, camera.width, 2), []
    number = np.arange(size.prod()).reshape(size[::-1])
    for (left, top), (right, bottom), centre, radius in zip(
        first.astype(int), last.astype(int), caps.place, caps.radius, strict=True
    ):
        box = slice(top, bottom), slice(left, right)
        found.append(number[box][((place[box] - centre) ** 2).sum(axis=-1) < radius**2])
    cap = np.repeat(np.arange(len(found)), [len(pixels) for pixels in found])
    return np.concatenate([*found, np.zeros(0, int)]), cap


def _disc(diameter):
    half = math.ceil(diameter / 2)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    kernel = np.clip(diameter / 2 + 0.5 - np.hypot(x, y), 0, 1)
    return kernel / kernel.sum()


def looked_up(out, leave, linear, depth, camera):
    """Return the colours of a wide picture along some directions from places near its camera.

    The picture's depth [m] tells where a direction meets the scene, in a few steps; directions
    beyond the picture take its rim, those of light that never leaves the water are black. Unit
    directions `out` and places `leave` [m] are of shape (n, 3) in the camera frame.
    """
    gone = ~np.isfinite(out[:, 0])
    ray = np.where(gone[:, None], (0.0, 0.0, 1.0), out)
    way = np.full(len(out), 1e6)  # m along the ray, far at first
    for step in range(PARALLAX_STEPS + 1):
        place = leave + way[:, None] * ray
        ahead = np.maximum(place[:, 2], 1e-6)
        u, v = image_point(camera, place[:, 0], place[:, 1], ahead)
        u, v = np.clip(u, 0, camera.width - 1e-3), np.clip(v, 0, camera.height - 1e-3)
        row, column = v.astype(int), u.astype(int)
        if step < PARALLAX_STEPS:
            far = np.minimum(depth[row, column], 1e6)
            way = np.maximum((far - leave[:, 2]) / np.maximum(ray[:, 2], 1e-3), 0.0)
    return np.where(gone[:, None], 0.0, linear[row, column])
