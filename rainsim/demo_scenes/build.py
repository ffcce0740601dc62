"""Build scenes out of splats: noise, light from an overcast sky, and surfaces covered with splats.

Everything here is in metres with z up. A `Cloud` is a set of splats in the making: `join` puts
clouds together and `to_splats` takes the finished one to a capture frame.
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from rainsim.constants import SH_0, SH_1
from rainsim.scene.types import GroundFrame, Splats

OVERLAP = 0.64  # deviation of a surface splat over its cell: closed, but not blurred
THIN = 4e-4  # m, deviation of a surface splat along its normal
DISPLAY_GAMMA = 2.2  # light scales linear colour, colours are stored display-referred
LATTICE = 32  # cells of the periodic noise lattice, each way


@dataclass(frozen=True, slots=True)
class Cloud:
    """Splats in the making, arrays (n, ...), float32."""

    position: np.ndarray  # (n, 3), m
    axes: np.ndarray  # (n, 3, 3), row k is own axis k, unit; row 2 a surface splat's normal
    scale: np.ndarray  # (n, 3), m, standard deviations along the own axes
    colour: np.ndarray  # (n, 3), display-referred
    opacity: np.ndarray
    sheen: np.ndarray  # how much brighter the splat is when seen along its surface than head-on

    def __len__(self):
        return len(self.position)

    @property
    def normal(self):
        """Third own axis of each splat, ndarray of shape (n, 3)."""
        return self.axes[:, 2]


class Noise:
    """Smooth periodic noise in space with zero mean, about -1 to 1, from a random generator."""

    def __init__(self, rng):
        self._lattice = rng.uniform(-1, 1, (LATTICE,) * 3).astype(np.float32)

    def __call__(self, points, wavelength, octaves=3):
        """Return the noise at points of shape (n, 2) or (n, 3) [m], ndarray of shape (n,), float32.

        `wavelength` [m] is the size of the largest features, for all axes or for each. Of the
        `octaves` that are added each has half the wavelength and 0.55 of the amplitude of the one
        before; the first has amplitude 1.
        """
        points = np.asarray(points, np.float32) / np.asarray(wavelength, np.float32)
        coordinates = np.zeros((3, len(points)), np.float32)
        coordinates[: points.shape[1]] = points.T
        total, amplitude = np.zeros(len(points), np.float32), 1.0
        for octave in range(octaves):
            cell = coordinates * 2.0**octave + 7.31 * octave  # shifted: octaves must not align
            base = np.floor(cell)
            smooth = cell - base
            smooth = smooth * smooth * (3 - 2 * smooth)
            total += amplitude * map_coordinates(
                self._lattice, base + smooth, order=1, mode="grid-wrap", output=np.float32
            )
            amplitude *= 0.55
        return total


def unit(vectors):
    """Return `vectors` of shape (..., 3) scaled to length one."""
    vectors = np.asarray(vectors, np.float32)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, np.float32(1e-12))  # a zero vector stays zero


def axes_from(first, third):
    """Return right-handed axes of shape (n, 3, 3): `third` kept, `first` made square to it."""
    third = unit(third)
    first = np.broadcast_to(np.asarray(first, np.float32), third.shape)
    first = first - third * np.sum(first * third, axis=1, keepdims=True)
    lost = np.linalg.norm(first, axis=1) < 1e-4  # parallel to the normal: any direction will do
    if lost.any():
        other = np.where(np.abs(third[lost, :1]) < 0.8, [[1.0, 0, 0]], [[0, 1.0, 0]])
        first[lost] = np.cross(third[lost], other)
    first = unit(first)
    return np.stack([first, np.cross(third, first), third], axis=1).astype(np.float32)


def discs(
    position, normal, colour, size, *, along=(1, 0, 0), thickness=THIN, opacity=0.97, sheen=0
):
    """Return flat splats, whose deviations `size` [m] lie in the plane, the first `along`."""
    position = np.ascontiguousarray(position, np.float32)
    n = len(position)
    size = np.asarray(size, np.float32)
    scale = np.empty((n, 3), np.float32)
    scale[:, :2] = size if size.ndim == 2 else np.broadcast_to(size, (n,))[:, None]
    scale[:, 2] = thickness
    return Cloud(
        position,
        axes_from(along, np.broadcast_to(np.asarray(normal, np.float32), (n, 3))),
        scale,
        np.broadcast_to(np.asarray(colour, np.float32), (n, 3)).copy(),
        np.broadcast_to(np.float32(opacity), (n,)).copy(),
        np.broadcast_to(np.float32(sheen), (n,)).copy(),
    )


def strands(
    position, direction, colour, length, width, *, normal=(0, 0, 1), flat=1.0, opacity=0.95
):
    """Return elongated splats of deviations `length`, `width` [m]; `flat` is thickness."""
    n = len(position)
    size = np.empty((n, 2), np.float32)
    size[:, 0], size[:, 1] = length, width
    direction = unit(np.broadcast_to(np.asarray(direction, np.float32), (n, 3)))
    side = np.cross(direction, np.broadcast_to(np.asarray(normal, np.float32), (n, 3)))
    side[np.linalg.norm(side, axis=1) < 1e-3] = (0.6, 0.8, 0)
    return discs(
        position, np.cross(side, direction), colour, size,
        along=direction, thickness=size[:, 1] * flat, opacity=opacity,
    )  # fmt: skip


def line(points, colour, width, *, piece=0.06, opacity=0.95):
    """Return strands along a polyline: `width` a deviation, `piece` the length of a cell [m]."""
    points = np.asarray(points, np.float32)
    middle, direction, length, _ = _resample(points, piece)
    return strands(middle, direction, colour, length * OVERLAP, width, opacity=opacity)


def _resample(points, piece):
    """Cut a polyline: centres, directions, lengths, and the parameter of each centre in points."""
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    pieces = np.maximum(1, np.round(length / piece)).astype(int)
    segment = np.repeat(np.arange(len(step)), pieces)
    within = (np.arange(len(segment)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / (
        pieces[segment]
    )
    middle = points[segment] + step[segment] * within[:, None]
    return middle, unit(step)[segment], (length / pieces)[segment], segment + within


def tube(points, radius, colour, *, piece=0.025, around=8, sheen=0.0, opacity=0.97, squash=1.0):
    """Return a round tube along a polyline, its surface covered with splats.

    piece : float [m]. Length of one splat's cell.
    squash : float. Height over width of the cross-section (its height is square
        to the sideways direction).
    """
    points = np.asarray(points, np.float32)
    radius = np.broadcast_to(np.asarray(radius, np.float32), (len(points),))
    middle, direction, length, parameter = _resample(points, piece)
    radius = np.interp(parameter, np.arange(len(points)), radius).astype(np.float32)
    sideways = np.cross(direction, (0, 0, 1.0))
    upright = np.linalg.norm(sideways, axis=1) < 0.1
    sideways[upright] = np.cross(direction[upright], (0, 1.0, 0))
    sideways = unit(sideways)
    up = np.cross(sideways, direction)
    # every other ring is turned by half a cell, so that gaps do not line up
    turn = (np.arange(around)[None] + 0.5 * (np.arange(len(middle)) % 2)[:, None]) * (
        2 * np.pi / around
    )
    cos, sin = np.cos(turn)[..., None], np.sin(turn)[..., None]
    outward = (cos * sideways[:, None] + sin * up[:, None] * squash) * radius[:, None, None]
    normal = cos * sideways[:, None] * squash + sin * up[:, None]
    size = np.empty((len(middle), around, 2), np.float32)
    size[..., 0] = (length * OVERLAP)[:, None]
    size[..., 1] = (radius * (2 * np.pi / around) * OVERLAP)[:, None]
    return discs(
        (middle[:, None] + outward).reshape(-1, 3), normal.reshape(-1, 3), colour,
        size.reshape(-1, 2), along=np.repeat(direction, around, axis=0),
        thickness=np.minimum(THIN, np.repeat(radius, around) * 0.2), opacity=opacity, sheen=sheen,
    )  # fmt: skip


def grid(*along):
    """Return the coordinates of all places of a grid, by its coordinates along each axis."""
    return (values.ravel() for values in np.meshgrid(*along))


def cells(length, spacing, edge=0.45):
    """Cut `length` [m] into cells, narrower at both ends: centres and widths, (n,) each."""
    inner = max(1, round((length - 2 * edge * spacing) / spacing))
    inner_width = (length - 2 * edge * spacing) / inner
    if inner_width <= 0:
        return np.array([length / 2]), np.array([length])
    width = np.concatenate([[edge * spacing], np.full(inner, inner_width), [edge * spacing]])
    return np.cumsum(width) - width / 2, width


def box(centre, half, colour, *, spacing=0.03, along=0, stretch=2.0, axes=None, sheen=0.0):
    """Return the six faces of a box.

    centre, half : array_like of shape (3,) [m]. Centre, and half of the side
        along each axis.
    spacing : float [m]. Cell size across the grain; along axis number `along` it
        is `stretch` times larger.
    """
    half = np.asarray(half, np.float32)
    axes = np.eye(3, dtype=np.float32) if axes is None else np.asarray(axes, np.float32)
    parts = []
    for third in range(3):
        first, second = [k for k in range(3) if k != third]
        steps = [
            min(spacing * (stretch if k == along else 1), 2 * half[k]) for k in (first, second)
        ]
        a, da = cells(2 * half[first], steps[0])
        b, db = cells(2 * half[second], steps[1])
        local = np.zeros((len(a), len(b), 3), np.float32)
        local[..., first] = (a - half[first])[:, None]
        local[..., second] = (b - half[second])[None]
        size = np.stack(np.broadcast_arrays(da[:, None], db[None]), axis=-1) * OVERLAP
        for side in (-1, 1):
            local[..., third] = side * half[third]
            parts.append(
                discs(
                    local.reshape(-1, 3) @ axes + np.asarray(centre, np.float32),
                    side * axes[third], colour, size.reshape(-1, 2),
                    along=axes[first], sheen=sheen,
                )
            )  # fmt: skip
    return join(parts)


def join(clouds):
    """Return one cloud of all `clouds`, in their order."""
    clouds = list(clouds)
    return Cloud(*(np.concatenate([getattr(c, name) for c in clouds]) for name in Cloud.__slots__))


def moved(cloud, rotation, translation=(0, 0, 0)):
    """Return the cloud turned by a 3 x 3 `rotation` and shifted by `translation` [m]."""
    rotation = np.asarray(rotation, np.float32)
    return replace(
        cloud,
        position=cloud.position @ rotation.T + np.asarray(translation, np.float32),
        axes=cloud.axes @ rotation.T,
    )


def replace_colour(cloud, colour, position=None):
    """Return the cloud with other colours (n, 3) and, if given, other positions (n, 3)."""
    position = cloud.position if position is None else np.asarray(position, np.float32)
    return replace(cloud, colour=np.asarray(colour, np.float32), position=position)


def tinted(cloud, factor):
    """Return the cloud with its colours multiplied by `factor`, broadcast to (n, 3)."""
    factor = np.asarray(factor, np.float32)
    factor = factor[:, None] if factor.ndim == 1 else factor
    return replace(cloud, colour=cloud.colour * factor)


def lit(cloud, light):
    """Return the cloud with its linear colours multiplied by `light` of shape (n,)."""
    return tinted(cloud, np.maximum(light, 1e-3).astype(np.float32) ** (1 / DISPLAY_GAMMA))


def polished(cloud, gloss):
    """Return the cloud with a soft sky reflection on splats that face upwards."""
    up = cloud.normal[:, 2:]
    glint = np.float32(gloss) * np.clip((up - 0.35) / 0.65, 0, 1) ** 2
    return replace(cloud, colour=cloud.colour + glint * (np.float32(0.93) - cloud.colour))


def turn_about(axis, angle):
    """Return the 3 x 3 rotation by `angle` [rad] about the unit vector `axis` (Rodrigues)."""
    axis = np.asarray(axis, np.float64)  # float32 would leave frames a little off square
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def spiral(z):
    """Return unit directions (n, 3) at heights z (n,) that rise evenly: even in solid angle."""
    turn = (np.arange(len(z)) + 0.5) * np.pi * (3 - np.sqrt(5))  # golden angle: no two line up
    r = np.sqrt(np.clip(1 - z * z, 0, 1))
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def sky_directions(count=64):
    """Return `count` unit directions over the upper half space, even in solid angle."""
    return spiral((np.arange(count) + 0.5) / count).astype(np.float32)


def sky_share(points, boxes, directions):
    """Return the share of an overcast sky's light that `boxes` let through to level ground, (n,).

    `points` are places [m]; rows of `boxes` are the low and the high corner [m] and how much of the
    light through the box it takes, 0 to 1; `directions` are those of `sky_directions`.
    """
    inverse = 1 / np.where(np.abs(directions) < 1e-6, np.float32(1e-6), directions)
    passed = np.ones((len(points), len(directions)), np.float32)
    for low, high, taken in ((b[:3], b[3:6], b[6]) for b in np.asarray(boxes, np.float32)):
        near = np.full(passed.shape, 1e-3, np.float32)
        far = np.full(passed.shape, np.inf, np.float32)
        for axis in range(3):
            at = points[:, axis, None]
            a = (low[axis] - at) * inverse[:, axis]
            b = (high[axis] - at) * inverse[:, axis]
            np.maximum(near, np.minimum(a, b), out=near)
            np.minimum(far, np.maximum(a, b), out=far)
        passed[near < far] *= 1 - taken
    weight = directions[:, 2] * (1 + 2 * directions[:, 2])  # CIE overcast sky on level ground
    return passed @ (weight / weight.sum())


def quaternions(matrices):
    """Return unit quaternions (n, 4), w first, of rotation matrices (n, 3, 3)."""
    m = np.asarray(matrices, np.float64)
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    squares = np.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], 1)
    pairs = {
        (0, 1): m[:, 2, 1] - m[:, 1, 2], (0, 2): m[:, 0, 2] - m[:, 2, 0],
        (0, 3): m[:, 1, 0] - m[:, 0, 1], (1, 2): m[:, 1, 0] + m[:, 0, 1],
        (1, 3): m[:, 0, 2] + m[:, 2, 0], (2, 3): m[:, 2, 1] + m[:, 1, 2],
    }  # fmt: skip
    products = np.empty((len(m), 4, 4))  # 4 q_a q_b; the row of the largest entry is well scaled
    products[:, range(4), range(4)] = squares
    for (a, b), value in pairs.items():
        products[:, a, b] = products[:, b, a] = value
    rows = products[np.arange(len(m)), np.argmax(squares, axis=1)]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def tilted_frame(tilt, meters_per_unit, origin):
    """Return the true ground frame of a generated scene: tilted, not metric, origin off the ground.

    `tilt` [rad] is about x, y and z, `origin` [m] where the capture frame has its origin.
    """
    x, y, z = tilt
    rotation = turn_about((0, 0, 1), z) @ turn_about((0, 1, 0), y) @ turn_about((1, 0, 0), -x)
    return GroundFrame(
        rotation, meters_per_unit, origin,
        notes=("up, plane and scale are exact: the scene was generated with them",),
    )  # fmt: skip


def content_hash(splats):
    """Return the SHA-256 of generated splats, used where a capture has the hash of its file."""
    digest = hashlib.sha256()
    for array in (splats.position, splats.rotation, splats.scale, splats.opacity, splats.sh):
        digest.update(array.tobytes())
    return digest.hexdigest()


def to_splats(cloud, ground_frame: GroundFrame):
    """Take a cloud of the ground frame to the capture frame, with colours of SH degree 1."""
    to_capture = ground_frame.rotation.T
    axes = cloud.axes.astype(np.float64) @ to_capture.T
    sh = np.zeros((len(cloud), 4, 3), np.float32)
    # colour + sheen * (1/2 + direction . normal), brighter where direction . normal is near 0
    sheen = cloud.sheen[:, None] * cloud.colour
    sh[:, 0] = (cloud.colour + 0.5 * sheen - 0.5) / SH_0
    for k, (axis, sign) in enumerate(((1, -1), (2, 1), (0, -1)), start=1):
        sh[:, k] = sign / SH_1 * axes[:, 2, axis, None] * sheen
    return Splats(
        np.ascontiguousarray(ground_frame.to_capture(cloud.position), np.float32),
        quaternions(axes.transpose(0, 2, 1)).astype(np.float32),
        np.ascontiguousarray(cloud.scale / ground_frame.meters_per_unit, np.float32),
        cloud.opacity,
        sh,
    )
