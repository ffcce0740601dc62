"""Lens distortion: a pinhole picture that is wide enough, warped to the real lens's picture.

Splats are drawn by pinhole cameras. So a distorted picture is drawn wider than it needs to be and
looked up in that: colours are interpolated, depths and ids are taken from the nearest pixel, and
flow leads from a distorted place to a distorted place. Flow is interpolated on one surface.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from rainsim.errors import ParameterError
from rainsim.render.labels import NO_FLOW, OUTSIDE
from rainsim.scene.view import image_point, slopes

MODELS = {"opencv": (4, 5), "fisheye": (4,), "division": (1,), "eucm": (2,)}  # coefficients
WIDEST = math.tan(math.radians(80))  # off the axis that a pinhole picture is drawn to
STEPS, CLOSE = 60, 1e-10  # of the inversion, in units of the focal length
BEYOND = 1.25  # times the picture's farthest ray up to which flow trusts a polynomial outside it
ALIKE, ALIKE_SHARE = 0.5, 0.05  # px and share of the flow by which it differs on one surface
MOST_SIDE = 16384  # px of the wide picture
REMEDY = "give other coefficients or a longer focal length"


@dataclass(frozen=True)
class Lens:
    """A lens as OpenCV has it.

    Attributes
    ----------
    model : str
        "opencv" is radial and tangential, "fisheye" has the angle off the axis as a polynomial,
        "division" has r / (1 + k r^2) for the pinhole's distance from the axis, "eucm" is the
        enhanced unified model.
    values : tuple of float
        k1, k2, p1, p2 and optionally k3; of a fisheye k1 to k4, else k; alpha and beta.

    Examples
    --------
    >>> x, y = rainsim.Lens("opencv", (-0.2, 0.0, 0.0, 0.0)).distort(0.5, 0.0)
    >>> round(float(x), 3)
    0.475

    References
    ----------
    https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html and
    https://docs.opencv.org/4.x/db/d58/group__calib3d__fisheye.html; Fitzgibbon, 2001 (division);
    Khomutenko, Garcia and Martinet, 2016 (enhanced unified); all as COLMAP has them.
    """

    model: str
    values: tuple

    def __post_init__(self):
        """Raise ParameterError unless model and coefficients fit."""
        if self.model not in MODELS:
            raise ParameterError(
                f"lens model is {self.model!r}; it must be one of {', '.join(MODELS)}"
            )
        counts = MODELS[self.model]
        if len(self.values) not in counts or not all(map(math.isfinite, self.values)):
            many = " or ".join(map(str, counts))
            raise ParameterError(
                f"lens {self.model} has the coefficients {self.values}; they must be {many} finite "
                "numbers"
            )

    def distort(self, x, y):
        """Return where the lens puts a ray, in focal lengths; (x, y) is the pinhole's place."""
        if self.model == "fisheye":
            r = np.hypot(x, y)
            angle = np.arctan(r)
            bent = angle * _polynomial(self.values, angle * angle)
            scale = np.where(r > 1e-12, bent / np.maximum(r, 1e-12), 1.0)
            return x * scale, y * scale
        r2 = x * x + y * y
        if self.model in ("division", "eucm"):
            with np.errstate(invalid="ignore"):  # NaN where the lens sees nothing
                if self.model == "division":  # the root that is 1 on the axis
                    scale = 2 / (1 + np.sqrt(1 - 4 * self.values[0] * r2))
                else:
                    alpha, beta = self.values
                    scale = 1 / (alpha * np.sqrt(beta * r2 + 1) + 1 - alpha)
            return x * scale, y * scale
        k1, k2, p1, p2, k3 = (*self.values, 0.0)[:5]
        radial = _polynomial((k1, k2, k3), r2)
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def undistort(self, x, y):
        """Return the pinhole's place of a distorted one, NaN where there is none.

        A fisheye is inverted by its angle, the other model by Newton's method along both axes.
        """
        if self.model == "fisheye":
            return self._unbent(np.asarray(x, float), np.asarray(y, float))
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        if self.model == "division":
            scale = 1 + self.values[0] * (x * x + y * y)
            scale = np.where(scale > 0, scale, np.nan)
            return x / scale, y / scale
        if self.model == "eucm":
            alpha, beta = self.values
            squared = x * x + y * y
            with np.errstate(invalid="ignore", divide="ignore"):
                root = np.sqrt(1 - (2 * alpha - 1) * beta * squared)
                ahead = (1 - beta * alpha**2 * squared) / (alpha * root + 1 - alpha)
            ahead = np.where(ahead > 0, ahead, np.nan)
            return x / ahead, y / ahead
        u, v, step = x.copy(), y.copy(), 1e-6
        for _ in range(STEPS):
            a, b = self.distort(u, v)
            ax, bx = self.distort(u + step, v)
            ay, by = self.distort(u, v + step)
            j00, j01, j10, j11 = (ax - a) / step, (ay - a) / step, (bx - b) / step, (by - b) / step
            det = j00 * j11 - j01 * j10
            with np.errstate(all="ignore"):
                du, dv = (
                    ((a - x) * j11 - (b - y) * j01) / det,
                    ((b - y) * j00 - (a - x) * j10) / det,
                )
            du, dv = (np.clip(np.nan_to_num(d), -0.2, 0.2) for d in (du, dv))
            u, v = u - du, v - dv
            if max(np.abs(du).max(initial=0), np.abs(dv).max(initial=0)) < CLOSE:
                break
        a, b = self.distort(u, v)
        # Past its turning point the radial polynomial leads back: no ray of the lens gets there.
        folded = ~(j00 * j11 - j01 * j10 > 0)
        bad = folded | (np.hypot(a - x, b - y) > 1e-6)
        return np.where(bad, np.nan, u), np.where(bad, np.nan, v)

    @property
    def reach(self):
        """Tangent of the angle off the axis up to which a ray farther out is seen farther out.

        At most WIDEST. Beyond it the polynomial leads back, and places belong to no ray.
        """
        if self.model in ("division", "eucm"):  # both grow all the way
            bends_back = self.model == "division" and self.values[0] > 0
            return min(0.5 / math.sqrt(self.values[0]), WIDEST) if bends_back else WIDEST
        fisheye = self.model == "fisheye"
        radial = self.values if fisheye else (*self.values[:2], *self.values[4:])
        slope = [(2 * k + 3) * c for k, c in enumerate(radial)]
        roots = np.roots([*reversed(slope), 1.0])
        turns = math.sqrt(min((r.real for r in roots if r.imag == 0 < r.real), default=math.inf))
        if fisheye:
            turns = math.tan(min(turns, math.atan(WIDEST)))
        return min(turns, WIDEST)

    def _unbent(self, x, y):
        bent = np.hypot(x, y)
        angle, rising = bent.copy(), [(2 * k + 3) * c for k, c in enumerate(self.values)]
        with np.errstate(all="ignore"):
            for step in range(STEPS + 1):
                squared = angle * angle
                off = angle * _polynomial(self.values, squared) - bent
                slope = _polynomial(rising, squared)
                angle = angle - off / slope if step < STEPS else angle
            good = (np.abs(off) < 1e-8) & (angle >= 0) & (angle < math.pi / 2) & (slope > 0)
            scale = np.where(bent > 1e-12, np.tan(angle) / np.maximum(bent, 1e-12), 1.0)
        scale = np.where(good, scale, np.nan)
        return x * scale, y * scale


def _polynomial(coefficients, squared):
    """Return 1 + c0 s + c1 s^2 + ... of s = `squared`."""
    total = np.zeros_like(np.asarray(squared, np.float64))
    for c in reversed(coefficients):
        total = (total + c) * squared
    return 1 + total


def lens_of(text):
    """Return the `Lens` that a text such as opencv:-0.2,0.05,0,0 names."""
    model, _, numbers = text.partition(":")
    try:
        values = tuple(float(number) for number in numbers.split(","))
    except ValueError:
        raise ParameterError(
            f"lens is {text!r}; it must be opencv:k1,k2,p1,p2[,k3], fisheye:k1,k2,k3,k4, "
            "division:k or eucm:alpha,beta"
        ) from None
    return Lens(model, values)


@dataclass(frozen=True)
class LensWarp:
    """Where each pixel of a distorted picture lies in the pinhole picture it is warped from."""

    camera: object  # the distorted picture's size, focal lengths, principal point and pose
    lens: Lens
    wide: object  # the pinhole camera whose picture is wide enough
    u: np.ndarray  # (height, width), float64, px: image points in the wide picture, with `v`
    v: np.ndarray
    farthest: float  # tangent of the angle off the axis of the picture's farthest ray

    def colors(self, picture):
        """Return the distorted picture of 8-bit colours, interpolated bilinearly."""
        return np.rint(self.light(picture.astype(np.float32))).astype(np.uint8)

    def light(self, picture):
        """Return the distorted picture of numbers with channels, interpolated bilinearly."""
        i, j, a, b = self._between(picture)
        top = picture[j, i] * (1 - a) + picture[j, i + 1] * a
        bottom = picture[j + 1, i] * (1 - a) + picture[j + 1, i + 1] * a
        return top * (1 - b) + bottom * b

    def _between(self, picture):
        """Return column and row of the first of each four pixels, and the shares of the others."""
        height, width = picture.shape[:2]
        x, y = np.clip(self.u - 0.5, 0, width - 1), np.clip(self.v - 0.5, 0, height - 1)
        i, j = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
        return i, j, (x - i)[..., None], (y - j)[..., None]

    def nearest(self, values):
        """Return the distorted picture of ids, depths or shares: that of the nearest pixel."""
        height, width = values.shape[:2]
        column = np.clip(self.u.astype(np.int64), 0, width - 1)
        row = np.clip(self.v.astype(np.int64), 0, height - 1)
        return values[row, column]

    def flow(self, flow, mask, after=None):
        """Return flow and mask of the distorted picture.

        `flow` is that of the wide picture [px], `mask` as `rainsim.render.labels.flow_of` has it,
        `after` the warp of the next frame, by default this one.
        """
        after = self if after is None else after
        lens, wide = after.lens, after.wide
        i, j, *_ = self._between(flow)
        corners = np.stack([flow[j, i], flow[j, i + 1], flow[j + 1, i], flow[j + 1, i + 1]])
        there = self.nearest(flow)
        apart, length = np.ptp(corners, axis=0).max(-1), np.abs(there).max(-1)
        same = apart <= ALIKE + ALIKE_SHARE * length
        there = np.where(same[..., None], self.light(flow), there)
        x, y = slopes(wide, self.u + there[..., 0], self.v + there[..., 1])
        p, q = lens.distort(x, y)
        u, v = image_point(after.camera, p, q, 1.0)
        row, column = np.mgrid[: self.camera.height, : self.camera.width] + 0.5
        found = np.stack([u - column, v - row], axis=-1).astype(np.float32)
        kept = self.nearest(mask).copy()
        outside = (u < 0) | (v < 0) | (u >= after.camera.width) | (v >= after.camera.height)
        kept[outside & (kept != NO_FLOW)] = OUTSIDE
        # The lens puts such a ray nowhere, or back into the picture, or nobody knows where: the
        # polynomial holds where the picture is, and leads thousands of pixels out far beyond.
        kept[np.hypot(x, y) > min(lens.reach, BEYOND * after.farthest)] = NO_FLOW
        found[kept == NO_FLOW] = 0
        return found, kept


def lens_warp(camera, lens):
    """Return the `LensWarp` of a camera with a lens; its wide picture is as fine in the middle.

    ParameterError if the lens sees farther off the axis than a pinhole picture can be drawn, or if
    a pixel of the picture belongs to no ray of the lens.
    """
    row, column = np.mgrid[: camera.height, : camera.width] + 0.5
    x, y = lens.undistort(*slopes(camera, column, row))
    if not np.isfinite(x).all():
        share = np.mean(~np.isfinite(x))
        raise ParameterError(
            f"{share:.1%} of the picture's pixels belong to no ray of the lens {lens.model} "
            f"{lens.values}; each must have one; {REMEDY}"
        )
    farthest = float(np.hypot(x, y).max())
    if farthest > WIDEST:
        raise ParameterError(
            f"the lens sees {math.degrees(math.atan(farthest)):.0f} degrees off its axis; it must "
            f"be at most 80, which a pinhole picture can hold; {REMEDY}"
        )
    left, top = math.floor(x.min() * camera.fx) - 1, math.floor(y.min() * camera.fy) - 1
    right, bottom = math.ceil(x.max() * camera.fx) + 1, math.ceil(y.max() * camera.fy) + 1
    width, height = right - left, bottom - top
    if max(width, height) > MOST_SIDE:
        raise ParameterError(
            f"the pinhole picture behind the lens would have {width} x {height} px; it must have "
            f"at most {MOST_SIDE} a side; give a smaller --width"
        )
    wide = replace(camera, width=width, height=height, cx=float(-left), cy=float(-top))
    return LensWarp(camera, lens, wide, *image_point(wide, x, y, 1.0), farthest)
