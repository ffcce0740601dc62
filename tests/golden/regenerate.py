"""The golden frames: what is drawn for them, how they are compared, and how they are made again.

Run `python tests/golden/regenerate.py [NAME ...]` after a change that is meant to change pictures,
look at the old and the new pictures, and say in the commit message what changed and by how much.
"""

from __future__ import annotations

import sys
from pathlib import Path

import imageio.v3 as imageio
import numpy as np

import rainsim

FOLDER = Path(__file__).resolve().parent
WIDTH, HEIGHT = 96, 64  # px
MAP = {"extent": 4.0, "spacing": 0.05}  # m: 160 x 160 cells
LEAST_DECIBEL = 50.0
CHANGED = 2  # grey levels of 255; rounding elsewhere moves a pixel by one
MOST_CHANGED = 0.002  # share of the pixels

# Name of the picture: scene, cameras of the two frames, preset, changes of its settings.
# Each preset stands here once, each scene with a camera at rest and with one that moves.
CASES = {
    "bicycle_drizzle": ("bicycle", (0, 0), "drizzle", {}),
    "bicycle_moderate": ("bicycle", (2, 3), "moderate", {}),
    "bicycle_paper": ("bicycle", (0, 0), "paper", {}),
    "street_downpour": ("street", (6, 7), "downpour", {}),
    "street_flood": ("street", (6, 6), "flood", {}),
    "street_dusk": ("street", (6, 7), "dusk", {}),
    "street_after": ("street", (1, 1), "after", {"sun": "sky"}),
}


def golden_frames(scene, name, **more):
    """Return the frames of a case, one above the other, as uint8 of shape (2 * HEIGHT, WIDTH, 3).

    `scene` is the loaded scene that the case names; `more` changes settings of the case.
    """
    _, cameras, preset, changes = CASES[name]
    views = [scene.cameras[k].resized(WIDTH, HEIGHT) for k in cameras]
    config = rainsim.Config.from_preset(preset)
    config = config.replace(**{"frames": len(views), "width": WIDTH, **MAP, **changes, **more})
    # The picture is copied: a renderer may draw the next frame into the same array.
    return np.concatenate([p.copy() for p, _ in rainsim.render_rain(scene, views, config)])


def path_of(name):
    """Return the path of a case's picture."""
    return FOLDER / f"{name}.png"


def read(name):
    """Return the kept picture of a case, of shape (2 * HEIGHT, WIDTH, 3), uint8."""
    return imageio.imread(path_of(name))


def compared(found, wanted):
    """Return the PSNR [dB], the share of changed pixels, and the worst pixel (row, column)."""
    error = np.abs(found.astype(int) - wanted)
    mean_square = np.mean(error**2)
    psnr = 10 * np.log10(255**2 / mean_square) if mean_square else np.inf
    worst = error.max(axis=-1)
    row, column = np.unravel_index(worst.argmax(), worst.shape)
    return psnr, np.mean(worst > CHANGED), (int(row), int(column))


def main(names):
    """Draw the cases again and print how far each was from the picture that it replaces."""
    scenes = {}
    for name in names or CASES:
        scene = scenes.setdefault(CASES[name][0], rainsim.load_scene(CASES[name][0]))
        found = golden_frames(scene, name)
        if path_of(name).exists():
            psnr, changed, worst = compared(found, read(name))
            print(f"{name}: {psnr:.1f} dB, {changed:.2%} of the pixels changed, most at {worst}")
        imageio.imwrite(path_of(name), found)


if __name__ == "__main__":
    main(sys.argv[1:])
