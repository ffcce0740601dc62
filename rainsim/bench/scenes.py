"""Which scenes the benches of pictures take."""

from rainsim.scene.library import list_scenes

SCENES = ("bicycle", "street")
CAPTURE = "garden"  # also measured if a folder of RAINSIM_SCENES holds a scene named so


def scene_names(quick):
    """Return the scenes of a bench: the first built-in one if it is to be quick."""
    if quick:
        return SCENES[:1]
    known = [name for name, _, _ in list_scenes()]
    return (*SCENES, *([CAPTURE] if CAPTURE in known else []))
