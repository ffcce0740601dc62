"""Drops on the glass: their number, size and run-off, and how a cap bends light."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rainsim.drops import RainField, RainSpectrum
from rainsim.errors import ParameterError
from rainsim.scene.types import Camera
from rainsim.scene.view import pixel_rays
from rainsim.sensors import glass

# Looks along x, level: right is -y, down is -z.
LEVEL = np.eye(4)
LEVEL[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
CAMERA = Camera(160, 120, 140.0, 140.0, 80.0, 60.0, LEVEL, "a")
FLAT = glass.Pane(tilt=0.0, aperture=0.0)


def test_drops_hit_the_moving_pane_by_their_flux():
    """An upright pane at speed v meets n v drops a second, whatever their fall; tilted more."""
    field = RainField(RainSpectrum(25.0), (0.0, 0.0), 1)
    density = field.spectrum.density.sum()
    assert glass.pane_flux(field, replace(FLAT, speed=10.0), CAMERA).sum() == pytest.approx(
        10 * density
    )
    assert glass.pane_flux(field, FLAT, CAMERA).sum() == 0
    leaning = glass.pane_flux(field, replace(FLAT, tilt=0.5, speed=10.0), CAMERA)
    expected = field.spectrum.density * (10 * math.cos(0.5) + field.spectrum.speed * math.sin(0.5))
    np.testing.assert_allclose(leaning, expected)
    pane = replace(FLAT, tilt=0.5, speed=10.0, age=20.0)
    area = np.prod(np.diff(glass.pane_window(CAMERA, pane), axis=0))
    arrived = np.mean([glass.caps_on(field, pane, CAMERA, seed).arrived for seed in range(6)])
    assert arrived > 500
    assert arrived == pytest.approx(expected.sum() * area * 20, rel=0.05)


def test_caps_keep_their_water_and_do_not_overlap():
    assert glass.cap_volume(1e-3, math.pi / 2) == pytest.approx(2 / 3 * math.pi * 1e-9)
    assert glass.cap_radius(glass.cap_volume(2e-3, 0.7), 0.7) == pytest.approx(2e-3)
    field = RainField(RainSpectrum(50.0), (0.0, 0.0), 1)
    pane = replace(FLAT, tilt=0.5, speed=12.0, age=15.0)
    caps = glass.caps_on(field, pane, CAMERA, 3)
    assert 20 < len(caps.radius) < caps.arrived
    away = np.linalg.norm(caps.place[:, None] - caps.place[None], axis=2)
    touch = away < caps.radius[:, None] + caps.radius[None] - 1e-12
    assert touch.sum() == len(caps.radius)  # each with itself only
    # The largest that stay hold against their weight on the slope.
    slope = math.cos(0.5)
    weight = 9810 * glass.cap_volume(caps.radius, pane.contact_angle) * slope
    assert (weight < 0.3 * 0.0728 * 2 * caps.radius).all()
    same = glass.caps_on(field, pane, CAMERA, 3)
    np.testing.assert_array_equal(same.place, caps.place)
    assert glass.caps_on(field, replace(pane, wiper=5.0), CAMERA, 3).arrived == 0  # just wiped
    wiped = glass.caps_on(field, replace(pane, age=17.0, wiper=5.0), CAMERA, 3)
    assert 0 < wiped.arrived < caps.arrived / 4


def test_drops_stay_on_the_pane_as_time_goes_on_and_as_the_camera_turns_a_little():
    field = RainField(RainSpectrum(25.0), (1.0, 0.0), 1)
    pane = replace(FLAT, tilt=0.5, speed=12.0, age=6.0)

    def common(later, camera=CAMERA):
        first, second = (
            glass.caps_on(field, pane, CAMERA, 3),
            glass.caps_on(field, later, camera, 3),
        )
        near = np.linalg.norm(first.place[:, None] - second.place[None], axis=2) < 1e-9
        return near.any(axis=1).mean(), second.arrived - first.arrived

    share, more = common(replace(pane, age=6.0 + 1 / 24))
    assert share > 0.95 and 0 < more < 100
    gathered = [common(replace(pane, age=6.0 + t))[0] for t in (0.5, 2.0, 6.0)]
    assert sorted(gathered, reverse=True) == gathered and gathered[-1] < 0.7  # the partner
    turn = np.eye(4)
    turn[:2, :2] = [[math.cos(0.6), -math.sin(0.6)], [math.sin(0.6), math.cos(0.6)]]
    share, more = common(pane, replace(CAMERA, camera_from_world=LEVEL @ turn))
    assert share > 0.7 and more != 0
    other = glass.caps_on(field, pane, CAMERA, 4)
    assert other.place[0].tolist() not in glass.caps_on(field, pane, CAMERA, 3).place.tolist()


def bent(x, pane=FLAT, radius=2e-3):
    """Directions behind a cap in the middle, of rays that meet it at x [m] from its middle."""
    rays = np.column_stack([x / pane.distance, 0 * x, np.ones_like(x)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    place, point = glass.on_pane(rays, pane)
    return rays, *glass.refracted(rays, point, place, np.zeros(2), radius, pane)


@pytest.mark.parametrize("tilt", [0.0, 0.5, -0.6, 1.2])
def test_pixels_behind_caps_are_those_whose_rays_meet_their_discs(tilt):
    """Of all pixels and all caps, whatever the pane's tilt and wherever caps reach out."""
    pane = replace(FLAT, tilt=tilt)
    rng, rays = np.random.default_rng(8), pixel_rays(CAMERA).reshape(-1, 3)
    place, _ = glass.on_pane(rays, pane)
    middle = rng.choice(place[np.isfinite(place[:, 0])], 60) + rng.normal(0, 5e-3, (60, 2))
    caps = glass.Caps(middle, rng.uniform(2e-4, 6e-3, 60), 60)
    inside = np.linalg.norm(place[:, None] - caps.place, axis=2) < caps.radius
    pixels, cap = glass.pixels_behind(caps, place, CAMERA, pane)
    found = np.zeros_like(inside)
    found[pixels, cap] = True
    assert 500 < len(pixels) == found.sum()
    np.testing.assert_array_equal(found, inside)
    beside = glass.Caps(np.array([[-9.0, 0.0]]), np.array([1e-3]), 1)
    assert not len(glass.pixels_behind(beside, place, CAMERA, pane)[0])


def test_a_cap_bends_as_snell_has_it():
    """Off the middle, angle by angle: in at the flat side, out at the ball, in one plane."""
    x = np.linspace(-1.5e-3, 1.5e-3, 31)
    rays, out, leave, share = bent(x)
    ball = 2e-3 / math.sin(FLAT.contact_angle)
    middle = np.array([0, 0, FLAT.distance - ball * math.cos(FLAT.contact_angle)])
    np.testing.assert_allclose(np.linalg.norm(leave - middle, axis=1), ball)
    normal = (leave - middle) / ball
    inner = leave - np.column_stack([x, 0 * x, np.full(31, FLAT.distance)])
    inner /= np.linalg.norm(inner, axis=1, keepdims=True)
    np.testing.assert_allclose(rays[:, 0], glass.INDEX * inner[:, 0], atol=1e-9)
    sine_in, sine_out = (np.linalg.norm(np.cross(normal, d), axis=1) for d in (inner, out))
    np.testing.assert_allclose(sine_out, glass.INDEX * sine_in, atol=1e-9)
    reflected = ((glass.INDEX - 1) / (glass.INDEX + 1)) ** 2  # at the middle, by Fresnel
    assert share[15] == pytest.approx(1 - reflected, rel=1e-3)
    tilted = replace(FLAT, tilt=0.4)
    _, out, _, _ = bent(np.zeros(1), tilted)
    assert out[0, 1] == pytest.approx(0, abs=0.4) and np.isfinite(out).all()


def test_the_wide_picture_is_looked_up_with_its_depth():
    camera = glass.wide_camera(CAMERA)
    rng = np.random.default_rng(0)
    picture, depth = (
        rng.random((glass.WIDE_SIDE, glass.WIDE_SIDE, 3)),
        np.full((glass.WIDE_SIDE, glass.WIDE_SIDE), 2.0),
    )
    out = np.array([[0.3, -0.2, 1.0], [0, 0, 1], [np.nan] * 3])
    leave = np.array([[0.05, 0.01, 0.08], [0.0, 0.1, 0.08], [0, 0, 0.08]])
    found = glass.looked_up(out / np.linalg.norm(out, axis=1, keepdims=True), leave, picture, depth,
                      camera)  # fmt: skip
    for k in (0, 1):
        place = leave[k] + out[k] * (2 - 0.08)
        u, v = camera.fx * place[0] / 2 + camera.cx, camera.fy * place[1] / 2 + camera.cy
        np.testing.assert_array_equal(found[k], picture[int(v), int(u)])
    assert not found[2].any()


def test_the_mask_is_where_the_drops_are():
    caps = glass.Caps(np.array([[0.0, 0.0], [0.02, 0.01]]), np.array([4e-3, 2e-3]), 2)
    pane = replace(FLAT, distance=0.1)
    picture = np.full((120, 160, 3), 100, np.uint8)
    wide = np.full((glass.WIDE_SIDE, glass.WIDE_SIDE, 3), 200, np.uint8)
    depth = np.full((glass.WIDE_SIDE, glass.WIDE_SIDE), 5.0, np.float32)
    seen, share = glass.through_glass(picture, CAMERA, caps, pane, wide, depth)
    v, u = np.mgrid[:120, :160] + 0.5
    expected = np.zeros((120, 160), bool)
    for (x, y), r in zip(caps.place, caps.radius, strict=True):
        expected |= np.hypot((u - 80) / 1400 - x, (v - 60) / 1400 - y) < r
    np.testing.assert_array_equal(share > 0, expected)
    assert (seen[~expected] == 100).all() and np.median(seen[expected]) > 180
    soft = replace(pane, aperture=2e-3, focus=10.0)
    blurred, part = glass.through_glass(picture, CAMERA, caps, soft, wide, depth)
    assert part.sum() == pytest.approx(share.sum(), rel=1e-3)
    assert (part > 0.01).sum() > expected.sum() and 100 <= np.median(blurred) <= 101


@pytest.mark.parametrize("wrong, message", [
    ({"distance": 0.0}, "glass distance is 0.0"), ({"contact_angle": 2.0}, "at most 90"),
    ({"tilt": 1.5}, "must be less than 80"), ({"wiper": 0.0}, "glass wiper is 0.0"),
])  # fmt: skip
def test_wrong_panes_are_named(wrong, message):
    with pytest.raises(ParameterError, match=message):
        glass.Pane(**wrong)


def test_a_picture_that_sees_past_the_glass_is_refused():
    with pytest.raises(ParameterError, match="sees past"):
        glass.pane_window(replace(CAMERA, fx=30.0, fy=30.0), replace(FLAT, tilt=1.3))
