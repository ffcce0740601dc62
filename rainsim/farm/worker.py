"""A worker of a farm: reports its facts, takes a job, draws chunks of frames of it."""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

from rainsim import __version__
from rainsim.io import cache
from rainsim.io.fingerprint import sources, versions
from rainsim.output_folder import host_facts
from rainsim.render.frame_files import FrameWriter, facts_of

_SEQUENCES = {}  # what this process draws, by the job's name; one at a time


def facts():
    """Return the facts that decide whether this process draws the same bytes, as plain values."""
    from rainsim.jit import processor

    return {
        "version": __version__, "sources": sources(), "libraries": versions(),
        "processor": processor(), "host": platform.node(), "cores": os.cpu_count(),
    }  # fmt: skip


def sees(path, text):
    """Whether this process finds a file with a text, and may write beside it."""
    with suppress(OSError):
        if Path(path).read_text(encoding="utf-8") == text:
            tempfile.TemporaryFile(dir=Path(path).parent).close()
            return True
    return False


def known_hashes(scene):
    """Return the hashes that are known of a scene's splats, by the names of their arrays."""
    arrays = {field.name: getattr(scene.splats, field.name) for field in fields(scene.splats)}
    known = {name: cache.known_hash(array) for name, array in arrays.items()}
    return {name: digest for name, digest in known.items() if digest}


def take_job(name, sequence, hashes):
    """Keep the `FrameSequence` of a job, in place of earlier ones.

    By the `known_hashes` of its scene this process finds results that another kept.
    """
    for array, digest in hashes.items():
        cache.take_hash(getattr(sequence.scene.splats, array), digest)
    _SEQUENCES.clear()
    _SEQUENCES[name] = sequence
    return True


def draw_chunk(name, indices, folder=None, threads=None, states=None):
    """Draw frames of a job that follow one another.

    `name` is as `take_job` had it. The frames' files go to a folder; without one they are sent
    back. `states` has the water of the frames; without it the water is simulated here. Return for
    each frame its `index`, the names of its `files` with their SHA-256, what the journal notes of
    it as `facts`, and the files' `bytes` by name if they are sent back; None if the job is not
    here: the worker was started again.
    """
    from rainsim.jit import set_threads

    if name not in _SEQUENCES:
        return None
    set_threads(threads)
    sequence = _SEQUENCES[name]
    if states is not None:
        sequence.states = states.__getitem__
    with tempfile.TemporaryDirectory(prefix="rainsim-") as own:
        where, done = Path(folder or own), []

        def note(report, names):
            content = {name: (where / name).read_bytes() for name in names}
            frame = {
                "index": report.index,
                "files": {name: hashlib.sha256(c).hexdigest() for name, c in content.items()},
                "facts": {**facts_of(report), "host": host_facts()},
            }
            done.append(frame if folder else {**frame, "bytes": content})

        with FrameWriter(where, note) as writer:
            for picture, report in sequence.frames(indices):
                writer.add(picture, report)
    return done
