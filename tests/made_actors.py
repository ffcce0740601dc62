"""The description of a scene with one part that moves, as a user writes it."""

import json
from dataclasses import replace

from made_formats import write_splats
from rainsim.scene.folder import write_scene


def described(folder, scene, **changes):
    """Write a scene's static set, its node and the actors.json of both into a folder."""
    write_scene(folder / "static", replace(scene, actors=()))
    actor = scene.actors[0]
    write_splats(folder / "box.ply", actor.splats)
    node = {
        "id": 7, "class": "parcel", "splats": "box.ply",
        "box": {"centre": actor.box[0].tolist(), "size": actor.box[1].tolist()},
        "track": {"times": actor.track.time.tolist(), "positions": actor.track.position.tolist(),
                  "rotations": actor.track.rotation.tolist()},
    }  # fmt: skip
    data = {"rainsim_actors": 1, "scene": "static", "nodes": [node | changes]}
    (folder / "actors.json").write_text(json.dumps(data), encoding="utf-8")
    return folder / "actors.json"
