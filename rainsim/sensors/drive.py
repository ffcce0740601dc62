"""A lidar's turns in each rain, and the folder that they are written to."""

import re
import sys

import numpy as np

from rainsim import __version__
from rainsim.actors.motion import Motion
from rainsim.config.settings import mm_per_hour
from rainsim.drops import Weather
from rainsim.io.files import replacing, write_json
from rainsim.lod.held_parts import scene_in_reach
from rainsim.output_folder.card_folder import CardFolder
from rainsim.output_folder.facts import input_facts, scene_content, settings_content, versions
from rainsim.pipeline import extract_terrain, simulate
from rainsim.render.actor_labels import box_in_space
from rainsim.render.weather import weather_of
from rainsim.sensors import point_files
from rainsim.sensors.lidar import LidarScanner, Pose, pose_at
from rainsim.sensors.lidar_model import LABEL_NAMES, SENSORS, extinction_of
from rainsim.sensors.lisa import scattered_share
from rainsim.sensors.radar import rain_attenuation
from rainsim.shading.calibration import albedo_of_white
from rainsim.shading.wetness import paving_dampness

CARD = "lidar.json"
CARD_VERSION = 1
JOURNAL = "turns.jsonl"  # which turns are whole
WRITER = {"rainsim_lidar": CARD_VERSION, "program": "rainsim", "version": __version__}
OURS = re.compile(
    r"(clear|rain/[\d.]+mm)/((velodyne|labels)/\d{6}\.(bin|label)|points/\d{6}\.(pcd|ply))"
    r"|poses\.txt|turns\.jsonl"
)
SAMPLES = 2000  # targets that LISA's expectation is averaged over


class LidarFolder(CardFolder):
    """A folder of turns of a kind ("kitti", "pcd", "ply").

    It may hold an earlier result, whose files are removed, if `overwrite` is set, and an unfinished
    scan, which `resume` goes on with.
    """

    def __init__(self, folder, kind, overwrite=False, resume=False):
        what = "scan of a lidar"
        super().__init__(folder, CARD, JOURNAL, OURS.fullmatch, what, overwrite, resume)
        self.kind, self.files = kind, []

    def begin(self, content, count):
        """Find what is kept of a scan of `count` turns, and remove an earlier one's other files."""
        self.find_kept(content, count)
        self.kept = {n: entry for n, entry in self.kept.items() if _has_facts(entry)}
        self.clear()
        self._write_card({"complete": False})  # a scan that is killed can be gone on with

    def finish(self, card):
        """Write the card of a whole scan, which needs no journal any more."""
        self._write_card({**card, "complete": True, "files": sorted([*self.files, JOURNAL])})

    def _write_card(self, facts):
        write_json(self.card_file, WRITER | {"fingerprint": self.fingerprint} | facts)

    def keep(self, number):
        """Return the journal's entry of a turn that is kept, None if it is to be scanned."""
        entry = self.kept.get(number)
        if entry is not None:
            self.files += entry["files"]
        return entry

    def add(self, number, where, turn, scan, channels, facts):
        """Write a turn into the folder `where` of its rain, and note it with facts."""
        if self.kind == "kitti":
            files = {f"velodyne/{turn:06d}.bin": point_files.kitti_bin(scan),
                     f"labels/{turn:06d}.label": point_files.kitti_labels(scan)}  # fmt: skip
        elif self.kind == "pcd":
            files = {f"points/{turn:06d}.pcd": point_files.pcd_bytes(scan, channels)}
        else:
            files = {f"points/{turn:06d}.ply": point_files.ply_bytes(scan)}
        for name, content in files.items():
            self.write(f"{where}/{name}", content)
        self.journal.add(number, [f"{where}/{name}" for name in files], **facts)

    def write(self, name, content):
        """Write a file of bytes."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(content)
        self.files.append(name)


def _has_facts(entry):
    return isinstance(entry.get("points"), dict) and isinstance(entry.get("share"), float)


def scan_rains(
    folder, scene, config, rates, *, sensor, camera, height=None, speed=0.0, turns=1,
    tell=lambda stage, done, total: None, say=lambda notes: None,
):  # fmt: skip
    """Scan a scene in each rain, write the turns, and return the card.

    The settings' rain is replaced by each of `rates` [mm/h]. `sensor` is a key of
    `lidar_model.SENSORS`; the camera, in the ground frame, stands and looks as the lidar does, at
    `height` [m] if that is given, and goes ahead at `speed` [m/s]. tell(stage, done, total) and
    say(notes) are called.
    """
    terrain = extract_terrain(scene, config, None, tell, say)
    albedo, note = albedo_of_white(terrain, scene, config.render.ground_albedo)
    say([note])
    lidar, pose = SENSORS[sensor], pose_at(camera, height)
    pose = Pose(pose.position, pose.rotation, speed * pose.rotation[:, 0])
    way = [_moved(pose, turn / lidar.rate).position for turn in range(turns + 1)]
    scanner = LidarScanner(_in_reach(scene, way, lidar, say), terrain, albedo)
    folder.begin({
        "scene": scene_content(scene),
        "settings": settings_content(config), "rates": list(rates),
        "sensor": sensor, "kind": folder.kind, "turns": turns, "speed": speed, "height": height,
        "place": pose.position.tolist(), "turn": pose.rotation.tolist(),
    }, turns * len(rates))  # fmt: skip
    rains, done = [], 0
    for rate in rates:
        own = config.replace(rate=mm_per_hour(rate), frames=turns, fps=lidar.rate)
        own = own if rate > 0 else own.replace(past=0.0, level=None)
        weather, states, state = Weather(own.check()), simulate(terrain, own), None
        where, counts, shares = f"rain/{rate:g}mm" if rate > 0 else "clear", {}, []
        for turn in range(turns):
            begin = turn / lidar.rate
            field = weather.field(begin, begin + 1 / lidar.rate)
            facts = folder.keep(done)
            if facts is None:
                while state is None or state.index < turn:  # each follows from the one before
                    state = next(states)
                # Noise of its own for each turn and rain, whatever is scanned besides.
                rng = np.random.default_rng([own.rain.seed, turn, round(rate * 1e6)])
                damp = paving_dampness(own.at(begin)) if rate > 0 else 0.0
                scan = scanner.scan(lidar, _moved(pose, begin), begin, rng, field, state, damp)
                points = {n: int((scan.label == k).sum()) for k, n in LABEL_NAMES.items()}
                facts = {"points": points, "share": _expected(scan, lidar, field)}
                folder.add(done, where, turn, scan, len(lidar.elevation), facts)
            for name, count in facts["points"].items():
                counts[name] = counts.get(name, 0) + count
            shares.append(facts["share"])
            done += 1
            tell("turns", done, turns * len(rates))
        rains.append({"folder": where, **_rain_facts(rate, own, field, counts, shares)})
    poses = [_moved(pose, turn / lidar.rate) for turn in range(turns)]
    lines = ["".join(_row(p)) for p in poses]
    folder.write("poses.txt", "".join(lines).encode())
    card = {
        "command": ["rainsim", *sys.argv[1:]],
        "versions": versions(),
        "input": input_facts(scene, folder.folder), "sensor": sensor,
        "channels": len(lidar.elevation), "columns": lidar.columns, "far_m": lidar.far,
        "turns_per_s": lidar.rate, "divergence_rad": lidar.divergence, "speed_m_per_s": speed,
        "labels": {str(k): name for k, name in LABEL_NAMES.items()},
        "reflectivity_of_white": round(albedo, 4), "seed": config.rain.seed, "rains": rains,
    }  # fmt: skip
    if scene.actors:
        card["nodes"] = _actors(scene, lidar.rate, turns)
    folder.finish(card)
    return WRITER | card


def _rain_facts(rate, config, field, counts, shares):
    """Return what a card says of one rain [mm/h]: its weather, and what became of the pulses."""
    return {
        **weather_of(config, field), "points": counts,
        "lidar_extinction_per_m": 0.0 if field is None else extinction_of(field.spectrum),
        "scattered_share": counts["scattered"] / max(sum(counts.values()), 1),
        "scattered_share_by_lisa": float(np.mean(shares)),
        "radar_db_per_km_vertical_77_ghz": round(float(rain_attenuation(rate, 77.0)), 4),
    }  # fmt: skip


def _in_reach(scene, way, lidar, say):
    """Return the scene that the beams of a lidar on its way (n, 3) [m] meet; of chunks a part."""
    within = scene_in_reach(scene, way, lidar.far, lidar.divergence)
    if within is not scene:
        say([f"{len(within.splats)} splats are as fine as the beams that meet them"])
    return within


def _actors(scene, rate, turns):
    """Return what a card says of each actor: its box, ground frame, as each turn begins."""
    return [
        {"number": number, "track": actor.id, "class": actor.kind,
         "box3d": [box_in_space(Motion(actor, scene.ground_frame), turn / rate, 1 / rate)
                   for turn in range(turns)]}
        for number, actor in enumerate(scene.actors, start=1)
    ]  # fmt: skip


def _moved(pose, time):
    return Pose(pose.position + time * pose.velocity, pose.rotation, pose.velocity)


def _row(pose):
    """Return a pose as KITTI's odometry benchmark has it: 12 numbers of ground_from_sensor."""
    matrix = np.column_stack([pose.rotation, pose.position])
    return " ".join(f"{v:.9e}" for v in matrix.ravel()) + "\n"


def _expected(scan, lidar, field):
    """Return the share of the turn's pulses that LISA expects drops to answer, of a sample."""
    if field is None:
        return 0.0
    some = np.random.Generator(np.random.PCG64(0)).permutation(len(scan.label))[:SAMPLES]
    targets = zip(scan.distance[some], scan.target[some], strict=True)
    return float(np.mean([scattered_share(d, r, lidar, field.spectrum) for d, r in targets]))
