"""Shapes of a made-up garden: meshes for a path tracer, and the places of splats on them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Mesh:
    """Triangles of one part of a garden."""

    vertices: np.ndarray  # (n, 3), m
    faces: np.ndarray  # (m, 3), int, counter-clockwise seen from outside
    albedo: np.ndarray  # (n, 3)
    normals: np.ndarray | None = None  # (n, 3); None: the faces are flat


@dataclass(frozen=True)
class Spots:
    """Places of splats on a part, arrays (n, 3) or (n,)."""

    position: np.ndarray  # m
    normal: np.ndarray  # unit
    along: np.ndarray  # unit, the splat's first axis
    spacing: np.ndarray  # m, of neighbours; negative: the splat is a whole leaf of that half length


@dataclass(frozen=True)
class Picture:
    """Albedo as a picture over a rectangle of two axes, for parts that get a coat of water."""

    albedo: np.ndarray  # (rows, columns, 3), row 0 has the least second coordinate
    bounds: tuple  # m, least and greatest of the first axis, then of the second
    axes: tuple = (0, 1)  # which coordinates the columns and the rows follow

    def texture_coordinates(self, points):
        """Return u, v in [0, 1], shape (n, 2), of points, shape (n, 3)."""
        low_u, high_u, low_v, high_v = self.bounds
        u = (points[:, self.axes[0]] - low_u) / (high_u - low_u)
        return np.stack([u, (points[:, self.axes[1]] - low_v) / (high_v - low_v)], axis=-1)


@dataclass
class Shapes:
    """A garden: meshes, spots and pictures by part, in the order in which they were added."""

    meshes: dict = field(default_factory=dict)
    spots: dict = field(default_factory=dict)
    pictures: dict = field(default_factory=dict)

    def add_mesh(self, part, vertices, faces, albedo, normals=None):
        """Add triangles to a part; `albedo` is one for all or one per vertex."""
        vertices = np.asarray(vertices, float)
        albedo = np.broadcast_to(np.asarray(albedo, float), (len(vertices), 3))
        before = self.meshes.get(part)
        if before is not None:
            faces = np.concatenate([before.faces, faces + len(before.vertices)])
            vertices = np.concatenate([before.vertices, vertices])
            albedo = np.concatenate([before.albedo, albedo])
            normals = None if normals is None else np.concatenate([before.normals, normals])
        self.meshes[part] = Mesh(vertices, faces, albedo, normals)

    def add_spots(self, part, position, normal, along, spacing):
        """Add places of splats to a part; normal, along and spacing may be one for all."""
        normal, along = (np.broadcast_to(np.asarray(a, float), position.shape)
                         for a in (normal, along))  # fmt: skip
        spacing = np.broadcast_to(np.asarray(spacing, float), (len(position),))
        self.spots.setdefault(part, []).append(Spots(position, normal, along, spacing))

    def rectangle(self, part, corner, u, v, albedo, spacing):
        """Add the rectangle corner + a u + b v, whose normal is along u x v.

        `albedo` is a colour, or a function of points of shape (n, 3).
        """
        corner, u, v = (np.asarray(a, float) for a in (corner, u, v))
        length_u, length_v = np.linalg.norm(u), np.linalg.norm(v)
        step = max(length_u, length_v)
        if callable(albedo):
            step = max(min(0.05, length_u / 2), 0.02)
        count_u, count_v = (max(2, round(size / step) + 1) for size in (length_u, length_v))
        a, b = np.meshgrid(np.linspace(0, 1, count_u), np.linspace(0, 1, count_v))
        points = corner + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v
        color = albedo(points) if callable(albedo) else albedo
        self.add_mesh(part, points, grid_faces(count_v, count_u), color)
        count_u, count_v = max(1, round(length_u / spacing)), max(1, round(length_v / spacing))
        rng = np.random.default_rng(1)
        a, b = np.meshgrid(
            (np.arange(count_u) + 0.5) / count_u, (np.arange(count_v) + 0.5) / count_v
        )
        a = a.ravel() + rng.uniform(-0.2, 0.2, a.size) / count_u
        b = b.ravel() + rng.uniform(-0.2, 0.2, b.size) / count_v
        normal = np.cross(u, v) / length_u / length_v
        self.add_spots(
            part, corner + a[:, None] * u + b[:, None] * v, normal, u / length_u, spacing
        )

    def box(self, part, low, high, albedo, spacing):
        """Add a box without its underside."""
        (a, b, c), (d, e, f) = low, high
        for corner, u, v in (
            ((a, b, f), (d - a, 0, 0), (0, e - b, 0)),
            ((a, b, c), (0, e - b, 0), (d - a, 0, 0)),
            ((a, b, c), (d - a, 0, 0), (0, 0, f - c)),
            ((d, e, c), (a - d, 0, 0), (0, 0, f - c)),
            ((a, e, c), (0, b - e, 0), (0, 0, f - c)),
            ((d, b, c), (0, e - b, 0), (0, 0, f - c)),
        ):
            self.rectangle(part, corner, u, v, albedo, spacing)

    def tube(self, part, center, radius, low, high, albedo, spacing):
        """Add an upright open cylinder about (x, y) from height `low` to `high`."""
        sides = 48
        turn = np.arange(sides + 1) / sides * 2 * np.pi
        out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
        middle = np.array([*center, 0])
        rim = middle + radius * out
        bottom, top = np.array([0, 0, low]), np.array([0, 0, high])
        points = np.concatenate([rim + bottom, rim + top])
        self.add_mesh(part, points, grid_faces(2, sides + 1), albedo)
        around = max(8, round(2 * np.pi * radius / spacing))
        up = max(1, round((high - low) / spacing))
        turn, z = np.meshgrid(
            (np.arange(around) + 0.5) / around * 2 * np.pi,
            low + (np.arange(up) + 0.5) / up * (high - low),
        )
        normal = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1).reshape(-1, 3)
        position = middle + radius * normal + np.stack([0 * z, 0 * z, z], axis=-1).reshape(-1, 3)
        width = min(spacing, 2 * np.pi * radius / around)
        self.add_spots(part, position, normal, np.cross([0, 0, 1.0], normal), width)

    def disk(self, part, center, radius, height, side, albedo, spacing):
        """Add a level disk that faces up (`side` 1) or down (-1)."""
        rings, sectors = 60, 96
        turn = np.arange(sectors + 1) / sectors * 2 * np.pi
        r, t = np.meshgrid(np.linspace(1e-4, radius, rings), turn, indexing="ij")
        x, y = center
        points = np.stack([x + r * np.cos(t), y + r * np.sin(t), height + 0 * r], axis=-1)
        points = points.reshape(-1, 3)
        faces = grid_faces(rings, sectors + 1)
        color = albedo(points) if callable(albedo) else albedo
        self.add_mesh(part, points, faces[:, ::-1] if side > 0 else faces, color)
        steps = np.arange(-radius, radius + spacing, spacing)
        a, b = np.meshgrid(steps, steps)
        inside = np.hypot(a, b) < radius - 0.2 * spacing
        z = np.full(inside.sum(), height)
        position = np.stack([x + a[inside], y + b[inside], z], axis=-1)
        self.add_spots(part, position, [0, 0, float(side)], [1.0, 0, 0], spacing)

    def ball(self, part, center, radius, albedo, count, spacing):
        """Add a ball with `count` splats."""
        n = 24
        t, f = np.meshgrid(
            np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij"
        )
        out = np.stack([np.sin(t) * np.cos(f), np.sin(t) * np.sin(f), np.cos(t)], axis=-1)
        out, center = out.reshape(-1, 3), np.asarray(center)
        self.add_mesh(part, center + radius * out, grid_faces(n, 2 * n)[:, ::-1], albedo, out)
        out = spiral(count) * [1, 1, -1]  # from the top down
        along = np.cross(out, [0.3, 0.2, 0.9])
        along /= np.linalg.norm(along, axis=1)[:, None]
        self.add_spots(part, center + radius * out, out, along, spacing)

    def leaves(self, part, cards, albedo):
        """Add leaf `cards` (see `leaf_cards`) of one albedo each, and a splat on both sides."""
        count = len(cards.center)
        a = 4 * np.arange(count)
        faces = [np.stack([a, a + 1, a + 2], axis=1), np.stack([a, a + 2, a + 3], axis=1)]
        corners = cards.corners.reshape(-1, 3)
        self.add_mesh(part, corners, np.concatenate(faces), np.repeat(albedo, 4, axis=0))
        for side in (1, -1):
            self.add_spots(part, cards.center, side * cards.normal, cards.along, -cards.half)

    def joined(self):
        """Return all spots in one, the part's number of each, and the parts' names."""
        lots = [(k, lot) for k, lots in enumerate(self.spots.values()) for lot in lots]
        arrays = (
            np.concatenate([getattr(lot, name) for _, lot in lots])
            for name in ("position", "normal", "along", "spacing")
        )
        part = np.concatenate([np.full(len(lot.position), k, np.uint8) for k, lot in lots])
        return Spots(*arrays), part, list(self.spots)


@dataclass(frozen=True)
class Cards:
    """Leaves as flat rhombs: corners (n, 4, 3), centres, normals, long axes, half lengths."""

    corners: np.ndarray
    center: np.ndarray
    normal: np.ndarray
    along: np.ndarray
    half: np.ndarray

    def take(self, which):
        """Return the cards that the mask or index array `which` selects."""
        return Cards(*(a[which] for a in (
            self.corners, self.center, self.normal, self.along, self.half
        )))  # fmt: skip


def leaf_cards(rng, count, low, high, half):
    """Return `count` random leaves with centres in the box `low` to `high`, about `half` m long."""
    center = rng.uniform(low, high, (count, 3))
    along = rng.standard_normal((count, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = np.cross(along, rng.standard_normal((count, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    half = half * rng.uniform(0.7, 1.2, count)[:, None]
    corners = [center - half * along, center + 0.55 * half * across,
               center + half * along, center - 0.55 * half * across]  # fmt: skip
    return Cards(np.stack(corners, axis=1), center, np.cross(along, across), along, half[:, 0])


def grid_faces(rows, columns, keep=None):
    """Return two triangles for each cell of a grid of vertices; `keep` masks the cells."""
    a = np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)
    a = (a if keep is None else a[keep]).ravel()
    return np.concatenate([
        np.stack([a, a + 1, a + columns + 1], axis=1),
        np.stack([a, a + columns + 1, a + columns], axis=1),
    ])  # fmt: skip


def spiral(count, lowest=-1.0):
    """Return `count` even directions, shape (count, 3), on the sphere above the sine `lowest`."""
    k = np.arange(count) + 0.5
    z = lowest + (1 - lowest) * k / count
    turn = k * np.pi * (1 + 5**0.5)
    level = np.sqrt(1 - z**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=-1)
