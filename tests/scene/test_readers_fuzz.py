"""Mutated files for every reader: a clear error or a right result, soon, in little memory.

The default lane reads some of each kind in this process. The campaign reads thousands of every
kind in processes of their own, so that a segfault and a file that takes all memory count too; one
kind by hand:
`PYTHONPATH=.:tests python tests/scene/test_readers_fuzz.py KIND COUNT SEED FOLDER`.
"""

import io
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import test_formats_fuzz as formats
import test_own_files as own
from test_shot import gltf, usd_camera, usda

import made_formats as made
import mutate
from made_captures import random_splats, ring
from made_formats import write_splats
from rainsim.actors.actor_files import read_actors
from rainsim.config.settings import Config
from rainsim.datasets.user_labels import _from_file as label_ids
from rainsim.errors import InputError, RainsimError
from rainsim.io.images import read_hdr
from rainsim.io.rasters import read_raster
from rainsim.scene import usd_cameras, usd_guard
from rainsim.scene.camera_rule import require_camera
from rainsim.scene.cameras import load_cameras, read_path
from rainsim.scene.formats import read, usd
from rainsim.scene.shot import read_shot
from rainsim.sensors.lens_files import lens_named
from rainsim.terrain.classify import read_mask
from rainsim.terrain.surface import _from_map as read_tiff
from rainsim.terrain.surface import _read_obj, _read_ply
from rainsim.terrain.table import class_table
from rainsim.water.series import read_series
from refusals import one_clear_line

QUICK, CAMPAIGN = 100, 5_000  # of each kind
MEMORY = 2_000_000_000  # bytes that a reader may take beyond what the process has at its start
PATIENCE = 10  # s for a file


@dataclass(frozen=True)
class Kind:
    """A kind of file: its name, sound content, what damages and reads it; share that is refused."""

    name: str
    whole: Callable
    damage: Callable
    read: Callable
    refused: float = 0.1


# --- sound files ----------------------------------------------------------------------------------


def mesh_ply(form):
    corners, faces = np.eye(3, dtype="<f4"), [(0, 1, 2), (2, 1, 0)]
    lines = ["ply", f"format {form} 1.0", "element vertex 3"]
    lines += [f"property float {axis}" for axis in "xyz"] + ["element face 2"]
    head = "\n".join([*lines, "property list uchar int vertex_indices", "end_header", ""]).encode()
    if form == "ascii":
        rows = [" ".join(map(str, row)) for row in corners] + [
            f"3 {a} {b} {c}" for a, b, c in faces
        ]
        return head + "\n".join(rows).encode() + b"\n"
    return (
        head
        + corners.tobytes()
        + b"".join(b"\x03" + np.array(face, "<i4").tobytes() for face in faces)
    )


def obj():
    return b"# made\nv 0 0 0\nv 1 0 0.5\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\nf -1 -2 -3\n"


def heights():
    file = io.BytesIO()
    iio.imwrite(file, np.linspace(0, 1, 80, dtype=np.float32).reshape(8, 10), extension=".tiff",
                plugin="pillow")  # fmt: skip
    return file.getvalue()


def mask():
    colors = class_table().colors
    picture = colors[np.arange(96).reshape(8, 12) % len(colors)]
    file = io.BytesIO()
    iio.imwrite(file, picture, extension=".png", plugin="pillow")
    return file.getvalue()


def sky():
    rng = np.random.default_rng(3)
    pixels = rng.integers(0, 255, (6, 12, 4), dtype=np.uint8)
    rows = []
    for row in pixels[:3]:  # run-length coded, then flat
        rows.append(bytes((2, 2, 0, 12)))
        rows += [b"\x0c" + row[:, channel].tobytes() for channel in range(4)]
    return (
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 6 +X 12\n"
        + b"".join(rows)
        + (pixels[3:].tobytes())
    )


def preset():
    return (
        b'rain_mm_per_hour = 20.0\npast_rain_mm = 3\nwind_speed_m_per_s = 2.0\nseed = 7\n'
        b'water_scheme = "auto"\nframes = 48\nsun_azimuth_degrees = 20.0\n'
        b'sun_elevation_degrees = 30.0\n\n[[keyframe]]\ntime_s = 0.0\nrain_mm_per_hour = 2\n'
        b'wind_direction_degrees = 30\n\n[[keyframe]]\ntime_s = 1.5\nrain_mm_per_hour = 50.0\n'
        b'wind_speed_m_per_s = 9.5\nexposure_ms = 8.0\n'
    )  # fmt: skip


def make_colmap(write):
    def files():
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder), ring(count=6))
            return {path.name: path.read_bytes() for path in Path(folder).iterdir()}

    return files


# --- what reads them ------------------------------------------------------------------------------


def read_splats(path):
    splats = read(path).splats
    made.check_arrays(splats)
    assert 0 < len(splats) <= 65_536


def read_model(path):
    for camera in load_cameras(path)[0]:
        turn = camera.camera_from_world[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert np.isfinite(camera.camera_from_world).all() and camera.fx > 0 and camera.fy > 0
        assert camera.width > 0 and camera.height > 0 and camera.name.isprintable()


def read_mesh(path):
    points, triangles = (_read_obj if path.suffix == ".obj" else _read_ply)(path)
    assert np.isfinite(points[triangles]).all()


def read_heights(path):
    assert read_tiff(path, 0.1, 1.0).bed.size <= 1e8


def read_classes(path):
    found = read_mask(path)
    assert found.min() >= -1 and found.max() < len(class_table().names)


def read_sky(path):
    assert np.isfinite(read_hdr(path)).all()


def read_preset(path):
    config = Config.from_preset(path)
    for time_s in config.key_times():
        config.at(time_s + 0.3)


def one_of_files(rng, files):
    """A model of several files, one of them damaged."""
    name = list(files)[rng.integers(len(files))]
    return files | {name: mutate.mutated(rng, files[name])}


def rezipped_or_not(rng, data):
    """A file of arrays, damaged as it stands or within a sound archive."""
    if rng.random() < 0.5:
        return mutate.mutated(rng, data)
    with np.load(io.BytesIO(data)) as archive:
        arrays = dict(archive)
    name = list(arrays)[rng.integers(len(arrays))]
    member = io.BytesIO()
    np.lib.format.write_array(member, arrays[name])
    return own.made.rezipped(arrays | {name: mutate.mutated(rng, member.getvalue())})


def content_of(make):
    """Return a function that gives the content of the file that `make` writes into a folder."""

    def whole():
        with tempfile.TemporaryDirectory() as folder:
            path = make(Path(folder))
            return {p.name: p.read_bytes() for p in Path(folder).iterdir()} | {"": path.name}

    return whole


def damaged_among(damage):
    """Return a function that damages the one file of a folder that is meant."""

    def one(rng, files):
        return files | {files[""]: damage(rng, files[files[""]])}

    return one


def labels():
    file = io.BytesIO()
    np.save(file, np.arange(40, dtype=np.uint16))
    return file.getvalue()


def as_json(data):
    return lambda: json.dumps(data).encode()


LENS = {"camera_model": "OPENCV", "frames": [{"k1": 0.1, "k2": -0.02, "p1": 0, "p2": 1e-3}] * 2}
POSE = [1, 0, 0, 0, 0, 0, -1, -3, 0, 1, 0, 1.5, 0, 0, 0, 1]
PATH = {
    "camera_type": "perspective", "render_height": 48, "render_width": 64, "fps": 24.0,
    "camera_path": [{"camera_to_world": POSE, "fov": 50.0, "aspect": 1.5, "render_time": t / 24}
                    for t in range(3)],
}  # fmt: skip


def make_actors(folder):
    write_splats(folder / "box.ply", random_splats(20, 1))
    track = {"times": [0, 1.5], "positions": [[0, 0, 0], [1, 0, 0]],
             "rotations": [[1, 0, 0, 0], [0.7, 0, 0, 0.7]], "visible": [True, False]}  # fmt: skip
    node = {
        "id": "a", "class": "car", "splats": "box.ply", "track": track, "label": 3,
        "box": {"centre": [0, 0, 0], "size": [1, 1, 1]}, "harmonics": "scene",
        "lamps": [{"class": "tail", "at": [0, 0, 0], "radius": 0.5}],
        "wheels": [{"at": [0, 0, 0], "width": 0.2, "radius": 0.3}],
    }  # fmt: skip
    data = {"rainsim_actors": 1, "scene": "static.ply", "nodes": [node]}
    (folder / "actors.json").write_text(json.dumps(data), encoding="utf-8")
    return folder / "actors.json"


def read_camera_path(path):
    cameras, moments = read_path(path)
    for camera in cameras:
        require_camera(camera, "it")
    assert list(moments) == sorted(moments)


def read_moving(path):
    for actor in read_actors(path).actors:
        made.check_arrays(actor.splats)
        assert np.isfinite(actor.track.pose(0.7).rotation).all()


def make_gltf(folder):
    gltf(folder / "a.gltf")
    return folder / "a.gltf"


def make_glb(folder):
    gltf(folder / "a.glb")
    return folder / "a.glb"


def make_usd_camera(folder):
    order = 'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]'
    places = "double3 xformOp:translate.timeSamples = {1: (0, 1, 2), 5: (1, 1, 2)}"
    turn = "float3 xformOp:rotateXYZ = (80, 0, 10)\nfloat focalLength = 35"
    camera = usd_camera(f"{places}\n{turn}\n{order}")
    return usda(folder / "a.usda", f'def Xform "Rig"\n{{\n{camera}}}\n')


def make_usd_splats(folder):
    rng = np.random.default_rng(5)

    def rows(*shape):
        return repr([tuple(row) for row in rng.uniform(0.1, 1, shape).round(3).tolist()])

    lines = [
        f"point3f[] positions = {rows(20, 3)}", f"quatf[] orientations = {rows(20, 4)}",
        f"float3[] scales = {rows(20, 3)}",
        f"float[] opacities = {rng.uniform(0.1, 1, 20).round(3).tolist()}",
        "uniform int radiance:sphericalHarmonicsDegree = 0",
        f"float3[] radiance:sphericalHarmonicsCoefficients = {rows(20, 3)}",
    ]  # fmt: skip
    inside = "\n".join(lines)
    return usda(folder / "a.usda", f'def ParticleField3DGaussianSplat "S"\n{{\n{inside}\n}}\n')


def read_camera_of_shot(path):
    for camera in read_shot(path).cameras:
        require_camera(camera, "it")


def table():
    return b'time_s,rain,other\n0,1.5,2\n60,3e-1,4\n120,0,-5\n"180",2,1\n'


def read_table(path):
    assert np.isfinite(read_series(path).values).all()


def grid():
    rows = "\n".join(" ".join(f"{x * y / 7:.3f}" for x in range(9)) for y in range(8))
    head = "ncols 9\nnrows 8\nxllcorner 5.5\nyllcorner -3\ncellsize 0.5\nNODATA_value -9999\n"
    return (head + rows + "\n").encode()


def read_grid(path):
    assert read_raster(path).values.size <= 1e8


def stage_of(make, suffix):
    """Return a function that gives a stage as bytes, text or binary."""

    def whole():
        with tempfile.TemporaryDirectory() as folder:
            path = make(Path(folder))
            if suffix == ".usdc":
                from pxr import Sdf

                Sdf.Layer.FindOrOpen(str(path)).Export(str(path.with_suffix(suffix)))
            return path.with_suffix(suffix).read_bytes()

    return whole


def bounded(read_it):
    """Return a function that reads a stage here, in the bounds that a process of its own has."""

    def reads(path):
        if usd_guard._start is None:
            usd_guard.watch_memory()
        read_it(path)

    return reads


# The library may end the process, so that these are read in one of their own always.
STAGES = {
    f"{name}{suffix}": Kind(f"a{suffix}", stage_of(make, suffix), mutate.plain, bounded(read_it))
    for name, make, read_it in (
        ("USD camera", make_usd_camera, lambda path: usd_cameras._read(path, None)),
        ("USD splats", make_usd_splats, lambda p: made.check_arrays(usd._read_stage(p)[0])),
    )
    for suffix in (".usda", ".usdc")
}
KINDS = STAGES | {
    "glTF camera": Kind(
        "", content_of(make_gltf), damaged_among(mutate.valued), read_camera_of_shot
    ),
    "glb camera": Kind("", content_of(make_glb), damaged_among(mutate.plain), read_camera_of_shot),
    "series": Kind("a.csv", table, mutate.plain, read_table),
    "grid": Kind("a.asc", grid, mutate.plain, read_grid),
    "labels": Kind("a.npy", labels, mutate.plain, lambda path: label_ids(path, 40)),
    "lens": Kind("transforms.json", as_json(LENS), mutate.valued, lambda p: lens_named(str(p))),
    "camera path": Kind("path.json", as_json(PATH), mutate.valued, read_camera_path),
    "nodes": Kind("", content_of(make_actors), damaged_among(mutate.valued), read_moving),
    "mesh, text": Kind("a.ply", lambda: mesh_ply("ascii"), mutate.plain, read_mesh),
    "mesh": Kind("a.ply", lambda: mesh_ply("binary_little_endian"), mutate.plain, read_mesh),
    "OBJ": Kind("a.obj", obj, mutate.plain, read_mesh),
    "TIFF": Kind("a.tif", heights, mutate.plain, read_heights),
    "mask": Kind("a.png", mask, mutate.plain, read_classes),
    "sky": Kind("a.hdr", sky, mutate.plain, read_sky),
    "preset": Kind("a.toml", preset, mutate.plain, read_preset),
}
KINDS |= {
    name: Kind("a", whole, damage, read_splats) for name, (whole, damage) in formats.READERS.items()
}
KINDS |= {
    f"COLMAP {write.__name__}": Kind("", make_colmap(write), one_of_files, read_model)
    for write in (made.colmap_binary, made.colmap_text)
}
KINDS |= {
    name: Kind("", content_of(make), damaged_among(rezipped_or_not), read_own, 0.5)
    for name, (make, read_own) in own.KINDS.items()
}
KINDS |= {
    f"{name}.json": Kind("", content_of(make), damaged_among(mutate.valued), read_own, 0.25)
    for name, (make, read_own) in own.JSON_KINDS.items()
}


def put(folder, kind, data):
    """Write damaged content; return the path to be read."""
    if not isinstance(data, dict):
        (folder / kind.name).write_bytes(data)
        return folder / kind.name
    for name, content in data.items():
        if name:
            (folder / name).write_bytes(content)
    return folder / data[""] if "" in data else folder


def fuzz(name, folder, count, seed):
    """Read mutated files of a kind; return how many were read, refused, and the slowest [s]."""
    kind = KINDS[name]
    rng, whole = np.random.default_rng(seed), kind.whole()
    outcome = {"read": 0, "refused": 0, "slowest": 0.0}
    for _ in range(count):
        path = put(folder, kind, kind.damage(rng, whole))
        begun = time.perf_counter()
        signal.alarm(PATIENCE)
        try:
            kind.read(path)
        except RainsimError as error:
            one_clear_line(error)
            outcome["refused"] += 1
        else:
            outcome["read"] += 1
        signal.alarm(0)
        outcome["slowest"] = max(outcome["slowest"], round(time.perf_counter() - begun, 3))
    return outcome


@pytest.fixture
def late():
    """Raise in a test that waits for one file."""

    def stop(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    yield
    signal.signal(signal.SIGALRM, before)


def needs_extra(name):
    if name in STAGES:
        pytest.importorskip("pxr")
    if name in formats.NEED_EXTRA:
        for module in ("gsply", "imagecodecs", "zstandard"):
            pytest.importorskip(module)


@pytest.mark.parametrize("name", [name for name in KINDS if name not in STAGES])
def test_sound_files_are_read_and_mutated_ones_or_refused(tmp_path, name, late):
    needs_extra(name)
    kind = KINDS[name]
    kind.read(put(tmp_path, kind, kind.whole()))
    outcome = fuzz(name, tmp_path, QUICK, seed=1)
    assert outcome["refused"] > kind.refused * QUICK and outcome["read"] > 0, outcome


# Kinds of which no part is a whole file of less: text may end anywhere.
ENDED = [*formats.READERS, *own.KINDS, "COLMAP colmap_binary", "glTF camera", "glb camera"]


@pytest.mark.parametrize("name", ENDED)
def test_files_cut_off_anywhere_are_refused(tmp_path, name):
    needs_extra(name)
    kind = KINDS[name]
    whole = kind.whole()
    if name == "sog":
        whole = made.bundle(whole)
    files = whole if isinstance(whole, dict) else {kind.name: whole}
    for part in {files[""]} if "" in files else files:
        content = files[part]
        for length in {*range(0, len(content), len(content) // 50 + 1), len(content) - 1}:
            if name == "splat" and length and length % 32 == 0:
                continue  # a whole file of fewer splats
            cut = {part: content[:length]}
            path = put(tmp_path, kind, files | cut if isinstance(whole, dict) else cut[part])
            with pytest.raises(RainsimError) as caught:
                kind.read(path)
            one_clear_line(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_a_campaign_in_a_process_of_its_own(tmp_path, name):
    needs_extra(name)
    campaign(tmp_path, name, CAMPAIGN)


@pytest.mark.parametrize("name", STAGES)
def test_stages_are_read_or_refused_in_a_process_of_their_own(tmp_path, name):
    needs_extra(name)
    campaign(tmp_path, name, QUICK)


def campaign(folder, name, count):
    command = [sys.executable, __file__, name, str(count), "16", str(folder)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        command, capture_output=True, text=True, errors="replace", env=environment
    )
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])
    outcome = json.loads(done.stdout)
    print(f"{name}: {count} files, {outcome}")
    assert outcome["read"] + outcome["refused"] == count and outcome["memory"] < MEMORY, outcome


def main(name, count, seed, folder):
    """Fuzz a kind under limits of memory and time; print the counts as JSON."""
    kind = KINDS[name]
    try:
        kind.read(put(Path(folder), kind, kind.whole()))  # imports and compiles what it needs
    except InputError as error:
        sys.exit(f"a sound file is refused: {error}")
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    outcome = fuzz(name, Path(folder), int(count), int(seed))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps(outcome | {"memory": (peak - before) * 1024}))


if __name__ == "__main__":
    main(*sys.argv[1:])
