"""The built-in scenes, generated as splats."""
