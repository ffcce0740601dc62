"""Drips: what falls on objects leaves at their edges, is counted, and comes down in time."""

from itertools import islice

import numpy as np
import pytest

from made_rain import config, ground, mm_per_hour, states
from rainsim.drops import OBSTACLE, Surfaces, drop_volume
from rainsim.rain.dripping import Drips, drift, drip_impacts, drips_seen, fall_time, fallen
from rainsim.rain.size_distribution import terminal_speed
from rainsim.simulation import simulate


def table(height=0.7, thick=0.04, size=60, half=15):
    """A square table top in the middle of 1.2 x 1.2 m of level ground."""
    level = np.zeros((size, size), np.float32)
    top, under = level.copy(), level.copy()
    inside = np.s_[size // 2 - half : size // 2 + half, size // 2 - half : size // 2 + half]
    top[inside], under[inside] = height, height - thick
    return Surfaces(0.02, (-0.6, -0.6), level, top, under)


def rain_on(drips, steps=60, step=0.05, wind=(0, 0)):
    """Rain on the objects; return what came and where and how much of it reached the ground."""
    came, rows, columns, volumes = 0.0, [], [], []
    for n in range(steps):
        came += drips.take_even_rain(mm_per_hour(60.0) * step)
        for into, values in zip(
            (rows, columns, volumes), drips.advance(n * step, (n + 1) * step, wind), strict=True
        ):
            into.append(values)
    return came, np.concatenate(rows), np.concatenate(columns), np.concatenate(volumes)


def test_a_hollow_that_no_edge_is_reached_from_keeps_its_water():
    surfaces = table()
    surfaces.top[28:32, 28:32] = 0.3  # a pot in the table, 40 cm deep
    point = Drips(surfaces).point
    assert (point[28:32, 28:32] == -2).all()
    assert (point[20:26, 20:40] >= 0).all()


def test_the_water_is_on_the_object_in_the_air_or_on_the_ground():
    for wet in (True, False):
        surfaces = table()
        drips = Drips(surfaces, seed=1, wet=wet)
        before = drips.held
        came, _, _, volumes = rain_on(drips)
        assert came == pytest.approx(mm_per_hour(60) * 3.0 * 0.36, rel=1e-6)
        assert before + came == pytest.approx(
            drips.held + drips.airborne + volumes.sum(), rel=1e-12
        )
        assert volumes.sum() > 0.2 * came if wet else volumes.sum() < 0.5 * came


def test_drips_land_at_the_foot_of_the_edge_and_nowhere_under_the_table():
    surfaces = table()
    _, rows, columns, volumes = rain_on(Drips(surfaces))
    beside = np.maximum(np.abs(rows - 29.5), np.abs(columns - 29.5))
    assert len(volumes) > 100 and set(np.unique(beside)) == {15.5}
    sides = [(rows == 14), (rows == 45), (columns == 14), (columns == 45)]
    shares = [volumes[s].sum() / volumes.sum() for s in sides]
    assert min(shares) > 0.15  # a level top sheds to all sides


def test_each_quarter_of_a_level_top_goes_to_its_own_edge_and_a_slope_downhill():
    drips = Drips(table())
    south = drips.point[16, 30]
    assert drips._row[south] == 14 and drips._row[drips.point[43, 30]] == 45
    surfaces = table()
    tilted = surfaces.top + np.where(surfaces.top > 0, 0.2 * np.arange(60)[:, None] * 0.02, 0)
    drips = Drips(Surfaces(0.02, (-0.6, -0.6), surfaces.ground, tilted, surfaces.underside))
    inside = drips.point[17:43, 20:40]
    assert (drips._row[inside] != 45).all()  # not over the upper edge
    assert (drips.point[:10] == -1).all()


def test_a_wall_sheds_at_its_foot_without_drops():
    surfaces = table()
    block = Surfaces(0.02, (-0.6, -0.6), surfaces.ground, surfaces.top, surfaces.ground)
    drips = Drips(block)
    came, rows, columns, volumes = rain_on(drips)
    assert len(drips.falling()[1]) == 0 and drips.airborne == 0
    assert volumes.sum() == pytest.approx(came, rel=1e-9)
    assert set(np.maximum(np.abs(rows - 29.5), np.abs(columns - 29.5))) == {15.5}


def test_drips_from_a_roof_go_on_from_the_table_below():
    low = table()
    top, under = low.top.copy(), low.underside.copy()
    top[26:34, 26:34], under[26:34, 26:34] = 1.4, 1.3
    both = Surfaces(0.02, (-0.6, -0.6), low.ground, top, under)
    drips = Drips(both)
    before = drips.held
    came, rows, columns, volumes = rain_on(drips)
    assert before + came == pytest.approx(drips.held + drips.airborne + volumes.sum(), rel=1e-12)
    assert set(np.maximum(np.abs(rows - 29.5), np.abs(columns - 29.5))) == {15.5}
    hits = drip_impacts(*drips.falling(), both, 0.0, 9.0)
    assert {0, OBSTACLE} == set(hits.kind)


def test_a_drip_falls_from_rest_with_drag():
    assert fall_time(0.05, 4.5e-3) == pytest.approx(np.sqrt(2 * 0.05 / 9.81), rel=0.01)
    for height in (0.2, 3.0, 30.0):
        way, speed = fallen(fall_time(height, 4.5e-3), 4.5e-3)
        assert way == pytest.approx(height)
        assert speed < terminal_speed(4.5e-3)
    assert speed == pytest.approx(terminal_speed(4.5e-3), rel=0.01)
    # against small steps of dv/dt = g (1 - v^2 / vt^2)
    z = v = 0.0
    for _ in range(5000):
        v += 9.81 * (1 - (v / terminal_speed(4.5e-3)) ** 2) * 1e-4
        z += v * 1e-4
    assert fallen(0.5, 4.5e-3)[0] == pytest.approx(z, rel=1e-3)


def test_what_is_drawn_is_where_the_drips_are():
    surfaces = table()
    drips = Drips(surfaces)
    rain_on(drips)
    listed, ids = drips.falling()
    assert len(ids) == len(np.unique(ids)) > 5
    seen = drips_seen(listed, 3.0, 1 / 60)
    position, velocity, diameter = seen[:, :3], seen[:, 3:6], seen[:, 6]
    assert (position[:, 2] <= 0.66 + 1e-6).all() and (position[:, 2] > 0).all()
    end = position + velocity / 60
    assert (end[:, 2] > -1e-9).all() and (velocity[:, 2] < 0).all()
    again = drips_seen(listed, 3.0 + 1 / 60, 1 / 60)[:, :3]
    assert len(again) > 0
    assert 3.9e-3 * 0.3 < diameter.max() <= 5.2e-3


@pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 1e-12), (np.float32, 1e-8)])
def test_frames_with_a_roof_close_the_ledger_in_wind_and_gusts(dtype, bound):
    x = np.abs(-1.0 + (np.arange(40) + 0.5) * 0.05)
    under = (x[:, None] < 0.5) & (x[None] < 0.5)
    roof = ground(top=np.where(under, 0.6, 0.0), underside=np.where(under, 0.55, 0.0))
    for past in (0.0, 3e-3):
        windy = config(rate=mm_per_hour(80.0), past=past, wind=(4.0, 0.5), gusts=0.3)
        run = list(islice(simulate(roof, windy, dtype=dtype), 25))
        ledger = run[-1].ledger
        assert abs(ledger["residual"]) < bound
        assert ledger["obstacles"] > 0 and (ledger["airborne"] > 0) == (past > 0)
    assert len(run[-1].drips) > 3 and run[-1].drips.shape[1] == 9
    without = states(
        roof, config(rate=mm_per_hour(80.0), past=3e-3, wind=(4.0, 0.5), drips=False), 25
    )[-1]
    assert len(without.drips) == 0 and abs(without.ledger["residual"]) < 1e-8
    assert without.ledger["obstacles"] > ledger["obstacles"]


def test_drips_are_those_of_the_seed():
    surfaces = table()
    tables = []
    for seed in (1, 1, 2):
        drips = Drips(surfaces, seed)
        rain_on(drips, steps=20)
        tables.append(drips.falling()[0].tobytes())
    assert tables[0] == tables[1] != tables[2]


def test_ground_alone_has_no_drips():
    level = np.zeros((5, 5), np.float32)
    drips = Drips(Surfaces(0.02, (0, 0), level, level, level))
    came, _, _, volumes = rain_on(drips, steps=2)
    assert came == 0 == volumes.sum() == drips.held
    assert drop_volume(4.5e-3) > 0


def test_wind_carries_drips_as_drag_has_it():
    # against small steps of dw/dt = (u - w) g / v tanh(g t / v)
    speed, x, w = terminal_speed(4.5e-3), 0.0, 0.0
    for n in range(8000):
        w += (1 - w) * 9.81 / speed * np.tanh(9.81 * n * 1e-4 / speed) * 1e-4
        x += w * 1e-4
    assert drift(0.8, 4.5e-3) == pytest.approx(x, rel=2e-3)
    surfaces = table()
    still, blown = Drips(surfaces), Drips(surfaces)
    rain_on(still)
    _, _, columns, _ = rain_on(blown, wind=(8.0, 0.0))
    assert columns.max() > 45  # beyond the foot of the edge
    (calm, ids), (windy, same) = still.falling(), blown.falling()
    assert len(ids) > 3 and (ids == same).all()
    calm, windy = (drip_impacts(t, ids, surfaces, 0.0, 9.0).position for t in (calm, windy))
    moved = windy[:, 0] - calm[:, 0]
    assert (moved > 0.01).all() and (moved < 0.3).all()
    assert (drips_seen(blown.falling()[0], 2.9, 1 / 60)[:, 3] > 0).all()


def test_tops_are_copied_only_where_the_ground_stands_higher():
    level = np.zeros((4, 4), np.float32)
    top = level + np.float32(0.5)
    assert Surfaces(0.02, (0, 0), level, top, level).top is top
    top[1, 2] = -0.5
    raised = Surfaces(0.02, (0, 0), level, top, level).top
    assert raised[1, 2] == 0 and top[1, 2] == -0.5


def test_open_ground_around_changes_no_drip_point():
    near, wide = (Drips(table(size=size), seed=1) for size in (40, 60))
    inner = wide.point[10:50, 10:50]
    np.testing.assert_array_equal(near.point >= 0, inner >= 0)
    assert (near.point >= 0).sum() == 900 and not (wide.point[:10] >= 0).any()
    for points in (near.point, inner):  # each point gathers as many cells, whatever its number
        counts = np.unique(points[points >= 0], return_counts=True)[1]
        assert counts.sum() == 900 and counts.min() > 0
