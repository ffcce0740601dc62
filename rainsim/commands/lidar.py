"""`rainsim lidar`: turns of a lidar in the rain that the cameras see."""

import click

from rainsim.commands import options
from rainsim.commands.export import rains_of
from rainsim.commands.given import named_camera
from rainsim.commands.job import Job
from rainsim.commands.options import group, option
from rainsim.errors import ParameterError, counted

SENSORS = ("vlp16", "hdl32", "hdl64")
FORMATS = ("kitti", "pcd", "ply")
MOST_TURNS = 9999
HIGHEST = 1000.0  # m above or below the ground's level

# fmt: off
_lidar_options = group(
    option("sensor", click.Choice(SENSORS), "Channels, ranges and beams of which lidar.",
           default="vlp16"),
    option("rain rains", str, "Rain rates in mm/h; 0 is the dry scene in clear air. The "
           "preset's rate does not count.", "MM/H,MM/H", default="0,10,25,50"),
    option("camera", str, "The lidar stands at this camera, level, and looks where it looks. "
           "[default: the first]", "NAME"),
    option("height", float, "Height of the lidar above the ground's level in metres.", "M",
           shows="the camera's"),
    option("speed", float, "Speed ahead in m/s.", "M/S", default=0.0),
    option("turns", click.IntRange(1, MOST_TURNS), "Number of turns, one after the other.",
           default=1),
    option("format kind", click.Choice(FORMATS), "kitti: .bin with .label files; pcd: all pulses, "
           "lost ones as NaN; ply.", default="kitti"),
)
_albedo_option = option(
    "ground-albedo", float, "Share of the light that the open dry ground reflects; colours stand "
    "for reflectivities.", "0..1", shows="guessed")
# fmt: on


@click.command(short_help="Scan a scene by a lidar, clear and in rain.")
@click.argument("scene", default="bicycle")
@_lidar_options
@options.preset_option
@options.shower_options
@_albedo_option
@options.ground_options
@options.terrain_options
@options.output_options("rainsim-out/SCENE-SENSOR")
@options.resume_option
def lidar(scene, sensor, rains, height, speed, turns, kind, **given):
    """Scan SCENE by a lidar, clear and in rain, through the very drops that the cameras see.

    Writes DIR/clear and DIR/rain/25mm and so on with a file for each turn, the label of each point
    (1 scattered by a drop, 2 kept, 3 mirrored by water; lost pulses have no point), poses.txt and
    lidar.json with counts, extinction and LISA's expectation. For clouds along a drive, with
    pictures, see `rainsim export --layout semantic_kitti`.

    \b
    Example:
        rainsim lidar street --sensor hdl64 --height 1.7 --rain 0,25
    """
    rates = rains_of(rains)
    job = Job(given)
    if not abs(speed) <= 100:  # false for NaN
        raise ParameterError(f"--speed is {speed} m/s; it must lie from -100 to 100")
    if height is not None and not abs(height) <= HIGHEST:
        raise ParameterError(
            f"--height is {height} m; it must lie from -{HIGHEST:g} to {HIGHEST:g}"
        )
    from rainsim.compiling.uses import LIDAR

    with job.compiling([LIDAR]):
        job.load(scene)
        job.out = job.out or options.default_out(job.scene.name, sensor)
        camera = named_camera(job.scene, given["camera"])
        place = job.scene.ground_frame.camera_in_ground(camera)
        from rainsim.sensors.drive import LidarFolder, scan_rains

        with job.folder(job.scene.source):
            folder = LidarFolder(job.out, kind, job.overwrite, job.resume)
            facts = scan_rains(
                folder, job.scene, job.config, rates, sensor=sensor, camera=place, height=height,
                speed=speed, turns=turns, tell=job.status.progress, say=job.status.notes,
            )  # fmt: skip
    total = counted(turns * len(rates), "turn")
    job.finish(total, facts, more=f" ({job.status.seconds:.1f} s)")
