"""What rain does to splats that are trained in it: PSNR and SSIM of clear views against mm/h.

Exports an orbit of a scene clear and in each rain, every view at its own moment, and trains on it.
`--against clear_air` judges by the same rain's views without what falls: light and wet ground are
theirs, so that the drops alone are to blame.
Needs `pip install "rainsim[downstream]"` and PYTHONPATH=. in a checkout.
Without a GPU give a tiny width, few splats and degree=0.
"""

import argparse
import json
from pathlib import Path

from benchmarks.downstream import AGAINST, CLEAR, measure
from rainsim.cli import cli
from rainsim.scene.cameras import orbit, write_transforms
from rainsim.scene.library import load_scene

RATES = (0, 0.1, 5, 10, 25, 50)  # mm/h; 0.1 mm/h is a wet world with hardly a drop in it


def export(out, scene, rates, views, width, height, more):
    """Write the data set by `rainsim export`, unless it is finished; return its folder."""
    folder, path = out / "data", out / "orbit.json"
    card = folder / "card.json"
    if card.is_file() and json.loads(card.read_text(encoding="utf-8"))["complete"]:
        return folder
    loaded = load_scene(scene)
    write_transforms(path, orbit(loaded.ground_frame, loaded.cameras, None, views, width, height))
    words = ["export", scene, "--path", path, "--rain", ",".join(f"{r:g}" for r in rates),
             "--width", width, "--height", height, "--out", folder, *more]  # fmt: skip
    cli([str(word) for word in words], standalone_mode=False)
    return folder


def main(out=None, scene="bicycle", rates=RATES, views=48, width=324, height=216,
         more=("--fps", "2"), against=CLEAR, **training):  # fmt: skip
    """Print the table; save it as table.json with a sheet of one held-out view, downstream.png."""
    if out is None:
        out, against = vars(typed_words().parse_args()).values()
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    more = more if against == CLEAR else (*more, "--partners")
    folder = export(out, scene, rates, views, width, height, more)
    return measure(folder, out, against=against, **training)


def typed_words():
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="downstream", help="folder; another for each --against")
    parser.add_argument("--against", choices=AGAINST, default=CLEAR, help="what is judged by")
    return parser


if __name__ == "__main__":
    main()
