"""Reads the data sets that we write in nerfstudio's layout, with numpy and a PNG reader alone."""

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
LABELS = ("class_id", "puddle_id", "actor_id", "labels")  # actors and own ids: where there are any


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


def pair_names(folder, rate, split="train", sensor=None):
    """Return the names of the views of a list, "train", "val" or "test", in a rain [mm/h].

    Of a rig `sensor` names the camera whose views count. Errors are those of `read_views`;
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
