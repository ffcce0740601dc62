"""What rain does to splats that are trained in it: PSNR and SSIM of clear views against mm/h.

Exports an orbit of a scene clear and in each rain, every view at its own moment, and trains on it.
Needs `pip install "rainsim[downstream]"`; without a GPU give a tiny width, few splats and degree=0.
"""

import json
from pathlib import Path

from rainsim.bench.downstream import measure
from rainsim.cli import cli
from rainsim.scene.cameras import orbit, write_transforms
from rainsim.scene.library import load_scene

RATES = (0, 0.1, 5, 10, 25, 50)  # mm/h; 0.1 mm/h is a wet world with hardly a drop in it


def export(out, scene, rates, views, width, height, more):
    """Write the data set by `rainsim export`, unless it is finished; return its folder."""
    folder, path = out / "data", out / "orbit.json"
    card = folder / "card.json"
    if card.is_file() and json.loads(card.read_text())["complete"]:
        return folder
    loaded = load_scene(scene)
    write_transforms(path, orbit(loaded.ground_frame, loaded.cameras, None, views, width, height))
    words = ["export", scene, "--path", path, "--rain", ",".join(f"{r:g}" for r in rates),
             "--width", width, "--height", height, "--out", folder, *more]  # fmt: skip
    cli([str(word) for word in words], standalone_mode=False)
    return folder


def main(out="downstream", scene="bicycle", rates=RATES, views=48, width=324, height=216,
         more=("--fps", "2"), **training):  # fmt: skip
    """Print the table; save it as table.json with a sheet of one held-out view, downstream.png."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    folder = export(out, scene, rates, views, width, height, more)
    return measure(folder, out, **training)


if __name__ == "__main__":
    main()
