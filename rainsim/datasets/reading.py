"""Reads the data sets that we write in nerfstudio's layout, with numpy and a PNG reader alone."""

from pathlib import Path

import numpy as np

from rainsim.datasets.card import VERSION, VERSION_KEY
from rainsim.datasets.data_files import FOLDER, condition
from rainsim.errors import InputError, ParameterError, shown
from rainsim.io.files import read_json, require_file
from rainsim.io.images import read_image

READ_LAYOUT = "nerfstudio"
LABELS = ("class_id", "puddle_id", "actor_id", "labels")  # actors and own ids: where there are any


def stored_card(folder):
    """Return the card of a finished data set in nerfstudio's layout; else raise InputError."""
    card = read_json(Path(folder) / "card.json", "a card")
    if not isinstance(card, dict) or VERSION_KEY not in card:
        raise InputError(f"{folder}/card.json is no data set's card; name a data set's folder")
    if card[VERSION_KEY] != VERSION:
        raise InputError(
            f"{folder} is a data set of version {shown(card[VERSION_KEY])}; it must be {VERSION}; "
            "export it again"
        )
    if card["layout"] != READ_LAYOUT:
        raise InputError(
            f"{folder} has the layout {card['layout']}; only {READ_LAYOUT} is read; export again "
            f"with --layout {READ_LAYOUT}"
        )
    if not card.get("complete"):
        raise InputError(f"{folder} is unfinished; finish it with rainsim export --resume")
    return card


def pair_names(folder, rate, split="train", sensor=None):
    """Return the names of the views of a list, "train", "val" or "test", in a rain [mm/h].

    Of a rig `sensor` names the camera whose views count. Errors are those of `stored_card`;
    ParameterError if the list has no view of the sensor.
    """
    stored_card(folder)
    place = Path(folder) / condition(rate)
    files = read_json(place / "transforms.json", "cameras")[f"{split}_filenames"]
    names = [Path(file).stem for file in files]
    if sensor is None:
        return names
    own = [name for name in names if _about(place, name).get("sensor") == sensor]
    if not own:
        raise ParameterError(
            f"sensor is {shown(sensor)}; {folder} has no view of it in {split}; it must be a "
            "camera of rig.json with views there"
        )
    return own


def read_pair(folder, rate, name):
    """Return what was exported of a view in a rain [mm/h] and clear: numpy arrays by name.

    Pictures (3, height, width), float32 from 0 to 1: `rainy`, `clear`, and the partners
    `clear_air`, `no_glass` and `dry`. Labels (height, width): `depth` [m] along the view axis, 0
    where unknown, `keep` (bool), and those of LABELS, int32. `lens` is (fx, fy, cx, cy) [px],
    `camera_from_ground` (4, 4) [m], and of a rig `time` [s]. What was not exported is missing.
    """
    place, png = Path(folder) / condition(rate), f"{name}.png"
    about, beside = _about(place, name), place / FOLDER
    camera = about["camera"]
    pair = {
        "rainy": _planes(place / "images" / png),
        "clear": _planes(Path(folder) / condition(0) / "images" / png),
        "depth": read_image(place / "depths" / png).astype(np.float32) / 1000,
        "keep": read_image(place / "masks" / png) > 0,
        "lens": np.array([camera[key] for key in ("fx", "fy", "cx", "cy")], np.float32),
        "camera_from_ground": np.array(camera["camera_from_ground"], np.float32),
    }
    if "time_s" in about:
        pair["time"] = np.float32(about["time_s"])
    pair |= {kind: _planes(beside / file) for kind, file in about["partners"].items()}
    kept = (label for label in LABELS if (beside / label / png).exists())
    return pair | {label: read_image(beside / label / png).astype(np.int32) for label in kept}


def read_turn(folder, rate, lidar, number):
    """Return a turn of a rig's lidar: points (n, 3) [m], ground frame, and their labels (n,)."""
    beside = Path(folder) / condition(rate) / FOLDER
    place = require_file(beside / lidar / f"{number:06d}.bin", "points")
    points = np.fromfile(place, "<f4").reshape(-1, 4)[:, :3]
    turn = np.array(_about(beside.parent, f"{lidar}_{number:06d}")["ground_from_sensor"])
    labels = np.fromfile(require_file(place.with_suffix(".label"), "labels"), "<u4")
    return points @ turn[:3, :3].T + turn[:3, 3], labels


def _about(place, name):
    return read_json(place / FOLDER / f"{name}.json", "what lies beside a view")


def _planes(path):
    return np.ascontiguousarray(read_image(path).transpose(2, 0, 1)).astype(np.float32) / 255
