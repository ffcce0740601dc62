"""The paper's choices beside the defaults: processor time and counts of the same frames.

Of your own capture: `import beside_the_paper` and `beside_the_paper.main("garden/")`.
"""

import time
from dataclasses import replace

import rainsim
from rainsim import pipeline
from rainsim.scene.cameras import resize_to

STEP = 0.02  # m from frame to frame: the camera moves ahead
SEEN = 1 / 255  # alpha from which on a pixel counts as covered by a streak
COLUMNS = "water of a frame", "picture of a frame", "pixels with streaks"
COLUMNS += "light that drops replace", "pixels of water"


def ahead(camera, step):
    """Return a camera that stands `step` (in the capture's unit) further along its view."""
    pose = camera.camera_from_world.copy()
    pose[2, 3] -= step
    return replace(camera, camera_from_world=pose)


def least(iterator, frames):
    """Return the least processor time [ms] of an iterator's steps after the first, and all."""
    items, times = [], []
    for _ in range(frames):
        begin = time.process_time()
        items.append(next(iterator))
        times.append(1e3 * (time.process_time() - begin))
    return f"{min(times[1:]):.0f} ms", items


def measure(scene, config, cameras):
    """Return the cells of a row."""
    terrain, names = pipeline.extract_terrain(scene, config), ("rain_alpha", "coverage")
    water, states = least(pipeline.simulate(terrain, config), len(cameras))
    picture, _ = least(pipeline.render(scene, terrain, states, cameras, config), len(cameras))
    aovs = next(pipeline.render(scene, terrain, states[-1:], cameras, config, names))[1].aovs
    alpha, covered = (aovs[name] for name in names)
    return [water, picture, *(f"{a.mean():.1%}" for a in (alpha > SEEN, alpha, covered))]


def main(scene=("bicycle", "street"), width=648, frames=7, **settings):
    """Print a line for each scene and preset, 50 mm/h after 8 mm of past rain."""
    print("| |", " | ".join(COLUMNS), "|\n|" + "---|" * (1 + len(COLUMNS)))
    for place in [scene] if isinstance(scene, str | rainsim.Scene) else scene:
        place = rainsim.load_scene(place) if isinstance(place, str) else place
        first, step = resize_to(place.cameras[0], width), STEP / place.ground_frame.meters_per_unit
        cameras = [ahead(first, k * step) for k in range(frames)]
        for preset, choice in ("paper", "the paper's choices"), ("downpour", "defaults"):
            config = rainsim.Config.from_preset(preset).replace(past=0.008, frames=frames)
            cells = measure(place, config.replace(**settings), cameras)
            print(f"| {place.name}, {choice} |", " | ".join(cells), "|", flush=True)


if __name__ == "__main__":
    main()
