"""`benchmarks day --remake`: bakes the captures and traces the pictures with Mitsuba."""

from __future__ import annotations

import time

import numpy as np

from benchmarks import day_data
from benchmarks.day_case import TINT
from benchmarks.day_data import HALF, REGIONS, Labels
from benchmarks.day_mitsuba import DULL, SUNNY, Garden, require_mitsuba
from benchmarks.day_shapes import spiral
from rainsim.numerics import srgb
from rainsim.scene.view import pixel_rays

BAKED = 64  # samples of a splat
TRACED = 384  # of a pixel of the main rain; of the others OTHERS of it
OTHERS = 1 / 4
SKY_SAMPLES = 8
SKY_SPLATS, SKY_LOWEST = 9000, -0.05
OPENNESS = 96  # rays of a pixel
OFF, OFF_LEAF = 1e-3, 4e-4  # m in front of a splat, where its light is taken
EXPOSURES = {SUNNY: np.array([1.735, 1.995, 2.285]), DULL: 1.15 / TINT}
MIDDLE = np.array([0.0, 0.0, 1.5])  # from where panes are baked


def remake(cases, folder=day_data.FOLDER, say=lambda line: None, baked=BAKED, traced=TRACED):
    """Bake and trace all cases and write their files to a folder.

    `baked` and `traced` are the samples of a splat and of a pixel.
    """
    mitsuba = require_mitsuba()
    for case in cases:
        start = time.perf_counter()
        shapes, paving = case.build()
        arrays = {"checksum": day_data.checksum(shapes.joined()[0])}
        for day in (SUNNY, DULL):
            garden = Garden(mitsuba, case, shapes, paving, day)
            colors, sky = bake(garden, shapes, EXPOSURES[day], baked)
            arrays[day] = day_data.pack_colors(colors)
            arrays[f"{day} sky"] = day_data.pack_colors(sky)
            say(f"{case.name}: {day} baked, {time.perf_counter() - start:.0f} s")
            if day == SUNNY:
                arrays |= _labels(case, garden, paving)
        for rain in case.rains:
            for mirrors in (True, False) if rain.gloss else (True,):
                garden = Garden(mitsuba, case, shapes, paving, rain, mirrors)
                for view in rain.views:
                    camera = small(case.cameras()[view])
                    main = mirrors and rain is case.rains[0]
                    samples = traced if main else round(OTHERS * traced)
                    light, error = garden.picture(camera, samples)
                    name = f"{rain.name}{'' if mirrors else ' dull'} {view}"
                    arrays[name] = day_data.pack_picture(light)
                    arrays[f"{name} error"] = np.float32(np.sqrt((error**2).mean()) / light.mean())
                    say(f"{case.name}: {name} traced, {time.perf_counter() - start:.0f} s")
        day_data.write(case.name, arrays, folder)


def small(camera):
    """Return a camera with the size of the traced pictures."""
    return camera.resized(camera.width // HALF, camera.height // HALF)


def bake(garden, shapes, exposure, samples):
    """Return display colours, uint8, of all splats of the shapes and of the sky's dome."""
    spots, part, names = shapes.joined()
    view = -spots.normal
    if "glass" in names:  # glossy: as it is seen from the middle
        pane = part == names.index("glass")
        toward = MIDDLE - spots.position[pane]
        view[pane] = -toward / np.linalg.norm(toward, axis=1)[:, None]
    leaf = part == names.index("leaf") if "leaf" in names else np.zeros(len(part), bool)
    start = spots.position - view * np.where(leaf, OFF_LEAF, OFF)[:, None]
    light = garden.radiance(start, view, samples, 0)
    dome = spiral(SKY_SPLATS, SKY_LOWEST)
    level = np.where(dome[:, 2:] < 0.01, dome * [1, 1, 0] + [0, 0, 0.01], dome)
    above = np.tile([[0.0, 0.0, 20.0]], (SKY_SPLATS, 1))
    sky = garden.radiance(above, level, SKY_SAMPLES, 5)
    return display(light * exposure), display(sky * exposure)


def display(light):
    """Return linear light as 8-bit display colour."""
    return np.round(255 * srgb.display(np.clip(light, 0, 1))).astype(np.uint8)


def _labels(case, garden, paving):
    """Return the packed labels of all views, by name."""
    views = sorted({view for rain in case.rains for view in rain.views})
    return {
        f"labels {view}": day_data.pack_labels(
            labels(case, garden, paving, small(case.cameras()[view]))
        )
        for view in views
    }


def labels(case, garden, paving, camera):
    """Return the `Labels` of a camera's pixels, by the hit of the ray through each one's middle."""
    ray = pixel_rays(camera).reshape(-1, 3) @ camera.camera_from_world[:3, :3]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    point, normal, part, names = garden.meet(camera.position, ray)
    hit = part >= 0
    point = np.where(hit[:, None], point, 0)
    normal = np.where(hit[:, None], normal, [0, 0, 1])
    normal = np.where((normal * ray).sum(axis=1, keepdims=True) > 0, -normal, normal)
    region = np.zeros(len(ray), np.uint8)
    for k, name in enumerate(names):
        region[part == k] = REGIONS.index("paving" if name == "bed" else name)
    depth = paving.depth_at(point[:, 0], point[:, 1])
    ground = region == REGIONS.index("paving")
    region[ground & (depth > 0)] = REGIONS.index("rim")
    region[ground & (depth > 1e-3)] = REGIONS.index("puddle")
    off = point + OFF * normal
    sun = case.sun.direction
    lit = hit & ~garden.blocked(off, sun) & (normal @ sun > 0)
    above, _, roof, names = garden.meet(off, np.array([0.0, 0.0, 1.0]) + 0 * off)
    tops = [k for k, name in enumerate(names) if name in ("table", "tabletop")]
    covered = hit & np.isin(roof, tops) & (above[:, 2] > point[:, 2] + 0.1)
    openness = np.where(hit, _openness(garden, off, normal), 1)
    shape = camera.height, camera.width
    return Labels(*(a.reshape(shape) for a in (region, lit, covered, openness)))


def _openness(garden, points, normals):
    """Return the light of the overcast sky at points over that of open level ground."""
    rng = np.random.default_rng(0)
    total = np.zeros(len(points))
    u = np.cross(normals, [0.3, 0.5, 0.81])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    for _ in range(OPENNESS):
        radius, turn = np.sqrt(rng.random(len(points))), 2 * np.pi * rng.random(len(points))
        out = (radius * np.cos(turn))[:, None] * u + (radius * np.sin(turn))[:, None] * v
        out += np.sqrt(1 - radius**2)[:, None] * normals
        sky = np.where(out[:, 2] > 0, (1 + 2 * out[:, 2]) / 3, 0) / (7 / 9)
        total += sky * ~garden.blocked(points, out)
    return total / OPENNESS
