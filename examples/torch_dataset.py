"""Pairs of clear and rainy pictures as a data set that torch's DataLoader takes."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from rainsim.datasets.data_files import condition
from rainsim.datasets.reading import stored_card
from rainsim.io.files import read_json
from rainsim.io.images import read_image


class RainyPairs:
    """Views of an export in nerfstudio's layout, each in a rain [mm/h] and clear, with labels."""

    def __init__(self, folder, rate, split="train"):
        stored_card(folder)  # raises if it is no finished data set of the layout
        self.clear, self.rainy = Path(folder) / "clear", Path(folder) / condition(rate)
        self.files = read_json(self.rainy / "transforms.json", "cameras")[f"{split}_filenames"]

    def __len__(self):
        """Return the number of pairs."""
        return len(self.files)

    def __getitem__(self, index):
        """Return a pair: pictures (3, height, width) from 0 to 1, depth [m], mask and partner."""
        name = Path(self.files[index]).name
        partner = self.rainy / "rainsim/clear_air" / name  # with --partners
        item = {
            "rainy": _planes(self.rainy / "images" / name),
            "clear": _planes(self.clear / "images" / name),
            "depth": read_image(self.rainy / "depths" / name).astype(np.float32) / 1000,
            "keep": read_image(self.rainy / "masks" / name) > 0,
        }
        return item | ({"clear_air": _planes(partner)} if partner.exists() else {})


def _planes(path):
    return np.ascontiguousarray(read_image(path).transpose(2, 0, 1)).astype(np.float32) / 255


def main(folder="pairs", rate=50.0, batch=2):
    """Export a few pairs if there are none, load them in batches, and say how rain changes them."""
    from torch.utils.data import DataLoader

    if not (Path(folder) / "card.json").exists():
        command = "export street --layout nerfstudio --views 8 --width 320 --partners".split()
        command += ["--rain", f"0,{rate:g}", "--out", str(folder)]
        subprocess.run([sys.executable, "-m", "rainsim", *command], check=True)
    for items in DataLoader(RainyPairs(folder, rate), batch_size=batch, shuffle=True):
        change = 255 * (items["rainy"] - items["clear"]).abs().mean()
        print(f"{tuple(items['rainy'].shape)}: mean change {change:.1f} of 255")
    return items


if __name__ == "__main__":
    main()
