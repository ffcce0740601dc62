"""Rolling shutters: each band of rows is drawn as camera and drops are when it is exposed.

The first row opens at the frame's time, the last a readout time later. Bands are drawn one by one,
each as high as it may be: what it shows moves between its first and its middle row by at most
MOST_SHIFT in 99 % of its pixels, and it is read within half the exposure, so that streaks are off
by at most a quarter of their length. A band that turns out to be too high is drawn again, lower.
"""

from dataclasses import dataclass, replace

import numpy as np

from rainsim.errors import ParameterError, require_not_negative
from rainsim.render.labels import boxes_of
from rainsim.render.shutter import moved
from rainsim.scene.cameras import cropped
from rainsim.scene.view import pixel_rays

ROWS = 8  # of the first band, and of the lowest
MOST_SHIFT, COUNTED = 0.25, 99  # px, and the percentage of a band's pixels that move less
SPARE = 0.85  # of the height that would have fitted a band, for the next one
ACTORS = "actor_id"
LONGEST = 0.2  # s; longer readouts are scanners'


@dataclass(frozen=True)
class Motion:
    """How a camera moves, evenly: `velocity` [m/s] and `turning` [rad/s], a rotation vector.

    The turn is that of camera_from_ground, see `shutter.moved`.
    """

    velocity: np.ndarray
    turning: np.ndarray

    def at(self, camera, time):
        """Return a camera (ground frame) as it is after a time [s]."""
        if not (self.velocity.any() or self.turning.any()):
            return camera
        return moved(camera, time * self.velocity, time * self.turning)

    @property
    def is_still(self):
        """Whether the camera does not move."""
        return not (self.velocity.any() or self.turning.any())


STILL = Motion(np.zeros(3), np.zeros(3))


def check_readout(readout):
    """Raise ParameterError unless a readout time [s] is one of a camera."""
    require_not_negative("rolling shutter's readout", readout, "s", "0.02 is usual")
    if readout > LONGEST:
        raise ParameterError(
            f"rolling shutter's readout is {readout * 1e3:g} ms; it must be at most "
            f"{LONGEST * 1e3:g} ms; 20 is usual"
        )


def check_rows(readout, config):
    """Raise ParameterError unless all rows of a frame are exposed before the next one begins.

    What falls later a GPU has not listed yet. The readout is in seconds, 0 of a global shutter.
    """
    exposure = max(config.at(time).render.exposure for time in config.key_times())
    if readout and readout + exposure > config.frame_interval:
        raise ParameterError(
            f"--rolling and exposure take {(readout + exposure) * 1e3:.3g} ms; with --backend cuda "
            f"they must end within a frame, {config.frame_interval * 1e3:.3g} ms; take a shorter "
            "one, a lower --fps, or leave out --backend cuda"
        )


def band(camera, motion, readout, exposure, top, bottom, first_row=0.0, height=None):
    """Return delay and cameras, as it opens and closes, of a picture's rows `top` to `bottom`.

    The delay [s] is that of the band's middle row after the sensor's first row, the cameras are of
    the band alone, the last None if the camera stands still. `camera` is in the ground frame, when
    the first row opens; readout and exposure are in seconds. `first_row` is the row of the sensor
    that the picture's first row is, `height` [px] the sensor's, by default the picture's own: a
    picture that is going to be distorted is larger than the sensor.
    """
    height = camera.height if height is None else height
    delay = readout * ((top + bottom) / 2 + first_row) / height
    window = 0, top, camera.width, bottom
    begin = cropped(motion.at(camera, delay), window)
    end = None if motion.is_still else cropped(motion.at(camera, delay + exposure), window)
    return delay, begin, end


def draw_rolling(renderer, camera, state, motion, readout, names=(), rows=None, **sensor):
    """Return the picture of a rolling shutter and its `FrameReport`, as `Renderer.draw` does.

    The camera is in the ground frame. Water does not move on within the readout [s], drops do. Flow
    is not among the AOVs `names`; `rows` is the height of all bands but the last, by default chosen
    band by band, or ROWS where another height costs the renderer more. `sensor` has `first_row` and
    `height` of `band`.
    """
    rows = rows or (None if renderer.takes_any_height else ROWS)
    conductor, parts, notes = renderer.conductor, [], []
    frame, exposure = conductor.wet_scene.frame, conductor.config.at(state.time).render.exposure
    row_time = readout / (sensor.get("height") or camera.height)
    most = ROWS if rows else max(ROWS, int(0.5 * exposure / max(row_time, 1e-9)))
    moving = (ACTORS,) if most > ROWS and conductor.wet_scene.scene.actors else ()
    drawn, top, rows = (*dict.fromkeys((*names, *moving)),), 0, rows or ROWS
    with conductor.bands_of(motion.at(camera, readout / 2), state.time + readout / 2):
        while top < camera.height:
            bottom = min(top + rows, camera.height)
            delay, begin, end = band(camera, motion, readout, exposure, top, bottom, **sensor)
            here = state.shown_at(state.time + delay)
            picture, report = renderer.draw(frame.camera_in_capture(begin), here, end, drawn)
            notes += report.notes
            if most > ROWS:
                speed = _speed_in(begin, motion, renderer.frame["depth"], report)
                fitting = 2 * MOST_SHIFT / max(speed * row_time, 1e-9)
                last, rows = bottom - top, int(min(SPARE * fitting, 2 * rows, most)) // 4 * 4
                rows = max(ROWS, rows)
                if fitting < last > ROWS:
                    continue
            parts.append((picture.copy(), report))  # a GPU draws the next band in its memory
            top = bottom
    picture = np.concatenate([part for part, _ in parts])
    reports = [report for _, report in parts]
    aovs = {name: np.concatenate([r.aovs[name] for r in reports]) for name in names}
    facts = {key: value for key, value in reports[0].facts.items() if key != "actors"}
    facts |= boxed(aovs, [report.facts for report in reports])
    if ACTORS in aovs:
        heights = [len(part) for part, _ in parts]
        facts["actors"] = _actors(reports, np.cumsum([0, *heights]), aovs[ACTORS])
    notes = tuple(dict.fromkeys(notes))
    return picture, replace(reports[0], time=state.time, aovs=aovs, facts=facts, notes=notes)


def boxed(layers, facts):
    """Return the entries of puddles and splashes in some facts, with their boxes in layers."""
    found = {}
    for kind, name in (("puddles", "puddle_id"), ("splashes", "splash_id")):
        if name in layers:
            known = {entry["id"]: entry for some in facts for entry in some.get(kind, ())}
            found[kind] = [{**known.get(b["id"], {}), **b} for b in boxes_of(layers[name])]
    return found


def _speed_in(camera, motion, depth, report):
    """Return how fast a picture's contents move [px/s]: COUNTED % of its pixels are slower."""
    turn, ray = camera.camera_from_world[:3, :3], pixel_rays(camera)
    near = np.where(np.isfinite(depth), 1 / depth, 0.0)[..., None]
    drift = np.cross(motion.turning, ray) - near * (turn @ motion.velocity)
    for actor in report.facts.get("actors", ()):
        mine = report.aovs[ACTORS] == actor["number"]
        drift[mine] += near[mine] * (turn @ np.array(actor["box3d"]["velocity"]))
    across = camera.fx * (drift[..., 0] - ray[..., 0] * drift[..., 2])
    down = camera.fy * (drift[..., 1] - ray[..., 1] * drift[..., 2])
    return float(np.percentile(np.hypot(across, down), COUNTED))


def _actors(reports, rows, number):
    """Return the labels of each actor that some band shows, or could.

    Its box in the picture is that of its boxes in all bands; its box in space is that at the time
    of the band in which the middle of this box lies. `reports` are those of the bands, `rows` the
    first row of each and the picture's height, `number` is the layer `actor_id` of the whole
    picture.
    """
    seen = {box["id"]: box for box in boxes_of(number)}
    known = {}
    for band, report in enumerate(reports):
        for entry in report.facts.get("actors", ()):
            known.setdefault(entry["number"], {})[band] = entry
    actors = []
    for which, entries in sorted(known.items()):
        boxes = [
            np.add(entry["box2d"], (0, rows[band], 0, rows[band]))
            for band, entry in entries.items()
            if entry["box2d"] is not None
        ]
        box, middle = None, min(entries)
        if boxes:
            low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
            box = [float(v) for v in (*low[:2], *high[2:])]
            band = int(np.searchsorted(rows, (box[1] + box[3]) / 2, side="right")) - 1
            middle = min(entries, key=lambda there: abs(there - band))
        mine = seen.get(which)
        actors.append({
            **entries[middle], "box2d": box, "box2d_seen": mine and mine["box"],
            "pixels": mine["pixels"] if mine else 0,
        })  # fmt: skip
    return actors
