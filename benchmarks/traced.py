"""Rays through the splats: the reference for what water and films mirror.

`RayScene` traces rays through the splats that pictures are drawn of, and grades and wets what they
meet as those pictures are. `traced_light` traces what listed water mirrors, `trace_reflections`
lets a renderer do so in its frames.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rainsim.constants import HALF
from rainsim.jit import cpu_kernel, prange
from rainsim.reflection import water_record
from rainsim.reflection.facets import LEAST_VARIANCE, SAMPLES, light_weight
from rainsim.reflection.mirrored_rays import ENVIRONMENT, sample_ray
from rainsim.reflection.slope_moments import root_of
from rainsim.reflection.water_pass import tilt
from rainsim.reflection.water_record import read_record
from rainsim.scene.cameras import MIRROR_CLEARANCE
from rainsim.scene.splat_sets import joined
from rainsim.scene.view import View, camera_component
from rainsim.sensors.ray_traced import Tracer
from rainsim.shading.grading import Look
from rainsim.shading.surface_point import FLAT, NOT_POOR, GroundMaps, SurfacePoint
from rainsim.shading.wetness import OffGroundWetness
from rainsim.shading.wetting import SkyMaps, wet_pixel

FIRST_SEGMENT = 0.5  # m of a ray that are searched at first
TRACED = 3  # where mirrored light was found, beside the codes of `mirrored_rays`


class DryRays(NamedTuple):
    """Hits of rays through the splats; read-only. See `rainsim.sensors.ray_traced.Traced`."""

    color: np.ndarray  # (n, 3) float32, display-referred, over black
    alpha: np.ndarray  # (n,) float32
    distance: np.ndarray  # (n,) float32 [m], from the eye along the ray
    plane_distance: np.ndarray  # (n,) float32 [m]
    normal: np.ndarray  # (n, 3) float32, unit, ground frame
    eye: np.ndarray  # (n, 3) float32 [m], ground frame
    direction: np.ndarray  # (n, 3) float32, unit, ground frame


class RayScene:
    """The splats of a renderer's scene as rays meet them, at the renderer's present time.

    Parameters
    ----------
    scene : WetScene
    splats : Splats, optional
        Those that rays meet; without them all that mirrored pictures show, actors included.
    """

    def __init__(self, scene, splats=None):
        self.scene, self._given, self._tracer, self._changes = scene, splats, None, None

    @property
    def tracer(self):
        """The `Tracer` of the splats, made again when they have changed."""
        capture = self.scene.capture
        if self._tracer is None or self._changes != capture.changes:
            self._tracer, self._changes = Tracer(self._splats()), capture.changes
        return self._tracer

    def _splats(self):
        capture = self.scene.capture
        if self._given is not None:
            return self._given
        splats = capture.splats
        if capture.badly_placed.any():
            splats = splats.take(~capture.badly_placed)
        moving = None if capture.actors is None else capture.actors.splats
        return splats if moving is None else joined([splats, moving])

    def trace(self, origin, direction, before, pixel, color_eye=None):
        """Return the graded radiance, alpha and distance [m] of rays of the ground frame [m].

        `before`, `pixel` and `color_eye` are those of `Tracer.trace`, in metres.
        """
        frame, now = self.scene.frame, self.scene.shading
        unit, turn = frame.meters_per_unit, frame.rotation
        found = self.tracer.trace(
            frame.to_capture(origin), direction @ turn, before / unit, pixel,
            FIRST_SEGMENT / unit, np.append(frame.up, MIRROR_CLEARANCE / unit), color_eye,
        )  # fmt: skip
        rays = DryRays(
            found.color, found.alpha, found.distance * np.float32(unit),
            found.plane_distance * np.float32(unit),
            np.ascontiguousarray(found.normal @ turn.T, np.float32),
            (origin - before[:, None] * direction).astype(np.float32), direction,
        )  # fmt: skip
        light = np.empty_like(rays.color)
        grade_rays(rays, now.ground, now.off_ground, now.mirrored_sky, now.look, light)
        return light, found.alpha, rays.distance


def trace_reflections(renderer):
    """Let a renderer of the CPU trace what water mirrors in all its frames; return it."""
    rays = RayScene(renderer.conductor.wet_scene)

    def reflect(seen, ripples, tops, view):
        if len(seen):
            tilt(seen, *ripples, tops)
            traced_light(seen.record, view, rays.trace, seen.light, seen.source)
        return seen

    renderer.passes.work |= {"mirror": lambda: {}, "reflection": reflect}
    return renderer


def traced_light(record, view, trace, light_out, source_out):
    """Trace the mirrored light of every record through the splats.

    Parameters
    ----------
    record : ndarray of shape (n, RECORD), float32
    view : View
    trace : callable
        trace(origin [m], direction, before [m], pixel) returns radiance (k, 3), alpha (k,) and
        distance (k,) [m] from the eye of rays in the ground frame; `pixel` is the width of a pixel
        over the distance.
    light_out : ndarray of shape (n, 3), float32
        Radiance that comes to the surface, before it is multiplied by the reflectance.
    source_out : ndarray of shape (n,), uint8
        TRACED, or ENVIRONMENT where the ray of the mean slopes met little.

    Returns
    -------
    alpha : ndarray of shape (n,), float32
    end : ndarray of shape (n, 3), float32 [m]
        Where the rays of the mean slopes end.
    """
    alpha_of, end, total = None, None, None
    variance = record[:, water_record.VARIANCE_X] + record[:, water_record.VARIANCE_Y]
    smooth = variance < LEAST_VARIANCE
    for sample in range(SAMPLES):
        which = np.flatnonzero(~smooth) if sample else np.arange(len(record))
        direction = np.empty((len(which), 3), np.float32)
        before, weight = np.empty((2, len(which)), np.float32)
        mirror_rays(which, record, view, sample, direction, before, weight)
        pixel = record[which, water_record.VIEW_DEPTH] / before / view.fx
        point = record[:, water_record.POINT]
        light, alpha, distance = trace(point[which], direction, before, pixel)
        if sample:
            light_out[which] += weight[:, None] * light
            total[which] += weight
        else:
            light_out[:], total = weight[:, None] * light, weight
            alpha_of = alpha
            end = point + (distance - before)[:, None] * direction
            source_out[:] = np.where(alpha > HALF, TRACED, ENVIRONMENT)
    light_out /= total[:, None]
    return alpha_of, end


@cpu_kernel
def mirror_rays(which, record, view: View, sample, direction_out, before_out, weight_out):
    """Write the mirrored ray of each record in `which`, for one of the SAMPLES slopes.

    Parameters
    ----------
    sample : int
        Number of the slope; 0 is the mean of the pixel's.
    direction_out : ndarray of shape (k, 3), float32
        Unit, ground frame.
    before_out : ndarray of shape (k,), float32 [m]
        Way from the eye to the water.
    weight_out : ndarray of shape (k,), float32
        Of the ray in the light, see `facets.light_weight`.
    """
    for k in prange(len(which)):
        water = read_record(record, which[k])
        a, b, c = root_of(water.variance_x, water.variance_y, water.covariance)
        rx, ry, rz = sample_ray(water, a, b, c, sample)
        direction_out[k, 0], direction_out[k, 1], direction_out[k, 2] = rx, ry, rz
        ahead = camera_component(view, 2, water.view_x, water.view_y, water.view_z)
        before_out[k] = water.view_depth / ahead
        weight_out[k] = light_weight(water, a, b, c, sample)


@cpu_kernel
def grade_rays(
    rays: DryRays, ground: GroundMaps, rain: OffGroundWetness, sky: SkyMaps, look: Look, light_out
):
    """Grade and wet the hits of rays, as `grade_and_wet` does a picture.

    Parameters
    ----------
    rays : DryRays
    ground : GroundMaps
    rain : OffGroundWetness
    sky : SkyMaps
    look : Look
    light_out : ndarray of shape (n, 3), float32
        Radiance.
    """
    color, alpha, normal, eye, direction = (
        rays.color, rays.alpha, rays.normal, rays.eye, rays.direction
    )  # fmt: skip
    distance, plane_distance = rays.distance, rays.plane_distance
    for n in prange(len(alpha)):
        x, y, z = direction[n, 0], direction[n, 1], direction[n, 2]
        d = plane_distance[n] if normal[n, 2] > FLAT else distance[n]
        point = SurfacePoint(
            eye[n, 0] + d * x, eye[n, 1] + d * y, eye[n, 2] + d * z,
            normal[n, 0], normal[n, 1], normal[n, 2], d, NOT_POOR,
        )  # fmt: skip
        r, g, b, _, _ = wet_pixel(
            (color[n, 0], color[n, 1], color[n, 2]), alpha[n], (x, y, z), point,
            (normal[n, 0], normal[n, 1], normal[n, 2]), ground, rain, sky, look, False,
        )  # fmt: skip
        light_out[n, 0], light_out[n, 1], light_out[n, 2] = r, g, b
