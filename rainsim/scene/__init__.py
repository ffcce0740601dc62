"""Captures: splats, cameras, the ground frame, the readers and the built-in scenes."""
