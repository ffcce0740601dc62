"""The size of the pictures of a transforms.json that gives an angle of view alone.

Files of NeRF's synthetic scenes do: their reader measured the pictures.
"""

from rainsim.errors import InputError

NERF_SIDE = 800  # px, of the pictures of NeRF's synthetic scenes


def with_size(data, path):
    """Return the data of a transforms.json with its pictures' size, and notes on that size."""
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or data.get("camera_angle_x") is None:
        return data, []
    entries = [data, *(frame for frame in frames if isinstance(frame, dict))]
    if any(entry.get(side) is not None for entry in entries for side in ("w", "h")):
        return data, []
    for frame in entries[1:]:
        size = _size_of_picture(frame.get("file_path"), path.parent)
        if size is not None:
            return {**data, "w": size[0], "h": size[1]}, []
    side = NERF_SIDE
    note = (
        f"size of the cameras' pictures ASSUMED: {side} x {side} pixels, as of NeRF's synthetic "
        f"scenes; put w and h into {path.name}, or the pictures beside it"
    )
    return {**data, "w": side, "h": side}, [note]


def _size_of_picture(name, folder):
    """Return width and height of the picture that a frame names, None without one."""
    from rainsim.io.images import picture_size  # brings imageio, which few captures need

    if not isinstance(name, str) or not name.isprintable():
        return None
    for suffix in ("", ".png", ".jpg"):
        try:
            return picture_size(folder / f"{name}{suffix}")
        except InputError:
            continue
    return None
