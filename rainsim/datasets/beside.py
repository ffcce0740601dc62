"""What a layout cannot hold, beside it in ours: `rainsim/` in the folder of each rain."""

import numpy as np

from rainsim.datasets.data_files import BYTES, FOLDER, JSON, PNG, PNG16, PNG48, DataFile, condition
from rainsim.datasets.sample import depth_mm


def sample_files(sample, plan):
    """Yield the `DataFile`s of a sample, the same for each layout."""
    folder, name = f"{condition(sample.rate)}/{FOLDER}", sample.view.name
    yield DataFile(f"{folder}/class_id/{name}.png", PNG, sample.class_id.astype(np.uint8))
    yield DataFile(f"{folder}/puddle_id/{name}.png", PNG16, sample.puddle_id)
    yield DataFile(f"{folder}/splash_id/{name}.png", PNG16, sample.splash_id)
    if sample.actor_id is not None:
        yield DataFile(f"{folder}/actor_id/{name}.png", PNG16, sample.actor_id)
    keep = np.where(sample.keep, 255, 0).astype(np.uint8)
    yield DataFile(f"{folder}/keep/{name}.png", PNG, keep)
    yield DataFile(f"{folder}/range/{name}.png", PNG16, depth_mm(sample.range))
    if sample.labels is not None:
        yield DataFile(f"{folder}/labels/{name}.png", PNG16, sample.labels)
    for kind in ("glass", "wetness"):
        if (share := getattr(sample, kind)) is not None:
            share = np.rint(np.clip(share, 0, 1) * 65535).astype(np.uint16)
            yield DataFile(f"{folder}/{kind}/{name}.png", PNG16, share)
    if sample.flow is not None:
        yield DataFile(f"{folder}/flow/{name}.png", PNG48, sample.flow_picture)
        mask = sample.flow_mask.astype(np.uint8)
        yield DataFile(f"{folder}/flow_mask/{name}.png", PNG, mask)
    for kind, picture in sample.partners.items():
        yield DataFile(f"{folder}/{kind}/{name}.png", PNG, picture)
    taken = {}
    if sample.view.mount is not None:
        taken = {"sensor": sample.view.mount.name, "time_s": sample.view.time}
    about = {
        "view": name, "index": sample.view.index, "rain_mm_per_hour": sample.rate,
        "held_out": sample.view.held_out, **taken, "classes": plan.names,
        **camera_facts(sample.view),
        "partners": {kind: f"{kind}/{name}.png" for kind in sample.partners}, **sample.facts,
    }  # fmt: skip
    yield DataFile(f"{folder}/{name}.json", JSON, about)


def cloud_files(sample, plan):
    """Yield the `DataFile`s of a turn of a rig's lidar, in a folder of the lidar's name."""
    turn = sample.view
    folder = f"{condition(sample.rate)}/{FOLDER}"
    place = f"{folder}/{turn.mount.name}/{turn.frame:06d}"
    for kind, values in zip(("bin", "label"), sample.cloud, strict=True):
        yield DataFile(f"{place}.{kind}", BYTES, values.tobytes())
    yield turn_facts(sample)


def turn_facts(sample):
    """Return the `DataFile` that says when and where a turn was."""
    turn = sample.view
    about = {"sensor": turn.mount.name, "frame": turn.frame, "time_s": turn.time,
             "rain_mm_per_hour": sample.rate,
             "ground_from_sensor": turn.ground_from_sensor.tolist()}  # fmt: skip
    return DataFile(f"{condition(sample.rate)}/{FOLDER}/{turn.name}.json", JSON, about)


def plan_files(plan):
    """Yield the `DataFile`s of the whole data set: rig.json, of a rig its calibration."""
    if plan.rig is not None:
        yield DataFile("rig.json", JSON, plan.rig.facts())


def camera_facts(view):
    """Return a view's camera and lens as plain values."""
    camera, lens = view.camera, view.lens
    return {
        "camera": {
            "width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy,
            "cx": camera.cx, "cy": camera.cy,
            "camera_from_ground": camera.camera_from_world.tolist(),
            "lens": None if lens is None else {"model": lens.model, "values": list(lens.values)},
        },
    }  # fmt: skip
