"""The meaning of captured colours: albedo, the level of an overcast sky, a camera's exposure.

A capture's colours have an exposure of their own. Under an overcast sky the irradiance E of open
ground of albedo a gives it the radiance L = a E / pi, and the zenith has the radiance 9/7 E / pi
(Moon and Spencer 1942). So one number, the albedo that a captured colour of 1 stands for, says how
bright the sky is against the land, and how much darker things get when they are wet.
"""

import math

import numpy as np

from rainsim.constants import SH_0
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.scene.cameras import look_at, resize_to
from rainsim.shading.backdrop import Backdrop, sky_of
from rainsim.shading.color import luminance_of
from rainsim.shading.grading import DULL_EXPOSURE
from rainsim.shading.wetness import LEAST_FILM, OTHER_POROSITY, dampness
from rainsim.terrain.table import class_table
from rainsim.terrain.types import INFERRED, MEASURED

FLAT_TOP = 0.05  # m over the bed: open ground has nothing on it
NEAR = 2.0  # cameras' heights from one, within which poor ground surely shows its own colours
LEAST_AREA = 0.25  # m2 of a class that can be judged
USUAL, USUAL_SPREAD = 0.85, 1.0  # what is assumed without ground to judge by, and its spread in log
WHITEST, WHITE_SHARE = 0.85, 99.0  # albedo of the whitest things, and percentile they are found at
LEAST, MOST = 0.25, 2.5  # albedo of a captured colour of 1: beyond it is an error
ZENITH = 9 / 7  # of the mean radiance that gives level ground its light
MIDDLE_GREY = 0.16  # mean linear light of the land in a well exposed picture of a dull day
MOST_ZENITH = 1.5  # of white: above it the tone curve leaves no clouds in the sky
MUCH_SKY = 0.3  # of the views, from which on the meter does not let the zenith be brighter
VIEWS, VIEW_WIDTH = 8, 256  # cameras that the exposure is metered with, px
VIEW_FOV, VIEW_SHAPE = 60.0, 1.5  # degrees, width over height: of one for a capture without cameras
LEAST_AWAY = 1.0  # m from it to what it looks at, on the level


def albedo_of_white(terrain, scene, ground_albedo=None, gain=None):
    """Return the albedo that a captured linear colour of 1 stands for, and a note.

    The colours of open grass, soil and paving are held against the albedos of their classes, each
    with its spread: the mean of the logarithms weighs them. It is at most what makes the whitest
    splats WHITEST.

    ground_albedo : float, optional. Albedo of the open ground, if it is known:
        nothing is guessed then.
    gain : array (n, 3), optional. On the splats' linear light, if the captured
        sun is divided out. What the sun shone on keeps its level then and shade
        gets that level too, so the number is that of relit colours: by captured
        ones the sky would be too dim over ground in the shade.
    """
    light, splats = luminance_of(terrain.color), scene.splats
    told = INFERRED if terrain.layer.size else MEASURED  # of poor ground the pictures tell colours
    open_ground = (terrain.source == told) & (terrain.top - terrain.bed < FLAT_TOP)
    if terrain.layer.size:
        near = open_ground & _near_cameras(scene, terrain.grid)
        open_ground = near if near.any() else open_ground
    brighter = 1.0
    if gain is not None:
        brighter = gain @ LUMINANCE_WEIGHTS
        change = ground_gain(terrain, splats, brighter, scene.ground_frame)
        light, open_ground = light * change, open_ground & (change > 0)
    if ground_albedo is not None:
        found = float(np.median(light[open_ground])) if open_ground.any() else USUAL
        scale = ground_albedo / max(found, 1e-3)
        return scale, f"albedo of open ground: {ground_albedo:g} as given, {scale:.2f} x its colour"
    table = class_table()
    weight = USUAL_SPREAD**-2
    total, judged = weight * math.log(USUAL), []
    for code, name in enumerate(table.names):
        here = light[open_ground & (terrain.ground_class == code)]
        albedo, spread = table.column("albedo")[code], table.column("albedo_spread")[code]
        if albedo <= 0 or here.size * terrain.grid.cell_area < LEAST_AREA:
            continue
        weight += spread**-2
        total += spread**-2 * math.log(albedo / max(float(np.median(here)), 1e-3))
        judged.append(name)
    scale = math.exp(total / weight)
    if len(splats):
        colors = luminance_of(0.5 + SH_0 * splats.sh[:, 0])
        white = float(np.percentile(colors * brighter, WHITE_SHARE))
        scale = min(scale, WHITEST / max(white, 1e-3))
    scale = min(max(scale, LEAST), MOST)
    by = " and ".join(judged) if judged else "no ground to judge by"
    return scale, f"albedo: {scale:.2f} x captured colour by {by}; --ground-albedo sets it"


def _near_cameras(scene, grid):
    """Return which cells lie near a camera, bool (ny, nx): farther off it may be walls they show.

    Poor ground goes on behind walls, and the pictures' colours are laid on it there, too.
    """
    near, (columns, rows) = np.zeros(grid.shape, bool), grid.centres()
    eyes = [scene.ground_frame.to_ground(camera.position) for camera in scene.cameras]
    reach = NEAR * np.median([height for _, _, height in eyes]) if eyes else 0.0
    for x, y, _ in eyes:
        near[np.ix_(np.abs(rows - y) < reach, np.abs(columns - x) < reach)] = True
    return near


def ground_gain(terrain, splats, gain, frame):
    """Return the mean gain of the splats on the ground of each cell, (ny, nx); 0 where none lies.

    gain : array (n,). On their light.
    frame : GroundFrame
    """
    grid = terrain.grid
    with np.errstate(all="ignore"):
        position = frame.to_ground(splats.position)
        row, column, inside = grid.cells(position[:, 0], position[:, 1])
        inside &= np.isfinite(position).all(axis=1) & (splats.opacity > 0)
    row, column = row[inside], column[inside]
    on_it = np.abs(position[inside, 2] - terrain.bed[row, column]) < FLAT_TOP
    cell = (row * grid.shape[1] + column)[on_it]
    weight = splats.opacity[inside][on_it]
    size = grid.shape[0] * grid.shape[1]
    total = np.bincount(cell, weight * gain[inside][on_it], minlength=size)
    share = np.bincount(cell, weight, minlength=size)
    return (total / np.maximum(share, 1e-9)).reshape(grid.shape)


def calibration_of(scene, terrain):
    """Return the calibration of a capture's colours that a run would use, as facts by name.

    Returns dict. `albedo` of a captured linear colour of 1; `zenith`, the
        radiance of an overcast zenith over that ground, display white being 1;
        `note`, how the albedo was found.
    """
    albedo, note = albedo_of_white(terrain, Backdrop(scene, sky_of(scene), wanted=True).scene)
    return {"albedo": albedo, "zenith": zenith_radiance(albedo, DULL_EXPOSURE), "note": note}


def zenith_radiance(albedo, exposure):
    """Return the radiance of an overcast zenith over ground whose colours stand for `albedo`.

    `exposure` is the factor by which captured light is dimmed under that sky.
    """
    return ZENITH * exposure / albedo


def metered(captured, rainy, sky_share, zenith, cloudiness):
    """Return the factor on a rainy picture that a camera's meter would choose.

    captured, rainy : float. Mean linear luminance of the land in some views, as
        captured and in the rain.
    sky_share : float. Share of the views that shows the sky. The more of it, the
        more the meter keeps it from losing its clouds.
    zenith : float. Radiance of the zenith.
    cloudiness : float. 0: the land stays as bright as it was captured; 1: it
        becomes MIDDLE_GREY.
    """
    if not (captured > 0 and rainy > 0):
        return 1.0
    wanted = captured ** (1 - cloudiness) * MIDDLE_GREY**cloudiness
    for_land = wanted / rainy
    for_sky = min(for_land, MOST_ZENITH / zenith)
    weight = min(sky_share / MUCH_SKY, 1.0) * cloudiness
    return for_land ** (1 - weight) * for_sky**weight


def exposure_bias(config):
    """Return the f-stops that are added to the meter's choice, as far as open ground is wet.

    A meter takes back what wetting darkens, so that a lawn is as bright in rain as dry.

    config : Config. Of one time.
    """
    if config.render.metering != "auto" or config.render.wetting == "none":
        return 0.0
    return config.render.exposure_bias * float(dampness(config, LEAST_FILM, OTHER_POROSITY))


def fixed_camera(scene, terrain, config):
    """Return the camera that meters a capture without cameras; None for one with cameras.

    It stands where `surroundings` of the settings is and looks at the middle of the map. Without
    that place the first camera that is drawn meters, so that pictures depend on it.
    """
    place = config.render.surroundings
    if scene.cameras or place is None:
        return None
    frame, grid = scene.ground_frame, terrain.grid
    eye = frame.to_ground(np.array(place, np.float64))
    middle = np.array([*(np.array(grid.origin) + np.array(grid.size) / 2), 0.0])
    if np.linalg.norm(middle[:2] - eye[:2]) < LEAST_AWAY:
        middle[0] = eye[0] + LEAST_AWAY
    camera = look_at(eye, middle, (0, 0, 1), VIEW_FOV, VIEW_WIDTH, round(VIEW_WIDTH / VIEW_SHAPE))
    return frame.camera_in_capture(camera)


def metering_views(cameras, first_camera):
    """Return the small cameras that the exposure is metered with."""
    chosen = cameras[:: -(-len(cameras) // VIEWS)] if cameras else (first_camera,)
    return [resize_to(camera, VIEW_WIDTH) for camera in chosen]
