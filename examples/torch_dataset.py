"""Pairs of clear and rainy pictures as a data set that torch's DataLoader takes."""

import subprocess
import sys
from pathlib import Path

from rainsim.datasets.reading import pair_names, read_pair


class RainyPairs:
    """Views of an export in nerfstudio's layout, each in a rain [mm/h] and clear, with labels.

    Of a rig `sensor` names the camera whose views count: one batch holds pictures of one size.
    `rainsim.datasets.reading.read_pair` says what an item holds, `read_turn` reads lidars.
    """

    def __init__(self, folder, rate, split="train", sensor=None):
        self.folder, self.rate = folder, rate
        self.names = pair_names(folder, rate, split, sensor)

    def __len__(self):
        """Return the number of pairs."""
        return len(self.names)

    def __getitem__(self, index):
        """Return a pair: arrays by name."""
        return read_pair(self.folder, self.rate, self.names[index])


def main(folder="pairs", rate=50.0, batch=2, sensor=None, workers=0):
    """Export a few pairs if there are none, load them in batches, and say how rain changes them.

    Workers are spawned: torch forks them on Linux, which ends those that run compiled kernels.
    """
    from torch.utils.data import DataLoader

    if not (Path(folder) / "card.json").exists():
        command = "export street --layout nerfstudio --views 8 --width 320 --partners".split()
        command += ["--rain", f"0,{rate:g}", "--out", str(folder)]
        subprocess.run([sys.executable, "-m", "rainsim", *command], check=True)
    pairs = RainyPairs(folder, rate, sensor=sensor)
    context = "spawn" if workers else None
    for items in DataLoader(
        pairs, batch, True, num_workers=workers, multiprocessing_context=context
    ):
        change = 255 * (items["rainy"] - items["clear"]).abs().mean()
        print(f"{tuple(items['rainy'].shape)}: mean change {change:.1f} of 255")
    return items


if __name__ == "__main__":
    main()
