"""Streets of a length: the same every time, side streets, drains that take water, eaves that drip.

Heights are those of the layout where that is enough: a street has 9,000 splats a metre.
"""

import numpy as np
import pytest

from rainsim.demo_scenes.build import content_hash
from rainsim.demo_scenes.street import SEED, make_long_street, road
from rainsim.demo_scenes.street.layout import DRAIN_STEP, SIDE_KERB, long_layout
from rainsim.demo_scenes.street.long import LongStreet
from rainsim.demo_scenes.traffic import LINE, _crossing, _waiting
from rainsim.errors import ParameterError
from rainsim.scene.library import find_scene, load_scene
from rainsim.terrain.table import DRAIN
from rainsim.terrain.types import MEASURED, Grid, Terrain
from rainsim.water.puddles import puddles_of

LENGTH = 60.0  # m


@pytest.fixture(scope="module")
def street():
    """The shortest street that there is."""
    return make_long_street(LENGTH)


@pytest.fixture(scope="module")
def plan():
    """A kilometre, laid out but not built."""
    return LongStreet(1000.0, SEED, None)


@pytest.mark.slow
def test_same_street_every_time_and_another_of_another_length(street):
    pieces = list(LongStreet(LENGTH, SEED, _no_leaves).pieces())
    again = list(LongStreet(LENGTH, SEED, _no_leaves).pieces())
    assert len(pieces) == len(again) > 4
    for one, other in zip(pieces, again, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.colour, other.colour)
    assert not np.array_equal(pieces[0].colour[:99], pieces[1].colour[:99])
    assert street.source_hash == content_hash(street.splats)


def _no_leaves(noise, rng, count, first, last, layout):
    from rainsim.demo_scenes.street import _leaves

    return _leaves(noise, rng, count, first, last, layout)


def test_splats_are_sound_and_cover_the_road(street):
    splats, frame = street.splats, street.ground_frame
    for name in ("position", "rotation", "scale", "opacity", "sh"):
        array = getattr(splats, name)
        assert array.dtype == np.float32 and np.isfinite(array).all()
    place = frame.to_ground(splats.position)
    for x in np.arange(-15, LENGTH, 7.5):  # a square metre of road has splats everywhere
        there = (np.abs(place[:, 0] - x) < 0.5) & (np.abs(place[:, 1]) < 0.5)
        assert np.count_nonzero(there & (np.abs(place[:, 2]) < 0.1)) > 150


def test_the_drive_keeps_to_the_street(street):
    eyes = np.array([street.ground_frame.to_ground(c.position) for c in street.cameras])
    np.testing.assert_allclose(np.diff(eyes[:, 0]) * 24, 10.0, rtol=1e-9)
    assert eyes[0, 0] == pytest.approx(0) and 24 < eyes[-1, 0] < LENGTH - 30
    assert len({camera.name for camera in street.cameras}) == len(eyes)


def test_the_road_falls_to_gutters_and_the_kerb_goes_round_corners(plan):
    layout, height = plan.layout, plan.bed_height()
    x = np.linspace(200, 220, 400)
    crown, gutter, kerb = (height(x, np.full(x.size, y)).mean() for y in (0.0, 3.2, 3.7))
    assert 0.05 < crown - gutter < 0.12  # 2.5 % camber, settlements
    assert 0.09 < kerb - gutter < 0.16
    side = layout.sides[1]
    y = np.array([0.0, 8.0, 20.0])
    assert np.all(road.from_middle(side + 0 * y, y, layout) < road.KERB)  # open to the side street
    assert np.all(road.from_middle(side + SIDE_KERB + 0.4 + 0 * y[1:], y[1:], layout) > road.KERB)
    corner = road.from_middle(side + SIDE_KERB + 0.3, road.KERB + 0.3, layout)
    assert corner < road.KERB < road.from_middle(side + SIDE_KERB + 1, road.KERB + 1, layout)


def test_every_gutter_is_near_a_drain_except_where_a_side_street_opens(plan):
    layout = plan.layout
    for side in (-1, 1):
        x = np.sort(layout.drains[np.sign(layout.drains[:, 1]) == side, 0])
        assert np.diff(x).max() <= 1.8 * DRAIN_STEP
    assert len(layout.sides) == 10 and len(layout.drains) > 90


def test_gratings_take_the_water_of_their_gutter(plan):
    """A centimetre of rain on the street: what its drains take does not stand in the gutters."""
    x, y = plan.layout.drains[np.argmin(np.abs(plan.layout.drains[:, 0] - 205))]
    low = -3.8 if y < 0 else 0.5
    grid = Grid((42, 160), (x - 6.4, low), 0.08)
    bed = plan.bed_height()(*np.meshgrid(*grid.centres())).astype(np.float32)
    zero, stands = np.zeros(grid.shape, np.float32), {}
    for drain in (True, False):
        classes = np.zeros(grid.shape, np.uint8)
        if drain:
            across, along = grid.centres()[1][:, None] - y, grid.centres()[0][None] - x
            classes[np.hypot(across, along) < 0.16] = DRAIN
        terrain = Terrain(grid, bed, bed, bed, np.full(grid.shape, MEASURED, np.uint8), classes,
                          zero, np.zeros((*grid.shape, 3), np.float32))  # fmt: skip
        puddles = puddles_of(terrain)
        puddles.rain(np.full(grid.shape, 1e-2))
        gutter = np.abs(grid.centres()[1]) > road.GUTTER
        stands[drain] = float(puddles.depth[gutter].mean())
    assert stands[True] < 0.7 * stands[False]


def test_cars_cross_before_the_drive_and_give_way(plan):
    middle = plan.layout.sides[0]
    arrival = middle / 10.0
    time, _, y, _ = _crossing(middle, arrival)
    on_road = time[np.abs(y) < road.KERB + 2.2]
    assert on_road.size and arrival - on_road.max() > 2.9  # clear before the saloon, 27 m ahead
    assert y[0] < -20 and y[-1] > 20
    time, _, y, _ = _waiting(middle, arrival)
    assert np.all(np.diff(y) <= 1e-12) and y[0] > LINE + 15
    assert np.ptp(y[time > arrival - 3]) == 0 and y[-1] - 2.13 > road.KERB  # stands at the line


def test_names_of_streets(monkeypatch):
    monkeypatch.setenv("RAINSIM_SCENES", "")
    assert find_scene("street:300") is None and find_scene("traffic:62.5") is None
    for name in ("street:59", "street:501", "street:", "street:long", "street:nan", "traffic:-9"):
        with pytest.raises(ParameterError, match=r"60 to 500 m long"):
            find_scene(name)
    with pytest.raises(ParameterError, match="not known"):
        load_scene("bicycle:100")


def test_layouts_differ_by_seed():
    one, other = (long_layout(300.0, seed, (0, 1, 2))[0] for seed in (1, 2))
    assert not np.array_equal(one.dips, other.dips)
    np.testing.assert_array_equal(one.dips, long_layout(300.0, 1, (0, 1, 2))[0].dips)
