"""Your own camera path: a slow dolly towards the scene, one camera per frame."""

from pathlib import Path

import numpy as np

import rainsim
from rainsim.io.images import write_png
from rainsim.scene.cameras import look_at, write_transforms


def dolly(scene, frames, width, height):
    """Return cameras that come closer to what the first camera looks at, in the capture frame."""
    frame, first = scene.ground_frame, scene.ground_frame.camera_in_ground(scene.cameras[0])
    target = first.position + 3.0 * first.forward  # metres
    cameras = []
    for t in np.linspace(0, 1, frames):
        eye = first.position + t * np.add(first.forward, (0, 0, -0.2))
        camera = look_at(eye, target, (0, 0, 1), 60, width, height, name=f"dolly_{len(cameras)}")
        cameras.append(frame.camera_in_capture(camera))
    return cameras


def main(out="camera_path", scene="bicycle", frames=12, width=648, height=432, **settings):
    """Draw the path in moderate rain; `transforms.json` works with `rainsim run --path` too."""
    scene = rainsim.load_scene(scene) if isinstance(scene, str) else scene
    cameras = dolly(scene, frames, width, height)
    Path(out).mkdir(parents=True, exist_ok=True)
    write_transforms(Path(out) / "transforms.json", cameras)
    config = rainsim.Config.from_preset("moderate").replace(frames=frames, **settings)
    for picture, report in rainsim.render_rain(scene, cameras, config):
        write_png(Path(out) / f"{report.index:05d}.png", picture)
    print(f"{frames} frames in {out}")


if __name__ == "__main__":
    main()
