"""Files to take home, from which `rainsim run` draws the same picture, and its command."""

import shlex
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from rainsim.config.preset_writer import preset_text_of
from rainsim.errors import RainsimError
from rainsim.io import images
from rainsim.io.files import replacing, write_json
from rainsim.output_folder.claims import relative
from rainsim.scene.camera_path import camera_path_data
from rainsim.scene.folder import write_scene
from rainsim.scene.ground import write_ground_frame
from rainsim.terrain.poured import DRAINS, STAYS, write_water_mask
from rainsim.view.keyframes import path_config, smooth_path
from rainsim.view.probe import mask_picture, painted_classes

PATH, PRESET, PICTURE, COMMAND = "camera_path.json", "preset.toml", "picture.png", "command.txt"
GROUND, DRAWN = "ground_frame.json", "drawn"
MASK, WATER = "class-mask.png", "water-mask.png"
MOST = 9999  # folders of one kind
END_WAIT = 20.0  # s for a run that was interrupted to write its record


@dataclass(frozen=True)
class Saved:
    """The folder that was written, the arguments of `rainsim` that draw from it, and how many."""

    folder: Path
    command: list
    frames: int = 0

    @property
    def line(self):
        """The command as it is typed in a shell."""
        return shlex.join(["rainsim", *self.command])


class Home:
    """Writes files to take home into folders of its own; no earlier file is replaced.

    folder : Path. Made when something is first written.
    say : callable, optional. say(line) prints a command in the terminal that
        shows the page.
    """

    def __init__(self, folder, scene, options=(), say=None):
        self.folder, self.scene, self.options = Path(folder), scene, tuple(options)
        self.say = say or (lambda line: None)

    def save_shot(self, session, view, index, width, height):
        """Write the picture of a view as the command draws it; return the folder as `Saved`."""
        session.make()
        picture, _ = session.draw(view, width, height, index)
        folder = self._new("shot")
        images.write_png(folder / PICTURE, picture)
        return self._write_view(session, folder, view, index, (width, height))

    def save_view(self, session, view, index, width, height):
        """Write the files for one picture of a state and draw nothing; return them as `Saved`."""
        return self._write_view(session, self._new("view"), view, index, (width, height))

    def _write_view(self, session, folder, view, index, size):
        """Write camera, preset and command of one picture of `size` (width, height) [px]."""
        (width, height), before = size, session.config
        config = replace(before, width=width, height=height, frames=max(before.frames, index + 1))
        poses = [(session.pose_of(view), view.fov)]
        data = camera_path_data(poses, width, height, config.fps)
        frames = ["--frames", str(config.frames), "--frame-range", f"{index}:{index + 1}"]
        return self._write(session, folder, config, data, frames, 1)

    def save_path(self, session, keyframes, width, height, video=False):
        """Write keyframes' path and the settings along it; return the folder as `Saved`."""
        config = replace(path_config(keyframes, session.config), width=width, height=height)
        views = smooth_path(keyframes, config.fps)
        poses = [(session.pose_of(view), view.fov) for view in views]
        marks = [
            (session.pose_of(k.view), k.view.fov, 0.0 if n == 0 else k.seconds, k.time)
            for n, k in enumerate(keyframes)
        ]
        data = camera_path_data(poses, width, height, config.fps, marks, config.moments)
        folder = self._new("path")
        frames = ["--frames", str(config.frames), *(["--video"] if video else [])]
        return self._write(session, folder, config, data, frames, config.frames)

    def save_ground(self, session):
        """Write ground frame and painted classes, as options take them; return them as `Saved`."""
        folder = self._new("ground")
        options = self._ground(session, folder)
        return Saved(folder, ["view", self.scene, *options, *self.options])

    def save_scene(self, session):
        """Write the scene with its mended ground as a scene folder; return the folder as `Saved`.

        Every command takes the folder in place of the capture, with the painted classes. Water
        that was put on the ground lies beside it as a mask.
        """
        folder, scene = self._new("scene"), session.scene
        if session.mask is not None:
            scene = replace(scene, painted=painted_classes(session.mask, session.terrain.grid))
        write_scene(folder, scene)
        return Saved(folder, ["view", relative(folder), *_water(session, folder)])

    def _write(self, session, folder, config, data, frames, count):
        """Write camera path, preset and command into a folder."""
        write_json(folder / PATH, data)
        _write_text(folder / PRESET, preset_text_of(config, "Saved by rainsim view."))
        sun = ["--sun", "sky"] if config.render.sun == "sky" else []  # no preset file holds it
        command = [
            "run", "--scene", self.scene, *self._ground(session, folder), *self.options,
            "--preset", relative(folder / PRESET), "--path", relative(folder / PATH), *sun,
            "--width", str(config.width), "--height", str(config.height), *frames,
            "--out", relative(folder / DRAWN),
        ]  # fmt: skip
        saved = Saved(folder, command, count)
        _write_text(folder / COMMAND, saved.line + "\n")
        return saved

    def _ground(self, session, folder):
        """Write ground frame and painted classes into a folder; return their options."""
        write_ground_frame(folder / GROUND, session.scene.ground_frame, session.scene.source_hash)
        return ["--ground-frame", relative(folder / GROUND), *self._mask(session, folder)]

    def _mask(self, session, folder):
        """Write painted classes and water into a folder; return their options, if any."""
        water = _water(session, folder)
        if session.mask is None:
            return water
        images.write_png(folder / MASK, mask_picture(session.mask))
        return ["--class-mask", relative(folder / MASK), *water]

    def _new(self, kind):
        """Return a new folder, such as shot-001."""
        for number in range(1, MOST + 1):
            folder = self.folder / f"{kind}-{number:03d}"
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                if not self.folder.is_dir():
                    raise
                continue
            return folder
        raise RainsimError(f"{self.folder} has {MOST} folders {kind}-NNN; give another --out")


def _write_text(path, text):
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


class CommandRun:
    """A `rainsim` command in a process of its own, with its progress."""

    def __init__(self, saved):
        self.saved, self.last_line = saved, ""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rainsim", *saved.command], stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, start_new_session=True,
        )  # fmt: skip

    @property
    def drawn(self):
        """Number of frames that are written."""
        folder = self.saved.folder / DRAWN / "frames"
        return sum(1 for _ in folder.glob("*.png")) if folder.is_dir() else 0

    def follow(self):
        """Note the last line of the run's status until it ends; return its exit code."""
        for line in self._process.stderr:
            if text := line.strip():
                self.last_line = text
        self._process.stderr.close()
        return self._process.wait()

    def cancel(self):
        """Interrupt the run as Ctrl-C does; its finished frames stay."""
        if self._process.poll() is not None:
            return
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(END_WAIT)
        except subprocess.TimeoutExpired:
            self._process.kill()


def _water(session, folder):
    """Write the water that was put on the ground into a folder; return its options, if any."""
    if session.water_mask is None:
        return []
    write_water_mask(folder / WATER, session.water_mask)
    use = STAYS if session.water_mask.stays else DRAINS
    return ["--water-mask", relative(folder / WATER), "--water-mask-use", use]
