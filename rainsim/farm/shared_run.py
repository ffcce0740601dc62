"""A run that several processes share: each draws a range of its frames into one folder.

The processes know of each other by the folder alone. Each frame is claimed before it is drawn
(`rainsim.io.part_claims`) and noted in a journal when it is whole; the process that finds all
frames finished writes what needs the whole sequence, with the same bytes as a run in one go.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import tempfile
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rainsim.errors import InputError, ParameterError
from rainsim.io.claim import ClaimedError, claim
from rainsim.io.journal import SHARED_FOLDER
from rainsim.io.part_claims import STALE, PartClaims, create
from rainsim.output_folder import (
    CLAIM,
    FRAME_FACTS,
    FrameFolder,
    host_facts,
    read_record,
    require_no_file,
)
from rainsim.render.frame_files import FrameWriter, facts_of, report_of

RUN = "run"  # file of the shared folder: the fingerprint of the run that the processes are at
WHOLE = "whole"  # the part that is made from all frames
BLOCK_TIME, MOST_IN_BLOCK = 1.0, 16  # s that the frames take that are claimed at once, and how many
MOST_WAIT = 1.0  # s between looks at what the others do


@contextmanager
def joined(path):
    """Make an output folder, or join the processes that write to it, and yield it.

    ParameterError if it is no folder, or a run that does not share it writes to it; OSError if it
    cannot be made or written to.
    """
    path = Path(path)
    require_no_file(path)
    made = not path.exists()
    try:
        with claim(path / CLAIM, shared=True):
            tempfile.TemporaryFile(dir=path).close()  # before hours of work, not after
            yield path
    except ClaimedError as error:
        raise ParameterError(
            f"a run without --frame-range writes to output folder {path} ({error}); it shares the "
            f"folder with none; wait for its end, or remove {path / CLAIM} if it has ended"
        ) from None
    finally:
        if made and path.is_dir() and not any(path.iterdir()):
            path.rmdir()


class SharedRun:
    """The part of this process in a shared run.

    `folder` is as `joined` yields it. There is a camera for each frame of the whole sequence, or
    one for all; the settings' frame range is what this process cares for. The claim of another
    process is taken over from an age of `stale` [s] on, see `PartClaims`. ParameterError if the
    folder holds something else than a run with the same fingerprint.
    """

    def __init__(self, folder, record, cameras, config, video=None, stale=STALE):
        self.folder, self.record, self._video = folder, record, video
        self._cameras, self._range = cameras, config.indices
        self._wanted = list(self._range)  # and frames of others that turn out to be damaged
        self._config = replace(config, frame_range=None)
        self._shared, self._stale = folder / SHARED_FOLDER, stale
        node = re.sub(r"[^\w-]", "-", platform.node())
        record.share(f"{node}-{os.getpid()}-{os.urandom(4).hex()}")
        whole = record.resume(self._wanted)
        self._join()
        # What the journals say of frames that are damaged or gone: they are drawn again.
        self._bad = {i: e for i, e in self._entries().items()
                     if i in self._wanted and i not in whole}  # fmt: skip
        if not read_record(folder) or (self._is_complete and self._missing(self._wanted)):
            record.write(complete=False)
        self._rejoined = self._is_complete

    def _join(self):
        """Be the first process of the run, or one more of the same."""
        self._shared.mkdir(exist_ok=True)
        ours, deadline = self.record.fingerprint, time.monotonic() + MOST_WAIT
        if create(self._shared / RUN, ours):
            return
        theirs = (self._shared / RUN).read_text(encoding="utf-8")
        while len(theirs) < len(ours) and time.monotonic() < deadline:  # it is being written
            time.sleep(MOST_WAIT / 20)
            theirs = (self._shared / RUN).read_text(encoding="utf-8")
        if theirs != ours:
            raise self.record.was_another()

    def draw(self, sequence, progress=None, say=None):
        """Draw the missing frames of the range until all of it is finished, here or elsewhere.

        progress(stage, done, total) is called, and say(notes) for each frame that is drawn here.
        Return the reports of the range's frames.
        """
        tell = progress or (lambda stage, done, total: None)
        try:
            with PartClaims(self._shared, self._stale) as claims:
                self._draw_all(claims, sequence, tell, say or (lambda notes: None))
        except FileNotFoundError as error:
            if not self._is_complete:  # else another process has ended the run and tidied up
                raise InputError(
                    f"{error.filename} is gone while frames are drawn; the output folder must stay "
                    "where it is; see that its disk is there, and run the same command again"
                ) from error
        entries = self._entries()
        return [report_of(i, entries[i]) for i in self._range if i in entries]

    def _draw_all(self, claims, sequence, tell, say):
        seconds = BLOCK_TIME
        with FrameWriter(self.folder, lambda *frame: self._note(claims, *frame)) as writer:
            while True:
                count = min(max(round(BLOCK_TIME / seconds), 1), MOST_IN_BLOCK)
                block, begun = self._claimed(claims, sequence.next, count), time.perf_counter()
                for picture, report in sequence.frames(block, tell):
                    say(report.notes)
                    writer.add(picture, report)
                    self._say_progress(tell)
                if block:
                    seconds = (time.perf_counter() - begun) / len(block)
                    continue
                writer.wait()
                self._say_progress(tell)
                if self._missing(self._wanted):
                    time.sleep(min(MOST_WAIT, self._stale / 10))  # others are at them
                elif self._is_ended(claims):
                    return

    @property
    def left(self):
        """How many frames of the whole sequence are not finished."""
        return 0 if self._is_complete else len(self._missing(self._config.indices))

    def _say_progress(self, tell):
        tell("frames", len(self._wanted) - len(self._missing(self._wanted)), len(self._wanted))

    def _claimed(self, claims, position, count):
        """Claim missing frames that follow one another, the first from `position` on; list them."""
        missing = self._missing(self._wanted)
        ahead, behind = ([i for i in missing if (i >= position) == side] for side in (True, False))
        for candidates in (ahead, behind):
            block = []
            for index in candidates:
                if len(block) == count or (block and index - block[0] >= MOST_IN_BLOCK):
                    break
                if claims.take(f"{index:05d}"):
                    block.append(index)
            missing = self._missing(block)  # what its last holder finished is not drawn twice
            for index in set(block) - set(missing):
                claims.finish(f"{index:05d}")
            if missing:
                return missing
        return []

    def _note(self, claims, report, names):
        """Enter a written frame in the journal and end the claim on it."""
        host = host_facts()
        self.record.journal.add(report.index, names, **facts_of(report), host=host)
        self._bad.pop(report.index, None)
        claims.finish(f"{report.index:05d}")

    def _entries(self):
        """Return the journals' entries of frames by index."""
        entries = self.record.journal.entries()
        return {i: e for i, e in entries.items() if all(name in e for name in FRAME_FACTS)}

    def _missing(self, indices):
        """Return those of some frames that are not finished."""
        if not indices:
            return []
        entries = self._entries()
        return [i for i in indices if entries.get(i) in (None, self._bad.get(i))]

    @property
    def _is_complete(self):
        return read_record(self.folder).get("complete") is True

    def _is_ended(self, claims):
        """Whether this process may leave; ends the run if this process finished its last frame."""
        if self._missing(self._config.indices):
            return True  # who draws the others ends it
        if not self._rejoined and self._is_complete:
            return True
        if not claims.take(WHOLE):
            if not self._is_complete:
                time.sleep(min(MOST_WAIT, self._stale / 10))
            return self._is_complete
        if not self._is_complete and not self._write_whole():
            claims.give_up(WHOLE)
            return False
        self.record.journal.gather()
        claims.finish(WHOLE)
        shutil.rmtree(self._shared, ignore_errors=True)
        return True

    def _write_whole(self):
        """Write the files that need all frames; return False if some frames are damaged."""
        arguments = self.folder, self.record, self._cameras, self._config, self._video
        film = FrameFolder(*arguments, resume=True)
        damaged = [i for i in self._config.indices if i not in film.kept]
        if damaged:
            entries = self._entries()
            self._bad |= {i: entries[i] for i in damaged}
            self._wanted = sorted({*self._wanted, *damaged})
            return False
        with film:
            pass  # it takes over all frames on the way out
        return True
