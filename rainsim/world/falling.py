"""What falls at a moment as lists: drops, droplets of splashes, and the lines of crowns.

They are those that `rainsim.render` draws for the camera, each class as far as it shows one by one.
"""

from typing import NamedTuple

import numpy as np

from rainsim.drops import impacts
from rainsim.jit import cpu_kernel, prange, serial_kernel
from rainsim.particles import splash
from rainsim.particles.crown import LONGEST_JET, crown_shape, raise_crown, raise_jet
from rainsim.particles.line_raster import NEAR
from rainsim.particles.shutter_view import footprint
from rainsim.particles.splash_pass import FARTHEST, MARGIN
from rainsim.particles.streaks import streak_reach
from rainsim.rain.dripping import drip_impacts, drips_seen
from rainsim.rain.heightfield import GROUND, first_hit
from rainsim.rain.impacts import joined
from rainsim.scene.view import camera_points, corner_rays, edge_planes, finest

MOMENT = 1e-4  # s, exposure of what is listed as at a moment
BESIDE = 0.5  # m around the picture in which drops are listed
COLUMNS = 7  # of `streaks.Line`


class Falling(NamedTuple):
    """Lists at one moment; rows are place [m], velocity [m/s] and diameter [m].

    drops : float64 array (n, 7)
    droplets : float64 array (m, 7)
    crowns : float64 array (k, 7). Two ends [m] in place of place and velocity,
        and the thickness [m] of a thread between.
    """

    drops: np.ndarray
    droplets: np.ndarray
    crowns: np.ndarray


def falling_at(state, field, surfaces, camera, render, film):
    """Return what falls before a camera at the time of a state, a `Falling`.

    film : float [m]. Water on what is not the ground, see
        `splash_pass.draw_splashes`.
    """
    if field is None:
        none = np.zeros((0, COLUMNS))
        return Falling(none, none, none)
    drips = drips_seen(state.drips, state.time, MOMENT)
    drips = drips[_in_view(camera, drips[:, :3])]
    drops = _drops(state.time, field, surfaces, camera, render)
    droplets, crowns = _splashes(state, field, surfaces, camera, render, film)
    return Falling(np.concatenate([drops, drips]), droplets, crowns)


def _in_view(camera, place, margin=BESIDE):
    seen = camera_points(camera, place)
    aside = seen @ edge_planes(camera).T
    return (seen[:, 2] > NEAR) & (aside > -margin).all(axis=1)


def _drops(time, field, surfaces, camera, render):
    """Return the drops in the air that show one by one, (n, 7)."""
    reach = streak_reach(field, camera, render.exposure, render.streak_far)
    corners = np.concatenate([np.zeros((1, 3)), corner_rays(camera)])
    corners = reach[:, None, None] * corners @ camera.camera_from_world[:3, :3] + camera.position
    low, high = corners.min(axis=1) - BESIDE, corners.max(axis=1) + BESIDE
    found = field.drops_in_box(time, low, high)
    classes = np.searchsorted(field.spectrum.edges, found.diameter, side="right") - 1
    classes = np.clip(classes, 0, len(reach) - 1)
    depth = camera_points(camera, found.position)[:, 2]
    shown = _in_view(camera, found.position) & (depth < reach[classes])
    shown &= found.position[:, 2] > surfaces.ground.min()  # beside the map nothing stops them
    place, velocity = found.position[shown], found.velocity[shown]
    falls = np.zeros(len(place), bool)
    _mark_falling(place - velocity * time, velocity, time, surfaces.height_fields(), falls)
    return np.column_stack([place, velocity, found.diameter[shown]])[falls]


def _splashes(state, field, surfaces, camera, render, film):
    """Return droplets (m, 7) in flight and the threads (k, 7) of crowns and jets."""
    within = footprint(camera, FARTHEST, MARGIN)
    since = state.time - splash.LONGEST_LIFE
    recent = impacts(field, surfaces, since, state.time, splash.SMALLEST_SPLASH, within)
    drips = drip_impacts(state.drips, state.drip_id, surfaces, since, state.time)
    hits = joined(recent, drips)
    hits = hits.take(_in_view(camera, hits.position))
    pixel = camera_points(camera, hits.position)[:, 2] / finest(camera)
    under = np.full(len(hits), film)
    ground = hits.kind == GROUND
    under[ground] += state.depth[hits.row[ground], hits.column[ground]]
    droplets, crowns = _listed(hits, under, pixel, state.time, render.exposure)
    start, way = crowns[:, :3], crowns[:, 3:6] * MOMENT
    thickness = np.pi / 4 * crowns[:, 6] ** 2 / np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    return droplets, np.column_stack([start, start + way, thickness])


def _listed(hits, under, pixel, time, exposure):
    """Return droplets and lines of crowns of impacts, with as much room as they need."""
    room = np.array([16 * len(hits) + 64] * 2)
    while True:
        droplets, crowns = (np.empty((rows, COLUMNS)) for rows in room)
        count = np.zeros(2, np.int64)
        _list_splashes(
            hits.arrays(), under, pixel, time, exposure, count[:1], count[1:], droplets, crowns
        )
        if (count <= room).all():
            return droplets[: count[0]], crowns[: count[1]]
        room = count


@cpu_kernel
def _mark_falling(origin, velocity, time, surfaces, falls_out):
    """Mark the drops that no surface has stopped; `origin` is where they were at time 0."""
    for n in prange(len(origin)):
        stop, _, _, _ = first_hit(
            origin[n, 0], origin[n, 1], origin[n, 2], velocity[n, 0], velocity[n, 1],
            velocity[n, 2], -np.inf, time, surfaces,
        )  # fmt: skip
        falls_out[n] = stop >= time


@serial_kernel
def _list_splashes(
    hits, under, pixel, time, exposure, count_droplets, count_lines, droplets_out, lines_out
):
    """List what impacts have thrown up at a time, as `splash_pass.list_splash` draws it."""
    for n in range(len(hits.id)):
        age, diameter, speed = time - hits.time[n], hits.diameter[n], abs(hits.velocity[n, 2])
        if not splash.splashes_on(under[n], diameter, speed):
            continue
        impact = splash.Impact(
            hits.id[n], hits.position[n, 0], hits.position[n, 1], hits.position[n, 2],
            hits.velocity[n, 0], hits.velocity[n, 1], speed, diameter, under[n], age,
        )  # fmt: skip
        size = splash.relative_size(under[n] / diameter)
        if diameter * splash.LARGEST_SHARE > splash.least_seen(pixel[n], exposure):
            most = int(splash.droplets_of(diameter, speed))
            for k in range(most):
                seen, x, y, z, vx, vy, vz, wide, _ = splash.droplet(impact, k, most, size, 0.0)
                if seen and wide > splash.least_seen(pixel[n], exposure):
                    if count_droplets[0] < len(droplets_out):
                        row = count_droplets[0]
                        droplets_out[row, 0], droplets_out[row, 1] = x, y
                        droplets_out[row, 2], droplets_out[row, 3] = z, vx
                        droplets_out[row, 4], droplets_out[row, 5] = vy, vz
                        droplets_out[row, 6] = wide
                    count_droplets[0] += 1
        if under[n] > splash.WET_DEPTH:
            crown = crown_shape(impact, size, pixel[n])
            if age < crown.life:
                raise_crown(impact, crown, pixel[n], MOMENT, count_lines, lines_out)
            if crown.jet and age < LONGEST_JET:
                raise_jet(impact, pixel[n], MOMENT, count_lines, lines_out)
