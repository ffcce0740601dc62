"""Output folders: checked before use, filled file by file, with a record of all written files.

`provenance.json` in a folder names the files that the program wrote there; only these are ever
removed or replaced, and only when new results are ready to take their place.
"""

_PUBLIC = {
    "claims": ("claimed", "relative", "require_empty"),
    "facts": (
        "cameras_facts", "host_facts", "input_facts", "scene_content", "settings_content",
        "settings_facts", "states_content", "versions",
    ),
    "frames": ("FrameFolder", "complete_film"),
    "names": (
        "CLAIM", "FRAME_FACTS", "JOURNAL", "OURS", "PROVENANCE", "RECORD_VERSION", "STATE",
        "STATE_FACTS", "VERSION", "others_in", "read_record", "remove_temporary",
    ),
    "record": ("Record",),
}  # fmt: skip
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}
__all__ = sorted(_HOME)


def __getattr__(name):
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(f"rainsim.output_folder.{_HOME[name]}"), name)
    raise AttributeError(f"module 'rainsim.output_folder' has no attribute {name!r}")
