"""The rain of OpenEXR frames laid over another plate, as a compositor lays it.

First `rainsim run --frames 2 --width 320 --exr --out comp`. A plate is a picture or an OpenEXR file
whose Z hides rain. The part `air`, the haze of far drops, has the captured scene's outlines.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np

from rainsim.io.exr import read_parts
from rainsim.io.images import read_image, write_png
from rainsim.numerics import srgb
from rainsim.numerics.color_spaces import REC709, to_rec709

RAIN = "splashes", "spray", "streaks", "near"  # from the back to the front


def parts_of(path):
    """Return the channels of each part, and "light" (h, w, 3) in linear Rec. 709 where it has."""
    parts = read_parts(path)
    for channels, header in parts.values():
        if "R" in channels:
            to_own = to_rec709(header.get("chromaticities", REC709)).T
            channels["light"] = np.stack([channels[c] for c in "RGB"], axis=-1) @ to_own
    return {name: channels for name, (channels, _) in parts.items()}


def plate_of(path):
    """Return light (h, w, 3) in linear Rec. 709 and depth [m] of a plate; without one, infinity."""
    if path.suffix.lower() != ".exr":
        return srgb.linear(read_image(path)[..., :3] / 255), np.inf
    own = dict(pair for part in parts_of(path).values() for pair in part.items())
    return own["light"], own.get("Z", np.inf)


def main(words=None):
    """Write a PNG for each frame: the rain over the plate, by default over an even grey."""
    (parser := argparse.ArgumentParser()).add_argument("frames", nargs="?", default="comp/exr")
    parser.add_argument("--plate", nargs="+", default=[None], type=Path, help="one for all or each")
    parser.add_argument("--out", default="over", type=Path)
    given = parser.parse_args(words)
    if not (frames := sorted(Path(given.frames).glob("*.exr"))):
        parser.error(f"{given.frames} has no OpenEXR files; `rainsim run --exr` writes them")
    for path, plate in zip(frames, itertools.cycle(given.plate), strict=False):
        parts, (over, depth) = parts_of(path), plate_of(plate) if plate else (0.18, np.inf)
        if plate and over.shape != parts["near"]["light"].shape:
            parser.error(f"{plate} is {over.shape[1]} x {over.shape[0]} px, {path} is not")
        for rain in map(parts.get, RAIN):
            seen = (rain["Z"] < depth)[..., None]
            over = seen * rain["light"] + (1 - seen * rain["A"][..., None]) * over
        shown = np.rint(255 * np.clip(srgb.display(over), 0, 1)).astype(np.uint8)
        given.out.mkdir(parents=True, exist_ok=True)
        write_png(given.out / f"{path.stem}.png", shown)


if __name__ == "__main__":
    main()
