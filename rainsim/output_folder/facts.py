"""What a record says of scene, settings and machine, and what of them results depend on."""

import os
import platform

from rainsim.config.preset_files import SKIES
from rainsim.io.files import named_path
from rainsim.io.fingerprint import hash_of, hash_of_file
from rainsim.io.fingerprint import versions as library_versions
from rainsim.output_folder.names import read_record

VERSIONS_OF = ("numpy", "scipy", "numba", "llvmlite", "pillow")


def settings_content(config):
    """Return the settings that results depend on: without paths, threads and frame range."""
    settings = config.as_dict()
    settings["threads"] = settings["frame_range"] = None
    if config.render.sky not in SKIES:
        settings["render"]["sky"] = hash_of_file(config.render.sky)
    return settings


def states_content(folder):
    """Return the parts of a folder of states that frames depend on, as plain values."""
    return {
        "terrain": hash_of_file(folder / "terrain.npz"),
        "simulation": read_record(folder).get("fingerprint"),
    }


def scene_content(scene):
    """Return the parts of a scene that results depend on, as plain values; None without one."""
    if scene is None:
        return None
    from rainsim.scene.cameras import cameras_to_data
    from rainsim.scene.ground import ground_frame_to_dict

    frame = ground_frame_to_dict(scene.ground_frame)
    return {
        "sha256": scene.source_hash, "splats": len(scene.splats), "drains": scene.drains,
        "ground_frame": {name: frame[name] for name in frame if name != "notes"},
        "cameras": hash_of(cameras_to_data(scene.cameras)), "painted": scene.painted_hash,
        **({"captured_sun": scene.captured_sun} if scene.captured_sun else {}),
    }  # fmt: skip


def host_facts():
    """Return the host and process that draw frames, which may differ between frames of one run."""
    return {"name": platform.node(), "platform": platform.platform(), "process": os.getpid()}


def settings_facts(config, preset):
    """Return the settings for a record, without threads and frame range, which change no frame."""
    settings = config.as_dict()
    settings["threads"] = settings["frame_range"] = None
    return {
        "preset": str(preset),
        "seed": config.rain.seed,
        "settings": settings,
        "settings_units": "SI: m, s, m/s, rad; px",
    }


def input_facts(scene, folder):
    """Return name, source, hash and ground frame of a scene as plain values, or None."""
    if scene is None:
        return None
    from rainsim.scene.ground import ground_frame_to_dict
    from rainsim.scene.origin import capture_from_ground

    large = {} if not any(scene.origin) else {
        "origin": list(scene.origin), "capture_from_ground": capture_from_ground(scene).tolist()
    }  # fmt: skip
    return {
        "scene": scene.name,
        "source": None if scene.source is None else named_path(scene.source, folder),
        "sha256": scene.source_hash,
        "splats": len(scene.splats),
        "ground_frame": ground_frame_to_dict(scene.ground_frame),
        "notes": list(scene.notes),
        **large,
    }


def cameras_facts(cameras):
    """Return number and hash of the frames' cameras; transforms.json holds the cameras."""
    from rainsim.scene.cameras import cameras_to_data

    return {"count": len(cameras), "sha256": hash_of(cameras_to_data(cameras))}


def versions():
    """Return the versions of Python and of the libraries that the numbers depend on."""
    return {**library_versions(VERSIONS_OF), "platform": platform.platform()}
