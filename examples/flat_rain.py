"""Rain in space against rain drawn flat on the picture: whether two views of one moment agree.

Needs PYTHONPATH=. in a checkout.
"""

from dataclasses import replace

import numpy as np

import rainsim
from benchmarks.flat_rain import flat_rain, partners
from rainsim.io.images import write_png
from rainsim.scene.cameras import resize_to

BASELINE, NEAREST = 0.2, 0.6  # m between the cameras, and of the nearest streak that is looked for


def pair_of(scene, camera):
    """Return a camera of the scene and one beside it to the right, capture frame."""
    grounded = scene.ground_frame.camera_in_ground(camera)
    matrix = grounded.camera_from_world.copy()
    matrix[0, 3] -= BASELINE
    return camera, scene.ground_frame.camera_in_capture(replace(grounded, camera_from_world=matrix))


def compare(scene, camera, config, seed):
    """Return the alphas of both views, ours and flat, and (share, count) of each."""
    shots = [next(iter(rainsim.render_rain(scene, [view], config, layers=["rain_alpha"])))
             for view in pair_of(scene, camera)]  # fmt: skip
    ours = [report.aovs["rain_alpha"] for _, report in shots]
    flat = [flat_rain(alpha, 2 * seed + k) for k, alpha in enumerate(ours)]
    most = round(BASELINE * camera.fx / NEAREST)
    return ours, flat, partners(*ours, most), partners(*flat, most)


def main(out="flat_rain.png", scene="bicycle", width=648, rates=(10, 25, 50), views=6, **settings):
    """Print the share of streaks that both views show, ours and the overlay's; save a picture."""
    scene = rainsim.load_scene(scene) if isinstance(scene, str) else scene
    print("mm/h  rain in space (streaks)  flat rain (streaks)")
    for rate in rates:
        config = rainsim.Config.from_preset("downpour").replace(
            rate=rate / 3.6e6, frames=1, **settings
        )
        total = np.zeros((2, 2))  # partners and streaks; ours and theirs
        for k, camera in enumerate(scene.cameras[:views]):
            ours, flat, *shares = compare(scene, resize_to(camera, width), config, k)
            total += [(share * count, count) for share, count in shares]
        (a, m), (b, n) = total
        print(f"{rate:4g}  {a / max(m, 1):.2f} ({m:.0f})  {b / max(n, 1):.2f} ({n:.0f})")
    rows = [np.concatenate(pair, axis=1) for pair in (ours, flat)]
    write_png(out, (np.clip(np.concatenate(rows) * 4, 0, 1) * 255).astype(np.uint8))


if __name__ == "__main__":
    main()
