"""Splats that the captured sky hides a part of, once it is left out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import factories
from rainsim.constants import SH_0
from rainsim.numerics.srgb import linear
from rainsim.raster import Rasterizer, prepare
from rainsim.scene.types import GroundFrame, Scene
from rainsim.surface.unveiled import EVERY, unveiled
from scenes import looking

SHOWN = np.float32([0.6, 0.3, 0.2])  # what the pictures show
WALL, VEILED, NEEDLE, VEIL, COVER = range(5)


def found(sky):
    """What leaving out `sky` (5,) unveils, where the right half of the picture shows the sky.

    On the left stand a bare splat of a wall, and one behind a veil; on the right one that the sky
    hides.
    """
    place = [(-0.3, 2, 0.3), (-0.3, 2, -0.3), (0.3, 2, 0), (-0.15, 1, -0.15), (0.15, 1, 0)]
    sh = np.zeros((5, 4, 3), np.float32)
    sh[:, 1:] = 2.0  # extreme from all sides
    opacity = np.float32([0.9, 0.9, 0.9, 0.8, 0.9])
    splats = factories.splats(np.float32(place), scale=0.05, opacity=opacity, sh=sh)
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3), 1.0, ())
    camera = looking((0, 0, 0), (0, 1, 0), 64, 64)
    part = np.full((64, 64), -1, np.int8)
    part[:, 32:] = 1
    view = SimpleNamespace(light=np.broadcast_to(linear(SHOWN), (64, 64, 3)))
    scene = Scene("veil", splats, (camera,), frame, None, "")
    seen = Rasterizer(prepare(splats)).weigh(camera, 0.05, part, EVERY)[:, :3].sum(axis=1)
    bare, what = unveiled(scene, sky, seen, [(view, camera, part)])
    return splats, bare, what


def test_what_a_veil_hid_has_the_colour_of_the_pictures_and_what_lies_before_the_sky_is_sky():
    splats, bare, what = found(np.isin(np.arange(5), (VEIL, COVER)))
    assert np.flatnonzero(bare).tolist() == [NEEDLE]
    assert what.which.tolist() == [VEILED]
    new = what.of(splats)
    np.testing.assert_array_equal(np.delete(new.sh, VEILED, 0), np.delete(splats.sh, VEILED, 0))
    assert what.share == pytest.approx(1)  # the veil hid more than half
    np.testing.assert_allclose(new.sh[VEILED, 0] * SH_0 + 0.5, SHOWN, atol=1e-5)
    assert not new.sh[VEILED, 1:].any()
    glaring = splats.sh.copy()
    glaring[VEILED, 0] = 3  # brighter than white
    new = what._replace(share=what.share / 5).of(replace(splats, sh=glaring))
    np.testing.assert_allclose(new.sh[VEILED, 0] * SH_0 + 0.5, SHOWN, atol=1e-5)


def test_nothing_is_unveiled_where_nothing_is_left_out():
    _, bare, what = found(np.zeros(5, bool))
    assert not bare.any() and not len(what.which)
