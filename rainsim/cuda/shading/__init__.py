"""Twins of `rainsim.shading`."""
