"""The uses that the recorded list is made for, and the choice of those most like a run."""

# Each use as the settings that a tiny run of it changes: a preset and single settings.
USES = {
    "drizzle": ("drizzle", {}),
    "downpour": ("downpour", {}),
    "flood": ("flood", {}),
    "after": ("after", {}),
    "paper": ("paper", {}),
    "mirror": ("drizzle", {"reflections": "mirror"}),
    "ssr": ("drizzle", {"reflections": "ssr"}),
    "capture-sky": ("drizzle", {"sky": "capture"}),
}
# Uses that are no run of these settings.
LAYERS = "layers"  # a run that writes all layers
HEIGHTMAP = "heightmap"  # the command
SIMULATE = "simulate"  # the command, and the height map that it needs
SPLAT = "splat"  # the command
LIDAR = "lidar"  # the command
CAPTURE = "capture"  # a run of a capture: its surface, its sun and its sky are found first
STREET, TRAFFIC = "street", "traffic"  # a run of that scene: its lamps, and its cars with spray
SCENES = (STREET, TRAFFIC)
# On a GPU: runs of several presets, of the two scenes, and one with layers.
CUDA, CUDA_LAYERS, CUDA_STREET, CUDA_TRAFFIC = "cuda", "cuda-layers", "cuda-street", "cuda-traffic"
ALL_CUDA = (CUDA, CUDA_LAYERS, CUDA_STREET, CUDA_TRAFFIC)
ALL = (*USES, LAYERS, HEIGHTMAP, SIMULATE, SPLAT, LIDAR, CAPTURE, *SCENES)
# Settings that choose kernels, by group.
CHOICES = {
    "water": ("scheme",),
    "render": (
        "wetting", "reflections", "film", "refraction", "fresnel", "highlight", "coverage",
        "water_geometry", "streaks", "splashes",
    ),
}  # fmt: skip


def choices(config):
    """Return the choices of a `Config` that decide which kernels run, as a tuple."""
    picked = [getattr(getattr(config, group), n) for group, names in CHOICES.items() for n in names]
    sky = config.render.sky == "capture"
    return (*picked, sky, config.water.level is not None, config.rain.rate > 0)


def cuda_uses(layers=(), captured=False, scene=""):
    """Return the names of the recorded uses that a run on a GPU is like; see `uses_like`."""
    found = [SIMULATE, CUDA]  # ground and standing water are the CPU's
    found += [*([CUDA_LAYERS] if layers else []), *([CAPTURE] if captured else [])]
    kind = f"{CUDA}-{scene.partition(':')[0]}"
    return found + [kind for use in ALL_CUDA if use == kind]


def uses_like(config, config_of, layers=(), captured=False, scene=""):
    """Return the names of the recorded uses that are most like a run.

    config_of : callable. config_of(preset, changes) returns the Config of a use.
    layers : sequence of str. Names of the layers that the run writes.
    captured : bool. Whether the scene is a capture and not a built-in one.
    scene : str. Its name.
    """
    wanted = choices(config)
    equal = {
        name: sum(a == b for a, b in zip(wanted, choices(config_of(*use)), strict=True))
        for name, use in USES.items()
    }
    best = max(equal.values())
    found = [name for name, count in equal.items() if count == best]
    found += [LAYERS] if layers else []
    found += [CAPTURE] if captured else []
    return found + [kind for kind in SCENES if scene.partition(":")[0] == kind]
