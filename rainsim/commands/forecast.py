"""What a long run will take, said when its first frames are drawn: time, and space on the disk."""

import shutil
import time
from contextlib import suppress

from rainsim.commands.status import StageProgress, in_words
from rainsim.errors import ParameterError, RainsimError

FRAMES = "frames"  # the stage that is looked at
MOST_UNSAID = 10  # frames; a run that draws no more of them is over soon
LONG = 60.0  # s that are left, beyond which it is always said
DRAWN = 3  # frames after which it is said
MEASURED = 3  # finished frames at most whose files are looked at


def format_of(given, start=0):
    """Return the `VideoFormat` that the options ask for, None without --video."""
    if not given["video"]:
        return None
    from rainsim.io.video import VideoFormat, require_video

    options = {name: given[f"video_{name}"] for name in ("codec", "quality")}
    asked = VideoFormat(**{k: v for k, v in options.items() if v is not None}, start=start)
    require_video(asked)
    return asked


def exr_of(given, fps, names, start=0):
    """Return the `ExrFormat` that the options ask for and the layers that frames need for all.

    `fps` is in 1/s, `names` are layers that are written by themselves, `start` is the number of the
    first frame. ParameterError if the options do not make a name, RainsimError if such files cannot
    be written.
    """
    if not given["exr"]:
        if given["frame_start"] is not None and not given["video"]:
            raise ParameterError(
                f"--frame-start {given['frame_start']} is given without --exr or --video, whose "
                "frames it numbers; give one of them, or leave it out"
            )
        return None, names
    from rainsim.io.exr import require_exr
    from rainsim.render.exr_frame import LAYERS, ExrFormat

    options = {"name": given["exr_name"], "colorspace": given["colorspace"]}
    options = {key: value for key, value in options.items() if value is not None}
    exr = ExrFormat(fps, **options, start=start, layers=names)
    require_exr()
    return exr, tuple(dict.fromkeys((*names, *LAYERS)))


class Forecast:
    """Shows the progress of a run as `Status` does, and says once what all of it will take."""

    def __init__(self, status, folder):
        self._status, self._folder = status, folder
        self._frames = None if status.quiet else StageProgress(FRAMES)
        self.say, self.notes, self.count = status.say, status.notes, status.count

    def progress(self, stage, done, total):
        """Show that `done` of `total` parts of a stage are done."""
        self._status.progress(stage, done, total)
        if stage == FRAMES and self._frames is not None:
            self._look(done, total)

    def _look(self, done, total):
        """Say what the run takes if enough frames are drawn to know."""
        self._frames.update(done, total)
        before, drawn, measured = self._frames.counts
        if total - before <= MOST_UNSAID or done == total:
            self._frames = None
        elif drawn >= DRAWN and measured >= DRAWN - 1:  # the first takes longer
            left, self._frames = self._frames.seconds_left(time.perf_counter()), None
            with suppress(OSError, RainsimError):  # no reason to end a run
                self._tell(left, done, total)

    def _tell(self, left, done, total):
        from rainsim.output_folder.claims import relative
        from rainsim.scene.info import in_bytes

        each = self._bytes_of_frames()
        sizes = {name: number * total for name, number in each.items()}
        needed = sum(each.values()) * (total - done)
        parts = ", ".join(f"{name} {in_bytes(size)}" for name, size in sizes.items())
        text = (
            f"{total} frames take about {in_words(self._status.seconds + left)} in all, until "
            f"{clock_time(time.time() + left)}, and {in_bytes(sum(sizes.values()))} of disk "
            f"({parts})"
        )
        free = shutil.disk_usage(self._folder).free
        if needed > free:
            text += (
                f"; WARNING: {in_bytes(free)} are free in {relative(self._folder)} and "
                f"{in_bytes(needed)} are still to be written; make room, or stop and give "
                "another --out"
            )
        if self._status.verbose or needed > free or left > LONG:
            self.say(text, bold=needed > free)

    def _bytes_of_frames(self):
        """Return what a frame and its layers take on average, by name."""
        from rainsim.io.journal import Journal
        from rainsim.output_folder.names import JOURNAL, OURS

        entries = Journal(self._folder, JOURNAL, OURS.fullmatch).entries()
        last = [entries[index] for index in sorted(entries)[-MEASURED:]]
        sizes = dict.fromkeys(("frames", "layers", "exr"), 0.0)
        for entry in last:
            for name in entry["files"]:
                size = (self._folder / name).stat().st_size
                sizes[name.split("/")[0]] += size / len(last)
        return {name: size for name, size in sizes.items() if size > 0}


def clock_time(seconds):
    """Return a time since the epoch [s] as the clock shows it here, with the date if not today."""
    then, now = time.localtime(seconds), time.localtime()
    return time.strftime("%H:%M" if then[:3] == now[:3] else "%Y-%m-%d %H:%M", then)
