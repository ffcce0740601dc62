"""Files of a data set: each is written whole, by the kind that a layout names."""

import io
import json
import shutil
from dataclasses import dataclass
from typing import Any

import numpy as np

from rainsim.errors import ParameterError
from rainsim.io import images
from rainsim.io.files import replacing

PNG, PNG16, PNG48, NPY, JSON, TEXT, BYTES = range(7)
FOLDER = "rainsim"  # in the folder of each rain, with what a layout cannot hold


@dataclass(frozen=True)
class DataFile:
    """A file to be written; kinds are PNG (uint8), PNG16 (grey), PNG48 (colour) and more."""

    name: str  # relative to the data set's folder
    kind: int
    content: Any  # ndarray, dict, list, str or bytes


def condition(rate):
    """Return the folder of a rain in a data set: clear, or rain/10mm as rain-rendering names it."""
    return f"rain/{rate:g}mm" if rate > 0 else "clear"


def write_files(folder, files):
    """Write `DataFile`s of the same content below a folder: it is packed once."""
    write_file(folder, files[0])
    for file in files[1:]:
        path = folder / file.name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            shutil.copyfile(folder / files[0].name, temporary)


def write_file(folder, file):
    """Write a `DataFile` below a folder and return its name."""
    path = folder / file.name
    path.parent.mkdir(parents=True, exist_ok=True)
    if file.kind == PNG:
        images.write_png(path, file.content)
    elif file.kind == PNG16:
        images.write_png16(path, file.content)
    elif file.kind == PNG48:
        images.write_png48(path, file.content)
    else:
        with replacing(path) as temporary:
            temporary.write_bytes(_bytes_of(file))
    return file.name


def _bytes_of(file):
    if file.kind == NPY:
        buffer = io.BytesIO()
        np.save(buffer, file.content)
        return buffer.getvalue()
    if file.kind == JSON:
        return (json.dumps(file.content, indent=1, allow_nan=False) + "\n").encode()
    if file.kind == TEXT:
        return file.content.encode()
    if file.kind == BYTES:
        return file.content
    raise ParameterError(f"file {file.name} has the kind {file.kind}; it must be one of the seven")
