"""A drop on the glass against Mitsuba 3 (an extra of the tests): where rays go on, and how bright.

Mitsuba follows each ray through the flat side of the water, a disc, and out of its ball: two
dielectric surfaces of which it samples the refracted ray.
"""

import math

import numpy as np
import pytest

from rainsim.scene.types import Camera
from rainsim.sensors.glass import INDEX, Pane, on_pane, refracted

mitsuba = pytest.importorskip("mitsuba")
pytestmark = pytest.mark.slow

CAMERA = Camera(160, 120, 140.0, 140.0, 80.0, 60.0, np.eye(4), "a")
CENTRE, RADIUS = np.array([0.012, -0.007]), 2.5e-3  # m, on the pane


def rays_through_the_cap(pane, rng, count=400):
    """Return unit rays from the camera that meet the cap's disc, and where they meet the pane."""
    axes = pane.axes()
    turn, away = rng.random(count) * 2 * math.pi, np.sqrt(rng.random(count)) * 0.999 * RADIUS
    place = CENTRE + away[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    point = place @ axes[:2] + (0, 0, pane.distance)
    rays = point / np.linalg.norm(point, axis=1, keepdims=True)
    np.testing.assert_allclose(on_pane(rays, pane)[0], place, atol=1e-12)
    return rays, point, place


def through(shape, origin, direction):
    """Return place, direction and transmittance of a ray that a dielectric shape refracts."""
    found = shape.ray_intersect(mitsuba.Ray3f(origin, direction))
    assert found.is_valid()
    context = mitsuba.BSDFContext()
    context.type_mask = mitsuba.BSDFFlags.DeltaTransmission
    sample, weight = found.bsdf().sample(context, found, 0.5, [0.5, 0.5])
    if weight[0] == 0:
        return np.array(found.p), None, 0.0
    # Radiance is divided by the index squared where it enters and multiplied where it leaves.
    back = float(weight[0]) * float(sample.eta) ** 2
    return np.array(found.p), np.array(found.to_world(sample.wo)), back


@pytest.mark.parametrize("tilt, angle", [(30, 50), (0, 50), (30, 85)])
def test_a_cap_refracts_as_mitsuba_has_it(rng, tilt, angle):
    mitsuba.set_variant("scalar_rgb")
    pane = Pane(tilt=math.radians(tilt), contact_angle=math.radians(angle))
    rays, point, place = rays_through_the_cap(pane, rng)
    out, leave, share = refracted(rays, point, place, CENTRE, RADIUS, pane)
    right, down, normal = pane.axes()
    middle = CENTRE @ pane.axes()[:2] + (0, 0, pane.distance)
    ball = RADIUS / math.sin(pane.contact_angle)
    frame = np.eye(4)
    frame[:3] = np.column_stack([RADIUS * right, -RADIUS * down, -normal, middle])
    water = {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0}
    disc = mitsuba.load_dict({"type": "scene", "a": {
        "type": "disk", "to_world": mitsuba.ScalarTransform4f(frame), "bsdf": water}})  # fmt: skip
    sphere = mitsuba.load_dict({"type": "scene", "a": {
        "type": "sphere", "radius": ball, "bsdf": water,
        "center": list(middle - ball * math.cos(pane.contact_angle) * normal)}})  # fmt: skip
    lost = 0
    for k in range(len(rays)):
        at, inside, _ = through(disc, [0, 0, 0], rays[k])
        place_out, direction, passed = through(sphere, at, inside)
        np.testing.assert_allclose(leave[k], place_out, atol=1e-7)
        if direction is None or direction @ normal <= 0:
            assert np.isnan(out[k]).all()
            lost += 1
            continue
        np.testing.assert_allclose(out[k], direction, atol=1e-4)
        assert share[k] == pytest.approx(passed, abs=5e-4)
    assert 0 < lost < 0.7 * len(rays)  # by total reflection at the cap's rim
