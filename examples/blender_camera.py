"""Write the active camera of a Blender scene for `rainsim run --path`, a frame at a time.

In Blender: Scripting, Open, Run Script; the file is written beside the .blend. Without a window:

    blender -b shot.blend --python blender_camera.py -- camera.json
"""

import json
import os
import sys

import bpy

scene, camera = bpy.context.scene, bpy.context.scene.camera
typed = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
out = typed[0] if typed else bpy.path.abspath("//camera.json")
if camera is None or camera.data.type != "PERSP":
    raise SystemExit("the scene has no active perspective camera; choose one and run this again")

render = scene.render
width = round(render.resolution_x * render.resolution_percentage / 100)
height = round(render.resolution_y * render.resolution_percentage / 100)
pixel = render.pixel_aspect_y / render.pixel_aspect_x  # height over width
kept, frames = scene.frame_current, []
for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
    scene.frame_set(number)
    lens, fit = camera.data, camera.data.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width >= height * pixel else "VERTICAL"
        sensor = lens.sensor_width
    else:
        sensor = lens.sensor_width if fit == "HORIZONTAL" else lens.sensor_height
    side = width if fit == "HORIZONTAL" else height * pixel  # in widths of a pixel
    focal = lens.lens / sensor * side
    place = camera.matrix_world.normalized()  # parents may scale, a camera has no size
    frames.append({
        "file_path": f"{number:05d}",
        "fl_x": focal, "fl_y": focal / pixel,
        "cx": width / 2 - lens.shift_x * side,
        "cy": height / 2 + lens.shift_y * side / pixel,
        "transform_matrix": [list(row) for row in place],
    })  # fmt: skip
scene.frame_set(kept)
shot = {
    "camera": camera.name, "up_axis": "Z", "meters_per_unit": scene.unit_settings.scale_length,
    "fps": render.fps / render.fps_base / scene.frame_step,
    "first_frame": scene.frame_start,
}  # fmt: skip
with open(out, "w", encoding="utf-8") as file:
    json.dump({"shot": shot, "w": width, "h": height, "frames": frames}, file)
print(f"{len(frames)} frames of {camera.name} in {os.path.abspath(out)}")
