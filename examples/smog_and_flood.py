"""ClimateNeRF's smog and flood, by its formulas, on the layers of a frame, beside rain and a flood.

Li et al., ICCV 2023: smog of extinction s before a surface at distance t replaces 1 - exp(-0.9 s t)
of its light by one colour; flooded pixels are F reflection + (1 - F) colour, F Fresnel's.
"""

import numpy as np
from PIL import Image

import rainsim
from rainsim.render.aov import NEEDED
from rainsim.scene.cameras import resize_to

BEFORE = 0.9  # of the distance to a surface lies in the smog
WATER = (0.488, 0.406, 0.32)  # display colour of water in its configurations


def frame(scene, camera, preset, **settings):
    """Return the first frame of a preset, and its report with the layers that are needed."""
    config = rainsim.Config.from_preset(preset).replace(frames=1, **settings)
    names = [*NEEDED, "range", "water_depth"]
    return next(rainsim.render_rain(scene, [camera], config, layers=names))


def smog(report, extinction):
    """Return the share of light that smog replaces, (height, width)."""
    return 1 - np.exp(-BEFORE * extinction * report.aovs["range"])


def flooded(report):
    """Return the frame with water of one colour, seen from above as ClimateNeRF's is."""
    color = ((np.array(WATER) + 0.055) / 1.055) ** 2.4  # linear light
    aovs = {**report.aovs, "refraction": np.broadcast_to(color, report.aovs["wet"].shape)}
    return rainsim.recompose(aovs, **report.light)


def main(out="smog_and_flood.jpg", scene="bicycle", camera=2, width=480, **settings):
    """Print shares and the difference; save the flood by both, side by side."""
    scene = rainsim.load_scene(scene) if isinstance(scene, str) else scene
    camera = resize_to(scene.cameras[camera], width)
    for rate in (10, 50, 100):
        _, report = frame(scene, camera, "downpour", rate=rate / 3.6e6, **settings)
        extinction = report.facts["weather"]["extinction_per_m"]
        land = np.isfinite(report.aovs["range"])
        rain = 1 - report.aovs["transmission"] * (1 - report.aovs["rain_alpha"])
        ours, theirs = rain[land].mean(), smog(report, extinction)[land].mean()
        print(f"{rate} mm/h: {extinction:.4f} /m; of the light of land")
        print(f"  rain replaces {ours:.4f}, smog {theirs:.4f}")
    own, report = frame(scene, camera, "flood", rate=0.0, **settings)
    other = flooded(report)
    water = (report.aovs["coverage"] > 0.9) & (report.aovs["water_depth"] > 0)
    error = np.mean((own[water] / 255.0 - other[water] / 255.0) ** 2)
    print(f"flood: {-10 * np.log10(error):.1f} dB apart on {water.mean():.2f} of the picture")
    Image.fromarray(np.concatenate([other, own], axis=1)).save(out, quality=86)


if __name__ == "__main__":
    main()
