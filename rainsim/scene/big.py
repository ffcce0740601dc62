"""Captures in chunks (Streamed SOG) as scenes: the pages, and the whole as a coarse level."""

from dataclasses import fields
from pathlib import Path

from rainsim.errors import ParameterError
from rainsim.io import cache
from rainsim.scene.formats.streamed import LOD_META, read_tree
from rainsim.scene.pages import Pages


def require_home(scene, folder):
    """Raise ParameterError if a scene in chunks is to be written to another folder than theirs."""
    home = scene.pages.tree.folder
    if home.resolve() != folder.resolve():
        raise ParameterError(
            f"{scene.name} is in chunks, which stay where they are: its scene file can be written "
            f"to {home} only; leave rainsim import out and run it"
        )


def open_pages(path):
    """Return the `Pages` of a lod-meta.json, the whole as coarse `Splats`, their hash and notes."""
    path = Path(path)
    tree = read_tree(path if path.name == LOD_META else path / LOD_META)
    pages, digest = Pages(tree), tree.fingerprint()
    splats, level = pages.overview()
    for field in fields(splats):
        cache.know_hash(getattr(splats, field.name), "overview", digest, field.name)
    note = (
        f"{pages.count} splats in {len(tree.names)} chunks of {tree.levels} levels; set up by "
        f"level {level}, {len(splats)} splats"
    )
    return pages, splats, digest, (note,)
