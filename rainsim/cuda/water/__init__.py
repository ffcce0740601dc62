"""Twins of `rainsim.water`."""
