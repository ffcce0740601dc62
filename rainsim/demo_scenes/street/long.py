"""A street of any length: the built-in street's parts, laid out by a seed, with side streets.

It is made piece by piece, so that a kilometre need never be in memory at once.
"""

import itertools
from functools import partial

import numpy as np

from rainsim.demo_scenes.bicycle.backdrop import sky_cloud
from rainsim.demo_scenes.build import Noise, join, moved
from rainsim.demo_scenes.street import cars, facades, footway, furniture, road
from rainsim.demo_scenes.street.layout import AFTER, SIDE_FACADE, SIDE_REACH, long_layout

PIECE = 20.0  # m
WALLS = 0.17  # m, distance of the splats at the foot of a wall
FRONT = 7.8  # m of street that a house takes, about
LEAVES = 10  # fallen leaves per metre
SKY_SPLATS, SKY_BEYOND = 3600, 110.0  # m that the sky is farther away than the ends of the street


class LongStreet:
    """A street of a length; the same arrays every time.

    The length [m] goes from the first place of the drive to the end of the street, `drive` [m] is
    the drive's own. leaves(noise, rng, count, first, last, layout) returns the `Cloud` of fallen
    leaves.
    """

    def __init__(self, length, seed, leaves):
        shapes = cars.HATCH, cars.SALOON, cars.VAN
        self.layout, self._standing = long_layout(length, seed, shapes)
        self.drive = length - AFTER
        self._seed, self._leaves = seed, leaves
        self.noise = Noise(np.random.Generator(np.random.PCG64(seed)))
        self._houses = list(self._plots())

    def pieces(self):
        """Yield the street as `Cloud` pieces in order, then the houses at its ends and the sky."""
        edges = self._edges()
        fronts = [list(self._fronts(*edge)) for edge in edges]
        for k, edge in enumerate(edges):
            near = itertools.chain(*fronts[max(k - 1, 0) : k + 2])
            glows = np.array([glow for _, rows in near for glow in rows]).reshape(-1, 4)
            yield self._piece(k, *edge, glows, fronts[k])
        yield self._closing()
        length = self.layout.ends[1] - self.layout.ends[0]
        sky = sky_cloud(self.noise, SKY_SPLATS, 0.5 * length + SKY_BEYOND)
        yield moved(sky, np.eye(3), (0.5 * (self.layout.ends[0] + self.layout.ends[1]), 0, 0))

    def bed_height(self):
        """Return the function of x and y [m] that gives the height of the ground."""
        return partial(road.bed_height, noise=self.noise, layout=self.layout)

    def _rng(self, *key):
        return np.random.Generator(np.random.PCG64((self._seed, *key)))

    def _edges(self):
        """Return (first, last) of each piece; a side street lies within one."""
        first, last = self.layout.ends
        cuts = [x for x in np.arange(first + PIECE, last - 0.5 * PIECE, PIECE)
                if not self.layout.beside_side_street(x, SIDE_FACADE + 1)]  # fmt: skip
        cuts = [first, *map(float, cuts), last]
        return list(itertools.pairwise(cuts))

    def _piece(self, number, first, last, windows, fronts):
        """Return the street from x = `first` to `last` with the houses that begin there."""
        rng, noise = self._rng(1, number), self.noise
        layout, standing = self.layout.piece(first, last), self._standing.piece(first, last)
        near = self._standing.piece(first - 5, last + 5)
        light = road.ground_light(cars.footprints(near.cars), self.layout)
        glows = np.concatenate(
            [windows, cars.lamp_glows(near.cars), furniture.lamp_glows(near.lamps)]
        )
        ground = [
            road.road_cloud(noise, rng, layout), footway.footway_cloud(noise, rng, layout),
            self._leaves(noise, rng, round(LEAVES * (last - first)), first, last, layout),
        ]  # fmt: skip
        parts = [road.lit_ground(join(ground), light, glows), *(front for front, _ in fronts)]
        if standing.cars:
            parts.append(cars.parked_cars(rng, standing.cars, (first - 1, last), 0.048))
        parts += furniture.lamps_and_bollards(standing.lamps, standing.bollards, (first, last))
        parts += [furniture.tree(*tree, rng) for tree in standing.trees]
        return join(parts)

    def _plots(self):
        """Yield each house's number, x of its piece, `Wall`, width, storeys and style."""
        rng, number = self._rng(2), 0
        first, last = self.layout.ends
        for side in (-1, 1):
            for edge, stop in self.layout.between((first, last), self.layout.sides, SIDE_FACADE):
                style = int(rng.integers(0, 8))
                for x, width in _row_of_houses(edge, stop, rng):
                    wall = partial(facades.Wall, (x, side * road.FACADE), (1, 0), (0, -side), WALLS)
                    style = (style + int(rng.integers(1, 4))) % 8
                    yield number, x, wall, width, int(rng.integers(2, 4)), style
                    number += 1
            for street in self.layout.sides:
                for out in (-1, 1):
                    style = int(rng.integers(0, 8))
                    low, high = sorted((side * road.FACADE, side * SIDE_REACH))
                    for y, width in _row_of_houses(low, high, rng):
                        away = max(min(abs(y), abs(y + width)) - road.FACADE, 0)
                        corner = street - out * SIDE_FACADE, y
                        spacing = 1.2 * WALLS + 0.008 * away
                        wall = partial(facades.Wall, corner, (0, 1), (out, 0), spacing)
                        style = (style + int(rng.integers(1, 4))) % 8
                        yield number, street, wall, width, int(rng.integers(2, 4)), style
                        number += 1
                corner = street - 9, side * (SIDE_REACH + 4)
                wall = partial(facades.Wall, corner, (1, 0), (0, -side), 0.4)
                yield number, street, wall, 18.0, 3, int(rng.integers(0, 8))
                number += 1

    def _fronts(self, first, last):
        """Yield (Cloud, glows) of the houses of a piece; glows are x, y, reach [m], strength."""
        for number, x, wall, width, storeys, style in self._houses:
            if first <= x < last:
                made = wall()
                front, warm = facades.house(
                    made, width, storeys, style, self.noise, self._rng(4, number)
                )
                rows = [made.at(np.array([u]), 0, 0.6)[0] for u, _ in warm]
                yield front, [(*row[:2], 1.5, w) for row, (_, w) in zip(rows, warm, strict=True)]

    def _closing(self):
        """Return the houses that close both ends of the street."""
        rng, parts, style = self._rng(5), [], 0
        first, last = self.layout.ends
        for x, out in ((last + 7, -1), (first - 5, 1)):
            for y in (-18.0, -9.0, 0.0, 9.0):
                wall = facades.Wall((x, y), (0, 1), (out, 0), 0.3)
                style = (style + int(rng.integers(1, 4))) % 8
                parts.append(facades.house(wall, 9.0, 3, style, self.noise, rng)[0])
        return join(parts)


def _row_of_houses(first, last, rng):
    """Yield where houses begin and their widths, which fill a stretch of a street exactly."""
    count = max(1, round((last - first) / FRONT))
    share = rng.uniform(0.8, 1.2, count)
    edges = first + np.concatenate([[0], np.cumsum(share)]) * (last - first) / share.sum()
    for x, end in itertools.pairwise(edges):
        yield float(x), float(end - x)
