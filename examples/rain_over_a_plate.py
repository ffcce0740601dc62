"""The rain of OpenEXR frames laid over another plate, as a compositor lays it.

First `rainsim run --frames 2 --width 320 --exr --out comp`. A plate is a picture or an OpenEXR file
whose Z hides rain. The part `air`, the haze of far drops, has the captured scene's outlines.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np

from rainsim.io.exr import light_of, read_parts
from rainsim.io.images import read_image, write_png
from rainsim.numerics import srgb

RAIN = ("splashes", "spray", "streaks", "near")  # from the back to the front


def plate_of(path):
    """Return light (h, w, 3) in linear Rec. 709 and depth [m] of a plate; without one, infinity."""
    if path.suffix.lower() != ".exr":
        return srgb.linear(read_image(path)[..., :3] / 255), np.inf
    parts = read_parts(path).values()
    light = next(light_of(*part) for part in parts if "R" in part[0])
    return light, next((channels["Z"] for channels, _ in parts if "Z" in channels), np.inf)


def main(words=None):
    """Write a PNG for each frame: the rain over the plate, by default over an even grey."""
    parser = argparse.ArgumentParser()
    parser.add_argument("frames", nargs="?", default="comp/exr", type=Path)
    parser.add_argument("--plate", nargs="+", default=[None], type=Path, help="one for all or each")
    parser.add_argument("--out", default="over", type=Path)
    given = parser.parse_args(words)
    frames = sorted(given.frames.glob("*.exr"))
    if not frames:
        parser.error(f"{given.frames} has no OpenEXR files; `rainsim run --exr` writes them")
    given.out.mkdir(parents=True, exist_ok=True)
    for path, plate in zip(frames, itertools.cycle(given.plate), strict=False):
        parts = read_parts(path)
        over, depth = plate_of(plate) if plate else (0.18, np.inf)
        for channels, header in (parts[name] for name in RAIN):
            light = light_of(channels, header)
            if plate and over.shape != light.shape:
                parser.error(f"{plate} is {over.shape[1]} x {over.shape[0]} px, {path} is not")
            seen = (channels["Z"] < depth)[..., None]
            over = seen * light + (1 - seen * channels["A"][..., None]) * over
        shown = np.rint(255 * np.clip(srgb.display(over), 0, 1)).astype(np.uint8)
        write_png(given.out / f"{path.stem}.png", shown)


if __name__ == "__main__":
    main()
