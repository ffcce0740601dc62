"""The choices that trade accuracy of splatting for time, each as a rasterizer of its own."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.variants import variant
from rainsim.jit import device_function, intrinsic, ir, types
from rainsim.raster import prepare, select
from rainsim.scene.types import Splats
from rainsim.splatting.lanes import EXP2
from rainsim.splatting.prepared import LANES, morton_order
from rainsim.splatting.project import color_chunk


@dataclass(frozen=True)
class Choice:
    """One way to draw, of a group of alternatives."""

    name: str
    changes: dict = field(default_factory=dict)  # of `rainsim.raster`, see `variants.variant`
    options: dict = field(default_factory=dict)  # of `Rasterizer.draw`
    adapt: object = None  # adapt(splats, prepared) returns what is drawn instead of `prepared`
    default: bool = False  # whether it is what the rasterizer does

    def rasterizer(self, splats, prepared):
        """Return a Rasterizer that draws as this choice says."""
        drawn = self.adapt(splats, prepared) if self.adapt else prepared
        return variant(**self.changes).Rasterizer(drawn)


def polynomial(degree, lowest=-1.02):
    """Return the coefficients of 2^x on [lowest, 0] by Chebyshev interpolation, constant first."""
    chebyshev = np.polynomial.chebyshev.Chebyshev
    fit = chebyshev.interpolate(lambda x: 2.0**x, degree, [lowest, 0.0])
    return tuple(map(float, fit.convert(kind=np.polynomial.Polynomial).coef))


def all_choices():
    """Return {group: [Choice, ...]}, the cheapest first."""
    ours = Choice("", default=True)
    degree = len(EXP2) - 1
    stops = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    thresholds = (32, 64, 128, 255, 1024)
    return {
        "polynomial of 2^x": [
            replace(ours, name=f"degree {d}") if d == degree
            else Choice(f"degree {d}", {"EXP2": polynomial(d)})
            for d in (2, 3, 4, 5, 6)
        ],
        "cut-off of a splat": [
            replace(ours, name=f"1/{n}") if n == 255
            else Choice(f"1/{n}", {"MIN_ALPHA_LOG2": np.float32(-np.log2(n)),
                                   "EXP2": polynomial(degree + (n > 255), -np.log2(n) / 7.8)})
            for n in thresholds
        ],
        "stop": [
            *(replace(ours, name=f"{t:g}") if t == 1e-4
              else Choice(f"{t:g}", {"TRANSMITTANCE_STOP": np.float32(t)}) for t in stops),
            Choice("never", {"TRANSMITTANCE_STOP": np.float32(-1)}),
            Choice("training codes", options={"drop_last": True}),
        ],
        "storage of harmonics": [
            Choice("half precision", {"color_chunk": color_half}, adapt=in_halves),
            replace(ours, name="degree 2 and 3 in 16 bits"),
            Choice("32 bits", adapt=in_floats),
        ],
        "degree of harmonics": [
            *(Choice(f"{d}", options={"degree": d}) for d in (0, 1, 2)),
            replace(ours, name="all"),
        ],
        "level of detail": [
            Choice("pairs merged", adapt=lambda splats, prepared: prepare(merge_pairs(splats))),
            *(Choice(f"{share:.0%} kept", adapt=_keeping(share)) for share in (0.5, 0.75, 0.9)),
            replace(ours, name="all"),
        ],
        "depth": [
            replace(ours, name="expected"),
            Choice("median", options={"depth": "median"}),
            Choice("expected, with hits", options={"hit": True}),
        ],
    }  # fmt: skip


# --- harmonics in 16 bits -------------------------------------------------------------------------


@intrinsic
def from_half(typingctx, bits):
    """Return the float32 of a number of half precision, given as uint16."""

    def codegen(context, builder, signature, arguments):
        half = builder.bitcast(arguments[0], ir.HalfType())
        return builder.fpext(half, ir.FloatType())

    return types.float32(types.uint16), codegen


def in_floats(splats, prepared):
    """Return the prepared splats with all harmonics in float32."""
    coarse = prepared.sh.shape[1] // LANES
    values = splats.sh.reshape(len(splats), -1)[prepared.order, coarse:]
    padded = np.zeros((len(prepared.sh) * LANES, values.shape[1]), np.float32)
    padded[: len(values)] = values
    rows = padded.reshape(len(prepared.sh), LANES, -1).transpose(0, 2, 1)
    fine = np.ascontiguousarray(rows).reshape(len(rows), -1)
    return replace(prepared, fine=fine, step=np.ones_like(prepared.step))


def in_halves(splats, prepared):
    """Return the prepared splats with all harmonics in half precision, as uint16."""
    full = in_floats(splats, prepared)
    sh, fine = (a.astype(np.float16).view(np.uint16) for a in (full.sh, full.fine))
    return replace(full, sh=sh, fine=fine)


@device_function
def color_half(g, sh, fine, step, eye, orthographic, bands, s):
    """Twin of `color_chunk` for harmonics in half precision, see `in_halves`."""
    low, high = np.empty(len(sh), np.float32), np.empty(len(fine), np.float32)
    for i in range(len(low)):
        low[i] = from_half(sh[i])
    for i in range(len(high)):
        high[i] = from_half(fine[i])
    color_chunk(g, low, high, step, eye, orthographic, bands, s)


# --- fewer splats ---------------------------------------------------------------------------------


def _keeping(share):
    """Return a function that keeps the share of splats with most opacity times area."""

    def adapt(splats, prepared):
        weight = (splats.opacity * _area(splats.scale))[prepared.order]
        return select(prepared, weight >= np.quantile(weight, 1 - share))

    return adapt


def _area(scale):
    """Return the product of the two largest scales."""
    return np.prod(np.sort(scale, axis=1)[:, 1:], axis=1)


def merge_pairs(splats):
    """Return half as many splats: each pair of neighbours on a Morton curve merged to one.

    A merged splat has the mean, covariance and mean harmonics of its two, weighted with opacity
    times area, and the opacity with which it covers as much as both.
    """
    order = morton_order(splats.position)
    order = order[: len(order) // 2 * 2].reshape(-1, 2)
    weight = (splats.opacity * _area(splats.scale)).astype(float)[order]
    weight = np.maximum(weight, np.finfo(np.float32).tiny)
    share = (weight / weight.sum(axis=1, keepdims=True))[..., None]
    position = splats.position.astype(float)[order]
    middle = (share * position).sum(axis=1)
    apart = position - middle[:, None]
    spread = _covariance(splats.rotation, splats.scale)[order]
    spread = spread + apart[..., :, None] * apart[..., None, :]
    value, axes = np.linalg.eigh((share[..., None] * spread).sum(axis=1))
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    scale = np.sqrt(np.maximum(value, 0))
    opacity = np.minimum(weight.sum(axis=1) / np.maximum(_area(scale), 1e-30), 1)
    sh = (share[..., None] * splats.sh[order]).sum(axis=1)
    rotation = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    parts = middle, rotation, scale, opacity, sh
    return Splats(*(np.ascontiguousarray(part, np.float32) for part in parts))


def _covariance(rotation, scale):
    turn = Rotation.from_quat(rotation, scalar_first=True).as_matrix()
    half = turn * scale[:, None, :]
    return half @ half.transpose(0, 2, 1)
