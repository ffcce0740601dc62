"""Captures in chunks: the files, the levels, what a camera gets of them, and frames."""

import json
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest
from test_gltf import covariances

import rainsim.scene.pages
from made_captures import random_splats
from made_formats import sog, tame_splats, write_folder, write_splats
from naive import decibel as psnr
from rainsim import pipeline
from rainsim.config.settings import Config
from rainsim.datasets.user_labels import read_labels
from rainsim.errors import InputError, ParameterError
from rainsim.io.images import write_png
from rainsim.lod import cut as cutting
from rainsim.lod.cut import cut
from rainsim.lod.held_parts import finest_near, scene_over
from rainsim.lod.levels import chosen_levels, pixels_per_unit
from rainsim.lod.merge import merged_splats, reach_box
from rainsim.lod.numbers import FinestNumbers
from rainsim.lod.paged import Page, PagedRasterizer, rasterizer_of_scene
from rainsim.lod.room import ChunkRoom, Stored
from rainsim.raster import Rasterizer, prepare
from rainsim.render.memory import memory_of_frames
from rainsim.render.renderer import Renderer
from rainsim.scene.big import open_pages
from rainsim.scene.cameras import look_at
from rainsim.scene.folder import import_scene, write_scene
from rainsim.scene.formats import read_splats, splat_blocks
from rainsim.scene.formats.sog_writer import write_sog
from rainsim.scene.formats.streamed import LOD_META, NONE, SIDES, read_tree
from rainsim.scene.pages import ALWAYS, Kept, Pages, levels_at
from rainsim.scene.splat_sets import joined
from rainsim.scene.types import GroundFrame, Scene, Splats
from rainsim.sensors import drive
from rainsim.sensors.lidar_model import Lidar
from rainsim.shading.lamp_images import scaled
from rainsim.shading.wet_ground_mirror import RESOLUTION, level_camera
from rainsim.splatting.level_kernels import area_of
from rainsim.splatting.prepared import NOBODY
from rainsim.terrain.pond import without_images
from rainsim.terrain.types import Grid

pytest.importorskip("gsply")
pytest.importorskip("imagecodecs")
AS_SHIPPED = True  # which choose levels of their own
CONFIG = Config.from_preset("moderate").replace(
    past=4e-3, extent=1.0, spacing=0.05, frames=3, width=96, height=64, detail=0.7, relight="off"
)
NAMES = ("position", "rotation", "scale", "opacity", "sh")


def strip(length=24.0, gap=0.04, seed=3):
    """A path between two walls along x, of discs, in the ground frame, with cameras on it."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(0, length, gap), np.arange(-1.5, 1.5, gap))
    floor = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    x, z = np.meshgrid(np.arange(0, length, gap), np.arange(0, 1.5, gap))
    walls = [np.stack([x, 0 * x + side, z], -1).reshape(-1, 3) for side in (-1.5, 1.5)]
    places = np.concatenate([floor, *walls]) + rng.normal(size=(1, 3)) * 1e-3
    n, flat = len(places), len(floor)
    turn = np.zeros((n, 4), np.float32)
    turn[:flat, 0] = 1
    turn[flat:, :2] = np.sqrt(0.5)  # about x: the thin axis goes across the path
    light = 0.4 + 0.1 * np.sin(places @ (3.0, 5.0, 4.0)) + 0.02 * rng.normal(size=n)
    sh = np.zeros((n, 4, 3), np.float32)
    sh[:, 0] = ((light[:, None] * (1.0, 0.95, 0.9)) - 0.5) / 0.28209479
    sh[:, 1:] = 0.02 * rng.normal(size=(n, 3, 3))
    splats = Splats(
        places.astype(np.float32), turn,
        np.tile(np.float32([0.6 * gap, 0.6 * gap, 2e-3]), (n, 1)),
        np.full(n, 0.95, np.float32), sh,
    )  # fmt: skip
    cameras = [
        look_at((k, 0.2, 1.0), (k + 4, 0, 0.3), (0, 0, 1), 60, 96, 64, f"{k:04.1f}")
        for k in np.arange(0.5, length - 6, 0.7)
    ]
    frame = GroundFrame(np.eye(3), 1.0, np.zeros(3))
    return Scene("strip", splats, tuple(cameras), frame, None, "0" * 64)


@pytest.fixture(scope="module")
def whole():
    return strip()


@pytest.fixture(scope="module")
def folder(whole, tmp_path_factory):
    """The strip in chunks, small ones, as a scene folder."""
    out = tmp_path_factory.mktemp("chunks") / "strip"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cutting, "CHUNK", 6000)
        patch.setattr(cutting, "LEAST", 1000)
        counts = cut(out, lambda: iter([whole.splats]), leaf=2000)
    assert len(counts) > 3, counts
    scene = import_scene(out, cameras=whole.cameras, ground_frame=whole.ground_frame)
    write_scene(out, scene)
    return out


@pytest.fixture
def big(folder):
    """The scene in chunks, nothing of it kept."""
    return import_scene(folder)


@pytest.fixture(autouse=True, scope="module")
def coarse_overview():
    """A small scene is known by a coarse level, as a big one is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rainsim.scene.pages, "OVERVIEW", 12_000)
        yield


def index(folder):
    return json.loads((folder / LOD_META).read_text())


# --- files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("coefficients", [1, 4, 16])
def test_a_written_sog_comes_back_as_fine_as_its_bytes(tmp_path, coefficients):
    splats = tame_splats(3000, coefficients)
    write_sog(tmp_path, splats)
    found, notes = read_splats(tmp_path)
    assert len(found) == 3000 and not notes
    width = np.log1p(np.abs(splats.position)).max()
    assert np.abs(found.position - splats.position).max() < 30 * width / 65535
    assert np.abs(found.opacity - splats.opacity).max() <= 0.5 / 255 + 1e-6
    assert np.abs(np.log(found.scale / splats.scale)).max() < 0.03
    assert np.abs((found.rotation * splats.rotation).sum(axis=1)).min() > 0.9999
    assert np.abs(found.sh[:, 0] - splats.sh[:, 0]).max() < 0.02
    if coefficients > 1:  # of numbers that nothing ties together a sixth are no good palette
        away = np.square(found.sh[:, 1:] - splats.sh[:, 1:]).mean()
        assert away < 0.8 * splats.sh[:, 1:].var()
    (tmp_path / "again").mkdir()
    write_sog(tmp_path / "again", splats)
    for file in (tmp_path / "again").iterdir():
        assert file.read_bytes() == (tmp_path / file.name).read_bytes()


def test_a_palette_of_few_harmonics_holds_each_of_them(tmp_path):
    splats = tame_splats(2000, 16)
    splats.sh[:, 1:] = splats.sh[np.arange(2000) % 40, 1:]
    write_sog(tmp_path, splats)
    found = read_splats(tmp_path)[0]
    assert np.abs(found.sh - splats.sh).max() < 0.02


def streamed(folder, runs, environment=None, **changes):
    """Write a Streamed SOG by the format's page: two leaves, levels in chunks of their own."""
    names = []
    for number, level in enumerate(runs):
        write_folder(folder / f"part{number}", sog(joined(level)))
        names.append(f"part{number}/meta.json")
    leaves = []
    for leaf in range(len(runs[0])):
        lods = {
            str(k): {
                "file": k, "offset": sum(map(len, level[:leaf])), "count": len(level[leaf]),
            }
            for k, level in enumerate(runs)
        }  # fmt: skip
        box = np.array([reach_box(level[leaf]) for level in runs])
        low, high = box[:, :3].min(axis=0), box[:, 3:].max(axis=0)
        leaves.append({"bound": {"min": low.tolist(), "max": high.tolist()}, "lods": lods})
    data = {
        "version": 1, "count": 0, "counts": [0] * len(runs), "lodLevels": len(runs),
        "filenames": names, "later": "a field that nobody knows",
        "tree": {"bound": leaves[0]["bound"], "children": leaves},
    }  # fmt: skip
    if environment is not None:
        write_folder(folder / "env", sog(environment))
        data["environment"] = "env/meta.json"
    folder.mkdir(exist_ok=True)
    (folder / LOD_META).write_text(json.dumps(data | changes))
    return folder


def test_files_of_the_format_are_read_run_by_run(tmp_path):
    fine = [tame_splats(700, 4, seed) for seed in (1, 2)]
    coarse = [tame_splats(90, 4, seed) for seed in (3, 4)]
    sky = tame_splats(50, 4, 5)
    pages, overview, digest, notes = open_pages(streamed(tmp_path, [fine, coarse], sky))
    assert pages.tree.levels == 2 and len(pages.tree.box) == 2 and pages.always
    assert pages.count == 1400 and len(overview) == 1450 and "1400 splats" in notes[0]
    for leaf in (0, 1):
        for level, runs in enumerate((fine, coarse)):
            found = pages.splats(leaf, level)
            assert np.abs(found.position - runs[leaf].position).max() < 2e-3
            assert np.abs(found.opacity - runs[leaf].opacity).max() < 3e-3
    assert len(pages.splats(ALWAYS, 0)) == 50
    side = pages.tree.side
    assert (side[:, 0] == 0).all() and (side[:, 1] > 0).all()
    meta = tmp_path / "part1" / "meta.json"
    meta.write_text(meta.read_text().replace('"version": 2', '"version":  2'))
    assert open_pages(tmp_path)[2] != digest


def test_a_leaf_without_a_level_shows_the_next(tmp_path):
    fine = [tame_splats(200, 1, 1), tame_splats(200, 1, 2)]
    coarse = [tame_splats(40, 1, 3), tame_splats(30, 1, 4)]
    data = index(streamed(tmp_path, [fine, coarse]))
    del data["tree"]["children"][0]["lods"]["1"]
    del data["tree"]["children"][1]["lods"]["0"]
    (tmp_path / LOD_META).write_text(json.dumps(data))
    tree = read_tree(tmp_path / LOD_META)
    assert levels_at(tree, 0).tolist() == levels_at(tree, 1).tolist() == [0, 1]
    assert Pages(tree).count == 230


ABSURD = {
    "no JSON": "{",
    "no object": "[]",
    "no tree": {"tree": None},
    "deep": "[" * 100_000,
    "another version": {"version": 2},
    "no version": {"version": "1"},
    "no names": {"filenames": []},
    "outside": {"filenames": ["../x/meta.json"] * 2},
    "absolute": {"filenames": ["/etc/meta.json"] * 2},
    "another file": {"filenames": ["part0/passwd"] * 2},
    "a number": {"filenames": [1, 2]},
    "no levels": {"lodLevels": 0},
    "too many levels": {"lodLevels": 1 << 40},
    "environment": {"environment": "..\\meta.json"},
    "one child": {"tree": {"children": [{}]}},
    "a child that is none": {"tree": {"children": [1, 2]}},
    "no bound": {"tree": {"lods": {}}},
    "a bound of text": {"tree": {"bound": {"min": ["a", 0, 0], "max": [1, 1, 1]}, "lods": {}}},
    "a bound inside out": {"tree": {"bound": {"min": [2, 0, 0], "max": [1, 1, 1]}, "lods": {}}},
    "NaN": {"tree": {"bound": {"min": [float("nan")] * 3, "max": [1] * 3}, "lods": {}}},
    "no splats": {"tree": {"bound": {"min": [0] * 3, "max": [1] * 3}, "lods": {}}},
    "sides that fall": {SIDES: [2, 1]},
    "sides of text": {SIDES: "0"},
}
RUN = {"bound": {"min": [0] * 3, "max": [1] * 3}}
for name, run in {
    "a file beyond": {"0": {"file": 9, "offset": 0, "count": 1}},
    "a level beyond": {"7": {"file": 0, "offset": 0, "count": 1}},
    "a level of text": {"x": {"file": 0, "offset": 0, "count": 1}},
    "less than nothing": {"0": {"file": 0, "offset": -1, "count": 1}},
    "a share": {"0": {"file": 0, "offset": 0, "count": 1.5}},
    "no run": {"0": None},
}.items():
    ABSURD[name] = {"tree": {**RUN, "lods": run}}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    runs = [[tame_splats(60, 1, 2 * k + n) for n in (0, 1)] for k in (0, 1)]
    return streamed(tmp_path_factory.mktemp("small") / "s", runs)


@pytest.mark.parametrize("fault", ABSURD)
def test_an_absurd_index_is_refused(small, tmp_path, fault):
    change = ABSURD[fault]
    text = change if isinstance(change, str) else json.dumps(index(small) | change)
    (tmp_path / LOD_META).write_text(text)
    with pytest.raises(InputError, match="lod-meta"):
        read_tree(tmp_path / LOD_META)


def test_chunks_that_do_not_fit_the_index_are_refused(small, tmp_path):
    shutil.copytree(small, tmp_path / "c")
    data = index(tmp_path / "c")
    data["tree"]["children"][1]["lods"]["0"]["count"] += 1
    (tmp_path / "c" / LOD_META).write_text(json.dumps(data))
    with pytest.raises(InputError, match="belong together"):
        Pages(read_tree(tmp_path / "c" / LOD_META)).splats(1, 0)
    (tmp_path / "c" / "part0" / "means_l.webp").write_bytes(b"RIFF")
    with pytest.raises(InputError, match="WebP"):
        Pages(read_tree(tmp_path / "c" / LOD_META)).splats(0, 0)
    (tmp_path / "c" / "part1" / "meta.json").unlink()
    with pytest.raises(InputError, match="chunk of a Streamed SOG"):
        open_pages(tmp_path / "c")


# --- levels ---------------------------------------------------------------------------------------


def test_merging_keeps_moments_and_what_is_wide(rng):
    """Over each cell: whichever way its splats face, their sums are those of the merged ones."""
    splats = random_splats(4000, 4, 1)
    splats.scale[:] = splats.scale.clip(1e-3, 0.4)
    side = 0.5
    merged = merged_splats(splats, side)
    kept = np.isin(splats.position[:, 0], merged.position[:, 0])
    alone = kept.sum()
    assert 0 < alone < len(merged) < 0.8 * len(splats)
    for name in NAMES:
        assert (getattr(merged, name)[:alone] == getattr(splats, name)[kept]).all()
    assert (np.square(splats.scale[~kept]).sum(axis=1) < side**2).all()
    own, theirs = covariances(splats)[~kept], covariances(merged)[alone:]
    few, made = splats.take(~kept), merged.take(np.arange(len(merged)) >= alone)

    def weights(some, covariance, depth):
        xx, xy, xz, _, yy, yz, _, _, zz = covariance.reshape(-1, 9).astype(float).T
        return depth * np.array([area_of(*row) for row in zip(xx, xy, xz, yy, yz, zz, strict=True)])

    opacity = made.opacity.astype(float)
    depth = np.where(opacity < 0.5, -np.log1p(-opacity.clip(0, 0.5)), 2 * np.log(2) * opacity)
    weight, sums = weights(few, own, few.opacity), weights(made, theirs, depth)
    cell, place = (np.floor(s.position / np.float32(side)) @ (1, 1e3, 1e6) for s in (few, made))
    bounded = np.isin(place, place[opacity >= 1])  # where no more fits into an opacity
    for k in rng.permutation(np.unique(place[~bounded]))[:60]:
        among, those = cell == k, place == k
        w, m = weight[among], sums[those]
        np.testing.assert_allclose(m.sum(), w.sum(), rtol=0.02)
        np.testing.assert_allclose(
            m @ made.position[those] / m.sum(), w @ few.position[among] / w.sum(), atol=5e-3
        )
        second = [np.einsum("n,nij->ij", a, c) + np.einsum("n,ni,nj->ij", a, x, x) for a, c, x in (
            (m, theirs[those], made.position[those]), (w, own[among], few.position[among])
        )]  # fmt: skip
        np.testing.assert_allclose(second[0] / m.sum(), second[1] / w.sum(), atol=0.02)
        mean = [np.einsum("n,nkc->kc", a, s) / a.sum() for a, s in (
            (m, made.sh[those]), (w, few.sh[among])
        )]  # fmt: skip
        np.testing.assert_allclose(*mean, atol=0.02)


def test_a_cut_holds_every_splat_once_and_levels_get_coarser(whole, folder, big):
    tree = big.pages.tree
    first = joined([big.pages.splats(leaf, 0) for leaf in range(len(tree.box))])
    assert len(first) == len(whole.splats) == big.count
    order = [np.lexsort(np.round(p, 2).T) for p in (first.position, whole.splats.position)]
    np.testing.assert_allclose(
        first.position[order[0]], whole.splats.position[order[1]], atol=0.011
    )
    counts = index(folder)["counts"]
    assert counts == sorted(counts, reverse=True) and counts[-1] < 0.1 * counts[0]
    assert tree.side.shape == tree.file.shape and (np.diff(tree.side, axis=1) > 0).all()
    for leaf in (0, len(tree.box) // 2):
        for level in range(tree.levels):
            box = reach_box(big.pages.splats(leaf, level))
            width = 2e-3 + 0.05 * np.abs(box).max()  # scales are stored to some percent
            assert (box[:3] >= tree.box[leaf, :3] - width).all()
            assert (box[3:] <= tree.box[leaf, 3:] + width).all()


def test_a_cut_does_not_depend_on_the_parts_it_is_read_in(whole, tmp_path):
    parts = [whole.splats.take(slice(s, s + 7000)) for s in range(0, len(whole.splats), 7000)]
    cut(tmp_path / "a", lambda: iter([whole.splats]))
    cut(tmp_path / "b", lambda: iter(parts))
    names = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert len(names) > 20
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    with pytest.raises(InputError, match="no splats"):
        cut(tmp_path / "c", lambda: iter([]))


def test_what_is_wider_than_leaves_is_always_drawn(tmp_path):
    splats = tame_splats(4000, 1)
    splats.scale[:] = 0.01
    splats.scale[::400] = 20.0
    wide = splats.scale[:, 0] > 1
    parts = [splats.take(~wide), splats.take(wide)]  # a part may have no splat of a leaf
    cut(tmp_path, lambda: iter(parts), leaf=500)
    tree = read_tree(tmp_path / LOD_META)
    assert len(Pages(tree).splats(ALWAYS, 0)) == 10
    assert np.ptp(tree.box.reshape(-1, 2, 3), axis=1).max() < 20


def test_a_ply_is_read_in_parts(tmp_path):
    splats = tame_splats(1000, 4)
    write_splats(tmp_path / "s.ply", splats)
    blocks, kind = splat_blocks(tmp_path / "s.ply")
    from rainsim.scene.ply import plain_blocks
    from rainsim.scene.plyheader import read_header

    assert kind == "3DGS PLY" and sum(map(len, blocks())) == 1000
    with open(tmp_path / "s.ply", "rb") as file:
        header = read_header(tmp_path / "s.ply", file)
    parts = list(plain_blocks(tmp_path / "s.ply", header, rows=300))
    assert list(map(len, parts)) == [300, 300, 300, 100]
    again = read_splats(tmp_path / "s.ply")[0]
    for name in NAMES:
        assert (np.concatenate([getattr(p, name) for p in parts]) == getattr(again, name)).all()
    splats.position[:50] = np.nan
    write_splats(tmp_path / "s.ply", splats)
    with pytest.raises(InputError, match="50 of 1000"):
        list(splat_blocks(tmp_path / "s.ply")[0]())


# --- what a camera gets ---------------------------------------------------------------------------


def test_near_is_fine_and_far_is_coarse(big):
    tree, camera = big.pages.tree, big.cameras[2]
    levels, used = chosen_levels(tree, camera, 0.05, 1.5, 10**9)
    assert used == 1.5 and (levels == NONE).any() and (levels == 0).any() and levels.max() >= 2
    size = pixels_per_unit(tree.box, camera, 0.05)
    seen = np.flatnonzero(levels != NONE)
    rows = tree.side[seen, levels[seen]] * size[seen]
    assert (rows <= 1.5).all()
    finer = levels[seen] < tree.levels - 1
    coarser = tree.side[seen, np.minimum(levels[seen] + 1, tree.levels - 1)] * size[seen]
    assert (coarser[finer] > 1.5).all()


def test_what_does_not_fit_is_drawn_coarser(big):
    tree, camera = big.pages.tree, big.cameras[0]
    free, _ = chosen_levels(tree, camera, 0.05, 0.5, 10**9)
    seen = free != NONE
    few, used = chosen_levels(tree, camera, 0.05, 0.5, 4000)
    assert ((few != NONE) == seen).all() and used > 0.5
    assert tree.count[np.arange(len(few)), few][seen].sum() <= 4000
    assert (few[seen] >= free[seen]).all()


def test_all_splats_drawn_are_the_capture(whole, big):
    camera = whole.cameras[3]
    truth = Rasterizer(prepare(whole.splats)).draw(camera, 0.05)
    drawer = rasterizer_of_scene(big, CONFIG.replace(detail=0.0).render)
    fine = drawer.draw(camera, 0.05)
    assert psnr(fine.color, truth.color, 1.0) > 38  # what the bytes of a SOG cost
    assert drawer.used["detail"] == 0
    tree = big.pages.tree
    every = joined([big.pages.splats(leaf, 0) for leaf in range(len(tree.box))])
    same = Rasterizer(prepare(every)).draw(camera, 0.05)
    assert np.abs(fine.color - same.color).max() < 1e-5  # what is left out is out of the picture


def test_pictures_get_coarser_with_the_threshold_and_stay_near_full_detail(big):
    found = {}
    for detail in (0.0, 1.0, 2.0, 8.0):
        drawer = rasterizer_of_scene(big, CONFIG.replace(detail=detail).render)
        shown = [drawer.draw(camera, 0.05).color for camera in big.cameras[::4]]
        found[detail] = shown, drawer.used["splats"]
    decibels = {d: [psnr(a, b, 1.0) for a, b in zip(found[d][0], found[0.0][0], strict=True)]
                for d in (1.0, 2.0, 8.0)}  # fmt: skip
    assert np.median(decibels[1.0]) > 35 and min(decibels[1.0]) > 30
    assert np.median(decibels[8.0]) < np.median(decibels[2.0]) < np.median(decibels[1.0]) < 70
    assert found[8.0][1] < found[2.0][1] < found[1.0][1] < found[0.0][1]


def test_a_picture_has_the_same_bytes_whatever_was_drawn_or_kept_before(folder, big):
    render = CONFIG.render
    alone = [rasterizer_of_scene(import_scene(folder), render).draw(big.cameras[n], 0.05).color
             for n in (2, 9)]  # fmt: skip
    drawer = rasterizer_of_scene(big, render)
    for n in (9, 0, 2, 17, 9):
        shown = drawer.draw(big.cameras[n], 0.05).color
        if n in (2, 9):
            assert (shown == alone[(2, 9).index(n)]).all()
    little = import_scene(folder)
    drawer = rasterizer_of_scene(little, render)
    little.pages.kept.most = 1e5  # hardly a page: all are read again and again
    drawer.pages.read_ahead([(leaf, 0) for leaf in range(len(little.pages.tree.box))])
    levels = {n: drawer.wanted(big.cameras[n], 0.05) for n in (2, 9)}
    for n in (9, 2):
        again = drawer.draw(big.cameras[n], 0.05).color
        if levels[n] == rasterizer_of_scene(big, render).wanted(big.cameras[n], 0.05):
            assert (again == alone[(2, 9).index(n)]).all()
    assert little.pages.kept.size <= 1e5 or len(little.pages.kept._values) == 1


def test_those_who_draw_in_turns_share_the_memory_of_pages(big):
    camera, render = big.cameras[2], CONFIG.render
    big.pages.limit(render.memory)

    def drawers(**room):
        how = big.pages, lambda splats: Page(prepare(splats))
        most = big.splats.sh.shape[1]
        return [PagedRasterizer(*how, detail, most, **room) for detail in (1.0, 8.0)]

    apart = [drawer.draw(camera, 0.05).color for drawer in drawers()]
    assert (apart[0] != apart[1]).any()
    one, other = drawers(room=ChunkRoom(1e5, 1000))  # less than they take: it grows
    for _ in range(2):
        assert (one.draw(camera, 0.05).color == apart[0]).all()
        assert (other.draw(camera, 0.05).color == apart[1]).all()


def test_a_page_leaves_its_room_when_nobody_holds_it():
    parts = [prepare(tame_splats(n, 4)) for n in (300, 700, 200)]
    none = prepare(tame_splats(300, 4).take(np.zeros(300, bool)))
    room = ChunkRoom(1, 1)
    pages = [Stored(room, *parts[:2]), Stored(room, none), Stored(room, parts[2])]
    assert [len(p.first) for p in pages] == [2, 0, 1] and len(pages[0].last) == 3
    for part, places in zip(parts, (pages[0].first, pages[0].last, pages[2].first), strict=True):
        assert (room.prepared.geometry[places] == part.geometry).all()
        assert (room.prepared.sh[places] == part.sh).all()
        order = room.prepared.order.reshape(-1, 256)[places].ravel()
        assert (order[: len(part)] == part.order).all() and (order[len(part) :] == NOBODY).all()
    held, left = len(room.prepared.box), set(pages[0].last.tolist())
    del pages[0]
    again = Stored(room, parts[1])
    assert left <= set(again.first.tolist()) | set(room._free) and len(room.prepared.box) == held
    assert (room.prepared.geometry[pages[-1].first] == parts[2].geometry).all()


def test_a_picture_without_a_chunk_is_empty(big):
    drawer = rasterizer_of_scene(big, CONFIG.render)
    away = look_at((0, 0, 500.0), (0, 0, 900.0), (0, 1, 0), 60, 32, 24, "away")
    assert (drawer.draw(away, 0.05).alpha == 0).all() and drawer.used["splats"] == 0
    assert drawer.draw(big.cameras[2], 0.05).alpha.any()


def test_kept_values_stay_below_the_limit():
    kept = Kept(100)
    for k in range(20):
        kept.put(k, str(k), 30)
        assert kept.size <= 100
        assert k < 1 or kept.get(0) == "0" or k > 3 or kept.has(k - 1)
    assert kept.get(19) == "19" and kept.get(1) is None and kept.made == 20
    few = Kept(90)
    for k in range(3):
        few.put(k, str(k), 30)
    assert few.get_all([0, 7, 1]) == ["0", None, "1"]
    few.put(3, "3", 30)  # 2 was asked for longest ago
    assert few.get_all([0, 1, 2, 3]) == ["0", "1", None, "3"]
    kept.put("large", "x", 500)  # what is asked for is kept, alone
    assert kept.get("large") == "x" and kept.get(19) is None
    kept.put("large", "x", 10)
    assert kept.size == 10 and kept.peak == 500


# --- scenes and frames ----------------------------------------------------------------------------


def test_a_scene_folder_of_chunks_comes_back(whole, folder, big, tmp_path):
    assert big.count == len(whole.splats) > 4 * len(big.splats)
    assert [c.name for c in big.cameras] == [c.name for c in whole.cameras]
    assert import_scene(folder / LOD_META, ground_frame=whole.ground_frame).pages is not None
    assert memory_of_frames(big, big.cameras[0]) > memory_of_frames(
        replace(big, pages=None), big.cameras[0]
    )
    with pytest.raises(ParameterError, match="chunks"):
        write_scene(tmp_path / "elsewhere", big)


def test_a_map_is_made_of_fine_splats(big, whole, monkeypatch):
    from rainsim.lod import held_parts

    grid = Grid((40, 40), (8.0, -1.0), 0.05)
    over = scene_over(big, grid)

    def inside(splats):
        low, high = grid.origin, np.array(grid.origin) + grid.size
        place = splats.position[:, :2]
        return int(((place > low) & (place < high)).all(axis=1).sum())

    assert over.pages is None and inside(over.splats) > 2 * inside(big.splats) > 0
    assert abs(inside(over.splats) - inside(whole.splats)) < 20
    assert len(over.splats) < big.count  # what lies elsewhere is left out
    assert scene_over(over, grid) is over
    monkeypatch.setattr(held_parts, "MOST", 1000)
    assert len(scene_over(big, grid).splats) < len(over.splats)
    near = finest_near(big, (2.0, 0.0))
    assert np.abs(near.splats.position[:, 0] - 2).min() < 0.1 and near.pages is None


@pytest.fixture(scope="module")
def film(folder):
    """Frames of a drive along the strip, in sequence, and the scene and map they are of."""
    scene = import_scene(folder)
    ground = pipeline.extract_terrain(scene, CONFIG)
    cameras = scene.cameras[:3]
    shown = [p for p, _ in pipeline.render_rain(scene, cameras, CONFIG, terrain=ground)]
    return ground, cameras, shown


def test_a_frame_by_itself_has_the_bytes_of_the_frame_in_sequence(folder, film):
    ground, cameras, shown = film
    alone = CONFIG.replace(frame_range=(2, 3))
    scene = import_scene(folder)
    ((picture, report),) = pipeline.render_rain(scene, cameras, alone, terrain=ground)
    assert report.index == 2 and (picture == shown[2]).all()
    assert not (shown[1] == shown[2]).all()


def test_frames_of_chunks_are_those_of_the_capture_held_whole(folder, film, whole):
    ground, cameras, _ = film
    config = CONFIG.replace(detail=0.0, merge=0.0, frames=1)
    ((a, _),) = pipeline.render_rain(import_scene(folder), cameras[:1], config, terrain=ground)
    ((b, _),) = pipeline.render_rain(whole, cameras[:1], config, terrain=ground)
    assert psnr(a, b) > 35


# --- labels and beams -----------------------------------------------------------------------------


def finest(big):
    """Positions of the finest level's splats in the order of their numbers, and `FinestNumbers`."""
    pages, numbers = big.pages, FinestNumbers(big.pages)
    parts = [pages.splats(n, 0).position for n in range(len(pages.tree.box))]
    if pages.always:
        parts.append(pages.splats(ALWAYS, 0).position)
    return np.concatenate(parts), numbers


def test_hits_of_chunks_name_splats_of_the_finest_level(whole, big):
    position, numbers = finest(big)
    assert numbers.count == len(position) == len(whole.splats)
    some = np.arange(0, numbers.count, 377)
    assert (numbers.positions(some) == position[some]).all()
    assert (np.concatenate(list(numbers.runs())) == np.arange(numbers.count)).all()
    camera = whole.cameras[3]
    for detail, most in ((0.0, 0.02), (4.0, 0.25)):
        render = CONFIG.replace(detail=detail).render
        drawer = rasterizer_of_scene(big, render, numbers_of=numbers.of_run)
        layers = drawer.draw(camera, 0.05, hit=True, depth="median")
        seen = layers.hit >= 0
        assert seen.mean() > 0.5 and len(np.unique(layers.hit[seen])) > 100
        view = position[layers.hit[seen]] @ camera.camera_from_world[2, :3]
        depth = view + camera.camera_from_world[2, 3]
        assert np.quantile(np.abs(depth - layers.depth[seen]), 0.95) < most  # m
    nameless = rasterizer_of_scene(big, render).draw(camera, 0.05, hit=True)
    assert (nameless.hit == -1).all()


def test_labels_of_chunks_by_splat_and_by_masks(big, tmp_path):
    position, _ = finest(big)
    ids = np.where(position[:, 2] > 0.3, 11, 300).astype(np.uint16)
    np.save(tmp_path / "ids.npy", ids)
    own = read_labels(tmp_path / "ids.npy", big, CONFIG.render)
    masks = tmp_path / "masks"
    masks.mkdir()
    for camera in big.cameras[:6]:
        shown = own.picture(camera)
        assert {11, 300} <= set(np.unique(shown))
        write_png(masks / f"{camera.name}.png", np.where(shown == 300, 3, shown).astype(np.uint8))
    voted = read_labels(masks, big, CONFIG.render)
    known = voted.ids != 255
    assert 0.1 < known.mean() < 1  # the strip's far end is in no mask
    assert (voted.ids[known] == np.where(ids == 300, 3, ids)[known]).mean() > 0.95
    for camera in big.cameras[:3]:
        one, other = own.picture(camera), voted.picture(camera)
        assert (np.where(one == 300, 3, one) == other).mean() > 0.97
    np.save(tmp_path / "few.npy", ids[:-1])
    with pytest.raises(InputError, match=f"{len(ids)} whole numbers"):
        read_labels(tmp_path / "few.npy", big, CONFIG.render)


def test_a_lidar_scans_chunks_as_the_whole(whole, folder, film, tmp_path, monkeypatch):
    ground, cameras, _ = film
    lidar = Lidar(tuple(np.radians(np.arange(-40, 20, 4.0))), columns=120, far=9.0, near=0.2,
                  accuracy=0.0)  # fmt: skip
    monkeypatch.setitem(drive.SENSORS, "small", lidar)
    monkeypatch.setattr(drive, "extract_terrain", lambda *_: ground)
    camera = whole.ground_frame.camera_in_ground(cameras[0])
    scans, notes = [], []
    monkeypatch.setattr(drive.LidarFolder, "add", lambda self, *what: scans.append(what[3]))
    for name, scene in (("whole", whole), ("chunks", import_scene(folder))):
        (tmp_path / name).mkdir()
        out = drive.LidarFolder(tmp_path / name, "kitti")
        drive.scan_rains(out, scene, CONFIG, [0.0], sensor="small", camera=camera, say=notes.extend)
    assert any("as fine as the beams that meet" in note for note in notes)
    range_, other = (np.where(scan.distance < 9.0, scan.distance, 0) for scan in scans)
    both = (range_ > 0) & (other > 0)
    assert both.mean() > 0.3 and ((range_ > 0) == (other > 0)).mean() > 0.97
    # Merged discs of a wall met at a slant differ by a part of a beam's footprint.
    assert np.median(np.abs(range_ - other)[both]) < 0.01
    assert np.quantile(np.abs(range_ - other)[both], 0.9) < 0.05


def test_painted_water_takes_the_place_of_what_the_chunks_show(whole, folder, film):
    plain, _, _ = film
    water = np.zeros_like(plain.bed)
    middle = tuple(slice(n // 4, n // 2) for n in water.shape)
    water[middle] = 0.2
    level = float(plain.bed[middle].min())
    bed = np.where(water > 0, np.float32(level - 0.2), plain.bed)
    pond = replace(plain, bed=bed, water=water)
    changed = [without_images(scene, pond) for scene in (whole, import_scene(folder))]
    shown = [changed[0].splats, joined([changed[1].pages.splats(ALWAYS, 0), *(
        changed[1].pages.splats(n, 0) for n in range(len(changed[1].pages.tree.box))
    )])]  # fmt: skip
    assert len(shown[0]) != len(whole.splats)
    assert abs(len(shown[1]) - len(shown[0])) < 0.002 * len(shown[0])
    low = [int((s.position[:, 2] < level - 0.15).sum()) for s in shown]
    assert low[0] == low[1] > 10  # the bed's
    again = pickle.loads(pickle.dumps(changed[1]))
    assert len(again.pages.splats(3, 1)) == len(changed[1].pages.splats(3, 1))
    x, y = np.array(plain.grid.origin) + 0.375 * np.array(plain.grid.size)
    camera = look_at((x - 0.5, y, 1.0), (x, y, level), (0, 0, 1), 60, 96, 64)
    render = CONFIG.replace(detail=0.0).render
    seen = [rasterizer_of_scene(scene, render).draw(camera, 0.05).color
            for scene in (*changed, whole, import_scene(folder))]  # fmt: skip
    # A row of splats lies on the pond's edge, and the bytes of a SOG move it across.
    error = np.abs(seen[0] - seen[1]).max(axis=-1)
    assert np.quantile(error, 0.95) < 0.01 < 0.05 < np.abs(seen[1] - seen[3]).max()
    assert psnr(seen[1], seen[3], 1.0) < psnr(seen[0], seen[1], 1.0) - 3
    assert psnr(seen[2], seen[3], 1.0) > 45


def test_both_pictures_of_lamps_are_drawn_of_the_same_pages(folder, film):
    ground, cameras, _ = film
    renderer = Renderer(import_scene(folder), ground, CONFIG.replace(frames=1), cameras[0])
    scene = renderer.conductor.wet_scene
    upright = level_camera(scene.frame.camera_in_ground(cameras[0].resized(648, 432)))
    used = []
    for camera in (upright, scaled(upright, 2 * RESOLUTION)):
        assert scene.level_mirrored(camera).picture.any()
        used.append(scene.capture.paged.standing.used)
    assert used[0]["splats"] == used[1]["splats"] > 0
    paged = scene.capture.paged  # one working memory for both, as large as the largest picture
    scene.picture(cameras[0])
    assert paged.whole._rasterizer is paged.standing._rasterizer
    assert scene.capture.prepared is None


def test_actors_stand_among_the_chunks(folder, film, whole):
    from rainsim.actors.actor import Actor, box_of, with_actors
    from rainsim.actors.motion import Track

    ground, cameras, shown = film
    body = whole.splats.take(np.abs(whole.splats.position - (3.0, 1.5, 0.5)).max(axis=1) < 0.3)
    body = replace(body, position=body.position - np.float32([3.0, 1.5, 0.0]))
    body.sh[:, 0] = (1.5, -1.0, -1.0)
    turn = np.array([[1.0, 0, 0, 0]] * 2)
    track = Track(
        np.array([0.0, 1.0]), np.array([[2.0, 0.3, 0.0], [2.5, 0.3, 0.0]]), turn,
        np.ones(2, bool),
    )  # fmt: skip
    actor = Actor("box", "cart", body, box_of(body), track)
    config = CONFIG.replace(detail=0.0, frames=1)
    seen = []
    for scene in (import_scene(folder), whole):
        scene = with_actors(scene, (actor,))
        found = pipeline.render_rain(
            scene, cameras[:1], config, terrain=ground, layers=("actor_id", "clean")
        )
        seen.append(next(iter(found)))
    (a, first), (b, second) = seen
    number, truth = first.aovs["actor_id"], second.aovs["actor_id"]
    assert truth.any() and np.mean(number == truth) > 0.99
    assert psnr(a, b) > 33 and psnr(a, shown[0]) < 33  # the actor is there
    red = first.aovs["clean"][number == 1].mean(axis=0)
    assert red[0] > 2 * red[1]


# --- antialiased ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "comments, expected",
    [
        ([], False), (["SplatRenderMode: mip"], True), (["SplatRenderMode: default"], False),
        (["SplatRenderMode: 2dgs"], False), (["antialiased 1"], True), (["antialiased 0"], False),
        (["  SPLATRENDERMODE:  MIP "], True), (["SplatRenderMode: banana"], False),
        (["antialiased 1", "SplatRenderMode: default"], False),
        (["SplatRenderMode: default", "antialiased 1"], True), (["antialiased"], False),
    ],
)  # fmt: skip
def test_a_ply_says_whether_it_was_trained_antialiased(tmp_path, comments, expected):
    from rainsim.scene.formats import trained_antialiased

    write_splats(tmp_path / "s.ply", tame_splats(50, 1))
    data = (tmp_path / "s.ply").read_bytes()
    lines = "".join(f"comment {c}\n" for c in comments).encode()
    (tmp_path / "s.ply").write_bytes(data.replace(b"1.0\n", b"1.0\n" + lines, 1))
    assert trained_antialiased(tmp_path / "s.ply") is expected
    assert len(read_splats(tmp_path / "s.ply")[0]) == 50


def test_antialiased_captures_are_drawn_weakened_cut_and_kept(whole, tmp_path):
    few = whole.splats.take(slice(0, None, 40))
    write_splats(tmp_path / "s.ply", few)
    data = (tmp_path / "s.ply").read_bytes()
    found = {}
    for mode in (b"mip", b"default"):
        text = b"1.0\ncomment SplatRenderMode: " + mode + b"\n"
        (tmp_path / "s.ply").write_bytes(data.replace(b"1.0\n", text, 1))
        given = {"cameras": whole.cameras, "ground_frame": whole.ground_frame}
        scene = import_scene(tmp_path / "s.ply", **given)
        out = tmp_path / mode.decode()
        cut(out, lambda: iter([few]), antialiased=scene.antialiased)
        chunks = import_scene(out, **given)
        write_scene(out, chunks)
        write_scene(tmp_path / "whole", scene)
        scenes = scene, import_scene(tmp_path / "whole"), chunks, import_scene(out)
        assert {s.antialiased for s in scenes} == {mode == b"mip"}
        render = CONFIG.replace(detail=0.0).render
        found[mode] = [rasterizer_of_scene(s, render).draw(whole.cameras[0], 0.05) for s in scenes]
    camera = whole.cameras[0]
    plain = Rasterizer(prepare(few)).draw(camera, 0.05, compensate=True)
    for layers in found[b"mip"]:
        assert np.abs(layers.alpha - plain.alpha).mean() < 0.005
    for a, b in zip(found[b"mip"], found[b"default"], strict=True):
        assert a.alpha.sum() < 0.97 * b.alpha.sum()
