"""A drive that Street Gaussians or drivestudio reconstructed, written as a scene of rainsim.

python convert.py output/street/ --tracks data/002 --out drive
python convert.py checkpoint_final.pth --cameras transforms.json --out drive

The first is a model of Street Gaussians (Yan et al. 2024) with the data that it was trained on, the
second a checkpoint of drivestudio (OmniRe, Chen et al. 2025), which torch reads. Their unit is the
metre. `rainsim run --scene drive --drive` rains on it; docs/actors.md says what is left out.
"""

import argparse
import pickle
from dataclasses import replace
from pathlib import Path

import drivestudio
import street_gaussians
from parts import scene_of

import rainsim
from rainsim.scene.folder import cameras_beside, locate, write_scene

DAMAGE = (
    rainsim.RainsimError, OSError, LookupError, ValueError, RuntimeError, TypeError,
    AttributeError, pickle.PickleError, ImportError,
)  # fmt: skip


def converted(given):
    """Return the Scene of what the command line names."""
    file, model = locate(given.model)
    found = rainsim.load_cameras(given.cameras) if given.cameras else cameras_beside(file, model)
    cameras, notes = street_gaussians.in_order(found[0]), found[1]
    if file.suffix == ".pth":
        found = drivestudio.read(file, given.fps)
    else:
        found = street_gaussians.read(file, given.tracks, cameras)
    scene = scene_of(cameras, *found)
    return replace(scene, source=file, notes=(*scene.notes, *notes))


def main(words=None):
    """Write the scene folder; `words` are those of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path, help="PLY or folder of Street Gaussians, or a .pth")
    parser.add_argument("--tracks", type=Path, help="data that Street Gaussians was trained on")
    parser.add_argument("--fps", type=float, default=10.0, help="of drivestudio's data")
    parser.add_argument("--cameras", type=Path, help="where they do not lie beside the model")
    parser.add_argument("--out", type=Path, default="drive", help="scene folder to write")
    given = parser.parse_args(words)
    try:
        scene = converted(given)
        write_scene(given.out, replace(scene, name=given.out.resolve().name))
    except DAMAGE as error:
        parser.error(f"{given.model} or its data cannot be read: {type(error).__name__}, {error}")
    print(*scene.notes, f"{len(scene.splats)} splats, {len(scene.actors)} actors", sep="\n")


if __name__ == "__main__":
    main()
