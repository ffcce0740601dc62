"""Views and points of a data set in nerfstudio's layout, as trainers take them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rainsim.datasets.data_files import FOLDER, condition
from rainsim.datasets.reading import stored_card
from rainsim.errors import InputError, ParameterError
from rainsim.io.files import read_json, require_file
from rainsim.io.images import read_image
from rainsim.scene.cameras import cameras_from_data

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


def read_views(folder, rate, partner=None):
    """Return the views of one rain of a data set, `StoredView`s in their order.

    `rainsim export --layout nerfstudio` wrote the folder; a rate [mm/h] of 0 gives the clear
    pictures, a `partner` of `sample.PARTNERS` those of the rain's partner, with the rain's labels.
    InputError if the folder holds no finished data set of this layout, or a file is damaged;
    ParameterError if the data set has no such rain or partner.
    """
    card = stored_card(folder)
    rates = [rain["rain_mm_per_hour"] for rain in card["rains"]]
    if rate not in rates:
        known = ", ".join(f"{r:g}" for r in rates)
        raise ParameterError(f"the rain is {rate:g} mm/h; {folder} has {known}; take one of them")
    place, pictures = Path(folder) / condition(rate), "images"
    data = read_json(place / "transforms.json", "a camera file")
    cameras = cameras_from_data(data, place / "transforms.json")
    if partner is not None:
        if rate == 0 or partner not in card.get("partners", ()):
            raise ParameterError(
                f"{folder} has no partner {partner} at {rate:g} mm/h; partners are of rainy "
                "pictures; export it again with --partners"
            )
        pictures = f"{FOLDER}/{partner}"
    return [
        _view(place, pictures, frame, camera, frame["file_path"] not in data["train_filenames"])
        for frame, camera in zip(data["frames"], cameras, strict=True)
    ]


def _view(place, pictures, frame, camera, held_out):
    picture = read_image(place / pictures / Path(frame["file_path"]).name)
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
