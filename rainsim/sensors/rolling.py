"""Rolling shutters: each band of rows is drawn as camera and drops are when it is exposed.

The first row opens at the frame's time, the last a readout time later. Bands are drawn one by one,
so that it is slow and exact but for the height of a band.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rainsim.errors import ParameterError, require_not_negative
from rainsim.render.labels import boxes_of
from rainsim.render.shutter import moved
from rainsim.scene.cameras import cropped

ROWS = 8  # of a band
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


def bands(camera, motion, readout, exposure, rows=ROWS, first_row=0.0, height=None):
    """Yield delay and cameras, as it opens and closes, of each band of a picture from the top down.

    The delay [s] is that of the band's middle row after the sensor's first row, the cameras are of
    the band alone, the last None if the camera stands still. `camera` is in the ground frame, when
    the first row opens; readout and exposure are in seconds. A band has `rows` rows, the last may
    have fewer. `first_row` is the row of the sensor that the picture's first row is, `height` [px]
    the sensor's, by default the picture's own: a picture that is going to be distorted is larger
    than the sensor.
    """
    height = camera.height if height is None else height
    for top in range(0, camera.height, rows):
        bottom = min(top + rows, camera.height)
        delay = readout * ((top + bottom) / 2 + first_row) / height
        window = 0, top, camera.width, bottom
        begin = cropped(motion.at(camera, delay), window)
        end = None if motion.is_still else cropped(motion.at(camera, delay + exposure), window)
        yield delay, begin, end


def draw_rolling(renderer, camera, state, motion, readout, names=(), **options):
    """Return the picture of a rolling shutter and its `FrameReport`, as `Renderer.draw` does.

    The camera is in the ground frame. Water does not move on within the readout [s], drops do. Flow
    is not among the AOVs `names`; `options` are `rows`, `first_row` and `height` of `bands`.
    """
    frame, parts = renderer.conductor.wet_scene.frame, []
    exposure = renderer.conductor.config.at(state.time).render.exposure
    for delay, begin, end in bands(camera, motion, readout, exposure, **options):
        here = state.shown_at(state.time + delay)
        part, report = renderer.draw(frame.camera_in_capture(begin), here, end, names)
        parts.append((part.copy(), report))  # a GPU draws the next band in the same memory
    picture = np.concatenate([part for part, _ in parts])
    reports = [report for _, report in parts]
    aovs = {name: np.concatenate([r.aovs[name] for r in reports]) for name in names}
    facts = dict(reports[0].facts)
    for kind, name in (("puddles", "puddle_id"), ("splashes", "splash_id")):
        if name in aovs:
            known = {entry["id"]: entry for r in reports for entry in r.facts.get(kind, ())}
            facts[kind] = [{**known.get(b["id"], {}), **b} for b in boxes_of(aovs[name])]
    if "actor_id" in aovs:
        heights = [len(part) for part, _ in parts]
        facts["actors"] = _actors(reports, np.cumsum([0, *heights]), aovs["actor_id"])
    notes = tuple(dict.fromkeys(note for r in reports for note in r.notes))
    return picture, replace(reports[0], time=state.time, aovs=aovs, facts=facts, notes=notes)


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
