"""Says when a camera is under water or underground: the picture is then black or inside out."""

import numpy as np

from rainsim.water.puddles import low_ground


def sunken_notes(path, terrain, config):
    """Return notes on the cameras of frames that are under water or below the ground.

    path : sequence of Camera. One per frame, or one for all, in the ground frame.
    Returns list of str
    """
    eyes = np.array([camera.position for camera in path])
    frames = np.array(config.indices) if len(path) > 1 else np.zeros(1, int)
    if len(path) > 1:
        eyes = eyes[frames]
    row, column, inside = terrain.grid.cells(eyes[:, 0], eyes[:, 1])
    ground = np.where(inside, terrain.bed[row, column], -np.inf)
    water = np.where(inside, ground + terrain.water[row, column], -np.inf)
    flood = _flood(config, frames / config.fps)
    if flood is not None:
        water = np.maximum(water, low_ground(terrain) + flood)
    below = ground - eyes[:, 2]
    drowned = np.where((below <= 0) & (water > ground), water - eyes[:, 2], 0.0)
    remedy = "raise it with --eye and --look-at, take another --camera"
    return [
        *_note(path, frames, below, "below the ground", f"{remedy}, or check the scale and --up"),
        *_note(path, frames, drowned, "under water", f"{remedy}, or lower --water-level"),
    ]


def _flood(config, times):
    """Return the level of still water over the low ground at some times [m]; None without one."""
    keys = config.key_times()
    levels = [config.at(time).water.level for time in keys]
    if any(level is None for level in levels):
        return None
    return np.interp(times, keys, levels)


def _note(path, frames, depth, where, remedy):
    """Yield the note on the frames whose cameras lie deep."""
    deep = np.flatnonzero(depth > 0)
    if not len(deep):
        return
    worst = deep[np.argmax(depth[deep])]
    name = path[frames[worst] if len(path) > 1 else 0].name
    which = f"camera {name}" if len(path) == 1 else f"the camera of {len(deep)} frames"
    yield (
        f"WARNING: {which} is up to {depth[worst]:.2f} m {where}: what it sees is not drawn "
        f"rightly; {remedy}"
    )
