"""A run that several processes share: each draws a range of its frames into one folder.

The processes know of each other by the folder alone. A range has one owner, which holds a claim on
it while it draws, and notes each frame that is whole in a journal of its own. The process that
finds all frames finished writes what needs the whole sequence, with the same bytes as a run in one
go. What an owner that has ended left undone is drawn by a process with --resume.
"""

import re
import shutil
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace

from rainsim.errors import InputError, ParameterError
from rainsim.io.claim import ClaimedError, claim
from rainsim.io.journal import SHARED_FOLDER
from rainsim.output_folder.facts import host_facts
from rainsim.output_folder.frames import complete_film
from rainsim.output_folder.names import read_record
from rainsim.render.frame_files import FrameWriter, facts_of, report_of

JOINING, WHOLE = "joining", "whole"  # claims: on looking who is there, and on ending the run
PATIENCE = 60.0  # s, for others that look who is there
PART = re.compile(r"(\d+)-(\d+)")  # name of a part's claim and journal: first frame, and end


class SharedRun:
    """The part of this process in a shared run.

    The folder is as `claimed` yields it. There is a camera for each frame of the whole sequence, or
    one for all; the settings' frame range is what this process owns. With `resume` it also draws
    what others have left undone of its range.
    """

    def __init__(self, folder, record, cameras, config, video=None, resume=False):
        self._run = folder, record, cameras, replace(config, frame_range=None), video
        self._folder, self._record, self._resume = folder, record, resume
        self._range, self._all = config.indices, range(config.frames)
        self._part = f"{self._range.start:05d}-{self._range.stop:05d}"
        record.share(folder, self._part)

    def draw(self, sequence, progress=None, say=None):
        """Draw the missing frames of the range; return the reports of the range's frames.

        progress(stage, done, total) is called, and say(notes) for each frame that is drawn here.

        ParameterError if the folder holds another run, or another process owns a frame of the
        range; InputError if the folder vanishes.
        """
        tell, say = progress or (lambda stage, done, total: None), say or (lambda notes: None)
        try:
            with self._owned() as missing:
                done = len(self._range) - len(missing)
                apart = len(missing) if sequence.backend == "cuda" else 0
                with FrameWriter(self._folder, self._note, apart) as writer:
                    for picture, report in sequence.frames(missing, tell):
                        say(report.notes)
                        writer.add(picture, report)
                        done += 1
                        tell("frames", done, len(self._range))
        except FileNotFoundError as error:
            raise InputError(
                f"{error.filename} is gone while frames are drawn; the output folder must stay "
                "where it is; see that its disk is there, and go on with --resume"
            ) from error
        entries = self._record.journal.entries()
        return [report_of(index, entries[index]) for index in self._range]

    def complete(self):
        """Write what needs all frames if all are there; return how many are still to be drawn."""
        left = len(set(self._all) - set(self._record.journal.entries()))
        if left == 0:
            with suppress(ClaimedError), claim(self._folder / SHARED_FOLDER / WHOLE):
                if read_record(self._folder).get("complete") is not True:
                    complete_film(*self._run)
                shutil.rmtree(self._folder / SHARED_FOLDER, ignore_errors=True)
        return left

    @contextmanager
    def _owned(self):
        """Own the range; yield the frames of it that are to be drawn."""
        self._record.require_same()
        shared = self._folder / SHARED_FOLDER
        with ExitStack() as held:
            try:
                with claim(shared / JOINING, wait=PATIENCE):
                    whole = self._record.resume(self._range)
                    missing = [index for index in self._range if index not in whole]
                    for path in sorted(shared.iterdir()):
                        self._require_free(path, missing)
                    held.enter_context(claim(shared / self._part))
                    before = read_record(self._folder)
                    if not before or (before.get("complete") and missing):
                        self._record.write(complete=False)
            except ClaimedError as error:
                raise ParameterError(
                    f"frames of {self._folder} are shared out by {error}, and that takes more than "
                    f"{PATIENCE:g} s; remove {shared / JOINING} if it has ended"
                ) from None
            yield missing

    def _require_free(self, path, missing):
        """Raise ParameterError if the part of a claim or a journal has missing frames of ours."""
        part = PART.fullmatch(path.stem)
        frames = [i for i in missing if int(part[1]) <= i < int(part[2])] if part else []
        if not frames:
            return
        owned, each = path.with_suffix(""), f"frames {frames[0]} to {frames[-1]}"
        try:
            with claim(owned):
                pass
        except ClaimedError as error:
            raise ParameterError(
                f"{each} are drawn by {error}; a frame has one owner; give a --frame-range of "
                f"other frames, or remove {owned} if that process has ended"
            ) from None
        if not self._resume:
            raise ParameterError(
                f"{each} were left undone by a process that has ended; each must be drawn; go on "
                "with --resume"
            )

    def _note(self, report, files):
        """Enter a written frame in the journal."""
        host = host_facts()
        self._record.journal.add(report.index, files, **facts_of(report), host=host)
