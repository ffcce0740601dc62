"""How much of a picture streaks, splashes and rings change, by preset and view.

Of your own capture, from this folder: `import parts_of_the_rain` and
`parts_of_the_rain.main("garden/", views=("DSC07965", "DSC08016"))`.
"""

import itertools
from dataclasses import replace

import numpy as np

import rainsim
from rainsim import pipeline
from rainsim.render.aov import NEEDED, recompose
from rainsim.scene.cameras import resize_to

SEEN = 3  # of 255: a pixel changed by more in any channel counts


def changed(one, other):
    """Return the share of pixels in which two pictures differ by more than SEEN."""
    return float((np.abs(one.astype(int) - other).max(axis=-1) > SEEN).mean())


def parts(scene, terrain, camera, config):
    """Return the shares that streaks, splashes and rings change, and 99 % of the streaks' alpha."""
    state = next(itertools.islice(pipeline.simulate(terrain, config), 3, None))
    flat = replace(state, slopes=np.zeros_like(state.slopes))
    drawn = pipeline.render(scene, terrain, (state, flat), [camera], config, NEEDED)
    report, calm = [report for _, report in drawn]

    def picture(aovs, **others):
        return recompose(aovs | others, **report.light)

    whole, none = picture(report.aovs), np.zeros_like(report.aovs["rain_alpha"])
    return (
        changed(whole, picture(report.aovs, rain_alpha=none)),
        changed(whole, picture(report.aovs, splash_alpha=none)),
        changed(whole, picture(calm.aovs)),
        float(np.percentile(report.aovs["rain_alpha"], 99)),
    )


def main(scene="bicycle", views=("00", "07", "21"), presets=("moderate", "downpour"),
         width=648, **settings):  # fmt: skip
    """Print a line for each view and preset."""
    scene = rainsim.load_scene(scene) if isinstance(scene, str) else scene
    names = "view", "preset", "streaks", "splashes", "rings", "alpha of streaks, 99 %"
    print("|", " | ".join(names), "|\n" + "|---" * len(names) + "|")
    for preset in presets:
        config = rainsim.Config.from_preset(preset).replace(frames=4, **settings)
        terrain = pipeline.extract_terrain(scene, config)
        for camera in (camera for camera in scene.cameras if camera.name in views):
            *shares, alpha = parts(scene, terrain, resize_to(camera, width), config)
            cells = [camera.name, preset, *(f"{share:.1%}" for share in shares), f"{alpha:.3f}"]
            print("|", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
