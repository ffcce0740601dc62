"""Twins of `rainsim.particles`."""
