"""The twins of streaks, impacts and ripples on a real GPU: `pytest -m gpu`."""

import numpy as np
import pytest

from rainsim.drops import GROUND, RainField, RainSpectrum, Surfaces, impacts
from rainsim.particles.splash_pass import draw_splashes
from rainsim.particles.streaks import draw_streaks, streak_reach
from rainsim.reflection.slope_moments import ripple_moments
from rainsim.scene.types import Camera
from rainsim.water.ripples import RippleTile

pytestmark = pytest.mark.gpu
WIDTH, HEIGHT, EXPOSURE = 320, 240, 1 / 60


@pytest.fixture(scope="module")
def field():
    return RainField(RainSpectrum(80.0), (1.0, 2.0), seed=4)


class Weather:
    """One steady rain."""

    def __init__(self, field):
        self.field = lambda start, stop: field


@pytest.fixture(scope="module")
def surfaces():
    ground = 0.02 * np.sin(np.arange(256, dtype=np.float32) * 0.1)[None] + np.zeros((256, 1))
    top, under = ground.copy(), ground.copy()
    top[60:110, 90:150], under[60:110, 90:150] = 1.5, 1.4
    return Surfaces(0.03, (-1.0, -4.0), ground, top, under)


def looking_down():
    matrix, tilt = np.eye(4), 0.35
    c, s = np.cos(tilt), np.sin(tilt)
    matrix[:3, :3] = np.array([[0, -1, 0], [-s, 0, -c], [c, 0, -s]])
    matrix[:3, 3] = -matrix[:3, :3] @ np.array([0.0, 0.0, 1.5])
    return Camera(WIDTH, HEIGHT, 260.0, 260.0, WIDTH / 2, HEIGHT / 2, matrix)


def depth_of_ground(camera):
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (column + 0.5 - camera.cx) / camera.fx, (row + 0.5 - camera.cy) / camera.fy
    down = (np.stack([x, y, np.ones_like(x)], -1) @ camera.camera_from_world[:3, :3])[..., 2]
    return np.where(down < -1e-3, -1.5 / np.minimum(down, -1e-3), np.inf).astype(np.float32)


def test_streaks_are_those_of_the_cpu(field, surfaces, poisoned):
    from rainsim.cuda.jit import cuda
    from rainsim.cuda.particles.streaks import Streaks

    camera = looking_down()
    depth, far = depth_of_ground(camera), streak_reach(field, camera, EXPOSURE, 8.0)
    twin = Streaks(field, surfaces, WIDTH, HEIGHT)
    for time in (3.0, 3.4):
        wanted = poisoned((HEIGHT, WIDTH))
        draw_streaks(field, surfaces, camera, time, EXPOSURE, depth, far, wanted)
        twin.update(field, camera, time, EXPOSURE, far)
        pictures = []
        for _ in range(2):
            twin.alpha.copy_to_device(poisoned((HEIGHT, WIDTH)))
            twin.draw(cuda.to_device(depth))
            pictures.append(twin.alpha.copy_to_host())
        assert wanted.max() > 0.05
        np.testing.assert_array_equal(*pictures)
        difference = np.abs(pictures[0] - wanted)
        assert (difference > 1e-3).mean() < 1e-3  # a drop at the limit of a kind of mark may differ
        assert np.sqrt(np.mean(difference**2)) < 1e-4


def test_impacts_are_those_of_the_cpu(field, surfaces):
    from rainsim.cuda.drops import Impacts, room_for

    wanted = impacts(field, surfaces, 3.0, 3.03)
    twin = Impacts(field, surfaces, room_for(field, surfaces, 0.03))
    twin.list(field, 3.0, 3.03)
    count = int(twin.lists.found.copy_to_host()[0])
    ids = twin.lists.ids.copy_to_host()[0, :count]
    order = np.argsort(ids)
    np.testing.assert_array_equal(ids[order], wanted.id)
    values = twin.lists.values.copy_to_host()[0, :count][order]
    labels = twin.lists.labels.copy_to_host()[0, :count][order]
    np.testing.assert_allclose(values[:, :3], wanted.position, atol=1e-9)
    np.testing.assert_allclose(values[:, 3], wanted.diameter, rtol=1e-9)
    assert (labels[:, 1] == wanted.kind).all() and (wanted.kind != GROUND).any()


def test_ripples_are_those_of_the_cpu():
    from rainsim.cuda.water.ripples import PUSH_UNIT, Ripples

    rng = np.random.default_rng(0)
    tile = RippleTile(depth=0.02, dtype=np.float32)
    twin = Ripples(tile, 1 / 30)
    for _ in range(20):
        cells, part = rng.integers(0, 256, (300, 2)), rng.integers(0, twin.tile.steps, 300)
        momentum = 5e-6 * rng.random(300)
        pushes = np.zeros((twin.tile.steps, 256, 256))
        np.add.at(pushes, (part, cells[:, 1], cells[:, 0]), momentum)
        tile.advance(
            1 / 30, cells / 256, momentum, (twin.tile.steps - 0.5 - part) / twin.tile.steps / 30
        )
        waiting = np.zeros(twin.pushes.shape, np.int64)
        waiting[: pushes.size] = np.rint(pushes / PUSH_UNIT).astype(np.int64).reshape(-1)
        twin.pushes.copy_to_device(waiting)
        twin.advance()
    wanted, found = ripple_moments(tile.slopes()), twin.moments.copy_to_host()
    scale = np.abs(wanted[..., :2]).max()
    np.testing.assert_allclose(found[..., :2], wanted[..., :2], atol=1e-4 * scale)
    np.testing.assert_allclose(found[..., 2:5], wanted[..., 2:5], atol=2e-4 * scale**2)
    np.testing.assert_allclose(
        found[..., 5], wanted[..., 5], atol=1e-4 * np.abs(wanted[..., 5]).max()
    )


def test_splashes_are_those_of_the_cpu(field, surfaces, poisoned):
    from rainsim.cuda.jit import cuda
    from rainsim.cuda.particles.splash_pass import Splashes
    from rainsim.cuda.particles.streaks import Streaks
    from rainsim.cuda.rain.impact_history import RecentImpacts

    camera = looking_down()
    depth = depth_of_ground(camera)
    water = np.zeros(surfaces.shape, np.float32)
    water[:, 60:140] = 0.006
    streaks = Streaks(field, surfaces, WIDTH, HEIGHT)
    recent = RecentImpacts(Weather(field), surfaces, 30, 2)
    twin = Splashes(streaks, recent)
    for time in (3.0, 3.4, 3.4 + 1 / 30):
        recent.update(int(time * 30 + 1e-6))
        wanted = poisoned((HEIGHT, WIDTH))
        draw_splashes(field, surfaces, camera, time, EXPOSURE, water, 2e-4, depth, wanted)
        streaks.update(field, camera, time, EXPOSURE, 3.0)
        twin.update(field, 2e-4)
        pictures = []
        for _ in range(2):
            twin.alpha.copy_to_device(poisoned((HEIGHT, WIDTH)))
            streaks.draw(cuda.to_device(depth))
            twin.draw(cuda.to_device(water))
            pictures.append(twin.alpha.copy_to_host())
        assert wanted.max() > 0.05
        np.testing.assert_array_equal(*pictures)
        difference = np.abs(pictures[0] - wanted)
        assert (difference > 1e-3).mean() < 1e-3
        assert np.sqrt(np.mean(difference**2)) < 1e-4


def test_a_film_is_its_frames():
    """What is made ready while the frame before is drawn does not show in it."""
    import dataclasses

    from rainsim.config.settings import Config, mm_per_hour
    from rainsim.cuda.render.renderer import Renderer
    from rainsim.cuda.simulation import simulate
    from rainsim.pipeline import extract_terrain
    from scenes import tiny_scene

    scene = tiny_scene()
    settings = Config().replace(
        rate=mm_per_hour(50.0), past=4e-3, frames=5, width=WIDTH, extent=4.0, spacing=0.05, fps=30.0
    )
    camera = scene.cameras[0].resized(WIDTH, HEIGHT)
    turn = np.eye(4)
    turn[0, 3] = 0.02
    cameras = [camera]
    for _ in range(4):
        matrix = turn @ cameras[-1].camera_from_world
        cameras.append(dataclasses.replace(camera, camera_from_world=matrix))
    terrain = extract_terrain(scene, settings)
    films, ledgers = [], []
    for ahead in (False, True):
        renderer = Renderer(scene, terrain, settings, camera)
        shots = (
            (camera, state, None)
            for camera, state in zip(cameras, simulate(terrain, settings), strict=False)
        )
        frames = renderer.film(shots) if ahead else (renderer.draw(*shot) for shot in shots)
        films.append([])
        for picture, report in frames:
            films[-1].append(picture.copy())
            ledgers.append(report.ledger)
    assert len(films[1]) == 5 and (films[0][1] != films[0][2]).any()
    np.testing.assert_array_equal(*films)
    assert ledgers[:5] == ledgers[5:] and ledgers[4]["rain"] > ledgers[1]["rain"] > 0


def test_drips_are_those_of_the_cpu(poisoned):
    """From the tiny scene's table, raised: what is in the air, the account, and pictures of it."""
    from dataclasses import replace
    from itertools import islice

    from rainsim import simulation
    from rainsim.config.settings import Config, mm_per_hour
    from rainsim.cuda.drops import Impacts
    from rainsim.cuda.jit import cuda
    from rainsim.cuda.particles.splash_pass import Splashes
    from rainsim.cuda.particles.streaks import Streaks
    from rainsim.cuda.rain.drip_list import DripList
    from rainsim.cuda.simulation import simulate
    from rainsim.pipeline import extract_terrain
    from rainsim.rain.dripping import drip_impacts, drips_seen
    from scenes import tiny_scene

    settings = Config().replace(
        rate=mm_per_hour(80.0), past=4e-3, frames=16, extent=1.0, spacing=0.02, fps=30.0,
        wind=(1.5, 0.3), scheme="lean",
    )  # fmt: skip
    terrain, runs = extract_terrain(tiny_scene(), settings), []
    high = np.where(terrain.top - terrain.bed > 0.3, np.float32(0.8), np.float32(0))
    terrain = replace(terrain, top=terrain.top + high, underside=terrain.underside + high)
    for _ in range(2):
        lists = [
            (state.drips, state.drip_id, state.ledger)
            for state in islice(simulate(terrain, settings), settings.frames)
        ]
        runs.append(lists)
    for (a, a_id, a_ledger), (b, b_id, b_ledger) in zip(*runs, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a_id, b_id)
        assert a_ledger == b_ledger
    states = list(islice(simulation.simulate(terrain, settings), settings.frames))
    for state, (table, ids, ledger) in zip(states, runs[0], strict=True):
        np.testing.assert_array_equal(ids, state.drip_id)
        np.testing.assert_allclose(table, state.drips, rtol=1e-9, atol=1e-12)
        for name in ("initial", "rain", "obstacles", "airborne"):
            assert ledger[name] == pytest.approx(state.ledger[name], rel=1e-6), name
        assert abs(ledger["residual"]) < 1e-6
    assert len(states[0].drips) > 10 and states[-1].ledger["rain"] > states[1].ledger["rain"] > 0

    last, surfaces = states[-1], simulation.surfaces_of(terrain)
    weak = RainField(RainSpectrum(1e-6), seed=4)
    camera = looking_down()
    matrix = camera.camera_from_world.copy()
    matrix[:3, 3] -= matrix[:3, :3] @ np.array([-1.2, 0.2, -0.9])
    camera = Camera(WIDTH, HEIGHT, 260.0, 260.0, WIDTH / 2, HEIGHT / 2, matrix)
    depth, water = np.full((HEIGHT, WIDTH), 3.0, np.float32), last.depth
    streaks = Streaks(weak, surfaces, WIDTH, HEIGHT)
    streaks.drips = DripList()
    streaks.drips.fill(last.drips, last.drip_id)
    twin = Splashes(streaks, Impacts(weak, surfaces, 5))
    streaks.update(weak, camera, last.time, EXPOSURE, 0.51)
    twin.update(weak, 2e-4)
    pictures = []
    for _ in range(2):
        for each, given in ((streaks, depth), (twin, water)):
            each.alpha.copy_to_device(poisoned((HEIGHT, WIDTH)))
            each.draw(cuda.to_device(given))
        pictures.append(np.stack([streaks.alpha.copy_to_host(), twin.alpha.copy_to_host()]))
    np.testing.assert_array_equal(*pictures)
    wanted, asked = poisoned((HEIGHT, WIDTH)), poisoned((HEIGHT, WIDTH))
    draw_streaks(
        weak, surfaces, camera, last.time, EXPOSURE, depth, 0.51, wanted,
        more=drips_seen(last.drips, last.time, EXPOSURE),
    )  # fmt: skip
    landed = drip_impacts(
        last.drips, last.drip_id, surfaces, last.time - 0.12, last.time + EXPOSURE
    )
    draw_splashes(
        weak, surfaces, camera, last.time, EXPOSURE, water, 2e-4, depth, asked, more=landed
    )
    for found, cpu in zip(pictures[0], (wanted, asked), strict=True):
        assert cpu.max() > 0.02
        assert (np.abs(found - cpu) > 1e-3).mean() < 1e-3
        assert np.sqrt(np.mean((found - cpu) ** 2)) < 1e-4
