"""Draw pictures of pages by the commands below them: last frames of stills, all frames of films."""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import rainsim

ROOT = Path(__file__).resolve().parents[1]
PAGES = "docs/gallery.md", "docs/compared.md"
ENTRY = re.compile(r"^!\[[^\]]*\]\(([^)\s]+)\)\n\n```\n((?:rainsim run .*\n)+)```", re.M)


def entries(page):
    """Return (path of the picture, list of commands) for each picture with commands on a page."""
    found = ENTRY.findall(page.read_text(encoding="utf-8"))
    return [(page.parent / picture, block.splitlines()) for picture, block in found]


def frames_of(command):
    """Run a command in an empty folder; return its frames, each of shape (height, width, 3)."""
    words = [sys.executable, "-m", *command.split(), "--quiet"]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "examples").symlink_to(ROOT / "examples")
        subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        frames = Path(folder, words[words.index("--out") + 1], "frames").glob("*.png")
        return [rainsim.read_image(path) for path in sorted(frames)]


def write(path, commands, shots):
    """Write the picture of a page from the frames of its commands."""
    about = Image.Exif()
    about[0x010E] = "; ".join(commands)  # EXIF's image description
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".jpg":
        still = np.concatenate([frames[-1] for frames in shots], axis=1)
        Image.fromarray(still).save(path, quality=86, optimize=True, exif=about)
        return
    fps = float(re.search(r"--fps (\S+)", commands[0])[1])
    first, *others = map(Image.fromarray, shots[0])
    moving = {"save_all": True, "append_images": others, "duration": round(1000 / fps), "loop": 0}
    first.save(path, quality=72, method=6, kmax=1, exif=about, **moving)


def main(pages=PAGES, only=None):
    """Draw the pictures of the pages, or `only` those of these names, else of the command line."""
    only = sys.argv[1:] if only is None else only
    for path, commands in [entry for page in pages for entry in entries(ROOT / page)]:
        if not only or path.name in only:
            write(path, commands, [frames_of(command) for command in commands])
            print(f"{path}: {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
