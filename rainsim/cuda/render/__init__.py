"""Twins of `rainsim.render`."""
