"""The frames of a run, written one by one with cameras, preview, video and record."""

from contextlib import ExitStack

from rainsim.errors import RainsimError
from rainsim.output_folder.facts import host_facts
from rainsim.output_folder.names import JOURNAL
from rainsim.render.frame_files import FRAME, FrameWriter, facts_of, mean_milliseconds, report_of


class FrameFolder:
    """Writes frames one by one as DIR/frames/NNNNN.png, with cameras, preview, video and record.

    Use as a context manager around the loop over frames: if the loop is interrupted, finished
    frames are kept and recorded. Nothing in the folder changes before the first frame. Frames are
    written while the next ones are drawn. A frame and its layers are noted in the journal when they
    are whole.

    The folder is as `claimed` yields it. There is a camera for each frame of the whole sequence, or
    one for all. `resume` goes on with an unfinished run in the folder: `kept` has the journal's
    entries of the frames that need not be drawn, by index. With `apart` processes encode pictures,
    unless there is a video.
    """

    def __init__(self, folder, record, cameras, config, video=None, resume=False, apart=False):
        from rainsim.io import images

        self._image, self.folder, self.record = images, folder, record
        self._cameras, self._config = cameras, config
        self.kept = record.resume(config.indices) if resume else {}
        self._preview = images.Preview(len(config.indices), config.fps)
        self._stack, self._video = ExitStack(), None
        self._format = video
        missing = len(config.indices) - len(self.kept)
        self._writer = FrameWriter(folder, self._note, missing if apart and not video else 0)
        self._has_begun, self.reports, self._handed = False, [], 0

    def __enter__(self):
        return self

    def add(self, picture, report):
        """Begin to write the next frame.

        OSError if this frame's layers or a frame before could not be written.
        """
        self._begin()
        self._keep_until(report.index)
        self._writer.add(picture, report, self._show)
        self._handed += 1

    @property
    def done(self):
        """Number of frames that were kept or handed over."""
        return len(self.kept) + self._handed

    def _show(self, picture):
        """Add a frame to preview and video."""
        self._preview.add(picture)
        if self._video is not None:
            self._video.add(picture)

    def _note(self, report, files):
        """Enter a written frame in the record and its journal."""
        self.record.add(JOURNAL, *files)
        self.record.journal.add(report.index, files, **facts_of(report), host=host_facts())
        self.reports.append(report)

    def _keep_until(self, end):
        """Take over the finished frames of an earlier run up to the frame `end`."""
        indices = [index for index in sorted(self.kept) if index < end]
        if indices:
            self._writer.wait()  # preview and video take frames in order
        for index in indices:
            entry = self.kept.pop(index)
            self._handed += 1
            self._show(self._image.read_image(self.folder / FRAME.format(index)))
            self.record.add(JOURNAL, *entry["files"])
            self.reports.append(report_of(index, entry))

    def _begin(self):
        from rainsim.io.video import VideoWriter
        from rainsim.scene.cameras import write_transforms
        from rainsim.scene.origin import NOWHERE, moved

        if self._has_begun:
            return
        self._has_begun = True
        self.record.begin()
        count = self._config.frames
        cameras = list(self._cameras) if len(self._cameras) > 1 else [self._cameras[0]] * count
        names = [FRAME.format(i) for i in range(count)]
        lens = self.record.facts.get("optics", {}).get("lens")
        origin = (self.record.facts.get("input") or {}).get("origin", NOWHERE)
        if any(origin):  # the capture's own coordinates
            cameras = moved(cameras, origin)
        write_transforms(self.folder / "transforms.json", cameras[:count], names, lens)
        self.record.add("transforms.json")
        if self._format:
            path = self.folder / self._format.name
            writer = VideoWriter(path, self._config.fps, self._format)
            self._video = self._stack.enter_context(writer)

    def __exit__(self, kind, *exception):
        try:
            with self._writer:
                pass
            if kind is None and self.kept:
                self._begin()
                self._keep_until(self._config.frames)
        finally:
            self._stack.close()
            self._finish(kind is None)

    def _finish(self, undisturbed):
        """Write the preview and the record of the written frames."""
        if not self.reports:
            return
        self._preview.write(self.folder / "preview.webp")
        self.record.add("preview.webp", *([self._format.name] if self._video else []))
        self.record.write(
            complete=undisturbed and len(self.reports) == len(self._config.indices),
            frames=[report.index for report in self.reports],
            milliseconds=mean_milliseconds(self.reports),
            ledger=self.reports[-1].ledger,
            notes=list(dict.fromkeys(note for r in self.reports for note in r.notes)),
        )


def complete_film(folder, record, cameras, config, video=None):
    """Write what needs the whole sequence from frames that are all there; return their reports."""
    film = FrameFolder(folder, record, cameras, config, video, resume=True)
    lost = [index for index in config.indices if index not in film.kept]
    if lost:
        raise RainsimError(
            f"{len(lost)} frames in {folder} were damaged after they were drawn, the first is "
            f"{lost[0]}; they must stay as they are; go on with --resume"
        )
    with film:
        pass  # it takes over all frames on the way out
    return film.reports
