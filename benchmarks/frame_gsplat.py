"""A capture's frames on one GPU beside gsplat's: part of `benchmarks frame --backend cuda`.

The capture is drawn as it is and with eight times as many splats, which give nearly the same
picture. Dry pictures are timed by events on the device; rainy frames are those of a sequence, with
everything that the preset asks for, simulation and the 8-bit picture on the host included.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np

from benchmarks import frame_levels
from benchmarks.growth import halved
from benchmarks.suite import intrinsics, markdown, quiet
from rainsim import pipeline, raster
from rainsim.config.settings import Config
from rainsim.scene.cameras import resize_to

NEAR = 0.01  # capture units
SIZES = {False: (0, 3), True: (0,)}  # how many times each splat is halved
PRESETS = ("moderate", "downpour")
WIDTH = {False: 1297, True: 32}  # px
SPACING, EXTENT = {False: 0.01, True: 0.2}, {False: 5.12, True: 1.0}  # m: 1024 x 1024 cells
FRAMES, SETTLING = {False: 110, True: 3}, {False: 20, True: 1}  # of a sequence; first left out
VIEWS = {False: 8, True: 1}  # cameras of which the dry pictures are timed
REPEATS = 15  # pictures of each view by gsplat, of which the median counts


def measure(scene, quick=False, say=quiet):
    """Return rows of times [ms] of one scene: program, splats, picture, median and least."""
    rows = []

    def add(program, what, count, times):
        rows.append({
            "scene": scene.name, "program": program, "what": what, "splats": count,
            "median_ms": float(np.median(times)), "least_ms": float(np.min(times)),
        })  # fmt: skip
        say("{scene} {splats:8d} splats  {program:8s} {what:24s} {median_ms:7.3f} ms  "
            "(least {least_ms:.3f})".format(**rows[-1]))  # fmt: skip

    config = Config.from_preset(PRESETS[0]).replace(spacing=SPACING[quick], extent=EXTENT[quick])
    cameras = frame_levels.cameras_of(scene, "moving", FRAMES[quick] + 1)
    cameras = [resize_to(camera, WIDTH[quick]) for camera in cameras]
    terrain = pipeline.extract_terrain(scene, config)
    for halvings in SIZES[quick]:
        splats = scene.splats
        for _ in range(halvings):
            splats = halved(splats)
        views = cameras[:: max(1, len(cameras) // VIEWS[quick])][: VIEWS[quick]]
        for what, times in _dry(splats, views).items():
            add(*what, len(splats), times)
        dense = replace(scene, splats=splats)
        for preset in PRESETS:
            settings = Config.from_preset(preset).replace(
                width=WIDTH[quick], frames=FRAMES[quick], spacing=SPACING[quick],
                extent=EXTENT[quick],
            )  # fmt: skip
            for what, times in _rainy(dense, terrain, settings, cameras, SETTLING[quick]).items():
                add("rainsim", f"{preset}, {what}", len(splats), times)
    return rows


def _dry(splats, views):
    """Return times [ms] of dry pictures by program and layers: rainsim, and gsplat if installed."""
    from rainsim.cuda.jit import cuda
    from rainsim.cuda.raster import Rasterizer

    own, found = Rasterizer(raster.prepare(splats)), []
    for view in views:
        times = []
        for _ in range(REPEATS):
            cuda.synchronize()
            begin = time.perf_counter()
            own.draw(view, NEAR, on_device=True)
            cuda.synchronize()
            times.append((time.perf_counter() - begin) * 1e3)
        found.append(float(np.median(times)))
    found = {("rainsim", "dry, all layers"): found}
    if find_spec("gsplat") is None or find_spec("torch") is None:
        return found
    found |= {("gsplat", what): times for what, times in gsplat_times(splats, views).items()}
    if find_spec("gsplat.experimental") is not None:
        found["HiGS", "dry, colour"] = higs_times(splats, views)
    return found


def _tensor(values):
    """Return values as a float32 tensor on the device."""
    import torch

    return torch.tensor(np.ascontiguousarray(values, np.float32), device="cuda")


def _tensors(splats):
    """Return positions, rotations, scales, opacities, harmonics of splats on the device; degree."""
    fields = splats.position, splats.rotation, splats.scale, splats.opacity, splats.sh
    return *map(_tensor, fields), int(np.sqrt(splats.sh.shape[1])) - 1


def _median_time(draw):
    """Return the median time [ms] of REPEATS pictures, by events."""
    import torch

    each = []
    for _ in range(REPEATS):
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        with torch.inference_mode():
            begin.record()
            draw()
            end.record()
        torch.cuda.synchronize()
        each.append(begin.elapsed_time(end))
    return float(np.median(each))


def higs_times(splats, views):
    """Return times [ms] of the pictures of gsplat's renderer for inference (HiGS, 2606.00352).

    Colour in half precision and transmittance, the quicker of its two tile sizes for each view; it
    has neither depth nor normals.
    """
    import torch
    from gsplat.experimental import GaussianInferenceRenderer
    from gsplat.scene import GaussianInferenceScene

    position, rotation, *rest, degree = _tensors(splats)
    rotation = torch.nn.functional.normalize(rotation, dim=-1)
    scene = GaussianInferenceScene.from_gaussian_tensors(
        position, rotation, *rest, degree, "none", id="capture"
    )
    renderers, times = [GaussianInferenceRenderer(scene, tile_size=size) for size in (8, 16)], []
    for view in views:
        options = {
            "viewmat": _tensor(view.camera_from_world), "K": _tensor(intrinsics(view)),
            "width": view.width, "height": view.height, "near_plane": NEAR,
        }  # fmt: skip
        times.append(min(_median_time(partial(own.render, **options)) for own in renderers))
    del scene, renderers, position, rotation, rest
    torch.cuda.empty_cache()
    return times


def gsplat_times(splats, views):
    """Return times [ms] of gsplat's pictures, by their layers."""
    import torch
    from gsplat import rasterization

    *values, sh, degree = _tensors(splats)
    found = {}
    for what, mode in (("dry, colour", "RGB"), ("dry, colour and depth", "RGB+ED")):
        for packed in (False, True):
            times = []
            for view in views:
                place = _tensor(view.camera_from_world)[None], _tensor(intrinsics(view))[None]
                times.append(_median_time(partial(
                    rasterization, *values, sh, *place, view.width, view.height, near_plane=NEAR,
                    sh_degree=degree, packed=packed, render_mode=mode,
                )))  # fmt: skip
            if what not in found or np.median(times) < np.median(found[what]):
                found[what] = times  # the quicker of gsplat's two layouts
    del values, sh
    torch.cuda.empty_cache()
    return found


def _rainy(scene, terrain, settings, cameras, settling):
    """Return times [ms] from frame to frame of a sequence, and of frames drawn one by one."""
    from rainsim.cuda.render.renderer import Renderer
    from rainsim.cuda.simulation import simulate

    cameras = cameras[: settings.frames]
    stamps = []
    states = itertools.islice(simulate(terrain, settings), len(cameras))
    for _ in pipeline.render(scene, terrain, states, cameras, settings, backend="cuda"):
        stamps.append(time.perf_counter())
    own, alone = Renderer(scene, terrain, settings, cameras[0]), []
    for camera, state in zip(cameras, simulate(terrain, settings), strict=False):
        begin = time.perf_counter()
        own.draw(camera, state)
        alone.append((time.perf_counter() - begin) * 1e3)
    return {"sequence": np.diff(stamps)[settling:] * 1e3, "one by one": alone[settling:]}


def table(rows):
    """Return the rows of one scene as a Markdown table: medians, and the least in brackets."""
    counts = list(dict.fromkeys(row["splats"] for row in rows))
    cells = {}
    for row in rows:
        of = cells.setdefault(f"{row['program']}, {row['what']}", dict.fromkeys(counts, "-"))
        of[row["splats"]] = f"{row['median_ms']:.3g} ({row['least_ms']:.3g})"
    heads = (f"{count / 1e6:.2f} M splats" for count in counts)
    return "\n".join(markdown(
        (f"{rows[0]['scene']}: ms, median (least)", *heads),
        [(what, *of.values()) for what, of in cells.items()],
    ))  # fmt: skip
