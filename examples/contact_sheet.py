"""A contact sheet: views of a capture, as it was taken above as it is in the rain.

Of your own capture, from this folder: `import contact_sheet` and
`contact_sheet.main("sheet.png", "garden/")`.
"""

import numpy as np

import rainsim
from rainsim.io.images import write_png
from rainsim.scene.cameras import resize_to


def views_of(scene, count):
    """Return `count` cameras of the capture from the lowest to the steepest view."""
    up = scene.ground_frame.up
    steep_last = sorted(scene.cameras, key=lambda camera: -float(camera.forward @ up))
    places = np.linspace(0, len(steep_last) - 1, count).round().astype(int)
    return [steep_last[place] for place in places]


def sheet_of(scene, cameras, config):
    """Return dry pictures above rainy ones, one column a camera."""
    columns = []
    for camera in cameras:
        frames = rainsim.render_rain(scene, [camera], config, layers=["clean"])
        picture, report = list(frames)[-1]
        columns.append(np.concatenate([report.aovs["clean"], picture]))
    height = max(len(column) for column in columns)
    padded = [np.pad(c, ((0, height - len(c)), (0, 0), (0, 0))) for c in columns]
    return np.concatenate(padded, axis=1)


def main(out="contact_sheet.png", scene="bicycle", presets=("moderate", "downpour"), views=5,
         width=432, **settings):  # fmt: skip
    """Write a sheet with a pair of rows for each preset; the frames are the third of a film."""
    scene = rainsim.load_scene(scene) if isinstance(scene, str) else scene
    cameras = [resize_to(camera, width) for camera in views_of(scene, views)]
    rows = []
    for preset in presets:
        config = rainsim.Config.from_preset(preset).replace(frames=3, **settings)
        rows.append(sheet_of(scene, cameras, config))
    write_png(out, np.concatenate(rows))
    print(f"{len(presets)} presets, {len(cameras)} views in {out}")


if __name__ == "__main__":
    main()
