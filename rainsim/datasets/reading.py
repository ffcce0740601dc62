"""Reads the data sets that we write in nerfstudio's layout, with numpy and a PNG reader alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rainsim.datasets.card import VERSION, VERSION_KEY
from rainsim.datasets.data_files import FOLDER, condition
from rainsim.errors import InputError, ParameterError, shown
from rainsim.io.files import read_json, require_file
from rainsim.io.images import read_image
from rainsim.scene.cameras import cameras_from_data

READ_LAYOUT = "nerfstudio"
HEADER_END = b"end_header\n"


@dataclass(frozen=True)
class StoredView:
    """A picture of a data set with its camera and the labels that trainers use.

    Arrays have the picture's height and width.
    """

    name: str
    picture: np.ndarray  # (height, width, 3), uint8
    depth: np.ndarray  # float32, m, along the view axis; infinite where the file has none
    keep: np.ndarray  # bool, shows the scene: neither drops, splashes nor water spoil it
    class_id: np.ndarray  # uint8, the card's `classes` names them
    camera: object  # in the ground frame, in metres
    held_out: bool  # to test or to validate, not to train on


def read_views(folder, rate):
    """Return the views of one rain of a data set, `StoredView`s in their order.

    `rainsim export --layout nerfstudio` wrote the folder; a rate [mm/h] of 0 gives the clear
    pictures. InputError if the folder holds no finished data set of this layout, or a file is
    damaged; ParameterError if the data set has no such rain.
    """
    card = stored_card(folder)
    rates = [rain["rain_mm_per_hour"] for rain in card["rains"]]
    if rate not in rates:
        known = ", ".join(f"{r:g}" for r in rates)
        raise ParameterError(f"the rain is {rate:g} mm/h; {folder} has {known}; take one of them")
    place = Path(folder) / condition(rate)
    data = read_json(place / "transforms.json", "a camera file")
    cameras = cameras_from_data(data, place / "transforms.json")
    return [
        _view(place, frame, camera, frame["file_path"] not in data["train_filenames"])
        for frame, camera in zip(data["frames"], cameras, strict=True)
    ]


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


def _view(place, frame, camera, held_out):
    picture = read_image(place / frame["file_path"])
    depth = read_image(place / frame["depth_file_path"])
    keep = read_image(place / frame["mask_path"])
    name = Path(frame["file_path"]).stem
    class_id = read_image(place / FOLDER / "class_id" / f"{name}.png")
    shape = camera.height, camera.width
    for kind, found, wanted in (("picture", picture, (*shape, 3)), ("depth", depth, shape),
                                ("mask", keep, shape), ("class ids", class_id, shape)):  # fmt: skip
        if found.shape != wanted:
            raise InputError(
                f"the {kind} of {frame['file_path']} in {place} has the shape {found.shape}; by "
                f"its camera it must have {wanted}; export again"
            )
    metres = np.where(depth > 0, depth.astype(np.float32) / 1000, np.float32(np.inf))
    return StoredView(name, picture, metres, keep > 0, class_id, camera, held_out)


def read_points(folder, rate=0.0):
    """Return places (n, 3), float32 [m], ground frame, and colours (n, 3), uint8, of a rain."""
    path = Path(folder) / condition(rate) / "points.ply"
    header, _, body = require_file(path, "points").read_bytes().partition(HEADER_END)
    kind = np.dtype([("place", "<f4", 3), ("color", "u1", 3)])
    rows = np.frombuffer(body, kind, len(body) // kind.itemsize)
    if f"element vertex {len(rows)}\n".encode() not in header:
        raise InputError(f"{path} does not hold as many points as it says; export again")
    return rows["place"].copy(), rows["color"].copy()
