"""What moves through a scene: its list, motion, wheels, footprint and files."""
