"""The rain of OpenEXR frames laid over another plate, as a compositor lays it.

First `rainsim run --frames 2 --width 320 --exr --out comp`, which is in linear Rec. 709. The part
`air`, the haze of far drops, is left out: it has the outlines of the captured scene.
"""

from pathlib import Path

import numpy as np

from rainsim.io.images import read_image, write_png
from rainsim.numerics import srgb

RAIN = ("splashes", "spray", "streaks", "near")  # from the back to the front


def parts_of(path):
    """Return the channels of each part of an OpenEXR file, float32."""
    import OpenEXR  # pip install "rainsim[exr]"

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {
            part.name(): {name: np.float32(c.pixels) for name, c in part.channels.items()}
            for part in file.parts
        }


def main(frames="comp/exr", plate=None, out="over", strength=1.0):
    """Write a PNG for each frame: the rain over the plate, by default over an even grey."""
    Path(out).mkdir(parents=True, exist_ok=True)
    for path in sorted(Path(frames).glob("*.exr")):
        parts = parts_of(path)
        over = np.full((*parts["near"]["A"].shape, 3), 0.18, np.float32)
        if plate is not None:
            over = srgb.linear(read_image(plate) / 255)
        for rain in (parts[name] for name in RAIN):
            light = np.stack([rain[channel] for channel in "RGB"], axis=-1)
            over = strength * light + (1 - strength * rain["A"][..., None]) * over
        shown = np.clip(srgb.display(over), 0, 1)
        write_png(Path(out) / f"{path.stem}.png", np.rint(255 * shown).astype(np.uint8))
    print(f"the frames over the plate are in {out}")


if __name__ == "__main__":
    main()
