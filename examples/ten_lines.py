"""Ten lines: a scene, its settings, rainy frames."""

from pathlib import Path

import rainsim
from rainsim.io.images import write_png
from rainsim.scene.cameras import resize_to


def main(out="ten_lines", scene="bicycle", width=648, frames=3, **settings):
    """Draw `frames` frames of a scene in a downpour into the folder `out`."""
    Path(out).mkdir(parents=True, exist_ok=True)
    scene = rainsim.load_scene(scene) if isinstance(scene, str) else scene
    config = rainsim.Config.from_preset("downpour").replace(frames=frames, **settings)
    camera = resize_to(scene.cameras[0], width)
    for picture, report in rainsim.render_rain(scene, [camera], config):
        write_png(Path(out) / f"{report.index:05d}.png", picture)
        print(f"frame {report.index}: {sum(report.milliseconds.values()):.0f} ms")


if __name__ == "__main__":
    main()
