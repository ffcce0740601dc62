"""Write the active camera of a Blender scene for `rainsim run --path`, frame by frame.

In Blender: workspace Scripting, Open, Run Script; camera.json is written beside the .blend. Or:
blender -b shot.blend --python blender_camera.py -- camera.json
"""

import json
import sys


def lens_of(camera, width, height, pixel):
    """Return focal lengths and principal point [px]; `pixel` is its height over its width."""
    fit = camera.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width >= height * pixel else "VERTICAL"
        sensor = camera.sensor_width
    else:
        sensor = camera.sensor_width if fit == "HORIZONTAL" else camera.sensor_height
    side = width if fit == "HORIZONTAL" else height * pixel  # in widths of a pixel
    focal = camera.lens / sensor * side
    return {
        "fl_x": focal, "fl_y": focal / pixel,
        "cx": width / 2 - camera.shift_x * side,
        "cy": height / 2 + camera.shift_y * side / pixel,
    }  # fmt: skip


def main(out=None):
    """Write the file `out`; without a name the one that is typed after two hyphens."""
    import bpy

    typed = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    out = out or (typed or [bpy.path.abspath("//camera.json")])[0]
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    if camera is None or camera.data.type != "PERSP":
        raise SystemExit("the scene has no active perspective camera; choose one")
    render, kept, frames = scene.render, scene.frame_current, []
    sides = render.resolution_x, render.resolution_y
    width, height = (int(side * render.resolution_percentage / 100) for side in sides)
    pixel = render.pixel_aspect_y / render.pixel_aspect_x
    for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
        scene.frame_set(number)
        place = camera.matrix_world.normalized()  # parents may scale; a camera has no size
        frames.append({
            "file_path": f"{number:05d}", **lens_of(camera.data, width, height, pixel),
            "transform_matrix": [list(row) for row in place],
        })  # fmt: skip
    scene.frame_set(kept)
    shot = {
        "camera": camera.name, "meters_per_unit": scene.unit_settings.scale_length, "up_axis": "Z",
        "fps": render.fps / render.fps_base / scene.frame_step,
        "first_frame": scene.frame_start,
    }  # fmt: skip
    with open(out, "w", encoding="utf-8") as file:
        json.dump({"shot": shot, "w": width, "h": height, "frames": frames}, file)
    print(f"{len(frames)} frames of {camera.name} in {out}")


if __name__ == "__main__":
    main()
