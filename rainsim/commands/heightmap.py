"""The command `rainsim heightmap`: makes a height map and prints figures on it."""

from pathlib import Path

import click

from rainsim.commands import options
from rainsim.commands.given import masks_named
from rainsim.commands.job import Job
from rainsim.errors import ParameterError, counted

GROUND_FRAME = "ground_frame.json"
RAINS = (1, 3, 8, 20)  # mm of past rain that puddles are shown for
CHECK_RAIN = 3  # mm of them, over what a camera sees


@click.command(short_help="Make the height map of a scene.")
@click.argument("scene")
@options.ground_options
@options.terrain_options
@options.mask_options
@options.option("check", str, "Draw the ground's grid and the puddles of 3 mm of rain over what a "
                "camera sees, as check.png. [default: the first]", "[=CAMERA]", is_flag=False,
                flag_value="")  # fmt: skip
@options.resume_option
@options.output_options("rainsim-out/SCENE-terrain")
def heightmap(scene, check, **given):
    """Make the height map of SCENE, a name or a path as for `rainsim run`.

    SCENE may also be a triangle mesh (PLY or OBJ) or a map of heights in metres with the north at
    the top, .asc or TIFF (--spacing is its cell size, if it names none).

    Writes terrain.npz (ground, occluder top and underside, masks), bed.tif and top.tif (float32
    metres, north at the top), ground_frame.json, and to look at: hillshade.png, classes.png and
    puddles-1mm.png to puddles-20mm.png. Cameras beside the splats are used; without any, --up and
    --meters-per-unit are needed.

    \b
    Example:
        rainsim heightmap garden/ --out terrain --check
        rainsim heightmap plaza.ply --up 0,0,1 --meters-per-unit 1 --extent 6
    """
    from rainsim.compiling.uses import HEIGHTMAP
    from rainsim.config.settings import Config
    from rainsim.output_folder.record import Record
    from rainsim.scene.ground import write_ground_frame
    from rainsim.terrain.surface import is_surface

    job = Job(given, base=Config())
    status, surface = job.status, is_surface(scene)
    mask, water = job.read_masks()
    if surface:
        _refuse_with_surface(scene, check, given)
        name = Path(scene).stem
    else:
        with status:
            job.load(scene)
        name = job.scene.name
    loaded = job.scene
    job.out = job.out or options.default_out(name, "terrain")
    with job.folder(scene if surface else loaded.source), job.compiling([HEIGHTMAP]):
        from rainsim.terrain.map_files import write_terrain

        content = _content(scene if surface else None, check, given)
        facts = {"settings": {"terrain": job.config.as_dict()["terrain"]}}
        record = Record(job.out, loaded, content, job.resume, **facts)
        terrain = _terrain_of(job, scene, water) if surface else job.extract_terrain(mask, water)
        status.notes(terrain.notes)
        record.begin()
        record.add(*(path.name for path in write_terrain(job.out, terrain)))
        if loaded is not None:
            frame_file = job.out / GROUND_FRAME
            write_ground_frame(frame_file, loaded.ground_frame, loaded.source_hash)
            record.add(GROUND_FRAME)
        puddles, depth = _puddles(job.out, terrain, record)
        checked = None
        if check is not None:
            camera = _check(job.out, loaded, terrain, check, depth, record)
            checked = {"file": "check.png", "camera": camera, "rain_mm": CHECK_RAIN}
        record.write(complete=True, notes=list(terrain.notes))
    result = {"out": str(job.out), **_result(terrain, loaded, puddles, record.files)}
    result["check"] = checked
    job.finish("height map and pictures", result, _as_text(result))


def _terrain_of(job, surface, water):
    """Return the `Terrain` of a mesh or a map of heights."""
    from rainsim.terrain.poured import with_water
    from rainsim.terrain.surface import terrain_from_surface

    job.status.progress("terrain", 0, 1)
    axes = job.given["up"], job.given["meters_per_unit"]
    terrain = with_water(terrain_from_surface(surface, job.config.terrain, *axes), water)
    job.status.progress("terrain", 1, 1)
    return terrain


def _content(surface, check, given):
    """Return what a height map depends on besides its scene and settings, as plain values."""
    from rainsim.io.fingerprint import hash_of_file

    hashes = {"surface": None if surface is None else hash_of_file(surface), "mask": None}
    hashes |= masks_named(given)
    axes = {name: given.get(name) for name in ("up", "meters_per_unit")} if surface else {}
    return {**hashes, **axes, "check": check}


def _refuse_with_surface(scene, check, given):
    names = "cameras", "camera_height", "ground_frame", "fall", "known_length", "class_mask"
    wrong = [name for name in names if given[name] is not None] + ["check"] * (check is not None)
    if wrong:
        raise ParameterError(
            f"--{wrong[0].replace('_', '-')} is given with {scene}, a surface without cameras or "
            "colours; leave it out"
        )


def _puddles(out, terrain, record):
    """Write the puddle pictures; return figures per rain and the depth after CHECK_RAIN."""
    from rainsim.io import images
    from rainsim.terrain.pictures import puddle_overlay
    from rainsim.water.puddles import doubt, probability, puddles_of, wet_share

    puddles, rows, fallen, shown = puddles_of(terrain), [], 0, None
    for rain in RAINS:
        puddles.rain((rain - fallen) * 1e-3)
        fallen = rain
        name = f"puddles-{rain}mm.png"
        images.write_png(out / name, puddle_overlay(terrain, puddles.depth))
        record.add(name)
        shown = puddles.depth if rain == CHECK_RAIN else shown
        rows.append(
            {
                "rain_mm": rain,
                "puddles": puddles.count(),
                "litres": puddles.volume * 1e3,
                "wet_share_of_paving": wet_share(puddles.depth, terrain.sealed),
                "deepest_mm": float(puddles.depth.max()) * 1e3,
                "probability": probability(terrain, puddles.depth),
                "doubt": doubt(terrain, rain * 1e-3),
            }
        )
    figures = {"hollows": puddles.graph.count, "left_out": puddles.graph.dropped}
    return {**figures, "residual": puddles.residual, "after_rain": rows}, shown


def _check(out, scene, terrain, name, depth, record):
    from rainsim.commands.given import named_camera
    from rainsim.io import images
    from rainsim.terrain.pictures import through_camera

    camera = named_camera(scene, name or None)
    images.write_png(out / "check.png", through_camera(scene, terrain, camera, depth))
    record.add("check.png")
    return camera.name


def _result(terrain, scene, puddles, files):
    """Return the printed figures of a height map as plain values."""
    import numpy as np

    from rainsim.terrain.table import class_table
    from rainsim.terrain.types import INFERRED, MEASURED, UNKNOWN
    from rainsim.water.puddles import bed_error

    grid, source = terrain.grid, terrain.source
    kinds = {"measured": MEASURED, "inferred": INFERRED, "unknown": UNKNOWN}
    result = {
        "files": files,
        "shape": list(grid.shape),
        "spacing": grid.spacing,
        "origin": list(grid.origin),
        "noise_mm": terrain.hard_noise * 1e3,
        "bed_error_mm": bed_error(terrain) * 1e3,
        "shares": {name: float(np.mean(source == kind)) for name, kind in kinds.items()},
        "classes": {
            name: float(np.mean(terrain.ground_class == code))
            for code, name in enumerate(class_table().names)
        },
        "painted_water": _painted_water(terrain),
        "puddles": puddles,
        "tops": _tops(terrain),
        "notes": list(terrain.notes),
    }
    if scene is not None:
        frame = scene.ground_frame
        result["ground_frame"] = {
            "up": [float(v) for v in frame.up],
            "meters_per_unit": frame.meters_per_unit,
            "scale_assumed": frame.scale_assumed,
            "confidence": frame.confidence,
        }
    return result


def _tops(terrain):
    """Return area [m2], height [m] and what each flat top holds [litres], a list of dicts."""
    from rainsim.water.top_water import TopWater

    held = TopWater(terrain).capacity
    return [
        {"m2": float(area), "height": float(surface[0]), "level": bool(level), "litres": 1e3 * v}
        for area, surface, level, v in zip(
            terrain.tops.area, terrain.tops.surface, terrain.tops.level, held.tolist(), strict=True
        )
    ]


def _painted_water(terrain):
    """Return painted water as a dict, None without: `m2`, `litres`, highest `level` [m]."""
    wet = terrain.water > 0
    if not wet.any():
        return None
    return {
        "m2": float(wet.sum()) * terrain.grid.cell_area,
        "litres": float(terrain.water.sum()) * terrain.grid.cell_area * 1e3,
        "level": float((terrain.bed + terrain.water)[wet].max()),
    }


def _as_text(result):
    """Return the figures as lines for a person."""
    lines = [f"height map        {result['out']}"]
    if "ground_frame" in result:
        frame = result["ground_frame"]
        assumed = " (ASSUMED)" if frame["scale_assumed"] else ""
        lines += [
            f"up                {', '.join(f'{v:.5f}' for v in frame['up'])}",
            f"metres per unit   {frame['meters_per_unit']:.6g}{assumed}",
            f"confidence        {frame['confidence']:.2f}",
        ]
    ny, nx = result["shape"]
    x, y = result["origin"]
    share = result["shares"]
    lines += [
        f"cells             {nx} x {ny} of {result['spacing']:g} m from ({x:.2f}, {y:.2f}) m",
        f"noise of paving   {result['noise_mm']:.2f} mm, its smoothed bed some "
        f"{result['bed_error_mm']:.1f} mm off",
        "ground            " + ", ".join(f"{name} {v:.0%}" for name, v in share.items()),
        "classes           "
        + ", ".join(f"{name} {v:.0%}" for name, v in result["classes"].items() if v > 0),
        *_water_line(result["painted_water"]),
        *_top_lines(result["tops"]),
        f"hollows           {result['puddles']['hollows']}, "
        f"{result['puddles']['left_out']} of them left out as noise",
    ]
    for row in result["puddles"]["after_rain"]:
        lines.append(
            f"after {row['rain_mm']:>2} mm       {counted(row['puddles'], 'puddle')}, "
            f"{row['litres']:.1f} litres, {row['wet_share_of_paving']:.0%} of the paving wet, "
            f"deepest {row['deepest_mm']:.1f} mm"
            + ("" if row["probability"] is None else f", probability {row['probability']:.0%}")
        )
    if result["check"] is not None:
        lines.append(
            f"check.png         the ground and the puddles of {CHECK_RAIN} mm of rain, camera "
            f"{result['check']['camera']}"
        )
    doubts = [row["doubt"] for row in result["puddles"]["after_rain"] if row["doubt"]]
    if doubts:
        lines.append(f"WARNING           {doubts[-1]}")
    return "\n".join(lines)


def _top_lines(tops):
    for top in tops:
        holds = f"level, holds {top['litres']:.2f} litres" if top["level"] else "slopes"
        yield f"top               {top['m2']:.2f} m2 at {top['height']:.2f} m, {holds}"


def _water_line(water):
    if water is not None:
        yield (
            f"painted water     {water['m2']:.3g} m2, {water['litres']:.0f} litres over a bed that "
            f"is ASSUMED, level {water['level']:.2f} m"
        )
