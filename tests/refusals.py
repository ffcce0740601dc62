"""Errors of damaged files: one clear line each, and memory in proportion."""

import tracemalloc

import pytest

from rainsim.errors import InputError
from rainsim.scene.formats import read as read_splats


def one_clear_line(error):
    text = str(error)
    assert "\n" not in text and len(text) < 700 and text.count(";") >= 1, text


def refused_within(limit, path, read=read_splats):
    """The message of the error that reading ends in, with the peak of memory checked."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < limit
    one_clear_line(caught.value)
    return str(caught.value)
