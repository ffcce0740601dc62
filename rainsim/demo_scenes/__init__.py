"""The built-in scenes, generated as splats."""

# Where `rainsim run` looks from if no camera is named: eye and target [capture units], low over a
# puddle that mirrors. Scenes that are not here are seen by their first camera.
FIRST_VIEWS = {"bicycle": ((-6.27, 1.14, 1.68), (-0.44, 0.86, 1.60))}
