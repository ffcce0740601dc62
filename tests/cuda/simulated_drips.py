"""The drips' twin in numba's CUDA simulator; `tests/cuda/test_cuda.py` runs this file."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_drops import Ground

from rainsim.cuda import simulated
from rainsim.cuda.drops import Impacts
from rainsim.cuda.particles.splash_pass import Splashes
from rainsim.cuda.particles.streaks import Streaks
from rainsim.cuda.rain.dripping import LISTED, DripList, Drips, volumes
from rainsim.cuda.rain.settling import PUSH_UNIT, VOLUME_UNIT
from rainsim.cuda.render.rain_pass import RainPass
from rainsim.drops import GROUND, OBSTACLE, RainField, RainSpectrum, Surfaces
from rainsim.drops import Impacts as Hits
from rainsim.errors import BackendError
from rainsim.particles.splash_pass import draw_splashes
from rainsim.particles.streaks import draw_streaks
from rainsim.rain.dripping import Drips as HostDrips
from rainsim.rain.dripping import drip_impacts, drips_seen
from rainsim.scene.types import Camera
from rainsim.water.ripples import LAYERS, tile_impacts

assert simulated()
# Plain numpy numbers warn where a GPU's wrap.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
STEP, WIND, ROUGHNESS, FINE = 1 / 20, (1.5, -0.7), 0.03, 2e-6
FIELD = RainField(RainSpectrum(20.0), seed=4)


def shelves():
    """A board over a lower table, beside a block that stands on the ground."""
    ground = np.zeros((12, 12), np.float32)
    top, under = ground.copy(), ground.copy()
    top[2:9, 3:9], under[2:9, 3:9] = 0.3, 0.25
    top[4:7, 3:6], under[4:7, 3:6] = 0.7, 0.65
    top[9:11, 1:3] = 0.2
    return Surfaces(0.08, (-0.5, -0.4), ground, top, under)


def hits_on(surfaces, rng):
    """Drops that fell on objects."""
    row, column = rng.integers(0, 12, (2, 60))
    kind = np.where(surfaces.top[row, column] > 0.05, OBSTACLE, GROUND).astype(np.uint8)
    many = len(row)
    return Hits(
        np.zeros((many, 3)), np.zeros((many, 3)), 2e-3 + 4e-3 * rng.random(many), np.zeros(many),
        kind, row.astype(np.int32), column.astype(np.int32), np.arange(many, dtype=np.uint64),
    )  # fmt: skip


@pytest.fixture(scope="module")
def steps():
    """Both sides, ten steps of rain; each step's table, ids, depths, momentum and volumes."""
    surfaces = shelves()
    host = HostDrips(surfaces, seed=3)
    rng = np.random.default_rng(2)
    for n in range(-6, 0):  # something is in the air at the start
        host.take_rain(hits_on(surfaces, rng), FINE)
        host.advance(n * STEP, (n + 1) * STEP, WIND, ROUGHNESS)
    start = host.held + host.airborne
    twin = Drips(host, Impacts(FIELD, surfaces, 5), 1e-4, STEP, ROUGHNESS)
    came = returned = 0.0
    found = []
    for n in range(10):
        hits, page = hits_on(surfaces, rng), (n + 1) % 2
        times = n * STEP, (n + 1) * STEP
        came += host.take_rain(hits, FINE)
        hit = hits.kind == OBSTACLE
        goes = host.point[hits.row[hit], hits.column[hit]]
        goes = np.where(goes < 0, len(host._store), goes)
        water = np.rint(hits.volume[hit] / VOLUME_UNIT).astype(np.int64)
        coming = twin.came[page].copy_to_host()
        np.add.at(coming, goes, water)
        twin.came[page].copy_to_device(coming)
        rows, columns, volume = host.advance(*times, WIND, ROUGHNESS)
        returned += volume.sum()
        depth = np.zeros(surfaces.shape)
        np.add.at(depth, (rows, columns), volume / surfaces.spacing**2)
        rings = drip_impacts(*host.falling(), surfaces, *times)
        rings = rings.take(rings.kind == GROUND)
        ground = Ground(surfaces, share=0.5)
        twin.update(*times, WIND, FINE)
        twin.launch(page, ground, ground, 0)
        momentum = (
            ground.pushes.sum() * PUSH_UNIT,
            tile_impacts(rings, 2.0 / LAYERS, 1.0, times[1])[1].sum(),
        )
        found.append((*twin.pages[page].fetch(), ground.depths(surfaces), momentum,
                      (*volumes(twin.account), *host.falling(), depth, host.held, host.airborne,
                       returned)))  # fmt: skip
    return surfaces, found, came, start


def test_what_falls_and_lands_is_that_of_the_cpu(steps):
    _, found, came, start = steps
    for table, ids, depth, momentum, rest in found:
        held, airborne, returned, fine, wanted, wanted_ids, wanted_depth, *asked = rest
        order = np.argsort(wanted_ids)
        np.testing.assert_array_equal(ids, wanted_ids[order])
        np.testing.assert_allclose(table, wanted[order], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(depth, wanted_depth, atol=1e-13)
        np.testing.assert_allclose((held, airborne, returned), asked, rtol=1e-7, atol=1e-15)
        assert momentum[0] == pytest.approx(momentum[1], rel=1e-6)
    assert start + came == pytest.approx(held + airborne + returned, rel=1e-7)
    assert fine == pytest.approx(10 * FINE * 0.08**2 * 46, rel=1e-6)
    assert returned > 1e-6 and airborne > 0 and max(m for *_, (m, _), _ in found) > 0
    assert any((a[2] != b[2]).any() for a, b in pairwise(found))


def test_a_list_without_room_is_counted(steps):
    surfaces = steps[0]
    twin = Drips(HostDrips(surfaces, seed=3), Impacts(FIELD, surfaces, 5), 1e-4, STEP, ROUGHNESS)
    twin.pages = [DripList(2), DripList(2)]
    many = len(twin.came[1].copy_to_host())
    twin.came[1].copy_to_device(np.full(many, round(1e-6 / VOLUME_UNIT)))
    ground = Ground(surfaces, share=0.5)
    twin.update(0.0, STEP, WIND, 0.0)
    twin.launch(1, ground, ground, 0)
    assert twin.account[LISTED] > 2
    with pytest.raises(BackendError, match="set drips to false, or use backend cpu"):
        twin.check()


def test_what_a_recorded_queue_holds_changes_as_the_drips_are_sent():
    """Not before: the frame before may be recorded once more until then."""
    rain, marks = RainPass.__new__(RainPass), []
    rain.splashes = rain.drips = None
    rain.streaks = SimpleNamespace(version=1, drips=None)
    for count in (3, 5, 9, 4):
        state = SimpleNamespace(
            drips=np.ones((count, 9)), drip_id=np.arange(count, dtype=np.uint64)
        )
        rain.send_drips(state)
        assert rain.streaks.drips is rain.drips and rain.drips.fetch()[1].tolist() == [
            *range(count)
        ]
        marks.append(rain.dependencies())
    assert marks[0] == marks[1] != marks[2] == marks[3]


def test_pictures_are_those_of_the_cpu(steps, poisoned):
    surfaces, found, *_ = steps
    width, height, time, exposure, film = 32, 24, 9 * STEP, 1 / 60, 2e-4
    table, ids = found[-1][4][4:6]
    matrix = np.diag([1.0, -1.0, -1.0, 1.0])
    matrix[2, 3] = 1.2  # 1.2 m up, looking down
    camera = Camera(width, height, 40.0, 40.0, width / 2, height / 2, matrix)
    depth = np.full((height, width), 1.2, np.float32)
    water = np.full(surfaces.shape, 0.004, np.float32)
    streaks = Streaks(FIELD, surfaces, width, height, depth)
    streaks.update(FIELD, camera, time, exposure, 0.51)  # hardly any rain
    streaks.drips = DripList(len(ids))
    streaks.drips.fill(table, ids)
    streaks.launch()
    wanted, without = poisoned((height, width)), poisoned((height, width))
    more = drips_seen(table, time, exposure)
    draw_streaks(FIELD, surfaces, camera, time, exposure, depth, 0.51, wanted, more=more)
    draw_streaks(FIELD, surfaces, camera, time, exposure, depth, 0.51, without)
    assert np.abs(wanted - without).max() > 0.02
    np.testing.assert_allclose(streaks.alpha.copy_to_host(), wanted, atol=1e-5)

    twin = Splashes(streaks, Impacts(FIELD, surfaces, 5), water)  # of drips alone
    twin.alpha.copy_to_device(poisoned((height, width)))
    twin.update(FIELD, film)
    twin.launch()
    landed = drip_impacts(table, ids, surfaces, time - 0.12, time + exposure)
    few = RainField(RainSpectrum(1e-6), seed=4)
    draw_splashes(few, surfaces, camera, time, exposure, water, film, depth, wanted, more=landed)
    assert wanted.max() > 0.02 and (wanted > 1e-4).sum() > 10
    np.testing.assert_allclose(twin.alpha.copy_to_host(), wanted, atol=1e-5)
