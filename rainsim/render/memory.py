"""Memory of pictures and states: estimated and compared with the free memory beforehand.

Peaks of whole runs, version 0.1.0 on a CPU: a garden of 493,196 splats of degree 3 (116 MB) on
160,000 cells 877 MB at 648 x 420 pixels, 1206 at 2000 x 1296, 2410 at 4000 x 2593, there 3041 with
a moving camera; 1969 at 2000 x 1296 with all 24 layers; 2120 on 4,000,000 cells at 648 x 420.
Its dry capture (`rainsim splat`) 435 MB at 648 x 420, 933 at 4000 x 2593, there 1247 as arrays, and
2800 at 8000 x 5186. Simulated water 229 MB on 160,000 cells, 1014 on 4,000,000.

On a GPU, by its allocations: 199 bytes a splat of degree 0, 166 a cell, 115 a pixel, 28 MB for the
rest; measured 1.4 GB for eight gardens at 1297 x 840 on 1,048,576 cells, and for the wet-ground
mirror at that size another 0.2 GB. That is without levels of detail.
"""

from typing import NamedTuple

from rainsim.compiling.pool import free_memory
from rainsim.errors import ParameterError

PROGRAM = 400e6  # bytes of the program itself with all that draws
# Times the splats' arrays: sorted copies, the mirrored world, the light's search (3.5), levels of
# detail (1.2; 1.1 for a garden and for one of 3.9 M splats).
PER_SPLATS = 4.7
CELL, PIXEL, LAYER_PIXEL = 310.0, 220.0, 12.0  # bytes of one of each
EXR_LAYERS, SUMS_LAYERS = 18, 17  # what takes as much as so many layers: see `layers_held`
DRY_PROGRAM, DRY_PER_SPLATS, DRY_PIXEL, ARRAYS_PIXEL = 200e6, 2.0, 62.0, 32.0  # the dry capture
WATER_PROGRAM, WATER_CELL = 220e6, 220.0  # simulated states
DEVICE_REST, DEVICE_SPLAT, DEVICE_HARMONIC = 100e6, 190.0, 2.0  # on a GPU, a harmonic in 16 bits
DEVICE_LEVELS = 2.6  # splats with their levels of detail, over splats: 2.1 to 2.6 measured
DEVICE_CELL, DEVICE_PIXEL = 170.0, 320.0
DEVICE_PAGES = 5.0  # times what chunks may take: their room, and splats as pictures project them
SAID = 2e9  # bytes from which on a run says what it takes
COARSER, FEWER = "give a larger --spacing", "take a capture of fewer splats"
LESS = "give less --memory"
LEAST_WIDTH = 64  # px: a smaller one is no remedy


class Need(NamedTuple):
    """An estimate of memory that is going to be taken.

    what : str. What takes it, for messages.
    bytes : float. At the peak, an estimate.
    pixel : float. Bytes of them for a pixel.
    where : str. For messages: "" in the machine's own memory.
    """

    what: str
    bytes: float
    pixel: float = 0.0
    where: str = ""


def layers_held(names, exr=None, optics=None):
    """Return the number of layers that `memory_of_frames` counts for these, int.

    The parts of an OpenEXR file and its writing take as much as 18, and their sums over samples of
    the shutter as 17: garden and bicycle, 1920 x 1280 and 3840 x 2160, with a moving camera.
    """
    held = len(names) + (EXR_LAYERS if exr else 0)
    return held + (SUMS_LAYERS if exr and optics and optics.samples > 1 else 0)


def memory_of_frames(scene, camera, cells=0, layers=0):
    """Return the bytes that a run takes at its peak, an estimate.

    camera : Camera. In the frames' size.
    cells : int. Of the height map.
    layers : int. Number of AOVs.
    """
    every = (scene.splats, *(actor.splats for actor in scene.actors))
    splats = PER_SPLATS * sum(map(_bytes_of, every)) + _bytes_of_pages(scene)
    pixel = PIXEL + LAYER_PIXEL * layers
    return PROGRAM + splats + CELL * cells + pixel * camera.width * camera.height


def device_memory_of_frames(splats, camera, cells=0, levels=DEVICE_LEVELS):
    """Return the bytes of a GPU's memory that frames take, an estimate.

    `levels`: times the splats, for their levels of detail.
    """
    pixels = DEVICE_PIXEL * camera.width * camera.height
    held = DEVICE_SPLAT * len(splats) + DEVICE_HARMONIC * splats.sh.size
    return DEVICE_REST + levels * held + DEVICE_CELL * cells + pixels


def require_memory(scene, camera, cells=0, layers=0, device_free=None):
    """Raise ParameterError if frames of this size do not fit; it names a width that does.

    scene, camera, cells, layers. As `memory_of_frames` takes them.
    device_free : int, optional. Free bytes of the GPU that draws; without it the
        CPU draws.
    Returns need : Need
        free : int or None. Bytes; None if unknown.
    """
    what = _pictures("frames", camera) + (f" on {cells} cells" if cells else "")
    if device_free is None:
        pixel = PIXEL + LAYER_PIXEL * layers
        need = Need(what, memory_of_frames(scene, camera, cells, layers), pixel)
        return need, _require(need, free_memory(), camera, COARSER)
    pages = DEVICE_PAGES * _bytes_of_pages(scene)
    return _require_on_device(what, scene.splats, camera, cells, device_free, pages=pages)


def require_memory_of_dry(splats, camera, arrays=False, device_free=None):
    """Raise ParameterError if a picture of the dry capture does not fit; list a note if it is much.

    arrays : bool. Whether all layers are written, as `rainsim splat --out
        FILE.npz` does.
    device_free : int, optional. Free bytes of the GPU that draws.
    """
    what, pixel = _pictures("a picture", camera), DRY_PIXEL + (ARRAYS_PIXEL if arrays else 0.0)
    if device_free is not None:
        _require_on_device(what, splats, camera, 0, device_free, levels=1.0)
    size = DRY_PROGRAM + DRY_PER_SPLATS * _bytes_of(splats) + pixel * camera.width * camera.height
    need = Need(what, size, pixel)
    return _notes(need, _require(need, free_memory(), camera, FEWER))


def require_memory_of_picture(camera, device_free=None):
    """Raise ParameterError if one more picture does not fit, where scene and light are in memory.

    The parameters are those of `require_memory`.
    """
    pixel, where = (PIXEL, "") if device_free is None else (DEVICE_PIXEL, " of the GPU")
    size = pixel * camera.width * camera.height
    free = free_memory() if device_free is None else device_free
    _require(Need(_pictures("a picture", camera), size, pixel, where), free, camera, FEWER)


def require_memory_of_water(cells):
    """Raise ParameterError if simulated states of a map do not fit; list a note if it is much.

    cells : int. Of the height map.
    """
    need = Need(f"water on {cells} cells", WATER_PROGRAM + WATER_CELL * cells)
    return _notes(need, _require(need, free_memory(), None, COARSER))


def memory_notes(scene, camera, cells, layers=0, device_free=None):
    """Return a list with a note on the memory that frames take, empty if that is little."""
    return _notes(*require_memory(scene, camera, cells, layers, device_free))


def _require_on_device(what, splats, camera, cells, free, levels=DEVICE_LEVELS, pages=0.0):
    size = pages + device_memory_of_frames(splats, camera, cells, levels)
    need = Need(what, size, DEVICE_PIXEL, " of the GPU")
    otherwise = LESS if 2 * pages > size else COARSER if cells else FEWER
    return need, _require(need, free, camera, otherwise)


def _bytes_of_pages(scene):
    """Return the bytes that the chunks of a scene may take beside its splats."""
    return 0.0 if scene.pages is None else scene.pages.memory


def _bytes_of(splats):
    return sum(getattr(splats, name).nbytes for name in splats.__slots__)


def _pictures(what, camera):
    return f"{what} of {camera.width} x {camera.height} pixels"


def _said(need):
    verb = "take" if need.what.startswith("frames") else "takes"
    return f"{need.what} {verb} some {need.bytes / 1e9:.1f} GB of memory{need.where}"


def _require(need, free, camera, otherwise):
    """Return the free bytes, or raise ParameterError that names a width that fits, or `otherwise`.

    `camera` is None where no picture is drawn.
    """
    if free is None or need.bytes <= free:
        return free
    fits = 0
    if camera is not None:
        room = max(free - need.bytes + need.pixel * camera.width * camera.height, 0)
        fits = int((room / need.pixel * camera.width / camera.height) ** 0.5)
    remedy = f"lower --width, {fits} fits" if fits >= LEAST_WIDTH else otherwise
    raise ParameterError(f"{_said(need)}; {free / 1e9:.1f} GB are free; {remedy}, or free memory")


def _notes(need, free):
    if need.bytes < SAID:
        return []
    return [_said(need) + ("" if free is None else f", of {free / 1e9:.1f} GB that are free")]
