"""How much memory frames take: estimated, said and compared with what is free before it is taken.

Peaks of whole runs, version 0.1.0 on a CPU: a garden of 493,196 splats of degree 3 (116 MB) on
160,000 cells 877 MB at 648 x 420 pixels, 1206 at 2000 x 1296, 2410 at 4000 x 2593, there 3041 with
a moving camera; 1969 at 2000 x 1296 with all 24 layers; 2120 on 4,000,000 cells at 648 x 420.
"""

from __future__ import annotations

from rainsim.compiling.pool import free_memory
from rainsim.errors import ParameterError

PROGRAM = 400e6  # bytes of the program itself
PER_SPLATS = 3.5  # times their arrays: sorted copies, the mirrored world, the light's search
CELL, PIXEL, LAYER_PIXEL = 310.0, 220.0, 12.0  # bytes of one of each
SAID = 2e9  # bytes from which on a run says what it takes


def memory_of_frames(scene, camera, cells=0, layers=0):
    """Return the bytes that a run takes at its peak, an estimate.

    Parameters
    ----------
    scene : Scene
    camera : Camera
        In the frames' size.
    cells : int
        Of the height map.
    layers : int
        Number of AOVs.
    """
    arrays = (getattr(scene.splats, name) for name in scene.splats.__slots__)
    pixels = camera.width * camera.height
    splats = PER_SPLATS * sum(array.nbytes for array in arrays)
    return PROGRAM + splats + CELL * cells + (PIXEL + LAYER_PIXEL * layers) * pixels


def require_memory(scene, camera, cells=0, layers=0):
    """Return `memory_of_frames` and the free bytes (None: unknown), or raise ParameterError.

    Raises
    ------
    ParameterError
        If frames of this size do not fit; it names a width that does.
    """
    need, free = memory_of_frames(scene, camera, cells, layers), free_memory()
    if free is None or need <= free:
        return need, free
    width, height = camera.width, camera.height
    room = free - need + (PIXEL + LAYER_PIXEL * layers) * width * height
    fits = int((max(room, 0) / (PIXEL + LAYER_PIXEL * layers) * width / height) ** 0.5)
    remedy = f"lower --width, {fits} fits" if fits >= 64 else "give a larger --spacing"
    raise ParameterError(
        f"frames of {width} x {height} pixels take some {need / 1e9:.1f} GB of memory"
        f"{f' on {cells} cells' if cells else ''}; {free / 1e9:.1f} GB are free; {remedy}, or free "
        "memory"
    )


def memory_notes(scene, camera, cells, layers=0):
    """Return a list with a note on the memory that frames take, empty if that is little."""
    need, free = require_memory(scene, camera, cells, layers)
    if need < SAID:
        return []
    left = "" if free is None else f", of {free / 1e9:.1f} GB that are free"
    return [
        f"frames of {camera.width} x {camera.height} pixels on {cells} cells take some "
        f"{need / 1e9:.1f} GB of memory{left}"
    ]
