"""What lies flat above the ground: found, filled by rain, run off from, drawn."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.look import light_up
from factories import off_ground
from made_rain import centres, config, ground, states
from rainsim import terrain as terrains
from rainsim.config.settings import Config, mm_per_hour
from rainsim.errors import ParameterError
from rainsim.io.states import read_state, write_state
from rainsim.pipeline import extract_terrain
from rainsim.reflection import wet_tops
from rainsim.reflection.water_pass import WaterTables, choice_of
from rainsim.reflection.wet_tops import DRY_TOPS, TopMaps
from rainsim.render import aov
from rainsim.render.frame import is_same
from rainsim.render.renderer import Renderer
from rainsim.scene.view import View, pixel_ray
from rainsim.simulation import simulate, surfaces_of, tops_drawn, tops_of
from rainsim.terrain.kept_terrain import kept_terrain
from rainsim.terrain.tops import find_tops, gaps_in, note_of
from rainsim.terrain.types import NO_TOPS
from rainsim.water.on_objects import Objects
from rainsim.water.ripples import ring_reach
from rainsim.water.top_water import PINNED, RAINS, TopWater, sheet_depth
from scenes import tiny_scene

F4 = np.float32
SOAKED = off_ground(supply=9)


def with_tops(terrain):
    return replace(terrain, tops=find_tops(terrain))


def with_table(height=0.7, half=0.5, tilt=0.0, centre=(0.0, 0.0), rough=0.0, hollow=0.0):
    """The test ground with a slab on thin air; `tilt` is a slope along x, `hollow` a dip [m]."""
    x, y = centres()
    x, y = x - centre[0], y - centre[1]
    inside = (np.abs(x) <= half) & (np.abs(y) <= half)
    noise = np.random.default_rng(3).normal(0, rough, x.shape) if rough else 0
    surface = height + tilt * x + noise - hollow * np.maximum(1 - (x * x + y * y) / 0.06, 0)
    top = np.where(inside, surface, 0)
    return with_tops(ground(top=top, underside=np.where(inside, surface - 0.04, 0)))


# ---- found


def test_a_table_is_found_with_its_level_area_and_cells():
    tops = with_table().tops
    assert len(tops) == 1 and tops.level.all()
    assert tops.surface[0, 0] == pytest.approx(0.7, abs=1e-6)
    assert tops.area[0] == pytest.approx(1.0, rel=0.1)
    x, y = centres()
    assert (tops.index[(np.abs(x) < 0.4) & (np.abs(y) < 0.4)] == 0).all()
    assert (tops.index[(np.abs(x) > 0.7)] == -1).all()
    held = tops.holds[tops.cells_of(0)].sum() * tops.spacing**2
    assert held == pytest.approx(1.0, rel=0.1)
    assert not tops.holds[[0, -1]].any() and not tops.holds[:, [0, -1]].any()
    assert "1 flat top " in next(note_of(tops)) and "0.70 m" in next(note_of(tops))


def test_what_slopes_has_no_patch_and_what_is_rough_or_low_is_no_top():
    tilted = with_table(tilt=0.15).tops
    assert len(tilted) == 1 and not tilted.level.any()
    assert tilted.surface[0, 1] == pytest.approx(0.15, rel=0.02)
    for other in (with_table(rough=0.03), with_table(height=0.2), with_table(half=0.15)):
        assert other.tops is NO_TOPS
    assert list(note_of(NO_TOPS)) == []


def test_maps_with_holes_and_tops_at_the_border():
    plain = with_table(centre=(0.8, -0.9))  # half of it beyond the map
    assert len(plain.tops) == 1
    top = plain.top.copy()
    top[3:5, 30:32] = np.nan
    holed = find_tops(replace(plain, top=top))
    assert len(holed) == 1 and np.isfinite(holed.relief).all()
    assert np.isfinite(holed.surface).all()
    everything = replace(plain, top=np.full_like(top, np.nan))
    assert find_tops(everything) is NO_TOPS


def test_tops_are_kept_and_written_to_the_byte(tmp_path, monkeypatch):
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path / "kept"))
    scene = tiny_scene(table=0.4)
    settings = Config().replace(extent=1.0, spacing=0.025).terrain
    first, again = kept_terrain(scene, settings), kept_terrain(scene, settings)
    terrains.write_terrain(tmp_path / "map", first)
    read = terrains.read_terrain(tmp_path / "map")
    assert len(first.tops) == 1
    for other in (again, read):
        for name, values in first.tops.arrays().items():
            np.testing.assert_array_equal(other.tops.arrays()[name], values)


def planks(dark, angle=0.35, grain=0.0):
    """Brightness of boards of 10 cm whose gaps of 5 mm are darker by a share, in cells of 5 mm."""
    y, x = np.indices((120, 120)) * 5e-3
    across = (x * np.cos(angle) + y * np.sin(angle)) % 0.1
    gap = np.abs(across - 0.05) < 2.6e-3
    noise = np.random.default_rng(2).normal(0, grain, gap.shape)
    return 0.3 * (1 - dark * gap) * (1 + noise), gap


def test_faint_gaps_between_planks_are_found_whole_and_grain_is_none():
    for dark in (0.1, 0.3):
        light, gap = planks(dark, grain=0.01)
        found = gaps_in(light, np.ones_like(light), 5e-3)
        inner = np.s_[12:-12, 12:-12]
        assert found[inner][gap[inner]].mean() > 0.9, dark
        assert found[inner][~gap[inner]].mean() < 0.05, dark
    light, _ = planks(0.0, grain=0.03)
    light[60, 60:63] *= 0.5  # a knot
    assert gaps_in(light, np.ones_like(light), 5e-3).mean() < 0.01


# ---- filled


def test_water_stands_in_the_hollow_and_pinned_at_the_edge_and_no_more():
    water = TopWater(with_table(hollow=5e-3))
    area = water.tops.holds.sum() * water.tops.spacing**2
    assert water.after(RAINS[1])[0] == pytest.approx(RAINS[1] * area, rel=1e-6)  # all stays
    assert water.after(0.1)[0] < 0.06 * area  # most has run off
    assert water.after(0.1)[0] == pytest.approx(water.capacity[0], rel=1e-6)
    assert water.capacity[0] > 0.3 * PINNED * area
    assert (np.diff(water.volumes[:, 0]) >= -1e-15).all()
    full = water.depths[-1][water.tops.cells_of(0)]
    middle = full[full.shape[0] // 2, full.shape[1] // 2]
    assert middle > full[full.shape[0] // 2, 8] and middle > 3e-3
    assert (water.depths[:, ~water.tops.holds] == 0).all()
    assert water.after(3e-3, evaporated=1e-3)[0] < water.after(3e-3)[0] - 0.5e-3 * area
    stages = water.stage(water.volumes[3])
    assert stages[0] == pytest.approx(3, abs=1e-5)


def test_a_board_between_gaps_holds_what_its_edges_pin():
    plain = with_table()
    holds = plain.tops.holds.copy()
    holds[:, ::4] = False
    parted = TopWater(replace(plain, tops=replace(plain.tops, holds=holds)))
    assert 0 < parted.capacity[0] < TopWater(plain).capacity[0]


def test_a_drawn_puddle_goes_on_over_gaps_and_keeps_its_depth_beside_them():
    plain = with_table()
    holds = plain.tops.holds.copy()
    holds[:, ::8] = False
    water = TopWater(replace(plain, tops=replace(plain.tops, holds=holds)))
    np.testing.assert_array_equal(water.drawn[:, holds], water.depths[:, holds])
    gap = ~holds & np.roll(holds, 1, axis=1) & np.roll(holds, -1, axis=1)
    beside = np.maximum(np.roll(water.depths, 1, axis=2), np.roll(water.depths, -1, axis=2))
    assert (water.depths[:, gap] == 0).all() and (water.drawn[-1, gap] > 0).mean() > 0.5
    assert (water.drawn[:, gap] <= beside[:, gap]).all()


def test_full_tops_take_no_more_rain():
    made, settings = with_table(hollow=5e-3), config(rate=mm_per_hour(5.0))
    start = settings.at(0.0)
    objects = Objects(surfaces_of(made), start, *tops_of(made, settings, start))
    found = []
    for rain in (0, 1e-3, 0.5, 0.1):
        objects.take_even_rain(rain)
        found.append(objects.top_water()[0])
    assert found[0] < found[1] < found[2] == found[3]
    assert found[2] == pytest.approx(TopWater(made).capacity[0], rel=1e-6)


def test_what_stands_on_tops_is_new_to_a_frame_only_when_it_changes():
    tables = WaterTables(with_table(hollow=5e-3), ring_reach(5e-3, 0.0, 5.0))
    half, full = (tables.top_water.volumes[n] for n in (3, -1))
    first = tables.tops_with(half, 0.0)
    assert first.water[0, 0] == pytest.approx(3, abs=1e-5) and first.water[0, 1] == 0
    assert is_same(tables.tops_with(half.copy(), 0.0), first)
    rainy, fuller = tables.tops_with(half, mm_per_hour(5.0)), tables.tops_with(full, 0.0)
    assert rainy.water[0, 1] == pytest.approx(sheet_depth(mm_per_hour(5.0)))
    assert fuller.water[0, 0] == len(RAINS) - 1 and fuller.water[0, 1] == 0
    assert not is_same(fuller, first)
    assert first.water[0, 0] == pytest.approx(3, abs=1e-5)


def test_the_sheet_is_nusselts():
    assert sheet_depth(0.0) == 0
    thin, thick = sheet_depth(mm_per_hour(5.0)), sheet_depth(mm_per_hour(40.0))
    assert thick == pytest.approx(2 * thin) and 0.1e-3 < thin < 1e-3


@pytest.mark.parametrize("dtype, least", [
    pytest.param(np.float64, 1e-9, marks=pytest.mark.slow), (np.float32, 1e-6),
])  # fmt: skip
def test_rain_fills_a_table_then_runs_off_and_the_ledger_closes(dtype, least):
    made = with_table(hollow=5e-3)
    rain = mm_per_hour(900.0)
    run = states(made, config(rate=rain, fps=2.0, frames=20), 20, dtype)
    volume = np.array([state.top_water[0] for state in run])
    assert all(abs(state.ledger["residual"]) < least for state in run)
    capacity = TopWater(made).capacity[0]
    # The warm-up's second of rain is on it; drops that hit its sides are its too.
    grown = volume[4] - volume[0]
    assert grown == pytest.approx(rain * run[4].time * 1.0, rel=0.25) and grown > 0.1 * capacity
    assert (np.diff(volume) >= -least / 1000).all() and volume[-1] == pytest.approx(
        capacity, rel=0.01
    )
    # Full, it gives on what it gets; what hangs at its edges falls in drops, not all at once.
    held = [state.ledger["obstacles"] for state in run]
    assert held[-1] - held[-4] < 0.5 * (held[4] - held[1])
    # Without tops the rain is at the ground earlier.
    off = states(made, config(rate=rain, fps=2.0, frames=5, tops="off"), 5, dtype)
    assert off[-1].ledger["obstacles"] < run[4].ledger["obstacles"] - 0.5 * volume[4]
    assert len(off[-1].top_water) == 0


def test_past_rain_is_there_from_the_start_and_a_slope_keeps_none():
    made = with_table(hollow=5e-3)
    wet = states(made, config(rate=0.0, past=2e-3), 3)
    assert wet[0].top_water[0] == pytest.approx(TopWater(made).after(2e-3)[0], rel=1e-6)
    assert wet[0].top_water[0] == wet[-1].top_water[0] > 1e-4
    assert wet[0].ledger["initial"] > wet[0].top_water[0]
    dry = states(made, config(rate=0.0, past=2e-3, drying=20 * 3600.0), 1)
    assert dry[0].top_water[0] < 0.1 * wet[0].top_water[0]
    tilted = states(with_table(tilt=0.15), config(rate=mm_per_hour(100.0), past=2e-3), 4)
    assert tilted[-1].top_water[0] == 0 and abs(tilted[-1].ledger["residual"]) < 1e-9
    without = states(made, config(rate=0.0, past=2e-3, drips=False), 2)
    assert without[1].top_water[0] == pytest.approx(wet[0].top_water[0])


def test_a_state_keeps_its_tops_on_disk(tmp_path):
    state = states(with_table(), config(past=2e-3), 1)[0]
    write_state(tmp_path / "state.npz", state)
    np.testing.assert_array_equal(read_state(tmp_path / "state.npz").top_water, state.top_water)


# ---- drawn


def level_view(height):
    """A camera at (-2, 0, height) m that looks along x, 64 x 48 px."""
    turn = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], F4)
    return View(turn, F4([-2, 0, height]), *(F4(n) for n in (60, 60, 32, 4)))


def maps(made, volume=None):
    water = TopWater(made)
    volume = water.capacity if volume is None else volume
    return wet_tops.top_maps(made, water)._replace(water=wet_tops.top_numbers(water, volume, 2e-4))


def picture_of(view, planes):
    """Depth (48, 64) of what shows of level squares (height, half width) over the ground."""
    rows, columns = np.indices((48, 64))
    a, b = (columns + 0.5 - view.cx) / view.fx, (rows + 0.5 - view.cy) / view.fy
    ray = np.stack([a, b, np.ones_like(a)], axis=-1) @ view.ground_from_camera.T
    nearest = np.full((48, 64), np.inf)
    for height, half, x0, y0 in planes:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (height - view.eye[2]) / ray[..., 2]
        x, y = view.eye[0] + t * ray[..., 0], view.eye[1] + t * ray[..., 1]
        on = (t > 0) & (np.abs(x - x0) <= half) & (np.abs(y - y0) <= half)
        nearest[on & (t < nearest)] = t[on & (t < nearest)]
    return nearest.astype(F4)


def met(made, view, depth, covered=None, rain=SOAKED):
    hit, coverage = np.full(depth.shape, np.nan, F4), np.zeros(depth.shape, F4)
    if covered is not None:
        coverage[covered] = 0.5
    count = np.zeros(len(depth), np.int64)
    wet_tops.meet_tops(depth, view, maps(made), rain, np.arange(len(depth)), hit, coverage, count)
    assert np.isfinite(hit[(coverage > 0) & (coverage != 0.5)]).all()
    assert count.sum() == np.count_nonzero((coverage > 0) & (coverage != 0.5))
    return hit, coverage


GROUND = (0.0, 1.0, 0.0, 0.0)


def test_pixels_that_show_the_table_are_its_and_no_others():
    made, view = with_table(), level_view(1.2)
    depth = picture_of(view, [GROUND, (0.7, 0.5, 0, 0)])
    hit, coverage = met(made, view, depth)
    table = picture_of(view, [(0.7, 0.4, 0, 0)])  # its rim is mixed
    inner = np.isfinite(table)
    np.testing.assert_allclose(hit[inner], depth[inner], rtol=1e-3)
    assert inner.sum() > 50 and (coverage[inner] > 0.9).all()
    assert (coverage[~np.isfinite(picture_of(view, [(0.7, 0.56, 0, 0)]))] == 0).all()
    # What stands on it, or water of the ground before it, hides it.
    assert (met(made, view, depth - F4(0.3))[1] == 0).all()
    assert met(made, view, depth, inner)[1][inner] == pytest.approx(0.5)
    dry = off_ground(supply=0, film_left=0, porosity=0)
    assert (met(made, view, depth, rain=dry)[1][inner] < 1).any()


def test_a_drawn_film_rounds_off_at_gaps_and_edges():
    holds = np.zeros((40, 60), bool)
    holds[3:-3, 3:-3] = True
    holds[:, 30] = False  # a gap of one cell
    film = wet_tops.drawn_film(holds)
    assert film.dtype == F4 and 0 <= film.min() and film.max() <= 1
    assert (film[~holds] < 0.15).all() and (film[:3] == 0).all()
    assert film[20, 29] == pytest.approx(film[20, 31], abs=1e-6) and 0.2 < film[20, 29] < 0.8
    assert (film[20, 7:26] > 0.999).all()


def test_a_warped_top_shows_its_gaps_where_the_picture_does():
    """A capture puts the whole table 5 mm too low: the gap is drawn where the pixels show it."""
    made, view = with_table(), level_view(1.1)
    first = made.tops.corner[0, 0]
    for low in (0.0, 5e-3):
        depth = picture_of(view, [GROUND, (0.7 - low, 0.5, 0, 0)])
        inner = np.isfinite(picture_of(view, [(0.7 - low, 0.4, 0, 0)]))
        x = view.eye[0] + depth[inner]
        middle = x[np.argmin(np.abs(x))]  # of the row of pixels nearest to the table's centre
        gap = int((middle - first) / made.tops.spacing)
        holds = made.tops.holds.copy()
        holds[:, gap - 2 : gap + 3] = False
        parted = replace(made, tops=replace(made.tops, holds=holds))
        coverage, at = met(parted, view, depth)[1][inner], np.abs(x - middle)
        assert (coverage[at < 2e-3] == 0).all() and (coverage[at > 0.03] > 0.9).all()
        assert 0 < np.count_nonzero(at < 2e-3) < np.count_nonzero(at > 0.03)


@pytest.mark.parametrize("height", [0.7, 0.7001, 0.4])
def test_a_camera_in_its_plane_or_below_sees_no_water_on_it(height):
    view = level_view(height)
    depth = picture_of(view, [GROUND, (0.7, 0.5, 0, 0)])
    _, coverage = met(with_table(), view, depth)
    assert (coverage == 0).all()
    blank = np.full((48, 64), np.nan, F4)
    assert (met(with_table(), level_view(1.2), blank)[1] == 0).all()
    assert (met(with_table(), level_view(1.2), np.full((48, 64), np.inf, F4))[1] == 0).all()


def test_of_two_tops_that_overlap_in_the_picture_each_pixel_shows_the_nearer():
    x, y = centres()
    near = (np.abs(x + 0.6) <= 0.3) & (np.abs(y) <= 0.5)
    far = (np.abs(x - 0.5) <= 0.4) & (np.abs(y) <= 0.5)
    top = np.where(near, 0.9, np.where(far, 0.5, 0))
    made = with_tops(ground(top=top))
    assert len(made.tops) == 2
    view = level_view(1.8)
    square = [(0.9, 0.3, -0.6, 0), (0.5, 0.4, 0.5, 0)]
    depth = picture_of(view, [GROUND, *square])
    hit, coverage = met(made, view, depth)
    for height, half, x0, y0 in square:
        own = picture_of(view, [(height, half - 0.1, x0, y0)])
        inner = np.isfinite(own) & np.isclose(own, depth, atol=1e-3)
        assert inner.sum() > 20 and (coverage[inner] > 0.9).all()
        z = 1.8 + hit[inner] * ((np.nonzero(inner)[0] + 0.5 - 4) / -60)
        np.testing.assert_allclose(z, height, atol=2e-3)


def test_a_slope_is_marked_and_tilts_its_film():
    made, view = with_table(tilt=0.15), level_view(1.5)
    k = maps(made)
    found = wet_tops.top_below(k, F4(0.2), F4(0.1), F4(0.73))
    assert found[0] == 0 and found[3] == pytest.approx(0.15, rel=0.03)
    assert wet_tops.top_below(k, F4(0.2), F4(0.1), F4(0.65))[0] == -1
    assert wet_tops.top_below(k, F4(np.nan), F4(0.1), F4(0.7))[0] == -1
    assert wet_tops.top_below(DRY_TOPS, F4(0), F4(0), F4(0))[0] == -1
    depth = picture_of(view, [GROUND])
    rows, columns = np.indices(depth.shape)
    ray_x, ray_z = 1.0, -(rows + 0.5 - 4) / 60
    t = (0.7 + 0.15 * -2 - 1.5) / (ray_z - 0.15 * ray_x)
    on = np.abs(-2 + t) < 0.35
    on &= np.abs(t * (columns + 0.5 - 32) / 60) < 0.35
    hit, coverage = met(made, view, np.where(on, t, depth).astype(F4))
    assert on.sum() > 20 and (coverage[on] > 0.9).all() and (hit[on] < 0).all()


@pytest.mark.parametrize(("tilt", "eye"), [(0.0, 1.1), (0.0, 0.76), (0.08, 1.1)])
def test_all_water_on_a_top_knows_its_top_also_at_the_rim(tilt, eye):
    made, view = with_table(tilt=tilt), level_view(eye)
    # A ray meets the top's plane beside what the pixel shows, also half a cell past its edge.
    depth = picture_of(view, [GROUND, (0.7, 0.56, 0, 0)])
    outside = seen = 0
    for off in (-0.08, -0.05, -0.02, 0.0, 0.02, 0.05):
        shown = (depth + F4(off)).astype(F4)
        hit, coverage = met(made, view, shown)
        for row, column in np.argwhere(coverage > 0)[::5]:
            ray = np.array(pixel_ray(view, row, column))
            point = (view.eye + abs(hit[row, column]) * ray).astype(F4)
            assert wet_tops.top_below(maps(made), *point)[0] == 0
            seen += 1
            outside += wet_tops.top_over(maps(made), *point[:2]) < 0
    assert seen > 30 and (outside > 0) == (tilt > 0)  # a level one holds none past its cells
    beside = F4(0.7), F4(0), F4(0.7 + tilt * 0.7)
    assert wet_tops.top_below(maps(made), *beside)[0] == -1


LAYERS = (*aov.NEEDED, "water_depth", "reflection_source")


@pytest.fixture(scope="module")
def shots():
    """A frame of a small scene with a wide table, its layers, and the frame without its water."""
    scene = tiny_scene(table=0.4)
    camera = scene.cameras[0].resized(160, 120)
    found = []
    for tops in ("auto", "off"):
        settings = Config.from_preset("downpour").replace(
            past=6e-3, extent=1.0, spacing=0.025, tops=tops, film="environment"
        )
        made = extract_terrain(scene, settings)
        state = next(s for s in simulate(made, settings) if s.index == 1)
        renderer = Renderer(scene, made, settings, camera)
        picture, report = renderer.draw(camera, state, None, LAYERS)
        found.append((picture.copy(), report, renderer))
    return found


def test_a_wet_table_is_in_the_frame_its_layers_and_its_notes(shots):
    (picture, report, renderer), (plain, without, _) = shots
    again = aov.recompose(report.aovs, **report.light)
    assert np.abs(again.astype(int) - picture).max() <= 1
    table = np.zeros(picture.shape[0] * picture.shape[1], bool)
    table[renderer.water.pixel[renderer.water.top >= 0]] = True
    table = table.reshape(picture.shape[:2])
    assert table.mean() > 0.03
    found = report.aovs
    assert (found["coverage"][table] > 0).all() and (found["water_depth"][table] > 1e-4).all()
    assert (found["reflection_source"][table] > 0).all()
    assert "surroundings" not in choice_of(renderer.water) and renderer.water.groups["auto"][0]
    assert (without.aovs["coverage"][table] == 0).mean() > 0.9
    assert np.abs(picture[table].astype(int) - plain[table]).mean() > 2
    assert any("tops above the ground" in note for note in report.notes)
    assert not any("tops above the ground" in note for note in without.notes)


def test_methods_of_reflection_may_take_turns_on_one_picture(shots):
    _, _, renderer = shots[0]
    water = renderer.water
    found = []
    for name in ("mirror", "ssr", "auto", "mirror", "ssr"):
        water.light[:] = np.nan
        light_up(renderer, name, 1)
        assert np.isfinite(water.light).all()
        found.append(water.light.copy())
    np.testing.assert_array_equal(found[0], found[3])
    np.testing.assert_array_equal(found[1], found[4])
    assert np.abs(found[0] - found[1]).max() > 0.01


def test_the_setting_leaves_them_out_and_is_checked():
    made = with_table()
    off = Config().replace(tops="off")
    assert tops_drawn(made, off).tops is NO_TOPS and tops_drawn(made, Config()) is made
    with pytest.raises(ParameterError, match="tops"):
        Config().replace(tops="on").check()
    assert isinstance(DRY_TOPS, TopMaps)
